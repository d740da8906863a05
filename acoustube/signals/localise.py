"""From a cycle to a distance: the processing that simulations and recordings share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acoustube.air import ABSOLUTE_ZERO, sound_speed
from acoustube.base.sampling import sampling_rate
from acoustube.base.types import Array
from acoustube.signals.filters import (
    TimeGain,
    compensate,
    envelope,
    matched_filter,
    normalise,
    remove_offset,
)
from acoustube.signals.peaks import Echoes, find_echoes, send_pulse, strongest_echo
from acoustube.signals.processing import Processing, process_arguments

FLAT = 0.95
"""Share of a send pulse's height that counts as its plateau."""
NORMAL_MEDIAN = 1.4826
"""Standard deviation of normal numbers over the median of their sizes."""
NOISE_RATIO_RECTIFIED, NOISE_RATIO_MATCHED = np.sqrt(1 - 2 / np.pi), 0.78
"""Noise of the envelope where nothing is heard, as a share of that on top of an echo: rectified
white noise keeps sqrt(1 - 2 / pi) of its deviation; behind the usual matched filter, measured."""
SAMPLED, SAMPLED_MATCHED = 0.13, 0.24
"""Deviation of a peak's time, in samples, by the sampled absolute value of the carrier."""


@dataclass(frozen=True)
class Ranging:
    """What the processing makes of a signal.

    Attributes
    ----------
    envelope : array of shape (..., time)
        Envelope as a share of the send pulse's.
    send_time, send_amplitude : array of shape (...)
        Maximum of the send pulse's envelope: time in s, without gain and matched filter but with
        the shift; of a clipped pulse, half its duration after its rise. And the amplitude after
        both, the highest before the search window.
    echoes : Echoes
        All echoes found in the search window.
    return_time, amplitude : array of shape (...)
        The highest echo: time in s, and amplitude as a share of the send pulse. nan if there is
        no echo.
    prominence : array of shape (...)
        Of the highest echo. nan if there is none.
    distance : array of shape (...)
        Distance from the source end to what returned the highest echo, in m. nan if there is none.
    distance_deviation : array of shape (...)
        Standard deviation of the distance in m, by the noise of the cycle and by an error of the
        temperature; not by what an extended press returns from its whole length.
    detected : array of bool of shape (...)
        Whether there is an echo.
    """

    envelope: Array
    send_time: Array
    send_amplitude: Array
    echoes: Echoes
    return_time: Array
    amplitude: Array
    prominence: Array
    distance: Array
    distance_deviation: Array
    detected: NDArray[np.bool_]


def locate(
    time: ArrayLike,
    samples: ArrayLike,
    how: Processing | None = None,
    *,
    temperature: ArrayLike = 20.0,
    temperature_deviation: float = 0.0,
) -> Ranging:
    """Find the distance of a press in recorded cycles.

    Parameters
    ----------
    time : array of shape (time,)
        Sampling times in s; the pulse starts to leave the source end at 0.
    samples : array of shape (..., time)
        The cycles in any unit, whole numbers or not, offset and all.
    how : Processing, optional
        The paper's by default; that of a calibration is
        :attr:`acoustube.signals.Calibration.processing`.
    temperature, temperature_deviation
        See :func:`process`.

    Returns
    -------
    Ranging

    Raises
    ------
    ValueError
        As :func:`process`.
    """
    how = how or Processing()
    return process(
        time,
        samples,
        temperature=temperature,
        temperature_deviation=temperature_deviation,
        **process_arguments(how, sampling_rate(time)),
    )


def speed_of_sound(temperature: ArrayLike) -> Array:
    """Return the speed of sound in dry air in m/s at temperatures in degC.

    Raises
    ------
    ValueError
        If one is not a temperature above absolute zero.
    """
    celsius = np.asarray(temperature, dtype=float)
    coldest = float(np.min(celsius))
    # Written so that nan fails too; the scalar function says what is wrong.
    reference = sound_speed(20.0 if coldest > ABSOLUTE_ZERO else coldest)
    return np.asarray(reference * np.sqrt((celsius - ABSOLUTE_ZERO) / (20.0 - ABSOLUTE_ZERO)))


