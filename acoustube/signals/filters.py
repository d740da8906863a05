"""The steps from a recorded cycle to its envelope, each a function on arrays (..., time).

All filters run forwards and backwards or are centred, and delay nothing. The steps of the paper's
section II-B, in their order: :func:`remove_offset`, :func:`compensate`, :func:`matched_filter`,
:func:`rectify`, :func:`normalise`, :func:`low_pass`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import signal

from acoustube.base.types import Array

FILTER_ORDER = 2
"""Order of the Butterworth low-pass, run forwards and backwards.

The second order rings least: its response to a short click dips 4.3 % below zero and comes back to
0.2 %, where the fourth order comes back to 3.7 %, an echo that is not there.
"""
OFFSET_CUTOFF = 100.0
"""Frequency in Hz below which a cycle's wandering offset lies."""
TEMPLATE_CYCLES = 10
"""Carrier cycles under the matched filter's Hann window."""


class TimeGain(NamedTuple):
    """How echoes fade with distance: c1 tanh(c2 (l - c3)) + c4, as a share of the send pulse.

    Attributes
    ----------
    c1, c2, c3, c4 : float
        Half the fall, its steepness in 1/m, its middle in m, and the mean level.
    """

    c1: float
    c2: float
    c3: float
    c4: float

    def level(self, distance: ArrayLike) -> Array:
        """Return what is left of an echo from distances in m."""
        return np.asarray(self.c1 * np.tanh(self.c2 * (np.asarray(distance) - self.c3)) + self.c4)


def remove_offset(samples: ArrayLike, sampling_rate: float, cutoff: float = OFFSET_CUTOFF) -> Array:
    """Subtract what is slower than a cut-off: an offset and its drift.

    Parameters
    ----------
    samples : array of shape (..., time)
        The cycles, in any unit, whole numbers or not.
    sampling_rate : float
        Samples per second.
    cutoff : float
        In Hz; see :func:`low_pass`.

    Returns
    -------
    array of shape (..., time)

    Notes
    -----
    A cycle lasts for a few periods of the cut-off only: it is continued by its mirror image, up to
    its whole length, and a constant is taken away exactly.
    """
    cycles = np.asarray(samples, dtype=float)
    centred = np.asarray(cycles - np.mean(cycles, axis=-1, keepdims=True))
    return np.asarray(centred - _two_ways(centred, sampling_rate, cutoff))


def compensate(samples: ArrayLike, distance: ArrayLike, gain: TimeGain) -> Array:
    """Raise later samples by what echoes lose on their way: time-gain compensation.

    Parameters
    ----------
    samples : array of shape (..., time)
        The cycles, their offset removed.
    distance : array of shape (time,) or (..., time)
        From where an echo would arrive at each sample, in m.
    gain : TimeGain
        How echoes fade.

    Returns
    -------
    array of shape (..., time)

    Raises
    ------
    ValueError
        If the gain would divide by what is not positive somewhere.
    """
    level = gain.level(distance)
    if not np.all(level > 0):
        raise ValueError(
            f"the gain's level falls to {float(np.min(level)):.3g} within the cycle and must stay "
            "positive; calibrate over more distance"
        )
    return np.asarray(np.asarray(samples, dtype=float) / level)


def template(sampling_rate: float, frequency: float, cycles: float = TEMPLATE_CYCLES) -> Array:
    """Return the matched filter's template: a sine under a Hann window, of unit energy.

    Parameters
    ----------
    sampling_rate : float
        Samples per second.
    frequency : float
        Carrier in Hz.
    cycles : float
        Length in carrier cycles.

    Returns
    -------
    array of shape (n,)
        An odd number of samples, its middle that of the window.

    Raises
    ------
    ValueError
        If the carrier is not below half the sampling rate.
    """
    if not 0 < frequency < sampling_rate / 2:
        raise ValueError(
            f"frequency = {frequency:g} Hz must lie between 0 and half the sampling rate "
            f"({sampling_rate / 2:g} Hz); sample faster, or go without the matched filter"
        )
    half = int(np.floor(cycles / frequency * sampling_rate / 2))
    time = np.arange(-half, half + 1) / sampling_rate
    window = 0.5 + 0.5 * np.cos(2 * np.pi * time * frequency / cycles)
    wave = window * np.sin(2 * np.pi * frequency * time)
    return np.asarray(wave / np.linalg.norm(wave))


