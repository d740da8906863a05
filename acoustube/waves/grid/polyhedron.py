"""Exact volume and face fractions of Cartesian cells inside a closed polyhedron.

The triangles are cut along all grid planes, so that every piece belongs to one cell. By the
divergence theorem the vector area of a closed surface vanishes, so the open area of a cell's lower
face follows from that of its upper face and the pieces between them, and the volume from the
pieces' moments. The fractions are exact to rounding.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.floating[Any]]
Indices = NDArray[np.int64]

ROUNDING = 1e-12
"""Fraction below which a cell or face counts as closed, due to rounding of cumulative sums."""
SNAP = 1e-10
"""Distance from a grid plane, in cells, within which vertices are moved onto it."""
BATCH = 50_000
"""Number of triangle parts that are clipped at once, so that they stay in the processor's cache."""


class Fractions(NamedTuple):
    """Open fractions of cells (nx, ny, nz) and of faces (one more along the face's normal)."""

    volume: Array
    open_x: Array
    open_y: Array
    open_z: Array


def cut_polyhedron(
    triangles: ArrayLike, origin: ArrayLike, spacing: ArrayLike, shape: tuple[int, int, int]
) -> Fractions:
    """Return the exact fractions of a grid's cells inside a closed polyhedron.

    Parameters
    ----------
    triangles : (n, 3, 3) array_like
        Outward-oriented triangles in m (triangle, vertex, coordinate).
    origin : (3,) array_like
        Lower corner of the first cell in m.
    spacing : (3,) array_like
        Cell size in m.
    shape : tuple of int
        Number of cells. The grid must enclose the polyhedron, except towards low x: the part there
        is cut off, and the first x faces then have the open area of the cut.

    Returns
    -------
    Fractions
        Volume and open-face fractions in [0, 1].

    Raises
    ------
    ValueError
        If a fraction lies outside [0, 1], or a piece of the surface belongs to no cell: the surface
        is open, folds through itself or extends beyond the grid.

    Notes
    -----
    With a_i the x component of the vector area of the wall inside cell i and m_i its first
    moment about the cell's lower x face, both in grid units, the divergence theorem gives the open
    area of that face, open_i = open_{i+1} + a_i, and the volume V_i = open_{i+1} + m_i. The areas
    of y and z faces follow likewise.
    """
    grid = (np.asarray(triangles, dtype=float) - np.asarray(origin)) / np.asarray(spacing)
    nearest = np.rint(grid)
    pieces = np.where(np.abs(grid - nearest) < SNAP, nearest, grid)
    x = pieces[:, :, 0]
    pieces = pieces[(x > 0.0).any(axis=1) | (x == 0.0).all(axis=1)]
    for axis in range(3):
        pieces = _split_at_planes(pieces, axis)
    area = 0.5 * twice_area(pieces)
    pieces, area = (part[np.any(area != 0.0, axis=1)] for part in (pieces, area))
    cell = _owning_cell(pieces, area)
    inside = cell[:, 0] >= 0
    pieces, area, cell = pieces[inside], area[inside], cell[inside]
    if np.any((cell < 0) | (cell >= shape)):
        raise ValueError("the surface folds through itself in a plane of the grid; repair it first")
    flat = np.ravel_multi_index(tuple(cell.T), shape)
    walls = [_per_cell(flat, area[:, axis], shape) for axis in range(3)]
    faces = [_accumulate_from_above(wall, axis) for axis, wall in enumerate(walls)]
    offset = pieces[:, :, 0].mean(axis=1) - cell[:, 0]
    volume = faces[0][1:] + _per_cell(flat, area[:, 0] * offset, shape)
    return Fractions(*(_clean(part) for part in (volume, *faces)))


def _split_at_planes(triangles: Array, axis: int) -> Array:
    """Return the triangles cut along the integer planes of an axis."""
    along = triangles[:, :, axis]
    first = np.floor(along.min(axis=1))
    slabs = (np.ceil(along.max(axis=1)) - first).astype(np.int64)
    owner = np.repeat(np.arange(len(triangles)), np.where(slabs > 1, slabs, 0))
    if not len(owner):
        return triangles
    start = np.concatenate([[True], owner[1:] != owner[:-1]])
    position = np.arange(len(owner))
    lower = first[owner] + position - np.maximum.accumulate(np.where(start, position, 0))
    parts = [_clip(triangles[some], low, axis) for some, low in _batches(owner, lower)]
    return np.concatenate([triangles[slabs <= 1], *parts])


def _batches(owner: Indices, lower: Array) -> Iterator[tuple[Indices, Array]]:
    """Iterate over triangle numbers and the lower planes of their slabs in batches."""
    for begin in range(0, len(owner), BATCH):
        yield owner[begin : begin + BATCH], lower[begin : begin + BATCH]


