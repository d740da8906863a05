"""Contacts found by waveform inversion in simulated recordings, against the highest peak.

Recordings of the default rangefinder on the default tube under a 25 mm rod, or of a design
(``--config``, ``--sensor``; ``--shore`` for another hardness of the wall than stated, ``--modulus``
for the stated tolerance): random positions and depths, air of 20 +- 0.3 degC, one tube whose
clutter is learned from 200 untouched cycles. The scattering is computed at depths between the
library's, by the spectral solver, by it with a wall on another mesh, or by the time-domain solver,
or read from the files of `acoustube scatter` or of ``spectral_presses.py`` whose names end in
``_MM.nc``, MM the depth. Missed presses are compared with the limit of detection that the
inversion states. With ``--changed`` tube, tool or sensor differ from the parameters given to the
inversion. Every recording is a row of a CSV file; existing rows are not computed again.

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
from acoustube.inversion.goodness import MISFIT, RESIDUAL, good_fit
from acoustube.lumen import pressed_part
from acoustube.ranging import Rangefinder, record
from acoustube.reports.studies.calibration import calibrated
from acoustube.runs import inversion, presses, scattering_file, sound
from acoustube.runs.config import load_config
from acoustube.runs.libraries.files import open_library
from acoustube.runs.libraries.plan import tool_plans
from acoustube.runs.sensor_check import NOTED, differing, estimates_of
from acoustube.runs.two_ends import EndsInverter
from acoustube.runs.wrap import wrap_of
from acoustube.sleeve import design, windings, wrapped
from acoustube.waves import PlacedScatterer
from acoustube.waves.network import at_sound_speed

QUANTITIES = ("cm", "cm", 100.0), ("mm", "mm", 1e3), ("n", "N", 1.0)
"""Position, depth and force: name in the table, unit, and factor from SI units."""
TOLD = "", "_sd", "_low68", "_high68", "_low", "_high"
COLUMNS = (
    "truth", "number", "cycles", "presses", *(f"true_{name}" for name, _, _ in QUANTITIES),
    "found", *(name + what for name, _, _ in QUANTITIES for what in TOLD), "n_contacts", "ghosts",
    "misfit", "residual", "mean_square", "error", "probability", "seconds", "peak_cm", "limit_mm",
    *(name + what for name in NOTED for what in ("", "_sd")),
)  # fmt: skip
TOGETHER, DRAWN = 5, 200
"""Number of recordings whose estimates of the sensor are combined, and number of such groups."""
NEAR = 0.05
"""Largest distance in m between an estimated and a true press that counts as found."""
PARTS = {
    "all": (0, 1e3, 0, 100), "to 1.3 m, from 2.5 mm": (0, 130, 2.5, 100),
    "to 1.3 m, under 2.5 mm": (0, 130, 0, 2.5), "beyond 1.3 m": (130, 1e3, 0, 100),
}  # fmt: skip
"""Ranges of distance in cm and of depth in mm for which results are printed separately."""
TUBE = 7
"""Seed of the tube's clutter."""
LENGTH = 2.5
"""Length of the sleeve paper's tube in m."""
FAR_TUBE = TUBE + 1
"""Random seed of the clutter that a rangefinder at the far end records."""
SLEEVE = 0.26, (0.18, 0.266)
"""Length in m of a sleeve on a forearm, and girths at its ends."""
PLACES, DEPTHS, FORMS = (0.3, 1.9), (1.1e-3, 7.9e-3), 24
"""Ranges in m of positions and depths, and the number of different depths."""
BORE = 7.9e-3
"""Bore in m of the sleeve paper's tube, to which the depths belong."""
FIRST, APART = 0.4, (0.08, 0.6)
"""For several presses: ranges in m of the first position and of the distances between them."""
REACH = 0.03
"""Half length in m of the part of the tube that a press deforms, where several are recorded."""
RIGHT = 5e-3, 0.5e-3
"""Largest errors in m of position and depth of several presses that count as estimated rightly."""


