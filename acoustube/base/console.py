"""Terminal output of computations: messages and progress."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from acoustube.base.errors import LONGEST_SENTENCE, readable
from acoustube.base.report import ShowProgress, TimeLeft, time_in_words
from acoustube.base.version import __version__

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress, TaskID
    from rich.text import Text

REPORT_INTERVAL, LONGEST_INTERVAL = 10.0, 60.0
"""Seconds between two lines of progress without a terminal: at first, and after 10 min."""


def plain_console(*, quiet: bool = False, stderr: bool = False) -> Console:
    """Return a console on which every string is plain text: no markup, no control characters.

    Strings contain what users supply: names of files, values, contents of files. Coloured text is
    passed as objects of rich.

    Parameters
    ----------
    quiet : bool
        Nothing is printed.
    stderr : bool
        Standard error instead of standard output.
    """
    return _plain_console()(quiet=quiet, stderr=stderr)


@cache
def _plain_console() -> type[Console]:
    from rich.console import Console  # slow to import

    class Plain(Console):
        def render_str(self, text: str, **options: Any) -> Text:
            return super().render_str(readable(text), **options | {"markup": False, "emoji": False})

        def on_broken_pipe(self) -> None:
            """Discard further messages after a broken pipe; files are still written."""
            self.quiet = True
            with Path(os.devnull).open("w") as nowhere:
                os.dup2(nowhere.fileno(), self.file.fileno())

    return Plain


def note(console: Console, text: str) -> None:
    """Print a note, such as a result outside the model's range, as one line."""
    _labelled(console, "yellow", "note", text)


def _labelled(console: Console, colour: str, label: str, text: str) -> None:
    from rich.text import Text

    one_line = readable(text.replace("\n", "\\n"), LONGEST_SENTENCE)  # from file names
    console.print(Text.assemble((f"{label}:", colour), " ", one_line), soft_wrap=True)


def failure(text: str, label: str = "failed") -> None:
    """Print an error message on standard error, as one line."""
    _labelled(plain_console(stderr=True), "red", label, text)


class ConsoleReporter:
    """Reporter that prints on a rich console (:class:`acoustube.base.report.Reporter`).

    Parameters
    ----------
    console : rich.console.Console
        Failures are printed on standard error instead, also if the console is quiet.
    """

    def __init__(self, console: Console) -> None:
        self.console = console

    def title(self, text: str) -> None:
        """Print the program, its version, and the task that begins."""
        self.console.print(f"acoustube {__version__}: {text}", highlight=False)

    def line(self, text: str) -> None:
        """Print a sentence."""
        self.console.print(text, soft_wrap=True, markup=False)

    def note(self, text: str) -> None:
        """Print a note."""
        note(self.console, text)

    def failure(self, text: str) -> None:
        """Print a failure on standard error."""
        failure(text)

    def rows(self, rows: Sequence[tuple[str, str]]) -> None:
        """Print a table of names and values."""
        from rich.table import Table

        table = Table(show_header=False, box=None, pad_edge=False)
        for row in rows:
            table.add_row(*row)
        self.console.print(table)

    @contextmanager
    def progress(self, check: Callable[[], None] = lambda: None) -> Iterator[ShowProgress]:
        """Yield a function that shows a bar for each stage, or lines without a terminal."""
        with _display(self.console) as display:

            def show(stage: str, done: float, total: float = 1.0, left: str | None = None) -> None:
                check()
                display.show(stage, done, total, left)

            yield show


@contextmanager
def _display(console: Console) -> Iterator[_Lines]:
    """Yield a progress display: bars on a terminal, lines elsewhere."""
    if not console.is_terminal:
        yield _Lines(console)
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    texts = ("{task.description:12}", "{task.fields[amount]:>8}", "{task.fields[left]}")
    stage, amount, left = (TextColumn(text, markup=False) for text in texts)
    columns = (stage, BarColumn(), amount, TimeElapsedColumn(), left)
    with Progress(*columns, console=console, transient=True) as bars:
        yield _Bars(console, bars)


class _Lines:
    """Progress display of occasional lines, rarer the longer the work takes."""

    def __init__(self, console: Console) -> None:
        self.console = console
        self.started = self.last = time.perf_counter()
        self.unfinished: dict[str, tuple[str, str]] = {}
        self.times: dict[str, TimeLeft] = {}

    def show(self, stage: str, done: float, total: float, left: str | None) -> None:
        """Show the progress of a stage; parameters as for :class:`ShowProgress`."""
        now = time.perf_counter()
        seconds = self.times.setdefault(stage, TimeLeft()).update(now, done / max(total, 1e-9))
        if left is None:
            left = "" if seconds is None else f"{time_in_words(seconds)} left"
        amount = f"{100 * done:.0f} %" if total == 1 else f"{done:g} of {total:g}"
        self._draw(stage, done, total, amount, left if done < total else "")

    def _draw(self, stage: str, done: float, total: float, amount: str, left: str) -> None:
        now = time.perf_counter()
        if done >= total:
            self.unfinished.pop(stage, None)
            return
        self.unfinished[stage] = f"{stage} {amount}", left
        interval = min(max(REPORT_INTERVAL, 0.1 * (now - self.started)), LONGEST_INTERVAL)
        if now - self.last > interval:
            self.last = now
            amounts, times = zip(*self.unfinished.values(), strict=True)
            left = next((f"; {left}" for left in reversed(times) if left), "")
            self.console.print(", ".join(amounts) + left, soft_wrap=True)


class _Bars(_Lines):
    """Progress display of one bar for each stage, on a terminal."""

    def __init__(self, console: Console, bars: Progress) -> None:
        super().__init__(console)
        self.bars = bars
        self.rows: dict[str, TaskID] = {}

    def _draw(self, stage: str, done: float, total: float, amount: str, left: str) -> None:
        if stage not in self.rows:
            self.rows[stage] = self.bars.add_task(readable(stage), total=total, amount="", left="")
        self.bars.update(self.rows[stage], completed=done, total=total, amount=amount, left=left)
