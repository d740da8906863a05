"""Settings in SI units: the one place where user settings are converted.

All computations use :class:`SIPress` and :class:`SISettings`, in which every default is filled in.
Temperatures stay in degC and the relative humidity in per cent, as :func:`acoustube.air.air_at`
takes them. Unlike the rest of this package, the module imports the stages of the computation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal

from acoustube.air import Air, air_at
from acoustube.indentation import USUAL_MESH, Indenter, Layer, MeshSize, Support
from acoustube.runs.config.config import Config, Mechanics
from acoustube.runs.config.settings import IndentationSettings
from acoustube.runs.config.tube_in_si import CENTI, KILO, MEGA, MILLI, tube_in_si
from acoustube.tube import Tube
from acoustube.waves import Pulse, SourceEnd

FACTORS = {"mm": MILLI, "cm": CENTI, "kHz": KILO, "kPa": KILO, "MPa": MEGA, "deg": math.pi / 180}
"""Factors to SI units, by unit; temperatures stay in degC, and fractions in per cent."""

MESH_SIZES = {
    "coarse": MeshSize(through_wall=1, around=12, along=10),
    "usual": USUAL_MESH,
    "fine": replace(USUAL_MESH, around=28, along=24, grading=3.2),
}
"""Meshes of a round tube. The force of a 25 mm rod on each is in the documentation's findings."""


@dataclass(frozen=True, kw_only=True)
class SIPress:
    """Settings of a press in SI units.

    Attributes
    ----------
    tube : Tube
        The tube; for a wall from a file only its moduli are used.
    surface : str or None
        File of a wall's surface in place of the round tube.
    indenter : Indenter
    layer : Layer or None
        Elastic layer under the tube; None for a rigid floor.
    support : {"held", "free"}
        The tube's bottom line is held on the floor, or rests on it with free ends.
    mesh : MeshSize
        Finite elements of a round tube.
    depth : float
        Indentation depth in m; 0 for the untouched tube.
    depths : tuple of float
        Equally spaced depths in m up to `depth`, for a press that is reported step by step.
    """

    tube: Tube
    surface: str | None
    indenter: Indenter
    layer: Layer | None
    support: Support
    mesh: MeshSize
    depth: float
    depths: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class SISettings(SIPress):
    """Settings of a simulation in SI units: the press, the sound and the processing.

    Attributes
    ----------
    position : float
        Distance of the press from the source end in m.
    pulse : Pulse
    temperature : float
        Air temperature in degC.
    humidity : float
        Relative humidity of the air in per cent.
    pressure : float
        Static pressure of the air in Pa.
    lossy : bool
        Whether there are losses at the wall and in the air.
    method : {"full", "scattering", "spectral"}
        Solver: FDTD of the whole tube, or scattering of the pressed part by FDTD or spectrally.
    resolution : int
        Grid cells across the bore.
    source_end : {"release", "absorbing"}
        Boundary condition at the source end after the pulse.
    probe : float
        Distance of the probe plane from the source end in m.
    cutoff : float
        Cut-off of the envelope's low-pass filter in Hz.
    prominence : float
        Least prominence of an echo, as a fraction of the send pulse.
    """

    position: float
    pulse: Pulse
    temperature: float
    humidity: float
    pressure: float
    lossy: bool
    method: Literal["full", "scattering", "spectral"]
    resolution: int
    source_end: SourceEnd
    probe: float
    cutoff: float
    prominence: float

    @property
    def air(self) -> Air:
        """Air in the tube."""
        return air_at(self.temperature, humidity=self.humidity, pressure=self.pressure)

    @property
    def radius(self) -> float:
        """Radius of the bore in m."""
        return self.tube.inner_diameter / 2


def to_si(value: float | None, unit: str) -> float | None:
    """Return a value in SI units, given its unit; None stays None.

    A value in a unit that is not in :data:`FACTORS` is returned unchanged.
    """
    return None if value is None else FACTORS.get(unit, 1) * value


def settings_in_si(config: Config) -> SISettings:
    """Convert the settings of a simulation to SI units."""
    waves = config.waves
    return SISettings(
        **_press_fields(config),
        position=CENTI * config.position_cm,
        pulse=Pulse(frequency=KILO * waves.frequency_khz, cycles=waves.cycles),
        temperature=waves.temperature_c,
        humidity=waves.humidity_percent,
        pressure=KILO * waves.pressure_kpa,
        lossy=waves.losses == "on",
        method=waves.method,
        resolution=waves.resolution,
        source_end=waves.source_end,
        probe=CENTI * waves.probe_cm,
        cutoff=KILO * config.lowpass_khz,
        prominence=config.signals.prominence,
    )


def press_in_si(config: Config | Mechanics) -> SIPress:
    """Convert the settings of a press to SI units."""
    return SIPress(**_press_fields(config))


def _press_fields(config: Config | Mechanics) -> dict[str, Any]:
    """Return the attributes of :class:`SIPress` by name."""
    press, n = config.indentation, config.indentation.steps
    return {
        "tube": tube_in_si(config.tube),
        "surface": config.tube.surface,
        "indenter": _indenter(press),
        "layer": _layer(press),
        "support": press.support,
        "mesh": MESH_SIZES[press.mesh],
        "depth": MILLI * press.depth_mm,
        "depths": tuple(MILLI * (press.depth_mm * i / n) for i in range(1, n + 1)),
    }


def _indenter(settings: IndentationSettings) -> Indenter:
    return Indenter(
        shape=settings.shape,
        diameter=MILLI * settings.indenter_mm,
        x=MILLI * settings.offset_mm,
        yaw=math.radians(settings.yaw_deg),
    )


def _layer(settings: IndentationSettings) -> Layer | None:
    if settings.layer_mm is None or settings.layer_mpa is None:
        return None
    return Layer(thickness=MILLI * settings.layer_mm, modulus=MEGA * settings.layer_mpa)
