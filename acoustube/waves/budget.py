"""What a run on a grid can be trusted with: its known errors, as numbers."""

from __future__ import annotations

from dataclasses import dataclass
from math import asin, log10, pi, sin, sqrt

import numpy as np

from acoustube.air import Air
from acoustube.waves.grid.cells import CutCells
from acoustube.waves.grid.polyhedron import Array
from acoustube.waves.grid.section import section_cut_ons
from acoustube.waves.modes import cut_on_frequency
from acoustube.waves.scheme.pml import REFLECTION

PLANE_WAVE = -60.0
"""What an absorbing end returns of the plane wave in dB, at most; without losses under -86 dB."""
WITH_LOSSES = -14.0
"""What one returns of a mode 1 % over its cut-on where losses fade out before it, as measured.

2, 3 and 5 % over it -27, -34 and -39 dB.
"""
OVER_CUT_ON = 1.01
"""How far over its cut-on a mode is for which the absorber's reflection is given."""
LAST = 0.05
"""Share of a recording at its end in which what still rings is measured."""


@dataclass(frozen=True, kw_only=True)
class Budget:
    """Known errors of a run.

    Attributes
    ----------
    cells_per_wavelength : float
        At the highest frequency of the pulse's band.
    delay_bias : float
        What the grid adds to the group delay of the plane wave at the carrier, relative.
    section_error : float
        Of the straight bore's cross-section on the grid, relative.
    cut_on_error : float
        Of the cut-on of (1,1) on the grid, relative.
    absorption : float or None
        What an absorbing end sends back of a mode 1 % over its cut-on, in dB; of modes farther
        over it less. None where no such end is in the recording.
    ringing : float
        Highest pressure in the last twentieth of the recording, in dB of the highest of all.
    """

    cells_per_wavelength: float
    delay_bias: float
    section_error: float
    cut_on_error: float
    absorption: float | None
    ringing: float

    def in_words(self, path: float) -> str:
        """Return the budget as a sentence, for an echo's path in m."""
        absorbing = (
            f"an absorbing end returns under {PLANE_WAVE:.0f} dB of the plane wave, "
            f"{self.absorption:.0f} dB of a mode 1 % over its cut-on; "
            if self.absorption is not None
            else ""
        )
        return (
            f"{self.cells_per_wavelength:.0f} cells per wavelength; the grid moves the echo by "
            f"{1e3 * self.delay_bias * path / 2:+.3f} mm, the bore's section by "
            f"{100 * self.section_error:+.2f} %, the cut-on of (1,1) by "
            f"{100 * self.cut_on_error:+.2f} %; {absorbing}the highest pressure at the end of the "
            f"recording is {self.ringing:.0f} dB of that of all"
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
    """Return the known errors of a run.

    Parameters
    ----------
    cells : CutCells
        The lumen, straight and round in its second layer.
    air : Air
        Gas in the lumen.
    frequency, highest : float
        Carrier and upper end of the pulse's band in Hz.
    radius : float
        Of the bore in m.
    time_step : float or None
        In s; None where straight tube is not marched, its dispersion and its ends exact.
    lossy : bool
        With losses at the wall and in the air.
    pressure : ndarray
        The recording, time last.

    Returns
    -------
    Budget
    """
    half = cells.origin[0] == 0.0
    area = cells.area()[1] * (2 if half else 1)
    exact = cut_on_frequency(1, 1, radius, air.sound_speed)
    lowest = section_cut_ons(cells, 1, air.sound_speed, 2)[1]
    spacing = cells.spacing[2]
    tail = pressure[..., -max(1, int(LAST * pressure.shape[-1])) :]
    quiet = max(float(np.abs(tail).max() / np.abs(pressure).max()), 1e-12)
    return Budget(
        cells_per_wavelength=air.sound_speed / (highest * max(cells.spacing)),
        delay_bias=0.0
        if time_step is None
        else delay_bias(frequency, spacing, time_step, air.sound_speed),
        section_error=float(area / (pi * radius**2) - 1),
        cut_on_error=float(lowest / exact - 1),
        absorption=None if time_step is None else WITH_LOSSES if lossy else over_cut_on(),
        ringing=20 * log10(quiet),
    )


def over_cut_on() -> float:
    """Return what an absorbing end sends back of a mode 1 % over its cut-on, in dB, lossless.

    The layer's profile is made for the plane wave; a slanted one meets the power kz / k of it.
    """
    return 20 * log10(REFLECTION) * sqrt(1 - OVER_CUT_ON**-2)


def delay_bias(frequency: float, spacing: float, time_step: float, sound_speed: float) -> float:
    """Return what a grid adds to the group delay of a plane wave along it, relative.

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
    The slope of the dispersion relation in :mod:`acoustube.waves.scheme.operator`: with X =
    4 sin^2(theta/2), d theta / d Omega = sin(Omega) / (nu^2 sin(theta) (1 + 2 beta X)), which is
    1 / nu without a grid.
    """
    nu = sound_speed * time_step / spacing
    beta, turn = (1 - nu**2) / 12, 2 * pi * frequency * time_step
    bent = 4 * sin(turn / 2) ** 2 / nu**2
    x = 2 * bent / (1 + sqrt(1 + 4 * beta * bent))
    theta = 2 * asin(sqrt(x) / 2)
    return sin(turn) / (nu * sin(theta) * (1 + 2 * beta * x)) - 1
