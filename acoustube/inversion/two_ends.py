"""Contacts of a tube with a rangefinder at each end: the posteriors from both ends, joined.

Each end is inverted separately, since its noise, clutter and nuisance parameters are its own. The
posterior of a contact that both ends detect is the product of its two distributions. Of maxima half
a wavelength apart, those that coincide from both ends remain, as far as the tube's length is known.
A contact whose echo is masked at one end by a deeper press in front of it is received at the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from acoustube.base.types import Array
from acoustube.inversion.estimate import Contact
from acoustube.inversion.model import Priors
from acoustube.inversion.posterior import Estimate, mixture
from acoustube.inversion.tools import Library

SAME_PLACE, FARTHEST = 0.03, 0.06
"""Distance in m within which contacts reported by both ends are one, and upper limit of this
distance for contacts whose places are less certain."""
DEVIATIONS = 3.0
"""Number of standard deviations of the distance between two contacts within which they are also
one, up to `FARTHEST`."""
CONTRADICTION = 16.0
"""Sum of the squared differences of place and of depth, in standard deviations, above which the two
ends contradict each other. The maxima of both ends that agree best are compared."""
LEAST = 0.1
"""Least fraction of a standard deviation that is taken as independent between the ends. The other
part is an error that both ends share."""
NEGLIGIBLE = 1e-9
"""Weight of a maximum, relative to the largest, up to which it is left out."""


class MatchedContact(NamedTuple):
    """A contact, and its indices among the contacts of each end.

    Attributes
    ----------
    contact : Contact
        The contact, with its distance from the near end.
    near, far : int or None
        Index among the contacts of each end; None where that end does not report it.
    agree : bool
        False if both ends report it, and contradict each other in place and depth.
    """

    contact: Contact
    near: int | None
    far: int | None
    agree: bool = True


def joined_contacts(
    near: Sequence[Contact],
    far: Sequence[Contact],
    length: float,
    library: Library,
    priors: Priors,
) -> list[MatchedContact]:
    """Return the contacts reported by one end or both, by distance from the near end.

    Parameters
    ----------
    near, far : sequence of Contact
        Contacts of each end, with distances from that end.
    length : float
        Length of the tube between both transducers in m.
    library : Library
    priors : Priors
        ``length`` is the standard deviation of the tube's length. ``depth`` is the error of depths
        that both ends share, ``modulus`` determines that of forces.

    Notes
    -----
    Where both ends report a contact with different tools, or contradict each other, the report with
    the smaller standard deviation of the place is used. The probability of a contact that both ends
    report is that of at least one of two independent reports.
    """
    turned = [_from_other_end(one, length, priors.length) for one in far]
    pairs = [(i, j) for i, a in enumerate(near) for j, b in enumerate(turned) if _same(a, b)]
    pairs.sort(key=lambda pair: _apart(near[pair[0]], turned[pair[1]]))
    seen: tuple[set[int], set[int]] = set(), set()
    found = []
    for i, j in pairs:
        if i not in seen[0] and j not in seen[1]:
            contact, agree = _product(near[i], turned[j], library, priors)
            found.append(MatchedContact(contact, i, j, agree))
            seen[0].add(i)
            seen[1].add(j)
    found += [MatchedContact(one, i, None) for i, one in enumerate(near) if i not in seen[0]]
    found += [MatchedContact(one, None, j) for j, one in enumerate(turned) if j not in seen[1]]
    return sorted(found, key=lambda one: one.contact.distance.value)


def _from_other_end(contact: Contact, length: float, deviation: float) -> Contact:
    """Return a contact with its distance from the other end of a tube of a length in m.

    `deviation` is the standard deviation of that length.
    """
    told = contact.distance
    spread = np.hypot(told.deviations, deviation)
    return replace(contact, distance=mixture(told.weights, length - told.means, spread))


def _apart(one: Contact, other: Contact) -> float:
    return abs(one.distance.value - other.distance.value)


def _same(one: Contact, other: Contact) -> bool:
    spread = float(np.hypot(one.distance.deviation, other.distance.deviation))
    return _apart(one, other) < min(max(SAME_PLACE, DEVIATIONS * spread), FARTHEST)


def _product(
    one: Contact, other: Contact, library: Library, priors: Priors
) -> tuple[Contact, bool]:
    """Return a contact that both ends report, and whether they agree.

    Its distributions are the products of both ends'. If the ends disagree, or name different tools,
    it is the report with the smaller standard deviation of the place.
    """
    probability = 1 - (1 - one.probability) * (1 - other.probability)
    best = replace(min(one, other, key=lambda it: it.distance.deviation), probability=probability)
    if one.tool != other.tool:
        return best, True
    # The error of the model in depth is the same from both ends, and that of the force.
    tool, at = library.tools[one.tool], np.array([one.depth.value])
    by_depth = tool.force_at(at, 1) * priors.depth
    force_shared = float(np.hypot(by_depth, priors.force_deviation(tool, at))[0])
    place, place_spread, place_off, place_weight = _combined(one.distance, other.distance, 0.0)
    depth, depth_spread, depth_off, depth_weight = _combined(one.depth, other.depth, priors.depth)
    if np.min(place_off + depth_off) > CONTRADICTION:
        return best, False
    prior = np.outer(one.distance.weights, other.distance.weights).ravel()
    off = place_off + depth_off
    weight = prior * place_weight * depth_weight * np.exp(-0.5 * (off - off.min()))
    order = np.argsort(-weight, kind="stable")
    order = order[weight[order] > NEGLIGIBLE * weight[order[0]]]
    share = weight[order] / weight[order].sum()
    force, force_spread, _, _ = _combined(one.force, other.force, force_shared)
    contact = Contact(
        probability=probability, distance=mixture(share, place[order], place_spread[order]),
        depth=mixture(share, depth[order], depth_spread[order]),
        force=mixture(share, force[order], force_spread[order]), tool=one.tool,
    )  # fmt: skip
    return contact, True


def _combined(one: Estimate, other: Estimate, shared: float) -> tuple[Array, Array, Array, Array]:
    """Return the products of all pairs of normal distributions from two mixtures.

    Parameters
    ----------
    one, other : Estimate
        Mixtures of n and m distributions.
    shared : float
        Standard deviation of an error that both have in common.

    Returns
    -------
    mean, deviation : ndarray
        Means and standard deviations of the products, (n m,): first those of all of `other` with
        the first of `one`.
    off, weight : ndarray
        Squared differences of the two means, relative to the variance of this difference without
        the shared error, and factors, (n m,). The integral of a product is in proportion to
        ``weight * exp(-off / 2)``; the weights in the two mixtures multiply it.
    """
    a, b = (
        np.maximum(it.deviations**2 - shared**2, (LEAST * it.deviations) ** 2)
        for it in (one, other)
    )
    both = a[:, None] + b
    difference = one.means[:, None] - other.means
    mean = other.means + difference * (b / both)
    deviation = np.sqrt(a[:, None] * b / both + shared**2)
    off, weight = difference**2 / both, 1 / np.sqrt(both)
    return mean.ravel(), deviation.ravel(), off.ravel(), weight.ravel()
