"""Tools of a library, and the depths of their presses and scattering matrices."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from math import ceil
from pathlib import Path

import numpy as np

from acoustube.base import cache
from acoustube.base.errors import ConfigError
from acoustube.base.types import Array
from acoustube.inversion.tools import FEWEST_DEPTHS
from acoustube.runs import presses as press_runs
from acoustube.runs import sound
from acoustube.runs.config import Config
from acoustube.runs.config.si import SISettings
from acoustube.runs.sweep.graph import LoadPath, load_paths
from acoustube.runs.sweep.plan import digest, load_plan
from acoustube.runs.sweep.run import cases_of

BAND = 0.8, 1.2
"""Ends of a library's band relative to the carrier frequency: the band of a resonant transducer, at
temperatures up to 25 K from the library's."""
WIDEST_STEP = 1 / 16
"""Largest step of the depths of a press, in bore diameters: closer shapes can be interpolated."""
ROUNDING = 1e-9
"""Multiple in m to which depths are rounded, so that equal depths have equal file names."""


@dataclass(frozen=True, eq=False)
class ToolPlan:
    """One tube under one tool, and the depths of its press and of its scattering matrices.

    Attributes
    ----------
    config : Config
        Settings of the press to the first depth.
    settings : SISettings
        These settings in SI units.
    pressed : tuple of float
        Depths of the press in m, the first of them near first contact.
    first : tuple of float
        Depths in m at which scattering is computed first.
    tolerance : float
        Relative error of interpolated scattering above which the depths are refined.
    edges : tuple of float or None
        Lowest and highest frequency in Hz; None for :data:`BAND` times the carrier.
    """

    config: Config
    settings: SISettings
    pressed: tuple[float, ...]
    first: tuple[float, ...]
    tolerance: float
    edges: tuple[float, float] | None = None

    @property
    def band(self) -> tuple[float, float]:
        """Lowest and highest frequency in Hz."""
        if self.edges is not None:
            return self.edges
        low, high = (edge * self.settings.pulse.frequency for edge in BAND)
        return low, high

    @property
    def words(self) -> str:
        """Description of tool, largest depth and tube."""
        settings = replace(self.settings, depth=self.first[-1])
        return f"{press_runs.press_in_words(settings)}; {press_runs.wall_in_words(settings)}"

    def scattering_key(self, depth: float) -> str:
        """Return the cache key of the scattering matrix at a depth in m."""
        settings = self.settings
        return cache.key(
            "scattering",
            {
                "library": press_runs.cache_key(settings, self.pressed),
                "depth": round(depth, 12),
                "band": list(self.band),
                "step": sound.FREQUENCY_STEP,
                "air": [settings.temperature, settings.humidity, settings.pressure],
                "lossy": settings.lossy,
            },
        )

    @property
    def name(self) -> str:
        """Name of the tool's file: a hash of all that determines it, except the solvers' code."""
        settings, sound_of = self.settings, self.config.waves
        content = {
            "tube": {n: v for n, v in asdict(settings.tube).items() if n != "length"},
            "indenter": asdict(settings.indenter), "support": settings.support,
            "layer": settings.layer and asdict(settings.layer), "mesh": asdict(settings.mesh),
            "pressed": list(self.pressed), "first": list(self.first), "band": list(self.band),
            "tolerance": self.tolerance, "air": [settings.temperature, settings.humidity,
            settings.pressure], "losses": sound_of.losses,
        }  # fmt: skip
        return f"tool-{digest(content)[:16]}.nc"


def tool_plans(
    over: Mapping[str, Sequence[str]],
    tolerance: float,
    path: str | Path | None = None,
    band: tuple[float, float] | None = None,
) -> list[ToolPlan]:
    """Return the tools that settings describe.

    Parameters
    ----------
    over : mapping of str to sequence of str
        Settings with their values or ranges, as :func:`acoustube.runs.sweep.plan.load_plan` takes
        them; each combination of values of the tube and the press, other than depths, is a tool.
    tolerance : float
        See :class:`ToolPlan`.
    path : str or Path, optional
        TOML file with further settings.
    band : tuple of float, optional
        Lowest and highest frequency in Hz, by default 0.8 and 1.2 carriers.

    Raises
    ------
    ConfigError
        If a setting is wrong, the wall is imported, or a tool has too few depths.
    """
    plan = load_plan(path, {**over, "method": ["spectral"]})
    return [_tool(load_path, tolerance, band) for load_path in load_paths(cases_of(plan))]


def _tool(path: LoadPath, tolerance: float, band: tuple[float, float] | None) -> ToolPlan:
    config, settings = path.groups[0].cases[0].config, path.settings
    own = [case.config for group in path.groups for case in group.cases]
    if len({replace(one.waves, source_end="release") for one in own}) > 1:
        raise ConfigError("a library is of one frequency and one air; make a library for each")
    if settings.surface is not None:
        raise ConfigError("libraries are computed for round tubes only; leave out surface")
    if len(path.depths) < FEWEST_DEPTHS:
        raise ConfigError(
            f"a library needs {FEWEST_DEPTHS} or more depths of an indenter; give a range such as "
            "--depth 1:8:0.25"
        )
    widest = WIDEST_STEP * settings.tube.inner_diameter
    asked = np.array(path.depths)
    step = min(widest, float(np.diff(asked).min()))
    before = np.arange(asked[0] - step, 0.5 * step, -step)[::-1]
    rows = _divided(np.concatenate([before, asked]), widest)
    pressed = tuple(float(d) for d in rows)
    first = tuple(d for d in pressed if d >= asked[0] - ROUNDING)
    return ToolPlan(config, settings, pressed, first, tolerance, band)


def _divided(depths: Array, widest: float) -> Array:
    """Return rising depths in m, rounded, with steps above `widest` divided into equal ones."""
    parts = [
        np.linspace(a, b, ceil((b - a) / widest - 1e-6) + 1)[:-1]
        for a, b in itertools.pairwise(depths)
    ]
    found = np.concatenate([*parts, depths[-1:]])
    return np.asarray(np.round(found / ROUNDING) * ROUNDING)
