"""Cycles of a rangefinder: noise, drift, reported temperature and the ADC.

References
----------
* Random numbers of each cycle, independent of the other cycles drawn: Salmon, J. K. et al.,
  Parallel random numbers: as easy as 1, 2, 3, SC '11 (2011). doi:10.1145/2063384.2063405
"""

from __future__ import annotations

from collections.abc import Sequence
from math import pi
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

from acoustube.base.checks import SEED, Optional, Reals, Several, checked
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.base.types import Array
from acoustube.ranging.analogue import response
from acoustube.ranging.rangefinder import Rangefinder
from acoustube.waves.scattering import PlacedScatterer

if TYPE_CHECKING:
    import xarray as xr

Numbers = NDArray[np.integer[Any]]

CYCLES_PER_CHUNK = 256
"""Number of cycles digitised at once."""
NOISE_STREAM, TEMPERATURE_STREAM, DRIFT_STREAM, TRIGGER_STREAM = range(4)
"""Keys of the independent streams of random numbers."""
DRIFT_PERIODS = np.geomspace(10.0, 1000.0, 8)
"""Periods in s of the sines that make up the drift: much longer than a record, with no common
period."""


@checked(
    voltage=Reals(ndim=1, axes=1),
    rangefinder=Rangefinder,
    cycles=Reals(0, 2**53, ndim=1, kinds="iu", empty=True),
    seed=SEED,
    session_seed=Optional(SEED),
)
def digitise(
    voltage: Array,
    rangefinder: Rangefinder,
    cycles: Numbers,
    seed: int,
    session_seed: int | None = None,
) -> NDArray[Any]:
    """Return the ADC's counts of a voltage in each cycle.

    Parameters
    ----------
    voltage : ndarray
        (n_samples,) in V, without offset.
    rangefinder : Rangefinder
    cycles : ndarray of int
        Numbers of the cycles, (n,); the noise of a cycle depends on its number and the seed alone.
    seed : int
        Random seed of noise, trigger delays and gains.
    session_seed : int, optional
        Random seed of the drift; default `seed`.

    Returns
    -------
    ndarray
        Counts, (n, n_samples): uint16, or float64 if not quantised.
    """
    voltage, cycles = np.asarray(voltage), np.asarray(cycles)
    per_volt = 2**rangefinder.bits / rangefinder.full_scale
    counts = np.empty(
        (len(cycles), len(voltage)), np.uint16 if rangefinder.quantised else np.float64
    )
    mean = (voltage * per_volt).astype(np.float32 if rangefinder.quantised else np.float64)
    drifting = seed if session_seed is None else session_seed
    shift = (rangefinder.offset + _drift(rangefinder, cycles, drifting)) * per_volt
    noise = np.zeros((min(CYCLES_PER_CHUNK, len(cycles)), len(voltage)), np.float32)
    for start in range(0, len(cycles), CYCLES_PER_CHUNK):
        part = slice(start, start + CYCLES_PER_CHUNK)
        block = noise[: len(cycles[part])]
        if rangefinder.noise > 0:
            for row, cycle in zip(block, cycles[part], strict=True):
                _generator(seed, NOISE_STREAM, cycle).standard_normal(out=row, dtype=np.float32)
        exact = (
            _varied(mean, rangefinder, cycles[part], seed)
            + block * np.float32(rangefinder.noise * per_volt)
            + shift[part, None].astype(mean.dtype)
        )
        counts[part] = (
            np.clip(np.rint(exact), 0, 2**rangefinder.bits - 1) if rangefinder.quantised else exact
        )
    return counts


def _varied(mean: Array, rangefinder: Rangefinder, cycles: Numbers, seed: int) -> Array:
    """Return the noise-free signal `mean` with each cycle's trigger delay and gain, (n, n_samples).

    If neither delay nor gain varies, `mean` is returned unchanged, (n_samples,).
    """
    if rangefinder.jitter == 0 and rangefinder.gain_wander == 0:
        return mean
    draws = np.array([_generator(seed, TRIGGER_STREAM, cycle).normal(size=2) for cycle in cycles])
    n = next_fast_len(2 * len(mean), real=True)  # padded against wrap-around of late samples
    turn = -2j * pi * np.fft.rfftfreq(n, 1 / rangefinder.sampling_rate)
    late = np.exp(turn * (rangefinder.jitter * draws[:, :1]))
    each = np.fft.irfft(np.fft.rfft(mean, n) * late, n)[:, : len(mean)]
    return np.asarray(each * (1 + rangefinder.gain_wander * draws[:, 1:]), mean.dtype)


