"""EchoTube's board, simulated: its cycles, its frames, and its end of a serial line."""

from __future__ import annotations

import contextlib
import os
import select
import threading

import numpy as np

from acoustube.recordings.echotube_stream import FRAME_BYTES, PULSE_WIDTH_BYTES, encode
from acoustube.runs.live import RATE

CARRIER, SPEED = 42e3, 343.24
PULSE_LENGTH = 11 / CARRIER
TIME = np.arange(PULSE_WIDTH_BYTES, FRAME_BYTES) / RATE


def burst(delay, time):
    """Gaussian pulse as the transducer sends it, `delay` after the send pulse."""
    since = time - PULSE_LENGTH / 2 - np.asarray(delay)[..., np.newaxis]
    return np.exp(-0.5 * (since / (PULSE_LENGTH / 6)) ** 2) * np.sin(2 * np.pi * CARRIER * since)


def cycles_at(distances, noise=0.01, seed=0, time=TIME):
    """Unsigned 8-bit cycles with a send pulse and an echo each, and noise of one count."""
    distances = np.atleast_1d(distances)
    clean = burst(np.zeros(1), time) + 0.3 * burst(2 * distances / SPEED, time)
    hiss = np.random.default_rng(seed).normal(scale=noise, size=clean.shape)
    return np.clip(np.rint(128 + 100 * (clean + hiss)), 0, 255).astype(np.uint8)


DISTANCES = np.linspace(0.3, 2.0, 40)
CYCLES = cycles_at(DISTANCES)
FRAMES = [encode(1000 + i, cycle) for i, cycle in enumerate(CYCLES)]


class Board:
    """The other end of a pseudo-terminal.

    Attributes
    ----------
    end, line : int
        File descriptors of the board's end, and of the line that the computer opens.
    port : str
        Name of the line.
    stopped : threading.Event
        Set to stop the sending thread.
    """

    def __init__(self):
        import tty

        self.end, self.line = os.openpty()
        tty.setraw(self.line)
        self.stopped = threading.Event()
        self.ends = (self.end, self.line)
        self.port = os.ttyname(self.line)

    def send(self, data, chunk=512):
        for start in range(0, len(data), chunk):
            piece = data[start : start + chunk]
            while piece:
                if self.stopped.is_set():
                    return
                if select.select([], [self.end], [], 0.05)[1]:
                    piece = piece[os.write(self.end, piece) :]

    @contextlib.contextmanager
    def sending(self, send):
        """Run a function with this board in a thread while the block runs, then close the line."""
        thread = threading.Thread(target=send, args=(self,), daemon=True)
        thread.start()
        try:
            yield
        finally:
            self.stopped.set()
            thread.join()
            self.cut()

    def cut(self):
        """Close the board's end of the line, once, as when the cable is pulled."""
        ends, self.ends = self.ends, ()
        for end in ends:
            with contextlib.suppress(OSError):
                os.close(end)
