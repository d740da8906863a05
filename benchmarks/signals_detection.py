"""Rates of detection and of false detection of an echo, against its signal-to-noise ratio.

White noise on synthetic cycles, the sleeve paper's processing, the least prominence at 2.8 and at 8
standard deviations of untouched cycles. Prints a table and draws ``signals_detection.png`` into the
current folder: ``python benchmarks/signals_detection.py``.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from acoustube.reports.figures.run import save
from acoustube.signals import Processing, locate
from acoustube.signals.calibration import untouched_deviation

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from test_pipeline import TIME, cycles_at

NOISE, COUNT, PLACE = 0.01, 400, 1.0
RATIOS_DB = np.arange(-8, 25, 2.0)


def main() -> None:
    """Print the rates and draw them."""
    quiet = cycles_at(np.full(COUNT, PLACE), height=0.0, noise=NOISE)
    sheet = Figure(figsize=(7, 4), layout="constrained")
    axes = sheet.subplots()
    print("| peak echo over noise, dB | " + " | ".join(f"{r:g}" for r in RATIOS_DB) + " |")
    for sigmas in (2.8, 8.0):
        how = Processing()
        least = np.pi / 2 * sigmas * untouched_deviation(TIME, quiet, how)
        how = replace(how, prominence=least)
        alarms = float(np.mean(locate(TIME, quiet, how).detected))
        found = []
        for ratio in RATIOS_DB:
            heard = cycles_at(
                np.full(COUNT, PLACE), height=NOISE * 10 ** (ratio / 20), noise=NOISE, seed=7
            )
            distance = locate(TIME, heard, how).distance
            found.append(float(np.mean(np.abs(distance - PLACE) < 0.02)))
        print(f"| {sigmas:g} deviations, {100 * alarms:.0f} % false alarms | "
              + " | ".join(f"{100 * rate:.0f}" for rate in found) + " |")  # fmt: skip
        label = f"{sigmas:g} deviations; {100 * alarms:.0f} % of empty cycles alarm"
        axes.plot(RATIOS_DB, found, "o-", label=label)
    axes.set_xlabel("peak of the echo over the noise's deviation (dB)")
    axes.set_ylabel("found within 2 cm")
    axes.legend()
    save(sheet, Path("signals_detection.png"))


if __name__ == "__main__":
    main()
