"""Many cycles of a rangefinder: noise, drift and the ADC."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from acoustube.base.errors import ConfigError
from acoustube.ranging.analogue import response
from acoustube.ranging.rangefinder import Rangefinder
from acoustube.waves.grid.polyhedron import Array
from acoustube.waves.scattering import PlacedScatterer

Numbers = NDArray[np.integer[Any]]

CHUNK = 256
"""Cycles that are digitised at once."""
NOISE, TEMPERATURE, DRIFT = range(3)
"""Purposes that random numbers are drawn for."""
DRIFT_PERIODS = np.geomspace(10.0, 1000.0, 8)
"""In s: a drift is constant within a record, and no two minutes of it are alike."""


def digitise(
    voltage: Array,
    rangefinder: Rangefinder,
    cycles: Numbers,
    seed: int,
    session_seed: int | None = None,
) -> NDArray[Any]:
    """Return what the ADC makes of a voltage in each cycle.

    Parameters
    ----------
    voltage : ndarray
        (n_samples,) in V, without offset.
    rangefinder : Rangefinder
    cycles : ndarray of int
        Numbers of the cycles, (n,): each has its own noise, whatever others there are.
    seed : int
    session_seed : int, optional
        Of the drift, in place of `seed`.

    Returns
    -------
    ndarray
        Counts, (n, n_samples): uint16, or float64 if not quantised.
    """
    r = rangefinder
    per_volt = 2**r.bits / r.full_scale
    counts = np.empty((len(cycles), len(voltage)), np.uint16 if r.quantised else np.float64)
    mean = (voltage * per_volt).astype(np.float32 if r.quantised else np.float64)
    drifting = seed if session_seed is None else session_seed
    shift = (r.offset + _wander(r, cycles, drifting)) * per_volt
    noise = np.zeros((min(CHUNK, len(cycles)), len(voltage)), np.float32)
    for start in range(0, len(cycles), CHUNK):
        part = slice(start, start + CHUNK)
        block = noise[: len(cycles[part])]
        if r.noise > 0:
            for row, cycle in zip(block, cycles[part], strict=True):
                _generator(seed, NOISE, cycle).standard_normal(out=row, dtype=np.float32)
        exact = mean + block * np.float32(r.noise * per_volt) + shift[part, None].astype(mean.dtype)
        counts[part] = np.clip(np.rint(exact), 0, 2**r.bits - 1) if r.quantised else exact
    return counts


def _generator(seed: int, *key: int) -> np.random.Generator:
    """Return the random numbers of one purpose and cycle, whatever others were drawn."""
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=key)))


def _wander(rangefinder: Rangefinder, cycles: Numbers, seed: int) -> Array:
    """Return the drift of each cycle in V: slow sines of random phase."""
    phase = _generator(seed, DRIFT).uniform(0, 2 * pi, len(DRIFT_PERIODS))
    turns = np.outer(cycles / rangefinder.cycle_rate, 2 * pi / DRIFT_PERIODS)
    rms = rangefinder.drift * np.sqrt(2 / len(phase))
    return np.asarray(rms * np.sin(turns + phase).sum(axis=1))


def _reported(temperature: float, rangefinder: Rangefinder, cycles: Numbers, seed: int) -> Array:
    """Return the temperature in degC that the board reports in each cycle."""
    r = rangefinder
    error = np.full(len(cycles), r.temperature_bias)
    if r.temperature_noise > 0:
        draws = [_generator(seed, TEMPERATURE, cycle).normal() for cycle in cycles]
        error += r.temperature_noise * np.array(draws)
    step = r.temperature_resolution
    exact = temperature + error
    return np.round(exact / step) * step if step > 0 else exact


def record(
    presses: Sequence[PlacedScatterer],
    rangefinder: Rangefinder | None = None,
    *,
    radius: float = 3.95e-3,
    length: float = 2.5,
    temperature: float = 20.0,
    n_cycles: int = 1,
    first_cycle: int = 0,
    seed: int = 0,
    session_seed: int | None = None,
    tube_seed: int = 0,
) -> xr.Dataset:
    """Return what a rangefinder records of a tube that is held still.

    Parameters
    ----------
    presses : sequence of PlacedScatterer
        None for an untouched tube.
    rangefinder : Rangefinder, optional
        Default that of the paper; see :data:`IDEAL`.
    radius, length : float
        Of the bore, in m. Defaults the paper's.
    temperature : float
        Of the air, in degC.
    n_cycles, first_cycle : int
        How many cycles, and the number of the first. A cycle is the same in whatever run.
    seed : int
        Of noise, drift and temperature. Runs that shall differ need different ones.
    session_seed : int, optional
        Of the drift, in place of `seed`: cycles of one session share it.
    tube_seed : int
        Of the clutter, which belongs to the tube.

    Returns
    -------
    xarray.Dataset
        ``signal`` (cycle, time) in counts and ``temperature`` (cycle) in degC, both with units;
        all parameters among the attributes, those of the rangefinder as JSON.

    Raises
    ------
    ValueError
        As :func:`response`, or if there are no cycles.
    """
    if n_cycles < 1 or first_cycle < 0:
        raise ConfigError(
            f"n_cycles = {n_cycles} from first_cycle = {first_cycle}: use 1 or more, from 0 or more"
        )
    r = Rangefinder() if rangefinder is None else rangefinder
    time, voltage = response(
        presses, r, radius=radius, length=length, temperature=temperature, tube_seed=tube_seed
    )
    cycles = np.arange(first_cycle, first_cycle + n_cycles)
    variables = {
        "signal": (("cycle", "time"), digitise(voltage, r, cycles, seed, session_seed),
                   {"units": "1", "long_name": "counts of the ADC"}),
        "temperature": ("cycle", _reported(temperature, r, cycles, seed),
                        {"units": "degC", "long_name": "temperature that the board reports"}),
    }  # fmt: skip
    coordinates = {
        "time": ("time", time, {"units": "s", "long_name": "time since the record began"}),
        "cycle": ("cycle", cycles, {"units": "1", "long_name": "number of the cycle"}),
    }
    return xr.Dataset(
        variables,
        coordinates,
        {
            "source": "simulation", "sampling_rate": r.sampling_rate, "full_scale": 2**r.bits,
            "seed": seed, "tube_seed": tube_seed, "air_temperature": temperature,
            "bore_radius": radius, "tube_length": length,
            "press_positions": np.array([press.position for press in presses], float),
            "rangefinder": r.to_json(),
        },
    )  # fmt: skip
