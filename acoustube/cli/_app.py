"""The command line: options in, one table or one sentence out.

Only light modules are imported here, so that ``--help`` and every refusal come at once; a command
imports its solvers when its settings have been accepted.
"""

from __future__ import annotations

import os
import re
import signal
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime
from math import radians
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import App, CoercionError, CycloptsError, Parameter, UnusedCliTokensError

from acoustube.base import cache
from acoustube.base.errors import ConfigError, SimulationError
from acoustube.base.files import (
    check_netcdf_name,
    check_new_file,
    check_out,
    check_surface,
    fresh_folder,
)
from acoustube.base.rules import Number
from acoustube.base.version import __version__
from acoustube.runs.config import (
    Mechanics,
    check_touched,
    describe,
    is_whole,
    load_config,
    section_of,
)
from acoustube.runs.sweep.plan import COUNT, DEFAULTS, load_plan, other_settings

app = App(
    name="acoustube",
    version=__version__,
    help="Simulate a silicone tube that carries ultrasound and feels where it is pressed.",
    default_parameter=Parameter(negative=()),
    # An interrupt must reach `main`, which says what became of the run.
    suppress_keyboard_interrupt=False,
)

SETTLED = ("simulate", "indent", "sweep")
"""Commands that take settings, of which some have no option of their own."""
HIGHEST_KHZ = 1000.0
"""Frequency above which Hz are suspected."""

app.register_install_completion_command(help="Let the shell complete commands and options.")


def whole(kind: Any, tokens: Sequence[Any]) -> int | float:  # noqa: ARG001
    """Return the whole number that a word states, exactly; 1e6 and 16.0 are whole too.

    Parameters
    ----------
    kind : type
        As cyclopts hands it on, unused.
    tokens : sequence of cyclopts.Token
        The word, with the option that it belongs to.

    Returns
    -------
    int or float
        A number that is not whole is returned as it is, for the rule of the option to refuse it
        with its range.

    Raises
    ------
    CoercionError
        If the word is not a number.
    """
    with suppress(ValueError):
        return int(tokens[0].value)
    try:
        number = float(tokens[0].value)
    except ValueError as error:
        raise CoercionError(token=tokens[0], target_type=int) from error
    return int(number) if number.is_integer() else number


Whole = Annotated[int, Parameter(converter=whole)]
"""A whole number, which would be rounded from 3.5 without a word."""


def _option(name: str) -> Parameter:
    """Return an option that is helped by the setting's own meaning, default and range."""
    converter = whole if is_whole(name) else None
    return Parameter(help=describe(name), show_default=False, converter=converter)


def _axis(name: str) -> Parameter:
    """Return an option of several values, helped by the setting's own meaning."""
    words = describe(name, DEFAULTS["waves"].get(name))
    return Parameter(help=words, show_default=False, consume_multiple=True)


@app.command
def simulate(
    *,
    indenter: Annotated[float | None, _option("indenter_mm")] = None,
    shape: Annotated[Literal["rod", "punch", "sphere"] | None, _option("shape")] = None,
    depth: Annotated[float | None, _option("depth_mm")] = None,
    position: Annotated[float | None, _option("position_cm")] = None,
    length: Annotated[float | None, _option("length_cm")] = None,
    support: Annotated[Literal["held", "free"] | None, _option("support")] = None,
    frequency: Annotated[float | None, _option("frequency_khz")] = None,
    temperature: Annotated[float | None, _option("temperature_c")] = None,
    resolution: Annotated[int | None, _option("resolution")] = None,
    source_end: Annotated[Literal["release", "absorbing"] | None, _option("source_end")] = None,
    losses: Annotated[Literal["off", "on"] | None, _option("losses")] = None,
    method: Annotated[Literal["full", "scattering"] | None, _option("method")] = None,
    config: Path | None = None,
    out: Path | None = None,
    quiet: Annotated[bool, Parameter(show_default=False)] = False,
) -> None:
    """Press the tube once, and find the press by its echo.

    An option that is not given is taken from the file, then from the defaults: the paper's tube,
    pressed 4 mm deep in its middle by a 25 mm cylinder.

    Parameters
    ----------
    config : Path
        A TOML file with settings; the options above win over it.
    out : Path
        The folder to write, which must be new or empty; simulate-1, simulate-2 and so on if not
        given.
    quiet : bool
        Print nothing but what went wrong.
    """
    settings = load_config(
        config,
        indenter_mm=indenter,
        shape=shape,
        depth_mm=depth,
        position_cm=position,
        length_cm=length,
        support=support,
        frequency_khz=frequency,
        temperature_c=temperature,
        resolution=resolution,
        source_end=source_end,
        losses=losses,
        method=method,
    )
    check_touched(settings)
    folder = check_out(out if out is not None else fresh_folder("simulate"))

    with _interrupts_held_back():
        from rich.console import Console

        from acoustube.cli.simulate import run

    run(settings, folder, Console(quiet=quiet))


