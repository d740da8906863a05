"""What the work of a sweep costs, about, in seconds and bytes: for estimates only."""

from __future__ import annotations

from collections.abc import Sequence

from acoustube.base import cache
from acoustube.runs import presses as press_runs
from acoustube.runs.config import grid_cells
from acoustube.runs.costs import PRESS_SECONDS
from acoustube.runs.sweep import tasks as sweep_tasks
from acoustube.runs.sweep.graph import Case, Descent, Group
from acoustube.waves.modes import modes_below

# Measured on two quiet cores; they serve the estimates only.
SCATTERING_SECONDS, HEARD_SECONDS, GIGABYTES = 4e-9, 0.2, 1.0
"""Per cell and step of a scattering; per case; per worker."""
CASE_BYTES, MATRIX_BYTES = 6.0, 370e3
"""Of a case per sample, both source ends together; of a scattering matrix with its walls."""
RINGING = 12e-3
"""Time in s that a scattering is marched for."""
STEP_SHARE = 0.45
"""Of a step of the march, in cell sizes over the speed of sound."""


def path_cost(path: Descent) -> float:
    """Return the seconds that a path takes, about."""
    if not path.presses:
        return 0.0
    start, per_mm = PRESS_SECONDS[sum(press_runs.press_from(path.config).halves)]
    return start + per_mm * 1e3 * path.depths[-1]


def matrix_cost(group: Group) -> float:
    """Return the seconds that a scattering takes, about."""
    if group.band is None:
        return 0.0
    config = group.config
    bore, speed = 1e-3 * config.tube.inner_diameter_mm, 343.0
    half = grid_cells(config) / 2
    steps = RINGING * speed / (STEP_SHARE * bore / config.waves.resolution)
    runs = len(modes_below(group.band.high, bore / 2, speed))
    return SCATTERING_SECONDS * half * steps * runs


def hear_cost(cases: Sequence[Case]) -> float:
    """Return the seconds that cases take when their scattering is known, about."""
    per_metre = HEARD_SECONDS * sum(1e-2 * case.config.tube.length_cm for case in cases)
    return per_metre + 0.05 * len(cases)


def remembered(paths: Sequence[Descent]) -> tuple[int, int, float]:
    """Return how many paths and matrices are in the cache, and the cost of the others."""
    n_paths = n_matrices = 0
    cost = 0.0
    for path in paths:
        there = path.presses and cache.holds(press_runs.remembered_as(path.config, path.depths))
        n_paths += there
        cost += 0.0 if there else path_cost(path)
        for group in path.groups:
            if group.band is not None:
                name = sweep_tasks.scattering_name(
                    group.config, path.depths, group.depth, group.band
                )
                known = cache.holds(name)
                n_matrices += known
                cost += 0.0 if known else matrix_cost(group)
            cost += hear_cost(group.cases)
    return n_paths, n_matrices, cost


def size_of(group: Group) -> float:
    """Return the bytes that the results of a group take on the disk, about."""
    matrix = MATRIX_BYTES if group.band is not None else 0.0
    lengths = sum(1e-2 * case.config.tube.length_cm for case in group.cases)
    return matrix + CASE_BYTES * 2 * lengths / 343 * 1e6
