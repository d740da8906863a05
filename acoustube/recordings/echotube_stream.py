"""The stream of EchoTube's board: from the bytes of a serial line to cycles, and back."""

from __future__ import annotations

import threading
import time
from collections import deque
from types import ModuleType
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acoustube.base.errors import ConfigError

FRAME_BYTES = 2000
"""Bytes of a frame before it is encoded."""
HEAD = 2
"""Bytes of the pulse width, in the place of a cycle's first samples."""

DEPTH = 64
"""Cycles that may wait, some three seconds."""
PATIENCE = 0.1
"""Seconds without a byte or a cycle after which a thread looks whether all is over."""
MISSING = (
    "a board's stream needs the libraries cobs and pyserial; install them with: "
    "pip install 'acoustube[serial]'"
)


class Frame(NamedTuple):
    """What the board sends of a cycle.

    Attributes
    ----------
    pulse_width : int
        The time of flight that the rangefinder itself found, in us, 0 to 65535. Where the echo
        comes back after the last sample it is that of the cycle before: the board packs what it
        knows when it has sampled.
    samples : array of shape (time,)
        Unsigned 8-bit samples, from the third of the cycle on: the pulse width has the place of
        the first two.
    """

    pulse_width: int
    samples: NDArray[np.uint8]


class Decoder:
    """Find the frames in a stream of bytes that is cut into pieces of any size.

    Parameters
    ----------
    frame_bytes : int
        Bytes of a frame before it is encoded, the pulse width's two included.

    Attributes
    ----------
    n_bytes : int
        Bytes fed so far.
    n_frames : int
        Intact frames.
    n_garbled : int
        Pieces between two zeros that are no frame: of another length or no COBS code. A frame in
        which a byte has become a zero is two of them; two frames whose zero in between is lost are
        one, together.
    n_joined : int
        1 if what came before the first zero was no frame: the line was joined in the middle.

    Raises
    ------
    ConfigError
        If the library cobs is missing.

    Notes
    -----
    A frame on the line is encoded by consistent overhead byte stuffing, which leaves no zero in it,
    and ends with a zero. Zeros that follow one another are idle. The code has no check sum, and a
    damaged frame of the right length passes. Of simulated cycles with one byte altered 99.6 %
    do, one sample wrong; with one byte lost 8 %, by codes that are misread and add up all the same:
    later samples then stand one too early, and single zeros among them.

    Of the pulse width the higher byte comes first. So EchoTube's firmware packs it (`echotube.ino`
    of the repository ctejada10/echotube), into the first two of 2000 samples.

    No more than one frame and a byte are kept. What grows longer without a zero is counted as
    garbled at once, and the rest of it up to the next zero left out.
    """

    def __init__(self, frame_bytes: int = FRAME_BYTES):
        self._cobs = _cobs()
        self._frame_bytes = frame_bytes
        self._longest = frame_bytes + frame_bytes // 254 + 1
        self._piece = bytearray()
        self._too_long = False
        self._first = True
        self.n_bytes = self.n_frames = self.n_garbled = self.n_joined = 0

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames that end in these bytes.

        Parameters
        ----------
        data : bytes
            The next of the stream, as many as have come.
        """
        self.n_bytes += len(data)
        *ended, rest = data.split(b"\0")
        frames = []
        for part in ended:
            self._append(part)
            frame = self._finish()
            if frame is not None:
                frames.append(frame)
        self._append(rest)
        return frames

    def _append(self, part: bytes) -> None:
        """Keep bytes of a piece, as far as it can become a frame."""
        self._piece += part[: self._longest + 1 - len(self._piece)]
        if len(self._piece) > self._longest and not self._too_long:
            self._too_long = True
            self.n_garbled += 1

    def _finish(self) -> Frame | None:
        """Return the frame that a zero has ended, or count what it is instead."""
        payload = None if self._too_long else self._payload()
        known = self._too_long or not self._piece
        first, self._first, self._too_long = self._first, False, False
        self._piece.clear()
        if payload is not None:
            self.n_frames += 1
            samples = np.frombuffer(payload, np.uint8, offset=HEAD)
            return Frame(int.from_bytes(payload[:HEAD], "big"), samples)
        if not known:
            self.n_joined += int(first)
            self.n_garbled += int(not first)
        return None

    def _payload(self) -> bytes | None:
        """Return the decoded piece if it is as long as a frame."""
        try:
            payload: bytes = self._cobs.decode(bytes(self._piece))
        except self._cobs.DecodeError:
            return None
        return payload if len(payload) == self._frame_bytes else None


def encode(pulse_width: int, samples: ArrayLike) -> bytes:
    """Return a frame as the board sends it, its zero included.

    Parameters
    ----------
    pulse_width : int
        In us, 0 to 65535.
    samples : array of shape (time,)
        Unsigned 8-bit samples without the cycle's first two.
    """
    payload = pulse_width.to_bytes(HEAD, "big") + np.asarray(samples, np.uint8).tobytes()
    return bytes(_cobs().encode(payload)) + b"\0"


def _cobs() -> ModuleType:
    """Return the library, or say how to install it."""
    try:
        from cobs import cobs
    except ImportError as error:
        raise ConfigError(MISSING) from error
    module: ModuleType = cobs
    return module


class Port(Protocol):
    """What is used of a serial port."""

    @property
    def in_waiting(self) -> int:
        """Bytes that have come."""

    def read(self, size: int = 1) -> bytes:
        """Return up to so many bytes, after a while without any also fewer."""


class Receiver:
    """Read a port on a thread of its own, and keep the newest cycles.

    Where the processing falls behind, the oldest waiting cycle is dropped and counted, so that what
    is taken is never older than the queue.

    Parameters
    ----------
    port : Port
    decoder : Decoder
    depth : int
        Cycles that may wait; one more, and the oldest is dropped.

    Attributes
    ----------
    n_dropped : int
        Intact cycles that were never taken.
    failure : Exception or None
        What ended the line, an OSError unless it is a defect; cycles may still be waiting.
    """

    def __init__(self, port: Port, decoder: Decoder, depth: int = DEPTH):
        self.n_dropped = 0
        self.failure: Exception | None = None
        self._port, self._decoder, self._depth = port, decoder, depth
        self._waiting: deque[tuple[float, Frame]] = deque()
        self._news = threading.Condition()
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._read, daemon=True)

    def __enter__(self) -> Receiver:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Read no more; what waits can still be taken."""
        self._stopped.set()
        self._thread.join()

    def take(self) -> tuple[float, Frame] | None:
        """Return the oldest waiting cycle and when its last byte came, or None after a while.

        The time is that of `time.perf_counter`.
        """
        with self._news:
            if not self._waiting and self.failure is None and not self._stopped.is_set():
                self._news.wait(PATIENCE)
            return self._waiting.popleft() if self._waiting else None

    def _read(self) -> None:
        try:
            while not self._stopped.is_set():
                data = self._port.read(max(1, self._port.in_waiting))
                if data:
                    self._keep(self._decoder.feed(data), time.perf_counter())
        except Exception as error:  # one of a thread would be lost; pyserial's own are OSErrors
            with self._news:
                self.failure = error
                self._news.notify()

    def _keep(self, frames: list[Frame], now: float) -> None:
        with self._news:
            for frame in frames:
                if len(self._waiting) == self._depth:
                    self._waiting.popleft()
                    self.n_dropped += 1
                self._waiting.append((now, frame))
            if frames:
                self._news.notify()
