"""Trained estimators with the settings that their features need."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr

from acoustube.base.checks import SEED, checked
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Choice
from acoustube.estimation import splits
from acoustube.estimation.boosting import Boosting
from acoustube.estimation.echo import EchoEnsemble
from acoustube.estimation.features import FeatureSettings, names
from acoustube.estimation.force_network import ForceNetwork
from acoustube.estimation.inputs import MIN_ROWS, is_constant

Estimator = ForceNetwork | EchoEnsemble | Boosting

ESTIMATORS: dict[str, type[Estimator]] = {
    "network": ForceNetwork,
    "echo": EchoEnsemble,
    "boosting": Boosting,
}
"""Estimators by the names that :func:`train` takes."""
TARGETS = {"true_distance": "distance", "depth": "depth", "force": "force"}
"""Labels that are estimated, with the names of their estimates."""
UNITS = {"true_distance": "m", "depth": "m", "force": "N"}
"""Units of the labels, and of their estimates."""
WIDE = 0.9
"""Coverage of the wider of an estimate's two intervals; that of the narrower one is 68 %."""


@dataclass(frozen=True, kw_only=True)
class Model:
    """Trained estimator with its targets and the settings of its features.

    Attributes
    ----------
    name : str
        ``network``, ``echo`` or ``boosting``.
    estimator : ForceNetwork, EchoEnsemble or Boosting
    targets : tuple of str
        Labels that it estimates, keys of :data:`TARGETS`.
    feature_settings : FeatureSettings
        Settings of its features.
    sampling_rate : float
        Sampling rate of the training cycles in Hz.
    origin : dict
        ``cycles`` and ``trained``: numbers of cycles given, and used. ``by``: groups that were held
        out together.
    """

    name: str
    estimator: Any
    targets: tuple[str, ...]
    feature_settings: FeatureSettings
    sampling_rate: float
    origin: Mapping[str, Any] = field(default_factory=dict)


def kind_of_features(name: str) -> str:
    """Return the kind of features that an estimator takes; see :class:`FeatureSettings`."""
    return "paper" if name == "network" else "echo"


def targets_of(name: str, table: xr.Dataset) -> tuple[str, ...]:
    """Return the labels of a table that an estimator can be trained on.

    Raises
    ------
    ConfigError
        If there is no such label.
    """
    wanted = ("force",) if name == "network" else tuple(TARGETS)
    known = tuple(t for t in wanted if t in table and np.isfinite(table[t]).any())
    if not known:
        raise ConfigError(
            f"the cycles have no label {' or '.join(wanted)}, the targets of {name}; give one in "
            "the files or in a sidecar"
        )
    return known


def usable(table: xr.Dataset, targets: tuple[str, ...]) -> Any:
    """Return the mask (cycle,) of the cycles that have an echo and all labels."""
    used = np.isfinite(table["features"].values).all(axis=1)
    for target in targets:
        used &= np.isfinite(table[target].values)
    return used


@checked(
    table=xr.Dataset,
    name=Choice(tuple(ESTIMATORS)),
    feature_settings=FeatureSettings,
    by=Choice(splits.KINDS),
    seed=SEED,
)
def train(
    table: xr.Dataset,
    name: str,
    feature_settings: FeatureSettings,
    *,
    by: str = "cycle",
    seed: int = 0,
    progress: Callable[..., None] | None = None,
    **settings: Any,
) -> Model:
    """Train an estimator.

    Parameters
    ----------
    table : xarray.Dataset
        From :func:`acoustube.estimation.feature_table`; cycles without an echo or a label are left
        out.
    name : str
        ``network``, ``echo`` or ``boosting``.
    feature_settings : FeatureSettings
        Settings that the features were computed with.
    by : str
        Groups held out together; see :func:`acoustube.estimation.splits.groups`.
    seed : int
        Random seed of folds, initial weights and order of the rows.
    progress : callable, optional
        Passed to the estimator's ``fit``.
    **settings
        Parameters of the estimator.

    Returns
    -------
    Model

    Raises
    ------
    ConfigError
        If labels are missing, the cycles are too few, a label is constant, a parameter is out of
        range, or the features are not those of `feature_settings`, or not those of the estimator.
    """
    _check_table(table)
    _check_features(name, table, feature_settings)
    targets = targets_of(name, table)
    used = usable(table, targets)
    if used.sum() < MIN_ROWS:
        raise ConfigError(
            f"{used.sum()} of {used.size} cycles have an echo and the labels {', '.join(targets)}, "
            f"too few to train with; record {MIN_ROWS} or more, or lower the prominence"
        )
    rows = table.isel(cycle=used)
    y = np.stack([rows[target].values.astype(float) for target in targets], axis=-1)
    for target, values in zip(targets, y.T, strict=True):
        if is_constant(values):
            raise ConfigError(
                f"{target} is {values[0]:g} {UNITS[target]} in all cycles; record different presses"
            )
    if name != "network":
        distance = int(np.flatnonzero(rows["feature"].values == "distance")[0])
        settings["offset_columns"] = tuple(
            distance if t == "true_distance" else None for t in targets
        )
    estimator = ESTIMATORS[name](seed=seed, **settings)
    labels = y[:, 0] if name == "network" else y
    estimator.fit(rows["features"].values, labels, splits.groups(rows, by), progress)
    return Model(
        name=name,
        estimator=estimator,
        targets=targets,
        feature_settings=feature_settings,
        sampling_rate=float(table.attrs["sampling_rate"]),
        origin={"cycles": int(used.size), "trained": int(used.sum()), "by": by},
    )


