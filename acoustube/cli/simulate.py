"""The command ``acoustube simulate``: one press, from the indentation to the distance estimate."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from acoustube.base.console import ConsoleReporter
from acoustube.base.files import partial_folder, publish
from acoustube.base.interrupts import watched_interrupts
from acoustube.base.units import CM, MM, MM2, PERCENT
from acoustube.base.version import __version__
from acoustube.base.writing import write
from acoustube.cli._header import print_wall
from acoustube.cli._options import Output, Run, Tool, setting, settings_of
from acoustube.runs.config import Config, check_touched, load_config, to_toml

if TYPE_CHECKING:
    import xarray as xr

    from acoustube.reports.scenes.offscreen import Image


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Sound:
    """Settings of the tube's length and of the sound in it."""

    position: Annotated[float | None, setting("position")] = None
    length: Annotated[float | None, setting("length")] = None
    frequency: Annotated[float | None, setting("frequency")] = None
    temperature: Annotated[float | None, setting("temperature")] = None
    resolution: Annotated[int | None, setting("resolution")] = None
    source_end: Annotated[Literal["release", "absorbing"] | None, setting("source_end")] = None
    losses: Annotated[Literal["off", "on"] | None, setting("losses")] = None
    method: Annotated[Literal["full", "scattering", "spectral"] | None, setting("method")] = None


def simulate(
    *, tool: Tool = Tool(), sound: Sound = Sound(), run: Run = Run(), output: Output = Output()
) -> None:
    """Simulate one press and its echo, and estimate its distance from the echo.

    An option that is not given is taken from the file of settings, else from the defaults: the tube
    of the sleeve paper, pressed 4 mm deep in its middle by a 25 mm cylinder.
    """
    config = load_config(run.config, **settings_of(tool, sound))
    check_touched(config.indentation)
    run_simulation(config, run.folder("simulate"), output.reporter())


def run_simulation(config: Config, folder: Path, report: ConsoleReporter) -> Path:
    """Simulate one press, print its results and write them to a folder.

    The folder appears only when it is complete; its path is returned.

    Raises
    ------
    ConfigError
        If the folder cannot be made, or the depth is zero.
    SimulationError
        If a stage cannot finish.
    """
    from acoustube.base.netcdf import write_dataset
    from acoustube.reports.figures import run as run_figure
    from acoustube.reports.scenes import tube as tube_scene
    from acoustube.runs.simulate import simulate as simulated

    started = time.perf_counter()
    with watched_interrupts() as check:
        _print_header(config, report)
        with partial_folder(folder) as partial, ExitStack() as drawing:
            pictures: Callable[[], Mapping[str, Image] | None] = lambda: None  # noqa: E731

            def draw(walls: xr.Dataset) -> None:
                nonlocal pictures
                pictures = drawing.enter_context(tube_scene.drawing(walls))

            with report.progress(check) as show:
                dataset = simulated(config, report=show, pressed=draw)
            write_dataset(dataset, partial / "run.nc")
            write(partial / "config.toml", to_toml(config))
            images = pictures()
            figure = partial / "figure.png"
            write(figure, run_figure.picture(run_figure.figure(dataset, images), figure))
            check()
            folder = publish(partial, folder)
    _print_results(dataset, config.signals.prominence, report)
    if images is None:
        report.note("VTK cannot draw on this machine: see 'The figure' in the README")
    report.line(f"Written to {folder} in {time.perf_counter() - started:.0f} s.")
    return folder


def _print_header(config: Config, report: ConsoleReporter) -> None:
    """Print the settings of a run, and its expected cost."""
    import jax

    from acoustube.runs.config.si import settings_in_si
    from acoustube.runs.costs import simulation_cost
    from acoustube.runs.presses import press_in_words

    waves, settings = config.waves, settings_in_si(config)
    seconds, memory = simulation_cost(settings)
    where = f"{jax.devices()[0].device_kind}, float64 wall, float32 air"
    grid = f"{waves.resolution} cells across the bore"
    cost = f"about {max(seconds / 60, 0.5):.1g} min, {memory:.1f} GB"
    report.line(f"acoustube {__version__} on {where}, {grid}; {cost}")
    print_wall(config, report)
    report.line(f"press: {press_in_words(settings)}, at {config.position_cm:g} cm")
    report.line(
        f"sound: {waves.frequency_khz:g} kHz, {waves.cycles} cycles, {waves.temperature_c:g} degC, "
        f"{waves.humidity_percent:g} % humidity, {waves.pressure_kpa:g} kPa, probe at "
        f"{waves.probe_cm:g} cm, source end {waves.source_end}, losses {waves.losses}, method "
        f"{waves.method}"
    )


def _print_results(dataset: xr.Dataset, prominence: float, report: ConsoleReporter) -> None:
    """Print the results of a run: the press, the estimates, the times and the notes."""
    from rich.table import Table

    last = dataset.isel(depth=-1)
    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_row("force", f"{float(last['contact_force']):.3f} N")
    table.add_row("lumen height at the press", f"{MM * float(last['lumen_height']):.3f} mm")
    table.add_row("lumen area at the press", f"{MM2 * float(last['lumen_area']):.2f} mm2")
    table.add_row("true distance", f"{CM * float(dataset['true_distance']):.2f} cm")
    chosen = dataset["distance"].attrs["source_end"]
    for end in sorted(dataset["source_end"].values, key=lambda end: end != chosen):
        style = "bold" if end == chosen else ""
        table.add_row(
            f"estimate, {end} source end",
            _estimate(dataset.sel(source_end=end), prominence),
            style=style,
        )
    if "spectral_distance" in dataset:
        table.add_row("spectral solver", _compared(dataset.sel(source_end=chosen)))
    times = zip(dataset["stage"].values, dataset["elapsed_time"].values, strict=True)
    table.add_row("time", ", ".join(f"{stage} {seconds:.1f} s" for stage, seconds in times))
    report.console.print(table)
    report.line(f"accuracy: {dataset.attrs['accuracy']}")
    for words in dataset.attrs["warnings"].splitlines():
        report.note(words)


def _compared(case: xr.Dataset) -> str:
    """Return the difference between the spectral solver's echo and that of the run, as text."""
    apart = float(case["spectral_distance"] - case["estimated_distance"])
    if not math.isfinite(apart):
        return "no echo in one of the two, see the variables spectral_*"
    ratio = float(case["spectral_amplitude"] / case["echo_amplitude"])
    return (
        f"echo displaced by {MM * apart:+.3f} mm, height changed by {PERCENT * (ratio - 1):+.2f} % "
        f"(estimated error of its coefficients {float(case['spectral_error']):.0e})"
    )


def _estimate(case: xr.Dataset, prominence: float) -> str:
    """Return the text of the estimated distance for one boundary condition at the source end."""
    distance, true = float(case["estimated_distance"]), float(case["true_distance"])
    if not math.isfinite(distance):
        return f"no echo over {PERCENT * prominence:g} % of the send pulse"
    return (
        f"{CM * distance:.2f} cm (error {CM * (distance - true):+.2f} cm), "
        f"echo {PERCENT * float(case['echo_amplitude']):.2f} % of the send pulse"
    )
