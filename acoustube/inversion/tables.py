"""Scattering of a tool at any depth and stretch of frequency, with both derivatives, in bulk."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import spline_filter1d

from acoustube.base.types import Array
from acoustube.inversion.tools import Tool
from acoustube.waves.scattering import Complex


class Matrices(NamedTuple):
    """Scattering matrices of presses and their derivatives; each (n, n_f, 2, m, 2, m).

    Attributes
    ----------
    value : ndarray
    by_depth : ndarray
        Per m.
    by_stretch : ndarray
        Per relative change of frequency.
    """

    value: Complex
    by_depth: Complex
    by_stretch: Complex


class ToolTable:
    """Bicubic splines of a tool's scattering, over depth and frequency.

    Parameters
    ----------
    tool : Tool
    frequency : ndarray
        In Hz, (n_f,), with a margin to the ends of the tool's band for stretches.
    modes : int
        Number of modes to keep, the plane mode first.

    Notes
    -----
    Over the frequencies, which are even, by the coefficients of B-splines; these are splined over
    the depths, which are not. Derivatives are those of the interpolation itself.
    """

    def __init__(self, tool: Tool, frequency: Array, modes: int) -> None:
        self.tool, self.frequency, self.modes = tool, frequency, modes
        kept = np.ascontiguousarray(tool.s[:, :, :, :modes, :, :modes]).astype(complex)
        flat = kept.reshape(len(tool.depth), len(tool.frequency), -1)
        filtered = spline_filter1d(flat, axis=1, mode="mirror", output=complex)
        self.pieces = CubicSpline(tool.depth, filtered).c
        self.start = float(tool.frequency[0])
        self.step = float(tool.frequency[1] - tool.frequency[0])

    @property
    def range(self) -> tuple[float, float]:
        """Shallowest and deepest depth in m."""
        return float(self.tool.depth[0]), float(self.tool.depth[-1])

    def __call__(self, depth: Array, stretch: Array) -> Matrices:
        """Return the matrices at depths in m and relative stretches of frequency, both (n,)."""
        value, slope = self._over_depth(np.asarray(depth, float))
        place = (np.outer(1 + np.asarray(stretch), self.frequency) - self.start) / self.step
        first = np.clip(np.floor(place).astype(int), 1, len(self.tool.frequency) - 3)
        weights, slopes = _b_spline(place - first)
        rows = np.arange(len(first))[:, None]
        shape = (*first.shape, 2, self.modes, 2, self.modes)
        found, by_depth, by_place = (np.zeros((*first.shape, value.shape[2]), complex)
                                     for _ in range(3))  # fmt: skip
        for j in range(4):
            at = value[rows, first + j - 1]
            found += weights[j][..., None] * at
            by_place += slopes[j][..., None] * at
            by_depth += weights[j][..., None] * slope[rows, first + j - 1]
        by_stretch = by_place * (self.frequency / self.step)[None, :, None]
        return Matrices(*(part.reshape(shape) for part in (found, by_depth, by_stretch)))

    def _over_depth(self, depth: Array) -> tuple[Complex, Complex]:
        """Return the coefficients over frequency at depths and their slopes, (n, n_f, values)."""
        nodes = self.tool.depth
        i = np.clip(np.searchsorted(nodes, depth, side="right") - 1, 0, len(nodes) - 2)
        a, b, c, d = (piece[i] for piece in self.pieces)
        x = (depth - nodes[i])[:, None, None]
        return ((a * x + b) * x + c) * x + d, (3 * a * x + 2 * b) * x + c


def _b_spline(u: NDArray[np.float64]) -> tuple[list[Array], list[Array]]:
    """Return the four cubic B-splines that are not zero at u in 0 to 1, and their slopes."""
    v = 1 - u
    values = [v**3 / 6, 2 / 3 - u**2 + u**3 / 2, 2 / 3 - v**2 + v**3 / 2, u**3 / 6]
    slopes = [-(v**2) / 2, -2 * u + 1.5 * u**2, 2 * v - 1.5 * v**2, u**2 / 2]
    return values, slopes
