"""The calibration of a sensor from cycles with the tube closed at known places (section II-E)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import curve_fit

from acoustube.base.sampling import sampling_rate
from acoustube.base.types import Array
from acoustube.signals.filters import TimeGain, normalise, remove_offset
from acoustube.signals.localise import (
    Ranging,
    gain_and_match,
    locate,
    nominal_distance,
    process,
    speed_of_sound,
)
from acoustube.signals.processing import Processing, process_arguments, without_aliased_template

FEWEST_PLACES = 6
"""Different places that a calibration needs: the gain has four parameters, two check them."""
SHORTEST_SPAN = 0.3
"""Distance in m that they must span, several lengths of a pulse."""
FAINTEST = 1e-5
"""Prominence of a blockage's echo: its highest peak counts, however low it is."""
SIGMAS = 2.8
"""Least prominence in standard deviations of cycles without contact, the paper's."""
HALF_NORMAL = 0.8937
"""Standard deviation of rectified normal noise over its median."""
REACH = 0.3
"""Distance in m from its place within which a blockage's echo is looked for."""
OVER_BACKGROUND = 6.0
"""Height of a blockage's echo over the untouched cycles there, in their standard deviations."""


class Estimate(NamedTuple):
    """A number and its standard deviation."""

    value: float
    deviation: float


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """What a calibration found.

    Attributes
    ----------
    processing : Processing
        How to process cycles with it: gain, shifted send time and least prominence set.
    sampling_rate : float
        Of the cycles, in Hz.
    c1, c2, c3, c4 : Estimate
        Of the amplitude c1 arctan(c2 (l - c3)) + c4 at distance l; in 1, 1/m, m and 1.
    amplitude_rmse : float
        Of that fit.
    slope, intercept : Estimate
        Of the line from true to estimated distance before the shift, in m/m and m.
    distance_rmse : float
        Of the estimates around the line, in m.
    false_alarms : float
        Share of the untouched cycles in which the processing finds an echo.
    true_distance, estimated_distance, amplitude : array of shape (n,)
        Of each cycle that was used, the distance with the shift; a closure that does not stand out
        is left out.
    """

    processing: Processing
    sampling_rate: float
    c1: Estimate
    c2: Estimate
    c3: Estimate
    c4: Estimate
    amplitude_rmse: float
    slope: Estimate
    intercept: Estimate
    distance_rmse: float
    false_alarms: float
    true_distance: Array
    estimated_distance: Array
    amplitude: Array

    def fitted_amplitude(self, distance: ArrayLike) -> Array:
        """Return the amplitude of a blockage at distances in m, by the fit."""
        return arctan_fall(np.asarray(distance, float), *(c.value for c in self._fall))

    @property
    def _fall(self) -> tuple[Estimate, Estimate, Estimate, Estimate]:
        return self.c1, self.c2, self.c3, self.c4


def arctan_fall(distance: Array, c1: float, c2: float, c3: float, c4: float) -> Array:
    """Return c1 arctan(c2 (l - c3)) + c4 at distances l."""
    return np.asarray(c1 * np.arctan(c2 * (distance - c3)) + c4)


