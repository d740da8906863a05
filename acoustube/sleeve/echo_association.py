"""Removal of ghost echoes: filter side lobes, trapped sound and multiple reflections.

The thresholds were set on the simulated presses of ``acoustube reproduce human``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acoustube.base.checks import GAPS, check_alike, checked
from acoustube.base.types import Array

SIDE_LOBE_RATIO = 0.12
"""Largest amplitude of a side lobe of the low-pass filter, relative to its echo."""
SIDE_LOBE_DISTANCE = 0.10
"""Largest distance between a side lobe and its echo, in m."""
TRAPPED_SOUND_DISTANCE = 0.18
"""Largest distance behind a press at which trapped sound appears, in m."""
SECOND_PRESS_RATIO = 2.0
"""Amplitude of an echo less than `TRAPPED_SOUND_DISTANCE` behind another, relative to the latter,
from which on the echo counts as a press, not as trapped sound."""
MULTIPLE_REFLECTION_TOLERANCE = 0.04
"""Tolerance of the distance of a multiple reflection between two presses, in m."""


@checked(places=GAPS, heights=GAPS)
def remove_ghost_echoes(places: ArrayLike, heights: ArrayLike) -> Array:
    """Remove ghost echoes: echoes of a cycle that another contact of the cycle causes.

    Parameters
    ----------
    places, heights : array_like of shape (n,)
        Distances in m and amplitudes in any unit of the candidate echoes of one sensor. Those with
        a distance or an amplitude that is nan or infinite are left out.

    Returns
    -------
    ndarray of shape (m,)
        Distances of the remaining echoes in m, in increasing order.

    Notes
    -----
    In the order of distance, an echo is removed if it is

    1. a side lobe of the low-pass filter: under 12 % of an echo less than 10 cm away;
    2. trapped sound: less than 18 cm behind the last echo that was kept, and under twice as high,
       since sound trapped near a deep press leaks out as much as 1 ms late;
    3. a multiple reflection: from a press b to a nearer press a and to b again, which arrives from
       the distance 2 b - a, and is lower than the echo of b.

    Two presses under 18 cm apart count as one contact unless the farther echo is twice as high.
    Sound that is trapped for longer than 1 ms cannot be distinguished from another press behind a
    harder one.
    """
    check_alike(places=places, heights=heights)
    place, height = (np.asarray(values, float).ravel() for values in (places, heights))
    known = np.isfinite(place) & np.isfinite(height)
    place, height = place[known], height[known]
    order = np.argsort(place)
    place, height = place[order], height[order]
    near = np.abs(place[:, None] - place) < SIDE_LOBE_DISTANCE
    lobe = np.any(near & (height[:, None] < SIDE_LOBE_RATIO * height), axis=1)
    kept: list[int] = []
    for i in np.flatnonzero(~lobe).tolist():
        if not kept or not _is_ghost(i, np.array(kept), place, height):
            kept.append(i)
    return place[kept]


def _is_ghost(i: int, kept: NDArray[np.int64], places: Array, heights: Array) -> bool:
    """Return whether an echo is trapped sound or a multiple reflection of nearer presses."""
    last = kept[-1]
    close = places[i] - places[last] < TRAPPED_SOUND_DISTANCE
    if close and heights[i] < SECOND_PRESS_RATIO * heights[last]:
        return True
    multiple = 2 * places[kept][:, None] - places[kept]
    nearer = places[kept][:, None] > places[kept]
    lower = heights[i] < heights[kept][:, None]
    near = np.abs(places[i] - multiple) < MULTIPLE_REFLECTION_TOLERANCE
    return bool(np.any(nearer & lower & near))
