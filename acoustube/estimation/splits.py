"""Folds and splits of cycles by cycle, session or tube, reproducible by their seed.

scikit-learn's ``GroupKFold`` balances the rows of uneven groups or shuffles them, but not both;
``GroupShuffleSplit`` raises where a large fraction of few groups leaves none for training.
"""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from acoustube.base.checks import SEED, Reals, checked
from acoustube.base.errors import ConfigError
from acoustube.base.report import counted
from acoustube.base.rules import Number

Index = NDArray[np.intp]

KINDS = ("cycle", "session", "tube")
"""Kinds of groups of cycles that a split can keep together."""


@checked(cycles=xr.Dataset, by=str)
def groups(cycles: xr.Dataset, by: str) -> Index:
    """Return the group of each cycle.

    Parameters
    ----------
    cycles : xarray.Dataset
        With ``session`` or ``tube`` (cycle), names or numbers, for a split by these.
    by : str
        ``cycle``: each cycle is a group. ``session`` or ``tube``: sessions of different tubes are
        different groups.

    Returns
    -------
    array of int of shape (cycle,)
        Number of the group, from 0.

    Raises
    ------
    ConfigError
        If the label is missing, or `by` is none of :data:`KINDS`.
    """
    if by == "cycle":
        return np.arange(cycles.sizes["cycle"])
    if by not in KINDS:
        raise ConfigError("is not known", setting="by", value=by, advice=f"use {', '.join(KINDS)}")
    if by not in cycles:
        raise ConfigError(f"the cycles have no label {by}; add it, or split by cycle")
    names = [name for name in ("tube", by) if name in cycles]
    columns = [np.unique(cycles[name].values, return_inverse=True)[1] for name in names]
    return np.asarray(np.unique(np.stack(columns), axis=1, return_inverse=True)[1].ravel())


@checked(
    groups=Reals(ndim=1, kinds="iufbU"),
    count=Number(-1e9, 1e9, "folds", whole=True),
    seed=SEED,
)
def folds(groups: ArrayLike, count: int, seed: int = 0, *, name: str = "count") -> Index:
    """Return folds of whole groups with about equal numbers of rows.

    Parameters
    ----------
    groups : array of int of shape (n,)
        Rows of one group belong to one fold.
    count : int
        Number of folds, 2 or more.
    seed : int
        Random seed of the shuffle.
    name : str
        Parameter of the caller that holds `count`, for errors.

    Returns
    -------
    array of int of shape (n,)
        Fold of each row, from 0 to count - 1; none is empty.

    Raises
    ------
    ConfigError
        If there are fewer groups than folds, or fewer than two folds.

    Notes
    -----
    The groups are shuffled, then taken from the largest to the smallest, each into the fold that
    has the fewest rows: groups of one row make folds that differ by one row at most.
    """
    _, member, sizes = np.unique(groups, return_inverse=True, return_counts=True)
    if not 2 <= count <= len(sizes):
        most = f"use 2 to {len(sizes)}" if len(sizes) > 2 else "use 2"
        raise ConfigError(
            f"cannot be made of {counted(len(sizes), 'group')} of cycles", setting=name,
            value=count, unit="folds", allowed=(2, len(sizes)),
            advice=f"{most if len(sizes) > 1 else 'split by cycle'}, or record more",
        )  # fmt: skip
    shuffled = np.random.default_rng(seed).permutation(len(sizes))
    fold = np.empty(len(sizes), np.intp)
    if sizes.max() == 1:
        fold[shuffled] = np.arange(len(sizes)) % count
        return np.asarray(fold[member])
    rows = np.zeros(count)
    for group in shuffled[np.argsort(-sizes[shuffled], kind="stable")]:
        fold[group] = np.argmin(rows)
        rows[fold[group]] += sizes[group]
    return np.asarray(fold[member])


@checked(groups=Reals(ndim=1, kinds="iufbU"), share=Number(-1e9, 1e9), seed=SEED)
def split(groups: ArrayLike, share: float = 0.2, seed: int = 0) -> tuple[Index, Index]:
    """Return the training rows and the test rows of a split of whole groups.

    Parameters
    ----------
    groups : array of int of shape (n,)
    share : float
        Fraction of the groups for the test. At least one group is for the test, one for training.
    seed : int
        Random seed of the choice.

    Returns
    -------
    train, test : array of int
        Rising indices of rows.

    Raises
    ------
    ConfigError
        If the fraction is not between 0 and 1, or there is only one group.
    """
    different, member = np.unique(groups, return_inverse=True)
    if not 0 < share < 1:
        raise ConfigError(
            "is out of range", setting="share", value=share,
            advice="use more than 0 and less than 1",
        )  # fmt: skip
    if len(different) < 2:
        raise ConfigError("one group of cycles cannot be split; split by cycle, or record more")
    count = int(np.clip(round(share * len(different)), 1, len(different) - 1))
    chosen = np.random.default_rng(seed).permutation(len(different))[:count]
    tests = np.isin(member, chosen)
    return np.flatnonzero(~tests), np.flatnonzero(tests)
