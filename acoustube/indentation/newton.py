"""Newton's method with a line search for the equilibrium of a press."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError

from acoustube.base.types import Array
from acoustube.indentation import linear_solver
from acoustube.indentation.assembly import Model, State, evaluate, stiffness
from acoustube.indentation.contact import Body

MAX_ITERATIONS = 25
MAX_HALVINGS = 8
SUFFICIENT_DECREASE = 1e-4


@dataclass(frozen=True, eq=False)
class Equilibrium:
    """Where Newton's method came to.

    Attributes
    ----------
    displacement : array of shape (n_nodes, 3)
        In m.
    converged : bool
    iterations : int
    residual : float
        Norm of the out-of-balance nodal forces, in N.
    reason : str
        Why it did not converge.
    """

    displacement: Array
    converged: bool
    iterations: int
    residual: float
    reason: str = ""


def minimise(model: Model, start: Array, bodies: tuple[Body, ...], tolerance: float) -> Equilibrium:
    """Find the displacements at which the energy is least, from a given start.

    Newton's method with a line search on the energy, in which no step crosses the lumen. A tangent
    that is not positive definite ends the search: the start lies across a buckling, and the caller
    does better to come closer in a shorter increment than to follow it into a crumpled state.

    Parameters
    ----------
    model : Model
    start : array of shape (n_nodes, 3)
        First guess of the displacements, in m; the inner wall does not cross itself there.
    bodies : tuple of Body
    tolerance : float
        Largest accepted norm of the out-of-balance nodal forces, in N.

    Returns
    -------
    Equilibrium
        With ``converged`` false if the iterations ran out, no step went downhill or the tangent
        was indefinite.
    """
    state = evaluate(model, start, bodies)
    order = linear_solver.section_order(model.mesh.points, model.free)
    for iteration in range(MAX_ITERATIONS + 1):
        if not state.norm > tolerance:
            # Also reached where the start inverts an element, by NaN.
            reason = "" if state.norm <= tolerance else "an element is turned inside out"
            break
        if iteration == MAX_ITERATIONS:
            reason = "Newton's method does not settle"
            break
        try:
            solve = linear_solver.factorise(stiffness(model, state.displacement, bodies), order)
        except LinAlgError:
            reason = "the wall buckles"
            break
        step = np.zeros_like(start)
        step[model.free] = -solve(state.gradient)
        lower = _search_line(model, state, step, bodies)
        if lower is None:
            reason = "no step lowers the energy"
            break
        state = lower
    return Equilibrium(state.displacement, not reason, iteration, state.norm, reason)


def _search_line(model: Model, state: State, step: Array, bodies: tuple[Body, ...]) -> State | None:
    """Return the first of the halved steps that lowers the energy enough, if any does."""
    position = model.mesh.points + state.displacement
    longest = model.lumen.free_share(position, position + step)
    slope = float(state.gradient @ step[model.free])
    for length in longest * 0.5 ** np.arange(MAX_HALVINGS):
        trial = evaluate(model, state.displacement + length * step, bodies)
        enough = state.energy + SUFFICIENT_DECREASE * length * slope
        # Close to the solution the energy's decrease drowns in round-off, the residual's does not.
        if trial.energy <= enough or trial.norm < 0.5 * state.norm:
            return trial
    return None
