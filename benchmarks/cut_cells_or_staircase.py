"""How long does R00 of a narrowed tube to 1 % take, with cut cells and with whole cells?

Lumen E of `tests/data/scattering.csv`: narrowed all round by 40 % over 16 mm. Each row: walls,
cells across the bore, largest error of the complex R00 at the reference's frequencies, seconds of
the run (one mode, one port, without compilation). Whole cells are those more than half open. Some
minutes: ``python benchmarks/cut_cells_or_staircase.py``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import numpy as np

from acoustube.waves import CutCells, cut_cells, grid_spacing, propagate

TESTS = Path(__file__).parents[1] / "tests"
sys.path.insert(0, str(TESTS))

from test_scattering import AIR, MIDDLE, PROBES, RADIUS, REFERENCE, click, pinched  # noqa: E402
from wave_lumens import staircase  # noqa: E402

GOAL = 0.01
RESOLUTIONS = (8, 12, 16, 24, 32, 48)


def reflected(resolution: int, walls: Callable[[CutCells], CutCells]) -> tuple[np.ndarray, float]:
    """Return R00 at the reference's frequencies, and the time in s of the run with the lumen."""
    spacing = grid_spacing(2 * RADIUS, resolution)
    frequencies = rows()["f_hz"].astype(float)
    settings = {"duration": 6e-3, "probes": PROBES, "source_end": "absorbing"}
    start = perf_counter()
    lumen = propagate(walls(cut_cells(pinched("E"), spacing, half=True)), AIR, click, **settings)
    seconds = perf_counter() - start
    straight = propagate(
        walls(cut_cells(pinched(None), spacing, half=True)), AIR, click,
        time_step=lumen.time_step, **settings,
    )  # fmt: skip
    kernel = np.exp(-2j * np.pi * np.outer(frequencies, straight.time))
    back = kernel @ (lumen.pressure - straight.pressure)[0] / (kernel @ straight.pressure[0])
    path = MIDDLE - straight.probes[0]
    return back * np.exp(4j * np.pi * frequencies / AIR.sound_speed * path), seconds


def rows() -> np.ndarray:
    """Return the reference's rows of lumen E."""
    table = np.genfromtxt(REFERENCE, delimiter=",", names=True, dtype=None, skip_header=5)
    return table[table["case"] == "E"]


def main() -> None:
    """Print the table, and the first grid of each kind that meets the goal."""
    exact = rows()["R_re"] + 1j * rows()["R_im"]
    reflected(RESOLUTIONS[0], lambda cells: cells)  # compiles
    print("| walls | cells | error of R00 | s |\n|---|---|---|---|")
    reached: dict[str, tuple[int, float]] = {}
    for name, walls in (("cut", lambda cells: cells), ("whole", staircase)):
        for resolution in RESOLUTIONS:
            found, seconds = reflected(resolution, walls)
            error = float(np.abs(found - exact).max())
            print(f"| {name} | {resolution} | {error:.4f} | {seconds:.1f} |", flush=True)
            if error < GOAL:
                reached.setdefault(name, (resolution, seconds))
    for name in ("cut", "whole"):
        words = (
            "not reached" if name not in reached else "{} cells, {:.1f} s".format(*reached[name])
        )
        print(f"{100 * GOAL:g} % with {name} cells: {words}")


if __name__ == "__main__":
    main()
