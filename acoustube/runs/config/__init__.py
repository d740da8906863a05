"""User settings in practical units, validated before any computation, and converted to SI units.

Read `settings`, then `checks`, `config`, `document`, and `si`, which converts them.
"""

from acoustube.runs.config.checks import CELLS_PER_WAVELENGTH, check_touched, grid_cells
from acoustube.runs.config.config import Config, Mechanics, Settings
from acoustube.runs.config.document import (
    Given,
    configured,
    describe,
    given_in,
    is_whole,
    load_config,
    read_document,
    section_of,
    to_toml,
)
from acoustube.runs.config.settings import (
    IndentationSettings,
    SignalSettings,
    TubeSettings,
    WaveSettings,
)

__all__ = [
    "CELLS_PER_WAVELENGTH",
    "Config",
    "Given",
    "IndentationSettings",
    "Mechanics",
    "Settings",
    "SignalSettings",
    "TubeSettings",
    "WaveSettings",
    "check_touched",
    "configured",
    "describe",
    "given_in",
    "grid_cells",
    "is_whole",
    "load_config",
    "read_document",
    "section_of",
    "to_toml",
]
