"""The commands ``acoustube process`` and ``acoustube calibrate``: recordings in, tables out."""

from __future__ import annotations

import contextlib
import csv
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, TextIO

import numpy as np
import xarray as xr
from platformdirs import user_data_path
from rich.console import Console
from rich.markup import escape

from acoustube import recordings, signals
from acoustube.errors import ConfigError
from acoustube.io import partial_file
from acoustube.progress import heard_interrupts, note, stage_progress
from acoustube.signals import Calibration, Processing, Ranging

CHUNK = 250
"""Cycles that are processed together: 8 MB of double precision per step."""
THREADS = 2
LOUD = 1.5
"""Height of an echo over the send pulse above which the record is suspected to begin elsewhere."""
MANY_ALARMS = 0.05
"""Share of untouched cycles with an echo above which a higher prominence is advised."""
COLUMNS = (
    "cycle", "time_of_flight_ms", "distance_cm", "amplitude", "prominence", "n_peaks", "detected",
    "file",
)  # fmt: skip
TRUE = {
    "true_distance": ("true_distance_cm", 100.0), "depth": ("depth_mm", 1e3),
    "force": ("force_n", 1.0),
}  # fmt: skip
"""Columns of the labels that a recording may have, and how many of their unit make one of SI."""


def located(
    data: xr.Dataset, how: Processing, done: Callable[[int], None] | None = None
) -> Iterator[tuple[int, Ranging]]:
    """Process the cycles of a recording in pieces, on two threads.

    Parameters
    ----------
    data : xarray.Dataset
        From :func:`acoustube.recordings.read`.
    how : Processing
        :func:`acoustube.signals.suited` to the recording's sampling rate.
    done : callable, optional
        Called with the number of cycles of each finished piece.

    Yields
    ------
    first : int
        Number of the piece's first cycle.
    ranging : Ranging
        Of the piece.
    """
    cycles, time = data["signal"], data["time"].values
    how = signals.suited(how, signals.sampling_rate(time))
    warmth = data["temperature"].values
    starts = range(0, cycles.sizes["cycle"], CHUNK)

    def piece(start: int) -> Ranging:
        part = slice(start, start + CHUNK)
        return signals.locate(time, cycles.values[part], how, temperature=warmth[part])

    with ThreadPoolExecutor(THREADS) as pool:
        waiting: list[tuple[int, Future[Ranging]]] = []
        for start in starts:
            waiting.append((start, pool.submit(piece, start)))
            # So many pieces are in memory at once.
            if len(waiting) > THREADS:
                yield _finished(waiting.pop(0), done)
        while waiting:
            yield _finished(waiting.pop(0), done)


def _finished(
    job: tuple[int, Future[Ranging]], done: Callable[[int], None] | None
) -> tuple[int, Ranging]:
    start, future = job
    ranging = future.result()
    if done is not None:
        done(len(ranging.detected))
    return start, ranging


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
    errors = Console(stderr=True)
    failures, n_cycles, n_found, drawn = 0, 0, 0, False
    with heard_interrupts() as check, _opened(out) as file:
        writer = csv.writer(file, lineterminator="\n")
        header = [[*COLUMNS, *(name for name, _ in TRUE.values())]]
        for path, data in recordings.read_all(
            paths, rate=rate, temperature=temperature, channel=channel, samples=samples
        ):
            found, loudest, shown = 0, 0.0, None
            table: list[list[object]] = []  # written as a whole, or not at all
            try:
                if isinstance(data, ConfigError):
                    raise data
                check_rate(float(data.attrs["sampling_rate"]), known, path)
                for first, ranging in _with_progress(data, how, console, check, path):
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


def chosen(
    calibration: str | None, prominence: float | None
) -> tuple[Calibration | None, Processing]:
    """Return the calibration that was asked for, if any, and the processing with it.

    Parameters
    ----------
    calibration : str or None
        A file, or the name of a calibration.
    prominence : float or None
        In place of the calibration's.

    Raises
    ------
    ConfigError
        If there is no such calibration.
    """
    known = None if calibration is None else signals.load(calibration_path(calibration))
    how = Processing() if known is None else known.processing
    return known, how if prominence is None else replace(how, prominence=prominence)


