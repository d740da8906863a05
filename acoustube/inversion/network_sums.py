"""Echo of presses joined by straight tube, and its derivatives, compiled: frequency by frequency.

The equations are given in :mod:`acoustube.inversion.network`. Matrices of three modes are tuples of
nine numbers, row by row, which the compiler keeps in registers.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np

from acoustube.base.types import Array
from acoustube.waves.scattering import Complex

MODES = 3
"""Modes of the matrices; fewer are padded with zeros."""

Matrix = tuple[complex, ...]
Vector = tuple[complex, complex, complex]
Compiled = Callable[[Callable[..., Any]], Callable[..., Any]]
OPTIONS: dict[str, Any] = {
    "cache": True, "error_model": "numpy", "fastmath": {"contract", "reassoc", "nsz"},
}  # fmt: skip
compiled: Compiled = numba.njit(**OPTIONS, forceinline=True)


@compiled
def _block(s: Complex, out: int, into: int) -> Matrix:
    """Return a block of a scattering matrix (2, 3, 2, 3)."""
    return (
        s[out, 0, into, 0], s[out, 0, into, 1], s[out, 0, into, 2],
        s[out, 1, into, 0], s[out, 1, into, 1], s[out, 1, into, 2],
        s[out, 2, into, 0], s[out, 2, into, 1], s[out, 2, into, 2],
    )  # fmt: skip


@compiled
def _kept(a: Complex) -> Matrix:
    """Return a matrix that is kept in an array (9,)."""
    return a[0], a[1], a[2], a[3], a[4], a[5], a[6], a[7], a[8]


@compiled
def _keep(a: Matrix, where: Complex) -> None:
    for i in range(9):
        where[i] = a[i]


@compiled
def _product(a: Matrix, b: Matrix) -> Matrix:
    return (
        a[0] * b[0] + a[1] * b[3] + a[2] * b[6], a[0] * b[1] + a[1] * b[4] + a[2] * b[7],
        a[0] * b[2] + a[1] * b[5] + a[2] * b[8], a[3] * b[0] + a[4] * b[3] + a[5] * b[6],
        a[3] * b[1] + a[4] * b[4] + a[5] * b[7], a[3] * b[2] + a[4] * b[5] + a[5] * b[8],
        a[6] * b[0] + a[7] * b[3] + a[8] * b[6], a[6] * b[1] + a[7] * b[4] + a[8] * b[7],
        a[6] * b[2] + a[7] * b[5] + a[8] * b[8],
    )  # fmt: skip


@compiled
def _sum(a: Matrix, b: Matrix) -> Matrix:
    return (
        a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5],
        a[6] + b[6], a[7] + b[7], a[8] + b[8],
    )  # fmt: skip


@compiled
def _unit_less(a: Matrix) -> Matrix:
    return 1 - a[0], -a[1], -a[2], -a[3], 1 - a[4], -a[5], -a[6], -a[7], 1 - a[8]


@compiled
def _inverse(a: Matrix) -> Matrix:
    """Return the inverse, by cofactors."""
    c0, c1, c2 = a[4] * a[8] - a[5] * a[7], a[5] * a[6] - a[3] * a[8], a[3] * a[7] - a[4] * a[6]
    x = 1 / (a[0] * c0 + a[1] * c1 + a[2] * c2)
    return (
        x * c0, x * (a[2] * a[7] - a[1] * a[8]), x * (a[1] * a[5] - a[2] * a[4]),
        x * c1, x * (a[0] * a[8] - a[2] * a[6]), x * (a[2] * a[3] - a[0] * a[5]),
        x * c2, x * (a[1] * a[6] - a[0] * a[7]), x * (a[0] * a[4] - a[1] * a[3]),
    )  # fmt: skip


@compiled
def _propagated(a: Matrix, p: Vector) -> Matrix:
    """Return a reflection seen over a length of tube."""
    return (
        p[0] * a[0] * p[0], p[0] * a[1] * p[1], p[0] * a[2] * p[2],
        p[1] * a[3] * p[0], p[1] * a[4] * p[1], p[1] * a[5] * p[2],
        p[2] * a[6] * p[0], p[2] * a[7] * p[1], p[2] * a[8] * p[2],
    )  # fmt: skip


@compiled
def _apply(a: Matrix, v: Vector) -> Vector:
    return (
        a[0] * v[0] + a[1] * v[1] + a[2] * v[2], a[3] * v[0] + a[4] * v[1] + a[5] * v[2],
        a[6] * v[0] + a[7] * v[1] + a[8] * v[2],
    )  # fmt: skip


@compiled
def _apply_left(v: Vector, a: Matrix) -> Vector:
    return (
        v[0] * a[0] + v[1] * a[3] + v[2] * a[6], v[0] * a[1] + v[1] * a[4] + v[2] * a[7],
        v[0] * a[2] + v[1] * a[5] + v[2] * a[8],
    )  # fmt: skip


@compiled
def _inner(v: Vector, w: Vector) -> complex:
    return v[0] * w[0] + v[1] * w[1] + v[2] * w[2]


@compiled
def _each(v: Vector, w: Vector) -> Vector:
    return v[0] * w[0], v[1] * w[1], v[2] * w[2]


@compiled
def _plus(v: Vector, w: Vector) -> Vector:
    return v[0] + w[0], v[1] + w[1], v[2] + w[2]


@compiled
def _moved(change: Complex, left: Vector, right: Vector, out: Vector, into: Vector) -> complex:
    """Return the change of the echo for a change of the matrix of a press before others."""
    first = _plus(_apply(_block(change, 0, 0), right), _apply(_block(change, 0, 1), into))
    second = _plus(_apply(_block(change, 1, 0), right), _apply(_block(change, 1, 1), into))
    return _inner(left, first) + _inner(out, second)


@numba.njit(**OPTIONS)
def echoes(
    s: Complex, s_depth: Complex, s_stretch: Complex, last: Complex, last_depth: Complex,
    last_stretch: Complex, lengths: Array, path: Complex, k: Complex, heat: Complex, face: complex,
) -> tuple[Complex, Complex, Complex, Complex, Complex]:  # fmt: skip
    """Return the echo and its derivatives by lengths, depths, temperature and stretch.

    Parameters
    ----------
    s, s_depth, s_stretch : ndarray
        Matrices of the presses but the last, and their derivatives by depth and stretch,
        (n_presses - 1, n, n_f, 2, 3, 2, 3).
    last, last_depth, last_stretch : ndarray
        Those of the last, of which the reflection is taken, (n, n_f, 2, 3, 2, 3).
    lengths : ndarray
        Of the straight tube before each press in m, (n, n_presses).
    path : ndarray
        Factors of the modes over these, (n, n_presses, n_f, 3).
    k, heat : ndarray
        Wavenumbers in 1/m and their derivatives by temperature, (n, n_f, 3).
    face : complex

    Returns
    -------
    tuple of ndarray
        (n, n_f), (n, n_presses, n_f) twice, (n, n_f) twice.
    """
    n, p, n_f = path.shape[:3]
    value = np.empty((n, n_f), np.complex128)
    lengthened, deepened = np.empty((2, n, p, n_f), np.complex128)
    heated, stretched = np.zeros((2, n, n_f), np.complex128)
    load, loop = np.empty((2, p, 9), np.complex128)
    for a in range(n):
        for f in range(n_f):
            # From the last press to the face: the reflection seen before each, and for the
            # multiple reflections behind it the inverse of I - B R2.
            for i in range(p - 1, -1, -1):
                if i == p - 1:
                    found = _block(last[a, f], 0, 0)
                else:
                    one, behind = s[i, a, f], _kept(load[i + 1])
                    inner = _inverse(_unit_less(_product(behind, _block(one, 1, 1))))
                    _keep(inner, loop[i + 1])
                    turned = _product(inner, _product(behind, _block(one, 1, 0)))
                    found = _sum(_block(one, 0, 0), _product(_block(one, 0, 1), turned))
                way = path[a, i, f, 0], path[a, i, f, 1], path[a, i, f, 2]
                _keep(_propagated(found, way), load[i])
            seen = _kept(load[0])
            scaled = (
                face * seen[0], face * seen[1], face * seen[2], face * seen[3], face * seen[4],
                face * seen[5], face * seen[6], face * seen[7], face * seen[8],
            )  # fmt: skip
            inner = _inverse(_unit_less(scaled))
            left, right = (inner[0], inner[1], inner[2]), (inner[0], inner[3], inner[6])
            value[a, f] = _inner(left, (seen[0], seen[3], seen[6]))
            wave, warm = (
                (k[a, f, 0], k[a, f, 1], k[a, f, 2]),
                (heat[a, f, 0], heat[a, f, 1], heat[a, f, 2]),
            )
            # From the face on: what reaches it from each press, and each press from it.
            for i in range(p):
                seen = _kept(load[i])
                both = _plus(
                    _each(left, _apply(seen, right)), _each(_apply_left(left, seen), right)
                )
                lengthened[a, i, f] = -1j * _inner(wave, both)
                heated[a, f] -= 1j * lengths[a, i] * _inner(warm, both)
                way = path[a, i, f, 0], path[a, i, f, 1], path[a, i, f, 2]
                left, right = _each(left, way), _each(way, right)
                if i == p - 1:
                    deepened[a, i, f] = _inner(left, _apply(_block(last_depth[a, f], 0, 0), right))
                    stretched[a, f] += _inner(left, _apply(_block(last_stretch[a, f], 0, 0), right))
                else:
                    one, behind, inner = s[i, a, f], _kept(load[i + 1]), _kept(loop[i + 1])
                    sent = _apply(_block(one, 1, 0), right)
                    into = _apply(inner, _apply(behind, sent))
                    onwards = _apply_left(_apply_left(left, _block(one, 0, 1)), inner)
                    out = _apply_left(onwards, behind)
                    deepened[a, i, f] = _moved(s_depth[i, a, f], left, right, out, into)
                    stretched[a, f] += _moved(s_stretch[i, a, f], left, right, out, into)
                    left, right = onwards, _plus(sent, _apply(_block(one, 1, 1), into))
    return value, lengthened, deepened, heated, stretched
