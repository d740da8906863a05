"""The command ``acoustube calibrate``: a calibration from recordings with known closures."""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from acoustube.base.errors import ConfigError
from acoustube.base.report import Reporter
from acoustube.base.rules import Number
from acoustube.base.units import MM
from acoustube.base.writing import write_all
from acoustube.cli._options import Lead, Output, Recording, check_files

if TYPE_CHECKING:
    import xarray as xr

    from acoustube.signals import Calibration, Processing

MANY_ALARMS = 0.05
"""Fraction of untouched cycles with an echo above which a higher prominence is advised."""


def calibrate(
    *blocked: Path,
    untouched: Annotated[list[Path], Parameter(consume_multiple=True)],
    out: Path | None = None,
    name: str | None = None,
    sigmas: float = 2.8,
    recording: Recording = Recording(),
    lead: Lead = Lead(),
    sensor: Path | None = None,
    figure: Path | None = None,
    output: Output = Output(),
) -> None:
    """Calibrate a sensor from cycles with the tube closed at known positions, and without contact.

    Parameters
    ----------
    blocked : Path
        Recordings with the label ``true_distance`` (or ``distance_cm``, ``distance_m``).
    untouched : list
        Recordings without contact.
    out : Path
        File to write, which must be new.
    name : str
        Name of the calibration, in place of a file: ``process --calibration NAME`` finds it.
    sigmas : float
        Least prominence of a detected echo, in standard deviations of the processed signal of the
        untouched cycles.
    sensor : Path
        TOML file of the rangefinder, which states its carrier and, for a chirp, the pulse to
        compress.
    figure : Path
        Picture to write (PNG, PDF or SVG) of the fits to amplitudes and distances; must be new.
    """
    if not blocked:
        raise ConfigError("calibrate needs recordings with the tube closed; name one or more")
    if name is not None and not re.fullmatch(r"[\w-]{1,64}", name):
        raise ConfigError(
            "must be of letters, digits, - and _", setting="name", value=name,
            advice="use --out for a path",
        )  # fmt: skip
    Number(0.1, 100, "", "standard deviations").check("sigmas", sigmas)
    check_files(out=out, figure=figure)
    path = _free_path(out, name)

    from acoustube import signals
    from acoustube.runs.twin_calibration import processing_of
    from acoustube.signals.calibration_file import in_toml

    report, how = output.reporter(), processing_of(sensor)
    named = f"{blocked[0]} (closed) and {untouched[0]} (untouched)"
    shut, quiet = (_recordings(paths, recording, lead, how) for paths in (blocked, untouched))
    _check_alike(shut[0], quiet[0], named)
    closed, free = _together(shut, quiet, named)
    if "true_distance" not in closed:
        raise ConfigError(
            f"the closed cycles of {blocked[0]} have no label true_distance; give it in the file "
            "or in a sidecar"
        )
    try:
        found = signals.calibrate(
            closed["time"].values, closed["signal"].values, closed["true_distance"].values,
            free["signal"].values, how, temperature=closed["temperature"].values,
            untouched_temperature=free["temperature"].values, sigmas=sigmas,
        )  # fmt: skip
    except ValueError as error:
        raise ConfigError(f"{named}: {error}") from error
    path.parent.mkdir(parents=True, exist_ok=True)
    contents: dict[Path, bytes | str] = {path: in_toml(found)}
    if figure is not None:
        from acoustube.reports.figures import cycles as cycle_figures
        from acoustube.reports.figures.run import picture

        contents[figure] = picture(cycle_figures.calibration_figure(found), figure)
    write_all(contents)
    _print_calibration(found, closed["true_distance"].values, report)
    report.line(f"Written to {path}.")


def _free_path(out: Path | None, name: str | None) -> Path:
    """Return the path of a calibration to write, from its path or name; raise if it exists."""
    from acoustube.runs.recordings import calibration_folder

    if out is not None and name is None:
        path = out
    elif name is not None and out is None:
        path = calibration_folder() / f"{name}.toml"
    else:
        raise ConfigError("give the calibration either a file with --out or a name with --name")
    if os.path.lexists(path):
        raise ConfigError(f"{path} exists and nothing is overwritten; name a new file")
    return path


