"""Matrices and vectors of three modes as tuples, which the compiler keeps in registers.

A matrix is nine numbers, row by row.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba

from acoustube.waves.scattering import Complex

Matrix = tuple[complex, ...]
Vector = tuple[complex, complex, complex]
Compiled = Callable[[Callable[..., Any]], Callable[..., Any]]
OPTIONS: dict[str, Any] = {
    "cache": True, "error_model": "numpy", "fastmath": {"contract", "reassoc", "nsz"},
}  # fmt: skip
"""Options of Numba's compiler: machine code is cached on disk, and sums may be reordered."""
compiled: Compiled = numba.njit(**OPTIONS, forceinline=True)
"""Decorator that compiles a function and inlines it in its callers."""


@compiled
def block(s: Complex, out: int, into: int) -> Matrix:
    """Return the block of a scattering matrix (2, 3, 2, 3) from port `into` to port `out`."""
    return (
        s[out, 0, into, 0], s[out, 0, into, 1], s[out, 0, into, 2],
        s[out, 1, into, 0], s[out, 1, into, 1], s[out, 1, into, 2],
        s[out, 2, into, 0], s[out, 2, into, 1], s[out, 2, into, 2],
    )  # fmt: skip


@compiled
def kept(a: Complex) -> Matrix:
    """Read a matrix from an array (9,)."""
    return a[0], a[1], a[2], a[3], a[4], a[5], a[6], a[7], a[8]


@compiled
def keep(a: Matrix, where: Complex) -> None:
    """Write a matrix to an array (9,)."""
    for i in range(9):
        where[i] = a[i]


@compiled
def product(a: Matrix, b: Matrix) -> Matrix:
    """Return the product a b."""
    return (
        a[0] * b[0] + a[1] * b[3] + a[2] * b[6], a[0] * b[1] + a[1] * b[4] + a[2] * b[7],
        a[0] * b[2] + a[1] * b[5] + a[2] * b[8], a[3] * b[0] + a[4] * b[3] + a[5] * b[6],
        a[3] * b[1] + a[4] * b[4] + a[5] * b[7], a[3] * b[2] + a[4] * b[5] + a[5] * b[8],
        a[6] * b[0] + a[7] * b[3] + a[8] * b[6], a[6] * b[1] + a[7] * b[4] + a[8] * b[7],
        a[6] * b[2] + a[7] * b[5] + a[8] * b[8],
    )  # fmt: skip


@compiled
def added(a: Matrix, b: Matrix) -> Matrix:
    """Return the sum of two matrices."""
    return (
        a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5],
        a[6] + b[6], a[7] + b[7], a[8] + b[8],
    )  # fmt: skip


@compiled
def product_left(a: Matrix, b: Matrix) -> Matrix:
    """Return the product a^T b."""
    return (
        a[0] * b[0] + a[3] * b[3] + a[6] * b[6], a[0] * b[1] + a[3] * b[4] + a[6] * b[7],
        a[0] * b[2] + a[3] * b[5] + a[6] * b[8], a[1] * b[0] + a[4] * b[3] + a[7] * b[6],
        a[1] * b[1] + a[4] * b[4] + a[7] * b[7], a[1] * b[2] + a[4] * b[5] + a[7] * b[8],
        a[2] * b[0] + a[5] * b[3] + a[8] * b[6], a[2] * b[1] + a[5] * b[4] + a[8] * b[7],
        a[2] * b[2] + a[5] * b[5] + a[8] * b[8],
    )  # fmt: skip


@compiled
def unit_less(a: Matrix) -> Matrix:
    """Return I - a."""
    return 1 - a[0], -a[1], -a[2], -a[3], 1 - a[4], -a[5], -a[6], -a[7], 1 - a[8]


@compiled
def inverse(a: Matrix) -> Matrix:
    """Return the inverse of a matrix, by cofactors."""
    c0, c1, c2 = a[4] * a[8] - a[5] * a[7], a[5] * a[6] - a[3] * a[8], a[3] * a[7] - a[4] * a[6]
    x = 1 / (a[0] * c0 + a[1] * c1 + a[2] * c2)
    return (
        x * c0, x * (a[2] * a[7] - a[1] * a[8]), x * (a[1] * a[5] - a[2] * a[4]),
        x * c1, x * (a[0] * a[8] - a[2] * a[6]), x * (a[2] * a[3] - a[0] * a[5]),
        x * c2, x * (a[1] * a[6] - a[0] * a[7]), x * (a[0] * a[4] - a[1] * a[3]),
    )  # fmt: skip


@compiled
def scaled(rows: Vector, a: Matrix, columns: Vector) -> Matrix:
    """Return a matrix with its rows and columns multiplied by factors."""
    return (
        rows[0] * a[0] * columns[0], rows[0] * a[1] * columns[1], rows[0] * a[2] * columns[2],
        rows[1] * a[3] * columns[0], rows[1] * a[4] * columns[1], rows[1] * a[5] * columns[2],
        rows[2] * a[6] * columns[0], rows[2] * a[7] * columns[1], rows[2] * a[8] * columns[2],
    )  # fmt: skip


@compiled
def apply(a: Matrix, v: Vector) -> Vector:
    """Return the product a v of a matrix and a vector."""
    return (
        a[0] * v[0] + a[1] * v[1] + a[2] * v[2], a[3] * v[0] + a[4] * v[1] + a[5] * v[2],
        a[6] * v[0] + a[7] * v[1] + a[8] * v[2],
    )  # fmt: skip


@compiled
def apply_left(v: Vector, a: Matrix) -> Vector:
    """Return the row vector v^T a."""
    return (
        v[0] * a[0] + v[1] * a[3] + v[2] * a[6], v[0] * a[1] + v[1] * a[4] + v[2] * a[7],
        v[0] * a[2] + v[1] * a[5] + v[2] * a[8],
    )  # fmt: skip


@compiled
def dot(v: Vector, w: Vector) -> complex:
    """Return v^T w, without conjugation."""
    return v[0] * w[0] + v[1] * w[1] + v[2] * w[2]


@compiled
def times(factor: complex, m: Matrix) -> Matrix:
    """Return a matrix multiplied by a factor."""
    return (
        factor * m[0], factor * m[1], factor * m[2], factor * m[3], factor * m[4],
        factor * m[5], factor * m[6], factor * m[7], factor * m[8],
    )  # fmt: skip


@compiled
def each(v: Vector, w: Vector) -> Vector:
    """Return the product of two vectors, component by component."""
    return v[0] * w[0], v[1] * w[1], v[2] * w[2]


@compiled
def plus(v: Vector, w: Vector) -> Vector:
    """Return the sum of two vectors."""
    return v[0] + w[0], v[1] + w[1], v[2] + w[2]
