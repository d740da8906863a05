"""Calibration of a sensor from closures of the tube at known distances.

It follows section II-E of "Wearable, Fabric-Embedded Acoustic Waveguides for Meter-Scale Contact
Localization and Force Sensing" (the sleeve paper), where closures are called blockages.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import curve_fit

from acoustube.base.checks import CELSIUS, TIMES, Reals, checked
from acoustube.base.rules import Number
from acoustube.base.sampling import sampling_rate
from acoustube.base.types import Array
from acoustube.signals.filters import TimeGain, normalise, remove_offset
from acoustube.signals.localise import Ranging, gain_and_match, locate, process
from acoustube.signals.processing import Processing, process_arguments, without_aliased_template
from acoustube.signals.time_of_flight import nominal_distance, speed_of_sound

MIN_DISTANCES = 6
"""Least number of distinct distances: four parameters of the gain, and two degrees of freedom."""
MIN_SPAN = 0.3
"""Least range of the distances in m: several lengths of a pulse."""
CLOSURE_PROMINENCE = 1e-5
"""Least prominence of a closure's echo, relative to the send pulse: low enough that the echo's
highest peak is always found."""
PROMINENCE_SIGMAS = 2.8
"""Least prominence, in standard deviations of untouched cycles (sleeve paper, section II-E)."""
HALF_NORMAL_RATIO = 0.8937
"""Standard deviation of the half-normal distribution (rectified normal noise), divided by its
median."""
RAYLEIGH_RATIO = 0.6028 / np.sqrt(2 * np.log(2))
"""Standard deviation of the half-normal distribution, divided by the median of the Rayleigh
distribution, both of normal components with equal variance: for a compressed chirp, whose samples
are magnitudes of two components."""
SEARCH_HALF_WIDTH = 0.3
"""Half the width in m of the search window around a closure's distance."""
CLOSURE_SIGMAS = 6.0
"""Least height of a closure's echo above the mean of untouched cycles, in their standard
deviations."""


class Estimate(NamedTuple):
    """A number and its standard deviation."""

    value: float
    deviation: float


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Result of a calibration.

    Attributes
    ----------
    processing : Processing
        Settings with the calibrated gain, shift of the send time and least prominence.
    sampling_rate : float
        Sampling rate of the cycles in Hz.
    c1, c2, c3, c4 : Estimate
        Parameters of the amplitude c1 arctan(c2 (l - c3)) + c4 at distance l; in 1, 1/m, m and 1.
    amplitude_rmse : float
        Root-mean-square residual of that fit, relative to the send pulse.
    slope, intercept : Estimate
        Line from true to estimated distance before the shift, in m/m and m.
    distance_rmse : float
        Root-mean-square residual of that line in m.
    false_alarms : float
        Fraction of the untouched cycles in which the processing finds an echo.
    true_distance, estimated_distance, amplitude : array of shape (n,)
        True distance and estimate (after the shift) in m, and amplitude relative to the send pulse,
        of each cycle used; closures whose echo does not exceed the background are left out.
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
        """Return the fitted amplitude of closures at distances in m, relative to the send pulse."""
        return arctan_fall(np.asarray(distance, float), *(c.value for c in self._parameters))

    @property
    def _parameters(self) -> tuple[Estimate, Estimate, Estimate, Estimate]:
        return self.c1, self.c2, self.c3, self.c4


def arctan_fall(distance: Array, c1: float, c2: float, c3: float, c4: float) -> Array:
    """Return c1 arctan(c2 (l - c3)) + c4 at distances l in m: the sleeve paper's eq. 4."""
    return np.asarray(c1 * np.arctan(c2 * (distance - c3)) + c4)


