"""Datasets: labelled cycles of a rangefinder for each case of a sweep."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from acoustube.base.checks import Several, checked
from acoustube.base.errors import ConfigError, SimulationError
from acoustube.base.files import check_out
from acoustube.base.interrupts import watched_interrupts
from acoustube.base.names import PATH
from acoustube.base.report import SILENT, Reporter, counted, time_in_words
from acoustube.base.rules import nearest
from acoustube.base.units import KHZ
from acoustube.base.version import __version__
from acoustube.base.writing import write
from acoustube.ranging import Burst, Chirp, Rangefinder, Tones
from acoustube.runs.opening import open_dataset
from acoustube.runs.sensor_file import OF_OTHERS, sensor_document
from acoustube.runs.sweep import store
from acoustube.runs.sweep.cycles import Recipe, record_cases, record_one
from acoustube.runs.sweep.plan import digest
from acoustube.runs.sweep.progress import Board
from acoustube.runs.sweep.run import run_with_progress
from acoustube.runs.sweep.workers import WORKERS, Task, Workers, count_of

RECIPE, CARD = "dataset.json", "README.md"
"""Names of the files with the recipe and with the dataset card."""
DRIVES: dict[str, type[Any]] = {"Burst": Burst, "Chirp": Chirp, "Tones": Tones}
"""Types of drive by their names in files."""
CYCLES_PER_FILE = 5000
SECONDS_PER_CASE, SECONDS_PER_CYCLE, BYTES_PER_CYCLE = 0.08, 1e-3, 2500.0
"""Estimates: computing time in s of a case and of a cycle on one idle core, bytes of a cycle."""
SECONDS_TO_START = 3.0
"""Time in s in which a worker process starts and imports the package."""
RANGES = {
    "true_distance": ("place", 1e2, "cm"), "depth": ("depth", 1e3, "mm"),
    "force": ("force", 1.0, "N"), "diameter": ("indenter", 1e3, "mm"),
    "lumen_area": ("lumen area", 1e6, "mm2"), "air_temperature": ("air", 1.0, "degC"),
    "inner_diameter": ("bore", 1e3, "mm"), "wall_thickness": ("wall", 1e3, "mm"),
    "shear_modulus": ("shear modulus", 1e-6, "MPa"), "tube_length": ("tube length", 1e2, "cm"),
    "carrier_frequency": ("carrier", 1e-3, "kHz"),
}  # fmt: skip
"""Labels whose range is on a dataset card: name, factor from SI, unit."""
CARD_TEXT = """\
# Cycles of a rangefinder on a soft acoustic waveguide

{n_cycles} simulated cycles of {n_samples} samples at {rate:g} kHz.

* presses: {n_presses} ({shapes})
* tubes: {n_tubes}
* sessions: {n_sessions}
* cycles without contact: {n_untouched}

## How it was made

acoustube {version}: each press by finite elements, its scattering of sound by finite differences or
the spectral solver, the tube's sound from both with wall losses, and the rangefinder's burst,
ring-down, amplifier, noise and ADC. Cycles of a case differ by noise, drift and reported
temperature; the seed is {seed}. Parameters of the rangefinder are in the files, the settings of
each case in the sweep.

## Ranges

| label | from | to | unit |
|---|---|---|---|
{ranges}

## How to use it

`acoustube.open_dataset(FOLDER)` opens it lazily as one `xarray.Dataset`; `signal` holds counts of
the ADC (cycle, time). Split by `tube` or `session`, not by cycle: cycles of one case are nearly
equal. Labels are exact; `temperature` is what the board reports, `air_temperature` the true value.

## What it is not

