"""Analogue voltage of a rangefinder on a tube before its ADC, the same in every cycle.

References
----------
* First-order (Born) scattering: Morse, P. M. and Ingard, K. U., Theoretical Acoustics, McGraw-Hill
  (1968).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, log, pi

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

from acoustube.air import Air, air_at
from acoustube.base.checks import (
    DISTANCE,
    LENGTH,
    SEED,
    TEMPERATURE,
    WAVE_SERIES,
    Optional,
    Reals,
    Several,
    checked,
)
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.base.types import Array
from acoustube.base.units import MM
from acoustube.ranging.drives import Burst, Chirp, Tones
from acoustube.ranging.rangefinder import Drive, Rangefinder
from acoustube.waves.interpolation import interpolate_scattering, plane_wavenumbers
from acoustube.waves.modes import axial_wavenumber
from acoustube.waves.network import WRAPAROUND_ATTENUATION, transfer
from acoustube.waves.network_checks import in_band
from acoustube.waves.scattering import Complex, PlacedScatterer, Scattering
from acoustube.waves.scheme.pulse import check_duration

REFLECTOR_SPACING = 0.5e-3
"""Spacing in m of the clutter's reflectors: under a quarter wavelength at 100 kHz."""
MEASURED_SPACING = 1e-3
"""Spacing in m of reflectors given by the caller: a quarter wavelength at 85 kHz."""
PASSBAND = 0.8
"""End of the anti-alias filter's passband, as a fraction of the Nyquist frequency."""
DRIVE_OVERSAMPLING = 16
"""Oversampling factor in the transform of a drive without a closed-form spectrum."""
HALF_WIDTH = 1 / 7
"""Half width of the band of a burst, relative to its carrier: 36 to 48 kHz about 42 kHz."""
FOLDED_OVERSAMPLING = 4
"""Least sampling rate in the computation of an aliased band, relative to its carrier."""
PERIOD_IN_RECORDS = 2
"""Period of the discrete Fourier transform, in lengths of the record."""