@checked(
    time=TIMES,
    blocked=Reals(ndim=2),
    true_distance=Reals(-1e6, 1e6, "m", ndim=1),
    untouched=Reals(ndim=2),
    settings=Processing,
    temperature=CELSIUS,
    untouched_temperature=CELSIUS,
    sigmas=Number(1e-3, 1e6),
)
def calibrate(
    time: ArrayLike,
    blocked: ArrayLike,
    true_distance: ArrayLike,
    untouched: ArrayLike,
    settings: Processing | None = None,
    *,
    temperature: ArrayLike = 20.0,
    untouched_temperature: ArrayLike = 20.0,
    sigmas: float = PROMINENCE_SIGMAS,
) -> Calibration:
    """Return gain, send time and least prominence from closures and untouched cycles.

    Parameters
    ----------
    time : array of shape (time,)
        Sampling times in s.
    blocked : array of shape (n, time)
        Cycles with the tube closed at one distance each.
    true_distance : array of shape (n,)
        Distance in m from the source end at which each cycle's tube was closed.
    untouched : array of shape (m, time)
        Cycles without contact.
    settings : Processing, optional
        Default: the sleeve paper's numbers, without matched filter where the carrier is aliased.
        Its gain, shift and prominence are replaced by those found here.
    temperature, untouched_temperature : float or array of shape (n,), (m,)
        Temperature of the air in degC.
    sigmas : float
        Least prominence in standard deviations of the untouched cycles.

    Returns
    -------
    Calibration

    Raises
    ------
    ValueError
        If the distances are too few or too close together, the closures' echoes do not exceed the
        background, or their amplitudes do not fall with distance.

    Notes
    -----
    Each closure's echo is searched around its distance, since echoes from afar are lower than those
    of nearby irregularities of the tube. An arctangent, the sleeve paper's eq. 4, is fitted to the
    amplitudes without gain and matched filter. A line is fitted to the distances with both, since
    they shift the maxima of the ringing send pulse and of the echoes. Both are least-squares fits;
    deviations are those of the fit. The send time is shifted so that the line passes through zero
    and keeps its slope.

    The four fitted parameters then enter a tanh, :class:`TimeGain`, and not the arctangent that was
    fitted. That is the sleeve paper's choice: dividing by the arctangent raised the mean baseline
    with distance until it hid the peaks, and the tanh of the same parameters has a similar form
    with a smaller gain at large distance.

    The least prominence is 2.8 standard deviations of untouched cycles in the search window after
    offset, gain, matched filter, rectification and normalisation. The sleeve paper's envelope is
    the mean of the rectified carrier; this package's is the amplitude of the carrier, pi/2 times as
    high, and so is the prominence. In white noise, whose envelope after the matched filter follows
    a Rayleigh distribution, most cycles exceed 2.8 deviations: `false_alarms` states the fraction,
    and a higher `sigmas` lowers it.
    """
    _check_cycles(np.size(time), blocked=blocked, untouched=untouched)
    settings = without_aliased_template(settings or Processing(), sampling_rate(time))
    places = np.asarray(true_distance, float)
    _check_distances(places, np.asarray(blocked).shape)
    if not np.all(np.ptp(np.asarray(untouched), axis=-1) > 0):
        raise ValueError("an untouched cycle is silent: it holds no send pulse; leave it out")
    time = np.asarray(time, float)
    plain = replace(
        settings, gain=None, template_cycles=None, send_shift=0.0, prominence=CLOSURE_PROMINENCE
    )
    ranging = _locate_closures(time, blocked, plain, temperature, places)
    quiet = locate(time, untouched, plain, temperature=untouched_temperature)
    used = _detected_closures(time, ranging, quiet.envelope, places)
    fall, fall_deviations = _fit_attenuation(places[used], ranging.amplitude[used])
    complete = replace(settings, gain=TimeGain(*fall), send_shift=0.0)
    found = _locate_closures(
        time, blocked, replace(complete, prominence=CLOSURE_PROMINENCE), temperature, places
    ).distance
    used &= np.isfinite(found)
    _check_distances(places[used], (int(used.sum()), time.size))
    speed = np.broadcast_to(speed_of_sound(temperature), places.shape)[used]
    places, found, heights = places[used], found[used], ranging.amplitude[used]
    (slope, intercept), line_deviations = _fit_line(places, found)
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
    time: ArrayLike, untouched: ArrayLike, settings: Processing, *, temperature: ArrayLike = 20.0
) -> float:
    """Return the standard deviation of untouched cycles in the search window.

    Parameters
    ----------
    time : array of shape (time,)
        In s.
    untouched : array of shape (..., time)
    settings : Processing
        With the gain of the calibration.
    temperature : float or array of shape (...)
        Temperature of the air in degC.

    Returns
    -------
    float
        Relative to the send pulse, after offset removal, gain, matched filter, rectification and
        normalisation, without the low-pass, as in the sleeve paper. Estimated from the median: the
        send pulse may still ring at the start of the window, which would dominate the root mean
        square.

    Raises
    ------
    ValueError
        If the cycles end before the search window, or as :func:`acoustube.signals.process`.
    """
    time, cycles = np.asarray(time, float), np.asarray(untouched, float)
    rate = sampling_rate(time)
    options = process_arguments(settings, rate)
    if settings.offset_cutoff is not None:
        cycles = remove_offset(cycles, rate, settings.offset_cutoff)
    places = nominal_distance(time, speed_of_sound(temperature), options["pulse_duration"])
    cycles = gain_and_match(cycles, places, settings.gain, options["template"])
    sent = process(time, untouched, temperature=temperature, **options).send_amplitude
    scaled = normalise(np.abs(cycles), sent)
    distance = np.broadcast_to(places, scaled.shape)
    inside = (distance >= settings.nearest) & (distance <= settings.farthest)
    if not inside.any():
        raise ValueError("the untouched cycles end before the search window; record longer ones")
    ratio = HALF_NORMAL_RATIO if settings.bandwidth is None else RAYLEIGH_RATIO
    return ratio * float(np.median(scaled[inside]))


