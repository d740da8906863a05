"""Adaptive load stepping: the load path of a press from first contact to its final depth.

The increments of depth are doubled where Newton's method converges in few iterations and halved
where it fails [1]_. Each starts from a polynomial extrapolation of the previous states, cut short
before the lumen's walls would cross.

References
----------
.. [1] M. A. Crisfield, "Non-linear Finite Element Analysis of Solids and Structures", vol. 1,
   Wiley (1991), chapter 9 on automatic increments.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from acoustube.base.types import Array, Progress
from acoustube.base.units import MM
from acoustube.indentation.assembly import EquilibriumResults, Model, equilibrium_results
from acoustube.indentation.newton import NewtonResult, minimise
from acoustube.indentation.result import Indentation, PressError, bodies_at

# All lengths below are in bore diameters, so that a small tube is pressed like a large one.
FIRST_INCREMENT = 2.5e-3
LARGEST_INCREMENT = 1 / 16
SMALLEST_INCREMENT = 1e-5
EASY_ITERATIONS = 8
"""Newton iterations up to which the next increment is doubled."""
FORCE_TOLERANCE = 1e-8
"""Norm of the residual forces at convergence, in shear moduli times squared bore diameters."""
EXTRAPOLATED_STATES = 3
"""Converged states that the start of an increment is extrapolated from (a quadratic)."""


class _Increment(NamedTuple):
    """A converged increment."""

    depth: float
    solution: NewtonResult
    results: EquilibriumResults


def load_path(
    untouched: Indentation, model: Model, targets: Array, progress: Progress | None
) -> Indentation:
    """Follow the load path from first contact to the last target depth.

    Parameters
    ----------
    untouched : Indentation
        At first contact, from :func:`acoustube.indentation.press.first_touch`.
    model : Model
    targets : array of shape (n,)
        Rising depths in m, each of which an increment meets exactly.
    progress : callable, optional
        Called after every increment with the fraction of the expected increments that is done.

    Returns
    -------
    Indentation
        Every converged increment.

    Raises
    ------
    PressError
        If an increment as short as `SMALLEST_INCREMENT` does not converge.
    """
    tube, bore = untouched.tube, untouched.tube.inner_diameter
    tolerance = FORCE_TOLERANCE * tube.shear_modulus * bore**2
    start = NewtonResult(untouched.displacement[0], True, 0, 0.0)
    done = [_Increment(0.0, start, _results_at_first_touch(model, untouched))]
    increment = FIRST_INCREMENT * bore
    while done[-1].depth < targets[-1]:
        depth = _next_depth(targets, done[-1].depth, increment)
        bodies = bodies_at(untouched, depth)
        guess = _extrapolated(model, done[-EXTRAPOLATED_STATES:], depth)
        solution = minimise(model, guess, bodies, tolerance)
        if not solution.converged:
            increment = (depth - done[-1].depth) / 2
            if increment < SMALLEST_INCREMENT * bore:
                raise _failed(untouched, done, targets[-1], solution)
            continue
        results = equilibrium_results(model, solution.displacement, bodies)
        done.append(_Increment(depth, solution, results))
        if solution.iterations <= EASY_ITERATIONS:
            increment = min(2 * increment, LARGEST_INCREMENT * bore)
        if progress:
            left = float(targets[-1]) - depth
            progress(_fraction_done(len(done), left, increment, LARGEST_INCREMENT * bore))
    return _gathered(untouched, done)


def _results_at_first_touch(model: Model, untouched: Indentation) -> EquilibriumResults:
    """Return the results of the undeformed tube; contact forces are still zero there."""
    none = np.zeros(len(untouched.indenters))
    return EquilibriumResults(none, none, 0.0, 1.0, model.lumen.smallest_gap(model.mesh.points))


def _next_depth(targets: Array, reached: float, increment: float) -> float:
    """Return the depth of the next increment; one ending just short of a target meets it."""
    target = float(targets[np.searchsorted(targets, reached, side="right")])
    return target if reached + 1.05 * increment >= target else reached + increment


def _extrapolated(model: Model, last: Sequence[_Increment], depth: float) -> Array:
    """Return the Lagrange extrapolation of the last states to a depth, short of any collision."""
    x = np.array([done.depth for done in last])
    weights = [np.prod((depth - np.delete(x, i)) / (x[i] - np.delete(x, i))) for i in range(len(x))]
    states = np.stack([done.solution.displacement for done in last])
    here, ahead = states[-1], np.tensordot(weights, states, axes=1)
    points = model.mesh.points
    free = model.lumen.collision_free_fraction(points + here, points + ahead)
    return here + free * (ahead - here)


def _fraction_done(n_done: int, left: float, increment: float, largest: float) -> float:
    """Return the fraction of the expected increments that is done, with `left` m still to go."""
    expected = np.log2(largest / increment) + left / largest
    return float(n_done / (n_done + expected)) if left > 0 else 1.0


def _failed(
    untouched: Indentation, done: Sequence[_Increment], asked: float, last: NewtonResult
) -> PressError:
    return PressError(
        f"The indentation stopped at a depth of {MM * done[-1].depth:.2f} mm of "
        f"{MM * asked:.2f} mm: {last.reason} (residual force {last.residual:.1e} N). "
        "Reduce the depth, use a larger indenter, or refine the mesh (from Python).",
        _gathered(untouched, done),
    )


def _gathered(untouched: Indentation, done: Sequence[_Increment]) -> Indentation:
    """Return the indentation with a row per increment."""
    solutions = [increment.solution for increment in done]
    results: dict[str, Any] = {
        name: np.array([getattr(increment.results, name) for increment in done])
        for name in EquilibriumResults._fields
    }
    return dataclasses.replace(
        untouched,
        depth=np.array([increment.depth for increment in done]),
        displacement=np.stack([solution.displacement for solution in solutions]),
        iterations=np.array([solution.iterations for solution in solutions]),
        residual=np.array([solution.residual for solution in solutions]),
        **results,
    )
