"""Computation of libraries: presses, then their scattering at depths refined by bisection.

A press is solved at depths some tenths of a millimetre apart. Shapes at depths between these are
interpolated, to an accuracy of micrometres. Scattering varies faster with depth than the shape
where a lumen has trapped modes, and is therefore computed at more depths. Its interpolation by
cubic splines over depth has an error that is estimated by leave-one-out cross-validation. Intervals
of depth in which this error is too large are bisected level by level.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

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
from acoustube.runs.costs import press_seconds, spectral_seconds
from acoustube.runs.libraries import files
from acoustube.runs.libraries.plan import ToolPlan
from acoustube.runs.sweep.progress import Board
from acoustube.runs.sweep.run import run_with_progress
from acoustube.runs.sweep.tasks import Done, one_thread
from acoustube.runs.sweep.workers import WORKERS, Task, Workers, count_of
from acoustube.waves.scattering import Complex
from acoustube.waves.spectral import SpectralScattering

GOOD_SHARE = 0.75
"""Fraction of the frequencies at which the estimated error of a matrix must be small. The estimate
leaves out losses, and is therefore far too large within half a kilohertz of a trapped mode."""
GAIN_OF_BISECTION = 6.0
"""Assumed factor by which bisection of an interval reduces the interpolation error of a cubic
spline; it is 16 for the smoothest functions."""
REACH = 8
"""Number of depths on each side of a left-out depth from which its scattering is interpolated."""
WIDEST_GAP = 1.6
"""Widest gap that failed depths may leave, relative to the largest step before bisection."""
FINEST = 1 / 32
"""Smallest step of depth, relative to the smallest step before bisection."""
USUAL_DEPTHS = 3.0
"""Ratio of final to first number of depths of a tool, for estimates of time."""


class PressRows(NamedTuple):
    """Arrays of a press, and the reason why it did not reach all depths; empty if it did."""

    arrays: dict[str, Array]
    stopped: str


def press_rows(plan: ToolPlan) -> Done[PressRows]:
    """Press a tube to the depths of a plan, or read the press from the cache."""
    reused = cache.holds(press_runs.cache_key(plan.settings, plan.pressed))
    try:
        found = press_runs.press_to(plan.settings, plan.pressed)
        return Done(PressRows(found.results, ""), reused)
    except PressError as error:
        return Done(PressRows(error.indentation.results, str(error)), reused)


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


class Refinement:
    """Scattering of a tool at the depths computed so far, and the depths that it lacks.

    Parameters
    ----------
    tolerance : float
        Largest expected error of interpolation, as :func:`deviation` measures it.
    first : sequence of float
        Depths in m to begin with.
    """

    def __init__(self, tolerance: float, first: Sequence[float]) -> None:
        self.tolerance, self.first = tolerance, first
        self.known: dict[float, SpectralScattering] = {}
        self.waiting: set[float] = set(first)
        self.failed: dict[float, str] = {}
        self.level: list[float] = []
        self.least = FINEST * min(np.diff(first))

    def add(self, depth: float, found: SpectralScattering) -> None:
        """Add the scattering at a depth in m."""
        self.known[depth] = found
        self.waiting.discard(depth)

    def fail(self, depth: float, reason: str) -> None:
        """Leave out a depth in m that cannot be computed."""
        self.failed[depth] = reason
        self.waiting.discard(depth)

    @property
    def depths(self) -> list[float]:
        """Rising depths in m computed so far, up to the first gap too wide to interpolate over."""
        depths = sorted(self.known)
        gaps = np.diff(depths)
        wide = np.flatnonzero(gaps > WIDEST_GAP * max(np.diff(self.first)))
        return depths[: wide[0] + 1] if len(wide) else depths

    @property
    def reason(self) -> str:
        """Reason why the depths end before the last requested one; empty if they do not."""
        last = max(self.depths, default=0.0)
        return next((self.failed[d] for d in sorted(self.failed) if d > last), "")

    def next(self) -> list[float]:
        """Return the depths in m of the next level of bisection; none at the end.

        To be called once all depths of the current level are known. The new depths are the middles
        of all intervals at first, then of those whose interpolation error exceeds the tolerance.
        """
        depths = self.depths
        if len(depths) < FEWEST_DEPTHS:
            return []
        error = self.between() if self.level else np.full(len(depths) - 1, np.inf)
        self.level = [
            round((a + b) / 2, 12)
            for (a, b), one in zip(itertools.pairwise(depths), error, strict=True)
            if one > self.tolerance and b - a > 1.5 * self.least
        ]
        self.level = [depth for depth in self.level if depth not in self.failed]
        self.waiting = set(self.level)
        return self.level

    def between(self) -> Array:
        """Return the expected error of interpolation between each depth and the next, (n - 1,).

        It is estimated by leave-one-out cross-validation; inf if there are too few depths. The
        error at a depth left out is taken as proportional to the product of the squared distances
        to its neighbours, the error in an interval to the fourth power of the interval's length.
        """
        depths = np.array(self.depths)
        known = np.array([self.known[d].s[:, :, :1, :, :1] for d in self.depths])
        steps = np.diff(depths)
        found = np.zeros(len(steps))
        for i in range(1, len(depths) - 1):
            near = np.arange(max(i - REACH, 0), min(i + REACH + 1, len(depths)))
            near = near[near != i]
            if len(near) < FEWEST_DEPTHS:
                return np.full(len(steps), np.inf)
            error = deviation(CubicSpline(depths[near], known[near])(depths[i]), known[i])
            beside = slice(i - 1, i + 1)
            scale = error / np.prod(steps[beside]) ** 2 / GAIN_OF_BISECTION
            found[beside] = np.maximum(found[beside], scale * steps[beside] ** 4)
        return found


def deviation(found: Complex, exact: Complex) -> float:
    """Return the error of a scattering matrix, (n_f, 2, m, 2, m), over the band.

    It is the larger of two: the rms error of the plane wave's reflection coefficient relative to
    the rms of this coefficient, and the rms error of its transmission coefficient.
    """
    plane = np.sqrt(np.mean(np.abs((found - exact)[:, :, 0, 0, 0]) ** 2, axis=0))
    return float(max(plane[0] / np.sqrt(np.mean(np.abs(exact[:, 0, 0, 0, 0]) ** 2)), plane[1]))


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
    costs = [_cost(plan) for plan in todo]
    first, settings = plans[0].first, plans[0].settings
    report.title("a library")
    report.rows([
        ("indenters", "\n".join(plan.words for plan in plans)),
        ("depths", (f"{MM * first[0]:g} to {MM * first[-1]:g} mm, "
                    f"{len(plans[0].pressed)} presses")),
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
                "press": (len(todo), sum(cost[0] for cost in costs)),
                "scattering": (int(USUAL_DEPTHS * sum(len(p.first) for p in todo)),
                               sum(cost[1] for cost in costs)),
            }  # fmt: skip
            board = Board(totals, count, show)
            tools = [_Builder(plan, folder, board, report, failed) for plan in todo]
            try:
                run_with_progress(
                    [t.press() for t in tools], board, workers=workers, executor=executor
                )
            except KeyboardInterrupt:
                raise KeyboardInterrupt(
                    "interrupted; presses and scattering matrices are in the cache, run the same "
                    "command again to go on"
                ) from None
    for reason in failed:
        report.failure(reason)
    report.line(f"Written to {folder} in {time_in_words(time.perf_counter() - started)}.")
    return not failed


def _cost(plan: ToolPlan) -> tuple[float, float]:
    """Return the expected times in s of a tool's press and of its scattering matrices."""
    matrix = spectral_seconds(plan.settings)
    return press_seconds(plan.settings, plan.pressed[-1]), USUAL_DEPTHS * len(plan.first) * matrix