@app.command
def sweep(
    *,
    indenter: Annotated[list[str] | None, _axis("indenter_mm")] = None,
    shape: Annotated[list[str] | None, _axis("shape")] = None,
    depth: Annotated[list[str] | None, _axis("depth_mm")] = None,
    position: Annotated[list[str] | None, _axis("position_cm")] = None,
    length: Annotated[list[str] | None, _axis("length_cm")] = None,
    bore: Annotated[list[str] | None, _axis("inner_diameter_mm")] = None,
    hardness: Annotated[list[str] | None, _axis("shore_a")] = None,
    support: Annotated[list[str] | None, _axis("support")] = None,
    frequency: Annotated[list[str] | None, _axis("frequency_khz")] = None,
    temperature: Annotated[list[str] | None, _axis("temperature_c")] = None,
    resolution: Annotated[list[str] | None, _axis("resolution")] = None,
    losses: Annotated[list[str] | None, _axis("losses")] = None,
    method: Annotated[list[str] | None, _axis("method")] = None,
    vary: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    random: Whole | None = None,
    sampler: Literal["sobol", "latin"] | None = None,
    seed: Whole | None = None,
    plan: Path | None = None,
    out: Path | None = None,
    workers: Whole | None = None,
    shard: str | None = None,
    dask: str | None = None,
    retry: Literal["failed"] | None = None,
    dry_run: Annotated[bool, Parameter(show_default=False)] = False,
    quiet: Annotated[bool, Parameter(show_default=False)] = False,
) -> int:
    """Press and sound a tube in many ways; what is there already is not computed again.

    Each setting takes one or more values, or ranges first:last:step with both ends; all their
    combinations are computed, or a random choice. A depth of 0 is the untouched tube.

    Parameters
    ----------
    vary : list
        Other settings, as wall_mm=1.2:2:0.2 or support=held,free.
    random : int
        Take this many cases at random; settings may then be given as a range low:high.
    sampler : str
        How a random plan fills the ranges: sobol (default) or latin.
    seed : int
        Of a random plan.
    plan : Path
        A TOML file with the plan; the options win over it.
    out : Path
        The folder to write, or to go on with.
    workers : int
        Processes; as many as there are cores if not given.
    shard : str
        Compute one of several equal shares, as 3/40, for job arrays; all write to one folder.
    dask : str
        Address of the scheduler of a running Dask cluster, in place of processes.
    retry : str
        Try failed cases again.
    dry_run : bool
        Print cases, what is shared and remembered, and the expected costs, and end.
    quiet : bool
        Print nothing but what went wrong.
    """
    given = {
        "indenter_mm": indenter, "shape": shape, "depth_mm": depth, "position_cm": position,
        "length_cm": length, "inner_diameter_mm": bore, "shore_a": hardness, "support": support,
        "frequency_khz": frequency, "temperature_c": temperature, "resolution": resolution,
        "losses": losses, "method": method,
    }  # fmt: skip
    over = {name: words for name, words in given.items() if words is not None}
    over |= other_settings(vary or [], over)
    processes = _processes(workers)
    if random is not None:
        COUNT.check("random", random)
    wanted = load_plan(plan, over, count=random, sampler=sampler, seed=seed)
    share = _share(shard)
    if out is None and not dry_run:
        raise ConfigError("out is missing; name the folder to write, or give --dry-run")

    with _interrupts_held_back():
        from rich.console import Console

        from acoustube.base.console import ConsoleReporter
        from acoustube.cli import sweep as cli_sweep
        from acoustube.runs.sweep import run as sweep_run
        from acoustube.runs.sweep import workers as sweep_workers

    console = Console(quiet=quiet)
    if dry_run or out is None:
        cli_sweep.dry_run(wanted, out, processes, console, share=share, retry=retry is not None)
        return 0
    executor, width = sweep_workers.dask_executor(dask) if dask is not None else (None, None)
    try:
        complete = sweep_run.run_sweep(
            wanted, out, report=ConsoleReporter(console), workers=processes, executor=executor,
            width=width, share=share, retry=retry is not None,
        )  # fmt: skip
    finally:
        if executor is not None:
            executor.shutdown(wait=False)
    return 0 if complete else 1


@app.command
def dataset(
    *sweep: Path,
    cycles: Whole = 50,
    tubes: Whole = 1,
    sessions: Whole = 1,
    seed: Whole = 0,
    rangefinder: Path | None = None,
    out: Path,
    workers: Whole | None = None,
    quiet: Annotated[bool, Parameter(show_default=False)] = False,
) -> None:
    """Record labelled cycles of a rangefinder for each case of a sweep, for training.

    Parameters
    ----------
    sweep : Path
        Folders that ``acoustube sweep`` wrote.
    cycles : int
        Of each case, in each session.
    tubes : int
        Specimens of each tube, each with irregularities of its own.
    sessions : int
        Of each specimen, each with drift and errors of temperature of its own.
    seed : int
        Of all random numbers; each cycle has its own, whatever the number of workers.
    rangefinder : Path
        A TOML file with its parameters; the paper's, at the case's carrier, if not given.
    out : Path
        The folder to write, or to go on with.
    workers : int
        Processes; as many as there are cores if not given.
    quiet : bool
        Print nothing but what went wrong.
    """
    processes = _processes(workers)
    if not sweep:
        raise ConfigError("dataset needs the folder of a sweep; name one or more")
    numbers = {"cycles": cycles, "tubes": tubes, "sessions": sessions}
    counts = {
        name: int(Number(1, 1_000_000, "", "how many", whole=True).check(name, value))
        for name, value in numbers.items()
    }
    seeds = Number(0, 2**63 - 1, "", "seed", whole=True)
    seed = int(seeds.check("seed", seed))

    with _interrupts_held_back():
        from rich.console import Console

        from acoustube.base.console import ConsoleReporter
        from acoustube.runs.sweep.cycles import Recipe
        from acoustube.runs.sweep.dataset import read_rangefinder, run_dataset

    recipe = Recipe(
        n_cycles=counts["cycles"], n_tubes=counts["tubes"], n_sessions=counts["sessions"],
        seed=seed, rangefinder=None if rangefinder is None else read_rangefinder(rangefinder),
    )  # fmt: skip
    run_dataset(sweep, out, recipe, report=ConsoleReporter(Console(quiet=quiet)), workers=processes)


