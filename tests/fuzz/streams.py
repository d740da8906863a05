"""Serial streams that a board, a bad cable or another device may send to ``acoustube live``."""

from __future__ import annotations

import contextlib
import csv
import fcntl
import itertools
import struct
import termios
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from random import Random

import numpy as np

from acoustube.recordings.echotube_stream import encode
from acoustube.runs.live import BAUD, LIVE_COLUMNS
from tests.boards import CYCLES, FRAMES, Board
from tests.fuzz.harness import Case
from tests.fuzz.oddities import mutated_bytes, odd_number

LONGEST_DURATION = 0.3
"""Time in s after which reading of an endless line stops."""
LOG = "o.csv"
OTHER_FRAMES = (12, 13, 100, 254, 255, 4000, 1_000_000)
OTHER_RATES = (300, 9600, 115_200, 921_600, 2_000_000)


def streams(chance: Random, corpus: Path, folder: Path) -> Case:
    """Streams of a board that are mutated, cut, endless, or read at another rate."""
    words = ["live", "--port", "board", "--out", LOG]
    frame_bytes = 2000
    if chance.random() < 0.25:
        frame_bytes = chance.choice(OTHER_FRAMES)
        words += ["--frame-bytes", str(frame_bytes)]
    if chance.random() < 0.5:
        words += ["--prominence", str(chance.choice((0.05, 0.05, 0.001, 1, 0)))]
    if chance.random() < 0.1:
        option = chance.choice(("--rate", "--temperature", "--baud", "--duration"))
        words += [option, str(min(odd_number(chance), 1e300))]
    if chance.random() < 0.1:
        words += ["--calibration", str(corpus / "calibration.toml")]
    data = _data(chance, frame_bytes)
    if chance.random() < 0.25 and len(data) <= 200_000:
        board = Board()
        words[2] = board.port
        beside = partial(_on_terminal, board, data, folder / LOG)
    else:
        end = chance.choice(("cut", "cut", "silent", "endless"))
        if end != "cut" and "--duration" not in words:
            words += ["--duration", str(chance.uniform(0.05, LONGEST_DURATION))]
        elif end != "cut":
            end = "cut"
        beside = partial(_as_port, ScriptedPort(data, end, chance))
    return Case(tuple(words), told=tuple(words), beside=beside, check=partial(_wrong_log, folder))


def _data(chance: Random, frame_bytes: int) -> bytes:
    """Return the bytes of a stream."""
    kind = chance.random()
    if kind < 0.1:
        return chance.randbytes(chance.choice((0, 1, 100, 5000, 100_000)))
    if kind < 0.15:
        return bytes([chance.choice((0, 1, 255))]) * chance.choice((10, 3000, 1_000_000))
    frames = chance.sample(FRAMES, chance.choice((1, 2, 5, 20)))
    if frame_bytes != 2000 and chance.random() < 0.8:
        frames = [_frame(chance, frame_bytes) for _ in range(1 if frame_bytes > 10_000 else 5)]
    elif chance.random() < 0.3:
        frames = [_frame(chance, frame_bytes) for _ in frames]
    data = b"".join(frames)
    if kind < 0.25:
        return at_another_rate(data[:6000], chance.choice(OTHER_RATES) / BAUD)
    if kind < 0.35:
        return data
    return mutated_bytes(chance, data, FRAMES[0])


def _frame(chance: Random, frame_bytes: int) -> bytes:
    """Return an intact frame of odd samples."""
    count = frame_bytes - 2
    kind = chance.randrange(4)
    if kind == 0:
        samples = np.full(count, chance.choice((0, 1, 128, 255)))
    elif kind == 1:
        samples = np.frombuffer(chance.randbytes(count), np.uint8)
    elif kind == 2:
        samples = np.resize([0, 255], count)
    else:
        samples = np.resize(CYCLES[0], count)
    return encode(chance.choice((0, 1, 65535)), samples)


