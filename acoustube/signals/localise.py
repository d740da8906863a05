"""Distance from the time of flight of a cycle's strongest echo.

The sleeve paper: "Wearable, Fabric-Embedded Acoustic Waveguides for Meter-Scale Contact
Localization and Force Sensing".

References
----------
* Envelope of narrow-band noise and its slope: Rice, S. O., Mathematical analysis of random noise,
  Bell System Technical Journal 24 (1945), 46-156. doi:10.1002/j.1538-7305.1945.tb00453.x
* Standard deviation from a median: Hampel, F. R., The influence curve and its role in robust
  estimation, Journal of the American Statistical Association 69 (1974), 383-393.
  doi:10.1080/01621459.1974.10482962
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acoustube.air import ABSOLUTE_ZERO
from acoustube.base import checks
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.base.sampling import sampling_rate
from acoustube.base.types import Array
from acoustube.signals.filters import (
    TimeGain,
    check_cutoff,
    compensate,
    envelope,
    matched_filter,
    normalise,
    remove_offset,
)
from acoustube.signals.peaks import (
    Echoes,
    find_echoes,
    plateaus,
    send_pulse,
    strongest_echo,
)
from acoustube.signals.processing import Processing, process_arguments
from acoustube.signals.time_of_flight import (
    blind_time,
    distance,
    nominal_distance,
    speed_of_sound,
)

EACH = replace(checks.CELSIUS, empty=True)
"""Rule for the temperature of each cycle, of which there may be none."""
NORMAL_MEDIAN = 1.4826
"""Standard deviation of normal numbers, divided by the median of their absolute values."""
NOISE_RATIO_RECTIFIED, NOISE_RATIO_MATCHED = np.sqrt(1 - 2 / np.pi), 0.78
"""Ratio of the noise of the envelope's slope without an echo to that at an echo's peak.

Without matched filter it is sqrt(1 - 2 / pi), that of rectified white noise.
benchmarks/signals_peak_noise.py measures 0.59 and, with the default matched filter, 0.83: with the
lower constant, the stated deviation is 6 % too large rather than too small."""
SAMPLING_DEVIATION_RECTIFIED, SAMPLING_DEVIATION_MATCHED = 0.13, 0.24
"""Standard deviation of a peak's time in samples, due to the sampled absolute value of the carrier,
without and with the matched filter: a little over the 0.11 and 0.23 that
benchmarks/signals_peak_noise.py measures."""
SAMPLING_DEVIATION_COMPRESSED = 0.003
"""Standard deviation of a peak's time in samples, for a compressed chirp, whose envelope is a
magnitude: the error of the parabola, at bandwidths up to 0.3 of the sampling rate."""


@dataclass(frozen=True)
class Ranging:
    """Result of the processing of cycles.

    Attributes
    ----------
    envelope : array of shape (..., time)
        Envelope, relative to the send pulse's maximum.
    send_time, send_amplitude : array of shape (...)
        Time in s of the maximum of the send pulse's envelope, without gain and matched filter, plus
        `send_shift` of :func:`process`; for a clipped pulse, the maximum is taken to lie half its
        duration after its rise. The amplitude is the maximum of the envelope before the search
        window, after gain and matched filter, in the signal's unit.
    echoes : Echoes
        All echoes found in the search window, with amplitudes relative to the send pulse.
    return_time, amplitude : array of shape (...)
        Time in s and amplitude, relative to the send pulse, of the strongest echo. nan without
        an echo.
    prominence : array of shape (...)
        Prominence of the strongest echo, relative to the send pulse. nan without an echo.
    distance : array of shape (...)
        Distance in m from the source end to the reflector of the strongest echo. nan without an
        echo.
    distance_deviation : array of shape (...)
        Standard deviation of the distance in m due to noise and an error of the temperature; the
        extent of the press along the tube is not included. nan without an echo.
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


