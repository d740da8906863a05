"""The command ``acoustube check``: versions, hardware, optional packages, and a self-test."""

from __future__ import annotations

import os
import platform
import re
import shutil
import subprocess
import sys
import time
from json import dumps
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from acoustube.base import cache
from acoustube.base.console import plain_console
from acoustube.base.errors import SimulationError
from acoustube.base.remnants import remnants
from acoustube.base.version import __version__
from acoustube.cli._options import FLAG, Output

if TYPE_CHECKING:
    from rich.console import Console

    from acoustube.runs.selftest import Outcome

PACKAGES = (
    "numpy", "scipy", "jax", "numba", "xarray", "h5netcdf", "ipctk", "pytetwild", "trimesh",
    "pyvista", "vtk", "matplotlib", "plotly", "scikit-learn", "cyclopts",
)  # fmt: skip
"""Packages whose versions affect results, or belong in a report of a problem."""
PURPOSES = {
    "audio": "reads FLAC files",
    "c3d": "reads markers of motion capture",
    "dask": "runs sweeps on a cluster",
    "parquet": "writes Parquet tables",
    "pardiso": "factorises large meshes faster",
    "robot": "runs `acoustube.sensor.environment` and the gallery's robot arm",
    "serial": "reads the board of `acoustube live`",
}
"""Purpose of each optional extra, by name: the end of a sentence."""
FOR_OTHERS = ("test", "docs")
"""Extras for the development of acoustube, which are not reported."""
DRAWING = """\
import pyvista
plotter = pyvista.Plotter(off_screen=True, window_size=[64, 64])
plotter.add_mesh(pyvista.Sphere())
assert plotter.screenshot(return_img=True).std() > 1
"""
"""Python program that fails unless VTK can draw off screen."""
DRAWING_SECONDS = 120.0
"""Time limit of `DRAWING` in s."""
HELP_WITH_CACHE = (
    "it cannot be written, so that nothing is cached: set ACOUSTUBE_CACHE to a writable folder"
)
HELP_WITH_DRAWING = (
    "the two pictures of the tube will be missing from figures; on Debian and Ubuntu: "
    "apt-get install libegl1 libgl1-mesa-dri libx11-6"
)


class Extra(NamedTuple):
    """An optional part of the installation, and the command that installs it."""

    name: str
    purpose: str
    present: bool
    install: str


def check(*, json: Annotated[bool, FLAG] = False, output: Output = Output()) -> None:
    """Report versions, hardware and optional packages, and run a self-test.

    Ends with exit code 1 if a test failed.

    Parameters
    ----------
    json : bool
        Print a JSON object instead of text.
    """
    started = time.perf_counter()
    console = plain_console(quiet=True) if json else output.console()
    machine = look()
    _print_machine(machine, console)
    with console.status("drawing without a screen"):
        drawing = can_draw()
    state = "works" if drawing else f"does not work; {HELP_WITH_DRAWING}"
    console.print(f"drawing: {state}", soft_wrap=True)
    outcomes = _tested(console)
    failed = [outcome for outcome in outcomes if not outcome.passed]
    if json:
        found = {
            "acoustube": __version__, **machine, "drawing": drawing,
            "tests": [_in_json(outcome) for outcome in outcomes], "passed": not failed,
        }  # fmt: skip
        print(dumps(found, indent=2))  # not console.print, which would break lines
    if failed:
        raise SimulationError(
            f"{len(failed)} of {len(outcomes)} tests failed ({failed[0].name}), so that results of "
            "this installation cannot be trusted; install acoustube in a fresh environment"
        )
    elapsed = time.perf_counter() - started
    console.print(f"all {len(outcomes)} tests passed, in {elapsed:.0f} s.", highlight=False)


def _in_json(outcome: Outcome) -> dict[str, Any]:
    """Return a test's outcome as a dictionary for JSON, with None in place of nan and infinity."""
    computed = outcome.computed if isfinite(outcome.computed) else None
    return outcome._asdict() | {"computed": computed, "passed": outcome.passed}


