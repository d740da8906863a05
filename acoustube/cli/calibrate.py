"""The command ``acoustube calibrate``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from rich.console import Console
from rich.markup import escape

from acoustube import recordings, signals
from acoustube.base.errors import ConfigError
from acoustube.runs.recordings import calibration_folder
from acoustube.signals import Calibration

MANY_ALARMS = 0.05
"""Share of untouched cycles with an echo above which a higher prominence is advised."""


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
        from acoustube.reports.figures import cycles as cycle_figures
        from acoustube.reports.figures import run as run_figure

        run_figure.save(cycle_figures.calibration_figure(found), figure)
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
