"""The command ``acoustube indent``: the mechanics of a press alone."""

from __future__ import annotations

import functools
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from acoustube.base.console import ConsoleReporter
from acoustube.base.files import check_surface, partial_folder, publish
from acoustube.base.interrupts import watched_interrupts
from acoustube.base.units import MM, MM2
from acoustube.base.version import __version__
from acoustube.base.writing import write
from acoustube.cli._header import print_wall
from acoustube.cli._options import Output, Run, Tool, setting, settings_of
from acoustube.runs.config import Mechanics, load_config, to_toml

if TYPE_CHECKING:
    import xarray as xr

TABLE_ROWS = 16
"""Largest number of depths of a press that are printed."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Placement:
    """Options for the indentation depths, the indenter's position and direction, and the tube."""

    steps: Annotated[int | None, setting("steps")] = None
    offset: Annotated[float | None, setting("offset")] = None
    yaw: Annotated[float | None, setting("yaw")] = None
    tube: Annotated[str | None, setting("tube")] = None


def indent(
    *,
    tool: Tool = Tool(),
    placement: Placement = Placement(),
    run: Run = Run(),
    output: Output = Output(),
) -> None:
    """Compute force, lumen and mesh of a pressed tube at each depth, up to a closed lumen.

    An option that is not given is taken from the file of --config, else from the defaults: the tube
    of the sleeve paper, pressed 4 mm deep by a 25 mm cylinder.
    """
    config = load_config(run.config, Mechanics, **settings_of(tool, placement))
    if config.tube.surface is not None:
        check_surface(config.tube.surface)
    run_press(config, run.folder("indent"), output.reporter())


def run_press(config: Mechanics, folder: Path, report: ConsoleReporter) -> Path:
    """Press a tube, print the results and write them to a folder.

    The folder appears only when it is complete; its path is returned.

    Raises
    ------
    ConfigError
        If the folder cannot be made, or an imported surface is not a tube.
    PressError
        If the press stopped before the last depth; the folder then holds what had converged.
    """
    import jax

    from acoustube.base.netcdf import write_dataset
    from acoustube.indentation import PressError
    from acoustube.reports.export import vtu
    from acoustube.reports.figures import run as run_figure
    from acoustube.runs import results
    from acoustube.runs.config.si import press_in_si
    from acoustube.runs.presses import press_to

    started = time.perf_counter()
    settings, stopped = press_in_si(config), None
    depths = settings.depths
    notes: list[str] = []
    with watched_interrupts() as check:
        _print_press_header(config, report)
        with partial_folder(folder) as partial:
            with report.progress(check) as show:
                progress = functools.partial(show, "indentation")
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
            write(partial / "config.toml", to_toml(config))
            rows = indentation.rows_at(depths)
            reached, displacements = indentation.depth[rows], indentation.displacement[rows]
            vtu.write(indentation.mesh, reached, displacements, partial / "vtu")
            figure = partial / "figure.png"
            write(figure, run_figure.picture(run_figure.press_figure(dataset), figure))
            check()
            folder = publish(partial, folder)
    _print_press(dataset, report)
    for words in notes:
        report.note(words)
    report.line(f"Written to {folder} in {time.perf_counter() - started:.0f} s.")
    if stopped is not None:
        raise stopped
    return folder


def _print_press_header(config: Mechanics, report: ConsoleReporter) -> None:
    """Print the settings of a press, and its expected cost."""
    import jax

    from acoustube.runs.config.si import press_in_si
    from acoustube.runs.costs import PRESS_GIGABYTES, TETRAHEDRA, press_seconds
    from acoustube.runs.presses import press_in_words

    settings = press_in_si(config)
    minutes = press_seconds(settings, settings.depth) / 60
    minutes *= TETRAHEDRA if settings.surface else 1.0
    report.line(
        f"acoustube {__version__} on {jax.devices()[0].device_kind}, float64; "
        f"about {max(minutes, 0.5):.1g} min unless it is cached, {PRESS_GIGABYTES:g} GB"
    )
    print_wall(config, report)
    report.line(f"press: {press_in_words(settings)}, in {config.indentation.steps} steps")


def _print_press(dataset: xr.Dataset, report: ConsoleReporter) -> None:
    """Print the press at some of its depths."""
    import numpy as np
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for name in ("depth mm", "force N", "height mm", "width mm", "area mm2", ""):
        table.add_column(name, justify="right")
    n = dataset.sizes["depth"]
    for i in sorted({round(k) for k in np.linspace(0, n - 1, min(n, TABLE_ROWS))}):
        row = dataset.isel(depth=i)
        numbers = [
            f"{MM * float(row['indentation_depth']):.3f}",
            f"{float(row['contact_force']):.3f}",
            f"{MM * float(row['lumen_height']):.3f}",
            f"{MM * float(row['lumen_width']):.3f}",
            f"{MM2 * float(row['lumen_area']):.2f}",
        ]
        state = "closed" if row["closed"] else ""
        table.add_row(*numbers, state if row["converged"] else "not reached")
    report.console.print(table)
