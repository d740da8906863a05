"""Localisation of presses in the cycles that a board sends over a serial line, as they arrive.

A thread reads the line and decodes it
(:class:`acoustube.recordings.echotube_stream.Receiver`); the main thread processes and logs.
"""

from __future__ import annotations

import contextlib
import csv
import errno
import io
import os
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from acoustube import signals
from acoustube.base.errors import ConfigError, SimulationError
from acoustube.base.interrupts import watched_interrupts
from acoustube.base.report import counted
from acoustube.base.units import MS
from acoustube.base.writing import FULL, begin
from acoustube.recordings.echotube_stream import (
    FRAME_BYTES,
    MISSING,
    POLL_INTERVAL,
    PULSE_WIDTH_BYTES,
    Decoder,
    Frame,
    Receiver,
)
from acoustube.runs.recordings import COLUMNS, check_rate, chosen, table_rows
from acoustube.signals import Ranging, Tracker

if TYPE_CHECKING:
    from acoustube.inversion import Tracked
    from acoustube.runs.live_contacts import Contacts, Follower

RATE = 80e3
"""Sampling rate of EchoTube's board in Hz."""
BAUD = 1_000_000
RECENT = 2000
"""Number of recent latencies whose median is reported."""
LIVE_COLUMNS = (*COLUMNS, "received_s", "pulse_width")


@dataclass(frozen=True, kw_only=True)
class Stream:
    """Serial line of a board, and the processing of its cycles.

    Attributes
    ----------
    port : str
        Name of the serial port.
    calibration, prominence
        Calibration, and least prominence of an echo; see :func:`acoustube.runs.recordings.chosen`.
    temperature : float
        Air temperature in degC.
    rate : float
        Sampling rate in Hz. If the carrier is not below half of it, as with EchoTube's 80 kHz, the
        cycles are processed without the matched filter, and distances are accurate to several mm
        only; see :func:`acoustube.signals.without_aliased_template`.
    frame_bytes : int
        Bytes of a cycle; see :class:`acoustube.recordings.echotube_stream.Decoder`.
    baud : int
        Bits per second of the line.
    """

    port: str
    calibration: str | None = None
    prominence: float | None = None
    temperature: float = 20.0
    rate: float = RATE
    frame_bytes: int = FRAME_BYTES
    baud: int = BAUD


@dataclass(kw_only=True)
class Tally:
    """Counts of the cycles and bytes of a stream.

    Attributes
    ----------
    n_cycles : int
        Number of processed cycles.
    n_detections : int
        Number of processed cycles with a detected echo.
    n_skipped : int
        Number of cycles that were not inverted, because many newer ones were waiting.
    n_hurried : int
        Number of cycles in which the known contacts were followed but no others sought, because
        newer ones were waiting.
    learning : bool
        Whether the clutter of the untouched tube is being estimated.
    found : Tracked or None
        Contacts of the last cycle that was inverted; None before the first.
    n_garbled, n_joined, n_bytes : int
        Counts of the :class:`acoustube.recordings.echotube_stream.Decoder`: damaged frames, frames
        that reception joined in the middle (0 or 1), and received bytes.
    n_dropped : int
        Number of intact cycles that were not processed for lack of time.
    arrivals : deque of float
        Arrival times of the last 40 cycles in s, by `time.perf_counter`.
    latencies : deque of float
        Times in s from the last byte of a cycle to its row in the log, of the last
        :data:`RECENT` cycles.
    """

    n_cycles: int = 0
    n_detections: int = 0
    n_skipped: int = 0
    n_hurried: int = 0
    learning: bool = False
    found: Tracked | None = None
    n_garbled: int = 0
    n_joined: int = 0
    n_bytes: int = 0
    n_dropped: int = 0
    arrivals: deque[float] = field(default_factory=lambda: deque(maxlen=40))
    latencies: deque[float] = field(default_factory=lambda: deque(maxlen=RECENT))

    @property
    def rate(self) -> float:
        """Recent cycles per second; zero if none has arrived for two seconds."""
        if len(self.arrivals) < 2 or time.perf_counter() - self.arrivals[-1] > 2:
            return 0.0
        return (len(self.arrivals) - 1) / max(self.arrivals[-1] - self.arrivals[0], 1e-6)

    @property
    def latency(self) -> float:
        """Median latency in s; nan before the first cycle."""
        return float(np.median(self.latencies)) if self.latencies else np.nan

    def words(self) -> str:
        """Return the counts as one line of text."""
        if not self.n_cycles:
            missing = f"no intact cycle in {self.n_bytes} bytes, {self.n_garbled} garbled"
            return missing + ("; check the baud rate and the board" if self.n_bytes else "")
        return (
            f"{counted(self.n_cycles, 'cycle')} at {self.rate:.1f}/s, echoes in "
            f"{self.n_detections}, {self.n_garbled} garbled, {self.n_dropped} dropped, latency "
            f"{MS * self.latency:.1f} ms"
            + (", reception began within a frame" if self.n_joined else "")
            + (f", {self.n_hurried} without a search for contacts" if self.n_hurried else "")
            + (f", {self.n_skipped} not inverted for lack of time" if self.n_skipped else "")
        )


