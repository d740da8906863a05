"""The commands ``acoustube train`` and ``acoustube evaluate``: labelled cycles in, errors out."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from rich.console import Console
from rich.markup import escape

from acoustube import estimation
from acoustube.base.console import ConsoleReporter, note, watched_interrupts
from acoustube.base.version import __version__
from acoustube.estimation import FeatureSettings, Model
from acoustube.estimation.model import ESTIMATORS, TARGETS, kind_of_features, targets_of, usable
from acoustube.runs.recordings import check_rate, chosen
from acoustube.runs.training import table_of

OVERFITTED = 0.02
"""Rise of the validation loss over its lowest from which fewer epochs are advised."""


def run_train(
    paths: Sequence[Path],
    out: Path,
    console: Console,
    *,
    name: str,
    by: str = "cycle",
    calibration: str | None = None,
    prominence: float | None = None,
    epochs: int | None = None,
    folds: int | None = None,
    seed: int = 0,
) -> Model:
    """Train an estimator on recordings and write it.

    Parameters
    ----------
    paths : sequence of Path
        Files and folders.
    out : Path
        The model to write.
    console : rich.console.Console
    name : str
        ``network``, ``echo`` or ``boosting``.
    by : str
        What is held out together: ``cycle``, ``session`` or ``tube``.
    calibration, prominence
        See :func:`acoustube.runs.recordings.chosen`.
    epochs, folds : int, optional
        In place of the estimator's own; `epochs` are the trees of boosting.
    seed : int

    Returns
    -------
    Model

    Raises
    ------
    ConfigError
        If the recordings cannot be read or trained with.
    """
    start = time.perf_counter()
    known, processing = chosen(calibration, prominence)
    feature_settings = FeatureSettings(kind=kind_of_features(name), processing=processing)
    settings: dict[str, Any] = {} if folds is None else {"n_folds": folds}
    if epochs is not None:
        settings["max_iter" if name == "boosting" else "epochs"] = epochs
    with watched_interrupts() as check:
        with ConsoleReporter(console).progress(check) as report:
            table = table_of(
                paths, feature_settings, report, lambda path, rate: check_rate(rate, known, path)
            )
        _print_cycles(table, name, console)
        with ConsoleReporter(console).progress(check) as report:
            total = epochs or ESTIMATORS[name]().get_params().get("epochs", 1)

            def learned(step: float, *losses: float) -> None:
                report("training", step / total if losses else step)
                if losses and str(step).strip("0") in ("1", "2", "5"):  # an early look
                    console.print(
                        f"epoch {step} of {total}: loss {losses[0]:.4f}, held out {losses[1]:.4f}"
                    )

            model = estimation.train(
                table, name, feature_settings, by=by, seed=seed, progress=learned, **settings
            )
        estimation.save(model, out)
    _print_overfitting(model, console)
    console.print(
        f"Written to [bold]{escape(str(out))}[/] in {time.perf_counter() - start:.0f} s.",
        soft_wrap=True,
    )
    return model


def _print_cycles(table: xr.Dataset, name: str, console: Console) -> None:
    targets = targets_of(name, table)
    echoes = int(np.isfinite(table["features"].values).all(axis=1).sum())
    used = int(usable(table, targets).sum())
    console.print(
        f"[bold]acoustube {__version__}[/]: {table.sizes['cycle']} cycles, echoes in {echoes}; "
        f"{name} learns {', '.join(TARGETS[t] for t in targets)} from {used} of them",
        soft_wrap=True,
    )


def _print_overfitting(model: Model, console: Console) -> None:
    """Say where the validation loss, the mean of the folds, was lowest, and what came of it."""
    if not hasattr(model.estimator, "networks_"):
        return
    training, validation = (
        np.asarray(curve, float).mean(axis=0)
        for curve in (model.estimator.networks_.training, model.estimator.networks_.validation)
    )
    best = int(np.argmin(validation))
    rise = (validation[-1] - validation[best]) / max(abs(validation[best]), 1e-12)
    console.print(
        f"held-out loss {validation[-1]:.4g} after {len(validation)} epochs, training "
        f"{training[-1]:.4g}; lowest after {best + 1} ({validation[best]:.4g})",
        soft_wrap=True,
    )
    if rise > OVERFITTED:
        note(
            console,
            f"the held-out loss has risen by {100 * rise:.2g} % since then, a sign of overfitting; "
            f"try --epochs {best + 1}",
        )
