"""The structure of a sweep's work: which cases share a press, and which a scattering.

A tube pressed by a tool goes through all its depths on one path. A press at one depth scatters
sound in one way, whatever the tube's length, its place, the air's temperature and the pulse; only
what is heard of it is a case's own.
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
from acoustube.runs.sweep.plan import digest
from acoustube.runs.sweep.tasks import Band

REFERENCE_TEMPERATURES = (-15.0, 20.0, 50.0)
"""In degC, at which scattering is computed: no air that a tube may hold is 18 K from one."""
BAND_STEP = 1e3
"""In Hz, to which bands are widened, so that they are the same for similar pulses."""
BURST = 11
"""Cycles of a pulse whose band holds all that the usual rangefinder hears."""
OWN = {"tube": ("length_cm",), "indentation": ("depth_mm", "position_cm", "steps")}
"""Settings that do not matter to a path of presses."""

OF_MATRIX = ("resolution", "losses", "method", "humidity_percent", "pressure_kpa")
"""Settings that decide, beside the press, how it scatters sound."""


class Case(NamedTuple):
    """A case of a sweep.

    Attributes
    ----------
    name : str
        Hash of its settings.
    config : Config
    """

    name: str
    config: Config


@dataclass(frozen=True, eq=False)
class Group:
    """Cases of one press at one depth, on one grid.

    Attributes
    ----------
    depth : float
        In m; 0 of an untouched tube.
    band : Band or None
        What their scattering must cover; None where whole tubes are marched, or none is pressed.
    cases : tuple of Case
    """

    depth: float
    band: Band | None
    cases: tuple[Case, ...]

    @property
    def config(self) -> Config:
        """The settings that all cases share, and others."""
        return self.cases[0].config


@dataclass(frozen=True, eq=False)
class Descent:
    """The way of one tool down on one tube.

    Attributes
    ----------
    depths : tuple of float
        Rising, in m, without the untouched tube.
    groups : tuple of Group
    """

    depths: tuple[float, ...]
    groups: tuple[Group, ...]

    @property
    def presses(self) -> bool:
        """Whether any of its cases needs the tool."""
        return any(group.depth > 0 for group in self.groups)

    @property
    def config(self) -> Config:
        """The settings of tube and tool, and others."""
        return self.groups[0].config


def depth_of(config: Config) -> float:
    """Return the depth of a press in m."""
    return 1e-3 * config.indentation.depth_mm


def structured(cases: Iterable[Case]) -> list[Descent]:
    """Return the paths and groups that cases belong to, in the cases' order.

    Parameters
    ----------
    cases : iterable of Case
        All of a plan: the increments of a path depend on all its depths.

    Returns
    -------
    list of Descent
    """
    paths: dict[str, dict[str, list[Case]]] = {}
    for case in cases:
        groups = paths.setdefault(_path_key(case.config), {})
        groups.setdefault(_group_key(case.config), []).append(case)
    return [_path(list(groups.values())) for groups in paths.values()]


def kept(paths: Sequence[Descent], names: set[str]) -> list[Descent]:
    """Return what remains of the work where only some cases, by name, are to be done."""
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


def shard(paths: Sequence[Descent], number: int, count: int) -> set[str]:
    """Return the names of the cases of one of several equal shares.

    Shares are runs of whole groups, so that few paths are in two of them.
    """
    groups = [group for path in paths for group in path.groups]
    sizes = [len(group.cases) for group in groups]
    total, before, found = sum(sizes), 0, set()
    for group, size in zip(groups, sizes, strict=True):
        # By the middle of a group, so that each belongs to just one share.
        if floor((before + size / 2) * count / total) == number - 1:
            found |= {case.name for case in group.cases}
        before += size
    return found


def _path(groups: list[list[Case]]) -> Descent:
    made = [_group(tuple(cases)) for cases in groups]
    depths = sorted({group.depth for group in made} - {0.0})
    return Descent(tuple(depths), tuple(made))


def _group(cases: tuple[Case, ...]) -> Group:
    config = cases[0].config
    depth = depth_of(config)
    if depth == 0 or config.waves.method == "full":
        return Group(depth, None, cases)
    reference = _reference(config)
    bands = []
    for case in cases:
        ratio = sound_speed(reference) / sound_speed(case.config.waves.temperature_c)
        bands.append([ratio * edge for edge in sound.band_of(_short(case.config))])
    lowest, highest = min(low for low, _ in bands), max(high for _, high in bands)
    low = BAND_STEP * floor(lowest / BAND_STEP) or lowest
    return Group(depth, Band(low, BAND_STEP * ceil(highest / BAND_STEP), reference), cases)


def _short(config: Config) -> Config:
    """Return the settings with a pulse as short as a rangefinder's burst at that carrier."""
    cycles = min(config.waves.cycles, BURST)
    return dataclasses.replace(config, waves=dataclasses.replace(config.waves, cycles=cycles))


def _reference(config: Config) -> float:
    """Return the temperature in degC at which the scattering of a press is computed."""
    return min(REFERENCE_TEMPERATURES, key=lambda t: abs(t - config.waves.temperature_c))


def _path_key(config: Config) -> str:
    """Return what decides the presses of a tube by a tool."""
    sections: dict[str, Any] = {
        "tube": dataclasses.asdict(config.tube),
        "indentation": dataclasses.asdict(config.indentation),
    }
    for section, names in OWN.items():
        for name in names:
            del sections[section][name]
    return digest(sections)


def _group_key(config: Config) -> str:
    """Return what decides, beside the press, how it scatters sound."""
    decisive = [getattr(config.waves, name) for name in OF_MATRIX]
    return digest([config.indentation.depth_mm, _reference(config), *decisive])
