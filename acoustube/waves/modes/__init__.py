"""Modes of ducts: of the round bore in closed form, and of any section on its grid; probes.

Reading order: `round_duct` (cut-ons, wavenumbers, attenuation), `bore_couplings` (for bends),
`grid_modes` (modes of any section), `probes` (amplitudes of modes), `yielding_wall` (plane mode
of an elastic tube of any thickness, whose wall is not rigid).
"""

from acoustube.waves.modes.round_duct import Mode as Mode
from acoustube.waves.modes.round_duct import (
    attenuation,
    axial_wavenumber,
    bessel_zero,
    cut_on_frequency,
    cut_ons_in_band,
    modes_below,
)

# Without `Mode`, which `acoustube.waves` documents.
__all__ = [
    "attenuation",
    "axial_wavenumber",
    "bessel_zero",
    "cut_on_frequency",
    "cut_ons_in_band",
    "modes_below",
]