@checked(frequency=Reals(0, 1e12, "Hz", ndim=1), position=DISTANCE)
def blockage(frequency: Array, position: float) -> PlacedScatterer:
    """Return a rigid closure of the bore, as for a calibration.

    Parameters
    ----------
    frequency : ndarray
        In Hz, (n,), rising and evenly spaced; the first and the last suffice. If the first is 0,
        the band includes the mean over time of a drive's signal.
    position : float
        Distance from the source end in m.

    Returns
    -------
    PlacedScatterer
        Reflection coefficient +1 and transmission 0 of the plane mode; of zero length.
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


def within(reflectors: Sequence[float] | Array, length: float) -> Array:
    """Return the reflectors, :data:`MEASURED_SPACING` apart, that lie within `length` in m."""
    return np.asarray(reflectors, float)[: int(length / MEASURED_SPACING)]


@checked(
    presses=Several(PlacedScatterer),
    air=Air,
    frequency=WAVE_SERIES,
    radius=LENGTH,
    length=Number(1e-9, 1e3, "m"),
    density=Number(0, 1e6, "1/m"),
    tube_seed=SEED,
    reflectors=Optional(Reals(-1, 1, ndim=1)),
)
def clutter(
    presses: Sequence[PlacedScatterer],
    air: Air,
    frequency: Complex,
    *,
    radius: float,
    length: float,
    density: float,
    tube_seed: int,
    reflectors: Array | None = None,
) -> Complex:
    """Return the clutter: pressure reflection coefficient of a tube's irregularities at its source.

    Parameters
    ----------
    presses : sequence of PlacedScatterer
        The two-way transmission of a press attenuates the clutter behind it; in a bend the plane
        wave has the bend's wavenumber.
    air : Air
    frequency : ndarray
        In Hz, real or complex, (n,).
    radius, length : float
        Radius of the bore and length of the tube in m.
    density : float
        Mean reflected power per length in 1/m.
    tube_seed : int
        Random seed of the tube's irregularities.
    reflectors : ndarray, optional
        Reflection coefficients of irregularities :data:`MEASURED_SPACING` apart, in place of random
        ones. The first is half that distance from the source end.

    Returns
    -------
    ndarray
        Reflected over launched pressure, complex, (n,).

    Raises
    ------
    ValueError
        If a frequency lies outside the band of a press, an argument is out of range, or a reflector
        is beyond the tube's end.

    Notes
    -----
    Random reflectors are at ``z_i = (i + 1/2) REFLECTOR_SPACING``. Their coefficients r_i are
    normal with variance ``density * REFLECTOR_SPACING``. In Born's approximation (single
    scattering of the plane mode) the clutter is ``sum r_i T_i^2 exp(-2j phi_i)``, with T_i the
    transmission of the presses before reflector i, and phi_i the phase of the plane wave up to it,
    with the bends' own wavenumbers in bends. Multiple reflections between a press and a reflector
    are neglected, and so is the conversion of modes where a bend begins.
    """
    frequency = np.atleast_1d(frequency)
    spacing = REFLECTOR_SPACING if reflectors is None else MEASURED_SPACING
    if reflectors is None:
        reflectors = np.random.default_rng(tube_seed).normal(
            0.0, np.sqrt(density * spacing), int(length / spacing)
        )
    n = len(reflectors)
    if (n - 1) * spacing >= length:
        raise ConfigError(
            f"has {n} values, one for each {MM * spacing:g} mm, and so reaches beyond length = "
            f"{length:g} m", setting="reflectors", value=f"[{reflectors[0]:g}, ...]",
            advice=f"give at most {int(length / spacing)}",
        )  # fmt: skip
    straight = axial_wavenumber(0, 0, frequency, radius, air)
    bends = [one for one in presses if one.scattering.inside is not None]
    pressed = [one for one in presses if one.scattering.inside is None]
    waves, number = _plane_waves(bends, frequency, straight, spacing, n)
    steps = np.exp(-2j * spacing * waves)
    total = np.zeros(len(frequency), complex)
    behind = n
    for press in sorted(pressed, key=lambda press: -press.position):
        first = min(int(press.position / spacing + 0.5), behind)
        _add_reflectors(total, steps, number[first:behind], reflectors[first:behind])
        plane, s = (
            press.scattering.modes.index("00"),
            interpolate_scattering(press.scattering, frequency),
        )
        total *= s[:, 1, plane, 0, plane] * s[:, 0, plane, 1, plane]
        # Relative to straight tube: `steps` contain its phase between the reference planes.
        total *= np.exp(2j * straight * np.ptp(press.scattering.planes))
        behind = first
    _add_reflectors(total, steps, number[:behind], reflectors[:behind])
    return np.asarray(total * np.exp(-1j * straight * spacing))


def _plane_waves(
    bends: Sequence[PlacedScatterer], frequency: Complex, straight: Complex, spacing: float, n: int
) -> tuple[Complex, NDArray[np.int_]]:
    """Return plane wavenumbers (n_waves, n_f) in 1/m, and the row that each reflector (n,) uses."""
    places = (np.arange(n) + 0.5) * spacing
    waves, number = [straight], np.zeros(n, int)
    for bend in bends:
        scattering, inside = bend.scattering, bend.scattering.inside
        assert inside is not None
        found = plane_wavenumbers(scattering, frequency)
        ends = bend.position + scattering.planes[0] + np.cumsum([0.0, *inside.length])
        part = np.searchsorted(ends, places, side="right")
        within = (part > 0) & (part < len(ends))
        number[within] = len(waves) + part[within] - 1
        waves.extend(found)
    return np.stack(waves), number


def _add_reflectors(
    total: Complex, steps: Complex, number: NDArray[np.int_], reflectors: Array
) -> None:
    """Add reflectors in front of the reflection coefficient `total` (n_f,), in place.

    Horner's scheme begins with the last one. `steps` are the two-way propagation factors over one
    spacing, (n_waves, n_f), of which reflector i uses row `number[i]`.
    """
    for i, r in zip(number[::-1], reflectors[::-1], strict=True):
        total *= steps[i]
        total += r


@checked(
    presses=Several(PlacedScatterer),
    rangefinder=Rangefinder,
    radius=LENGTH,
    length=LENGTH,
    temperature=TEMPERATURE,
    tube_seed=SEED,
    reflectors=Optional(Reals(-1, 1, ndim=1)),
)
def response(
    presses: Sequence[PlacedScatterer],
    rangefinder: Rangefinder,
    *,
    radius: float = 3.95e-3,
    length: float = 2.5,
    temperature: float = 20.0,
    tube_seed: int = 0,
    reflectors: Array | None = None,
) -> tuple[Array, Array]:
    """Return the voltage before the ADC, without noise and offset; it is the same in every cycle.

    Parameters
    ----------
    presses : sequence of PlacedScatterer
        Empty for an untouched tube.
    rangefinder : Rangefinder
    radius, length : float
        Radius of the bore and length of the tube in m.
    temperature : float
        Temperature of the air in degC.
    tube_seed : int
        Random seed of the clutter.
    reflectors : ndarray, optional
        Of the clutter, in place of random ones; see :func:`clutter`.

    Returns
    -------
    time, voltage : ndarray
        (n_samples,), in s from the start of the record, and in V.

    Raises
    ------
    ValueError
        As :func:`~acoustube.waves.transfer`; or if the received spectrum exceeds the band of the
        presses, or the drive is longer than the record.

    Notes
    -----
    With the spectrum E of the drive, filtered by loudspeaker and microphone, the resonator's
    response H, the face's reflection coefficient r and the pressure p at the face over the launched
    pressure, the voltage is
    ``send H E + gain H^2 E (p - 1) / (1 + r)``, to which the clutter is added as a part of the
    incident wave (p - 1) / (1 + r). It is computed in the frequency domain and filtered without
    delay, by a raised cosine that falls from 1 at 0.8 of the Nyquist frequency to 0 at that
    frequency. No finer time step is needed, and nothing is aliased. Only where :func:`oversampling`
    exceeds 1, as for a burst whose band exceeds half the sampling rate, is there no such filter, as
    on EchoTube's board: the voltage is computed at that multiple of the rate, and the samples
    between the recorded ones are dropped.
    """
    every = oversampling(rangefinder)
    rate, n = every * rangefinder.sampling_rate, every * rangefinder.n_samples
    check_duration(rangefinder.drive, n / rate - rangefinder.lead)
    n_cycle = next_fast_len(PERIOD_IN_RECORDS * n, real=True)
    damping = log(WRAPAROUND_ATTENUATION) * rate / n_cycle
    real = np.asarray(np.fft.rfftfreq(n_cycle, 1 / rate), float)
    frequency = real - 0.5j * damping / pi
    sent = sent_spectrum(rangefinder, frequency, rate, n_cycle, damping)
    sent *= rangefinder.resonator(frequency) * anti_alias(real, rate)
    sent *= np.exp(-2j * pi * frequency * rangefinder.lead)
    received = sent * rangefinder.resonator(frequency)
    # A signal times a decaying exponential has a mean, and so a spectrum at frequency zero.
    whole = all(press.scattering.frequency[0] == 0 for press in presses)
    inside = np.append(whole, in_band(presses, real[1:], received[1:], what="the received signal"))
    air, band, face = air_at(temperature), frequency[inside], rangefinder.face_reflection
    pressure = transfer(
        presses, air, band, radius=radius, length=length, probes=(0.0,),
        source_reflection=face, far_reflection=rangefinder.far_reflection,
    )[0]  # fmt: skip
    arriving = (pressure - 1) / (1 + face)
    if rangefinder.clutter > 0 or reflectors is not None:
        arriving += clutter(
            presses, air, band, radius=radius, length=length,
            density=rangefinder.clutter, tube_seed=tube_seed, reflectors=reflectors,
        )  # fmt: skip
    spectrum = rangefinder.send * sent
    spectrum[inside] += rangefinder.gain * received[inside] * arriving
    time = (np.arange(n) / rate)[::every]
    voltage = np.fft.irfft(spectrum * rate, n_cycle)[:n:every]
    return time, voltage * np.exp(damping * time)


def oversampling(rangefinder: Rangefinder) -> int:
    """Return the number of computed samples for each recorded one; 1 if no band is aliased.

    The band of a burst is aliased if it exceeds half the sampling rate, that of a chirp or of tones
    if its middle does. A sampled pulse counts as a burst at the transducer's resonance frequency,
    or at 0 if the transducer has none.
    """
    drive, rate = rangefinder.drive, rangefinder.sampling_rate
    usual = rangefinder.resonance if rangefinder.quality_factor > 0 else 0.0
    carrier = getattr(drive, "frequency", usual)
    highest = carrier if isinstance(drive, Chirp | Tones) else (1 + HALF_WIDTH) * carrier
    return 1 if highest <= rate / 2 else ceil(FOLDED_OVERSAMPLING * carrier / rate)


def sent_spectrum(
    rangefinder: Rangefinder, frequency: Complex, rate: float, n_cycle: int, damping: float
) -> Complex:
    """Return the spectrum in s of a drive after loudspeaker and microphone, without the resonance.

    The arguments are those of :func:`drive_spectrum`, with the rangefinder in place of its drive.
    """
    spectrum = drive_spectrum(rangefinder.drive, frequency, rate, n_cycle, damping)
    return np.asarray(spectrum * rangefinder.passband(frequency))


def drive_spectrum(
    drive: Drive, frequency: Complex, rate: float, n_cycle: int, damping: float
) -> Complex:
    """Return the Fourier transform in s of a drive times a decaying exponential.

    Parameters
    ----------
    drive : Burst, Chirp, Tones, Pulse or SampledPulse
    frequency : ndarray
        In Hz, (n,): ``rate / n_cycle`` times whole numbers, minus ``0.5j damping / pi``.
    rate : float
        Sampling rate in Hz.
    n_cycle : int
        Number of samples of the transform's period.
    damping : float
        Decay rate of the exponential in 1/s.

    Returns
    -------
    ndarray
        (n,).
    """
    if isinstance(drive, Burst | Chirp | Tones):
        return drive.spectrum(frequency)
    step = 1 / (DRIVE_OVERSAMPLING * rate)
    time = np.arange(int(np.ceil(drive.duration / step)) + 1) * step
    samples = drive(time) * np.exp(-damping * time)
    bins = np.rint(np.real(frequency) * n_cycle / rate).astype(int)
    return np.asarray(np.fft.rfft(samples, DRIVE_OVERSAMPLING * n_cycle)[bins] * step)


def anti_alias(frequency: Array, rate: float) -> Array:
    """Return the anti-alias filter's gain at frequencies in Hz: 1, then a raised cosine to 0."""
    falling = np.clip((2 * frequency / rate - PASSBAND) / (1 - PASSBAND), 0, 1)
    return 0.5 + 0.5 * np.cos(pi * falling)