def _generator(seed: int, *key: int) -> np.random.Generator:
    """Return the random generator of a key (stream, then cycle); all keys are independent."""
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=key)))


def _drift(rangefinder: Rangefinder, cycles: Numbers, seed: int) -> Array:
    """Return the drift of each cycle in V: a sum of slow sines of random phase."""
    phase = _generator(seed, DRIFT_STREAM).uniform(0, 2 * pi, len(DRIFT_PERIODS))
    turns = np.outer(cycles / rangefinder.cycle_rate, 2 * pi / DRIFT_PERIODS)
    rms = rangefinder.drift * np.sqrt(2 / len(phase))
    return np.asarray(rms * np.sin(turns + phase).sum(axis=1))


def _reported_temperature(
    temperature: float, rangefinder: Rangefinder, cycles: Numbers, seed: int
) -> Array:
    """Return the temperature in degC that the board reports in each cycle."""
    error = np.full(len(cycles), rangefinder.temperature_bias)
    if rangefinder.temperature_noise > 0:
        draws = [_generator(seed, TEMPERATURE_STREAM, cycle).normal() for cycle in cycles]
        error += rangefinder.temperature_noise * np.array(draws)
    step = rangefinder.temperature_resolution
    exact = temperature + error
    return np.round(exact / step) * step if step > 0 else exact


@checked(
    presses=Several(PlacedScatterer),
    rangefinder=Rangefinder,
    n_cycles=Number(-1e9, 1e9, whole=True),
    first_cycle=Number(-1e9, 1e12, whole=True),
    seed=SEED,
    session_seed=SEED,
)
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
    reflectors: Array | None = None,
) -> xr.Dataset:
    """Return the recording of a rangefinder on a tube in a fixed state.

    Parameters
    ----------
    presses : sequence of PlacedScatterer
        Empty for an untouched tube.
    rangefinder : Rangefinder, optional
        Default: the sleeve paper's board ("Wearable, Fabric-Embedded Acoustic Waveguides for
        Meter-Scale Contact Localization and Force Sensing"); see also :data:`IDEAL`.
    radius, length : float
        Radius of the bore and length of the tube in m. Defaults: the sleeve paper's.
    temperature : float
        Temperature of the air in degC.
    n_cycles, first_cycle : int
        Number of cycles, and the number of the first. The same number gives the same cycle.
    seed : int
        Random seed of noise, trigger delays, gains and reported temperature.
    session_seed : int, optional
        Random seed of the drift; default `seed`. Cycles of one session share it.
    tube_seed : int
        Random seed of the clutter, which belongs to the tube.
    reflectors : ndarray, optional
        Reflection coefficients of the tube's irregularities, in place of random ones; see
        :func:`~acoustube.ranging.clutter`.

    Returns
    -------
    xarray.Dataset
        ``signal`` (cycle, time) in counts and ``temperature`` (cycle) in degC, both with units, on
        coordinates ``time`` in s and ``cycle``. Attributes are the rangefinder as JSON, the tube,
        the temperature, the positions of the presses, `seed` and `tube_seed`, but neither
        `session_seed` nor `reflectors`.

    Raises
    ------
    ValueError
        As :func:`response`, or if n_cycles < 1 or first_cycle < 0.
    """
    import xarray as xr  # 70 MB with pandas; acoustube.sensor needs none of it

    for name, value, least in (("n_cycles", n_cycles, 1), ("first_cycle", first_cycle, 0)):
        if value < least:
            raise ConfigError(
                "is out of range", setting=name, value=value, allowed=(least, np.inf),
                advice=f"use {least} or more",
            )  # fmt: skip
    rangefinder = rangefinder or Rangefinder()
    time, voltage = response(
        presses,
        rangefinder,
        radius=radius,
        length=length,
        temperature=temperature,
        tube_seed=tube_seed,
        reflectors=reflectors,
    )
    cycles = np.arange(first_cycle, first_cycle + n_cycles)
    variables = {
        "signal": (("cycle", "time"), digitise(voltage, rangefinder, cycles, seed, session_seed),
                   {"units": "1", "long_name": "counts of the ADC"}),
        "temperature": ("cycle", _reported_temperature(temperature, rangefinder, cycles, seed),
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
            "source": "simulation", "sampling_rate": rangefinder.sampling_rate,
            "full_scale": 2**rangefinder.bits,
            "seed": seed, "tube_seed": tube_seed, "air_temperature": temperature,
            "bore_radius": radius, "tube_length": length,
            "press_positions": np.array([press.position for press in presses], float),
            "rangefinder": rangefinder.to_json(),
        },
    )  # fmt: skip
