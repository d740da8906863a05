"""The deformed walls of a pressed tube, thinned out for files and pictures."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from acoustube.lumen import Lumen, profile, ring_faces
from acoustube.record import variable

RINGS = 49
"""Rings that are kept; for a press of the paper's tube the others lie within 20 um of them."""
AROUND = 120
"""Points of a ring that are kept, at most."""
MANTISSA = 12
"""Bits of a coordinate's mantissa that are kept: 1e-4 of it, which packs twice as small."""


def walls(part: Lumen) -> xr.Dataset:
    """Gather the walls of a pressed part and its lumen's area along the tube.

    Parameters
    ----------
    part : Lumen
        From :func:`acoustube.lumen.pressed_part`.

    Returns
    -------
    xarray.Dataset
        ``inner_wall`` and ``outer_wall`` (ring, around, xyz), `RINGS` by `AROUND` points in m, and
        ``area_profile`` (z) in m2; the press at z = 0.
    """
    here = np.array([0.0, 0.0, part.position])
    inner, outer = thinned(part.rings - here, part.outer_rings - here)
    surface = (part.rings - here).reshape(-1, 3), ring_faces(*part.rings.shape[:2])
    z = part.rings[1:-1, 0, 2] - part.position
    along = profile(*surface, z)
    table = {
        "inner_wall": variable("ring around xyz", _rounded(inner), "m", "rings of the inner wall"),
        "outer_wall": variable("ring around xyz", _rounded(outer), "m", "rings of the outer wall"),
        "area_profile": variable("z", _rounded(along.area), "m2", "cross-section of the lumen"),
        "z": variable("z", z, "m", "distance from the press"),
        "xyz": variable("xyz", ["x", "y", "z"], "1", "across, up, along the tube"),
    }
    return xr.Dataset(table, attrs={"title": "Walls of a pressed tube, the press at z = 0"})


def thinned(
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


def _rounded(values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return values whose last bits are zero."""
    last = 23 - MANTISSA
    bits = np.asarray(values, np.float32).view(np.uint32) + np.uint32(1 << (last - 1))
    return (bits & ~np.uint32((1 << last) - 1)).view(np.float32)