CHANGES: dict[str, tuple[dict, dict]] = {
    "": ({}, {}), "gain -20 %": ({"gain": 0.8}, {}), "resonance +0.5 %": ({"resonance": 1.005}, {}),
    "quality +5 %": ({"quality_factor": 1.05}, {}), "thermometer +1 K": ({}, {}),
    "bore +1 %": ({}, {"inner_diameter_mm": ["7.979"]}),
    "hardness +5 Shore A": ({}, {"shore_a": ["40"]}),
    "yaw 10 deg": ({}, {"yaw_deg": ["10"]}),
    "sphere": ({}, {"shape": ["sphere"]}),
}  # fmt: skip
"""Deviations from the parameters given to the inversion: factors of the sensor's parameters, and
settings of the press."""


def designed_depths(config):
    """Return the range of depths of a tube as a setting, to 0.93 of its bore."""
    bore = load_config(config).tube.inner_diameter_mm
    return f"0.5:{0.93 * bore:.2f}:0.25"


class Truth:
    """Scattering and forces of presses, by the name of a truth and changed settings.

    Parameters
    ----------
    name : str
        Name of the truth.
    changed : dict
        Settings of the press.
    mesh : str
        Mesh of the wall of a folder's presses.
    config : Path, optional
        Settings of the tube and the tool.
    """

    def __init__(self, name, changed, mesh="usual", config=None):
        self.files = {}
        for one in Path(name).glob("*.nc") if Path(name).is_dir() else ():
            self.files[1e-3 * float(one.stem.rpartition("_")[2])] = scattering_file.read(one)
        kind, _, other = name.partition("-")
        mesh, self.how = (other, "spectral") if kind == "mesh" else (mesh, name)
        usual = {"indenter_mm": ["25"], "depth_mm": ["0.5:8:0.25"]}
        own = usual if config is None else {"depth_mm": [designed_depths(config)]}
        settings = own | {"mesh": [mesh]} | changed
        (self.plan,) = tool_plans(settings, 0.005, config)
        self.path = DepthPath(presses.press_to(self.plan.settings, self.plan.pressed))
        self.bore = self.plan.settings.tube.inner_diameter

    def depths(self):
        """Return the depths in m of the presses: those of the files, or some at random."""
        if self.files:
            return np.array(sorted(self.files))
        low, high = DEPTHS[0], min(DEPTHS[1] * self.bore / BORE, self.plan.pressed[-1])
        forms = np.round(np.random.default_rng(3).uniform(low, high, FORMS), 7)
        if self.how.startswith("march"):
            return forms[:9] if self.how.endswith("16") else forms[[0, 1, 5, 8]]
        return forms

    def force(self, depth):
        """Return the force in N at a depth in m."""
        return float(self.path.contact_force(depth))

    def matrix(self, depth):
        """Return the scattering of the press at a depth in m, from the cache or computed."""
        if self.files:
            return self.files[depth]
        plan = self.plan
        name = cache.key("scattering", {"benchmark": presses.cache_key(plan.settings, plan.pressed),
                                        "depth": round(depth, 12), "how": self.how})  # fmt: skip
        known = scattering_file.recall(name)
        if known is None:
            method, _, cells = self.how.partition("-")
            part, band = pressed_part(self.path.at([depth])), sound.band_of(plan.settings.pulse)
            known, _, note = sound.scattering_of(
                part, air_at(20.0), band,
                method="spectral" if method == "spectral" else "scattering", bore=self.bore,
                resolution=int(cells or 16), lossy=True,
            )  # fmt: skip
            if note:
                print(f"{1e3 * depth:.3f} mm: {note}")
            scattering_file.keep(name, known, f"benchmark: {1e3 * depth:.3f} mm, {self.how}")
        return known


def cases(forms, first, count, n_presses, seed, within=PLACES, apart=APART):
    """Yield number, positions and depths in m of recordings, with a number of different depths."""
    rng = np.random.default_rng(seed)
    for number in range(count):
        if n_presses == 1:
            places = rng.uniform(*within, 1)
        else:
            nearest = rng.uniform(within[0], within[0] + FIRST)
            places = nearest + np.cumsum([0.0, *rng.uniform(*apart, n_presses - 1)])
        depths = rng.choice(forms, n_presses)
        if number >= first:
            yield number, places, depths


