"""How do the echoes of the flat study depend on the method for its scattering matrices?

    OMP_NUM_THREADS=1 python benchmarks/flat_by_method.py [--cells 16 24] [--places 20:210:5]

The scattering of the flat study's presses (25 mm rod, 1 to 8 mm every 0.5 mm, tube of 2.5 m, with
losses) is computed by the spectral solver and by the time-domain solver on grids of given numbers
of cells across the bore. From each matrix the same cycles are recorded: with the same noise, drift,
clutter, temperatures and the study's calibration. The labels of a cycle (position, depth, force)
are those of its case and do not depend on the method; its features and the detection of an echo do.

For each depth and method: processor time in s of the matrix (none if it is cached); cycles with an
echo and located cycles (within 25 cm) in per cent; among cycles with an echo by both methods, the
difference from the spectral solver in distance in mm (median, 95 % of the absolute value) and
in height in per cent (median, 95 % of the absolute value); cycles with an echo by only one of the
two, and with distances 2 cm and more apart, in per cent of all.
"""

from __future__ import annotations

import argparse
from time import process_time

import numpy as np

from acoustube.base.types import Array
from acoustube.base.units import MM
from acoustube.ranging import Rangefinder, record
from acoustube.reports.studies.calibration import calibrated
from acoustube.reports.studies.flat import DEPTHS, ROD
from acoustube.reports.studies.ranged import FALSE_POSITIVE_ERROR, FIRST_DATASET_DEPTH
from acoustube.runs.config.si import settings_in_si
from acoustube.runs.scattering_file import StoredScattering
from acoustube.runs.sweep import tasks
from acoustube.runs.sweep.case_results import placed
from acoustube.runs.sweep.cycles import seed_of
from acoustube.runs.sweep.graph import Group, LoadPath, load_paths
from acoustube.runs.sweep.plan import Plan, load_plan, tube_name
from acoustube.runs.sweep.run import cases_of
from acoustube.signals import locate

OTHER_LOBE = 0.02
"""Difference of two distances in m beyond which the highest peaks are taken as different ones."""


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cells", type=int, nargs="*", default=[16, 24])
    parser.add_argument("--places", default="20:210:5", help="in cm")
    parser.add_argument("--cycles", type=int, default=50)
    given = parser.parse_args()
    methods = [("spectral", 16), *(("scattering", cells) for cells in given.cells)]
    found: dict[tuple[float, int], Array] = {}
    print("depth method seconds | echo % located % | mm % | only one % other lobe %")
    for number, (method, cells) in enumerate(methods):
        plan = plan_of(method, cells, given.places)
        (path,) = load_paths(cases_of(plan))
        pressed = tasks.press(path.settings, path.depths).result.at
        for group in path.groups:
            if group.depth > FIRST_DATASET_DEPTH:
                start = process_time()
                matrix = scattering(path, group, pressed[group.depth])
                seconds = process_time() - start
                features = features_of(group, matrix, given.cycles)
                found[group.depth, number] = features
                print(
                    f"{MM * group.depth:g} {method} {cells} {seconds:.1f} "
                    f"{row(features, found[group.depth, 0])}",
                    flush=True,
                )


def plan_of(method: str, cells: int, places: str) -> Plan:
    """Return the flat study's plan at some positions, by one method."""
    over = {
        "method": [method], "mesh": ["usual"], "resolution": [str(cells)],
        **ROD, "depth_mm": [DEPTHS], "position_cm": [places],
    }  # fmt: skip
    return load_plan(None, over)


def scattering(path: LoadPath, group: Group, pressed: tasks.Pressed) -> StoredScattering:
    """Return the matrix of a press as a sweep computes it, or from the cache."""
    assert group.band is not None
    assert pressed.part is not None
    key = tasks.scattering_key(group.settings, path.depths, group.depth, group.band)
    return tasks.scattering(group.settings, key, group.band, pressed.part, "").result


def features_of(group: Group, matrix: StoredScattering, n_cycles: int) -> Array:
    """Return distance, height and true distance of cycles at all positions, (3, cycle)."""
    parts = []
    for number, case in enumerate(group.cases):
        settings, tube = settings_in_si(case.config), f"{tube_name(case.config)}-0"
        cycles = record(
            placed(settings, matrix), Rangefinder(), radius=settings.radius,
            length=settings.tube.length, temperature=settings.temperature, n_cycles=n_cycles,
            seed=seed_of(tube, number, group.depth), session_seed=seed_of(tube, 0, 0),
            tube_seed=seed_of(tube, 0),
        )  # fmt: skip
        processing = calibrated(seed_of(tube, 0))[0].processing
        ranging = locate(
            cycles["time"].values, cycles["signal"].values, processing,
            temperature=cycles["temperature"].values,
        )  # fmt: skip
        truth = np.full(n_cycles, settings.position)
        parts.append(np.stack([ranging.distance, ranging.amplitude, truth]))
    return np.concatenate(parts, axis=1)


def row(features: Array, reference: Array) -> str:
    """Return the results for one depth and method."""
    distance, height, truth = features
    there, before = np.isfinite(distance), np.isfinite(reference[0])
    located = np.abs(distance - truth) < FALSE_POSITIVE_ERROR
    both = there & before
    away = (distance - reference[0])[both]
    higher = height[both] / reference[1][both] - 1
    counts = np.array([np.mean(there), np.mean(located)])
    apart = np.array([np.mean(there ^ before), np.sum(np.abs(away) > OTHER_LOBE) / len(there)])
    return (
        f"| {shown(100 * counts)} | {spread(MM * away)}, {spread(100 * higher)} | "
        f"{shown(100 * apart)}"
    )


def shown(values: Array) -> str:
    """Return numbers as text."""
    return " ".join(f"{value:.2f}" for value in values)


def spread(values: Array) -> str:
    """Return the median, and 95 % of the absolute values."""
    if not len(values):
        return "none"
    return shown(np.array([np.median(values), np.quantile(np.abs(values), 0.95)]))


if __name__ == "__main__":
    main()
