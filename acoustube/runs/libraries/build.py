"""Computation of libraries: presses, then their scattering at depths refined by bisection.

A press is solved at depths some tenths of a millimetre apart, usually in two parts at the same
time: the shallower two thirds and the deepest third. Shapes at depths between these are
interpolated, to an accuracy of micrometres. Scattering varies faster with depth than the shape
where a lumen has trapped modes, and is therefore computed at more depths, level by level
(:mod:`acoustube.runs.libraries.refinement`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import NamedTuple

import numpy as np

from acoustube.base import cache
from acoustube.base.checks import Several, checked
from acoustube.base.errors import ConfigError
from acoustube.base.interrupts import watched_interrupts
from acoustube.base.names import PATH
from acoustube.base.netcdf import Seal, seal_of
from acoustube.base.report import SILENT, Reporter, time_in_words
from acoustube.base.types import Array
from acoustube.base.units import KHZ, MM
from acoustube.indentation import DepthPath, PressError, restored
from acoustube.inversion import Tool
from acoustube.inversion.tools import FEWEST_DEPTHS
from acoustube.lumen import Lumen, pressed_part
from acoustube.runs import presses as press_runs
from acoustube.runs import scattering_file, sound
from acoustube.runs.config.si import MESH_SIZES
from acoustube.runs.costs import press_seconds, spectral_seconds
from acoustube.runs.libraries import files
from acoustube.runs.libraries.plan import ToolPlan
from acoustube.runs.libraries.refinement import Refinement
from acoustube.runs.sweep.progress import Board
from acoustube.runs.sweep.run import run_with_progress
from acoustube.runs.sweep.tasks import Done, one_thread
from acoustube.runs.sweep.workers import WORKERS, Task, Workers, count_of
from acoustube.waves.spectral import SpectralScattering

GOOD_SHARE = 0.75
"""Fraction of the frequencies at which the estimated error of a matrix must be small. The estimate
leaves out losses, and is therefore far too large within half a kilohertz of a trapped mode."""
DEEP_SHARE = 1 / 3
"""Fraction of the depths of a press that make its deep part. Solving them takes about as long as
solving the others: contact is wider, and a load path on the coarse mesh leads to them first."""
USUAL_DEPTHS = 3.0
"""Ratio of final to first number of depths of a tool, for estimates of time."""


# Depths in m of the parts of a press, rising.
Parts = Sequence[tuple[float, ...]]


class PressRows(NamedTuple):
    """Arrays of a press, and the reason why it did not reach all depths; empty if it did."""

    arrays: dict[str, Array]
    stopped: str


def press_rows(plan: ToolPlan, depths: Sequence[float]) -> Done[PressRows]:
    """Press the tube of a plan to depths in m, or read the press from the cache."""
    reused = cache.holds(press_runs.cache_key(plan.settings, depths))
    try:
        found = press_runs.press_to(plan.settings, depths)
        return Done(PressRows(found.results, ""), reused)
    except PressError as error:
        return Done(PressRows(error.indentation.results, str(error)), reused)


def parts_of(plan: ToolPlan) -> Parts:
    """Return the depths in m of the parts of a press, which are solved at the same time.

    There is one part if the whole press is in the cache, or on the coarse mesh, where nothing leads
    to the deep part but the depths of the shallow one.
    """
    depths = plan.pressed
    whole = cache.holds(press_runs.cache_key(plan.settings, depths))
    if whole or plan.settings.mesh == MESH_SIZES["coarse"]:
        return [depths]
    n = round((1 - DEEP_SHARE) * len(depths))
    return [depths[:n], depths[n:]]


def joined(pressed: Sequence[PressRows], parts: Parts) -> PressRows:
    """Return the rows of the parts of a press in order of depth, up to the first part that stopped.

    `parts` are their depths in m. Rows on the way to the first depth of a part are left out: those
    of the part before it are there.
    """
    arrays, stopped = pressed[0]
    for further, depths in zip(pressed[1:], parts[1:], strict=True):
        if stopped:
            break
        own = further.arrays["depth"] >= depths[0]
        arrays = {
            name: np.concatenate([rows, further.arrays[name][own]]) for name, rows in arrays.items()
        }
        stopped = further.stopped
    return PressRows(arrays, stopped)


def path_of(plan: ToolPlan, arrays: dict[str, Array]) -> DepthPath:
    """Return the interpolation of a press over depth, from its arrays."""
    settings = plan.settings
    return DepthPath(
        restored(
            settings.tube, settings.indenter, arrays, support=settings.support,
            layer=settings.layer, mesh=settings.mesh,
        )
    )  # fmt: skip


def scattering_at(plan: ToolPlan, depth: float, part: Lumen) -> Done[SpectralScattering | str]:
    """Compute the scattering of a part pressed to a depth in m, or read it from the cache.

    If the solver cannot compute the scattering, the reason is returned instead.
    """
    name = plan.scattering_key(depth)
    known = scattering_file.recall(name)
    if isinstance(known, SpectralScattering):
        return Done(known, True)
    try:
        with one_thread():
            found = sound.spectral_scattering_of(
                part, plan.settings.air, plan.band, lossy=plan.settings.lossy, share=GOOD_SHARE
            )
    except ConfigError as reason:
        return Done(str(reason).partition(";")[0], False)
    scattering_file.keep(name, found, f"library: {MM * depth:.4g} mm of {plan.words}")
    return Done(found, False)


@checked(
    plans=Several(ToolPlan, 1),
    out=PATH,
    workers=WORKERS,
)
def build_library(
    plans: Sequence[ToolPlan],
    out: str | Path,
    *,
    report: Reporter = SILENT,
    workers: int | Workers | None = None,
    executor: Executor | None = None,
) -> bool:
    """Compute the tools of a library that its folder lacks.

    Parameters
    ----------
    plans : sequence of ToolPlan
        From :func:`acoustube.runs.libraries.plan.tool_plans`.
    out : str or Path
        A folder, new or of a library.
    report : Reporter
        Receives messages and progress.
    workers : int or Workers, optional
        Number of processes, by default that of the cores; or an existing pool.
    executor : concurrent.futures.Executor, optional
        Runs the tasks in place of processes of this machine.

    Returns
    -------
    bool
        Whether no tool has failed.

    Raises
    ------
    ConfigError
        If the folder cannot be used.
    SimulationError
        If a file cannot be written, or the workers are gone.
    """
    started = time.perf_counter()
    folder = files.prepared(out)
    present = [plan for plan in plans if (folder / plan.name).is_file()]
    finished = [plan for plan in present if seal_of(folder / plan.name) is Seal.INTACT]
    todo = [plan for plan in plans if plan not in finished]
    count = count_of(workers)
    parts = [parts_of(plan) for plan in todo]
    costs = [_cost(plan, own) for plan, own in zip(todo, parts, strict=True)]
    first, settings = plans[0].first, plans[0].settings
    report.title("a library")
    report.rows([
        ("indenters", "\n".join(plan.words for plan in plans)),
        ("depths", (f"{MM * first[0]:g} to {MM * first[-1]:g} mm, "
                    f"{len(plans[0].pressed)} steps of the press")),
        ("band", "{:g} to {:g} kHz".format(*(KHZ * edge for edge in plans[0].band))),
        ("air", f"{settings.temperature:g} degC, {settings.air.sound_speed:.2f} m/s"),
        ("expected", (f"{time_in_words(sum(map(sum, costs)) / count)} on {count} workers; "
                     f"{len(plans) - len(todo)} of {len(plans)} indenters finished")),
    ])  # fmt: skip
    if not all(plan.settings.lossy for plan in plans):
        report.note(
            'losses = "off": near trapped modes the scattering is sharper than that of a tube, so '
            'that depths estimated with it are wrong; set losses = "on" to invert recordings'
        )
    failed: list[str] = []
    if todo:
        with watched_interrupts() as check, report.progress(check) as show:
            totals = {
                "press": (sum(map(len, parts)), sum(cost[0] for cost in costs)),
                "scattering": (int(USUAL_DEPTHS * sum(len(p.first) for p in todo)),
                               sum(cost[1] for cost in costs)),
            }  # fmt: skip
            board = Board(totals, count, show)
            tools = [
                _Builder(plan, own, folder, board, report, failed)
                for plan, own in zip(todo, parts, strict=True)
            ]
            try:
                first_tasks = [task for tool in tools for task in tool.press()]
                run_with_progress(first_tasks, board, workers=workers, executor=executor)
            except KeyboardInterrupt:
                raise KeyboardInterrupt(
                    "interrupted; presses and scattering matrices are in the cache, run the same "
                    "command again to go on"
                ) from None
    for reason in failed:
        report.failure(reason)
    report.line(f"Written to {folder} in {time_in_words(time.perf_counter() - started)}.")
    return not failed


def _cost(plan: ToolPlan, parts: Parts) -> tuple[float, float]:
    """Return the expected times in s of a tool's press and of its scattering matrices."""
    press = len(parts) * _part_cost(plan, parts)
    return press, USUAL_DEPTHS * len(plan.first) * spectral_seconds(plan.settings)


