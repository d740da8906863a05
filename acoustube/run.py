"""A run as a person sees it: progress, a table, a folder with data, settings and a figure."""

from __future__ import annotations

import functools
import time
from pathlib import Path

import jax
import numpy as np
import xarray as xr
from rich.console import Console
from rich.table import Table

from acoustube import __version__, record, scene
from acoustube.chain import simulate
from acoustube.config import Config, Mechanics, grid_cells, to_toml
from acoustube.indentation import PressError
from acoustube.io import partial_folder, publish, write_dataset
from acoustube.mechanics import press_from, press_in_words, pressed
from acoustube.progress import heard_interrupts, note, stage_progress

# Measured with benchmarks/fdtd_throughput.py and the default run on two quiet cores; they serve
# the estimate in the first line only.
FIXED_SECONDS, FIXED_GIGABYTES = 30.0, 0.6
STEPS_PER_LAYER = 2 * 3.9  # time steps per axial layer, for both source ends
SCATTERING_STEPS = 8 * 8000.0  # of eight runs of 12 ms, per cell in a mm
SECONDS_PER_CELL_STEP, LOSSY, GIGABYTES_PER_CELL = 0.6e-9, 3.0, 3e-7
PRESS_SECONDS, PRESS_GIGABYTES = {2: (10.0, 7.0), 1: (15.0, 15.0), 0: (30.0, 60.0)}, 1.0
"""Of a press: once and per mm of depth, by how often symmetry halves the tube."""
TETRAHEDRA = 4.0
"""By what a press of a wall from a file takes longer."""

TABLE_ROWS = 16
"""Depths of a press that are printed."""


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
    with heard_interrupts() as check:
        _print_header(config, console)
        with partial_folder(folder) as partial:
            with stage_progress(console, check) as report:
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
    from acoustube import plot, vtu

    started = time.perf_counter()
    press, stopped = config.indentation, None
    notes: list[str] = []
    depths = [1e-3 * (press.depth_mm * i / press.steps) for i in range(1, press.steps + 1)]
    with heard_interrupts() as check:
        _print_press_header(config, console)
        with partial_folder(folder) as partial:
            with stage_progress(console, check) as report:
                progress = functools.partial(report, "indentation")
                progress(0.0)
                try:
                    indentation = pressed(config, depths, progress, notes.append)
                except PressError as error:
                    indentation, stopped = error.indentation, error
            dataset = record.press_dataset(
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
            plot.save(plot.press_figure(dataset), partial / "figure.png")
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
    start, per_mm = PRESS_SECONDS[sum(press_from(config).halves)]
    minutes = (start + per_mm * config.indentation.depth_mm) / 60
    minutes *= TETRAHEDRA if config.tube.surface else 1.0
    console.print(
        f"[bold]acoustube {__version__}[/] on {jax.devices()[0].device_kind}, float64; "
        f"about {max(minutes, 0.5):.1g} min unless it is remembered, {PRESS_GIGABYTES:g} GB",
        soft_wrap=True,
    )
    _print_wall(config, console)
    console.print(
        f"press: {press_in_words(config)}, in {config.indentation.steps} steps", soft_wrap=True
    )


def _print_wall(config: Config | Mechanics, console: Console) -> None:
    """Print the tube's sizes and material."""
    tube = config.tube
    hardness = (
        f"{tube.shore_a:g} Shore A"
        if tube.shore_a is not None
        else f"shear modulus {tube.shear_modulus_mpa:g} MPa"
    )
    shape = (
        f"bore {tube.inner_diameter_mm:g} mm, wall {tube.wall_mm:g} mm, {tube.length_cm:g} cm long"
        if tube.surface is None
        else f"surface {tube.surface}"
    )
    console.print(
        f"tube: {shape}, {hardness}, Poisson's ratio {tube.poisson_ratio:g}", soft_wrap=True
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


def _write_figure(dataset: xr.Dataset, folder: Path) -> bool:
    """Write the figure, and tell whether the tube is drawn in it."""
    from acoustube import plot

    images = scene.draw(folder / "run.nc")
    plot.save(plot.figure(dataset, images), folder / "figure.png")
    return images is not None


def _print_header(config: Config, console: Console) -> None:
    """Print what is about to be computed, and what it costs."""
    tube, press, waves = config.tube, config.indentation, config.waves
    cells, layers = grid_cells(config), waves.resolution / tube.inner_diameter_mm
    steps = STEPS_PER_LAYER * 10 * tube.length_cm * layers
    if waves.method == "scattering":
        steps = SCATTERING_STEPS * layers
    seconds = cells * steps * SECONDS_PER_CELL_STEP * (LOSSY if waves.losses == "on" else 1)
    minutes = (FIXED_SECONDS + seconds) / 60
    memory = FIXED_GIGABYTES + cells * GIGABYTES_PER_CELL
    where = f"{jax.devices()[0].device_kind}, float64 wall, float32 air"
    grid = f"{waves.resolution} cells across the bore"
    cost = f"about {max(minutes, 0.5):.1g} min, {memory:.1f} GB"
    console.print(f"[bold]acoustube {__version__}[/] on {where}, {grid}; {cost}", soft_wrap=True)
    _print_wall(config, console)
    console.print(
        f"press: {press_in_words(config)}, at {press.position_cm:g} cm",
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