@app.command
def show(
    results: Path,
    /,
    *,
    out: Path | None = None,
    html: Path | None = None,
    quiet: Annotated[bool, Parameter(show_default=False)] = False,
) -> None:
    """Draw results: a sweep as a figure, or any run as a page to turn and move.

    The figure has force, echo and error over depth, and the echoes. The page is one file that opens
    in any browser, without a network: a slider over the depth moves the tube, its section, the
    lumen's area, the signal and the reflection.

    Parameters
    ----------
    results : Path
        A folder that ``acoustube sweep`` wrote; for a page also of ``simulate`` or ``indent``.
    out : Path
        The picture to write (PNG, PDF or SVG), which must be new.
    html : Path
        The page to write, which must be new; needs ``pip install 'acoustube[page]'``.
    quiet : bool
        Print nothing but what went wrong.
    """
    if out is None and html is None:
        raise ConfigError("There is nothing to write; give --html FILE, --out FILE or both")
    if out is not None:
        check_new_file(out)
        _check_picture(out, "out")
    if html is not None:
        check_new_file(html, "html")
        if html.suffix.lower() not in (".html", ".htm"):
            raise ConfigError(f"html = {html} must end in .html")

    with _interrupts_held_back():
        from rich.console import Console

        from acoustube.cli.show import run_page, run_show

    console = Console(quiet=quiet)
    if html is not None:
        run_page(results, html, console)
    if out is not None:
        run_show(results, out, console)


@app.command
def export(
    results: Path,
    /,
    *,
    kind: Annotated[
        Literal["wav", "csv", "stl", "vtp", "vtu", "lerobot"] | None, Parameter(name="--format")
    ] = None,
    out: Path,
    quiet: Annotated[bool, Parameter(show_default=False)] = False,
) -> None:
    """Write results in the files that other programs read.

    Parameters
    ----------
    results : Path
        A folder that ``simulate``, ``indent``, ``sweep`` or ``dataset`` wrote, or a file that
        ``scatter`` wrote.
    kind : str
        Of datasets wav (with a Parquet table; the default), csv (labels) or lerobot (episodes as
        robot learners keep them); of simulate and indent stl (the lumen, at each depth; the
        default), vtp (the same), vtu (the mesh at each depth) or csv; of sweeps csv (the default),
        stl or vtp; of scatter csv.
    out : Path
        The folder to write, which must be new or empty.
    quiet : bool
        Print nothing but what went wrong.
    """
    check_out(out)

    with _interrupts_held_back():
        from rich.console import Console

        from acoustube.cli.export import run_export

    run_export(results, out, Console(quiet=quiet), wanted=kind)


def _processes(workers: int | None) -> int | None:
    """Return a number of worker processes; None for as many as there are cores."""
    if workers is None:
        return None
    return int(Number(1, 1024, "", "processes", whole=True).check("workers", workers))


def _share(shard: str | None) -> tuple[int, int]:
    """Return number and count of a share such as 3/40."""
    if shard is None:
        return 1, 1
    found = re.fullmatch(r"(\d{1,6})/(\d{1,6})", shard)
    number, count = (int(found[1]), int(found[2])) if found else (0, 0)
    if not 1 <= number <= count:
        raise ConfigError(
            f"shard = {shard} is no share; write NUMBER/COUNT, from 1/COUNT on, such as 3/40"
        )
    return number, count


@app.command
def indent(
    *,
    indenter: Annotated[float | None, _option("indenter_mm")] = None,
    shape: Annotated[Literal["rod", "punch", "sphere"] | None, _option("shape")] = None,
    depth: Annotated[float | None, _option("depth_mm")] = None,
    steps: Annotated[int | None, _option("steps")] = None,
    offset: Annotated[float | None, _option("offset_mm")] = None,
    yaw: Annotated[float | None, _option("yaw_deg")] = None,
    support: Annotated[Literal["held", "free"] | None, _option("support")] = None,
    tube: Annotated[str | None, _option("surface")] = None,
    config: Path | None = None,
    out: Path | None = None,
    quiet: Annotated[bool, Parameter(show_default=False)] = False,
) -> None:
    """Press the tube alone, up to a closed lumen: force, lumen and mesh at each depth.

    An option that is not given is taken from the file, then from the defaults: the paper's tube,
    pressed 4 mm deep by a 25 mm cylinder.

    Parameters
    ----------
    config : Path
        A TOML file with settings; the options above win over it.
    out : Path
        The folder to write, which must be new or empty; indent-1, indent-2 and so on if not given.
    quiet : bool
        Print nothing but what went wrong.
    """
    settings = load_config(
        config,
        Mechanics,
        indenter_mm=indenter,
        shape=shape,
        depth_mm=depth,
        steps=steps,
        offset_mm=offset,
        yaw_deg=yaw,
        support=support,
        surface=tube,
    )
    if settings.tube.surface is not None:
        check_surface(settings.tube.surface)
    folder = check_out(out if out is not None else fresh_folder("indent"))

    with _interrupts_held_back():
        from rich.console import Console

        from acoustube.cli.indent import run_press

    run_press(settings, folder, Console(quiet=quiet))


