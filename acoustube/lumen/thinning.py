"""Decimation of the rings of a deformed wall, for files and pictures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from acoustube.base.checks import Reals, check_alike, checked

RINGS = 49
"""Largest number of rings kept; in the default tube the others are interpolated to within 20 um."""
AROUND = 120
"""Smallest number of points to which a ring is thinned; see `decimate_rings`."""


@checked(inner=Reals(-1e6, 1e6, "m", ndim=3, last=3), outer=Reals(-1e6, 1e6, "m", ndim=3, last=3))
def decimate_rings(
    inner: NDArray[np.float64], outer: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Reduce the numbers of rings and of points per ring, at a small error of interpolation.

    Parameters
    ----------
    inner, outer : array of shape (n_rings, n_around, 3)
        Rings in m as in :class:`acoustube.lumen.Lumen`, with the indenter at z = 0.

    Returns
    -------
    inner, outer : array of shape (RINGS or n_rings, n_kept, 3)
        At most `RINGS` rings, with the first, the last and that at the indenter. Of each ring every
        k-th point is kept, with k = n_around // `AROUND`, or every point if k is 0 or the top would
        be omitted.
    """
    check_alike(inner=inner, outer=outer)
    step = max(1, inner.shape[1] // AROUND)
    # Bottom and top are points 0 and n/2 of a ring, which must both stay.
    step = step if inner.shape[1] % (2 * step) == 0 else 1
    both = np.stack([inner, outer], axis=1)[:, :, ::step]
    middle = int(np.argmin(np.abs(inner[:, 0, 2])))
    rings = _most_informative_rings(
        both.reshape(len(both), -1, 3), {0, middle, len(both) - 1}, RINGS
    )
    return both[rings, 0], both[rings, 1]


def _most_informative_rings(rings: NDArray[np.float64], kept: set[int], count: int) -> list[int]:
    """Return the numbers of rings to keep; each added ring has the largest interpolation error."""
    while len(kept) < min(count, len(rings)):
        known = sorted(kept)
        right = np.clip(np.searchsorted(known, np.arange(len(rings))), 1, len(known) - 1)
        low, high = np.asarray(known)[right - 1], np.asarray(known)[right]
        z = rings[:, 0, 2]  # of the rings' first points
        fraction = ((z - z[low]) / (z[high] - z[low]))[:, None, None]
        error = np.abs(rings - (1 - fraction) * rings[low] - fraction * rings[high])
        off = error.max(axis=(1, 2))
        off[known] = -1.0
        kept.add(int(np.argmax(off)))
    return sorted(kept)
