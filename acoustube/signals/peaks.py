"""Peaks of envelopes: send pulse and echoes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal

from acoustube.base.checks import PROMINENCE, SAMPLES, SECONDS, TIMES, Reals, checked
from acoustube.base.types import Array

PLATEAU_LEVEL = 0.95
"""Fraction of the send pulse's height above which a sample is part of a plateau (clipping)."""


@dataclass(frozen=True)
class Echoes:
    """Peaks of envelopes, in order of time.

    Attributes
    ----------
    times : array of shape (..., echo)
        Times in s. Rows of cycles with fewer echoes are filled with nan.
    amplitudes : array of shape (..., echo)
        Envelope at the peak, in the envelope's unit.
    prominences : array of shape (..., echo)
        Height of the peak above the higher of two minima, in the same unit, as in
        ``scipy.signal.find_peaks``: the minima between the peak and the next higher point on either
        side, or the end of the search window.
    """

    times: Array
    amplitudes: Array
    prominences: Array


@checked(time=TIMES, envelope=SAMPLES, before=SECONDS)
def send_pulse(time: ArrayLike, envelope: ArrayLike, before: float) -> tuple[Array, Array]:
    """Return time and amplitude of the send pulse: the envelope's maximum before a given time.

    Parameters
    ----------
    time : array of shape (time,)
        Sampling times in s.
    envelope : array of shape (..., time)
        The envelopes.
    before : float
        Time in s after the send pulse and before the first echo.

    Returns
    -------
    time, amplitude : array of shape (...)
        The maximum in s and in the envelope's unit, refined between the samples.

    Raises
    ------
    ValueError
        If the record has fewer than three samples before that time, or the last axis of the
        envelopes is not the time.
    """
    time, envelope = np.asarray(time, dtype=float), np.asarray(envelope, dtype=float)
    _check_time(time, envelope)
    n_before = int(np.searchsorted(time, before))
    if n_before < 3:
        raise ValueError(
            f"before = {before:g} s leaves fewer than 3 samples of a record that starts at "
            f"{time[0]:g} s; use a later time"
        )
    index = np.argmax(envelope[..., :n_before], axis=-1)
    return _refine(time, envelope, index)


@checked(
    time=TIMES,
    envelope=Reals(axes=1, missing=True),
    start=Reals(-np.inf, np.inf, "s", missing=True, empty=True),
    stop=Reals(-np.inf, np.inf, "s", missing=True, empty=True),
    prominence=PROMINENCE,
)
def find_echoes(
    time: ArrayLike,
    envelope: ArrayLike,
    *,
    start: ArrayLike = -np.inf,
    stop: ArrayLike = np.inf,
    prominence: float = 0.01,
) -> Echoes:
    """Return the peaks of envelopes within a search window.

    Parameters
    ----------
    time : array of shape (time,)
        Sampling times in s.
    envelope : array of shape (..., time)
        The envelopes.
    start, stop : float or array of shape (...)
        The window in s. The prominence is computed within it, so that the flank of a send pulse
        that extends into the window is not a peak.
    prominence : float
        Least prominence of an echo, in the envelope's unit.

    Returns
    -------
    Echoes
        The peaks, times and amplitudes refined between the samples by a parabola.

    Raises
    ------
    ValueError
        If the last axis of the envelopes is not the time, or `start` or `stop` is neither a number
        nor one for each envelope.
    """
    time, envelope = np.asarray(time, dtype=float), np.asarray(envelope, dtype=float)
    _check_time(time, envelope)
    cycles = envelope.reshape(-1, time.size)
    shape = envelope.shape[:-1]
    first = np.searchsorted(time, _for_each("start", start, shape), side="left").ravel()
    last = np.searchsorted(time, _for_each("stop", stop, shape), side="right").ravel()
    found = [
        _peaks(time, cycle, slice(a, b), prominence)
        for cycle, a, b in zip(cycles, first, last, strict=True)
    ]
    most = max((rows.shape[1] for rows in found), default=0)
    padded = np.full((3, len(found), most), np.nan)
    for row, rows in enumerate(found):
        padded[:, row, : rows.shape[1]] = rows
    return Echoes(*padded.reshape(3, *shape, most))


