"""Limit of detection: the least depth at which a further press along the tube is detected.

Behind a deep press little sound arrives, and an error of the model of its echo hides fainter
echoes. A press that is not detected is either absent or shallower than this limit. Detection is
decided by the evidence with its prior odds, not by a rate of false positives.

References
----------
* Limit of detection: Currie, L. A. (1968). Analytical Chemistry 40, 586-593.
  doi:10.1021/ac60259a007
* Evidence by Laplace's approximation: see :mod:`acoustube.inversion.fit`.
"""

from __future__ import annotations

from collections.abc import Callable
from math import log, pi
from typing import NamedTuple

import numpy as np

from acoustube.base.types import Array
from acoustube.inversion.doubt import doubt_weights
from acoustube.inversion.hypotheses import Hypothesis
from acoustube.inversion.model import NUISANCES, ForwardModel
from acoustube.inversion.parameters import CLOSEST, cost_of_press, split
from acoustube.inversion.whitening import Weights
from acoustube.waves.scattering import Complex

STEP = 0.5e-3
"""Spacing in m of the depths that are tried; the evidence is interpolated between them."""
ALONG = 0.013
"""Spacing in m of positions along the tube. Each is given the largest limit of itself and its two
neighbours. Behind a press the modes beat over 2 and 4 cm; at the three positions the beats have
phases 110 to 130 degrees apart."""
NORMAL_QUANTILE = 1.28
"""Margin of a press at the limit, in standard deviations of the deviance that it explains: its
probability of detection is then 0.9 if errors are normal with the covariance of the weights."""


def detection_limit(
    model: ForwardModel, known: Hypothesis, noise: float, tool: int, places: Array
) -> Array:
    """Return the limits of detection: the least depths at which a further press is detected.

    Parameters
    ----------
    model : ForwardModel
    known : Hypothesis
        The detected presses, none or more.
    noise : float
        Variance of a sample of the mean of cycles, in counts squared.
    tool : int
        Number in the library, from 0, of the tool of the further press.
    places : ndarray
        Distances from the face in m, (n,).

    Returns
    -------
    ndarray
        Depths in m, (n,): inf where the deepest press of the library would not be detected, and the
        shallowest depth of the library, an upper bound, where all presses would be. nan closer than
        :data:`.CLOSEST` to a detected press, and outside the span of the model.

    Notes
    -----
    A change of the known parameters could explain a part of the echo that a further press adds.
    This part is subtracted, at the least favourable phase. The squared norm of the rest, with the
    weights of :mod:`acoustube.inversion.doubt`, is the deviance that the press explains. The press
    is detected where this deviance, less :data:`NORMAL_QUANTILE` of its standard deviations,
    exceeds the cost of its prior odds and of its two parameters. Where the reflection falls again
    with depth, the limit is the depth beyond which all are detected.
    """
    table = model.tables[tool]
    depths = np.linspace(*table.range, 2 + int(np.diff(table.range)[0] / STEP))
    own, _, _ = split(known.best[None])
    found = np.full(len(places), np.nan)
    apart = np.abs(places[:, None] - own).min(axis=1, initial=np.inf) > CLOSEST
    apart &= (places >= model.span[0]) & (places <= model.span[1])
    state = _linearised(model, known, noise)
    for i in np.flatnonzero(apart):
        surplus = _surplus(model, state, (tool, float(places[i])), depths)
        found[i] = _limit(depths, surplus)
    return found


class _Known(NamedTuple):
    """Model of the detected presses, linearised about their best fit.

    Attributes
    ----------
    tools : tuple of int
        Number of the tool of each press.
    parameters : ndarray
        Parameter vector of the fit, (1, n_parameters).
    whiten : Weights
        Weights with which a further press is judged.
    value : ndarray
        Baseband of the model in counts, (1, n_time).
    slopes : ndarray
        Derivatives of `value` by the parameters, whitened, (1, n_parameters, n_time).
    information : ndarray
        Half the Hessian of the cost of :class:`acoustube.inversion.fit.Fits`,
        (n_parameters, n_parameters).
    """

    tools: tuple[int, ...]
    parameters: Array
    whiten: Weights
    value: Complex
    slopes: Complex
    information: Array


