"""Estimates of networks whose input is the whole echo, for the second dataset of the flat table."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from acoustube import estimation
from acoustube.base.interrupts import watched_interrupts
from acoustube.base.report import Reporter, ShowProgress
from acoustube.estimation import FeatureSettings, Model
from acoustube.estimation.model import TARGETS
from acoustube.reports.studies.ranged import FIRST_DATASET_DEPTH, measure_rows
from acoustube.reports.studies.report import Row, Scale
from acoustube.runs.opening import open_dataset
from acoustube.runs.training import DISPLAY_UNITS

CYCLE_STRIDE = 10
"""Step from one used cycle to the next: the cycles of a press differ only by noise."""


def rows(
    work: Path,
    settings: FeatureSettings,
    detected: NDArray[np.bool_],
    scale: Scale,
    report: Reporter,
) -> list[Row]:
    """Return rows of the errors of whole-echo networks on the flat table's second dataset.

    The networks are trained on the first dataset. Errors are given for the cycles in which the
    sleeve paper's processing detects an echo, where both methods can be compared, and for all.

    Parameters
    ----------
    work : Path
        Folder of the flat study, with the cycles of both datasets.
    settings : FeatureSettings
        Settings of the whole-echo features.
    detected : array of bool of shape (cycle,)
        Mask of the cycles of the second dataset in which the sleeve paper's processing detects an
        echo.
    scale : Scale
    report : Reporter
    """
    every = 1 if scale.quick else CYCLE_STRIDE
    with watched_interrupts() as check, report.progress(check) as show:
        first, second = (
            _described(work / name, settings, every, show) for name in ("first", "second")
        )
        first = first.isel(cycle=first["depth"].values > FIRST_DATASET_DEPTH)
        model = _trained(first, settings, scale, show)
    return [
        *_rows(model, second, detected[::every], "where the highest peak is found"),
        *_rows(model, second, np.ones_like(detected[::every]), "of all cycles"),
    ]


def _described(work: Path, settings: FeatureSettings, every: int, show: ShowProgress) -> xr.Dataset:
    cycles = open_dataset(work / "cycles").isel(cycle=slice(None, None, every)).load()
    return estimation.feature_table(cycles, settings, lambda share: show("whole echoes", share))


def _trained(
    table: xr.Dataset, settings: FeatureSettings, scale: Scale, show: ShowProgress
) -> Model:
    options: dict[str, Any] = {"epochs": 2, "n_folds": 2} if scale.quick else {}
    total = options.get("epochs", 25)

    def learned(step: float, *_losses: float) -> None:
        show("training", min(step / total, 1.0))

    return estimation.train(table, "echo", settings, progress=learned, **options)


def _rows(model: Model, table: xr.Dataset, some: NDArray[np.bool_], which: str) -> Iterator[Row]:
    table = table.isel(cycle=some)
    estimates = estimation.estimate(model, table)
    for target in model.targets:
        unit, scale = DISPLAY_UNITS[target]
        truth, name = table[target].values.astype(float), TARGETS[target]
        columns = [estimates[name + end].values for end in ("", "_deviation", "_half_width")]
        found = estimation.errors(truth, *columns)
        why = f"Second dataset, {which}; learned from the first."
        yield from measure_rows(f"{name}, whole echo, {which}", unit, found, why=why, scale=scale)
        yield Row(quantity=f"{name}, whole echo, {which}: median relative error", unit="%",
                  ours=100 * found.relative, why=why)  # fmt: skip
        yield Row(quantity=f"{name}, whole echo, {which}: in the intervals of 90 %", unit="%",
                  ours=100 * found.covered_wide, why="The stated coverage is 90 %.")  # fmt: skip