def _check_cycles(n_samples: int, **cycles: ArrayLike) -> None:
    """Raise unless all cycles (n, time), given by name, have a sample at each time."""
    for name, samples in cycles.items():
        shape = np.shape(samples)
        if shape[-1:] != (n_samples,) or not shape[0]:
            raise ValueError(
                f"{name} has shape {shape} and time ({n_samples},); give one cycle or more, "
                "with a sample at each time"
            )


def _check_distances(places: Array, shape: tuple[int, ...]) -> None:
    """Raise if the distances do not match the cycles or do not determine the fit."""
    if len(shape) != 2 or places.shape != shape[:1]:
        raise ValueError(
            f"true_distance has shape {places.shape} and blocked {shape}; give one distance for "
            "each cycle (n, time)"
        )
    if not np.all(np.isfinite(places) & (places > 0)):
        raise ValueError("true_distance must be positive and finite, in m")
    different = np.unique(np.round(places, 3))
    if different.size < MIN_DISTANCES:
        raise ValueError(
            f"{different.size} different places are too few to calibrate with; block the tube at "
            f"{MIN_DISTANCES} or more"
        )
    if np.ptp(places) < MIN_SPAN:
        raise ValueError(
            f"the places span {np.ptp(places):.3g} m, too little to fit the attenuation; "
            f"spread them over {MIN_SPAN} m or more"
        )


def _locate_closures(
    time: Array, blocked: ArrayLike, settings: Processing, temperature: ArrayLike, places: Array
) -> Ranging:
    """Return the ranging of closures, each within a search window around its distance."""
    window = {
        "nearest": np.maximum(places - SEARCH_HALF_WIDTH, settings.nearest),
        "farthest": places + SEARCH_HALF_WIDTH,
    }
    options = process_arguments(settings, sampling_rate(time)) | window
    return process(time, blocked, temperature=temperature, **options)


def _detected_closures(
    time: Array, ranging: Ranging, background: Array, places: Array
) -> NDArray[np.bool_]:
    """Return which cycles show their closure's echo; raise ValueError if too few do.

    At its time, an echo must exceed the mean of the untouched envelopes `background`, (m, time), by
    :data:`CLOSURE_SIGMAS` standard deviations.
    """
    level = np.nanmean(background, axis=0) + CLOSURE_SIGMAS * np.nanstd(background, axis=0)
    there = np.interp(np.nan_to_num(ranging.return_time), time, level)
    used = ranging.detected & (np.nan_to_num(ranging.amplitude) > there)
    left = np.unique(np.round(places[used], 3))
    if left.size < MIN_DISTANCES:
        lost = np.unique(np.round(places[~used], 2))
        raise ValueError(
            f"only {left.size} places show an echo within {SEARCH_HALF_WIDTH} m of their closure, "
            f"{MIN_DISTANCES} are needed; none at {', '.join(f'{z:g}' for z in lost[:8])} m: "
            "check the unit of the distances (m), the temperature, the tube's closure and the "
            "search window"
        )
    return used


def _fit_line(x: Array, y: Array) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return slope and intercept of the least-squares line, and their standard deviations."""
    (slope, intercept), covariance = np.polyfit(x, y, 1, cov=True)
    deviations = np.sqrt(np.diag(covariance))
    return (float(slope), float(intercept)), (float(deviations[0]), float(deviations[1]))


def _fit_attenuation(places: Array, heights: Array) -> tuple[list[float], list[float]]:
    """Return c1 to c4 of the arctangent, with c1 <= 0 and c2 > 0, and their standard deviations."""
    if not np.polyfit(places, heights, 1)[0] < 0:
        raise ValueError(
            "the closures' amplitudes do not fall with distance; check that the distances belong "
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
            "the arctangent does not fit the amplitudes; spread the distances over more of the tube"
        ) from error
    return [float(c) for c in found], [float(d) for d in np.sqrt(np.diag(covariance))]


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
