"""Rings of a deformed wall thinned to those that describe it best."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

RINGS = 49
"""Rings that are kept; for a press of the paper's tube the others lie within 20 um of them."""
AROUND = 120
"""Points of a ring that are kept, at most."""


def decimate_rings(
    inner: NDArray[np.float64], outer: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Leave those rings and points that tell the shape of both walls.

    Parameters
    ----------
    inner, outer : array of shape (n_rings, n_around, 3)
        Rings in m as in :class:`acoustube.lumen.Lumen`, the press at z = 0.

    Returns
    -------
    inner, outer : array of shape (RINGS or n_rings, AROUND or n_around, 3)
        Whichever is less. The ring at the press is one of them, bottom and top of each ring too.
    """
    step = max(1, inner.shape[1] // AROUND)
    # Bottom and top are points 0 and n/2 of a ring, which must both stay.
    step = step if inner.shape[1] % (2 * step) == 0 else 1
    both = np.stack([inner, outer], axis=1)[:, :, ::step]
    middle = int(np.argmin(np.abs(inner[:, 0, 2])))
    rings = _telling(both.reshape(len(both), -1, 3), {0, middle, len(both) - 1}, RINGS)
    return both[rings, 0], both[rings, 1]


def _telling(rings: NDArray[np.float64], kept: set[int], count: int) -> list[int]:
    """Return which rings to keep: the one that is farthest off the others is added, and so on."""
    while len(kept) < min(count, len(rings)):
        known = sorted(kept)
        right = np.clip(np.searchsorted(known, np.arange(len(rings))), 1, len(known) - 1)
        low, high = np.asarray(known)[right - 1], np.asarray(known)[right]
        share = _share(rings[:, 0, 2], low, high)[:, None, None]
        off = np.abs(rings - (1 - share) * rings[low] - share * rings[high]).max(axis=(1, 2))
        off[known] = -1.0
        kept.add(int(np.argmax(off)))
    return sorted(kept)


def _share(z: NDArray[np.float64], low: Any, high: Any) -> NDArray[np.float64]:
    """Return how far between two rings each lies, by its first point."""
    return (z - z[low]) / (z[high] - z[low])
