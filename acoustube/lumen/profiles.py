"""Height, width and area of the lumen along the tube."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from acoustube.base.types import Array, Index
from acoustube.indentation import Indentation, Mesh
from acoustube.indentation.self_contact import triangulated

TRIANGLES_PER_EDGE = 8
"""Of an element's face, where sections are measured."""


@dataclass(frozen=True, eq=False)
class Profile:
    """The lumen's cross-section along the tube; every array has shape (n,).

    Parameters
    ----------
    z : array
        Distance from the source end in m.
    area : array
        In m2.
    height : array
        Distance in m from the bottom to the top of the section at x = 0.
    width : array
        Greatest extent across, in m.
    """

    z: Array
    area: Array
    height: Array
    width: Array


def inner_wall(mesh: Mesh) -> tuple[Any, Index]:
    """Return the sampling and the triangles with which sections of a lumen are measured."""
    return triangulated(mesh, parts=TRIANGLES_PER_EDGE)


def measure(
    indentation: Indentation,
    increment: int,
    z: Array,
    wall: tuple[Any, Index] | None = None,
) -> Profile:
    """Measure the lumen of the whole tube across planes z = const of the pressed part.

    Parameters
    ----------
    indentation : Indentation
    increment : int
    z : array of shape (n,)
        Deformed axial positions in m, the middle of the modelled part at zero.
    wall : optional
        What :func:`inner_wall` returned, so that it need not be formed for every increment.

    Returns
    -------
    Profile
    """
    mesh = indentation.mesh
    sampling, triangles = wall or inner_wall(mesh)
    seen = np.abs(z) if mesh.halved[1] else z
    vertices = sampling @ indentation.position(increment)
    found = profile(vertices, triangles, seen, halved=mesh.halved[0])
    return dataclasses.replace(found, z=np.asarray(z, float))


def profile(vertices: Array, triangles: Index, z: Array, *, halved: bool = False) -> Profile:
    """Cut a tube-like surface by the planes z = const and measure the sections.

    Parameters
    ----------
    vertices : array of shape (n_vertices, 3)
        In m.
    triangles : array of shape (n_triangles, 3)
        Consistently oriented.
    z : array of shape (n,)
        Where to cut, in m.
    halved : bool
        Whether the surface is the half x >= 0 of a symmetric one, which is measured.

    Returns
    -------
    Profile
        Zero where a plane does not meet the surface.

    Notes
    -----
    The area is half the sum of ``x dy - y dx`` over the segments in which the plane cuts the
    triangles, so that neither their order nor the closing line x = 0 of a half matters.
    """
    z = np.asarray(z, float)
    plane, start, end = _segments(vertices, triangles, z)
    cross = start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]
    area = 0.5 * np.abs(np.bincount(plane, cross, minlength=z.size))
    x = np.concatenate([start[:, 0], end[:, 0]])
    left, right = _extent(np.tile(plane, 2), x, z.size)
    middle = start[:, 0] * end[:, 0] <= 0
    run = np.where(middle, end[:, 0] - start[:, 0], 1.0)
    share = np.divide(-start[:, 0], run, out=np.zeros_like(run), where=run != 0)
    y = start[:, 1] + share * (end[:, 1] - start[:, 1])
    bottom, top = _extent(plane[middle], y[middle], z.size)
    return Profile(
        z=z,
        area=2 * area if halved else area,
        height=top - bottom,
        width=2 * right if halved else right - left,
    )


def _segments(vertices: Array, triangles: Index, z: Array) -> tuple[Index, Array, Array]:
    """Return where planes cut triangles: number of the plane, start and end (n, 2) in it.

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
    """Return where the lines from a to b pass z, as (x, y)."""
    share = (z - a[:, 2]) / (b[:, 2] - a[:, 2])
    return a[:, :2] + share[:, None] * (b - a)[:, :2]


def _extent(plane: Index, values: Array, n: int) -> tuple[Array, Array]:
    """Return the least and the greatest of the values in each of n planes, zero where none is."""
    low, high = np.full(n, np.inf), np.full(n, -np.inf)
    np.minimum.at(low, plane, values)
    np.maximum.at(high, plane, values)
    met = high >= low
    return np.where(met, low, 0.0), np.where(met, high, 0.0)