def _check_table(table: xr.Dataset) -> None:
    """Raise unless a dataset is a table of features."""
    if "features" not in table or "sampling_rate" not in table.attrs:
        raise ConfigError("table has no features, or no sampling_rate; give a feature_table")


def _check_features(name: str, table: xr.Dataset, settings: FeatureSettings) -> None:
    """Raise ConfigError unless an estimator takes the settings' features and a table has them."""
    kind = kind_of_features(name)
    if settings.kind != kind:
        raise ConfigError(
            f"does not fit {name}", setting="feature_settings.kind", value=settings.kind,
            allowed=(kind,), advice=f'use "{kind}"',
        )  # fmt: skip
    if table["feature"].values.tolist() != list(names(settings)):
        raise ConfigError(
            f"table has {table.sizes['feature']} features that are not those of feature_settings; "
            "give the settings with which they were computed"
        )


@checked(model=Model, table=xr.Dataset)
def estimate(model: Model, table: xr.Dataset) -> xr.Dataset:
    """Return the estimates of a model for a table of features.

    Parameters
    ----------
    model : Model
    table : xarray.Dataset
        From :func:`acoustube.estimation.feature_table` with the model's ``feature_settings``.

    Returns
    -------
    xarray.Dataset
        For each target its estimate (cycle), by the names of :data:`TARGETS`, with
        ``_deviation`` and ``_half_width``: half widths of the intervals of 68 % and 90 % coverage.
        nan for a cycle without an echo.

    Raises
    ------
    ConfigError
        If the sampling rate differs from that of the training cycles, or an estimate is not a
        finite number.
    """
    _check_table(table)
    rate = float(table.attrs["sampling_rate"])
    if abs(rate / model.sampling_rate - 1) > 1e-3:
        raise ConfigError(
            f"the cycles have {rate:g} samples per second, and the model was trained with "
            f"{model.sampling_rate:g}; train one with cycles like these"
        )
    features = table["features"].values
    seen = np.isfinite(features).all(axis=1)
    found = np.full((3, len(features), len(model.targets)), np.nan)
    if seen.any():
        rows = features[seen]
        with np.errstate(all="ignore"):  # estimates that are not finite are rejected below
            middle, deviation = model.estimator.predict(rows, return_std=True)
            wide = model.estimator.half_width(rows, WIDE)
        shape = (len(rows), len(model.targets))
        found[:, seen] = np.stack([a.reshape(shape) for a in (middle, deviation, wide)])
        if not np.isfinite(found[:, seen]).all():
            raise ConfigError("the model's estimates are not finite; train it again")
    variables = {}
    for column, target in enumerate(model.targets):
        name, unit = TARGETS[target], UNITS[target]
        for suffix, values, words in zip(
            ("", "_deviation", "_half_width"), found[..., column],
            ("estimated {}", "half the interval of 68 % of the {}",
             f"half the interval of {100 * WIDE:g} % of the {{}}"), strict=True,
        ):  # fmt: skip
            attributes = {"units": unit, "long_name": words.format(name)}
            variables[name + suffix] = ("cycle", values, attributes)
    return xr.Dataset(variables)
