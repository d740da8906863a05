"""Quadratic nodes of a tetrahedral mesh on the wall's surface and symmetry planes."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import trimesh
from scipy import sparse
from scipy.sparse.csgraph import connected_components, reverse_cuthill_mckee

from acoustube.base.errors import ConfigError
from acoustube.base.types import Array, Index, Mask
from acoustube.indentation.mesh import Mesh
from acoustube.indentation.reference_element import TET10, edges
from acoustube.indentation.wall_surface import Walls, closest

ENVELOPE = 1 / 25
"""How far the linear tetrahedra may leave the surface, in wall thicknesses.

Their corners are put back onto it; a narrow envelope only forces small elements around the bore."""
LEAST_JACOBIAN = 0.2
"""Least Jacobian anywhere in an element with curved sides, as a share of the straight one's."""
THERE = 1e-3
"""How far a node that is on a wall or plane may be off it, in wall thicknesses."""
ACROSS = 0.7
"""Least cosine between the normals of a plane and of a face that lies in it."""
SETTLING_ROUNDS = 3
"""Times that a node where a wall meets a plane is put onto the one and into the other."""

_CORNERS = np.array(list(itertools.combinations(range(4), 3)))
_FACES = np.array(
    [[*face, *(4 + edges(3).index((face[i], face[j])) for i, j in edges(2))] for face in _CORNERS]
)
"""Local nodes of a tetrahedron's four faces, each in the order of the face's own nodes."""
FLIPPED = np.array([0, 2, 1, 4, 3, 5])
"""A face's nodes in the order that turns its normal around."""


# ---------------------------------------------------------------------------------------------
# The mesh


class Plane(NamedTuple):
    """A plane across an axis (0 for x, 2 for z) that bounds the piece; it lies on `side` of it."""

    axis: int
    value: float
    side: int


def quadratic(
    points: Array,
    tetrahedra: Index,
    planes: Sequence[Plane],
    whole: Walls,
    halved: tuple[bool, bool],
) -> tuple[Mesh, float]:
    """Make linear tetrahedra quadratic, their boundary on the walls and planes of the piece.

    The second value is the larger share of a wall's nodes that could not be put onto it, or one
    where a node could not be put into its plane.
    """
    pairs, middle = _middles(tetrahedra, len(points))
    elements = np.hstack([tetrahedra, middle])
    straight = np.concatenate([points, points[pairs].mean(axis=1)])
    faces = _boundary(elements, straight)
    in_plane = _faces_in_planes(straight[faces], planes, 2 * ENVELOPE * whole.thickness)
    inner, outer = _separated(faces[~in_plane.any(axis=0)], straight)
    snapped = [
        (plane, np.unique(faces[mask])) for plane, mask in zip(planes, in_plane, strict=True)
    ]
    bounds = [(whole.inner, np.unique(inner)), (whole.outer, np.unique(outer))]
    n = len(points)
    corners = _settled(straight, bounds, snapped)[:n]
    start = _in_planes(straight, snapped)[:n]
    corners = _sound(start, corners, tetrahedra)
    straight = np.concatenate([corners, corners[pairs].mean(axis=1)])
    target = _settled(straight, bounds, snapped)
    settled = target.copy()
    settled[:n] = corners
    curved = _sound(straight, settled, elements)
    off = np.linalg.norm(curved - target, axis=1) > THERE * whole.thickness
    across = any(off[nodes].any() for _, nodes in snapped)
    astray = 1.0 if across else max(float(np.mean(off[nodes])) for _, nodes in bounds)
    order = _order(elements, curved)
    number = np.argsort(order)
    mesh = Mesh(
        points=curved[order],
        elements=number[elements],
        inner_faces=number[inner[:, FLIPPED]],
        outer_faces=number[outer],
        reference=TET10,
        halved=halved,
    )
    return mesh, astray


def _middles(tetrahedra: Index, n_points: int) -> tuple[Index, Index]:
    """Return every edge's two ends, and the numbers (n_tetrahedra, 6) of their middle nodes."""
    ends = np.sort(tetrahedra[:, edges(3)].reshape(-1, 2), axis=1)
    pairs, number = np.unique(ends, axis=0, return_inverse=True)
    return pairs, n_points + number.reshape(-1, 6)