@checks.checked(
    time=checks.TIMES,
    samples=checks.Reals(axes=1, missing=True),
    settings=Processing,
    temperature=EACH,
    temperature_deviation=checks.KELVIN,
)
def locate(
    time: ArrayLike,
    samples: ArrayLike,
    settings: Processing | None = None,
    *,
    temperature: ArrayLike = 20.0,
    temperature_deviation: float = 0.0,
) -> Ranging:
    """Return the distance of a press from recorded cycles.

    Parameters
    ----------
    time : array of shape (time,)
        Sampling times in s; the pulse starts to leave the source end at 0.
    samples : array of shape (..., time)
        The cycles in any unit, integers or not, with their mean (DC offset).
    settings : Processing, optional
        Default: the sleeve paper's numbers; those of a calibration are
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
    settings = settings or Processing()
    return process(
        time,
        samples,
        temperature=temperature,
        temperature_deviation=temperature_deviation,
        **process_arguments(settings, sampling_rate(time)),
    )


@checks.checked(
    time=checks.TIMES,
    pressure=checks.Reals(axes=1, missing=True),
    pulse_duration=Number(1e-12, 1e5, "s"),
    probe_position=checks.DISTANCE,
    temperature=EACH,
    temperature_deviation=checks.KELVIN,
    offset_cutoff=checks.FREQUENCY,
    gain=TimeGain,
    template=checks.Complex(0, 1e100, axes=1),
    cutoff=checks.FREQUENCY,
    prominence=checks.PROMINENCE,
    nearest=checks.Reals(-1e6, 1e6, "m"),
    farthest=checks.Reals(-1e6, np.inf, "m"),
    send_shift=checks.SECONDS,
)
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
    """Return the distance of a press from the signal of a probe.

    Parameters
    ----------
    time : array of shape (time,)
        Sampling times in s; the pulse starts to leave the source end at 0.
    pressure : array of shape (..., time)
        Pressure at the probe, in any unit.
    pulse_duration : float
        Duration of the source pulse in s: the number of cycles divided by the carrier frequency.
    probe_position : float
        Distance of the probe from the source end in m.
    temperature : float or array of shape (...)
        Temperature of the air in degC.
    temperature_deviation : float
        Standard deviation of the temperature in K; it enters the standard deviation of the
        distance.
    offset_cutoff : float, optional
        Cut-off frequency in Hz; see :func:`remove_offset`. None for no removal.
    gain : TimeGain, optional
        See :func:`compensate`.
    template : array of shape (n,), optional
        See :func:`matched_filter`. With a complex one, of :func:`chirp_template`, the envelope is
        the magnitude of the filtered cycle, with no low-pass; it gives the send pulse's time too.
    cutoff : float
        Cut-off of the envelope's low-pass in Hz.
    prominence : float
        Least prominence of an echo, relative to the send pulse.
    nearest, farthest : float or array of shape (...)
        Limits of the search window in m from the source end. The search never starts before the
        send pulse has decayed at the probe.
    send_shift : float
        Time in s added to that of the send pulse.

    Returns
    -------
    Ranging
        A cycle that is silent or has no echo is not an error: it is not `detected`, and its
        distance is nan.

    Raises
    ------
    ValueError
        If the signal is too short, holds values that are not finite, or does not fit the time.

    Notes
    -----
    The sleeve paper normalises before the low-pass, which gives the same envelope, as both are
    linear. The amplitude of the send pulse is the maximum of its *envelope*, so that the normalised
    send pulse has the amplitude 1, as has an echo from a rigid end without losses.

    The absolute value of a sampled signal is not exact: overtones of the rectified carrier are
    aliased to frequencies below the cut-off and shift a 42 kHz echo by up to 0.3 samples (0.2 mm)
    at 200 kHz, 0.1 samples (0.01 mm) at 2 MHz. The parabolic refinement adds no further error.

    The search window starts :func:`blind_time` after the send pulse's maximum, or later. For a
    compressed pulse it starts a whole pulse duration after the maximum: earlier echoes begin while
    the pulse is being sent, and the side lobes of the send pulse end by then.

    Noise shifts a maximum by the noise's slope divided by the envelope's curvature. The slope's
    standard deviation is estimated from the differences of adjacent samples after the send pulse,
    by their median, which is robust against a few echoes. It is smaller there than at an echo,
    because noise alone is rectified (:data:`NOISE_RATIO_RECTIFIED`); the stated deviation is
    corrected for that, and includes the effect of sampling. The slope of a compressed pulse's
    envelope is that of one quadrature component with and without an echo (Rice), so that no
    correction is needed. The time of an echo with a flat top, of a uniform burst longer than the
    filter, varies more than stated.
    """
    time, pressure = _check_signal(time, pressure)
    _check_rows(temperature, pressure.shape[:-1])
    temperature = temperature if pressure.size else 20.0  # any value, without cycles
    rate, speed = sampling_rate(time), speed_of_sound(temperature)
    if offset_cutoff is not None:
        check_cutoff("offset_cutoff", offset_cutoff, rate)
        pressure = remove_offset(pressure, rate, offset_cutoff)
    compressed = template is not None and np.iscomplexobj(template)
    send_end = probe_position / float(np.min(speed)) + pulse_duration + 1 / cutoff
    raw = _envelope(pressure, template if compressed else None, rate, cutoff)
    send_time, send_amplitude = _sent(time, raw, send_end, None if compressed else pulse_duration)
    send_time = send_time + send_shift
    faded = send_time + (pulse_duration if compressed else blind_time(pulse_duration, cutoff))
    start = np.maximum(faded, send_time + 2 * (np.asarray(nearest) - probe_position) / speed)
    stop = send_time + 2 * (np.asarray(farthest) - probe_position) / speed
    if gain is not None or template is not None:
        late = (probe_position / speed)[..., np.newaxis]
        places = probe_position + nominal_distance(time - late, speed, pulse_duration)
        if gain is not None:
            pressure = compensate(pressure, places, gain)
        raw = _envelope(pressure, template, rate, cutoff)
        ahead = time < np.broadcast_to(start, raw.shape[:-1])[..., np.newaxis]
        send_amplitude = np.max(raw, axis=-1, where=ahead, initial=0.0)
    scaled = normalise(raw, send_amplitude)
    echoes = find_echoes(time, scaled, start=start, stop=stop, prominence=prominence)
    return_time, amplitude, height = strongest_echo(echoes)
    found = distance(return_time - send_time, temperature)
    ratio, samples = _noise_constants(template)
    by_noise = speed / 2 * _time_deviation(time, scaled, return_time, send_end) / ratio
    by_sampling = speed / 2 * samples / rate
    by_temperature = found * temperature_deviation / (2 * (np.asarray(temperature) - ABSOLUTE_ZERO))
    return Ranging(
        envelope=scaled,
        send_time=send_time,
        send_amplitude=send_amplitude,
        echoes=echoes,
        return_time=return_time,
        amplitude=amplitude,
        prominence=height,
        distance=probe_position + found,
        distance_deviation=np.hypot(np.hypot(by_noise, by_sampling), by_temperature),
        detected=np.isfinite(return_time),
    )


def _sent(time: Array, raw: Array, end: float, duration: float | None) -> tuple[Array, Array]:
    """Return time and amplitude of the send pulse; a clipped burst's time is from its rise."""
    sent, amplitude = send_pulse(time, raw, before=end)
    if duration is None:
        return sent, amplitude
    clipped, edge = plateaus(time, raw, amplitude, before=end, least=duration / 2)
    return np.where(clipped, edge + duration / 2, sent), amplitude


