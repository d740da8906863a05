"""Validation of the estimators' inputs and targets."""

from __future__ import annotations

from typing import Any

import numpy as np

from acoustube.base.checks import SEED, Either, Optional, Reals, Several, check_argument
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.base.types import Array

ROWS = Reals(missing=True, empty=True)
MIN_ROWS = 50
"""Smallest number of training rows: fewer do not determine a standard deviation."""


SETTINGS = {
    "n_folds": Number(2, 1000, "folds", whole=True),
    "epochs": Number(1, 1e6, whole=True),
    "batch_size": Number(1, 1e9, "rows", whole=True),
    "learning_rate": Number(1e-9, 10),
    "weight_decay": Number(0, 1e3),
    "max_iter": Number(1, 1e5, "trees", whole=True),
    "max_leaf_nodes": Number(2, 1e5, "leaves", whole=True),
    "hidden": Several(Number(1, 1e5, "units", whole=True)),
    "offset_columns": Optional(Several(Optional(Number(0, 1e6, whole=True)))),
    "seed": SEED,
}
"""Rules of the estimators' parameters; by scikit-learn's convention ``fit`` checks them."""


def check_settings(estimator: Any) -> None:
    """Raise ConfigError unless an estimator's parameters are in range; store 3.0 as the int 3."""
    for name, value in estimator.get_params().items():
        if name in SETTINGS:
            found = check_argument(name, value, SETTINGS[name])
            if isinstance(SETTINGS[name], Several | Either) and found is not None:
                found = tuple(None if one is None else int(one) for one in found)
            setattr(estimator, name, found)


def groups_of(groups: Any, rows: Array) -> Any:
    """Return the groups of rows; without given groups, each row is a group of its own.

    Raises
    ------
    ConfigError
        If there is not one group for each row.
    """
    if groups is None:
        return np.arange(len(rows))
    try:
        shape = np.shape(groups)
    except ValueError as error:  # rows of different length
        raise ConfigError("groups is not an array; give one group for each row") from error
    if shape != (len(rows),):
        raise ConfigError(
            f"groups has shape {shape} and X {rows.shape}; give one group for each row"
        )
    return groups


def is_constant(values: Array) -> bool:
    """Return whether the values of a target are equal in all rows, up to rounding."""
    return bool(np.ptp(values) <= 1e-9 * np.max(np.abs(values)))


def check_rows(X: Any, y: Any) -> tuple[Array, Array]:
    """Return inputs (row, input) and targets (row, target) as float64.

    Raises
    ------
    ConfigError
        If their lengths differ, they are not finite or too few, or a target is constant.
    """
    x = check_inputs(X)
    check_argument("y", y, ROWS)
    targets = np.asarray(y, float)
    targets = targets[:, None] if targets.ndim == 1 else targets
    if targets.ndim != 2 or len(targets) != len(x):
        raise ConfigError(
            f"y has shape {np.shape(y)} and X {np.shape(X)}; give one row of targets for each row "
            "of X"
        )
    if bad := int(np.sum(~np.isfinite(targets).all(axis=1))):
        raise ConfigError(
            f"y has a target that is not finite in {bad} of {len(targets)} rows; leave them out"
        )
    if len(x) < MIN_ROWS:
        raise ConfigError(
            f"X has {len(x)} rows, too few to train with; record {MIN_ROWS} or more cycles with "
            "an echo"
        )
    for column, values in enumerate(targets.T):
        if is_constant(values):
            raise ConfigError(
                f"target {column} of y is {values[0]:g} in all rows, so that it cannot be "
                "estimated; record different values"
            )
    return x, targets


def check_inputs(X: Any, columns: int | None = None) -> Array:
    """Return inputs (row, input) as float64.

    Raises
    ------
    ConfigError
        If they are not finite or do not have the shape (row, columns).
    """
    check_argument("X", X, ROWS)
    x = np.asarray(X, float)
    if x.ndim != 2 or not x.shape[1] or (columns is not None and x.shape[1] != columns):
        wanted = "(rows, inputs)" if columns is None else f"(rows, {columns})"
        raise ConfigError(f"X has shape {x.shape}; give {wanted}")
    if bad := int(np.sum(~np.isfinite(x).all(axis=1))):
        raise ConfigError(
            f"X has an input that is not finite in {bad} of {len(x)} rows; leave them out"
        )
    return x


def offsets(x: Array, columns: tuple[int | None, ...] | None, n_targets: int) -> Array:
    """Return the offset of each target, (row, target): a column of the inputs, or zero.

    Parameters
    ----------
    x : array of shape (row, input)
    columns : tuple of int or None, optional
        For each target a column of x, or None for zero.
    n_targets : int

    Raises
    ------
    ConfigError
        If the number of entries is not n_targets, or an entry is not a column.
    """
    chosen = (None,) * n_targets if columns is None else tuple(columns)
    if len(chosen) != n_targets:
        raise ConfigError(
            f"offset_columns has {len(chosen)} entries for {n_targets} targets; give one for each"
        )
    for column in chosen:
        if column is not None:
            check_argument("each of offset_columns", column, Number(0, x.shape[1] - 1, whole=True))
    return np.stack([np.zeros(len(x)) if c is None else x[:, c] for c in chosen], axis=-1)