def distance(time_of_flight: ArrayLike, temperature: ArrayLike) -> Array:
    """Return how far away an echo came from.

    Parameters
    ----------
    time_of_flight : array
        Time from the send pulse to its return, in s.
    temperature : float or array
        Temperature of the air in degC.

    Returns
    -------
    array
        One-way distance in m: half of what sound travels in that time.
    """
    return speed_of_sound(temperature) * np.asarray(time_of_flight, dtype=float) / 2


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
    temperature: ArrayLike = 20.0,
    temperature_deviation: float = 0.0,
    offset_cutoff: float | None = None,
    gain: TimeGain | None = None,
    template: ArrayLike | None = None,
    cutoff: float = 10e3,
    prominence: float = 0.01,
    nearest: ArrayLike = 0.0,
    farthest: ArrayLike = np.inf,
    send_shift: float = 0.0,
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
    temperature : float or array of shape (...)
        Temperature of the air in degC.
    temperature_deviation : float
        Its standard deviation in K, for that of the distance.
    offset_cutoff : float, optional
        See :func:`remove_offset`; without it the signal is taken as it is.
    gain : TimeGain, optional
        See :func:`compensate`.
    template : array, optional
        See :func:`matched_filter`.
    cutoff : float
        Cut-off of the envelope's low-pass in Hz.
    prominence : float
        Least prominence of an echo, as a share of the send pulse.
    nearest, farthest : float or array of shape (...)
        Distances from the source end, in m, between which an echo is looked for. The search never
        starts before the send pulse has died away at the probe.
    send_shift : float
        Added to the time of the send pulse, in s.

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

    Noise moves a maximum by its slope there over the envelope's curvature; the slope's deviation is
    estimated from the differences of neighbouring samples behind the send pulse, by their median,
    which few echoes do not move. It is less there than on top of an echo, as noise alone is
    rectified; the deviation stated allows for that, and for the sampling.
    """
    time, pressure = _checked(time, pressure)
    rate, speed = sampling_rate(time), speed_of_sound(temperature)
    if offset_cutoff is not None:
        pressure = remove_offset(pressure, rate, offset_cutoff)
    raw = envelope(pressure, rate, cutoff)
    send_end = probe_position / float(np.min(speed)) + pulse_duration + 1 / cutoff
    send_time, send_amplitude = send_pulse(time, raw, before=send_end)
    clipped, edge = _clipped(time, raw, send_amplitude, before=send_end, least=pulse_duration / 2)
    send_time = np.where(clipped, edge + pulse_duration / 2, send_time) + send_shift
    faded = send_time + blind_time(pulse_duration, cutoff)
    start = np.maximum(faded, send_time + 2 * (np.asarray(nearest) - probe_position) / speed)
    stop = send_time + 2 * (np.asarray(farthest) - probe_position) / speed
    if gain is not None or template is not None:
        places = probe_position + nominal_distance(time, speed, pulse_duration)
        raw = envelope(gain_and_match(pressure, places, gain, template), rate, cutoff)
        ahead = time < np.broadcast_to(start, raw.shape[:-1])[..., np.newaxis]
        send_amplitude = np.max(raw, axis=-1, where=ahead, initial=0.0)
    scaled = normalise(raw, send_amplitude)
    echoes = find_echoes(time, scaled, start=start, stop=stop, prominence=prominence)
    return_time, amplitude, height = strongest_echo(echoes)
    found = distance(return_time - send_time, temperature)
    plain = template is None
    share, samples = (
        (NOISE_RATIO_RECTIFIED, SAMPLED) if plain else (NOISE_RATIO_MATCHED, SAMPLED_MATCHED)
    )
    by_noise = speed / 2 * _time_deviation(time, scaled, return_time, send_end) / share
    by_sampling = speed / 2 * samples / rate
    by_warmth = found * temperature_deviation / (2 * (np.asarray(temperature) - ABSOLUTE_ZERO))
    return Ranging(
        envelope=scaled,
        send_time=send_time,
        send_amplitude=send_amplitude,
        echoes=echoes,
        return_time=return_time,
        amplitude=amplitude,
        prominence=height,
        distance=probe_position + found,
        distance_deviation=np.hypot(np.hypot(by_noise, by_sampling), by_warmth),
        detected=np.isfinite(return_time),
    )


def nominal_distance(time: Array, speed: Array, pulse_duration: float) -> Array:
    """Return from where an echo arrives at each time, the pulse's middle leaving at its nominal.

    Parameters
    ----------
    time : array of shape (time,)
        In s.
    speed : array of shape (...)
        Of sound in m/s.
    pulse_duration : float
        In s.

    Returns
    -------
    array of shape (..., time)
        In m from the probe, zero before the pulse's middle.
    """
    return speed[..., np.newaxis] * np.maximum(time - pulse_duration / 2, 0.0) / 2


def gain_and_match(
    samples: Array, distance: Array, gain: TimeGain | None, template: ArrayLike | None
) -> Array:
    """Return cycles (..., time) after gain and matched filter, as far as there are any."""
    if gain is not None:
        samples = compensate(samples, distance, gain)
    return samples if template is None else matched_filter(samples, template)


def _clipped(
    time: Array, envelope: Array, height: Array, *, before: float, least: float
) -> tuple[NDArray[np.bool_], Array]:
    """Return which send pulses are flat for longer than `least`, in s, and when they rise.

    A send pulse far over full scale has no maximum, but a plateau that wanders with the noise.
    """
    ahead = envelope[..., : int(np.searchsorted(time, before))]
    step, top = time[1] - time[0], np.asarray(height)[..., np.newaxis]
    flat = step * np.sum(ahead > FLAT * top, axis=-1) > least
    high = ahead >= top / 2
    first = np.argmax(high, axis=-1)[..., np.newaxis]
    here = np.take_along_axis(ahead, first, axis=-1)[..., 0]
    earlier = np.take_along_axis(ahead, np.maximum(first - 1, 0), axis=-1)[..., 0]
    rise = here - earlier
    share = np.divide(here - top[..., 0] / 2, rise, out=np.zeros_like(rise), where=rise > 0)
    return flat, time[first[..., 0]] - share * step


def _time_deviation(time: Array, envelope: Array, peak: Array, start: float) -> Array:
    """Return the standard deviation of the time of each cycle's peak, by the noise around it."""
    slopes = np.abs(np.diff(envelope[..., int(np.searchsorted(time, start)) :], axis=-1))
    if slopes.shape[-1] == 0:
        return np.full(peak.shape, np.nan)
    noise = NORMAL_MEDIAN * np.median(slopes, axis=-1)
    step = time[1] - time[0]
    index = np.nan_to_num((peak - time[0]) / step).round().astype(int)
    index = np.clip(index, 1, time.size - 2)[..., np.newaxis]
    left, middle, right = (
        np.take_along_axis(envelope, index + shift, axis=-1)[..., 0] for shift in (-1, 0, 1)
    )
    bend = 2 * middle - left - right
    steps = np.divide(noise, bend, out=np.full(bend.shape, np.nan), where=bend > 0)
    return np.where(np.isfinite(peak), steps * step, np.nan)


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
