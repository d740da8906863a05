"""Which effects explain the published scatter of closures, 36 mm, and of distances, 5 cm?

The sleeve paper's calibration (37 closures, a line through their distances) and its flat study
(presses of a 25 mm rod at random positions of 0.2 to 2.1 m and depths of 1 to 8 mm, highest peak)
are simulated with one effect at a time, in several sizes, and with several at once. This is a
hypothesis, not a measurement: the results state which effects could explain the scatter, and how
large they would have to be. The scattering is that of a library of the rod. Every case is a row of
a CSV file; existing rows are not computed again.

Usage: python benchmarks/twin_scatter_of_closures.py LIBRARY out.csv
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from placed_press import placed_press
from resumed_table import completed

from acoustube import signals
from acoustube.air import air_at
from acoustube.inversion import Tool
from acoustube.ranging import Rangefinder, blockage, record
from acoustube.runs.libraries.files import open_library
from acoustube.waves import PlacedScatterer

COLUMNS = (
    "effect", "size", "unit", "closures", "line_mm", "whole_line_mm", "found", "median_cm",
    "rmse_cm", "iqr_cm", "seconds",
)  # fmt: skip
PLACES, LENGTH, AIR = np.arange(0.20, 2.001, 0.05), 2.5, 20.0
SIDES = np.array([10e3, 90e3])
CYCLES, UNTOUCHED = 4, 100
PRESSES, PRESS_CYCLES = 150, 2
TUBE = 7


@dataclass(frozen=True)
class Bench:
    """Differences from the simulated bench: standard deviations in SI units."""

    own: Rangefinder = field(default_factory=Rangefinder)
    placement: float = 0.0
    warmth: float = 0.0
    gradient: float = 0.0
    late: float = 0.0
    leak: float = 0.0
    zero: float = 0.0
    sigmas: float = 15.0


def usual(**changes):
    """Return the default bench with changes of the rangefinder."""
    return Bench(replace(Rangefinder(), **changes))


CASES = [
    ("none", 0, "", Bench()),
    *(("place", mm, "mm", Bench(placement=1e-3 * mm)) for mm in (2, 5, 10, 36)),
    *(("trigger, each cycle", us, "us", usual(jitter=1e-6 * us)) for us in (5, 50, 100)),
    *(("trigger, each place", us, "us", Bench(late=1e-6 * us)) for us in (50, 100)),
    *(("air, from place to place", k, "K", Bench(warmth=k)) for k in (0.5, 2, 5, 15)),
    *(("gradient of the air", k, "K/m", Bench(gradient=k)) for k in (1, 3, 10)),
    *(("gain, each cycle", p, "%", usual(gain_wander=p / 100)) for p in (5, 20)),
    *(("leak of the closures", db, "dB", Bench(leak=db)) for db in (3, 10, 20)),
    *(("clutter", f, "times", usual(clutter=1.5e-5 * f)) for f in (10, 20, 40, 100)),
    *(("noise", mv, "mV", usual(noise=1e-3 * mv)) for mv in (1, 3, 10)),
    *(("quality factor", q, "", usual(quality_factor=float(q))) for q in (20, 30, 45)),
    *(("far end", r, "", usual(far_reflection=r)) for r in (0.2, 0.5, 0.9)),
    *(("origin of the presses", cm, "cm", Bench(zero=cm / 100)) for cm in (2, 5)),
    *(("least prominence", s, "deviations", Bench(sigmas=s)) for s in (2.8, 5, 8)),
    ("all, small", 1, "", Bench(replace(Rangefinder(), jitter=5e-6, gain_wander=0.05,
                                        clutter=1.5e-4, quality_factor=20.0),
                                5e-3, 0.5, 1.0, 20e-6, 3.0, 0.005, 8.0)),
    ("all, large", 2, "", Bench(replace(Rangefinder(), jitter=5e-5, gain_wander=0.2,
                                        clutter=3e-4, quality_factor=20.0),
                                10e-3, 2.0, 3.0, 50e-6, 10.0, 0.02, 5.0)),
]  # fmt: skip


class Recorder:
    """Recordings of a bench."""

    def __init__(self, bench: Bench, tool: Tool) -> None:
        self.bench, self.tool, self.number = bench, tool, 0
        self.random = np.random.default_rng(22)

    def cycles(self, kind, place, depth, n):
        """Return cycles of a closure, a press or the open tube at a stated position."""
        b, self.number = self.bench, self.number + 1
        true = place + self.random.normal(0, b.placement) + b.zero * (kind == "press")
        # The mean along the path of a temperature that varies along the tube.
        air = AIR + self.random.normal(0, b.warmth) + b.gradient * (true - LENGTH) / 2
        late = abs(self.random.normal(0, b.late))
        presses = []
        if kind == "closure":
            leak = 10 ** (-abs(self.random.normal(0, b.leak)) / 20)
            presses = [weakened(blockage(SIDES, true), leak)]
        elif kind == "press":
            presses = [placed_press(self.tool, true, depth, air_at(air).sound_speed)]
        own = replace(b.own, lead=b.own.lead + late)
        found = record(
            presses, own, length=LENGTH, temperature=air, n_cycles=n, seed=self.number,
            session_seed=1, tube_seed=TUBE,
        )  # fmt: skip
        return found["signal"].values


def weakened(closed, level):
    """Return a closure that reflects a part and transmits the rest of the power."""
    s = closed.scattering.s.copy()
    for port in (0, 1):
        s[:, port, 0, port, 0] = level
        s[:, port, 0, 1 - port, 0] = 1j * np.sqrt(1 - level**2)
    return PlacedScatterer(replace(closed.scattering, s=s), closed.position)


def row_of(effect, size, unit, bench, tool):
    """Return the row of a case."""
    started = time.process_time()
    recorder = Recorder(bench, tool)
    shut = [recorder.cycles("closure", float(z), 0.0, CYCLES) for z in PLACES]
    free = recorder.cycles("open", 1.0, 0.0, UNTOUCHED)
    axis = np.arange(free.shape[1]) / bench.own.sampling_rate
    row = {"effect": effect, "size": size, "unit": unit}
    closed, places = np.concatenate(shut), np.repeat(PLACES, CYCLES)
    try:
        known = signals.calibrate(axis, closed, places, free, temperature=AIR,
                                  untouched_temperature=AIR, sigmas=bench.sigmas)  # fmt: skip
    except ValueError as error:
        return row | {"closures": f"not calibrated: {error}"}
    # The highest peak of the whole window, as published, without a window about each position.
    told = signals.locate(axis, closed, known.processing, temperature=AIR).distance
    seen = np.isfinite(told)
    line = np.polyval(np.polyfit(places[seen], told[seen], 1), places[seen])
    random = np.random.default_rng(5)
    where = random.uniform(0.2, 2.1, PRESSES)
    depth = random.uniform(1e-3, min(8e-3, tool.depth[-1]), PRESSES)
    pressed = [
        recorder.cycles("press", float(z), float(d), PRESS_CYCLES)
        for z, d in zip(where, depth, strict=True)
    ]
    found = signals.locate(axis, np.concatenate(pressed), known.processing, temperature=AIR)
    error = found.distance - np.repeat(where, PRESS_CYCLES)
    error = error[found.detected]
    row["found"] = f"{np.mean(found.detected):.2f}"
    if not error.size:
        return row
    low, middle, high = np.quantile(np.abs(error), [0.25, 0.5, 0.75])
    return row | {
        "closures": len(np.unique(known.true_distance)),
        "line_mm": f"{1e3 * known.distance_rmse:.2f}",
        "whole_line_mm": f"{1e3 * np.sqrt(np.mean((told[seen] - line) ** 2)):.1f}",
        "median_cm": f"{100 * middle:.2f}",
        "rmse_cm": f"{100 * np.sqrt(np.mean(error**2)):.1f}", "iqr_cm": f"{100 * (high - low):.1f}",
        "seconds": f"{time.process_time() - started:.1f}",
    }  # fmt: skip


def main() -> None:
    """Compute the rows that are missing, and print all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="of the library")
    parser.add_argument("table", type=Path)
    given = parser.parse_args()
    tool = open_library(given.folder).tools[0]
    cases = [(*case, tool) for case in CASES]
    completed(given.table, COLUMNS, ["effect", "size"], cases, row_of)
    print(given.table.read_text(encoding="utf-8"))


if __name__ == "__main__":
    main()
