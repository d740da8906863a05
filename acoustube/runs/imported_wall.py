"""Wall of a tube read from a surface file, checked and centred."""

from __future__ import annotations

from pathlib import Path

import trimesh

from acoustube.base import surfaces
from acoustube.base.errors import ConfigError
from acoustube.indentation.wall_surface import separate_walls


def read_surface(path: str | Path) -> trimesh.Trimesh:
    """Read the surface of a tube's wall from a file.

    Parameters
    ----------
    path : str or Path
        STL, PLY, OBJ or VTP file in mm; the tube lies along z, the indenter comes from +y.

    Returns
    -------
    trimesh.Trimesh
        A closed surface in m with outward normals, the centre of its bounding box at the origin.

    Raises
    ------
    ConfigError
        If the file cannot be read, its size is not that of a tube in mm, or its surface is not that
        of one tube: it is open, crosses itself, has several bodies, lacks two flat ends across z,
        or does not have one bore.
    """
    path = Path(path)
    surface = surfaces.load(path)
    surfaces.check_closed(surface, path)
    surfaces.check_millimetres(surface, path)
    if surface.volume < 0:
        surface.invert()
    surface.apply_translation(-surface.bounds.mean(axis=0))
    surfaces.check_crossings(surface, path)
    surface.apply_scale(1e-3)
    if surface.euler_number != 0:
        raise ConfigError(
            f"{path}: the surface has {1 - surface.euler_number // 2} holes through it, and a tube "
            "has one, its bore; remove all parts but the wall"
        )
    separate_walls(surface, str(path))
    return surface
