"""Simulate a silicone tube that carries ultrasound and is pressed by a cylinder.

The modules follow the data: tube -> indentation -> lumen -> waves -> ranging -> signals ->
estimation. The names below are loaded when they are first used, so that importing the package costs
nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from acoustube.chain import simulate
    from acoustube.config import Config, load_config
    from acoustube.opening import open_dataset

__version__ = "0.1.0"

__all__ = ["Config", "__version__", "load_config", "open_dataset", "simulate"]

_HOME = {
    "Config": "acoustube.config",
    "load_config": "acoustube.config",
    "open_dataset": "acoustube.opening",
    "simulate": "acoustube.chain",
}


def __getattr__(name: str) -> Any:
    """Import an exported name on first use (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value  # the next access skips this function
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
