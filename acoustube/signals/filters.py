"""Filters from a recorded cycle to its envelope, each a function on arrays (..., time).

All filters are zero-phase: run forwards and backwards, or centred. In the order of the sleeve
paper's section II-B: :func:`remove_offset`, :func:`compensate`, :func:`matched_filter`,
:func:`rectify`, :func:`normalise`, :func:`low_pass`. (The sleeve paper: "Wearable, Fabric-Embedded
Acoustic Waveguides for Meter-Scale Contact Localization and Force Sensing".)

References
----------
* Matched filter: Turin, G. L., An introduction to matched filters, IRE Transactions on Information
  Theory 6 (1960), 311-329. doi:10.1109/TIT.1960.1057571
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import signal

from acoustube.base.checks import CYCLES, FREQUENCY, RATE, SAMPLES, Complex, Reals, checked
from acoustube.base.errors import ConfigError
from acoustube.base.types import Array

FILTER_ORDER = 2
"""Order of the Butterworth low-pass, run forwards and backwards.

The second order rings least: its impulse response undershoots to -4.3 % and then overshoots to
0.2 %; that of the fourth order overshoots to 3.7 %, which would count as an echo.
"""
OFFSET_CUTOFF = 100.0
"""Cut-off frequency in Hz of the high-pass that removes a cycle's offset and its drift."""
LOWEST_CUTOFF = 1e-6
"""Lowest cut-off frequency of a filter, relative to the sampling rate.

There the gain of the low-pass at frequency zero is right to 3e-6; below, its coefficients are lost
in rounding.
"""
LONGEST_TEMPLATE = 1e6
"""Largest number of samples of a template, far more than in a cycle of any recorder."""
LEAST_NORM = 1e-9
"""Smallest norm of a template before it is scaled; a smaller one is that of rounding errors."""
TEMPLATE_CYCLES = 10
"""Length of the matched filter's Hann window in carrier cycles."""


class TimeGain(NamedTuple):
    """Attenuation model of the time gain: c1 tanh(c2 (l - c3)) + c4, relative to the send pulse.

    It gives the amplitude of an echo from the distance l.

    Attributes
    ----------
    c1 : float
        Half the change of the amplitude over all distances; negative, since the amplitude falls.
    c2 : float
        Steepness of the fall in 1/m.
    c3 : float
        Distance l in m of the middle of the fall.
    c4 : float
        Amplitude at the middle of the fall.

    Notes
    -----
    The parameters are those of the arctangent of the sleeve paper's eq. 4, which is fitted to
    closures; see :func:`acoustube.signals.calibrate`. Both functions fall alike around c3, but the
    tanh levels off sooner, so that its gain is smaller at large distance. There, dividing by the
    arctangent raised the mean baseline until it hid the peaks (section II-E).
    """

    c1: float
    c2: float
    c3: float
    c4: float

    def level(self, distance: ArrayLike) -> Array:
        """Return the amplitude of an echo from distances in m, relative to the send pulse."""
        return np.asarray(self.c1 * np.tanh(self.c2 * (np.asarray(distance) - self.c3)) + self.c4)


@checked(samples=SAMPLES, sampling_rate=RATE, cutoff=FREQUENCY)
def remove_offset(samples: ArrayLike, sampling_rate: float, cutoff: float = OFFSET_CUTOFF) -> Array:
    """Subtract the offset and its drift: a zero-phase high-pass.

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

    Raises
    ------
    ValueError
        If the cut-off is not below half the sampling rate, or is below :data:`LOWEST_CUTOFF`
        times that rate.

    Notes
    -----
    A cycle lasts for only a few periods of the cut-off frequency. It is therefore continued at both
    ends by its mirror image, by up to its own length. A constant is removed exactly.
    """
    check_cutoff("cutoff", cutoff, sampling_rate)
    cycles = np.asarray(samples, dtype=float)
    centred = np.asarray(cycles - np.mean(cycles, axis=-1, keepdims=True))
    return np.asarray(centred - _zero_phase_low_pass(centred, sampling_rate, cutoff))


