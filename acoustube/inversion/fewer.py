"""Fits of a cycle with fewer contacts, which reveal spurious ones (ghosts).

A spurious contact explains the residual of other, misplaced contacts. Its evidence is therefore the
loss of likelihood where the others are fitted again without it. A press that deepens fast may be
tracked at too small a depth half a wavelength off; the residual then resembles a contact just
behind it. One contact is therefore also sought in place of two neighbours.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from acoustube.base.types import Array
from acoustube.inversion.births import fronts_of, new_deviations, with_shifts
from acoustube.inversion.model import ForwardModel, Priors
from acoustube.inversion.motion import Branches, Motion, Update, updated
from acoustube.inversion.parameters import CLOSEST, split
from acoustube.inversion.proposals import Proposals
from acoustube.inversion.whitening import Weights
from acoustube.waves.scattering import Complex

WIDER = 0.5e-3, 0.15e-3
"""Standard deviations in m that are added in quadrature to those of positions and depths in a fit
from another starting point."""
UNUSUAL = -4.0
"""Logarithm of the prior odds of a maximum other than the one that is tracked."""
BEFORE, BEHIND = 0.03, 0.01
"""Distances in m before two neighbours and behind them within which a single contact is sought."""
ITERATIONS = 4, 5
"""Numbers of iterations: of fits of the remaining contacts, and of one contact in place of two."""


def refitted(model: ForwardModel, fewer: Branches, samples: Complex, whiten: Weights) -> Update:
    """Return fits of the remaining contacts, also started half a wavelength away, the best first.

    Parameters
    ----------
    model : ForwardModel
    fewer : Branches
        One branch of the remaining contacts.
    samples : ndarray
        Baseband of the cycle in counts, (n_time,).
    whiten : Weights
    """
    m = len(fewer.tools)
    mean = np.repeat(fewer.mean, 1 + 2 * m, axis=0)
    contact = np.arange(m)
    mean[1 + contact, 2 * contact] -= model.base.half_wavelength
    mean[1 + m + contact, 2 * contact] += model.base.half_wavelength
    start = restarted(fewer, mean, model.priors)
    start = replace(start, level=np.append(0.0, np.full(2 * m, UNUSUAL)))
    return updated(model, start, samples, whiten, iterations=ITERATIONS[0])


def log_ratio(found: Update, fewer: Update, whiten: Weights) -> float:
    """Return the log likelihood ratio of a fit over one with fewer contacts, in a cycle."""
    without, with_all = np.sum(
        np.abs(whiten(np.stack([fewer.rest[0], found.rest[0]]))) ** 2, axis=1
    )
    return float(without - with_all)


def restarted(branches: Branches, mean: Array, priors: Priors) -> Branches:
    """Return branches from which other maxima can be reached.

    The covariance is that of the best branch, with the variances of `WIDER` added to positions and
    depths. The nuisance parameters, which a misplaced contact has biased, have the distribution of
    their priors again. If they kept their means, misplaced contacts would bias them farther each
    time, and then fit better than those in the right places.

    Parameters
    ----------
    branches : Branches
    mean : ndarray
        Means of contacts and velocities, (n, n_state); those of nuisance parameters are not used.
    priors : Priors
    """
    m, p = 2 * len(branches.tools), branches.parameters
    mean, wide = mean.copy(), branches.covariance[:1].copy()
    contact, own = np.arange(m), np.arange(m, p)
    wide[:, contact, contact] += np.tile(WIDER, m // 2) ** 2
    mean[:, own], wide[:, own], wide[:, :, own] = 0.0, 0.0, 0.0
    wide[:, own, own] = priors.deviations**2
    n = len(mean)
    return Branches(branches.tools, mean, np.repeat(wide, n, axis=0), np.zeros(n))


def one_for_two(
    proposals: list[Proposals],
    motion: Motion,
    best: Branches,
    first: int,
    samples: Complex,
    whiten: Weights,
) -> Update | None:
    """Return fits of one contact in place of two neighbours, or None if none is found.

    Parameters
    ----------
    proposals : list of Proposals
        One for each tool.
    motion : Motion
    best : Branches
        One branch, with both neighbours.
    first : int
        Index of the first of the two neighbours along the tube.
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
    value, _ = model.baseband(others.tools, *split(others.mean[:, : others.parameters]))
    fronts, _, warm = fronts_of(model, others)
    others = restarted(others, others.mean[:1], model.priors)
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
