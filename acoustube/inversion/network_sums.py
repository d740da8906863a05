"""Compiled loops for the echo of presses joined by straight tube, and its derivatives.

The loops run frequency by frequency. The equations are in :mod:`acoustube.inversion.network`.
"""

from __future__ import annotations

import numba
import numpy as np

from acoustube.base.types import Array
from acoustube.inversion.small_matrices import (
    OPTIONS,
    Vector,
    added,
    apply,
    apply_left,
    block,
    compiled,
    dot,
    each,
    inverse,
    keep,
    kept,
    plus,
    product,
    scaled,
    times,
    unit_less,
)
from acoustube.waves.scattering import Complex


@compiled
def _wavenumber(
    k: complex, heat: complex, transverse: float, warmer: float, wider: float
) -> Vector:
    """Return a mode's wavenumber in 1/m and its derivatives by temperature and width of the bore.

    The temperature is `warmer` K above the nominal one, and the bore wider by the ratio `wider`.
    `k` is the nominal wavenumber, `heat` its derivative by temperature, and `transverse` the mode's
    transverse wavenumber in the nominal bore. The derivatives are in 1/(m K), and in 1/m per
    relative change of the bore.
    """
    nominal = k + warmer * heat
    if transverse == 0:
        return nominal, heat, 0j
    # k^2 + q^2 / (1 + b)^2 does not depend on the relative change b of the bore.
    ratio = 1 / (1 + wider)
    square = nominal * nominal + transverse**2 * (1 - ratio**2)
    # By real square roots: those of complex numbers take several times as long.
    size = np.sqrt(square.real**2 + square.imag**2)
    if square.real > 0:
        real = np.sqrt((size + square.real) / 2)
        found = complex(real, square.imag / (2 * real))
    else:
        decay = -np.sqrt((size - square.real) / 2)
        found = complex(square.imag / (2 * decay), decay)
    inverse = found.conjugate() / size
    return found, heat * nominal * inverse, transverse**2 * ratio**3 * inverse


@compiled
def _wavenumbers(
    k: Complex, heat: Complex, transverse: Array, warmer: float, wider: float
) -> tuple[Vector, Vector, Vector]:
    """Return wavenumbers of three modes and their derivatives, as :func:`_wavenumber` does."""
    k0, warm0, wide0 = _wavenumber(k[0], heat[0], transverse[0], warmer, wider)
    k1, warm1, wide1 = _wavenumber(k[1], heat[1], transverse[1], warmer, wider)
    k2, warm2, wide2 = _wavenumber(k[2], heat[2], transverse[2], warmer, wider)
    return (k0, k1, k2), (warm0, warm1, warm2), (wide0, wide1, wide2)


@compiled
def _propagation(length: float, k: complex) -> complex:
    """Return exp(-j k L) for a wavenumber k in 1/m and a length L in m."""
    size, angle = np.exp(length * k.imag), length * k.real
    return complex(size * np.cos(angle), -size * np.sin(angle))


@compiled
def _moved(change: Complex, left: Vector, right: Vector, out: Vector, into: Vector) -> complex:
    """Return the change of the echo by a change of the matrix of any press but the last.

    `right` and `into` are the waves that arrive at its front and at its back. `left` and `out` are
    the factors with which waves that leave its front and its back are received at the face.
    """
    first = plus(apply(block(change, 0, 0), right), apply(block(change, 0, 1), into))
    second = plus(apply(block(change, 1, 0), right), apply(block(change, 1, 1), into))
    return dot(left, first) + dot(out, second)


