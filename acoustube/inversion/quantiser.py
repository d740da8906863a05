"""Voltage estimated from cycles of a rounding converter with little dither.

With noise of 0.23 counts (rms), the mean of rounded samples is a smoothed staircase function of the
voltage. A weak echo is then recorded with 0.31 to 1.75 times its amplitude, depending on the
offset. Since the noise is known and the offset can be estimated, the staircase can be inverted.

References
----------
* Mean error of a quantiser with Gaussian dither: Widrow, B. and Kollar, I. (2008). Quantization
  Noise. Cambridge University Press.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acoustube.base.types import Array

HARMONICS = 3
"""Number of terms of the staircase's Fourier series."""
DITHER = 0.1
"""Rms noise in counts below which rounding errors are not white, nor independent between cycles."""
LEAST_NOISE, MOST_NOISE = 0.19, 0.6
"""Least rms noise in counts at which the staircase can be inverted, and largest at which it needs
to be."""
ITERATIONS = 6
"""Number of Gauss-Newton iterations."""
BISECTIONS = 20
"""Number of bisections of an interval of one count, by which an offset is found to 1e-6 counts."""
LARGEST_STEP = 0.3
"""Largest change of a sample in an iteration, in counts."""


def common_rounding(noise: float) -> float:
    """Return the variance of the rounding error that is equal in all cycles, in counts squared.

    It is the whole error, 1/12, if the noise before rounding, in counts (rms), is below
    :data:`DITHER`, and 0 otherwise.
    """
    return 1 / 12 if noise < DITHER else 0.0


class Linearised(NamedTuple):
    """Mean voltage of cycles, and the deviations of the single cycles from it.

    Attributes
    ----------
    mean : ndarray
        Voltage in counts, without offset, (n_samples,).
    deviations : ndarray
        Deviations of the single cycles in counts, (n_cycles, n_samples). They are scaled such that
        the error of `mean` has the statistics of their mean over the cycles.
    """

    mean: Array
    deviations: Array


def linearised(counts: NDArray[np.generic], noise: float, quiet: int) -> Linearised:
    """Return the mean voltage of cycles of rounded counts.

    Parameters
    ----------
    counts : ndarray
        Recorded counts, (n_cycles, n_samples).
    noise : float
        Standard deviation of the noise before rounding, in counts; 0 for cycles that are not
        rounded.
    quiet : int
        Number of samples at the end of a cycle from which its offset is estimated.

    Notes
    -----
    The staircase is inverted by least squares over the cycles, each with its own offset, by
    Gauss-Newton iterations. With too little noise to invert the staircase, or so much that no
    correction is needed, the plain mean of the cycles less its offset is returned.
    """
    given = np.asarray(counts, float)
    if not LEAST_NOISE <= noise <= MOST_NOISE:
        mean = given.mean(axis=0)
        return Linearised(mean - mean[-quiet:].mean(), given - mean)
    offset = _inverted(given[:, -quiet:].mean(axis=1), noise)[:, None]
    voltage = (given - offset).mean(axis=0)
    for _ in range(ITERATIONS):
        expected, slope = _staircase(voltage + offset, noise)
        weight = slope / np.maximum((slope**2).sum(axis=0), 1e-3)
        deviations = (given - expected) * weight * len(given)
        step = deviations.mean(axis=0)
        voltage = voltage + np.clip(step, -LARGEST_STEP, LARGEST_STEP)
    return Linearised(voltage, deviations)


def _staircase(voltage: Array, noise: float) -> tuple[Array, Array]:
    """Return the mean of rounded noisy samples of a voltage, and its derivative by the voltage.

    Voltage and rms noise are in counts.
    """
    # Sines and cosines of multiples of the angle follow by recurrence from those of the angle.
    turn = np.exp(2j * np.pi * voltage)
    power, value, slope = np.ones_like(turn), voltage.copy(), np.ones_like(voltage)
    for k in range(1, HARMONICS + 1):
        power = power * turn
        size = (-1) ** k * np.exp(-2 * (np.pi * k * noise) ** 2)
        value += size / (np.pi * k) * power.imag
        slope += 2 * size * power.real
    return value, slope


def _inverted(mean: Array, noise: float) -> Array:
    """Return the voltages in counts whose noisy rounded samples have given means, by bisection."""
    low, high = mean - 0.5, mean + 0.5
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        above = _staircase(middle, noise)[0] > mean
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return np.asarray((low + high) / 2)
