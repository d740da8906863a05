"""Error budget of a run on a grid."""

from __future__ import annotations

from dataclasses import dataclass
from math import asin, ceil, log10, pi, sin, sqrt

import numpy as np

from acoustube.air import Air
from acoustube.base.checks import DURATION, FLAG, FREQUENCY, LENGTH, SAMPLES, Optional, checked
from acoustube.base.errors import ConfigError
from acoustube.base.units import MM
from acoustube.waves.grid.cells import CutCells
from acoustube.waves.grid.polyhedron import Array
from acoustube.waves.grid.section import section_cut_ons
from acoustube.waves.modes import cut_on_frequency
from acoustube.waves.scheme.pml import REFLECTION
from acoustube.waves.spectral.result import SpectralScattering

PLANE_WAVE_REFLECTION = -60.0
"""Upper bound in dB of the plane wave's reflection coefficient at an absorbing end, unless losses
that fade out before it reflect more (:func:`fading_reflection`); without losses it is -86 dB."""
LOSSY_REFLECTION = -14.0
"""Measured reflection in dB of a mode 1 % above cut-on where losses fade out before the absorber.

At 2, 3 and 5 % above cut-on it is -27, -34 and -39 dB.
"""
CUT_ON_RATIO = 1.01
"""Ratio of frequency to cut-on of the mode for which the absorber's reflection is stated."""
TAIL_FRACTION = 0.05
"""Fraction of the recording's duration, at its end, in which the residual ringing is measured."""


@dataclass(frozen=True, kw_only=True)
class Budget:
    """Known errors of a run.

    Attributes
    ----------
    cells_per_wavelength : float
        Wavelength divided by the largest cell size, at the highest frequency of the pulse's band.
    delay_bias : float
        Relative error of the plane wave's group delay at the carrier, due to the grid's dispersion.
    section_error : float
        Relative error of the straight bore's cross-section on the grid.
    cut_on_error : float
        Relative error of the cut-on frequency of (1,1) on the grid.
    absorption : float or None
        Reflection coefficient of the absorbing layer for a mode 1 % above cut-on, in dB; it is
        smaller for modes farther above their cut-on. None if no end absorbs by such a layer.
    plane_reflection : float or None
        Upper bound of that layer's reflection coefficient for the plane wave at the carrier
        frequency, in dB, or None.
    ringing : float
        Highest pressure in the last twentieth of the recording, in dB relative to the highest of
        the whole recording.
    """

    cells_per_wavelength: float
    delay_bias: float
    section_error: float
    cut_on_error: float
    absorption: float | None
    plane_reflection: float | None
    ringing: float

    def in_words(self, path: float) -> str:
        """Return the error budget as a sentence, for an echo's path in m, there and back."""
        absorbing = (
            f"an absorbing end reflects the plane wave at under {ceil(self.plane_reflection)} dB "
            f"and a mode 1 % above its cut-on at {self.absorption:.0f} dB; "
            if self.absorption is not None and self.plane_reflection is not None
            else ""
        )
        return (
            f"{self.cells_per_wavelength:.0f} cells per wavelength; the grid moves the echo by "
            f"{MM * self.delay_bias * path / 2:+.3f} mm and changes the bore's section by "
            f"{100 * self.section_error:+.2f} %, the cut-on of (1,1) by "
            f"{100 * self.cut_on_error:+.2f} %; {absorbing}the highest pressure at the end of the "
            f"recording is {self.ringing:.0f} dB relative to its maximum"
        )


@dataclass(frozen=True, kw_only=True)
class SpectralBudget:
    """Known errors of a run by the spectral solver.

    Attributes
    ----------
    spectral_error : float
        Estimated error of the scattering coefficients that 95 % of the frequencies do not exceed.
    largest_spectral_error : float
        Largest estimated error over all frequencies.
    ringing : float
        See :class:`Budget`.
    """

    spectral_error: float
    largest_spectral_error: float
    ringing: float

    def in_words(self, _path: float) -> str:
        """Return the error budget as a sentence."""
        return (
            "scattering coefficients by the spectral solver, with an estimated error of "
            f"{self.spectral_error:.1g} or less at 95 % of the frequencies and "
            f"{self.largest_spectral_error:.1g} at most; the highest pressure at the end of the "
            f"recording is {self.ringing:.0f} dB relative to its maximum"
        )


def spectral_budget(found: SpectralScattering, pressure: Array) -> SpectralBudget:
    """Return the error budget of a recording (time last) computed from a scattering matrix."""
    return SpectralBudget(
        spectral_error=found.typical_error,
        largest_spectral_error=float(found.error.max()),
        ringing=_ringing(pressure),
    )