@app.command
def scatter(
    lumen: Path,
    /,
    *,
    band: tuple[float, float] = (5.0, 60.0),
    step: float = 0.1,
    temperature: float = 20.0,
    humidity: float = 50.0,
    pressure: float = 101.325,
    lossless: Annotated[bool, Parameter(show_default=False)] = False,
    resolution: Whole = 32,
    out: Path,
    quiet: Annotated[bool, Parameter(show_default=False)] = False,
) -> None:
    """Compute how a lumen scatters the modes of its straight ends, over a band.

    Parameters
    ----------
    lumen : Path
        The air space as a closed surface in mm along z (STL, PLY, OBJ, VTP), with two straight
        ends of the same section.
    band : tuple of float
        Lowest and highest frequency in kHz.
    step : float
        Between two frequencies, in kHz.
    temperature : float
        Of the air, in degC.
    humidity : float
        Of the air, relative, in per cent.
    pressure : float
        Of the air, in kPa.
    lossless : bool
        Leave out the losses at the wall and in the air.
    resolution : int
        Grid cells across the ends.
    out : Path
        The file to write, which must be new.
    quiet : bool
        Print nothing but what went wrong.
    """
    check_surface(lumen)
    check_new_file(out)
    check_netcdf_name(out)
    low, high = band
    if high > HIGHEST_KHZ:
        raise ConfigError(
            f"band = {low:g} {high:g} kHz goes beyond {HIGHEST_KHZ:g} kHz; give it in kHz, such as "
            "5 60"
        )
    if not 0 < low < high:
        raise ConfigError(f"band = {low:g} {high:g} kHz must rise from over 0")
    count = (high - low) / step if step > 0 else 0.0
    if not (0.999 < count < 5000 and abs(count - round(count)) < 1e-6 * count):
        raise ConfigError(
            f"step = {step:g} kHz must divide the band of {high - low:g} kHz into 1 to 5000 whole "
            f"parts; use {(high - low) / max(1, round(min(count, 5000))):.6g}"
        )
    for name, value, rule in (
        ("temperature", temperature, Number(-20, 60, "degC", "of the air")),
        ("humidity", humidity, Number(0, 100, "%", "of the air")),
        ("pressure", pressure, Number(10, 200, "kPa", "of the air")),
    ):
        rule.check(name, value)
    cells = Number(8, 128, "", "grid cells across the ends", whole=True)
    across = int(cells.check("resolution", resolution))

    with _interrupts_held_back():
        from rich.console import Console

        from acoustube.cli.scatter import run_scatter

    run_scatter(
        lumen,
        out,
        Console(quiet=quiet),
        band_khz=band,
        step_khz=step,
        temperature=temperature,
        humidity=humidity,
        pressure_kpa=pressure,
        lossy=not lossless,
        resolution=across,
    )


@app.command
def process(
    *files: Path,
    calibration: str | None = None,
    prominence: float | None = None,
    rate: float | None = None,
    temperature: float | None = None,
    channel: Whole | None = None,
    samples: Whole | None = None,
    out: Path | None = None,
    figure: Path | None = None,
    quiet: Annotated[bool, Parameter(show_default=False)] = False,
) -> int:
    """Find the distance of a press in each cycle of recordings.

    Parameters
    ----------
    files : Path
        NPZ, NPY, CSV, TSV, WAV, FLAC, MAT, HDF5 or netCDF, or folders of these.
    calibration : str
        A file that ``calibrate`` wrote, or the name of a calibration.
    prominence : float
        Least prominence of an echo, as a share of the send pulse, in place of the calibration's.
    rate : float
        Samples per second, in place of the files' own.
    temperature : float
        Of the air in degC, in place of the files' own.
    channel : int
        Of several, counted from 0.
    samples : int
        Samples of a cycle, where a file is one long record.
    out : Path
        The table to write (CSV), which must be new; standard output if not given.
    figure : Path
        A new picture (PNG, PDF or SVG): the first cycle with an echo, and a waterfall around it.
    quiet : bool
        Print nothing but the table and what went wrong.
    """
    if not files:
        raise ConfigError("process needs a file or a folder; name one or more")
    if prominence is not None:
        Number(1e-6, 1, "", "share of the send pulse").check("prominence", prominence)
    _check_files(out=out, figure=figure)

    with _interrupts_held_back():
        from rich.console import Console

        from acoustube.cli.process import run_process

    complete = run_process(
        files,
        out,
        Console(stderr=out is None, quiet=quiet),
        calibration=calibration,
        prominence=prominence,
        rate=rate,
        temperature=temperature,
        channel=_whole("channel", channel, Number(0, 1e6, "", "counts from 0", whole=True)),
        samples=_whole("samples", samples, Number(2, 1e12, "", "of a cycle", whole=True)),
        figure=figure,
    )
    return 0 if complete else 1


