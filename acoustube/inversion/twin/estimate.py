"""Sensor estimated from recordings of closures: starting values, fit, rejection and posterior."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import log

import numpy as np
from threadpoolctl import threadpool_limits

from acoustube.base.checks import LENGTH, RATE, SECONDS, Optional, Several, checked
from acoustube.base.errors import ConfigError
from acoustube.base.report import ignore
from acoustube.base.rules import Number
from acoustube.base.types import Array
from acoustube.base.units import CM, MS
from acoustube.inversion.twin.fit import (
    SPEED,
    Data,
    Normal,
    Point,
    Prior,
    maximise,
)
from acoustube.inversion.twin.model import (
    NOMINAL_FREQUENCY,
    NOMINAL_RADIUS,
    SHARED,
    EchoModel,
)
from acoustube.inversion.twin.noise import score_of, with_variances
from acoustube.inversion.twin.posterior import Posterior, posterior, with_scatter
from acoustube.inversion.twin.recorded import LEAST_CLIPPED, Band, Group, Means, band_of, mean_of
from acoustube.inversion.twin.starts import best_start
from acoustube.waves.scattering import Complex

PRIORS = {
    "log_radius": (0.0, 0.2), "temperature_offset": (0.0, 4.0), "temperature_gradient": (0.0, 1.0),
    "log_loss": (0.0, 0.003), "log_resonance": (0.0, 0.2), "log_quality": (log(14.0), 1.0),
    "log_drive_frequency": (0.0, 0.1), "drive_cycles": (13.0, 8.0), "log_gain": (7.0, 5.0),
    "trigger": (0.0, 2e-4), "face_real": (0.3, 0.3), "face_imag": (0.0, 0.2),
} | {name: (0.0, 0.01) for name in SHARED if name[-1] in "123"}  # fmt: skip
"""Prior mean and standard deviation of each parameter of :data:`SHARED`. The means of the resonance
and of the drive's frequency are replaced by the received carrier. The standard deviation of the
losses has two causes: the viscosity of air, to whose square root they are proportional, is known to
0.5 %, and theories of the losses differ by 0.2 %. It holds at the assumed humidity: an absorption
in the air that is higher by a tenth raises the losses by 1 %."""
MODEL_ERRORS = {"temperature_offset": 0.05, "log_resonance": 2e-5, "log_quality": 2e-4}
"""Standard deviations of parameters of :data:`SHARED` due to effects that the model leaves out and
that do not decrease with the number of closures: clutter that neighbouring closures share, and the
resolution of the thermometer."""
FIRST_PLACEMENT, FIRST_LEVEL, PHASE = 3e-3, 0.1, 1e3
"""Prior standard deviations of a closure's position in m, of its log level and of its phase in rad,
in the first fit."""
WINDOW = (-0.3e-3, 2.0e-3)
"""Start and end of the data used of an echo, in s from its arrival at the nominal sound speed."""
SLACK = 0.01
"""Fraction of the time of flight by which an echo may arrive earlier or later."""
LEAST_ECHO = 0.5
"""Least fraction of the energy of a closure's echo that the model must explain."""
WEAKEST = 4.0
"""Least peak in counts of an echo that is used, if it is rounded without dither."""
DITHERED = 0.4
"""Standard deviation of noise in counts above which rounding is linear on average."""
OUTLYING, LEAST_OUTLYING = 8.0, 6e-3
"""Error of a stated position, in standard deviations and in m, above both of which it counts as
wrong."""
BEYOND_END = 0.02
"""Distance in m by which a closure's label may exceed the stated length: the position of a plug in
the far end may be that of either of its faces."""
FEWEST = 2
"""Least number of different places at which the tube has to be closed."""
ROUNDS = 3
"""Number of fits, before each of which the variances of the noise are estimated from residuals."""


