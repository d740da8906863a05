"""Contact of the inner wall with itself: the barrier of incremental potential contact.

The inner wall is sampled by triangles. Between two that are closer than the activation distance
d_hat acts a barrier energy, infinite at contact (incremental potential contact, IPC [1]_), with the
area weights of its convergent form [2]_; continuous collision detection [3]_ limits every Newton
step to a collision-free part. Both are computed by ``ipctk``, the library of the method's authors.

References
----------
.. [1] M. Li, Z. Ferguson, T. Schneider, T. Langlois, D. Zorin, D. Panozzo, C. Jiang, D. M. Kaufman,
   "Incremental potential contact: intersection- and inversion-free, large-deformation dynamics",
   ACM Trans. Graph. 39, 49 (2020). doi:10.1145/3386569.3392425
.. [2] M. Li, Z. Ferguson, T. Schneider, T. Langlois, D. Zorin, D. Panozzo, C. Jiang, D. M. Kaufman,
   "Convergent incremental potential contact", arXiv:2307.15908 (2023).
.. [3] B. Wang, Z. Ferguson, T. Schneider, X. Jiang, M. Attene, D. Panozzo, "A large-scale benchmark
   and an inclusion-based algorithm for continuous collision detection", ACM Trans. Graph. 40, 188
   (2021). doi:10.1145/3460775
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import ipctk
import numpy as np
from scipy import sparse
from scipy.optimize import brentq
from scipy.spatial import KDTree

from acoustube.base.types import Array, Index
from acoustube.indentation.mesh import Mesh
from acoustube.indentation.reference_element import QUAD8

SUBDIVISIONS = 4
"""Number of triangle edges of the inner wall along the edge of an element's face."""
BARRIER_DISTANCE = 2.5e-3
"""Default activation distance d_hat in bore diameters: 0.02 mm in the default tube."""
BARRIER_STIFFNESS = 0.3
"""Stiffness K of the barrier, in shear moduli; see :func:`gap_at_pressure`."""
LIBRARY_UNIT = 400
"""Unit of length in the collision library, in activation distances (a bore, by default)."""
REST_STEP = 1e-6
"""Step of undeformed vertices in central differences, in the collision library's unit of length."""
STEP_SAFETY_FACTOR = 0.9
"""Fraction of the step to the first collision that is taken."""
CLEARANCE = 3.0
"""Distance in activation distances up to which the smallest gap between triangles is computed."""
FACING_ANGLE = np.pi / 6
"""Largest angle in rad between the vertical and the normals of walls that face each other."""


