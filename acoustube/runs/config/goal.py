"""Goals of a design: requirements and design variables of a sensor, from TOML files."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from acoustube.air import sound_speed
from acoustube.base.errors import ConfigError
from acoustube.base.foreign.documents import read_document
from acoustube.base.rules import Choice, Number, Section, nearest, setting
from acoustube.base.units import CM, KHZ, MM, MS, PERCENT, UM
from acoustube.runs.config.ranges import Words, numbers
from acoustube.sleeve.ovalisation import kinks
from acoustube.tube import Tube

MOST_RANGEFINDERS = 1000
"""Largest number of combinations of transducer, quality factor, bandwidth, rate, bits and ends."""
MOST_SAMPLES = 20000
"""Largest number of samples of a cycle."""
LONGEST_PULSE = 5e-3
"""Longest drive in s: the frequency step of the predictions is too wide for longer ones."""
TRANSDUCERS = "resonant", "loudspeaker"
"""Kinds of transducer."""
WIDEST_CHIRP = 1.6
"""Largest ratio of a chirp's bandwidth to its carrier, a little below the inversion's limit."""
LEAST_RATE = 2.3
"""Lowest ratio of sampling rate to carrier frequency."""


@dataclass(frozen=True, kw_only=True)
class Goal(Section):
    """Required measuring range, resolution and accuracy of a sensor.

    Attributes
    ----------
    reach_m : float
        Length of the tube in m, over which contacts are to be estimated.
    nearest_m : float
        Distance in m of the nearest contact.
    forces_n : tuple of float
        Least and largest force in N.
    tools_mm : tuple of float
        Diameters of rods in mm.
    separation_cm : float
        Distance in cm between two presses that are to be resolved.
    place_mm : float
        Largest acceptable median standard deviation of a contact's distance, in mm.
    support : str
        ``table``: the tube is held on rigid ground; ``arm``: it rests on a soft layer.
    layer_mm, layer_mpa : float
        Thickness and Young's modulus of the arm's layer.
    bend_radius_cm : float
        Least radius in cm to which the tube is bent, without kinking; 0 for a straight tube.
    hardness_percent : float
        Relative standard deviation of the wall's modulus, in per cent.
    temperature_c : float
        Air temperature in degC.
    model_um : float
        Standard deviation of depths in um due to errors of the forward model; 50 um is the effect
        of another mesh.
    average : int
        Number of cycles whose mean is inverted.
    """

    reach_m: float = setting(2.0, Number(0.2, 10, "m", "length over which presses are resolved"))
    nearest_m: float = setting(0.3, Number(0.02, 9, "m", "distance of the nearest press"))
    forces_n: tuple[float, float] = numbers(
        (2.0, 20.0), Number(0.05, 500, "N", "forces to be measured"), span=True
    )
    tools_mm: tuple[float, ...] = numbers((25.0,), Number(5, 80, "mm", "diameters of the rods"))
    separation_cm: float = setting(15.0, Number(3, 200, "cm", "distance of two presses"))
    place_mm: float = setting(
        10.0, Number(0.1, 500, "mm", "largest median standard deviation of the distance")
    )
    support: str = setting("table", Choice(("table", "arm"), "what the tube lies on"))
    layer_mm: float = setting(20.0, Number(1, 100, "mm", "thickness of the arm's soft layer"))
    layer_mpa: float = setting(0.1, Number(0.005, 50, "MPa", "Young's modulus of that layer"))
    bend_radius_cm: float = setting(
        0.0, Number(0, 1000, "cm", "least radius of the tube's bends; 0 for none")
    )
    hardness_percent: float = setting(
        5.0, Number(0, 50, "%", "standard deviation of the wall's modulus")
    )
    temperature_c: float = setting(20.0, Number(-20, 60, "degC", "temperature of the air"))
    model_um: float = setting(
        50.0, Number(0, 1000, "um", "standard deviation of the depth by model errors")
    )
    average: int = setting(1, Number(1, 1000, "", "cycles whose mean is inverted", whole=True))

    @property
    def separation(self) -> float:
        """Distance between two presses in m."""
        return self.separation_cm / CM

    @property
    def place_deviation(self) -> float:
        """Largest acceptable median standard deviation of a contact's distance, in m."""
        return self.place_mm / MM

    @property
    def hardness(self) -> float:
        """Relative standard deviation of the wall's modulus, as a fraction."""
        return self.hardness_percent / PERCENT

    @property
    def model(self) -> float:
        """Standard deviation of depths in m due to errors of the forward model."""
        return self.model_um / UM

    @property
    def layer_thickness(self) -> float:
        """Thickness of the arm's layer in m."""
        return self.layer_mm / MM

    @property
    def curvature(self) -> float:
        """Largest curvature of the tube in 1/m."""
        return CM / self.bend_radius_cm if self.bend_radius_cm > 0 else 0.0

    @property
    def asked(self) -> tuple[float, float, float, float]:
        """Required reach, separation, deviation of position and nearest press, all in m."""
        return self.reach_m, self.separation, self.place_deviation, self.nearest_m

    def samples_at(self, rate: float, duration: float) -> int:
        """Return the number of samples of a cycle at a rate in Hz, to the end of the last echo.

        `duration` is that of the drive in s; one below 2 ms counts as 2 ms.
        """
        slowest = min(340.0, sound_speed(self.temperature_c))
        return int(rate * (2 * self.reach_m / slowest + max(duration, 2e-3) + 2e-3))


