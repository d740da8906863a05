"""Files of models: NumPy arrays and one line of JSON, read without pickle.

The arrays are validated before use. skops.io was considered for the trees. It does not validate
their nodes, so that a crafted file could make the evaluation endless, and it depends on the version
of scikit-learn that wrote them.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Mapping
from dataclasses import asdict
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acoustube.base.checks import checked
from acoustube.base.errors import ConfigError
from acoustube.base.foreign.archives import read_archive
from acoustube.base.foreign.documents import parsed
from acoustube.base.foreign.limits import check_file, reading
from acoustube.base.names import PATH
from acoustube.base.rules import Number
from acoustube.base.version import __version__
from acoustube.base.writing import write
from acoustube.estimation.boosting import Boosting
from acoustube.estimation.features import FeatureSettings, names
from acoustube.estimation.model import ESTIMATORS, TARGETS, Estimator, Model, kind_of_features
from acoustube.estimation.network import FittedNetworks, Scaler
from acoustube.estimation.trees import Trees
from acoustube.estimation.uncertainty import LEVELS
from acoustube.signals import Processing, TimeGain

Arrays = dict[str, NDArray[Any]]

FORMAT = 1
"""Version of the format; raised when the stored arrays, or the definition of features, change."""
KIND = "acoustube model"
"""Words that identify a file's header as that of a model."""
ORIGIN = ("cycles", "trained", "by")
"""Keys of a model's ``origin``: what it was trained with."""
RATE = Number(1e3, 1e8, "Hz", "samples per second")
FILE_NAMES = {
    "max_iter": "iterations",
    "max_leaf_nodes": "leaves",
    "offset_columns": "added_to",
}
"""Names in files of the settings that have other names in Python."""


@checked(model=Model, path=PATH)
def save(model: Model, path: str | Path, *, overwrite: bool = True) -> None:
    """Write a model as a NumPy archive (the format of .npz) under any name.

    Parameters
    ----------
    model : Model
    path : str or Path
    overwrite : bool
        Whether an existing file is replaced, once the new one is complete.

    Raises
    ------
    ConfigError
        If the file cannot be written.
    SimulationError
        If the disk is full, or the file exists and `overwrite` is false.
    """
    header = {
        "kind": KIND,
        "format": FORMAT,
        "acoustube_version": __version__,
        "estimator": model.name,
        "settings": {
            FILE_NAMES.get(name, name): value
            for name, value in model.estimator.get_params().items()
        },
        "targets": model.targets,
        "features": model.feature_settings.kind,
        "radius": model.feature_settings.radius,
        "processing": asdict(model.feature_settings.processing),
        "sampling_rate": model.sampling_rate,
        "origin": dict(model.origin),
    }
    arrays: dict[str, Any] = {"header": np.array(json.dumps(header))} | _arrays(model.estimator)
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)
    write(path, content.getvalue(), overwrite=overwrite)


def load(path: str | Path) -> Model:
    """Read a model that :func:`save` wrote.

    Raises
    ------
    ConfigError
        If the file is not a model, or has another format.
    """
    PATH.check("path", path)
    check_file(path, "model")
    with reading(path, "is not a model", "acoustube train writes one"):
        if not zipfile.is_zipfile(path):
            raise ValueError("not a NumPy archive")
        arrays = read_archive(Path(path), "model")
        if "header" not in arrays:
            raise ValueError("an archive without a header")
        header = parsed(str(arrays.pop("header")), path)
        if not isinstance(header, dict):
            raise ValueError("its header holds no settings")
        if header["kind"] != KIND:
            raise ValueError(f"it is a {header['kind']}")
        if header["format"] == FORMAT:
            return _model(header, arrays)
    raise ConfigError(
        f"{path} was written by acoustube {header.get('acoustube_version')} in format "
        f"{header['format']}, and this is acoustube {__version__}, which reads format {FORMAT}; "
        "train it again"
    )


def _model(header: Mapping[str, Any], arrays: Arrays) -> Model:
    name, targets = header["estimator"], tuple(header["targets"])
    gain = header["processing"]["gain"]
    gain = None if gain is None else TimeGain(*(float(c) for c in gain))
    processing = Processing(**(header["processing"] | {"gain": gain}))
    feature_settings = FeatureSettings(
        kind=header["features"], processing=processing, radius=float(header["radius"])
    )
    if (
        feature_settings.kind != kind_of_features(name)
        or not targets
        or set(targets) - set(TARGETS)
    ):
        raise ValueError(
            f"{name} does not estimate {', '.join(targets)} from features of kind "
            f"{feature_settings.kind}"
        )
    python_names = {file_name: name for name, file_name in FILE_NAMES.items()}
    settings = {
        python_names.get(key, key): tuple(value) if isinstance(value, list) else value
        for key, value in header["settings"].items()
    }
    make: Any = ESTIMATORS[name]
    estimator = make(**settings)
    _restore(estimator, arrays, len(names(feature_settings)), len(targets))
    return Model(
        name=name,
        estimator=estimator,
        targets=targets,
        feature_settings=feature_settings,
        sampling_rate=float(RATE.check("sampling_rate", header["sampling_rate"])),
        origin={name: header["origin"][name] for name in ORIGIN},
    )


