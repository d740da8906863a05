"""Error of the forward model, estimated from a recording, and its effect on positions and depths.

The error of the model changes the shape of the echo: a wall on another mesh or a lumen on another
grid scatters much as the library's at another depth. This part of the error lies along the
derivative of the echo and leaves no residual, whereas noise of the same power would mostly be
perpendicular to the derivative.

References
----------
* Discrepancy of a model, which data reveal only in part: Kennedy, M. C. and O'Hagan, A. (2001).
  Journal of the Royal Statistical Society B 63, 425-464. doi:10.1111/1467-9868.00294
* Variance by the likelihood of the residuals alone: Patterson, H. D. and Thompson, R. (1971).
  Biometrika 58, 545-554. doi:10.1093/biomet/58.3.545
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from acoustube.base.types import Array
from acoustube.inversion.doubt import LARGEST, SAMPLES
from acoustube.inversion.hypotheses import ERRORS, Hypothesis
from acoustube.inversion.likelihood import echo_of, whitened
from acoustube.inversion.model import NUISANCES, ForwardModel
from acoustube.inversion.parameters import limited, split
from acoustube.waves.scattering import Complex


class Discrepancy(NamedTuple):
    """Weights of the maxima, and deviations of positions and depths due to the error of the model.

    Attributes
    ----------
    level : ndarray
        Minus twice the logarithms of the weights of the maxima, up to a constant, (n,).
    deviation : ndarray
        Standard deviations in m of position and depth of each press in turn, (n, 2 n_presses).
    """

    level: Array
    deviation: Array


def discrepancy(
    model: ForwardModel, known: Hypothesis, samples: Complex, noise: float
) -> Discrepancy:
    """Return the discrepancy of the model about each maximum of a hypothesis.

    The relative errors of :data:`acoustube.inversion.hypotheses.ERRORS` are equally likely a
    priori. For each, the parameters are marginalised, since a fit absorbs a part of the error. The
    posterior root mean square of the relative error, times the echo of a press, is taken to lie
    wholly along the derivative by position, and also wholly along that by depth. The offsets of the
    priors are added in quadrature. The weights of all maxima are those for one relative error: that
    of the first maximum, up to :data:`acoustube.inversion.doubt.LARGEST`, times the root of
    :data:`acoustube.inversion.doubt.SAMPLES`. Such an error hardly distinguishes them, and a
    maximum that explains the samples far worse could have the largest weight. The maximum that is
    most likely without that factor, with the relative error marginalised, is therefore given the
    largest weight too.

    Parameters
    ----------
    model : ForwardModel
    known : Hypothesis
    samples : ndarray
        Baseband of the cycles in counts, (n_time,).
    noise : float
        Variance of the noise of a sample, in counts squared.
    """
    places, depths, nuisances = split(known.fits.parameters)
    value, jacobian = model.baseband(known.tools, places, depths, nuisances)
    echo = echo_of(model, known.tools, known.best)
    both = np.concatenate([(samples - value)[:, None], jacobian], axis=1)

    def restricted(error: float) -> Array:
        white, size = whitened(model, noise, error, echo, known.whiten.spread, both)
        return restricted_deviance(model, known.fits.parameters, white[:, 0], white[:, 1:], size)

    deviance = np.array([restricted(error) for error in ERRORS])
    least = deviance.min(axis=0)
    likelihood = np.exp(-0.5 * (deviance - least))
    marginal = likelihood.sum(axis=0)
    likeliest = np.argmin(least - 2 * np.log(marginal))
    error = np.sqrt(np.square(ERRORS) @ likelihood / marginal)
    # The error changes an echo as a whole: it distinguishes maxima less than its samples would.
    level = restricted(np.sqrt(SAMPLES) * min(float(error[0]), LARGEST))
    level[likeliest] = np.nextafter(level.min(), -np.inf)
    m = len(known.tools)
    slope = np.linalg.norm(known.whiten(jacobian[:, : 2 * m]), axis=2)
    deviation = np.empty_like(slope)
    for i in reversed(range(m)):
        before = model.baseband(known.tools[:i], places[:, :i], depths[:, :i], nuisances)[0]
        own = np.linalg.norm(known.whiten(value - before), axis=1)
        deviation[:, 2 * i : 2 * i + 2] = (error * own)[:, None] / slope[:, 2 * i : 2 * i + 2]
        value = before
    return Discrepancy(level, np.hypot(deviation, model.priors.offsets(m)))


def restricted_deviance(
    model: ForwardModel, parameters: Array, rest: Complex, slopes: Complex, logarithm: float
) -> Array:
    """Return minus twice the log likelihood with the parameters marginalised, (n,).

    The model is linearised about each set of parameters, but no farther from it in place and depth
    than :data:`acoustube.inversion.parameters.LARGEST_STEPS`. The result omits a constant.

    Parameters
    ----------
    model : ForwardModel
    parameters : ndarray
        As in :class:`acoustube.inversion.fit.Fits`, (n, n_parameters).
    rest : ndarray
        Residual, whitened, (n, n_time).
    slopes : ndarray
        Derivatives of the model, whitened, (n, n_parameters, n_time).
    logarithm : float
        :attr:`.Weights.log_determinant`.
    """
    precision = np.zeros(parameters.shape[1])
    precision[-len(NUISANCES) :] = 1 / model.priors.deviations**2
    information = 2 * (slopes.conj() @ slopes.swapaxes(1, 2)).real + np.diag(precision)
    gradient = precision * parameters - 2 * (slopes.conj() @ rest[..., None])[..., 0].real
    step = np.asarray(np.linalg.solve(information, gradient[..., None])[..., 0], float)
    # Step towards the minimum as far as the linear model holds: it may lie beyond a bound.
    part = np.min(
        limited(step) / np.where(step == 0, 1.0, step), axis=1, initial=1.0, where=step != 0
    )
    least = 2 * np.sum(np.abs(rest) ** 2, axis=1) + parameters**2 @ precision
    least -= part * (2 - part) * np.sum(gradient * step, axis=1)
    curvature = np.linalg.slogdet(information)[1]
    return np.asarray(least + 2 * logarithm + curvature)
