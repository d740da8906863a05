"""From pressure to distance: the processing that simulations and recordings share.

The steps are the paper's for simulated signals (section II-D): rectify, normalise by the send
pulse, low-pass, peaks by prominence, time of flight -> distance. All functions take arrays of shape
(..., time) and treat each cycle on its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal

from acoustube.air import sound_speed

Array = NDArray[np.float64]

FILTER_ORDER = 2
"""Order of the Butterworth low-pass, run forwards and backwards.

The second order rings least: its response to a short click dips 4.3 % below zero and comes back to
0.2 %, where the fourth order comes back to 3.7 %, an echo that is not there.
"""


@dataclass(frozen=True)
class Echoes:
    """Peaks of an envelope, in order of time.

    Attributes
    ----------
    times : array of shape (..., echo)
        Times in s. Where a cycle has fewer echoes than another, the rest of its row is nan.
    amplitudes : array of shape (..., echo)
        Envelope at the peak.
    prominences : array of shape (..., echo)
        Height of the peak over the higher of the two valleys beside it.
    """

    times: Array
    amplitudes: Array
    prominences: Array


@dataclass(frozen=True)
class Ranging:
    """What the processing makes of a signal.

    Attributes
    ----------
    envelope : array of shape (..., time)
        Envelope as a share of the send pulse's.
    send_time, send_amplitude : array of shape (...)
        Maximum of the send pulse's envelope: time in s, and amplitude in the unit of the signal.
    echoes : Echoes
        All echoes found in the search window.
    return_time, amplitude : array of shape (...)
        The highest echo: time in s, and amplitude as a share of the send pulse. nan if there is
        no echo.
    distance : array of shape (...)
        Distance from the source end to what returned the highest echo, in m. nan if there is none.
    detected : array of bool of shape (...)
        Whether there is an echo.
    """

    envelope: Array
    send_time: Array
    send_amplitude: Array
    echoes: Echoes
    return_time: Array
    amplitude: Array
    distance: Array
    detected: NDArray[np.bool_]


def sampling_rate(time: ArrayLike) -> float:
    """Return the sampling rate of a time axis.

    Parameters
    ----------
    time : array of shape (time,)
        Sampling times in s.

    Returns
    -------
    float
        Samples per second.

    Raises
    ------
    ValueError
        If the times are not evenly spaced and rising.
    """
    time = np.asarray(time, dtype=float)
    if time.ndim != 1 or time.size < 2:
        raise ValueError(f"time has shape {time.shape}; give one axis of at least two samples")
    step = (time[-1] - time[0]) / (time.size - 1)
    # Loose enough for times that were stored in single precision.
    if not (step > 0 and np.allclose(np.diff(time), step, rtol=0.05, atol=0)):
        raise ValueError("time is not evenly spaced and rising; resample the signal first")
    return float(1 / step)


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
    pad = int(np.ceil(3 * sampling_rate / cutoff))
    if samples.shape[-1] <= pad:
        raise ValueError(
            f"the record of {samples.shape[-1]} samples is too short for a low-pass at "
            f"{cutoff:g} Hz; record more than {pad} samples"
        )
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


def send_pulse(time: ArrayLike, envelope: ArrayLike, before: float) -> tuple[Array, Array]:
    """Find the send pulse: the envelope's maximum before a given time.

    Parameters
    ----------
    time : array of shape (time,)
        Sampling times in s.
    envelope : array of shape (..., time)
        The envelopes.
    before : float
        Time in s by which the send pulse has passed, and no echo has come back yet.

    Returns
    -------
    time, amplitude : array of shape (...)
        The maximum, refined between the samples.

    Raises
    ------
    ValueError
        If the record has fewer than three samples before that time.
    """
    time, envelope = np.asarray(time, dtype=float), np.asarray(envelope, dtype=float)
    n_before = int(np.searchsorted(time, before))
    if n_before < 3:
        raise ValueError(
            f"before = {before:g} s leaves no send pulse in a record that starts at {time[0]:g} s"
        )
    index = np.argmax(envelope[..., :n_before], axis=-1)
    return _refine(time, envelope, index)


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


def find_echoes(
    time: ArrayLike,
    envelope: ArrayLike,
    *,
    start: ArrayLike = -np.inf,
    stop: ArrayLike = np.inf,
    prominence: float = 0.01,
) -> Echoes:
    """Find the peaks of envelopes within a search window.

    Parameters
    ----------
    time : array of shape (time,)
        Sampling times in s.
    envelope : array of shape (..., time)
        The envelopes.
    start, stop : float or array of shape (...)
        The window in s. The prominence is reckoned within it, so that the flank of a send pulse
        that reaches into the window counts as ground, not as a peak.
    prominence : float
        The least prominence of an echo.

    Returns
    -------
    Echoes
        The peaks, times and amplitudes refined between the samples by a parabola.
    """
    time, envelope = np.asarray(time, dtype=float), np.asarray(envelope, dtype=float)
    cycles = envelope.reshape(-1, time.size)
    shape = envelope.shape[:-1]
    first = np.searchsorted(time, np.broadcast_to(start, shape), side="left").ravel()
    last = np.searchsorted(time, np.broadcast_to(stop, shape), side="right").ravel()
    found = [
        _peaks(time, cycle, slice(a, b), prominence)
        for cycle, a, b in zip(cycles, first, last, strict=True)
    ]
    most = max((rows.shape[1] for rows in found), default=0)
    padded = np.full((3, len(found), most), np.nan)
    for row, rows in enumerate(found):
        padded[:, row, : rows.shape[1]] = rows
    return Echoes(*padded.reshape(3, *shape, most))


def _peaks(time: Array, cycle: Array, window: slice, prominence: float) -> Array:
    """Return times, amplitudes and prominences of one cycle's peaks, shape (3, echo)."""
    inside = cycle[window]
    if inside.size < 3:
        return np.empty((3, 0))
    index, properties = signal.find_peaks(inside, prominence=prominence)
    times, amplitudes = _refine(time, cycle, index + window.start)
    return np.stack([times, amplitudes, properties["prominences"]])


