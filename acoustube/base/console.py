"""What a person sees of work that goes on: its progress, notes, and how it is interrupted."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

if TYPE_CHECKING:
    from acoustube.base.types import Report

REPORT_INTERVAL = 10.0
"""Seconds between two lines of progress where there is no terminal."""


def note(console: Console, text: str) -> None:
    """Print what the reader of a result should know, on a line."""
    console.print(f"[yellow]note:[/] {escape(text)}", soft_wrap=True)


@contextmanager
def heard_interrupts() -> Iterator[Callable[[], None]]:
    """Yield a check that repeats an interrupt which was lost.

    JAX has a hook in Python's garbage collection, where an exception is printed and ignored.
    """
    heard: list[int] = []

    def interrupt(number: int, _frame: object) -> None:
        heard.append(number)
        raise KeyboardInterrupt

    def check() -> None:
        if heard:
            raise KeyboardInterrupt

    numbers = [
        number
        for number in (signal.SIGINT, signal.SIGTERM)
        if threading.current_thread() is threading.main_thread()
        and signal.getsignal(number) is signal.default_int_handler
    ]
    for number in numbers:
        signal.signal(number, interrupt)
    try:
        yield check
    finally:
        for number in numbers:
            signal.signal(number, signal.default_int_handler)


@contextmanager
def stage_progress(console: Console, check: Callable[[], None]) -> Iterator[Report]:
    """Yield a function that shows a bar per stage, or a line now and then without a terminal.

    Parameters
    ----------
    console : rich.console.Console
    check : callable
        From :func:`heard_interrupts`; called with each report.
    """
    if not console.is_terminal:
        line = _lines(console)

        def report_line(stage: str, fraction: float) -> None:
            check()
            line(stage, fraction)

        yield report_line
        return
    columns = (
        TextColumn("{task.description:12}"),
        BarColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bars:
        tasks: dict[str, TaskID] = {}

        def report(stage: str, fraction: float) -> None:
            check()
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=1.0)
            bars.update(tasks[stage], completed=fraction)

        yield report


def _lines(console: Console) -> Report:
    """Return a function that prints a line now and then."""
    start = last = time.perf_counter()
    stage_now = ""

    def report(stage: str, fraction: float) -> None:
        nonlocal start, last, stage_now
        now = time.perf_counter()
        if stage != stage_now:
            stage_now, start, last = stage, now, now
        elif now - last > REPORT_INTERVAL and 0 < fraction < 1:
            left = (now - start) * (1 - fraction) / fraction
            console.print(f"{stage} {100 * fraction:.0f} %, {left:.0f} s left")
            last = now

    return report
