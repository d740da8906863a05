"""Sound in a lumen: cut-cell finite differences in the time domain."""

from acoustube.waves.cells import CutCells, cut_cells
from acoustube.waves.fdtd import Recording, grid_spacing, propagate
from acoustube.waves.modes import (
    Mode,
    attenuation,
    cut_on_frequency,
    cut_ons_in_band,
    modes_below,
)
from acoustube.waves.pulse import Pulse
from acoustube.waves.scheme import SourceEnd
from acoustube.waves.section import section_cut_ons
from acoustube.waves.stability import stable_step

__all__ = [
    "CutCells",
    "Mode",
    "Pulse",
    "Recording",
    "SourceEnd",
    "attenuation",
    "cut_cells",
    "cut_on_frequency",
    "cut_ons_in_band",
    "grid_spacing",
    "modes_below",
    "propagate",
    "section_cut_ons",
    "stable_step",
]
