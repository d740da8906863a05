"""Simulate a silicone tube that carries ultrasound and is pressed by a cylinder.

Three layers, from top to bottom. A module imports only from its own layer and those below it::

    cli, reports, sensor, runs             commands; figures and files; a sensor for simulations of
                                           robots; settings and computations
    tube -> indentation -> lumen -> waves (air) -> ranging -> recordings -> signals -> estimation
    -> inversion -> sleeve                 the stages, in the order of the data
    base                                   errors, rules, files, the cache

The names below are loaded when they are first used, so that importing the package costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from acoustube.base import moved
from acoustube.base.version import __version__

if TYPE_CHECKING:
    from acoustube.base.errors import ConfigError, SimulationError
    from acoustube.runs.config import Config, Mechanics, load_config
    from acoustube.runs.opening import open_dataset
    from acoustube.runs.presses import pressed
    from acoustube.runs.scattering_file import read as read_scattering
    from acoustube.runs.simulate import simulate
    from acoustube.runs.sweep.cycles import Recipe
    from acoustube.runs.sweep.dataset import run_dataset
    from acoustube.runs.sweep.plan import load_plan
    from acoustube.runs.sweep.run import run_sweep

__all__ = [
    "Config",
    "ConfigError",
    "Mechanics",
    "Recipe",
    "SimulationError",
    "__version__",
    "load_config",
    "load_plan",
    "open_dataset",
    "pressed",
    "read_scattering",
    "run_dataset",
    "run_sweep",
    "simulate",
]

_HOME = {
    "Config": "runs.config",
    "ConfigError": "base.errors",
    "Mechanics": "runs.config",
    "Recipe": "runs.sweep.cycles",
    "SimulationError": "base.errors",
    "load_config": "runs.config",
    "load_plan": "runs.sweep.plan",
    "open_dataset": "runs.opening",
    "pressed": "runs.presses",
    "read_scattering": "runs.scattering_file",
    "run_dataset": "runs.sweep.dataset",
    "run_sweep": "runs.sweep.run",
    "simulate": "runs.simulate",
}

moved.announce()


def __getattr__(name: str) -> Any:
    """Import an exported name on first use (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = import_module(f"acoustube.{_HOME[name]}")
    value = getattr(module, "read" if name == "read_scattering" else name)
    globals()[name] = value  # the next access skips this function
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
