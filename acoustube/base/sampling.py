"""Sampling rate of a time axis."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from acoustube.base.checks import RATE, TIMES, checked


@checked(time=TIMES)
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
        If the times are not evenly spaced and increasing, or their steps are out of range.
    """
    time = np.asarray(time, dtype=float)
    if time.ndim != 1 or time.size < 2:
        raise ValueError(f"time has shape {time.shape}; give one axis of at least two samples")
    step = (time[-1] - time[0]) / (time.size - 1)
    # Loose enough for times that were stored in single precision.
    if not (step > 0 and np.allclose(np.diff(time), step, rtol=0.05, atol=0)):
        raise ValueError("time is not evenly spaced and increasing; resample the signal first")
    if not RATE.low <= 1 / step <= RATE.high:
        raise ValueError(
            f"time has steps of {step:g} s; use {1 / RATE.high:g} to {1 / RATE.low:g} s"
        )
    return float(1 / step)
