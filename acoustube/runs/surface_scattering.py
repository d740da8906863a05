"""Lumens from surface files: scattering by the spectral solver, and grids for the time domain."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from acoustube.air import Air
from acoustube.base.errors import ConfigError
from acoustube.base.types import Array
from acoustube.base.units import KHZ, MM
from acoustube.runs.config import CELLS_PER_WAVELENGTH
from acoustube.runs.config.checks import MOST_CELLS
from acoustube.runs.sound import LARGEST_SPECTRAL_ERROR
from acoustube.waves import CutCells, cut_cells
from acoustube.waves.spectral import (
    SpectralScattering,
    rings_of_surface,
    scatter_spectral,
    wall_of,
)

NARROWEST_CELLS = 2
"""Least number of grid cells across the narrowest section."""


def spectral_of_surface(
    surface: trimesh.Trimesh,
    start: float,
    air: Air,
    frequency: Array,
    *,
    tolerance: float,
    lossy: bool,
) -> SpectralScattering:
    """Return the scattering matrix of a lumen, given as a closed surface, by the spectral solver.

    Both reference planes are at z = 0 of the surface's file.

    Parameters
    ----------
    surface : trimesh.Trimesh
        From :func:`acoustube.base.surfaces.read_lumen`: in m, moved along z to begin at z = 0.
    start : float
        Position z in m at which the surface begins in its file.
    air : Air
    frequency : ndarray
        Rising frequencies in Hz, (n,).
    tolerance : float
        Largest error of a scattering coefficient that the solver aims at.
    lossy : bool
        Whether there are losses at the wall and in the air.

    Raises
    ------
    ConfigError
        If the lumen is unsuitable for the spectral solver, or if at over 5 % of the frequencies the
        estimated error exceeds both the tolerance and
        :data:`acoustube.runs.sound.LARGEST_SPECTRAL_ERROR`.
    """
    rings = rings_of_surface(surface, position=-start)
    try:
        found = scatter_spectral(wall_of(rings), air, frequency, tolerance=tolerance, lossy=lossy)
    except np.linalg.LinAlgError as cause:
        raise ConfigError(
            "the sections of the lumen overlap themselves; use --method march"
        ) from cause
    if not found.typical_error <= max(LARGEST_SPECTRAL_ERROR, tolerance):
        raise ConfigError(
            f"the spectral solver's error estimate is {found.typical_error:.1g}, more than "
            f"{max(LARGEST_SPECTRAL_ERROR, tolerance):g}; use --method march"
        )
    return found


def cells_of_surface(
    surface: trimesh.Trimesh, path: Path, resolution: int, highest: float, air: Air
) -> CutCells:
    """Return the cut cells of a lumen, given as a closed surface, for the time-domain solver.

    Parameters
    ----------
    surface : trimesh.Trimesh
        Closed surface in m that begins at z = 0.
    path : Path
        File of the surface, for messages.
    resolution : int
        Number of grid cells along the larger of the width and the height of the ends.
    highest : float
        Highest frequency in Hz.
    air : Air

    Raises
    ------
    ConfigError
        If the grid is too coarse for the frequency or for the narrowest section, or too large.
    """
    across = float(_end_size(surface) / resolution)
    _check_grid(highest, across, air, path)
    # A whole number of layers, so that a lumen symmetric along z has a symmetric grid.
    length = float(np.ptp(surface.bounds[:, 2]))
    spacing = across, across, length / np.ceil(length / across - 1e-6)
    _check_cells(float(np.prod(np.ptp(surface.bounds, axis=0) / spacing)), path)
    cells = cut_cells(surface, spacing)
    _check_width(cells, path)
    return cells


def _end_size(surface: trimesh.Trimesh) -> float:
    """Return the larger of width and height of the ends, in m."""
    z = surface.vertices[:, 2]
    rim = surface.vertices[np.abs(z - z.min()) < 1e-9 + 1e-6 * np.ptp(z)]
    return float(np.ptp(rim[:, :2], axis=0).max())


def _check_grid(highest: float, spacing: float, air: Air, path: Path) -> None:
    """Check that the grid resolves the shortest wavelength."""
    high = KHZ * highest
    finest = KHZ * air.sound_speed / (CELLS_PER_WAVELENGTH * spacing)
    if high > finest:
        raise ConfigError(
            f"{path}: the band up to {high:g} kHz goes beyond {finest:.3g} kHz, where the grid of "
            f"{MM * spacing:.3g} mm has {CELLS_PER_WAVELENGTH} cells per wavelength; raise "
            "resolution or lower the band"
        )


def _check_cells(cells: float, path: Path) -> None:
    """Check that the grid of a lumen is not too large."""
    if cells > MOST_CELLS:
        raise ConfigError(
            f"{path} takes a grid of {cells:.3g} cells, over {MOST_CELLS:.0e}; give a shorter "
            "lumen (straight tube is added by acoustube simulate), or lower resolution"
        )


def openings(cells: CutCells) -> Array:
    """Return the narrower dimension of each layer of a lumen in m, (nz,).

    That is the smaller of the largest height and the largest width of the layer.
    """
    high, wide = (cells.volume_fraction.sum(axis=axis).max(axis=0) for axis in (1, 0))
    return np.asarray(np.minimum(high * cells.spacing[1], wide * cells.spacing[0]))


def _check_width(cells: CutCells, path: Path) -> None:
    """Check that there are enough cells across the narrowest section."""
    inner = openings(cells)[1:-1]
    narrowest, place = float(inner.min()), int(inner.argmin())
    if narrowest < NARROWEST_CELLS * cells.spacing[1]:
        at = MM * (place + 1) * cells.spacing[2]
        raise ConfigError(
            f"{path} is {MM * narrowest:.3g} mm wide at {at:.3g} mm from its low end, under "
            f"{NARROWEST_CELLS} cells of {MM * cells.spacing[1]:.3g} mm; raise resolution"
        )
