"""The command ``acoustube process``: distances of presses in recordings, as a table."""

from __future__ import annotations

import csv
import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

from acoustube.base.console import failure
from acoustube.base.errors import ConfigError, about
from acoustube.base.interrupts import watched_interrupts
from acoustube.base.report import Reporter, counted
from acoustube.base.units import MS
from acoustube.cli._options import Lead, Output, Ranging, Recording, check_files

if TYPE_CHECKING:
    import xarray as xr

    from acoustube import signals
    from acoustube.runs.recordings import Processed
    from acoustube.signals import Processing

UNCALIBRATED = (
    "without a calibration, distances are measured from the maximum of the send pulse and may be "
    "wrong by some centimetres; acoustube calibrate makes a calibration"
)
LOUD = 1.5
"""Echo amplitude relative to the send pulse above which a note says that the recorder may have
started before the pulse was sent."""


def process(
    *files: Path,
    ranging: Ranging = Ranging(),
    recording: Recording = Recording(),
    lead: Lead = Lead(),
    sensor: Path | None = None,
    out: Path | None = None,
    figure: Path | None = None,
    output: Output = Output(),
) -> int:
    """Estimate the distance of a press in each cycle of recordings.

    Parameters
    ----------
    files : Path
        NPZ, NPY, CSV, TSV, WAV, FLAC, MAT, HDF5 or netCDF files, or folders of these.
    sensor : Path
        TOML file of a rangefinder or a twin, whose thermometer error is subtracted. A rangefinder
        also states its carrier and, for a chirp, the pulse to compress; a twin gives gain, send
        time and prominence, unless --calibration is given.
    out : Path
        Table to write (CSV), which must be new; standard output if not given.
    figure : Path
        Picture to write (PNG, PDF or SVG): the first cycle with an echo, and cycles around it.
    """
    if not files:
        raise ConfigError("process needs a file or a folder; name one or more")
    check_files(out=out, figure=figure)
    from acoustube import recordings
    from acoustube.runs.recordings import (
        COLUMNS,
        LABEL_COLUMNS,
        aligned,
        chosen,
        opened,
        process_recording,
    )
    from acoustube.runs.twin_calibration import corrections, processing_of

    calibration, bias = corrections(sensor, ranging.calibration)
    known, settings = chosen(calibration, ranging.prominence, processing_of(sensor))
    report = output.reporter(stderr=out is None)
    failures, n_cycles, n_found = 0, 0, 0
    pictures: dict[Path, bytes | str] = {}
    with watched_interrupts() as check, opened(out, pictures) as file:
        writer = csv.writer(file, lineterminator="\n")
        header = [[*COLUMNS, *(name for name, _ in LABEL_COLUMNS.values())]]
        for path, data in recordings.read_all(files, **dataclasses.asdict(recording)):
            try:
                if isinstance(data, ConfigError):
                    raise data
                data, begins = aligned(data, lead.pulse_at, settings)
                data = data.assign(temperature=data["temperature"] - bias)
                found = process_recording(path, data, known, settings, report, check)
            except (ConfigError, ValueError) as error:
                failures += 1
                failure(about(path, error), "not processed")
                continue
            writer.writerows([*header, *found.rows])  # all rows of a file, or none
            header = []
            n_cycles, n_found = n_cycles + len(found.rows), n_found + found.n_detected
            _note_recording(path, data, found, begins, report)
            if figure is not None and not pictures and found.first is not None:
                pictures[figure] = _drawn(data, settings, *found.first, figure)
        if failures and not n_cycles:
            raise ConfigError("no file could be processed, and nothing was written; see above")
    if known is None:
        report.note(UNCALIBRATED)
    if figure is not None and not pictures:
        report.note("no echo is detected, so no picture is drawn")
    failed = f"; {counted(failures, 'file')} could not be processed" if failures else ""
    report.line(f"{counted(n_cycles, 'cycle')}, echoes in {n_found}{failed}")
    return 1 if failures else 0


def _note_recording(
    path: Path, data: xr.Dataset, found: Processed, begins: float | None, report: Reporter
) -> None:
    """Report notes on a recording; `begins` is the start of its send pulse in s, if known."""
    notes = str(data.attrs.get("warnings", "")).splitlines()
    if begins is not None:
        notes.append(f"the send pulse starts {MS * begins:.3f} ms after the first sample")
    if found.loudest > LOUD:
        notes.append(
            f"an echo is {found.loudest:.3g} times as high as the send pulse; if the recorder "
            "starts before that pulse, give --pulse-at MS, or --pulse-at auto"
        )
    for words in notes:
        report.note(f"{path}: {words}")


def _drawn(
    data: xr.Dataset, settings: Processing, first: int, ranging: signals.Ranging, figure: Path
) -> bytes:
    """Return a picture of the first cycle with an echo, and of the piece of a recording around it.

    `ranging` is the result of that piece, whose first cycle has the index `first`.
    """
    import numpy as np
    from matplotlib.figure import Figure

    from acoustube import signals
    from acoustube.reports.figures import cycles as cycle_figures
    from acoustube.reports.figures.run import picture

    index = first + int(np.argmax(ranging.detected))
    time, cycle = data["time"].values, data["signal"].values[index]
    temperature = float(data["temperature"].values[index])
    one = signals.locate(
        time,
        cycle,
        signals.without_aliased_template(settings, float(data.attrs["sampling_rate"])),
        temperature=temperature,
    )
    sheet = Figure(figsize=(9, 8), layout="constrained")
    above, below = sheet.subplots(2, 1)
    cycle_figures.draw_cycle(above, time, cycle, one, temperature)
    sent = float(np.nanmedian(ranging.send_time))
    cycle_figures.draw_waterfall(below, time, ranging.envelope, sent, temperature)
    return picture(sheet, figure)
