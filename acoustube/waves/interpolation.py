"""Scattering between the frequencies it was computed at.

By the impulse response of the band: the samples stand for an even time, whose spectrum can be had
at any frequency, real or complex. What a bend transmits is interpolated relative to the plane wave
in it: as band-limited functions of frequency long delays are off where the band ends.

A coefficient of a mode is zero below the mode's cut-on f_c, and begins there with a step: at its
cut-on a mode is reflected with -1. Above, it is an analytic function of the mode's axial
wavenumber, and so of u = sqrt((f / f_c)^2 - 1); one between two modes, power-normalised, is the
square root of the higher mode's wavenumber times such a function (the threshold law of [1]_).
Interpolation oscillates about the step all over the band (Gibbs's phenomenon). So a polynomial in
u, fitted to the coefficients next to the cut-on, is subtracted before and added afterwards, with a
window that makes it vanish farther above.

References
----------
.. [1] Wigner, E. P. (1948). On the behavior of cross sections near thresholds. Physical Review 73,
   1002-1009. doi:10.1103/PhysRev.73.1002
"""

from __future__ import annotations

from math import pi
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len
from scipy.interpolate import CubicSpline

from acoustube.base.types import Array
from acoustube.waves import network_checks as checks
from acoustube.waves.port_waves import Complex
from acoustube.waves.scattering import ModalScattering

SPAN = 2e3
"""Range in Hz above a cut-on in which the polynomial is fitted, and the scale of its window."""
DEGREE = 5
"""Of the polynomial. Between frequencies 100 Hz apart the matrices of a rod on a bore of 9 mm are
off by 0.002 to 0.004 from 0.5 to 8 kHz above a cut-on (rms of all coefficients), in place of 0.05
to 0.14; with degree 4 by 0.004 to 0.010."""
FEWEST = 10
"""Frequencies above a cut-on that the fit needs: of a cut-on nearer to the end of the band there is
little to see."""


class Onsets(NamedTuple):
    """Cut-on frequencies of scattering coefficients, and which of these convert modes.

    Attributes
    ----------
    cut_on : ndarray
        Of the higher mode of each coefficient, in Hz, (n,).
    converts : ndarray of bool
        Whether its modes have different cut-ons, (n,).
    """

    cut_on: Array
    converts: NDArray[np.bool_]


def onsets(cut_ons: Array) -> Onsets:
    """Return the cut-ons of the coefficients of a scattering matrix (2, m, 2, m), flattened.

    Parameters
    ----------
    cut_ons : ndarray
        Of the modes in Hz, (m,).
    """
    shape = 2, len(cut_ons), 2, len(cut_ons)
    out, into = cut_ons[:, None, None], cut_ons
    higher = np.broadcast_to(np.maximum(out, into), shape)
    return Onsets(higher.ravel(), np.broadcast_to(out != into, shape).ravel())


class Step(NamedTuple):
    """Steps of scattering coefficients at a cut-on: polynomials, as weights of the coefficients.

    Attributes
    ----------
    columns : ndarray of int
        Their numbers, (n_columns,).
    fitted : slice
        Given frequencies that the polynomial is fitted to.
    given, wanted : ndarray
        Weights of the coefficients there: at the given frequencies, (n_given, n_fitted), and at
        those wanted, (n_wanted, n_fitted).
    """

    columns: NDArray[np.int_]
    fitted: slice
    given: Array
    wanted: Complex


def steps(given: Array, wanted: NDArray[Any], begun: Onsets) -> list[Step]:
    """Return the steps of coefficients at the cut-ons within a band.

    Parameters
    ----------
    given, wanted : ndarray
        Frequencies in Hz: rising and real, (n_given,), and those to interpolate at, real or
        complex, (n_wanted,).
    begun : Onsets
    """
    found = []
    for cut_on in np.unique(begun.cut_on):
        first = int(np.searchsorted(given, cut_on, side="right"))
        fitted = slice(first, int(np.searchsorted(given, cut_on + SPAN)))
        if first == 0 or fitted.stop - first < FEWEST:
            continue
        for converts in (False, True):
            columns = np.flatnonzero((begun.cut_on == cut_on) & (begun.converts == converts))
            if len(columns):
                power = 0.5 if converts else 0.0
                here, there = (_polynomials(f, float(cut_on), power) for f in (given, wanted))
                fit = np.linalg.pinv(here[fitted])
                found.append(Step(columns, fitted, here @ fit, there @ fit))
    return found


def _polynomials(frequency: NDArray[Any], cut_on: float, power: float) -> NDArray[Any]:
    """Return powers of u from `power` on, windowed, (n, DEGREE + 1); 0 below the cut-on."""
    above = frequency.real > cut_on
    u = np.sqrt(np.where(above, (frequency / cut_on) ** 2 - 1, 0.0))
    window = np.where(above, np.exp(-(((frequency - cut_on) / SPAN) ** 2)), 0.0)
    return np.asarray(window[:, None] * u[:, None] ** (power + np.arange(DEGREE + 1)))


def without(found: list[Step], coefficients: Complex) -> Complex:
    """Return coefficients (n_given, n) without their steps."""
    rest = coefficients.copy()
    for step in found:
        rest[:, step.columns] -= step.given @ coefficients[step.fitted, step.columns]
    return rest


def restored(found: list[Step], interpolated: Complex, coefficients: Complex) -> Complex:
    """Return interpolated coefficients (n_wanted, n) with the steps of those given."""
    whole = interpolated.copy()
    for step in found:
        whole[:, step.columns] += step.wanted @ coefficients[step.fitted, step.columns]
    return whole


