"""Surfaces of walls read from files."""

from __future__ import annotations

from pathlib import Path

import trimesh

from acoustube.base import surfaces
from acoustube.base.errors import ConfigError
from acoustube.indentation.wall_surface import walls

# ---------------------------------------------------------------------------------------------
# The surface


def read_surface(path: str | Path, unit: float = 1e-3) -> trimesh.Trimesh:
    """Read a tube's wall from a file.

    Parameters
    ----------
    path : str or Path
        STL, PLY or OBJ; its z axis is along the tube, +y where the press comes from.
    unit : float
        Length in m that the file's numbers count; millimetres by default.

    Returns
    -------
    trimesh.Trimesh
        A closed surface in m, its normals outwards, the middle of its bounding box at the origin.

    Raises
    ------
    ConfigError
        If the file cannot be read, or its surface is not that of one tube: open, crossing itself,
        of several bodies, without two flat ends across z, or without one bore.
    """
    path = Path(path)
    surface = surfaces.load(path)
    surfaces.check_closed(surface, path)
    if unit == 1e-3:
        surfaces.check_millimetres(surface, path)
    if surface.volume < 0:
        surface.invert()
    surface.apply_translation(-surface.bounds.mean(axis=0))
    surfaces.check_crossings(surface, path)
    surface.apply_scale(unit)
    if surface.euler_number != 0:
        raise ConfigError(
            f"{path}: the surface has {1 - surface.euler_number // 2} holes through it; a tube "
            "has one, its bore. Remove what is not the wall."
        )
    walls(surface, str(path))
    return surface
