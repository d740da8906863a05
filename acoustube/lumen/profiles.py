"""Profiles of the lumen: height, width and area of its cross-sections along the tube."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from acoustube.base.checks import Reals, checked
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.base.types import Array, Index
from acoustube.indentation import Indentation, Mesh
from acoustube.indentation.self_contact import triangulated

INCREMENT = Number(-1e9, 1e9, whole=True)

TRIANGLES_PER_EDGE = 8
"""Number of triangle edges per edge of an element's face, for the measurement of sections."""
END_TOLERANCE = 1e-6
"""Distance from an end up to which vertices are the end's, in lengths of the modelled part."""


@dataclass(frozen=True, eq=False)
class Profile:
    """Cross-sections of the lumen along the tube.

    Parameters
    ----------
    z : array of shape (n,)
        Axial positions in m.
    area : array of shape (n,)
        Cross-sectional area in m2.
    height : array of shape (n,)
        Distance in m from the bottom to the top of the section at x = 0.
    width : array of shape (n,)
        Largest extent along x, in m.
    """

    z: Array
    area: Array
    height: Array
    width: Array


def check_increment(indentation: Indentation, increment: int) -> None:
    """Raise ConfigError unless an indentation has an increment of a given number.

    Parameters
    ----------
    indentation : Indentation
    increment : int
        Number of the increment, from 0; negative numbers count from the last.
    """
    count = len(indentation.depth)
    if not -count <= increment < count:
        raise ConfigError(f"increment = {increment} is out of range; use 0 to {count - 1}")


@checked(mesh=Mesh)
def inner_wall(mesh: Mesh) -> tuple[Any, Index]:
    """Triangulate the inner wall for the measurement of sections.

    Returns
    -------
    sampling : sparse array of shape (n_vertices, n_nodes)
        Matrix that interpolates nodal values at the vertices.
    triangles : array of int, shape (n_triangles, 3)
        Numbers of the vertices of each triangle.
    """
    return triangulated(mesh, parts=TRIANGLES_PER_EDGE)


@checked(indentation=Indentation, increment=INCREMENT, z=Reals(-1e6, 1e6, "m", ndim=1, empty=True))
def measure(
    indentation: Indentation,
    increment: int,
    z: Array,
    wall: tuple[Any, Index] | None = None,
) -> Profile:
    """Measure the lumen's cross-sections in planes z = const at an increment of a press.

    Parameters
    ----------
    indentation : Indentation
    increment : int
        Number of the increment, from 0; negative numbers count from the last.
    z : array of shape (n,)
        Axial positions in the deformed tube in m, as in the mesh; of a mesh of the half z >= 0 they
        may be negative.
    wall : tuple, optional
        Result of :func:`inner_wall`, to compute it once for many increments.

    Returns
    -------
    Profile
        Measures of the whole section, even if only half of it is modelled; nan where the plane is
        beyond an end of the modelled part, or cuts an end, which is slanted in a tube that tilts.

    Raises
    ------
    ConfigError
        If there is no such increment, or `z` is not a finite array of one axis.
    """
    check_increment(indentation, increment)
    mesh = indentation.mesh
    sampling, triangles = wall or inner_wall(mesh)
    z = np.asarray(z, float)
    modelled = np.abs(z) if mesh.halved[1] else z
    vertices = sampling @ indentation.position(increment)
    found = profile(vertices, triangles, modelled, halved=mesh.halved[0])
    low, high = _ends((sampling @ mesh.points)[:, 2], vertices[:, 2])
    whole = (modelled < high) & ((modelled >= low) | mesh.halved[1])
    area, height, width = (
        np.where(whole, values, np.nan) for values in (found.area, found.height, found.width)
    )
    return Profile(z=z, area=area, height=height, width=width)


def _ends(undeformed: Array, deformed: Array) -> tuple[float, float]:
    """Return the z in m between which planes cut the wall all around, from its vertices' z."""
    margin = END_TOLERANCE * np.ptp(undeformed)
    first, last = undeformed < undeformed.min() + margin, undeformed > undeformed.max() - margin
    return float(deformed[first].max()), float(deformed[last].min())


