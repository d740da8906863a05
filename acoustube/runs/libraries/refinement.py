"""Refinement of the depths of a tool by bisection, until interpolation between them is accurate.

The error of interpolation by cubic splines over depth is estimated by leave-one-out
cross-validation. Intervals of depth in which it is too large are bisected level by level.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from scipy.interpolate import CubicSpline

from acoustube.base.types import Array
from acoustube.inversion.tools import FEWEST_DEPTHS
from acoustube.waves.scattering import Complex
from acoustube.waves.spectral import SpectralScattering

GAIN_OF_BISECTION = 6.0
"""Assumed factor by which bisection of an interval reduces the interpolation error of a cubic
spline; it is 16 for the smoothest functions."""
REACH = 8
"""Number of depths on each side of a left-out depth from which its scattering is interpolated."""
WIDEST_GAP = 1.6
"""Widest gap that failed depths may leave, relative to the largest step before bisection."""
FINEST = 1 / 32
"""Smallest step of depth, relative to the smallest step before bisection."""


class Refinement:
    """Scattering of a tool at the depths computed so far, and the depths that it lacks.

    Parameters
    ----------
    tolerance : float
        Largest expected error of interpolation, as :func:`deviation` measures it.
    first : sequence of float
        Depths in m to begin with.
    """

    def __init__(self, tolerance: float, first: Sequence[float]) -> None:
        self.tolerance, self.first = tolerance, first
        self.known: dict[float, SpectralScattering] = {}
        self.waiting: set[float] = set(first)
        self.failed: dict[float, str] = {}
        self.level: list[float] = []
        self.least = FINEST * min(np.diff(first))

    def add(self, depth: float, found: SpectralScattering) -> None:
        """Add the scattering at a depth in m."""
        self.known[depth] = found
        self.waiting.discard(depth)

    def fail(self, depth: float, reason: str) -> None:
        """Leave out a depth in m that cannot be computed."""
        self.failed[depth] = reason
        self.waiting.discard(depth)

    @property
    def depths(self) -> list[float]:
        """Rising depths in m computed so far, up to the first gap too wide to interpolate over."""
        depths = sorted(self.known)
        gaps = np.diff(depths)
        wide = np.flatnonzero(gaps > WIDEST_GAP * max(np.diff(self.first)))
        return depths[: wide[0] + 1] if len(wide) else depths

    @property
    def reason(self) -> str:
        """Reason why the depths end before the last requested one; empty if they do not."""
        last = max(self.depths, default=0.0)
        return next((self.failed[d] for d in sorted(self.failed) if d > last), "")

    def next(self) -> list[float]:
        """Return the depths in m of the next level of bisection; none at the end.

        To be called once all depths of the current level are known. The new depths are the middles
        of all intervals at first, then of those whose interpolation error exceeds the tolerance.
        """
        depths = self.depths
        if len(depths) < FEWEST_DEPTHS:
            return []
        error = self.between() if self.level else np.full(len(depths) - 1, np.inf)
        self.level = [
            round((a + b) / 2, 12)
            for (a, b), one in zip(itertools.pairwise(depths), error, strict=True)
            if one > self.tolerance and b - a > 1.5 * self.least
        ]
        self.level = [depth for depth in self.level if depth not in self.failed]
        self.waiting = set(self.level)
        return self.level

    def between(self) -> Array:
        """Return the expected error of interpolation between each depth and the next, (n - 1,).

        It is estimated by leave-one-out cross-validation; inf if there are too few depths. The
        error at a depth left out is taken as proportional to the product of the squared distances
        to its neighbours, the error in an interval to the fourth power of the interval's length.
        """
        depths = np.array(self.depths)
        known = np.array([self.known[d].s[:, :, :1, :, :1] for d in self.depths])
        steps = np.diff(depths)
        found = np.zeros(len(steps))
        for i in range(1, len(depths) - 1):
            near = np.arange(max(i - REACH, 0), min(i + REACH + 1, len(depths)))
            near = near[near != i]
            if len(near) < FEWEST_DEPTHS:
                return np.full(len(steps), np.inf)
            error = deviation(CubicSpline(depths[near], known[near])(depths[i]), known[i])
            beside = slice(i - 1, i + 1)
            scale = error / np.prod(steps[beside]) ** 2 / GAIN_OF_BISECTION
            found[beside] = np.maximum(found[beside], scale * steps[beside] ** 4)
        return found


def deviation(found: Complex, exact: Complex) -> float:
    """Return the error of a scattering matrix, (n_f, 2, m, 2, m), over the band.

    It is the larger of two: the rms error of the plane wave's reflection coefficient relative to
    the rms of this coefficient, and the rms error of its transmission coefficient.
    """
    plane = np.sqrt(np.mean(np.abs((found - exact)[:, :, 0, 0, 0]) ** 2, axis=0))
    return float(max(plane[0] / np.sqrt(np.mean(np.abs(exact[:, 0, 0, 0, 0]) ** 2)), plane[1]))
