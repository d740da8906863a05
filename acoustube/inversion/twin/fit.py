"""Maximum of the posterior of a sensor's parameters, by Levenberg and Marquardt's method.

The parameters of each closure affect its own cycles alone. They are eliminated from the normal
equations (Schur complement), so that many closures cost little time.

References
----------
* Damped least squares: Marquardt, D. W. (1963). An algorithm for least-squares estimation of
  nonlinear parameters. Journal of the Society for Industrial and Applied Mathematics 11, 431-441.
  doi:10.1137/0111030
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from math import exp, log
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acoustube.base.types import Array
from acoustube.inversion.twin.model import LOCAL, NOMINAL_FREQUENCY, SHARED, EchoModel
from acoustube.inversion.twin.recorded import Band
from acoustube.waves.scattering import Complex

SPEED = 343.2
"""Nominal speed of sound in m/s."""
ITERATIONS, CONVERGED = 40, 1e-6
"""Largest number of steps, and decrease of the objective per step below which the fit ends. The
latter is multiplied by 1e-4 of the objective where that exceeds 1."""
FIRST_DAMPING, LEAST_DAMPING = 1e-2, 1e-9
"""Initial and least damping of the steps."""
QUALITY_FACTORS = (5.0, 10.0, 20.0, 40.0)
DRIVE_CYCLES = (4.0, 7.0, 10.0, 13.0, 16.0, 19.0, 22.0, 25.0)
DETUNED = (-0.06, -0.04, -0.02, 0.0, 0.02, 0.04, 0.06)
"""Starting values of the quality factor, of the number of the drive's periods, and of the logarithm
of the resonance over the received carrier."""
WHOLE_CYCLES, HALF_CYCLES = (-1.0, 0.0, 1.0), (-0.5, 0.5)
"""Changes of the burst's length in periods with which the fit is started again: first from each
starting point, then from the best maxima."""
BEST, ROUNDS = 3, 2
"""Number of the best maxima that are followed, and number of rounds in which they are."""
SHARPER = 30.0
"""Factor by which the variances are reduced before the best maximum is chosen."""
WRAPS = (-0.5, 0.0, 0.5)
"""Delays of the drive in periods from which the fit of echoes with their repetitions starts."""
SEARCHED, SEARCH_STEP = 0.4e-3, 4e-6
"""Half range and step in s of the delays at which the echo of a closure is sought."""
SEARCH_CLOSURES, SEARCH_ITERATIONS = 6, 20
"""Number of closures used in the search for the best maximum, and number of iterations from each
starting point."""


@dataclass(frozen=True, eq=False)
class Data:
    """Recorded closures in the baseband, and the variance of their noise.

    Attributes
    ----------
    values : ndarray
        Baseband in counts, (n, n_t).
    segments : ndarray of int
        Segment of each sample: 1 about the echo, 2 about its repetition, 0 elsewhere; (n, n_t).
    variances : ndarray
        Variances of the noise in segments 1 and 2, in counts squared, (n, 2).
    clutter : ndarray
        Power density of the clutter relative to that of the echo, in segments 1 and 2, (n, 2).
    """

    values: Complex
    segments: NDArray[np.int64]
    variances: Array
    clutter: Array

    @property
    def weights(self) -> Array:
        """Reciprocal variance of a sample's real and imaginary part, 0 if not used, (n, n_t)."""
        inverse = np.concatenate([np.zeros((len(self.variances), 1)), 2 / self.variances], axis=1)
        return np.asarray(np.take_along_axis(inverse, self.segments, axis=1))


@dataclass(frozen=True, eq=False)
class Prior:
    """Independent normal priors of the parameters of a sensor and of its closures.

    Attributes
    ----------
    mean, deviation : ndarray
        Means and standard deviations of the shared parameters, (n_shared,).
    local : ndarray
        Standard deviations of the parameters of each closure, (n, n_local); their means are 0.
    """

    mean: Array
    deviation: Array
    local: Array


class Point(NamedTuple):
    """Parameters of the sensor, (n_shared,), and of each closure, (n, n_local)."""

    shared: Array
    local: Array


