"""Regression trees as plain arrays, which can be stored safely, and their compiled evaluation."""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from acoustube.base.types import Array


class Trees(NamedTuple):
    """Ensembles of regression trees as arrays, one sum of trees per model.

    Attributes
    ----------
    baseline : array of shape (model,)
        Constant to which the trees are added.
    first : array of int of shape (model + 1,)
        First index of each model's trees in `root`, then their total number.
    root : array of int of shape (tree,)
        Root nodes of the trees.
    feature, left, right : array of int of shape (node,)
        Column that is compared, next node if its value is at or below the threshold, and next node
        if it is above. A leaf has the column -1.
    threshold, value : array of shape (node,)
        Threshold of an inner node, and value of a leaf.
    """

    baseline: Array
    first: NDArray[np.int32]
    root: NDArray[np.int32]
    feature: NDArray[np.int32]
    left: NDArray[np.int32]
    right: NDArray[np.int32]
    threshold: Array
    value: Array


def export_trees(models: list[Any]) -> Trees:
    """Return the trees of fitted ``HistGradientBoostingRegressor`` models with one output each.

    scikit-learn has no public access to the nodes; a test compares :func:`predict_trees` with
    ``predict`` of scikit-learn.
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


def predict_trees(trees: Trees, x: Array) -> Array:
    """Return the predictions of all models for rows (row, column): (model, row)."""
    return np.asarray(_predict_trees(*trees, np.ascontiguousarray(x, dtype=float)))


@numba.njit(parallel=True, cache=True)
def _predict_trees(  # type: ignore[no-untyped-def]
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
