"""A run as a person sees it: progress, a table, a folder with data, settings and a figure."""

from __future__ import annotations

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
from acoustube.reports.scenes import tube as tube_scene
from acoustube.runs.config import Config, to_toml
from acoustube.runs.config.si import settings_in_si
from acoustube.runs.costs import simulation_cost
from acoustube.runs.presses import press_in_words
from acoustube.runs.simulate import simulate


def run(config: Config, folder: Path, console: Console) -> Path:
    """Simulate one press, print what came of it and write it to a folder.

    Parameters
    ----------
    config : Config
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
        If the folder cannot be made.
    SimulationError
        If a stage cannot finish.
    """
    started = time.perf_counter()
    with watched_interrupts() as check:
        _print_header(config, console)
        with partial_folder(folder) as partial:
            with ConsoleReporter(console).progress(check) as report:
                dataset = simulate(config, report=report)
            write_dataset(dataset, partial / "run.nc")
            (partial / "config.toml").write_text(to_toml(config), encoding="utf-8")
            drawn = _write_figure(dataset, partial)
            check()
            folder = publish(partial, folder)
    _print_results(dataset, config.signals.prominence, console)
    if not drawn:
        note(console, "The tube could not be drawn in 3-D: see 'The figure' in the README.")
    elapsed = time.perf_counter() - started
    console.print(f"Written to [bold]{folder}[/] in {elapsed:.0f} s.", soft_wrap=True)
    return folder


def _write_figure(dataset: xr.Dataset, folder: Path) -> bool:
    """Write the figure, and tell whether the tube is drawn in it."""
    from acoustube.reports.figures import run as run_figure

    images = tube_scene.draw(folder / "run.nc")
    run_figure.save(run_figure.figure(dataset, images), folder / "figure.png")
    return images is not None


def _print_header(config: Config, console: Console) -> None:
    """Print what is about to be computed, and what it costs."""
    waves, settings = config.waves, settings_in_si(config)
    seconds, memory = simulation_cost(settings)
    where = f"{jax.devices()[0].device_kind}, float64 wall, float32 air"
    grid = f"{waves.resolution} cells across the bore"
    cost = f"about {max(seconds / 60, 0.5):.1g} min, {memory:.1f} GB"
    console.print(f"[bold]acoustube {__version__}[/] on {where}, {grid}; {cost}", soft_wrap=True)
    print_wall(config, console)
    console.print(
        f"press: {press_in_words(settings)}, at {config.position_cm:g} cm",
        soft_wrap=True,
    )
    console.print(
        f"sound: {waves.frequency_khz:g} kHz, {waves.cycles} cycles, {waves.temperature_c:g} degC, "
        f"{waves.humidity_percent:g} % humidity, {waves.pressure_kpa:g} kPa, probe at "
        f"{waves.probe_cm:g} cm, source end {waves.source_end}, losses {waves.losses}, method "
        f"{waves.method}",
        soft_wrap=True,
    )


def _print_results(dataset: xr.Dataset, prominence: float, console: Console) -> None:
    """Print what came of a run: the press, the estimates, the times and the notes."""
    last = dataset.isel(depth=-1)
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_row("force", f"{float(last['contact_force']):.3f} N")
    table.add_row("lumen height at the press", f"{1e3 * float(last['lumen_height']):.3f} mm")
    table.add_row("lumen area at the press", f"{1e6 * float(last['lumen_area']):.2f} mm2")
    table.add_row("true distance", f"{100 * float(dataset['true_distance']):.2f} cm")
    chosen = dataset["distance"].attrs["source_end"]
    for end in sorted(dataset["source_end"].values, key=lambda end: end != chosen):
        style = "bold" if end == chosen else ""
        table.add_row(
            f"estimate, {end} source end",
            _estimate(dataset.sel(source_end=end), prominence),
            style=style,
        )
    times = zip(dataset["stage"].values, dataset["elapsed_time"].values, strict=True)
    table.add_row("time", ", ".join(f"{stage} {seconds:.1f} s" for stage, seconds in times))
    console.print(table)
    console.print(f"accuracy: {dataset.attrs['accuracy']}", soft_wrap=True)
    for words in dataset.attrs["warnings"].splitlines():
        note(console, words)


def _estimate(case: xr.Dataset, prominence: float) -> str:
    """Return the estimate with one choice of the source end, in words."""
    distance, true = float(case["estimated_distance"]), float(case["true_distance"])
    if not np.isfinite(distance):
        return f"no echo over {100 * prominence:g} % of the send pulse"
    return (
        f"{100 * distance:.2f} cm (error {100 * (distance - true):+.2f} cm), "
        f"echo {100 * float(case['echo_amplitude']):.2f} % of the send pulse"
    )