def _refine(time: Array, samples: Array, index: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return the vertex of the parabola through a maximum and its neighbours.

    One maximum per cycle for ``samples`` of shape (..., time), or several of a single cycle.
    """
    middle = np.clip(index, 1, time.size - 2)
    left, centre, right = (_take(samples, middle + shift) for shift in (-1, 0, 1))
    slope, bend = (right - left) / 2, left - 2 * centre + right
    # A maximum at the record's edge, or on a plateau, has no vertex near by: keep the sample.
    vertex = (middle == index) & (bend < 0) & (centre >= left) & (centre >= right)
    offset = np.divide(-slope, bend, out=np.zeros_like(slope), where=vertex)
    height = np.where(vertex, centre + slope * offset / 2, _take(samples, index))
    return time[index] + offset * (time[1] - time[0]), height


def _take(samples: Array, index: NDArray[np.intp]) -> Array:
    """Return one sample of each cycle, or several of a single cycle."""
    if samples.ndim == 1:
        return np.asarray(samples[index])
    return np.take_along_axis(samples, index[..., np.newaxis], axis=-1)[..., 0]


def distance(time_of_flight: ArrayLike, temperature: float) -> Array:
    """Return how far away an echo came from.

    Parameters
    ----------
    time_of_flight : array
        Time from the send pulse to its return, in s.
    temperature : float
        Temperature of the air in degC.

    Returns
    -------
    array
        One-way distance in m: half of what sound travels in that time.
    """
    return np.asarray(sound_speed(temperature) * np.asarray(time_of_flight, dtype=float) / 2)


def blind_time(pulse_duration: float, cutoff: float) -> float:
    """Return how long after its maximum the send pulse's envelope has faded, in s.

    Half the pulse's duration in s, and one period of the low-pass's cut-off in Hz for its spread.
    """
    return pulse_duration / 2 + 1 / cutoff


def process(
    time: ArrayLike,
    pressure: ArrayLike,
    *,
    pulse_duration: float,
    probe_position: float = 0.0,
    temperature: float = 20.0,
    cutoff: float = 10e3,
    prominence: float = 0.01,
    nearest: float = 0.0,
    farthest: float = np.inf,
) -> Ranging:
    """Find the distance of a press in the signal of a probe.

    Parameters
    ----------
    time : array of shape (time,)
        Sampling times in s; the pulse starts to leave the source end at 0.
    pressure : array of shape (..., time)
        Pressure at the probe, in any unit.
    pulse_duration : float
        How long the source emits, in s: the number of cycles over the carrier frequency.
    probe_position : float
        Distance of the probe from the source end in m.
    temperature : float
        Temperature of the air in degC.
    cutoff : float
        Cut-off of the envelope's low-pass in Hz.
    prominence : float
        Least prominence of an echo, as a share of the send pulse.
    nearest, farthest : float
        Distances from the source end, in m, between which an echo is looked for. The search never
        starts before the send pulse has died away at the probe.

    Returns
    -------
    Ranging
        Envelope, send pulse, echoes, and the distance of the highest. A cycle that is silent or
        has no echo is not an error: it is not `detected`, and its distance is nan.

    Raises
    ------
    ValueError
        If the signal is too short, holds values that are not finite, or does not fit the time.

    Notes
    -----
    The paper normalises before the low-pass, which gives the same envelope, as both are linear.
    The amplitude of the send pulse means the maximum of its *envelope*, so that the normalised
    send pulse is exactly 1 high, an echo from a rigid end is 1 too, and the prominence is a share
    of it.

    A sampled signal has no exact absolute value: the overtones of the rectified carrier alias
    below the cut-off and shift a 42 kHz echo by up to 0.3 samples (0.2 mm) at 200 kHz, 0.1 samples
    (0.01 mm) at 2 MHz. The parabola adds nothing to that.

    No echo is looked for within :func:`blind_time` of the send pulse's maximum.
    """
    time, pressure = _checked(time, pressure)
    speed = float(sound_speed(temperature))
    raw = envelope(pressure, sampling_rate(time), cutoff)
    send_end = probe_position / speed + pulse_duration + 1 / cutoff
    send_time, send_amplitude = send_pulse(time, raw, before=send_end)
    scaled = normalise(raw, send_amplitude)

    faded = send_time + blind_time(pulse_duration, cutoff)
    start = np.maximum(faded, send_time + 2 * (nearest - probe_position) / speed)
    stop = send_time + 2 * (farthest - probe_position) / speed
    echoes = find_echoes(time, scaled, start=start, stop=stop, prominence=prominence)
    return_time, amplitude = _highest(echoes)
    return Ranging(
        envelope=scaled,
        send_time=send_time,
        send_amplitude=send_amplitude,
        echoes=echoes,
        return_time=return_time,
        amplitude=amplitude,
        distance=probe_position + distance(return_time - send_time, temperature),
        detected=np.isfinite(return_time),
    )


def _checked(time: ArrayLike, pressure: ArrayLike) -> tuple[Array, Array]:
    """Return a signal as arrays, or say what is wrong with it."""
    time, pressure = np.asarray(time, dtype=float), np.asarray(pressure, dtype=float)
    if pressure.shape[-1:] != time.shape:
        raise ValueError(
            f"pressure has shape {pressure.shape} and time {time.shape}; "
            "the last axis of pressure must be the time"
        )
    bad = np.argwhere(~np.isfinite(pressure))
    if bad.size:
        raise ValueError(
            f"pressure holds {len(bad)} values that are not finite, the first at index "
            f"{tuple(bad[0].tolist())}; remove or interpolate them"
        )
    return time, pressure


def _highest(echoes: Echoes) -> tuple[Array, Array]:
    """Return time and amplitude of each cycle's highest echo, nan where there is none."""
    amplitudes = np.nan_to_num(echoes.amplitudes, nan=-np.inf)
    # A column of nothing gives argmax something to find in a cycle without any echo.
    nothing = np.full((*amplitudes.shape[:-1], 1), -np.inf)
    index = np.argmax(np.concatenate([amplitudes, nothing], axis=-1), axis=-1)[..., np.newaxis]
    pad = np.full_like(nothing, np.nan)
    times, heights = (
        np.take_along_axis(np.concatenate([values, pad], axis=-1), index, axis=-1)[..., 0]
        for values in (echoes.times, echoes.amplitudes)
    )
    return times, heights
