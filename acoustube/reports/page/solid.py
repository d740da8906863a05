"""Surfaces of the finite-element mesh of a tube's wall, for a page."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from acoustube.base.types import Array, Index
from acoustube.indentation.mesh import Mesh
from acoustube.indentation.reference_element import HEX20, TET10, Reference, edges
from acoustube.indentation.self_contact import triangulated
from acoustube.lumen import TRIANGLES_PER_EDGE, profile
from acoustube.reports.page.shapes import Shape

PLANE_TOLERANCE = 1e-6
"""Distance from a plane up to which a node counts as in it, relative to the mesh's length."""
FACE_SUBDIVISIONS = 3
"""Number of drawn triangles along each edge of an element's face."""
SECTION_OFFSET = 1e-7
"""Axial position in m of the section at the press; not zero, since nodes lie exactly in z = 0."""


class Solid:
    """The walls of a tube that is modelled by finite elements, for any displacement of its nodes.

    Parameters
    ----------
    nodes : array of shape (n_nodes, 3)
        Nodes of the modelled part in m: the whole tube, or the part with x >= 0, z >= 0 or both.
    elements : array of shape (n_elements, 20 or 10)
        Node numbers of hexahedra (20) or tetrahedra (10).
    """

    def __init__(self, nodes: Array, elements: Index) -> None:
        self.nodes = nodes
        size = float(np.ptp(nodes, axis=0).max())
        low = nodes.min(axis=0)
        self.halved = bool(low[0] > -PLANE_TOLERANCE * size), bool(low[2] > -PLANE_TOLERANCE * size)
        self._find_faces(elements, PLANE_TOLERANCE * size)

    def _find_faces(self, elements: Index, flat: float) -> None:
        """Sort the faces into inner wall, outer wall and cut; `flat` is a tolerance in m.

        The cut is the section at x = 0 with the ends of the tube, where x >= 0.
        """
        reference = HEX20 if elements.shape[1] == len(HEX20.nodes) else TET10
        local = faces_of(reference)
        faces, owner = elements[:, local].reshape(-1, local.shape[1]), np.arange(len(elements))
        owner = np.repeat(owner, len(local))
        shown = np.full(len(elements), True)
        if not self.halved[0]:
            shown = self.nodes[elements].mean(axis=1)[:, 0] > 0
        part = self._parts(faces[_single(faces)], flat)
        name = np.full(len(faces), "", dtype="U5")
        name[_single(faces)] = part
        kept = np.flatnonzero(shown[owner])
        cut = kept[_single(faces[kept])]
        name[cut[(name[cut] == "") | (name[cut] == "flat")]] = "cut"
        mesh = Mesh(
            self.nodes, elements, faces[:0], faces[:0], reference=reference, halved=self.halved
        )
        middle = self.nodes[elements].mean(axis=1)
        self.walls = {
            wall: _surface(
                mesh, faces[name == wall], middle[owner[name == wall]], FACE_SUBDIVISIONS
            )
            for wall in ("inner", "outer", "cut")
        }
        inner = name == "inner"
        self.lumen = _surface(mesh, faces[inner], middle[owner[inner]], TRIANGLES_PER_EDGE)
        self.shown = {wall: shown[owner[name == wall]] for wall in self.walls}

    def _parts(self, faces: Index, flat: float) -> Any:
        """Return the kind of each boundary face: ``inner``, ``outer``, ``flat`` or ``none``.

        Flat faces are the plane x = 0 and the ends; ``none`` is the symmetry plane z = 0. Faces of
        the inner and of the outer wall share no node.
        """
        z, x = self.nodes[faces][..., 2], self.nodes[faces][..., 0]
        mirror = np.full(len(faces), False)
        for halved, at in zip(self.halved, (x, z), strict=True):
            mirror |= halved & (np.abs(at) < flat).all(axis=1)
        top, bottom = (np.abs(z - end) < 1e3 * flat for end in (z.max(), z.min()))
        end = (top.all(axis=1) | bottom.all(axis=1)) & ~mirror
        wall = ~mirror & ~end
        n, (a, b) = len(self.nodes), (faces[wall][:, :-1].ravel(), faces[wall][:, 1:].ravel())
        links = sparse.coo_array((np.ones(a.size), (a, b)), shape=(n, n))
        label = connected_components(links, directed=False)[1][faces[wall][:, 0]]
        width = {c: np.ptp(self.nodes[faces[wall][label == c]][..., 1]) for c in np.unique(label)}
        part = np.full(len(faces), "flat", dtype="U5")
        part[wall] = np.where(label == min(width, key=lambda c: width[c]), "inner", "outer")
        # The plane x = 0 and the ends are cut open; the plane z = 0 is inside the tube.
        inside = self.halved[1] & (np.abs(z) < flat).all(axis=1)
        part[inside] = "none"
        return part

    def shape(self, displacement: Array) -> Shape:
        """Return the shape of the tube for displacements of its nodes in m, (n_nodes, 3)."""
        position = self.nodes + displacement
        points, faces, count = [], {}, 0
        for wall, (sampling, triangles) in self.walls.items():
            here, drawn = self._whole(sampling, position, self._drawn(wall, triangles))
            points.append(here)
            faces[wall] = drawn + count
            count += len(here)
        outlines = [self._outline(wall, position) for wall in ("inner", "outer")]
        return Shape(np.concatenate(points), faces, *outlines)

    def outer_wall(self, displacement: Array) -> Array:
        """Return points (n, 3) in m of the outer wall, of one half if that alone is modelled.

        `displacement` is that of the nodes in m, (n_nodes, 3).
        """
        sampling, _ = self.walls["outer"]
        return np.asarray(sampling @ (self.nodes + displacement))

    def area(self, displacement: Array, z: Array) -> Array:
        """Return the lumen's cross-section in m2 at positions z in m from the press, (n,).

        `displacement` is that of the nodes in m, (n_nodes, 3).
        """
        sampling, triangles = self.lumen
        at = np.abs(z) if self.halved[1] else z
        position = sampling @ (self.nodes + displacement)
        return profile(position, triangles, at, halved=self.halved[0]).area

    def _drawn(self, wall: str, triangles: Index) -> Index:
        per_face = len(triangles) // len(self.shown[wall])
        return triangles[np.repeat(self.shown[wall], per_face)]

    def _whole(self, sampling: Any, position: Array, triangles: Index) -> tuple[Array, Index]:
        """Return points and triangles of a surface; half a tube gets its mirror image in z = 0."""
        points = np.asarray(sampling @ position)
        if not self.halved[1]:
            return points, triangles
        # Points in the plane z = 0 are their own mirror images.
        own = np.abs(sampling @ self.nodes)[:, 2] < SECTION_OFFSET
        image = np.where(own, np.arange(len(points)), np.arange(len(points)) + len(points))
        mirrored = image[triangles[:, ::-1]]
        return np.concatenate([points, points * [1, 1, -1]]), np.concatenate([triangles, mirrored])

    def _outline(self, wall: str, position: Array) -> Array:
        """Return the closed outline (n, 2) in m of a wall's section at the press."""
        import pyvista

        sampling, triangles = self.walls[wall]
        points, faces = sampling @ position, triangles.astype(int)
        surface: Any = pyvista.PolyData.from_regular_faces(points, faces)
        path = surface.slice(normal="z", origin=(0, 0, SECTION_OFFSET)).strip(
            join=True, max_length=10_000
        )
        line = max(path.cell, key=lambda cell: cell.n_points).points[:, :2]
        return np.concatenate([line, line[::-1] * [-1, 1]]) if self.halved[0] else line


