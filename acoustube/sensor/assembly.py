"""Constant arrays of a sensor, computed from its library, rangefinder and tube."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from math import log, pi
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

from acoustube.air import Air, air_at
from acoustube.base.errors import ConfigError
from acoustube.base.types import Array
from acoustube.base.units import KHZ
from acoustube.inversion import Library, Wrap
from acoustube.ranging import Rangefinder
from acoustube.ranging.analogue import (
    REFLECTOR_SPACING,
    anti_alias,
    oversampling,
    sent_spectrum,
)
from acoustube.sensor.cycles import Parts, Shape
from acoustube.sensor.network import Constants, Entry, Pair
from acoustube.sensor.tables import PressTables, press_tables
from acoustube.sensor.wrapped import (
    PLACES,
    far_end,
    joined_tables,
    phases,
    untouched_echo,
    wrapped_path,
)
from acoustube.waves.modes.grid_modes import wavenumbers
from acoustube.waves.scattering import Complex

WRAPAROUND_ATTENUATION = 300.0
"""Factor by which echoes later than a cycle are attenuated, since they wrap around; a larger one
costs digits of float32."""
LEFT_OUT, MOST_LEFT_OUT = 5e-5, 3e-4
"""Fraction of the received energy left outside the band, and largest such fraction where the band
ends with that of the library."""

REFLECTORS_AT_ONCE = 256
"""Number of the clutter's reflectors that are computed at once, in double precision."""
TAPER = 0.1
"""Fraction of the band over which each of its ends is tapered."""
QUIET = 2.0
"""Product of two quantities: the time in s after a cycle in which the ends of the band may ring,
and the width of a taper in Hz."""


def assembled(
    library: Library,
    rangefinder: Rangefinder,
    length: float,
    temperature: float,
    tube_seed: int,
    tolerance: float,
    wrap: Wrap | None = None,
) -> tuple[PressTables, Shape, Parts, Pair | None]:
    """Return the tables of a sensor, inputs of its compiled functions, and the change by a wrap.

    The last is the echo of the untouched wrapped tube less that of the untouched straight one,
    (n_f,); None without a wrap.

    Parameters
    ----------
    library : Library
    rangefinder : Rangefinder
    length, temperature, tube_seed, tolerance, wrap
        As in :class:`acoustube.sensor.TubeSensor`.

    Raises
    ------
    ConfigError
        If the library's band does not contain the received spectrum, or its tools cannot be
        combined.
    """
    r, air = rangefinder, air_at(temperature)
    stretch = air.sound_speed / library.sound_speed
    available = (library.band[0] * stretch, library.band[1] * stretch)
    every = oversampling(r)
    rate, n = every * r.sampling_rate, every * r.n_samples
    _, _, inside = _received(r, rate, n, available)
    # The tapered band rings before an echo. This must not wrap into the cycle's end, which `growth`
    # amplifies.
    quiet = QUIET * n / (TAPER * inside.sum())
    period = next_fast_len(n + int(np.ceil(quiet)), real=True)
    damped, received, inside = _received(r, rate, period, available)
    damping = log(WRAPAROUND_ATTENUATION) * rate / period
    damped = damped[inside]
    press = press_tables(library, damped, stretch, tolerance)
    if wrap is None:
        tube = _straight(library, press, air, damped, r, length)
    else:
        tube = _wrapped(library, press, air, damped, r, length, wrap)
    given = len(damped), r.clutter, length, tube_seed
    clutter, whole = _clutter_beyond(tube.phase, *given)
    scale = r.gain * received[inside] * rate * _taper(int(inside.sum()))
    growth = np.exp(damping * np.arange(r.n_samples) / r.sampling_rate)
    constants = Constants(
        _float32(tube.tables.values), _float32(tube.decay), _float32(tube.turn), _float32(clutter),
        _float32(_triangle(tube.far)),
    )  # fmt: skip
    # The tables share the memory of `presses` on the CPU; those of a wrapped tube take 200 MB.
    tables = replace(tube.tables, values=np.asarray(constants.presses))
    tube = tube._replace(tables=tables)
    if tube.entry is not None:
        both_ways = tube.entry @ tube.entry.swapaxes(1, 2)
        plane = tube.entry[:, :, 0].T
        constants = constants._replace(entry=Entry(
            _float32(np.stack([plane.real, plane.imag])), _float32(_triangle(both_ways))
        ))  # fmt: skip
    parts = Parts(
        constants, _float32(tables.depths), _float32(tables.diameters),
        jnp.asarray(tables.first, jnp.int32), _pair(tube.untouched + whole), _pair(scale),
        _float32(growth),
    )  # fmt: skip
    shape = Shape(
        tuple(int(n) for n in tables.number.ravel()), tables.modes, period, r.n_samples,
        int(np.flatnonzero(inside)[0]) + 1, tube.ends, complex(r.face_reflection), tube.places,
        every,
    )  # fmt: skip
    if wrap is None:
        return tables, shape, parts, None
    straight = _straight(library, press, air, damped, r, length)
    bent = tube.untouched + whole - straight.untouched - _clutter_beyond(straight.phase, *given)[1]
    return tables, shape, parts, _pair(bent)


