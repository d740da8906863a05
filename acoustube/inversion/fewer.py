"""Fits of a cycle by fewer contacts, which reveal spurious ones (ghosts).

A spurious contact explains what the others, misplaced, leave of a cycle. Its worth is therefore
what the cycle loses where the others are fitted again without it. A press that deepens fast may be
followed at too small a depth half a wavelength off, and what is left seem a contact just behind: so
one contact is also sought in place of two neighbours.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from acoustube.base.types import Array
from acoustube.inversion.births import fronts_of, half_wavelength, new_deviations, with_shifts
from acoustube.inversion.likelihood import Weights
from acoustube.inversion.model import ForwardModel, Priors
from acoustube.inversion.motion import Branches, Motion, Update, updated
from acoustube.inversion.parameters import CLOSEST, split
from acoustube.inversion.proposals import Proposals
from acoustube.waves.scattering import Complex

WIDER = 0.5e-3, 0.15e-3
"""Standard deviations in m that are added to those of places and depths in a fit from elsewhere."""
UNUSUAL = -4.0
"""Logarithm of the prior odds of another maximum than the one followed."""
BEFORE, BEHIND = 0.03, 0.01
"""Reach in m in front of two neighbours and behind, within which one is sought in their place."""
ITERATIONS = 4, 5
"""Iterations of the contacts left, and of one in place of two."""


def refitted(model: ForwardModel, fewer: Branches, samples: Complex, whiten: Weights) -> Update:
    """Return fits of the contacts left, also from half a wavelength away, the best first.

    Parameters
    ----------
    model : ForwardModel
    fewer : Branches
        One branch, of the contacts left.
    samples : ndarray
        Baseband of the cycle, (n_time,).
    whiten : Weights
    """
    m = len(fewer.tools)
    mean = np.repeat(fewer.mean, 1 + 2 * m, axis=0)
    contact = np.arange(m)
    mean[1 + contact, 2 * contact] -= half_wavelength(model)
    mean[1 + m + contact, 2 * contact] += half_wavelength(model)
    wide = np.repeat(widened(fewer, model.priors), 1 + 2 * m, axis=0)
    level = np.append(0.0, np.full(2 * m, UNUSUAL))
    start = Branches(fewer.tools, mean, wide, level)
    return updated(model, start, samples, whiten, iterations=ITERATIONS[0])


def widened(branches: Branches, priors: Priors) -> Array:
    """Return the best branch's covariance (1, p, p) with that of another maximum added.

    It has `WIDER` more of places and depths, and the priors of the nuisances: a misplaced contact
    has misled them.

    Parameters
    ----------
    branches : Branches
    priors : Priors
    """
    wide = branches.covariance[:1].copy()
    added = np.concatenate([np.tile(WIDER, len(branches.tools)), priors.deviations])
    diagonal = np.arange(branches.parameters)
    wide[:, diagonal, diagonal] += added**2
    return wide


def one_for_two(
    proposals: list[Proposals],
    motion: Motion,
    best: Branches,
    first: int,
    samples: Complex,
    whiten: Weights,
) -> Update | None:
    """Return fits of one contact in place of two neighbours, None where none is found.

    Parameters
    ----------
    proposals : list of Proposals
        Of each tool.
    motion : Motion
    best : Branches
        One branch.
    first : int
        Number of the first of the neighbours.
    samples : ndarray
        Baseband of the cycle, (n_time,).
    whiten : Weights
    """
    model = proposals[0].model
    places = best.mean[0, : 2 * len(best.tools) : 2]
    low, high = places[first] - BEFORE, places[first + 1] + BEHIND
    if first:
        low = max(low, places[first - 1] + CLOSEST)
    if first + 2 < len(places):
        high = min(high, places[first + 2] - CLOSEST)
    others = best.without(first + 1).without(first)
    others = replace(others, covariance=widened(others, model.priors))
    value, _ = model.baseband(others.tools, *split(others.mean[:, : others.parameters]))
    fronts, _, warm = fronts_of(model, others)
    found = []
    for tool in sorted({*best.tools[first : first + 2]}):
        given = proposals[tool].search(
            samples - value[0], whiten, fronts, number=1,
            within=(low, high), temperature=warm,
        )  # fmt: skip
        if len(given.gain):
            start = others.added(first, tool, given.place, given.depth, new_deviations(motion))
            found.append(updated(model, start, samples, whiten, iterations=ITERATIONS[1]))
    if not found:
        return None
    alone = max(found, key=lambda one: float(one.evidence[0]))
    return with_shifts(model, motion, others, alone, first, samples, whiten)
