"""Adaptive load stepping: the load path of a press from first contact to its final depth.

The increments of depth are doubled where Newton's method converges in few iterations and halved
where it fails [1]_. Each starts from a polynomial extrapolation of the previous states, unless the
lumen's walls cross there. With a guide (:mod:`acoustube.indentation.guide`) an increment reaches
from one requested depth to the next. It starts from the guide's state plus the difference between
the last converged state and the guide's state at that depth, or from an extrapolation, whichever
has the lower energy. Only requested depths `SPACING` apart are solved in rising order. The others
follow in bisection order: next is the one nearest the middle of the widest gap between solved
depths. They start from the cubic through the two states on either side, which is closer to the
solution than an extrapolation.

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

from acoustube.base.report import part_of
from acoustube.base.types import Array, Progress
from acoustube.base.units import MM
from acoustube.indentation.assembly import (
    EquilibriumResults,
    Model,
    equilibrium_results,
    evaluate,
)
from acoustube.indentation.guide import Guide
from acoustube.indentation.newton import NewtonResult, minimise
from acoustube.indentation.result import Indentation, PressError, bodies_at

# All lengths below are in bore diameters, so that a small tube is pressed like a large one.
FIRST_INCREMENT = 2.5e-3
LARGEST_INCREMENT = 1 / 16
SMALLEST_INCREMENT = 1e-5
EASY_ITERATIONS = 8
"""Largest number of Newton iterations after which the next increment is doubled."""
FORCE_TOLERANCE = 1e-8
"""Largest norm of the residual forces at convergence, in shear moduli times squared bore
diameters."""
SPACING = 1 / 8
"""Smallest spacing in bore diameters of depths solved in rising order, before those in between."""
EXTRAPOLATED_STATES = 3
"""Largest number of converged states from which an increment's start is extrapolated."""


class _Increment(NamedTuple):
    """A converged increment of the load path: its depth in m, solution, and results."""

    depth: float
    solution: NewtonResult
    results: EquilibriumResults