def look() -> dict[str, Any]:
    """Return the properties of the machine, its packages and the cache.

    Versions are empty where a package is missing, sizes of memory None where the system does not
    state them; `remnants` are incomplete outputs that killed commands have left behind.
    """
    from importlib.metadata import requires

    import jax
    import numba

    from acoustube.runs.sweep.workers import cores

    device = jax.devices()[0]
    folder = cache.folder()
    there = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    return {
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "packages": {name: _version(name) for name in PACKAGES},
        "device": f"{device.platform} ({device.device_kind})",
        "precision": "float64 wall, float32 air",
        "cores": cores(),
        "threads": numba.get_num_threads(),
        "memory_gb": _memory(),
        "memory_free_gb": _free_memory(),
        "cache_folder": str(folder),
        "cache_writable": there.is_dir() and os.access(there, os.W_OK),
        "disk_free_gb": round(shutil.disk_usage(there).free / 1e9, 2),
        "remnants": [str(remnant.path) for remnant in remnants()],
        "extras": [extra._asdict() for extra in extras(requires("acoustube") or [])],
    }


def extras(requirements: list[str]) -> list[Extra]:
    """Return the optional extras in requirements such as ``dask; extra == 'dask'``."""
    needed: dict[str, list[str]] = {}
    for line in requirements:
        found = re.match(r"([\w.-]+).*;.*extra == ['\"]([\w-]+)['\"]", line)
        if found and found[2] not in FOR_OTHERS:
            needed.setdefault(found[2], []).append(found[1])
    return [
        Extra(
            name,
            PURPOSES.get(name, ""),
            all(_version(package) for package in packages),
            f"pip install 'acoustube[{name}]'",
        )
        for name, packages in sorted(needed.items())
    ]


def can_draw() -> bool:
    """Return whether VTK can draw off screen, tested in a separate process, which may crash."""
    command = [sys.executable, "-c", DRAWING]
    try:
        subprocess.run(command, capture_output=True, check=True, timeout=DRAWING_SECONDS)
    except (subprocess.SubprocessError, OSError):
        return False
    return True


def _version(package: str) -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(package)
    except PackageNotFoundError:
        return ""


def _memory() -> float | None:
    """Return the machine's memory in GB; None if the system does not state it."""
    try:
        return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9, 2)
    except (AttributeError, OSError, ValueError):
        return None


def _free_memory() -> float | None:
    """Return the memory in GB available without swapping; None if the system does not state it."""
    try:
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        kilobytes = next(line.split()[1] for line in lines if line.startswith("MemAvailable:"))
    except (OSError, StopIteration):
        return None
    return round(int(kilobytes) * 1024 / 1e9, 2)


def _print_machine(machine: dict[str, Any], console: Console) -> None:
    def line(text: str) -> None:
        console.print(text, soft_wrap=True, highlight=False)

    line(f"acoustube {__version__}, Python {machine['python']} on {machine['system']}")
    versions = (f"{name} {number or 'MISSING'}" for name, number in machine["packages"].items())
    line(f"packages: {', '.join(versions)}")
    line(
        f"device: {machine['device']}, {machine['precision']}; {machine['cores']} cores, "
        f"{machine['threads']} threads"
    )
    line(f"memory: {_in_gb(machine['memory_gb'])}, {_in_gb(machine['memory_free_gb'])} free")
    advice = "" if machine["cache_writable"] else f"; {HELP_WITH_CACHE}"
    line(f"cache: {machine['cache_folder']}, {machine['disk_free_gb']:.1f} GB free{advice}")
    if machine["remnants"]:
        first, *others = machine["remnants"]
        more = f" and {len(others)} more" * bool(others)
        line(f"left behind by killed commands: {first}{more}; acoustube cache clear removes them")
    for extra in machine["extras"]:
        state = "there" if extra["present"] else f"missing; {extra['install']}"
        line(f"extra {extra['name']}, which {extra['purpose']}: {state}")


def _in_gb(size: float | None) -> str:
    return "unknown" if size is None else f"{size:.1f} GB"


def _tested(console: Console) -> list[Outcome]:
    """Run the self-test, and print each row as soon as it is computed."""
    from acoustube.runs.selftest import all_trials

    outcomes = []
    for trial in all_trials():
        with console.status(f"testing: {trial.name}"):
            outcome = trial.run()
        outcomes.append(outcome)
        console.print(_row(outcome), soft_wrap=True, highlight=False)
    return outcomes


def _row(outcome: Outcome) -> str:
    """Return the outcome of a test as one line of text."""
    state = "passed" if outcome.passed else "FAILED"
    unit = "" if outcome.unit == "1" else f" {outcome.unit}"
    expected = f"{outcome.expected:.5g}{unit} within {outcome.tolerance:.2g}"
    computed = outcome.problem or f"{outcome.computed:.5g}{unit}"
    return f"{state}  {outcome.name}: {computed}, expected {expected} ({outcome.seconds:.1f} s)"