@checked(
    vertices=Reals(-1e6, 1e6, "m", ndim=2, last=3),
    triangles=Reals(0, 2**53, ndim=2, last=3, kinds="iu"),
    z=Reals(-1e6, 1e6, "m", ndim=1, empty=True),
)
def profile(vertices: Array, triangles: Index, z: Array, *, halved: bool = False) -> Profile:
    """Measure the cross-sections of a tube-like surface in planes z = const.

    Parameters
    ----------
    vertices : array of shape (n_vertices, 3)
        Coordinates (x, y, z) in m.
    triangles : array of int, shape (n_triangles, 3)
        Vertex numbers from 0, of consistently oriented triangles.
    z : array of shape (n,)
        Positions of the planes, in m.
    halved : bool
        True if the surface is the half x >= 0 of a symmetric one; the whole section is measured.

    Returns
    -------
    Profile
        With zeros where a plane does not meet the surface.

    Raises
    ------
    ConfigError
        If a vertex number is too large, or an array has another shape or is not finite.

    Notes
    -----
    By Green's theorem the area is half the sum of ``x dy - y dx`` over the segments in which the
    plane cuts the triangles (the shoelace formula). The order of the segments does not matter, and
    the closing line x = 0 of a half contributes nothing.
    """
    if np.size(triangles) and np.max(triangles) >= len(vertices):
        raise ConfigError(
            f"triangles name vertex {np.max(triangles)}, and vertices has {len(vertices)} rows; "
            "number them from 0"
        )
    vertices, triangles, z = np.asarray(vertices), np.asarray(triangles), np.asarray(z, float)
    plane, start, end = _segments(vertices, triangles, z)
    cross = start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]
    area = 0.5 * np.abs(np.bincount(plane, cross, minlength=z.size))
    x = np.concatenate([start[:, 0], end[:, 0]])
    left, right = _extent(np.tile(plane, 2), x, z.size)
    middle = start[:, 0] * end[:, 0] <= 0
    run = np.where(middle, end[:, 0] - start[:, 0], 1.0)
    fraction = np.divide(-start[:, 0], run, out=np.zeros_like(run), where=run != 0)
    y = start[:, 1] + fraction * (end[:, 1] - start[:, 1])
    bottom, top = _extent(plane[middle], y[middle], z.size)
    return Profile(
        z=z,
        area=2 * area if halved else area,
        height=top - bottom,
        width=2 * right if halved else right - left,
    )


def _segments(vertices: Array, triangles: Index, z: Array) -> tuple[Index, Array, Array]:
    """Return the segments in which planes cut triangles: plane number, start and end (n, 2).

    A corner in the plane counts as below it.
    """
    order = np.argsort(z, kind="stable")
    heights = vertices[triangles, 2]
    first = np.searchsorted(z[order], heights.min(axis=1), side="left")
    count = np.searchsorted(z[order], heights.max(axis=1), side="left") - first
    which = np.repeat(np.arange(len(triangles)), count)
    within = np.arange(which.size) - np.repeat(np.cumsum(count) - count, count)
    plane = order[np.repeat(first, count) + within]
    corners = vertices[triangles[which]]
    below = corners[..., 2] <= z[plane, None]
    lone_below = below.sum(axis=1) == 1
    lone = np.argmax(below == lone_below[:, None], axis=1)
    turned = np.take_along_axis(corners, (lone[:, None] + np.arange(3))[..., None] % 3, axis=1)
    ahead, behind = (_crossing(turned[:, 0], turned[:, i], z[plane]) for i in (1, 2))
    forwards = lone_below[:, None]
    return plane, np.where(forwards, ahead, behind), np.where(forwards, behind, ahead)


def _crossing(a: Array, b: Array, z: Array) -> Array:
    """Return the points (x, y) at which the lines from a to b cross the heights z."""
    fraction = (z - a[:, 2]) / (b[:, 2] - a[:, 2])
    return a[:, :2] + fraction[:, None] * (b - a)[:, :2]


def _extent(plane: Index, values: Array, n: int) -> tuple[Array, Array]:
    """Return the smallest and largest value in each of n planes; zeros in planes without values."""
    low, high = np.full(n, np.inf), np.full(n, -np.inf)
    np.minimum.at(low, plane, values)
    np.maximum.at(high, plane, values)
    met = high >= low
    return np.where(met, low, 0.0), np.where(met, high, 0.0)
