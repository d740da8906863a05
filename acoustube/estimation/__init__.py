"""From echoes to presses: estimators of position, depth and force, each with its uncertainty.

Cycles come as of :mod:`acoustube.recordings`, with their labels. :func:`described` makes features
of them, :func:`train` a :class:`Model`, :func:`estimate` asks it. The estimators themselves,
:class:`ForceNetwork` as published, :class:`EchoEnsemble` and :class:`Boosting`, take arrays and
follow scikit-learn's convention: ``fit(X, y)``, ``predict(X, return_std=True)``, and besides
``half_width(X, coverage)``.
"""

from acoustube.estimation.boosting import Boosting
from acoustube.estimation.echo import EchoEnsemble
from acoustube.estimation.features import Describing, described, echo_features
from acoustube.estimation.force_network import ForceNetwork
from acoustube.estimation.metrics import Errors, bins, errors
from acoustube.estimation.model import Model, estimate, train
from acoustube.estimation.model_file import load, save
from acoustube.estimation.splits import folds, groups, split

__all__ = [
    "Boosting",
    "Describing",
    "EchoEnsemble",
    "Errors",
    "ForceNetwork",
    "Model",
    "bins",
    "described",
    "echo_features",
    "errors",
    "estimate",
    "folds",
    "groups",
    "load",
    "save",
    "split",
    "train",
]