@contextlib.contextmanager
def _opened(out: Path | None) -> Iterator[TextIO]:
    """Yield standard output, or a new file that appears when it is complete."""
    if out is None:
        yield sys.stdout
        return
    with partial_file(out) as partial, partial.open("w", encoding="utf-8", newline="") as file:
        yield file


def _with_progress(
    data: xr.Dataset, how: Processing, console: Console, check: Callable[[], None], path: Path
) -> Iterator[tuple[int, Ranging]]:
    total, finished = data.sizes["cycle"], 0
    with stage_progress(console, check) as show:
        for first, ranging in located(data, how):
            check()
            finished += len(ranging.detected)
            if total > 4 * CHUNK:
                show(path.name, finished / total)
            yield first, ranging


def check_rate(rate: float, known: Calibration | None, source: Path) -> None:
    """Refuse a calibration of another sampling rate: its gain and template are of its own."""
    if known is not None and abs(rate / known.sampling_rate - 1) > 1e-3:
        raise ConfigError(
            f"{source} has {rate:g} samples per second and the calibration "
            f"{known.sampling_rate:g}; calibrate with cycles like these"
        )


def table_rows(first: int, ranging: Ranging, source: Path) -> Iterator[list[object]]:
    """Return a row of :data:`COLUMNS` for each cycle, the first of which has a number.

    The ranging is one of several cycles or of a single one.
    """
    flight = 1e3 * (ranging.return_time - ranging.send_time)
    columns = (flight, 100 * ranging.distance, ranging.amplitude, ranging.prominence)
    numbers = np.atleast_2d(np.stack(columns, axis=-1))
    peaks = np.atleast_1d(np.sum(np.isfinite(ranging.echoes.times), axis=-1))
    for i, seen in enumerate(np.atleast_1d(ranging.detected)):
        texts = [f"{value:.6g}" if seen else "" for value in numbers[i]]
        yield [first + i, *texts, int(peaks[i]), int(seen), str(source)]


def true_rows(data: xr.Dataset) -> Iterator[list[object]]:
    """Return the labels of :data:`TRUE` of each cycle, empty where there is none."""
    columns = [
        scale * data[name].values if name in data else np.full(data.sizes["cycle"], np.nan)
        for name, (_, scale) in TRUE.items()
    ]
    for values in np.stack(columns, axis=-1):
        yield ["" if np.isnan(value) else f"{value:.6g}" for value in values]


def _draw(data: xr.Dataset, how: Processing, first: int, ranging: Ranging, figure: Path) -> None:
    """Draw the first cycle with an echo of a piece that begins at `first`, and the whole piece."""
    from matplotlib.figure import Figure

    from acoustube import plot, plot_cycles

    index = first + int(np.argmax(ranging.detected))
    time, cycle = data["time"].values, data["signal"].values[index]
    warmth = float(data["temperature"].values[index])
    one = signals.locate(
        time, cycle, signals.suited(how, float(data.attrs["sampling_rate"])), temperature=warmth
    )
    sheet = Figure(figsize=(9, 8), layout="constrained")
    above, below = sheet.subplots(2, 1)
    plot_cycles.draw_cycle(above, time, cycle, one, warmth)
    sent = float(np.nanmedian(ranging.send_time))
    plot_cycles.draw_waterfall(below, time, ranging.envelope, sent, warmth)
    plot.save(sheet, figure)


def calibration_path(name: str) -> Path:
    """Return the file of a calibration that is given by its file or its name.

    Raises
    ------
    ConfigError
        If there is none.
    """
    path = Path(name)
    if path.exists():
        return path
    home = calibration_folder() / f"{name}.toml"
    if home.exists():
        return home
    known = sorted(p.stem for p in calibration_folder().glob("*.toml"))
    advice = f"known are {', '.join(known)}" if known else "acoustube calibrate makes one"
    raise ConfigError(f"{name} is neither a file nor the name of a calibration; {advice}")


def calibration_folder() -> Path:
    """Return where named calibrations are kept."""
    return user_data_path("acoustube") / "calibrations"


