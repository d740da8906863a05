"""Sums of tensor-product splines over depth and frequency, compiled."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from acoustube.base.types import Array
from acoustube.waves.scattering import Complex


@numba.njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
def sums(
    values: NDArray[np.complex64],
    slopes: NDArray[np.complex64],
    interval: NDArray[np.int64],
    hermite: Array,
    rates: Array,
    first: NDArray[np.int64],
    weights: Array,
    tilts: Array,
) -> Complex:
    """Return a spline's values and its derivatives by depth and by frequency, in steps.

    Parameters
    ----------
    values, slopes : ndarray
        Coefficients over frequency and their slopes by depth, at the depths, (n_depths, n_c, q).
    interval : ndarray
        Number of the interval of depths, (n,).
    hermite, rates : ndarray
        Weights of the values and slopes at its ends, and their derivatives by depth, (n, 4).
    first : ndarray
        Number of the first of four coefficients over frequency, (n, n_f).
    weights, tilts : ndarray
        Of these four, and their derivatives, (n, n_f, 4).

    Returns
    -------
    ndarray
        (3, n, n_f, q).
    """
    n, n_f = first.shape
    count, q = values.shape[1:]
    found = np.zeros((3, n, n_f, q), np.complex128)
    here = np.empty((2, count, q), np.complex128)
    for a in range(n):
        i = interval[a]
        w, r = hermite[a], rates[a]
        low, high = first[a].min(), first[a].max() + 4
        for f in range(low, high):
            for c in range(q):
                v0, v1 = values[i, f, c], values[i + 1, f, c]
                s0, s1 = slopes[i, f, c], slopes[i + 1, f, c]
                here[0, f, c] = w[0] * v0 + w[1] * v1 + w[2] * s0 + w[3] * s1
                here[1, f, c] = r[0] * v0 + r[1] * v1 + r[2] * s0 + r[3] * s1
        for k in range(n_f):
            j = first[a, k]
            w0, w1, w2, w3 = weights[a, k]
            t0, t1, t2, t3 = tilts[a, k]
            for c in range(q):
                x0, x1, x2, x3 = (
                    here[0, j, c],
                    here[0, j + 1, c],
                    here[0, j + 2, c],
                    here[0, j + 3, c],
                )
                found[0, a, k, c] = w0 * x0 + w1 * x1 + w2 * x2 + w3 * x3
                found[2, a, k, c] = t0 * x0 + t1 * x1 + t2 * x2 + t3 * x3
                found[1, a, k, c] = (
                    w0 * here[1, j, c]
                    + w1 * here[1, j + 1, c]
                    + w2 * here[1, j + 2, c]
                    + w3 * here[1, j + 3, c]
                )
    return found