@app.command
def live(
    *,
    port: str,
    calibration: str | None = None,
    prominence: float | None = None,
    temperature: float = 20.0,
    rate: float = 80e3,
    frame_bytes: Whole = 2000,
    baud: Whole = 1_000_000,
    out: Path | None = None,
    duration: float | None = None,
    quiet: Annotated[bool, Parameter(show_default=False)] = False,
) -> None:
    """Find the distance of a press in each cycle that an EchoTube board sends, as it comes.

    Ends with the line, after the duration, or with an interrupt.

    Parameters
    ----------
    port : str
        The serial port, such as /dev/ttyACM0.
    calibration : str
        A file that ``calibrate`` wrote, or the name of a calibration.
    prominence : float
        Least prominence of an echo, as a share of the send pulse, in place of the calibration's.
    temperature : float
        Of the air, in degC.
    rate : float
        Samples per second.
    frame_bytes : int
        Bytes of a frame, the two of the pulse width included.
    baud : int
        Bits per second of the line.
    out : Path
        The table to write (CSV), which must be new; a row is on the disk with its cycle.
    duration : float
        In s; without it until the line ends or an interrupt.
    quiet : bool
        Print nothing but what went wrong.
    """
    if prominence is not None:
        Number(1e-6, 1, "", "share of the send pulse").check("prominence", prominence)
    Number(-40, 85, "degC", "of the air").check("temperature", temperature)
    Number(1e3, 1e8, "Hz", "samples per second").check("rate", rate)
    if duration is not None:
        Number(0, 1e9, "s", "how long to listen").check("duration", duration)
    n_bytes = Number(12, 1_000_000, "", "bytes of a frame", whole=True)
    bits = Number(300, 100_000_000, "", "bits per second of the line", whole=True)
    n_bytes.check("frame-bytes", frame_bytes)
    bits.check("baud", baud)
    if out is not None:
        check_new_file(out)

    with _interrupts_held_back():
        from rich.console import Console

        from acoustube.cli.live import run_live

    run_live(
        port,
        Console(quiet=quiet),
        calibration=calibration,
        prominence=prominence,
        temperature=temperature,
        rate=rate,
        frame_bytes=frame_bytes,
        baud=baud,
        out=out,
        duration=duration,
    )


@app.command
def calibrate(
    *blocked: Path,
    untouched: Annotated[list[Path], Parameter(consume_multiple=True)],
    out: Path | None = None,
    name: str | None = None,
    sigmas: float = 2.8,
    rate: float | None = None,
    temperature: float | None = None,
    channel: Whole | None = None,
    samples: Whole | None = None,
    figure: Path | None = None,
) -> None:
    """Calibrate a sensor from cycles with the tube closed at known places, and without contact.

    Parameters
    ----------
    blocked : Path
        Recordings with the label ``true_distance`` (or ``distance_cm``, ``distance_m``).
    untouched : list
        Recordings without contact.
    out : Path
        The file to write, which must be new.
    name : str
        In place of a file: ``process --calibration NAME`` finds it.
    sigmas : float
        Least prominence of an echo, in standard deviations of the untouched cycles.
    rate : float
        Samples per second, in place of the files' own.
    temperature : float
        Of the air in degC, in place of the files' own.
    channel : int
        Of several, counted from 0.
    samples : int
        Samples of a cycle, where a file is one long record.
    figure : Path
        A new picture (PNG, PDF or SVG) of the fits.
    """
    if not blocked:
        raise ConfigError("calibrate needs recordings with the tube closed; name one or more")
    if name is not None and not re.fullmatch(r"[\w-]{1,64}", name):
        raise ConfigError(
            f"name = {name} must be of letters, digits, - and _; use --out for a path"
        )
    Number(0.1, 100, "", "standard deviations").check("sigmas", sigmas)
    _check_files(out=out, figure=figure)

    with _interrupts_held_back():
        from rich.console import Console

        from acoustube.cli.calibrate import run_calibrate

    run_calibrate(
        blocked,
        untouched,
        Console(),
        out=out,
        name=name,
        sigmas=sigmas,
        rate=rate,
        temperature=temperature,
        channel=_whole("channel", channel, Number(0, 1e6, "", "counts from 0", whole=True)),
        samples=_whole("samples", samples, Number(2, 1e12, "", "of a cycle", whole=True)),
        figure=figure,
    )


