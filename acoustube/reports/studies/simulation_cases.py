"""Cases of the study of the sleeve paper's simulations: selection, and energy by time and mode."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from acoustube import signals
from acoustube.base.types import Array
from acoustube.base.units import MM
from acoustube.reports.studies.presses import matrices
from acoustube.runs.config import Config
from acoustube.runs.config.si import settings_in_si
from acoustube.runs.sweep import select
from acoustube.waves.modes import cut_on_frequency
from acoustube.waves.scattering import ModalScattering

RODS = {"10": (3.03, 1.22), "25": (2.95, 1.92), "35": (2.51, 1.64)}
"""Published mean and standard deviation of absolute errors in cm, by the rod's diameter in mm."""
TRAPPED_AFTER_S = 0.4e-3
"""Time in s after the middle of the direct echo from which sound counts as trapped: the pulse lasts
0.26 ms, and its reflection by the source end arrives 0.12 ms later."""
DEFAULT = settings_in_si(Config())
"""Settings of the sweeps, except those that vary."""
CARRIER, PROBE = DEFAULT.pulse.frequency, DEFAULT.probe
"""Carrier in Hz, and position of the probe in m."""
SOUND_SPEED = DEFAULT.air.sound_speed
"""Sound speed in m/s."""
CUT_ON = cut_on_frequency(1, 1, DEFAULT.radius, SOUND_SPEED)
"""Cut-on frequency of the first higher mode in Hz."""


def chosen(cases: xr.Dataset, end: str) -> xr.Dataset:
    """Return cases with amplitude, distance and distance error for one kind of source end."""
    return select.chosen(cases.assign(chosen_source_end=("press", [end] * cases.press.size)))


def of_rod(cases: xr.Dataset, rod: str) -> xr.Dataset:
    """Return the cases of a rod, given its diameter in mm as text, in order of depth."""
    return only(cases, "diameter", float(rod) / MM).sortby("depth")


def only(cases: xr.Dataset, label: str, value: float) -> xr.Dataset:
    """Return the cases whose label has a given value, in SI units."""
    return cases.isel(press=np.flatnonzero(np.isclose(cases[label].values, value)))


def late_fraction(cases: xr.Dataset) -> Array:
    """Return the fraction of each case's echo energy later than :data:`TRAPPED_AFTER_S`, (press,).

    The source end absorbs. Times are from the middle of the direct echo.
    """
    signal = np.nan_to_num(cases["pressure"].sel(source_end="absorbing").values.astype(float)) ** 2
    time = cases["time"].values
    path = 2 * cases["true_distance"].values - PROBE
    middle = DEFAULT.pulse.duration / 2 + path / signals.speed_of_sound(cases["temperature"].values)
    after = time[None] - middle[:, None]
    echo = after > -DEFAULT.pulse.duration / 2
    return np.asarray(
        (signal * (after > TRAPPED_AFTER_S)).sum(axis=1)
        / np.maximum((signal * echo).sum(axis=1), 1e-30)
    )


def carried_power(folder: Path) -> dict[tuple[str, float], dict[str, Array]]:
    """Return reflected and transmitted power by mode, averaged over the pulse's spectrum.

    Returns
    -------
    dict
        Keys are the diameter in mm, as text, and the depth in m. Each value gives for each mode, by
        name, the reflected and the transmitted fraction of an incident plane wave's power, (2,).
    """
    found = {}
    for cases, matrix in matrices(folder):
        rod = f"{MM * float(cases['diameter'].values[0]):g}"
        found[rod, float(cases["depth"].values[0])] = _fractions(matrix)
    return found


def _fractions(matrix: ModalScattering) -> dict[str, Array]:
    """Return the reflected and the transmitted fraction of a plane wave's power by mode, (2,)."""
    weight = np.abs(_spectrum(matrix.frequency)) ** 2
    plane = matrix.modes.index("00")
    power = np.abs(matrix.s[:, :, :, 0, plane]) ** 2
    mean = np.einsum("f,fpm->pm", weight / weight.sum(), power)
    return {mode: mean[:, i] for i, mode in enumerate(matrix.modes)}


def _spectrum(frequency: NDArray[Any]) -> Any:
    """Return the pulse's spectrum, up to a factor, at frequencies in Hz."""
    pulse = DEFAULT.pulse
    time = np.arange(0.0, pulse.duration, 1e-6)
    return np.exp(-2j * np.pi * np.outer(frequency, time)) @ np.asarray(pulse(time))
