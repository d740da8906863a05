"""Contacts found by waveform inversion in simulated recordings, beside the highest peak.

Recordings of the default rangefinder on the default tube: 25 mm rod, random places and depths,
air of 20 +- 0.3 degC, one tube whose clutter is learned from 200 untouched cycles. Their scattering
is computed at depths of its own, off the library's, by the spectral solver, by it from a wall on
another mesh, or by the time-domain method. Every recording is a row of a CSV file; rows that are
there are not computed again.

Usage: python benchmarks/inversion_contacts.py FOLDER out.csv --count 60 --truth spectral
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import time
from pathlib import Path

import numpy as np

from acoustube import signals
from acoustube.air import air_at
from acoustube.base import cache
from acoustube.indentation import DepthPath
from acoustube.inversion import Priors
from acoustube.lumen import pressed_part
from acoustube.ranging import Rangefinder, record
from acoustube.reports.studies.calibration import calibrated
from acoustube.runs import inversion, presses, scattering_file, sound
from acoustube.runs.libraries.files import open_library
from acoustube.runs.libraries.plan import tool_plans
from acoustube.waves import PlacedScatterer
from acoustube.waves.network import at_sound_speed

COLUMNS = (
    "truth", "number", "cycles", "presses", "true_cm", "true_mm", "found", "cm", "cm_sd", "cm_low",
    "cm_high", "mm", "mm_sd", "mm_low", "mm_high", "n_contacts", "ghosts", "misfit", "error",
    "residual", "probability", "seconds", "peak_cm",
)  # fmt: skip
NEAR = 0.05
"""Distance in m within which a press counts as found."""
PARTS = {
    "all": (0, 1e3, 0, 100), "to 1.3 m, from 2.5 mm": (0, 130, 2.5, 100),
    "to 1.3 m, under 2.5 mm": (0, 130, 0, 2.5), "beyond 1.3 m": (130, 1e3, 0, 100),
}  # fmt: skip
"""Ranges of distance in cm and of depth in mm that are told apart."""
TUBE = 7
"""Seed of the tube's clutter."""
PLACES, DEPTHS, FORMS = (0.3, 1.9), (1.1e-3, 7.9e-3), 24
"""Ranges in m of places and depths, and the number of different depths."""
FIRST, APART = 0.4, (0.145, 0.6)
"""Of several presses: range in m of the first place, and of the distances between them; the parts
of the tube that are scattered are 14 cm long and must not meet."""


CHANGES = {
    "": {}, "gain -20 %": {"gain": 0.8}, "resonance +0.5 %": {"resonance": 1.005},
    "quality +5 %": {"quality_factor": 1.05}, "thermometer +1 K": {},
}  # fmt: skip
"""What the sensor has otherwise than the inversion is told: factors of its parameters."""


def truth_matrix(plan, path, depth, how):
    """Return the scattering of the press at a depth in m, from the cache or computed."""
    name = cache.key("scattering", {"benchmark": presses.cache_key(plan.settings, plan.pressed),
                                    "depth": round(depth, 12), "how": how})  # fmt: skip
    known = scattering_file.recall(name)
    if known is None:
        method, _, cells = how.partition("-")
        band = sound.band_of(plan.settings.pulse)
        known, _, note = sound.scattering_of(
            pressed_part(path.at([depth])), air_at(20.0), band,
            method="spectral" if method == "spectral" else "scattering", bore=7.9e-3,
            resolution=int(cells or 16), lossy=True,
        )  # fmt: skip
        if note:
            print(f"{1e3 * depth:.3f} mm: {note}")
        scattering_file.keep(name, known, f"benchmark: {1e3 * depth:.3f} mm, {how}")
    return known


def cases(how, count, n_presses, seed):
    """Yield number, places and depths in m of recordings."""
    rng = np.random.default_rng(seed)
    forms = np.round(np.random.default_rng(3).uniform(*DEPTHS, FORMS), 7)
    if how.startswith("march"):
        forms = forms[:9] if how.endswith("16") else forms[[0, 1, 5, 8]]
    for number in range(count):
        if n_presses == 1:
            places = rng.uniform(*PLACES, 1)
        else:
            first = rng.uniform(PLACES[0], PLACES[0] + FIRST)
            places = first + np.cumsum([0.0, *rng.uniform(*APART, n_presses - 1)])
        yield number, places, rng.choice(forms, n_presses)


def rows(case, how, cycles, found, seconds, peak):
    """Return a row for each true press of a case (number, places, depths)."""
    number, places, depths = case
    given = np.array([contact.distance.value for contact in found.contacts])
    free, matched = list(range(len(given))), {}
    for i in np.argsort([np.abs(given - z).min(initial=np.inf) for z in places]):
        near = [j for j in free if abs(given[j] - places[i]) < NEAR]
        if near:
            matched[i] = min(near, key=lambda j: abs(given[j] - places[i]))
            free.remove(matched[i])
    best = found.best
    for i, (z, d) in enumerate(zip(places, depths, strict=True)):
        told, probability = [""] * 8, ""
        if i in matched:
            one = found.contacts[matched[i]]
            probability = f"{one.probability:.4f}"
            told = [
                f"{scale * value:.6f}"
                for scale, estimate in ((100, one.distance), (1e3, one.depth))
                for value in (estimate.value, estimate.deviation, *estimate.intervals[0.9])
            ]
        values = (
            how, number, cycles, len(places), f"{100 * z:.6f}", f"{1e3 * d:.6f}", int(i in matched),
            *told, len(given), len(free), f"{found.misfit:.4g}", best.error, f"{best.residual:.3g}",
            probability, f"{seconds:.3f}", f"{100 * peak:.4f}",
        )  # fmt: skip
        yield dict(zip(COLUMNS, values, strict=True))