def _for_each(name: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return a limit of the search window per envelope; raise ValueError if the shape is wrong."""
    try:
        return np.broadcast_to(np.asarray(value, float), shape)
    except ValueError as error:
        raise ValueError(
            f"{name} has shape {np.shape(value)}; give a number or one for each envelope, {shape}"
        ) from error


def _check_time(time: Array, envelope: Array) -> None:
    """Raise ValueError unless the last axis of an envelope is the time."""
    if envelope.shape[-1] != time.size:
        raise ValueError(
            f"envelope has shape {envelope.shape} and time {time.shape}; the last axis of envelope "
            "must be the time"
        )


def _peaks(time: Array, cycle: Array, window: slice, prominence: float) -> Array:
    """Return times, amplitudes and prominences of one cycle's peaks, shape (3, echo)."""
    inside = cycle[window]
    if inside.size < 3:
        return np.empty((3, 0))
    index, properties = signal.find_peaks(inside, prominence=prominence)
    times, amplitudes = _refine(time, cycle, index + window.start)
    return np.stack([times, amplitudes, properties["prominences"]])


def _refine(time: Array, samples: Array, index: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return time and height of the vertex of the parabola through a maximum and its neighbours.

    There is one maximum per cycle for ``samples`` of shape (..., time), or several in one cycle.
    """
    middle = np.clip(index, 1, time.size - 2)
    left, centre, right = (_take(samples, middle + shift) for shift in (-1, 0, 1))
    slope, bend = (right - left) / 2, left - 2 * centre + right
    # A maximum at the record's edge, or on a plateau, has no vertex nearby: keep the sample.
    vertex = (middle == index) & (bend < 0) & (centre >= left) & (centre >= right)
    offset = np.divide(-slope, bend, out=np.zeros_like(slope), where=vertex)
    height = np.where(vertex, centre + slope * offset / 2, _take(samples, index))
    return time[index] + offset * (time[1] - time[0]), height


def _take(samples: Array, index: NDArray[np.intp]) -> Array:
    """Return the sample at one index per cycle, or at several indices of a single cycle."""
    if samples.ndim == 1:
        return np.asarray(samples[index])
    return np.take_along_axis(samples, index[..., np.newaxis], axis=-1)[..., 0]


def strongest_echo(echoes: Echoes) -> tuple[Array, Array, Array]:
    """Return the echo of the highest amplitude of each cycle.

    Parameters
    ----------
    echoes : Echoes

    Returns
    -------
    time, amplitude, prominence : array of shape (...)
        In s and in the envelope's unit; nan for a cycle without an echo.
    """
    amplitudes = np.nan_to_num(echoes.amplitudes, nan=-np.inf)
    # A last column of -inf gives argmax a result for a cycle without any echo.
    nothing = np.full((*amplitudes.shape[:-1], 1), -np.inf)
    index = np.argmax(np.concatenate([amplitudes, nothing], axis=-1), axis=-1)[..., np.newaxis]
    pad = np.full_like(nothing, np.nan)
    times, heights, prominences = (
        np.take_along_axis(np.concatenate([values, pad], axis=-1), index, axis=-1)[..., 0]
        for values in (echoes.times, echoes.amplitudes, echoes.prominences)
    )
    return times, heights, prominences


def plateaus(
    time: Array, envelope: Array, height: Array, *, before: float, least: float
) -> tuple[NDArray[np.bool_], Array]:
    """Return which send pulses have a plateau, as clipped ones do, and the times of their rise.

    A clipped send pulse has no distinct maximum but a plateau, whose maximum is arbitrary.

    Parameters
    ----------
    time : array of shape (time,)
        In s.
    envelope : array of shape (..., time)
    height : array of shape (...)
        Height of the send pulse.
    before : float
        Time in s after the send pulse.
    least : float
        Least duration of a plateau in s.

    Returns
    -------
    flat : array of bool, shape (...)
        Whether there is a plateau.
    rise : array of shape (...)
        Time in s at which the envelope reaches half the height.
    """
    ahead = envelope[..., : int(np.searchsorted(time, before))]
    step, top = time[1] - time[0], np.asarray(height)[..., np.newaxis]
    flat = step * np.sum(ahead > PLATEAU_LEVEL * top, axis=-1) > least
    high = ahead >= top / 2
    first = np.argmax(high, axis=-1)[..., np.newaxis]
    here = np.take_along_axis(ahead, first, axis=-1)[..., 0]
    earlier = np.take_along_axis(ahead, np.maximum(first - 1, 0), axis=-1)[..., 0]
    rise = here - earlier
    fraction = np.divide(here - top[..., 0] / 2, rise, out=np.zeros_like(rise), where=rise > 0)
    return flat, time[first[..., 0]] - fraction * step
