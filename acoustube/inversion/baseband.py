"""Complex baseband of a rangefinder's cycles, and the gain from reflection to recorded spectrum."""

from __future__ import annotations

from functools import cached_property
from math import log, pi

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len

from acoustube.air import Air, air_at, neighbouring_air
from acoustube.base.checks import BORE, TEMPERATURE, Optional, Reals, Several, checked
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.base.types import Array
from acoustube.base.units import KHZ, MS
from acoustube.inversion.band import CHIRP_BAND, half_width, is_compressed
from acoustube.inversion.paths import Path, StraightPath
from acoustube.inversion.quantiser import common_rounding, linearised
from acoustube.inversion.tables import MOST_MODES
from acoustube.inversion.wrap import Wrap, WrappedPath
from acoustube.ranging import Rangefinder
from acoustube.ranging.analogue import anti_alias, sent_spectrum
from acoustube.waves.modes import axial_wavenumber
from acoustube.waves.modes.grid_modes import mode_numbers
from acoustube.waves.scattering import Complex

TAPER = 1 / 6
"""Fraction of the band over which each of its ends is tapered."""
AFTER_CLIPPING, FADE, SETTLED = 0.1e-3, 0.2e-3, 0.3e-3
"""Times in s: `AFTER_CLIPPING` is from the end of clipping to the start of the samples' fade-in,
`FADE` is the duration of the fade-in, and `SETTLED` is from its end to the first sample of the
baseband that is used."""
QUIET_SHARE = 0.3
"""Fraction of a cycle, at its end, from whose mean the cycle's zero offset is estimated."""
TUBE = Number(0.01, 100.0, "m")
CYCLE = Number(2, 1e6, "samples", whole=True)
SLOWEST = 318.0
"""Speed of sound in m/s at -21 degC, which sets the end of the times that are inverted. These are
the same at all temperatures, so that clutter learned at one can be used at another."""
OWN_LENGTH = 0.03
"""Length in m of the tube that a press deforms, from its middle to either side."""
FEWEST_CYCLES = 8
"""Least number of cycles whose noise is estimated from their scatter."""