class Normal(NamedTuple):
    """Normal equations of weighted least squares, without priors.

    Attributes
    ----------
    shared : ndarray
        Half the Gauss-Newton Hessian by the parameters of the sensor, (n_shared, n_shared).
    mixed : ndarray
        That by parameters of the sensor and of each closure, (n, n_shared, n_local).
    local : ndarray
        That by the parameters of each closure, (n, n_local, n_local).
    right_shared, right_local : ndarray
        Minus half the gradient by the parameters of the sensor, (n_shared,), and of each closure,
        (n, n_local).
    misfit : float
        Weighted sum of the squared residuals.
    """

    shared: Array
    mixed: Array
    local: Array
    right_shared: Array
    right_local: Array
    misfit: float


def normal_equations(model: EchoModel, data: Data, point: Point) -> Normal:
    """Return the normal equations of the data at a point."""
    echoes = model(*point)
    weights = data.weights
    left = data.values - echoes.value
    root = np.sqrt(weights)[:, None]

    def real(values: Complex) -> Array:
        scaled = values * root
        return np.concatenate([scaled.real, scaled.imag], axis=-1)

    js, jl = real(echoes.by_shared), real(echoes.by_local)
    r = real(left[:, None])[:, 0]
    return Normal(
        np.einsum("npt,nqt->pq", js, js, optimize=True),
        js @ jl.swapaxes(1, 2),
        jl @ jl.swapaxes(1, 2),
        np.einsum("npt,nt->p", js, r),
        (jl @ r[:, :, None])[:, :, 0],
        float(np.sum(r**2)),
    )


def solve(normal: Normal, prior: Prior, point: Point, damping: float) -> tuple[Array, Array]:
    """Return damped steps of the parameters of sensor, (n_shared,), and closures, (n, n_local)."""
    precision, local_precision = prior.deviation**-2.0, prior.local**-2.0
    a = normal.shared + np.diag(precision)
    c = normal.local + local_precision[:, :, None] * np.eye(normal.local.shape[1])
    b_s = normal.right_shared - precision * (point.shared - prior.mean)
    b_l = normal.right_local - local_precision * point.local
    a = a + damping * np.diag(np.diag(a))
    c = c + damping * c * np.eye(c.shape[1])
    inverse = np.linalg.inv(c)
    passed = normal.mixed @ inverse
    schur = a - np.einsum("npl,nql->pq", passed, normal.mixed, optimize=True)
    right = b_s - np.einsum("npl,nl->p", passed, b_l)
    scale = 1 / np.sqrt(np.diag(schur))
    step = scale * np.linalg.solve(schur * scale[:, None] * scale, scale * right)
    local = b_l - np.einsum("npl,p->nl", normal.mixed, step)
    return step, (inverse @ local[:, :, None])[:, :, 0]


def objective(misfit: float, prior: Prior, point: Point) -> float:
    """Return minus twice the logarithm of the posterior density, up to a constant."""
    shared = ((point.shared - prior.mean) / prior.deviation) ** 2
    return float(misfit + shared.sum() + ((point.local / prior.local) ** 2).sum())


def maximise(
    model: EchoModel, data: Data, prior: Prior, point: Point, iterations: int = ITERATIONS
) -> tuple[Point, Normal, float]:
    """Return the maximum of the posterior, and the normal equations and the objective there."""
    normal = normal_equations(model, data, point)
    value, damping = objective(normal.misfit, prior, point), FIRST_DAMPING
    for _ in range(iterations):
        step, local = solve(normal, prior, point, damping)
        trial = Point(*_bounded(point.shared + step, point.local + local))
        left = data.values - model.value(*trial)
        found = objective(float(np.sum(data.weights * np.abs(left) ** 2)), prior, trial)
        if not found < value:
            damping *= 8
            if damping > 1e8:
                break
            continue
        gained, point, value = value - found, trial, found
        normal = normal_equations(model, data, point)
        damping = max(damping / 6, LEAST_DAMPING)
        if gained < CONVERGED * max(1.0, 1e-4 * value):
            break
    return point, normal, value


def _bounded(shared: Array, local: Array) -> tuple[Array, Array]:
    """Clip parameters to the range in which the model is defined, in place; return them."""
    limits = {
        "log_radius": (log(0.3), log(4.0)), "temperature_offset": (-30.0, 30.0),
        "log_quality": (log(0.5), log(300.0)), "drive_cycles": (0.6, 100.0),
        "log_resonance": (log(0.2), log(5.0)), "log_drive_frequency": (log(0.2), log(5.0)),
        "face_real": (-0.9, 0.9), "face_imag": (-0.9, 0.9), "log_gain": (-30.0, 30.0),
        "trigger": (-2e-3, 2e-3), **{name: (-1.0, 1.0) for name in SHARED if name[-1] in "123"},
    }  # fmt: skip
    for name, (low, high) in limits.items():
        i = SHARED.index(name)
        shared[i] = min(max(shared[i], low), high)
    local[:, 0] = np.clip(local[:, 0], -0.2, 0.2)
    local[:, 1] = np.clip(local[:, 1], -4.0, 4.0)
    return shared, local