@app.command
def train(
    *data: Path,
    estimator: Literal["network", "echo", "boosting"],
    out: Path,
    by: Literal["cycle", "session", "tube"] = "cycle",
    calibration: str | None = None,
    prominence: float | None = None,
    epochs: Whole | None = None,
    folds: Whole | None = None,
    seed: Whole = 0,
    quiet: Annotated[bool, Parameter(show_default=False)] = False,
) -> None:
    """Train an estimator of presses on labelled cycles.

    Parameters
    ----------
    data : Path
        Files with cycles and the labels ``true_distance``, ``depth`` and ``force``, as far as
        known, or folders of these.
    estimator : str
        The paper's force network; networks that use the whole echo to tell distance, depth and
        force; or gradient boosting of the same.
    out : Path
        The model to write, which must be new.
    by : str
        What is held out together, to weight the folds and to state uncertainties: single cycles, as
        in the paper, sessions (files, where they do not tell), or tubes.
    calibration : str
        A file that ``calibrate`` wrote, or the name of a calibration.
    prominence : float
        Least prominence of an echo, as a share of the send pulse, in place of the calibration's.
    epochs : int
        Of the networks, 100 for ``network`` and 25 for ``echo`` if not given; the trees of
        ``boosting``, 150.
    folds : int
        10, or 5 for ``boosting``, if not given.
    seed : int
        Of folds, initial weights and order.
    quiet : bool
        Print nothing but what went wrong.
    """
    if not data:
        raise ConfigError("train needs a file or a folder; name one or more")
    if prominence is not None:
        Number(1e-6, 1, "", "share of the send pulse").check("prominence", prominence)
    counts = {
        "epochs": (epochs, Number(1, 100_000, "", "passes over the cycles", whole=True)),
        "folds": (folds, Number(2, 100, "", "parts of the cycles", whole=True)),
        "seed": (seed, Number(0, 2**32 - 1, "", "of random numbers", whole=True)),
    }
    whole = {
        name: None if value is None else int(rule.check(name, value))
        for name, (value, rule) in counts.items()
    }
    check_new_file(out)

    with _interrupts_held_back():
        from rich.console import Console

        from acoustube.cli.train import run_train

    run_train(
        data,
        out,
        Console(quiet=quiet),
        name=estimator,
        by=by,
        calibration=calibration,
        prominence=prominence,
        epochs=whole["epochs"],
        folds=whole["folds"],
        seed=whole["seed"] or 0,
    )


@app.command
def evaluate(
    model: Path,
    *data: Path,
    out: Path | None = None,
    figure: Path | None = None,
    quiet: Annotated[bool, Parameter(show_default=False)] = False,
) -> None:
    """Set an estimator's presses beside the labels of cycles: errors, and whether intervals hold.

    Parameters
    ----------
    model : Path
        A file that ``train`` wrote.
    data : Path
        Files with cycles and labels, or folders of these; not those that it was trained on.
    out : Path
        A table (CSV) of the errors, by depth and by distance too, which must be new.
    figure : Path
        A new picture (PNG, PDF or SVG) of estimates and errors.
    quiet : bool
        Print nothing but what went wrong.
    """
    if not data:
        raise ConfigError("evaluate needs a file or a folder; name one or more")
    if not model.is_file():
        what = "is a folder" if model.is_dir() else "does not exist"
        raise ConfigError(f"{model} {what}; give the name of a model: train writes one")
    _check_files(out=out, figure=figure)

    with _interrupts_held_back():
        from rich.console import Console

        from acoustube.cli.evaluate import run_evaluate

    run_evaluate(model, data, Console(quiet=quiet), out=out, figure=figure)


@app.command
def reproduce(
    *study: Literal["simulation", "calibration", "flat", "mannequin", "human", "echotube", "all"],
    out: Path = Path("studies"),
    quick: Annotated[bool, Parameter(show_default=False)] = False,
    workers: Whole | None = None,
    quiet: Annotated[bool, Parameter(show_default=False)] = False,
) -> None:
    """Repeat the paper's studies: a page and a table with each published number beside ours.

    Parameters
    ----------
    study : str
        The simulations of Fig. 2, the calibration of Fig. 3, the flat table of Figs. 4 and 5 and of
        Tables I and II, the sleeve on a mannequin's and on a human arm of Figs. 6 and 7, EchoTube's
        reach by bore, or all.
    out : Path
        The folder to write; one that was begun by this command is finished.
    quick : bool
        A few presses on a coarse grid, to see that all works; the numbers mean little.
    workers : int
        Processes; as many as there are cores if not given.
    quiet : bool
        Print nothing but what went wrong.
    """
    processes = _processes(workers)
    if not study:
        raise ConfigError("reproduce needs the name of a study, or all")

    with _interrupts_held_back():
        from rich.console import Console

        from acoustube.cli.reproduce import STUDIES, run_reproduce
        from acoustube.reports.studies.report import Scale

    names = list(STUDIES) if "all" in study else [name for name in STUDIES if name in study]
    scale = Scale(quick=quick, workers=processes)
    run_reproduce(names, out, scale, Console(quiet=quiet))