def run_calibrate(
    blocked: Sequence[Path],
    untouched: Sequence[Path],
    console: Console,
    *,
    out: Path | None = None,
    name: str | None = None,
    sigmas: float = 2.8,
    rate: float | None = None,
    temperature: float | None = None,
    channel: int | None = None,
    samples: int | None = None,
    figure: Path | None = None,
) -> Path:
    """Calibrate a sensor from recordings, and write the calibration.

    Parameters
    ----------
    blocked : sequence of Path
        Recordings with the tube closed at the places of their label ``true_distance``.
    untouched : sequence of Path
        Recordings without contact.
    console : rich.console.Console
    out : Path, optional
        The file to write; in place of it `name`, by which ``process`` finds it.
    name : str, optional
    sigmas : float
        Least prominence in standard deviations of the untouched cycles.
    rate, temperature, channel, samples
        See :func:`acoustube.recordings.read`.
    figure : Path, optional
        A picture of the fits.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ConfigError
        If a recording cannot be read, or nothing can be calibrated with them.
    """
    if (out is None) == (name is None):
        raise ConfigError("give the calibration either a file with --out or a name with --name")
    path = out if out is not None else calibration_folder() / f"{name}.toml"
    if path.exists():
        raise ConfigError(f"{path} exists and nothing is overwritten; remove it or name another")
    options = {"rate": rate, "temperature": temperature, "channel": channel, "samples": samples}
    closed, free = (_together(paths, options) for paths in (blocked, untouched))
    if "true_distance" not in closed:
        raise ConfigError(
            f"the blocked cycles of {blocked[0]} have no label true_distance; give it in the file "
            "or in a sidecar"
        )
    for what, one, other in (
        ("sampling rate", closed.attrs["sampling_rate"], free.attrs["sampling_rate"]),
        ("number of samples", closed.sizes["time"], free.sizes["time"]),
    ):
        if one != other:
            raise ConfigError(
                f"blocked and untouched cycles must have the same {what}, not {one:g} and {other:g}"
            )
    try:
        found = signals.calibrate(
            closed["time"].values, closed["signal"].values, closed["true_distance"].values,
            free["signal"].values, temperature=closed["temperature"].values,
            untouched_temperature=free["temperature"].values, sigmas=sigmas,
        )  # fmt: skip
    except ValueError as error:
        raise ConfigError(str(error)) from error
    path.parent.mkdir(parents=True, exist_ok=True)
    signals.save(found, path)
    if figure is not None:
        from acoustube import plot, plot_cycles

        plot.save(plot_cycles.calibration_figure(found), figure)
    _print_calibration(found, closed["true_distance"].values, console)
    console.print(f"Written to [bold]{escape(str(path))}[/].", soft_wrap=True)
    return path


def _together(paths: Sequence[Path], options: Mapping[str, Any]) -> xr.Dataset:
    """Return the cycles of several recordings as one."""
    parts = []
    for _, data in recordings.read_all(paths, **options):
        if isinstance(data, ConfigError):
            raise data
        parts.append(data)
    rates = {float(part.attrs["sampling_rate"]) for part in parts}
    lengths = {part.sizes["time"] for part in parts}
    if len(rates) > 1 or len(lengths) > 1:
        raise ConfigError("the recordings differ in sampling rate or length; calibrate with alike")
    return xr.concat(parts, "cycle", data_vars="all", join="override") if parts[1:] else parts[0]


def _print_calibration(found: Calibration, given: Any, console: Console) -> None:
    gain = found.processing.gain
    assert gain is not None
    lost = np.unique(np.round(given[~np.isin(given, found.true_distance)], 3))
    left_out = f", none at {', '.join(f'{z:g}' for z in lost)} m" if lost.size else ""
    near, far = gain.c4 - gain.c1, gain.c4 + gain.c1
    console.print(
        f"{found.true_distance.size} of {given.size} blockages{left_out}: slope "
        f"{found.slope.value:.4f} +- {found.slope.deviation:.4f} m/m, RMSE "
        f"{1e3 * found.distance_rmse:.3g} mm; arctan RMSE {found.amplitude_rmse:.3g}, tanh from "
        f"{near:.3g} to {far:.3g}",
        soft_wrap=True,
    )
    console.print(
        f"least prominence {found.processing.prominence:.3g} of the send pulse; "
        f"{100 * found.false_alarms:.3g} % of the untouched cycles show an echo with it"
        + ("; raise --sigmas for fewer" if found.false_alarms > MANY_ALARMS else ""),
        soft_wrap=True,
    )
