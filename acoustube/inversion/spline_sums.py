"""Compiled evaluation of splines over depth and frequency, and over place and temperature.

Complex coefficients over depth are passed as twice as many real ones, so that the loops are
vectorised.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from acoustube.base.types import Array
from acoustube.inversion.small_matrices import OPTIONS
from acoustube.waves.scattering import Complex


@numba.njit(**OPTIONS)
def sums(
    values: NDArray[np.float32],
    slopes: NDArray[np.float32],
    depths: Array,
    depth: Array,
    places: Array,
    rates: Array,
) -> Array:
    """Return a spline's values and its derivatives by depth and by a stretch of the frequencies.

    The interpolation is by cubic Hermite splines over depth, by cubic B-splines over frequency.

    Parameters
    ----------
    values, slopes : ndarray
        The n_c B-spline coefficients over frequency of q real functions, and their derivatives by
        depth, at each of `depths`, (n_depths, n_c, q).
    depths : ndarray
        Depths of the coefficients, rising, in m, (n_depths,).
    depth : ndarray
        Depths to interpolate to, in m, (n,).
    places : ndarray
        Positions of the frequencies to interpolate to, in steps of the coefficients, rising,
        (n, n_f).
    rates : ndarray
        Derivatives of these positions by the stretch, (n_f,).

    Returns
    -------
    ndarray
        Values, derivatives by depth and derivatives by the stretch, (3, n, n_f, q).
    """
    n, n_f = places.shape
    count, q = values.shape[1:]
    found = np.empty((3, n, n_f, q))
    here, moved = np.empty((2, count, q))
    for a in range(n):
        i = min(max(np.searchsorted(depths, depth[a], side="right") - 1, 0), len(depths) - 2)
        step = depths[i + 1] - depths[i]
        x = (depth[a] - depths[i]) / step
        y = 1 - x
        a0, a1 = (1 + 2 * x) * y**2, x**2 * (1 + 2 * y)
        b0, b1 = step * x * y**2, -step * x**2 * y
        c1, d0, d1 = 6 * x * y / step, y * (1 - 3 * x), x * (3 * x - 2)
        first = min(max(int(np.floor(places[a, 0])), 1), count - 3) - 1
        last = min(max(int(np.floor(places[a, -1])), 1), count - 3) + 3
        for f in range(first, last):
            for c in range(q):
                v0, v1 = np.float64(values[i, f, c]), np.float64(values[i + 1, f, c])
                s0, s1 = np.float64(slopes[i, f, c]), np.float64(slopes[i + 1, f, c])
                here[f, c] = a0 * v0 + a1 * v1 + b0 * s0 + b1 * s1
                moved[f, c] = c1 * (v1 - v0) + d0 * s0 + d1 * s1
        for k in range(n_f):
            j = min(max(int(np.floor(places[a, k])), 1), count - 3)
            u = places[a, k] - j
            v = 1 - u
            w0, w1 = v**3 / 6, 2 / 3 - u**2 + u**3 / 2
            w2, w3 = 2 / 3 - v**2 + v**3 / 2, u**3 / 6
            rate = rates[k]
            t0, t1 = -rate * v**2 / 2, rate * (1.5 * u**2 - 2 * u)
            t2, t3 = rate * (2 * v - 1.5 * v**2), rate * u**2 / 2
            x0, x1, x2, x3 = here[j - 1], here[j], here[j + 1], here[j + 2]
            y0, y1, y2, y3 = moved[j - 1], moved[j], moved[j + 1], moved[j + 2]
            for c in range(q):
                found[0, a, k, c] = w0 * x0[c] + w1 * x1[c] + w2 * x2[c] + w3 * x3[c]
                found[1, a, k, c] = w0 * y0[c] + w1 * y1[c] + w2 * y2[c] + w3 * y3[c]
                found[2, a, k, c] = t0 * x0[c] + t1 * x1[c] + t2 * x2[c] + t3 * x3[c]
    return found


@numba.njit(**OPTIONS)
def between(
    values: NDArray[np.complex64],
    slopes: NDArray[np.complex64],
    rows: Array,
    columns: Array,
    row_step: float,
    column_step: float,
) -> Complex:
    """Return values of an evenly spaced table, and derivatives by column and by row, (3, n, n_f).

    The interpolation is cubic Hermite over the rows and linear over the columns. Positions are in
    steps.

    Parameters
    ----------
    values, slopes : ndarray
        Values at the nodes, and their derivatives per step between rows, (n_rows, n_columns, n_f).
    rows, columns : ndarray
        Positions to interpolate to, (n,): from 0 to less than n_rows - 1 and n_columns - 1.
    row_step, column_step : float
        Steps of the table, by which the derivatives are divided.
    """
    n_f = values.shape[2]
    found = np.empty((3, len(rows), n_f), np.complex128)
    for a in range(len(rows)):
        i, j = int(rows[a]), int(columns[a])
        x, z = rows[a] - i, columns[a] - j
        y = 1 - x
        h0, h1, h2, h3 = (1 + 2 * x) * y**2, x**2 * (1 + 2 * y), x * y**2, -(x**2) * y
        g1, g2, g3 = 6 * x * y / row_step, y * (1 - 3 * x) / row_step, x * (3 * x - 2) / row_step
        c0, c1, c2, c3 = h0 / column_step, h1 / column_step, h2 / column_step, h3 / column_step
        for f in range(n_f):
            low, high = values[i, j, f], values[i + 1, j, f]
            low_step = values[i, j + 1, f] - low
            high_step = values[i + 1, j + 1, f] - high
            rate, late = slopes[i, j, f], slopes[i + 1, j, f]
            rate_step = slopes[i, j + 1, f] - rate
            late_step = slopes[i + 1, j + 1, f] - late
            found[1, a, f] = c0 * low_step + c1 * high_step + c2 * rate_step + c3 * late_step
            low, high = low + z * low_step, high + z * high_step
            rate, late = rate + z * rate_step, late + z * late_step
            found[0, a, f] = h0 * low + h1 * high + h2 * rate + h3 * late
            found[2, a, f] = g1 * (high - low) + g2 * rate + g3 * late
    return found
