"""Sound in a lumen: cut-cell finite differences in the time domain, and scattering matrices.

Reading order: the packages `grid` (lumens as cut cells), `scheme` (the leapfrog scheme, its time
step, losses and absorbing layers) and `modes` (duct modes and probes); then `propagation`
(recordings of a pulse), `port_waves` and `scattering` (scattering matrices of lumens), `spectral`
(such matrices by a solver in the frequency domain), `bent_parts` and `bends` (scattering matrices
of bends), `bent_modes` (the modes of a bend), `network` (tubes combined from scattering matrices)
and `budget` (the errors of a run). `network` uses `star_product`, `interpolation` (of scattering
matrices over frequency), `cut_on_steps` and `network_checks`.
"""

from acoustube.base.moved import renamed
from acoustube.waves.bends import bend, joined_bends
from acoustube.waves.bent_parts import Bent
from acoustube.waves.budget import Budget, error_budget
from acoustube.waves.grid.cells import CutCells, cut_cells
from acoustube.waves.grid.section import section_cut_ons
from acoustube.waves.modes import (
    attenuation,
    axial_wavenumber,
    cut_on_frequency,
    cut_ons_in_band,
    modes_below,
)
from acoustube.waves.modes.probes import ModalProbe, PointProbe
from acoustube.waves.modes.round_duct import Mode
from acoustube.waves.network import probe_pressure, transfer
from acoustube.waves.propagation import Recording, grid_spacing, propagate
from acoustube.waves.scattering import PlacedScatterer, Scattering, scatter
from acoustube.waves.scheme.problem import SourceEnd
from acoustube.waves.scheme.pulse import Pulse, SampledPulse
from acoustube.waves.scheme.time_step import stable_step

__all__ = [
    "Bent",
    "Budget",
    "CutCells",
    "ModalProbe",
    "Mode",
    "PlacedScatterer",
    "PointProbe",
    "Pulse",
    "Recording",
    "SampledPulse",
    "Scattering",
    "SourceEnd",
    "attenuation",
    "axial_wavenumber",
    "bend",
    "cut_cells",
    "cut_on_frequency",
    "cut_ons_in_band",
    "error_budget",
    "grid_spacing",
    "joined_bends",
    "modes_below",
    "probe_pressure",
    "propagate",
    "scatter",
    "section_cut_ons",
    "stable_step",
    "transfer",
]

__getattr__ = renamed(__name__, {"Placed": "PlacedScatterer", "heard": "probe_pressure"})
