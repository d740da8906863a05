"""Errors predicted by a design, against those of inversions of simulated recordings.

For a sensor of a design's folder: random contacts are drawn with a separate seed, their scattering
is computed at depths between the library's, with losses in the presses, and the rangefinder records
it with noise, clutter (learned from 200 untouched cycles) and air 0.3 K off. The inversion's errors
are then divided by the standard deviations that the design predicts for these contacts, with the
tube as computed in the design (coarse mesh, few depths).

Usage: acoustube library --config FOLDER/NAME.config.toml --depth 0.5:7:0.25 --out library
       python benchmarks/design_predictions.py FOLDER NAME library out.csv --count 16
"""

from __future__ import annotations

import argparse
import csv
import dataclasses
import time
from pathlib import Path

import numpy as np

from acoustube.air import air_at
from acoustube.base import cache
from acoustube.indentation import DepthPath
from acoustube.inversion import Library, Priors, Tool
from acoustube.inversion.design import Contacts
from acoustube.inversion.design.electronics import electronics_of
from acoustube.inversion.design.prediction import predict
from acoustube.lumen import pressed_part
from acoustube.ranging import Rangefinder, record
from acoustube.runs import inversion, presses, scattering_file, sound
from acoustube.runs.config import load_config
from acoustube.runs.config.goal import read_goal
from acoustube.runs.config.si import MESH_SIZES, settings_in_si
from acoustube.runs.design.search import known_of
from acoustube.runs.design.tubes import TubeSpec, band_of, plan_of, pressed_tubes, sounded
from acoustube.runs.libraries.build import scattering_at
from acoustube.runs.libraries.files import open_library
from acoustube.runs.sweep.graph import BURST_CYCLES
from acoustube.tube import shear_modulus_from_shore
from acoustube.waves import PlacedScatterer, Pulse
from acoustube.waves.network import at_sound_speed

TUBE = 7
"""Seed of the tube's clutter."""
COLUMNS = (
    "number", "place_cm", "force_n", "depth_mm", "found", "place_error_mm", "depth_error_um",
    "place_sd_mm", "depth_sd_um", "bound_sd_um", "detected", "wrong", "contacts", "seconds",
)  # fmt: skip


def matrix_at(plan, path, depth, band, mesh):
    """Return the scattering of a press with losses, from the cache or computed."""
    parts = {"benchmark": plan.name, "depth": depth, "band": list(band), "mesh": mesh}
    name = cache.key("scattering", parts)
    known = scattering_file.recall(name)
    if known is None:
        part = pressed_part(path.at([depth]))
        known = sound.spectral_scattering_of(part, plan.settings.air, band, lossy=True)
        scattering_file.keep(name, known, f"benchmark: {1e3 * depth:.3f} mm")
    return known


def arguments():
    """Return the arguments of the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="of the design")
    parser.add_argument("name", help="of the sensor")
    parser.add_argument("tools", type=Path, help="folder of the library, or own: of the design")
    parser.add_argument("out", type=Path)
    parser.add_argument("--count", type=int, default=16)
    parser.add_argument("--seed", type=int, default=5)
    parser.add_argument("--mesh", choices=tuple(MESH_SIZES), default="usual", help="of the truth")
    return parser.parse_args()


def prepared(given):
    """Return the goal, the sensor, its tube's plan, path and pressed tubes, and the settings."""
    design = read_goal(given.folder / "goal.toml")
    sensor = inversion.read_sensor(given.folder / f"{given.name}.sensor.toml")
    sensor = dataclasses.replace(sensor, priors=Priors(thermometer=0.0))
    settings = settings_in_si(load_config(given.folder / f"{given.name}.config.toml"))
    config = load_config(given.folder / f"{given.name}.config.toml")
    pressed = 35.0 if design.goal.support == "table" else config.tube.shore_a
    spec = TubeSpec(config.tube.inner_diameter_mm, config.tube.wall_mm, pressed)
    band = band_of(design, [Rangefinder().resonance])
    plan = plan_of(design, spec, design.goal.tools_mm[0], band)
    tubes = pressed_tubes(spec, design.goal.tools_mm[:1], [sounded(plan).result])
    wall = dataclasses.replace(
        plan.settings if given.mesh == "coarse" else settings, mesh=MESH_SIZES[given.mesh]
    )
    path = DepthPath(presses.press_to(wall, plan.pressed))
    return design, sensor, plan, path, tubes, config.tube.shore_a


def own_library(plan, carrier, modulus):
    """Return the library of the design's presses, about a carrier in Hz, with another modulus."""
    path = DepthPath(presses.press_to(plan.settings, plan.pressed))
    found = [(d, scattering_at(plan, d, pressed_part(path.at([d])))[0]) for d in plan.first]
    found = [(d, one) for d, one in found if not isinstance(one, str)]
    depth, first = np.array([d for d, _ in found]), found[0][1]
    f = np.asarray(first.frequency, float)
    kept = (f > 0.8 * carrier) & (f < 1.2 * carrier)
    settings, n = plan.settings, len(depth)
    return Library((Tool(
        shape=settings.indenter.shape, diameter=settings.indenter.diameter, radius=settings.radius,
        depth=depth, force=modulus * np.asarray(path.contact_force(depth), float),
        force_error=np.zeros(n), frequency=f[kept], modes=first.modes,
        s=np.array([one.s[kept] for _, one in found]), error=np.zeros(n),
        interpolation_error=np.zeros(n - 1), sound_speed=settings.air.sound_speed,
    ),))  # fmt: skip