def interpolate_scattering(scattering: ModalScattering, frequency: NDArray[Any]) -> Complex:
    """Return a scattering matrix at other frequencies, real or complex.

    Parameters
    ----------
    scattering : ModalScattering
        At evenly spaced frequencies.
    frequency : ndarray
        In Hz, (n,), their real parts within its band.

    Returns
    -------
    ndarray
        (n, port_out, mode_out, port_in, mode_in); zero where a mode does not propagate.

    Raises
    ------
    ValueError
        If the frequencies leave the band, or the given ones are not evenly spaced, or too far apart
        for a cut-on among them.
    """
    given, cut_ons = (np.asarray(one, float) for one in (scattering.frequency, scattering.cut_ons))
    checks.check_interpolation(given, cut_ons, frequency)
    wanted, shape = np.asarray(frequency), scattering.s.shape
    here, there = (_passing(scattering, f) for f in (given, wanted))
    flat = (scattering.s / here).reshape(len(given), -1)
    found = interpolated(given, flat, wanted, onsets(cut_ons))
    return found.reshape(len(wanted), *shape[1:]) * there


def _passing(scattering: ModalScattering, frequency: NDArray[Any]) -> Complex:
    """Return factors of the coefficients (n, 2, 1, 2, 1): the plane wave through a bend, or 1."""
    found = np.ones((len(frequency), 2, 1, 2, 1), complex)
    if scattering.inside is not None:
        phase = scattering.inside.length @ plane_wavenumbers(scattering, frequency)
        found[:, 0, 0, 1, 0] = found[:, 1, 0, 0, 0] = np.exp(-1j * phase)
    return found


def plane_wavenumbers(bend: ModalScattering, frequency: NDArray[Any]) -> Complex:
    """Return the plane wave's wavenumbers in the parts of a bend, in 1/m, (n_parts, n).

    Parameters
    ----------
    bend : ModalScattering
    frequency : ndarray
        In Hz, real or complex, (n,): to first order in the imaginary part.
    """
    assert bend.inside is not None
    table = CubicSpline(bend.frequency, bend.inside.wavenumber, axis=1)
    real, imaginary = np.real(frequency), np.imag(frequency)
    return np.asarray(table(real) + 1j * imaginary * table(real, 1))


def interpolated(
    given: Array, coefficients: Complex, wanted: NDArray[Any], begun: Onsets
) -> Complex:
    """Return coefficients at other frequencies.

    Parameters
    ----------
    given : ndarray
        Frequencies in Hz, rising and even, (n_given,).
    coefficients : ndarray
        (n_given, n).
    wanted : ndarray
        Frequencies in Hz within these, real or complex, (n_wanted,).
    begun : Onsets

    Returns
    -------
    ndarray
        (n_wanted, n).

    Notes
    -----
    The spectrum at a frequency with a negative imaginary part is that of the impulse response times
    a decaying exponential. At even frequencies it is computed by the chirp z-transform [1]_.

    References
    ----------
    .. [1] Rabiner, L. R., Schafer, R. W. and Rader, C. M. (1969). The chirp z-transform algorithm.
       IEEE Transactions on Audio and Electroacoustics 17, 86-92. doi:10.1109/TAU.1969.1162034
    """
    n, step = len(given), given[1] - given[0]
    # The response begins before zero, since the press begins before its reference plane.
    early = n // 10
    time = (np.arange(n) - early) / (n * step)
    found = steps(given, wanted, begun)
    smooth = without(found, coefficients)
    # Without the line between the ends of the band, which would sound at all times: its samples
    # there are those of a periodic function then.
    rise = (smooth[-1] - smooth[0]) / (given[-1] - given[0])
    rest = smooth - smooth[0] - np.outer(given - given[0], rise)
    inverse = np.roll(np.fft.ifft(rest, axis=0), early, axis=0)
    response = np.exp(2j * pi * given[0] * time)[:, None] * inverse
    line = smooth[0] + np.outer(wanted - given[0], rise)
    return restored(found, _spectrum(response, time, wanted) + line, coefficients)


def _spectrum(response: Complex, time: Array, frequency: NDArray[Any]) -> Complex:
    """Return the spectra of columns over an even time, at any frequencies, real or complex.

    By the chirp z-transform for evenly spaced frequencies: ten times as fast as sums.
    """
    n = len(frequency)
    spacing = np.diff(frequency)
    if n < 2 or np.ptp(spacing.real) > 1e-9 * spacing[0].real or np.any(spacing.imag != 0):
        return np.asarray(np.exp(-2j * pi * np.outer(frequency, time)) @ response, complex)
    rate = time[1] - time[0]
    ratio, first = np.exp(-2j * pi * spacing[0].real * rate), np.exp(2j * pi * frequency[0] * rate)
    sums = _chirp_z(response, n, ratio, first)
    return np.asarray(sums * np.exp(-2j * pi * frequency * time[0])[:, None], complex)


def _chirp_z(columns: Complex, n: int, ratio: complex, first: complex) -> Complex:
    """Return the z-transforms of columns at ``first ratio^-k`` for k from 0 to n - 1.

    SciPy's, without the memory and the time that importing its signals with the statistics takes.
    """
    n_in = len(columns)
    chirp = ratio ** (np.arange(max(n, n_in)) ** 2 / 2)
    size = next_fast_len(n_in + n - 1)
    weighted = columns * (first ** -np.arange(n_in) * chirp[:n_in])[:, None]
    kernel = np.fft.fft(1 / np.concatenate([chirp[n_in - 1 : 0 : -1], chirp[:n]]), size)
    convolved = np.fft.ifft(kernel[:, None] * np.fft.fft(weighted, size, axis=0), axis=0)
    return np.asarray(convolved[n_in - 1 : n_in + n - 1] * chirp[:n, None])
