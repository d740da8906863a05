"""Steps of scattering coefficients at the cut-ons of modes, and evanescent modes just below.

A given coefficient of a mode is zero below the mode's cut-on f_c, and begins there with a step: at
its cut-on a mode is reflected with -1. Above, it is an analytic function of the mode's axial
wavenumber k_z, and therefore of u = k_z / k_c, with k_c = 2 pi f_c / c. Without losses
u = sqrt((f / f_c)^2 - 1); where losses are known they are included, since within about 100 Hz of
the cut-on they change u by as much as its value. A power-normalised coefficient between two modes
is the square root of the higher mode's wavenumber times such a function (the threshold law of
[1]_). Interpolation would oscillate about the step over the whole band (Gibbs phenomenon).
Therefore a polynomial in u, fitted to the coefficients next to the cut-on, is subtracted before the
interpolation and added afterwards, with a window that makes it vanish farther from the cut-on.

Just below its cut-on a mode is evanescent, but extends over centimetres, and couples a press to a
bend beside it. The coefficients of bends are known there too, and the polynomial is fitted on both
sides of the cut-on. For a press the added polynomial is the analytic continuation of the
coefficients. Without it the spectrum of an echo would have a step at the cut-on, whose transform is
not causal.

Through a bend of 10 cm a mode close to its cut-on is delayed by so much that no such polynomial
fits its transmission. This is small there, since the mode is also attenuated, and nothing is
subtracted.

References
----------
.. [1] Wigner, E. P. (1948). On the behavior of cross sections near thresholds. Physical Review 73,
   1002-1009. doi:10.1103/PhysRev.73.1002
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import pi
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from acoustube.base.types import Array
from acoustube.waves.port_waves import Complex

SPAN = 2e3
"""Range in Hz above a cut-on in which the polynomial is fitted, and the scale of its window; also
below the cut-on where the coefficients are known there."""
SPAN_BELOW = 250.0
"""Scale in Hz of the window below a cut-on where the coefficients are not known there. In the 50 Hz
below it, the largest error of the echo of a press between bends is 2 to 11 % of the echo without
the continuation, 0.4 to 5 % with scales of 150 to 300 Hz. With 400 Hz it is up to 13 %, farther
below: the polynomial is extrapolated."""
DEGREE = 5
"""Degree of the polynomial. The error of interpolation between frequencies 100 Hz apart, for a rod
on a bore of 9 mm and from 0.5 to 8 kHz above a cut-on (rms of all coefficients), is 0.002 to 0.004;
with degree 4 it is 0.004 to 0.010, and without the polynomial 0.05 to 0.14."""
FEWEST = 10
"""Least number of given frequencies in the fit, that is, within `SPAN` above a cut-on. With fewer,
for a cut-on close to the end of the band or in steps of more than 200 Hz, the polynomial is not
subtracted."""
GOOD_FIT, POOREST_FIT = 0.1, 0.3
"""Relative rms residuals of the fit, with its weights, up to which a polynomial is subtracted as a
whole, and from which on it is not subtracted; between them, a part of it is."""
FIT_SCALE = 500.0
"""Scale in Hz of the decay of the fit's weights away from a cut-on. With equal weights over `SPAN`
the coefficients at the cut-on are two to three times less accurate."""

Losses = Callable[[str, NDArray[Any]], Complex]
"""Function from the name of a mode and frequencies in Hz, (n,), to the change of the mode's squared
axial wavenumber by losses in 1/m2, (n,)."""
Axial = Callable[[NDArray[Any], float], NDArray[Any]]
"""Function from frequencies and a cut-on in Hz to u, the axial wavenumber of the mode of that
cut-on relative to its cut-on wavenumber."""


class Onsets(NamedTuple):
    """Cut-on frequencies of scattering coefficients, and which coefficients convert modes.

    Attributes
    ----------
    cut_on : ndarray
        Cut-on of the higher of the two modes of each coefficient, in Hz, (n,).
    converts : ndarray of bool
        Whether the two modes have different cut-ons, (n,).
    """

    cut_on: Array
    converts: NDArray[np.bool_]


def onsets(cut_ons: Array) -> Onsets:
    """Return the cut-ons of the coefficients of a scattering matrix (2, m, 2, m), flattened.

    Parameters
    ----------
    cut_ons : ndarray
        Cut-ons of the modes in Hz, (m,).
    """
    shape = 2, len(cut_ons), 2, len(cut_ons)
    out, into = cut_ons[:, None, None], cut_ons
    higher = np.broadcast_to(np.maximum(out, into), shape)
    return Onsets(higher.ravel(), np.broadcast_to(out != into, shape).ravel())


class Step(NamedTuple):
    """Steps of scattering coefficients at a cut-on, as polynomials fitted to the coefficients.

    Attributes
    ----------
    columns : ndarray of int
        Indices of the coefficients, (n_columns,).
    fitted : slice
        Given frequencies to which the polynomial is fitted.
    weight : ndarray
        Weights of these frequencies in the fit, (n_fitted,).
    share : ndarray
        Share of each coefficient's polynomial that is subtracted, (n_columns,).
    given, wanted : ndarray
        Matrices from the coefficients at the fitted frequencies to the polynomial at the given
        frequencies, (n_given, n_fitted), and at those wanted, (n_wanted, n_fitted).
    """

    columns: NDArray[np.int_]
    fitted: slice
    weight: Array
    share: Array
    given: NDArray[Any]
    wanted: Complex


def lossless(frequency: NDArray[Any], cut_on: float) -> NDArray[Any]:
    """Return u = sqrt((f / f_c)^2 - 1) at frequencies f and a cut-on f_c, all in Hz.

    Below the cut-on it is imaginary, and negative as for an evanescent wave.
    """
    return np.asarray(-1j * np.sqrt(1 - (frequency / cut_on) ** 2 + 0j))


def lossy(names: Sequence[str], cut_ons: Array, sound_speed: float, losses: Losses) -> Axial:
    """Return u of modes with the losses of the straight tube, as a function; see :data:`Axial`.

    Parameters
    ----------
    names : sequence of str
        Of the m modes, as ``11c``.
    cut_ons : ndarray
        Cut-ons of the modes in Hz, without losses, (m,).
    sound_speed : float
        In m/s.
    losses : callable
        See :data:`Losses`.
    """

    def axial(frequency: NDArray[Any], cut_on: float) -> NDArray[Any]:
        name = names[int(np.argmin(np.abs(cut_ons - cut_on)))]
        change = losses(name, frequency) * (sound_speed / (2 * pi * cut_on)) ** 2
        return np.asarray(np.sqrt((frequency / cut_on) ** 2 - 1 + change))

    return axial


def steps(
    given: Array,
    wanted: NDArray[Any],
    begun: Onsets,
    axial: Axial = lossless,
    *,
    evanescent: bool = False,
) -> list[Step]:
    """Return the steps of scattering coefficients at the cut-ons within the given band.

    Parameters
    ----------
    given : ndarray
        Frequencies in Hz at which the coefficients are given, rising and real, (n_given,).
    wanted : ndarray
        Frequencies in Hz at which to interpolate, real or complex, (n_wanted,).
    begun : Onsets
        Cut-ons of the coefficients.
    axial : callable
        Relative axial wavenumbers u of the modes, see :data:`Axial`.
    evanescent : bool
        Whether the coefficients are known below the cut-ons too, in place of zero.
    """
    found = []
    for cut_on in np.unique(begun.cut_on[begun.cut_on > 0]):
        first = int(np.searchsorted(given, cut_on, side="right"))
        fitted = slice(first, int(np.searchsorted(given, cut_on + SPAN)))
        if first == 0 or fitted.stop - first < FEWEST:
            continue
        below = SPAN_BELOW
        if evanescent:
            first, below = int(np.searchsorted(given, cut_on - SPAN)), SPAN
            fitted = slice(first, fitted.stop)
        weight = np.exp(-np.abs(given[fitted] - cut_on) / FIT_SCALE)
        u, powers = _windowed_powers(given[first:], float(cut_on), axial, below)
        u_wanted, powers_wanted = _windowed_powers(wanted, float(cut_on), axial, below)
        for converts in (False, True):
            columns = np.flatnonzero((begun.cut_on == cut_on) & (begun.converts == converts))
            if not len(columns):
                continue
            power = 0.5 if converts else 0.0
            here = np.zeros((len(given), DEGREE + 1), complex)
            here[first:] = u**power * powers
            fit = np.linalg.pinv(weight[:, None] * here[fitted]) * weight
            there = u_wanted**power * powers_wanted
            share = np.ones(len(columns))
            found.append(Step(columns, fitted, weight, share, here @ fit, there @ fit))
    return found


def _windowed_powers(
    frequency: NDArray[Any], cut_on: float, axial: Axial, scale: float
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return u, (n, 1), and its powers from 0 up times the window, (n, DEGREE + 1).

    Below the cut-on the window has an additional factor of a scale in Hz.
    """
    u, off = axial(frequency, cut_on)[:, None], frequency - cut_on
    below = np.minimum(off.real, 0.0) / scale
    window = np.exp(-((off / SPAN) ** 2) - below**2)
    return u, window[:, None] * u ** np.arange(DEGREE + 1)