@dataclass(frozen=True, eq=False)
class SelfContact:
    """The triangulated inner wall and its self-contact barrier.

    Parameters
    ----------
    sampling : sparse array of shape (n_vertices, n_nodes)
        Interpolates nodal values at the vertices of the triangles.
    faces : array of shape (n_triangles, 3)
    mesh : ipctk.CollisionMesh
        The triangles for the collision library, in units of `length`.
    barrier : ipctk.BarrierPotential
    length : float
        Unit of length in the collision library in m; its tolerances are absolute.
    """

    sampling: Any
    faces: Index
    mesh: Any
    barrier: Any
    length: float
    _last: dict[str, Any] = field(init=False, repr=False, default_factory=dict)

    def _vertices(self, position: Array) -> Array:
        """Return the vertices' positions in units of `length`, from those of the nodes in m."""
        return np.asfortranarray((self.sampling @ position) / self.length)

    def _collisions(self, vertices: Array) -> Any:
        """Return the pairs of triangles within the activation distance, cached for one state."""
        if self._apart(vertices, by=self.barrier.dhat):
            return ipctk.NormalCollisions()
        known, pairs = self._last.get("pairs", (None, None))
        if known is None or not np.array_equal(known, vertices):
            pairs = self._pairs(vertices, self.barrier.dhat)
            self._last["pairs"] = vertices, pairs
        return pairs

    def _apart(self, *states: Array, by: float = 0.0) -> bool:
        """Return whether all triangles are surely farther apart than a distance; False if unknown.

        This holds at the given states of the vertices and on the straight path between them. If the
        smallest distance at a reference state (`centre`) is d, it exceeds `by` while no vertex has
        moved farther than the margin (d - by) / 2. A centre without a margin is replaced after a
        vertex has moved by d_hat / 4. The centre stays if the path is longer than its margin.
        """
        d_hat = self.barrier.dhat

        def moved(centre: Array) -> float:
            away = [np.sum((state - centre) ** 2, axis=1).max(initial=0.0) for state in states]
            return float(np.sqrt(max(away)))

        centre, least = self._last.get("centre", (None, CLEARANCE * d_hat))
        margin = 0.999 * (least - by) / 2
        if centre is None or moved(centre) > (margin if margin > 0 else d_hat / 4):
            if moved(states[0]) > max(margin, 0.0):
                return False
            centre, least = states[0], CLEARANCE * d_hat
            pairs = self._pairs(centre, least)
            if not pairs.empty():  # the library returns the squared distance
                least = float(np.sqrt(pairs.compute_minimum_distance(self.mesh, centre)))
            self._last["centre"] = centre, least
            margin = 0.999 * (least - by) / 2
        return margin > 0 and moved(centre) <= margin

    def _pairs(self, vertices: Array, distance: float) -> Any:
        pairs = ipctk.NormalCollisions()
        pairs.use_area_weighting = True
        pairs.collision_set_type = ipctk.NormalCollisions.CollisionSetType.IMPROVED_MAX_APPROX
        pairs.build(self.mesh, vertices, distance)
        return pairs

    def energy_and_forces(self, position: Array) -> tuple[float, Array]:
        """Return the barrier energy in J and its gradient in N.

        Parameters
        ----------
        position : array of shape (n_nodes, 3)
            Deformed nodes in m.

        Returns
        -------
        energy : float
        gradient : array of shape (n_nodes, 3)
        """
        vertices = self._vertices(position)
        collisions = self._collisions(vertices)
        if collisions.empty():
            return 0.0, np.zeros_like(position)
        energy = self.barrier(collisions, self.mesh, vertices) * self.length**3
        gradient = self.barrier.gradient(collisions, self.mesh, vertices) * self.length**2
        return energy, self.sampling.T @ gradient.reshape(-1, 3)

    def tangent(self, position: Array, *, convex: bool = False) -> Any:
        """Return the stiffness of the barrier in N/m.

        Parameters
        ----------
        position : array of shape (n_nodes, 3)
            Deformed nodes in m.
        convex : bool
            Leave out the negative eigenvalues of the stiffness of each pair of triangles.

        Returns
        -------
        sparse array of shape (3 n_nodes, 3 n_nodes), or None
            None if no triangles are within the activation distance.
        """
        vertices = self._vertices(position)
        collisions = self._collisions(vertices)
        if collisions.empty():
            return None
        kept = ipctk.PSDProjectionMethod.CLAMP if convex else ipctk.PSDProjectionMethod.NONE
        hessian = self.barrier.hessian(collisions, self.mesh, vertices, kept) * self.length
        to_nodes = self._to_nodes()
        return (to_nodes.T @ hessian @ to_nodes).tocsc()

    def forces_along(self, position: Array, moved: Array) -> Array:
        """Return the derivative of the barrier forces along a motion of the undeformed nodes.

        Parameters
        ----------
        position : array of shape (n_nodes, 3)
            Deformed nodes in m; they move with the undeformed ones (constant displacements).
        moved : array of shape (n_nodes, 3)
            Motion of the undeformed nodes, in m per unit of a parameter.

        Returns
        -------
        array of shape (n_nodes, 3)
            In N per unit of the parameter.

        Notes
        -----
        The dependence on the undeformed wall (area weights, and the tolerance for parallel edges)
        is differentiated by central differences: the library's own derivative is off by 6e-4 in a
        closed lumen.
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
        """Return the smallest distance in m between the lower and the upper part of the inner wall.

        Parameters
        ----------
        position : array of shape (n_nodes, 3)
            Deformed nodes in m.

        Notes
        -----
        The parts are those whose undeformed normals are within `FACING_ANGLE` of the vertical:
        there a lumen pressed from above closes first.
        """
        vertices = self.sampling @ position
        lower, upper = self._facing
        away, nearest = KDTree(vertices[upper]).query(vertices[lower])
        across = vertices[upper[nearest]] - vertices[lower]
        normal = np.abs(np.sum(across * vertex_normals(vertices, self.faces)[lower], axis=1))
        # If the nearest vertex is next to the normal, the gap is the distance along the normal.
        adjacent = np.sqrt(np.maximum(away**2 - normal**2, 0)) < self._spacing
        return float(np.min(np.where(adjacent, normal, away)))

    @cached_property
    def _facing(self) -> tuple[Index, Index]:
        """Vertex numbers of the lower and of the upper part of the inner wall."""
        normal = vertex_normals(np.asarray(self.mesh.rest_positions), self.faces)
        upright = np.abs(normal[:, 1]) > np.cos(FACING_ANGLE)
        low = np.asarray(self.mesh.rest_positions)[:, 1]
        is_low = low < (low.min() + low.max()) / 2
        return np.flatnonzero(upright & is_low), np.flatnonzero(upright & ~is_low)

    @cached_property
    def _spacing(self) -> float:
        """Median over the triangles of the longest edge, in m."""
        rest = np.asarray(self.mesh.rest_positions)
        sides = rest[self.faces] - rest[np.roll(self.faces, 1, axis=1)]
        return float(np.median(np.linalg.norm(sides, axis=-1).max(axis=1))) * self.length

    def collision_free_fraction(self, start: Array, end: Array) -> float:
        """Return the fraction of a step, from 0 to 1, that can be taken without collision.

        It is 1 without a collision, else `STEP_SAFETY_FACTOR` times the fraction up to the first.

        Parameters
        ----------
        start, end : array of shape (n_nodes, 3)
            Nodes before and after the step, in m.
        """
        before, after = self._vertices(start), self._vertices(end)
        if self._apart(before, after):
            return 1.0
        free = ipctk.compute_collision_free_stepsize(self.mesh, before, after)
        return 1.0 if free >= 1 else STEP_SAFETY_FACTOR * float(free)

    def crosses_itself(self, position: Array) -> bool:
        """Return whether triangles of the wall intersect.

        Parameters
        ----------
        position : array of shape (n_nodes, 3)
            Deformed nodes in m.
        """
        vertices = self._vertices(position)
        return bool(ipctk.has_intersections(self.mesh, vertices))


def self_contact(
    mesh: Mesh, shear_modulus: float, distance: float, parts: int = SUBDIVISIONS
) -> SelfContact:
    """Build the self-contact barrier of a mesh's inner wall.

    Parameters
    ----------
    mesh : Mesh
    shear_modulus : float
        Of the wall, in Pa.
    distance : float
        Activation distance d_hat of the barrier, in m.
    parts : int
        Number of triangle edges along the edge of an element's face.
    """
    sampling, faces = triangulated(mesh, parts=parts)
    length = LIBRARY_UNIT * distance
    collision_mesh = _collision_mesh(sampling @ mesh.points / length, faces)
    stiffness = BARRIER_STIFFNESS * shear_modulus
    barrier = ipctk.BarrierPotential(distance / length, stiffness, use_physical_barrier=True)
    return SelfContact(sampling, faces, collision_mesh, barrier, length)


def gap_at_pressure(pressure: float, distance: float, shear_modulus: float) -> float:
    """Return the gap between flat, parallel walls at which the barrier exerts a given pressure.

    Parameters
    ----------
    pressure : float
        In Pa.
    distance : float
        Activation distance of the barrier in m.
    shear_modulus : float
        Of the wall, in Pa.

    Returns
    -------
    float
        In m.

    Notes
    -----
    The pressure is minus the derivative by the gap of the barrier's energy per area,
    ``d_hat K (r^2 - 1)^2 ln(1 / r^2)`` with its stiffness K and r = gap / d_hat. The area weights
    of the pairs of triangles make the pressure of a mesh up to 1.5 times as high.
    """
    scaled = max(pressure, 0.0) / (BARRIER_STIFFNESS * shear_modulus)

    def excess(r: float) -> float:
        square = r**2 - 1
        return float(4 * r * square * np.log(r**2) + 2 * square**2 / r - scaled)

    root = 2 / scaled if scaled > 1e6 else brentq(excess, 1e-6, 1.0)  # 2 / r dominates, to 1e-10
    return float(distance * root)


def _collision_mesh(rest: Array, faces: Index) -> Any:
    return ipctk.CollisionMesh(np.asfortranarray(rest), ipctk.edges(faces), faces)


def vertex_normals(vertices: Array, faces: Index) -> Array:
    """Return the area-weighted unit normals of a triangulated surface at its vertices.

    Parameters
    ----------
    vertices : array of shape (n_vertices, 3)
    faces : array of shape (n_triangles, 3)

    Returns
    -------
    array of shape (n_vertices, 3)
    """
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    total = np.zeros_like(vertices)
    np.add.at(total, faces, np.cross(b - a, c - a)[:, None])
    return total / np.linalg.norm(total, axis=1, keepdims=True)


def triangulated(
    mesh: Mesh, faces: Index | None = None, parts: int = SUBDIVISIONS
) -> tuple[Any, Index]:
    """Triangulate a wall of the mesh; the vertices lie on the element faces.

    Parameters
    ----------
    mesh : Mesh
    faces : array of int, shape (n_faces, n_face_local), optional
        Element faces of the wall; those of the inner wall by default.
    parts : int
        Number of triangle edges along the edge of an element's face.

    Returns
    -------
    sampling : sparse array of shape (n_vertices, n_nodes)
        Interpolates nodal values at the vertices.
    triangles : array of shape (n_triangles, 3)
    """
    faces = mesh.inner_faces if faces is None else faces
    local, pattern = _pattern(mesh.face is QUAD8, parts)
    shapes, _ = mesh.face.shape_functions(local)
    points = np.einsum("vn,fni->fvi", shapes, mesh.points[faces]).reshape(-1, 3)
    # Coordinates of vertices on common edges are equal up to round-off.
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
    """Return local vertices and triangles of a face divided into `parts` per edge."""
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