def summary(path):
    """Print errors, coverage, found and ghosts of the rows of a file, by kind of recording."""
    with Path(path).open(newline="") as file:
        table = list(csv.DictReader(file))
    for kind in sorted({(row["truth"], row["cycles"], row["presses"]) for row in table}):
        these = [row for row in table if (row["truth"], row["cycles"], row["presses"]) == kind]
        print("{}, {} cycles, {} presses in a recording".format(*kind))
        for name, (near, far, low, high) in PARTS.items():
            part = [
                row
                for row in these
                if near <= float(row["true_cm"]) < far and low <= float(row["true_mm"]) < high
            ]
            if part:
                print(f"  {name}: {'; '.join(in_words(part))}")


def in_words(part):
    """Return found, ghosts, errors and coverage of rows, in words."""
    found = [row for row in part if row["found"] == "1"]
    ghosts = sum(int(row["ghosts"]) for row in {row["number"]: row for row in part}.values())
    words = [f"{len(part)} presses, found {100 * len(found) / len(part):.0f} %, {ghosts} ghosts"]
    for unit, scale in (("cm", 10.0), ("mm", 1.0)):
        if found:
            truth, value, low, high = (
                scale * np.array([float(row[name]) for row in found])
                for name in (f"true_{unit}", unit, f"{unit}_low", f"{unit}_high")
            )
            q = np.quantile(np.abs(value - truth), [0.5, 0.9, 0.99])
            held = 100 * np.mean((low <= truth) & (truth <= high))
            words.append(
                f"{'place' if unit == 'cm' else 'depth'} {q[0]:.3f} / {q[1]:.3f} / {q[2]:.2f} mm, "
                f"90 % intervals hold {held:.0f} %"
            )
    off = 10 * np.abs([float(row["peak_cm"]) - float(row["true_cm"]) for row in part])
    near = off < 1e3 * NEAR
    median = np.median(off[near]) if near.any() else np.nan
    words.append(
        f"highest peak: found {100 * np.mean(near):.0f} %, median of these {median:.1f} mm"
    )
    words.append(f"{np.median([float(row['seconds']) for row in part]):.2f} s")
    return words


def finished(path):
    """Return the recordings that a file has, and begin it if there is none."""
    if not path.is_file():
        path.write_text(",".join(COLUMNS) + "\n")
    with path.open(newline="") as file:
        names = "truth", "number", "cycles", "presses"
        return {tuple(row[name] for name in names) for row in csv.DictReader(file)}


def arguments():
    """Return the words of the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="of the library")
    parser.add_argument("out", type=Path)
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--truth", default="spectral", help="spectral, mesh-coarse, march-16 ...")
    parser.add_argument("--cycles", type=int, default=20)
    parser.add_argument("--presses", type=int, default=1)
    parser.add_argument("--changed", default="", choices=CHANGES, help="sensor, not as told")
    parser.add_argument("--seconds", type=float, default=250.0, help="of processor time, at most")
    parser.add_argument("--summary", action="store_true", help="of what there is, alone")
    return parser.parse_args()


def main():
    """Record and invert what the file lacks, and print the summary."""
    given, began = arguments(), time.process_time()
    if given.summary:
        summary(given.out)
        return
    kind, _, mesh = given.truth.partition("-")
    mesh, how = (mesh, "spectral") if kind == "mesh" else ("usual", given.truth)
    pressed = {"indenter_mm": ["25"], "depth_mm": ["0.5:8:0.25"], "mesh": [mesh]}
    (plan,) = tool_plans(pressed, 0.005)
    path = DepthPath(presses.press_to(plan.settings, plan.pressed))
    exact = {"place": 0.0, "depth": 0.0} if kind == "spectral" else {}
    sensor = inversion.Sensor(priors=Priors(thermometer=0.0, **exact))
    usual, changed = Rangefinder(), CHANGES[given.changed]
    device = dataclasses.replace(usual, **{n: x * getattr(usual, n) for n, x in changed.items()})
    free = record([], device, n_cycles=200, tube_seed=TUBE, seed=11, temperature=20.0)
    library = open_library(given.folder)
    inverter = inversion.RecordingInverter(library, sensor, [(Path("free"), free)])
    calibration, _ = calibrated(TUBE)
    there, seed = finished(given.out), 100 + given.presses
    for case in cases(given.truth, given.count, given.presses, seed):
        number, places, depths = case
        truth = f"{given.truth} {given.changed}".strip()
        name = truth, str(number), str(given.cycles), str(given.presses)
        if name in there or time.process_time() - began > given.seconds:
            continue
        air = 20.0 + np.random.default_rng(number).uniform(-0.3, 0.3)
        matrices = [truth_matrix(plan, path, depth, how) for depth in depths]
        placed = [
            PlacedScatterer(at_sound_speed(matrix, air_at(air).sound_speed), place)
            for matrix, place in zip(matrices, places, strict=True)
        ]
        data = record(
            placed, device, n_cycles=given.cycles, tube_seed=TUBE, seed=1000 + number,
            temperature=air,
        )  # fmt: skip
        if "thermometer" in given.changed:
            data["temperature"] = data["temperature"] + 1.0
        start = time.process_time()
        ((_, found),) = inverter.groups(Path("cycles"), data, given.cycles, lambda: None)
        seconds = time.process_time() - start
        mean = data["signal"].values.mean(axis=0)
        located = signals.locate(data["time"].values, mean, calibration.processing, temperature=air)
        peak = float(located.distance) if bool(located.detected) else float("nan")
        with given.out.open("a", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            writer.writerows(rows(case, truth, given.cycles, found, seconds, peak))
    summary(given.out)


if __name__ == "__main__":
    main()
