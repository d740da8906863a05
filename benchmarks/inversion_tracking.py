"""Two moving fingers tracked from cycle to cycle: processor time per cycle, memory and errors.

Fingers repeatedly land, slide, press deeper and lift at about 0.55 and 1 m of a tube of 2 m; cycles
are computed one by one with the rangefinder's model, with the library's scattering interpolated in
depth. The results include errors of search, filter and noise, not of the scattering. With
``--board`` the cycles are those of EchoTube's board: 80 kHz, unfiltered, 8 bits. With ``--sleeve``
the tube is wrapped around a forearm as in the sleeve paper; its bends take 1 to 2 s per cycle.
Times from cold are those of trackers that begin in the middle of the stream; their construction is
not timed.

Usage: python benchmarks/inversion_tracking.py FOLDER --seconds 60
"""

from __future__ import annotations

import argparse
import resource
import time
from pathlib import Path

import numpy as np
from placed_press import placed_press

from acoustube.air import air_at
from acoustube.inversion import ContactTracker, ForwardModel, baseband_of, measured_clutter
from acoustube.ranging import Rangefinder, digitise, response
from acoustube.runs.libraries.files import open_library
from acoustube.runs.wrap import wrap_of
from acoustube.sleeve import between_bends, design, windings

LENGTH, TUBE, AIR, RATE, NEAR = 2.0, 7, 20.1, 20, 0.05
FOREARM, WRAPPED, REACH = (0.26, (0.18, 0.266)), 2.5, 0.03
"""Length and girths of the arm, length of the tube around it, and half the length of the tube that
is straight at a press, in m."""
UNTOUCHED = 100
"""Number of cycles from which the clutter is learned."""
SETTLED = 0.5
"""Time in s after a landing from which errors are printed separately."""
BETWEEN, DEEP, FIRST = 24, 1.5e-3, 3
"""Cycles between trackers that begin in the middle of the stream, least depth in m of all contacts
there, and number of the first cycles of each that are timed."""


def finger(t, start, hold, pause, place, slide, depth):
    """Return position, depth and time since landing of a finger that lands repeatedly."""
    k, since = divmod(t - start, hold + pause)
    if t < start or since > hold:
        return None
    deep = depth * (0.8 + 0.2 * np.cos(2.1 * k))
    deep *= np.sin(np.pi / 2 * min(1, since / 0.6, (hold - since) / 0.6)) ** 2
    deep *= 1 - 0.12 * np.sin(2 * np.pi * since / 2.3)
    moved = place + 0.03 * np.sin(1.7 * k) + slide * np.sin(2 * np.pi * since / hold)
    return moved, deep, since


def hands(t, least):
    """Return the fingers that press deeper than the library's first depth."""
    both = finger(t, 0.5, 7, 2, 0.55, 0.03, 5e-3), finger(t, 3, 8, 2.5, 1.0, 0.035, 6e-3)
    return [one for one in both if one is not None and one[1] > least]


class Tube:
    """Cycles of presses with a tool's scattering."""

    def __init__(self, tool, board, sleeve=None):
        self.tool, self.board, self.sleeve = tool, board, sleeve
        self.length = LENGTH if sleeve is None else WRAPPED
        self.bends = [] if sleeve is None else self.between([])
        if board:
            self.own = Rangefinder(sampling_rate=80e3, n_samples=2000, bits=8)
            self.fine = Rangefinder(sampling_rate=240e3, n_samples=6000)
        else:
            self.own = self.fine = Rangefinder()

    def cycle(self, pressed, number):
        """Return the counts of a cycle."""
        placed = [placed_press(self.tool, place, depth) for place, depth, _ in pressed]
        if self.sleeve is not None:
            bends = self.between([one.position for one in placed]) if placed else self.bends
            placed = [between_bends(one, REACH) for one in placed] + bends
        _, voltage = response(
            placed, self.fine, radius=self.tool.radius, length=self.length, temperature=AIR,
            tube_seed=TUBE,
        )  # fmt: skip
        voltage = voltage[::3].copy() if self.board else voltage
        return digitise(voltage, self.own, np.array([number]), 5)[0]

    def between(self, places):
        """Return the bends of the sleeve between presses, at the temperature of the library."""
        tool = self.tool
        return windings(
            self.sleeve, air_at(20.0), tool.frequency, sorted(places), reach=REACH,
            radius=tool.radius, modes=tool.modes,
        )  # fmt: skip


