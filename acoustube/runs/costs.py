"""Expected processor time and memory of a press and of its sound."""

from __future__ import annotations

# Measured with benchmarks/fdtd_throughput.py and the default run on two quiet cores; they serve
# the estimate in the first line only.
FIXED_SECONDS, FIXED_GIGABYTES = 30.0, 0.6
STEPS_PER_LAYER = 2 * 3.9  # time steps per axial layer, for both source ends
SCATTERING_STEPS = 8 * 8000.0  # of eight runs of 12 ms, per cell in a mm
SECONDS_PER_CELL_STEP, LOSSY, GIGABYTES_PER_CELL = 0.6e-9, 3.0, 3e-7
PRESS_SECONDS, PRESS_GIGABYTES = {2: (10.0, 7.0), 1: (15.0, 15.0), 0: (30.0, 60.0)}, 1.0
"""Of a press: once and per mm of depth, by how often symmetry halves the tube."""
TETRAHEDRA = 4.0
"""By what a press of a wall from a file takes longer."""