Simulated: no fabric, no bends, no scatter between specimens but that of `clutter`{clutter}.
"""


@checked(
    sweep=Several(PATH),
    out=PATH,
    recipe=Recipe,
    workers=WORKERS,
)
def run_dataset(
    sweep: Sequence[Path],
    out: Path,
    recipe: Recipe,
    *,
    report: Reporter = SILENT,
    workers: int | Workers | None = None,
    executor: Executor | None = None,
) -> Path:
    """Simulate labelled cycles of all cases of a sweep, and write them with a dataset card.

    Parameters
    ----------
    sweep : sequence of Path
        Folders of sweeps.
    out : Path
        The folder to write, or to resume.
    recipe : Recipe
    report : Reporter
        Receives messages and progress; by default nothing is shown.
    workers : int or Workers, optional
        Number of processes, by default that of the cores; or an existing pool.
    executor : concurrent.futures.Executor, optional
        Runs the tasks in place of processes of this machine.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    ConfigError
        If a folder is not that of a sweep or is damaged, the rangefinder does not suit the sweep,
        or `out` contains anything but this dataset.
    SimulationError
        If a case cannot be recorded.
    """
    started = time.perf_counter()
    parts = _parts([Path(folder) for folder in sweep], recipe)
    _check_band(parts, recipe)
    folder = _prepared(Path(out), set(parts), recipe)
    there = {name for name in parts if store.intact(folder / name) is not None}
    n_cases = sum(map(len, parts.values()))
    report.title("a dataset")
    todo = {name: cases for name, cases in parts.items() if name not in there}
    n_cycles, n_workers = n_cases * recipe.per_case, count_of(workers)
    seconds = (n_cases * SECONDS_PER_CASE + n_cycles * SECONDS_PER_CYCLE) / n_workers
    remaining = seconds * len(todo) / len(parts) + SECONDS_TO_START * bool(todo)
    report.line(
        f"{counted(n_cases, 'case')}, {counted(recipe.per_case, 'cycle')} of each, {n_cycles} in "
        "all; "
        f"{len(there)} of {len(parts)} files of the dataset are written; about "
        f"{time_in_words(remaining)} left on "
        f"{counted(n_workers, 'worker')}, {n_cycles * BYTES_PER_CYCLE / 1e6:.0f} MB in all"
    )
    if todo:
        _record(todo, folder, recipe, workers, report, executor)
    data = open_dataset(folder)
    write(folder / CARD, card(data, recipe), overwrite=True)
    elapsed = time_in_words(time.perf_counter() - started)
    report.line(f"{counted(data.sizes['cycle'], 'cycle')} written to {folder} in {elapsed}.")
    return folder


def _parts(sweep: Sequence[Path], recipe: Recipe) -> dict[str, list[tuple[str, Path]]]:
    """Return the cases of each file of the dataset: their names and the sweep's files.

    The order of the cases is that of :func:`acoustube.open_dataset`, whatever files a sweep has.
    """
    found: dict[str, Path] = {}
    for folder in sweep:
        if not (folder / store.PLAN).is_file():
            if not folder.exists():
                raise ConfigError(f"{folder} does not exist; name a folder of acoustube sweep")
            raise ConfigError(f"{folder} holds no sweep; make one with acoustube sweep")
        contents = store.contents(folder)
        if contents.damaged:
            raise ConfigError(
                f"{contents.damaged[0]} is damaged; repeat the command acoustube sweep to "
                "recompute it"
            )
        found |= contents.finished
    if not found:
        raise ConfigError(
            f"{sweep[0]} holds no finished case; run acoustube sweep until some are finished"
        )
    cases = [(str(name), found[str(name)]) for name in open_dataset(sweep)["press"].values]
    size = max(1, CYCLES_PER_FILE // recipe.per_case)
    parts = {}
    for i in range(0, len(cases), size):
        some = cases[i : i + size]
        hashed = digest([recipe.name, *(name for name, _ in some)])[:16]
        parts[f"cycles-{i // size:05d}-{hashed}.nc"] = some
    return parts


def _prepared(out: Path, names: set[str], recipe: Recipe) -> Path:
    """Return the folder of the dataset, with its recipe; raise if it holds anything else."""
    folder = out.expanduser().resolve()
    if (folder / RECIPE).is_file():
        others = sorted(path.name for path in folder.glob("cycles-*.nc") if path.name not in names)
        if others:
            raise ConfigError(
                f"holds cycles of another sweep, recipe or version ({others[0]})", setting="out",
                value=out, advice="name a new folder",
            )  # fmt: skip
    else:
        folder = check_out(out)
    folder.mkdir(parents=True, exist_ok=True)
    words = dataclasses.asdict(recipe) | {"rangefinder": None}
    if recipe.rangefinder is not None:
        words["rangefinder"] = json.loads(recipe.rangefinder.to_json())
    words |= {"acoustube_version": __version__}
    write(folder / RECIPE, json.dumps(words, indent=1) + "\n", overwrite=True)
    return folder


def _record(
    todo: dict[str, list[tuple[str, Path]]],
    folder: Path,
    recipe: Recipe,
    workers: int | Workers | None,
    report: Reporter,
    executor: Executor | None,
) -> None:
    """Compute and write the missing files, given the cases of each."""
    costs = {
        name: len(cases) * (SECONDS_PER_CASE + recipe.per_case * SECONDS_PER_CYCLE)
        for name, cases in todo.items()
    }
    totals = {"files": (len(todo), sum(costs.values()))}
    with watched_interrupts() as check, report.progress(check) as show:
        board = Board(totals, count_of(workers), show)
        tasks = [
            _task(name, cases, folder, recipe, costs[name], board) for name, cases in todo.items()
        ]
        try:
            run_with_progress(tasks, board, workers=workers, executor=executor)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                "interrupted; complete files are kept, run the same command again to go on"
            ) from None


def _task(
    name: str,
    cases: Sequence[tuple[str, Path]],
    folder: Path,
    recipe: Recipe,
    cost: float,
    board: Board,
) -> Task:
    def then(_: int) -> list[Task]:
        board.count("files", cost)
        return []

    def failed(reason: str) -> None:
        raise SimulationError(f"{name}: {reason}")

    return Task(record_cases, (cases, folder / name, recipe), then, failed, cost)


def _check_band(parts: Mapping[str, Sequence[tuple[str, Path]]], recipe: Recipe) -> None:
    """Raise if a press has no scattering matrix, or the rangefinder's band exceeds that of one."""
    first = {path: name for cases in parts.values() for name, path in cases}
    for path, name in first.items():
        if store.lacks_scattering(path):
            raise ConfigError(
                f"case {name} has no scattering matrix, since it was simulated as a whole tube; "
                "sweep with --method scattering or spectral"
            )
    alike = {store.sound_of(path): (path, name) for path, name in first.items()}
    for path, name in alike.values():
        try:
            record_one(name, path, recipe)
        except ConfigError as error:
            raise ConfigError(f"case {name} cannot be recorded: {error}") from error
        except ValueError as error:
            raise ConfigError(
                f"case {name} cannot be recorded: {error}; choose a rangefinder near the carrier "
                "of the sweep, or sweep with another --frequency"
            ) from error


