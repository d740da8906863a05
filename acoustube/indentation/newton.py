"""Newton's method with a backtracking line search for the equilibrium of a press.

A step is halved until the energy falls by a fixed fraction of what its slope predicts, the
condition of sufficient decrease (Armijo [1]_); see [2]_, chapter 3. The first step tried is already
short of any crossing of the lumen's walls.

References
----------
.. [1] L. Armijo, "Minimization of functions having Lipschitz continuous first partial derivatives",
   Pacific J. Math. 16, 1-3 (1966). doi:10.2140/pjm.1966.16.1
.. [2] J. Nocedal, S. J. Wright, "Numerical Optimization", 2nd ed., Springer (2006).
   doi:10.1007/978-0-387-40065-5
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError

from acoustube.base.types import Array, Index
from acoustube.indentation import linear_solver
from acoustube.indentation.assembly import Model, State, evaluate, stiffness
from acoustube.indentation.contact import Body

MAX_ITERATIONS = 40
MAX_HALVINGS = 8
SUFFICIENT_DECREASE = 1e-4
"""Fraction of the predicted decrease of the energy that a step must reach (Armijo's constant)."""
RESIDUAL_DECREASE = 0.5
"""Ratio of the residuals after and before a step below which it is taken whatever the energy."""
REUSE_DECREASE = 0.1
"""Ratio of the residuals after and before a step below which its factor is used again."""
REUSED_TOLERANCE = 1e-2
"""Part of the tolerance that the residual must reach by a step with a factor used before."""
DIAGONAL_SHIFTS = (0.0, 1e-3, 1e-2, 1e-1)
"""Parts of the diagonal that are added, one after the other, to an indefinite tangent."""
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
    model: Model, start: Array, bodies: tuple[Body, ...], tolerance: float
) -> NewtonResult:
    """Minimise the potential energy by Newton's method with a line search.

    Parameters
    ----------
    model : Model
    start : array of shape (n_nodes, 3)
        Initial displacements in m, at which the inner wall does not cross itself.
    bodies : tuple of Body
        Indenters and ground at their heights.
    tolerance : float
        Largest norm of the residual nodal forces at convergence, in N.

    Returns
    -------
    NewtonResult
        Not converged if the iterations ran out, the line search found no decrease, an element was
        inverted, or the tangent was not positive definite and could not be made so.

    Notes
    -----
    Where the tangent is indefinite, the step is that of a positive definite matrix near it. It
    converges only by a step of a true, positive definite tangent: the result is a stable
    equilibrium, not a saddle point of the energy. The factor of a tangent is used again while it
    lowers the residual tenfold (the chord method); after such steps the residual must fall to
    `REUSED_TOLERANCE` of the tolerance, as a step of the state's own tangent would make it.
    """
    state = evaluate(model, start, bodies)
    order = linear_solver.section_order(model.mesh.points, model.free)
    solve, stable, own = None, False, False
    for iteration in range(MAX_ITERATIONS + 1):
        near = state.norm <= tolerance
        if not np.isfinite(state.norm):
            reason = "an element is inverted (J <= 0)"
            break
        if stable and state.norm <= tolerance * (1.0 if own else REUSED_TOLERANCE):
            reason = ""
            break
        if iteration == MAX_ITERATIONS:
            reason = f"Newton's method did not converge in {MAX_ITERATIONS} iterations"
            break
        own = solve is None or (near and not stable)
        if own:
            try:
                solve, stable = _factorised(model, state.displacement, bodies, order)
            except LinAlgError:
                stable = False
        if solve is None or (near and (iteration == 0 or not stable)):
            reason = "" if stable else BUCKLING
            break
        step = np.zeros_like(start)
        step[model.free] = -solve(state.gradient)
        lower = _line_search(model, state, step, bodies)
        if lower is None and own:
            reason = "" if near else "the line search found no decrease of the energy"
            break
        if lower is None or not stable or lower.norm > REUSE_DECREASE * state.norm:
            solve = None
        state = state if lower is None else lower
    return NewtonResult(state.displacement, not reason, iteration, state.norm, reason)


def _factorised(
    model: Model, displacement: Array, bodies: tuple[Body, ...], order: Index
) -> tuple[linear_solver.Solve, bool]:
    """Factorise the tangent, or else a nearby positive definite matrix; return whether the tangent.

    The second is the tangent without what makes it indefinite first, and with a part of its
    diagonal added where that is not enough ([2]_, section 3.4).

    Raises
    ------
    scipy.linalg.LinAlgError
        If the largest part is not enough either.
    """
    try:
        return linear_solver.factorise(stiffness(model, displacement, bodies), order), True
    except LinAlgError:
        convex = stiffness(model, displacement, bodies, convex=True)
    for shift in DIAGONAL_SHIFTS:
        shifted = convex + shift * sparse.diags_array(np.abs(convex.diagonal()))
        try:
            return linear_solver.factorise(shifted.tocsc(), order), False
        except LinAlgError:
            continue
    raise LinAlgError("The tangent cannot be made positive definite.")


def _line_search(model: Model, state: State, step: Array, bodies: tuple[Body, ...]) -> State | None:
    """Return the first of the halved steps with a sufficient decrease of the energy, or None."""
    position = model.mesh.points + state.displacement
    longest = model.lumen.collision_free_fraction(position, position + step)
    slope = float(state.gradient @ step[model.free])
    for length in longest * 0.5 ** np.arange(MAX_HALVINGS):
        trial = evaluate(model, state.displacement + length * step, bodies)
        enough = state.energy + SUFFICIENT_DECREASE * length * slope
        # Near the solution the decrease of the energy is lost in round-off, but not the residual's.
        if trial.energy <= enough or trial.norm < RESIDUAL_DECREASE * state.norm:
            return trial
    return None