def _linearised(model: ForwardModel, known: Hypothesis, noise: float) -> _Known:
    whiten = doubt_weights(model, known, noise, known) if known.tools else known.whiten
    parameters = known.best[None]
    value, slopes = model.baseband(known.tools, *split(parameters))
    slopes = whiten(slopes)
    return _Known(known.tools, parameters, whiten, value, slopes, _information(model, slopes)[0])


def limits_along(limit: Callable[[Array], Array], span: tuple[float, float]) -> tuple[Array, Array]:
    """Return positions, each with the largest limit of detection of itself and its neighbours.

    Parameters
    ----------
    limit : callable
        Takes positions in m and returns the limits of detection there in m, both (n,).
    span : (float, float)
        Nearest and farthest position in m.

    Returns
    -------
    places : ndarray
        Multiples of :data:`ALONG` in m, (n,).
    depths : ndarray
        Limits in m, (n,); nan where there is no limit at the position itself.
    """
    places = ALONG * np.arange(np.ceil(span[0] / ALONG), np.floor(span[1] / ALONG) + 1)
    depths = limit(places)
    padded = np.pad(depths, 1, constant_values=np.nan)
    worst = np.fmax(np.fmax(padded[:-2], padded[1:-1]), padded[2:])
    return places, np.where(np.isnan(depths), np.nan, worst)


def _surplus(model: ForwardModel, known: _Known, press: tuple[int, float], depths: Array) -> Array:
    """Return the deviance that a further press explains, less its cost, at depths in m, (n,).

    The margin of :data:`NORMAL_QUANTILE` standard deviations is subtracted too. `press` is the
    number of the tool, and the position in m.
    """
    tool, place = press
    own, deep, nuisances = (np.repeat(one, len(depths), 0) for one in split(known.parameters))
    rank = int(np.searchsorted(own[0], place))
    tools = (*known.tools[:rank], tool, *known.tools[rank:])
    given = np.insert(own, rank, place, axis=1), np.insert(deep, rank, depths, axis=1), nuisances
    value, slopes = model.baseband(tools, *given)
    change = known.whiten(value - known.value)
    explained = 2 * np.sum(np.abs(change) ** 2, axis=1)
    toward = 2 * (known.slopes.conj() @ change[:, :, None])[..., 0]
    explained -= _absorbed(known.information, toward)
    length, span = model.span[1] - model.span[0], float(np.diff(model.tables[tool].range)[0])
    cost = np.linalg.slogdet(_information(model, known.whiten(slopes)))[1]
    cost -= np.linalg.slogdet(known.information)[1]
    cost += 2 * log(length * span) - 2 * log(2 * pi)
    # A press without an echo leaves its position and depth open, which is no evidence for it.
    cost = np.maximum(cost, 0.0) + cost_of_press(len(tools))
    explained = np.maximum(explained, 0.0)
    return np.asarray(explained - NORMAL_QUANTILE * 2 * np.sqrt(explained) - cost)


def _absorbed(information: Array, toward: Complex) -> Array:
    """Return the part of an echo's deviance that a change of the known parameters explains, (n,).

    The largest value over the phase of the echo is returned. This phase turns once when the
    position changes by half a wavelength.

    Parameters
    ----------
    information : ndarray
        Half the Hessian of the cost by the known parameters, (p, p).
    toward : ndarray
        Twice the products of the conjugate derivatives with the echo, both whitened, (n, p).
    """
    parts = np.stack([toward.real, toward.imag], axis=1)
    absorbed = parts @ np.linalg.solve(information, parts.swapaxes(1, 2))
    return np.asarray(np.linalg.eigvalsh(absorbed)[:, -1])


def _information(model: ForwardModel, slopes: Complex) -> Array:
    """Return half the Hessian of the cost, (n, p, p), from whitened derivatives (n, p, n_time)."""
    found = 2 * (slopes.conj() @ slopes.swapaxes(1, 2)).real
    own = np.arange(found.shape[1])[-len(NUISANCES) :]
    found[:, own, own] += 1 / model.priors.deviations**2
    return np.asarray(found)


def _limit(depths: Array, surplus: Array) -> float:
    """Return the depth in m beyond which the surplus stays positive, inf if there is none."""
    hidden = np.flatnonzero(~(surplus > 0))
    if not len(hidden):
        return float(depths[0])
    i = int(hidden[-1])
    if i == len(depths) - 1:
        return np.inf
    return float(np.interp(0.0, surplus[i : i + 2], depths[i : i + 2]))
