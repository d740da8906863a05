"""Progress, messages and interrupts of computations that a command shows."""

import importlib
import os
import signal
import sys
import threading
import time
from io import StringIO

import pytest
from rich.console import Console

from acoustube.base import console as base_console
from acoustube.base.console import ConsoleReporter
from acoustube.base.interrupts import watched_interrupts
from acoustube.base.report import SILENT, TimeLeft, time_in_words
from acoustube.runs.sweep import progress


class Clock:
    """A clock that the test sets."""

    def __init__(self, monkeypatch):
        self.now = 0.0
        monkeypatch.setattr(base_console.time, "perf_counter", lambda: self.now)


def test_time_left_of_a_steady_rate_is_exact_after_a_slow_compiler():
    """After 20 s of compilation ten steps take 1 s each: no estimate exceeds ten seconds."""
    left, times = TimeLeft(), []
    times.append(left.update(0.0, 0.0))
    times.append(left.update(10.0, 0.0))
    times.extend(left.update(20.0 + step, step / 10) for step in range(1, 11))
    assert times[:3] == [None, None, None]
    assert times[3:] == pytest.approx([8, 7, 6, 5, 4, 3, 2, 1, 0])


def test_time_left_runs_down_between_two_changes_and_follows_the_recent_rate():
    left = TimeLeft()
    for step in range(1, 31):
        left.update(10.0 * step, step / 100)
    assert left.update(303.0, 0.3) == pytest.approx(697.0)
    for step in range(1, 21):  # ten times as fast from here on
        found = left.update(300.0 + step, 0.3 + step / 100)
    assert found == pytest.approx(50.0)
    assert left.update(1e4, 0.5) == 0.0


@pytest.mark.parametrize(
    ("seconds", "words"), [(0.4, "0 s"), (89, "89 s"), (91, "2 min"), (5400, "1.5 h")]
)
def test_durations_in_words(seconds, words):
    assert time_in_words(seconds) == words


def test_lines_come_every_ten_seconds_and_start_without_a_time_left(monkeypatch):
    clock, text = Clock(monkeypatch), StringIO()
    with ConsoleReporter(Console(file=text, width=200)).progress() as show:
        for second in range(60):
            clock.now = float(second)
            show("waves", max(0, second - 20) / 60)
    lines = text.getvalue().splitlines()
    assert lines[:2] == ["waves 0 %", "waves 3 %; 58 s left"]
    assert len(lines) == 5


def test_lines_become_rarer_in_work_of_hours(monkeypatch):
    clock, text = Clock(monkeypatch), StringIO()
    with ConsoleReporter(Console(file=text, width=200)).progress() as show:
        for second in range(36_000):
            clock.now = float(second)
            show("load paths", 3, 7, "")
            show("cases", 5, 100, "3 h left")
    lines = text.getvalue().splitlines()
    assert lines[-1] == "load paths 3 of 7, cases 5 of 100; 3 h left"
    assert 590 < len(lines) < 650


def test_finished_stages_and_quiet_consoles_print_nothing(monkeypatch):
    clock, text = Clock(monkeypatch), StringIO()
    with ConsoleReporter(Console(file=text, quiet=True)).progress() as show:
        clock.now = 20.0
        show("waves", 0.5)
    with ConsoleReporter(Console(file=text)).progress() as show:
        clock.now = 40.0
        show("waves", 1.0)
    assert text.getvalue() == ""


def test_terminal_has_a_bar_for_each_stage():
    text = StringIO()
    terminal = Console(file=text, force_terminal=True, width=100)
    with ConsoleReporter(terminal).progress() as show:
        show("wall", 0.25)
        show("cases", 3, 7, "5 min left")
    for part in ("wall", "25 %", "cases", "3 of 7", "5 min left"):
        assert part in text.getvalue()


@pytest.mark.parametrize("reporter", [SILENT, ConsoleReporter(Console(file=StringIO()))])
def test_progress_repeats_a_lost_interrupt(reporter):
    def check():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), reporter.progress(check) as show:
        show("waves", 0.1)


def test_messages_are_printed_as_they_are_and_failures_also_when_quiet(capsys):
    for quiet in (False, True):
        reporter = ConsoleReporter(Console(quiet=quiet, width=200))
        reporter.title("a sweep")
        reporter.line("written to [folder]")
        reporter.note("a [note]")
        reporter.rows([("cases", "3")])
        reporter.failure("case [1]")
        out, err = capsys.readouterr()
        assert err == "failed: case [1]\n"
        if quiet:
            assert out == ""
        else:
            assert out.startswith("acoustube ")
            assert out.endswith(": a sweep\nwritten to [folder]\nnote: a [note]\ncases  3\n")


def interrupts_after(*delays):
    """Interrupt this process after each of some delays in s."""
    for delay in delays:
        threading.Timer(delay, os.kill, [os.getpid(), signal.SIGINT]).start()


@pytest.mark.parametrize("delays", [(0.1,), (0.1, 0.15)], ids=["once", "twice"])
def test_interrupt_waits_for_an_import_and_comes_once(delays, tmp_path, monkeypatch):
    (tmp_path / "slow_to_load.py").write_text(
        "import time\ntime.sleep(0.3)\ntime.sleep(0.2)\nDONE = True\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    before = signal.getsignal(signal.SIGINT)
    begun = time.perf_counter()
    with pytest.raises(KeyboardInterrupt), watched_interrupts():
        interrupts_after(*delays)
        importlib.import_module("slow_to_load")
        time.sleep(5)
    assert 0.45 < time.perf_counter() - begun < 3
    assert sys.modules.pop("slow_to_load").DONE
    assert signal.getsignal(signal.SIGINT) is before
    time.sleep(0.2)  # the second one was merged with the first


def test_interrupt_outside_imports_comes_at_once_and_a_lost_one_again():
    with watched_interrupts(), watched_interrupts() as check:
        interrupts_after(0.1)
        begun = time.perf_counter()
        with pytest.raises(KeyboardInterrupt):
            time.sleep(5)
        assert time.perf_counter() - begun < 2
        with pytest.raises(KeyboardInterrupt):
            check()


class Unfinished:
    """An object whose destructor fails, as after an interrupted construction."""

    def __del__(self) -> None:
        raise AttributeError("unfinished")


def test_errors_of_destructors_are_reported_until_an_interrupt(monkeypatch):
    told = []
    monkeypatch.setattr(sys, "unraisablehook", told.append)
    with watched_interrupts():
        Unfinished()
        assert len(told) == 1
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        Unfinished()
        assert len(told) == 1
    Unfinished()
    assert len(told) == 2


def test_time_left_of_a_sweep_falls_while_its_first_tasks_run(monkeypatch):
    """Four tasks of 100 s on two workers, none of which has ended: 200 s, then never more."""
    clock, said = Clock(monkeypatch), []
    monkeypatch.setattr(progress.time, "perf_counter", lambda: clock.now)
    board = progress.Board({"cases": (4, 400.0)}, 2, lambda *given: said.append(given[-1]))
    for now in (0.0, 30.0, 80.0, 150.0):
        clock.now = now
        board.tick()
    assert said == ["3 min left", "3 min left", "2 min left", "2 min left"]
    clock.now = 160.0  # 1.6 times as long as expected, damped by PRIOR_SECONDS at the expected rate
    board.count("cases", 200.0, 2)
    scale = (160 + progress.PRIOR_SECONDS) / (100 + progress.PRIOR_SECONDS)
    assert said[-1] == f"{time_in_words(100 * scale)} left"
