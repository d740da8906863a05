"""Errors of TubeSensor against the full chain, for random contacts; its speed and memory.

The full chain computes the scattering of each deformed lumen by the spectral solver, at depths that
the library lacks, places the matrices in the tube and records them (``acoustube.ranging.record``),
without noise. Echoes are compared in position (the lag of the highest correlation), amplitude (of
the envelope's peak) and sample by sample, each contact's from 2 ms before the next one's.

With ``--loops`` the tube is wrapped around the sleeve paper's forearm, in the chain as bends in
series with constant curvature over half a turn each.

Usage: acoustube library --indenter 25 --depth 0.5:8:0.25 --out FOLDER
       python benchmarks/sensor_cycles.py FOLDER --count 200 [--loops 9]
"""

from __future__ import annotations

import argparse
import dataclasses
import resource
import time

import numpy as np

from acoustube.air import air_at
from acoustube.ranging import Rangefinder, record
from acoustube.runs.wrap import wrap_of
from acoustube.sensor import Contact, TubeSensor
from acoustube.sleeve import design, windings, wrapped
from acoustube.waves import PlacedScatterer

PLACES, DEPTHS, FORMS = (0.3, 2.3), (0.7e-3, 7.9e-3), 40
"""Ranges in m of positions and depths, and the number of different depths."""
FOREARM = 0.26, (0.18, 0.266)
"""Length in m of a sleeve, and girths of the forearm at its ends."""
QUIET = dataclasses.replace(Rangefinder(), noise=0.0, drift=0.0, quantised=False, offset=0.0)


def matrices():
    """Return depths between the library's and their scattering, computed or from the cache."""
    # Imported here, as the memory of a process with a sensor alone is measured too.
    from acoustube.indentation import DepthPath
    from acoustube.lumen import pressed_part
    from acoustube.runs import presses
    from acoustube.runs.libraries.build import scattering_at
    from acoustube.runs.libraries.plan import tool_plans

    (plan,) = tool_plans({"indenter_mm": ["25"], "depth_mm": ["0.5:8:0.25"]}, 0.005)
    path = DepthPath(presses.press_to(plan.settings, plan.pressed))
    found = {}
    for depth in np.round(np.random.default_rng(3).uniform(*DEPTHS, FORMS), 7):
        matrix = scattering_at(plan, float(depth), pressed_part(path.at([depth]))).result
        if isinstance(matrix, str):
            print(f"{1e3 * depth:.4f} mm is left out: {matrix}")
        else:
            found[float(depth)] = matrix
    return found


def transparent(matrix):
    """Return the scattering of an undeformed tube, in the band of a press, for the chain."""
    s = np.zeros_like(matrix.s)
    for mode in range(len(matrix.modes)):
        s[:, 0, mode, 1, mode] = s[:, 1, mode, 0, mode] = matrix.propagates[:, mode]
    return dataclasses.replace(matrix, s=s)


def recorded(sensor, placed):
    """Return the counts of the full chain's cycle."""
    return record(placed, sensor.rangefinder, length=sensor.length)["signal"].values[0]


def compared(sensor, known, places, depths, arm):
    """Return errors of position in mm, amplitude and samples, of the first contact's echo."""
    from scipy.signal import hilbert

    placed = [PlacedScatterer(known[d], z) for z, d in zip(places, depths, strict=True)]
    if arm is None:
        free = [PlacedScatterer(transparent(known[depths[0]]), places[0])]
    else:
        free, tube = arm[1], {"radius": sensor.tool_library.radius, "reach": sensor.wrap.reach}
        placed = wrapped(arm[0], placed, air_at(sensor.temperature), **tube)
    truth, untouched = recorded(sensor, placed), recorded(sensor, free)
    given = [Contact(place=z, depth=d) for z, d in zip(places, depths, strict=True)]
    exact, found = truth - untouched, sensor.read(given) - sensor.read([])
    speed, rate = sensor.tool_library.sound_speed, sensor.rangefinder.sampling_rate
    start = int(rate * (2 * places[0] / speed - 0.1e-3))
    part = slice(start, start + int(1.5e-3 * rate))
    a, b = exact[part], found[part]
    lags = np.arange(-40, 41) / 8  # eighths of a sample
    spectrum, f = np.fft.rfft(a, 4 * len(a)), np.fft.rfftfreq(4 * len(a))
    shifted = [np.fft.irfft(spectrum * np.exp(-2j * np.pi * f * lag))[: len(a)] for lag in lags]
    best = int(np.argmax([x @ b for x in shifted]))
    height = np.abs(hilbert(b)).max() / np.abs(hilbert(a)).max() - 1
    place = 1e3 * lags[best] / rate * speed / 2
    return place, height, np.linalg.norm(b - a) / np.linalg.norm(a), \
        np.linalg.norm(found - exact) / np.linalg.norm(exact)  # fmt: skip


