"""Checks of recorded samples: errors, and warnings of silent and clipped cycles."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from acoustube.air import TEMPERATURES
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.base.units import MS

SEND_PULSE_END = 3e-3
"""Time in s up to which the send pulse may reach the extreme codes."""

MIN_CLIPPED_SAMPLES = 3
"""Least number of samples at an extreme code after the send pulse that count as clipping: an echo
has one peak."""

MIN_CODE_RANGE = 64
"""Range of codes below which noise reaches the extremes repeatedly without clipping."""

SUSPECT_LENGTHS = {"depth": (0.3, "mm"), "diameter": (0.3, "mm"), "true_distance": (20.0, "cm")}
"""For each label, the length in m above which another unit is suspected, and that unit."""

BLOCK_SAMPLES = 1 << 22
"""Number of samples checked at a time, so that a memory-mapped file need not fit into memory."""


def check_temperature(path: Path, values: NDArray[Any]) -> None:
    """Raise ConfigError if a temperature lies outside the range of the model of air.

    Parameters
    ----------
    path : Path
        For messages.
    values : array of shape (cycle,)
        In degC.
    """
    low, high = TEMPERATURES
    wrong = np.flatnonzero(~((values >= low) & (values <= high)))  # so that nan fails too
    if wrong.size:
        raise ConfigError(
            f"{path}: temperature = {values[wrong[0]]:g} degC in cycle {wrong[0]} is outside "
            f"{low:g} to {high:g} degC; give it in degC"
        )


def _blocks(signal: NDArray[Any]) -> Iterator[tuple[int, NDArray[Any]]]:
    """Yield blocks of cycles, each with the number of its first cycle."""
    step = max(1, BLOCK_SAMPLES // signal.shape[1])
    yield from ((i, signal[i : i + step]) for i in range(0, len(signal), step))


def check_samples(path: Path, signal: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return each cycle's extremes; raise ConfigError if samples are unusable.

    Samples are unusable if there are none, one is not finite, or all are equal.

    Parameters
    ----------
    path : Path
        For messages.
    signal : array of shape (cycle, time)

    Returns
    -------
    low, high : array of shape (cycle,)
        Smallest and largest sample of each cycle.
    """
    if not signal.size:
        raise ConfigError(
            f"{path} holds {len(signal)} cycles of {signal.shape[1]} samples; record at least one "
            "cycle"
        )
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


def silent_cycles(low: NDArray[Any], high: NDArray[Any]) -> list[str]:
    """Return a warning with the number of silent cycles, or no warning if there are none.

    `low` and `high` are the extremes of each cycle, (cycle,), from :func:`check_samples`.
    """
    count = int(np.sum(low == high))
    text = f"{count} of {len(low)} cycles are silent: all their samples are equal."
    return [text] if count else []


def clipped_cycles(
    signal: NDArray[Any], rate: float, low: NDArray[Any], high: NDArray[Any]
) -> list[str]:
    """Return a warning with the number of cycles that are clipped after the send pulse.

    Parameters
    ----------
    signal : array of shape (cycle, time)
    rate : float
        Samples per second.
    low, high : array of shape (cycle,)
        Extremes from :func:`check_samples`.

    Returns
    -------
    list of str
        One sentence; empty if no cycle is clipped, samples are not integers, or their range is
        under :data:`MIN_CODE_RANGE`.
    """
    bottom, top = int(low.min()), int(high.max())
    later = signal[:, int(SEND_PULSE_END * rate) :]
    if signal.dtype.kind == "f" or top - bottom < MIN_CODE_RANGE or not later.size:
        return []
    count = 0
    for _, block in _blocks(later):
        repeats = [np.sum(block == end, axis=1) for end in (bottom, top)]
        count += int(np.sum(np.maximum(*repeats) >= MIN_CLIPPED_SAMPLES))
    text = (
        f"{count} of {len(signal)} cycles reach the extreme codes {bottom} or {top} at "
        f"{MIN_CLIPPED_SAMPLES} or more samples after the first {MS * SEND_PULSE_END:g} ms, as "
        "clipped echoes do."
    )
    return [text] if count else []


def suspect_lengths(labels: dict[str, NDArray[Any]]) -> list[str]:
    """Return warnings of labels, given by name, with implausibly large lengths in m."""
    return [
        f"{name} reaches {np.nanmax(labels[name]):g} m; if that is in {unit}, call it "
        f"{name}_{unit}."
        for name, (longest, unit) in SUSPECT_LENGTHS.items()
        if name in labels and np.any(labels[name] > longest)
    ]


STATED = {
    "full_scale": Number(1, 1e12, "counts"), "bore_radius": Number(1e-5, 1e3, "m"),
    "tube_length": Number(1e-2, 1e3, "m"),
}  # fmt: skip
"""Rules of attributes of recordings that acoustube wrote, by name.

Where they vary between cycles, they are variables (cycle) instead."""


def check_statements(path: Path, data: xr.Dataset, labels: Iterable[str]) -> None:
    """Raise ConfigError unless labels are one number a cycle, and attributes are in range.

    The attributes are those of :data:`STATED`, in a file that acoustube wrote.

    Parameters
    ----------
    path : Path
        For messages.
    data : xarray.Dataset
    labels : iterable of str
        Names of the variables that must have a number for each cycle, where they exist.
    """
    for name, rule in STATED.items():
        if name in data.attrs:
            rule.check(f"{path}: {name}", data.attrs[name])
    for name in (*labels, *STATED):
        if name in data and (data[name].dims != ("cycle",) or data[name].dtype.kind not in "iuf"):
            raise ConfigError(
                f"{path}: {name} has type {data[name].dtype} and dimensions {data[name].dims}; "
                "give one number a cycle"
            )