class _Builder:
    """Tasks of one tool: its press, its matrices level by level, and its file."""

    def __init__(
        self, plan: ToolPlan, folder: Path, board: Board, report: Reporter, failed: list[str]
    ) -> None:
        self.plan, self.folder, self.board, self.report = plan, folder, board, report
        self.failed = failed
        self.path: DepthPath | None = None
        self.refinement = Refinement(plan.tolerance, plan.first)
        self.expected = int(USUAL_DEPTHS * len(plan.first))

    def press(self) -> Task:
        """Return the task of the press."""
        cost = press_seconds(self.plan.settings, self.plan.pressed[-1])

        def then(done: Done[PressRows]) -> list[Task]:
            self.board.count("press", cost, reused=done.reused)
            settings, (arrays, stopped) = self.plan.settings, done.result
            reached = [d for d in self.plan.first if d <= arrays["depth"][-1] * (1 + 1e-9)]
            if stopped:
                self.report.note(f"{self.plan.words}: {stopped}")
            if len(reached) < FEWEST_DEPTHS:
                return self._give_up(f"too few depths were reached ({stopped})")
            self.path = DepthPath(
                restored(
                    settings.tube, settings.indenter, arrays, support=settings.support,
                    layer=settings.layer, mesh=settings.mesh,
                )
            )  # fmt: skip
            self.refinement = Refinement(self.plan.tolerance, reached)
            return self._scatter(reached)

        return Task(press_rows, (self.plan,), then, self._failed("press", cost), cost)

    def _scatter(self, depths: Sequence[float]) -> list[Task]:
        """Return the tasks that compute the scattering at one level of depths in m."""
        assert self.path is not None
        n, cost = self.board.totals["scattering"]
        short = len(self.refinement.known) + len(depths) - self.expected
        if short > 0:  # more depths than expected
            self.expected += short
            more = short * spectral_seconds(self.plan.settings)
            self.board.totals["scattering"] = (n + short, cost + more)
            self.board.left += more
        return [self._matrix(d, pressed_part(self.path.at([d]))) for d in sorted(depths)]

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
        self.failed.append(f"{self.plan.words}: {reason}")
        return []

    def _failed(self, stage: str, cost: float) -> Callable[[str], None]:
        def failed(reason: str) -> None:
            self.board.count(stage, cost)
            self._give_up(reason)

        return failed
