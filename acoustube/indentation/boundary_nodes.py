"""Quadratic tetrahedra from linear ones: boundary nodes on the wall's surface and in planes.

Mid-edge nodes are added. The nodes of both walls are moved to the closest points of the surface,
and those of symmetry planes and ends into their plane. Nodes whose element would be distorted too
much stay off the surface.
"""

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
"""Largest distance of the boundary of the linear tetrahedra from the wall, in wall thicknesses.

The nodes of the boundary are then projected onto the wall; a narrower envelope only forces small
elements at the bore."""
MIN_JACOBIAN_RATIO = 0.2
"""Smallest allowed ratio of an element's Jacobian determinant after moving nodes to that before."""
ON_SURFACE = 1e-3
"""Largest distance at which a node counts as lying on a wall or plane, in wall thicknesses."""
MIN_NORMAL_COSINE = 0.7
"""Smallest cosine between the normals of a plane and of a face that lies in it."""
PROJECTION_ROUNDS = 3
"""Number of alternating projections onto wall and plane, for nodes where the two meet."""

_CORNERS = np.array(list(itertools.combinations(range(4), 3)))
TETRAHEDRON_FACES = np.array(
    [[*face, *(4 + edges(3).index((face[i], face[j])) for i, j in edges(2))] for face in _CORNERS]
)
"""Local nodes of a tetrahedron's faces, (4, 6): a row has the corners, then the mid-edge nodes."""
REVERSED_FACE = np.array([0, 2, 1, 4, 3, 5])
"""Order of a face's six nodes that reverses its normal."""


class Plane(NamedTuple):
    """A plane that bounds the meshed piece of the wall.

    Attributes
    ----------
    axis : int
        Axis of its normal: 0 for x, 2 for z.
    value : float
        Its coordinate on that axis, in m.
    side : int
        +1 if the piece is at larger coordinates, -1 if at smaller.
    """

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
    """Make linear tetrahedra quadratic, with the boundary on the walls and planes of the piece.

    Parameters
    ----------
    points : array of shape (n_points, 3)
        In m.
    tetrahedra : array of int, shape (n_tetrahedra, 4)
        Node numbers of the corners.
    planes : sequence of Plane
        Symmetry planes and ends of the piece.
    whole : Walls
        Surfaces of the inner and the outer wall.
    halved : tuple of bool
        Whether x = 0, and whether z = 0, is a symmetry plane of the piece.

    Returns
    -------
    mesh : Mesh
    off_surface : float
        Fraction of a wall's nodes that could not be moved onto the wall (the larger fraction of
        the two walls), or one if a node could not be moved into its plane.

    Raises
    ------
    ConfigError
        If the mesh does not have one inner and one outer wall.
    """
    pairs, middle = _mid_edge_nodes(tetrahedra, len(points))
    elements = np.hstack([tetrahedra, middle])
    straight = np.concatenate([points, points[pairs].mean(axis=1)])
    faces = boundary_faces(elements, straight)
    in_plane = _faces_in_planes(straight[faces], planes, 2 * ENVELOPE * whole.thickness)
    inner, outer = _inner_and_outer(faces[~in_plane.any(axis=0)], straight)
    snapped = [
        (plane, np.unique(faces[mask])) for plane, mask in zip(planes, in_plane, strict=True)
    ]
    bounds = [(whole.inner, np.unique(inner)), (whole.outer, np.unique(outer))]
    n = len(points)
    corners = _projected(straight, bounds, snapped)[:n]
    start = _moved_into_planes(straight, snapped)[:n]
    corners = limit_distortion(start, corners, tetrahedra)
    straight = np.concatenate([corners, corners[pairs].mean(axis=1)])
    target = _projected(straight, bounds, snapped)
    with_corners = target.copy()
    with_corners[:n] = corners
    curved = limit_distortion(straight, with_corners, elements)
    off = np.linalg.norm(curved - target, axis=1) > ON_SURFACE * whole.thickness
    off_plane = any(off[nodes].any() for _, nodes in snapped)
    off_surface = 1.0 if off_plane else max(float(np.mean(off[nodes])) for _, nodes in bounds)
    order = _bandwidth_order(elements, curved)
    number = np.argsort(order)
    mesh = Mesh(
        points=curved[order],
        elements=number[elements],
        inner_faces=number[inner[:, REVERSED_FACE]],
        outer_faces=number[outer],
        reference=TET10,
        halved=halved,
    )
    return mesh, off_surface


def _mid_edge_nodes(tetrahedra: Index, n_points: int) -> tuple[Index, Index]:
    """Return node numbers: ends of the edges (n_edges, 2), mid-edge nodes (n_tetrahedra, 6)."""
    ends = np.sort(tetrahedra[:, edges(3)].reshape(-1, 2), axis=1)
    pairs, number = np.unique(ends, axis=0, return_inverse=True)
    return pairs, n_points + number.reshape(-1, 6)