def rangefinder_in(document: Mapping[str, Any], path: Path) -> Rangefinder:
    """Return the rangefinder that the content of a sensor's file describes.

    Parameters
    ----------
    document : mapping
        Content of the file; the entries :data:`acoustube.runs.sensor_file.OF_OTHERS`, which do not
        describe the rangefinder, are ignored.
    path : Path
        The file, for messages.

    Raises
    ------
    ConfigError
        If a name or a value is wrong.
    """
    given = sensor_document(document, path)
    for name in OF_OTHERS:
        given.pop(name, None)
    drive = given.pop("drive", None)
    if not isinstance(drive, dict | None):
        raise ConfigError(f"{path}: drive = {drive!r} must be a section, written [drive]")
    drive = None if drive is None else dict(drive)
    kind = "Burst" if drive is None else drive.pop("kind", "Burst")
    if not isinstance(kind, str) or kind not in DRIVES:
        raise ConfigError(
            f"{path}: kind = {kind!r} cannot be given by a file; use {' or '.join(DRIVES)}"
        )
    for names, of in ((given, Rangefinder), (drive or {}, DRIVES[kind])):
        known = [field.name for field in dataclasses.fields(of)]
        for name in names:
            if name not in known:
                words = nearest(name, [*known, *(OF_OTHERS if of is Rangefinder else ())])
                raise ConfigError(f"{path}: {name} is not a parameter{words}")
    try:
        parts: dict[str, Any] = {} if drive is None else {"drive": DRIVES[kind](**drive)}
        return Rangefinder(**given, **parts)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error


def card(data: xr.Dataset, recipe: Recipe) -> str:
    """Return the dataset card in Markdown: content, origin and ranges of labels.

    Parameters
    ----------
    data : xarray.Dataset
        From :func:`acoustube.open_dataset`.
    recipe : Recipe
    """
    n_presses, n_tubes, n_sessions = (
        len(np.unique(data[name].values)) for name in ("press", "tube", "session")
    )
    rangefinder: dict[str, Any] = json.loads(data.attrs.get("rangefinder", "{}"))
    return CARD_TEXT.format(
        n_cycles=data.sizes["cycle"], n_samples=data.sizes["time"],
        rate=KHZ * data.attrs["sampling_rate"], shapes=", ".join(np.unique(data["shape"].values)),
        n_presses=n_presses, n_tubes=n_tubes, n_sessions=n_sessions,
        n_untouched=int((data["depth"].values == 0).sum()), version=__version__, seed=recipe.seed,
        ranges="\n".join(_range_row(data, name) for name in RANGES),
        clutter=f" ({rangefinder['clutter']:g} 1/m)" if "clutter" in rangefinder else "",
    )  # fmt: skip


def _range_row(data: xr.Dataset, name: str) -> str:
    words, scale, unit = RANGES[name]
    values = scale * data[name].values
    if not np.isfinite(values).any():
        return f"| {words} | none | none | {unit} |"
    return f"| {words} | {np.nanmin(values):.4g} | {np.nanmax(values):.4g} | {unit} |"