class Baseband:
    """Complex baseband of a rangefinder's cycles at one temperature: frequencies, times and gain.

    Parameters
    ----------
    rangefinder : Rangefinder
    radius, length : float
        Radius of the bore and length of the tube, in m.
    temperature : float
        Nominal temperature of the air, in degC.
    modes : tuple of str
        Names of the modes whose wavenumbers are needed, the plane mode first.
    n_samples : int, optional
        Number of samples in a cycle; that of the rangefinder by default.
    wrap : Wrap, optional
        Curvature and torsion of a wrapped tube; the tube is straight by default.

    Attributes
    ----------
    frequency : ndarray
        Frequencies of the band in Hz, (n_f,).
    time, used : ndarray
        Times in s of all baseband samples, (n_f,), and indices of those that are used, (n_time,).
    k, k_by_temperature : ndarray
        Wavenumbers of `modes` in 1/m, and their derivatives in 1/(m K), (n_f, n_modes).
    gain : ndarray
        Gain from reflection coefficient to recorded spectrum, in counts s, (n_f,).
    sent : ndarray
        That gain without the transducer's resonance, in counts s, (n_f,).

    Raises
    ------
    ConfigError
        If the band is too wide, the sampling rate too low for the carrier, or a cycle too short.
    """

    freedom = 1.0
    """Expected squared magnitude of a whitened sample: 1 if it is complex, 1/2 if it is real."""

    @checked(
        rangefinder=Rangefinder, radius=BORE, length=TUBE, temperature=TEMPERATURE,
        modes=Several(str, 1), n_samples=Optional(CYCLE), wrap=Optional(Wrap),
    )  # fmt: skip
    def __init__(
        self,
        rangefinder: Rangefinder,
        radius: float,
        length: float,
        temperature: float,
        modes: tuple[str, ...],
        n_samples: int | None = None,
        wrap: Wrap | None = None,
    ) -> None:
        self.rangefinder, self.radius, self.length = rangefinder, radius, length
        self.temperature, self.modes = temperature, modes
        self.n_samples = n_samples or rangefinder.n_samples
        self.rate = rangefinder.sampling_rate
        carrier = getattr(rangefinder.drive, "frequency", rangefinder.resonance)
        self.air = air_at(temperature)
        flight = rangefinder.lead + 2 * length / SLOWEST
        late = rangefinder.drive.duration + 0.5e-3
        lasting = flight + max(3e-3, 2e-3 + late)
        self.period = self._period(max(self.n_samples, int(self.rate * lasting)))
        self.step = step = self.rate / self.period
        self.bins, self.taper = self._band(carrier)
        self.frequency: Array = np.asarray(self.bins * step, float)
        n = len(self.bins)
        self.time = np.arange(n) / (n * step)
        self.clear = self._clipped()
        end = min(flight + max(1e-3, late), self.n_samples / self.rate - 0.5e-3)
        start = self.clear + AFTER_CLIPPING + FADE + SETTLED
        drive = self._drive()
        # Pulse compression puts an echo at the middle of the recorded one, not at its start.
        self.turn = np.ones(n, complex)
        if is_compressed(rangefinder):
            middle = rangefinder.drive.duration / 2
            back = np.exp(-2j * pi * self.frequency * middle)
            self.turn = np.conj(drive) / np.maximum(np.abs(drive), 1e-300) * back
            start += max(middle - SETTLED, 0.0)
        self.used = np.flatnonzero((self.time >= start) & (self.time < end))
        if len(self.used) < 16:
            raise ConfigError(
                f"a cycle of n_samples = {self.n_samples}, {MS * self.n_samples / self.rate:.3g} "
                f"ms, in a tube of length {length:g} m is too short to invert; use longer cycles "
                "or a longer tube"
            )
        self.k, self.k_by_temperature = self._wavenumbers()
        self.speed, self.speed_by_temperature = _speeds(temperature)
        self.path = self._path(wrap)
        self.per_volt = 2**rangefinder.bits / rangefinder.full_scale
        self._thermal = rangefinder.noise * self.per_volt  # rms in counts
        lead = np.exp(-2j * pi * self.frequency * rangefinder.lead)
        self.sent = rangefinder.gain * self.per_volt * drive * self.turn * lead
        self.gain = self.press_gain(np.zeros((1, 2)))[0]

    def _period(self, least: int) -> int:
        """Return the period of the Fourier transforms in samples, at least `least`."""
        return int(next_fast_len(least))

    def _band(self, carrier: float) -> tuple[NDArray[np.int_], Array]:
        """Return the bins of the frequencies about a carrier in Hz, and their taper.

        The band extends to both sides of the carrier by :func:`half_width`.
        """
        half = half_width(self.rangefinder)
        low, high = carrier - half, carrier + half
        if not low > self.step:
            raise ConfigError(
                f"a chirp of {KHZ * half / CHIRP_BAND:g} kHz about "
                f"{KHZ * carrier:g} kHz is too wide to invert; use at most "
                f"{KHZ * carrier / CHIRP_BAND:.4g} kHz"
            )
        if not high < self.rate / 2:
            raise ConfigError(
                f"a sampling rate of {self.rate:g} Hz is too low for a carrier of "
                f"{KHZ * carrier:g} kHz; record at {2.2 * high:.0f} Hz or more"
            )
        bins = np.arange(int(np.ceil(low / self.step)), int(high / self.step))
        return bins, _edges(len(bins), round(TAPER * len(bins)))

    @property
    def window(self) -> Array:
        """Times of the baseband samples used, in s from the start of the record, (n_time,)."""
        return self.time[self.used]

    @cached_property
    def places(self) -> Array:
        """Distances in m whose echoes arrive at the times of :attr:`window`, (n_time,)."""
        return self.path.place_at(np.maximum(self.window - self.rangefinder.lead, 0.0))

    @cached_property
    def half_wavelength(self) -> float:
        """Half a wavelength at the middle of the band, in m."""
        return self.air.sound_speed / (2 * float(np.mean(self.frequency)))

    @property
    def interval(self) -> float:
        """Interval in s between samples of the baseband."""
        return float(self.time[1] - self.time[0])

    @property
    def nearest(self) -> float:
        """Distance in m of the nearest press whose echo is not clipped."""
        flight = self.clear - self.rangefinder.lead + AFTER_CLIPPING + FADE
        return 0.5 * self.air.sound_speed * flight + OWN_LENGTH

    def echo_ranges(self, places: Array, before: float, lasting: float, n: int) -> NDArray[np.int_]:
        """Return the ranges of baseband samples that the echoes of presses cover.

        Parameters
        ----------
        places : ndarray
            Distances of the presses in m, (n_places,).
        before, lasting : float
            A range begins `before` seconds before the echo of the start of the drive arrives, and
            ends `lasting` seconds after the echo of its end arrives.
        n : int
            Number of samples, counted from the first used one, to which the ranges are limited.

        Returns
        -------
        ndarray
            Index of the first sample and of the one after the last, at least two apart if there
            are so many samples, (n_places, 2).
        """
        arrival = np.interp(places, self.places, np.arange(len(self.used)))
        first = (arrival - before / self.interval).astype(int)
        late = (self.rangefinder.drive.duration + lasting) / self.interval
        last = np.ceil(arrival + late).astype(int)
        first = np.clip(first, 0, max(n - 2, 0))
        return np.stack([first, np.minimum(np.maximum(last, first + 2), n)], axis=1)

    def noise(self, n_cycles: int) -> float:
        """Return the noise variance in counts squared of a baseband sample of the mean of cycles.

        Thermal noise and the dithered part of the rounding error are white, and independent from
        cycle to cycle.
        """
        variance, band = self._thermal**2, len(self.bins) * self.step / (self.rate / 2)
        if self.rangefinder.quantised:
            variance += 1 / 12 - common_rounding(self._thermal)
        # Both halves of a folded band hold the same record, and its samples are real.
        return 2 * self.freedom**2 * max(variance / n_cycles, 1e-12) * band + self.rounding

    @property
    def rounding(self) -> float:
        """Variance in counts squared of a baseband sample due to rounding without dither by noise.

        This part of the rounding error is in the band of the signal, and the same in all cycles.
        """
        return 2 * self.freedom * common_rounding(self._thermal) * self.rangefinder.quantised

    @checked(counts=Reals(ndim=2))
    def of_cycles(self, counts: NDArray[np.generic]) -> tuple[Complex, float]:
        """Return the baseband of the mean of cycles, and the noise variance of a sample of it.

        Parameters
        ----------
        counts : ndarray
            Counts of the converter, (n_cycles, n_samples).

        Returns
        -------
        mean : ndarray
            Baseband in counts, with the rounding of weak signals corrected, (n_time,).
        variance : float
            In counts squared: from the scatter of the cycles within the band and :attr:`rounding`,
            or from :meth:`noise` for fewer than :data:`FEWEST_CYCLES` cycles.

        Raises
        ------
        ConfigError
            If there is no cycle, or cycles have another length than `n_samples`.
        """
        counts = np.asarray(counts)
        n = len(counts)
        if n == 0 or counts.shape[1] != self.n_samples:
            raise ConfigError(
                f"counts have shape {counts.shape}; give one or more cycles of {self.n_samples} "
                "samples, those of the model"
            )
        dither = self._thermal * self.rangefinder.quantised
        found = linearised(counts, dither, int(QUIET_SHARE * counts.shape[1]))
        mean = self._of_samples(found.mean)
        if n < FEWEST_CYCLES:
            return mean, self.noise(n)
        each = self._of_samples(found.deviations)
        scatter = np.sum(np.abs(each - each.mean(axis=0)) ** 2) / ((n - 1) * n * each.shape[1])
        least = 0.1 * (self.noise(n) - self.rounding)
        return mean, float(max(scatter, least) + self.rounding)

    def ring_down(self) -> Complex:
        """Return the ring-down in the baseband in counts, from the rangefinder's parameters."""
        n = self.period
        real = np.asarray(np.fft.rfftfreq(n, 1 / self.rate)[1:], float)
        f = real.astype(complex)
        r = self.rangefinder
        spectrum = r.send * sent_spectrum(r, f, self.rate, n, 0.0)
        spectrum *= r.resonator(f) * anti_alias(real, self.rate) * self.per_volt
        spectrum *= np.exp(-2j * pi * real * r.lead)
        samples = np.fft.irfft(np.concatenate([[0], spectrum]) * self.rate, n)[: self.n_samples]
        return self._of_samples(samples)

    def transformed(self, spectrum: Complex) -> Complex:
        """Return the baseband in counts, (..., n_time), of spectra in counts s, (..., n_f).

        The spectra may be given at every m-th frequency only, if m divides n_f (:meth:`every`). The
        result is then the sum of the baseband and its copies shifted by multiples of n_f / m
        samples (aliasing in time).
        """
        count = spectrum.shape[-1]
        scale = 2 * len(self.bins) * self.step * self.taper[:: len(self.bins) // count]
        samples = np.fft.ifft(spectrum * scale.astype(spectrum.real.dtype), axis=-1)
        if count == len(self.bins):  # the samples used are consecutive
            return samples[..., self.used[0] : self.used[-1] + 1]
        return samples.take(self.used % count, axis=-1)

    def every(self, duration: float) -> int:
        """Return the largest m such that every m-th frequency represents echoes of a duration in s.

        Later sound of an echo is aliased to its start (:meth:`transformed`).
        """
        most = int(len(self.bins) * self.interval / duration)
        return next((m for m in range(most, 1, -1) if len(self.bins) % m == 0), 1)

    def adjoint(self, samples: Complex) -> Complex:
        """Return the adjoint of :meth:`transformed` applied to samples: spectra (..., n_f).

        The inner product of the result with a spectrum is that of the samples with the baseband of
        the spectrum. Samples (..., n) may be only the first n of n_time; the others count as zero.
        """
        full = np.zeros((*samples.shape[:-1], len(self.bins)), complex)
        full[..., self.used[: samples.shape[-1]]] = samples
        return np.asarray(2 * self.step * self.taper * np.fft.fft(full, axis=-1))

    def press_gain(self, detuned: Array) -> Complex:
        """Return the gain from reflection coefficient to recorded spectrum of detuned transducers.

        Parameters
        ----------
        detuned : ndarray
            Relative deviations of the resonance and of the quality factor, (n, 2).

        Returns
        -------
        ndarray
            Gain in counts s, (n, n_f).
        """
        r = self.rangefinder
        resonance = r.resonance * (1 + detuned[:, :1])
        quality = r.quality_factor * (1 + detuned[:, 1:])
        f = self.frequency
        off = f / resonance - resonance / f
        return np.asarray(self.sent / (1 + 1j * quality * off) ** 2)

    def _of_samples(self, samples: Array) -> Complex:
        time = np.arange(samples.shape[-1]) / self.rate
        fade = np.sin(pi / 2 * np.clip((time - self.clear - AFTER_CLIPPING) / FADE, 0, 1)) ** 2
        spectrum = np.fft.fft(samples * fade, self.period, axis=-1)[..., self.bins] / self.rate
        return self.transformed(spectrum * self.turn)

    def _clipped(self) -> float:
        """Return the time in s at which the ring-down has fallen below full scale."""
        r = self.rangefinder
        decay = r.quality_factor / (pi * r.resonance)
        ratio = max(2 * r.send / r.full_scale, 1.0)
        return r.lead + r.drive.duration + decay * log(ratio)

    def _wavenumbers(self) -> tuple[Complex, Complex]:
        """Return the modes' wavenumbers in 1/m and derivatives in 1/(m K), (n_f, m)."""

        def at(air: Air) -> Complex:
            numbers = [mode_numbers(name) for name in self.modes]
            return np.stack(
                [axial_wavenumber(*one, self.frequency, self.radius, air) for one in numbers], -1
            )

        cold, warm, apart = neighbouring_air(self.temperature)
        return at(self.air), (at(warm) - at(cold)) / apart

    def _path(self, wrap: Wrap | None) -> Path:
        m = min(MOST_MODES, len(self.modes))
        k, heat = self.k[:, :m], self.k_by_temperature[:, :m]
        if wrap is None:
            return StraightPath(k, heat, self.speed)
        relative = self.speed_by_temperature / self.speed
        return WrappedPath(
            wrap, self.air, self.frequency, self.radius, self.modes[:m], k, heat, relative
        )

    def _drive(self) -> Complex:
        """Return the spectrum of the drive after the converter's anti-aliasing filter, (n_f,)."""
        grid = np.asarray(np.arange(1, self.period // 2 + 1) * self.step, complex)
        sent = sent_spectrum(self.rangefinder, grid, self.rate, self.period, 0.0)[self.bins - 1]
        return np.asarray(sent * anti_alias(self.frequency, self.rate))


def _edges(n: int, width: int) -> Array:
    """Return a taper of n samples that rises and falls over `width` samples as a squared sine."""
    rise = np.sin(pi / 2 * (np.arange(width) + 0.5) / width) ** 2
    found = np.ones(n)
    found[:width], found[n - width :] = rise, rise[::-1]
    return found


def _speeds(temperature: float) -> tuple[float, float]:
    """Return the speed of sound in m/s and its derivative by temperature in m/(s K)."""
    cold, warm, apart = neighbouring_air(temperature)
    return air_at(temperature).sound_speed, (warm.sound_speed - cold.sound_speed) / apart
