"""Serial stream of EchoTube's board: bytes to cycles, and back.

References
----------
* Framing: Cheshire, S. and Baker, M., Consistent overhead byte stuffing, IEEE/ACM Transactions on
  Networking 7 (1999), 159-172. doi:10.1109/90.769765
"""

from __future__ import annotations

import threading
import time
from collections import deque
from types import ModuleType
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acoustube.base.checks import Reals, check_argument
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number

FRAME_BYTES = 2000
"""Bytes of a frame before it is encoded."""
PULSE_WIDTH_BYTES = 2
"""Bytes of a cycle's measured time of flight (pulse width), which replace its first samples."""

QUEUE_DEPTH = 64
"""Largest number of waiting cycles: about three seconds."""
POLL_INTERVAL = 0.1
"""Time in s after which a waiting thread checks whether the stream has ended."""
MISSING = (
    "a board's stream needs the packages cobs and pyserial; run pip install 'acoustube[serial]'"
)


class Frame(NamedTuple):
    """Cycle as the board sends it.

    Attributes
    ----------
    pulse_width : int
        Time of flight that the rangefinder itself measured, in us, 0 to 65535. The board stores it
        when the echo arrives: if that is after the cycle's last sample, the frame contains the
        value of the previous cycle.
    samples : array of shape (time,)
        Unsigned 8-bit samples, beginning with the cycle's third: the pulse width replaces the
        first two.
    """

    pulse_width: int
    samples: NDArray[np.uint8]


