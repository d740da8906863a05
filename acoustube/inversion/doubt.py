"""Test of whether one additional press is real, or fits an error of the model of the others.

The error of the model is taken as independent from sample to sample of an echo. It is not: a wall
on another mesh changes an echo as a whole, with far fewer degrees of freedom than samples. A faint
press in front of a strong one may fit such an error, and appear likely because of the number of
samples. One additional press is therefore credited only with what it explains beyond an error of
the model with :data:`SAMPLES` times the power, as if so many samples were one.
"""

from __future__ import annotations

from dataclasses import replace
from math import sqrt

from acoustube.inversion.fit import evidence, maximise
from acoustube.inversion.hypotheses import Builder, Hypothesis
from acoustube.inversion.likelihood import echo_of, weights
from acoustube.inversion.model import ForwardModel
from acoustube.inversion.whitening import Weights

SAMPLES = 10
"""Number of samples over which an echo's error is correlated: 0.8 ms, because of trapped sound."""
LEAST, BENT_LEAST, LARGEST = 0.02, 0.06, 0.1
"""Limits of the relative error of the model that is assumed. `LEAST` is the lower one on a straight
tube: two solvers or meshes differ by as much near closure. `BENT_LEAST` is that on a wrapped tube:
echoes next to a cut-on differ by as much. `LARGEST` is the upper one: a larger error is due to
presses that are not detected yet."""
FALL = 0.4
"""Largest ratio of the model error found with one additional press to the error found without it,
at which the first is used: the second is then due to the absence of the press. Both are among
:data:`acoustube.inversion.hypotheses.ERRORS`, whose ratios next to this one are 1/3 and 1/2.
"""
ITERATIONS = 6
"""Largest number of iterations of each fit with the weights of :func:`doubt_weights`."""


def doubt_weights(
    model: ForwardModel, known: Hypothesis, noise: float, seen: Hypothesis
) -> Weights:
    """Return the weights with which one additional press is judged, for an enlarged model error.

    Parameters
    ----------
    model : ForwardModel
    known : Hypothesis
        Hypothesis of one press or more.
    noise : float
        Variance of a sample of the mean of cycles, in counts squared.
    seen : Hypothesis
        Hypothesis whose errors of the model are taken: the one in proportion to the echo, which is
        limited and enlarged, and the one that is equal at all times.
    """
    least = BENT_LEAST if model.path.converts else LEAST
    error = sqrt(SAMPLES) * min(max(seen.error, least), LARGEST)
    echo = echo_of(model, known.tools, known.best)
    return weights(model, noise, error, echo, seen.whiten.spread)


def doubted(builder: Builder, fewer: Hypothesis, more: Hypothesis) -> Hypothesis:
    """Return a hypothesis whose evidence credits one more press only beyond errors of the model.

    Parameters
    ----------
    builder : Builder
    fewer : Hypothesis
        Hypothesis of one press or more.
    more : Hypothesis
        Hypothesis of one press more than `fewer`.

    Returns
    -------
    Hypothesis
        `more` with the larger of two deviances. One is that of its own fits. The other is that of
        `fewer` plus the change from `fewer` to `more` with the weights of :func:`doubt_weights`.
    """
    model = builder.model
    seen = more if more.error <= FALL * fewer.error else fewer
    whiten = doubt_weights(model, fewer, builder.noise, seen)
    deviance = []
    for one in (fewer, more):
        start = one.fits.parameters[:1]
        fit = maximise(model, one.tools, start, builder.samples, whiten, ITERATIONS)
        deviance.append(float(evidence(model, one.tools, fit, whiten)[0]))
    # `more.deviance` may be the result of an earlier call.
    own = builder.own_deviance(more)
    return replace(more, deviance=max(own, fewer.deviance + deviance[1] - deviance[0]))
