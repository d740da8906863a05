"""Drives of a transducer with closed-form spectra: tone bursts, linear chirps and several tones.

References
----------
* Linear chirps and their spectra by Fresnel integrals: Klauder, J. R., Price, A. C., Darlington, S.
  and Albersheim, W. J., The theory and design of chirp radars, Bell System Technical Journal 39
  (1960), 745-808. doi:10.1002/j.1538-7305.1960.tb03942.x
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import pi, sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import wofz

from acoustube.base.errors import ConfigError
from acoustube.base.rules import Choice, Number, Section, setting
from acoustube.base.types import Array
from acoustube.waves.scattering import Complex

WINDOWS = {"rectangular": (1.0, 0.0), "hann": (0.5, 0.5), "hamming": (0.54, 0.46)}
"""Windows a - b cos(2 pi t / T) over a duration T by name: a and b."""
FREQUENCY = Number(1e3, 1e6, "Hz", "frequency of the drive")
DURATION = Number(1e-5, 1.0, "s", "duration of the drive")
MOST_TONES = 64
"""Largest number of tones of a drive."""


@dataclass(frozen=True)
class Frequencies:
    """Rule for one or more frequencies, a tuple or a list."""

    def check(self, name: str, value: Any) -> tuple[float, ...]:
        """Return the frequencies in Hz as a tuple.

        Raises
        ------
        ConfigError
            If there are none, too many, or one is out of range.
        """
        given = value if isinstance(value, tuple | list) else (value,)
        if not 1 <= len(given) <= MOST_TONES:
            raise ConfigError(
                f"has {len(given)} values", setting=name, value=list(given)[:4],
                advice=f"use 1 to {MOST_TONES} frequencies in Hz",
            )  # fmt: skip
        return tuple(float(FREQUENCY.check(name, one)) for one in given)


@dataclass(frozen=True, kw_only=True)
class Burst(Section):
    """Tone burst of unit amplitude.

    Attributes
    ----------
    frequency : float
        In Hz. Default 42 kHz (data sheet of the rangefinder).
    cycles : float
        Number of periods. Default 13 (data sheet).
    shape : str
        Waveform: ``square``, as from a logic output (default, chosen), or ``sine``.

    Raises
    ------
    ConfigError
        If a value is out of range.
    """

    frequency: float = setting(42e3, FREQUENCY)
    cycles: float = setting(13.0, Number(0.5, 1e3, "", "cycles of the drive"))
    shape: str = setting("square", Choice(("square", "sine"), "form of the drive"))

    @property
    def duration(self) -> float:
        """Duration in s."""
        return self.cycles / self.frequency

    @property
    def bandwidth(self) -> float:
        """Bandwidth in Hz of the frequency sweep: zero, since a burst has none."""
        return 0.0

    def spectrum(self, frequency: Complex) -> Complex:
        """Return the Fourier transform in s at frequencies in Hz, real or complex, not zero.

        Closed forms, so that no overtone is aliased: a square burst is a sum of steps at times t,
        with the transforms exp(-j omega t) / (j omega), and a sine burst has two sinc functions.
        """
        if self.shape == "sine":
            return _sine(frequency, self.frequency, self.duration)
        omega, end = 2 * pi * frequency, self.duration
        edges = np.arange(int(np.ceil(2 * self.cycles))) / (2 * self.frequency)
        steps = np.where(np.arange(len(edges)) % 2, -2.0, 2.0)
        steps[0] = 1.0
        edges, steps = np.append(edges, end), np.append(steps, -np.sign(steps[-1]))
        return np.exp(-1j * np.outer(omega, edges)) @ steps / (1j * omega)


@dataclass(frozen=True, kw_only=True)
class Chirp(Section):
    """Linear chirp of unit amplitude: a sine of linearly rising frequency; call it with times in s.

    Attributes
    ----------
    frequency : float
        Middle of the band in Hz. Default 30 kHz.
    bandwidth : float
        Highest less lowest instantaneous frequency in Hz. Default 20 kHz.
    duration : float
        In s. Default 1 ms.
    window : str
        Amplitude over time: ``rectangular`` (default), ``hann`` or ``hamming``, which need a linear
        amplifier and send less energy.

    Raises
    ------
    ConfigError
        If a value is out of range, or the band reaches zero.

    Notes
    -----
    s(t) = w(t) sin(2 pi (f1 t + k t^2 / 2)) for 0 <= t <= T, with f1 = frequency - bandwidth / 2
    and k = bandwidth / T.
    """

    frequency: float = setting(30e3, FREQUENCY)
    bandwidth: float = setting(20e3, Number(10.0, 1e6, "Hz", "bandwidth of the chirp"))
    duration: float = setting(1e-3, DURATION)
    window: str = setting("rectangular", Choice(tuple(WINDOWS), "amplitude of the chirp"))

    def __post_init__(self) -> None:
        """Validate the values and the band."""
        super().__post_init__()
        if self.bandwidth >= 2 * self.frequency:
            raise ConfigError(
                f"extends below 0 Hz about a frequency of {self.frequency:g} Hz",
                setting="bandwidth", value=self.bandwidth,
                advice=f"use less than {2 * self.frequency:g} Hz",
            )  # fmt: skip

    @property
    def rate(self) -> float:
        """Rate of change of the instantaneous frequency in Hz/s."""
        return self.bandwidth / self.duration

    def __call__(self, time: ArrayLike) -> Array:
        """Return the chirp at times in s."""
        t = np.asarray(time, float)
        level, cosine = WINDOWS[self.window]
        phase = 2 * pi * t * (self.frequency - self.bandwidth / 2 + self.rate * t / 2)
        wave = (level - cosine * np.cos(2 * pi * t / self.duration)) * np.sin(phase)
        return np.where((t >= 0) & (t <= self.duration), wave, 0.0)

    def spectrum(self, frequency: Complex) -> Complex:
        """Return the Fourier transform (unit: s) at frequencies in Hz, real or complex.

        A closed form by the Faddeeva function; a window adds shifted spectra.
        """
        level, cosine = WINDOWS[self.window]
        lines = level * self._rectangular(frequency)
        if cosine:
            for shift in (-1, 1):
                lines -= cosine / 2 * self._rectangular(frequency + shift / self.duration)
        return np.asarray(lines)

    def _rectangular(self, frequency: Complex) -> Complex:
        """Return the transform (unit: s) of the chirp without a window, at frequencies in Hz."""
        first = self.frequency - self.bandwidth / 2
        f = np.asarray(frequency, complex)
        rising = _fresnel(np.asarray(first - f), self.rate, self.duration)
        falling = _fresnel(np.asarray(first + f.conj()), self.rate, self.duration).conj()
        return np.asarray((rising - falling) / 2j)


@dataclass(frozen=True, kw_only=True)
class Tones(Section):
    """Several tones, one after the other or together; call it with times in s.

    Attributes
    ----------
    frequencies : tuple of float
        In Hz, one or more.
    duration : float
        Of the whole drive in s. Default 1 ms.
    order : str
        ``in turn`` (default): bursts of full amplitude, one after the other, each of an equal part
        of the duration; ``together``: their sum over the whole duration, each tone with the
        amplitude 1 / n, so that the sum never exceeds 1.

    Raises
    ------
    ConfigError
        If a value is out of range, or there are more than :data:`MOST_TONES` tones.
    """

    frequencies: tuple[float, ...] = field(
        default=(20e3, 30e3, 40e3), metadata={"rule": Frequencies()}
    )
    duration: float = setting(1e-3, DURATION)
    order: str = setting("in turn", Choice(("in turn", "together"), "order of the tones"))

    @property
    def frequency(self) -> float:
        """Middle of the band in Hz."""
        return (min(self.frequencies) + max(self.frequencies)) / 2

    @property
    def bandwidth(self) -> float:
        """Width of the band in Hz, to the outer first zeros of the outermost tones' spectra."""
        return max(self.frequencies) - min(self.frequencies) + 2 / self._parts[0][2]

    @property
    def _parts(self) -> list[tuple[float, float, float, float]]:
        """Frequency in Hz, start and duration in s, and amplitude of each tone."""
        n = len(self.frequencies)
        if self.order == "together":
            return [(f, 0.0, self.duration, 1 / n) for f in self.frequencies]
        each = self.duration / n
        return [(f, i * each, each, 1.0) for i, f in enumerate(self.frequencies)]

    def __call__(self, time: ArrayLike) -> Array:
        """Return the drive at times in s."""
        total = np.zeros(np.shape(time))
        for f, start, lasting, level in self._parts:
            t = np.asarray(time, float) - start
            total += np.where((t >= 0) & (t < lasting), level * np.sin(2 * pi * f * t), 0.0)
        return total

    def spectrum(self, frequency: Complex) -> Complex:
        """Return the Fourier transform (unit: s) at frequencies in Hz, real or complex."""
        f = np.asarray(frequency)
        total = np.zeros(f.shape, complex)
        for tone, start, lasting, level in self._parts:
            total += level * np.exp(-2j * pi * f * start) * _sine(f, tone, lasting)
        return total


