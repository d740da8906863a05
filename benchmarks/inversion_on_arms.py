"""Errors of the inversion, instead of the highest peak, in the sleeve paper's studies on arms.

The presses of `acoustube reproduce mannequin human`, from its folder, on the same sleeve: those on
a mannequin's arm at seven positions for each depth, those on a human arm at seven positions of two
tubes at three levels of force, with three forces each. Cycles of each press are recorded as in the
studies and inverted together, with a library of the rod that is equivalent to the 25 mm one on the
bent tube, made beforehand by

    acoustube library --indenter 19.2 --depth 0.5:8:0.25 --out rigid
    acoustube library --indenter 19.2 --depth 0.5:14:0.25 --config soft.toml --out soft

(19.2 mm is `arm.tool` of the sleeve; soft.toml states ``support = "free"``, ``layer_mm = 20``
and ``layer_mpa = 0.06`` under ``[indentation]``). The library's presses are on the study's mesh, by
its solver, but at other depths; the bends of the recordings are joined by all their modes, while
the inversion uses bent modes. Each press is a row of a CSV file; existing rows are not
computed again.

Usage: python benchmarks/inversion_on_arms.py WORK LIBRARY out.csv --study mannequin
"""

from __future__ import annotations

import argparse
import csv
import time
from pathlib import Path

import numpy as np

from acoustube.inversion.goodness import good_fit
from acoustube.reports.studies import human
from acoustube.reports.studies.arm import (
    PLACES,
    bent_around,
    by_depth,
    cycles_of,
    estimates_of,
    sleeve,
    sleeve_inverter,
)
from acoustube.reports.studies.ranged import found_distance
from acoustube.runs.libraries.files import open_library

CYCLES = 50
NEAR = 0.05
"""Largest distance in m between an estimated and a true press that counts as found."""
COLUMNS = (
    "tube", "level", "true_cm", "true_mm", "true_n", "found", "cm", "cm_low", "cm_high", "mm", "n",
    "n_low", "n_high", "n_contacts", "misfit", "residual", "seconds", "peak_cm",
)  # fmt: skip


def mannequin(presses):
    """Yield tube, level, place, press and number of cycles of each recording."""
    for place in PLACES:
        for press in presses.values():
            yield 0, "", float(place), press, CYCLES


def human_arm(presses):
    """Yield tube, level, place, press and number of cycles of each recording."""
    ordered = list(dict(sorted(presses.items())).values())
    for tube in (0, 1):
        for place in PLACES + tube * human.SHIFT:
            for i, press in enumerate(ordered):
                low, high = human.LEVELS[i // 3]
                yield tube, f"{low:g}-{high:g} N", float(place), press, human.CYCLES[i % 3]


def summary(path):
    """Print errors by level."""
    with path.open(newline="") as file:
        table = list(csv.DictReader(file))
    for level in [*sorted({row["level"] for row in table}), "all"]:
        rows = [row for row in table if level in ("all", row["level"])]
        found = [row for row in rows if row["found"] == "1"]
        apart = np.abs([float(row["peak_cm"]) - float(row["true_cm"]) for row in rows])
        ghosts = sum(int(row["n_contacts"]) - int(row["found"]) for row in rows)
        words = [f"{level or 'all depths'}: {len(rows)} presses, found {len(found)}"]
        words.append(f"{ghosts} contacts more")
        if found:
            off = [10 * abs(float(row["cm"]) - float(row["true_cm"])) for row in found]
            deep = [abs(float(row["mm"]) - float(row["true_mm"])) for row in found]
            force = [100 * abs(float(row["n"]) / float(row["true_n"]) - 1) for row in found]
            for name, errors in (("place mm", off), ("depth mm", deep), ("force %", force)):
                words.append(f"{name} {np.median(errors):.2f} / {np.quantile(errors, 0.9):.2f}")
            for name, truth in (("cm", "true_cm"), ("n", "true_n")):
                held = [
                    float(row[f"{name}_low"]) <= float(row[truth]) <= float(row[f"{name}_high"])
                    for row in found
                ]
                words.append(f"90 % intervals of {name} hold {100 * np.mean(held):.0f} %")
        poor = [not good_fit(float(row["misfit"]), float(row["residual"])) for row in rows]
        words.append(f"flagged by misfit or residual in {np.mean(poor):.0%}")
        words.append(
            f"peak: {np.sum(apart < 25)} within 25 cm, median {np.nanmedian(apart):.2f} cm; "
            f"{np.median([float(row['seconds']) for row in rows]):.1f} s"
        )
        print("; ".join(words))


def main():
    """Record and invert what the file lacks, and print the summary."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("work", type=Path, help="folder `work` of `acoustube reproduce`")
    parser.add_argument("library", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--study", choices=("mannequin", "human"), default="mannequin")
    parser.add_argument("--every", type=int, default=1, help="of the recordings, only each n-th")
    given = parser.parse_args()
    presses = by_depth(given.work / given.study / "arm")
    like = next(iter(presses.values()))[1]
    library = open_library(given.library)
    inverters = {}
    if not given.out.is_file():
        given.out.write_text(",".join(COLUMNS) + "\n")
    with given.out.open(newline="") as file:
        if tuple(next(csv.reader(file), ())) != COLUMNS:
            raise SystemExit(f"{given.out} has other columns; name a new file")
        file.seek(0)
        there = {tuple(row[name] for name in COLUMNS[:4]) for row in csv.DictReader(file)}
    bends = {}
    recordings = mannequin(presses) if given.study == "mannequin" else human_arm(presses)
    for i, (tube, level, place, (case, matrix), n_cycles) in enumerate(recordings):
        depth, force = float(case["depth"]), float(case["force"])
        key = str(tube), level, f"{100 * place:.4f}", f"{1e3 * depth:.4f}"
        if i % given.every or key in there:
            continue
        if tube not in inverters:
            inverters[tube] = sleeve_inverter(library, tube, like)
        if (tube, place) not in bends:
            bends = {(tube, place): bent_around(sleeve()[tube], place, like)}
        cycles = cycles_of(matrix, place, bends[tube, place], tube=tube, n_cycles=n_cycles,
                           name=[level, place, depth], labels={"force": force})  # fmt: skip
        peak = float(found_distance(estimates_of(human.averaged([cycles]), tube))[0])
        start = time.process_time()
        ((_, found),) = inverters[tube].groups(Path("cycles"), cycles, n_cycles, lambda: None)
        seconds = time.process_time() - start
        row = dict(zip(COLUMNS, (*key, f"{force:.4f}"), strict=False)) | {
            "found": 0, "n_contacts": len(found.contacts), "misfit": f"{found.misfit:.4g}",
            "residual": f"{found.residual:.4g}",
            "seconds": f"{seconds:.2f}", "peak_cm": f"{100 * peak:.3f}",
        }  # fmt: skip
        near = min(found.contacts, key=lambda one: abs(one.distance.value - place), default=None)
        if near is not None and abs(near.distance.value - place) < NEAR:
            row |= {"found": 1, "mm": f"{1e3 * near.depth.value:.4f}"}
            for name, scale, told in (("cm", 100, near.distance), ("n", 1, near.force)):
                for what, value in zip(
                    ("", "_low", "_high"), (told.value, *told.intervals[0.9]), strict=True
                ):
                    row[name + what] = f"{scale * value:.4f}"
        with given.out.open("a", newline="") as file:
            csv.DictWriter(file, COLUMNS, lineterminator="\n").writerow(row)
    summary(given.out)


if __name__ == "__main__":
    main()
