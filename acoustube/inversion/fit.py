"""Maxima of the likelihood of a cycle's baseband, from many starting points at once.

References
----------
* Damped least squares: Marquardt, D. W. (1963). Journal of the Society for Industrial and Applied
  Mathematics 11, 431-441. doi:10.1137/0111030
* Evidence by Laplace's approximation: MacKay, D. J. C. (2003). Information Theory, Inference, and
  Learning Algorithms. Cambridge University Press, chapter 27.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log, pi

import numpy as np
from numpy.typing import NDArray

from acoustube.base.types import Array, Index
from acoustube.inversion.model import NUISANCES, ForwardModel
from acoustube.inversion.parameters import bounded, limited, split
from acoustube.inversion.whitening import Weights
from acoustube.waves.scattering import Complex

CONVERGED = 0.02
"""Largest decrease of the cost of :class:`Fits` in one iteration at which a fit has converged."""
UNFINISHED = 1.0
"""Decrease of the cost in the last successful iteration above which a fit that has used up its
iterations has not reached a maximum."""
DAMPING, RAISED, LOWERED = 1e-2, 6.0, 5.0
"""Initial Levenberg-Marquardt damping, its factor after a step that does not lower the cost, and
its divisor otherwise."""
AT_ONCE = 16
"""Number of sets of parameters whose scattering is computed at once: some MB, which fit a cache."""
DISTINCT = 0.3e-3, 0.02e-3
"""Differences of place and depth in m below which two maxima count as one."""
SAME_MAXIMUM = 4.0
"""Squared Mahalanobis distance below which two maxima count as one, as they do within
:data:`DISTINCT`. While maxima are sought, this distance alone decides."""
PATIENCE, FAR_WORSE = 3, 1e3
"""Rule without a known maximum: after PATIENCE iterations, starting points are given up whose cost
exceeds the least by FAR_WORSE or more. This excess is halved with each further iteration."""
GIVEN_UP = 5e3, 2e3, 1e3, 500.0, 300.0
"""Excess of the cost over that of a known maximum at which a starting point is given up, before
each iteration. Of 2436 starting points that ended in other maxima, with a cost at most 300 above
that of the known one, this rule loses 7 %; the rule without a known maximum loses 47 %."""


@dataclass(frozen=True, eq=False)
class Fits:
    """Local maxima of the likelihood.

    Attributes
    ----------
    parameters : ndarray
        Place and depth in m of each press in turn, then the nuisance parameters,
        (n, 2 n_presses + 7).
    cost : ndarray
        Minus twice the logarithm of the likelihood times the prior of the nuisance parameters, up
        to a constant, (n,).
    information : ndarray
        Half the Hessian of the cost, (n, n_parameters, n_parameters).
    """

    parameters: Array
    cost: Array
    information: Array

    def sorted(self) -> Fits:
        """Return the fits, the best first."""
        return self.at(np.argsort(self.cost))

    def at(self, order: Index) -> Fits:
        """Return the fits at given indices."""
        return Fits(self.parameters[order], self.cost[order], self.information[order])

    def first(self, n: int) -> Fits:
        """Return the first n of the fits."""
        return Fits(self.parameters[:n], self.cost[:n], self.information[:n])

    def likely(self, excess: float) -> Fits:
        """Return the fits whose cost exceeds that of the first by less than `excess`."""
        return self.at(np.flatnonzero(self.cost < self.cost[0] + excess))

    def and_those(self, others: Fits) -> Fits:
        """Return the fits followed by others with the same number of presses."""
        return Fits(
            np.concatenate([self.parameters, others.parameters]),
            np.concatenate([self.cost, others.cost]),
            np.concatenate([self.information, others.information]),
        )


def maximise(
    model: ForwardModel,
    tools: tuple[int, ...],
    start: Array,
    samples: Complex,
    whiten: Weights,
    iterations: int = 12,
    known: Fits | None = None,
    unfinished: float = UNFINISHED,
) -> Fits:
    """Return a maximum of the likelihood next to each starting point, by Levenberg and Marquardt.

    The fits are in the order of the starting points. A starting point whose cost stays far above
    the least, or above that of a known maximum, or that comes to the known maximum, is given up:
    its last parameters are returned. One that comes within :data:`SAME_MAXIMUM` of a better one is
    given the maximum of the better one. A fit that has used up its iterations while its cost still
    falls is replaced by the known maximum, if that is better.

    Parameters
    ----------
    model : ForwardModel
    tools : tuple of int
        Number of the tool of each press.
    start : ndarray
        Parameters, (n, 2 n_presses + 7).
    samples : ndarray
        Baseband of the cycles in counts, (n_time,).
    whiten : Weights
    iterations : int
        Largest number of iterations.
    known : Fits, optional
        Maxima that are known already, the best first; only the best counts.
    unfinished : float
        Decrease of the cost in the last successful iteration above which a maximum has not been
        reached when the iterations are used up; infinite to return what has been reached.
    """
    at = bounded(model, tools, start)
    cost, gradient, information = _quadratic(model, tools, at, samples, whiten)
    damping, active = np.full(len(at), DAMPING), np.ones(len(at), bool)
    fallen = np.zeros(len(at))
    leader = np.arange(len(at))
    for number in range(iterations):
        if known is not None:
            active &= cost < known.cost[0] + GIVEN_UP[min(number, len(GIVEN_UP) - 1)]
            same = alike(at, known.parameters[:1], known.information[:1])[:, 0]
            active &= ~(same & (cost >= known.cost[0]))
        elif number >= PATIENCE:
            active &= cost < cost.min() + FAR_WORSE / 2 ** (number - PATIENCE)
        if number:  # at first, starting points may be close by chance
            _follow(leader, alike(at, at, information), cost)
            active &= leader == np.arange(len(at))
        i = np.flatnonzero(active)
        if not len(i):
            break
        diagonal = np.einsum("nii->ni", information[i])
        damped = information[i] + damping[i, None, None] * (
            diagonal[:, :, None] * np.eye(at.shape[1])
        )
        step = -np.linalg.solve(damped, gradient[i][..., None])[..., 0]
        tried = bounded(model, tools, at[i] + limited(step))
        new = _quadratic(model, tools, tried, samples, whiten)
        better = new[0] < cost[i]
        gain = np.where(better, cost[i] - new[0], np.inf)
        damping[i] = np.where(better, np.maximum(damping[i] / LOWERED, 1e-7), damping[i] * RAISED)
        j = i[better]
        at[j], cost[j] = tried[better], new[0][better]
        gradient[j], information[j] = new[1][better], new[2][better]
        fallen[j] = gain[better]
        active[i] = (gain > CONVERGED) & (damping[i] < 1e5)
    if known is not None:
        short = active & (fallen > unfinished) & (cost > known.cost[0])
        at[short], cost[short] = known.parameters[0], known.cost[0]
        information[short] = known.information[0]
    while np.any(leader[leader] != leader):  # a leader may follow another
        leader = leader[leader]
    return Fits(at[leader], cost[leader], information[leader])


def alike(one: Array, other: Array, information: Array) -> NDArray[np.bool_]:
    """Return whether parameters (n, p) and others (m, p) belong to one maximum, (n, m).

    `information` is half the Hessian of the cost at the others, (m, p, p).
    """
    off = one[:, None] - other
    return np.asarray(np.einsum("ijp,jpq,ijq->ij", off, information, off) < SAME_MAXIMUM)


def _follow(leader: NDArray[np.int_], near: NDArray[np.bool_], cost: Array) -> None:
    """Assign to each starting point the best one near it, whose maximum it is given.

    Parameters
    ----------
    leader : ndarray
        Index of the starting point that each follows, which may be its own, (n,). Changed in place.
    near : ndarray
        Whether two starting points have come to the same parameters, (n, n).
    cost : ndarray
        Cost at each, (n,).
    """
    own = np.arange(len(leader))
    free = leader == own
    costs = np.where(near & free, cost, np.inf)
    best = np.where(np.isfinite(cost), np.argmin(costs, axis=1), own)
    leader[free] = best[free]


def _quadratic(
    model: ForwardModel,
    tools: tuple[int, ...],
    parameters: Array,
    samples: Complex,
    whiten: Weights,
) -> tuple[Array, Array, Array]:
    """Return cost (n,), half its gradient (n, p) and half its Gauss-Newton Hessian (n, p, p)."""
    parts = [
        _few_quadratic(model, tools, parameters[i : i + AT_ONCE], samples, whiten)
        for i in range(0, len(parameters), AT_ONCE)
    ]
    cost, gradient, information = (np.concatenate(part) for part in zip(*parts, strict=True))
    return cost, gradient, information


def _few_quadratic(
    model: ForwardModel,
    tools: tuple[int, ...],
    parameters: Array,
    samples: Complex,
    whiten: Weights,
) -> tuple[Array, Array, Array]:
    """Return cost, half its gradient and half its Hessian for at most :data:`AT_ONCE` sets."""
    places, depths, nuisances = split(parameters)
    value, jacobian = model.baseband(tools, places, depths, nuisances)
    residual = whiten(samples - value)
    slopes = whiten.of_derivatives(jacobian)
    p = parameters.shape[1]
    prior = np.zeros((p, p))
    own = np.arange(p - len(NUISANCES), p)
    precision = 1 / model.priors.deviations**2
    prior[own, own] = precision
    cost = 2 * np.sum(np.abs(residual) ** 2, axis=1) + nuisances**2 @ precision
    slopes = slopes.astype(complex, copy=False)  # products by place and temperature nearly cancel
    conjugate = slopes.conj()
    gradient = -2 * (conjugate @ residual[:, :, None])[:, :, 0].real
    gradient[:, own] += nuisances * precision
    information = 2 * (conjugate @ slopes.swapaxes(1, 2)).real + prior
    return cost, gradient, information


def evidence(model: ForwardModel, tools: tuple[int, ...], fits: Fits, whiten: Weights) -> Array:
    """Return minus twice the logarithm of the evidence of each fit, up to a constant, (n,).

    The prior of places and depths is uniform.
    """
    length = model.span[1] - model.span[0]
    volume = sum(2 * log(length * float(np.diff(model.tables[tool].range)[0])) for tool in tools)
    volume += float(np.log(2 * pi * model.priors.deviations**2).sum())
    p = fits.parameters.shape[1]
    curvature = np.linalg.slogdet(fits.information)[1] - p * log(2 * pi)
    return np.asarray(fits.cost + 2 * whiten.log_determinant + curvature + volume)


def distinct(fits: Fits, n_presses: int) -> Fits:
    """Return the distinct maxima, the best first; of those that count as one, the best is kept."""
    fits = fits.sorted()
    at, own = fits.parameters, fits.parameters[:, : 2 * n_presses]
    close = np.abs(own[:, None] - own) < np.tile(DISTINCT, n_presses)
    same = close.all(axis=2) | alike(at, at, fits.information)
    kept: list[int] = []
    for i in range(len(at)):
        if not same[i, kept].any():
            kept.append(i)
    return fits.at(np.array(kept))
