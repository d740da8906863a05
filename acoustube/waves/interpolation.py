"""Interpolation of scattering matrices over frequency.

The coefficients are transformed to a band-limited impulse response at evenly spaced times, whose
spectrum can be computed at any frequency, real or complex. The transmission of a bend is
interpolated relative to that of the plane wave in it, because long delays cause errors at the ends
of the band.

Steps of the coefficients at the modes' cut-ons are subtracted before and added afterwards
(:mod:`acoustube.waves.cut_on_steps`).
"""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import next_fast_len
from scipy.interpolate import CubicSpline

from acoustube.base.types import Array
from acoustube.waves import network_checks as checks
from acoustube.waves.cut_on_steps import (
    Axial,
    Losses,
    Onsets,
    fitting,
    lossless,
    lossy,
    onsets,
    restored,
    steps,
    without,
)
from acoustube.waves.port_waves import Complex
from acoustube.waves.scattering import ModalScattering


def interpolate_scattering(
    scattering: ModalScattering, frequency: NDArray[Any], losses: Losses | None = None
) -> Complex:
    """Interpolate a scattering matrix over frequency, at real or complex frequencies.

    Parameters
    ----------
    scattering : ModalScattering
        Scattering at evenly spaced frequencies.
    frequency : ndarray
        In Hz, (n,), with real parts within the band of `scattering`.
    losses : callable, optional
        Effect of the losses on the modes of the straight tube, see
        :data:`acoustube.waves.cut_on_steps.Losses`; by default they are neglected in the
        interpolation next to cut-ons.

    Returns
    -------
    ndarray
        (n, port_out, mode_out, port_in, mode_in). Below the cut-on of a mode, that of the
        evanescent mode: for a bend throughout, otherwise over a few hundred Hz, and farther below
        zero, except for the error of interpolation.

    Raises
    ------
    ValueError
        If a frequency lies outside the band, or the frequencies of `scattering` are not evenly
        spaced, or are more than `network_checks.COARSEST_STEP` apart with a cut-on in the band.
    """
    given, cut_ons = (np.asarray(one, float) for one in (scattering.frequency, scattering.cut_ons))
    checks.check_interpolation(given, cut_ons, frequency)
    wanted, shape = np.asarray(frequency), scattering.s.shape
    here, there = (_passing(scattering, f) for f in (given, wanted))
    below = scattering.evanescent
    whole = scattering.s if below is None else scattering.s + below
    flat = (whole / here).reshape(len(given), -1)
    axial: Axial = lossless
    if losses is not None:
        axial = lossy(scattering.modes, cut_ons, scattering.sound_speed, losses)
    found = interpolated(given, flat, wanted, onsets(cut_ons), axial, evanescent=below is not None)
    return found.reshape(len(wanted), *shape[1:]) * there


def _passing(scattering: ModalScattering, frequency: NDArray[Any]) -> Complex:
    """Return the factors that are divided out before interpolation, (n, 2, 1, 2, 1).

    They are the phase factor of the plane wave for transmission through a bend, and 1 otherwise.
    """
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
        Scattering whose attribute `inside` holds the plane wave in the bend.
    frequency : ndarray
        In Hz, real or complex, (n,). The wavenumbers are exact to first order in the frequency's
        imaginary part.
    """
    assert bend.inside is not None
    table = CubicSpline(bend.frequency, bend.inside.wavenumber, axis=1)
    real, imaginary = np.real(frequency), np.imag(frequency)
    return np.asarray(table(real) + 1j * imaginary * table(real, 1))


def interpolated(
    given: Array,
    coefficients: Complex,
    wanted: NDArray[Any],
    begun: Onsets,
    axial: Axial = lossless,
    *,
    evanescent: bool = False,
) -> Complex:
    """Interpolate n scattering coefficients over frequency.

    Parameters
    ----------
    given : ndarray
        Rising, evenly spaced frequencies in Hz, (n_given,).
    coefficients : ndarray
        Coefficients at the given frequencies, (n_given, n).
    wanted : ndarray
        Frequencies in Hz, real or complex, with real parts within the given range, (n_wanted,).
    begun : Onsets
        Cut-ons of the coefficients.
    axial, evanescent
        See :func:`acoustube.waves.cut_on_steps.steps`.

    Returns
    -------
    ndarray
        (n_wanted, n).

    Notes
    -----
    The spectrum at a frequency with a negative imaginary part is that of the impulse response times
    a decaying exponential. At evenly spaced frequencies it is computed by the chirp z-transform
    [1]_.

    References
    ----------
    .. [1] Rabiner, L. R., Schafer, R. W. and Rader, C. M. (1969). The chirp z-transform algorithm.
       IEEE Transactions on Audio and Electroacoustics 17, 86-92. doi:10.1109/TAU.1969.1162034
    """
    n, step = len(given), given[1] - given[0]
    # The response begins before zero, since the press begins before its reference plane.
    early = n // 10
    time = (np.arange(n) - early) / (n * step)
    found = fitting(steps(given, wanted, begun, axial, evanescent=evanescent), coefficients)
    smooth = without(found, coefficients)
    # The line through the values at the ends of the band is subtracted: the rest is periodic over
    # the band, and its impulse response is short.
    rise = (smooth[-1] - smooth[0]) / (given[-1] - given[0])
    rest = smooth - smooth[0] - np.outer(given - given[0], rise)
    inverse = np.roll(np.fft.ifft(rest, axis=0), early, axis=0)
    response = np.exp(2j * pi * given[0] * time)[:, None] * inverse
    line = smooth[0] + np.outer(wanted - given[0], rise)
    return restored(found, _spectrum(response, time, wanted) + line, coefficients)


def _spectrum(response: Complex, time: Array, frequency: NDArray[Any]) -> Complex:
    """Return spectra of columns sampled at evenly spaced times, at real or complex frequencies.

    Evenly spaced frequencies use the chirp z-transform, which is ten times as fast as sums.
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

    The same as ``scipy.signal.czt``, whose import takes time and memory.
    """
    n_in = len(columns)
    chirp = ratio ** (np.arange(max(n, n_in)) ** 2 / 2)
    size = next_fast_len(n_in + n - 1)
    weighted = columns * (first ** -np.arange(n_in) * chirp[:n_in])[:, None]
    kernel = np.fft.fft(1 / np.concatenate([chirp[n_in - 1 : 0 : -1], chirp[:n]]), size)
    convolved = np.fft.ifft(kernel[:, None] * np.fft.fft(weighted, size, axis=0), axis=0)
    return np.asarray(convolved[n_in - 1 : n_in + n - 1] * chirp[:n, None])