def _received(
    r: Rangefinder, rate: float, period: int, available: tuple[float, float]
) -> tuple[Complex, Complex, NDArray[np.bool_]]:
    """Return complex frequencies in Hz, the spectrum received at them, and the mask of the band.

    The available range of frequencies and the rate of the computed samples are in Hz. The results
    are of shape (period // 2,).
    """
    step = rate / period
    damping = log(WRAPAROUND_ATTENUATION) * step
    grid = np.asarray(np.arange(1, period // 2 + 1) * step, float)
    damped = grid - 0.5j * damping / pi
    received = sent_spectrum(r, damped, rate, period, damping)
    received = received * r.resonator(damped) ** 2 * anti_alias(grid, rate)
    received *= np.exp(-2j * pi * damped * r.lead)
    return damped, received, _band(grid, received, available)


class _Tube(NamedTuple):
    """Tables, wavenumbers and ends of a straight or a wrapped tube, with m modes between contacts.

    `decay` and `turn` are as in :class:`.Constants`, `ends` and `places` as in :class:`.Shape`.

    Attributes
    ----------
    tables : PressTables
    phase : callable
        Takes places in m, (n,); returns the complex phase in rad of the plane wave from the face to
        each place, (n, n_f).
    far : ndarray
        Reflection matrix of the far end, (n_f, m, m).
    entry : ndarray or None
        Matrix of :class:`acoustube.inversion.paths.Entry`, (n_f, m, m_s), with the m_s modes of the
        straight tube before the bend; None for a straight tube.
    untouched : ndarray
        Echo of the tube without contact or clutter, (n_f,).
    """

    tables: PressTables
    decay: Array
    turn: Array
    far: Complex
    untouched: Complex
    ends: tuple[float, float]
    phase: Callable[[Array], Complex]
    entry: Complex | None = None
    places: int = 1


def _straight(
    library: Library, tables: PressTables, air: Air, frequency: Complex, r: Rangefinder,
    length: float,
) -> _Tube:  # fmt: skip
    names = library.modes[: tables.modes]
    waves = wavenumbers(names, frequency, library.radius, air, lossy=True).T
    end = r.far_reflection * np.exp(-2j * waves[0] * length)
    far = np.broadcast_to(
        r.far_reflection * np.eye(len(waves)), (len(frequency), *2 * waves.shape[:1])
    )
    return _Tube(
        tables, np.asarray(waves.imag, float), np.asarray(-waves.real / (2 * pi), float),
        far.astype(complex),
        end / (1 - r.face_reflection * end), (0.0, length), lambda place: np.outer(place, waves[0]),
    )  # fmt: skip


def _wrapped(
    library: Library, tables: PressTables, air: Air, frequency: Complex, r: Rangefinder,
    length: float, wrap: Wrap,
) -> _Tube:  # fmt: skip
    path = wrapped_path(wrap, air, frequency, library, tables.modes)
    far = far_end(path, length, r.far_reflection)
    entry = path.entry(np.zeros(1)).matrix[0]
    return _Tube(
        joined_tables(tables, library, path), *phases(path), far,
        untouched_echo(path, far, entry, r.face_reflection), (wrap.start, wrap.stop),
        lambda place: path.plane(place)[0].T, entry, PLACES,
    )  # fmt: skip


def _triangle(matrix: Complex) -> Array:
    """Return matrices (n_f, m, m) as real and imaginary upper triangles (2, m (m + 1) / 2, n_f)."""
    part = matrix[:, *np.triu_indices(matrix.shape[-1])].T
    return np.asarray(np.stack([part.real, part.imag]), float)


def _pair(array: Complex) -> Pair:
    return Pair(_float32(array.real), _float32(array.imag))


def _float32(array: Array | NDArray[np.float32]) -> jax.Array:
    return jnp.asarray(array, jnp.float32)


def _band(frequency: Array, received: Complex, available: tuple[float, float]) -> NDArray[np.bool_]:
    """Return the mask of the contiguous band that contains nearly all received energy, (n_f,).

    Raises
    ------
    ConfigError
        If too much of that energy is outside the available range of frequencies in Hz.
    """
    share = np.cumsum(np.abs(received) ** 2)
    share /= share[-1]
    wanted = (share > LEFT_OUT / 2) & (share < 1 - LEFT_OUT / 2)
    inside = wanted & (frequency >= available[0]) & (frequency <= available[1])
    energy = np.abs(received) ** 2
    left_out = float(energy[~inside].sum() / energy.sum())
    if left_out > MOST_LEFT_OUT:
        low, high = frequency[wanted][[0, -1]]
        raise ConfigError(
            f"the library covers {KHZ * available[0]:.4g} to {KHZ * available[1]:.4g} kHz at this "
            f"temperature, and the rangefinder receives {KHZ * low:.4g} to {KHZ * high:.4g} kHz; "
            "make one with acoustube library --frequency"
        )
    return inside


def _taper(n: int) -> Array:
    """Return a taper over n frequencies against ringing, with squared sines at its ends."""
    rise = np.sin(0.5 * pi * (np.arange(n) + 0.5) / (TAPER * n)) ** 2
    rise[round(TAPER * n) :] = 1.0
    return rise * rise[::-1]


def _clutter_beyond(
    phase: Callable[[Array], Complex], n_f: int, density: float, length: float, seed: int
) -> tuple[NDArray[np.float32], Complex]:
    """Return the echo of each reflector with all those behind it, and the echo of all clutter.

    They are (n_reflectors + 1, 2, n_f), as real and imaginary parts, and (n_f,), complex. The
    clutter is that of :func:`acoustube.ranging.analogue.clutter`, summed from the far end.
    """
    total: Complex = np.zeros(n_f, complex)
    if density == 0:
        return np.zeros((1, 2, n_f), np.float32), total
    n = int(length / REFLECTOR_SPACING)
    deviation = np.sqrt(density * REFLECTOR_SPACING)
    reflectors = np.random.default_rng(seed).normal(0.0, deviation, n)
    place = (np.arange(n) + 0.5) * REFLECTOR_SPACING
    beyond = np.zeros((n + 1, 2, n_f), np.float32)
    for end in range(n, 0, -REFLECTORS_AT_ONCE):
        part = slice(max(end - REFLECTORS_AT_ONCE, 0), end)
        each = reflectors[part, None] * np.exp(-2j * phase(np.asarray(place[part], float)))
        each[-1] += total
        found = np.cumsum(each[::-1], axis=0)[::-1]
        beyond[part, 0], beyond[part, 1] = found.real, found.imag
        total = found[0]
    return beyond, total
