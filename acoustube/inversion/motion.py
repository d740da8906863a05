"""Gaussian-sum filter of contacts: prediction between cycles, and update by a cycle.

The state vector of m contacts has 4 m + 7 components: position and depth of each contact in turn,
the seven nuisance parameters, and the velocities of position and of depth of each contact in turn.
Its distribution is a mixture of normal distributions, the branches, all of the same contacts.

References
----------
* Iterated extended Kalman filter as Gauss-Newton: Bell, B. M. and Cathey, F. W. (1993). IEEE
  Transactions on Automatic Control 38, 294-297.
* Sums of normal distributions: Alspach, D. L. and Sorenson, H. W. (1972). IEEE Transactions on
  Automatic Control 17, 439-448.
* Velocity as an Ornstein-Uhlenbeck process: Singer, R. A. (1970). IEEE Transactions on Aerospace
  and Electronic Systems 6, 473-483.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acoustube.base.checks import check_fields
from acoustube.base.rules import Number
from acoustube.base.types import Array
from acoustube.inversion.model import DRIFTING, NUISANCES, ForwardModel, Priors
from acoustube.inversion.parameters import LARGEST_STEPS, bounded, split
from acoustube.inversion.whitening import Weights
from acoustube.waves.scattering import Complex

Numbers = NDArray[np.integer[Any]]

LIMITS = 2 * LARGEST_STEPS[0], 2 * LARGEST_STEPS[1]
"""Largest changes of position and depth in one iteration of an update, in m."""
CONVERGED = 0.1
"""Expected decrease of the cost in an iteration, below which a branch is not iterated further. The
cost is minus twice the logarithm of the posterior density, up to a constant."""
LOST = 60.0
"""Excess of a branch's cost over the least above which it gets no more than two iterations."""
DISTINCT = 0.5e-3, 0.05e-3
"""Differences of position and depth in m: branches whose contacts differ by less are one."""


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Model of motion: velocities and nuisance parameters as Ornstein-Uhlenbeck processes.

    Attributes
    ----------
    slide, sink : float
        Stationary standard deviations in m/s of the velocity of a contact along the tube, and of
        the velocity of its depth. Defaults 0.03 and 0.015.
    memory : float
        Correlation time of both velocities in s. Default 0.4.
    drift, ageing : float
        Correlation times in s of temperature, gain and phase, and of the other nuisance parameters,
        of sensor, tube and solver. Defaults 30 and 1200.
    survival : float
        Prior probability that a contact is still present when tested next. Default 0.9.

    Raises
    ------
    ConfigError
        If a value is outside its range.
    """

    slide: float = 0.03
    sink: float = 0.015
    memory: float = 0.4
    drift: float = 30.0
    ageing: float = 1200.0
    survival: float = 0.9

    def __post_init__(self) -> None:
        """Check the ranges."""
        positive = Number(1e-9, 1e6)
        check_fields(
            self, slide=positive, sink=positive, memory=positive, drift=positive,
            ageing=positive, survival=Number(1e-6, 1),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Branches:
    """Mixture of normal distributions of the state of one set of contacts.

    Attributes
    ----------
    tools : tuple of int
        Index in the library of the tool of each contact, in the order along the tube.
    mean : ndarray
        Mean in each of n branches of the state, which holds position and depth of each contact,
        nuisance parameters, and velocities of position and depth, (n, 4 n_contacts + 7).
    covariance : ndarray
        Covariance of the state in each branch, (n, 4 n_contacts + 7, 4 n_contacts + 7).
    level : ndarray
        Logarithm of each branch's weight relative to the largest weight, (n,).
    """

    tools: tuple[int, ...]
    mean: Array
    covariance: Array
    level: Array

    @property
    def parameters(self) -> int:
        """Number of parameters of the forward model: the state without the velocities."""
        return 2 * len(self.tools) + len(NUISANCES)

    def take(self, rows: Numbers) -> Branches:
        """Return the branches at given indices, with levels relative to the largest of these."""
        level = self.level[rows]
        return Branches(self.tools, self.mean[rows], self.covariance[rows], level - level.max())

    def joined(self, other: Branches) -> Branches:
        """Return these branches followed by others of the same contacts, with unchanged levels."""
        return Branches(
            self.tools,
            np.concatenate([self.mean, other.mean]),
            np.concatenate([self.covariance, other.covariance]),
            np.concatenate([self.level, other.level]),
        )

    def without(self, contact: int) -> Branches:
        """Return the branches without the contact of an index, over which they are marginalised."""
        p = self.parameters
        gone = [2 * contact, 2 * contact + 1, p + 2 * contact, p + 2 * contact + 1]
        kept = np.delete(np.arange(self.mean.shape[1]), gone)
        tools = self.tools[:contact] + self.tools[contact + 1 :]
        return Branches(tools, self.mean[:, kept], self.covariance[:, kept][:, :, kept], self.level)

    def added(
        self, rank: int, tool: int, place: Array, depth: Array, deviations: Array
    ) -> Branches:
        """Return copies of the first branch with one additional contact, one copy for each place.

        The new contact is independent of the others, its mean velocities are zero, and all levels
        are zero.

        Parameters
        ----------
        rank : int
            Index of the new contact along the tube.
        tool : int
            Index of its tool in the library.
        place, depth : ndarray
            Its mean position and depth in each copy in m, (n,).
        deviations : ndarray
            Standard deviations of position and depth in m and of their velocities in m/s, (4,).
        """
        n, p, old = len(place), self.parameters, self.mean.shape[1]
        own = [2 * rank, 2 * rank + 1, p + 2 + 2 * rank, p + 3 + 2 * rank]
        kept = np.delete(np.arange(old + 4), own)
        mean = np.zeros((n, old + 4))
        mean[:, kept], mean[:, own[0]], mean[:, own[1]] = self.mean[0], place, depth
        covariance = np.zeros((n, old + 4, old + 4))
        covariance[:, kept[:, None], kept] = self.covariance[0]
        covariance[:, own, own] = deviations**2
        tools = (*self.tools[:rank], tool, *self.tools[rank:])
        return Branches(tools, mean, covariance, np.zeros(n))


def at_rest(priors: Priors) -> Branches:
    """Return the prior without contacts: one branch, of the nuisance parameters alone."""
    n = len(NUISANCES)
    return Branches((), np.zeros((1, n)), np.diag(priors.deviations**2)[None], np.zeros(1))


def velocities(motion: Motion, contacts: int) -> Array:
    """Return the standard deviations of position and depth velocities in m/s, (2 n_contacts,)."""
    return np.tile([motion.slide, motion.sink], contacts)


def predicted(branches: Branches, motion: Motion, priors: Priors, step: float) -> Branches:
    """Return the distribution predicted after a time step, before the next cycle is used.

    Parameters
    ----------
    branches : Branches
    motion : Motion
    priors : Priors
        Stationary distribution of the nuisance parameters.
    step : float
        Time in s.
    """
    m, p = len(branches.tools), branches.parameters
    q = p + 2 * m
    place, speed, own = np.arange(2 * m), np.arange(p, q), np.arange(2 * m, p)
    x = step / motion.memory
    kept, passed = np.exp(-x), -np.expm1(-x)
    slow = np.exp(-step / np.where(np.isin(NUISANCES, DRIFTING), motion.drift, motion.ageing))
    change = np.eye(q)
    change[place, speed], change[speed, speed] = motion.memory * passed, kept
    change[own, own] = slow
    # Singer's integrals over the time step; for a short step by a series, to avoid cancellation.
    spread = x**3 * (2 / 3 - x / 2) if x < 1e-3 else 2 * (x - passed) - passed**2
    steady, noise = velocities(motion, m) ** 2, np.zeros((q, q))
    noise[speed, speed] = steady * -np.expm1(-2 * x)
    noise[place, place] = steady * motion.memory**2 * spread
    noise[place, speed] = noise[speed, place] = steady * motion.memory * passed**2
    noise[own, own] = priors.deviations**2 * (1 - slow**2)
    covariance = change @ branches.covariance @ change.T + noise
    return Branches(branches.tools, branches.mean @ change.T, covariance, branches.level)


@dataclass(frozen=True, eq=False)
class Update:
    """Distribution after a cycle, and the quantities from which it was computed.

    Attributes
    ----------
    branches : Branches
        The n branches, sorted by weight, the most likely first.
    evidence : ndarray
        Log likelihood of the cycle in each branch, given the earlier cycles, up to a constant,
        (n,).
    rest : ndarray
        Residual of the cycle in the baseband, in counts, (n, n_time).
    slopes : ndarray
        Whitened Jacobian by the 2 n_contacts + 7 parameters, which exclude the velocities,
        (n, n_parameters, n_time).
    information : ndarray
        Fisher information of the parameters in this cycle alone, (n, n_parameters, n_parameters).
    """

    branches: Branches
    evidence: Array
    rest: Complex
    slopes: Complex
    information: Array

    def joined(self, other: Update) -> Update:
        """Return the branches of two updates of the same contacts, the highest level first."""
        both = Update(
            self.branches.joined(other.branches),
            *(
                np.concatenate([getattr(self, name), getattr(other, name)])
                for name in ("evidence", "rest", "slopes", "information")
            ),
        )
        return both.take(np.argsort(-both.branches.level))

    def take(self, rows: Numbers) -> Update:
        """Return the branches at given indices, with levels relative to the largest of these."""
        return Update(
            self.branches.take(rows), self.evidence[rows], self.rest[rows], self.slopes[rows],
            self.information[rows],
        )  # fmt: skip


def updated(
    model: ForwardModel,
    prior: Branches,
    samples: Complex,
    whiten: Weights,
    *,
    iterations: int = 3,
    forget: float = 1.0,
    limit: float = np.inf,
) -> Update:
    """Return the posterior after a cycle: an iterated extended Kalman update of each branch.

    Parameters
    ----------
    model : ForwardModel
    prior : Branches
        Predicted distribution.
    samples : ndarray
        Baseband of the cycle in counts, (n_time,).
    whiten : Weights
    iterations : int
        Largest number of damped Gauss-Newton steps.
    forget : float
        Factor by which the levels are multiplied before the evidence of this cycle is added.
    limit : float
        Cost above which a branch is not refined after its first iteration.
    """
    p, n = prior.parameters, len(prior.mean)
    expected, covariance = prior.mean[:, :p], prior.covariance[:, :p, :p]
    precision = np.asarray(np.linalg.inv(covariance), float)
    at = bounded(model, prior.tools, expected)
    known = _Quadratic(model, prior.tools, at, samples, whiten, expected, precision)
    damping, active = np.full(n, 1e-4), np.ones(n, bool)
    for number in range(iterations):
        if number:
            active &= known.cost < limit
        if number > 1:
            active &= known.cost < known.cost.min() + LOST
        i = np.flatnonzero(active)
        if not len(i):
            break
        curved = known.information[i] + precision[i]
        curved += damping[i, None, None] * np.einsum("nii->ni", curved)[:, :, None] * np.eye(p)
        step = -np.linalg.solve(curved, known.gradient[i][..., None])[..., 0]
        promised = -np.einsum("ni,ni->n", step, known.gradient[i])
        active[i] = promised > CONVERGED
        i, step = i[promised > CONVERGED], step[promised > CONVERGED]
        if not len(i):
            break
        step = _limited(step, len(prior.tools))
        tried_at = bounded(model, prior.tools, at[i] + step)
        tried = _Quadratic(
            model, prior.tools, tried_at, samples, whiten, expected[i], precision[i]
        )  # fmt: skip
        better = tried.cost < known.cost[i]
        damping[i] = np.where(better, damping[i] / 5, 10 * np.maximum(damping[i], 1e-2))
        at[i[better]] = tried_at[better]
        known.replace(i[better], tried, better)
    posterior = np.asarray(np.linalg.inv(known.information + precision), float)
    spread = np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(posterior)[1]
    evidence = -0.5 * (known.cost + spread)
    level = forget * prior.level + evidence
    branches = Branches(
        prior.tools, *_with_velocities(prior, at, precision, posterior), level - level.max()
    )
    order = np.argsort(-level)
    found = Update(branches, evidence, known.rest, known.slopes, known.information)
    return found.take(order)


def likely(found: Update, worst: float, most: int) -> Update:
    """Return the branches that are likely and distinct, the best first.

    Parameters
    ----------
    found : Update
        Sorted by weight.
    worst : float
        Log odds relative to the best branch, negative, below which a branch is left out.
    most : int
        Largest number of branches.
    """
    branches, m = found.branches, 2 * len(found.branches.tools)
    at = branches.mean[:, :m] / np.tile(DISTINCT, m // 2)
    kept: list[int] = []
    for i in range(len(at)):
        same = any(np.all(np.abs(at[i] - at[j]) < 1) for j in kept)
        if not kept or (branches.level[i] > branches.level[0] + worst and not same):
            kept.append(i)
    return found.take(np.array(kept[:most]))


class _Quadratic:
    """Cost, half its gradient, and Fisher information of the data, for n sets of parameters.

    `rest`, `slopes` and `information` are those of :class:`Update`; `cost` is (n,) and `gradient`
    (n, n_parameters). Cost and gradient include the prior; the information does not.
    """

    def __init__(
        self,
        model: ForwardModel,
        tools: tuple[int, ...],
        at: Array,
        samples: Complex,
        whiten: Weights,
        expected: Array,
        precision: Array,
    ) -> None:
        value, jacobian = model.baseband(tools, *split(at))
        self.rest = samples - value
        white = whiten(self.rest)
        self.slopes = whiten(jacobian)
        off = at - expected
        pulled = np.einsum("nij,nj->ni", precision, off)
        self.cost = 2 * np.sum(np.abs(white) ** 2, axis=1) + np.einsum("ni,ni->n", off, pulled)
        drawn = (self.slopes.conj() @ white[..., None])[..., 0].real
        self.gradient = pulled - 2 * drawn
        self.information = 2 * (self.slopes.conj() @ self.slopes.swapaxes(1, 2)).real

    def replace(self, rows: Array, other: _Quadratic, taken: Array) -> None:
        """Overwrite rows, in place, with those of `other` that the mask `taken` selects."""
        for name in ("rest", "slopes", "cost", "gradient", "information"):
            getattr(self, name)[rows] = getattr(other, name)[taken]


def _limited(step: Array, contacts: int) -> Array:
    """Limit the changes of positions and depths to :data:`LIMITS` in place; return the steps."""
    for i, largest in enumerate(LIMITS):
        part = slice(i, 2 * contacts, 2)
        step[:, part] = np.clip(step[:, part], -largest, largest)
    return step


def _with_velocities(
    prior: Branches, at: Array, precision: Array, posterior: Array
) -> tuple[Array, Array]:
    """Return mean and covariance of the whole state: the velocities by regression on the rest."""
    p = prior.parameters
    gain = prior.covariance[:, p:, :p] @ precision
    speed = prior.mean[:, p:] + np.einsum("nij,nj->ni", gain, at - prior.mean[:, :p])
    across = gain @ posterior
    own = prior.covariance[:, p:, p:] - gain @ prior.covariance[:, :p, p:]
    own = own + across @ gain.swapaxes(1, 2)
    upper = np.concatenate([posterior, across.swapaxes(1, 2)], axis=2)
    lower = np.concatenate([across, own], axis=2)
    whole = np.concatenate([upper, lower], axis=1)
    return np.concatenate([at, speed], axis=1), (whole + whole.swapaxes(1, 2)) / 2
