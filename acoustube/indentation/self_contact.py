"""Contact of the inner wall with itself: the barrier of incremental potential contact.

The inner wall is sampled by triangles. Where two of them come closer than a small distance, a
barrier that grows to infinity as they meet keeps them apart; a continuous collision check keeps
every Newton step short of a crossing. The method is that of Li et al. [1]_, in the library of its
authors, ``ipctk``.

References
----------
.. [1] M. Li, Z. Ferguson, T. Schneider, T. Langlois, D. Zorin, D. Panozzo, C. Jiang, D. M. Kaufman,
   "Incremental potential contact: intersection- and inversion-free, large-deformation dynamics",
   ACM Trans. Graph. 39, 49 (2020). doi:10.1145/3386569.3392425
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import ipctk
import numpy as np
from scipy import sparse
from scipy.spatial import KDTree

from acoustube.base.types import Array, Index
from acoustube.indentation.mesh import Mesh
from acoustube.indentation.reference_element import QUAD8

PARTS = 4
"""Triangles' edges along the edge of an element's face."""
BARRIER_STIFFNESS = 0.3
"""Of the barrier, in shear moduli."""
REST_STEP = 1e-6
"""Step of the undeformed wall's vertices in a central difference, in the library's unit."""
SAFETY = 0.9
"""Share of the way to the first collision that a step may go."""


@dataclass(frozen=True, eq=False)
class SelfContact:
    """The triangulated inner wall and its barrier.

    Parameters
    ----------
    sampling : sparse array of shape (n_vertices, n_nodes)
        Takes nodal values to the vertices of the triangles.
    faces : array of shape (n_triangles, 3)
    mesh : ipctk.CollisionMesh
        In units of `length`.
    barrier : ipctk.BarrierPotential
    length : float
        Unit of length of the collision library in m, for its tolerances are absolute.
    """

    sampling: Any
    faces: Index
    mesh: Any
    barrier: Any
    length: float

    def _vertices(self, position: Array) -> Array:
        return np.asfortranarray((self.sampling @ position) / self.length)

    def _collisions(self, vertices: Array) -> Any:
        collisions = ipctk.NormalCollisions()
        collisions.use_area_weighting = True
        collisions.collision_set_type = ipctk.NormalCollisions.CollisionSetType.IMPROVED_MAX_APPROX
        collisions.build(self.mesh, vertices, self.barrier.dhat)
        return collisions

    def energy_and_forces(self, position: Array) -> tuple[float, Array]:
        """Return the barrier's energy in J and its gradient (n_nodes, 3) in N."""
        vertices = self._vertices(position)
        collisions = self._collisions(vertices)
        if collisions.empty():
            return 0.0, np.zeros_like(position)
        energy = self.barrier(collisions, self.mesh, vertices) * self.length**3
        gradient = self.barrier.gradient(collisions, self.mesh, vertices) * self.length**2
        return energy, self.sampling.T @ gradient.reshape(-1, 3)

    def tangent(self, position: Array) -> Any:
        """Return the barrier's second derivative, sparse (3 n_nodes, 3 n_nodes), in N/m, or None.

        None where nothing is in contact.
        """
        vertices = self._vertices(position)
        collisions = self._collisions(vertices)
        if collisions.empty():
            return None
        hessian = self.barrier.hessian(collisions, self.mesh, vertices) * self.length
        to_nodes = self._to_nodes()
        return (to_nodes.T @ hessian @ to_nodes).tocsc()

    def forces_along(self, position: Array, moved: Array) -> Array:
        """Return how the forces change, per unit, as the undeformed nodes are moved.

        Parameters
        ----------
        position : array of shape (n_nodes, 3)
            In m. The displacements are fixed, so that it moves along.
        moved : array of shape (n_nodes, 3)
            Motion of the undeformed nodes, in m per unit.

        Returns
        -------
        array of shape (n_nodes, 3)
            In N per unit.

        Notes
        -----
        What the undeformed wall decides, areas and when edges count as parallel, is differentiated
        by central differences: the library's own derivative misses 6e-4 of it in a closed lumen.
        """
        tangent = self.tangent(position)
        if tangent is None:
            return np.zeros_like(position)
        motion = self._vertices(moved)
        step = REST_STEP / np.abs(motion).max(initial=REST_STEP)
        ahead, behind = (
            replace(self, mesh=_collision_mesh(self.mesh.rest_positions + s * motion, self.faces))
            for s in (step, -step)
        )
        of_rest = ahead.energy_and_forces(position)[1] - behind.energy_and_forces(position)[1]
        return (tangent @ moved.ravel()).reshape(-1, 3) + of_rest / (2 * step)

    def _to_nodes(self) -> Any:
        return sparse.kron(self.sampling, sparse.eye_array(3), format="csr")

    def smallest_gap(self, position: Array) -> float:
        """Return the smallest distance in m between the lower and the upper inner wall.

        Of those parts whose undeformed normals are within 30 degrees of the vertical, where a
        lumen that is pressed from above closes first.
        """
        vertices = self.sampling @ position
        lower, upper = self._facing
        away, nearest = KDTree(vertices[upper]).query(vertices[lower])
        across = vertices[upper[nearest]] - vertices[lower]
        normal = np.abs(np.sum(across * vertex_normals(vertices, self.faces)[lower], axis=1))
        # Where the nearest vertex is only beside the nearest point, the point is along the normal.
        beside = np.sqrt(np.maximum(away**2 - normal**2, 0)) < self._spacing
        return float(np.min(np.where(beside, normal, away)))

    @cached_property
    def _facing(self) -> tuple[Index, Index]:
        """Numbers of the vertices of the lower and of the upper wall."""
        normal = vertex_normals(np.asarray(self.mesh.rest_positions), self.faces)
        upright = np.abs(normal[:, 1]) > np.cos(np.pi / 6)
        low = np.asarray(self.mesh.rest_positions)[:, 1]
        is_low = low < (low.min() + low.max()) / 2
        return np.flatnonzero(upright & is_low), np.flatnonzero(upright & ~is_low)

    @cached_property
    def _spacing(self) -> float:
        """Longest distance in m between neighbouring vertices where the mesh is fine."""
        rest = np.asarray(self.mesh.rest_positions)
        sides = rest[self.faces] - rest[np.roll(self.faces, 1, axis=1)]
        return float(np.median(np.linalg.norm(sides, axis=-1).max(axis=1))) * self.length

    def free_share(self, start: Array, end: Array) -> float:
        """Return how far from one position to another no wall meets another, from 0 to 1."""
        before, after = self._vertices(start), self._vertices(end)
        share = ipctk.compute_collision_free_stepsize(self.mesh, before, after)
        return 1.0 if share >= 1 else SAFETY * float(share)