def _boundary(elements: Index, points: Array) -> Index:
    """Return the nodes of the faces that one element only has, their normals outwards."""
    faces = elements[:, _FACES].reshape(-1, 6)
    _, first, count = np.unique(
        np.sort(faces[:, :3], axis=1), axis=0, return_index=True, return_counts=True
    )
    alone = first[count == 1]
    a, b, c = np.moveaxis(points[faces[alone, :3]], 1, 0)
    centre = points[elements[alone // 4, :4]].mean(axis=1)
    inwards = np.sum(np.cross(b - a, c - a) * (centre - a), axis=1) > 0
    return np.where(inwards[:, None], faces[alone][:, FLIPPED], faces[alone])


def _faces_in_planes(faces: Array, planes: Sequence[Plane], tolerance: float) -> Mask:
    """Return which faces (n_faces, 6, 3) lie in which plane, shape (n_planes, n_faces)."""
    a, b, c = np.moveaxis(faces[:, :3], 1, 0)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.array(
        [
            np.all(np.abs(faces[..., plane.axis] - plane.value) < tolerance, axis=1)
            & (np.abs(normal[:, plane.axis]) > ACROSS)
            for plane in planes
        ]
    )


def _separated(faces: Index, points: Array) -> tuple[Index, Index]:
    """Return the faces of the inner and of the outer wall: the connected parts of the sides."""
    which = np.repeat(np.arange(len(faces)), 3)
    ones = np.ones(len(which))
    beside = sparse.csr_array((ones, (which, faces[:, 3:].ravel())))
    n, part = connected_components(beside @ beside.T, directed=False)
    if n != 2:
        raise ConfigError(
            f"The meshed wall has {n} separate sides, not an inner and an outer one; repair thin "
            "or damaged places of the surface, or ask for shorter edges."
        )
    outer = part[np.argmax(points[faces, 1].max(axis=1))]
    return faces[part != outer], faces[part == outer]


def _settled(
    points: Array,
    bounds: Sequence[tuple[trimesh.Trimesh, Index]],
    snapped: Sequence[tuple[Plane, Index]],
) -> Array:
    """Return the nodes with those of walls on their wall, and those of planes in their plane."""
    for _ in range(SETTLING_ROUNDS):
        points = points.copy()
        for wall, nodes in bounds:
            points[nodes] = closest(wall, points[nodes])
        points = _in_planes(points, snapped)
    return points


def _in_planes(points: Array, snapped: Sequence[tuple[Plane, Index]]) -> Array:
    points = points.copy()
    for plane, nodes in snapped:
        points[nodes, plane.axis] = plane.value
    return points


def _sound(start: Array, target: Array, elements: Index) -> Array:
    """Move nodes from start to target, except those of elements that it would badly distort.

    Elements that are flat at the start stay so; `_qualities` tells.
    """
    least = LEAST_JACOBIAN * jacobians(start, elements[:, :4])[:, 0]
    moved = target.copy()
    while np.any(bad := jacobians(moved, elements).min(axis=1) < least):
        nodes = np.unique(elements[bad])
        if np.array_equal(moved[nodes], start[nodes]):
            break
        moved[nodes] = start[nodes]
    return moved


def jacobians(points: Array, elements: Index) -> Array:
    """Return the Jacobian (n_elements, n_points) at nodes and points, or of linear ones."""
    if elements.shape[1] == 4:
        sides = points[elements[:, 1:]] - points[elements[:, :1]]
        return np.linalg.det(sides)[:, None]
    slopes = TET10.shape_functions(np.concatenate([TET10.nodes, TET10.points]))[1]
    return np.linalg.det(np.einsum("eni,qnj->eqij", points[elements], slopes))


def _order(elements: Index, points: Array) -> Index:
    """Return the nodes in an order that keeps the stiffness matrix a narrow band."""
    n = elements.shape[1]
    rows, columns = np.repeat(elements, n, axis=1).ravel(), np.tile(elements, n).ravel()
    graph = sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=(len(points),) * 2)
    return reverse_cuthill_mckee(graph, symmetric_mode=True).astype(np.int64)