Show = Callable[[Tally, Ranging | None], None]
"""Function called with the counts and the last cycle's result, about a hundred times a second."""


def follow(
    stream: Stream,
    show: Show,
    *,
    out: Path | None = None,
    duration: float | None = None,
    contacts: Contacts | None = None,
) -> tuple[Tally, Exception | None]:
    """Process the cycles of a board until the stream or the duration ends, or an interrupt comes.

    Parameters
    ----------
    stream : Stream
    show : callable
        Called with the counts so far and the result of the last cycle, None before the first.
    out : Path, optional
        New CSV file with one row of :data:`LIVE_COLUMNS` per cycle, written as the cycle arrives:
        `received_s` is the Unix time in s at which a cycle's last byte arrived, and `pulse_width`
        the pulse width that the rangefinder itself reports, in us.
    duration : float, optional
        Duration in s; no limit by default.
    contacts : Contacts, optional
        Settings of the search for contacts by inversion; no search by default.

    Returns
    -------
    tally : Tally
        Final counts.
    failure : Exception or None
        Error that ended the connection, None otherwise; complete cycles are processed and logged.

    Raises
    ------
    ConfigError
        If the calibration, the library, the sensor, the port or a file cannot be used.
    SimulationError
        If a row cannot be written, as on a full disk.
    KeyboardInterrupt
        With a message on the counts and the log file.
    """
    tracker, follower = _tracker(stream), _follower(stream, contacts)
    table, columns = (None, ()) if contacts is None else (contacts.table, contacts.columns)
    decoder, tally = Decoder(stream.frame_bytes), Tally()
    ranging: Ranging | None = None
    # One reference for the whole run, so that an adjusted clock does not change the intervals.
    epoch = time.time() - time.perf_counter()
    kept = "nothing is logged" if out is None else f"{out} holds them"
    with (
        watched_interrupts() as check,
        _opened(stream.port, stream.baud) as line,
        _log("out", out, LIVE_COLUMNS) as log,
        _log("contacts", table, columns) as log_contact,
    ):
        try:
            with Receiver(line, decoder) as receiver:
                for received, frame in _taken(receiver, duration, check):
                    if frame is not None:
                        ranging = tracker.update(frame.samples, stream.temperature)
                        number = tracker.n_cycles - 1
                        log(_row(number, ranging, stream.port, received + epoch, frame))
                        if follower is not None:
                            found = follower.update(frame.samples, received, receiver.waiting)
                            tally.learning, tally.n_skipped = follower.learning, follower.n_skipped
                            tally.n_hurried = follower.n_hurried
                            tally.found = found or tally.found
                            for row in follower.rows(number, received + epoch, found):
                                log_contact(row)
                        tally.arrivals.append(received)
                        tally.latencies.append(time.perf_counter() - received)
                    _count(tally, tracker, decoder, receiver)
                    show(tally, ranging)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(f"interrupted; {tally.words()}; {kept}") from None
    if isinstance(receiver.failure, OSError):
        cut = SimulationError(
            f"the connection to {stream.port} was lost after "
            f"{counted(tracker.n_cycles, 'intact cycle')}, {kept}; connect the board and start "
            "again"
        )
        cut.__cause__ = receiver.failure
        return tally, cut
    return tally, receiver.failure


