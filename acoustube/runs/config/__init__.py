"""User settings in practical units, validated before any computation, and converted to SI units.

Reading order: `ranges` (rules for several numbers), `settings`, `checks`, `config`, `document`;
`si` and `tube_in_si` (conversion); `goal` (of a design).
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
