"""User settings in practical units, validated before any computation.

Each section is a frozen dataclass whose fields carry their own rule (range or choice), so that one
check serves them all; :class:`Config` adds the checks that need more than one section. This module
imports no solver, so that wrong settings are rejected at once.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from acoustube.base.errors import ConfigError
from acoustube.base.limits import SHALLOWEST_MM
from acoustube.base.rules import Choice, File, Number, Section, setting

DEFAULT_SHORE_A = 35.0


@dataclass(frozen=True, kw_only=True)
class TubeSettings(Section):
    """The tube. The defaults are those of the sleeve paper's silicone tube.

    The material is given by its hardness or by its shear modulus, not both; with neither, the
    hardness is 35 Shore A.
    """

    inner_diameter_mm: float = setting(7.9, Number(1, 50, "mm", "diameter of the bore"))
    wall_mm: float = setting(1.6, Number(0.2, 20, "mm", "wall thickness"))
    length_cm: float = setting(40.0, Number(5, 1000, "cm", "length of the tube"))
    shore_a: float | None = setting(None, Number(10, 90, "Shore A", "hardness of the wall"))
    shear_modulus_mpa: float | None = setting(
        None, Number(0.01, 20, "MPa", "shear modulus of the wall, in place of shore_a")
    )
    poisson_ratio: float = setting(0.49, Number(0.2, 0.499, "", "Poisson's ratio of the wall"))
    surface: str | None = setting(
        None,
        File(
            "closed surface of a wall along z, in mm (STL, PLY, OBJ, VTP), in place of the round "
            "tube"
        ),
    )

    def __post_init__(self) -> None:
        if self.shore_a is None and self.shear_modulus_mpa is None:
            object.__setattr__(self, "shore_a", DEFAULT_SHORE_A)
        super().__post_init__()
        if self.shore_a is not None and self.shear_modulus_mpa is not None:
            raise ConfigError(
                f"shore_a = {self.shore_a:g} and shear_modulus_mpa = {self.shear_modulus_mpa:g} "
                "both describe the wall's stiffness",
                advice="give one of the two",
            )

    @property
    def outer_diameter_mm(self) -> float:
        """Outer diameter in mm."""
        return self.inner_diameter_mm + 2 * self.wall_mm


class _Depth(Number):
    """Rule of an indentation depth, where zero means the untouched tube."""

    @property
    def allowed(self) -> str:
        """The range in words."""
        return f"{SHALLOWEST_MM:g} to {self.high:g} {self.unit}, or 0 in a sweep"


@dataclass(frozen=True, kw_only=True)
class IndentationSettings(Section):
    """The press: a rigid indenter that moves down onto the tube, and the ground under the tube."""

    shape: Literal["rod", "punch", "sphere"] = setting(
        "rod",
        Choice(
            ("rod", "punch", "sphere"),
            "indenter: cylinder across the tube, upright cylinder with a flat end, or sphere",
        ),
    )
    indenter_mm: float = setting(25.0, Number(2, 100, "mm", "diameter of the indenter"))
    depth_mm: float = setting(4.0, _Depth(0, 50, "mm", "indentation depth from first contact"))
    steps: int = setting(
        16,
        Number(1, 1000, "", "number of equally spaced depths of acoustube indent", whole=True),
    )
    position_cm: float | None = setting(
        None,
        Number(
            0.1, 1000, "cm", "distance of the press from the source end, by default half the length"
        ),
    )
    offset_mm: float = setting(
        0.0, Number(-50, 50, "mm", "lateral offset of a punch or sphere from the tube's axis")
    )
    yaw_deg: float = setting(
        0.0, Number(-60, 60, "deg", "yaw of a rod from the direction across the tube")
    )
    support: Literal["held", "free"] = setting(
        "held",
        Choice(
            ("held", "free"),
            "support of the tube: bottom line held on the floor, or resting on it with free ends",
        ),
    )
    layer_mm: float | None = setting(
        None, Number(0.1, 100, "mm", "thickness of an elastic layer under a free tube")
    )
    layer_mpa: float | None = setting(
        None, Number(0.001, 1000, "MPa", "Young's modulus of the elastic layer")
    )
    mesh: Literal["coarse", "usual", "fine"] = setting(
        "usual",
        Choice(
            ("coarse", "usual", "fine"),
            "finite-element mesh of a round tube, for a convergence study",
        ),
    )


@dataclass(frozen=True, kw_only=True)
class WaveSettings(Section):
    """The sound in the lumen, and the grid on which it is computed."""

    frequency_khz: float = setting(42.0, Number(5, 100, "kHz", "carrier frequency of the pulse"))
    cycles: int = setting(11, Number(1, 100, "", "carrier cycles in the pulse", whole=True))
    temperature_c: float = setting(20.0, Number(-20, 60, "degC", "temperature of the air"))
    humidity_percent: float = setting(50.0, Number(0, 100, "%", "relative humidity of the air"))
    pressure_kpa: float = setting(101.325, Number(10, 200, "kPa", "pressure of the air at rest"))
    losses: Literal["off", "on"] = setting(
        "off", Choice(("off", "on"), "losses at the wall and in the air")
    )
    method: Literal["full", "scattering", "spectral"] = setting(
        "full",
        Choice(
            ("full", "scattering", "spectral"),
            "solver: FDTD of the whole tube, or scattering matrix of the press, by FDTD or by the "
            "spectral solver, joined to straight tube",
        ),
    )
    resolution: int = setting(24, Number(8, 256, "", "grid cells across the bore", whole=True))
    source_end: Literal["release", "absorbing"] = setting(
        "release",
        Choice(("release", "absorbing"), "boundary condition at the source end after the pulse"),
    )
    probe_cm: float = setting(
        2.0, Number(0.1, 100, "cm", "distance of the probe plane from the source end")
    )


@dataclass(frozen=True, kw_only=True)
class SignalSettings(Section):
    """The processing from pressure to distance."""

    lowpass_khz: float | None = setting(
        None,
        Number(
            0.5,
            50,
            "kHz",
            "cut-off of the envelope's low-pass filter, by default half of frequency_khz but at "
            "most 10",
        ),
    )
    prominence: float = setting(
        0.001, Number(0.0001, 1, "", "least prominence of an echo, as a fraction of the send pulse")
    )
