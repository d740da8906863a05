"""Which echoes of a cycle are contacts of their own, and which come with another's."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acoustube.base.types import Array

LOBE = 0.12
"""Height of a low-pass's lobe beside an echo, as a share of it, at most."""
LOBE_REACH = 0.10
"""How far from its echo a lobe is, in m."""
TRAPPED = 0.18
"""How far behind a press the sound that it traps is told, in m."""
LOUDER = 2.0
"""By what an echo must stand over one that is nearer by less than that, to be another press's."""
BETWEEN = 0.04
"""How exactly sound that went to and fro between two presses is told, in m."""


def contacts_of_their_own(places: ArrayLike, heights: ArrayLike) -> Array:
    """Return the echoes that no other one of the cycle explains.

    Parameters
    ----------
    places, heights : array_like of shape (n,)
        Of the candidate echoes of one sensor, distances in m and heights in any unit; nan is none.

    Returns
    -------
    ndarray
        Their places, from near to far.

    Notes
    -----
    From near to far, an echo is left out if it is

    1. a lobe: under 12 % of an echo less than 10 cm away, which is what the low-pass of the
       processing leaves beside it;
    2. trapped sound: less than 18 cm behind a press and not twice as high, since deep presses send
       back what they trapped beside them as much as 1 ms late;
    3. sound that went from a press b back to a nearer press a and to b again, told at 2 b - a, and
       lower than that of b.

    Two presses nearer to each other than 18 cm are told as one, unless the farther is heard twice
    as high. What is trapped for longer than 1 ms is not told from a press that a harder one in
    front of it hides.
    """
    place, height = (np.asarray(values, float).ravel() for values in (places, heights))
    order = np.argsort(place)[: np.count_nonzero(np.isfinite(place))]  # nan goes to the end
    place, height = place[order], height[order]
    near = np.abs(place[:, None] - place) < LOBE_REACH
    lobe = np.any(near & (height[:, None] < LOBE * height), axis=1)
    kept: list[int] = []
    for i in np.flatnonzero(~lobe).tolist():
        if not kept or not _comes_with(i, np.array(kept), place, height):
            kept.append(i)
    return place[kept]


def _comes_with(i: int, kept: NDArray[np.int64], places: Array, heights: Array) -> bool:
    """Tell whether an echo comes with those of nearer presses."""
    last = kept[-1]
    if places[i] - places[last] < TRAPPED and heights[i] < LOUDER * heights[last]:
        return True
    again = 2 * places[kept][:, None] - places[kept]
    nearer = places[kept][:, None] > places[kept]
    lower = heights[i] < heights[kept][:, None]
    return bool(np.any(nearer & lower & (np.abs(places[i] - again) < BETWEEN)))
