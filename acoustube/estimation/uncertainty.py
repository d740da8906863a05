"""Conformal prediction intervals from the residuals of held-out rows.

Split-conformal prediction [1]_: an estimator states a scale with each estimate. The factor on the
scale for a wanted coverage is a quantile of the ratio of absolute residual to scale on held-out
rows. Held-out and future rows must be exchangeable: for intervals valid in new tubes, rows are held
out by tube.

References
----------
.. [1] J. Lei et al., Distribution-free predictive inference for regression, Journal of the American
   Statistical Association 113 (2018), 1094-1111. doi:10.1080/01621459.2017.1307116
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.utils.validation import check_is_fitted

from acoustube.base.errors import ConfigError
from acoustube.base.types import Array
from acoustube.estimation.inputs import check_rows, check_settings, groups_of
from acoustube.estimation.splits import folds
from acoustube.signals.localise import NORMAL_MEDIAN

Folds = NDArray[np.intp]
Report = Callable[..., None] | None

LEVELS = np.append(np.arange(1, 100) / 100, 0.995)
"""Coverages at which the quantiles are stored."""
ONE_DEVIATION = 0.6827
"""Coverage of one standard deviation of a normal variable."""
MAX_BINS, ROWS_PER_BIN = 20, 30
"""Largest number of bins of :func:`residual_scale`, and least rows in each if there are several."""


def conformal_quantiles(residual: ArrayLike, scale: ArrayLike) -> Array:
    """Return the factor of a scale for each coverage of :data:`LEVELS`.

    Parameters
    ----------
    residual, scale : array of shape (n, ...)
        Residuals and positive scales of held-out rows, along the first axis.

    Returns
    -------
    array of shape (level, ...)

    Notes
    -----
    The factor for coverage p is the ceil((n + 1) p)-th smallest ratio of absolute residual to
    scale: that of an exchangeable new row is at most this factor with a probability of at least p.
    With too few rows for a coverage, the factor is the largest ratio.
    """
    score = np.sort(np.abs(np.asarray(residual)) / np.asarray(scale), axis=0)
    rank = np.ceil((len(score) + 1) * LEVELS - 1e-9).astype(int)
    return np.asarray(score[np.clip(rank, 1, len(score)) - 1])


def factor(quantiles: Array, coverage: float = ONE_DEVIATION) -> Array:
    """Return the factor on the scale for a coverage, interpolated between the stored levels.

    Parameters
    ----------
    quantiles : array of shape (level, ...)
        From :func:`conformal_quantiles`.
    coverage : float
        Fraction of the truths within an interval.

    Returns
    -------
    array of shape (...)

    Raises
    ------
    ConfigError
        If the coverage lies outside the levels.
    """
    if not LEVELS[0] <= coverage <= LEVELS[-1]:
        raise ConfigError(
            "is out of range", setting="coverage", value=coverage,
            allowed=(LEVELS[0], LEVELS[-1]),
            advice=f"use {LEVELS[0]:g} to {LEVELS[-1]:g}",
        )  # fmt: skip
    above = int(np.searchsorted(LEVELS, coverage))
    below = max(above - 1, 0)
    fraction = (
        1.0 if above == below else (coverage - LEVELS[below]) / (LEVELS[above] - LEVELS[below])
    )
    return np.asarray((1 - fraction) * quantiles[below] + fraction * quantiles[above])


def residual_scale(estimate: Array, residual: Array) -> tuple[Array, Array]:
    """Return the scale of residuals as a function of the estimate.

    Parameters
    ----------
    estimate, residual : array of shape (n,)
        Estimates and residuals of held-out rows.

    Returns
    -------
    at, scale : array of shape (bin,)
        Median of the estimates in a bin, and standard deviation of its residuals, estimated from
        their median absolute value. Bins have equal numbers of rows; interpolate between them.
    """
    order = np.argsort(estimate, kind="stable")
    count = int(np.clip(len(order) // ROWS_PER_BIN, 1, MAX_BINS))
    parts = np.array_split(order, count)
    at = np.array([np.median(estimate[part]) for part in parts])
    scale = np.array([NORMAL_MEDIAN * np.median(np.abs(residual[part])) for part in parts])
    # A lower bound for bins in which more than half of the rows are fitted exactly.
    typical = float(np.median(np.abs(residual))) or float(np.mean(np.abs(residual)))
    return at, np.maximum(scale, 1e-3 * typical + np.finfo(float).tiny)


class Conformal:
    """Estimator with conformal intervals, from an estimate and its scale, fitted by folds.

    Attributes
    ----------
    quantiles_ : array of shape (level, target)
        From :func:`conformal_quantiles`.
    """

    n_folds: int
    seed: int
    quantiles_: Array
    _flat = False  # whether the training targets have one axis; then the estimates have one too

    def fit(
        self,
        X: ArrayLike,
        y: ArrayLike,
        groups: ArrayLike | None = None,
        progress: Report = None,
    ) -> Self:
        """Fit a model for each fold on the rows of the others.

        Parameters
        ----------
        X : array of shape (row, input)
            Inputs; for the sleeve paper's force network, amplitude and distance.
        y : array of shape (row, target)
            Targets; for the force network, the force in N, (row,).
        groups : array of int of shape (row,), optional
            Rows of one group are held out together; by default each row is its own group, as in
            the sleeve paper.
        progress : callable, optional
            Called with the finished fraction; by networks as
            :data:`acoustube.estimation.network.Progress`.

        Raises
        ------
        ConfigError
            If rows are too few or not finite, a target is constant, a parameter is out of range, or
            there are fewer groups than folds.
        """
        check_settings(self)
        x, targets = check_rows(X, y)
        self._flat = np.ndim(y) == 1
        self.n_features_in_, self.n_targets_ = x.shape[1], targets.shape[1]
        fold = folds(groups_of(groups, x), self.n_folds, self.seed, name="n_folds")
        self._fit(x, targets, fold, progress)
        return self

    def _fit(self, x: Array, targets: Array, fold: Folds, progress: Report) -> None:
        """Fit the models of all folds to inputs (row, input) and targets (row, target).

        The fold of each row is a number from 0. The conformal quantiles are set too.
        """
        raise NotImplementedError

    def _estimated(self, X: ArrayLike) -> tuple[Array, Array]:
        """Return estimates and their scales, both (row,) or (row, target)."""
        raise NotImplementedError

    def _as_targets(self, values: Array) -> Array:
        """Return values (row, target), or (row,) if the training targets had one axis."""
        return np.asarray(values[:, 0] if self._flat and values.ndim == 2 else values)

    def predict(self, X: ArrayLike, return_std: bool = False) -> Any:
        """Return estimates.

        Parameters
        ----------
        X : array of shape (row, input)
        return_std : bool
            True to return their standard deviations as well.

        Returns
        -------
        estimate, deviation : array of shape (row,) or (row, target)
            In the shape and the unit of the training targets; (row,) for the force network. The
            deviation is the half width of an interval of 68 % coverage, for rows exchangeable with
            the held-out ones.

        Raises
        ------
        ConfigError
            If X is not finite or has another number of columns than the training rows.
        sklearn.exceptions.NotFittedError
            If it is not fitted.
        """
        check_is_fitted(self, "quantiles_")
        estimate, scale = self._estimated(X)
        if not return_std:
            return self._as_targets(estimate)
        return self._as_targets(estimate), self._as_targets(scale * factor(self.quantiles_))

    def half_width(self, X: ArrayLike, coverage: float = 0.9) -> Array:
        """Return the half widths of intervals around the estimates that have a coverage.

        Parameters
        ----------
        X : array of shape (row, input)
        coverage : float
            Fraction of the truths within the intervals.

        Returns
        -------
        array of shape (row,) or (row, target)
            In the unit of the training targets.

        Raises
        ------
        ConfigError
            As :meth:`predict`, or if the coverage is outside :data:`LEVELS`.
        sklearn.exceptions.NotFittedError
            If it is not fitted.
        """
        check_is_fitted(self, "quantiles_")
        return self._as_targets(self._estimated(X)[1] * factor(self.quantiles_, coverage))
