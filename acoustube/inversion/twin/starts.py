"""Starting values of a sensor's fit, and the best of the maxima that are reached from them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from itertools import product
from math import exp, log

import numpy as np

from acoustube.air import ABSOLUTE_ZERO
from acoustube.base.types import Array
from acoustube.inversion.twin.fit import SPEED, Data, Point, Prior, maximise
from acoustube.inversion.twin.model import LOCAL, NOMINAL_FREQUENCY, SHARED, EchoModel
from acoustube.inversion.twin.recorded import Band
from acoustube.waves.scattering import Complex

COMMON = [SHARED.index(name) for name in ("trigger", "temperature_offset")]
"""Indices in :data:`acoustube.inversion.twin.model.SHARED` of the parameters that delay all echoes,
equally or in proportion to their distance."""
REWEIGHTED = 5
"""Number of least-squares fits of the parameters in :data:`COMMON`, with weights such that the last
ones minimise absolute deviations."""
QUALITY_FACTORS = (5.0, 10.0, 20.0, 40.0)
DRIVE_CYCLES = (4.0, 7.0, 10.0, 13.0, 16.0, 19.0, 22.0, 25.0)
DETUNED = (-0.06, -0.04, -0.02, 0.0, 0.02, 0.04, 0.06)
"""Starting values of the quality factor, of the number of the drive's periods, and of the logarithm
of the resonance over the received carrier."""
WHOLE_CYCLES, HALF_CYCLES = (-1.0, 0.0, 1.0), (-0.5, 0.5)
"""Changes of the burst's length in periods with which the fit is started again: first from each
starting point, then from the best maxima."""
BEST, ROUNDS = 3, 2
"""Number of the best maxima from which the fit is started again with bursts of other lengths, and
number of rounds in which this is done."""
SHARPER = 30.0
"""Factor by which the variances of the noise are reduced before the best maximum is chosen."""
WRAPS = (-0.5, 0.0, 0.5)
"""Delays of the drive, in periods, with which the fit of echoes and their repetitions starts."""
SEARCHED, SEARCH_STEP = 0.4e-3, 4e-6
"""Half range and step in s of the delays at which the echo of a closure is sought."""
SEARCH_CLOSURES, SEARCH_ITERATIONS = 6, 20
"""Number of closures used in the search for the best maximum, and number of iterations from each
starting point."""


def start_points(model: EchoModel, data: Data, prior: Prior) -> list[Point]:
    """Return starting points: for each burst length the transducer that fits the data best.

    Parameters
    ----------
    model : EchoModel
    data : Data
    prior : Prior
        Its mean is the starting value of the other parameters, except the gain, which is fitted.

    Notes
    -----
    The fit is judged by the correlation of modelled with recorded echoes, at the delay of each
    closure at which its magnitude is largest. This magnitude does not depend on the carrier's
    phase, which is ambiguous by half wavelengths. What the delays have in common is due to the
    trigger and the temperature, the rest to displacements.
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
        points.append(_placed(model, data, prior, shared))
    return points


def _placed(model: EchoModel, data: Data, prior: Prior, shared: Array) -> Point:
    """Return parameters with the delays, levels and phases of the closures that fit best."""
    delays, _ = _delays(model, data, shared)
    common, left = _common(model, prior, shared, delays)
    shared, local = shared.copy(), np.zeros((len(delays), len(LOCAL)))
    shared[COMMON] += common
    local[:, 0] = 0.5 * SPEED * left
    return _levelled(model, data, Point(shared, local))


def _common(model: EchoModel, prior: Prior, shared: Array, delays: Array) -> tuple[Array, Array]:
    """Return the changes of :data:`COMMON` that explain delays (n,) best, and the residual delays.

    The delays are in s, and `shared` are the parameters for which they were found. The prior limits
    the changed parameters. Large residuals, as of wrong labels, enter the cost linearly.
    """
    away = (prior.mean - shared)[COMMON]
    air = float(model.temperatures.mean()) - ABSOLUTE_ZERO
    design = np.stack([np.ones_like(delays), -model.places / (SPEED * air)], axis=1)
    precision = np.diag(prior.deviation[COMMON] ** -2.0)
    scale = 2 / SPEED * prior.local[:, 0]
    weight = scale**-2.0
    found: Array = np.zeros(len(COMMON))
    for _ in range(REWEIGHTED):
        weighted = design.T * weight
        right = weighted @ delays + precision @ away
        found = np.asarray(np.linalg.solve(weighted @ design + precision, right), float)
        weight = 1 / (scale * np.maximum(np.abs(delays - design @ found), scale))
    return found, delays - design @ found


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
    """Return parameters with the gain, and the levels and phases of closures, that fit best."""
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
    there = _placed(model, first, prior, maxima[cycles][1].shared)
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
    """Return a starting point with a burst longer by `step` periods, with its middle unchanged.

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