@checked(
    cells=CutCells,
    air=Air,
    frequency=FREQUENCY,
    highest=FREQUENCY,
    radius=LENGTH,
    time_step=Optional(DURATION),
    lossy=FLAG,
    pressure=SAMPLES,
)
def error_budget(
    cells: CutCells,
    air: Air,
    *,
    frequency: float,
    highest: float,
    radius: float,
    time_step: float | None,
    lossy: bool,
    pressure: Array,
) -> Budget:
    """Return the error budget of a run.

    Parameters
    ----------
    cells : CutCells
        The lumen, straight and round in its second layer.
    air : Air
        Gas in the lumen.
    frequency, highest : float
        Carrier and upper end of the pulse's band in Hz.
    radius : float
        Bore radius in m.
    time_step : float or None
        In s; None if straight tube is not computed on the grid: its dispersion and ends are then
        exact.
    lossy : bool
        With losses at the wall and in the air.
    pressure : ndarray
        The recording, time last.

    Returns
    -------
    Budget

    Raises
    ------
    ConfigError
        If the recording is silent, or an argument is outside its range.
    """
    half = cells.origin[0] == 0.0
    area = cells.area()[1] * (2 if half else 1)
    exact = cut_on_frequency(1, 1, radius, air.sound_speed)
    lowest = section_cut_ons(cells, 1, air.sound_speed, 2)[1]
    spacing = cells.spacing[2]
    absorption = plane = None
    if time_step is not None:
        absorption, plane = absorber_reflection(), PLANE_WAVE_REFLECTION
        if lossy:
            fading = fading_reflection(air, radius, frequency)
            absorption, plane = LOSSY_REFLECTION, max(plane, fading)
    return Budget(
        cells_per_wavelength=air.sound_speed / (highest * max(cells.spacing)),
        delay_bias=0.0
        if time_step is None
        else delay_bias(frequency, spacing, time_step, air.sound_speed),
        section_error=float(area / (pi * radius**2) - 1),
        cut_on_error=float(lowest / exact - 1),
        absorption=absorption,
        plane_reflection=plane,
        ringing=_ringing(np.asarray(pressure)),
    )


def _ringing(pressure: Array) -> float:
    """Return the highest pressure at a recording's end, in dB relative to the highest of all."""
    tail = pressure[..., -max(1, int(TAIL_FRACTION * pressure.shape[-1])) :]
    highest = float(np.abs(pressure).max(initial=0.0))
    if not highest:
        raise ConfigError("pressure is empty, or 0 throughout; give a recording")
    return 20 * log10(max(float(np.abs(tail).max()) / highest, 1e-12))


def absorber_reflection() -> float:
    """Return the lossless absorber's reflection of a mode 1 % above cut-on, in dB.

    For a mode with axial wavenumber kz, the reflection in dB is kz / k times the plane wave's.
    """
    return 20 * log10(REFLECTION) * sqrt(1 - CUT_ON_RATIO**-2)


def fading_reflection(air: Air, radius: float, frequency: float) -> float:
    """Return an upper bound of the plane wave's reflection where losses fade out, in dB.

    It is that of an abrupt end of the losses: to first order in the boundary layers, the losses
    change the wave impedance by the factor 1 + (1 - (gamma - 1) / sqrt(Pr)) D / R, with
    D = sqrt(nu / (j omega)), and half of the change is reflected.
    """
    layer = sqrt(air.viscous_diffusivity / (2 * pi * frequency)) / radius
    share = abs(1 - (air.heat_capacity_ratio - 1) / sqrt(air.prandtl))
    return 20 * log10(max(share * layer / 2, 1e-12))


def delay_bias(frequency: float, spacing: float, time_step: float, sound_speed: float) -> float:
    """Return the relative error of the plane wave's group delay on a grid.

    Parameters
    ----------
    frequency : float
        In Hz.
    spacing : float
        Axial cell size in m.
    time_step : float
        In s.
    sound_speed : float
        In m/s.

    Notes
    -----
    The dispersion relation in :mod:`acoustube.waves.scheme.operator` relates the phases theta per
    cell and Omega per time step. With the Courant number nu, the coefficient beta of the axial
    correction and X = 4 sin^2(theta/2), its derivative is d theta / d Omega = sin(Omega) /
    (nu^2 sin(theta) (1 + 2 beta X)), which is 1 / nu in the continuum.
    """
    nu = sound_speed * time_step / spacing
    beta, turn = (1 - nu**2) / 12, 2 * pi * frequency * time_step
    square = 4 * sin(turn / 2) ** 2 / nu**2
    x = 2 * square / (1 + sqrt(1 + 4 * beta * square))
    theta = 2 * asin(sqrt(x) / 2)
    return sin(turn) / (nu * sin(theta) * (1 + 2 * beta * x)) - 1