def matched_filter(samples: ArrayLike, template: ArrayLike) -> Array:
    """Correlate cycles with a template, without delay.

    Parameters
    ----------
    samples : array of shape (..., time)
    template : array of shape (n,)
        An odd number of samples, fewer than a cycle's.

    Returns
    -------
    array of shape (..., time)
        A pulse like the template has its highest value in its own middle. White noise keeps its
        standard deviation where the template has unit energy.

    Raises
    ------
    ValueError
        If the template is longer than a cycle.
    """
    samples, template = np.asarray(samples, dtype=float), np.asarray(template, dtype=float)
    if template.size > samples.shape[-1]:
        raise ValueError(
            f"the record of {samples.shape[-1]} samples is shorter than the matched filter's "
            f"template of {template.size}; record more"
        )
    kernel = template[::-1].reshape((1,) * (samples.ndim - 1) + (-1,))
    return np.asarray(signal.oaconvolve(samples, kernel, mode="same", axes=-1))


def rectify(pressure: ArrayLike) -> Array:
    """Return the absolute value of a signal."""
    return np.abs(np.asarray(pressure, dtype=float))


def low_pass(samples: ArrayLike, sampling_rate: float, cutoff: float = 10e3) -> Array:
    """Remove what is faster than a cut-off, without delay.

    Parameters
    ----------
    samples : array of shape (..., time)
        The signals.
    sampling_rate : float
        Samples per second.
    cutoff : float
        Frequency in Hz at which the amplitude falls to a half.

    Returns
    -------
    array of shape (..., time)
        The filtered signals.

    Raises
    ------
    ValueError
        If the cut-off is not below half the sampling rate, or a signal is shorter than three
        periods of the cut-off: it would consist of the filter's transients.

    Notes
    -----
    A Butterworth filter of order :data:`FILTER_ORDER`, as second-order sections, run forwards and
    backwards: no phase, and the gain ``1 / (1 + (f/cutoff)**4)`` as long as the cut-off is far
    below half the sampling rate. The record is continued at both ends by its mirror image over
    three periods of the cut-off, so that the envelope of a steady tone stays within 5 % up to its
    ends.
    """
    samples = np.asarray(samples, dtype=float)
    if not 0 < cutoff < sampling_rate / 2:
        raise ValueError(
            f"cutoff = {cutoff:g} Hz must lie between 0 and half the sampling rate "
            f"({sampling_rate / 2:g} Hz)"
        )
    pad = _mirrored(sampling_rate, cutoff)
    if samples.shape[-1] <= pad:
        raise ValueError(
            f"the record of {samples.shape[-1]} samples is too short for a low-pass at "
            f"{cutoff:g} Hz; record more than {pad} samples"
        )
    return _two_ways(samples, sampling_rate, cutoff)


def _mirrored(sampling_rate: float, cutoff: float) -> int:
    """Return by how many samples a record is continued at both ends."""
    return int(np.ceil(3 * sampling_rate / cutoff))


def _two_ways(samples: Array, sampling_rate: float, cutoff: float) -> Array:
    """Run the low-pass forwards and backwards over records continued by their mirror image."""
    pad = min(_mirrored(sampling_rate, cutoff), samples.shape[-1] - 1)
    sections = signal.butter(FILTER_ORDER, cutoff, fs=sampling_rate, output="sos")
    return np.asarray(signal.sosfiltfilt(sections, samples, padtype="even", padlen=pad))


def envelope(pressure: ArrayLike, sampling_rate: float, cutoff: float = 10e3) -> Array:
    """Return the envelope of a signal: rectified, low-passed, scaled.

    Parameters
    ----------
    pressure : array of shape (..., time)
        The signals.
    sampling_rate : float
        Samples per second.
    cutoff : float
        Cut-off of the low-pass in Hz.

    Returns
    -------
    array of shape (..., time)
        The envelopes, in the unit of the signal.

    Notes
    -----
    The mean of a rectified sine is ``2/pi`` of its amplitude. The result is scaled by ``pi/2``, so
    that a steady sine of amplitude 1 has the envelope 1. A burst that is short against the
    cut-off's period reads lower, the send pulse and its echoes alike. At 200 kHz the overtones of
    the rectified carrier alias below the cut-off and leave a ripple of 1 %.
    """
    return np.pi / 2 * low_pass(rectify(pressure), sampling_rate, cutoff)


def normalise(samples: ArrayLike, amplitude: ArrayLike) -> Array:
    """Divide each signal by an amplitude of its own.

    Parameters
    ----------
    samples : array of shape (..., time)
        The signals.
    amplitude : array of shape (...)
        The amplitude that becomes 1; :func:`send_pulse` returns the envelope's. A silent cycle,
        whose amplitude is zero, becomes nan.

    Returns
    -------
    array of shape (..., time)
        The normalised signals.
    """
    amplitude = np.asarray(amplitude, dtype=float)[..., np.newaxis]
    return np.asarray(samples, dtype=float) / np.where(amplitude > 0, amplitude, np.nan)