def _part_cost(plan: ToolPlan, parts: Parts) -> float:
    """Return the expected time in s of each part of a tool's press."""
    return press_seconds(plan.settings, parts[0][-1])


class _Builder:
    """Tasks of one tool: the parts of its press, its matrices level by level, and its file."""

    def __init__(
        self,
        plan: ToolPlan,
        parts: Parts,
        folder: Path,
        board: Board,
        report: Reporter,
        failed: list[str],
    ) -> None:
        self.plan, self.parts, self.folder = plan, parts, folder
        self.board, self.report = board, report
        self.failed, self.given_up = failed, False
        self.pressed: dict[int, PressRows] = {}
        self.path: DepthPath | None = None
        self.refinement = Refinement(plan.tolerance, plan.first)
        self.expected = int(USUAL_DEPTHS * len(plan.first))

    def press(self) -> list[Task]:
        """Return the tasks of the parts of the press."""
        return [self._part(number) for number in range(len(self.parts))]

    def _part(self, number: int) -> Task:
        """Return the task of a part of the press; the last one to end goes on."""
        cost = _part_cost(self.plan, self.parts)

        def then(done: Done[PressRows]) -> list[Task]:
            self.board.count("press", cost, reused=done.reused)
            self.pressed[number] = done.result
            if len(self.pressed) < len(self.parts):
                return []
            return self._sound(
                joined([self.pressed[i] for i in range(len(self.parts))], self.parts)
            )

        arguments = self.plan, self.parts[number]
        return Task(press_rows, arguments, then, self._failed("press", cost), cost)

    def _sound(self, press: PressRows) -> list[Task]:
        """Return the tasks that compute the scattering at the first depths of a press."""
        arrays, stopped = press
        reached = [d for d in self.plan.first if d <= arrays["depth"][-1] * (1 + 1e-9)]
        if stopped:
            last, wanted = MM * arrays["depth"][-1], MM * self.plan.pressed[-1]
            self.report.note(
                f"{self.plan.words}: the press ends at {last:.4g} of {wanted:.4g} mm; {stopped}"
            )
        if len(reached) < FEWEST_DEPTHS:
            return self._give_up(f"too few depths were reached ({stopped})")
        self.path = path_of(self.plan, arrays)
        self.refinement = Refinement(self.plan.tolerance, reached)
        return self._scatter(reached)

    def _scatter(self, depths: Sequence[float]) -> list[Task]:
        """Return the tasks that compute the scattering at one level of depths in m.

        The deepest come first. Near closure they take up to five times as long as others, for which
        the other workers would wait at the end of the level.
        """
        assert self.path is not None
        n, cost = self.board.totals["scattering"]
        short = len(self.refinement.known) + len(depths) - self.expected
        if short > 0:  # more depths than expected
            self.expected += short
            more = short * spectral_seconds(self.plan.settings)
            self.board.totals["scattering"] = (n + short, cost + more)
            self.board.left += more
        deepest_first = sorted(depths, reverse=True)
        return [self._matrix(d, pressed_part(self.path.at([d]))) for d in deepest_first]

    def _matrix(self, depth: float, part: Lumen) -> Task:
        cost = spectral_seconds(self.plan.settings)

        def then(done: Done[SpectralScattering | str]) -> list[Task]:
            self.board.count("scattering", cost, reused=done.reused)
            if isinstance(done.result, str):
                self.refinement.fail(depth, done.result)
            else:
                self.refinement.add(depth, done.result)
            return [] if self.refinement.waiting else self._go_on()

        arguments = self.plan, depth, part
        failed = self._failed("scattering", cost)
        return Task(scattering_at, arguments, then, failed, cost)

    def _go_on(self) -> list[Task]:
        """Return the tasks of the next level of depths; at the end write the tool."""
        depths = self.refinement.next()
        if depths:
            return self._scatter(depths)
        known = len(self.refinement.depths)
        if known < FEWEST_DEPTHS or not np.all(np.isfinite(self.refinement.between())):
            return self._give_up(self.refinement.reason)
        if self.refinement.reason:
            last = MM * self.refinement.depths[-1]
            self.report.note(f"{self.plan.words} ends at {last:.4g} mm: {self.refinement.reason}")
        files.write_tool(self.folder / self.plan.name, self._tool(), self.plan)
        self.board.left -= spectral_seconds(self.plan.settings) * max(
            self.expected - len(self.refinement.known), 0
        )
        return []

    def _tool(self) -> Tool:
        """Return the tool with its scattering at the computed depths."""
        assert self.path is not None
        settings, refinement = self.plan.settings, self.refinement
        depths = np.array(refinement.depths)
        found = [refinement.known[d] for d in refinement.depths]
        return Tool(
            shape=settings.indenter.shape, diameter=settings.indenter.diameter,
            radius=settings.radius, depth=depths, force=self.path.contact_force(depths),
            force_error=self.path.error(depths).contact_force,
            frequency=np.asarray(found[0].frequency, float), modes=found[0].modes,
            s=np.array([one.s for one in found], np.complex64),
            error=np.array([np.quantile(one.error, GOOD_SHARE) for one in found]),
            interpolation_error=refinement.between(), sound_speed=settings.air.sound_speed,
        )  # fmt: skip

    def _give_up(self, reason: str) -> list[Task]:
        """Report the tool as failed, once: its other tasks may fail too."""
        if not self.given_up:
            self.failed.append(f"{self.plan.words}: {reason}")
        self.given_up = True
        return []

    def _failed(self, stage: str, cost: float) -> Callable[[str], None]:
        def failed(reason: str) -> None:
            self.board.count(stage, cost)
            self._give_up(reason)

        return failed
