"""Presses and reflections of a candidate tube, from the cache or computed by workers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from acoustube.base.errors import ConfigError
from acoustube.base.types import Array
from acoustube.base.units import MM
from acoustube.inversion.design import PressedTube
from acoustube.inversion.design.echoes import FEWEST
from acoustube.lumen import pressed_part
from acoustube.runs.config import configured
from acoustube.runs.config.goal import DesignGoal
from acoustube.runs.config.si import settings_in_si
from acoustube.runs.costs import press_seconds, spectral_seconds
from acoustube.runs.libraries.build import path_of, press_rows, scattering_at
from acoustube.runs.libraries.plan import ToolPlan
from acoustube.runs.sweep.progress import Board
from acoustube.runs.sweep.tasks import Done
from acoustube.runs.sweep.workers import Task
from acoustube.waves.scattering import Complex

REFERENCE_SHORE_A = 35.0
"""Shore A hardness of computed presses on a table, whose forces are scaled to other moduli."""
SHALLOWEST, DEEPEST, DEPTHS = 0.1, 0.94, 14
"""Depths at which sound is computed: first and last in bore diameters, and their number."""
ROWS = 16
"""Number of depths of a press, between which its shapes are interpolated."""
INTO_LAYER = 0.4
"""Increase of the largest depth on a soft layer, as a fraction of the layer's thickness."""
MARGIN = 0.85, 1.15
"""Lowest computed frequency relative to the lowest carrier, and highest computed frequency relative
to the highest carrier."""
CHIRP_MARGIN = 0.61
"""Half width of the band computed for a chirp, relative to the chirp's bandwidth; a little larger
than that of the band in the inversion."""


class TubeSpec(NamedTuple):
    """Sizes and hardness of a tube.

    Attributes
    ----------
    bore, wall : float
        Diameter of the bore and thickness of the wall in mm.
    shore : float
        Shore A hardness.
    """

    bore: float
    wall: float
    shore: float

    @property
    def words(self) -> str:
        """Description of the tube."""
        return f"bore {self.bore:g} mm, wall {self.wall:g} mm, {self.shore:g} Shore A"


class Sounded(NamedTuple):
    """Arrays of a :class:`acoustube.inversion.design.PressedTube`, or why they are missing.

    Units and shapes are those of that class. The arrays are empty if there is a `reason`.
    """

    depth: Array
    force: Array
    frequency: Array
    reflection: Complex
    sound_speed: float
    reason: str = ""
    transmission: Complex | None = None


def band_of(design: DesignGoal, extra: Sequence[float] = ()) -> tuple[float, float]:
    """Return the band in Hz that covers all carriers of a design, and `extra` carriers in Hz."""
    free = design.variables
    carriers = [*free.carrier, *extra]
    ends = [
        (low - CHIRP_MARGIN * width, high + CHIRP_MARGIN * width)
        for width in free.bandwidths
        for low, high in [free.chirp_carrier(width)]
    ]
    lowest = min(MARGIN[0] * min(carriers), *(low for low, _ in ends))
    highest = max(MARGIN[1] * max(carriers), *(high for _, high in ends))
    return round(lowest, -2), round(highest, -2)


def plan_of(design: DesignGoal, spec: TubeSpec, tool: float, band: tuple[float, float]) -> ToolPlan:
    """Return the plan of a tube's presses by a rod of a diameter in mm, with sound in a band in Hz.

    Losses are included. Without them the resonances of trapped modes are so sharp that the
    reflection cannot be interpolated between the few depths.
    """
    goal, on_arm = design.goal, design.goal.support == "arm"
    ground: dict[str, Any] = {"support": "held"}
    last = DEEPEST * spec.bore
    if on_arm:
        ground = {"support": "free", "layer_mm": goal.layer_mm, "layer_mpa": goal.layer_mpa}
        last += INTO_LAYER * MM * goal.layer_thickness
    settings = configured(
        {}, inner_diameter_mm=spec.bore, wall_mm=spec.wall, shore_a=spec.shore, length_cm=100.0,
        indenter_mm=tool, depth_mm=0.9 * spec.bore, mesh="coarse",
        method="spectral", losses="on", resolution=64, frequency_khz=20.0,
        temperature_c=goal.temperature_c, **ground,
    )  # fmt: skip
    pressed = np.round(np.linspace(0, last, ROWS + 1)[1:], 6) / MM
    first = np.round(np.linspace(SHALLOWEST * spec.bore, last, DEPTHS), 6) / MM
    return ToolPlan(
        settings, settings_in_si(settings), tuple(map(float, pressed)), tuple(map(float, first)),
        0.005, band,
    )  # fmt: skip


