"""Inner and outer wall of an imported surface: separation, symmetry and thickness."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import trimesh

from acoustube.base import surfaces
from acoustube.base.errors import ConfigError
from acoustube.base.report import counted
from acoustube.base.types import Array, Mask
from acoustube.base.units import MM
from acoustube.tube import Tube

SYMMETRY_TOLERANCE = 0.02
"""Largest distance of a symmetric wall from its mirror image, in wall thicknesses."""
MIN_THICKNESS = 0.25
"""Smallest allowed thickness of a wall, in mean thicknesses: elements are sized by the mean."""
MAX_TETRAHEDRA = 60_000
"""Largest expected number of tetrahedra; a wall that needs more is too thin."""
TETRAHEDRON_VOLUME = 0.13
"""Mean volume of a tetrahedron, in cubes of the requested edge length (a regular one has 0.118)."""


class Walls(NamedTuple):
    """Inner and outer wall of a tube, in m, and its mean thickness in m."""

    inner: trimesh.Trimesh
    outer: trimesh.Trimesh
    thickness: float


def separate_walls(surface: trimesh.Trimesh, name: str = "surface") -> Walls:
    """Separate the inner wall of a tube from the outer wall.

    Parameters
    ----------
    surface : trimesh.Trimesh
        Closed surface of the wall in m, the tube along z.
    name : str
        Name of the surface in error messages.

    Raises
    ------
    ConfigError
        If the surface does not have two flat ends across z with one opening each.
    """
    low, high = surface.bounds[:, 2]
    z = surface.triangles[..., 2]
    tolerance = 1e-4 * min(surface.extents)
    ends = np.all(z < low + tolerance, axis=1) | np.all(z > high - tolerance, axis=1)
    sides = _part(surface, ~ends)
    parts = surfaces.components(sides)
    if not ends.any() or parts.max() != 1:
        raise ConfigError(
            f"{name} is not a tube along z: between flat ends it has "
            f"{counted(parts.max() + 1, 'separate wall')}, not an inner and an outer one; turn it "
            "so that it lies along z, and cut its ends square"
        )
    inner, outer = sorted(
        (_part(sides, parts == i) for i in (0, 1)), key=lambda wall: float(wall.extents[0])
    )
    return Walls(inner, outer, float(2 * surface.volume / (inner.area + outer.area)))


def _part(surface: trimesh.Trimesh, chosen: Mask) -> trimesh.Trimesh:
    """Return the selected facets of a surface."""
    part = trimesh.Trimesh(surface.vertices, surface.faces[chosen], process=False)
    part.remove_unreferenced_vertices()
    return part


def tube_of(surface: trimesh.Trimesh, *, shear_modulus: float, poisson_ratio: float) -> Tube:
    """Return the equivalent round tube of an imported wall: its sizes and moduli.

    Parameters
    ----------
    surface : trimesh.Trimesh
        From :func:`acoustube.runs.imported_wall.read_surface`, in m.
    shear_modulus : float
        Of the wall, in Pa.
    poisson_ratio : float

    Returns
    -------
    Tube
        Its inner diameter is the height of the bore in the plane x = 0 at mid-length, its wall
        thickness the mean thickness of the imported wall.

    Raises
    ------
    ConfigError
        If the surface is not a tube, or x = 0 misses its bore.
    """
    inner, _, thickness = separate_walls(surface)
    middle = [0.0, 0.0, surface.bounds[:, 2].mean()]
    ring = trimesh.intersections.mesh_plane(inner, [0.0, 0.0, 1.0], middle)
    (x0, x1), (y0, y1) = ring[..., 0].T, ring[..., 1].T
    crossing = (np.minimum(x0, x1) <= 0) & (np.maximum(x0, x1) >= 0) & (x0 != x1)
    if not crossing.any():
        raise ConfigError("x = 0 misses the bore at mid-length; centre the tube on the z axis")
    heights = (y0 - x0 * (y1 - y0) / np.where(crossing, x1 - x0, 1.0))[crossing]
    return Tube(
        inner_diameter=float(np.ptp(heights)),
        wall_thickness=thickness,
        length=float(surface.extents[2]),
        shear_modulus=shear_modulus,
        poisson_ratio=poisson_ratio,
    )


def closest(wall: trimesh.Trimesh, points: Array) -> Array:
    """Return the closest points on a wall.

    Parameters
    ----------
    wall : trimesh.Trimesh
    points : array of shape (n, 3)
        In m.

    Returns
    -------
    array of shape (n, 3)
    """
    import pyvista

    _, found = pyvista.wrap(wall).find_closest_cell(points, return_closest_point=True)  # type: ignore[misc]
    return np.asarray(found)


def symmetries(
    piece: trimesh.Trimesh, asked: tuple[bool, bool], tolerance: float
) -> tuple[bool, bool]:
    """Return whether a piece is symmetric about x = 0, and about z = 0.

    Parameters
    ----------
    piece : trimesh.Trimesh
        In m.
    asked : tuple of bool
        Symmetry of the load about x = 0, and about z = 0; where false, the result is false too.
    tolerance : float
        Largest distance of the piece from its mirror image, in m.
    """
    points = np.concatenate([piece.vertices, piece.triangles_center])
    found = []
    for wanted, axis in zip(asked, (0, 2), strict=True):
        mirrored = points * np.where(np.arange(3) == axis, -1.0, 1.0)
        distance = np.linalg.norm(closest(piece, mirrored) - mirrored, axis=1)
        found.append(bool(wanted and distance.max() < tolerance))
    return found[0], found[1]


def check_thickness(piece: trimesh.Trimesh, whole: Walls, edge: Array) -> None:
    """Raise if a mesh sized by the mean thickness would not resolve the wall.

    Parameters
    ----------
    piece : trimesh.Trimesh
        The part to be meshed, in m.
    whole : Walls
    edge : array of shape (n,)
        Requested edge lengths along the piece, in m.

    Raises
    ------
    ConfigError
        If the wall is thinner than :data:`MIN_THICKNESS` somewhere, or would need more than
        :data:`MAX_TETRAHEDRA` tetrahedra.
    """
    inside = _sampled(whole.inner)
    least = np.linalg.norm(closest(whole.outer, inside) - inside, axis=1).min()
    if least < MIN_THICKNESS * whole.thickness:
        raise ConfigError(
            f"the wall is {MM * least:.3g} mm thick at its thinnest place, under a quarter of its "
            f"mean of {MM * whole.thickness:.3g} mm, and cannot be meshed; make it at least "
            f"{MM * MIN_THICKNESS * whole.thickness:.3g} mm there"
        )
    count = piece.volume * np.mean(1 / edge**3) / TETRAHEDRON_VOLUME
    if count > MAX_TETRAHEDRA:
        needed = whole.thickness * np.sqrt(count / MAX_TETRAHEDRA)
        raise ConfigError(
            f"the wall, {MM * whole.thickness:.3g} mm thick in the mean, is too thin for its "
            f"size: it would need {count:.0f} tetrahedra, {MAX_TETRAHEDRA} are allowed; make it "
            f"about {MM * needed:.2g} mm, model a shorter piece, or choose longer edges (from "
            "Python)"
        )


def _sampled(wall: trimesh.Trimesh) -> Array:
    """Return the corners, edge midpoints and centres of a wall's facets."""
    middles = wall.vertices[wall.edges_unique].mean(axis=1)
    return np.concatenate([wall.vertices, middles, wall.triangles_center])