@app.command
def sleeve(
    markers: Path | None = None,
    /,
    *,
    forearm: tuple[float, float, float] | None = None,
    loops: float | None = None,
    pitch: float | None = None,
    tubes: Whole = 2,
    phase: float = 0.0,
    hand: Literal["right", "left"] = "right",
    lead: float = 15.0,
    dead_zone: float = 15.0,
    reach: float = 250.0,
    tube_diameter: float = 11.1,
    distance: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    deviation: float = 5.0,
    within: float = 10.0,
    step: float = 1.0,
    axis: Literal["fitted", "z"] = "fitted",
    unit: Literal["mm", "cm", "m"] | None = None,
    columns: tuple[str, str] | None = None,
    out: Path | None = None,
    quiet: Annotated[bool, Parameter(show_default=False)] = False,
) -> None:
    """Lay out a sleeve: from a distance along a wrapped tube to a place on the arm.

    Parameters
    ----------
    markers : Path
        Two columns of markers along the arm: a table with the columns column, x_mm, y_mm, z_mm, or
        a C3D file.
    forearm : tuple
        In place of markers: length of the sleeve, and girth of the arm at the end near the
        sensors and at the other, in cm.
    loops : float
        Turns of each tube over the sleeve.
    pitch : float
        In place of loops: advance per turn in cm.
    tubes : int
        Side by side, 1 to 8.
    phase : float
        Angle at which the first tube starts, from the first column of markers, in degrees.
    hand : str
        Of the helix.
    lead : float
        Tube between sensor and sleeve, in cm.
    dead_zone : float
        Distance from the sensor within which nothing is heard, in cm.
    reach : float
        Farthest distance from the sensor that is heard, in cm.
    tube_diameter : float
        Outer diameter of the tube in mm.
    distance : list
        Contacts to mark, in cm from the sensor; 2:80 is on the second tube.
    deviation : float
        Standard deviation of a distance, in cm.
    within : float
        Half width of the skin that counts as covered by a tube, in mm.
    step : float
        Between two rows of the table, in cm.
    axis : str
        Of the arm: fitted midway between opposite columns, or the z of the markers.
    unit : str
        Of the markers, in place of the file's own; mm if nothing tells.
    columns : tuple of str
        Names of the two columns, where the file has more.
    out : Path
        The folder to write, which must be new or empty; sleeve-1, sleeve-2 and so on if not given.
    quiet : bool
        Print nothing but what went wrong.
    """
    if (markers is None) == (forearm is None):
        raise ConfigError("sleeve needs a file of markers, or --forearm 25 17 26; give one of them")
    if (loops is None) == (pitch is None):
        raise ConfigError("sleeve needs --loops 9, say, or --pitch in cm; give one of them")
    length, first, second = forearm or (None, None, None)
    for name, value, rule in (
        ("loops", loops, Number(0.25, 100, "", "turns of each tube")),
        ("pitch", pitch, Number(0.5, 100, "cm", "advance per turn")),
        ("length of the forearm", length, Number(3, 150, "cm", "under the sleeve")),
        ("first girth of the forearm", first, Number(8, 150, "cm", "near the sensors")),
        ("second girth of the forearm", second, Number(8, 150, "cm", "at the other end")),
        ("tubes", tubes, Number(1, 8, "", "side by side", whole=True)),
        ("phase", phase, Number(-360, 360, "degrees", "where the first tube starts")),
        ("lead", lead, Number(0, 1000, "cm", "tube between sensor and sleeve")),
        ("dead-zone", dead_zone, Number(0, 200, "cm", "within which nothing is heard")),
        ("reach", reach, Number(10, 2000, "cm", "farthest distance that is heard")),
        ("tube-diameter", tube_diameter, Number(1, 50, "mm", "outer")),
        ("deviation", deviation, Number(0.01, 100, "cm", "of a distance")),
        ("within", within, Number(1, 100, "mm", "half width of the covered skin")),
        ("step", step, Number(0.05, 50, "cm", "between rows")),
    ):
        if value is not None:
            rule.check(name, value)
    if markers is not None and not markers.is_file():
        raise ConfigError(f"{markers} is not a file; give a table or C3D file of markers")
    folder = check_out(out if out is not None else fresh_folder("sleeve"))

    with _interrupts_held_back():
        from rich.console import Console

        from acoustube.cli.sleeve import Plan, contacts_of, run_sleeve

    plan = Plan(
        markers=markers,
        forearm=None if forearm is None else (forearm[0] / 100, forearm[1] / 100, forearm[2] / 100),
        loops=loops,
        pitch=None if pitch is None else pitch / 100,
        tubes=tubes,
        phase=radians(phase),
        hand=hand,
        axis=axis,
        lead=lead / 100,
        dead_zone=dead_zone / 100,
        reach=reach / 100,
        outer_diameter=tube_diameter / 1000,
        deviation=deviation / 100,
        within=within / 1000,
        step=step / 100,
        contacts=contacts_of(distance or []),
        unit=unit,
        columns=columns,
    )
    run_sleeve(plan, folder, Console(quiet=quiet))


def _whole(name: str, value: int | None, rule: Number) -> int | None:
    """Return a whole number, or None where it is not given."""
    return None if value is None else int(rule.check(name, value))


def _check_files(**files: Path | None) -> None:
    """Refuse files that cannot be written, before anything is computed."""
    for name, path in files.items():
        if path is not None:
            check_new_file(path, name)
            if name == "figure":
                _check_picture(path, name)


def _check_picture(picture: Path, name: str) -> None:
    """Refuse a picture of a kind that cannot be drawn."""
    kinds = (".png", ".pdf", ".svg")
    if picture.suffix.lower() not in kinds:
        raise ConfigError(f"{name} = {picture} must end in one of {', '.join(kinds)}")


@app.command
def check(
    *,
    json: Annotated[bool, Parameter(show_default=False)] = False,
    quiet: Annotated[bool, Parameter(show_default=False)] = False,
) -> None:
    """Tell what is installed and what there is to compute on, and test what it computes.

    Ends with exit code 1 if a test failed.

    Parameters
    ----------
    json : bool
        Print one JSON object instead of a table.
    quiet : bool
        Print nothing but what went wrong.
    """
    with _interrupts_held_back():
        from rich.console import Console

        from acoustube.cli.check import run_check

    run_check(Console(quiet=quiet), as_json=json)


