"""The command ``acoustube evaluate``."""

from __future__ import annotations

import csv
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from acoustube import estimation
from acoustube.base.console import ConsoleReporter, watched_interrupts
from acoustube.base.errors import ConfigError
from acoustube.base.files import partial_file
from acoustube.base.version import __version__
from acoustube.estimation import Model
from acoustube.estimation.model import TARGETS
from acoustube.runs.training import DISPLAY_UNITS, Row, error_rows, table_of

COLUMNS = (
    "target", "unit", "by", "from", "to", "cycles", "estimated", "median", "rmse", "iqr",
    "median_relative_percent", "bias", "within_68_percent", "within_90_percent",
)  # fmt: skip


def run_evaluate(
    path: Path,
    paths: Sequence[Path],
    console: Console,
    *,
    out: Path | None = None,
    figure: Path | None = None,
) -> list[Row]:
    """Set a model's estimates beside the labels of recordings.

    Parameters
    ----------
    path : Path
        The model.
    paths : sequence of Path
        Files and folders.
    console : rich.console.Console
    out : Path, optional
        A table (CSV) of the errors of all cycles, by depth and by distance.
    figure : Path, optional
        A picture of the estimates against the truth.

    Returns
    -------
    list of tuple
        See :func:`error_rows`.

    Raises
    ------
    ConfigError
        If the model or the recordings cannot be used, or no label is known.
    """
    start = time.perf_counter()
    model = estimation.load(path)
    with watched_interrupts() as check, ConsoleReporter(console).progress(check) as report:
        table = table_of(paths, model.feature_settings, report)
        estimates = estimation.estimate(model, table)
    rows = list(error_rows(model, table, estimates))
    if not rows:
        raise ConfigError(
            f"the cycles have no label {' or '.join(model.targets)}, which the model estimates; "
            "give it in the files or in a sidecar"
        )
    _print_errors(rows, table, model, console)
    if out is not None:
        with partial_file(out) as partial, partial.open("w", encoding="utf-8", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(COLUMNS)
            writer.writerows(_written(row) for row in rows)
    if figure is not None:
        from acoustube.reports.figures import estimates as estimate_figures
        from acoustube.reports.figures import run as run_figure

        run_figure.save(estimate_figures.figure(table, estimates), figure)
    written = " and ".join(str(p) for p in (out, figure) if p is not None)
    console.print(
        (f"Written to [bold]{escape(written)}[/] in " if written else "Evaluated in ")
        + f"{time.perf_counter() - start:.0f} s.",
        soft_wrap=True,
    )
    return rows


def _written(row: Row) -> list[object]:
    """Return a row of :data:`COLUMNS`, in human units."""
    target, by, low, high, count, found = row
    unit, scale = DISPLAY_UNITS[target]
    edge = {"distance": 100.0, "depth": 1e3}.get(by, 1.0)
    sizes = [scale * v for v in (found.median, found.rmse, found.iqr)]
    rest = [100 * found.relative, scale * found.bias, 100 * found.covered, 100 * found.covered_wide]
    numbers = [edge * low, edge * high, count, found.n, *sizes, *rest]
    return [TARGETS[target], unit, by, *("" if np.isnan(v) else f"{v:.6g}" for v in numbers)]


def _print_errors(rows: list[Row], table: xr.Dataset, model: Model, console: Console) -> None:
    seen = int(np.isfinite(table["features"].values).all(axis=1).sum())
    console.print(
        f"[bold]acoustube {__version__}[/]: {model.name}, trained on {model.origin['trained']} "
        f"cycles; {table.sizes['cycle']} cycles, echoes in {seen}",
        soft_wrap=True,
    )
    shown = Table(box=None, pad_edge=False)
    names = ("absolute error", "median", "RMSE", "IQR", "relative", "in 68 %", "in 90 %")
    for column in names:
        shown.add_column(column, justify="left" if column == names[0] else "right", no_wrap=True)
    for target, by, *_, found in rows:
        if by == "all":
            unit, scale = DISPLAY_UNITS[target]
            sizes = [f"{scale * v:.3g}" for v in (found.median, found.rmse, found.iqr)]
            shares = (found.relative, found.covered, found.covered_wide)
            percent = [f"{100 * v:.3g} %" for v in shares]
            shown.add_row(f"{TARGETS[target]}, {unit}", *sizes, *percent)
    console.print(shown)