@dataclass(frozen=True, kw_only=True)
class Variables(Section):
    """Ranges of the design variables; a single number fixes a variable."""

    bore_mm: tuple[float, float] = numbers((5.0, 12.0), Number(2, 25, "mm", "bore"), span=True)
    wall_mm: tuple[float, float] = numbers(
        (1.0, 2.5), Number(0.5, 8, "mm", "wall thickness"), span=True
    )
    outer_mm: float = setting(14.0, Number(4, 40, "mm", "largest outer diameter"))
    hardness_shore_a: tuple[float, float] = numbers(
        (20.0, 60.0), Number(10, 90, "Shore A", "hardness of the wall"), span=True
    )
    carrier_khz: tuple[float, float] = numbers(
        (10.0, 42.0), Number(5, 90, "kHz", "carrier and resonance of the transducer"), span=True
    )
    cycles: tuple[float, float] = numbers(
        (3.0, 20.0), Number(1, 100, "", "periods of the drive"), span=True
    )
    bandwidth_khz: tuple[float, ...] = numbers(
        (0.0,), Number(0, 100, "kHz", "bandwidths of a chirp; 0 is a burst")
    )
    transducer: tuple[str, ...] = dataclasses.field(
        default=("resonant",),
        metadata={"rule": Words(Choice(TRANSDUCERS, "transducers at hand"))},
    )
    quality_factor: tuple[float, ...] = numbers(
        (14.0,), Number(0, 100, "", "quality factors of the transducers at hand")
    )
    rate_khz: tuple[float, ...] = numbers((200.0,), Number(10, 5000, "kHz", "sampling rates"))
    bits: tuple[int, ...] = numbers(
        (12,), Number(8, 16, "", "resolutions of the converter", whole=True)
    )
    ends: tuple[int, ...] = numbers((1,), Number(1, 2, "", "rangefinders", whole=True))

    @property
    def carrier(self) -> tuple[float, float]:
        """Lowest and highest carrier frequency in Hz."""
        return self.carrier_khz[0] / KHZ, self.carrier_khz[1] / KHZ

    def chirp_carrier(self, bandwidth: float) -> tuple[float, float]:
        """Return the lowest and highest carrier frequency in Hz of a drive with a bandwidth in Hz.

        The whole band of a chirp lies within the range of the carriers, so that the lowest exceeds
        the highest for a bandwidth wider than this range. A single carrier is returned unchanged.
        """
        low, high = self.carrier
        return (low + bandwidth / 2, high - bandwidth / 2) if high > low else (low, high)

    @property
    def bandwidths(self) -> tuple[float, ...]:
        """Bandwidths of the drive in Hz."""
        return tuple(one / KHZ for one in self.bandwidth_khz)

    @property
    def rates(self) -> tuple[float, ...]:
        """Sampling rates in Hz."""
        return tuple(one / KHZ for one in self.rate_khz)


SECTIONS: dict[str, type[Any]] = {"goal": Goal, "variables": Variables}


