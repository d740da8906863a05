"""Validation of scatterers, probes and spectra that are combined into one tube."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acoustube.air import Air
from acoustube.base.errors import ConfigError
from acoustube.base.units import KHZ
from acoustube.waves.grid.polyhedron import Array
from acoustube.waves.modes import cut_on_frequency
from acoustube.waves.port_waves import Complex
from acoustube.waves.scattering import PlacedScatterer

OUT_OF_BAND_ENERGY = 1e-4
"""Largest fraction of a pulse's energy outside the band of the scattering matrices."""
COARSEST_STEP = 300.0
"""Largest frequency step in Hz of a scattering matrix that can be interpolated at a cut-on.

With 200 or 300 Hz the error of a pinched tube's echo at 42 kHz, next to the cut-on of (2,1), was
0.4 %; with 500 Hz it was 2 %, or 22 % where a mode was trapped.
"""
MOST_SAMPLES = 5e6
"""Largest number of samples of a computed recording; a longer transform takes gigabytes."""
CUT_ON_TOLERANCE = 0.04
"""Largest relative error of a cut-on that is attributed to the grid, not to another bore."""


def check_tube(presses: Sequence[PlacedScatterer], air: Air, radius: float) -> None:
    """Validate that presses were computed for the given air and bore."""
    if not 0 < radius < np.inf:
        raise ValueError(f"radius = {radius} m must be positive")
    for press in presses:
        scattering = press.scattering
        if abs(scattering.sound_speed / air.sound_speed - 1) > 1e-3:
            raise ValueError(
                f"the press at {press.position:.4g} m was computed for sound at "
                f"{scattering.sound_speed:.2f} m/s and the tube's air carries it at "
                f"{air.sound_speed:.2f} m/s; compute it at the same temperature"
            )
        if "11c" in scattering.modes:
            found = scattering.cut_ons[scattering.modes.index("11c")]
            wanted = cut_on_frequency(1, 1, radius, air.sound_speed)
            if abs(found / wanted - 1) > CUT_ON_TOLERANCE:
                raise ValueError(
                    f"radius = {radius:.4g} m is not that of the press at {press.position:.4g} m, "
                    f"whose mode (1,1) cuts on at {KHZ * found:.4g} kHz: its bore has a radius of "
                    f"{radius * wanted / found:.4g} m"
                )


def check_reflection(name: str, value: Any, n: int) -> None:
    """Validate that a reflection coefficient is one number, or one for each of n frequencies."""
    if np.shape(value) not in ((), (n,)):
        raise ValueError(
            f"{name} has shape {np.shape(value)}; give one number, or one for each of the {n} "
            "frequencies"
        )


def in_band(
    presses: Sequence[PlacedScatterer], frequency: Array, spectrum: Complex, *, what: str
) -> NDArray[np.bool_]:
    """Return a mask of the frequencies that lie in the bands of all scattering matrices.

    Parameters
    ----------
    presses : sequence of PlacedScatterer
    frequency : ndarray
        In Hz, (n,).
    spectrum : ndarray
        Spectrum of the incident signal, (n,).
    what : str
        Name of the signal in error messages.

    Returns
    -------
    ndarray of bool
        (n,).

    Raises
    ------
    ValueError
        If the signal is zero or not finite, or too much of its energy lies outside these bands.
    """
    inside = np.ones(len(frequency), bool)
    for press in presses:
        low, high = press.scattering.frequency[[0, -1]]
        inside &= (frequency >= low) & (frequency <= high)
    energy = np.abs(spectrum) ** 2
    if not 0 < energy.sum() < np.inf:
        raise ValueError(f"{what} is zero, or holds values that are not finite")
    left_out = energy[~inside].sum() / energy.sum()
    if not inside.any():
        raise ValueError(
            f"no frequency of {what} lies in the bands of all scattering matrices of the presses; "
            "compute all of them over the band of this signal"
        )
    if left_out > OUT_OF_BAND_ENERGY:
        low, high = frequency[inside][[0, -1]]
        raise ValueError(
            f"{100 * left_out:.2g} % of the energy of {what} lies outside {KHZ * low:.4g} to "
            f"{KHZ * high:.4g} kHz, the band of the presses' scattering, and "
            f"{100 * OUT_OF_BAND_ENERGY:g} % are allowed; compute the scattering over a wider band"
        )
    return inside


def check_interpolation(given: Array, cut_ons: Array, frequency: NDArray[Any]) -> None:
    """Validate the given and the required frequencies of an interpolation; all arguments in Hz."""
    if len(given) < 2:
        raise ConfigError("a press of one frequency cannot be interpolated; compute two or more")
    low, high = given[[0, -1]]
    least, most = np.min(np.real(frequency)), np.max(np.real(frequency))
    if not low * (1 - 1e-9) <= least <= most <= high * (1 + 1e-9):
        raise ValueError(
            f"frequency = {least:g} to {most:g} Hz is outside the band of a press, {low:g} to "
            f"{high:g} Hz; compute its scattering over a wider band"
        )
    step = np.diff(given)
    if np.ptp(step) > 1e-6 * step[0]:
        raise ValueError("the scattering of a press must be given at evenly spaced frequencies")
    within = np.any((cut_ons > low) & (cut_ons < high))
    if within and step[0] > COARSEST_STEP:
        raise ValueError(
            f"steps of {step[0]:g} Hz are too coarse to interpolate next to a cut-on; compute the "
            f"press in steps of {COARSEST_STEP:g} Hz at most"
        )


def common_modes(presses: Sequence[PlacedScatterer]) -> tuple[str, ...]:
    """Return the modes of the presses; raise ValueError if they are not the same for all."""
    if not presses:
        return ("00",)
    modes = presses[0].scattering.modes
    for press in presses:
        if press.scattering.modes != modes:
            raise ValueError(
                f"the presses have different modes, {', '.join(modes)} and "
                f"{', '.join(press.scattering.modes)}; compute their scattering over one band, on "
                "one grid, and with the same symmetry; between bends, place what "
                "sleeve.between_bends returns"
            )
    return modes


def check_places(
    presses: Sequence[PlacedScatterer], length: float, probes: Sequence[float]
) -> None:
    """Validate that presses, sorted by position, and probes lie in the tube without overlap."""
    parts = [
        (press.position + press.scattering.extent[0], press.position + press.scattering.extent[1])
        for press in presses
    ]
    free = 0.0
    for press, (start, end) in zip(presses, parts, strict=True):
        if start < free:
            raise ValueError(
                f"the press at {press.position:.4g} m, whose deformed section extends from "
                f"{start:.4g} m to {end:.4g} m, meets the one before it or the source end; place "
                f"it at {press.position + free - start:.4g} m or farther"
            )
        free = end
    if free > length:
        raise ValueError(
            f"the deformed section of the last press extends to {free:.4g} m, beyond the tube's "
            f"end at length = {length:.4g} m; use a longer tube or move the press"
        )
    for probe in probes:
        if not 0 <= probe <= length or any(start < probe < end for start, end in parts):
            raise ValueError(
                f"probe = {probe:.4g} m lies outside the tube or within a press; move the probe"
            )


def check_samples(duration: float, time_step: float) -> None:
    """Raise ConfigError if a recording has too many samples to be computed."""
    if duration > MOST_SAMPLES * time_step:
        raise ConfigError(
            f"is over {MOST_SAMPLES:.0e} samples of time_step = {time_step:g} s",
            setting="duration", value=duration, unit="s",
            advice=f"use at most {MOST_SAMPLES * time_step:.3g} s",
        )  # fmt: skip
