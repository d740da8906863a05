"""Does `acoustube live` keep up with a board for ten minutes, with constant memory?

Another process writes the data of EchoTube's board to a pseudo-terminal, 20 cycles per second,
the bytes at the rate of 1 Mbaud; every hundredth frame ends in its middle. The table lists the
cycles sent, received, garbled and dropped, percentiles of the latency from a cycle's last byte to
its row in the log (of the last 2000 cycles), the largest error of a distance, the resident memory
after ten seconds and at the end, and the seconds of one core. On Linux, ``python
benchmarks/live_ten_minutes.py``, or with the minutes as an argument.
"""

from __future__ import annotations

import csv
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

TESTS = Path(__file__).parents[1] / "tests"
sys.path.insert(0, str(TESTS))

from test_live import DISTANCES, FRAMES, Board, garbled  # noqa: E402

from acoustube.runs.live import Stream, Tally, follow  # noqa: E402

CYCLES_PER_SECOND, BYTES_PER_SECOND, CHUNK = 20.0, 1e5, 200
DAMAGED = 100
"""Number of frames of which one lacks its second half."""


def frames_of(n_cycles: int) -> Iterator[bytes]:
    """Yield the frames of cycles, some of which are damaged."""
    for i in range(n_cycles):
        frame = FRAMES[i % len(FRAMES)]
        if i % DAMAGED == DAMAGED - 1:
            frame, _ = garbled(frame, "end lost")
        yield frame


def write_frames(end: int, frames: Iterable[bytes]) -> None:
    """Write frames to the board's end of a pseudo-terminal, at the board's rate."""
    start = time.monotonic() + 1.0
    for i, frame in enumerate(frames):
        for first in range(0, len(frame), CHUNK):
            due = start + i / CYCLES_PER_SECOND + first / BYTES_PER_SECOND
            time.sleep(max(0.0, due - time.monotonic()))
            os.write(end, frame[first : first + CHUNK])


def resident() -> float:
    """Return the resident memory of this process in MB."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def listen(board: Board, n_cycles: int, log: Path) -> tuple[Tally, float]:
    """Run the command until the board is done; return its tally and the memory after 10 s."""
    memory: list[float] = []
    timer = threading.Timer(10.0, lambda: memory.append(resident()))
    timer.start()
    words = [sys.executable, __file__, "--board", str(board.end), str(n_cycles)]
    with subprocess.Popen(words, pass_fds=[board.end]):
        seconds = 4.0 + n_cycles / CYCLES_PER_SECOND
        stream = Stream(port=board.port, prominence=0.05)
        tally, _ = follow(stream, lambda *_: None, out=log, duration=seconds)
    timer.join()
    return tally, memory[0]


def largest_error(log: Path) -> float:
    """Return the largest error of a distance in a log, in m; frames state their own distance."""
    with log.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    true = DISTANCES[[int(row["pulse_width"]) - 1000 for row in rows]]
    found = np.array([float(row["distance_cm"] or "nan") for row in rows]) / 100
    return float(np.max(np.abs(found - true)))


def main(minutes: float) -> None:
    """Print the table."""
    n_cycles = round(60 * minutes * CYCLES_PER_SECOND)
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log.csv"
        used = time.process_time()
        tally, before = listen(Board(), n_cycles, log)
        used = time.process_time() - used
        error = largest_error(log)
    percentiles = 1e3 * np.percentile(tally.latencies, [50, 90, 99, 100])
    print(f"cycles sent       {n_cycles}, {n_cycles // DAMAGED} of them damaged")
    print(f"cycles received   {tally.n_cycles}, echoes in {tally.n_detections}")
    print(f"garbled, dropped  {tally.n_garbled}, {tally.n_dropped}")
    print("latency in ms     " + "  ".join(f"{p:.1f}" for p in percentiles) + "  (50 90 99 100 %)")
    print(f"largest error     {1e3 * error:.1f} mm")
    print(f"resident memory   {before:.1f} MB after 10 s, {resident():.1f} MB at the end")
    print(f"processor         {used:.1f} s in {n_cycles / CYCLES_PER_SECOND:.0f} s")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--board"]:
        end, n_cycles = (int(word) for word in sys.argv[2:4])
        write_frames(end, frames_of(n_cycles))
    else:
        main(float(sys.argv[1]) if sys.argv[1:] else 10.0)
