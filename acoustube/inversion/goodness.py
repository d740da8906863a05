"""Goodness of fit: whether the contacts of an inversion explain the echo."""

from __future__ import annotations

import numpy as np

from acoustube.inversion.baseband import Baseband
from acoustube.waves.scattering import Complex

MISFIT = 0.15
"""Relative error of the forward model above which the tube, the tool, the sensor or the number of
contacts is reported to differ from the model."""
WINDOW, RESIDUAL = 2e-3, 2.5
"""Duration in s of the parts of the echo whose whitened residual is tested (twice as long where its
samples are real), and mean square of a part above which the contacts do not explain it. With a
bandwidth of 12 kHz a part has 24 complex samples. If these were independent normal errors, its mean
square would be 1 with a standard deviation of 0.2. The rest of the threshold is for the largest of
the parts, and for errors of the model that last for a part of the echo."""
EXCESS = 2.0
"""Margin that is subtracted from the energy of the residual, besides the energy of the noise, in
standard deviations of the latter. The rest counts as unexplained."""


def good_fit(misfit: float, residual: float) -> bool:
    """Return whether contacts explain an echo: neither value is above its threshold.

    A misfit that is nan, without contacts, counts as none. Where the function returns false, the
    tube, the tools, the sensor or the number of contacts may differ from the model's.

    Parameters
    ----------
    misfit, residual : float
        See :class:`.Inversion`; the thresholds are :data:`MISFIT` and :data:`RESIDUAL`.
    """
    return not (misfit > MISFIT or residual > RESIDUAL)


def largest_residual(white: Complex, base: Baseband) -> tuple[float, tuple[float, float]]:
    """Return the largest mean square of a residual in any part, and the part's distances in m.

    They are :attr:`.Inversion.residual` and :attr:`.Inversion.residual_span`.

    Parameters
    ----------
    white : ndarray
        Whitened residual, (n_time,).
    base : Baseband
        Baseband of its samples.
    """
    power = np.abs(white) ** 2 / base.freedom
    length = min(max(round(WINDOW / (base.interval * base.freedom)), 1), len(power))
    parts = np.convolve(power, np.full(length, 1 / length), "valid")
    first = int(np.argmax(parts))
    span = float(base.places[first]), float(base.places[first + length - 1])
    return float(parts[first]), span


def unexplained(rest: Complex, echo: Complex, freedom: float, excess: float = 0.0) -> float:
    """Return the fraction of the echo's amplitude that neither model nor noise explains.

    Parameters
    ----------
    rest, echo : ndarray
        Residual and echo of the presses, whitened without an error of the model, (n_time,).
    freedom : float
        Expected square of a sample of the residual.
    excess : float, optional
        Margin in standard deviations of the noise's energy, such as :data:`EXCESS`.
    """
    noise = freedom * len(rest)
    beyond = np.sum(np.abs(rest) ** 2) - noise - excess * noise**0.5
    return float(np.sqrt(max(beyond, 0.0) / np.sum(np.abs(echo) ** 2)))
