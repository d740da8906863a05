"""Distances from times of flight, by the speed of sound at the temperature of the air."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from acoustube.air import ABSOLUTE_ZERO, sound_speed
from acoustube.base import checks
from acoustube.base.types import Array


@checks.checked(temperature=checks.CELSIUS)
def speed_of_sound(temperature: ArrayLike) -> Array:
    """Return the speed of sound in dry air in m/s at temperatures in degC.

    Raises
    ------
    ValueError
        If a temperature is not above absolute zero.
    """
    celsius = np.asarray(temperature, dtype=float)
    coldest = float(np.min(celsius))
    # Written so that nan fails too; the scalar function says what is wrong.
    reference = sound_speed(20.0 if coldest > ABSOLUTE_ZERO else coldest)
    return np.asarray(reference * np.sqrt((celsius - ABSOLUTE_ZERO) / (20.0 - ABSOLUTE_ZERO)))


@checks.checked(
    time_of_flight=checks.Reals(-1e9, 1e9, "s", missing=True, empty=True),
    temperature=checks.CELSIUS,
)
def distance(time_of_flight: ArrayLike, temperature: ArrayLike) -> Array:
    """Return the distance of a reflector from its time of flight.

    Parameters
    ----------
    time_of_flight : array
        Time from the send pulse to its return, in s.
    temperature : float or array
        Temperature of the air in degC.

    Returns
    -------
    array
        One-way distance in m: half the path of sound in that time.
    """
    return speed_of_sound(temperature) * np.asarray(time_of_flight, dtype=float) / 2


@checks.checked(pulse_duration=checks.DURATION, cutoff=checks.FREQUENCY)
def blind_time(pulse_duration: float, cutoff: float) -> float:
    """Return the duration in s of the send pulse's envelope after its maximum.

    It is half the pulse's duration in s plus one period of the low-pass's cut-off in Hz, by which
    the low-pass spreads the pulse.
    """
    return pulse_duration / 2 + 1 / cutoff


def nominal_distance(time: Array, speed: Array, pulse_duration: float) -> Array:
    """Return the distance from which an echo arrives at each time, for the nominal send time.

    Parameters
    ----------
    time : array of shape (time,) or (..., time)
        In s, less the time from the source to the probe.
    speed : array of shape (...)
        Speed of sound in m/s.
    pulse_duration : float
        Duration of the source pulse in s; its middle leaves the source after half of it.

    Returns
    -------
    array of shape (..., time)
        Distance in m from the probe, zero before the pulse's middle.
    """
    return speed[..., np.newaxis] * np.maximum(time - pulse_duration / 2, 0.0) / 2
