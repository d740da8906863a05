"""Expected time and disk space of a sweep's tasks, for estimates only."""

from __future__ import annotations

from collections.abc import Sequence

from acoustube.base import cache
from acoustube.runs import presses as press_runs
from acoustube.runs.costs import cells_of, press_seconds, spectral_seconds
from acoustube.runs.sweep import tasks as sweep_tasks
from acoustube.runs.sweep.graph import Case, Group, LoadPath
from acoustube.waves.modes import modes_below

# Measured on two quiet cores; used for estimates only.
SCATTERING_SECONDS, RECORDING_SECONDS, GIGABYTES = 4e-9, 0.2, 1.0
"""Costs of a sweep.

Time in s of a scattering matrix by FDTD, per cell and time step. Time in s of the recording of a
case, per metre of tube. Memory of a worker in GB.
"""
CASE_BYTES, MATRIX_BYTES = 6.0, 370e3
"""Bytes of a case per sample, both source ends together; bytes of a matrix and its walls."""
RINGING = 12e-3
"""Simulated time in s of each run for a scattering matrix."""
COURANT_NUMBER = 0.45
"""Time step of FDTD multiplied by the speed of sound and divided by the cell size."""
SOUND_SPEED = 343.0
"""Speed of sound in m/s, for estimates."""
SAMPLING_RATE = 1e6
"""Samples per second of a case's recording."""


def path_cost(path: LoadPath) -> float:
    """Return the expected computing time in s of the presses of a load path."""
    return press_seconds(path.settings, path.depths[-1]) if path.presses else 0.0


def matrix_cost(group: Group) -> float:
    """Return the expected computing time in s of a group's scattering matrix; 0 without one."""
    if group.band is None:
        return 0.0
    settings = group.settings
    if settings.method == "spectral":
        return spectral_seconds(settings)
    cell = settings.tube.inner_diameter / settings.resolution
    steps = RINGING * SOUND_SPEED / (COURANT_NUMBER * cell)
    runs = len(modes_below(group.band.high, settings.radius, SOUND_SPEED))
    return SCATTERING_SECONDS * cells_of(settings) / 2 * steps * runs


def case_cost(cases: Sequence[Case]) -> float:
    """Return the expected computing time in s of cases whose scattering is known."""
    return RECORDING_SECONDS * _lengths(cases) + 0.05 * len(cases)


def _lengths(cases: Sequence[Case]) -> float:
    """Return the total tube length of the cases in m."""
    return sum(case.settings.tube.length for case in cases)


def cached(paths: Sequence[LoadPath]) -> tuple[int, int, float]:
    """Return the numbers of cached load paths and matrices, and the time in s of all others."""
    n_paths = n_matrices = 0
    cost = 0.0
    for path in paths:
        there = path.presses and cache.holds(press_runs.cache_key(path.settings, path.depths))
        n_paths += there
        cost += 0.0 if there else path_cost(path)
        for group in path.groups:
            if group.band is not None:
                known = cache.holds(
                    sweep_tasks.scattering_key(group.settings, path.depths, group.depth, group.band)
                )
                n_matrices += known
                cost += 0.0 if known else matrix_cost(group)
            cost += case_cost(group.cases)
    return n_paths, n_matrices, cost


def size_of(group: Group) -> float:
    """Return the expected size of a group's results on the disk in bytes."""
    matrix = MATRIX_BYTES if group.band is not None else 0.0
    return matrix + CASE_BYTES * 2 * _lengths(group.cases) / SOUND_SPEED * SAMPLING_RATE
