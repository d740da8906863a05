"""The commands ``acoustube train`` and ``acoustube evaluate``: labelled cycles in, errors out."""

from __future__ import annotations

import csv
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from acoustube import __version__, estimation, recordings
from acoustube.errors import ConfigError
from acoustube.estimation import Describing, Model
from acoustube.estimation.features import LABELS
from acoustube.estimation.model import ESTIMATORS, TARGETS, kind_of_features, targets_of, usable
from acoustube.io import partial_file
from acoustube.processed import check_rate, chosen
from acoustube.progress import heard_interrupts, note, stage_progress

HUMAN = {"true_distance": ("cm", 100.0), "depth": ("mm", 1e3), "force": ("N", 1.0)}
"""Units of the tables, and how many make one of SI."""
BINS = {"depth": 0.5e-3, "true_distance": 0.05}
"""Widths in m of the bins of the table: the paper's steps of depth, and of its error map."""
OVERFITTED = 0.02
"""Rise of the validation loss over its lowest from which fewer epochs are advised."""
COLUMNS = (
    "target", "unit", "by", "from", "to", "cycles", "estimated", "median", "rmse", "iqr",
    "median_relative_percent", "bias", "within_68_percent", "within_90_percent",
)  # fmt: skip
# Target, by what its cycles are chosen, from where to where in SI, how many, and their errors.
Row = tuple[str, str, float, float, int, estimation.Errors]


def read_cycles(paths: Sequence[Path]) -> Iterator[tuple[Path, xr.Dataset]]:
    """Yield the cycles of files and folders.

    Raises
    ------
    ConfigError
        If one cannot be read: labels without their cycles would train something else.
    """
    for path, data in recordings.read_all(paths):
        if isinstance(data, ConfigError):
            raise data
        yield path, data


def table_of(
    paths: Sequence[Path],
    describing: Describing,
    report: Callable[[str, float], None],
    check: Callable[[Path, float], None] | None = None,
) -> xr.Dataset:
    """Describe the cycles of files, one file after another, and join what is said of them.

    Parameters
    ----------
    paths : sequence of Path
    describing : Describing
    report : callable
        Called with a stage and the fraction of it that is done.
    check : callable, optional
        Called with each file and its sampling rate in Hz.

    Returns
    -------
    xarray.Dataset
        As of :func:`acoustube.estimation.described`. A file that does not tell its session is one.

    Raises
    ------
    ConfigError
        If a file cannot be read, or their sampling rates differ.
    """
    parts: list[xr.Dataset] = []
    for path, data in read_cycles(paths):
        if check is not None:
            check(path, float(data.attrs["sampling_rate"]))
        try:
            part = estimation.described(data, describing, lambda share: report("echoes", share))
        except ValueError as error:
            raise ConfigError(f"{path}: {error}") from error
        if "session" not in part:
            part["session"] = "cycle", np.full(part.sizes["cycle"], str(path))
        parts.append(part)
    rates = {float(part.attrs["sampling_rate"]) for part in parts}
    if max(rates) > 1.001 * min(rates):
        raise ConfigError(
            f"the recordings have {min(rates):g} to {max(rates):g} samples per second; use alike"
        )
    return _joined(parts)


def _joined(parts: list[xr.Dataset]) -> xr.Dataset:
    """Join descriptions; a label that only some know is nan, or empty, for the others."""
    variables: dict[str, Any] = {
        "features": (("cycle", "feature"), np.concatenate([p["features"].values for p in parts]))
    }
    for name in LABELS:
        known = [p[name].values for p in parts if name in p]
        if not known:
            continue
        numbers = all(values.dtype.kind in "biuf" for values in known)
        blank: Any = np.nan if numbers else ""
        columns = [p[name].values if name in p else np.full(p.sizes["cycle"], blank) for p in parts]
        variables[name] = (
            "cycle",
            np.concatenate(columns if numbers else [column.astype(str) for column in columns]),
        )
    return xr.Dataset(variables, {"feature": parts[0]["feature"].values}, parts[0].attrs)


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
        See :func:`acoustube.processed.chosen`.
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
    describing = Describing(kind=kind_of_features(name), processing=processing)
    settings: dict[str, Any] = {} if folds is None else {"n_folds": folds}
    if epochs is not None:
        settings["iterations" if name == "boosting" else "epochs"] = epochs
    with heard_interrupts() as check:
        with stage_progress(console, check) as report:
            table = table_of(
                paths, describing, report, lambda path, rate: check_rate(rate, known, path)
            )
        _print_cycles(table, name, console)
        with stage_progress(console, check) as report:
            total = epochs or ESTIMATORS[name]().get_params().get("epochs", 1)

            def learned(step: float, *losses: float) -> None:
                report("training", step / total if losses else step)
                if losses and str(step).strip("0") in ("1", "2", "5"):  # an early look
                    console.print(
                        f"epoch {step} of {total}: loss {losses[0]:.4f}, held out {losses[1]:.4f}"
                    )

            model = estimation.train(
                table, name, describing, by=by, seed=seed, progress=learned, **settings
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
    with heard_interrupts() as check, stage_progress(console, check) as report:
        table = table_of(paths, model.describing, report)
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
        from acoustube import plot, plot_estimates

        plot.save(plot_estimates.figure(table, estimates), figure)
    written = " and ".join(str(p) for p in (out, figure) if p is not None)
    console.print(
        (f"Written to [bold]{escape(written)}[/] in " if written else "Evaluated in ")
        + f"{time.perf_counter() - start:.0f} s.",
        soft_wrap=True,
    )
    return rows


def error_rows(model: Model, table: xr.Dataset, estimates: xr.Dataset) -> Iterator[Row]:
    """Yield the errors of each target: of all cycles, then by depth and by distance.

    Parameters
    ----------
    model : Model
    table, estimates : xarray.Dataset
        From :func:`acoustube.estimation.described` and :func:`acoustube.estimation.estimate`.

    Yields
    ------
    tuple
        The target; by what its cycles are chosen, and from where to where; how many they are; and
        their errors, in SI units.
    """
    for target in model.targets:
        if target not in table or not np.isfinite(table[target]).any():
            continue
        name = TARGETS[target]
        columns = [table[target].values.astype(float)]
        columns += [estimates[name + s].values for s in ("", "_deviation", "_half_width")]
        known = np.isfinite(columns[0])
        yield target, "all", np.nan, np.nan, int(known.sum()), estimation.errors(*columns)
        for label, width in BINS.items():
            if label not in table:
                continue
            edges, index = estimation.bins(table[label].values, width)
            for i, (low, high) in enumerate(edges):
                inside = index == i
                some = [column[inside] for column in columns]
                count = int((known & inside).sum())
                yield target, TARGETS[label], low, high, count, estimation.errors(*some)


def _written(row: Row) -> list[object]:
    """Return a row of :data:`COLUMNS`, in human units."""
    target, by, low, high, count, found = row
    unit, scale = HUMAN[target]
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
            unit, scale = HUMAN[target]
            sizes = [f"{scale * v:.3g}" for v in (found.median, found.rmse, found.iqr)]
            shares = (found.relative, found.covered, found.covered_wide)
            percent = [f"{100 * v:.3g} %" for v in shares]
            shown.add_row(f"{TARGETS[target]}, {unit}", *sizes, *percent)
    console.print(shown)
