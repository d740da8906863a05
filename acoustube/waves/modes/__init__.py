"""Modes of ducts: of the round bore by Bessel functions, of any section on its grid, and probes.

Read `round_duct`, then `grid_modes` and `probes`.
"""

from acoustube.waves.modes.round_duct import (
    Mode,
    attenuation,
    axial_wavenumber,
    bessel_zero,
    cut_on_frequency,
    cut_ons_in_band,
    modes_below,
)

__all__ = [
    "Mode",
    "attenuation",
    "axial_wavenumber",
    "bessel_zero",
    "cut_on_frequency",
    "cut_ons_in_band",
    "modes_below",
]
