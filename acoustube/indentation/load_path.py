"""Adaptive load stepping: the load path of a press from first contact to its final depth.

The increments of depth are doubled where Newton's method converges in few iterations and halved
where it fails [1]_. Each starts from a polynomial extrapolation of the previous states, cut short
before the lumen's walls would cross. With a guide (:mod:`acoustube.indentation.guide`) an increment
reaches from one of the depths asked for to the next, and starts from the guide's state, moved by
what the last state on the own mesh differed from it, or from the extrapolation, whichever has the
lower energy.

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
from acoustube.indentation.assembly import (
    EquilibriumResults,
    Model,
    equilibrium_results,
    evaluate,
)
from acoustube.indentation.contact import Body
from acoustube.indentation.guide import Guide
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
        Load path on a coarser mesh; up to its reach only the targets are met.
    tolerance : float
        Norm of the residual forces at convergence, in shear moduli times squared bore diameters.
    largest : float
        Largest increment without a guide, in bore diameters.

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
    allowed = tolerance * tube.shear_modulus * bore**2
    start = NewtonResult(untouched.displacement[0], True, 0, 0.0)
    done = [_Increment(0.0, start, _results_at_first_touch(model, untouched))]
    largest, increment = largest * bore, FIRST_INCREMENT * bore
    if guide is not None:
        increment = np.inf
        targets = np.unique(np.append(targets, min(guide.reach, targets[-1])))
    while done[-1].depth < targets[-1]:
        if guide is not None and done[-1].depth >= guide.reach:
            guide, increment = None, min(increment, largest)
        depth = _next_depth(targets, done[-1].depth, increment)
        bodies = bodies_at(untouched, depth)
        guess = _start(model, done[-EXTRAPOLATED_STATES:], depth, bodies, guide)
        solution = minimise(model, guess, bodies, allowed)
        if not solution.converged:
            increment = (depth - done[-1].depth) / 2
            if increment < SMALLEST_INCREMENT * bore:
                raise _failed(untouched, done, targets[-1], solution)
            continue
        results = equilibrium_results(model, solution.displacement, bodies)
        done.append(_Increment(depth, solution, results))
        if solution.iterations <= EASY_ITERATIONS:
            increment = 2 * increment if guide is not None else min(2 * increment, largest)
        if progress:
            left = float(targets[-1]) - depth
            if guide is None:
                progress(_fraction_done(len(done), left, increment, largest))
            else:
                progress(depth / float(targets[-1]))
    return _gathered(untouched, done)


def _results_at_first_touch(model: Model, untouched: Indentation) -> EquilibriumResults:
    """Return the results of the undeformed tube; contact forces are still zero there."""
    none = np.zeros(len(untouched.indenters))
    return EquilibriumResults(none, none, 0.0, 1.0, model.lumen.smallest_gap(model.mesh.points))


def _next_depth(targets: Array, reached: float, increment: float) -> float:
    """Return the depth of the next increment; one ending just short of a target meets it."""
    target = float(targets[np.searchsorted(targets, reached, side="right")])
    return target if reached + 1.05 * increment >= target else reached + increment


def _start(
    model: Model,
    last: Sequence[_Increment],
    depth: float,
    bodies: tuple[Body, ...],
    guide: Guide | None,
) -> Array:
    """Return the start of an increment: the guess of the lowest energy, short of any collision."""
    here, points = last[-1].solution.displacement, model.mesh.points
    # Of a low order as well: a high one overshoots where the contact grows unforeseen.
    guesses = [_extrapolated(last[-n:], depth) for n in range(2, len(last) + 1)]
    if guide is not None:
        change = guide.displacement(depth) - guide.displacement(last[-1].depth)
        guesses.append(here + change * model.free)
    best, least = here, np.inf
    for ahead in guesses:
        guess = ahead
        if model.lumen.crosses_itself(points + ahead):
            clear = model.lumen.collision_free_fraction(points + here, points + ahead)
            guess = here + clear * (ahead - here)
        energy = evaluate(model, guess, bodies).energy
        if energy < least:
            best, least = guess, energy
    return best


def _extrapolated(last: Sequence[_Increment], depth: float) -> Array:
    """Return the Lagrange extrapolation of the last states to a depth."""
    x = np.array([done.depth for done in last])
    weights = [np.prod((depth - np.delete(x, i)) / (x[i] - np.delete(x, i))) for i in range(len(x))]
    states = np.stack([done.solution.displacement for done in last])
    return np.tensordot(weights, states, axes=1)


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
