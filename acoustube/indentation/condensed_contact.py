"""Newton steps with the contact solved exactly, condensed to the nodes where it changes.

Between two states of a press some hundred points of the wall come into contact or leave it.
Newton's method, which linearises the contact as well, takes six to ten iterations to find them,
each with a factorisation. Here the wall alone is linearised. The factor of one tangent gives the
compliance of the nodes whose contact changes (the zone), a small dense matrix. The contact problem
on the zone is solved to convergence by the semismooth Newton method [2]_. Eliminating all nodes but
those in contact is due to Francavilla and Zienkiewicz [1]_. The step minimises an energy whose only
nonlinear part is contact; a few steps with the same factor then remove the residual that the
nonlinearity of the wall leaves.

References
----------
.. [1] A. Francavilla, O. C. Zienkiewicz, "A note on numerical computation of elastic contact
   problems", Int. J. Numer. Methods Eng. 9, 913-924 (1975).
.. [2] L. Qi, J. Sun, "A nonsmooth version of Newton's method", Math. Program. 58, 353-367 (1993).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import jax
import numpy as np
from scipy.linalg import LinAlgError, cholesky

from acoustube.base.types import Array, Index
from acoustube.indentation import contact
from acoustube.indentation.assembly import Model, State
from acoustube.indentation.contact import Body, Touch
from acoustube.indentation.multifrontal import MultifrontalFactor
from acoustube.indentation.padding import padded

LARGEST_ZONE = 1000
"""Largest number of unknowns of the zone (the nodes whose contact changes); a step that needs a
larger one linearises the contact as well."""
ROUNDS = 6
"""Largest number of times that one step extends the zone, the nodes whose contact changes."""
NEGLIGIBLE = 1e-4
"""Bound up to which the contact of a face is linearised: the nonlinear part of the change of its
contact forces, relative to the norm of the residual."""
ITERATIONS = 30
"""Largest number of semismooth Newton iterations on the contact problem of a step."""
PRECISION = 1e-4
"""Largest error of the displacements that solve the contact problem of a step, relative to the
largest displacement of the linear step at the nodes whose contact changes.