def calibrate(
    time: ArrayLike,
    blocked: ArrayLike,
    true_distance: ArrayLike,
    untouched: ArrayLike,
    how: Processing | None = None,
    *,
    temperature: ArrayLike = 20.0,
    untouched_temperature: ArrayLike = 20.0,
    sigmas: float = SIGMAS,
) -> Calibration:
    """Calibrate a sensor.

    Parameters
    ----------
    time : array of shape (time,)
        Sampling times in s.
    blocked : array of shape (n, time)
        Cycles with the tube closed at one place each.
    true_distance : array of shape (n,)
        These places in m.
    untouched : array of shape (m, time)
        Cycles without contact.
    how : Processing, optional
        Default: the sleeve paper's numbers, without matched filter where the carrier is aliased.
        Its gain, shift and prominence are replaced by those found here.
    temperature, untouched_temperature : float or array of shape (n,), (m,)
        In degC.
    sigmas : float
        Least prominence in standard deviations of the untouched cycles.

    Returns
    -------
    Calibration

    Raises
    ------
    ValueError
        If the places are too few or too close together, the blockages cannot be told from noise,
        or their amplitudes do not fall with distance.

    Notes
    -----
    Each blockage is looked for around its place: far ones are lower than what nearby irregularities
    of the tube return. An arctangent is fitted to the amplitudes without gain and matched filter,
    and a line to the distances with both, which move the maxima of the ringing send pulse and of
    the echoes; by least squares, deviations are those of the fit. The send time is shifted so that
    the line passes through zero and keeps its slope. The least prominence is 2.8 standard
    deviations of what untouched cycles hold in the search window after the offset, gain, matched
    filter, rectification and normalisation. The paper's envelope is the mean of the rectified
    carrier, this package's its amplitude: pi/2 times as high, and the prominence with it.

    In white noise, whose envelope after the matched filter wanders like a Rayleigh variable, 2.8
    deviations are passed in most cycles: `false_alarms` tells, and `sigmas` raises them.
    """
    how = without_aliased_template(how or Processing(), sampling_rate(time))
    places = np.asarray(true_distance, float)
    _check_places(places, np.asarray(blocked).shape)
    if not np.all(np.ptp(np.asarray(untouched), axis=-1) > 0):
        raise ValueError("an untouched cycle is silent: it holds no send pulse; leave it out")
    time = np.asarray(time, float)
    plain = replace(how, gain=None, template_cycles=None, send_shift=0.0, prominence=FAINTEST)
    ranging = _around(time, blocked, plain, temperature, places)
    quiet = locate(time, untouched, plain, temperature=untouched_temperature)
    used = _recognised(time, ranging, quiet.envelope, places)
    fall, fall_deviations = _fall(places[used], ranging.amplitude[used])
    complete = replace(how, gain=TimeGain(*fall), send_shift=0.0)
    found = _around(
        time, blocked, replace(complete, prominence=FAINTEST), temperature, places
    ).distance
    used &= np.isfinite(found)
    _check_places(places[used], (int(used.sum()), time.size))
    speed = np.broadcast_to(speed_of_sound(temperature), places.shape)[used]
    places, found, heights = places[used], found[used], ranging.amplitude[used]
    (slope, intercept), line_deviations = _line(places, found)
    shift = 2 * intercept / float(np.mean(speed))
    complete = replace(complete, send_shift=shift)
    sigma = untouched_deviation(time, untouched, complete, temperature=untouched_temperature)
    complete = replace(complete, prominence=np.pi / 2 * sigmas * sigma)
    alarms = locate(time, untouched, complete, temperature=untouched_temperature).detected
    return Calibration(
        processing=complete,
        false_alarms=float(np.mean(alarms)),
        sampling_rate=sampling_rate(time),
        **{f"c{i + 1}": Estimate(fall[i], fall_deviations[i]) for i in range(4)},
        amplitude_rmse=_rms(heights - arctan_fall(places, *fall)),
        slope=Estimate(slope, line_deviations[0]),
        intercept=Estimate(intercept, line_deviations[1]),
        distance_rmse=_rms(found - slope * places - intercept),
        true_distance=places,
        estimated_distance=found - speed * shift / 2,
        amplitude=heights,
    )


def untouched_deviation(
    time: ArrayLike, untouched: ArrayLike, how: Processing, *, temperature: ArrayLike = 20.0
) -> float:
    """Return the standard deviation of untouched cycles in the search window.

    Parameters
    ----------
    time : array of shape (time,)
        In s.
    untouched : array of shape (..., time)
    how : Processing
        With the gain that will be used.
    temperature : float or array of shape (...)
        In degC.

    Returns
    -------
    float
        As a share of the send pulse: after offset, gain, matched filter, rectification and
        normalisation, the low-pass left out, as the paper has it. By the median: the send pulse may
        still ring where the window begins, which would rule the root of the mean square.
    """
    time, cycles = np.asarray(time, float), np.asarray(untouched, float)
    rate = sampling_rate(time)
    settings = process_arguments(how, rate)
    if how.offset_cutoff is not None:
        cycles = remove_offset(cycles, rate, how.offset_cutoff)
    places = nominal_distance(time, speed_of_sound(temperature), settings["pulse_duration"])
    cycles = gain_and_match(cycles, places, how.gain, settings["template"])
    sent = process(time, untouched, temperature=temperature, **settings).send_amplitude
    scaled = np.abs(normalise(cycles, sent))
    distance = np.broadcast_to(places, scaled.shape)
    inside = (distance >= how.nearest) & (distance <= how.farthest)
    if not inside.any():
        raise ValueError("the untouched cycles end before the search window; record longer ones")
    return HALF_NORMAL * float(np.median(scaled[inside]))


