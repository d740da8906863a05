"""Posterior of a sensor's parameters, with the scatter of its closures unknown.

References
----------
* Laplace's approximation and evidence: MacKay, D. J. C. (2003). Information Theory, Inference, and
  Learning Algorithms. Cambridge University Press.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np

from acoustube.base.types import Array
from acoustube.inversion.twin.fit import Normal, Point, Prior
from acoustube.inversion.twin.model import CORRECTIONS, LOCAL
from acoustube.inversion.twin.noise import Score

PLACEMENTS = np.geomspace(0.02e-3, 10e-3, 13)
"""Standard deviations in m of the stated positions of closures that are marginalised over."""
LEVELS = np.geomspace(3e-4, 0.3, 13)
"""Standard deviations of the log levels of closures that are marginalised over."""
COLOURS = np.geomspace(1e-4, 0.1, 7)
"""Standard deviations of the coefficients of the send pulse's correction (``level_k``, ``phase_k``)
that are marginalised over."""
USUAL = ((1e-3, 1.5), (0.02, 1.5), (0.01, 2.0))
"""Log-normal priors of the standard deviations in :data:`PLACEMENTS`, :data:`LEVELS` and
:data:`COLOURS`: median, and standard deviation of the logarithm."""


class Posterior(NamedTuple):
    """Posterior of the sensor's parameters, and of the errors of the stated positions.

    Attributes
    ----------
    mean : ndarray
        Means of the parameters, in the order of :data:`acoustube.inversion.twin.model.SHARED`,
        (n_shared,).
    covariance : ndarray
        Covariance of the parameters, (n_shared, n_shared).
    placement, level, colour : float
        Most likely standard deviations of positions in m, of log levels and of the coefficients of
        the send pulse's correction.
    displacement, displacement_deviation : ndarray
        Errors of the n stated positions in m, and their standard deviations, (n,).
    """

    mean: Array
    covariance: Array
    placement: float
    level: float
    colour: float
    displacement: Array
    displacement_deviation: Array


def with_scatter(prior: Prior, placement: float, level: Array | float, colour: float) -> Prior:
    """Return priors with other standard deviations of positions in m, log levels and correction.

    The correction is that of the send pulse, with the coefficients ``level_k`` and ``phase_k``.
    """
    deviation = prior.deviation.copy()
    deviation[list(CORRECTIONS)] = colour
    local = prior.local.copy()
    local[:, 0], local[:, 1] = placement, level
    return replace(prior, deviation=deviation, local=local)


def posterior(
    normal: Normal, prior: Prior, point: Point, extra_level: Array, score: Score | None = None
) -> Posterior:
    """Return the posterior of a sensor's parameters, averaged over the scatter of the closures.

    Parameters
    ----------
    normal : Normal
        Normal equations of the data at the maximum.
    prior : Prior
    point : Point
        Maximum of the posterior.
    extra_level : ndarray
        Known standard deviations of the log levels of the closures, due to rounding, (n,).
    score : Score, optional
        Covariance of the score if the noise is not white; white noise by default.

    Notes
    -----
    The model is linearised at the maximum. For a given scatter the posterior is normal and its
    evidence has a closed form. The average over a grid has the mean and the covariance of the
    mixture; with few closures it is wider, as Student's distribution is. With a score, the
    covariance of the shared parameters is White's, which is that of the estimate under this noise.
    The variance of a position is then the sum of two parts: that due to its own data, which follows
    from the weights, and that due to the covariance of the shared parameters.
    """
    cases = list(product(PLACEMENTS, LEVELS, COLOURS))
    n, p = len(point.local), len(point.shared)
    weights, means, covariances = np.zeros(len(cases)), np.zeros((len(cases), p)), []
    places, place_variances = np.zeros((len(cases), n)), np.zeros((len(cases), n))
    for i, scatter in enumerate(cases):
        spread = np.sqrt(scatter[1] ** 2 + extra_level**2)
        own = with_scatter(prior, scatter[0], spread, scatter[2])
        weights[i], means[i], covariance, places[i], place_variances[i] = _given(
            normal, own, point, score
        )
        covariances.append(covariance)
        for value, (median, width) in zip(scatter, USUAL, strict=True):
            weights[i] -= 0.5 * (np.log(value / median) / width) ** 2
    share = np.exp(weights - weights.max())
    share /= share.sum()
    mean = share @ means
    spread = means - mean
    covariance = np.einsum("i,ipq->pq", share, covariances) + (share * spread.T) @ spread
    place = share @ places
    best = cases[int(np.argmax(weights))]
    return Posterior(
        mean, covariance, *best, place,
        np.sqrt(share @ (place_variances + (places - place) ** 2)),
    )  # fmt: skip


def _given(
    normal: Normal, prior: Prior, point: Point, score: Score | None = None
) -> tuple[float, Array, Array, Array, Array]:
    """Return log evidence, mean, covariance, displacements and their variances for one prior."""
    precision, local_precision = prior.deviation**-2.0, prior.local**-2.0
    a = normal.shared + np.diag(precision)
    c = normal.local + local_precision[:, :, None] * np.eye(len(LOCAL))
    b_s = normal.right_shared - precision * (point.shared - prior.mean)
    b_l = normal.right_local - local_precision * point.local
    inverse = np.linalg.inv(c)
    passed = normal.mixed @ inverse
    schur = a - np.einsum("npl,nql->pq", passed, normal.mixed, optimize=True)
    right = b_s - np.einsum("npl,nl->p", passed, b_l)
    scale = 1 / np.sqrt(np.diag(schur))
    scaled = schur * scale[:, None] * scale
    covariance = np.linalg.inv(scaled) * scale[:, None] * scale
    step = covariance @ right
    local = (inverse @ (b_l - np.einsum("npl,p->nl", normal.mixed, step))[:, :, None])[:, :, 0]
    # Minus half of the objective at the maximum, and the determinants.
    gained = right @ step + np.einsum("nl,nlm,nm->", b_l, inverse, b_l)
    offset = ((point.shared - prior.mean) / prior.deviation) ** 2
    value = offset.sum() + ((point.local / prior.local) ** 2).sum() - gained
    determinant = np.linalg.slogdet(scaled)[1] - 2 * np.log(scale).sum()
    determinant += np.linalg.slogdet(c)[1].sum()
    log_evidence = -0.5 * (value + determinant + 2 * np.log(prior.deviation).sum())
    log_evidence -= np.log(prior.local).sum()
    if score is not None:
        own = score.local + local_precision[:, :, None] * np.eye(len(LOCAL))
        crossed = np.einsum("npl,nql->pq", passed, score.mixed, optimize=True)
        spread = np.diag(precision) + score.shared.sum(axis=0) - crossed - crossed.T
        spread += np.einsum("npl,nlm,nqm->pq", passed, own, passed, optimize=True)
        covariance = covariance @ spread @ covariance
    # Variance of the position: from its own data, and through the shared parameters.
    through = passed[:, :, 0]
    variance = inverse[:, 0, 0] + np.einsum("np,pq,nq->n", through, covariance, through)
    return (
        float(log_evidence),
        point.shared + step,
        covariance,
        point.local[:, 0] + local[:, 0],
        (variance),
    )