def at_another_rate(data: bytes, ratio: float) -> bytes:
    """Return the bytes that a port reads whose rate differs from the sender's.

    Parameters
    ----------
    data : bytes
        As sent: each byte has a start bit, eight bits with the least first, and a stop bit.
    ratio : float
        Rate of the port over that of the sender.
    """
    bits = np.unpackbits(np.frombuffer(data, np.uint8)[:, np.newaxis], axis=1, bitorder="little")
    line = np.pad(bits, ((0, 0), (1, 1)), constant_values=((0, 0), (0, 1))).ravel()
    line[9::10] = 1
    seen = line[(np.arange(int(line.size * ratio)) / ratio).astype(int)]
    found, at = bytearray(), 0
    while at + 10 <= seen.size:
        if seen[at]:
            at += 1
            continue
        found += np.packbits(seen[at + 1 : at + 9], bitorder="little").tobytes()
        at += 10
    return bytes(found)


class ScriptedPort:
    """A port that returns pieces of a stream, and then fails, is silent, or starts again.

    Parameters
    ----------
    data : bytes
    end : str
        ``cut``, ``silent`` or ``endless``.
    chance : Random
        Draws the sizes of the pieces.
    """

    def __init__(self, data: bytes, end: str, chance: Random) -> None:
        longest = chance.choice((1, 100, 4096, 10**6))
        longest = max(longest, len(data) // 10_000)
        self._data, self._end = data, end
        cuts = [0]
        while cuts[-1] < len(data):
            cuts.append(cuts[-1] + chance.randint(1, longest))
        self._pieces = itertools.pairwise(cuts)
        if end == "endless":
            self._pieces = itertools.cycle(self._pieces) if data else itertools.repeat((0, 0))
        self._reports = chance.random() < 0.9

    @property
    def in_waiting(self) -> int:
        """Number of bytes; some drivers always report 0."""
        return 4096 if self._reports else 0

    def read(self, size: int = 1) -> bytes:  # noqa: ARG002
        """Return the next piece."""
        piece = next(self._pieces, None)
        if piece is not None:
            return self._data[slice(*piece)]
        if self._end == "cut":
            raise OSError(5, "Input/output error")
        time.sleep(0.02)
        return b""

    def close(self) -> None:
        """Do nothing."""


@contextlib.contextmanager
def _as_port(port: ScriptedPort) -> Iterator[None]:
    """Make the serial library open the given port."""
    import serial

    before = serial.Serial
    serial.Serial = lambda *_given, **_settings: port
    try:
        yield
    finally:
        serial.Serial = before


def _on_terminal(board: Board, data: bytes, log: Path) -> AbstractContextManager[object]:
    """Send data over a pseudo-terminal once the log exists, and close it when all is read."""

    def send(board: Board) -> None:
        if waited(board, log.exists):
            board.send(data)
            waited(board, lambda: not unread(board))
        board.cut()

    return board.sending(send)


def unread(board: Board) -> int:
    """Return the number of bytes that were sent and not read."""
    return int(struct.unpack("i", fcntl.ioctl(board.line, termios.FIONREAD, b"\0" * 4))[0])


def waited(board: Board, condition: Callable[[], bool]) -> bool:
    """Wait until a condition holds, or the board is stopped; return whether it holds."""
    while not condition():
        if board.stopped.wait(0.005):
            return False
    return True


def rows_of(log: Path) -> list[list[str]]:
    """Return the rows of a log, with its head, without the columns that differ from run to run."""
    with log.open(newline="", encoding="utf-8", errors="replace") as file:
        rows = list(csv.reader(file))
    names = rows[0] if rows else []
    kept = [i for i, name in enumerate(names) if name not in ("received_s", "file")]
    return [[row[i] for i in kept] for row in rows]


def _wrong_log(folder: Path) -> str:
    """Return what is wrong with a log, in which each row must be complete."""
    log = folder / LOG
    if not log.exists():
        return ""
    text = log.read_text(encoding="utf-8", errors="replace")
    with log.open(newline="", encoding="utf-8", errors="replace") as file:
        rows = list(csv.reader(file))
    if not text.endswith("\n") or any(len(row) != len(LIVE_COLUMNS) for row in rows):
        return "a row of the log is not whole"
    wrong = [value for row in rows[1:] for value in row[:6] if value in ("nan", "inf", "-inf")]
    return f"the log holds {wrong[0]}" if wrong else ""