class Decoder:
    """Decoder of frames in a stream of bytes that arrives in pieces of any size.

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
        Pieces between two zeros that are not a frame: of another length or not a COBS code. A
        frame with a byte altered to zero counts as two; two frames whose separating zero is lost
        count as one.
    n_joined : int
        1 if the bytes before the first zero were not a frame: reception began within a frame. More
        bytes than a frame's count as garbled instead.

    Raises
    ------
    ConfigError
        If the library cobs is missing, or `frame_bytes` is not a whole number of at least 3.

    Notes
    -----
    A frame on the line is encoded by consistent overhead byte stuffing, which leaves no zero in it,
    and ends with a zero. Consecutive zeros are idle. The code has no checksum, so that a damaged
    frame of the right length is accepted. Of simulated cycles with one altered byte 99.6 % are
    accepted, with one wrong sample. With one lost byte 8 % are, as misread codes still add up to
    the right length: later samples are then one place early, with single zeros among them.

    The higher byte of the pulse width comes first. EchoTube's firmware (`echotube.ino` of the
    repository ctejada10/echotube) packs it so, into the first two of 2000 samples.

    No more than one frame and a byte are kept. A longer piece without a zero is counted as garbled
    at once, and its rest up to the next zero is discarded.
    """

    def __init__(self, frame_bytes: int = FRAME_BYTES):
        size = int(check_argument("frame_bytes", frame_bytes, Number(3, 1e9, "bytes", whole=True)))
        self._cobs = _cobs()
        self._frame_bytes = size
        self._longest = size + size // 254 + 1
        self._piece = bytearray()
        self._too_long = False
        self._first = True
        self.n_bytes = self.n_frames = self.n_garbled = self.n_joined = 0

    def feed(self, data: bytes) -> list[Frame]:
        """Return the frames completed by further bytes.

        Parameters
        ----------
        data : bytes
            Next bytes of the stream, of any number.
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
        """Append bytes to the current piece, up to the longest possible frame."""
        self._piece += part[: self._longest + 1 - len(self._piece)]
        if len(self._piece) > self._longest and not self._too_long:
            self._too_long = True
            self.n_garbled += 1

    def _finish(self) -> Frame | None:
        """Return the frame that a zero byte completes; None, and count it, if it is garbled."""
        payload = None if self._too_long else self._payload()
        known = self._too_long or not self._piece
        first, self._first, self._too_long = self._first, False, False
        self._piece.clear()
        if payload is not None:
            self.n_frames += 1
            samples = np.frombuffer(payload, np.uint8, offset=PULSE_WIDTH_BYTES)
            return Frame(int.from_bytes(payload[:PULSE_WIDTH_BYTES], "big"), samples)
        if not known:
            self.n_joined += int(first)
            self.n_garbled += int(not first)
        return None

    def _payload(self) -> bytes | None:
        """Return the decoded piece if it is as long as a frame, else None."""
        try:
            payload: bytes = self._cobs.decode(bytes(self._piece))
        except self._cobs.DecodeError:
            return None
        return payload if len(payload) == self._frame_bytes else None


def encode(pulse_width: int, samples: ArrayLike) -> bytes:
    """Return a frame as bytes of the serial stream, with the terminating zero byte.

    Parameters
    ----------
    pulse_width : int
        Time of flight that the rangefinder itself measured, in us, 0 to 65535.
    samples : array of shape (time,)
        Unsigned 8-bit samples without the cycle's first two.

    Raises
    ------
    ConfigError
        If the library cobs is missing, or a value is not a whole number within its range.
    """
    width = int(check_argument("pulse_width", pulse_width, Number(0, 65535, "us", whole=True)))
    check_argument("samples", samples, Reals(0, 255, ndim=1, empty=True, kinds="iu"))
    payload = width.to_bytes(PULSE_WIDTH_BYTES, "big") + np.asarray(samples, np.uint8).tobytes()
    return bytes(_cobs().encode(payload)) + b"\0"


def _cobs() -> ModuleType:
    """Return the module cobs; raise ConfigError with advice if it is missing."""
    try:
        from cobs import cobs
    except ImportError as error:
        raise ConfigError(MISSING) from error
    module: ModuleType = cobs
    return module


class Port(Protocol):
    """Interface of a serial port, as that of pyserial."""

    @property
    def in_waiting(self) -> int:
        """Number of received bytes that wait to be read."""

    def read(self, size: int = 1) -> bytes:
        """Return up to `size` bytes, or fewer after a time-out."""


class Receiver:
    """Receiver that reads a port on its own thread and keeps the newest cycles.

    Reading begins at the entry of a ``with`` block and stops at its end. If the processing is
    slower than the stream, the oldest waiting cycle is dropped and counted, so that the delay is
    bounded.

    Parameters
    ----------
    port : Port
    decoder : Decoder
    depth : int
        Largest number of waiting cycles; with a further one the oldest is dropped.

    Attributes
    ----------
    n_dropped : int
        Number of intact cycles dropped before they were processed.
    failure : Exception or None
        Exception that ended the stream, usually an OSError; cycles may still be waiting.
    """

    def __init__(self, port: Port, decoder: Decoder, depth: int = QUEUE_DEPTH):
        self.n_dropped = 0
        self.failure: Exception | None = None
        self._port, self._decoder, self._depth = port, decoder, depth
        self._waiting: deque[tuple[float, Frame]] = deque()
        self._news = threading.Condition()
        self._stopped = threading.Event()
        self._thread = threading.Thread(target=self._read, daemon=True)

    @property
    def waiting(self) -> int:
        """Number of cycles received and not yet taken."""
        return len(self._waiting)

    def __enter__(self) -> Receiver:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """Stop reading; waiting cycles can still be taken."""
        self._stopped.set()
        self._thread.join()

    def take(self) -> tuple[float, Frame] | None:
        """Return arrival time and frame of the oldest waiting cycle, or None.

        The arrival time is that of its last byte, in s of `time.perf_counter`. The result is None
        if no cycle arrives within :data:`POLL_INTERVAL`, or none waits and the stream has ended.
        """
        with self._news:
            if not self._waiting and self.failure is None and not self._stopped.is_set():
                self._news.wait(POLL_INTERVAL)
            return self._waiting.popleft() if self._waiting else None

    def _read(self) -> None:
        try:
            while not self._stopped.is_set():
                data = self._port.read(max(1, self._port.in_waiting))
                if data:
                    self._keep(self._decoder.feed(data), time.perf_counter())
        except Exception as error:  # otherwise lost with the thread; OSError from pyserial
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
