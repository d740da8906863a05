"""Estimators of position, depth and force from echoes, each with its uncertainty.

Cycles come from :mod:`acoustube.recordings`, with their labels. :func:`feature_table` computes
their features, :func:`train` fits a :class:`Model` and :func:`estimate` evaluates it. The
estimators themselves, :class:`ForceNetwork` as published, :class:`EchoEnsemble` and
:class:`Boosting`, take arrays and follow scikit-learn's convention: ``fit(X, y)`` and
``predict(X, return_std=True)``, with a further method ``half_width(X, coverage)``.

Reading order: `features` (of the strongest peak, and of the whole echo), `inputs` (checks),
`splits` (training and test cycles), `uncertainty` (quantiles of held-out residuals), `network`,
`force_network` and `echo` (neural networks), `trees` and `boosting` (decision trees), `metrics`
(errors and coverage), `model` (training, estimates) and `model_file`.
"""

from acoustube.base.moved import renamed
from acoustube.estimation.boosting import Boosting
from acoustube.estimation.echo import EchoEnsemble
from acoustube.estimation.features import FeatureSettings, echo_features, feature_table
from acoustube.estimation.force_network import ForceNetwork
from acoustube.estimation.metrics import Errors, bins, errors
from acoustube.estimation.model import Model, estimate, train
from acoustube.estimation.model_file import load, save
from acoustube.estimation.splits import folds, groups, split

__all__ = [
    "Boosting",
    "EchoEnsemble",
    "Errors",
    "FeatureSettings",
    "ForceNetwork",
    "Model",
    "bins",
    "echo_features",
    "errors",
    "estimate",
    "feature_table",
    "folds",
    "groups",
    "load",
    "save",
    "split",
    "train",
]

__getattr__ = renamed(__name__, {"described": "feature_table", "Describing": "FeatureSettings"})
