"""Computations of minutes, replaced by an error: only the code that leads to them is fuzzed."""

from __future__ import annotations

import gc
from importlib import import_module
from typing import Any

from acoustube.base.errors import SimulationError
from tests.fuzz.functions import specs

HEAVY = (
    "acoustube.runs.presses:press_to", "acoustube.runs.simulate:press_to",
    "acoustube.waves.scattering:scatter", "acoustube.runs.sweep.run:run_sweep",
    "acoustube.runs.sweep.dataset:run_dataset", "acoustube.cli.reproduce:run_reproduce",
    "acoustube.runs.libraries.build:build_library", "acoustube.runs.selftest:all_trials",
    "acoustube.estimation:train", "acoustube.runs.design.run:run_design",
)  # fmt: skip
DRAWING = ("acoustube.reports.scenes.sleeve:draw", "acoustube.cli.check:can_draw")
PRELOADED = (
    "acoustube.cli.simulate", "acoustube.cli.indent", "acoustube.cli.sweep", "acoustube.cli.show",
    "acoustube.cli.export", "acoustube.cli.cite", "acoustube.cli.process", "acoustube.cli.train",
    "acoustube.cli.evaluate", "acoustube.cli.calibrate", "acoustube.cli.sleeve",
    "acoustube.cli.twin", "acoustube.cli.design",
    "acoustube.cli.scatter", "acoustube.cli.live", "acoustube.recordings", "acoustube.signals",
    "acoustube.runs.recordings", "acoustube.runs.opening", "acoustube.runs.training",
    "acoustube.base.surfaces", "acoustube.indentation.tetrahedra", "acoustube.reports.page",
    "acoustube.reports.figures.sweep", "acoustube.reports.export.tables", "h5netcdf", "h5py",
    "rich.console", "rich.progress", "rich.table", "rich.markup", "scipy.io", "pandas", "pyvista",
    "acoustube.sleeve", "acoustube.reports.sleeve_table", "sklearn.ensemble", "acoustube.waves",
    "matplotlib.backends.backend_agg", "tomlkit", "acoustube.runs.sweep.graph", "ezc3d",
    "cobs", "serial",
)  # fmt: skip


def _not_computed(*_arguments: Any, **_settings: Any) -> Any:
    raise SimulationError("nothing = 0 is computed while fuzzing; run the command by itself")


def _not_drawn(*_arguments: Any, **_settings: Any) -> bool:
    return False


def install() -> None:
    """Load the modules that the commands need, once for all, and replace long computations."""
    for name in PRELOADED:
        try:
            import_module(name)
        except ImportError:
            continue  # of an optional package, or moved: the case loads it itself or reports it
    for place, stub in (*((p, _not_computed) for p in HEAVY), *((p, _not_drawn) for p in DRAWING)):
        module, _, name = place.partition(":")
        loaded = import_module(module)
        getattr(loaded, name)  # raises where it has moved: else it would run for minutes
        setattr(loaded, name, stub)
    specs()  # whose arguments take a second to make
    gc.freeze()  # or each process would copy all of it to count references
