"""Elements along a lumen: short where its section changes, and limited by the wavelength."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from acoustube.waves.spectral.polynomials import Array
from acoustube.waves.spectral.walls import Wall

LEAD = 0.5
"""Length of straight bore between the lumen and a port, in radii."""
SHORT, LONG = 0.65, 1.2
"""Largest element length on a sloping and on an almost straight wall, in radii."""
SHORT_WAVE, LONG_WAVE = 0.45, 0.85
"""Largest element lengths in wavelengths."""
SLOPE = 0.1
"""Slope of the box's sides above which the wall counts as sloping."""
SAMPLES = 400


def partition(wall: Wall, wavenumber: float) -> Array:
    """Return the boundaries of the elements in m, from port to port or from the plane of symmetry.

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
    x, y, *_ = wall.lines(z)
    extent = np.stack([x.min(axis=1), x.max(axis=1), y.min(axis=1), y.max(axis=1)])
    steep = np.abs(np.gradient(extent, z, axis=1)).max(axis=0) > SLOPE
    wave = 2 * np.pi / wavenumber
    short, long = (
        min(a * wall.radius, b * wave) for a, b in ((SHORT, SHORT_WAVE), (LONG, LONG_WAVE))
    )
    density = np.where(steep, 1 / short, 1 / long)
    passed = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(z))])
    pieces = [_between(*ends, z, passed) for ends in pairwise(borders)]
    edges = np.concatenate([[start], *(piece[1:] for piece in pieces), [wall.ends[1] + lead]])
    return edges if wall.reversible else np.concatenate([[start - lead], edges])


def _between(low: float, high: float, z: Array, passed: Array) -> Array:
    """Return the boundaries of an interval's elements, with equal integrals of the density."""
    first, last = np.interp([low, high], z, passed)
    n = max(1, int(np.ceil(last - first - 1e-9)))
    inner = np.interp(np.linspace(first, last, n + 1)[1:-1], passed, z)
    return np.concatenate([[low], inner, [high]])


def split(edges: Array, which: NDArray[np.bool_]) -> Array:
    """Return the element boundaries after bisection of some elements."""
    middle = (edges[:-1] + edges[1:])[which] / 2
    return np.sort(np.concatenate([edges, middle]))
