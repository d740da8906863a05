"""Test of one press more: whether it is real, or fits an error of the model of the others.

The error of the model is taken as independent from sample to sample of an echo. It is not: a wall
on another mesh changes an echo as a whole, by far fewer numbers than it has samples. A faint press
in front of a strong one may explain such an error, and seem likely by the number of its samples. So
one press more is credited only with what it explains beyond an error of the model of
:data:`SAMPLES` times the power, as if so many samples were one.
"""

from __future__ import annotations

from dataclasses import replace
from math import sqrt

from acoustube.inversion.fit import evidence, maximise
from acoustube.inversion.hypotheses import Builder, Hypothesis
from acoustube.inversion.likelihood import Weights, echo_of, weights
from acoustube.inversion.model import ForwardModel

SAMPLES = 10
"""Samples of an echo over which its error is correlated: 0.8 ms, by trapped sound."""
LEAST, BENT_LEAST, LARGEST = 0.02, 0.06, 0.1
"""Least errors of the model that are allowed for, of a straight tube and of a wrapped one, and the
largest: two solvers, or meshes, differ by the least near closure, echoes on a sleeve next to a
cut-on; an error over the largest stands for presses not found yet."""
SMALL_ERROR = 0.01
"""Error of the model, with one press more, up to which it is taken as its error in truth: what was
larger without was the missing press."""
ITERATIONS = 6
"""Iterations of each fit with these weights."""


def doubt_weights(model: ForwardModel, known: Hypothesis, noise: float, seen: float) -> Weights:
    """Return the weights by which one press more is credited.

    Parameters
    ----------
    model : ForwardModel
    known : Hypothesis
        Of one press or more.
    noise : float
        Variance of a sample of the mean of cycles.
    seen : float
        Relative error of the model that was found.
    """
    least = BENT_LEAST if model.path.converts else LEAST
    error = sqrt(SAMPLES) * min(max(seen, least), LARGEST)
    echo = echo_of(model, known.tools, known.best)
    return weights(model, noise, error, echo, known.whiten.spread)


def doubted(builder: Builder, fewer: Hypothesis, more: Hypothesis) -> Hypothesis:
    """Return a hypothesis with the evidence that it has beyond the error of the model of another.

    Parameters
    ----------
    builder : Builder
    fewer : Hypothesis
        Of one press or more.
    more : Hypothesis
        Of more presses.

    Returns
    -------
    Hypothesis
        `more` with the larger one of two deviances: that of its own fits, and that of `fewer` plus
        the change of deviance with the weights stated above.
    """
    model = builder.model
    seen = more.error if more.error <= SMALL_ERROR else fewer.error
    whiten = doubt_weights(model, fewer, builder.noise, seen)
    deviance = []
    for one in (fewer, more):
        start = one.fits.parameters[:1]
        fit = maximise(model, one.tools, start, builder.samples, whiten, ITERATIONS)
        deviance.append(float(evidence(model, one.tools, fit, whiten)[0]))
    # That of `more` may be the result of an earlier call.
    own = builder.own_deviance(more)
    return replace(more, deviance=max(own, fewer.deviance + deviance[1] - deviance[0]))
