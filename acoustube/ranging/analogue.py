"""The voltage that a rangefinder on a tube makes before its ADC: the same in every cycle."""

from __future__ import annotations

from collections.abc import Sequence
from math import log, pi

import numpy as np
from scipy.fft import next_fast_len

from acoustube.air import Air, air_at
from acoustube.ranging.rangefinder import Burst, Drive, Rangefinder
from acoustube.waves.grid.polyhedron import Array
from acoustube.waves.modes import axial_wavenumber
from acoustube.waves.network import (
    WRAPAROUND_ATTENUATION,
    interpolate_scattering,
    transfer,
)
from acoustube.waves.network_checks import in_band
from acoustube.waves.scattering import Complex, PlacedScatterer, Scattering
from acoustube.waves.scheme.pulse import check_duration

GRAIN = 0.5e-3
"""Distance in m between the reflectors that stand for clutter: under a quarter wave at 100 kHz."""
PASSED = 0.8
"""Share of half the sampling rate up to which the anti-alias filter passes all."""
FINER = 16
"""Samples per sample of the record at which a drive without a closed form is transformed."""
CYCLE = 2
"""Computed time, which is cyclic, in records."""


def blockage(frequency: Array, position: float) -> PlacedScatterer:
    """Return a rigid closure of the bore, as used for calibration.

    Parameters
    ----------
    frequency : ndarray
        In Hz, (n,), rising and evenly spaced; the first and the last are enough.
    position : float
        Distance from the source end in m.

    Returns
    -------
    PlacedScatterer
        The plane mode is reflected whole, with its sign, and nothing passes. No length.
    """
    frequency = np.asarray(frequency, float)
    n = len(frequency)
    s = np.zeros((n, 2, 1, 2, 1), complex)
    s[:, (0, 1), 0, (0, 1), 0] = 1.0
    closed = Scattering(
        frequency=frequency, modes=("00",), s=s, propagates=np.ones((n, 1), bool),
        cut_ons=np.zeros(1), settled=np.ones(s.shape, bool), sound_speed=np.nan,
        extent=(0.0, 0.0), spacing=(np.nan,) * 3, shape=(0, 0, 0), steps=0, time_step=np.nan,
    )  # fmt: skip
    return PlacedScatterer(closed, position)


def clutter(
    presses: Sequence[PlacedScatterer],
    air: Air,
    frequency: Complex,
    *,
    radius: float,
    length: float,
    density: float,
    tube_seed: int,
) -> Complex:
    """Return what small irregularities along a tube send back to its source end.

    Parameters
    ----------
    presses : sequence of PlacedScatterer
        Behind a press the sound is what it lets pass, both ways.
    air : Air
    frequency : ndarray
        In Hz, real or complex, (n,).
    radius, length : float
        Of the bore, in m.
    density : float
        Mean power reflected per metre, in 1/m.
    tube_seed : int
        Tells tubes apart.

    Returns
    -------
    ndarray
        Over what the source launches, (n,).

    Notes
    -----
    Reflectors r_i, normal numbers of variance density * GRAIN at z_i = (i + 1/2) GRAIN, each met
    by the plane mode on its way out and back, and no sound met by two (Born's approximation):
    sum r_i T_i^2 exp(-2j kz z_i), with T_i the transmission of the presses before it. Echoes
    between a press and a reflector are left out, too.
    """
    n = int(length / GRAIN)
    reflectors = np.random.default_rng(tube_seed).normal(0.0, np.sqrt(density * GRAIN), n)
    wave = axial_wavenumber(0, 0, frequency, radius, air)
    step = np.exp(-2j * wave * GRAIN)
    total = np.zeros(len(frequency), complex)
    behind = n
    for press in sorted(presses, key=lambda press: -press.position):
        first = min(int(press.position / GRAIN + 0.5), behind)
        _add_up(total, step, reflectors[first:behind])
        plane, s = (
            press.scattering.modes.index("00"),
            interpolate_scattering(press.scattering, frequency),
        )
        total *= s[:, 1, plane, 0, plane] * s[:, 0, plane, 1, plane]
        behind = first
    _add_up(total, step, reflectors[:behind])
    return np.asarray(total * np.exp(-1j * wave * GRAIN))


