"""Compiled loops over the spectra and the baseband samples of echoes."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray

from acoustube.base.types import Array
from acoustube.inversion.small_matrices import OPTIONS
from acoustube.waves.scattering import Complex

Single = NDArray[np.float32]
SingleComplex = NDArray[np.complex64]


@numba.njit(**OPTIONS)
def propagated(
    real: Single, imaginary: Single, first: NDArray[np.int_], second: NDArray[np.int_],
    modes: SingleComplex,
) -> SingleComplex:  # fmt: skip
    """Return the spectra of echoes that travel to presses and back, each way in one of the modes.

    Parameters
    ----------
    real, imaginary : ndarray
        Parts of the spectra before propagation, (n_depths, n_parts, n_f).
    first, second : ndarray
        Indices of the two modes of each part, (n_parts,).
    modes : ndarray
        Propagation factors of the modes to the presses, (n_places, m, n_f).

    Returns
    -------
    ndarray
        Sums over the parts, (n_places, n_depths, n_f).
    """
    n_depths, parts, n_f = real.shape
    found = np.empty((len(modes), n_depths, n_f), np.complex64)
    there, across = np.empty((2, parts, n_f), np.float32)
    x, y = np.empty((2, n_f), np.float32)
    for a in range(len(modes)):
        for p in range(parts):
            one, other = modes[a, first[p]], modes[a, second[p]]
            for f in range(n_f):
                there[p, f] = one[f].real * other[f].real - one[f].imag * other[f].imag
                across[p, f] = one[f].real * other[f].imag + one[f].imag * other[f].real
        for d in range(n_depths):
            x[:] = 0
            y[:] = 0
            for p in range(parts):
                u, v, s, t = real[d, p], imaginary[d, p], there[p], across[p]
                for f in range(n_f):
                    x[f] += u[f] * s[f] - v[f] * t[f]
                    y[f] += u[f] * t[f] + v[f] * s[f]
            for f in range(n_f):
                found[a, d, f] = complex(x[f], y[f])
    return found


@numba.njit(**OPTIONS)
def energies(
    samples: SingleComplex, starts: NDArray[np.int_], stops: NDArray[np.int_], scale: Array,
    shape: Complex, absorbed: float,
) -> Single:  # fmt: skip
    """Return the energies of scaled echoes, less the absorbed part of one shape, (n, n_depths).

    An energy is ``sum |b|^2 - absorbed |sum conj(u) b|^2``, with the scaled samples b.

    Parameters
    ----------
    samples : ndarray
        Samples of the echoes, (n, n_depths, n_time).
    starts, stops : ndarray
        Index of the first sample of each echo that counts, and of the one after the last, (n,).
    scale : ndarray
        Factors of the samples, (n_time,).
    shape : ndarray
        The vector u, (n_time,).
    absorbed : float
        Factor of the energy along the shape.
    """
    n, n_depths, _ = samples.shape
    found = np.empty((n, n_depths), np.float32)
    for a in range(n):
        for d in range(n_depths):
            total, along, across = 0.0, 0.0, 0.0
            for t in range(starts[a], stops[a]):
                x, y = scale[t] * samples[a, d, t].real, scale[t] * samples[a, d, t].imag
                total += x * x + y * y
                along += shape[t].real * x + shape[t].imag * y
                across += shape[t].real * y - shape[t].imag * x
            found[a, d] = total - absorbed * (along * along + across * across)
    return found


@numba.njit(**OPTIONS)
def innovations(
    samples: Complex, scale: Array, shape: Complex, before: Array, gain: Array
) -> Complex:
    """Return whitened samples (rows, n): innovations of the estimate of an error's amplitude.

    The arguments are named as in :class:`acoustube.inversion.whitening.RankOneWeights`.

    Parameters
    ----------
    samples : ndarray
        (rows, n_time), of which the first n are used.
    scale : ndarray
        Root of `freedom`, divided by the independent errors' standard deviations, (n,).
    shape : ndarray
        The vector u, (n,).
    before, gain : ndarray
        ``s_(k-1)`` and ``sqrt(s_(k-1) / s_k)``, both (n,).
    """
    rows, n = len(samples), len(scale)
    found, shares = np.empty((rows, n), np.complex128), 1 / before
    for a in range(rows):
        along, across = 0.0, 0.0
        for k in range(n):
            x, y = scale[k] * samples[a, k].real, scale[k] * samples[a, k].imag
            u, v, share = shape[k].real, shape[k].imag, shares[k]
            found[a, k] = complex(
                gain[k] * (x - share * (u * along - v * across)),
                gain[k] * (y - share * (u * across + v * along)),
            )
            along += u * x + v * y
            across += u * y - v * x
    return found
