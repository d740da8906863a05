"""Does `acoustube live --library` track two fingers for ten minutes?

The fingers of ``inversion_tracking.py`` land, slide, press deeper and lift on a tube of 2 m. One
process computes their cycles beforehand, by :class:`acoustube.sensor.TubeSensor`, as EchoTube's
board would sample them: 80 kHz without a filter, 8 bits, with a gain at which presses fill the
converter. Another one writes them to a pseudo-terminal, 20 per second, the bytes at the rate of
1 Mbaud, after untouched cycles from which the clutter is learned. Printed are the numbers of
cycles sent, received, left out, and without a search for contacts, percentiles of the latency from
a cycle's last byte to its row (of the last 2000 cycles), the resident memory after half a minute
and at the end, the seconds of one core, and the errors of the contacts.
On Linux: ``OMP_NUM_THREADS=1 python benchmarks/live_two_fingers.py LIBRARY [--minutes 10]``.
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from inversion_tracking import AIR, LENGTH, NEAR, RATE, TUBE, hands, print_errors
from live_ten_minutes import TESTS, resident, write_frames

sys.path.insert(0, str(TESTS))

from boards import Board

from acoustube.ranging import Rangefinder, digitise
from acoustube.recordings.echotube_stream import PULSE_WIDTH_BYTES, encode

REST, FOLD = 5.0, 3
"""Untouched time in s, and number of computed samples per sample of the board."""
GAIN, NOISE = 25.0, 2e-3
"""Received level in V of a complete reflection, and noise in V: 20 times EchoTube's."""
BOARD = Rangefinder(sampling_rate=80e3, n_samples=2000, bits=8, gain=GAIN, noise=NOISE)
SENSOR = f"""sampling_rate = {BOARD.sampling_rate}
bits = {BOARD.bits}
n_samples = {BOARD.n_samples}
gain = {GAIN}
noise = {NOISE}
length_cm = {100 * LENGTH}
temperature_bias = 0.0
"""
COVERED = 1.645
"""Half a 90 % interval in standard deviations."""
STARTING, SETTLING = 30.0, 30.0
"""Time in s until the board starts, and from then until memory is first measured."""


def make(library: Path, out: Path, n_cycles: int) -> None:
    """Write the frames' samples and the fingers' positions, depths and times since landing."""
    from acoustube.sensor import Contact, TubeSensor

    fine = dataclasses.replace(
        BOARD, sampling_rate=FOLD * BOARD.sampling_rate, n_samples=FOLD * BOARD.n_samples,
        quantised=False,
    )  # fmt: skip
    sensor = TubeSensor.from_library(
        library, fine, length=LENGTH, temperature=AIR, tube_seed=TUBE, most_contacts=2
    )
    least = sensor.tool_library.tools[0].depth[0]
    samples = np.empty((n_cycles, BOARD.n_samples - PULSE_WIDTH_BYTES), np.uint8)
    truth = np.zeros((n_cycles, 2, 3))
    for i in range(n_cycles):
        there = hands(i / RATE - REST, least) if i >= RATE * REST else []
        truth[i, : len(there)] = np.reshape(there, (-1, 3))
        found = sensor.read([Contact(place=place, depth=depth) for place, depth, _ in there])
        voltage = found[::FOLD] * fine.full_scale / 2**fine.bits - fine.offset
        counts = digitise(voltage, BOARD, np.array([i]), 5)[0]
        samples[i] = counts[PULSE_WIDTH_BYTES:]
    np.savez(out, samples=samples, truth=truth)


def play(end: int, cycles: Path) -> None:
    """Write cycles to the board's end of a pseudo-terminal, at the board's rate."""
    with np.load(cycles) as file:
        frames = [encode(i, one) for i, one in enumerate(file["samples"])]
    time.sleep(STARTING)
    write_frames(end, frames)


