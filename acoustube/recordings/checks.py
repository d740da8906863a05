"""Checks of recorded samples: what stops a reader, and what it only warns of."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acoustube.air import TEMPERATURES
from acoustube.base.errors import ConfigError

SEND_TIME = 3e-3
"""Time in s in which the send pulse may reach the extreme codes."""

CLIPPED_SAMPLES = 3
"""So many samples at an extreme code later in a cycle count as clipping: an echo has one peak."""

LEAST_SPAN = 64
"""Codes between the extremes, under which noise repeats them without clipping."""

BLOCK = 1 << 22
"""Samples checked at a time, so that a mapped file need not fit into memory."""


def check_temperature(path: Path, values: NDArray[Any]) -> None:
    """Refuse a temperature in degC, of shape (cycle,), at which air is not known.

    Raises
    ------
    ConfigError
    """
    low, high = TEMPERATURES
    wrong = np.flatnonzero(~((values >= low) & (values <= high)))  # so that nan fails too
    if wrong.size:
        raise ConfigError(
            f"{path}: temperature = {values[wrong[0]]:g} degC in cycle {wrong[0]} is outside "
            f"{low:g} to {high:g} degC; give it in degC"
        )


def _blocks(signal: NDArray[Any]) -> Iterator[tuple[int, NDArray[Any]]]:
    """Yield some cycles at a time, with the number of the first."""
    step = max(1, BLOCK // signal.shape[1])
    yield from ((i, signal[i : i + step]) for i in range(0, len(signal), step))


def check_samples(path: Path, signal: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return each cycle's lowest and highest sample, once all are finite and not all the same.

    Parameters
    ----------
    path : Path
        For messages.
    signal : array of shape (cycle, time)

    Returns
    -------
    low, high : array of shape (cycle,)

    Raises
    ------
    ConfigError
    """
    count, first = 0, (0, 0)
    ends = []
    for start, block in _blocks(signal):
        if signal.dtype.kind == "f" and not np.isfinite(block).all():
            wrong = np.argwhere(~np.isfinite(block))
            first = first if count else (start + int(wrong[0, 0]), int(wrong[0, 1]))
            count += len(wrong)
        ends.append((block.min(axis=1), block.max(axis=1)))
    if count:
        raise ConfigError(
            f"{path}: {count} samples are missing, NaN or infinite, the first in cycle {first[0]} "
            f"at sample {first[1]}; leave those cycles out, or interpolate"
        )
    low, high = (np.concatenate(parts) for parts in zip(*ends, strict=True))
    if low.min() == high.max():
        raise ConfigError(
            f"{path} is silent: all samples are {low[0]:g}; check the sensor and its connection"
        )
    return low, high


def dead(low: NDArray[Any], high: NDArray[Any]) -> list[str]:
    """Tell how many cycles are silent; see :func:`clipping`."""
    count = int(np.sum(low == high))
    text = f"{count} of {len(low)} cycles are silent: all their samples are equal."
    return [text] if count else []


def clipping(signal: NDArray[Any], rate: float, low: NDArray[Any], high: NDArray[Any]) -> list[str]:
    """Tell how many cycles of integers stay at the record's extreme codes after the send pulse.

    Parameters
    ----------
    signal : array of shape (cycle, time)
    rate : float
        Samples per second.
    low, high : array of shape (cycle,)
        Of :func:`check_samples`.

    Returns
    -------
    list of str
        One sentence, or none.
    """
    bottom, top = int(low.min()), int(high.max())
    later = signal[:, int(SEND_TIME * rate) :]
    if signal.dtype.kind == "f" or top - bottom < LEAST_SPAN or not later.size:
        return []
    count = 0
    for _, block in _blocks(later):
        repeats = [np.sum(block == end, axis=1) for end in (bottom, top)]
        count += int(np.sum(np.maximum(*repeats) >= CLIPPED_SAMPLES))
    text = (
        f"{count} of {len(signal)} cycles reach the extreme codes {bottom} or {top} at "
        f"{CLIPPED_SAMPLES} or more samples after the first {1e3 * SEND_TIME:g} ms, as clipped "
        "echoes do."
    )
    return [text] if count else []
