"""The command ``acoustube library``: scattering as a function of depth, for ``invert``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.base.units import KHZ
from acoustube.cli._options import Checked, Output, Workers, axis, settings_of

Values = list[str] | None


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Tools:
    """Settings of the indenters, the tube and the pulse, with one or more values each."""

    indenter: Annotated[Values, axis("indenter")] = None
    shape: Annotated[Values, axis("shape")] = None
    depth: Annotated[Values, axis("depth")] = None
    bore: Annotated[Values, axis("bore")] = None
    hardness: Annotated[Values, axis("hardness")] = None
    support: Annotated[Values, axis("support")] = None
    frequency: Annotated[Values, axis("frequency")] = None
    temperature: Annotated[Values, axis("temperature")] = None


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Accuracy(Checked):
    """Accuracy of a library.

    Attributes
    ----------
    tolerance : float
        Largest estimated rms error, over the band, of interpolation between depths: of the
        reflection coefficient, relative to its own rms, and of the transmission coefficient; depths
        are added until it is met.
    band : tuple
        Lowest and highest frequency in kHz, for chirps and other wide pulses; 0.8 and 1.2 times
        --frequency if not given.
    """

    tolerance: Annotated[float, Number(1e-4, 0.2, "", "relative")] = 0.005
    band: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        """Check the band."""
        super().__post_init__()
        if self.band is not None:
            for edge in self.band:
                Number(0.5, 120, "kHz").check("band", edge)
            low, high = self.band
            if not low < high:
                raise ConfigError(
                    "is invalid", setting="band", value=f"{low:g} {high:g}", unit="kHz",
                    advice="use 0 < low < high",
                )  # fmt: skip

    @property
    def in_hertz(self) -> tuple[float, float] | None:
        """The band in Hz; None if not given."""
        return None if self.band is None else (self.band[0] / KHZ, self.band[1] / KHZ)


def library(
    *,
    tools: Tools = Tools(),
    accuracy: Accuracy = Accuracy(),
    config: Path | None = None,
    out: Path,
    processes: Workers = Workers(),
    output: Output = Output(),
) -> int:
    """Compute a library for invert: the scattering of presses as a function of depth.

    The depths are a range first:last:step. Shapes between them are interpolated, and scattering is
    computed at more depths where it varies more. Other settings may have several values; each
    combination counts as one indenter. Indenters that the folder contains are not computed again.

    Parameters
    ----------
    config : Path
        TOML file with settings, which options override.
    out : Path
        Folder to write, or to resume.
    """
    over = {name: words for name, words in settings_of(tools).items() if words is not None}
    over.setdefault("depth_mm", ["1:7.5:0.25"])

    from acoustube.runs.libraries.build import build_library
    from acoustube.runs.libraries.plan import tool_plans

    plans = tool_plans(over, accuracy.tolerance, config, accuracy.in_hertz)
    report = output.reporter()
    return 0 if build_library(plans, out, report=report, workers=processes.workers) else 1