def start_points(model: EchoModel, data: Data, prior: Prior) -> list[Point]:
    """Return starting points: for each burst length the transducer whose echoes correlate best.

    Parameters
    ----------
    model : EchoModel
    data : Data
    prior : Prior
        Its mean is the starting value of the other parameters but the gain, which is fitted.

    Notes
    -----
    The delay of each closure is that at which the magnitude of the correlation is largest. This
    magnitude does not depend on the carrier's phase, which is ambiguous by half wavelengths.
    """
    base = log(model.band.carrier / NOMINAL_FREQUENCY)
    points = []
    for cycles in DRIVE_CYCLES:
        found: list[tuple[float, Array]] = []
        for detuned, quality, drive in product(DETUNED, QUALITY_FACTORS, (base, 0.0)):
            shared = prior.mean.copy()
            shared[SHARED.index("log_resonance")] = base + detuned
            shared[SHARED.index("log_quality")] = log(quality)
            shared[SHARED.index("drive_cycles")] = cycles
            shared[SHARED.index("log_drive_frequency")] = drive
            found.append((float(_delays(model, data, shared)[1].sum()), shared))
        _, shared = max(found, key=lambda one: one[0])
        points.append(_placed(model, data, shared))
    return points


def _placed(model: EchoModel, data: Data, shared: Array) -> Point:
    """Return a point with the displacements, levels and phases of the closures that fit best."""
    delays, _ = _delays(model, data, shared)
    local = np.zeros((len(delays), len(LOCAL)))
    local[:, 0] = 0.5 * SPEED * delays
    return _levelled(model, data, Point(shared.copy(), local))


def _delays(model: EchoModel, data: Data, shared: Array) -> tuple[Array, Array]:
    """Return the delays in s of the echoes relative to the model's, and explained fractions, (n,).

    The fractions are those of the echoes' energy that the delayed model explains.
    """
    values = model.value(shared, np.zeros((len(model.places), len(LOCAL))))
    heard = np.where(data.segments == 1, data.values, 0)
    # Both basebands begin at the same time, whose phase cancels in the product of their transforms.
    product = np.fft.fft(heard, axis=-1) * np.fft.fft(values, axis=-1).conj()
    size = np.abs(product @ _shifts(model.band))
    best = size.argmax(axis=1)
    total = np.sum(np.abs(heard) ** 2, axis=1) * np.sum(np.abs(values) ** 2, axis=1)
    n = heard.shape[1]
    return _delays_sought()[best], (size.max(axis=1) / n) ** 2 / np.maximum(total, 1e-300)


@lru_cache(maxsize=2)
def _shifts(band: Band) -> Complex:
    """Return the factors of spectra that shift echoes by the delays sought, (n_f, n_delays)."""
    return np.asarray(np.exp(2j * np.pi * np.outer(band.frequency, _delays_sought())))


def _delays_sought() -> Array:
    """Return the delays in s at which an echo is sought, (n_delays,)."""
    return np.arange(-SEARCHED, SEARCHED, SEARCH_STEP)


def _levelled(model: EchoModel, data: Data, point: Point) -> Point:
    """Return a point with the gain, and the levels and phases of closures, that fit best."""
    value = model.value(*point)
    heard = np.where(data.segments == 1, 1.0, 0.0)
    product = np.sum(heard * data.values * value.conj(), axis=1)
    level = product / np.maximum(np.sum(heard * np.abs(value) ** 2, axis=1), 1e-300)
    shared, local = point.shared.copy(), point.local.copy()
    gains = np.log(np.maximum(np.abs(level), 1e-12))
    shared[SHARED.index("log_gain")] += np.median(gains)
    local[:, 1] = np.clip(local[:, 1] + gains - np.median(gains), -1, 1)
    local[:, 2] += np.angle(level)
    return Point(shared, local)


