"""Regression trees as plain arrays: safe to store, and walked by all rows at once."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from acoustube.base.types import Array


class Trees(NamedTuple):
    """Sums of trees, one sum per model.

    Attributes
    ----------
    baseline : array of shape (model,)
        What the trees add to.
    first : array of int of shape (model + 1,)
        Where each model's trees begin in `root`.
    root : array of int of shape (tree,)
        Their first nodes.
    feature, left, right : array of int of shape (node,)
        Column that is compared, and the next node where it is not above the threshold, and where
        it is. A leaf has the column -1.
    threshold, value : array of shape (node,)
        The value is that of a leaf.
    """

    baseline: Array
    first: NDArray[np.int32]
    root: NDArray[np.int32]
    feature: NDArray[np.int32]
    left: NDArray[np.int32]
    right: NDArray[np.int32]
    threshold: Array
    value: Array


def exported(models: list[Any]) -> Trees:
    """Return the trees of fitted ``HistGradientBoostingRegressor`` with one output each.

    Its nodes have no public name; a test holds :func:`summed` against its own ``predict``.
    """
    found = [[stage[0].nodes for stage in model._predictors] for model in models]
    nodes = [tree for trees in found for tree in trees]
    root = np.cumsum([0, *(len(tree) for tree in nodes)])
    first = np.cumsum([0, *(len(trees) for trees in found)])
    every = np.concatenate(nodes)
    shift = np.repeat(root[:-1], [len(tree) for tree in nodes])
    leaf = every["is_leaf"].astype(bool)
    return Trees(
        baseline=np.array([float(np.squeeze(model._baseline_prediction)) for model in models]),
        first=first.astype(np.int32),
        root=root[:-1].astype(np.int32),
        feature=np.where(leaf, -1, every["feature_idx"]).astype(np.int32),
        left=(every["left"] + shift).astype(np.int32),
        right=(every["right"] + shift).astype(np.int32),
        threshold=np.where(leaf, 0.0, every["num_threshold"]),
        value=np.where(leaf, every["value"], 0.0),
    )


def summed(trees: Trees, x: Array) -> Array:
    """Return what each model makes of rows (row, column): (model, row)."""
    return np.asarray(_summed(*trees, np.ascontiguousarray(x, dtype=float)))


@numba.njit(parallel=True, cache=True)
def _summed(  # type: ignore[no-untyped-def]
    baseline, first, root, feature, left, right, threshold, value, x
):
    out = np.empty((len(baseline), len(x)))
    for model in range(len(baseline)):
        for row in numba.prange(len(x)):
            total = baseline[model]
            for tree in range(first[model], first[model + 1]):
                node = root[tree]
                while feature[node] >= 0:
                    under = x[row, feature[node]] <= threshold[node]
                    node = left[node] if under else right[node]
                total += value[node]
            out[model, row] = total
    return out