def _noise_constants(template: ArrayLike | None) -> tuple[float, float]:
    """Return the ratio of slope noise without an echo to that with one, and sampling deviation."""
    if template is None:
        return NOISE_RATIO_RECTIFIED, SAMPLING_DEVIATION_RECTIFIED
    if np.iscomplexobj(template):
        return 1.0, SAMPLING_DEVIATION_COMPRESSED
    return NOISE_RATIO_MATCHED, SAMPLING_DEVIATION_MATCHED


def _envelope(samples: Array, template: ArrayLike | None, rate: float, cutoff: float) -> Array:
    """Return the envelope of cycles (..., time) after a matched filter, if a template is given.

    With a complex template it is the magnitude, without rectifier and low-pass.
    """
    if template is None:
        return envelope(samples, rate, cutoff)
    matched = matched_filter(samples, template)
    return np.abs(matched) if np.iscomplexobj(matched) else envelope(matched, rate, cutoff)


def gain_and_match(
    samples: Array, distance: Array, gain: TimeGain | None, template: ArrayLike | None
) -> Any:
    """Return cycles (..., time) after gain and matched filter; None skips a step."""
    if gain is not None:
        samples = compensate(samples, distance, gain)
    return samples if template is None else matched_filter(samples, template)


def _time_deviation(time: Array, envelope: Array, peak: Array, start: float) -> Array:
    """Return the standard deviation in s of the time of each cycle's peak, due to noise.

    The noise is estimated from the envelope after the time `start`.
    """
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
    curvature = 2 * middle - left - right
    steps = np.divide(noise, curvature, out=np.full(curvature.shape, np.nan), where=curvature > 0)
    return np.where(np.isfinite(peak), steps * step, np.nan)


def _check_rows(temperature: ArrayLike, rows: tuple[int, ...]) -> None:
    """Raise unless there is one temperature for all cycles or one for each."""
    try:
        np.broadcast_to(np.asarray(temperature), rows)
    except ValueError:
        raise ConfigError(
            f"temperature has the shape {np.shape(temperature)} and the cycles have {rows}; "
            "give one for all or one for each"
        ) from None


def _check_signal(time: ArrayLike, pressure: ArrayLike) -> tuple[Array, Array]:
    """Return time and signal as arrays; raise ValueError if they do not match or are not finite."""
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
