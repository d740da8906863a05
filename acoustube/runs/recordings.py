"""Processing of recordings in pieces, and tables of their echoes."""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, TextIO

import numpy as np
import xarray as xr
from platformdirs import user_data_path

from acoustube import recordings, signals
from acoustube.base.errors import ConfigError, about
from acoustube.base.report import Reporter
from acoustube.base.units import CM, MS
from acoustube.base.writing import write_all
from acoustube.runs.twin_calibration import is_twin, twin_calibration
from acoustube.signals import Calibration, Processing, Ranging

CHUNK = 250
"""Number of cycles that are processed together; each step of the processing takes 8 MB."""
THREADS = 2
COLUMNS = (
    "cycle", "time_of_flight_ms", "distance_cm", "amplitude", "prominence", "n_peaks", "detected",
    "file",
)  # fmt: skip
LABEL_COLUMNS = {
    "true_distance": ("true_distance_cm", 100.0), "depth": ("depth_mm", 1e3),
    "force": ("force_n", 1.0),
}  # fmt: skip
"""Columns of the labels that a recording may have, with the factors from SI to their units."""


def located(data: xr.Dataset, how: Processing) -> Iterator[tuple[int, Ranging]]:
    """Process the cycles of a recording in pieces, on two threads.

    Parameters
    ----------
    data : xarray.Dataset
        From :func:`acoustube.recordings.read`.
    how : Processing
        Settings; where the carrier is aliased, the matched filter is omitted by
        :func:`acoustube.signals.without_aliased_template`.

    Yields
    ------
    first : int
        Number of the first cycle of a piece.
    ranging : Ranging
        Result for the cycles of the piece.
    """
    cycles, time = data["signal"], data["time"].values
    how = signals.without_aliased_template(how, signals.sampling_rate(time))
    temperature = data["temperature"].values
    starts = range(0, cycles.sizes["cycle"], CHUNK)

    def piece(start: int) -> Ranging:
        part = slice(start, start + CHUNK)
        return signals.locate(time, cycles.values[part], how, temperature=temperature[part])

    with ThreadPoolExecutor(THREADS) as pool:
        waiting: list[tuple[int, Future[Ranging]]] = []
        for start in starts:
            waiting.append((start, pool.submit(piece, start)))
            if len(waiting) > THREADS:  # this limits the number of pieces in memory
                first, job = waiting.pop(0)
                yield first, job.result()
        yield from ((first, job.result()) for first, job in waiting)


def chosen(
    calibration: str | None, prominence: float | None, usual: Processing | None = None
) -> tuple[Calibration | None, Processing]:
    """Return the requested calibration, None without one, and the settings of the processing.

    Parameters
    ----------
    calibration : str or None
        File or name of a calibration, or file of a twin, from which a calibration is computed.
    prominence : float or None
        Least prominence of an echo relative to the send pulse, in place of the calibration's.
    usual : Processing, optional
        Settings to use without a calibration; those of the sleeve paper by default.

    Raises
    ------
    ConfigError
        If the calibration does not exist or cannot be read.
    """
    known = None
    if calibration is not None:
        path = calibration_path(calibration)
        known = twin_calibration(path) if is_twin(path) else signals.load(path)
    how = (usual or Processing()) if known is None else known.processing
    return known, how if prominence is None else replace(how, prominence=prominence)


@contextlib.contextmanager
def opened(out: Path | None, others: Mapping[Path, bytes | str]) -> Iterator[TextIO]:
    """Yield the text stream of a table: standard output, or a buffer for a new file.

    Files are written at the end, all or none; nothing is written after an exception.

    Parameters
    ----------
    out : Path or None
        File of the table; None for standard output.
    others : mapping of Path to bytes or str
        Contents of further files, which may be added until the end.
    """
    table = io.StringIO()
    yield sys.stdout if out is None else table
    write_all(others if out is None else {out: table.getvalue(), **others})


class Processed(NamedTuple):
    """Table of the cycles of a recording.

    Attributes
    ----------
    rows : list of list
        Rows of :data:`COLUMNS` and of the labels :data:`LABEL_COLUMNS`.
    n_detected : int
        Number of cycles with an echo.
    loudest : float
        Highest amplitude of an echo, relative to the send pulse; 0 without an echo.
    first : tuple of int and Ranging, or None
        Number of the first cycle of the first piece that has an echo, and the result for this
        piece; None without an echo.
    """

    rows: list[list[object]]
    n_detected: int
    loudest: float
    first: tuple[int, Ranging] | None


def aligned(
    data: xr.Dataset, pulse_at: str | float | None, how: Processing
) -> tuple[xr.Dataset, float | None]:
    """Return a recording with time zero at the start of the send pulse, and the shift applied.

    Parameters
    ----------
    data : xarray.Dataset
        From :func:`acoustube.recordings.read`.
    pulse_at : float, "auto" or None
        Time in ms from the first sample to the start of the send pulse; "auto" estimates it, one
        for all cycles; None leaves the time as it is.
    how : Processing

    Returns
    -------
    data : xarray.Dataset
    lead : float or None
        Time in s from the first sample to the start of the send pulse; None if `pulse_at` is.

    Raises
    ------
    ValueError
        If the pulse cannot be found.
    ConfigError
        If the pulse starts after the last sample.
    """
    if pulse_at is None:
        return data, None
    time = data["time"].values - data["time"].values[0]
    lead = (
        signals.find_lead(time, data["signal"].values, how)
        if isinstance(pulse_at, str)
        else pulse_at / MS
    )
    if not lead < time[-1]:
        raise ConfigError(
            "is after the last sample", setting="pulse-at", value=pulse_at,
            advice=f"use less than {MS * time[-1]:.6g} ms",
        )  # fmt: skip
    return data.assign_coords(time=data["time"].copy(data=time - lead)), lead


