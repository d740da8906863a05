"""The command ``acoustube train``: an estimator of presses, from labelled cycles."""

from __future__ import annotations

import time
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from acoustube.base.errors import ConfigError
from acoustube.base.files import check_new_file
from acoustube.base.interrupts import watched_interrupts
from acoustube.base.report import Reporter, ShowProgress, counted
from acoustube.base.rules import Number
from acoustube.base.version import __version__
from acoustube.cli._options import WHOLE, Checked, Output, Ranging

if TYPE_CHECKING:
    import xarray as xr

    from acoustube.estimation import FeatureSettings, Model

OVERFITTED = 0.02
"""Relative rise of the validation loss above its minimum from which fewer epochs are advised."""
EARLY_EPOCHS = ("1", "2", "5")
"""Digits, without final zeros, of the epochs whose losses are printed: 1, 2, 5, 10, 20, ..."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Training(Checked):
    """Options of the training.

    Attributes
    ----------
    by : str
        Groups that are held out together in the cross-validation, whose errors weight the folds
        and give the uncertainties: single cycles, as in the sleeve paper, sessions (files, if
        cycles have no session), or tubes.
    epochs : int
        Training epochs (default 100, for ``echo`` 25); number of trees for ``boosting`` (150).
    folds : int
        Folds of the cross-validation (default 10, for ``boosting`` 5).
    seed : int
        Random seed of folds, weights and batch order.
    """

    by: Literal["cycle", "session", "tube"] = "cycle"
    epochs: Annotated[
        int | None, WHOLE, Number(1, 100_000, "", "passes over the cycles", whole=True)
    ] = None
    folds: Annotated[int | None, WHOLE, Number(2, 100, "", "parts of the cycles", whole=True)] = (
        None
    )
    seed: Annotated[int, WHOLE, Number(0, 2**32 - 1, "", "random seed", whole=True)] = 0


def train(
    *data: Path,
    estimator: Literal["network", "echo", "boosting"],
    out: Path,
    training: Training = Training(),
    ranging: Ranging = Ranging(),
    output: Output = Output(),
) -> None:
    """Train an estimator of presses on labelled cycles.

    Parameters
    ----------
    data : Path
        Files with cycles and the labels ``true_distance``, ``depth`` and ``force``, as far as
        known, or folders of these.
    estimator : str
        Kind: network, the force network of the sleeve paper; echo, networks that estimate distance,
        depth and force from the whole echo; or boosting, gradient boosting for the same quantities.
    out : Path
        Model to write, which must be new.
    """
    if not data:
        raise ConfigError("train needs a file or a folder; name one or more")
    check_new_file(out)

    from acoustube import estimation
    from acoustube.estimation.model import kind_of_features
    from acoustube.runs.recordings import check_rate, chosen, read_cycles
    from acoustube.runs.training import check_drive, table_of
    from acoustube.runs.twin_calibration import stated_processing

    start = time.perf_counter()
    report = output.reporter()
    recordings = read_cycles(data)
    first = next(recordings)
    stated = None if ranging.calibration else stated_processing(*first)
    known, processing = chosen(ranging.calibration, ranging.prominence, stated)

    def check_recording(path: Path, recorded: xr.Dataset) -> None:
        check_rate(float(recorded.attrs["sampling_rate"]), known, path)
        if known is None:
            check_drive(path, recorded, processing)

    features = estimation.FeatureSettings(kind=kind_of_features(estimator), processing=processing)
    with watched_interrupts() as check:
        with report.progress(check) as show:
            table = table_of(chain([first], recordings), features, show, check_recording)
        _print_cycles(table, estimator, report)
        with report.progress(check) as show:
            model = _trained(table, estimator, features, training, show, report)
        estimation.save(model, out, overwrite=False)
    _print_overfitting(model, report)
    report.line(f"Written to {out} in {time.perf_counter() - start:.0f} s.")


def _trained(
    table: xr.Dataset,
    name: str,
    features: FeatureSettings,
    training: Training,
    show: ShowProgress,
    report: Reporter,
) -> Model:
    """Train an estimator on a table of cycles, and print its losses during training."""
    from acoustube import estimation
    from acoustube.estimation.model import ESTIMATORS

    settings: dict[str, Any] = {} if training.folds is None else {"n_folds": training.folds}
    if training.epochs is not None:
        settings["max_iter" if name == "boosting" else "epochs"] = training.epochs
    total = training.epochs or ESTIMATORS[name]().get_params().get("epochs", 1)

    def progress(step: float, *losses: float) -> None:
        show("training", step / total if losses else step)
        if losses and str(step).strip("0") in EARLY_EPOCHS:
            report.line(f"epoch {step} of {total}: loss {losses[0]:.4f}, held out {losses[1]:.4f}")

    return estimation.train(
        table, name, features, by=training.by, seed=training.seed, progress=progress, **settings
    )


def _print_cycles(table: xr.Dataset, name: str, report: Reporter) -> None:
    """Print the numbers of cycles, of echoes and of cycles to train on, and the targets."""
    import numpy as np

    from acoustube.estimation.model import TARGETS, targets_of, usable

    targets = targets_of(name, table)
    echoes = int(np.isfinite(table["features"].values).all(axis=1).sum())
    used = int(usable(table, targets).sum())
    report.line(
        f"acoustube {__version__}: {counted(table.sizes['cycle'], 'cycle')}, echoes in {echoes}; "
        f"the estimator {name} learns {', '.join(TARGETS[t] for t in targets)} from {used} of them"
    )


def _print_overfitting(model: Model, report: Reporter) -> None:
    """Print the validation loss, averaged over the folds, and whether it shows overfitting."""
    import numpy as np

    if not hasattr(model.estimator, "networks_"):
        return
    training, validation = (
        np.asarray(curve, float).mean(axis=0)
        for curve in (model.estimator.networks_.training, model.estimator.networks_.validation)
    )
    best = int(np.argmin(validation))
    rise = (validation[-1] - validation[best]) / max(abs(validation[best]), 1e-12)
    report.line(
        f"held-out loss {validation[-1]:.4g} after {len(validation)} epochs, training "
        f"{training[-1]:.4g}; lowest after {best + 1} ({validation[best]:.4g})"
    )
    if rise > OVERFITTED:
        report.note(
            f"the held-out loss has risen by {100 * rise:.2g} % since then, a sign of overfitting; "
            f"try --epochs {best + 1}"
        )