def faces_of(reference: Reference) -> Index:
    """Return the local node numbers of an element's faces, (n_faces, n_face_nodes).

    The nodes of each face are in the order of the face's reference element.
    """
    if reference is HEX20:
        sides = [(axis, side) for axis in range(3) for side in (-1, 1)]
        return np.array([np.flatnonzero(reference.nodes[:, a] == s) for a, s in sides])
    middle = {pair: 4 + i for i, pair in enumerate(edges(3))}
    corners = combinations(range(4), 3)
    return np.array([[*c, *(middle[pair] for pair in combinations(c, 2))] for c in corners])


def _single(faces: Index) -> NDArray[np.bool_]:
    """Return the mask of the faces on the boundary, which belong to one element only."""
    _, which, count = np.unique(
        np.sort(faces, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    return np.asarray(count[which.ravel()] == 1)


def _surface(mesh: Mesh, faces: Index, middle: Array, parts: int) -> tuple[Any, Index]:
    """Return the matrix from nodes to points on faces, and the triangles of these points.

    Normals point away from the middles (n, 3) of the elements with these faces. `parts` is the
    number of triangles along each edge of a face.
    """
    sampling, triangles = triangulated(mesh, faces, parts)
    points = (sampling @ mesh.points)[triangles]
    normal = np.cross(points[:, 1] - points[:, 0], points[:, 2] - points[:, 0])
    away = points.mean(axis=1) - np.repeat(middle, len(triangles) // len(faces), axis=0)
    inwards = np.sum(normal * away, axis=1) < 0
    return sampling, np.where(inwards[:, None], triangles[:, ::-1], triangles)
