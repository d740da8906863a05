"""Inner and outer wall of an imported surface."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import trimesh

from acoustube.base import surfaces
from acoustube.base.errors import ConfigError
from acoustube.base.types import Array, Mask
from acoustube.tube import Tube

SYMMETRY = 0.02
"""How far the mirror image of a wall may be off it, in wall thicknesses."""
THINNEST = 0.25
"""Least thickness of a wall anywhere, in mean thicknesses: elements are sized by the mean."""
LARGEST_COUNT = 60_000
"""Most tetrahedra that a mesh is expected to have; a wall that needs more is too thin."""
FILL = 0.13
"""Volume of a tetrahedron among many, in cubes of the edge asked for (a regular one has 0.118)."""


class Walls(NamedTuple):
    """The two walls of a tube, and the mean distance in m between them."""

    inner: trimesh.Trimesh
    outer: trimesh.Trimesh
    thickness: float


def walls(surface: trimesh.Trimesh, name: str = "surface") -> Walls:
    """Separate the inner wall of a tube from the outer.

    Parameters
    ----------
    surface : trimesh.Trimesh
        Closed, in m, along z.
    name : str
        What an error calls it.

    Raises
    ------
    ConfigError
        If it has no two flat ends across z with one opening each.
    """
    low, high = surface.bounds[:, 2]
    z = surface.triangles[..., 2]
    tolerance = 1e-4 * min(surface.extents)
    ends = np.all(z < low + tolerance, axis=1) | np.all(z > high - tolerance, axis=1)
    sides = _part(surface, ~ends)
    parts = surfaces.components(sides)
    if not ends.any() or parts.max() != 1:
        raise ConfigError(
            f"{name} is not a tube along z: between flat ends it has {parts.max() + 1} separate "
            "walls, not an inner and an outer one; turn it so that it lies along z, and cut its "
            "ends square."
        )
    inner, outer = sorted(
        (_part(sides, parts == i) for i in (0, 1)), key=lambda wall: float(wall.extents[0])
    )
    return Walls(inner, outer, float(2 * surface.volume / (inner.area + outer.area)))


def _part(surface: trimesh.Trimesh, chosen: Mask) -> trimesh.Trimesh:
    """Return some of a surface's facets."""
    part = trimesh.Trimesh(surface.vertices, surface.faces[chosen], process=False)
    part.remove_unreferenced_vertices()
    return part


def tube_of(surface: trimesh.Trimesh, *, shear_modulus: float, poisson_ratio: float) -> Tube:
    """Return a round tube with the scales of a surface.

    Parameters
    ----------
    surface : trimesh.Trimesh
        From :func:`read_surface`.
    shear_modulus : float
        Of the wall, in Pa.
    poisson_ratio : float

    Returns
    -------
    Tube
        Its inner diameter is the height of the bore over x = 0 at mid-length, its wall as thick as
        the surface's in the mean.

    Raises
    ------
    ConfigError
        If the surface is no tube, or x = 0 misses its bore.
    """
    inner, _, thickness = walls(surface)
    middle = [0.0, 0.0, surface.bounds[:, 2].mean()]
    ring = trimesh.intersections.mesh_plane(inner, [0.0, 0.0, 1.0], middle)
    (x0, x1), (y0, y1) = ring[..., 0].T, ring[..., 1].T
    crossing = (np.minimum(x0, x1) <= 0) & (np.maximum(x0, x1) >= 0) & (x0 != x1)
    if not crossing.any():
        raise ConfigError("The bore is nowhere over x = 0 at mid-length; centre the tube on z.")
    heights = (y0 - x0 * (y1 - y0) / np.where(crossing, x1 - x0, 1.0))[crossing]
    return Tube(
        inner_diameter=float(np.ptp(heights)),
        wall_thickness=thickness,
        length=float(surface.extents[2]),
        shear_modulus=shear_modulus,
        poisson_ratio=poisson_ratio,
    )


def closest(wall: trimesh.Trimesh, points: Array) -> Array:
    """Return the points of a wall that are closest to the given ones."""
    import pyvista

    _, found = pyvista.wrap(wall).find_closest_cell(points, return_closest_point=True)  # type: ignore[misc]
    return np.asarray(found)


def symmetries(
    piece: trimesh.Trimesh, asked: tuple[bool, bool], tolerance: float
) -> tuple[bool, bool]:
    """Return about which of x = 0 and z = 0 a piece is its own mirror image, of those asked for."""
    points = np.concatenate([piece.vertices, piece.triangles_center])
    found = []
    for wanted, axis in zip(asked, (0, 2), strict=True):
        mirrored = points * np.where(np.arange(3) == axis, -1.0, 1.0)
        off = np.linalg.norm(closest(piece, mirrored) - mirrored, axis=1)
        found.append(bool(wanted and off.max() < tolerance))
    return found[0], found[1]


def check_thickness(piece: trimesh.Trimesh, whole: Walls, edge: Array) -> None:
    """Refuse a wall that a mesh sized by its mean thickness would not resolve."""
    inside = _sampled(whole.inner)
    least = np.linalg.norm(closest(whole.outer, inside) - inside, axis=1).min()
    if least < THINNEST * whole.thickness:
        raise ConfigError(
            f"The wall is {1e3 * least:.3g} mm thick at its thinnest place, under a quarter of its "
            f"mean of {1e3 * whole.thickness:.3g} mm, and cannot be meshed; make it at least "
            f"{1e3 * THINNEST * whole.thickness:.3g} mm there."
        )
    count = piece.volume * np.mean(1 / edge**3) / FILL
    if count > LARGEST_COUNT:
        needed = whole.thickness * np.sqrt(count / LARGEST_COUNT)
        raise ConfigError(
            f"The wall, {1e3 * whole.thickness:.3g} mm thick in the mean, is too thin for its "
            f"size: it would take {count:.0f} tetrahedra, {LARGEST_COUNT} are allowed; make it "
            f"about {1e3 * needed:.2g} mm, model a shorter piece, or ask for longer edges."
        )


def _sampled(wall: trimesh.Trimesh) -> Array:
    """Return the corners, middles of edges and centres of a wall's facets."""
    middles = wall.vertices[wall.edges_unique].mean(axis=1)
    return np.concatenate([wall.vertices, middles, wall.triangles_center])
