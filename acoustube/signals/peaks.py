"""Peaks of envelopes: the send pulse and its echoes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import signal

from acoustube.base.types import Array


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


def strongest_echo(echoes: Echoes) -> tuple[Array, Array, Array]:
    """Return time, amplitude and prominence of each cycle's highest echo, nan where none is."""
    amplitudes = np.nan_to_num(echoes.amplitudes, nan=-np.inf)
    # A column of nothing gives argmax something to find in a cycle without any echo.
    nothing = np.full((*amplitudes.shape[:-1], 1), -np.inf)
    index = np.argmax(np.concatenate([amplitudes, nothing], axis=-1), axis=-1)[..., np.newaxis]
    pad = np.full_like(nothing, np.nan)
    times, heights, prominences = (
        np.take_along_axis(np.concatenate([values, pad], axis=-1), index, axis=-1)[..., 0]
        for values in (echoes.times, echoes.amplitudes, echoes.prominences)
    )
    return times, heights, prominences
