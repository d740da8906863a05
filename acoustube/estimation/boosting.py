"""Gradient boosting on the features of the echo."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.base import BaseEstimator, RegressorMixin
from sklearn.ensemble import HistGradientBoostingRegressor

from acoustube.base.types import Array
from acoustube.estimation import uncertainty
from acoustube.estimation.inputs import check_inputs, offsets
from acoustube.estimation.trees import export_trees, predict_trees
from acoustube.estimation.uncertainty import Folds, Report

MIN_SCALE = 0.05
"""Lower bound of predicted scales, relative to the median absolute residual of held-out rows."""


@dataclass(kw_only=True, eq=False, repr=False)
class Boosting(uncertainty.Conformal, RegressorMixin, BaseEstimator):
    """Gradient boosting of regression trees, one model per fold and target.

    Parameters
    ----------
    n_folds : int
        Number of models, each of which holds out one fold of the rows.
    max_iter : int
        Number of trees of a model, as ``max_iter`` of scikit-learn.
    learning_rate : float
        As ``learning_rate`` of scikit-learn.
    max_leaf_nodes : int
        Largest number of leaves of a tree, as ``max_leaf_nodes`` of scikit-learn.
    offset_columns : tuple of int or None
        For each target the column of X whose values are subtracted from it before training and
        added to the estimate; None for no offset.
    seed : int
        Random seed of the folds and of scikit-learn.

    Attributes
    ----------
    means_, scales_ : acoustube.estimation.trees.Trees
        Models of the targets and of their absolute held-out residuals: for each target one model
        per fold, the folds varying fastest.
    narrowest_ : array of shape (target,)
        Least scale of each target, in its unit; see :data:`MIN_SCALE`.
    quantiles_ : array of shape (level, target)
        See :mod:`acoustube.estimation.uncertainty`.

    Notes
    -----
    The models are scikit-learn's ``HistGradientBoostingRegressor``, after LightGBM [2]_. A second
    model on the same folds estimates the absolute residuals of held-out rows from the features, and
    is itself evaluated on held-out rows only [1]_.

    References
    ----------
    .. [1] J. Lei et al., Distribution-free predictive inference for regression, Journal of the
       American Statistical Association 113 (2018), 1094-1111, section 5.2.
       doi:10.1080/01621459.2017.1307116
    .. [2] G. Ke et al., LightGBM: a highly efficient gradient boosting decision tree, NeurIPS 2017.
    """

    n_folds: int = 5
    max_iter: int = 150
    learning_rate: float = 0.1
    max_leaf_nodes: int = 31
    offset_columns: tuple[int | None, ...] | None = None
    seed: int = 0

    def _fit(self, x: Array, targets: Array, fold: Folds, progress: Report) -> None:

        def report(part: float, fraction: float) -> None:
            if progress is not None:
                progress((part + fraction) / 2)

        rest = targets - offsets(x, self.offset_columns, self.n_targets_)
        means = self._fit_models(x, rest, fold, lambda fraction: report(0, fraction))
        self.means_ = export_trees(means)
        residual = rest - self._held_out(self.means_, x, fold)
        scales = self._fit_models(x, np.abs(residual), fold, lambda fraction: report(1, fraction))
        self.scales_ = export_trees(scales)
        self.narrowest_ = MIN_SCALE * np.median(np.abs(residual), axis=0) + np.finfo(float).tiny
        scale = np.maximum(self._held_out(self.scales_, x, fold), self.narrowest_)
        self.quantiles_ = uncertainty.conformal_quantiles(residual, scale)

    def _estimated(self, X: ArrayLike) -> tuple[Array, Array]:
        x = check_inputs(X, self.n_features_in_)
        estimate = offsets(x, self.offset_columns, self.n_targets_) + self._mean(self.means_, x)
        return estimate, np.maximum(self._mean(self.scales_, x), self.narrowest_)

    def _fit_models(
        self, x: Array, targets: Array, fold: NDArray[np.intp], report: Callable[[float], None]
    ) -> list[Any]:
        """Return one model per target and fold, fitted without the rows of that fold."""
        models: list[Any] = []
        for target in targets.T:
            for k in range(self.n_folds):
                model = HistGradientBoostingRegressor(
                    max_iter=self.max_iter, learning_rate=self.learning_rate,
                    max_leaf_nodes=self.max_leaf_nodes, early_stopping=False,
                    random_state=self.seed % 2**32,  # scikit-learn takes no larger seed
                )  # fmt: skip
                models.append(model.fit(x[fold != k], target[fold != k]))
                report(len(models) / (targets.shape[1] * self.n_folds))
        return models

    def _by_fold(self, trees: Any, x: Array) -> Array:
        """Return the outputs of all models, (fold, row, target)."""
        every = predict_trees(trees, x).reshape(self.n_targets_, self.n_folds, len(x))
        return np.asarray(every.transpose(1, 2, 0))

    def _held_out(self, trees: Any, x: Array, fold: NDArray[np.intp]) -> Array:
        """Return each row's output of the model that held it out, (row, target)."""
        return np.asarray(self._by_fold(trees, x)[fold, np.arange(len(x))])

    def _mean(self, trees: Any, x: Array) -> Array:
        """Return the mean output of the models of all folds, (row, target)."""
        return np.asarray(self._by_fold(trees, x).mean(axis=0))
