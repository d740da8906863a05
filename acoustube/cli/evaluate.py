"""The command ``acoustube evaluate``: errors of a trained estimator on labelled cycles."""

from __future__ import annotations

import csv
import io
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from acoustube.base.console import ConsoleReporter
from acoustube.base.errors import ConfigError
from acoustube.base.interrupts import watched_interrupts
from acoustube.base.report import counted
from acoustube.base.rules import Number
from acoustube.base.version import __version__
from acoustube.base.writing import write_all
from acoustube.cli._options import WHOLE, Checked, Output, check_files

if TYPE_CHECKING:
    import xarray as xr

    from acoustube.runs.training import Row

COLUMNS = (
    "target", "unit", "by", "from", "to", "cycles", "estimated", "median", "rmse", "iqr",
    "median_relative_percent", "bias", "within_68_percent", "within_90_percent",
)  # fmt: skip
"""Columns of the table of errors."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Inverted(Checked):
    """Options of an evaluation of waveform inversion.

    Attributes
    ----------
    sensor : Path
        TOML file of the sensor, as for `invert`.
    untouched : Path
        Recordings of the tube without contact, as for `invert`.
    group : int
        Cycles with equal labels that are inverted together, at most.
    """

    sensor: Path | None = None
    untouched: Annotated[list[Path] | None, Parameter(consume_multiple=True)] = None
    group: Annotated[int, WHOLE, Number(1, 100_000, "", "cycles", whole=True)] = 20


def evaluate(
    model: Path,
    *data: Path,
    inverted: Inverted = Inverted(),
    out: Path | None = None,
    figure: Path | None = None,
    output: Output = Output(),
) -> None:
    """Evaluate an estimator on labelled cycles: errors and coverage of the intervals.

    Parameters
    ----------
    model : Path
        File that ``train`` wrote, or folder that ``library`` wrote, to evaluate waveform inversion.
    data : Path
        Files with cycles and labels, or folders of these; not those used for training.
    out : Path
        Table of errors to write (CSV), in total, by depth and by distance, which must be new.
    figure : Path
        Picture of estimates and errors to write (PNG, PDF or SVG), which must be new.
    """
    if not data:
        raise ConfigError("evaluate needs a file or a folder; name one or more")
    of_library = False
    if model.is_dir():
        from acoustube.runs.libraries.files import PATTERN

        of_library = any(model.glob(PATTERN))
    if not (model.is_file() or of_library):
        what = "holds no file of a library" if model.is_dir() else "does not exist"
        raise ConfigError(
            f"{model} {what}; give a model, which train writes, or a library's folder, which "
            "library writes"
        )
    check_files(out=out, figure=figure)
    for name, value in (("sensor", inverted.sensor), ("untouched", inverted.untouched)):
        if value is not None and not of_library:
            raise ConfigError(f"--{name} needs a library; give the folder of one, not a model")
    if of_library:
        _evaluate_library(model, data, inverted, out, figure, output.reporter())
        return

    import numpy as np

    from acoustube import estimation
    from acoustube.base.foreign.limits import reading
    from acoustube.runs.recordings import read_cycles
    from acoustube.runs.training import check_drive, error_rows, table_of

    report = output.reporter()
    start = time.perf_counter()
    trained = estimation.load(model)
    with watched_interrupts() as check, report.progress(check) as show:
        how = trained.feature_settings
        check_recording = partial(check_drive, how=how.processing)
        table = table_of(read_cycles(data), how, show, check_recording)
        with reading(model, "cannot be used", "train it again"):
            estimates = estimation.estimate(trained, table)
    rows = list(error_rows(trained.targets, table, estimates))
    if not rows:
        raise ConfigError(
            f"the cycles have no label {' or '.join(trained.targets)}, which the model estimates; "
            "give it in the files or in a sidecar"
        )
    seen = int(np.isfinite(table["features"].values).all(axis=1).sum())
    head = (
        f"{trained.name}, trained on {counted(trained.origin['trained'], 'cycle')}; "
        f"{counted(table.sizes['cycle'], 'cycle')}, echoes in {seen}"
    )
    _finish(rows, head, (table, estimates), {"out": out, "figure": figure}, report, start)


def _evaluate_library(
    folder: Path,
    data: Sequence[Path],
    inverted: Inverted,
    out: Path | None,
    figure: Path | None,
    report: ConsoleReporter,
) -> None:
    """Evaluate the inversion with the library in a folder, on labelled cycles."""
    import numpy as np

    from acoustube.estimation.model import TARGETS
    from acoustube.runs import inversion
    from acoustube.runs.inverted_cycles import inverted as estimated
    from acoustube.runs.libraries.files import open_library
    from acoustube.runs.recordings import read_cycles
    from acoustube.runs.training import error_rows

    start = time.perf_counter()
    library = open_library(folder)
    sensor = (
        inversion.Sensor() if inverted.sensor is None else inversion.read_sensor(inverted.sensor)
    )
    free = list(read_cycles(inverted.untouched)) if inverted.untouched else []
    inverter = inversion.RecordingInverter(library, sensor, free)
    with watched_interrupts() as check, report.progress(check) as show:
        table, estimates = estimated(read_cycles(data), inverter, inverted.group, show)
    rows = list(error_rows(tuple(TARGETS), table, estimates))
    if not rows:
        raise ConfigError(
            f"the cycles have no label {' or '.join(TARGETS)}; give it in the files or in a sidecar"
        )
    found = int(np.isfinite(estimates["distance"].values).sum())
    tools = ", ".join(tool.name for tool in library.tools)
    head = (
        f"inversion, library of {tools}; {counted(table.sizes['cycle'], 'group')} of up to "
        f"{counted(inverted.group, 'cycle')}, contacts in {found}"
    )
    _finish(rows, head, (table, estimates), {"out": out, "figure": figure}, report, start)


def _finish(
    rows: list[Row],
    head: str,
    results: tuple[xr.Dataset, xr.Dataset],
    files: dict[str, Path | None],
    report: ConsoleReporter,
    start: float,
) -> None:
    """Print the errors, and write the table and the picture."""
    _print_errors(rows, head, report)
    contents: dict[Path, bytes | str] = {}
    if files["out"] is not None:
        table = io.StringIO()
        csv.writer(table, lineterminator="\n").writerows([COLUMNS, *map(_written, rows)])
        contents[files["out"]] = table.getvalue()
    if files["figure"] is not None:
        from acoustube.reports.figures import estimates as estimate_figures
        from acoustube.reports.figures.run import picture

        contents[files["figure"]] = picture(estimate_figures.figure(*results), files["figure"])
    write_all(contents)
    done = f"Written to {' and '.join(map(str, contents))}" if contents else "Evaluated"
    report.line(f"{done} in {time.perf_counter() - start:.0f} s.")


def _written(row: Row) -> list[object]:
    """Return a row of :data:`COLUMNS`, in display units."""
    from acoustube.estimation.model import TARGETS
    from acoustube.runs.training import DISPLAY_UNITS

    target, by, low, high, count, found = row
    unit, scale = DISPLAY_UNITS[target]
    edge = {"distance": 100.0, "depth": 1e3}.get(by, 1.0)
    sizes = [scale * v for v in (found.median, found.rmse, found.iqr)]
    rest = [100 * found.relative, scale * found.bias, 100 * found.covered, 100 * found.covered_wide]
    numbers = [edge * low, edge * high, count, found.n, *sizes, *rest]
    return [TARGETS[target], unit, by, *("" if math.isnan(v) else f"{v:.6g}" for v in numbers)]


def _print_errors(rows: list[Row], head: str, report: ConsoleReporter) -> None:
    """Print the errors over all cycles as a table, by target."""
    from rich.table import Table

    from acoustube.estimation.model import TARGETS
    from acoustube.runs.training import DISPLAY_UNITS

    report.line(f"acoustube {__version__}: {head}")
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
    report.console.print(shown)