@dataclass(frozen=True, eq=False)
class Twin:
    """Sensor fitted to recordings of closures: parameters, their posterior, and the data used.

    Attributes
    ----------
    band : Band
    model : EchoModel
        Model of the closures that are used.
    data : Data
        Recordings of these closures.
    point : Point
        Maximum of the posterior.
    posterior : Posterior
    prior : Prior
    used : list of int
        Indices of the closed groups that are used.
    left_out : dict
        Reasons why closed groups are left out, by index of the group.
    means : list of Means
        Means of all closed groups.
    untouched : Means
        Mean of the untouched cycles.
    """

    band: Band
    model: EchoModel
    data: Data
    point: Point
    posterior: Posterior
    prior: Prior
    used: list[int]
    left_out: dict[int, str]
    means: list[Means]
    untouched: Means

    def value(self, name: str) -> float:
        """Return the posterior mean of a parameter of :data:`SHARED`."""
        return float(self.posterior.mean[SHARED.index(name)])

    def deviation(self, name: str) -> float:
        """Return the posterior standard deviation of a parameter of :data:`SHARED`."""
        i = SHARED.index(name)
        return float(np.sqrt(self.posterior.covariance[i, i]))

    @property
    def explained(self) -> Array:
        """Fraction of the energy of each used closure's echo that the model explains, (n,)."""
        inside = self.data.segments == 1
        left = np.abs(self.data.values - self.model(*self.point).value) ** 2
        return 1 - _sums(left, inside) / _sums(np.abs(self.data.values) ** 2, inside)


@checked(
    closed=Several(Group, 1), untouched=Group, rate=RATE, start=SECONDS, length=Optional(LENGTH),
    humidity=Optional(Number(0, 100, "%")),
)  # fmt: skip
def fit_twin(
    closed: Sequence[Group],
    untouched: Group,
    rate: float,
    start: float = 0.0,
    *,
    length: float | None = None,
    humidity: float | None = None,
    show: Callable[[str, float], None] = ignore,
) -> Twin:
    """Return the sensor estimated from recordings of the closed and of the untouched tube.

    Parameters
    ----------
    closed : sequence of Group
        Cycles of the tube closed at a known place, one group for each closure.
    untouched : Group
        Cycles without contact.
    rate : float
        Samples per second.
    start : float
        Time of the first sample in s from the start of the drive.
    length : float, optional
        Length of the tube in m, by default the distance of the farthest closure. The temperature,
        which varies linearly along the tube, is estimated at half this length.
    humidity : float, optional
        Relative humidity of the air in per cent. The estimated temperature is then that of moist
        air; by default it is that at which dry air has the estimated speed of sound.
    show : callable
        Called with the name of a stage and its finished fraction.

    Raises
    ------
    ConfigError
        If a closure lies beyond the end of the tube, or closures at fewer than two places can be
        used (the message gives the first reason). Also as
        :func:`acoustube.inversion.twin.recorded.band_of`.
    """
    _check_places(closed, length)
    band = band_of(closed, untouched.cycles, rate, start)
    free, means, left_out = mean_of(band, untouched.cycles), [], {}
    quiet = np.asarray(untouched.cycles, float).mean(axis=0)
    near = band.spectra(quiet, band.before_ring_end())
    extremes = [(float(g.cycles.min()), float(g.cycles.max())) for g in (untouched, *closed)]
    rails = min(low for low, _ in extremes), max(high for _, high in extremes)
    for i, group in enumerate(closed):
        show("reading the echoes", i / len(closed))
        means.append(mean_of(band, group.cycles))
        if reason := _unusable(band, group, means[-1].spectrum - near, rails):
            left_out[i] = reason
    used = [i for i in range(len(closed)) if i not in left_out]
    values = band.baseband(np.array([means[i].spectrum - near for i in range(len(closed))]))
    places = np.array([group.place for group in closed])
    middle = (length or float(np.max(places[used], initial=0.0))) / 2
    best: Twin | None = None
    temperatures = np.array([group.temperature for group in closed])
    for filtered in (True,) if band.frequency[-1] < 0.4 * rate else (True, False):
        model = EchoModel(band, places, temperatures, middle, filtered, humidity)
        with threadpool_limits(1, user_api="blas"):  # the matrices are small
            found = _fitted(model, values, used, dict(left_out), means, free, closed, show)
        if best is None or found.explained.mean() > best.explained.mean():
            best = found
    assert best is not None
    return best


def _check_places(closed: Sequence[Group], length: float | None) -> None:
    """Raise if a closure lies beyond the end of a tube of a stated length in m."""
    for group in closed:
        if length is not None and group.place > length + BEYOND_END:
            raise ConfigError(
                f"{group.source}: the closure at {CM * group.place:.4g} cm lies beyond the end of "
                f"the tube, at {CM * length:.4g} cm; correct its label or the stated length"
            )


