"""Excitation pulses: a sine under a Gaussian envelope, or any sampled waveform."""

from __future__ import annotations

from dataclasses import dataclass
from math import log, pi, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from acoustube.base.checks import CYCLES, FREQUENCY, RATE, Reals, check_fields
from acoustube.base.errors import ConfigError
from acoustube.base.units import MS


@dataclass(frozen=True, kw_only=True)
class Pulse:
    """A Gaussian-modulated sine of unit amplitude; call it with times in s.

    Attributes
    ----------
    frequency : float
        Carrier frequency f in Hz.
    cycles : float
        Duration of the window in carrier cycles.

    Raises
    ------
    ConfigError
        If the frequency is not positive, or the number of cycles not from 0.1 to 10 000.

    Notes
    -----
    s(t) = exp(-(t - T/2)^2 / (2 sigma^2)) sin(2 pi f (t - T/2)) for 0 <= t <= T = cycles / f, else
    0, with sigma = T/6. The window extends over +-3 sigma and truncates the envelope at 1.1 % of
    its peak. With a whole number of cycles the carrier vanishes there, and the signal is
    continuous.
    """

    frequency: float
    cycles: float = 11.0

    def __post_init__(self) -> None:
        """Validate frequency and cycles."""
        check_fields(self, frequency=FREQUENCY, cycles=CYCLES)

    @property
    def duration(self) -> float:
        """Duration of the window in s."""
        return self.cycles / self.frequency

    @property
    def sigma(self) -> float:
        """Standard deviation of the Gaussian envelope in s, a sixth of the duration."""
        return self.duration / 6.0

    def __call__(self, time: ArrayLike) -> NDArray[np.float64]:
        """Return the pulse at times in s, with unit peak envelope."""
        since_centre = np.asarray(time, dtype=float) - 0.5 * self.duration
        envelope = np.exp(-0.5 * (since_centre / self.sigma) ** 2)
        carrier = np.sin(2.0 * pi * self.frequency * since_centre)
        return np.where(np.abs(since_centre) <= 0.5 * self.duration, envelope * carrier, 0.0)

    def band(self, level: float = -20.0) -> tuple[float, float]:
        """Return the band in which the spectrum is above a level.

        Parameters
        ----------
        level : float
            In dB relative to the spectrum's peak, negative.

        Returns
        -------
        lowest, highest : float
            Ends of the band in Hz; the lower is 0 or more.

        Raises
        ------
        ValueError
            If the level is not negative.

        Notes
        -----
        The truncation of the envelope is neglected: at a frequency that differs by d from the
        carrier's, the spectrum relative to its peak is exp(-(2 pi sigma d)^2 / 2).
        """
        if not level < 0.0:
            raise ValueError(f"level = {level} dB must be negative")
        nepers = -level * log(10.0) / 20.0
        half_width = sqrt(2.0 * nepers) / (2.0 * pi * self.sigma)
        return max(self.frequency - half_width, 0.0), self.frequency + half_width


@dataclass(frozen=True, kw_only=True, eq=False)
class SampledPulse:
    """A pulse given by its samples; call it with times in s.

    Attributes
    ----------
    pressure : ndarray
        Samples from t = 0, (n,).
    rate : float
        Samples per second.

    Raises
    ------
    ValueError
        If there are fewer than four samples, a sample is not finite, or the rate not positive.

    Notes
    -----
    The samples are interpolated by a cubic spline, with zero before the first and after the last
    sample. The sampling rate should be ten times the highest frequency or more.
    """

    pressure: ArrayLike
    rate: float

    def __post_init__(self) -> None:
        """Validate samples and rate."""
        check_fields(self, pressure=Reals(ndim=1), rate=RATE)
        if np.size(self.pressure) < 4:
            raise ValueError(
                f"pressure of shape {np.shape(self.pressure)} is not a pulse; give four or more "
                "samples"
            )

    @property
    def duration(self) -> float:
        """Time of the last sample in s."""
        return (np.size(self.pressure) - 1) / self.rate

    def __call__(self, time: ArrayLike) -> NDArray[np.float64]:
        """Return the pulse at times in s."""
        samples = np.asarray(self.pressure, dtype=float)
        spline = CubicSpline(np.arange(samples.size) / self.rate, samples, extrapolate=False)
        return np.nan_to_num(spline(np.asarray(time, dtype=float)))


def check_pulse(pulse: object, duration: float) -> None:
    """Raise ValueError unless a pulse is a function of time, not longer than the run (in s)."""
    if not callable(pulse):
        raise ConfigError(
            "is not a function of time", setting="pulse", value=pulse, advice="use Pulse"
        )
    check_duration(pulse, duration)


def check_duration(pulse: object, duration: float) -> None:
    """Raise ValueError if a pulse is longer than the run (in s); one without `duration` passes."""
    lasting = float(getattr(pulse, "duration", 0.0))
    if lasting > duration:
        raise ValueError(
            f"the pulse lasts {MS * lasting:.4g} ms, longer than the run; use duration = "
            f"{lasting:.4g} s or more, or a shorter pulse"
        )
