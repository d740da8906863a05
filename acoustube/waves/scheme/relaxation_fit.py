"""Approximation of the half-integral s^(-1/2) by relaxations, a passive model over a band [1]_.

References
----------
.. [1] Bilbao, S. and Harrison, R. (2016). Passive time-domain numerical models of viscothermal wave
   propagation in acoustic tubes of variable cross section. Journal of the Acoustical Society of
   America 140, 728-740. doi:10.1121/1.4959025
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi, sqrt

import numpy as np
from scipy.optimize import minimize, nnls

from acoustube.base.errors import ConfigError
from acoustube.waves.grid.polyhedron import Array

ACCURACY = 3e-3
"""Relative error of the fit of s^(-1/2), over the band, below which no relaxation is added."""
MOST_POLES = 10
"""Largest number of relaxations in the fit of s^(-1/2)."""
FIT_POINTS = 200
"""Number of frequencies in the least-squares fit of s^(-1/2)."""


@dataclass(frozen=True, kw_only=True)
class HalfIntegral:
    """Sum of weight / (s + rate) that approximates s^(-1/2) over a band.

    Attributes
    ----------
    rates, weights : ndarray
        Relaxation rates in 1/s, and weights in s^(-1/2), (n,).
    error : float
        Largest relative error over the band.
    """

    rates: Array
    weights: Array
    error: float


def half_integral(band: tuple[float, float]) -> HalfIntegral:
    """Return the approximation of the half-integral with the fewest relaxations that suffice.

    Its error is below `ACCURACY`, or that of `MOST_POLES` relaxations if these do not suffice.

    Parameters
    ----------
    band : tuple of float
        Lowest and highest frequency in Hz.

    Returns
    -------
    HalfIntegral
        With rates in geometric progression, of fitted spacing and centre, and non-negative weights,
        so that the model is passive.

    Raises
    ------
    ConfigError
        If not 0 < low < high < infinity.
    """
    if not 0 < band[0] < band[1] < np.inf:
        raise ConfigError(
            f"lossy_band = {band[0]:g} to {band[1]:g} Hz must be positive and increasing; give the "
            "lowest and the highest frequency"
        )
    for n in range(2, MOST_POLES + 1):
        found = _fitted(band, n)
        if found.error < ACCURACY:
            break
    return found


def _fitted(band: tuple[float, float], n: int) -> HalfIntegral:
    """Return the best approximation of s^(-1/2) with n relaxations."""
    omega = 2 * pi * np.geomspace(*band, FIT_POINTS)
    middle = sqrt(omega[0] * omega[-1])
    wanted = (1j * omega) ** -0.5

    def weighted(guess: Array) -> tuple[Array, Array, Array]:
        rates = middle * np.exp(np.linspace(-1, 1, n) * np.exp(guess[0]) + guess[1])
        terms = 1 / (1j * omega[:, None] + rates) / wanted[:, None]
        both = np.concatenate([terms.real, terms.imag])
        weights, _ = nnls(both, np.repeat([1.0, 0.0], FIT_POINTS))
        return rates, weights, np.abs(terms @ weights - 1)

    def cost(guess: Array) -> float:
        return float(np.log(np.mean(weighted(guess)[2] ** 2)))

    spread = np.log(band[1] / band[0])
    trials = [
        minimize(cost, [np.log(width * spread), 0.0], method="Nelder-Mead")
        for width in (0.5, 1.0, 2.0)
    ]
    rates, weights, off = weighted(min(trials, key=lambda trial: trial.fun).x)
    used = weights > 0
    return HalfIntegral(rates=rates[used], weights=weights[used], error=float(off.max()))