def _fitted(
    model: EchoModel,
    values: Complex,
    used: list[int],
    left_out: dict[int, str],
    means: list[Means],
    free: Means,
    closed: Sequence[Group],
    show: Callable[[str, float], None],
) -> Twin:
    """Return the sensor fitted by one model to all closures except those that it cannot explain."""
    band, prior = model.band, _first_prior(model.band, len(values))
    floors = np.array([one.variance for one in means]) + _rounding(closed, band)
    while True:
        _check_enough(used, closed, left_out)
        part = np.array(used)
        own = replace(model, places=model.places[part], temperatures=model.temperatures[part])
        data = _windowed(own, values[part], floors[part])
        mine = replace(prior, local=prior.local[part])
        start = best_start(own, data, mine, lambda done: show("fitting the echoes", done / 2))
        data, point, normal = _refined(own, data, mine, start, floors[part], show)
        wrong = _wrong(own, data, point)
        if not wrong:
            break
        left_out |= {used[i]: reason for i, reason in wrong.items()}
        used = [i for i in used if i not in left_out]
    levels = _quantised_levels(closed, data, part)
    found = posterior(normal, mine, point, levels, score_of(own, data, point))
    floor = np.array([MODEL_ERRORS.get(name, 0.0) for name in SHARED])
    found = found._replace(covariance=found.covariance + np.diag(floor**2))
    return Twin(band, own, data, point, found, mine, used, left_out, means, free)


def _refined(
    model: EchoModel,
    data: Data,
    prior: Prior,
    point: Point,
    floors: Array,
    show: Callable[[str, float], None],
) -> tuple[Data, Point, Normal]:
    """Return data with variances from residuals, the posterior's maximum and normal equations."""
    normal = None
    for i in range(ROUNDS):
        show("fitting the echoes", 0.5 + 0.5 * i / ROUNDS)
        if i > 0:
            prior = with_scatter(prior, 2e-3, 0.05, 0.01)
        data = with_variances(model, data, prior, point, floors)
        point, normal, _ = maximise(model, data, prior, point)
    assert normal is not None
    return data, point, normal


def _first_prior(band: Band, n: int) -> Prior:
    mean, deviation = (np.array([PRIORS[name][k] for name in SHARED]) for k in (0, 1))
    for name in ("log_resonance", "log_drive_frequency"):
        mean[SHARED.index(name)] = log(band.carrier / NOMINAL_FREQUENCY)
    local = np.tile([FIRST_PLACEMENT, FIRST_LEVEL, PHASE], (n, 1))
    return Prior(mean, deviation, local)


def _windowed(model: EchoModel, values: Complex, floors: Array) -> Data:
    """Return basebands (n, n_t) with segments about the echoes and their repetitions.

    The variances are 1e-3 of the mean power in a segment plus the white noise `floors`, (n,).
    """
    time, band = model.band.time, model.band
    segments = np.zeros(values.shape, int)
    for number in (2, 1):
        flight = (number * 2 / SPEED * model.places)[:, None]
        inside = (time >= (1 - SLACK) * flight + WINDOW[0]) & (
            time <= (1 + SLACK) * flight + WINDOW[1]
        )
        segments[inside & (time >= band.first) & (time <= band.last)] = number
    sizes = [_sums(np.abs(values) ** 2, segments == k) for k in (1, 2)]
    counts = [np.maximum((segments == k).sum(axis=1), 1) for k in (1, 2)]
    variances = np.stack([1e-3 * s / c + floors for s, c in zip(sizes, counts, strict=True)], 1)
    return Data(values, segments, variances, np.zeros_like(variances))


def _rounding(closed: Sequence[Group], band: Band) -> Array:
    """Return the variance in counts squared that rounding adds to means in the baseband, (n,)."""
    return np.where([_distorted(group) for group in closed], band.white / 12, 0.0)


def _quantised_levels(closed: Sequence[Group], data: Data, part: Array) -> Array:
    """Return the standard deviations of log levels due to rounding, 0 if noise dithers it, (n,)."""
    peaks = np.where(data.segments == 1, np.abs(data.values), 0).max(axis=1)
    rounded = [_distorted(closed[i]) for i in part]
    return np.where(rounded, 0.3 * np.maximum(peaks, 1.0) ** -1.5, 0.0)


def _distorted(group: Group) -> bool:
    """Return whether cycles are rounded to integers without noise that makes rounding linear."""
    noise = float(np.std(np.asarray(group.cycles[:32, -64:], float), axis=0).mean())
    return bool(np.issubdtype(group.cycles.dtype, np.integer)) and noise < DITHERED