def _clip(triangles: Array, lower: Array, axis: int) -> Array:
    """Return the parts of triangles between two planes, lower and lower + 1, as triangles.

    With the corners sorted along the axis, the part is the polygon between the long edge
    bottom-top and the chain bottom-middle-top. It is divided into a fan of triangles.
    """
    order = np.argsort(triangles[:, :, axis], axis=1)
    corners = np.take_along_axis(triangles, order[:, :, None], axis=1)
    bottom, middle, top = corners.transpose(1, 0, 2)
    low = np.maximum(lower, bottom[:, axis])
    high = np.minimum(lower + 1.0, top[:, axis])
    left_low, left_high = (_point(bottom, top, s, axis) for s in (low, high))
    right_low, right_high = (_chain(bottom, middle, top, s, axis) for s in (low, high))
    bend = _chain(bottom, middle, top, np.clip(middle[:, axis], low, high), axis)
    within = (middle[:, axis] >= low) & (middle[:, axis] <= high)
    bend = np.where(within[:, None], middle, bend)
    fan = [(right_low, bend), (bend, right_high), (right_high, left_high)]
    odd = (order[:, 1] - order[:, 0]) % 3 == 2
    parts = np.concatenate([_oriented(left_low, p, q, odd) for p, q in fan])
    # Parts without area, from corners on a plane, contribute nothing.
    return parts[np.any(twice_area(parts) != 0.0, axis=1)]


def _oriented(a: Array, b: Array, c: Array, odd: NDArray[np.bool_]) -> Array:
    """Return triangles, with corners b and c exchanged where sorting reversed the orientation."""
    flip = odd[:, None]
    return np.stack([a, np.where(flip, c, b), np.where(flip, b, c)], axis=1)


def _chain(bottom: Array, middle: Array, top: Array, height: Array, axis: int) -> Array:
    """Return the point at a height on the two shorter edges, bottom-middle and middle-top."""
    upper = (height > middle[:, axis])[:, None]
    start, end = np.where(upper, middle, bottom), np.where(upper, top, middle)
    return _point(start, end, height, axis)


def _point(start: Array, end: Array, height: Array, axis: int) -> Array:
    """Return the point of an edge at a height; it lies exactly in the plane despite rounding."""
    rise = end[:, axis] - start[:, axis]
    ratio = (height - start[:, axis]) / np.where(rise > 0.0, rise, 1.0)
    point = start + ratio[:, None] * (end - start)
    point = np.where((height == end[:, axis])[:, None] & (rise > 0.0)[:, None], end, point)
    point[:, axis] = height
    return point


def twice_area(triangles: Array) -> Array:
    """Return twice the vector areas of triangles, (n, 3); numpy.cross is slower."""
    (ux, uy, uz), (vx, vy, vz) = (
        (triangles[:, i] - triangles[:, 0]).T for i in (1, 2)
    )  # fmt: skip
    return np.stack([uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx], axis=1)


def _owning_cell(pieces: Array, area: Array) -> Indices:
    """Return the cell of each piece; for a piece in a grid plane, that on the lumen's side."""
    cell = np.floor(pieces.mean(axis=1)).astype(np.int64)
    plane = pieces[:, 0]
    flat = np.all(pieces == plane[:, None], axis=1) & (plane == np.rint(plane))
    owner: Indices = np.where(flat, plane.astype(np.int64) - (area > 0.0), cell)
    return owner


def _per_cell(flat: Indices, value: Array, shape: tuple[int, int, int]) -> Array:
    """Sum the pieces' values into their cells."""
    total = np.bincount(flat, value, minlength=int(np.prod(shape)))
    return total.astype(float).reshape(shape)


def _accumulate_from_above(wall: Array, axis: int) -> Array:
    """Return the open areas of the faces along an axis, summed from the closed upper end."""
    closed = np.zeros_like(np.take(wall, [0], axis=axis))
    padded = np.concatenate([wall, closed], axis=axis)
    return np.flip(np.cumsum(np.flip(padded, axis), axis=axis), axis)


def _clean(fraction: Array) -> Array:
    """Return fractions without rounding noise, validated to lie in [0, 1]."""
    if fraction.min() < -1e-6 or fraction.max() > 1.0 + 1e-6:
        raise ValueError(
            f"cell fractions reach [{fraction.min():.3g}, {fraction.max():.3g}] instead of "
            "[0, 1]: the surface is open or folds through itself; repair it first"
        )
    return np.where(fraction < ROUNDING, 0.0, np.minimum(fraction, 1.0))
