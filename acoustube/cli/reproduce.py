"""The command ``acoustube reproduce``: published studies, repeated by simulation."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from acoustube.base.console import ConsoleReporter
from acoustube.base.errors import ConfigError
from acoustube.base.files import check_out
from acoustube.base.report import Reporter, time_in_words
from acoustube.base.version import __version__
from acoustube.base.writing import write
from acoustube.cli._options import FLAG, Output, Workers

if TYPE_CHECKING:
    from acoustube.reports.studies.report import Scale, Study

STUDIES = {
    "simulation": 25.0, "calibration": 0.5, "flat": 16.0, "mannequin": 10.0, "human": 11.0,
    "echotube": 1.5,
}  # fmt: skip
"""Studies in their order, and minutes that each takes on two cores with an empty cache."""
SPEED_UP = 12.0
"""Ratio of the computing times of a full and a quick study."""
MARK, WORK = "reproduce.json", "work"
"""Names of the file that marks the folder of a report, and of the folder of its computations."""

Perform = Callable[["Scale", Path, Reporter], "Study"]
"""Function that performs a study, given the folder of its computations."""


def reproduce(
    *study: Literal["simulation", "calibration", "flat", "mannequin", "human", "echotube", "all"],
    out: Path = Path("studies"),
    quick: Annotated[bool, FLAG] = False,
    processes: Workers = Workers(),
    output: Output = Output(),
) -> None:
    """Repeat published studies: a page and a table of published and simulated numbers for each.

    Numbers from waveform inversion of the same simulated recordings are listed beside them.

    Parameters
    ----------
    study : str
        Studies of the sleeve paper: the simulations of Fig. 2, the calibration of Fig. 3, the flat
        table of Figs. 4 and 5 and of Tables I and II, the sleeve on a mannequin's and on a human
        arm of Figs. 6 and 7; and the reach of EchoTube as a function of the bore; or all.
    out : Path
        Folder to write, or to resume.
    quick : bool
        Few presses on a coarse grid and no waveform inversion, as a test of the installation; the
        numbers are not accurate.
    """
    if not study:
        raise ConfigError("reproduce needs the name of a study, or all")

    from acoustube.reports.studies.report import Scale

    names = list(STUDIES) if "all" in study else [name for name in STUDIES if name in study]
    scale = Scale(quick=quick, workers=processes.workers)
    run_reproduce(names, out, scale, output.reporter())


def run_reproduce(names: Sequence[str], out: Path, scale: Scale, report: ConsoleReporter) -> Path:
    """Run studies; write a page and a table for each, and an index and a table of all.

    The folder `out` is new, or one that this command began, whose finished studies are kept. Its
    path is returned.

    Raises
    ------
    ConfigError
        If the folder holds something else, or another version or ``--quick`` began it.
    SimulationError
        If a study cannot be finished.
    """
    from acoustube.runs.sweep.workers import worker_pool

    started = time.perf_counter()
    folder = _prepared(out, scale)
    minutes = sum(STUDIES[name] for name in names) / (SPEED_UP if scale.quick else 1.0)
    report.line(
        f"acoustube {__version__}: studies {', '.join(names)}; about "
        f"{time_in_words(60 * minutes)} on two cores, less for cached results"
    )
    with worker_pool(scale.workers) as workers:
        for number, name in enumerate(names, 1):
            report.console.rule(f"study {number} of {len(names)}: {name}")
            study = _performed(name, folder, replace(scale, workers=workers), report)
            _write_index(folder)
            _print(study, report)
    elapsed = time_in_words(time.perf_counter() - started)
    report.line(f"Written to {folder / 'index.html'} in {elapsed}.")
    return folder


def _performed(name: str, folder: Path, scale: Scale, report: Reporter) -> Study:
    """Run a study and write its page and table."""
    from acoustube.reports.studies.report import write

    work, pages = folder / WORK / name, folder / name
    for path in (work, pages):
        path.mkdir(parents=True, exist_ok=True)
    perform: Perform = import_module(f"acoustube.reports.studies.{name}").study
    try:
        study = perform(scale, work, report)
    except KeyboardInterrupt as error:
        words = str(error) or f"interrupted in the study {name}; run the same command to go on"
        raise KeyboardInterrupt(words) from None
    write(study, name, pages)
    return study


def _prepared(out: Path, scale: Scale) -> Path:
    """Return the folder of the report: a new one, or one begun with the same options."""
    folder, mark = out.expanduser().resolve(), {"quick": scale.quick, "version": __version__}
    if (folder / MARK).is_file():
        if _begun_with(folder / MARK) != mark:
            raise ConfigError(
                "was begun with the other setting of --quick, or by another version of acoustube",
                setting="out", value=out, advice="name a new folder",
            )  # fmt: skip
        return folder
    folder = check_out(out)
    folder.mkdir(parents=True, exist_ok=True)
    write(folder / MARK, json.dumps(mark) + "\n")
    return folder


def _begun_with(path: Path) -> object:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path.name} is damaged; name a new folder for out") from error


def _write_index(folder: Path) -> None:
    """Write a page that links to those of all finished studies, and the table of all."""
    import pandas as pd

    from acoustube.reports.studies.report import index_page

    there = [name for name in STUDIES if (folder / name / "index.html").is_file()]
    tables = [pd.read_csv(folder / name / "table.csv", dtype=str) for name in there]
    table = pd.concat(tables).to_csv(index=False, lineterminator="\n")
    write(folder / "table.csv", table, overwrite=True)
    write(folder / "index.html", index_page(there), overwrite=True)


def _print(study: Study, report: ConsoleReporter) -> None:
    """Print the published numbers of a study next to the computed ones."""
    from rich.table import Table

    from acoustube.reports.studies.report import plain

    table = Table(box=None, pad_edge=False)
    for column in (study.title, "unit", "published", "acoustube", "by waveform inversion"):
        table.add_column(column, justify="left" if column == study.title else "right")
    for row in study.rows:
        if row.published is not None:
            numbers = (plain(number) for number in (row.published, row.ours, row.inversion))
            table.add_row(row.quantity, row.unit, *numbers)
    report.console.print(table)
