"""Contacts of a tube with a rangefinder at each end: the posteriors of both, joined.

Each end is inverted by itself, since its noise, clutter and nuisance parameters are its own. A
contact that both find has the product of its two distributions; of maxima half a wavelength apart
those that coincide from both sides remain, as far as the tube's length is known. A contact behind a
hard one, whose echo from one side lies below that one's own, is heard from the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from acoustube.base.types import Array
from acoustube.inversion.estimate import Contact
from acoustube.inversion.model import Priors
from acoustube.inversion.posterior import Estimate, mixture
from acoustube.inversion.tools import Library

SAME_PLACE = 0.03
"""Distance in m within which contacts told from both ends are one."""
DEVIATIONS = 3.0
"""Standard deviations of their distance within which they are one, too."""
LEAST = 0.1
"""Part of a deviation that is each end's own at least, beside the error that both share."""
NEGLIGIBLE = 1e-9
"""Weight of a maximum, relative to the largest, that is left out."""


def joined_contacts(
    near: Sequence[Contact],
    far: Sequence[Contact],
    length: float,
    library: Library,
    priors: Priors,
) -> list[tuple[Contact, tuple[int | None, int | None]]]:
    """Return contacts told from one end or both, by distance from the near one.

    Parameters
    ----------
    near, far : sequence of Contact
        Each with distances from its own end.
    length : float
        Of the tube between both transducers in m; ``priors.length`` is its standard deviation.
    library : Library
    priors : Priors
        Errors of the model in depth, ``depth`` and ``bore``, are the same from both ends.

    Returns
    -------
    list of (Contact, (int or None, int or None))
        With its number among the near and among the far ones, None where one does not tell it.
        Where both tell it by different tools, it is the one whose place is told better.
    """
    turned = [_turned(one, length, priors.length) for one in far]
    free = list(range(len(turned)))
    found: list[tuple[Contact, tuple[int | None, int | None]]] = []
    for i, one in enumerate(near):
        j = min(free, key=lambda n: _apart(one, turned[n]), default=None)
        if j is None or not _one(one, turned[j]):
            found.append((one, (i, None)))
            continue
        free.remove(j)
        found.append((_product(one, turned[j], library, priors), (i, j)))
    found += [(turned[j], (None, j)) for j in free]
    return sorted(found, key=lambda pair: pair[0].distance.value)


def _turned(contact: Contact, length: float, deviation: float) -> Contact:
    """Return a contact with its distance from the other end."""
    told = contact.distance
    spread = np.hypot(told.deviations, deviation)
    return replace(contact, distance=mixture(told.weights, length - told.means, spread))


def _apart(one: Contact, other: Contact) -> float:
    return abs(one.distance.value - other.distance.value)


def _one(one: Contact, other: Contact) -> bool:
    spread = float(np.hypot(one.distance.deviation, other.distance.deviation))
    return _apart(one, other) < max(SAME_PLACE, DEVIATIONS * spread)


def _product(one: Contact, other: Contact, library: Library, priors: Priors) -> Contact:
    """Return a contact that both ends tell, with the product of its distributions."""
    probability = 1 - (1 - one.probability) * (1 - other.probability)
    if one.tool != other.tool:
        best = min(one, other, key=lambda it: it.distance.deviation)
        return replace(best, probability=probability)
    # What the model errs by in depth, it errs by from both ends.
    shared = float(priors.offsets(np.array([[one.depth.value]]))[0, 1])
    place, place_spread, place_off = _combined(one.distance, other.distance, 0.0)
    depth, depth_spread, depth_off = _combined(one.depth, other.depth, shared)
    prior = np.outer(one.distance.weights, other.distance.weights).ravel()
    off = place_off + depth_off
    weight = prior * np.exp(-0.5 * (off - off.min()))
    order = np.argsort(-weight, kind="stable")
    order = order[weight[order] > NEGLIGIBLE * weight[order[0]]]
    share, d = weight[order] / weight[order].sum(), depth[order]
    tool = library.tools[one.tool]
    error = np.hypot(tool.force_at(d, 1) * depth_spread[order], priors.force_deviation(tool, d))
    return Contact(
        probability=probability, distance=mixture(share, place[order], place_spread[order]),
        depth=mixture(share, d, depth_spread[order]),
        force=mixture(share, tool.force_at(d), error), tool=one.tool,
    )  # fmt: skip


def _combined(one: Estimate, other: Estimate, shared: float) -> tuple[Array, Array, Array]:
    """Return the products of the normal distributions of two mixtures, each with each.

    Parameters
    ----------
    one, other : Estimate
        Of n and m distributions.
    shared : float
        Standard deviation of an error that both have in common.

    Returns
    -------
    mean, deviation, off : ndarray
        (n m,); the last is minus twice the logarithm of the products' weights.
    """
    a, b = (
        np.maximum(it.deviations**2 - shared**2, (LEAST * it.deviations) ** 2)
        for it in (one, other)
    )
    both = a[:, None] + b
    difference = one.means[:, None] - other.means
    mean = other.means + difference * (b / both)
    deviation = np.sqrt(a[:, None] * b / both + shared**2)
    off = difference**2 / both + np.log(both)
    return mean.ravel(), deviation.ravel(), off.ravel()