def load_path(
    untouched: Indentation,
    model: Model,
    targets: Array,
    progress: Progress | None = None,
    *,
    guide: Guide | None = None,
    tolerance: float = FORCE_TOLERANCE,
    largest: float = LARGEST_INCREMENT,
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
    guide : Guide, optional
        Load path on a coarser mesh; up to its largest depth only the target depths are solved.
    tolerance : float
        Largest norm of the residual forces at convergence, in shear moduli times squared bore
        diameters.
    largest : float
        Largest increment without a guide, in bore diameters.

    Returns
    -------
    Indentation
        First contact and every converged increment, in order of depth.

    Raises
    ------
    PressError
        If increments would have to be shorter than `SMALLEST_INCREMENT` to converge.
    """
    tube, bore = untouched.tube, untouched.tube.inner_diameter
    allowed = tolerance * tube.shear_modulus * bore**2
    start = NewtonResult(untouched.displacement[0], True, 0, 0.0)
    first = _Increment(0.0, start, _results_at_first_touch(model, untouched))
    asked = targets
    if guide is not None:
        targets = np.unique(np.append(targets, min(guide.reach, targets[-1])))
    problem = _Problem(untouched, model, allowed, largest * bore)
    chain = spread(targets, SPACING * bore)
    share = len(chain) / len(targets)
    done, failure = _follow(problem, [first], chain, part_of(progress, 0.0, share), guide)
    left = np.setdiff1d(targets[targets < done[-1].depth], [each.depth for each in done])
    for count, depth in enumerate(_by_bisection(left, done), start=len(chain) + 1):
        done, stopped = _between(problem, done, depth, guide)
        failure = stopped or failure
        if progress:
            progress(count / len(targets))
    if failure is not None:
        raise _failed(untouched, done, asked, failure)
    return _gathered(untouched, done)


class _Problem(NamedTuple):
    """A press: its first contact, model, allowed residual in N and largest increment in m."""

    untouched: Indentation
    model: Model
    allowed: float
    largest: float


def spread(targets: Array, spacing: float) -> Array:
    """Return those of the target depths, at least `spacing` apart, that are solved first.

    The last is always one of them.
    """
    kept = [targets[-1]]
    for target in targets[-2::-1]:
        if kept[-1] - target >= spacing * (1 - 1e-9):
            kept.append(target)
    return np.array(kept[::-1])


def _by_bisection(targets: Array, done: Sequence[_Increment]) -> list[float]:
    """Return the targets in bisection order: next is that nearest the middle of the widest gap."""
    order, left, known = [], targets, np.array([each.depth for each in done])
    while len(left):
        above = np.searchsorted(known, left)
        low, high = known[above - 1], known[above]
        widest = np.flatnonzero(high - low >= (high - low).max() * (1 - 1e-9))
        best = widest[np.argmin(np.abs(left - (low + high) / 2)[widest])]
        order.append(float(left[best]))
        known = np.insert(known, above[best], left[best])
        left = np.delete(left, best)
    return order


def _follow(
    problem: _Problem,
    done: Sequence[_Increment],
    targets: Array,
    progress: Progress | None,
    guide: Guide | None,
) -> tuple[list[_Increment], NewtonResult | None]:
    """Extend the load path to the last target depth, with an increment at each target.

    Also return the failed solution if Newton's method fails at the smallest increment, else None.
    """
    untouched, model, largest = problem.untouched, problem.model, problem.largest
    done, bore = list(done), untouched.tube.inner_diameter
    increment = np.inf if guide is not None else FIRST_INCREMENT * bore
    while done[-1].depth < targets[-1]:
        if guide is not None and done[-1].depth >= guide.reach:
            guide, increment = None, min(increment, largest)
        depth = _next_depth(targets, done[-1].depth, increment)
        guesses = _ahead(model, done[-EXTRAPOLATED_STATES:], depth, guide)
        solution = _solved(problem, done[-1], guesses, depth)
        if not solution.converged:
            increment = (depth - done[-1].depth) / 2
            if increment < SMALLEST_INCREMENT * bore:
                return done, solution
            continue
        done.append(_increment(problem, depth, solution))
        if solution.iterations <= EASY_ITERATIONS:
            increment = 2 * increment if guide is not None else min(2 * increment, largest)
        if progress:
            left = float(targets[-1]) - depth
            if guide is None:
                progress(_fraction_done(len(done), left, increment, largest))
            else:
                progress(depth / float(targets[-1]))
    return done, None


def _between(
    problem: _Problem, done: list[_Increment], depth: float, guide: Guide | None
) -> tuple[list[_Increment], NewtonResult | None]:
    """Insert an increment at a depth between two others; the results are those of :func:`_follow`.

    After a failure the depth may be beyond the last increment: then nothing is inserted. If
    Newton's method fails from the state interpolated between the neighbours, a load path from the
    lower neighbour is followed. If that fails too, the deeper increments are dropped.
    """
    if depth > done[-1].depth:
        return done, None
    above = int(np.searchsorted([each.depth for each in done], depth))
    near = done[max(above - 2, 0) : above + 2]
    nearest = min(near, key=lambda each: abs(each.depth - depth))
    guesses = [_interpolated(near, depth)]
    if guide is not None and done[above].depth <= guide.reach:
        within = [each for each in near if each.depth <= guide.reach]
        guesses.append(_corrected(guide, problem.model, within, depth))
    solution = _solved(problem, nearest, guesses, depth)
    if solution.converged:
        return [*done[:above], _increment(problem, depth, solution), *done[above:]], None
    path, failure = _follow(problem, done[:above], np.array([depth]), None, None)
    return path + ([] if failure else done[above:]), failure


def _increment(problem: _Problem, depth: float, solution: NewtonResult) -> _Increment:
    bodies = bodies_at(problem.untouched, depth)
    results = equilibrium_results(problem.model, solution.displacement, bodies)
    return _Increment(depth, solution, results)


def _results_at_first_touch(model: Model, untouched: Indentation) -> EquilibriumResults:
    """Return the results of the undeformed tube; contact forces are still zero there."""
    none = np.zeros(len(untouched.indenters))
    return EquilibriumResults(none, none, 0.0, 1.0, model.lumen.smallest_gap(model.mesh.points))


def _next_depth(targets: Array, reached: float, increment: float) -> float:
    """Return the next depth: the next target if within 1.05 increments, else one increment on."""
    target = float(targets[np.searchsorted(targets, reached, side="right")])
    return target if reached + 1.05 * increment >= target else reached + increment


def _ahead(
    model: Model, last: Sequence[_Increment], depth: float, guide: Guide | None
) -> list[Array]:
    """Return predictors of the displacements, extrapolated from the last increments to a depth."""
    # Low orders as well: a high order overshoots where contact grows faster than extrapolated.
    guesses = [_interpolated(last[-n:], depth) for n in range(2, len(last) + 1)]
    if guide is not None:
        guesses.append(_corrected(guide, model, last[-1:], depth))
    return guesses


def _solved(
    problem: _Problem, near: _Increment, guesses: Sequence[Array], depth: float
) -> NewtonResult:
    """Return Newton's solution from the predictor of lowest energy without self-intersection.

    If all predictors intersect themselves, each is replaced by a state short of the first crossing,
    on the line to it from the state of the increment `near`. If no energy is finite, Newton's
    method starts from the state of `near`.
    """
    model, bodies = problem.model, bodies_at(problem.untouched, depth)
    here, points = near.solution.displacement, problem.model.mesh.points
    sound = [guess for guess in guesses if not model.lumen.crosses_itself(points + guess)]
    if not sound:
        for guess in guesses:
            clear = model.lumen.collision_free_fraction(points + here, points + guess)
            sound.append(here + clear * (guess - here))
    states = [evaluate(model, guess, bodies) for guess in sound]
    finite = [state for state in states if np.isfinite(state.energy)]
    best = min(finite, key=lambda state: state.energy) if finite else here
    return minimise(model, best, bodies, problem.allowed)


def _interpolated(increments: Sequence[_Increment], depth: float) -> Array:
    """Return the displacements at a depth, by the polynomial through those of increments."""
    states = [each.solution.displacement for each in increments]
    return _lagrange([each.depth for each in increments], states, depth)


def _corrected(guide: Guide, model: Model, increments: Sequence[_Increment], depth: float) -> Array:
    """Return the guide's state at a depth, minus its error interpolated from solved increments."""
    depths = [each.depth for each in increments]
    differences = [
        each.solution.displacement - guide.displacement(each.depth) * model.free
        for each in increments
    ]
    return guide.displacement(depth) * model.free + _lagrange(depths, differences, depth)


def _lagrange(depths: Sequence[float], states: Sequence[Array], depth: float) -> Array:
    """Return the value at `depth` of the Lagrange polynomial through states at other depths."""
    x = np.array(depths)
    weights = [np.prod((depth - np.delete(x, i)) / (x[i] - np.delete(x, i))) for i in range(len(x))]
    return np.tensordot(weights, np.stack(states), axes=1)


def _fraction_done(n_done: int, left: float, increment: float, largest: float) -> float:
    """Return the fraction of the expected increments that is done, with `left` m still to go."""
    expected = np.log2(largest / increment) + left / largest
    return float(n_done / (n_done + expected)) if left > 0 else 1.0


def _failed(
    untouched: Indentation, done: Sequence[_Increment], targets: Array, last: NewtonResult
) -> PressError:
    """Return the error of a press whose increment failed, with the increments converged so far."""
    reached = int(np.isin(targets, [each.depth for each in done]).sum())
    count = f"; {reached} of the {len(targets)} depths were reached" if len(targets) > 1 else ""
    return PressError(
        f"the indentation stopped at a depth of {MM * done[-1].depth:.2f} mm of "
        f"{MM * targets[-1]:.2f} mm: {last.reason} (residual force {last.residual:.1e} N)"
        f"{count}; reduce the depth, use a larger indenter, or refine the mesh (from Python)",
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
