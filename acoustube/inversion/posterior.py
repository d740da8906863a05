"""Posterior distributions of a hypothesis's parameters: mixtures of normal distributions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri

from acoustube.base.types import Array
from acoustube.inversion.hypotheses import Hypothesis
from acoustube.inversion.model_error import Discrepancy

LEVELS = 0.68, 0.9
"""Probabilities of the central intervals that are reported."""
TAILS = np.array([(1 + sign * level) / 2 for level in LEVELS for sign in (-1, 1)])
NORMAL = ndtri(TAILS)
"""Probabilities below the ends of these intervals, and ends of those of the standard normal
distribution."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """Estimate of one quantity, with its posterior distribution.

    Attributes
    ----------
    value : float
        Value at the most likely maximum: the first mean of the mixture.
    deviation : float
        Standard deviation of the posterior.
    intervals : dict of float
        Ends of the central interval of each probability of :data:`LEVELS`.
    weights, means, deviations : ndarray
        Weights, means and standard deviations of the normal distributions whose mixture is the
        posterior, (n,).
    """

    value: float
    deviation: float
    intervals: dict[float, tuple[float, float]]
    weights: Array
    means: Array
    deviations: Array

    def density(self, value: ArrayLike) -> Array:
        """Return the probability density at values of any shape, per unit of the quantity."""
        off = (np.asarray(value)[..., None] - self.means) / self.deviations
        return np.asarray(
            np.exp(-(off**2) / 2) / np.sqrt(2 * pi) @ (self.weights / self.deviations)
        )


class Posterior:
    """Mixture of normal distributions, one about each maximum of a hypothesis.

    Where the mean square of the hypothesis's whitened residual exceeds 1, the variances (Laplace's
    approximation) are multiplied by it, and the logarithms of the weights are divided by it.

    Parameters
    ----------
    hypothesis : Hypothesis
    off : Discrepancy
        Effect of the model's error on the weights of the maxima and on places and depths.
    """

    def __init__(self, hypothesis: Hypothesis, off: Discrepancy) -> None:
        fits = hypothesis.fits
        inflation = max(1.0, hypothesis.mean_square)
        n = fits.parameters.shape[1]
        covariance: Array = np.asarray(np.linalg.inv(fits.information + 1e-12 * np.eye(n)), float)
        self.mean = fits.parameters
        self.variance = inflation * np.maximum(np.einsum("nii->ni", covariance), 0.0)
        self.variance[:, : off.deviation.shape[1]] += off.deviation**2
        self.covariance_with_bore = inflation * covariance[:, -1]
        self.weight = np.exp(-0.5 * (off.level - off.level.min()) / inflation)
        self.weight /= self.weight.sum()

    def estimate(self, parameter: int, error: float = 0.0) -> Estimate:
        """Return the marginal distribution of the parameter with index `parameter`.

        An independent error of standard deviation `error` is added.
        """
        deviation = np.sqrt(self.variance[:, parameter] + error**2)
        return mixture(self.weight, self.mean[:, parameter], deviation)

    def depth(self, parameter: int) -> Estimate:
        """Return the marginal distribution of the depth with index `parameter` in the tube's bore.

        See :func:`in_own_bore`.
        """
        mean, deviation = in_own_bore(
            self.mean[:, [parameter, -1]], self.variance[:, [parameter, -1]],
            self.covariance_with_bore[:, parameter],
        )  # fmt: skip
        return mixture(self.weight, mean, deviation)

    def mapped(
        self,
        parameter: int,
        function: Callable[[Array, int], Array],
        error: Callable[[Array], Array],
    ) -> Estimate:
        """Return the distribution of an increasing function of a parameter.

        The function is linearised about each maximum. Its own error is added.

        Parameters
        ----------
        parameter : int
            Index of the parameter.
        function : callable
            Takes values of the parameter and the order of the derivative to return.
        error : callable
            Takes values of the parameter and returns the standard deviation of the function itself.
        """
        mean = self.mean[:, parameter]
        slope = function(mean, 1)
        deviation = np.hypot(slope * np.sqrt(self.variance[:, parameter]), error(mean))
        return mixture(self.weight, function(mean, 0), deviation)


def in_own_bore(mean: Array, variance: Array, covariance: Array) -> tuple[Array, Array]:
    """Return mean and standard deviation in m of depths in the tube's bore, (n,) each.

    A depth of the library belongs to the library's bore. In a wider bore, the press with the same
    echo is deeper in proportion.

    Parameters
    ----------
    mean, variance : ndarray
        Means and variances of the depth in m and of the relative deviation of the bore, (n, 2).
    covariance : ndarray
        Covariance of both, (n,).
    """
    depth, ratio = mean[:, 0], 1 + mean[:, 1]
    spread = ratio**2 * variance[:, 0] + 2 * ratio * depth * covariance + depth**2 * variance[:, 1]
    return ratio * depth, np.sqrt(np.maximum(spread, 0.0))


def mixture(weight: Array, mean: Array, deviation: Array) -> Estimate:
    """Return the estimate of a quantity whose distribution is a mixture of normal distributions.

    Parameters
    ----------
    weight, mean, deviation : ndarray
        Weights, of sum 1, means and standard deviations of the normal distributions, (n,). The
        first mean is the value of the estimate.
    """
    deviation = np.maximum(deviation, 1e-15)
    if len(mean) == 1:
        value, spread = float(mean[0]), float(deviation[0])
        reach = {level: spread * float(ndtri((1 + level) / 2)) for level in LEVELS}
        ends = {level: (value - r, value + r) for level, r in reach.items()}
        return Estimate(value, spread, ends, weight, mean, deviation)
    middle = float(weight @ mean)
    spread = float(np.sqrt(weight @ (deviation**2 + (mean - middle) ** 2)))
    from acoustube.inversion.mixture_quantiles import quantiles  # imports Numba

    found = quantiles(TAILS, NORMAL, *(np.ascontiguousarray(x) for x in (weight, mean, deviation)))
    ends = {level: (float(found[2 * i]), float(found[2 * i + 1])) for i, level in enumerate(LEVELS)}
    return Estimate(float(mean[0]), spread, ends, weight, mean, deviation)
