"""The command ``acoustube indent``: a press as a table, a folder and a figure."""

from __future__ import annotations

import functools
import time
from pathlib import Path

import jax
import numpy as np
import xarray as xr
from rich.console import Console
from rich.table import Table

from acoustube.base.console import ConsoleReporter, note, watched_interrupts
from acoustube.base.files import partial_folder, publish
from acoustube.base.netcdf import write_dataset
from acoustube.base.version import __version__
from acoustube.cli._header import print_wall
from acoustube.indentation import PressError
from acoustube.runs import results
from acoustube.runs.config import Mechanics, to_toml
from acoustube.runs.config.si import press_in_si
from acoustube.runs.costs import PRESS_GIGABYTES, TETRAHEDRA, press_seconds
from acoustube.runs.presses import press_in_words, press_to

TABLE_ROWS = 16
"""Depths of a press that are printed."""


def run_press(config: Mechanics, folder: Path, console: Console) -> Path:
    """Press a tube, print what came of it and write it to a folder.

    Parameters
    ----------
    config : Mechanics
        The settings.
    folder : path
        The folder to be made; it appears only when it is complete.
    console : rich.console.Console
        Where to print.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    ConfigError
        If the folder cannot be made, or an imported surface is no tube.
    PressError
        If the press stopped before the last depth; the folder then holds what had converged.
    """
    from acoustube.reports.export import vtu
    from acoustube.reports.figures import run as run_figure

    started = time.perf_counter()
    settings, stopped = press_in_si(config), None
    depths = settings.depths
    notes: list[str] = []
    with watched_interrupts() as check:
        _print_press_header(config, console)
        with partial_folder(folder) as partial:
            with ConsoleReporter(console).progress(check) as report:
                progress = functools.partial(report, "indentation")
                progress(0.0)
                try:
                    indentation = press_to(settings, depths, progress, notes.append)
                except PressError as error:
                    indentation, stopped = error.indentation, error
            dataset = results.press_dataset(
                config,
                indentation,
                depths,
                seconds=time.perf_counter() - started,
                warnings=notes if stopped is None else [*notes, str(stopped)],
                device=jax.devices()[0].device_kind,
            )
            write_dataset(dataset, partial / "run.nc")
            (partial / "config.toml").write_text(to_toml(config), encoding="utf-8")
            rows = indentation.rows_at(depths)
            reached, displacements = indentation.depth[rows], indentation.displacement[rows]
            vtu.write(indentation.mesh, reached, displacements, partial / "vtu")
            run_figure.save(run_figure.press_figure(dataset), partial / "figure.png")
            check()
            folder = publish(partial, folder)
    _print_press(dataset, console)
    for words in notes:
        note(console, words)
    elapsed = time.perf_counter() - started
    console.print(f"Written to [bold]{folder}[/] in {elapsed:.0f} s.", soft_wrap=True)
    if stopped is not None:
        raise stopped
    return folder


def _print_press_header(config: Mechanics, console: Console) -> None:
    """Print what is about to be pressed."""
    settings = press_in_si(config)
    minutes = press_seconds(settings, settings.depth) / 60
    minutes *= TETRAHEDRA if settings.surface else 1.0
    console.print(
        f"[bold]acoustube {__version__}[/] on {jax.devices()[0].device_kind}, float64; "
        f"about {max(minutes, 0.5):.1g} min unless it is remembered, {PRESS_GIGABYTES:g} GB",
        soft_wrap=True,
    )
    print_wall(config, console)
    console.print(
        f"press: {press_in_words(settings)}, in {config.indentation.steps} steps", soft_wrap=True
    )


def _print_press(dataset: xr.Dataset, console: Console) -> None:
    """Print the press at some of its depths."""
    table = Table(box=None, pad_edge=False)
    for name in ("depth mm", "force N", "height mm", "width mm", "area mm2", ""):
        table.add_column(name, justify="right")
    n = dataset.sizes["depth"]
    for i in sorted({round(k) for k in np.linspace(0, n - 1, min(n, TABLE_ROWS))}):
        row = dataset.isel(depth=i)
        numbers = [
            f"{1e3 * float(row['indentation_depth']):.3f}",
            f"{float(row['contact_force']):.3f}",
            f"{1e3 * float(row['lumen_height']):.3f}",
            f"{1e3 * float(row['lumen_width']):.3f}",
            f"{1e6 * float(row['lumen_area']):.2f}",
        ]
        state = "closed" if row["closed"] else ""
        table.add_row(*numbers, state if row["converged"] else "not reached")
    console.print(table)