def _check_places(places: Array, shape: tuple[int, ...]) -> None:
    """Refuse places that do not belong to the cycles, or that leave the fit open."""
    if len(shape) != 2 or places.shape != shape[:1]:
        raise ValueError(
            f"true_distance has shape {places.shape} and blocked {shape}; give one distance for "
            "each cycle (n, time)"
        )
    if not np.all(np.isfinite(places) & (places > 0)):
        raise ValueError("true_distance must be positive and finite, in m")
    different = np.unique(np.round(places, 3))
    if different.size < FEWEST_PLACES:
        raise ValueError(
            f"{different.size} different places are too few to calibrate with; block the tube at "
            f"{FEWEST_PLACES} or more"
        )
    if np.ptp(places) < SHORTEST_SPAN:
        raise ValueError(
            f"the places span {np.ptp(places):.3g} m, too little to tell how echoes fade; spread "
            f"them over {SHORTEST_SPAN} m or more"
        )


def _around(
    time: Array, blocked: ArrayLike, how: Processing, temperature: ArrayLike, places: Array
) -> Ranging:
    """Process blockages, each around its place."""
    window = {
        "nearest": np.maximum(places - REACH, how.nearest),
        "farthest": places + REACH,
    }
    settings = process_arguments(how, sampling_rate(time)) | window
    return process(time, blocked, temperature=temperature, **settings)


def _recognised(
    time: Array, ranging: Ranging, background: Array, places: Array
) -> NDArray[np.bool_]:
    """Return which cycles show their blockage, and refuse when too few do.

    It must stand out from what untouched cycles (m, time) hold at the same time.
    """
    level = np.nanmean(background, axis=0) + OVER_BACKGROUND * np.nanstd(background, axis=0)
    there = np.interp(np.nan_to_num(ranging.return_time), time, level)
    used = ranging.detected & (np.nan_to_num(ranging.amplitude) > there)
    left = np.unique(np.round(places[used], 3))
    if left.size < FEWEST_PLACES:
        lost = np.unique(np.round(places[~used], 2))
        raise ValueError(
            f"only {left.size} places show an echo within {REACH} m of where it belongs, "
            f"{FEWEST_PLACES} are needed; not so at {', '.join(f'{z:g}' for z in lost[:8])} m: "
            "check the unit of the distances (m), the tube's closure and the search window"
        )
    return used


def _line(x: Array, y: Array) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return slope and intercept of the line of least squares, and their deviations."""
    (slope, intercept), covariance = np.polyfit(x, y, 1, cov=True)
    deviations = np.sqrt(np.diag(covariance))
    return (float(slope), float(intercept)), (float(deviations[0]), float(deviations[1]))


def _fall(places: Array, heights: Array) -> tuple[list[float], list[float]]:
    """Fit the arctangent, its fall negative and its steepness positive."""
    if not np.polyfit(places, heights, 1)[0] < 0:
        raise ValueError(
            "the blockages' amplitudes do not fall with distance; check that the distances belong "
            "to the cycles"
        )
    span, height = np.ptp(places), np.ptp(heights)
    guess = [-height / np.pi, 4 / span, float(np.median(places)), float(np.mean(heights))]
    bounds = ([-np.inf, 1e-3, -np.inf, -np.inf], [0.0, np.inf, np.inf, np.inf])
    try:
        found, covariance = curve_fit(
            arctan_fall, places, heights, guess, bounds=bounds, x_scale=np.abs(guess),
            max_nfev=20_000,
        )  # fmt: skip
    except RuntimeError as error:
        raise ValueError(
            "no arctangent fits the blockages' amplitudes; spread the places over more of the tube"
        ) from error
    return [float(c) for c in found], [float(d) for d in np.sqrt(np.diag(covariance))]


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