@checked(samples=SAMPLES, distance=Reals(-1e9, 1e9, "m", axes=1), gain=TimeGain)
def compensate(samples: ArrayLike, distance: ArrayLike, gain: TimeGain) -> Array:
    """Apply time-gain compensation: divide by the attenuation at each sample's distance.

    Parameters
    ----------
    samples : array of shape (..., time)
        The cycles, their offset removed.
    distance : array of shape (time,) or (..., time)
        Distance in m from which an echo arrives at each sample.
    gain : TimeGain
        Attenuation model.

    Returns
    -------
    array of shape (..., time)

    Raises
    ------
    ValueError
        If the attenuation model is not positive within the cycle, or there is not one distance for
        each sample.
    """
    level = gain.level(distance)
    if np.shape(samples)[-1:] != level.shape[-1:]:
        raise ValueError(
            f"samples has shape {np.shape(samples)} and distance {np.shape(level)}; give a "
            "distance for each sample"
        )
    if not np.all((level > 0) & (level < np.inf)):
        raise ValueError(
            f"the gain's attenuation model falls to {float(np.min(level)):.3g} within the cycle "
            "and must stay positive; calibrate over a longer range of distances, and check the "
            "temperature"
        )
    return np.asarray(np.asarray(samples, dtype=float) / level)


@checked(sampling_rate=RATE, frequency=FREQUENCY, cycles=CYCLES)
def template(sampling_rate: float, frequency: float, cycles: float = TEMPLATE_CYCLES) -> Array:
    """Return the matched filter's template: a Hann-windowed sine of unit energy.

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
        An odd number of samples, the middle one at the middle of the window.

    Raises
    ------
    ValueError
        If the carrier is not below the Nyquist frequency, or the template too long or too short.
    """
    if not 0 < frequency < sampling_rate / 2:
        raise ValueError(
            f"frequency = {frequency:g} Hz must lie between 0 and half the sampling rate "
            f"({sampling_rate / 2:g} Hz); raise the sampling rate, or omit the matched filter"
        )
    if cycles / frequency * sampling_rate > LONGEST_TEMPLATE:
        raise ValueError(
            f"a template of {cycles:g} cycles of frequency = {frequency:g} Hz has more than "
            f"{LONGEST_TEMPLATE:g} samples at sampling_rate = {sampling_rate:g} Hz; give fewer "
            "cycles"
        )
    half = int(np.floor(cycles / frequency * sampling_rate / 2))
    time = np.arange(-half, half + 1) / sampling_rate
    window = 0.5 + 0.5 * np.cos(2 * np.pi * time * frequency / cycles)
    wave = window * np.sin(2 * np.pi * frequency * time)
    norm = np.linalg.norm(wave)
    if norm < LEAST_NORM:
        raise ValueError(
            f"a template of {cycles:g} cycles of frequency = {frequency:g} Hz is zero at all its "
            f"samples, {time.size} at sampling_rate = {sampling_rate:g} Hz; give more cycles"
        )
    return np.asarray(wave / norm)


@checked(samples=SAMPLES, template=Complex(0, 1e100, axes=1))
def matched_filter(samples: ArrayLike, template: ArrayLike) -> Any:
    """Correlate cycles with a template, without delay.

    Parameters
    ----------
    samples : array of shape (..., time)
    template : array of shape (n,)
        An odd number of samples, fewer than a cycle's, real or complex.

    Returns
    -------
    array of shape (..., time)
        Complex where the template is, with the envelope as its magnitude. The correlation with a
        pulse like the template is highest at that pulse's middle. White noise keeps its standard
        deviation where the template has unit energy.

    Raises
    ------
    ValueError
        If the template is longer than a cycle, or has an even number of samples.
    """
    samples, template = np.asarray(samples, dtype=float), np.atleast_1d(np.asarray(template))
    if template.size % 2 == 0:
        raise ValueError(
            f"template has {template.size} samples and so none in its middle, which would shift "
            "times by half a sample; give an odd number"
        )
    if template.size > samples.shape[-1]:
        raise ValueError(
            f"the record of {samples.shape[-1]} samples is shorter than the matched filter's "
            f"template of {template.size}; record more"
        )
    if not samples.size:
        return np.zeros(samples.shape, np.result_type(samples, template))
    kernel = template[::-1].conj().reshape((1,) * (samples.ndim - 1) + (-1,))
    return np.asarray(signal.oaconvolve(samples, kernel, mode="same", axes=-1))


@checked(pressure=SAMPLES)
def rectify(pressure: ArrayLike) -> Array:
    """Return the absolute value of a signal."""
    return np.abs(np.asarray(pressure, dtype=float))


