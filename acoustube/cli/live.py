"""The command ``acoustube live``: a board on a serial line, its cycles as they come.

A thread reads the line and decodes it
(:class:`acoustube.recordings.echotube_stream.Receiver`); the main thread processes, logs and shows.
"""

from __future__ import annotations

import contextlib
import csv
import os
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from rich.console import Console
from rich.live import Live
from rich.panel import Panel

from acoustube import signals
from acoustube.base.console import REPORT_INTERVAL, watched_interrupts
from acoustube.base.errors import ConfigError, SimulationError
from acoustube.recordings.echotube_stream import (
    FRAME_BYTES,
    HEAD,
    MISSING,
    PATIENCE,
    Decoder,
    Frame,
    Receiver,
)
from acoustube.runs.recordings import COLUMNS, check_rate, chosen, table_rows
from acoustube.signals import Ranging, Tracker

RATE = 80e3
"""Samples per second of EchoTube's board."""
BAUD = 1_000_000
REFRESH = 0.1
"""Seconds between two pictures in a terminal."""
RECENT = 2000
"""Latencies that are remembered."""
BARS, FLOOR_DB, TRACE = " ▁▂▃▄▅▆▇█", -40.0, 60
"""Of the trace: its characters, the level of the lowest, and its width."""
LIVE_COLUMNS = (*COLUMNS, "received_s", "pulse_width")


@dataclass(kw_only=True)
class Tally:
    """What became of a stream.

    Attributes
    ----------
    n_cycles, n_detections : int
        Processed cycles, and how many of them held an echo.
    n_garbled, n_joined, n_bytes : int
        See :class:`acoustube.recordings.echotube_stream.Decoder`.
    n_dropped : int
        Intact cycles for which there was no time.
    arrivals : deque of float
        When the last cycles came, by `time.perf_counter`.
    latencies : deque of float
        Seconds from the last byte of a cycle to its row in the log, of the last cycles.
    """

    n_cycles: int = 0
    n_detections: int = 0
    n_garbled: int = 0
    n_joined: int = 0
    n_bytes: int = 0
    n_dropped: int = 0
    arrivals: deque[float] = field(default_factory=lambda: deque(maxlen=40))
    latencies: deque[float] = field(default_factory=lambda: deque(maxlen=RECENT))

    @property
    def rate(self) -> float:
        """Cycles per second over the last ones, zero when none has come for two seconds."""
        if len(self.arrivals) < 2 or time.perf_counter() - self.arrivals[-1] > 2:
            return 0.0
        return (len(self.arrivals) - 1) / max(self.arrivals[-1] - self.arrivals[0], 1e-6)

    @property
    def latency(self) -> float:
        """Median in s, nan before the first cycle."""
        return float(np.median(self.latencies)) if self.latencies else np.nan

    def words(self) -> str:
        """Return the counts as a line."""
        if not self.n_cycles:
            missing = f"no intact cycle in {self.n_bytes} bytes, {self.n_garbled} garbled"
            return missing + ("; check the baud rate and the board" if self.n_bytes else "")
        return (
            f"{self.n_cycles} cycles at {self.rate:.1f}/s, echoes in {self.n_detections}, "
            f"{self.n_garbled} garbled, {self.n_dropped} dropped, latency "
            f"{1e3 * self.latency:.1f} ms" + (", joined in the middle" if self.n_joined else "")
        )


def run_live(
    port: str,
    console: Console,
    *,
    calibration: str | None = None,
    prominence: float | None = None,
    temperature: float = 20.0,
    rate: float = RATE,
    frame_bytes: int = FRAME_BYTES,
    baud: int = BAUD,
    out: Path | None = None,
    duration: float | None = None,
) -> Tally:
    """Process what a board sends until the line ends, the time is over or the user interrupts.

    Parameters
    ----------
    port : str
        Name of the serial port.
    console : rich.console.Console
        Where to show the cycles: a panel in a terminal, else a line every 10 s.
    calibration, prominence
        See :func:`acoustube.cli.process.run_process`.
    temperature : float
        Of the air in degC.
    rate : float
        Samples per second. Where the carrier does not lie below half of it, as with EchoTube's
        80 kHz, the cycles are processed without the matched filter and good to several mm:
        :func:`acoustube.signals.without_aliased_template`.
    frame_bytes : int
        See :class:`acoustube.recordings.echotube_stream.Decoder`.
    baud : int
        Bits per second of the line.
    out : Path, optional
        A new CSV file, one row of :data:`LIVE_COLUMNS` per cycle, on the disk with each cycle:
        `received_s` is the Unix time of a cycle's last byte in s, by the clock at the start, and
        `pulse_width` the rangefinder's own in us.
    duration : float, optional
        In s.

    Returns
    -------
    Tally

    Raises
    ------
    ConfigError
        If the calibration or the port cannot be used.
    SimulationError
        If the line is cut. What was received whole is processed and logged.
    KeyboardInterrupt
        With a sentence that says what is kept.
    """
    tracker = _tracker(Path(port), calibration, prominence, temperature, rate, frame_bytes)
    decoder, tally = Decoder(frame_bytes), Tally()
    ranging: Ranging | None = None
    # One reference for the whole run, so that an adjusted clock leaves the intervals as they are.
    epoch = time.time() - time.perf_counter()
    kept = "nothing is logged" if out is None else f"{out} holds them"
    with watched_interrupts() as check, _opened(port, baud) as line, _log(out) as log:
        try:
            with Receiver(line, decoder) as receiver, _shown(console, port) as show:
                for received, frame in _taken(receiver, duration, check):
                    if frame is not None:
                        ranging = tracker.update(frame.samples, temperature)
                        log(_row(tracker.n_cycles - 1, ranging, port, received + epoch, frame))
                        tally.arrivals.append(received)
                        tally.latencies.append(time.perf_counter() - received)
                    _count(tally, tracker, decoder, receiver)
                    show(tally, ranging)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"interrupted; {tally.words()}; {kept}") from None
    console.print(tally.words(), soft_wrap=True)
    if isinstance(receiver.failure, OSError):
        raise SimulationError(
            f"{port} was cut off after {tracker.n_cycles} intact cycles, {kept}; connect the board "
            "and start again"
        ) from receiver.failure
    if receiver.failure is not None:
        raise receiver.failure
    return tally


