"""Errors of the network of the whole echo on the recordings of ``inversion_contacts.py``.

The estimator `echo` is trained for position, depth and force on single cycles of presses at random
positions, with scattering by the spectral solver at other depths; rangefinder, tube, and the
range of temperatures are those of the test recordings. These are the single presses of
``inversion_contacts.py``, with the same file of scattering, seeds, positions and depths. The cycles
of a recording are averaged before the estimate.

Usage: python benchmarks/inversion_beside_network.py --truth FOLDER --count 500 --cycles 20
"""

from __future__ import annotations

import argparse
import time

import numpy as np
import xarray as xr
from inversion_contacts import LENGTH, NEAR, TUBE, Truth, cases, recorded

from acoustube import estimation
from acoustube.estimation import FeatureSettings
from acoustube.estimation.model import TARGETS
from acoustube.ranging import Rangefinder
from acoustube.reports.studies.calibration import calibrated

SEED, TEST_SEED = 50, 101
"""Random seeds of the training presses, and of those of ``inversion_contacts.py``."""
FIRST = 100_000
"""Number of the first recording for training; test recordings begin with 0."""
PARTS = {
    "to 1.3 m, from 2.5 mm": (0, 1.3, 2.5e-3, 1), "to 1.3 m, under 2.5 mm": (0, 1.3, 0, 2.5e-3),
    "beyond 1.3 m": (1.3, 9, 0, 1), "all": (0, 9, 0, 1),
}  # fmt: skip


def labelled(truth, drawn, cycles):
    """Return averaged recordings of single presses with their labels."""
    device, tube = Rangefinder(), {"tube_seed": TUBE, "length": LENGTH, "radius": truth.bore / 2}
    rows = []
    for number, places, depths in drawn:
        data = recorded(truth, (number, places, depths), device, cycles, tube)
        mean = data.mean("cycle", keep_attrs=True).expand_dims("cycle").transpose("cycle", ...)
        known = {"true_distance": places[0], "depth": depths[0], "force": truth.force(depths[0])}
        rows.append(mean.assign({name: ("cycle", [value]) for name, value in known.items()}))
    return xr.concat(rows, "cycle", combine_attrs="drop_conflicts")


def main():
    """Train, estimate, and print errors by distance and depth."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--truth", default="spectral", help="as of inversion_contacts.py")
    parser.add_argument("--mesh", default="usual", help="of the wall of a folder's presses")
    parser.add_argument("--count", type=int, default=500)
    parser.add_argument("--cycles", type=int, default=20)
    parser.add_argument("--learned", type=int, default=4000, help="number of cycles")
    given = parser.parse_args()
    settings = FeatureSettings(kind="echo", processing=calibrated(TUBE)[0].processing)
    known, unknown = Truth("spectral", {}), Truth(given.truth, {}, given.mesh)
    start = time.perf_counter()
    drawn = cases(known.depths(), 0, given.learned, 1, SEED)
    first = labelled(known, ((FIRST + n, z, d) for n, z, d in drawn), 1)
    model = estimation.train(estimation.feature_table(first, settings), "echo", settings)
    print(f"{given.learned} cycles recorded and learned in {time.perf_counter() - start:.0f} s")
    tried = labelled(unknown, cases(unknown.depths(), 0, given.count, 1, TEST_SEED), given.cycles)
    start = time.perf_counter()
    found = estimation.estimate(model, estimation.feature_table(tried, settings))
    print(f"estimated in {1e3 * (time.perf_counter() - start) / given.count:.1f} ms each")
    place, depth = tried["true_distance"].values, tried["depth"].values
    for name, (near, far, low, high) in PARTS.items():
        some = (place >= near) & (place < far) & (depth >= low) & (depth < high)
        if not some.any():
            continue
        off = np.abs(found["distance"].values - place)[some]
        words = [f"{some.sum()} presses, within 5 cm {np.mean(off < NEAR):.0%}"]
        some &= np.isfinite(found["distance"].values)
        words.append(f"with an echo {some.sum()}, of which")
        for target, unit, scale in (("true_distance", "mm", 1e3), ("depth", "mm", 1e3)):
            size = scale * np.abs(found[TARGETS[target]].values - tried[target].values)[some]
            a, b, c = np.quantile(size, [0.5, 0.9, 0.99])
            words.append(f"{TARGETS[target]} {a:.3g} / {b:.3g} / {c:.3g} {unit} (50, 90, 99 %)")
            held = size <= scale * found[TARGETS[target] + "_half_width"].values[some]
            words.append(f"90 % intervals hold {np.mean(held):.0%}")
        force = np.abs(found["force"].values / tried["force"].values - 1)[some]
        words.append("force {:.1%} / {:.1%} (50, 90 %)".format(*np.quantile(force, [0.5, 0.9])))
        print(f"{name}: {'; '.join(words)}")


if __name__ == "__main__":
    main()
