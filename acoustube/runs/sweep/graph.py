"""Task graph of a sweep: the cases that share a load path, and those that share scattering.

One load path contains all depths of a tube under an indenter. At each depth, one scattering matrix
serves all lengths of the tube, positions of the press, pulses in its band, and air temperatures
within 18 K of its own. Only the recording and its processing are computed for each case.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import ceil, floor
from typing import Any, NamedTuple

from acoustube.air import sound_speed
from acoustube.runs import sound
from acoustube.runs.config import Config
from acoustube.runs.config.si import SISettings, settings_in_si
from acoustube.runs.sweep.plan import digest
from acoustube.runs.sweep.tasks import Band

REFERENCE_TEMPERATURES = (-15.0, 20.0, 50.0)
"""Air temperatures in degC of the matrices: every allowed temperature is within 18 K of one."""
BAND_STEP = 1e3
"""Multiple in Hz to which band edges are rounded outwards, so that similar pulses share a band."""
BURST_CYCLES = 11
"""Cycles of a pulse with the band of the default rangefinder; longer pulses are given this band."""
CASE_SETTINGS = {"tube": ("length_cm",), "indentation": ("depth_mm", "position_cm", "steps")}
"""Settings by section on which a load path does not depend."""

SCATTERING_SETTINGS = ("resolution", "losses", "method", "humidity_percent", "pressure_kpa")
"""Settings of the sound on which a press's scattering depends."""


class Case(NamedTuple):
    """A case of a sweep.

    Attributes
    ----------
    name : str
        Hash of the settings.
    config : Config
        Settings of the case.
    """

    name: str
    config: Config

    @property
    def settings(self) -> SISettings:
        """Settings of the case in SI units."""
        return settings_in_si(self.config)


@dataclass(frozen=True, eq=False)
class Group:
    """Cases of one press at one depth, on one grid.

    Attributes
    ----------
    depth : float
        Indentation depth in m; 0 for an untouched tube.
    band : Band or None
        Band and air of the cases' scattering matrix; None without a matrix (whole tubes, or no
        press).
    cases : tuple of Case
    """

    depth: float
    band: Band | None
    cases: tuple[Case, ...]

    @property
    def settings(self) -> SISettings:
        """Settings of the first case, which shares the press and the grid with the others."""
        return self.cases[0].settings


@dataclass(frozen=True, eq=False)
class LoadPath:
    """A tube, an indenter, and the depths to which the tube is pressed.

    Attributes
    ----------
    depths : tuple of float
        Rising depths in m, without 0 of an untouched tube.
    groups : tuple of Group
        Cases of each depth and grid.
    """

    depths: tuple[float, ...]
    groups: tuple[Group, ...]

    @property
    def presses(self) -> bool:
        """True if one of the cases is pressed."""
        return any(group.depth > 0 for group in self.groups)

    @property
    def settings(self) -> SISettings:
        """Settings of the first case, which shares the tube and the indenter with the others."""
        return self.groups[0].settings


def load_paths(cases: Iterable[Case]) -> list[LoadPath]:
    """Group cases by load path, and within a path by scattering, in the order of the cases.

    Parameters
    ----------
    cases : iterable of Case
        All cases of a plan, since the increments of a load path depend on all its depths.
    """
    paths: dict[str, dict[str, list[Case]]] = {}
    for case in cases:
        groups = paths.setdefault(_path_key(case.config), {})
        groups.setdefault(_group_key(case.config), []).append(case)
    return [_path(list(groups.values())) for groups in paths.values()]


def only_cases(paths: Sequence[LoadPath], names: set[str]) -> list[LoadPath]:
    """Return the load paths with only those cases that are named."""
    found = []
    for path in paths:
        groups = [
            dataclasses.replace(group, cases=cases)
            for group in path.groups
            if (cases := tuple(case for case in group.cases if case.name in names))
        ]
        if groups:
            found.append(dataclasses.replace(path, groups=tuple(groups)))
    return found


def shard(paths: Sequence[LoadPath], number: int, count: int) -> set[str]:
    """Return the names of the cases in part `number`, from 1, of `count` parts of a sweep.

    Parts are nearly equal in size. Each consists of consecutive whole groups, so that few load
    paths are in two parts.
    """
    groups = [group for path in paths for group in path.groups]
    sizes = [len(group.cases) for group in groups]
    total, before, found = sum(sizes), 0, set()
    for group, size in zip(groups, sizes, strict=True):
        # The middle of a group decides, so that each group belongs to just one part.
        if floor((before + size / 2) * count / total) == number - 1:
            found |= {case.name for case in group.cases}
        before += size
    return found


def _path(groups: list[list[Case]]) -> LoadPath:
    made = [_group(tuple(cases)) for cases in groups]
    depths = sorted({group.depth for group in made} - {0.0})
    return LoadPath(tuple(depths), tuple(made))


def _group(cases: tuple[Case, ...]) -> Group:
    first = cases[0].settings
    if first.depth == 0 or first.method == "full":
        return Group(first.depth, None, cases)
    reference = _reference(first.temperature)
    bands = []
    for settings in (case.settings for case in cases):
        ratio = sound_speed(reference) / sound_speed(settings.temperature)
        burst = dataclasses.replace(settings.pulse, cycles=min(settings.pulse.cycles, BURST_CYCLES))
        bands.append([ratio * edge for edge in sound.band_of(burst)])
    lowest, highest = min(low for low, _ in bands), max(high for _, high in bands)
    low = BAND_STEP * floor(lowest / BAND_STEP) or lowest
    band = Band(low, BAND_STEP * ceil(highest / BAND_STEP), reference)
    return Group(first.depth, band, cases)


def _reference(temperature: float) -> float:
    """Return the nearest of the reference temperatures to a temperature, in degC."""
    return min(REFERENCE_TEMPERATURES, key=lambda t: abs(t - temperature))


def _path_key(config: Config) -> str:
    """Return the hash of the settings that a load path depends on."""
    sections: dict[str, Any] = {
        "tube": dataclasses.asdict(config.tube),
        "indentation": dataclasses.asdict(config.indentation),
    }
    for section, names in CASE_SETTINGS.items():
        for name in names:
            del sections[section][name]
    return digest(sections)


def _group_key(config: Config) -> str:
    """Return the hash of the settings that scattering on a load path depends on."""
    waves = config.waves
    decisive = [getattr(waves, name) for name in SCATTERING_SETTINGS]
    return digest([config.indentation.depth_mm, _reference(waves.temperature_c), *decisive])