def rows(case, how, cycles, found, seconds, peak):
    """Return a row for each true press of a case (number, positions, depths, forces)."""
    number, *true = case
    places = true[0]
    contacts = [one.contact for one in found.contacts]
    given = np.array([contact.distance.value for contact in contacts])
    free, matched = list(range(len(given))), {}
    for i in np.argsort([np.abs(given - z).min(initial=np.inf) for z in places]):
        near = [j for j in free if abs(given[j] - places[i]) < NEAR]
        if near:
            matched[i] = min(near, key=lambda j: abs(given[j] - places[i]))
            free.remove(matched[i])
    limit = found.detection_limit(np.array(places))
    sensor = estimates_of(found.near)
    for i in range(len(places)):
        row = {
            "truth": how, "number": number, "cycles": cycles, "presses": len(places),
            "found": int(i in matched), "n_contacts": len(given), "ghosts": len(free),
            "misfit": f"{found.misfit:.4g}", "residual": f"{found.residual:.4g}",
            "mean_square": f"{found.near.best.mean_square:.3g}", "error": found.near.best.error,
            "seconds": f"{seconds:.3f}",
            "peak_cm": f"{100 * peak:.4f}", "limit_mm": f"{1e3 * limit[i]:.4f}",
        }  # fmt: skip
        for name, (ratio, deviation) in sensor.items():
            row |= {name: f"{ratio:.6f}", name + "_sd": f"{deviation:.6f}"}
        for (name, _, scale), values in zip(QUANTITIES, true, strict=True):
            row[f"true_{name}"] = f"{scale * values[i]:.6f}"
        if i in matched:
            one = contacts[matched[i]]
            row["probability"] = f"{one.probability:.4f}"
            estimates = one.distance, one.depth, one.force
            for (name, _, scale), told in zip(QUANTITIES, estimates, strict=True):
                values = told.value, told.deviation, *told.intervals[0.68], *told.intervals[0.9]
                row |= {
                    name + what: f"{scale * value:.6f}"
                    for what, value in zip(TOLD, values, strict=True)
                }
        yield row


def unexplained(row):
    """Return whether the contacts of a row's recording do not explain its echo."""
    return not good_fit(float(row["misfit"]), float(row["residual"]))


def summary(path):
    """Print errors, coverage, detections and false detections in a file, by kind of recording."""
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
        if int(kind[2]) > 1:
            together(these)
        parameters(these)


def parameters(rows):
    """Print how often the sensor's parameters are reported as differing from those stated.

    They are estimated from single recordings, from random groups of recordings, and from all.
    """
    each = {
        row["number"]: {n: (float(row[n]), float(row[n + "_sd"])) for n in NOTED if row.get(n)}
        for row in rows
    }
    each, rng = [one for one in each.values() if one], np.random.default_rng(0)
    few = min(TOGETHER, len(each))
    groups = [rng.choice(len(each), few, replace=False) for _ in range(DRAWN)]
    for size, some in ((1, [[i] for i in range(len(each))]), (few, groups)):
        told = [one.name for group in some for one in differing([each[i] for i in group], Priors())]
        for name in NOTED:
            share = 100 * told.count(name) / max(len(some), 1)
            print(f"  {name} reported from {size} of {len(each)} recordings in {share:.0f} %")
    for one in differing(each, Priors()):
        print(f"  {one.name} of all: {100 * one.ratio:.3f} % off, {100 * one.deviation:.3f} % (sd)")