@numba.njit(**OPTIONS)
def echoes(
    s: Complex, s_depth: Complex, s_stretch: Complex, last: Complex, last_depth: Complex,
    last_stretch: Complex, lengths: Array, temperature: Array, widening: Array, k: Complex,
    heat: Complex, transverse: Array, face: complex,
) -> tuple[Complex, Complex, Complex, Complex, Complex, Complex]:  # fmt: skip
    """Return the echo and its derivatives by lengths, depths, temperature, stretch and bore.

    Parameters
    ----------
    s, s_depth, s_stretch : ndarray
        Matrices of all presses but the last, and their derivatives by depth and by stretch (a
        relative change of frequency), (n_presses - 1, n, n_f, 2, 3, 2, 3).
    last, last_depth, last_stretch : ndarray
        Reflection coefficients of the last press between three modes, row by row, and their
        derivatives, (n, n_f, 9) or more columns.
    lengths : ndarray
        Lengths of the straight tube before each press in m, (n, n_presses).
    temperature : ndarray
        Deviations of the temperature from the nominal one in K, (n,).
    widening : ndarray
        Relative deviations of the bore from the nominal one between the presses, (n,).
    k : ndarray
        Wavenumbers at the nominal temperature and bore in 1/m, (n_f, 3).
    heat : ndarray
        Their derivatives by temperature in 1/(m K), (n_f, 3).
    transverse : ndarray
        Transverse wavenumbers in the nominal bore in 1/m, (3,).
    face : complex
        Reflection coefficient of the face for all modes.

    Returns
    -------
    tuple of ndarray
        Echo, (n, n_f); derivatives by lengths and depths, (n, n_presses, n_f) each; derivatives by
        temperature, by stretch and, between the presses, by widening, (n, n_f) each.
    """
    (n, p), n_f = lengths.shape, len(k)
    value = np.empty((n, n_f), np.complex128)
    lengthened, deepened = np.empty((2, n, p, n_f), np.complex128)
    heated, stretched, widened = np.zeros((3, n, n_f), np.complex128)
    load, loop = np.empty((2, p, 9), np.complex128)
    path = np.empty((p, 3), np.complex128)
    for a in range(n):
        for f in range(n_f):
            wave, warm, wide = _wavenumbers(k[f], heat[f], transverse, temperature[a], widening[a])
            for i in range(p):
                for c in range(3):
                    path[i, c] = _propagation(lengths[a, i], wave[c])
            # From the last press to the face: the reflection matrix at the start of the tube before
            # each press, and, for multiple reflections behind the press, the inverse of I - B R2,
            # with the reflection matrices B of all that follows and R2 of the back of the press.
            for i in range(p - 1, -1, -1):
                if i == p - 1:
                    found = kept(last[a, f])
                else:
                    one, behind = s[i, a, f], kept(load[i + 1])
                    inner = inverse(unit_less(product(behind, block(one, 1, 1))))
                    keep(inner, loop[i + 1])
                    turned = product(inner, product(behind, block(one, 1, 0)))
                    found = added(block(one, 0, 0), product(block(one, 0, 1), turned))
                way = path[i, 0], path[i, 1], path[i, 2]
                keep(scaled(way, found, way), load[i])
            seen = kept(load[0])
            inner = inverse(unit_less(times(face, seen)))
            left, right = (inner[0], inner[1], inner[2]), (inner[0], inner[3], inner[6])
            value[a, f] = dot(left, (seen[0], seen[3], seen[6]))
            # From the face on: the row vector `left` of the waves that reach the face from a plane,
            # and the column vector `right` of those that reach the plane from the face.
            for i in range(p):
                seen = kept(load[i])
                both = plus(each(left, apply(seen, right)), each(apply_left(left, seen), right))
                lengthened[a, i, f] = -1j * dot(wave, both)
                heated[a, f] -= 1j * lengths[a, i] * dot(warm, both)
                widened[a, f] -= 1j * lengths[a, i] * dot(wide, both)
                way = path[i, 0], path[i, 1], path[i, 2]
                left, right = each(left, way), each(way, right)
                if i == p - 1:
                    deepened[a, i, f] = dot(left, apply(kept(last_depth[a, f]), right))
                    stretched[a, f] += dot(left, apply(kept(last_stretch[a, f]), right))
                else:
                    one, behind, inner = s[i, a, f], kept(load[i + 1]), kept(loop[i + 1])
                    sent = apply(block(one, 1, 0), right)
                    into = apply(inner, apply(behind, sent))
                    onwards = apply_left(apply_left(left, block(one, 0, 1)), inner)
                    out = apply_left(onwards, behind)
                    deepened[a, i, f] = _moved(s_depth[i, a, f], left, right, out, into)
                    stretched[a, f] += _moved(s_stretch[i, a, f], left, right, out, into)
                    left, right = onwards, plus(sent, apply(block(one, 1, 1), into))
    return value, lengthened, deepened, heated, stretched, widened
