"""The commands ``acoustube process`` and ``acoustube calibrate``: recordings in, tables out."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from rich.console import Console
from rich.markup import escape

from acoustube import recordings, signals
from acoustube.base.console import ConsoleReporter, note, watched_interrupts
from acoustube.base.errors import ConfigError
from acoustube.runs.recordings import (
    COLUMNS,
    LABEL_COLUMNS,
    check_rate,
    chosen,
    opened,
    table_rows,
    true_rows,
    with_progress,
)
from acoustube.signals import Processing, Ranging

LOUD = 1.5
"""Height of an echo over the send pulse above which the record is suspected to begin elsewhere."""


def run_process(
    paths: Sequence[Path],
    out: Path | None,
    console: Console,
    *,
    calibration: str | None = None,
    prominence: float | None = None,
    rate: float | None = None,
    temperature: float | None = None,
    channel: int | None = None,
    samples: int | None = None,
    figure: Path | None = None,
) -> bool:
    """Process recordings and write one row per cycle.

    Parameters
    ----------
    paths : sequence of Path
        Files and folders.
    out : Path or None
        The CSV file to write; None writes to standard output.
    console : rich.console.Console
        Where to say what was found; what could not be processed goes to standard error.
    calibration : str, optional
        A file, or the name of a calibration.
    prominence : float, optional
        In place of the calibration's.
    rate, temperature, channel, samples
        See :func:`acoustube.recordings.read`.
    figure : Path, optional
        A picture of the first cycle with an echo, and a waterfall of the cycles around it.

    Returns
    -------
    bool
        Whether all files were processed.

    Raises
    ------
    ConfigError
        If the calibration cannot be used, or no file be processed.
    """
    known, how = chosen(calibration, prominence)
    errors, report = Console(stderr=True), ConsoleReporter(console)
    failures, n_cycles, n_found, drawn = 0, 0, 0, False
    with watched_interrupts() as check, opened(out) as file:
        writer = csv.writer(file, lineterminator="\n")
        header = [[*COLUMNS, *(name for name, _ in LABEL_COLUMNS.values())]]
        for path, data in recordings.read_all(
            paths, rate=rate, temperature=temperature, channel=channel, samples=samples
        ):
            found, loudest, shown = 0, 0.0, None
            table: list[list[object]] = []  # written as a whole, or not at all
            try:
                if isinstance(data, ConfigError):
                    raise data
                check_rate(float(data.attrs["sampling_rate"]), known, path)
                for first, ranging in with_progress(data, how, report, check, path):
                    these = data.isel(cycle=slice(first, first + len(ranging.detected)))
                    rows = zip(table_rows(first, ranging, path), true_rows(these), strict=True)
                    table += ([*row, *labels] for row, labels in rows)
                    if ranging.detected.any():
                        found += int(ranging.detected.sum())
                        loudest = max(loudest, float(np.nanmax(ranging.amplitude)))
                        shown = shown or (first, ranging)
            except (ConfigError, ValueError) as error:
                failures += 1
                text = " ".join(str(error).split())
                named = text if str(path) in text else f"{path}: {text}"
                errors.print(f"[red]not processed:[/] {escape(named)}", soft_wrap=True)
                continue
            writer.writerows([*header, *table])
            header = []
            n_cycles, n_found = n_cycles + data.sizes["cycle"], n_found + found
            notes = str(data.attrs.get("warnings", "")).splitlines()
            if loudest > LOUD:
                notes.append(
                    f"an echo is {loudest:.3g} times as high as the send pulse: does each cycle "
                    "begin when the pulse leaves?"
                )
            for words in notes:
                note(console, f"{path}: {words}")
            if figure is not None and not drawn and shown is not None:
                _draw(data, how, *shown, figure)
                drawn = True
        if failures and not n_cycles:
            raise ConfigError("no file could be processed, and nothing was written; see above")
    if known is None:
        note(
            console,
            "without a calibration distances are from the maximum of the send pulse and may be "
            "some centimetres off; acoustube calibrate makes one",
        )
    if figure is not None and not drawn:
        note(console, "no echo, and no picture")
    console.print(
        f"{n_cycles} cycles, echoes in {n_found}"
        + (f"; {failures} files could not be processed" if failures else ""),
        soft_wrap=True,
    )
    return failures == 0


def _draw(data: xr.Dataset, how: Processing, first: int, ranging: Ranging, figure: Path) -> None:
    """Draw the first cycle with an echo of a piece that begins at `first`, and the whole piece."""
    from matplotlib.figure import Figure

    from acoustube.reports.figures import cycles as cycle_figures
    from acoustube.reports.figures import run as run_figure

    index = first + int(np.argmax(ranging.detected))
    time, cycle = data["time"].values, data["signal"].values[index]
    warmth = float(data["temperature"].values[index])
    one = signals.locate(
        time,
        cycle,
        signals.without_aliased_template(how, float(data.attrs["sampling_rate"])),
        temperature=warmth,
    )
    sheet = Figure(figsize=(9, 8), layout="constrained")
    above, below = sheet.subplots(2, 1)
    cycle_figures.draw_cycle(above, time, cycle, one, warmth)
    sent = float(np.nanmedian(ranging.send_time))
    cycle_figures.draw_waterfall(below, time, ranging.envelope, sent, warmth)
    run_figure.save(sheet, figure)
