"""Elements along a lumen: short where the section changes, and shorter than the wavelength."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from acoustube.waves.spectral.polynomials import Array
from acoustube.waves.spectral.walls import Wall

LEAD = 0.5
"""Length of straight bore between the lumen and a port, in radii."""
LONGEST, LONGEST_WAVE = 1.2, 0.85
"""Largest element lengths, in radii and in wavelengths; the smaller one limits the elements."""
FEWEST = 3
"""Least number of elements of half a lumen, because a short lumen has short features."""
PER_CHANGE = 1.0
"""Number of additional elements per change of a section's height or width by a factor of e."""
SHORTEST = 0.3
"""Smallest initial length of an element in radii; elements may be divided to reduce errors."""
SAMPLES = 400


def partition(wall: Wall, wavenumber: float) -> Array:
    """Return the boundaries of the elements in m, from the first port or plane of symmetry on.

    Parameters
    ----------
    wall : Wall
    wavenumber : float
        Highest wavenumber of interest, in 1/m.
    """
    lead = LEAD * wall.radius
    start = wall.middle if wall.reversible else wall.ends[0]
    borders = [start, *(z for z in sorted(wall.breaks) if start < z < wall.ends[1]), wall.ends[1]]
    z = np.linspace(start, wall.ends[1], SAMPLES)
    half = (wall.ends[1] - start) / (1 if wall.reversible else 2)
    longest = min(LONGEST * wall.radius, LONGEST_WAVE * 2 * np.pi / wavenumber, half / FEWEST)
    density = 1 / longest + PER_CHANGE * _change(wall, z)
    density = np.minimum(density, 1 / min(SHORTEST * wall.radius, longest))
    passed = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(z))])
    pieces = [_between(*ends, z, passed) for ends in pairwise(borders)]
    edges = np.concatenate([[start], *(piece[1:] for piece in pieces), [wall.ends[1] + lead]])
    return edges if wall.reversible else np.concatenate([[start - lead], edges])


def _change(wall: Wall, z: Array) -> Array:
    """Return the relative change per length of a section's height or width, the larger, in 1/m."""
    x, y, *_ = wall.lines(z)
    found = []
    for part in (x, y):
        low, high = part.min(axis=1), part.max(axis=1)
        moved = np.abs(np.gradient(low, z)) + np.abs(np.gradient(high, z))
        found.append(moved / (high - low))
    return np.maximum(*found)


def _between(low: float, high: float, z: Array, passed: Array) -> Array:
    """Return the boundaries in m of elements between `low` and `high`.

    The density of elements, whose integral up to `z` is `passed`, has equal integrals over them.
    """
    first, last = np.interp([low, high], z, passed)
    n = max(1, int(np.ceil(last - first - 1e-9)))
    inner = np.interp(np.linspace(first, last, n + 1)[1:-1], passed, z)
    return np.concatenate([[low], inner, [high]])


def split(edges: Array, which: NDArray[np.bool_]) -> Array:
    """Return the element boundaries after bisection of some elements."""
    middle = (edges[:-1] + edges[1:])[which] / 2
    return np.sort(np.concatenate([edges, middle]))
