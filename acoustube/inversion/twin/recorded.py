"""Recorded closures in the complex baseband: mean, jitter and gain of cycles, and their noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan, pi
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

from acoustube.base.checks import (
    FREQUENCY,
    RATE,
    SECONDS,
    TEMPERATURE,
    Reals,
    check_fields,
    checked,
)
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.base.types import Array
from acoustube.base.units import KHZ, MS
from acoustube.waves.scattering import Complex

HALF_WIDTH = 1 / 5
"""Half the width of the band relative to the carrier frequency: 33.6 to 50.4 kHz about 42 kHz."""
TAPER = 1 / 6
"""Fraction of the band that is tapered at each end."""
CARRIERS = (15e3, 120e3)
"""Range in Hz in which the carrier is sought."""
UNDERSAMPLED = 42e3
"""Carrier in Hz that is assumed where the sampling rate does not distinguish it from its image."""
AFTER_CLIPPING, FADE, SETTLED = 0.05e-3, 0.2e-3, 0.15e-3
"""Times in s from the end of clipping to the fade-in, of the fade-in, and from its end to the first
data that are used."""
QUIET_SHARE = 0.2
"""Fraction of a cycle, at its end, whose mean is subtracted from the cycle."""
RING_LASTS = 4e-3
"""Time in s after clipping from which untouched cycles are not subtracted from closed ones."""
NEAR_RAIL, AT_RAIL, LEAST_CLIPPED = 0.9, 0.98, 8
"""Fractions of the largest deviation from the offset: from the first on, a sample may be clipped,
and from the second on, it counts as clipped. Least number of clipped samples that show clipping."""
UNCLIPPED_END = 2e-3
"""Time in s from the start of the drive, up to which the largest deviation of an unclipped
ring-down is sought."""
CLEAR_CYCLE = 30.0
"""Ratio of the energy of a group's mean cycle to that of the noise of a cycle, above which the
delays and gains of the cycles are estimated."""


@dataclass(frozen=True, eq=False)
class Group:
    """Cycles of the tube in one state, untouched or closed at one place.

    Attributes
    ----------
    cycles : ndarray
        Counts of the converter, (n_cycles, n_samples).
    temperature : float
        Temperature in degC that the board reports.
    place : float
        Stated distance of the closure from the face in m; nan for an untouched tube.
    source : str
        File, for messages.

    Raises
    ------
    ConfigError
        If a value is outside its range.
    """

    cycles: NDArray[np.generic]
    temperature: float
    place: float = nan
    source: str = ""

    def __post_init__(self) -> None:
        """Check the values; lists of cycles become an array."""
        place = Reals(0, 1e6, "m", ndim=0, missing=True)
        check_fields(
            self, cycles=Reals(ndim=2), temperature=TEMPERATURE, place=place, source=str
        )  # fmt: skip
        object.__setattr__(self, "cycles", np.asarray(self.cycles))


class Means(NamedTuple):
    """Mean of the cycles of a group in the band, and the scatter of the single cycles.

    Attributes
    ----------
    spectrum : ndarray
        Spectrum of the mean in counts s, (n_f,).
    variance : float
        Variance of a sample of the mean in the baseband, in counts squared.
    delays, gains : ndarray
        Delays in s and gains of the cycles relative to their mean, (n_cycles,); empty if the cycles
        are too weak or fewer than three.
    wobble : float
        Variance of a gain, and of a phase in rad squared, due to noise alone.
    """

    spectrum: Complex
    variance: float
    delays: Array
    gains: Array
    wobble: float


class Band:
    """Grid of frequencies around the carrier, and of times, on which cycles are compared.

    Parameters
    ----------
    rate : float
        Samples per second.
    start : float
        Time of the first sample in s from the start of the drive.
    n_samples : int
        Number of samples of a cycle.
    carrier : float
        Carrier frequency in Hz.
    clear : float
        Time in s from the start of the drive, at which the ring-down is no longer clipped.

    Attributes
    ----------
    frequency, image : ndarray
        Frequencies of the band in Hz, and their images ``rate - frequency``, (n_f,).
    time : ndarray
        Times of the baseband in s from the start of the drive, (n_t,); n_t equals n_f.

    Raises
    ------
    ConfigError
        If the sampling rate is too low for the carrier.

    Notes
    -----
    A band that extends above half the sampling rate is folded: the transform at a frequency then
    also contains the conjugate of that at its image.
    """

    @checked(
        rate=RATE, start=SECONDS, n_samples=Number(2, 1e7, whole=True), carrier=FREQUENCY,
        clear=SECONDS,
    )  # fmt: skip
    def __init__(
        self, rate: float, start: float, n_samples: int, carrier: float, clear: float
    ) -> None:
        self.rate, self.start, self.n_samples = rate, start, n_samples
        self.carrier, self.clear = carrier, clear
        low, high = (1 - HALF_WIDTH) * carrier, (1 + HALF_WIDTH) * carrier
        self.folded = high > rate / 2
        if self.folded:
            low, high = min(low, rate - high), 0.999 * rate / 2
        if low <= 0 or low >= high or carrier > rate:
            raise ConfigError(
                f"a sampling rate of {rate:g} Hz is too low for a carrier of {KHZ * carrier:.3g} "
                f"kHz; record at {2.5 * carrier:.0f} Hz or more"
            )
        self.period = next_fast_len(int(n_samples + 2e-3 * rate), real=True)
        step = rate / self.period
        self.bins = np.arange(int(np.ceil(low / step)), int(high / step))
        self.frequency: Array = self.bins * step
        self.image: Array = rate - self.frequency
        n = len(self.bins)
        self.taper = np.ones(n)
        width = round(TAPER * n)
        rise = np.sin(pi / 2 * (np.arange(width) + 0.5) / width) ** 2
        self.taper[:width] = rise
        if not self.folded:  # a folded band continues in its image
            self.taper[n - width :] = rise[::-1]
        self.scale = 2 * n * step
        self.time: Array = start + np.arange(n) / (n * step)
        self.white = 2 * float(np.mean(self.taper**2)) * n * step / (rate / 2)
        """Variance in the baseband of white noise with unit variance in the samples."""

    def spectra(self, samples: Array, keep: Array | float = 1.0) -> Complex:
        """Return spectra (..., n_f) in counts s of samples (..., n_samples) in counts.

        The samples are first freed of their offset, faded in, and multiplied by the window `keep`.
        """
        time = self.start + np.arange(samples.shape[-1]) / self.rate
        since = time - self.clear - AFTER_CLIPPING
        fade = np.sin(pi / 2 * np.clip(since / FADE, 0, 1)) ** 2
        quiet = int(QUIET_SHARE * samples.shape[-1])
        level = samples[..., -quiet:].mean(axis=-1, keepdims=True)
        found = np.fft.rfft((samples - level) * fade * keep, self.period, axis=-1)[..., self.bins]
        return np.asarray(found / self.rate * np.exp(-2j * pi * self.frequency * self.start))

    def baseband(self, spectrum: Complex) -> Complex:
        """Return the baseband (..., n_t) in counts of spectra (..., n_f) in counts s."""
        turned = spectrum * (self.taper * np.exp(2j * pi * self.frequency * self.start))
        return np.asarray(self.scale * np.fft.ifft(turned, axis=-1))

    @property
    def first(self) -> float:
        """Time in s from the start of the drive from which data are used."""
        return self.clear + AFTER_CLIPPING + FADE + SETTLED

    @property
    def last(self) -> float:
        """Time in s from the start of the drive up to which data are used."""
        return self.start + self.n_samples / self.rate - 0.1e-3

    def before_ring_end(self) -> Array:
        """Return a window that falls to 0 when the ring-down has died away, (n_samples,)."""
        time = self.start + np.arange(self.n_samples) / self.rate
        return np.asarray(
            0.5 + 0.5 * np.cos(pi * np.clip((time - self.clear - RING_LASTS) / FADE, 0, 1))
        )


def band_of(
    closed: Sequence[Group], untouched: NDArray[np.generic], rate: float, start: float
) -> Band:
    """Return the band of recordings: about the carrier, after the clipped ring-down.

    Parameters
    ----------
    closed : sequence of Group
    untouched : ndarray
        Counts of the cycles without contact, (n_cycles, n_samples).
    rate, start : float
        Samples per second; time of the first sample in s from the start of the drive.

    Raises
    ------
    ConfigError
        If a group has no cycles or cycles of another length, the sampling rate is too low, the
        clipped ring-down takes most of a cycle, or the closed cycles contain no sound from 15 to
        120 kHz.
    """
    n = untouched.shape[1]
    shapes = [(one.source or "a closure", one.cycles.shape) for one in closed]
    for name, (count, length) in [("the untouched tube", untouched.shape), *shapes]:
        if count == 0 or length != n:
            raise ConfigError(
                f"{name} has {count} cycles of {length} samples, and the untouched cycles have "
                f"{n} samples; give each group one or more cycles of one length"
            )
    mean = np.asarray(untouched[:256], float).mean(axis=0)
    level = mean[-int(QUIET_SHARE * n) :].mean()
    size = np.abs(mean - level)
    # Only the first part is used: later the largest deviations are echoes, or noise.
    part = size[: n // 3]
    if np.sum(part >= AT_RAIL * part.max()) < LEAST_CLIPPED:
        part = part[: max(int((UNCLIPPED_END - start) * rate), 16)]
    loud = np.flatnonzero(part >= NEAR_RAIL * part.max())
    clear = start + (loud[-1] + 1) / rate
    if loud[-1] > 0.3 * n:
        raise ConfigError(
            f"the ring-down of the untouched cycles is clipped up to {MS * clear:.3g} ms, most of "
            "the cycle; lower the gain, or record longer cycles"
        )
    power = np.zeros(n // 2 + 1)
    late = int((clear - start + AFTER_CLIPPING) * rate)
    for one in closed:
        samples = np.asarray(one.cycles[:64], float).mean(axis=0)
        power += np.abs(np.fft.rfft((samples - samples[late:].mean())[late:], n)) ** 2
    frequency = np.fft.rfftfreq(n, 1 / rate)
    inside = (frequency > CARRIERS[0]) & (frequency < CARRIERS[1])
    if not inside.any() or not power[inside].any():
        raise ConfigError("the closed cycles hold no sound from 15 to 120 kHz; check the sensor")
    peak = frequency[inside][int(np.argmax(power[inside]))]
    near = inside & (abs(frequency - peak) < 0.1 * peak)
    carrier = float((power[near] * frequency[near]).sum() / power[near].sum())
    if carrier > 0.43 * rate:
        carrier = UNDERSAMPLED
    return Band(rate, start, n, carrier, clear)


def mean_of(band: Band, cycles: NDArray[np.generic]) -> Means:
    """Return the mean of cycles in the band, with their delays removed, and their scatter.

    Parameters
    ----------
    band : Band
    cycles : ndarray
        Counts, (n_cycles, n_samples).

    Notes
    -----
    The product of a cycle's spectrum with the conjugate mean, summed over frequency and divided by
    the energy of the mean, gives its delay, due to the jitter of the trigger, and its gain. The
    delay is minus the phase of the product, divided by the carrier's angular frequency; the gain is
    its magnitude. Both are maximum-likelihood estimates for small delays.
    """
    given = np.asarray(cycles)
    parts = [band.spectra(given[i : i + 256].astype(float)) for i in range(0, len(given), 256)]
    each = np.concatenate(parts)
    n = len(each)
    quiet = np.asarray(given[:, -int(QUIET_SHARE * given.shape[1]) :], float)
    power = float(quiet.var(axis=1).mean())
    mean = each.mean(axis=0)
    none = np.zeros(0)
    if n < 3:
        return Means(mean, power * band.white / n, none, none, 0.0)
    noise = power / band.rate**2 * band.n_samples  # variance of a bin of a cycle
    delays, gains = np.zeros(n), np.ones(n)
    clear = np.sum(np.abs(mean) ** 2) / len(mean) > CLEAR_CYCLE * noise
    for _ in range(3 if clear else 0):
        product = each @ mean.conj() / np.sum(np.abs(mean) ** 2)
        step = -np.angle(product) / (2 * pi * band.carrier)
        gains = np.abs(product)
        delays += step
        each = each * np.exp(2j * pi * step[:, None] * band.frequency)
        mean = each.mean(axis=0)
    left = each - mean * (gains[:, None] if clear else 1.0)
    basebands = band.baseband(left)[:, band.time >= band.first]
    scatter = float(np.sum(np.abs(basebands) ** 2)) / ((n - 1) * n * basebands.shape[1])
    floor = 1e-3 * power * band.white / n
    variance = max(scatter, floor)
    # Neighbouring bins, of cycles padded to the period, are correlated.
    padded = noise * band.period / band.n_samples
    wobble = 0.5 * padded / max(float(np.sum(np.abs(mean) ** 2)), 1e-300)
    return Means(mean, variance, *((delays, gains) if clear else (none, none)), wobble)