def in_words(values, scale=1.0):
    """Return median, 90 % and largest magnitude, as text."""
    q = np.quantile(np.abs(values) * scale, [0.5, 0.9, 1.0])
    return " / ".join(f"{x:.3g}" for x in q)


def accuracy(sensor, count, helix):
    """Print errors for one, two and three contacts."""
    known, rng = matrices(), np.random.default_rng(8)
    depths, arm = np.array(sorted(known)), None
    if helix is not None:
        like = known[depths[0]]
        arm = helix, windings(
            helix, air_at(sensor.temperature), like.frequency, [], reach=sensor.wrap.reach,
            radius=sensor.tool_library.radius, modes=like.modes,
        )  # fmt: skip
    for n in (1, 2, 3):
        rows = []
        for _ in range(count if n == 1 else count // 4):
            while True:
                places = np.sort(rng.uniform(*PLACES, n))
                if n == 1 or np.diff(places).min() > 0.15:
                    break
            rows.append(compared(sensor, known, places, rng.choice(depths, n), arm))
        place, height, first, whole = np.array(rows).T
        print(f"{n} contacts, {len(rows)} cycles; median / 90 % / largest of the first echo:")
        print(f"  place {in_words(place)} mm, amplitude {in_words(height, 100)} %, "
              f"samples {in_words(first, 100)} %; cycle {in_words(whole, 100)} %")  # fmt: skip


def speed(sensor):
    """Print the times of cycles, alone and in batches, and the memory."""
    rng = np.random.default_rng(0)
    contacts = [Contact(place=0.6, depth=3.1e-3), Contact(place=1.1, force=3.0)]
    for words, seed in (("without", None), ("with", 1)):
        sensor.read(contacts, seed=seed)
        times = []
        for _ in range(200):
            start = time.perf_counter()
            sensor.read(contacts, seed=seed)
            times.append(time.perf_counter() - start)
        print(f"read, {words} noise: {1e3 * np.quantile(times, 0.1):.2f} ms; {resident()}")
    nearest = sensor.span[0]
    places = nearest + np.cumsum(rng.uniform(0.1, 0.7, (2048, sensor.most_contacts)), axis=1)
    for words, seed in (("without", None), ("with", 1)):
        sensor.read_many(places, np.full_like(places, 3e-3), seed=seed)
        print(f"2048 cycles of read_many, {words} noise: {resident()}")
    for n in range(1, sensor.most_contacts + 1):
        places = nearest + np.cumsum(rng.uniform(0.1, 0.7, (2048, n)), axis=1)
        depths = rng.uniform(1e-3, 7e-3, (2048, n))
        own = TubeSensor(
            sensor.tool_library, length=sensor.length, most_contacts=n, wrap=sensor.wrap
        )
        for words, seed in (("without", None), ("with", 1)):
            own.read_many(places[:256], depths[:256], seed=seed)
            times = []
            for _ in range(3):
                start = time.perf_counter()
                own.read_many(places, depths, seed=seed)
                times.append(time.perf_counter() - start)
            rate = len(places) / min(times)
            print(f"read_many, {n} contacts, {words} noise: {rate:.0f} cycles/s")
    print(f"tables {sensor.tables.values.nbytes / 1e6:.0f} MB; four sensors: {resident()}")


def resident():
    """Return the largest resident set of the process so far, in words."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    return f"largest resident set {peak:.0f} MB"


def main():
    """Compare, and measure times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", help="of the library")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--only", choices=("accuracy", "speed"))
    parser.add_argument("--loops", type=float, help="of the tube about a forearm")
    given = parser.parse_args()
    helix, tube = None, {}
    if given.loops:
        helix = design(*FOREARM, loops=given.loops, n_tubes=2)[0]
        tube = {"wrap": wrap_of(helix), "length": helix.tube_length}
    if given.only != "speed":
        accuracy(TubeSensor.from_library(given.folder, QUIET, **tube), given.count, helix)
    start = time.process_time()
    sensor = TubeSensor.from_library(given.folder, **tube)
    print(f"sensor made in {time.process_time() - start:.1f} s; {resident()}")
    if given.only != "accuracy":
        speed(sensor)


if __name__ == "__main__":
    main()
