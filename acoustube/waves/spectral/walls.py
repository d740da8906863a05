"""Walls of lumens as contours of their sections.

A wall is a family of closed contours x(t, z), y(t, z), with t from 0 to 2 pi. Lines of constant t
run along the tube, and lines of constant z around it, anticlockwise seen with z towards the reader.
Its ends are straight; round ends lie about x = y = 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from math import factorial
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from acoustube.base.errors import ConfigError
from acoustube.waves.spectral.polynomials import Array, gauss

LEAST_POINTS, MOST_POINTS = 1, 8
"""Smallest and largest number of Gauss points between two neighbouring points of a contour."""


class Contours(NamedTuple):
    """Contours of sections at quadrature points, each quantity (n_sections, n_points).

    Attributes
    ----------
    x, y : ndarray
        Points in m.
    x_t, y_t : ndarray
        Derivatives with respect to t, in m.
    x_z, y_z : ndarray
        Derivatives along the tube, at constant t, dimensionless.
    t : ndarray
        Parameter of the points, (n_points,).
    weight : ndarray
        Quadrature weights over t, (n_points,). For a wall symmetric about x = 0 the points are
        those of one half, and the weights are doubled.
    """

    x: Array
    y: Array
    x_t: Array
    y_t: Array
    x_z: Array
    y_z: Array
    t: Array
    weight: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Wall:
    """The wall of a lumen between straight ends.

    Attributes
    ----------
    lines : callable
        Takes z (n,) in m and returns x, y and their z derivatives, each (n, n_points), at
        evenly spaced t.
    ends : tuple of float
        Start and end, z in m, of the part that is not straight.
    radius : float
        Radius of the ends, or of the circle of equal area, in m.
    breaks : tuple of float
        Coordinates z in m, other than `ends`, at which the wall is not smooth along z.
    symmetric : bool
        True if symmetric about x = 0.
    reversible : bool
        True if symmetric about the plane z = `middle`.
    middle : float
        Coordinate z of the middle in m.
    circular : bool
        True if the straight ends are round, about x = y = 0.
    sealing_gap : float
        Height in m of a gap that is half sealed in a computation with losses; zero if no gap is
        sealed. See `layers.SEALING_WIDTH`.
    knots : ndarray
        Coordinates z in m between which the wall is smooth; empty if it is smooth everywhere.
    unmoved : Wall or None
        The wall of which this one is a small displacement, or None.
    """

    lines: Callable[[Array], tuple[Array, Array, Array, Array]]
    ends: tuple[float, float]
    radius: float
    breaks: tuple[float, ...] = ()
    symmetric: bool = True
    reversible: bool = False
    middle: float = 0.0
    circular: bool = True
    sealing_gap: float = 0.0
    knots: Array = field(default_factory=lambda: np.zeros(0))
    unmoved: Wall | None = None

    def contours(self, z: Array, degree: int) -> Contours:
        """Return the contours at z (n,) in m, as cubic splines through the points of the lines.

        The number of quadrature points suffices for products of two polynomials of total degree
        `degree`.
        """
        lines = self.lines(z)
        n = lines[0].shape[1]
        value, slope, t, weight = _spline(n, _gauss_points(n, degree), self.symmetric)
        x, y, x_z, y_z = (part @ value for part in lines)
        return Contours(x, y, lines[0] @ slope, lines[1] @ slope, x_z, y_z, t, weight)


def _gauss_points(n: int, degree: int) -> int:
    """Return the number of Gauss points for polynomials on one of n pieces of a contour.

    Notes
    -----
    The relative error of Gauss's rule with g points is (k h)^(2g) (g!)^4 / ((2g + 1) (2g)!^3) on a
    piece h = 2 pi / n of the contour's parameter, for a wavenumber k in this parameter, here twice
    the degree. It has to be small compared with the least eigenvalue of the Gram matrix of Legendre
    polynomials over a disc, because the matrix would otherwise not be positive definite. This
    eigenvalue is 3e-6 at degree 10, and 30 times smaller for every two degrees more.
    """
    step = 4 * np.pi * degree / n
    allowed = 1e-2 * 3e-6 * 30.0 ** ((10 - degree) / 2)
    for g in range(LEAST_POINTS, MOST_POINTS):
        error = step ** (2 * g) * factorial(g) ** 4 / ((2 * g + 1) * factorial(2 * g) ** 3)
        if error < allowed:
            return g
    return MOST_POINTS


@lru_cache(maxsize=8)
def _spline(n: int, n_gauss: int, half: bool) -> tuple[Array, Array, Array, Array]:
    """Return the matrices from n values round a contour to their spline at Gauss's points.

    Returns
    -------
    value, slope : ndarray
        Matrices for the values and for their derivatives with respect to t, (n, n_points).
    t, weight : ndarray
        Gauss's points and weights, (n_points,).
    """
    n_pieces = n // 2 if half else n
    point, share = gauss(n_gauss, 0.0, 1.0)
    t = (np.arange(n_pieces)[:, None] + point).ravel() * 2 * np.pi / n
    ones = np.concatenate([np.eye(n), np.eye(n)[:1]])
    spline = CubicSpline(2 * np.pi * np.arange(n + 1) / n, ones, bc_type="periodic")
    weight = np.tile(share, n_pieces) * 2 * np.pi / n
    return spline(t).T, spline(t, 1).T, t, weight * (2 if half else 1)


def analytic_wall(
    shape: Callable[[Array, Array], tuple[Array, Array, Array, Array]],
    *,
    ends: tuple[float, float],
    radius: float,
    n_points: int = 96,
    symmetric: bool = True,
    reversible: bool = False,
) -> Wall:
    """Return the wall of a lumen with round ends from a formula.

    Parameters
    ----------
    shape : callable
        Takes z (n, 1) in m and t (n_points,) from 0 to 2 pi, and returns x and y in m and their z
        derivatives, each (n, n_points) or of a shape that broadcasts to it.
    ends : tuple of float
        Start and end, z in m, of the part that is not straight.
    radius : float
        Radius of the ends in m.
    n_points : int
        Number of points around; even, with the first at the bottom if symmetric about x = 0.
    symmetric, reversible : bool
        True if symmetric about x = 0, and if symmetric about the plane midway between the ends.

    Returns
    -------
    Wall

    Raises
    ------
    ConfigError
        If the number of points is odd and the wall symmetric.
    """
    if symmetric and n_points % 2:
        raise ConfigError(
            "is odd, and the points of a symmetric wall lie in pairs", setting="n_points",
            value=n_points, advice=f"use {n_points + 1}",
        )  # fmt: skip
    t = 2 * np.pi * np.arange(n_points) / n_points

    def lines(z: Array) -> tuple[Array, Array, Array, Array]:
        like = np.zeros((len(z), n_points))
        x, y, x_z, y_z = (like + part for part in shape(z[:, None], t))
        return x, y, x_z, y_z

    return Wall(
        lines=lines, ends=ends, radius=radius, symmetric=symmetric, reversible=reversible,
        middle=(ends[0] + ends[1]) / 2,
    )  # fmt: skip