def sounded(plan: ToolPlan) -> Done[Sounded]:
    """Press a tube and compute its scattering at the depths of a plan, or read both from cache."""
    (arrays, stopped), reused = press_rows(plan, plan.pressed)
    reached = [d for d in plan.first if d <= arrays["depth"][-1] * (1 + 1e-9)]
    empty = np.zeros(0)
    none = Sounded(empty, empty, empty, empty.astype(complex), 0.0)
    if len(reached) < FEWEST:
        return Done(none._replace(reason=stopped or "too few depths were reached"), reused)
    path = path_of(plan, arrays)
    kept: list[float] = []
    reflection: list[Complex] = []
    passed: list[Complex] = []
    frequency, reason = np.zeros(0), ""
    for depth in reached:
        found, known = scattering_at(plan, depth, pressed_part(path.at([depth])))
        reused &= known
        if isinstance(found, str):
            reason = found
            if len(kept) >= FEWEST:  # the lumen has closed
                break
            continue
        frequency = np.asarray(found.frequency, float)
        kept.append(depth)
        reflection.append(found.s[:, 0, 0, 0, 0])
        passed.append(found.s[:, 1, 0, 0, 0])
    if len(kept) < FEWEST:
        return Done(none._replace(reason=reason), reused)
    force = np.asarray(path.contact_force(kept), float)
    rising = np.concatenate([[True], np.diff(np.maximum.accumulate(force)) > 0])
    return Done(
        Sounded(
            np.array(kept)[rising], force[rising], frequency, np.array(reflection)[rising],
            plan.settings.air.sound_speed, transmission=np.array(passed)[rising],
        ),
        reused,
    )  # fmt: skip


def pressed_tubes(
    spec: TubeSpec, tools: Sequence[float], found: Sequence[Sounded]
) -> list[PressedTube]:
    """Return a tube's presses by tools of diameters in mm, from the arrays in the same order."""
    return [
        PressedTube(
            radius=spec.bore / 2 / MM, diameter=tool / MM, depth=one.depth, force=one.force,
            frequency=one.frequency, reflection=one.reflection, sound_speed=one.sound_speed,
            transmission=one.transmission,
        )
        for tool, one in zip(tools, found, strict=True)
    ]  # fmt: skip


def tasks_of(
    design: DesignGoal,
    specs: Sequence[TubeSpec],
    band: tuple[float, float],
    board: Board,
    found: dict[TubeSpec, list[PressedTube] | str],
) -> list[Task]:
    """Return tasks that compute tubes, each under one tool.

    The callbacks of the tasks add the presses of each tube, or the reason of its failure, to
    `found`.
    """
    tools = design.goal.tools_mm
    parts: dict[TubeSpec, dict[float, Sounded]] = {spec: {} for spec in specs}

    def task(spec: TubeSpec, tool: float) -> Task:
        plan = plan_of(design, spec, tool, band)
        cost = tube_seconds(plan)

        def then(done: Done[Sounded]) -> list[Task]:
            board.count("tubes", cost, reused=done.reused)
            parts[spec][tool] = done.result
            if len(parts[spec]) == len(tools):
                found[spec] = _joined(spec, tools, parts[spec])
            return []

        def failed(reason: str) -> None:
            board.count("tubes", cost)
            found[spec] = reason

        return Task(sounded, (plan,), then, failed, cost)

    return [task(spec, tool) for spec in specs for tool in tools]


def _joined(
    spec: TubeSpec, tools: Sequence[float], parts: Mapping[float, Sounded]
) -> list[PressedTube] | str:
    reasons = [one.reason for one in parts.values() if one.reason]
    if reasons:
        return reasons[0]
    try:
        return pressed_tubes(spec, tools, [parts[tool] for tool in tools])
    except ConfigError as error:
        return str(error)


def tube_seconds(plan: ToolPlan) -> float:
    """Return the expected computing time in s of a tube under one tool."""
    wide = (plan.band[1] - plan.band[0]) / 17e3
    return press_seconds(plan.settings, plan.pressed[-1]) + len(plan.first) * spectral_seconds(
        plan.settings
    ) * max(wide, 1.0)


Compute = Callable[[Sequence[TubeSpec]], dict[TubeSpec, "list[PressedTube] | str"]]
"""Function that returns each tube's presses, or the reason why it cannot be computed."""