@app.command
def cite(
    result: Path | None = None,
    /,
    *,
    bibtex: Annotated[bool, Parameter(show_default=False)] = False,
) -> None:
    """List what a publication should cite: the program, and where its methods come from.

    Parameters
    ----------
    result : Path
        What a command wrote: list those methods alone that it used. A folder of simulate, indent,
        sweep, dataset or sleeve, or a file of scatter or train.
    bibtex : bool
        Print BibTeX entries.
    """
    if result is not None and not result.exists():
        raise ConfigError(f"{result} does not exist; name what a command wrote, or nothing")

    from acoustube.cli.cite import run_cite

    run_cite(result, bibtex=bibtex)


remembered = App(name="cache", help="Presses and scattering that need not be computed again.")
app.command(remembered)


@remembered.command(name="list")
def list_cache() -> None:
    """List what is remembered, the newest first."""
    for entry in cache.entries():
        written = datetime.fromtimestamp(entry.modified).strftime("%Y-%m-%d %H:%M")
        print(f"{written}  {entry.size / 1e6:6.1f} MB  {entry.label}")


@remembered.command(name="size")
def cache_size() -> None:
    """Print the number of results, their size and folder, and the size of JAX's compiled code."""
    found, code = cache.entries(), cache.compiled()
    print(f"{_results(len(found))}, {_megabytes(found)} in {cache.folder()}")
    print(f"compiled code, {_megabytes(code)}")


@remembered.command(name="clear")
def clear_cache() -> None:
    """Forget all of it, and JAX's compiled code."""
    code = cache.compiled()
    gone = cache.clear()
    print(f"{_results(len(gone))} forgotten, {_megabytes([*gone, *code])} freed")


def _megabytes(entries: list[cache.Entry]) -> str:
    return f"{sum(entry.size for entry in entries) / 1e6:.1f} MB"


def _results(count: int) -> str:
    return f"{count} result" if count == 1 else f"{count} results"


@contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """Let an interrupt wait: inside an extension that is being loaded it becomes an ImportError."""
    pending: list[int] = []
    numbers = [
        number
        for number in (signal.SIGINT, signal.SIGTERM)
        if signal.getsignal(number) is signal.default_int_handler  # not one that is ignored
    ]
    for number in numbers:
        signal.signal(number, lambda number, _frame: pending.append(number))
    try:
        yield
    finally:
        for number in numbers:
            signal.signal(number, signal.default_int_handler)
    if pending:
        raise KeyboardInterrupt


def main(tokens: Sequence[str] | None = None) -> int:
    """Run a command.

    Parameters
    ----------
    tokens : sequence of str, optional
        The words after ``acoustube``; those of the shell by default.

    Returns
    -------
    int
        Exit code: 0 done, 1 a stage failed, 2 wrong usage, 130 interrupted.
    """
    try:
        code = app(tokens, exit_on_error=False, print_error=False, result_action="return_value")
        sys.stdout.flush()
    except CycloptsError as error:
        return _refuse(_in_one_sentence(error), 2)
    except ConfigError as error:
        return _refuse(str(error), 2)
    except BrokenPipeError:  # whoever reads, such as head, has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (SimulationError, OSError) as error:
        return _refuse(str(error), 1)
    except KeyboardInterrupt as error:
        return _refuse(str(error) or "interrupted; no incomplete run is left", 130)
    return code if isinstance(code, int) else 0


def _in_one_sentence(error: CycloptsError) -> str:
    """Return what is wrong with the command's words, and what to do."""
    command = " ".join(["acoustube", *(error.command_chain or ())])
    if isinstance(error, UnusedCliTokensError):
        surplus = error.unused_tokens or ()
        count = "is one word" if len(surplus) == 1 else f"are {len(surplus)} words"
        return f'"{" ".join(surplus)}" {count} too many; {command} --help tells what it takes'
    # Several sentences are joined into one.
    words = re.sub(r"[.?] ([A-Z])", lambda m: f"; {m[1].lower()}", " ".join(str(error).split()))
    words = re.sub(r"(?<!\.)\.$", "", words)
    given = r'^Command "(.*)" parameter (\S+) requires '
    words = re.sub(f"{given}an argument", r"\1 needs \2 and its value", words)
    words = re.sub(rf"{given}(\d+) positional arguments", r"\1 \2 needs \3 values", words)
    option = re.match(r"Unknown option: --([a-z-]+)", words)
    if option and command.split()[-1] in SETTLED:
        name = option[1].replace("-", "_")
        with suppress(ConfigError):
            file = f"--config FILE with {name} in [{section_of(name)}]"
            how = f"--vary {name}=VALUE" if command.endswith("sweep") else file
            return f"--{option[1]} is no option, but {name} is a setting; give {how}"
    if "did you mean" in words or "choose from" in words:
        return words
    if isinstance(error, CoercionError):
        words = re.sub(r'unable to convert (".*") into (float|int)', r"\1 is not a number", words)
        return f"{words}; give a number without a unit"
    return f"{words}; {command} --help tells what it takes"


def _refuse(message: str, code: int) -> int:
    """Print one line on standard error and return the exit code."""
    print(f"acoustube: {' '.join(message.split())}", file=sys.stderr)
    return code