def read_cycles(paths: Sequence[Path], **options: Any) -> Iterator[tuple[Path, xr.Dataset]]:
    """Yield each file in files and folders, with its recording.

    Parameters
    ----------
    paths : sequence of Path
        Files and folders.
    **options
        Arguments of :func:`acoustube.recordings.read`.

    Raises
    ------
    ConfigError
        If a file cannot be read.
    """
    for path, data in recordings.read_all(paths, **options):
        if isinstance(data, ConfigError):
            raise data
        yield path, data


def read_recordings(
    paths: Sequence[Path],
    options: Mapping[str, Any],
    pulse_at: str | float | None,
    how: Processing | None = None,
) -> list[tuple[Path, xr.Dataset]]:
    """Return files with their recordings, whose time is zero at the start of the send pulse.

    Parameters
    ----------
    paths, options
        As of :func:`read_cycles`.
    pulse_at, how
        As of :func:`aligned`; the processing of the sleeve paper by default.

    Raises
    ------
    ConfigError
        If a file cannot be read, or its send pulse cannot be found.
    """
    found = []
    for path, data in read_cycles(paths, **options):
        try:
            found.append((path, aligned(data, pulse_at, how or Processing())[0]))
        except ValueError as error:
            raise ConfigError(about(path, error)) from error
    return found


def process_recording(
    path: Path,
    data: xr.Dataset,
    known: Calibration | None,
    settings: Processing,
    report: Reporter,
    check: Callable[[], None],
) -> Processed:
    """Estimate the distances in all cycles of a recording.

    Parameters
    ----------
    path : Path
        File of the recording, for the table and messages.
    data : xarray.Dataset
        From :func:`acoustube.recordings.read`.
    known : Calibration or None
        Calibration that gave `settings`; it must have the sampling rate of the recording.
    settings : Processing
    report : Reporter
        Receives the progress of long recordings.
    check : callable
        Called after each piece, to raise a keyboard interrupt that a library suppressed.

    Raises
    ------
    ConfigError
        If the calibration is of another sampling rate.
    ValueError
        If the cycles cannot be processed.
    """
    check_rate(float(data.attrs["sampling_rate"]), known, path)
    table: list[list[object]] = []
    n_detected, loudest, shown = 0, 0.0, None
    total = data.sizes["cycle"]
    with report.progress(check) as show:
        for first, ranging in located(data, settings):
            check()
            these = data.isel(cycle=slice(first, first + len(ranging.detected)))
            rows = zip(table_rows(first, ranging, path), true_rows(these), strict=True)
            table += ([*row, *labels] for row, labels in rows)
            if ranging.detected.any():
                n_detected += int(ranging.detected.sum())
                loudest = max(loudest, float(np.nanmax(ranging.amplitude)))
                shown = shown or (first, ranging)
            if total > 4 * CHUNK:
                show(path.name, len(table) / total)
    return Processed(table, n_detected, loudest, shown)


def check_rate(rate: float, known: Calibration | None, source: Path) -> None:
    """Raise ConfigError if a calibration is of another sampling rate in Hz, on which it depends."""
    if known is not None and abs(rate / known.sampling_rate - 1) > 1e-3:
        raise ConfigError(
            f"{source} has {rate:g} samples per second and the calibration "
            f"{known.sampling_rate:g}; calibrate with cycles like these"
        )


def table_rows(first: int, ranging: Ranging, source: Path) -> Iterator[list[object]]:
    """Yield a row of :data:`COLUMNS` for each cycle; `first` is the number of the first cycle.

    `ranging` is the result of several cycles or of a single one.
    """
    flight = MS * (ranging.return_time - ranging.send_time)
    columns = (flight, CM * ranging.distance, ranging.amplitude, ranging.prominence)
    numbers = np.atleast_2d(np.stack(columns, axis=-1))
    peaks = np.atleast_1d(np.sum(np.isfinite(ranging.echoes.times), axis=-1))
    for i, seen in enumerate(np.atleast_1d(ranging.detected)):
        texts = [f"{value:.6g}" if seen else "" for value in numbers[i]]
        yield [first + i, *texts, int(peaks[i]), int(seen), str(source)]


def true_rows(data: xr.Dataset) -> Iterator[list[object]]:
    """Yield the labels of :data:`LABEL_COLUMNS` of each cycle; a missing label is empty."""
    columns = [
        scale * data[name].values if name in data else np.full(data.sizes["cycle"], np.nan)
        for name, (_, scale) in LABEL_COLUMNS.items()
    ]
    for values in np.stack(columns, axis=-1):
        yield ["" if np.isnan(value) else f"{value:.6g}" for value in values]


def calibration_path(name: str) -> Path:
    """Return the file of a calibration that is given by its file or its name.

    Raises
    ------
    ConfigError
        If there is neither such a file nor such a name.
    """
    path = Path(name)
    if path.exists() and not path.is_dir():
        return path
    home = calibration_folder() / f"{name}.toml"
    if home.is_file():
        return home
    known = sorted(p.stem for p in calibration_folder().glob("*.toml"))
    advice = f"known are {', '.join(known)}" if known else "acoustube calibrate makes one"
    raise ConfigError(f"{name} is neither a file nor the name of a calibration; {advice}")


def calibration_folder() -> Path:
    """Return the folder of the calibrations that are known by name."""
    return user_data_path("acoustube") / "calibrations"
