"""From residuals on rows that were not trained with to deviations that can be relied on.

Conformal prediction [1]_: whatever scale an estimator states for each estimate, the quantiles of
residual over scale on held-out rows tell by what the scale must be multiplied to hold a wanted
share of the truths. The rows must be like those that will come: held out by tube, for new tubes.

References
----------
.. [1] J. Lei et al., Distribution-free predictive inference for regression, Journal of the American
   Statistical Association 113 (2018), 1094-1111. doi:10.1080/01621459.2017.1307116
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from acoustube.base.errors import ConfigError
from acoustube.base.types import Array

LEVELS = np.append(np.arange(1, 100) / 100, 0.995)
"""Coverages at which the quantiles are kept."""
ONE_DEVIATION = 0.6827
"""Coverage of one standard deviation of a normal variable."""
NORMAL_MEDIAN = 1.4826
"""Standard deviation of normal numbers over the median of their sizes."""
MOST_BINS, ROWS_PER_BIN = 20, 30


def conformal_quantiles(residual: ArrayLike, scale: ArrayLike) -> Array:
    """Return by what a scale must be multiplied for each coverage of :data:`LEVELS`.

    Parameters
    ----------
    residual, scale : array of shape (n, ...)
        Of held-out rows, along the first axis; the scale is positive.

    Returns
    -------
    array of shape (level, ...)

    Notes
    -----
    The quantile of level p is the ceil((n + 1) p)-th smallest of the residuals' sizes over their
    scales: a new row like these lies within it with a probability of p at least. Where there are
    too few rows for a level, the largest.
    """
    score = np.sort(np.abs(np.asarray(residual)) / np.asarray(scale), axis=0)
    rank = np.ceil((len(score) + 1) * LEVELS - 1e-9).astype(int)
    return np.asarray(score[np.clip(rank, 1, len(score)) - 1])


def factor(quantiles: Array, coverage: float = ONE_DEVIATION) -> Array:
    """Return the factor for a coverage, between those that are kept.

    Parameters
    ----------
    quantiles : array of shape (level, ...)
        Of :func:`conformal_quantiles`.
    coverage : float
        Share of the truths that an interval is to hold.

    Raises
    ------
    ConfigError
        If it lies outside the levels.
    """
    if not LEVELS[0] <= coverage <= LEVELS[-1]:
        raise ConfigError(
            f"coverage = {coverage:g} is out of range; use {LEVELS[0]:g} to {LEVELS[-1]:g}"
        )
    above = int(np.searchsorted(LEVELS, coverage))
    below = max(above - 1, 0)
    share = 1.0 if above == below else (coverage - LEVELS[below]) / (LEVELS[above] - LEVELS[below])
    return np.asarray((1 - share) * quantiles[below] + share * quantiles[above])


def residual_scale(estimate: Array, residual: Array) -> tuple[Array, Array]:
    """Return how residuals grow with the estimate.

    Parameters
    ----------
    estimate, residual : array of shape (n,)
        Of held-out rows.

    Returns
    -------
    at, scale : array of shape (bin,)
        Median of the estimates of a bin, and the deviation of its residuals by the median of their
        sizes. The bins hold as many rows each; interpolate between them.
    """
    order = np.argsort(estimate, kind="stable")
    count = int(np.clip(len(order) // ROWS_PER_BIN, 1, MOST_BINS))
    parts = np.array_split(order, count)
    at = np.array([np.median(estimate[part]) for part in parts])
    scale = np.array([NORMAL_MEDIAN * np.median(np.abs(residual[part])) for part in parts])
    # Where more than half the rows of a bin fit exactly, another bin's scale is a fair guess.
    typical = float(np.median(np.abs(residual))) or float(np.mean(np.abs(residual)))
    return at, np.maximum(scale, 1e-3 * typical + np.finfo(float).tiny)


class Conformal:
    """What all estimators do with an estimate, its scale and the scale's quantiles.

    Attributes
    ----------
    quantiles_ : array of shape (level, target)
        Of :func:`conformal_quantiles`.
    """

    quantiles_: Array

    def _estimated(self, X: ArrayLike) -> tuple[Array, Array]:
        """Return estimates and their scales, both (row,) or (row, target)."""
        raise NotImplementedError

    def predict(self, X: ArrayLike, return_std: bool = False) -> Any:
        """Return estimates.

        Parameters
        ----------
        X : array of shape (row, input)
        return_std : bool
            Whether to return their deviations, too.

        Returns
        -------
        estimate, deviation : array of shape (row,) or (row, target)
            As the targets that were trained with. The deviation is half an interval that holds
            68 % of the truths, where they are like the held-out rows.
        """
        estimate, scale = self._estimated(X)
        if not return_std:
            return estimate
        return estimate, scale * factor(self.quantiles_)

    def half_width(self, X: ArrayLike, coverage: float = 0.9) -> Array:
        """Return half the intervals around the estimates that hold a share of the truths."""
        return np.asarray(self._estimated(X)[1] * factor(self.quantiles_, coverage))