def boundary_faces(elements: Index, points: Array) -> Index:
    """Return the boundary faces of a mesh: those that belong to one element only.

    Parameters
    ----------
    elements : array of int, shape (n_elements, 10)
    points : array of shape (n_nodes, 3)
        In m.

    Returns
    -------
    array of int, shape (n_faces, 6)
        Node numbers, ordered so that the normal points outwards.
    """
    faces = elements[:, TETRAHEDRON_FACES].reshape(-1, 6)
    _, first, count = np.unique(
        np.sort(faces[:, :3], axis=1), axis=0, return_index=True, return_counts=True
    )
    alone = first[count == 1]
    a, b, c = np.moveaxis(points[faces[alone, :3]], 1, 0)
    centre = points[elements[alone // 4, :4]].mean(axis=1)
    inwards = np.sum(np.cross(b - a, c - a) * (centre - a), axis=1) > 0
    return np.where(inwards[:, None], faces[alone][:, REVERSED_FACE], faces[alone])


def _faces_in_planes(faces: Array, planes: Sequence[Plane], tolerance: float) -> Mask:
    """Return the mask (n_planes, n_faces) of the faces (n_faces, 6, 3) that lie in each plane."""
    a, b, c = np.moveaxis(faces[:, :3], 1, 0)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.array(
        [
            np.all(np.abs(faces[..., plane.axis] - plane.value) < tolerance, axis=1)
            & (np.abs(normal[:, plane.axis]) > MIN_NORMAL_COSINE)
            for plane in planes
        ]
    )


def _inner_and_outer(faces: Index, points: Array) -> tuple[Index, Index]:
    """Return the faces of the inner and of the outer wall: the connected parts of the boundary."""
    face = np.repeat(np.arange(len(faces)), 3)
    edges_of = sparse.csr_array((np.ones(len(face)), (face, faces[:, 3:].ravel())))
    n, part = connected_components(edges_of @ edges_of.T, directed=False)
    if n != 2:
        raise ConfigError(
            f"the meshed wall has {n} separate sides, not an inner and an outer one; repair thin "
            "or damaged places of the surface, or choose shorter edges (from Python)"
        )
    outer = part[np.argmax(points[faces, 1].max(axis=1))]
    return faces[part != outer], faces[part == outer]


def _projected(
    points: Array,
    bounds: Sequence[tuple[trimesh.Trimesh, Index]],
    snapped: Sequence[tuple[Plane, Index]],
) -> Array:
    """Return the nodes, projected onto their wall and moved into their plane."""
    for _ in range(PROJECTION_ROUNDS):
        points = points.copy()
        for wall, nodes in bounds:
            points[nodes] = closest(wall, points[nodes])
        points = _moved_into_planes(points, snapped)
    return points


def _moved_into_planes(points: Array, snapped: Sequence[tuple[Plane, Index]]) -> Array:
    points = points.copy()
    for plane, nodes in snapped:
        points[nodes, plane.axis] = plane.value
    return points


def limit_distortion(start: Array, target: Array, elements: Index) -> Array:
    """Move nodes to their targets, except those of elements that would be distorted too much.

    Parameters
    ----------
    start, target : array of shape (n_nodes, 3)
        In m.
    elements : array of int, shape (n_elements, 4 or 10)

    Returns
    -------
    array of shape (n_nodes, 3)
        In m. Elements have at least `MIN_JACOBIAN_RATIO` times their Jacobian determinant at the
        start. Those that are flat at the start stay flat;
        :func:`acoustube.indentation.tetrahedra.qualities` finds them.
    """
    least = MIN_JACOBIAN_RATIO * jacobians(start, elements[:, :4])[:, 0]
    moved = target.copy()
    while np.any(bad := jacobians(moved, elements).min(axis=1) < least):
        nodes = np.unique(elements[bad])
        if np.array_equal(moved[nodes], start[nodes]):
            break
        moved[nodes] = start[nodes]
    return moved


def jacobians(points: Array, elements: Index) -> Array:
    """Return the Jacobian determinants of tetrahedra.

    Parameters
    ----------
    points : array of shape (n_nodes, 3)
        In m.
    elements : array of int, shape (n_elements, 4 or 10)

    Returns
    -------
    array of shape (n_elements, n)
        In m3. For quadratic elements n is 14: at the 10 nodes, then at the 4 quadrature points.
        For linear elements n is 1.
    """
    if elements.shape[1] == 4:
        sides = points[elements[:, 1:]] - points[elements[:, :1]]
        return np.linalg.det(sides)[:, None]
    slopes = TET10.shape_functions(np.concatenate([TET10.nodes, TET10.points]))[1]
    return np.linalg.det(np.einsum("eni,qnj->eqij", points[elements], slopes))


def _bandwidth_order(elements: Index, points: Array) -> Index:
    """Return the reverse Cuthill-McKee order of the nodes [1]_, for a narrow band.

    References
    ----------
    .. [1] E. Cuthill, J. McKee, "Reducing the bandwidth of sparse symmetric matrices", Proc. 24th
       National Conference of the ACM, 157-172 (1969).
    """
    n = elements.shape[1]
    rows, columns = np.repeat(elements, n, axis=1).ravel(), np.tile(elements, n).ravel()
    graph = sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=(len(points),) * 2)
    return reverse_cuthill_mckee(graph, symmetric_mode=True).astype(np.int64)