def _sine(frequency: Complex, carrier: float, end: float) -> Complex:
    """Return the Fourier transform in s of a sine of `carrier` Hz that lasts from 0 to `end` s."""
    omega, own = 2 * pi * frequency, 2 * pi * carrier
    lines = [
        end * np.exp(0.5j * end * off) * np.sinc(end * off / (2 * pi))
        for off in (own - omega, -own - omega)
    ]
    return np.asarray((lines[0] - lines[1]) / 2j)


def _fresnel(off: Complex, rate: float, end: float) -> Complex:
    """Return the integral in s from 0 to `end` of exp(2j pi (off t + rate t^2 / 2)) over t.

    With a = off / rate, the result is exp(-j pi rate a^2) times the integral of exp(j pi rate u^2)
    over u from a to a + end. It is the difference of two integrals, each from one limit to infinity
    or to -infinity, which are expressed by w(z) = exp(-z^2) erfc(-j z) in the half plane in which w
    is bounded. Where 0 lies between the limits, the integral over the whole real axis is added.
    """
    a = off / rate
    root = np.exp(-0.25j * pi) * sqrt(pi * rate)

    def tail(u: Complex) -> Complex:
        """Return the scaled integral of exp(j pi rate v^2) over v from u to infinity.

        For u < 0 the integral is from u to -infinity. The scale factor is
        exp(-j pi rate u^2) 2 root / sqrt(pi), with root = exp(-j pi / 4) sqrt(pi rate).
        """
        return np.where(u.real >= 0, 1.0, -1.0) * wofz(1j * root * np.where(u.real >= 0, u, -u))

    turn = np.exp(1j * pi * rate * end * (2 * a + end))
    between = (a.real < 0) & (a.real + end >= 0)
    middle = np.where(between, 2 * np.exp(-1j * pi * rate * np.where(between, a, 0) ** 2), 0.0)
    return np.asarray((middle + tail(a) - turn * tail(a + end)) * sqrt(pi) / (2 * root))