@checked(samples=SAMPLES, sampling_rate=RATE, cutoff=FREQUENCY)
def low_pass(samples: ArrayLike, sampling_rate: float, cutoff: float = 10e3) -> Array:
    """Apply a zero-phase Butterworth low-pass.

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
        If the cut-off is not below half the sampling rate, or is below :data:`LOWEST_CUTOFF`
        times that rate, or a signal is shorter than three periods of the cut-off: it would consist
        of the filter's transients.

    Notes
    -----
    A Butterworth filter of order :data:`FILTER_ORDER`, as second-order sections, run forwards and
    backwards: zero phase, and the gain ``1 / (1 + (f/cutoff)**4)`` as long as the cut-off is far
    below half the sampling rate. The record is continued at both ends by its mirror image over
    three periods of the cut-off, so that the envelope of a steady tone stays within 5 % up to its
    ends.
    """
    samples = np.asarray(samples, dtype=float)
    check_cutoff("cutoff", cutoff, sampling_rate)
    pad = _padding(sampling_rate, cutoff)
    if samples.shape[-1] <= pad:
        raise ValueError(
            f"the record of {samples.shape[-1]} samples is too short for a low-pass at "
            f"cutoff = {cutoff:g} Hz and sampling_rate = {sampling_rate:g} Hz; record more than "
            f"{pad}"
        )
    return _zero_phase_low_pass(samples, sampling_rate, cutoff)


def check_cutoff(name: str, cutoff: float, sampling_rate: float) -> None:
    """Raise ValueError unless a cut-off in Hz is possible at a sampling rate in Hz.

    It has to lie between :data:`LOWEST_CUTOFF` times that rate and half of it. The message calls
    the cut-off `name`.
    """
    least = LOWEST_CUTOFF * sampling_rate
    if not least <= cutoff < sampling_rate / 2:
        raise ValueError(
            f"{name} = {cutoff:g} Hz must lie between {least:g} Hz and half the sampling rate "
            f"({sampling_rate / 2:g} Hz) at a sampling rate of {sampling_rate:g} Hz"
        )


def _padding(sampling_rate: float, cutoff: float) -> int:
    """Return the number of samples of the mirror image at each end of a record."""
    return int(np.ceil(3 * sampling_rate / cutoff))


def _zero_phase_low_pass(samples: Array, sampling_rate: float, cutoff: float) -> Array:
    """Run the low-pass forwards and backwards over records with mirrored ends."""
    pad = min(_padding(sampling_rate, cutoff), samples.shape[-1] - 1)
    sections = signal.butter(FILTER_ORDER, cutoff, fs=sampling_rate, output="sos")
    return np.asarray(signal.sosfiltfilt(sections, samples, padtype="even", padlen=pad))


@checked(pressure=SAMPLES, sampling_rate=RATE, cutoff=FREQUENCY)
def envelope(pressure: ArrayLike, sampling_rate: float, cutoff: float = 10e3) -> Array:
    """Return the envelope of a signal: rectified, low-pass filtered and scaled by pi/2.

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

    Raises
    ------
    ValueError
        As :func:`low_pass`.

    Notes
    -----
    The mean of a rectified sine is ``2/pi`` of its amplitude. The result is scaled by ``pi/2``, so
    that a steady sine of amplitude 1 has the envelope 1. A burst that is shorter than the period of
    the cut-off has a lower envelope, the send pulse and its echoes alike. At a sampling rate of
    200 kHz, overtones of the rectified carrier are aliased to frequencies below the cut-off and
    leave a ripple of 1 %.
    """
    return np.pi / 2 * low_pass(rectify(pressure), sampling_rate, cutoff)


@checked(samples=SAMPLES, amplitude=Reals(missing=True, empty=True))
def normalise(samples: ArrayLike, amplitude: ArrayLike) -> Array:
    """Divide each signal by its amplitude.

    Parameters
    ----------
    samples : array of shape (..., time)
        The signals.
    amplitude : float or array of shape (...)
        The amplitude that becomes 1; :func:`send_pulse` returns that of an envelope. A signal
        becomes nan if its amplitude is not positive, as that of a silent cycle.

    Returns
    -------
    array of shape (..., time)
        The normalised signals.

    Raises
    ------
    ConfigError
        If there is not one amplitude for each signal, or one for all.
    """
    shapes = np.shape(samples)[:-1], np.shape(amplitude)
    if shapes[1] and shapes[0] != shapes[1]:
        raise ConfigError(
            f"amplitude has shape {shapes[1]} and the signals in samples {shapes[0]}; give one for "
            "each signal"
        )
    amplitude = np.asarray(amplitude, dtype=float)[..., np.newaxis]
    return np.asarray(samples, dtype=float) / np.where(amplitude > 0, amplitude, np.nan)
