"""The command ``acoustube reproduce``: the paper's studies, one after another, and their report."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from html import escape
from importlib import import_module
from pathlib import Path

import pandas as pd
from rich.console import Console
from rich.table import Table

from acoustube.base.console import ConsoleReporter
from acoustube.base.errors import ConfigError
from acoustube.base.files import check_out, partial_file
from acoustube.base.report import Reporter, time_in_words
from acoustube.base.version import __version__
from acoustube.reports.studies.report import Scale, Study, write
from acoustube.runs.sweep.workers import crew

STUDIES = {
    "simulation": 25.0, "calibration": 0.5, "flat": 25.0, "mannequin": 8.0, "human": 6.0,
    "echotube": 1.5,
}  # fmt: skip
"""Studies in their order, and minutes that each takes on two cores with nothing remembered."""
QUICKER = 12.0
"""By what a quick study is shorter."""
MARK, WORK = "reproduce.json", "work"

Perform = Callable[[Scale, Path, Reporter], Study]


def run_reproduce(names: Sequence[str], out: Path, scale: Scale, console: Console) -> Path:
    """Run studies and write a page and a table for each, and for all.

    Parameters
    ----------
    names : sequence of str
        Of :data:`STUDIES`.
    out : Path
        A new folder, or one that this command began: what is finished there is kept.
    scale : Scale
    console : rich.console.Console

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    ConfigError
        If the folder holds something else.
    SimulationError
        If a study cannot be finished.
    """
    started = time.perf_counter()
    folder = _prepared(out, scale)
    minutes = sum(STUDIES[name] for name in names) / (QUICKER if scale.quick else 1.0)
    console.print(
        f"[bold]acoustube {__version__}[/]: studies {', '.join(names)}; about "
        f"{time_in_words(60 * minutes)} on two cores, less for what is remembered",
        soft_wrap=True,
    )
    with crew(scale.workers) as workers:
        for number, name in enumerate(names, 1):
            console.rule(f"study {number} of {len(names)}: {name}")
            study = _performed(name, folder, replace(scale, workers=workers), console)
            _write_index(folder)
            _print(study, console)
    elapsed = time_in_words(time.perf_counter() - started)
    console.print(f"Written to [bold]{folder / 'index.html'}[/] in {elapsed}.", soft_wrap=True)
    return folder


def _performed(name: str, folder: Path, scale: Scale, console: Console) -> Study:
    """Run a study and write its report."""
    work, report = folder / WORK / name, folder / name
    for path in (work, report):
        path.mkdir(parents=True, exist_ok=True)
    perform: Perform = import_module(f"acoustube.reports.studies.{name}").study
    try:
        study = perform(scale, work, ConsoleReporter(console))
    except KeyboardInterrupt as error:
        words = str(error) or f"interrupted in the study {name}; run the same command to go on"
        raise KeyboardInterrupt(words) from None
    write(study, name, report)
    return study


def _prepared(out: Path, scale: Scale) -> Path:
    """Return the folder of the report, which holds nothing else."""
    folder, mark = out.expanduser().resolve(), {"quick": scale.quick, "version": __version__}
    if (folder / MARK).is_file():
        if _begun_with(folder / MARK) != mark:
            raise ConfigError(
                f"out = {out} was begun with or without --quick, or by another version of "
                "acoustube; name a new folder"
            )
        return folder
    folder = check_out(out)
    folder.mkdir(parents=True, exist_ok=True)
    with partial_file(folder / MARK) as part:
        part.write_text(json.dumps(mark) + "\n", encoding="utf-8")
    return folder


def _begun_with(path: Path) -> object:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path.name} is damaged; name a new folder for out") from error


def _write_index(folder: Path) -> None:
    """Write a page that links to those of all studies that are there, and the table of all."""
    there = [name for name in STUDIES if (folder / name / "index.html").is_file()]
    tables = [pd.read_csv(folder / name / "table.csv", dtype=str) for name in there]
    pd.concat(tables).to_csv(folder / "table.csv", index=False, lineterminator="\n")
    links = "\n".join(
        f'<li><a href="{escape(name)}/index.html">{escape(name)}</a></li>' for name in there
    )
    (folder / "index.html").write_text(
        '<!doctype html>\n<html lang="en">\n<meta charset="utf-8">\n<title>acoustube: studies'
        f"</title>\n<h1>The paper's studies</h1>\n<ul>\n{links}\n</ul>\n<p>acoustube "
        f'{__version__}; all numbers: <a href="table.csv">table.csv</a></p>\n',
        encoding="utf-8",
    )


def _print(study: Study, console: Console) -> None:
    """Print the numbers of a study that have a published one."""
    table = Table(box=None, pad_edge=False)
    for column in (study.title, "unit", "published", "acoustube"):
        table.add_column(column, justify="left" if column == study.title else "right")
    for row in study.rows:
        if row.published is not None:
            table.add_row(row.quantity, row.unit, f"{row.published:.3g}", f"{row.ours:.3g}")
    console.print(table)
