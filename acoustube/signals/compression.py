"""Pulse compression: the complex matched filter of a linear chirp.

References
----------
* Compression of linear chirps, their side lobes, and weighting to lower these:
  Klauder, J. R., Price, A. C., Darlington, S. and Albersheim, W. J., The theory and design of chirp
  radars, Bell System Technical Journal 39 (1960), 745-808. doi:10.1002/j.1538-7305.1960.tb03942.x
* Windows: Harris, F. J., On the use of windows for harmonic analysis with the discrete Fourier
  transform, Proceedings of the IEEE 66 (1978), 51-83. doi:10.1109/PROC.1978.10837
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from acoustube.base.checks import DURATION, FREQUENCY, RATE, checked
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Choice
from acoustube.signals.filters import LONGEST_TEMPLATE

WINDOWS = {"rectangular": (1.0, 0.0), "hann": (0.5, 0.5), "hamming": (0.54, 0.46)}
"""Coefficients a and b of each window a + b cos(2 pi t / T), by name; T is the window's duration,
and its middle is at t = 0."""
WINDOW = Choice(tuple(WINDOWS), "weighting of the chirp's template")


@checked(
    sampling_rate=RATE, frequency=FREQUENCY, bandwidth=FREQUENCY, duration=DURATION, window=WINDOW
)
def chirp_template(
    sampling_rate: float,
    frequency: float,
    bandwidth: float,
    duration: float,
    window: str = "hann",
) -> NDArray[np.complex128]:
    """Return the analytic template, of unit energy, that compresses a linear chirp.

    Parameters
    ----------
    sampling_rate : float
        Samples per second.
    frequency, bandwidth : float
        Middle and width of the band in Hz, through which the frequency rises.
    duration : float
        In s.
    window : str
        ``rectangular``, ``hann`` or ``hamming``.

    Returns
    -------
    array of shape (n,)
        An odd number of samples, the middle one at the middle of the chirp.

    Raises
    ------
    ConfigError
        If the band reaches zero or the Nyquist frequency, or the template is too long.

    Notes
    -----
    The magnitude of :func:`acoustube.signals.matched_filter` with this template is the envelope of
    the compressed chirp; no rectifier and low-pass are needed. For a chirp whose product of
    bandwidth B and duration is much larger than 1, the width of the main lobe at -3 dB and the
    level of the highest side lobe are

    * rectangular: 0.886 / B, -13.3 dB;
    * hann: 1.44 / B, -31.5 dB, at 1.8 dB less signal-to-noise ratio;
    * hamming: 1.30 / B, -42.7 dB, at 1.3 dB less.
    """
    half_band = bandwidth / 2
    if not half_band < frequency < sampling_rate / 2 - half_band:
        raise ConfigError(
            f"with bandwidth = {bandwidth:g} Hz extends beyond 0 or half the sampling rate "
            f"({sampling_rate / 2:g} Hz)", setting="frequency", value=frequency,
            advice="use a narrower chirp, or sample faster",
        )  # fmt: skip
    if duration * sampling_rate > LONGEST_TEMPLATE:
        raise ConfigError(
            f"is over {LONGEST_TEMPLATE:g} samples at {sampling_rate:g} Hz", setting="duration",
            value=duration, advice="use a shorter chirp",
        )  # fmt: skip
    half = int(np.floor(duration * sampling_rate / 2))
    time = np.arange(-half, half + 1) / sampling_rate
    level, cosine = WINDOWS[window]
    weight = level + cosine * np.cos(2 * np.pi * time / duration)
    wave = weight * np.exp(2j * np.pi * time * (frequency + bandwidth / duration * time / 2))
    return np.asarray(wave / np.linalg.norm(wave))