def best_start(model: EchoModel, data: Data, prior: Prior, show: Callable[[float], None]) -> Point:
    """Return the best of the maxima that are reached from the starting points.

    `show` is called with the finished fraction.

    Notes
    -----
    Each number of periods of the burst has a maximum of its own. The best is chosen by the
    strongest closures alone, first with bursts longer or shorter by whole periods, then by half
    periods. In the last fits the number of periods is a free parameter.
    """
    energy = np.where(data.segments == 1, np.abs(data.values) ** 2, 0).sum(axis=1)
    few = np.argsort(-energy)[:SEARCH_CLOSURES]
    own = replace(model, places=model.places[few], temperatures=model.temperatures[few])
    first = replace(data, segments=np.where(data.segments == 1, 1, 0))
    seen = Data(data.values[few], first.segments[few], data.variances[few], data.clutter[few])
    mine = replace(prior, local=prior.local[few])
    maxima: dict[float, tuple[float, Point]] = {}

    def refine(start: Point | None) -> None:
        if start is None:
            return
        cycles = float(start.shared[SHARED.index("drive_cycles")])
        point, _, value = maximise(own, seen, _frozen(mine, cycles), start, SEARCH_ITERATIONS)
        if cycles not in maxima or value < maxima[cycles][0]:
            maxima[cycles] = value, point

    starts = start_points(own, seen, mine)
    for i, start in enumerate(starts):
        show(0.2 + 0.5 * i / len(starts))
        for step in WHOLE_CYCLES:
            refine(_other_burst(own, seen, mine, start, step))
    for _ in range(ROUNDS):
        for cycles in sorted(maxima, key=lambda one: maxima[one][0])[:BEST]:
            for step in HALF_CYCLES:
                refine(_other_burst(own, seen, mine, maxima[cycles][1], step))
    show(0.9)
    # With variances closer to the noise the wrong maxima are easier to distinguish.
    seen = replace(seen, variances=seen.variances / SHARPER)
    best = sorted(maxima, key=lambda one: maxima[one][0])[: BEST + 1]
    sharp = {
        cycles: maximise(own, seen, _frozen(mine, cycles), maxima[cycles][1], 40) for cycles in best
    }
    cycles = min(sharp, key=lambda one: sharp[one][2])
    maxima[cycles] = 0.0, sharp[cycles][0]
    there = _placed(model, first, maxima[cycles][1].shared)
    there, _, _ = maximise(model, first, _frozen(prior, cycles), there, 20)
    found = []
    for turns in WRAPS:
        point, _, value = maximise(model, data, prior, _later(there, turns), 25)
        found.append((value, turns, point))
    return min(found)[2]


def _later(point: Point, turns: float) -> Point:
    """Return a starting point with a later drive and closer closures, or the reverse.

    The drive is shifted by `turns` periods of the carrier, and the distances are changed such that
    the first echoes keep their delays. The phases of the repeated echoes change, so that the fit
    finds another reflection coefficient of the face.
    """
    shared, local = point.shared.copy(), point.local.copy()
    carrier = NOMINAL_FREQUENCY * exp(shared[SHARED.index("log_drive_frequency")])
    shared[SHARED.index("trigger")] += turns / carrier
    local[:, 0] -= 0.5 * SPEED * turns / carrier
    return Point(shared, local)


def _frozen(prior: Prior, cycles: float) -> Prior:
    """Return the prior with the number of the drive's periods fixed."""
    i = SHARED.index("drive_cycles")
    mean, deviation = prior.mean.copy(), prior.deviation.copy()
    mean[i], deviation[i] = cycles, 1e-3
    return replace(prior, mean=mean, deviation=deviation)


def _other_burst(
    model: EchoModel, data: Data, prior: Prior, point: Point, step: float
) -> Point | None:
    """Return a starting point with a burst longer by `step` periods, about the same middle.

    The length is rounded to half periods. None if the burst would be shorter than one period.
    """
    shared = point.shared.copy()
    cycles, trigger = (SHARED.index(name) for name in ("drive_cycles", "trigger"))
    longer = round(2 * shared[cycles]) / 2 + step
    if longer < 1:
        return None
    carrier = NOMINAL_FREQUENCY * exp(shared[SHARED.index("log_drive_frequency")])
    shared[trigger] -= 0.5 * (longer - shared[cycles]) / carrier
    shared[cycles] = longer
    for name in (n for n in SHARED if n[-1] in "123"):
        shared[SHARED.index(name)] = prior.mean[SHARED.index(name)]
    return _levelled(model, data, Point(shared, point.local.copy()))
