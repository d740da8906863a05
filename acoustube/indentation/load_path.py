"""Load path of a press: adaptive increments of depth."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from acoustube.base.types import Array, Progress
from acoustube.indentation.assembly import Measures, Model, measures
from acoustube.indentation.newton import Equilibrium, minimise
from acoustube.indentation.result import Indentation, PressError, bodies_at

# All lengths below are in bore diameters, so that a small tube is pressed like a large one.
FIRST_INCREMENT = 2.5e-3
LARGEST_INCREMENT = 1 / 16
SMALLEST_INCREMENT = 1e-5
EASY_ITERATIONS = 8
FORCE_TOLERANCE = 1e-8
"""Out-of-balance force accepted, in shear moduli times squared bore diameters."""


class _Done(NamedTuple):
    """A converged increment."""

    depth: float
    result: Equilibrium
    measures: Measures


def load_path(
    untouched: Indentation, model: Model, targets: Array, progress: Progress | None
) -> Indentation:
    """Press from first touch to the last target, and gather every converged increment."""
    tube, bore = untouched.tube, untouched.tube.inner_diameter
    tolerance = FORCE_TOLERANCE * tube.shear_modulus * bore**2
    start = Equilibrium(untouched.displacement[0], True, 0, 0.0)
    done = [_Done(0.0, start, _at_first_touch(model, untouched))]
    increment = FIRST_INCREMENT * bore
    while done[-1].depth < targets[-1]:
        depth = _next_depth(targets, done[-1].depth, increment)
        bodies = bodies_at(untouched, depth)
        result = minimise(model, _guess(model, done[-3:], depth), bodies, tolerance)
        if not result.converged:
            increment = (depth - done[-1].depth) / 2
            if increment < SMALLEST_INCREMENT * bore:
                raise _stopped(untouched, done, targets[-1], result)
            continue
        done.append(_Done(depth, result, measures(model, result.displacement, bodies)))
        if result.iterations <= EASY_ITERATIONS:
            increment = min(2 * increment, LARGEST_INCREMENT * bore)
        if progress:
            left = float(targets[-1]) - depth
            progress(_share_done(len(done), left, increment, LARGEST_INCREMENT * bore))
    return _gathered(untouched, done)


def _at_first_touch(model: Model, untouched: Indentation) -> Measures:
    """Return the measures of the undeformed tube; the contact only begins to be felt there."""
    none = np.zeros(len(untouched.presses))
    return Measures(none, none, 0.0, 1.0, model.lumen.smallest_gap(model.mesh.points))


def _next_depth(targets: Array, reached: float, increment: float) -> float:
    """Return where the next increment ends; one that would end just short of a target meets it."""
    target = float(targets[np.searchsorted(targets, reached, side="right")])
    return target if reached + 1.05 * increment >= target else reached + increment


def _guess(model: Model, last: Sequence[_Done], depth: float) -> Array:
    """Return the polynomial through the last states at a new depth, short of any collision."""
    x = np.array([done.depth for done in last])
    weights = [np.prod((depth - np.delete(x, i)) / (x[i] - np.delete(x, i))) for i in range(len(x))]
    states = np.stack([done.result.displacement for done in last])
    here, ahead = states[-1], np.tensordot(weights, states, axes=1)
    share = model.lumen.free_share(model.mesh.points + here, model.mesh.points + ahead)
    return here + share * (ahead - here)


def _share_done(n_done: int, left: float, increment: float, largest: float) -> float:
    """Return the share of the expected increments that is done, with `left` m still to go."""
    expected = np.log2(largest / increment) + left / largest
    return float(n_done / (n_done + expected)) if left > 0 else 1.0


def _stopped(
    untouched: Indentation, done: Sequence[_Done], asked: float, failed: Equilibrium
) -> PressError:
    return PressError(
        f"The indentation stopped at a depth of {1e3 * done[-1].depth:.2f} mm of "
        f"{1e3 * asked:.2f} mm: {failed.reason} (out-of-balance force {failed.residual:.1e} N). "
        "Ask for less depth or a larger indenter; from Python, for a finer mesh.",
        _gathered(untouched, done),
    )


def _gathered(untouched: Indentation, done: Sequence[_Done]) -> Indentation:
    results = [increment.result for increment in done]
    measured: dict[str, Any] = {
        name: np.array([getattr(increment.measures, name) for increment in done])
        for name in Measures._fields
    }
    return dataclasses.replace(
        untouched,
        depth=np.array([increment.depth for increment in done]),
        displacement=np.stack([result.displacement for result in results]),
        iterations=np.array([result.iterations for result in results]),
        residual=np.array([result.residual for result in results]),
        **measured,
    )