def fitting(found: list[Step], coefficients: Complex) -> list[Step]:
    """Return steps whose shares depend on how well they fit to coefficients, (n_given, n)."""
    kept = []
    for step in found:
        near = coefficients[step.fitted, step.columns]
        off, size = (
            np.linalg.norm(step.weight[:, None] * part, axis=0)
            for part in (near - step.given[step.fitted] @ near, near)
        )
        poor = np.divide(off, size, out=np.zeros_like(off), where=size > 0)
        share = np.clip((POOREST_FIT - poor) / (POOREST_FIT - GOOD_FIT), 0.0, 1.0)
        kept.append(step._replace(share=share))
    return kept


def without(found: list[Step], coefficients: Complex) -> Complex:
    """Return coefficients (n_given, n) minus their steps at the cut-ons."""
    rest = coefficients.copy()
    for step in found:
        near = step.share * coefficients[step.fitted, step.columns]
        rest[:, step.columns] -= step.given @ near
    return rest


def restored(found: list[Step], interpolated: Complex, coefficients: Complex) -> Complex:
    """Return interpolated coefficients (n_wanted, n) plus the steps of those given (n_given, n)."""
    whole = interpolated.copy()
    for step in found:
        near = step.share * coefficients[step.fitted, step.columns]
        whole[:, step.columns] += step.wanted @ near
    return whole
