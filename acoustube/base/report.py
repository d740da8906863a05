"""Reports of work in progress: the interface between computations and their display.

Computations print nothing. They call a :class:`Reporter`; the command line passes one that prints
(:class:`acoustube.base.console.ConsoleReporter`), Python code may pass its own or none.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Protocol

WINDOW = 8
"""Number of latest changes of the finished fraction from which the time left is extrapolated."""


class ShowProgress(Protocol):
    """Function that shows the progress of a stage.

    Parameters
    ----------
    stage : str
        Name of the stage.
    done : float
        Finished part of `total`.
    total : float
        1 for a fraction, otherwise a number of tasks.
    left : str, optional
        Time left, in words; extrapolated from the recent changes of `done` if not given.
    """

    def __call__(
        self, stage: str, done: float, total: float = 1.0, left: str | None = None
    ) -> None:
        """Show the progress of a stage."""


class Reporter(Protocol):
    """Receiver of the messages and the progress of a computation."""

    def title(self, text: str) -> None:
        """Receive the name of a computation that begins."""

    def line(self, text: str) -> None:
        """Receive a sentence about settings or results."""

    def note(self, text: str) -> None:
        """Receive a sentence on the validity of a result."""

    def failure(self, text: str) -> None:
        """Receive a sentence about a part that failed."""

    def rows(self, rows: Sequence[tuple[str, str]]) -> None:
        """Receive a table of names and values."""

    def progress(self, check: Callable[[], None] = ...) -> AbstractContextManager[ShowProgress]:
        """Return a context manager that yields a function to report progress to.

        Parameters
        ----------
        check : callable
            Called at each report of progress, to raise an interrupt that was lost.
        """


class Silent:
    """Reporter that discards everything."""

    def title(self, text: str) -> None:
        """Do nothing: this reporter shows no titles."""

    line = note = failure = title

    def rows(self, rows: Sequence[tuple[str, str]]) -> None:
        """Discard a table."""

    def progress(
        self, check: Callable[[], None] = lambda: None
    ) -> AbstractContextManager[ShowProgress]:
        """Return a context manager that yields a function which only calls `check`."""

        def show(*_progress: object, **_words: object) -> None:
            check()

        return nullcontext(show)


SILENT = Silent()


def ignore(*_progress: object) -> None:
    """Discard progress."""


def part_of(
    progress: Callable[[float], None] | None, start: float, end: float
) -> Callable[[float], None] | None:
    """Return the progress function of a part of the work.

    Parameters
    ----------
    progress : callable or None
        Called with the finished fraction of the whole.
    start, end : float
        Finished fraction of the whole at the start and at the end of the part.

    Returns
    -------
    callable or None
        To be called with the finished fraction of the part; None if `progress` is None.
    """
    if progress is None:
        return None
    return lambda fraction: progress(start + (end - start) * fraction)


class TimeLeft:
    """Extrapolation of the time left from the recent rate of a fraction.

    The time up to the first change of the fraction is left out: a compiler or the import of a
    library takes most of it. There is no estimate before the second change.
    """

    def __init__(self) -> None:
        self.changes: deque[tuple[float, float]] = deque(maxlen=WINDOW)

    def update(self, now: float, fraction: float) -> float | None:
        """Return the time left in s, or None while it is unknown.

        Parameters
        ----------
        now : float
            Time in s, by any monotonic clock.
        fraction : float
            Finished fraction of the work.
        """
        if fraction > (self.changes[-1][1] if self.changes else 0.0):
            self.changes.append((now, fraction))
        if len(self.changes) < 2:
            return None
        (begin, low), (end, high) = self.changes[0], self.changes[-1]
        left = (1 - high) * (end - begin) / (high - low)
        return max(left - (now - end), 0.0)


def counted(number: int, noun: str) -> str:
    """Return a number and its noun, such as ``1 case`` or ``3 cases``."""
    ending = "es" if noun.endswith("s") else "s"
    return f"{number} {noun}" if number == 1 else f"{number} {noun}{ending}"


def time_in_words(seconds: float) -> str:
    """Return a duration in words, such as ``12 s``, ``5 min`` or ``1.5 h``."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    if seconds < 5400:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.3g} h"