def together(rows):
    """Print how many recordings of several presses are estimated rightly, by their distance."""
    told = {}
    for row in rows:
        told.setdefault(row["number"], []).append(row)
    apart, right, flagged, told_of, poor = [], [], [], [], []
    for one in told.values():
        places = sorted(float(row["true_cm"]) / 100 for row in one)
        near = [
            row["found"] == "1"
            and abs(float(row["cm"]) - float(row["true_cm"])) < 100 * RIGHT[0]
            and abs(float(row["mm"]) - float(row["true_mm"])) < 1e3 * RIGHT[1]
            for row in one
        ]
        apart.append(min(np.diff(places)))
        right.append(all(near) and int(one[0]["ghosts"]) == 0)
        flagged.append(unexplained(one[0]))
        poor.append(float(one[0]["misfit"]) > MISFIT)
        missed = [row for row in one if row["found"] == "0"]
        hidden = [float(row["true_mm"]) < float(row["limit_mm"]) for row in missed]
        told_of.append(flagged[-1] or (missed != [] and all(hidden)))
    apart, right, flagged = np.array(apart), np.array(right), np.array(flagged)
    told_of, poor = np.array(told_of), np.array(poor)
    for low, high in ((0.0, 0.1), (0.1, 0.2), (0.1, 9.0), (0.2, 9.0)):
        part = (apart >= low) & (apart < high)
        if part.any():
            wrong = part & ~right
            print(
                f"  nearest {100 * low:.0f} to {100 * min(high, 0.6):.0f} cm apart: "
                f"{right[part].sum()} of {part.sum()} right; of {wrong.sum()} others "
                f"{poor[wrong].sum()} have a misfit over {MISFIT}, {flagged[wrong].sum()} that or "
                f"a residual over {RESIDUAL}, {told_of[wrong].sum()} one of these or only presses "
                "missed that are shallower than the limit of detection told; of those right "
                f"{flagged[part & right].sum()} are flagged by misfit or residual"
            )


def in_words(part):
    """Return detections, false detections, errors and coverage of rows, as text."""
    found = [row for row in part if row["found"] == "1"]
    ghosts = sum(int(row["ghosts"]) for row in {row["number"]: row for row in part}.values())
    words = [f"{len(part)} presses, found {100 * len(found) / len(part):.0f} %, {ghosts} ghosts"]
    for name, what, scale in (("cm", "place", 10.0), ("mm", "depth", 1.0), ("n", "force", 0.0)):
        if found:
            truth, value, *ends = (
                np.array([float(row[column]) for row in found])
                for column in (f"true_{name}", name, *(name + what for what in TOLD[2:]))
            )
            off = np.abs(value - truth) * scale if scale else 100 * np.abs(value / truth - 1)
            q = np.quantile(off, [0.5, 0.9, 0.99])
            held = [
                100 * np.mean((low <= truth) & (truth <= high))
                for low, high in (ends[:2], ends[2:])
            ]
            words.append(
                f"{what} {q[0]:.3f} / {q[1]:.3f} / {q[2]:.2f} {'mm' if scale else '%'}, 68 and "
                f"90 % intervals hold {held[0]:.0f} and {held[1]:.0f} %"
            )
    flagged = np.mean([unexplained(row) for row in part])
    words.append(f"flagged by misfit or residual in {100 * flagged:.0f} %")
    off = 10 * np.abs([float(row["peak_cm"]) - float(row["true_cm"]) for row in part])
    near = off < 1e3 * NEAR
    limit, depth = (
        np.array([float(row[name]) for row in part]) for name in ("limit_mm", "true_mm")
    )
    missed, known = np.array([row["found"] == "0" for row in part]), np.isfinite(limit)
    deep = known & (depth >= limit)
    words.append(
        f"{np.sum(missed & deep)} of {np.sum(missed)} missed were over the limit told, "
        f"{np.sum(missed & np.isnan(limit))} had none"
    )
    median = np.median(off[near]) if near.any() else np.nan
    words.append(
        f"highest peak: found {100 * np.mean(near):.0f} %, median of these {median:.1f} mm"
    )
    words.append(f"{np.median([float(row['seconds']) for row in part]):.2f} s")
    return words


def finished(path):
    """Return the recordings that a file has, and start the file if there is none."""
    if not path.is_file():
        path.write_text(",".join(COLUMNS) + "\n")
    with path.open(newline="") as file:
        if tuple(next(csv.reader(file), ())) != COLUMNS:
            raise SystemExit(f"{path} has other columns; name a new file")
        file.seek(0)
        names = "truth", "number", "cycles", "presses"
        return {tuple(row[name] for name in names) for row in csv.DictReader(file)}


