"""Expected computing time and memory of a press and of its sound."""

from __future__ import annotations

from acoustube.base.units import MM
from acoustube.runs.config import grid_cells
from acoustube.runs.config.si import SIPress, SISettings

# Measured with benchmarks/fdtd_throughput.py and the default run on two quiet cores; used only for
# the estimate that a command prints first.
FIXED_SECONDS, FIXED_GIGABYTES = 20.0, 0.6
"""Time in s and memory in GB of a simulation, without the parts that grow with the FDTD grid."""
STEPS_PER_LAYER = 3.9
"""Number of FDTD time steps of a whole tube, for both source ends together, divided by its number
of axial layers of cells. Steps that skip a silent layer, about half, are not counted."""
SCATTERING_STEPS = 8 * 8000.0
"""Time steps of a scattering matrix by FDTD at one cell per mm: eight runs of 12 ms."""
SECONDS_PER_CELL_STEP, LOSSY, GIGABYTES_PER_CELL = 0.6e-9, 3.0, 3e-7
"""Costs of FDTD: time in s per cell and step, its factor with losses, and memory in GB per cell."""
SPECTRAL_SECONDS = 1.5
"""Time in s of a scattering matrix by the spectral solver, without losses."""
PRESS_SECONDS, PRESS_GIGABYTES = {2: (5.0, 2.5), 1: (10.0, 6.0), 0: (30.0, 20.0)}, 1.0
"""Costs of a press: time as (s, s per mm of depth), by number of symmetry planes; memory in GB."""
TETRAHEDRA = 4.0
"""Ratio of the computing time of a press of an imported wall to that of a round tube."""


def press_seconds(settings: SIPress, depth: float) -> float:
    """Return the expected computing time in s of a press of a round tube to a depth in m."""
    start, per_mm = PRESS_SECONDS[sum(settings.indenter.halves)]
    return start + per_mm * MM * depth


def simulation_cost(settings: SISettings) -> tuple[float, float]:
    """Return the expected time in s and memory in GB of a simulation."""
    cells, layers = cells_of(settings), settings.resolution / (MM * settings.tube.inner_diameter)
    steps = STEPS_PER_LAYER * MM * settings.tube.length * layers
    if settings.method == "scattering":
        steps = SCATTERING_STEPS * layers
    seconds = cells * steps * SECONDS_PER_CELL_STEP * (LOSSY if settings.lossy else 1)
    if settings.method == "spectral":
        return FIXED_SECONDS + spectral_seconds(settings), FIXED_GIGABYTES
    return FIXED_SECONDS + seconds, FIXED_GIGABYTES + cells * GIGABYTES_PER_CELL


def spectral_seconds(settings: SISettings) -> float:
    """Return the expected time in s of a scattering matrix by the spectral solver."""
    return SPECTRAL_SECONDS * (LOSSY if settings.lossy else 1)


def cells_of(settings: SISettings) -> float:
    """Return the number of cells of the FDTD grid, a box around the bore.

    It covers the whole tube with the method ``full``, otherwise the pressed part.
    """
    return grid_cells(
        bore=settings.tube.inner_diameter,
        outer_diameter=settings.tube.outer_diameter,
        indenter_diameter=settings.indenter.diameter,
        tube_length=settings.tube.length,
        resolution=settings.resolution,
        method=settings.method,
    )