@dataclass(frozen=True, kw_only=True)
class DesignGoal:
    """Requirements of a sensor and ranges of its design variables.

    Raises
    ------
    ConfigError
        If requirements and ranges contradict each other, there are too many combinations to search,
        or a cycle has too many samples.
    """

    goal: Goal = dataclasses.field(default_factory=Goal)
    variables: Variables = dataclasses.field(default_factory=Variables)

    def __post_init__(self) -> None:
        """Check the settings against each other."""
        goal, free = self.goal, self.variables
        if goal.nearest_m >= goal.reach_m:
            raise ConfigError(
                f"is not below reach_m = {goal.reach_m:g}", setting="nearest_m",
                value=goal.nearest_m, advice="give a smaller distance",
            )  # fmt: skip
        if goal.forces_n[0] == goal.forces_n[1]:
            raise ConfigError(
                "is no range", setting="forces_n", value=list(goal.forces_n),
                advice="give the least and the largest force",
            )  # fmt: skip
        least = free.bore_mm[0] + 2 * free.wall_mm[0]
        if free.outer_mm < least:
            raise ConfigError(
                f"is less than the smallest bore plus twice the thinnest wall, {least:g} mm",
                setting="outer_mm", value=free.outer_mm, advice="raise it or lower bore_mm",
            )  # fmt: skip
        # A wall as thick as the bore is wide resists kinking best.
        thickest = min(free.wall_mm[1], (free.outer_mm - free.bore_mm[0]) / 2)
        stiffest = min(max(free.bore_mm[0], free.wall_mm[0]), thickest)
        if not self.bends(free.bore_mm[0], stiffest):
            raise ConfigError(
                "kinks all tubes", setting="bend_radius_cm", value=goal.bend_radius_cm,
                advice="raise it, lower bore_mm, or raise wall_mm and outer_mm",
            )  # fmt: skip
        if LEAST_RATE * free.carrier_khz[0] > max(free.rate_khz):
            raise ConfigError(
                f"is too low for a carrier of {free.carrier_khz[0]:g} kHz", setting="rate_khz",
                value=max(free.rate_khz),
                advice=f"use {LEAST_RATE * free.carrier_khz[0]:g} or more",
            )  # fmt: skip
        self._check_sizes()

    def bends(self, bore_mm: float, wall_mm: float) -> bool:
        """Return whether a tube (bore, wall in mm) bends to the goal's radius without kinking."""
        tube = Tube(inner_diameter=bore_mm / MM, wall_thickness=wall_mm / MM)
        return not kinks(tube, self.goal.curvature)

    def _check_sizes(self) -> None:
        """Raise if tools are listed twice, or cycles, drives or lists exceed their limits."""
        goal, free = self.goal, self.variables
        if len(set(goal.tools_mm)) < len(goal.tools_mm):
            raise ConfigError(
                "has a diameter twice", setting="tools_mm", value=list(goal.tools_mm),
                advice="give each once",
            )  # fmt: skip
        for bandwidth in free.bandwidths:
            low, high = free.chirp_carrier(bandwidth)
            if not bandwidth <= WIDEST_CHIRP * low or low > high:
                raise ConfigError(
                    f"is too wide for chirps within carrier_khz, {free.carrier_khz[0]:g} to "
                    f"{free.carrier_khz[1]:g} kHz", setting="bandwidth_khz",
                    value=KHZ * bandwidth, advice="use narrower chirps or widen carrier_khz",
                )  # fmt: skip
        if free.cycles[1] / free.carrier[0] > LONGEST_PULSE:
            raise ConfigError(
                f"last over {MS * LONGEST_PULSE:g} ms at {free.carrier_khz[0]:g} kHz",
                setting="cycles", value=free.cycles[1], advice="lower it or raise carrier_khz",
            )  # fmt: skip
        if goal.samples_at(max(free.rates), free.cycles[1] / free.carrier[0]) > MOST_SAMPLES:
            raise ConfigError(
                f"makes cycles of over {MOST_SAMPLES} samples", setting="rate_khz",
                value=max(free.rate_khz), advice="lower it or reach_m",
            )  # fmt: skip
        lists = {"quality_factor": free.quality_factor, "rate_khz": free.rate_khz,
                 "bandwidth_khz": free.bandwidth_khz, "transducer": free.transducer,
                 "bits": free.bits, "ends": free.ends}  # fmt: skip
        count = math.prod(map(len, lists.values()))
        if count > MOST_RANGEFINDERS:
            longest = max(lists, key=lambda name: len(lists[name]))
            raise ConfigError(
                f"makes {count} rangefinders with the other lists", setting=longest,
                value=list(lists[longest])[:4],
                advice=f"shorten it; at most {MOST_RANGEFINDERS} combinations are allowed",
            )  # fmt: skip


def read_goal(path: Path) -> DesignGoal:
    """Read a goal from a TOML file with the sections ``[goal]`` and ``[variables]``.

    Parameters
    ----------
    path : Path
        The file; settings that it omits have the defaults of :class:`Goal` and
        :class:`Variables`.

    Raises
    ------
    ConfigError
        If the file cannot be read, or a section, a name or a value is wrong.
    """
    document, found = read_document(path), {}
    for name, values in document.items():
        if name not in SECTIONS:
            raise ConfigError(f"{path}: [{name}] is not a section{nearest(name, SECTIONS)}")
        if not isinstance(values, dict):
            raise ConfigError(f"{path}: {name} must be a section, written [{name}]")
        known = [one.name for one in dataclasses.fields(SECTIONS[name])]
        for key in values:
            if key not in known:
                raise ConfigError(f"{path}: [{name}] {key} is not known{nearest(key, known)}")
    try:
        for name, section in SECTIONS.items():
            found[name] = section(**document.get(name, {}))
        return DesignGoal(**found)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