def arguments():
    """Return the arguments of the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="of the library")
    parser.add_argument("out", type=Path)
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--first", type=int, default=0, help="number of the first recording")
    parser.add_argument(
        "--truth", default="spectral", help="spectral, mesh-coarse, march-16 ..., or a folder"
    )
    parser.add_argument("--mesh", default="usual", help="of the wall of a folder's presses")
    parser.add_argument("--cycles", type=int, default=20)
    parser.add_argument("--presses", type=int, default=1)
    parser.add_argument("--sleeve", action="store_true", help="wrapped as in the sleeve paper")
    parser.add_argument("--loops", type=float, default=9.0, help="of the sleeve")
    parser.add_argument("--config", type=Path, help="settings of another tube, as of a design")
    parser.add_argument("--sensor", type=Path, help="its rangefinder")
    parser.add_argument(
        "--shore", type=float, default=0.0, help="added to the hardness of a design's wall"
    )
    parser.add_argument(
        "--modulus",
        type=float,
        default=0.0,
        help="standard deviation of the wall's modulus that is told, in per cent; without --shore "
        "true forces differ at random by as much",
    )
    parser.add_argument(
        "--bore", type=float, default=0.5, help="told standard deviation of the bore, in per cent"
    )
    parser.add_argument(
        "--places", type=float, nargs=2, default=PLACES, help="range of a single press's place in m"
    )
    parser.add_argument(
        "--apart", type=float, nargs=2, default=APART, help="range of the presses' distance in m"
    )
    parser.add_argument("--length", type=float, help="of the tube in m, in place of the sensor's")
    parser.add_argument(
        "--ends", type=int, default=1, choices=(1, 2), help="a second rangefinder at the far end"
    )
    parser.add_argument("--changed", default="", choices=CHANGES, help="not as told")
    parser.add_argument("--seconds", type=float, default=250.0, help="of processor time, at most")
    parser.add_argument(
        "--again",
        action="store_true",
        help="time a second inversion of each recording, whose forward model is there",
    )
    parser.add_argument("--summary", action="store_true", help="of what there is, alone")
    return parser.parse_args()


def recorded(truth, case, device, cycles, tube, sleeve=None, far=False):
    """Return the cycles of a case (number, positions, depths) from the near end or the far end."""
    number, places, depths = case
    air = 20.0 + np.random.default_rng(number).uniform(-0.3, 0.3)
    speed = air_at(air).sound_speed
    placed = [
        PlacedScatterer(at_sound_speed(truth.matrix(depth), speed), place)
        for depth, place in zip(depths, places, strict=True)
    ]
    if sleeve is not None:
        placed = wrapped(sleeve, placed, air_at(air), radius=truth.bore / 2, reach=REACH)
    elif len(placed) > 1:
        placed = [
            PlacedScatterer(
                dataclasses.replace(one.scattering, extent=(-REACH, REACH)), one.position
            )
            for one in placed
        ]
    if far:
        placed = [one.from_other_end(tube["length"]) for one in placed]
        tube = tube | {"tube_seed": FAR_TUBE}
    seed = (5000 if far else 1000) + number
    return record(placed, device, n_cycles=cycles, seed=seed, temperature=air, **tube)


def untouched(sleeve, truth):
    """Return the bends of a wrapped tube without presses."""
    like = truth.matrix(truth.depths()[0])
    return windings(
        sleeve, air_at(20.0), like.frequency, [], reach=REACH, radius=truth.bore / 2,
        modes=like.modes,
    )  # fmt: skip


def main():
    """Record and invert what the file lacks, and print the summary."""
    given, began = arguments(), time.process_time()
    if given.summary:
        summary(given.out)
        return
    factors, settings = CHANGES[given.changed]
    if given.shore:
        if given.config is None:
            raise SystemExit("--shore goes with --config; name the settings of a design")
        hardness = load_config(given.config).tube.shore_a + given.shore
        settings = settings | {"shore_a": [f"{hardness:g}"]}
    truth = Truth(given.truth, settings, given.mesh, given.config)
    exact = {}
    if given.truth.startswith("spectral"):
        exact = {"place": 0.0, "depth": 0.0, "losses": 0.0}
    sleeve = design(*SLEEVE, loops=given.loops, n_tubes=2)[0] if given.sleeve else None
    wrap = None if sleeve is None else wrap_of(sleeve)
    sensor = inversion.Sensor() if given.sensor is None else inversion.read_sensor(given.sensor)
    sensor = dataclasses.replace(
        sensor,
        priors=Priors(
            thermometer=0.0, bore=0.01 * given.bore, modulus=0.01 * given.modulus, **exact
        ),
        wrap=wrap,
        length=given.length or sensor.length or LENGTH,
    )
    usual = sensor.rangefinder or Rangefinder()
    if given.ends == 2:  # the other transducer's face
        usual = dataclasses.replace(usual, far_reflection=usual.face_reflection)
        sensor = dataclasses.replace(sensor, rangefinder=usual)
    device = dataclasses.replace(usual, **{n: x * getattr(usual, n) for n, x in factors.items()})
    tube = {"tube_seed": TUBE, "length": sensor.length, "radius": truth.bore / 2}
    # The clutter is learned from the sensor and the tube as they are.
    bends = [] if sleeve is None else untouched(sleeve, truth)
    free = record(bends, device, n_cycles=200, seed=11, temperature=20.0, **tube)
    library = open_library(given.folder)
    inverter = inversion.RecordingInverter(library, sensor, [(Path("free"), free)])
    far_free = []
    if given.ends == 2:
        turned = [one.from_other_end(sensor.length) for one in bends]
        other = tube | {"tube_seed": FAR_TUBE}
        free = record(turned, device, n_cycles=200, seed=12, temperature=20.0, **other)
        far_free = [(Path("free"), free)]
    inverter = EndsInverter(inverter, far_free)
    calibration, _ = calibrated(TUBE)
    there, seed = finished(given.out), 100 + given.presses
    words = [Path(given.truth).name, given.changed, "sleeve" * given.sleeve]
    if given.config is not None:
        words.append(given.config.stem)
    others = (
        ("shore", 0.0, "Shore A"), ("modulus", 0.0, "% modulus"), ("bore", 0.5, "% bore"),
        ("loops", 9.0, "loops"), ("ends", 1, "ends"),
    )  # fmt: skip
    told = [(getattr(given, one), usual, unit) for one, usual, unit in others]
    words += [f"{value:g} {unit}" for value, usual, unit in told if value != usual]
    words += [f"{given.mesh} mesh"] if given.mesh != "usual" else []
    ranges = (given.places, PLACES, "m"), (given.apart, APART, "m apart")
    words += [f"{x[0]:g} to {x[1]:g} {u}" for x, usual, u in ranges if tuple(x) != usual]
    name = " ".join(word for word in words if word)
    drawn = given.first, given.count, given.presses, seed, given.places, given.apart
    for case in cases(truth.depths(), *drawn):
        key = name, str(case[0]), str(given.cycles), str(given.presses)
        if key in there or time.process_time() - began > given.seconds:
            continue
        data = recorded(truth, case, device, given.cycles, tube, sleeve)
        there_too = None
        if given.ends == 2:
            far = recorded(truth, case, device, given.cycles, tube, sleeve, far=True)
            there_too = Path("far"), far
        air = data["temperature"].values.mean()
        peak = float("nan")
        if "thermometer" in given.changed:
            data["temperature"] = data["temperature"] + 1.0
        for _ in range(1 + given.again):
            start = time.process_time()
            groups = inverter.groups(Path("cycles"), data, there_too, given.cycles, lambda: None)
            ((_, found),) = groups
            seconds = time.process_time() - start
        if given.sensor is None:
            mean = data["signal"].values.mean(axis=0)
            located = signals.locate(
                data["time"].values, mean, calibration.processing, temperature=air
            )
            peak = float(located.distance) if bool(located.detected) else peak
        unknown = 0.0 if given.shore else 0.01 * given.modulus
        off = np.random.default_rng(2000 + case[0]).normal(1.0, unknown)
        forces = [off * truth.force(depth) for depth in case[2]]
        with given.out.open("a", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            writer.writerows(rows((*case, forces), name, given.cycles, found, seconds, peak))
    summary(given.out)


if __name__ == "__main__":
    main()