def _tracker(stream: Stream) -> Tracker:
    """Return the tracker of echoes in the stream's cycles; raise if such cycles are unsuitable."""
    known, settings = chosen(stream.calibration, stream.prominence)
    check_rate(stream.rate, known, Path(stream.port))
    settings = signals.without_aliased_template(settings, stream.rate)
    try:
        # The pulse width replaces the first samples of a cycle.
        tracker = Tracker(np.arange(PULSE_WIDTH_BYTES, stream.frame_bytes) / stream.rate, settings)
        signals.speed_of_sound(stream.temperature)
    except ValueError as error:
        raise ConfigError(f"cycles like these cannot be processed: {error}") from error
    return tracker


@contextlib.contextmanager
def _opened(port: str, baud: int) -> Iterator[Any]:
    """Yield an open serial port, for a bit rate in bit/s."""
    try:
        import serial
    except ImportError as error:
        raise ConfigError(MISSING) from error
    try:
        line = serial.Serial(port, baud, timeout=POLL_INTERVAL, exclusive=True)
    except (OSError, ValueError) as error:
        number = getattr(error, "errno", None)
        reason = os.strerror(number) if number else error
        raise ConfigError(
            f"cannot be opened ({reason})",
            setting="port",
            value=port,
            advice="name the board's port, free and readable",
        ) from error
    with contextlib.closing(line):
        yield line


def _follower(stream: Stream, contacts: Contacts | None) -> Follower | None:
    """Return the tracker of contacts in the stream's cycles; None if contacts are not sought."""
    if contacts is None:
        return None
    from acoustube.runs.live_contacts import Follower

    return Follower(contacts, stream.rate, stream.frame_bytes, stream.temperature)


@contextlib.contextmanager
def _log(
    name: str, out: Path | None, columns: Sequence[str]
) -> Iterator[Callable[[list[object]], None]]:
    """Yield a function that immediately writes a row to a new file, or does nothing without one."""
    if out is None:
        yield lambda _: None
        return
    try:
        # The header is written at once: an interrupt before it would leave an empty file behind.
        file = begin(out, _csv_row(columns))
    except OSError as error:
        raise ConfigError(
            f"cannot be written ({error.strerror})",
            setting=name,
            value=out,
            advice="name a new file",
        ) from error
    with file:

        def write(row: list[object]) -> None:
            whole, content = file.tell(), _csv_row(row)
            try:
                if file.write(content) < len(content):
                    raise OSError(errno.ENOSPC, FULL[errno.ENOSPC])
            except OSError as error:
                file.truncate(whole)
                raise SimulationError(
                    f"{out}: {FULL.get(error.errno or 0, error.strerror)}; it holds the cycles so "
                    "far, so make room and log to a new file"
                ) from error

        yield write


def _csv_row(row: Sequence[object]) -> bytes:
    line = io.StringIO()
    csv.writer(line, lineterminator="\n").writerow(row)
    return line.getvalue().encode("utf-8", "backslashreplace")


def _taken(
    receiver: Receiver, duration: float | None, check: Callable[[], None]
) -> Iterator[tuple[float, Frame | None]]:
    """Yield arrival time in s and frame of each cycle, None while none arrives, until the end."""
    end = np.inf if duration is None else time.perf_counter() + duration
    while True:
        check()
        timed_out = time.perf_counter() > end
        if timed_out:
            receiver.stop()
        # This is checked before the queue, which then holds all cycles that arrived before the end.
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
