"""Progress of a sweep, stage by stage, and the time left from expected and measured times."""

from __future__ import annotations

import time
from collections.abc import Sequence

from acoustube.base.report import ShowProgress, time_in_words
from acoustube.runs.sweep.costs import case_cost, matrix_cost, path_cost
from acoustube.runs.sweep.graph import LoadPath

PRIOR_SECONDS = 60.0
"""Expected time in s of finished tasks at which measured and expected times have equal weight."""


# Number of the tasks of each stage, and their total expected time in s.
Totals = dict[str, tuple[int, float]]


class Board:
    """Finished and remaining tasks of each stage of a sweep, and the time left.

    Parameters
    ----------
    totals : dict of str to (int, float)
        Number of the tasks of each stage, and their total expected time in s.
    workers : int
        Number of tasks that run at the same time.
    show : callable
        See :class:`acoustube.base.report.ShowProgress`.
    """

    def __init__(self, totals: Totals, workers: int, show: ShowProgress) -> None:
        self.workers = workers
        self.totals = totals
        self.done = dict.fromkeys(totals, 0)
        self.left = sum(cost for _, cost in totals.values())
        self.spent, self.started = 0.0, time.perf_counter()
        self.counted = self.started
        self.show = show

    def count(self, stage: str, cost: float, n: int = 1, *, reused: bool = False) -> None:
        """Count finished tasks.

        Parameters
        ----------
        stage : str
            A stage of `totals`.
        cost : float
            Expected time of these tasks in s.
        n : int
            Number of these tasks.
        reused : bool
            Whether the results were cached, so that the tasks give no information on the speed.
        """
        self.done[stage] += n
        self.left -= cost
        self.spent += 0.0 if reused else cost
        self.counted = time.perf_counter()
        self.tick()

    def tick(self) -> None:
        """Show all stages; called while tasks run."""
        stages = [stage for stage, (n, _) in self.totals.items() if n]
        for stage in stages:
            left = self._time_left(time.perf_counter()) if stage == stages[-1] else ""
            self.show(stage, self.done[stage], self.totals[stage][0], left)

    def _time_left(self, now: float) -> str:
        """Return the expected time left in words.

        The expected time is scaled by the ratio of measured to expected time up to the last
        finished task. Until the next task is finished it decreases with time, to half at most.
        """
        measured = self.counted - self.started
        scale = (measured + PRIOR_SECONDS) / (self.spent / self.workers + PRIOR_SECONDS)
        left = max(self.left, 0.0) / self.workers * scale
        return f"{time_in_words(max(left - (now - self.counted), left / 2))} left"


def totals_of(paths: Sequence[LoadPath]) -> Totals:
    """Return the number of tasks of each stage of a sweep, and their total expected time in s."""
    groups = [group for path in paths for group in path.groups]
    pressed = [path for path in paths if path.presses]
    matrices = [group for group in groups if group.band is not None]
    return {
        "load paths": (len(pressed), sum(map(path_cost, pressed))),
        "scattering": (len(matrices), sum(map(matrix_cost, matrices))),
        "cases": (
            sum(len(group.cases) for group in groups),
            sum(case_cost(group.cases) for group in groups),
        ),
    }
