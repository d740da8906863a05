"""Results of rods of 10, 25 and 35 mm at depths of 2, 4 and 6 mm, and sources of their errors.

The default tube of 40 cm, pressed in the middle, at full resolution (32 cells across the bore). One
indentation per rod serves its three depths. Prints a table in Markdown, some eight minutes of work
on two cores: ``python benchmarks/rods_and_depths.py [RESOLUTION [SUPPORT]]``.
"""

from __future__ import annotations

import sys

import numpy as np

from acoustube import load_config, pressed
from acoustube.lumen import lumen, measure
from acoustube.runs.config.si import settings_in_si
from acoustube.runs.sound import locate, tube_recordings

RODS_MM, DEPTHS_MM = (10.0, 25.0, 35.0), (2.0, 4.0, 6.0)
PAPER_CM = {10.0: (3.03, 1.22), 25.0: (2.95, 1.92), 35.0: (2.51, 1.64)}


def rows_of(rod_mm: float, resolution: int, support: str) -> list[list[float]]:
    """Return one row per depth: mechanics, then distance, error and amplitude per source end."""
    config = load_config(indenter_mm=rod_mm, resolution=resolution, support=support)
    settings = settings_in_si(config)
    position = settings.position
    press = pressed(config, [1e-3 * depth for depth in DEPTHS_MM])
    rows = []
    for depth in DEPTHS_MM:
        (increment,) = np.flatnonzero(press.depth == 1e-3 * depth)
        section = measure(press, increment, np.zeros(1))
        row = [rod_mm, depth, press.contact_force[increment]]
        row += [1e3 * section.height[0], 1e6 * section.area[0]]
        recordings, _ = tube_recordings(settings, lumen(press, position, increment))
        for recording in recordings.values():
            ranging = locate(settings, recording)
            row += [
                100 * float(ranging.distance),
                100 * (float(ranging.distance) - position),
                100 * float(ranging.amplitude),
            ]
        rows.append(row)
    return rows


if __name__ == "__main__":
    resolution = int(sys.argv[1]) if len(sys.argv) > 1 else 32
    support = sys.argv[2] if len(sys.argv) > 2 else "held"
    print(f"support {support}, {resolution} cells across the bore\n")
    print(
        "| rod mm | depth mm | force N | height mm | area mm2 | release: estimate cm | error cm "
        "| echo % | absorbing: estimate cm | error cm | echo % |"
    )
    print("|" + "---|" * 11)
    for rod in RODS_MM:
        for row in rows_of(rod, resolution, support):
            print("| " + " | ".join(f"{value:.3g}" for value in row[:2]), end=" | ", flush=True)
            print(" | ".join(f"{value:.3f}" for value in row[2:]), "|", flush=True)
        mean, deviation = PAPER_CM[rod]
        print(f"| {rod:g} | paper, mean absolute error | {mean} +- {deviation} cm |")
