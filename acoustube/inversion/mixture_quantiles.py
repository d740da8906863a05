"""Compiled quantiles of mixtures of normal distributions."""

from __future__ import annotations

import math

import numba
import numpy as np

from acoustube.base.types import Array
from acoustube.inversion.small_matrices import OPTIONS

HALVINGS = 50
"""Number of bisections: a quantile is found within 1e-15 of the range that contains it."""


@numba.njit(**OPTIONS)
def quantiles(
    probability: Array, normal: Array, weight: Array, mean: Array, deviation: Array
) -> Array:
    """Return quantiles (m,) of a mixture of normal distributions, by bisection.

    A quantile of the mixture lies between the least and the largest of those of its distributions.

    Parameters
    ----------
    probability : ndarray
        Probabilities of the quantiles, (m,).
    normal : ndarray
        Quantiles of the standard normal distribution for these probabilities, (m,).
    weight, mean, deviation : ndarray
        Weights, of sum 1, means and standard deviations of the distributions, (n,).
    """
    found = np.empty(len(probability))
    for i in range(len(probability)):
        low, high = math.inf, -math.inf
        for j in range(len(mean)):
            own = mean[j] + normal[i] * deviation[j]
            low, high = min(low, own), max(high, own)
        for _ in range(HALVINGS):
            middle, below = 0.5 * (low + high), 0.0
            for j in range(len(mean)):
                off = (middle - mean[j]) / deviation[j]
                below += 0.5 * weight[j] * math.erfc(-off / math.sqrt(2.0))
            if below < probability[i]:
                low = middle
            else:
                high = middle
        found[i] = 0.5 * (low + high)
    return found