def listen(library: Path, folder: Path):
    """Run the command until the board is done; return its tally and the memory at first."""
    from acoustube.runs.live import Stream, follow
    from acoustube.runs.live_contacts import Contacts

    (folder / "sensor.toml").write_text(SENSOR)
    how = Contacts(folder=library, sensor=folder / "sensor.toml", rest=REST - 1,
                   table=folder / "contacts.csv", most=2)  # fmt: skip
    board, memory = Board(), []
    words = [sys.executable, __file__, str(library), "--board", str(board.end)]
    words += ["--cycles", str(folder / "cycles.npz")]

    def send():
        with subprocess.Popen(words, pass_fds=[board.end]) as sending:
            time.sleep(STARTING + SETTLING)
            memory.append(resident())
            sending.wait()
        time.sleep(1.0)
        board.cut()

    thread = threading.Thread(target=send)
    thread.start()
    stream = Stream(port=board.port, prominence=0.05, temperature=AIR)
    tally, _ = follow(stream, lambda *_: None, out=folder / "log.csv", contacts=how)
    thread.join()
    return tally, memory[0]


def compared(folder: Path):
    """Return rows of the presses, as ``inversion_tracking.py`` has them, and false contacts."""
    with np.load(folder / "cycles.npz") as file:
        truth = file["truth"]
    with (folder / "log.csv").open(newline="") as file:
        sent = {row["cycle"]: int(row["pulse_width"]) for row in csv.DictReader(file)}
    found: dict[int, list[dict[str, str]]] = {}
    with (folder / "contacts.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            found.setdefault(sent[row["cycle"]], []).append(row)
    rows, false = [], 0
    for cycle, pressed in enumerate(truth):
        left = found.get(cycle, [])
        for place, depth, since in pressed[pressed[:, 1] > 0]:
            off = [abs(float(one["distance_cm"]) / 100 - place) for one in left]
            if not off or min(off) > NEAR:
                rows.append((depth, since, *[np.nan] * 4))
                continue
            one = left.pop(int(np.argmin(off)))
            values = (("distance", "cm", 100, place), ("depth", "mm", 1e3, depth))
            errors = [float(one[f"{what}_{u}"]) / scale - true for what, u, scale, true in values]
            told = [float(one[f"{what}_sd_{u}"]) / scale for what, u, scale, _ in values]
            held = [abs(e) < COVERED * sd for e, sd in zip(errors, told, strict=True)]
            rows.append((depth, since, *errors, *held))
        false += len(left)
    return np.array(rows, float), false


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("library", type=Path)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--board", type=int, help="its end of the line (used by itself)")
    parser.add_argument("--cycles", type=Path, help="file of the cycles (used by itself)")
    given = parser.parse_args()
    n_cycles = round(60 * given.minutes * RATE)
    if given.board is not None:
        play(given.board, given.cycles)
        return
    if given.cycles is not None:
        make(given.library, given.cycles, n_cycles)
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        words = [sys.executable, __file__, str(given.library), "--minutes", str(given.minutes)]
        subprocess.run([*words, "--cycles", str(folder / "cycles.npz")], check=True)
        used = time.process_time()
        tally, before = listen(given.library, folder)
        used = time.process_time() - used
        rows, false = compared(folder)
    percentiles = 1e3 * np.percentile(tally.latencies, [50, 90, 99, 100])
    print(f"cycles sent, received, left out  {n_cycles}, {tally.n_cycles}, {tally.n_skipped}")
    print(f"cycles without a search  {tally.n_hurried}")
    print("latency in ms    " + "  ".join(f"{p:.1f}" for p in percentiles) + "  (50 90 99 100 %)")
    print(
        f"resident memory  {before:.0f} MB after {SETTLING:.0f} s, {resident():.0f} MB at the end"
    )
    print(f"processor        {used:.0f} s in {n_cycles / RATE:.0f} s")
    print(f"contacts that are none: {false} in {n_cycles} cycles")
    print_errors(rows)


if __name__ == "__main__":
    main()