def _unusable(band: Band, group: Group, spectrum: Complex, rails: tuple[float, float]) -> str:
    """Return why a closure cannot be used, or an empty string if it can be.

    `spectrum` is that of the closure's mean in counts s, (n_f,), less the ring-down. `rails` are
    the smallest and the largest count of all cycles.
    """
    flight = 2 * group.place / SPEED
    if not np.isfinite(group.place) or group.place <= 0:
        return f"its stated distance is {CM * group.place:g} cm"
    if (1 - SLACK) * flight < band.first:
        return (
            f"its echo arrives within the ring-down, which lasts {MS * band.first:.2g} ms; close "
            f"the tube at {CM * (0.5 * SPEED * band.first + 0.02):.0f} cm or farther"
        )
    if flight + 0.8e-3 > band.last:
        return (
            "its echo arrives after the end of the cycle; correct the label, or the cycle's length"
        )
    inside = (band.time > 0.99 * flight - 0.1e-3) & (band.time < 1.01 * flight + 1.5e-3)
    peak = float(np.abs(band.baseband(spectrum))[inside].max())
    if peak < WEAKEST and _distorted(group):
        return f"its echo has a peak of {peak:.1f} counts, which rounding distorts; raise the gain"
    begin = int((0.99 * flight - band.start) * band.rate)
    echo = np.asarray(group.cycles, float)[:, begin : begin + int(1.5e-3 * band.rate)]
    clipped = np.sum((echo >= rails[1]) | (echo <= rails[0]), axis=1)
    if np.median(clipped) >= LEAST_CLIPPED:
        return "its echo is clipped; lower the gain"
    return ""


def _wrong(model: EchoModel, data: Data, point: Point) -> dict[int, str]:
    """Return the closures, by index, that the model cannot explain, and why.

    These are all closures without an echo, or else the one with the most outlying position.
    """
    inside = data.segments == 1
    left = _sums(np.abs(data.values - model(*point).value) ** 2, inside)
    share = 1 - left / np.maximum(_sums(np.abs(data.values) ** 2, inside), 1e-300)
    if np.any(share < LEAST_ECHO):
        return {
            int(i): "there is no echo of a closure at its stated distance; check the label"
            for i in np.flatnonzero(share < LEAST_ECHO)
        }
    error = point.local[:, 0] - np.median(point.local[:, 0])
    error = _line_removed(model.places, error)
    scatter = max(1.48 * float(np.median(np.abs(error))), LEAST_OUTLYING / OUTLYING)
    far = np.flatnonzero(np.abs(error) > OUTLYING * scatter)
    if len(error) < 5 or not far.size:
        return {}
    worst = int(far[np.argmax(np.abs(error[far]))])
    return {
        worst: f"its echo comes from {CM * (model.places[worst] + error[worst]):.1f} cm according "
        "to all other closures; check the label"
    }


def _line_removed(places: Array, error: Array) -> Array:
    """Return the errors of positions (n,) minus the line fitted by least absolute deviations."""
    design = np.stack([np.ones_like(places), places], axis=1)
    weight = np.ones_like(places)
    left = error
    for _ in range(20):
        fitted = np.linalg.lstsq(design * weight[:, None], error * weight, rcond=None)[0]
        left = error - design @ fitted
        weight = 1 / np.sqrt(np.maximum(np.abs(left), 1e-5))
    return np.asarray(left)


def _check_enough(used: list[int], closed: Sequence[Group], left_out: dict[int, str]) -> None:
    """Raise unless there are closures at two places or more."""
    if len({round(closed[i].place, 3) for i in used}) >= FEWEST:
        return
    first = next(iter(left_out), None)
    if first is None:
        reason = f"{closed[used[0]].source}: all are at one place"
    else:
        group = closed[first]
        reason = f"{group.source}, at {CM * group.place:.1f} cm: {left_out[first]}"
    raise ConfigError(
        f"{len(used)} of {len(closed)} closures can be used ({reason}), and at least {FEWEST} "
        "places are needed; record the tube closed at five or more"
    )


def _sums(values: Array, inside: Array) -> Array:
    return np.asarray(np.where(inside, values, 0).sum(axis=1))


def radius(twin: Twin) -> tuple[float, float]:
    """Return the radius of the bore in m and its standard deviation."""
    value = NOMINAL_RADIUS * float(np.exp(twin.value("log_radius")))
    return value, value * twin.deviation("log_radius")