def _check_alike(closed: xr.Dataset, free: xr.Dataset, named: str) -> None:
    """Raise unless closures and untouched cycles have the same sampling rate and length."""
    for what, one, other in (
        ("sampling rate", closed.attrs["sampling_rate"], free.attrs["sampling_rate"]),
        ("number of samples", closed.sizes["time"], free.sizes["time"]),
    ):
        if one != other:
            raise ConfigError(
                f"{named}: closed and untouched cycles must have the same {what}, not {one:g} and "
                f"{other:g}"
            )


def _recordings(
    paths: Sequence[Path], options: Recording, lead: Lead, how: Processing
) -> list[xr.Dataset]:
    """Return recordings with time zero at the send pulse, of one sampling rate and length."""
    from acoustube.runs.recordings import read_recordings

    found = read_recordings(paths, dataclasses.asdict(options), lead.pulse_at, how)
    parts = [data for _, data in found]
    rates = {float(part.attrs["sampling_rate"]) for part in parts}
    lengths = {part.sizes["time"] for part in parts}
    if len(rates) > 1 or len(lengths) > 1:
        raise ConfigError(
            f"{', '.join(map(str, paths))}: the recordings differ in sampling rate or length; "
            "calibrate with recordings of one rate and length"
        )
    return parts


def _together(
    closed: list[xr.Dataset], free: list[xr.Dataset], named: str
) -> tuple[xr.Dataset, xr.Dataset]:
    """Return the closed and the untouched cycles, each as one dataset, on one axis of time.

    The axis is that of the recording that begins last, up to the earliest end. Of the other
    recordings, the samples nearest to these times are taken.
    """
    import xarray as xr

    parts = [*closed, *free]
    starts = [float(part["time"][0]) for part in parts]
    rate = float(parts[0].attrs["sampling_rate"])
    skipped = [round((max(starts) - start) * rate) for start in starts]
    length = parts[0].sizes["time"] - max(skipped)
    if length < 2:
        raise ConfigError(
            f"{named}: the recordings begin at {min(starts):.3g} to {max(starts):.3g} s and have "
            "no time in common; calibrate with recordings of the same part of a cycle"
        )
    last = parts[skipped.index(0)]["time"].values[:length]
    parts = [
        part.isel(time=slice(first, first + length)).assign_coords(time=last)
        for part, first in zip(parts, skipped, strict=True)
    ]
    groups = parts[: len(closed)], parts[len(closed) :]
    one, other = (
        xr.concat(group, "cycle", data_vars="all", join="override") if group[1:] else group[0]
        for group in groups
    )
    return one, other


def _print_calibration(found: Calibration, given: Any, report: Reporter) -> None:
    import numpy as np

    gain = found.processing.gain
    assert gain is not None
    lost = np.unique(np.round(given[~np.isin(given, found.true_distance)], 3))
    left_out = f" (none at {', '.join(f'{z:g}' for z in lost)} m)" if lost.size else ""
    near, far = gain.c4 - gain.c1, gain.c4 + gain.c1
    report.line(
        f"{found.true_distance.size} of {given.size} closures used{left_out}: slope "
        f"{found.slope.value:.4f} +- {found.slope.deviation:.4f} m/m, RMSE "
        f"{MM * found.distance_rmse:.3g} mm; amplitude: RMSE of the arctan fit "
        f"{found.amplitude_rmse:.3g}, tanh from {near:.3g} to {far:.3g}"
    )
    report.line(
        f"least prominence {found.processing.prominence:.3g} of the send pulse; "
        f"{100 * found.false_alarms:.3g} % of the untouched cycles show an echo with it"
        + ("; raise --sigmas for fewer" if found.false_alarms > MANY_ALARMS else "")
    )
