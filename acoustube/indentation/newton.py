"""Newton's method with a backtracking line search for the equilibrium of a press.

A step is halved until the energy falls by a fixed fraction of the decrease that its slope predicts,
the condition of sufficient decrease (Armijo [1]_); see [2]_, chapter 3. Already the first step
tried ends before any crossing of the lumen's walls.

References
----------
.. [1] L. Armijo, "Minimization of functions having Lipschitz continuous first partial derivatives",
   Pacific J. Math. 16, 1-3 (1966). doi:10.2140/pjm.1966.16.1
.. [2] J. Nocedal, S. J. Wright, "Numerical Optimization", 2nd ed., Springer (2006).
   doi:10.1007/978-0-387-40065-5
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError

from acoustube.base.types import Array
from acoustube.indentation import linear_solver
from acoustube.indentation.assembly import Model, State, evaluate, stiffness
from acoustube.indentation.condensed_contact import CondensedContact
from acoustube.indentation.contact import Body
from acoustube.indentation.multifrontal import MultifrontalFactor
from acoustube.indentation.negative_curvature import CurvedStep, curved_step

MAX_ITERATIONS = 40
MAX_HALVINGS = 8
SUFFICIENT_DECREASE = 1e-4
"""Fraction of the predicted decrease of the energy that a step must reach (Armijo's constant)."""
RESIDUAL_DECREASE = 0.5
"""Ratio of the residuals after and before a step below which the step is accepted at any energy."""
REUSE_DECREASE = 0.1
"""Ratio of the residuals after and before a step below which the factorised tangent is reused."""
CONDENSED_REUSE_DECREASE = 0.3
"""Ratio of the residuals after and before a step with condensed contact below which the factorised
tangent is reused: such a step is cheap beside a factorisation."""
LEAST_CONDENSED_WORK = 1e9
"""Smallest number of operations of a factorisation at which contact is condensed; see
:mod:`acoustube.indentation.condensed_contact`.

With fewer, as on 2 x 12 x 10 elements of a quarter of a tube, this costs more than it saves."""
REUSED_TOLERANCE = 0.1
"""Largest residual at convergence after a step with a reused factor, relative to the tolerance."""
DIAGONAL_SHIFTS = (0.0, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 1e-1)
"""Fractions of its diagonal, one of which is added to an indefinite tangent; tried in this order.

The diagonal of a nearly incompressible wall is dominated by its volumetric stiffness. The stiffness
of a thin wall in bending is 1e-6 to 1e-4 of it: with a larger shift a step hardly bends the wall.
"""
SADDLE_STEPS = 1e-2 * 0.25 ** np.arange(5)
"""Largest nodal displacements of the steps tried from a saddle of the energy, to either side along
the direction of least curvature, in heights of the bore (of the body, if it has no bore)."""
BUCKLING = "the tangent stiffness is not positive definite (buckling)"


@dataclass(frozen=True, eq=False)
class NewtonResult:
    """Result of a Newton solve.

    Attributes
    ----------
    displacement : array of shape (n_nodes, 3)
        Nodal displacements in m, converged or not.
    converged : bool
    iterations : int
    residual : float
        Norm of the residual (out-of-balance) nodal forces, in N.
    reason : str
        Cause of the failure; empty if converged.
    """

    displacement: Array
    converged: bool
    iterations: int
    residual: float
    reason: str = ""


def minimise(
    model: Model, start: Array | State, bodies: tuple[Body, ...], tolerance: float
) -> NewtonResult:
    """Minimise the potential energy by Newton's method with a line search.

    Parameters
    ----------
    model : Model
    start : State or array of shape (n_nodes, 3)
        Initial state or displacements in m, at which the inner wall does not cross itself.
    bodies : tuple of Body
        Indenters and ground at their heights.
    tolerance : float
        Largest norm of the residual nodal forces at convergence, in N; for a press it follows from
        :data:`acoustube.indentation.load_path.FORCE_TOLERANCE`.

    Returns
    -------
    NewtonResult
        Not converged if the iterations ran out, the line search found no decrease, an element was
        inverted, or the tangent was not positive definite and could not be made so.

    Notes
    -----
    Where the tangent is indefinite, the step is that of a positive definite matrix near it,
    corrected by :mod:`acoustube.indentation.negative_curvature`; from a saddle of the energy it
    follows the direction of least curvature. Convergence requires that the last factorised tangent
    is unmodified and positive definite: the result is no saddle. The factor of a tangent is used
    again while it lowers the residual enough (the chord method, :func:`_worth`); after such steps
    the residual must fall to `REUSED_TOLERANCE` of the tolerance, as it would after a step of the
    state's own tangent.
    """
    state = start if isinstance(start, State) else evaluate(model, start, bodies)
    tangent, own = None, False
    for iteration in range(MAX_ITERATIONS + 1):
        near = state.norm <= tolerance
        if not np.isfinite(state.norm):
            reason = "an element is inverted (J <= 0)"
            break
        small = state.norm <= tolerance * (1.0 if own else REUSED_TOLERANCE)
        sound = tangent is not None and tangent.stable and (not small or tangent.holds_at(state))
        if small and sound:
            reason = ""
            break
        if iteration == MAX_ITERATIONS:
            reason = f"Newton's method did not converge in {MAX_ITERATIONS} iterations"
            break
        own = tangent is None or (near and not sound)
        if own:
            tangent = _factorised(model, state.displacement, bodies)
        if tangent is None or (near and iteration == 0 and tangent.stable):
            reason = "" if tangent is not None else BUCKLING
            break
        lower = _descended(model, state, tangent, bodies, saddle=near and not tangent.stable)
        if lower is None and own:
            failed = BUCKLING if near else "the line search found no decrease of the energy"
            reason = "" if near and tangent.stable else failed
            break
        if lower is None or not tangent.stable or not _worth(tangent, state, lower, tolerance):
            tangent = None
        state = state if lower is None else lower
    return NewtonResult(state.displacement, not reason, iteration, state.norm, reason)


class _Tangent(NamedTuple):
    """A factorised tangent (`stable`), or else a factorised positive definite matrix near it."""

    solve: linear_solver.Solve
    stable: bool
    contact: CondensedContact | None
    indefinite: sparse.csc_array | None = None
    """Lower triangle of the tangent in N/m if that is not positive definite, else None."""

    def step(self, state: State) -> Array:
        """Return the Newton step (n_free,) in m; if contact is condensed, it is solved exactly."""
        return -self.solve(state.gradient) if self.contact is None else self.contact.step(state)

    def holds_at(self, state: State) -> bool:
        """Return whether the tangent stays positive definite with the contact stiffness of `state`.

        True without a check if the contact is not condensed.
        """
        return self.contact is None or self.contact.positive_definite(state.displacement)

    @property
    def reuse(self) -> float:
        """Ratio of the residuals after and before a step below which the factor is used again."""
        return REUSE_DECREASE if self.contact is None else CONDENSED_REUSE_DECREASE


def _worth(tangent: _Tangent, state: State, lower: State, tolerance: float) -> bool:
    """Return whether to reuse the factor whose step led from `state` to `lower`.

    True if the step lowered the residual enough, or if three more steps with the same ratio of
    residuals would converge.
    """
    ratio = lower.norm / state.norm
    last = lower.norm * ratio**3
    return ratio <= tangent.reuse or (ratio < 1 and last <= REUSED_TOLERANCE * tolerance)


def _factorised(model: Model, displacement: Array, bodies: tuple[Body, ...]) -> _Tangent | None:
    """Factorise the tangent, or else a nearby positive definite matrix.

    That matrix is the tangent without the terms that are the first to make it indefinite, see
    `convex` of :func:`stiffness`. If this is not positive definite either, fractions of its
    diagonal are added ([2]_, section 3.4); None if not even the largest of these suffices.
    """
    indefinite = None
    for shift in (None, *DIAGONAL_SHIFTS):
        if not shift:
            matrix = plain = stiffness(model, displacement, bodies, convex=shift is not None)
        else:
            matrix = (plain + shift * sparse.diags_array(np.abs(plain.diagonal()))).tocsc()
        try:
            solve = linear_solver.factorise(matrix, model.analysis)
        except LinAlgError:
            indefinite = matrix if shift is None else indefinite
            continue
        condensed = None
        if (
            shift is None
            and isinstance(solve, MultifrontalFactor)
            and solve.plan.operations >= LEAST_CONDENSED_WORK
        ):
            condensed = CondensedContact(model, bodies, solve, displacement)
        return _Tangent(solve, shift is None, condensed, indefinite)
    return None


def _descended(
    model: Model, state: State, tangent: _Tangent, bodies: tuple[Body, ...], *, saddle: bool
) -> State | None:
    """Return a state of lower energy or residual after a step of a tangent; None if none is found.

    After a step from a saddle its energy is lower.
    """

    def moved(step: Array) -> State | None:
        on_nodes = np.zeros_like(state.displacement)
        on_nodes[model.free] = step
        return _line_search(model, state, on_nodes, bodies)

    if tangent.indefinite is None:
        return moved(tangent.step(state))
    curved = None
    if state.gradient.any():
        curved = curved_step(tangent.indefinite, tangent.solve, state.gradient)
    lower = None if curved is None else moved(curved.step)
    if not saddle:
        return moved(tangent.step(state)) if lower is None else lower
    # At a loose tolerance the saddle may lie beyond the step's end: also try to descend beyond it.
    beyond = _below_saddle(model, state, tangent.indefinite, tangent.solve, bodies, curved)
    found = [each for each in (lower, beyond) if each is not None and each.energy < state.energy]
    return min(found, key=lambda each: each.energy, default=None)


def _below_saddle(
    model: Model,
    state: State,
    indefinite: sparse.csc_array,
    convex: linear_solver.Solve,
    bodies: tuple[Body, ...],
    curved: CurvedStep | None,
) -> State | None:
    """Return a state of lower energy along a saddle's least curvature; None if none is found.

    `curved` is the step from the saddle; None where the residual is zero.
    """
    if curved is None or curved.curvature >= 0:
        # The gradient of a symmetric state has no component in the direction of buckling.
        start = np.random.default_rng(0).normal(size=len(state.gradient))
        curved = curved_step(indefinite, convex, start)
    inner = np.unique(model.mesh.inner_faces)
    points = model.mesh.points[inner] if inner.size else model.mesh.points
    height = np.ptp(points[:, 1])
    away = np.where(state.gradient @ curved.lowest > 0, -1.0, 1.0) * curved.lowest
    away *= height / np.abs(away).max()
    position = model.mesh.points + state.displacement
    for size in SADDLE_STEPS:
        for step in (size * away, -size * away):
            target = state.displacement.copy()
            target[model.free] += step
            if model.lumen.collision_free_fraction(position, model.mesh.points + target) < 1:
                continue
            trial = evaluate(model, target, bodies)
            if trial.energy < state.energy:
                return trial
    return None


def _line_search(model: Model, state: State, step: Array, bodies: tuple[Body, ...]) -> State | None:
    """Return the state after the first accepted step, halved until it is accepted; None if none."""
    position = model.mesh.points + state.displacement
    longest = model.lumen.collision_free_fraction(position, position + step)
    slope = float(state.gradient @ step[model.free])
    for length in longest * 0.5 ** np.arange(MAX_HALVINGS):
        trial = evaluate(model, state.displacement + length * step, bodies)
        enough = state.energy + SUFFICIENT_DECREASE * length * slope
        # Near the solution the decrease of the energy is lost in round-off; the residual's is not.
        if trial.energy <= enough or trial.norm < RESIDUAL_DECREASE * state.norm:
            return trial
    return None
