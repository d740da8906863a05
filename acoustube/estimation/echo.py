"""Ensemble of networks for position, depth and force from the features of the whole echo."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, RegressorMixin

from acoustube.base.errors import ConfigError
from acoustube.base.types import Array
from acoustube.estimation import network, uncertainty
from acoustube.estimation.inputs import check_inputs, offsets
from acoustube.estimation.uncertainty import Folds, Report


@dataclass(kw_only=True, eq=False, repr=False)
class EchoEnsemble(uncertainty.Conformal, RegressorMixin, BaseEstimator):
    """Networks that estimate a Laplace distribution for each target, one network per fold.

    The inputs are the features of :func:`acoustube.estimation.features.echo_features`. With the
    column of the distance as its offset column, position is estimated relative to the strongest
    echo.

    Parameters
    ----------
    n_folds : int
        Number of networks, each of which holds out one fold of the rows.
    epochs : int
        Number of passes over the training rows.
    batch_size : int
        Number of rows of an optimiser's step.
    learning_rate, weight_decay : float
        See :func:`acoustube.estimation.network.optimiser`.
    hidden : tuple of int
        Widths of the hidden layers.
    offset_columns : tuple of int or None
        For each target the column of X whose values are subtracted from it before training and
        added to the estimate; None for no offset. These columns are not inputs of the networks.
    seed : int
        Random seed of folds, initial weights and the order of the rows.

    Attributes
    ----------
    networks_ : acoustube.estimation.network.FittedNetworks
    quantiles_ : array of shape (level, target)
        See :mod:`acoustube.estimation.uncertainty`.

    Notes
    -----
    A deep ensemble [1]_ of Laplace distributions in place of normal ones, since some strongest
    echoes are not those of the press: outliers of a metre must not enter the loss squared. The
    estimate is the mean of the networks' medians. The square of its scale is the mean of the
    networks' variances plus the variance of their medians. The scale is multiplied by the conformal
    quantile of held-out rows.

    References
    ----------
    .. [1] B. Lakshminarayanan et al., Simple and scalable predictive uncertainty estimation using
       deep ensembles, NeurIPS 2017. arXiv:1612.01474
    """

    n_folds: int = 10
    epochs: int = 25
    batch_size: int = 64
    learning_rate: float = 1e-3
    weight_decay: float = 1e-4
    hidden: tuple[int, ...] = (64, 64)
    offset_columns: tuple[int | None, ...] | None = None
    seed: int = 0

    def _fit(self, x: Array, targets: Array, fold: Folds, progress: Report) -> None:
        rest = targets - offsets(x, self.offset_columns, self.n_targets_)
        self.networks_ = network.train(
            self._inputs(x), rest, fold, hidden=tuple(self.hidden), loss="laplace",
            epochs=self.epochs, batch_size=self.batch_size, learning_rate=self.learning_rate,
            weight_decay=self.weight_decay, seed=self.seed, progress=progress,
        )  # fmt: skip
        median, deviation = self._by_fold(x)
        rows = np.arange(len(x))
        scale = np.hypot(deviation[fold, rows], median.std(axis=0))
        self.quantiles_ = uncertainty.conformal_quantiles(rest - median[fold, rows], scale)

    def _estimated(self, X: ArrayLike) -> tuple[Array, Array]:
        x = check_inputs(X, self.n_features_in_)
        median, deviation = self._by_fold(x)
        scale = np.sqrt(np.mean(deviation**2, axis=0) + np.var(median, axis=0))
        return offsets(x, self.offset_columns, self.n_targets_) + median.mean(axis=0), scale

    def _by_fold(self, x: Array) -> tuple[Array, Array]:
        """Return medians and standard deviations of all networks, (fold, row, target)."""
        scales = self.networks_.scaler
        out, log_scale = np.split(network.predict(self.networks_, self._inputs(x)), 2, axis=-1)
        unit = scales.y_deviation[:, None]
        # A Laplace distribution of scale b has the standard deviation sqrt(2) b.
        width = np.sqrt(2) * np.exp(np.asarray(network.bounded(log_scale)))
        return scales.y_mean[:, None] + unit * out, unit * width

    def _inputs(self, x: Array) -> Array:
        """Return the inputs of the networks: the columns of X that are no offset columns."""
        apart = sorted({c for c in self.offset_columns or () if c is not None})
        if len(apart) == x.shape[1]:
            raise ConfigError(
                "takes all columns of X and leaves no inputs", setting="offset_columns",
                value=self.offset_columns, advice="give X other columns too",
            )  # fmt: skip
        return np.delete(x, apart, axis=1)
