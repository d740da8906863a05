"""Other maxima of the likelihood: at other depths, and half wavelengths from likely maxima.

Where the reflection rises and falls again with depth, as near closure of the lumen, two depths that
differ by millimetres may have nearly the same echo.
"""

from __future__ import annotations

import numpy as np

from acoustube.base.types import Array
from acoustube.inversion.fit import Fits, alike, distinct, maximise
from acoustube.inversion.model import ForwardModel
from acoustube.inversion.whitening import Weights
from acoustube.waves.scattering import Complex

STEP = 0.4e-3
"""Step in m between the depths that are tried."""
ITERATIONS, TRIED = 8, 2
"""Iterations from each starting point, fewer if :func:`acoustube.inversion.fit.maximise` gives it
up; and those of them after which a depth is given up whose cost exceeds that of a neighbouring one.
"""
JOINT = -3, -2, -1, 1, 2, 3
"""Shifts in half wavelengths by which other maxima are sought: of all presses together, and of each
press in turn where one has another depth."""
UNLIKELY, FARTHER = 8.0, 4
"""Excess of the cost (minus twice the log likelihood) over the least, below which a maximum is
likely, and number of half wavelengths tried beyond a likely maximum far from the best."""


def other_depths(model: ForwardModel, known: Fits, tools: tuple[int, ...], samples: Complex,
                 whiten: Weights) -> Fits:  # fmt: skip
    """Return maxima of the likelihood that are found from other depths of each press.

    The depths tried are more than :data:`STEP` from that of the best fit; if the tool has no such
    depth, they are the ends of its range. All other parameters start at those of the best fit.
    After :data:`TRIED` iterations those are followed whose cost is at most that of both
    neighbouring depths; the others descend to the same maxima. Depths that have come to the best
    fit, and are no better, do not count as neighbours; if all have, the best fit is returned.

    Parameters
    ----------
    model : ForwardModel
    known : Fits
        Fits of the hypothesis, the best one first.
    tools : tuple of int
        Index of the tool of each press in the model's tables.
    samples : ndarray
        Baseband of the cycles, (n_time,).
    whiten : Weights
    """
    starts = []
    for i, tool in enumerate(tools):
        low, high = model.tables[tool].range
        depths = np.linspace(low, high, 2 + int((high - low) / STEP))
        far = np.abs(depths - known.parameters[0, 2 * i + 1]) > STEP
        if not far.any():
            depths, far = np.array([low, high]), np.ones(2, bool)
        start = np.repeat(known.parameters[:1], far.sum(), axis=0)
        start[:, 2 * i + 1] = depths[far]
        tried = maximise(model, tools, start, samples, whiten, TRIED, known, unfinished=np.inf)
        arrived = alike(tried.parameters, known.parameters[:1], known.information[:1])[:, 0]
        arrived &= tried.cost >= known.cost[0]
        cost = np.full(len(depths) + 2, np.inf)  # also at the depths near that of the best fit
        cost[1:-1][far] = np.where(arrived, np.inf, tried.cost)
        lower = ((cost[1:-1] <= cost[:-2]) & (cost[1:-1] <= cost[2:]))[far]
        starts.append(np.unique(tried.parameters[lower & ~arrived], axis=0))
    followed = np.concatenate(starts)
    if not len(followed):
        return known.first(1)
    return maximise(model, tools, followed, samples, whiten, ITERATIONS - TRIED, known)


def beside(model: ForwardModel, known: Fits, tools: tuple[int, ...], others: Fits,
           samples: Complex, whiten: Weights) -> Fits:  # fmt: skip
    """Return fits at other depths, and maxima half wavelengths from those that are likely.

    The parameters are those of :func:`other_depths`, and `others` its result.
    """
    m = len(tools)
    found = distinct(others, m)
    off = np.abs((found.parameters - known.parameters[0])[:, 1 : 2 * m : 2]).max(axis=1)
    likely = np.flatnonzero((off > STEP) & (found.cost < known.cost[0] + UNLIKELY))
    if not len(likely):
        return others
    starts = np.repeat(found.parameters[likely], m * len(JOINT), axis=0)
    moves = np.kron(np.eye(m), np.array(JOINT)[:, None])  # one press at a time
    starts[:, : 2 * m : 2] += model.base.half_wavelength * np.tile(moves, (len(likely), 1))
    return others.and_those(maximise(model, tools, starts, samples, whiten, ITERATIONS, known))


def farther(model: ForwardModel, fits: Fits, tools: tuple[int, ...], samples: Complex,
            whiten: Weights) -> Fits:  # fmt: skip
    """Return fits, and maxima beyond likely ones more than 2.5 half wavelengths from the best.

    `fits` are all maxima found, the best first; for the other parameters see
    :func:`other_depths`.
    """
    likely, half = fits.cost < fits.cost[0] + UNLIKELY, model.base.half_wavelength
    m, starts = len(tools), list[Array]()
    for i in range(m):
        places = fits.parameters[likely, 2 * i]
        for end, sign in ((np.argmin(places), -1), (np.argmax(places), 1)):
            if abs(places[end] - fits.parameters[0, 2 * i]) > 2.5 * half:
                start = np.repeat(fits.parameters[likely][[end]], FARTHER, axis=0)
                start[:, 2 * i] += sign * half * np.arange(1, FARTHER + 1)
                starts.append(start)
    if not starts:
        return fits
    found = maximise(model, tools, np.concatenate(starts), samples, whiten, ITERATIONS)
    return distinct(fits.and_those(found), m)
