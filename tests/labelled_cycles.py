"""Labelled cycles of a synthetic sensor whose presses reflect more the deeper they are.

The reflection of a press is a smooth function of frequency, of which level and tilt depend on the
depth; the record is made by :func:`acoustube.ranging.record`, with noise and weak clutter.
"""

from dataclasses import replace

import numpy as np
import xarray as xr

from acoustube.ranging import Rangefinder, blockage, record
from acoustube.signals import Processing
from acoustube.waves import PlacedScatterer

BAND = np.arange(28e3, 56.1e3, 500.0)
SENSOR = Rangefinder(clutter=1e-6)
HOW = Processing(prominence=0.001, send_shift=-2e-5)


def press(depth, position):
    """Return a press in m that reflects 2 % of the sound per mm, with a tilt of its spectrum."""
    closed = blockage(BAND, position).scattering
    share = np.clip(20 * depth * (1 + 80 * depth * (BAND - 42e3) / 42e3), 0.0, 0.5)
    s = np.zeros_like(closed.s)
    s[:, (0, 1), 0, (0, 1), 0] = share[:, None]
    s[:, (0, 1), 0, (1, 0), 0] = 1j * np.sqrt(1 - share**2)[:, None]
    return PlacedScatterer(replace(closed, s=s), position)


def cycles(n_presses, *, seed=0, n_cycles=1, tube="a", farthest=1.2, stiffness=600.0):
    """Return cycles of presses of 1 to 6 mm at 0.25 m and beyond, with all labels."""
    rng = np.random.default_rng(seed)
    parts = []
    for i in range(n_presses):
        depth, position = rng.uniform(1e-3, 6e-3), rng.uniform(0.25, farthest)
        warmth = rng.uniform(18, 24)
        found = record(
            [press(depth, position)], SENSOR, temperature=warmth, n_cycles=n_cycles,
            seed=1000 * seed + i, tube_seed=seed,
        )  # fmt: skip
        labels = {"true_distance": position, "depth": depth, "force": stiffness * depth,
                  "diameter": 0.025, "session": i // 10}  # fmt: skip
        units = {"true_distance": "m", "depth": "m", "force": "N", "diameter": "m", "session": "1"}
        found = found.assign(
            {
                name: ("cycle", np.full(n_cycles, value), {"units": units[name], "long_name": name})
                for name, value in labels.items()
            }
        )
        found["tube"] = ("cycle", np.full(n_cycles, tube), {"units": "1", "long_name": "tube"})
        parts.append(
            found.drop_vars("cycle")
            .drop_attrs(deep=False)
            .assign_attrs(sampling_rate=found.attrs["sampling_rate"], source="simulation")
        )
    data = xr.concat(parts, "cycle", data_vars="minimal", coords="minimal", join="override")
    number = np.arange(data.sizes["cycle"])
    return data.assign_coords(cycle=("cycle", number, {"units": "1", "long_name": "number"}))
