"""Run of a design: the search with its workers and progress, and the recommended sensors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from acoustube.base.checks import Optional, checked
from acoustube.base.errors import SimulationError
from acoustube.base.interrupts import watched_interrupts
from acoustube.base.report import SILENT, Reporter, counted, time_in_words
from acoustube.base.rules import Number
from acoustube.base.units import KHZ
from acoustube.inversion.design import PressedTube
from acoustube.ranging import Rangefinder
from acoustube.runs.config.goal import DesignGoal
from acoustube.runs.design.candidates import Candidate
from acoustube.runs.design.choice import (
    PAPER,
    Recommended,
    error_map,
    limits_of,
    paper_sensor,
    recommended,
    robustness_of,
)
from acoustube.runs.design.parts import pairs_of, ranges_of
from acoustube.runs.design.search import Search
from acoustube.runs.design.tubes import (
    REFERENCE_SHORE_A,
    TubeSpec,
    band_of,
    plan_of,
    tasks_of,
    tube_seconds,
)
from acoustube.runs.sweep.progress import Board
from acoustube.runs.sweep.run import run_with_progress
from acoustube.runs.sweep.workers import Workers, count_of, worker_pool

ASSUMED = (
    ("Presses are computed on the coarse mesh; clutter that calibration leaves is not included."),
    (
        "Level, noise and ring-down of the electronics are those of the default rangefinder at "
        "every carrier, and with a loudspeaker those of acoustube.ranging.LOUDSPEAKER."
    ),
)
"""Assumptions of the predictions."""


class Designed(NamedTuple):
    """Result of a design.

    Attributes
    ----------
    design : DesignGoal
    seed : int
    front : list of Candidate
        Pareto front in reach, resolution, and the errors of force and position.
    sensors : list of Recommended
        The recommended sensors, and last the sleeve paper's if it can be computed.
    tubes : int
        Number of tubes with a candidate.
    failed : dict of TubeSpec to str
        Tubes without a candidate, which could not be computed or which no drive suits, and why.
    """

    design: DesignGoal
    seed: int
    front: list[Candidate]
    sensors: list[Recommended]
    tubes: int
    failed: dict[TubeSpec, str]

    @property
    def notes(self) -> list[str]:
        """Warnings and assumptions of the predictions, one sentence each."""
        found = []
        if all(one.shortfalls(self.design) for one in self.front):
            found.append(
                "No candidate meets the goal; the recommended sensors come closest to it in reach, "
                "resolution, place and nearest press."
            )
        if self.failed:
            found.append(
                f"The search found no candidate with {counted(len(self.failed), 'tube')}, the "
                f"first: {next(iter(self.failed)).words}: {next(iter(self.failed.values()))}"
            )
        return [*found, *ASSUMED]


@checked(
    design=DesignGoal, seed=Number(0, 2**31, whole=True),
    tubes=Number(1, 2000, "tubes", whole=True),
    workers=Optional(Number(1, 1024, "processes", whole=True)),
)  # fmt: skip
def run_design(
    design: DesignGoal,
    *,
    seed: int = 0,
    tubes: int = 40,
    robust: bool = False,
    report: Reporter = SILENT,
    workers: int | None = None,
) -> Designed:
    """Search for sensors that meet a goal.

    Parameters
    ----------
    design : DesignGoal
    seed : int
        Random seed of the first tubes.
    tubes : int
        Largest number of tubes that the search computes.
    robust : bool
        Whether the recommended sensors are also computed with other bore, hardness and temperature.
    report : Reporter
        Receives messages and progress.
    workers : int, optional
        Number of processes, by default that of the cores.

    Returns
    -------
    Designed

    Raises
    ------
    SimulationError
        If no tube has a candidate.
    """
    count = count_of(workers)
    band = band_of(design, [Rangefinder().resonance])
    tools = design.goal.tools_mm
    middle = TubeSpec(design.variables.bore_mm[1], design.variables.wall_mm[0], REFERENCE_SHORE_A)
    each = sum(tube_seconds(plan_of(design, middle, tool, band)) for tool in tools)
    more = (6 if robust else 0) * (1 if design.goal.support == "table" else 2)
    report.title("a design")
    report.rows([
        ("tubes", f"at most {tubes}, first ones by seed {seed}"),
        ("band", f"{KHZ * band[0]:g} to {KHZ * band[1]:g} kHz"),
        ("expected", (f"at most {time_in_words((tubes + 1 + more) * each / count)} on {count} "
                     "workers; presses and sound are kept in the cache")),
    ])  # fmt: skip
    with watched_interrupts() as check, report.progress(check) as show, worker_pool(count) as pool:
        costs = (tubes + 1 + more) * len(tools)
        board = Board({"tubes": (costs, (tubes + 1 + more) * each)}, count, show)
        try:
            return _searched(design, seed, tubes, robust, board, pool, band)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                "interrupted; presses and scattering matrices are in the cache, run the same "
                "command again to go on"
            ) from None


def _searched(
    design: DesignGoal, seed: int, most: int, robust: bool, board: Board, pool: Workers,
    band: tuple[float, float],
) -> Designed:  # fmt: skip
    made: dict[TubeSpec, list[PressedTube] | str] = {}

    def compute(specs: Sequence[TubeSpec]) -> dict[TubeSpec, list[PressedTube] | str]:
        new = [spec for spec in dict.fromkeys(specs) if spec not in made]
        if new:
            run_with_progress(tasks_of(design, new, band, board, made), board, workers=pool)
        return {spec: made[spec] for spec in specs}

    search = Search(design, compute, seed, most)
    if search.run() is None:
        spec, reason = next(iter(search.failed.items()))
        raise SimulationError(
            f"none of {len(search.failed)} tubes has a candidate, the first ({spec.words}): "
            f"{reason}; widen bore_mm, wall_mm or outer_mm"
        )
    own = compute([PAPER])[PAPER]
    sensors = []
    for name, words, one in recommended(design, search.kept):
        parts = search.tubes[_pressed_as(design, one.tube)]
        changed = robustness_of(design, one, parts, compute) if robust else {}
        sensors.append(
            Recommended(name, words, one, error_map(design, parts, one),
                        limits_of(design, one), changed, ranges_of(design, parts, one),
                        pairs_of(design, parts, one))
        )  # fmt: skip
    failed = dict(search.failed)
    if isinstance(own, str):
        failed[PAPER] = f"the sleeve paper's, which is left out: {own}"
    else:
        paper = paper_sensor(design, own)
        sensors.append(
            Recommended("paper", "the sleeve paper's sensor", paper, error_map(design, own, paper),
                        limits_of(design, paper), {}, ranges_of(design, own, paper),
                        pairs_of(design, own, paper))
        )  # fmt: skip
    return Designed(design, seed, search.kept, sensors, len(search.best), failed)


def _pressed_as(design: DesignGoal, spec: TubeSpec) -> TubeSpec:
    """Return the tube to press for `spec`: itself, or on a table with the reference hardness."""
    return spec._replace(shore=REFERENCE_SHORE_A) if design.goal.support == "table" else spec


def summary(found: Designed) -> list[tuple[str, str]]:
    """Return names and descriptions of the sensors, and last the number of tubes."""
    rows = []
    for one in found.sensors:
        row = one.candidate.row
        words = (
            f"{one.candidate.tube.words}, {row['carrier_khz']:g} kHz, {row['cycles']:g} cycles, "
            f"{counted(row['ends'], 'end')}: reach {row['reach_m']:g} m, force "
            f"{row['force_percent']:g} % (median {row['force_median_percent']:g} %), two presses "
            f"{row['resolution_cm']:g} cm, place {row['place_mm']:g} mm"
        )
        if short := one.candidate.shortfalls(found.design):
            words += f"; misses the goal: {', '.join(short)}"
        rows.append((one.name, words))
    rows.append(("tubes", f"{found.tubes} with a candidate, {len(found.failed)} without"))
    return rows
