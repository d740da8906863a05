"""Force network of the sleeve paper: from peak amplitude and estimated distance to force.

It follows section II-B of "Wearable, Fabric-Embedded Acoustic Waveguides for Meter-Scale Contact
Localization and Force Sensing" (the sleeve paper).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from sklearn.base import BaseEstimator, RegressorMixin

from acoustube.base.errors import ConfigError
from acoustube.base.types import Array
from acoustube.estimation import network, uncertainty
from acoustube.estimation.inputs import check_inputs
from acoustube.estimation.uncertainty import Folds, Report


@dataclass(kw_only=True, eq=False, repr=False)
class ForceNetwork(uncertainty.Conformal, RegressorMixin, BaseEstimator):
    """Fully connected 64-64-1 networks, one per fold, weighted by inverse validation losses.

    As published, they have leaky ReLU and He's initialisation, inputs and outputs are standardised
    on each fold's training rows, and Adam minimises the mean squared error.

    Parameters
    ----------
    n_folds : int
        Number of networks, each of which holds out one fold of the rows.
    epochs : int
        Number of passes over the training rows.
    batch_size : int
        Number of rows of an optimiser's step.
    learning_rate, weight_decay : float
        Settings of Adam; the decay is an L2 term in the gradient, see
        :func:`acoustube.estimation.network.optimiser`.
    seed : int
        Random seed of folds, initial weights and the order of the rows.

    Attributes
    ----------
    networks_ : acoustube.estimation.network.FittedNetworks
        With the losses (fold, epoch) of training and validation.
    weights_ : array of shape (fold,)
        Normalised inverse validation losses after the last epoch.
    scale_ : tuple of array
        Scale of held-out residuals as a function of the estimate, in the target's unit; see
        :func:`acoustube.estimation.uncertainty.residual_scale`.
    quantiles_ : array of shape (level, 1)
        See :mod:`acoustube.estimation.uncertainty`.

    Notes
    -----
    The scale of an estimate is the root sum of squares of the spread between the folds and the
    typical residual of held-out rows with a similar estimate.
    """

    n_folds: int = 10
    epochs: int = 100
    batch_size: int = 32
    learning_rate: float = 1e-3
    weight_decay: float = 1e-5
    seed: int = 0

    def _fit(self, x: Array, targets: Array, fold: Folds, progress: Report) -> None:
        if targets.shape[1] != 1:
            raise ConfigError(
                f"the force network has one target, not {targets.shape[1]}; train one for each"
            )
        self.networks_ = network.train(
            x, targets, fold, epochs=self.epochs, batch_size=self.batch_size,
            learning_rate=self.learning_rate, weight_decay=self.weight_decay, seed=self.seed,
            progress=progress,
        )  # fmt: skip
        self.weights_ = network.weights(self.networks_.validation)
        every = self._by_fold(x)
        own = every[fold, np.arange(len(x))]
        residual = targets[:, 0] - own
        self.scale_ = uncertainty.residual_scale(own, residual)
        spread = self._deviation(own, every)
        self.quantiles_ = uncertainty.conformal_quantiles(residual[:, None], spread[:, None])

    def _estimated(self, X: ArrayLike) -> tuple[Array, Array]:
        every = self._by_fold(check_inputs(X, self.n_features_in_))
        estimate = self.weights_ @ every
        return estimate, self._deviation(estimate, every)

    def _by_fold(self, x: Array) -> Array:
        """Return the estimates of all networks, (fold, row)."""
        scales = self.networks_.scaler
        out = network.predict(self.networks_, x)[..., 0]
        return np.asarray(scales.y_mean + scales.y_deviation * out)

    def _deviation(self, estimate: Array, every: Array) -> Array:
        """Return scales (row,): root sum of squares of folds' spread and typical residual."""
        mean = self.weights_ @ every
        between = np.sqrt(self.weights_ @ (every - mean) ** 2)
        return np.hypot(between, np.interp(estimate, *self.scale_))