def followed(tube, library, seconds):
    """Return times of cycles, rows (depth, time since landing, errors, coverage), ghosts, starts.

    A start is the number of fingers at the start of a tracker in the middle of the stream, the
    times in ms of its first cycles, and whether it reports the fingers and nothing else after each.
    """
    tool = library.tools[0]
    base = baseband_of(
        tube.own, library.radius, tube.length, 20.0, library.modes, tube.own.n_samples,
        None if tube.sleeve is None else wrap_of(tube.sleeve),
    )  # fmt: skip
    free = np.array([tube.cycle([], i) for i in range(UNTOUCHED)])
    model = ForwardModel(library, base, measured_clutter(base, free))
    tracker = ContactTracker(model)
    times, rows, ghosts, starts, late = [], [], 0, [], None
    for i in range(round(seconds * RATE)):
        pressed = hands(i / RATE, tool.depth[0])
        counts = tube.cycle(pressed, UNTOUCHED + i)
        if i % BETWEEN == BETWEEN - 1 and all(depth >= DEEP for _, depth, _ in pressed):
            late = ContactTracker(model)
            starts.append((len(pressed), [], []))
        if late is not None:
            spent, reported = timed(late, counts)
            starts[-1][1].append(1e3 * spent)
            found = sorted(one.distance.value for one in reported)
            true = sorted(place for place, _, _ in pressed)
            right = len(found) == len(true) and np.allclose(found, true, rtol=0, atol=NEAR)
            starts[-1][2].append(right)
            late = late if len(starts[-1][1]) < FIRST else None
        spent, left = timed(tracker, counts)
        times.append(spent)
        for place, depth, since in pressed:
            near = [one for one in left if abs(one.distance.value - place) < NEAR]
            if not near:
                rows.append((depth, since, *[np.nan] * 4))
                continue
            one = min(near, key=lambda one: abs(one.distance.value - place))
            left.remove(one)
            held = [
                low <= truth <= high
                for (low, high), truth in (
                    (one.distance.intervals[0.9], place),
                    (one.depth.intervals[0.9], depth),
                )
            ]
            rows.append((depth, since, one.distance.value - place, one.depth.value - depth, *held))
        ghosts += len(left)
    return 1e3 * np.array(times), np.array(rows, float), ghosts, starts


def timed(tracker, counts):
    """Return the processor time in s of a tracker for a cycle, and a list of its contacts."""
    start = time.process_time()
    found = tracker.update(counts)
    return time.process_time() - start, list(found.contacts)


def print_starts(starts):
    """Print the times of the first cycles of trackers, by the number of fingers at their start."""
    for n in sorted({one[0] for one in starts}):
        here = [one for one in starts if one[0] == n and len(one[1]) == FIRST]
        if not here:
            continue
        spent, right = (np.array([one[i] for one in here]) for i in (1, 2))
        median, most = np.median(spent, axis=0), spent.max(axis=0)
        found = np.maximum.accumulate(right, axis=1).sum(axis=0)
        print(
            f"from cold, fingers: {n}, trackers: {len(here)}, first cycles "
            + ", ".join(f"{a:.0f} (at most {b:.0f})" for a, b in zip(median, most, strict=True))
            + f" ms; all fingers found by then in {', '.join(map(str, found))}"
        )


def print_errors(rows):
    """Print errors and coverage of rows as :func:`followed` returns them, by depth and by time."""
    for name, low, high in (("under 1 mm", 0, 1e-3), ("1 to 2.5 mm", 1e-3, 2.5e-3),
                            ("from 2.5 mm", 2.5e-3, 1)):  # fmt: skip
        for when, first, last in (("landing", 0, SETTLED), ("later", SETTLED, np.inf)):
            here = (rows[:, 0] >= low) & (rows[:, 0] < high)
            here &= (rows[:, 1] >= first) & (rows[:, 1] < last)
            found = rows[here][np.isfinite(rows[here, 2])]
            if len(found):
                place, depth = (np.quantile(1e3 * np.abs(found[:, i]), [0.5, 0.9]) for i in (2, 3))
                print(
                    f"{name}, {when}: {here.sum()}, found {100 * len(found) / here.sum():.0f} %, "
                    f"place {place[0]:.3f} / {place[1]:.3f} mm, depth {depth[0]:.3f} / "
                    f"{depth[1]:.3f} mm, 90 % intervals hold {100 * found[:, 4].mean():.0f} and "
                    f"{100 * found[:, 5].mean():.0f} %"
                )


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="of the library")
    parser.add_argument("--seconds", type=float, default=60.0, help="of the stream")
    parser.add_argument("--board", action="store_true", help="80 kHz and 8 bits")
    parser.add_argument("--sleeve", action="store_true", help="wrapped around a forearm")
    given = parser.parse_args()
    library = open_library(given.folder)
    sleeve = design(*FOREARM, loops=9, n_tubes=2)[0] if given.sleeve else None
    tube = Tube(library.tools[0], given.board, sleeve)
    times, rows, ghosts, starts = followed(tube, library, given.seconds)
    q = np.quantile(times, [0.5, 0.95, 1])
    print(f"{len(times)} cycles; {q[0]:.1f} ms of processor time, 95 % {q[1]:.1f}, most {q[2]:.0f}")
    print(f"resident memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3:.0f} MB")
    print(f"contacts that are none: {ghosts} in {len(times)} cycles")
    print_errors(rows)
    print_starts(starts)


if __name__ == "__main__":
    main()