A smaller tolerance gains nothing: with the linearised wall a step lowers the residual by a factor
of 5 to 20 at most."""
HALVINGS = 6
"""Largest number of lengths tried for a Newton step on the contact problem, each half the last."""

_gaps = jax.jit(contact.gaps, static_argnames="face")
_pressures = jax.jit(contact.pressures)


@dataclass(eq=False)
class CondensedContact:
    """A factorised tangent, with the compliance of the zone: the nodes whose contact changes.

    Parameters
    ----------
    model : Model
    bodies : tuple of Body
        Indenters and ground at their heights.
    factor : MultifrontalFactor
        Factor of the tangent, or of a matrix near it, at a state.
    displacement : array of shape (n_nodes, 3)
        Displacements of that state, in m.
    """

    model: Model
    bodies: tuple[Body, ...]
    factor: MultifrontalFactor
    displacement: Array
    _faces: Index = field(init=False)
    _zone: Index = field(init=False)
    _columns: list[Array] = field(init=False, repr=False, default_factory=list)
    _compliance: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        """Linearise the gaps of contact at the state; no node is in the zone yet."""
        touch = self._touch(self.displacement)
        self._normal, self._stiffness = touch.normal, self._laws(touch.gap, touch.area)[1]
        self._number = np.where(
            self.model.free, np.cumsum(self.model.free).reshape(self.model.free.shape) - 1, -1
        )
        self._faces, self._zone = np.zeros(0, int), np.zeros(0, int)
        self._compliance = np.zeros((0, 0))

    def step(self, state: State) -> Array:
        """Return the Newton step from a state, with the contact of the zone solved exactly.

        The zone is extended in place to all nodes whose contact the step changes.

        Parameters
        ----------
        state : State

        Returns
        -------
        array of shape (n_free,)
            In m. The step with linearised contact instead, if the zone becomes too large, its
            contact problem is not solved, or the energy would not fall along the step.
        """
        linear = -self.factor(state.gradient)
        touch = self._touch(state.displacement)
        before, _ = self._laws(touch.gap, touch.area)
        step = linear
        for _ in range(ROUNDS):
            if self._zone.size:
                forces = self._contact_forces(touch, before, linear[self._zone])
                if forces is None:
                    return linear
                step = linear - self.factor(forces)
            excess, _ = self._excess(touch, before, self._closing(self._on_nodes(step)))
            size = np.abs(excess).max(axis=(0, 2))
            size[self._faces] = 0.0
            new = np.flatnonzero(size > NEGLIGIBLE * state.norm)
            if not new.size:
                break
            if not self._extended(new):
                return linear
        return step if state.gradient @ step < 0 else linear

    def positive_definite(self, displacement: Array) -> bool:
        """Return whether the tangent stays positive definite with the contact of another state.

        Parameters
        ----------
        displacement : array of shape (n_nodes, 3)
            In m.

        Notes
        -----
        Let D be the change of the zone's contact stiffness. The tangent is positive definite if
        the factorised one is, and if the Schur complement of the zone is as well, which is the
        inverse of the compliance plus D. This holds if ``I + L^T D L`` is positive definite, with
        the Cholesky factor L of the compliance. On an elastic ground layer, D omits the change of
        the contact area.
        """
        if not self._zone.size:
            return True
        touch = self._touch(displacement)
        _, stiffness = self._laws(touch.gap, touch.area)
        try:
            root = cholesky(self._compliance, lower=True)
            cholesky(np.eye(len(root)) + root.T @ self._zone_stiffness(stiffness) @ root)
        except LinAlgError:
            return False
        return True

    def _touch(self, displacement: Array) -> Touch:
        """Return gaps in m, their gradients, and areas in m2, at the faces' quadrature points."""
        mesh = self.model.mesh
        faces = (mesh.points + displacement)[self._nodes]
        touch = _gaps(padded(faces), padded(self._areas), mesh.face, self.bodies)
        return Touch(*(np.asarray(part)[:, : len(faces)] for part in touch))

    def _laws(self, gap: Array, area: Array) -> tuple[Array, Array]:
        """Return minus the contact force in N, and its stiffness in N/m, (body, face, point)."""
        faces = np.moveaxis(gap, 1, 0)
        slope, bend = _pressures(np.moveaxis(padded(faces), 0, 1), self.bodies)
        count = len(faces)
        return np.asarray(slope)[:, :count] * area, np.asarray(bend)[:, :count] * area

    def _closing(self, moved: Array, at: Index | slice = slice(None)) -> Array:
        """Return the linearised change of the gaps in m due to a motion of the nodes.

        Its shape is (body, face, point). It is computed at the faces `at` and zero elsewhere.
        """
        change = np.zeros(self._stiffness.shape)
        points = self._shapes @ moved[self._nodes[at]]
        change[:, at] = np.einsum("bfqi,fqi->bfq", self._normal[:, at], points)
        return change

    def _excess(self, touch: Touch, before: Array, closing: Array) -> tuple[Array, Array]:
        """Return the nonlinear part of the contact forces' change in N, and stiffnesses in N/m.

        Both are (body, face, point). The areas are those of `touch`: only the factorised tangent
        includes their change.
        """
        force, stiffness = self._laws(touch.gap + closing, touch.area)
        return force - before - self._stiffness * closing, stiffness

    def _extended(self, faces: Index) -> bool:
        """Add the unknowns of faces to the zone, or return False if it would become too large."""
        at_faces = np.union1d(self._faces, faces)
        # Contact forces are along the body's normal, which has no x component for a rod.
        across = np.abs(self._normal[:, at_faces]).max(axis=(0, 1, 2)) > 0
        used = np.unique(self._number[self._nodes[at_faces]][..., across])
        numbers = used[used >= 0]
        new = np.setdiff1d(numbers, self._zone)
        if len(self._zone) + len(new) > LARGEST_ZONE:
            return False
        new = new[np.argsort(self.factor.place[new])]
        columns = self.factor.forward(new)
        rows = np.flatnonzero(columns.any(axis=1))
        reached = columns[rows]
        own = reached.T @ reached
        shared = [known[rows].T @ reached for known in self._columns]
        between = np.concatenate([np.zeros((0, len(new))), *shared])
        self._compliance = np.block([[self._compliance, between], [between.T, own]])
        self._faces, self._zone = at_faces, np.concatenate([self._zone, new])
        self._columns.append(columns)
        return True

    def _contact_forces(self, touch: Touch, before: Array, linear: Array) -> Array | None:
        """Solve the contact problem on the zone; return forces on all unknowns, in N.

        The displacements v of the zone satisfy ``v - v_linear + C f(v) = 0``, with the compliance C
        and the nonlinear part f of the change of the contact forces, which is returned. The result
        is None without convergence.
        """
        moved, scale = linear, np.abs(linear).max()

        def misfit(moved: Array) -> tuple[Array, Array, Array]:
            closing = self._closing(self._of_zone(moved), self._faces)
            excess, stiffness = self._excess(touch, before, closing)
            force = self._zone_forces(excess)
            return moved - linear + self._compliance @ force[self._zone], force, stiffness

        wrong, force, stiffness = misfit(moved)
        for _ in range(ITERATIONS):
            if np.abs(wrong).max() <= PRECISION * scale:
                return force
            change = _solved(self._compliance, self._zone_stiffness(stiffness), -wrong)
            if change is None:
                return None
            for length in 0.5 ** np.arange(HALVINGS):
                trial = moved + length * change
                left, force, stiffness = misfit(trial)
                if np.linalg.norm(left) < np.linalg.norm(wrong):
                    break
            moved, wrong = trial, left
        return None

    def _zone_forces(self, point_forces: Array) -> Array:
        """Return the forces on the unknowns due to forces at the points of the zone's faces."""
        at, shapes = self._faces, self._shapes
        normal = self._normal[:, at]
        local = np.einsum("qn,bfqi,bfq->fni", shapes, normal, point_forces[:, at], optimize=True)
        total = np.zeros(self.displacement.shape)
        np.add.at(total, self._nodes[at], local)
        return total[self.model.free]

    def _zone_stiffness(self, stiffness: Array) -> Array:
        """Return the contact stiffness of the zone minus that in the factorised tangent, in N/m."""
        at, shapes, size = self._faces, self._shapes, len(self._zone)
        normal, change = self._normal[:, at], (stiffness - self._stiffness)[:, at]
        at_points = np.einsum("bfq,bfqi,bfqj->fqij", change, normal, normal, optimize=True)
        local = np.einsum("qn,qm,fqij->fnimj", shapes, shapes, at_points, optimize=True)
        place = np.full(self.model.pattern.n_free + 1, -1)
        place[self._zone] = np.arange(size)
        rows = place[self._number[self._nodes[at]]]
        first, second = np.broadcast_arrays(rows[:, :, :, None, None], rows[:, None, None])
        known = (first >= 0) & (second >= 0)
        entries = np.bincount(first[known] * size + second[known], local[known], size**2)
        return np.asarray(entries.reshape(size, size), float)

    def _on_nodes(self, step: Array) -> Array:
        """Return a step (n_free,) as displacements (n_nodes, 3), zero where they are fixed."""
        moved = np.zeros(self.displacement.shape)
        moved[self.model.free] = step
        return moved

    def _of_zone(self, moved: Array) -> Array:
        """Return displacements of the zone's unknowns as (n_nodes, 3), zero elsewhere."""
        step = np.zeros(self.model.pattern.n_free)
        step[self._zone] = moved
        return self._on_nodes(step)

    @property
    def _nodes(self) -> Index:
        """Nodes of the outer faces, (n_faces, n_face_nodes), with the repeats of the last block."""
        blocks = self.model.outer_faces
        return blocks.reshape(-1, blocks.shape[-1])

    @property
    def _areas(self) -> Array:
        """Undeformed areas of the faces' points in m2, (n_faces, n_points)."""
        return self.model.outer_areas.reshape(-1, self.model.outer_areas.shape[-1])

    @property
    def _shapes(self) -> Array:
        return np.asarray(self.model.mesh.face.shapes)


def _solved(compliance: Array, stiffness: Array, right: Array) -> Array | None:
    """Solve ``x + C K x = right``, reduced to the nonzero rows of K; return None if that fails."""
    stiff = np.flatnonzero(stiffness.any(axis=1))
    own = stiffness[np.ix_(stiff, stiff)]
    matrix = np.eye(len(stiff)) + compliance[np.ix_(stiff, stiff)] @ own
    if not np.all(np.isfinite(matrix)):
        return None
    try:
        inner = np.linalg.solve(matrix, right[stiff])
    except np.linalg.LinAlgError:
        return None
    return np.asarray(right - compliance[:, stiff] @ (own @ inner))
