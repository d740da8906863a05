"""Candidates for one additional contact, as starting points of fits to a cycle.

A branch is one normal distribution in the mixture of :mod:`acoustube.inversion.motion`. Here it is
that of the known contacts with a candidate added.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from acoustube.base.types import Array
from acoustube.inversion.model import ForwardModel
from acoustube.inversion.motion import Branches, Motion, Update, updated
from acoustube.inversion.parameters import CLOSEST, split
from acoustube.inversion.proposals import Proposals
from acoustube.inversion.search import Front, front_of
from acoustube.inversion.whitening import Weights
from acoustube.waves.scattering import Complex

BIRTH = 120.0
"""Expected decrease of minus twice the log likelihood above which a candidate is fitted: weaker
echoes do not distinguish positions half a wavelength apart."""
START = 3e-3, 0.5e-3
"""Standard deviations in m of the position and the depth of a candidate before it is fitted."""
NEW_CONTACT = float(np.log(100.0))
"""Logarithm of the prior odds against one more contact."""
LANDING = 0.01
"""Standard deviation of the velocity along the tube of a new contact, in m/s."""


def candidates(
    proposals: list[Proposals], motion: Motion, branches: Branches, rest: Complex, whiten: Weights
) -> list[Branches]:
    """Return branches (normal distributions) with one more contact, to start fits to a cycle from.

    Parameters
    ----------
    proposals : list of Proposals
        One for each tool.
    motion : Motion
    branches : Branches
        Branches without the contact, the best first.
    rest : ndarray
        Residual of a cycle with the best branch, (n_time,).
    whiten : Weights
        Weights of the residual.

    Returns
    -------
    list of Branches
        One for each tool and each index of the contact along the tube for which there are
        candidates, with a branch for each candidate.
    """
    fronts, places, warm = fronts_of(proposals[0].model, branches)
    found: list[Branches] = []
    for tool, one in enumerate(proposals):
        given = one.search(rest, whiten, fronts, temperature=warm)
        ranks = np.searchsorted(places, given.place)
        apart = np.abs(given.place[:, None] - places).min(axis=1, initial=np.inf) > CLOSEST
        apart &= given.gain > BIRTH
        for rank in np.unique(ranks[apart]):
            here = apart & (ranks == rank)
            more = branches.added(
                rank, tool, given.place[here], given.depth[here], new_deviations(motion)
            )
            found.append(more)
    return found


def fronts_of(model: ForwardModel, branches: Branches) -> tuple[list[Front], Array, float]:
    """Return the waves behind the contacts of the best branch, their positions and a temperature.

    Returns
    -------
    fronts : list of Front
        Waves that the contacts transmit, in the order of the contacts along the tube.
    places : ndarray
        Positions of the contacts in m, (n_contacts,).
    temperature : float
        Deviation of the air's temperature in K.
    """
    places, depths, own = split(branches.mean[:1, : branches.parameters])
    fronts: list[Front] = []
    if branches.tools:
        fronts = front_of(model, branches.tools, places[0], depths[0], own[0])
    return fronts, places[0], float(own[0, 0])


def new_deviations(motion: Motion) -> Array:
    """Return standard deviations of a candidate: position, depth in m, velocities in m/s, (4,)."""
    return np.array([*START, LANDING, motion.sink])


def uniform(model: ForwardModel, tool: int) -> float:
    """Return the log ratio of the area of a contact's prior to that of a candidate's distribution.

    The prior is uniform: its area is the range of position times that of depth. The area of the
    normal distribution is 2 pi times the product of the standard deviations :data:`START`.
    """
    low, high = model.tables[tool].range
    volume = float(np.ptp(model.span)) * (high - low)
    return float(np.log(volume / (2 * np.pi * START[0] * START[1])))


def with_shifts(
    model: ForwardModel,
    motion: Motion,
    fewer: Branches,
    best: Update,
    rank: int,
    samples: Complex,
    whiten: Weights,
) -> Update:
    """Return `best` and fits with the new contact one and two half wavelengths away, best first.

    Parameters
    ----------
    model : ForwardModel
    motion : Motion
    fewer : Branches
        Branches without the new contact.
    best : Update
        Fit with the new contact.
    rank : int
        Index of the new contact along the tube.
    samples : ndarray
        Baseband of the cycle, (n_time,).
    whiten : Weights
    """
    steps = model.base.half_wavelength * np.array([-2, -1, 1, 2])
    place, depth = best.branches.mean[0, 2 * rank : 2 * rank + 2]
    start = fewer.added(
        rank, best.branches.tools[rank], place + steps, np.full(4, depth), new_deviations(motion)
    )
    tried = updated(model, start, samples, whiten, iterations=3)
    level = tried.branches.level + tried.evidence[0] - best.evidence[0]
    return best.joined(replace(tried, branches=replace(tried.branches, level=level)))


def in_place_of(
    model: ForwardModel,
    motion: Motion,
    fewer: Branches,
    young: list[int],
    best: Update,
    rank: int,
    samples: Complex,
    whiten: Weights,
) -> tuple[Update, int | None]:
    """Return fits of the new contact in place of a young one behind it, if as likely.

    Until the echo of the new contact was high enough to be detected, its effect on later echoes may
    have been taken for a contact.

    Parameters
    ----------
    model : ForwardModel
    motion : Motion
    fewer : Branches
        Branches without the new contact.
    young : list of int
        Indices in `fewer` of the young contacts behind the new one.
    best : Update
        Fit with the new contact.
    rank : int
        Index of the new contact along the tube.
    samples : ndarray
        Baseband of the cycle, (n_time,).
    whiten : Weights

    Returns
    -------
    found : Update
        Fits without one of the young contacts; otherwise `best`.
    gone : int or None
        Index of that contact in `fewer`; otherwise None.
    """
    place, depth = best.branches.mean[:1, 2 * rank : 2 * rank + 2].T
    for i in young:
        others, tool = fewer.without(i), best.branches.tools[rank]
        start = others.added(rank, tool, place, depth, new_deviations(motion))
        alone = updated(model, start, samples, whiten, iterations=5)
        alone = with_shifts(model, motion, others, alone, rank, samples, whiten)
        if alone.evidence[0] + NEW_CONTACT > best.evidence[0]:
            return alone, i
    return best, None


def rank_of(fewer: Branches, more: Branches) -> int:
    """Return the index along the tube of the contact that `more` has in addition to `fewer`."""
    old = fewer.mean[0, : 2 * len(fewer.tools) : 2]
    new = more.mean[0, : 2 * len(more.tools) : 2]
    return int(np.argmin([np.abs(np.delete(new, i) - old).sum() for i in range(len(new))]))
