"""How many grid cells per second does the wave stage march, and how accurate is it?

A straight 40 cm tube, half model, 42 kHz. Each row: ends, grid, cells per second (median of five
runs of one compiled chunk, warm), and the error of the pulse at the far probe against the exact
delayed pulse. Run on an otherwise idle machine: ``python benchmarks/fdtd_throughput.py``.
"""

from __future__ import annotations

import os
import platform
from statistics import median
from time import perf_counter

import jax
import numpy as np
import trimesh

from acoustube.air import air_at
from acoustube.waves import CutCells, Pulse, cut_cells, grid_spacing, propagate
from acoustube.waves.marching import CHUNK, march
from acoustube.waves.scheme import FarEnd, SourceEnd, prepare

RADIUS, LENGTH, PROBES = 3.95e-3, 0.40, (0.02, 0.30)
AIR = air_at(20.0)
PULSE = Pulse(frequency=42e3)


def lumen(resolution: int) -> CutCells:
    """Return the half model of a straight tube."""
    tube = trimesh.creation.cylinder(RADIUS, LENGTH, sections=256)
    tube.apply_translation([0.0, 0.0, LENGTH / 2])
    return cut_cells(tube, grid_spacing(2 * RADIUS, resolution), half=True)


def cells_per_second(cells: CutCells, source_end: SourceEnd, far_end: FarEnd) -> float:
    """Return the marching rate of one warm chunk."""
    setup = prepare(cells, AIR, probes=PROBES, source_end=source_end, far_end=far_end)
    source = np.zeros(CHUNK)
    march(setup, setup.state, source)
    seconds = []
    for _ in range(5):
        start = perf_counter()
        state, _ = march(setup, setup.state, source)
        jax.block_until_ready(state.pressure)
        seconds.append(perf_counter() - start)
    return float(np.prod(setup.cells.shape)) * CHUNK / median(seconds)


def far_probe_error(cells: CutCells) -> float:
    """Return the largest error of the pulse after 30 cm, relative to its peak."""
    arrival = PROBES[1] / AIR.sound_speed
    recording = propagate(
        cells, AIR, PULSE, duration=arrival + 1.2 * PULSE.duration, probes=PROBES,
        source_end="absorbing",
    )  # fmt: skip
    return float(np.abs(recording.pressure[1] - PULSE(recording.time - arrival)).max())


if __name__ == "__main__":
    print(f"{platform.processor()} x {os.cpu_count()}, jax {jax.__version__}, float32")
    for resolution in (16, 32):
        tube = lumen(resolution)
        print(f"{resolution} cells per bore, {tube.shape}: error {far_probe_error(tube):.2e}")
        for ends in (("release", "rigid"), ("release", "absorbing"), ("absorbing", "absorbing")):
            rate = cells_per_second(tube, *ends)
            print(f"  {ends[0]:>9} - {ends[1]:<9} {rate / 1e9:.2f} Gcell/s")