def _add_up(total: Complex, step: Complex, reflectors: Array) -> None:
    """Put reflectors before what there is, in place: Horner's scheme from the far end."""
    for r in reflectors[::-1]:
        total *= step
        total += r


def response(
    presses: Sequence[PlacedScatterer],
    rangefinder: Rangefinder,
    *,
    radius: float = 3.95e-3,
    length: float = 2.5,
    temperature: float = 20.0,
    tube_seed: int = 0,
) -> tuple[Array, Array]:
    """Return the voltage before the ADC, without noise and offset, as in every cycle.

    Parameters
    ----------
    presses : sequence of PlacedScatterer
        None for an untouched tube.
    rangefinder : Rangefinder
    radius, length : float
        Of the bore, in m.
    temperature : float
        Of the air, in degC.
    tube_seed : int
        Of the clutter.

    Returns
    -------
    time, voltage : ndarray
        (n_samples,), in s from the start of the record, and in V.

    Raises
    ------
    ValueError
        As :func:`~acoustube.waves.transfer`; or if what would be heard has sound outside the band
        of the presses, or the drive lasts longer than the record.

    Notes
    -----
    With drive E, resonator H, face r and the pressure p at the face over that which is launched,
    the voltage is ``send H E + gain H^2 E (p - 1) / (1 + r)``: the wave that arrives is heard.
    Computed in the frequency domain and filtered without delay, so that nothing is left at half
    the sampling rate (a cosine from 0.8 of it): no finer step is needed, nothing is aliased.
    """
    rate, n = rangefinder.sampling_rate, rangefinder.n_samples
    check_duration(rangefinder.drive, n / rate - rangefinder.lead)
    n_cycle = next_fast_len(CYCLE * n, real=True)
    damping = log(WRAPAROUND_ATTENUATION) * rate / n_cycle
    real = np.fft.rfftfreq(n_cycle, 1 / rate)[1:]
    frequency = real - 0.5j * damping / pi
    own = _drive_spectrum(rangefinder.drive, frequency, rate, n_cycle, damping)
    own *= rangefinder.resonator(frequency) * _anti_alias(real, rate)
    own *= np.exp(-2j * pi * frequency * rangefinder.lead)
    heard = own * rangefinder.resonator(frequency)
    inside = in_band(presses, real, heard, what="what the rangefinder hears")
    air, band, face = air_at(temperature), frequency[inside], rangefinder.face_reflection
    pressure = transfer(
        presses, air, band, radius=radius, length=length, probes=(0.0,),
        source_reflection=face, far_reflection=rangefinder.far_reflection,
    )[0]  # fmt: skip
    arriving = (pressure - 1) / (1 + face)
    if rangefinder.clutter > 0:
        arriving += clutter(
            presses, air, band, radius=radius, length=length,
            density=rangefinder.clutter, tube_seed=tube_seed,
        )  # fmt: skip
    spectrum = np.zeros(len(real) + 1, complex)
    spectrum[1:] = rangefinder.send * own
    spectrum[1:][inside] += rangefinder.gain * heard[inside] * arriving
    time = np.arange(n) / rate
    return time, np.fft.irfft(spectrum * rate, n_cycle)[:n] * np.exp(damping * time)


def _drive_spectrum(
    drive: Drive, frequency: Complex, rate: float, n_cycle: int, damping: float
) -> Complex:
    """Return the transform of a drive in s, of what decays where the frequency is complex."""
    if isinstance(drive, Burst):
        return drive.spectrum(frequency)
    step = 1 / (FINER * rate)
    time = np.arange(int(np.ceil(drive.duration / step)) + 1) * step
    samples = drive(time) * np.exp(-damping * time)
    return np.fft.rfft(samples, FINER * n_cycle)[1 : len(frequency) + 1] * step


def _anti_alias(frequency: Array, rate: float) -> Array:
    """Return the filter's gain: whole up to PASSED of half the rate, then a cosine down to none."""
    falling = np.clip((2 * frequency / rate - PASSED) / (1 - PASSED), 0, 1)
    return 0.5 + 0.5 * np.cos(pi * falling)