def contacts(design, library, tubes, given):
    """Return contacts within the library and their depths in m."""
    rng, goal, tool = np.random.default_rng(given.seed), design.goal, library.tools[0]
    places = rng.uniform(goal.nearest_m, goal.reach_m - 0.1, given.count)
    low = max(goal.forces_n[0], float(tool.force[0]))
    # Within the range of the design's presses, which are on another mesh.
    deepest = min(tool.depth[-1], 0.99 * tubes[0].depth[-1])
    high = min(goal.forces_n[1], float(np.interp(deepest, tool.depth, tool.force)))
    forces = low * (high / low) ** rng.random(given.count)
    depths = np.round(np.interp(forces, tool.force, tool.depth), 7)
    return Contacts(
        place=places, force=forces, tool=np.zeros(given.count, int), lightest=goal.forces_n[0],
        strongest=goal.forces_n[1], length=goal.reach_m,
    ), depths  # fmt: skip


def main():
    """Record and invert, and print ratios of errors and predictions."""
    given = arguments()
    design, sensor, plan, path, tubes, shore = prepared(given)
    average, carrier = design.goal.average, sensor.rangefinder.resonance
    own = str(given.tools) == "own"
    modulus = shear_modulus_from_shore(shore) / plan.settings.tube.shear_modulus
    library = own_library(plan, carrier, modulus) if own else open_library(given.tools)
    drawn, depths = contacts(design, library, tubes, given)
    device, temperature = sensor.rangefinder, design.goal.temperature_c
    radius, length = library.radius, design.goal.reach_m
    tube = {"radius": radius, "length": length, "tube_seed": TUBE}
    found = predict(known_of(design, tubes, shore, drawn), electronics_of(device, 1, average))
    free = record([], device, n_cycles=200, seed=11, temperature=temperature, **tube)
    inverter = inversion.RecordingInverter(library, sensor, [(Path("free"), free)], 1)
    # All that the rangefinder receives, also outside the library's band.
    cycles = min(device.drive.cycles, BURST_CYCLES)
    band = sound.band_of(Pulse(frequency=device.resonance, cycles=round(cycles)))
    rows = []
    for i, (place, depth) in enumerate(zip(drawn.place, depths, strict=True)):
        air = temperature + np.random.default_rng(given.seed + i).uniform(-0.3, 0.3)
        speed = air_at(air).sound_speed
        matrix = at_sound_speed(matrix_at(plan, path, depth, band, given.mesh), speed)
        data = record(
            [PlacedScatterer(matrix, place)], device, n_cycles=average, seed=1000 + i,
            temperature=air, **tube,
        )  # fmt: skip
        start = time.process_time()
        ((_, told),) = inverter.groups(Path("cycles"), data, average, lambda: None)
        off = [(abs(c.distance.value - place), c.distance.value - place, c.depth.value - depth)
               for c in told.contacts]  # fmt: skip
        _, off_place, off_depth = min(off, default=(np.nan, np.nan, np.nan))
        values = (
            i, 100 * place, drawn.force[i], 1e3 * depth, int(abs(off_place) < 0.05),
            1e3 * off_place, 1e6 * off_depth, 1e3 * found.place[i], 1e6 * found.depth[i],
            1e6 * found.noise[i] / known_slope(design, tubes, shore, drawn, i), found.found[i],
            found.wrong[i], len(told.contacts), time.process_time() - start,
        )  # fmt: skip
        rows.append({n: float(f"{v:.5g}") for n, v in zip(COLUMNS, values, strict=True)})
        print(rows[-1], flush=True)
    with given.out.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    summary(rows)


def known_slope(design, tubes, shore, drawn, i):
    """Return the relative change of force with depth of a contact in 1/m."""
    return known_of(design, tubes, shore, drawn).slope[i]


def summary(rows):
    """Print medians of errors over predicted deviations; a normal distribution has 0.67."""
    table = {name: np.array([row[name] for row in rows]) for name in COLUMNS}
    good = (table["found"] == 1) & (table["detected"] > 0.9)
    print(f"{len(rows)} contacts, {int((table['found'] == 1).sum())} found; expected "
          f"{table['detected'].sum():.1f}")  # fmt: skip
    for error, deviation in (("place_error_mm", "place_sd_mm"), ("depth_error_um", "depth_sd_um")):
        ratio = np.abs(table[error][good]) / table[deviation][good]
        rms = np.sqrt(np.mean(ratio**2))
        print(f"{error} over {deviation}: median {np.median(ratio):.2f}, rms {rms:.2f}")


if __name__ == "__main__":
    main()