def self_contact(mesh: Mesh, shear_modulus: float, distance: float) -> SelfContact:
    """Prepare the contact of a mesh's inner wall with itself.

    Parameters
    ----------
    mesh : Mesh
    shear_modulus : float
        Of the wall, in Pa.
    distance : float
        Gap in m below which the barrier acts.
    """
    sampling, faces = triangulated(mesh)
    length = 400 * distance
    collision_mesh = _collision_mesh(sampling @ mesh.points / length, faces)
    stiffness = BARRIER_STIFFNESS * shear_modulus
    barrier = ipctk.BarrierPotential(distance / length, stiffness, use_physical_barrier=True)
    return SelfContact(sampling, faces, collision_mesh, barrier, length)


def _collision_mesh(rest: Array, faces: Index) -> Any:
    return ipctk.CollisionMesh(np.asfortranarray(rest), ipctk.edges(faces), faces)


def vertex_normals(vertices: Array, faces: Index) -> Array:
    """Return the unit normals (n_vertices, 3) of a triangulated surface at its vertices."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    total = np.zeros_like(vertices)
    np.add.at(total, faces, np.cross(b - a, c - a)[:, None])
    return total / np.linalg.norm(total, axis=1, keepdims=True)


def triangulated(mesh: Mesh, faces: Index | None = None, parts: int = PARTS) -> tuple[Any, Index]:
    """Sample a wall by triangles whose vertices lie on the element faces.

    Parameters
    ----------
    mesh : Mesh
    faces : array of int, optional
        Element faces of the wall; the inner one's by default.
    parts : int
        Edges of triangles along the edge of a face.

    Returns
    -------
    sampling : sparse array of shape (n_vertices, n_nodes)
        Takes values at the mesh's nodes to the vertices.
    triangles : array of shape (n_triangles, 3)
    """
    faces = mesh.inner_faces if faces is None else faces
    local, pattern = _pattern(mesh.face is QUAD8, parts)
    shapes, _ = mesh.face.shape_functions(local)
    points = np.einsum("vn,fni->fvi", shapes, mesh.points[faces]).reshape(-1, 3)
    # Vertices on shared edges are the same numbers up to round-off.
    scale = 1e-7 * np.ptp(points, axis=0).max()
    _, first, vertex = np.unique(
        np.round(points / scale).astype(np.int64), axis=0, return_index=True, return_inverse=True
    )
    face, at = np.divmod(first, len(local))
    rows = np.repeat(np.arange(len(first)), faces.shape[1])
    sampling = sparse.csr_array(
        (shapes[at].ravel(), (rows, faces[face].ravel())), shape=(len(first), len(mesh.points))
    )
    sampling.eliminate_zeros()
    numbers = vertex.reshape(len(faces), -1)
    return sampling, numbers[:, pattern].reshape(-1, 3).astype(np.int32)


def _pattern(square: bool, parts: int) -> tuple[Array, Index]:
    """Return local vertices and triangles of a face that is divided into `parts` per edge."""
    i, j = (index.ravel() for index in np.indices((parts + 1, parts + 1)))
    number = np.arange((parts + 1) ** 2).reshape(parts + 1, parts + 1)
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    lower, upper = (np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, c), (b, d, c)))
    if square:
        return 2 * np.stack([j, i], axis=-1) / parts - 1, np.concatenate([lower, upper])
    inside = i + j <= parts
    renumbered = np.cumsum(inside) - 1
    kept = np.concatenate([lower, upper])
    kept = kept[np.all(inside[kept], axis=1)]
    return np.stack([j, i], axis=-1)[inside] / parts, renumbered[kept]
