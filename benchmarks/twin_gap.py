"""How much of the gap between the default sensor and a hidden one does a twin close?

Hidden sensors are those of `twin_hidden_sensors.py`, with a wall of another hardness, on a tube of
the library's bore. A twin is fitted to closures, the untouched tube and six presses of known force.
The same estimator (gradient boosting on features of the echo) is trained on simulated presses of
the default sensor, on those of the twin, and on presses of the hidden sensor itself, and tested on
other presses of the hidden sensor: median absolute errors of distance, depth and force. Every
sensor and quantity is a row of a CSV file; existing sensors are not computed again.

Usage: python benchmarks/twin_gap.py LIBRARY out.csv --count 10
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import xarray as xr
from placed_press import placed_press
from resumed_table import completed
from scipy.interpolate import CubicSpline
from twin_hidden_sensors import FINE, LENGTH, RATE, SAMPLES, Bench, drawn

from acoustube import estimation
from acoustube.air import air_at
from acoustube.base.report import SILENT
from acoustube.inversion import Tool
from acoustube.ranging import Rangefinder, record
from acoustube.ranging.analogue import within
from acoustube.runs.libraries.files import open_library
from acoustube.runs.twin import Bench as Known
from acoustube.runs.twin import fitted_sensor
from acoustube.runs.twin_file import in_toml
from acoustube.runs.twin_pressed import fitted_material
from acoustube.runs.twin_sessions import recipe_settings

TARGETS = {"distance": ("true_distance", 100.0), "depth": ("depth", 1e3), "force": ("force", 1.0)}
COLUMNS = (
    "number", "target", "default", "twin", "itself", "closed", "stiffness", "told", "told_sd",
    "seconds",
)  # fmt: skip
REACH, DEPTHS = (0.4, 1.2), (2.5e-3, 7.8e-3)
TRAINING, TESTED, PRESSES = 500, 200, 6
TREES, FOLDS = 100, 3


class PressedBench(Bench):
    """A hidden sensor with presses of a library's tool."""

    def __init__(self, sensor, tool: Tool, stiffness: float, random: np.random.Generator) -> None:
        super().__init__(sensor, random)
        self.tool, self.stiffness = tool, stiffness
        frequency = np.fft.rfftfreq(2 * self.n, 1 / FINE)
        self.n_band = int(80e3 / FINE * 2 * self.n)
        self.frequency = frequency[: self.n_band]
        centre = np.exp(2j * np.pi * self.frequency * (len(self.filter) // 2) / FINE)
        passed = np.fft.rfft(self.filter, 2 * self.n)[: self.n_band] * centre
        self.sent, self.received = (
            np.fft.rfft(one, 2 * self.n)[: self.n_band] * passed for one in (self.rung, self.heard)
        )

    def pressed(self, place: float, depth: float, n: int) -> np.ndarray:
        """Return cycles of a press, in counts, with the plane wave's echo only."""
        s, plane = self.sensor, self.tool.matrix(depth)[:, :, 0, :, 0]
        at = np.clip(self.frequency * self.tool.sound_speed / air_at(s.air).sound_speed,
                     *self.tool.frequency[[0, -1]])  # fmt: skip
        found = CubicSpline(self.tool.frequency, plane)(at)
        reflected, through = found[:, 0, 0], found[:, 1, 0] * found[:, 0, 1]
        before = self.where < place
        total = self.ways[:, before] @ self.strength[before]
        total += through * (self.ways[:, ~before] @ self.strength[~before])
        loop = reflected * self.way(np.array([place]))[:, 0]
        total += loop / (1 - s.face * loop)
        return self.digitised(s.gain * self.received * total + s.send * self.sent, n)

    def digitised(self, spectrum: np.ndarray, n: int) -> np.ndarray:
        """Return cycles of a spectrum in counts, each with its own trigger, gain and noise."""
        s, found = self.sensor, []
        for _ in range(n):
            late = np.exp(-2j * np.pi * self.frequency * self.random.normal(0, s.jitter))
            one = np.fft.irfft(spectrum * late, 2 * SAMPLES)[:SAMPLES] * (SAMPLES / self.n)
            one = one * (1 + self.random.normal(0, s.wander)) + 0.9 + self.random.normal(0, 5e-3)
            one = one + self.random.normal(0, s.noise, SAMPLES)
            found.append(np.clip(np.rint(one / 1.8 * 2**s.bits), 0, 2**s.bits - 1))
        return np.array(found).astype(np.uint16)

    def force(self, depth):
        """Return the force of the wall in N."""
        return self.stiffness * self.tool.force_at(depth)


def hidden(number: int, tool: Tool) -> PressedBench:
    """Return a hidden sensor whose band the library covers."""
    random = np.random.default_rng([number, 5])
    sensor = replace(
        drawn(random), bore=2 * tool.radius * random.uniform(0.997, 1.003),
        resonance=42e3 + random.uniform(-800, 800), quality=random.uniform(12, 28),
        bits=int(random.choice([12, 12, 14])), clutter=float(np.exp(random.uniform(-12.2, -10))),
        n_closures=10, n_cycles=6,
    )  # fmt: skip
    return PressedBench(sensor, tool, float(np.exp(random.uniform(-0.5, 0.5))), random)


def fitted(bench: PressedBench, library: Path, folder: Path):
    """Return the settings of the twin of a hidden sensor, and its modulus over the library's."""
    s, random = bench.sensor, bench.random
    places = np.linspace(0.4, 2.0, s.n_closures)
    shut = [bench.counts(bench.volts(float(z + random.normal(0, s.placement)))) for z in places]
    common = {"sampling_rate_hz": RATE}
    np.savez(folder / "closed.npz", signal=np.concatenate(shut), temperature=bench.reading(),
             true_distance_cm=np.repeat(100 * places, s.n_cycles), **common)  # fmt: skip
    volts = bench.volts(None)
    free = np.concatenate([bench.counts(volts) for _ in range(8)])
    np.savez(folder / "free.npz", signal=free, temperature=bench.reading(), **common)
    depth = np.linspace(3.5e-3, 7e-3, PRESSES)
    where = np.linspace(0.45, 0.9, PRESSES)
    cycles = [bench.pressed(float(z), float(d), 10) for z, d in zip(where, depth, strict=True)]
    force = bench.force(depth) * (1 + random.normal(0, 0.02, PRESSES))
    np.savez(folder / "pressed.npz", signal=np.concatenate(cycles), temperature=bench.reading(),
             force_n=np.repeat(force, 10), true_distance_cm=np.repeat(100 * where, 10),
             **common)  # fmt: skip
    words = {"report": SILENT, "check": lambda: None}
    found = fitted_sensor([folder / "closed.npz"], [folder / "free.npz"], {}, None,
                          bench=Known(length=LENGTH), **words)  # fmt: skip
    material, states = fitted_material(found, [folder / "pressed.npz"], [folder / "free.npz"],
                                       library, {}, None, **words)  # fmt: skip
    path = folder / "own.twin.toml"
    path.write_text(in_toml(replace(found, material=material, pressed=states)))
    modulus = material.young_modulus
    return recipe_settings([path])[0], np.array([modulus.value, modulus.deviation])


def table_of(cycles, temperature, places, depths, forces, own=None):
    """Return the feature table of labelled cycles."""
    n = len(cycles)
    data = xr.Dataset(
        {"signal": (("cycle", "time"), np.asarray(cycles)),
         "temperature": ("cycle", np.broadcast_to(temperature, n).astype(float)),
         **{name: ("cycle", np.asarray(values, float)) for name, values in
            (("true_distance", places), ("depth", depths), ("force", forces))}},
        {"time": np.arange(SAMPLES) / RATE}, {"sampling_rate": RATE},
    )  # fmt: skip
    settings = own or estimation.FeatureSettings(kind="echo")
    return estimation.feature_table(data, settings, lambda _: None)


def simulated(rangefinder: Rangefinder, tool: Tool, air: float, random, reflectors=None):
    """Return cycles of random presses of a rangefinder, temperatures, and labels."""
    places, depths = drawn_presses(TRAINING, random)
    cycles, temperatures = [], []
    for i, (place, depth) in enumerate(zip(places, depths, strict=True)):
        here = air + random.uniform(-1, 1)
        press = placed_press(tool, float(place), float(depth), air_at(here).sound_speed)
        one = record([press], rangefinder, radius=tool.radius, length=LENGTH, temperature=here,
                     seed=i, session_seed=1, tube_seed=i, reflectors=reflectors)  # fmt: skip
        cycles.append(one["signal"].values[0])
        temperatures.append(float(one["temperature"].values[0]))
    return np.array(cycles), np.array(temperatures), places, depths


def drawn_presses(n, random):
    """Return random positions and depths in m."""
    return random.uniform(*REACH, n), random.uniform(*DEPTHS, n)


def trained(table):
    """Return the estimator."""
    return estimation.train(table, "boosting", estimation.FeatureSettings(kind="echo"),
                            max_iter=TREES, n_folds=FOLDS)  # fmt: skip


def medians(model, table):
    """Return the median absolute errors of an estimator in the units of the table."""
    found = estimation.estimate(model, table)
    return {
        name: scale * float(np.nanmedian(np.abs(found[name].values - table[label].values)))
        for name, (label, scale) in TARGETS.items()
    }


def rows_of(number: int, tool: Tool, library: Path):
    """Return the rows of a hidden sensor."""
    started, bench = time.process_time(), hidden(number, tool)
    with tempfile.TemporaryDirectory() as folder:
        settings, modulus = fitted(bench, library, Path(folder))
    random, reading = np.random.default_rng([number, 6]), bench.reading()
    tables = {}
    clutter_of_twin = within(settings["reflectors"], LENGTH)
    for name, own, clutter, stiff, air in (
        ("default", Rangefinder(), None, 1.0, reading),
        ("twin", settings["rangefinder"], clutter_of_twin,
         settings.get("young_modulus", tool.young_modulus) / tool.young_modulus,
         reading - settings["rangefinder"].temperature_bias),
    ):  # fmt: skip
        cycles, warm, places, depths = simulated(own, tool, air, random, clutter)
        tables[name] = table_of(cycles, warm, places, depths, stiff * tool.force_at(depths))
    for name, n in (("itself", TRAINING), ("test", TESTED)):
        places, depths = drawn_presses(n, random)
        cycles = np.concatenate([
            bench.pressed(float(z), float(d), 1) for z, d in zip(places, depths, strict=True)
        ])  # fmt: skip
        tables[name] = table_of(cycles, reading, places, depths, bench.force(depths))
    errors = {
        name: medians(trained(tables[name]), tables["test"])
        for name in ("default", "twin", "itself")
    }
    told = modulus / tool.young_modulus
    for target in TARGETS:
        default, twin, own = (errors[name][target] for name in ("default", "twin", "itself"))
        yield {
            "number": number, "target": target, "default": f"{default:.4g}", "twin": f"{twin:.4g}",
            "itself": f"{own:.4g}", "closed": f"{(default - twin) / (default - own):.3f}",
            "stiffness": f"{bench.stiffness:.4f}", "told": f"{told[0]:.4f}",
            "told_sd": f"{told[1]:.4f}", "seconds": f"{time.process_time() - started:.0f}",
        }  # fmt: skip


def main() -> None:
    """Compute the rows that are missing, and print the medians over the sensors."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="of the library")
    parser.add_argument("table", type=Path)
    parser.add_argument("--count", type=int, default=10)
    given = parser.parse_args()
    tool = open_library(given.folder).tools[0]
    cases = [(number, tool, given.folder) for number in range(given.count)]
    rows = completed(given.table, COLUMNS, ["number"], cases, rows_of)
    for target in TARGETS:
        these = [row for row in rows if row["target"] == target]
        mean = [np.mean([float(row[k]) for row in these]) for k in ("default", "twin", "itself")]
        share = (mean[0] - mean[1]) / (mean[0] - mean[2])
        print(f"{target:9} of {len(these)}: default {mean[0]:.3g}, twin {mean[1]:.3g}, itself "
              f"{mean[2]:.3g}; the twin closes {100 * share:.0f} % of the gap")  # fmt: skip


if __name__ == "__main__":
    main()
