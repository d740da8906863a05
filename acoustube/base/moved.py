"""Former addresses of modules, which still import for one version, with a warning."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

NEW_ADDRESSES = {
    "acoustube.by_force": "acoustube.runs.by_force",
    "acoustube.cache": "acoustube.base.cache",
    "acoustube.chain": "acoustube.runs.sound",
    "acoustube.config": "acoustube.runs.config",
    "acoustube.datasets": "acoustube.runs.sweep.dataset",
    "acoustube.errors": "acoustube.base.errors",
    "acoustube.indentation.tools": "acoustube.indentation.indenters",
    "acoustube.mechanics": "acoustube.runs.presses",
    "acoustube.opening": "acoustube.runs.opening",
    "acoustube.plot": "acoustube.reports.figures.run",
    "acoustube.scattered": "acoustube.runs.scattering_file",
    "acoustube.scene": "acoustube.reports.scenes.tube",
    "acoustube.scene_sleeve": "acoustube.reports.scenes.sleeve",
    "acoustube.studies": "acoustube.reports.studies",
    "acoustube.studies.presses": "acoustube.reports.studies.presses",
    "acoustube.surfaces": "acoustube.base.surfaces",
    "acoustube.sweep": "acoustube.runs.sweep",
    "acoustube.sweep.cycles": "acoustube.runs.sweep.cycles",
    "acoustube.sweep.plan": "acoustube.runs.sweep.plan",
    "acoustube.swept": "acoustube.runs.sweep.run",
    "acoustube.vtu": "acoustube.reports.export.vtu",
    "acoustube.waves.duct_modes": "acoustube.waves.modes.grid_modes",
    "acoustube.waves.small_cells": "acoustube.waves.grid.small_cells",
    "acoustube.wrapped": "acoustube.reports.sleeve_table",
}
"""Modules that users of version 0.1 imported, and their present addresses."""


class _Moved(MetaPathFinder, Loader):
    """Finder of modules under their former addresses; they forward to the new ones."""

    def find_spec(
        self, fullname: str, _path: Sequence[str] | None = None, _target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the specification of a module that moved, or None."""
        if fullname not in NEW_ADDRESSES:
            return None
        package = any(name.startswith(f"{fullname}.") for name in NEW_ADDRESSES)
        return ModuleSpec(fullname, self, is_package=package)

    def exec_module(self, module: ModuleType) -> None:
        """Forward every name of a module to its new address, with a warning."""
        new = NEW_ADDRESSES[module.__name__]
        warnings.warn(f"{module.__name__} is {new} now", DeprecationWarning, stacklevel=2)
        vars(module)["__getattr__"] = partial(getattr, import_module(new))


def announce() -> None:
    """Make modules importable under their former names."""
    if not any(isinstance(finder, _Moved) for finder in sys.meta_path):
        sys.meta_path.append(_Moved())


def renamed(module: str, names: Mapping[str, str]) -> Callable[[str], Any]:
    """Return a module's ``__getattr__``, which forwards former names with a warning.

    Parameters
    ----------
    module : str
        Name of the module.
    names : mapping of str to str
        Present name for each former name; with the full name of its module in front if that is not
        `module`.
    """

    def forward(name: str) -> Any:
        if name not in names:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        warnings.warn(f"{module}.{name} is {names[name]} now", DeprecationWarning, stacklevel=2)
        home, _, present = names[name].rpartition(".")
        return getattr(import_module(home or module), present)

    return forward