def _arrays(estimator: Estimator) -> Arrays:
    """Return the fitted arrays of an estimator by name."""
    learned: Arrays = {"quantiles": estimator.quantiles_}
    if isinstance(estimator, Boosting):
        learned["narrowest"] = estimator.narrowest_
        for part, trees in (("mean", estimator.means_), ("scale", estimator.scales_)):
            learned |= {f"{part}_{name}": array for name, array in trees._asdict().items()}
        return learned
    networks = estimator.networks_
    for i, (weights, bias) in enumerate(networks.layers):
        learned |= {f"weights_{i}": weights, f"bias_{i}": bias}
    learned |= {name: np.asarray(a) for name, a in networks.scaler._asdict().items()}
    learned |= {"training": networks.training, "validation": networks.validation}
    if hasattr(estimator, "weights_"):
        learned |= {"fold_weights": estimator.weights_, "scale": np.stack(estimator.scale_)}
    return learned


def _restore(estimator: Estimator, arrays: Arrays, n_features: int, n_targets: int) -> None:
    """Set the fitted arrays of an estimator, after validation of their shapes."""
    estimator.n_features_in_ = n_features
    estimator.quantiles_ = _shaped(arrays, "quantiles", (len(LEVELS), n_targets))
    if isinstance(estimator, Boosting):
        estimator.n_targets_ = n_targets
        estimator.narrowest_ = _shaped(arrays, "narrowest", (n_targets,))
        count = n_targets * estimator.n_folds
        estimator.means_ = _trees(arrays, "mean", n_features, count)
        estimator.scales_ = _trees(arrays, "scale", n_features, count)
        return
    if hasattr(estimator, "offset_columns"):
        estimator.n_targets_ = n_targets
        own = n_features - len({c for c in estimator.offset_columns or () if c is not None})
        widths, outputs = (own, *estimator.hidden), 2 * n_targets
    else:
        own, widths, outputs = n_features, (n_features, 64, 64), 1
        folds = estimator.n_folds
        estimator.weights_ = _shaped(arrays, "fold_weights", (folds,))
        at, scale = _shaped(arrays, "scale", (2, arrays["scale"].shape[-1]))
        estimator.scale_ = at, scale
    estimator.networks_ = _networks(arrays, estimator.n_folds, (*widths, outputs), n_targets)


def _networks(
    arrays: Arrays, folds: int, widths: tuple[int, ...], n_targets: int
) -> FittedNetworks:
    layers = [
        (_shaped(arrays, f"weights_{i}", (folds, a, b)), _shaped(arrays, f"bias_{i}", (folds, b)))
        for i, (a, b) in enumerate(pairwise(widths))
    ]
    sizes = {"x": widths[0], "y": n_targets}
    scales = {name: _shaped(arrays, name, (folds, sizes[name[0]])) for name in Scaler._fields}
    epochs = arrays["training"].shape[-1]
    curves = (_shaped(arrays, name, (folds, epochs)) for name in ("training", "validation"))
    return FittedNetworks(layers, Scaler(**scales), *curves)


def _trees(arrays: Arrays, part: str, n_features: int, n_models: int) -> Trees:
    """Return validated trees: every path must end, as compiled evaluation checks no bounds."""
    trees = Trees(**{name: arrays[f"{part}_{name}"] for name in Trees._fields})
    nodes, own = len(trees.feature), np.arange(len(trees.feature))
    inner = trees.feature >= 0
    whole = (
        all(array.ndim == 1 for array in trees)
        and [array.dtype for array in trees] == [float, *5 * [np.int32], float, float]
        and all(len(array) == nodes for array in trees[3:])
    )
    sound = (
        whole
        and trees.baseline.shape == (n_models,)
        and trees.first.shape == (n_models + 1,)
        and trees.first[0] == 0
        and trees.first[-1] == len(trees.root)
        and np.all(np.diff(trees.first) >= 0)
        and np.all((trees.root >= 0) & (trees.root < nodes))
        and np.all((trees.feature >= -1) & (trees.feature < n_features))
        and all(np.all((a > own) & (a < nodes) | ~inner) for a in (trees.left, trees.right))
        and all(np.isfinite(a).all() for a in (trees.baseline, trees.value))
        and not np.isnan(trees.threshold).any()
    )
    if not sound:
        raise ValueError(f"its trees of the {part} are invalid")
    return trees


def _shaped(arrays: Arrays, name: str, shape: tuple[int, ...]) -> NDArray[Any]:
    """Return an array of a file; raise ValueError unless it has the shape and is finite."""
    array = arrays[name]
    if array.shape != shape or array.dtype.kind != "f" or not np.isfinite(array).all():
        raise ValueError(f"its {name} of shape {array.shape} should be {shape} finite numbers")
    return array.astype(np.float32 if array.dtype.itemsize <= 4 else float)  # in native byte order