def _tracker(
    port: Path,
    calibration: str | None,
    prominence: float | None,
    temperature: float,
    rate: float,
    frame_bytes: int,
) -> Tracker:
    """Return the processing of the board's cycles, tried with a silent one."""
    known, how = chosen(calibration, prominence)
    check_rate(rate, known, port)
    how = signals.without_aliased_template(how, rate)
    try:
        # The first samples gave their place to the pulse width.
        tracker = Tracker(np.arange(HEAD, frame_bytes) / rate, how)
        signals.speed_of_sound(temperature)
    except ValueError as error:
        raise ConfigError(f"cycles like these cannot be processed: {error}") from error
    return tracker


@contextlib.contextmanager
def _opened(port: str, baud: int) -> Iterator[Any]:
    """Yield a serial port, or say why it cannot be."""
    try:
        import serial
    except ImportError as error:
        raise ConfigError(MISSING) from error
    try:
        line = serial.Serial(port, baud, timeout=PATIENCE, exclusive=True)
    except (OSError, ValueError) as error:
        number = getattr(error, "errno", None)
        reason = os.strerror(number) if number else error
        raise ConfigError(
            f"port = {port} cannot be opened ({reason}); name the board's port, free and readable"
        ) from error
    with contextlib.closing(line):
        yield line


@contextlib.contextmanager
def _log(out: Path | None) -> Iterator[Callable[[list[object]], None]]:
    """Yield a function that writes a row to a new file, at once."""
    if out is None:
        yield lambda _: None
        return
    try:
        file: TextIO = out.open("x", encoding="utf-8", newline="")
    except OSError as error:
        raise ConfigError(
            f"out = {out} cannot be written ({error.strerror}); name a new file"
        ) from error
    with file:
        writer = csv.writer(file, lineterminator="\n")

        def write(row: list[object]) -> None:
            writer.writerow(row)
            file.flush()

        write([*LIVE_COLUMNS])
        yield write


def _taken(
    receiver: Receiver, duration: float | None, check: Callable[[], None]
) -> Iterator[tuple[float, Frame | None]]:
    """Yield the cycles with their times, and now and then None, until the end of line or time."""
    end = np.inf if duration is None else time.perf_counter() + duration
    while True:
        check()
        timed_out = time.perf_counter() > end
        if timed_out:
            receiver.stop()
        # Asked before the queue: what came before the end is in it.
        ended = timed_out or receiver.failure is not None
        taken = receiver.take()
        if taken is not None:
            yield taken
        elif ended:
            return
        else:
            yield time.perf_counter(), None


def _row(number: int, ranging: Ranging, port: str, received: float, frame: Frame) -> list[object]:
    """Return the log's row of a cycle that was received at a Unix time in s."""
    (row,) = table_rows(number, ranging, Path(port))
    return [*row, f"{received:.6f}", frame.pulse_width]


def _count(tally: Tally, tracker: Tracker, decoder: Decoder, receiver: Receiver) -> None:
    tally.n_cycles, tally.n_detections = tracker.n_cycles, tracker.n_detections
    tally.n_garbled, tally.n_joined = decoder.n_garbled, decoder.n_joined
    tally.n_bytes, tally.n_dropped = decoder.n_bytes, receiver.n_dropped


@contextlib.contextmanager
def _shown(console: Console, port: str) -> Iterator[Callable[[Tally, Ranging | None], None]]:
    """Yield a function that shows the last cycle now and then: a panel, or lines elsewhere."""
    in_place = console.is_terminal and not console.quiet
    interval = REFRESH if in_place else REPORT_INTERVAL
    before = time.perf_counter()
    with contextlib.ExitStack() as stack:
        panel = Live(console=console, auto_refresh=False, transient=True) if in_place else None
        if panel is not None:
            stack.enter_context(panel)

        def show(tally: Tally, ranging: Ranging | None) -> None:
            nonlocal before
            if time.perf_counter() - before < interval:
                return
            before = time.perf_counter()
            head = "nothing yet" if ranging is None else _found(ranging)
            if panel is None:
                console.print(f"{head}; {tally.words()}", soft_wrap=True)
                return
            bars = "" if ranging is None else trace(ranging.envelope)
            text = f"[bold]{head}[/]\n{bars}\n{tally.words()}"
            panel.update(Panel(text, title=port, expand=False), refresh=True)

        yield show


def _found(ranging: Ranging) -> str:
    """Return what was found in a cycle, in words."""
    if not ranging.detected:
        return "no echo"
    return f"{100 * float(ranging.distance):.1f} cm, amplitude {float(ranging.amplitude):.3f}"


def trace(envelope: np.ndarray, width: int = TRACE) -> str:
    """Return an envelope of shape (time,) as a row of bars over 40 dB below the send pulse."""
    starts = np.linspace(0, envelope.size, width, endpoint=False).astype(int)
    highest = np.maximum.reduceat(np.nan_to_num(envelope), starts)
    level = 1 - 20 * np.log10(np.maximum(highest, 1e-9)) / FLOOR_DB
    index = np.clip(np.ceil(level * (len(BARS) - 1)), 0, len(BARS) - 1).astype(int)
    return "".join(BARS[i] for i in index)
