"""How far a sweep is: bars on a terminal, a line a minute elsewhere."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
)

from acoustube.runs.sweep.costs import hear_cost, in_words, matrix_cost, path_cost
from acoustube.runs.sweep.graph import Descent

INTERVAL = 60.0
"""Seconds between two lines of progress where there is no terminal."""
TRUSTED = 60.0
"""Seconds of work after which what was measured counts as much as what was expected."""


# Number and cost in seconds of the tasks of each stage.
Totals = dict[str, tuple[int, float]]


class Board:
    """How far a sweep is, stage by stage, and how long it will take."""

    def __init__(self, totals: Totals, workers: int, console: Console) -> None:
        self.workers = workers
        self.totals = totals
        self.done = dict.fromkeys(totals, 0)
        self.left = sum(cost for _, cost in totals.values())
        self.spent, self.started, self.last = 0.0, time.perf_counter(), time.perf_counter()
        self.console = console
        self.bars: Progress | None = None
        self.rows: dict[str, TaskID] = {}

    def count(self, stage: str, cost: float, n: int = 1, *, reused: bool = False) -> None:
        """Count what is done."""
        self.done[stage] += n
        self.left -= cost
        self.spent += 0.0 if reused else cost
        if self.bars is not None:
            self.bars.update(self.rows[stage], completed=self.done[stage])

    def tick(self) -> None:
        """Print a line now and then where there is no terminal."""
        now = time.perf_counter()
        if self.bars is not None:
            self.bars.update(list(self.rows.values())[-1], left=self._left(now))
        elif now - self.last > INTERVAL:
            self.last = now
            stages = [f"{s} {self.done[s]} of {n}" for s, (n, _) in self.totals.items() if n]
            self.console.print(f"{', '.join(stages)}; {self._left(now)}", soft_wrap=True)

    def _left(self, now: float) -> str:
        """Return the time left: what was expected, and how far that was off so far."""
        off = (now - self.started + TRUSTED) / (self.spent / self.workers + TRUSTED)
        return f"{in_words(max(self.left, 0.0) / self.workers * off)} left"


def totals_of(paths: Sequence[Descent]) -> Totals:
    """Return how many tasks each stage of a sweep has, and their cost in seconds."""
    groups = [group for path in paths for group in path.groups]
    pressed = [path for path in paths if path.presses]
    matrices = [group for group in groups if group.band is not None]
    return {
        "path": (len(pressed), sum(map(path_cost, pressed))),
        "scattering": (len(matrices), sum(map(matrix_cost, matrices))),
        "cases": (
            sum(len(group.cases) for group in groups),
            sum(hear_cost(group.cases) for group in groups),
        ),
    }


@contextmanager
def progress_board(totals: Totals, workers: int, console: Console) -> Iterator[Board]:
    """Yield the board of a run, with a bar for each stage on a terminal."""
    board = Board(totals, workers, console)
    if not console.is_terminal:
        yield board
        return
    columns = (
        TextColumn("{task.description:12}"), BarColumn(), MofNCompleteColumn(),
        TimeElapsedColumn(), TextColumn("{task.fields[left]}"),
    )  # fmt: skip
    with Progress(*columns, console=console, transient=True) as bars:
        board.bars = bars
        board.rows = {
            stage: bars.add_task(stage, total=n, left="") for stage, (n, _) in totals.items() if n
        }
        yield board
