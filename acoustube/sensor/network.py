"""Echo of contacts along a tube, in JAX: one cycle, all frequencies at once.

A wrapped tube differs from a straight one in its modes, whose phase is an integral along it, in the
contacts' matrices, which vary with the curvature, and in the joint where the wrap begins
(:mod:`acoustube.sensor.wrapped`).

The input reflection matrix is computed contact by contact, from the far end to the face, as in
:mod:`acoustube.waves.network`. Matrices are symmetric by reciprocity and have three modes at most;
their products are written out element by element, with the frequencies along the last axis. Real
and imaginary parts are kept apart, since compilers vectorise these better.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Pair:
    """Complex numbers as real and imaginary parts, of any shape that broadcasts."""

    re: Any
    im: Any

    def __add__(self, other: Pair) -> Pair:
        """Return the sum."""
        return Pair(self.re + other.re, self.im + other.im)

    def __sub__(self, other: Pair) -> Pair:
        """Return the difference."""
        return Pair(self.re - other.re, self.im - other.im)

    def __mul__(self, other: Pair) -> Pair:
        """Return the product."""
        return Pair(
            self.re * other.re - self.im * other.im, self.re * other.im + self.im * other.re
        )

    def inverse(self) -> Pair:
        """Return the reciprocal."""
        size = 1 / (self.re * self.re + self.im * self.im)
        return Pair(self.re * size, -self.im * size)


Matrix = list[list[Pair]]


class Entry(NamedTuple):
    """Joint of a wrapped tube with the straight tube before it.

    Attributes
    ----------
    plane : jax.Array
        Amplitudes of the wrapped tube's modes at the start of the wrap for a plane wave of unit
        amplitude at the face, (2, m, n_f).
    both_ways : jax.Array
        Transmission between the wrapped tube's modes to the face and back, T T^T, summed over all
        modes at the face; upper triangle, (2, m (m + 1) / 2, n_f).
    """

    plane: jax.Array
    both_ways: jax.Array


class Constants(NamedTuple):
    """Arrays from which the echo is computed, in float32.

    Attributes
    ----------
    presses : jax.Array
        Scattering coefficients, :attr:`acoustube.sensor.tables.PressTables.values`.
    decay, turn : jax.Array
        Real part in 1/m and imaginary part in revolutions per m of -j times the axial wavenumbers,
        (m, n_f); in a wrapped tube their integrals from the start of the wrap, (n_z, m, n_f).
    clutter : jax.Array
        Echo of each reflector of the clutter and all those behind it, and a last row of zeros,
        (n_reflectors + 1, 2, n_f); without clutter the zeros alone, (1, 2, n_f).
    far : jax.Array
        Reflection matrix of the far end, its upper triangle, (2, m (m + 1) / 2, n_f).
    entry : Entry or None
        Joint at the start of the wrap; None for a straight tube.
    """

    presses: jax.Array
    decay: jax.Array
    turn: jax.Array
    clutter: jax.Array
    far: jax.Array
    entry: Entry | None = None


class Press(NamedTuple):
    """Rows of the tables from which the matrices of contacts are interpolated, and weights.

    Attributes
    ----------
    row : jax.Array
        First of two adjacent rows between which each part is interpolated, (n_contacts, n_parts).
        The parts are two tools, two places of a wrapped tube, four of both, or a single one.
    weight : jax.Array
        Weight of the second row of each part, then that of the second tool, if there are two, and
        that of the second place, if there are two; (n_contacts, n_parts) to (n_contacts, 6).
    """

    row: jax.Array
    weight: jax.Array


def echo(
    constants: Constants,
    number: NDArray[np.int64],
    press: Press,
    place: jax.Array,
    reflector: jax.Array,
    ends: tuple[float, float],
    face: complex,
) -> Pair:
    """Return the echo of contacts, far end and clutter, relative to the wave launched by the face.

    Parameters
    ----------
    constants : Constants
    number : ndarray of int
        Indices of the coefficients, :attr:`acoustube.sensor.tables.PressTables.number` as
        (2 m, 2 m); fixed when compiled.
    press : Press
    place : jax.Array
        Distances from the face in m, rising, (n_contacts,).
    reflector : jax.Array
        Index of the clutter's first reflector behind each contact, (n_contacts,).
    ends : tuple of float
        Places in m between which the modes of `constants` propagate: the face or the start of the
        wrap, and the far end of the tube or of the wrap; fixed when compiled.
    face : complex
        Reflection coefficient of the face.

    Returns
    -------
    Pair
        Amplitude of the arriving plane wave relative to that of the launched one, (n_f,).

    Notes
    -----
    All multiple reflections between contacts and both ends are included, except those at the joint
    where a wrap begins. Multiple reflections with the clutter are neglected, as in
    :func:`acoustube.ranging.record`; the clutter is attenuated by the plane wave's transmission
    through the contacts before it.
    """
    m, n_f = constants.decay.shape[-2:]
    following = jnp.append(place[1:], ends[1])
    zero = jnp.zeros(n_f, jnp.float32)
    behind = Pair(*constants.clutter[-1])

    def before(
        carry: tuple[list[Pair], Pair, Pair], contact: Any
    ) -> tuple[tuple[list[Pair], Pair, Pair], None]:
        triangle, seen, beyond = carry
        row, weight, here, there, first = contact
        s = _matrix(constants.presses, number, row, weight)
        load = _propagated(_full(m, triangle), constants, ends, here, there)
        reflected = _input_reflection(s, load, m)
        onwards = Pair(*constants.clutter[first])
        # The clutter as seen just behind this contact, then as attenuated by it.
        seen = onwards - beyond + seen
        seen = s[0][m] * s[0][m] * seen
        return (_triangle(m, reflected), seen, onwards), None

    far = [Pair(*constants.far[:, i]) for i in range(constants.far.shape[1])]
    start = (far, Pair(zero, zero), behind)
    contacts = (press.row, press.weight, place, following, reflector)
    (triangle, seen, beyond), _ = jax.lax.scan(before, start, contacts, reverse=True)
    load = _propagated(_full(m, triangle), constants, ends, ends[0], place[0])
    heard = _heard(load, constants.entry, face)
    return heard + (Pair(*constants.clutter[0]) - beyond) + seen


def _heard(load: Matrix, entry: Entry | None, face: complex) -> Pair:
    """Return the plane wave's echo at the face, from a reflection matrix there or at the wrap.

    Let L be the reflection matrix at the start of the wrap, T the transmission matrix from the
    modes at the face to there, and f the reflection coefficient of the face. The plane wave's
    element of (1 - f A)^-1 A, with A = T^T L T, is t^T (1 - f L T T^T)^-1 L t, where t is the
    plane wave's column of T.
    """
    m = len(load)
    back = Pair(np.float32(np.real(face)), np.float32(np.imag(face)))
    if entry is None:
        loop = [[_unit(i == j) - back * load[i][j] for j in range(m)] for i in range(m)]
        return _dot(_inverse(loop)[0], [load[i][0] for i in range(m)])
    plane = [Pair(*entry.plane[:, i]) for i in range(m)]
    both = _full(m, [Pair(*entry.both_ways[:, i]) for i in range(entry.both_ways.shape[1])])
    loop = [[_unit(i == j) - back * _dot(load[i], both[j]) for j in range(m)] for i in range(m)]
    arriving = [_dot(row, plane) for row in load]
    inverse = _inverse(loop)
    return _dot(plane, [_dot(row, arriving) for row in inverse])


def _matrix(
    table: jax.Array, number: NDArray[np.int64], row: jax.Array, weight: jax.Array
) -> Matrix:
    """Return the scattering matrix of a contact, (2 m, 2 m), interpolated from a table."""
    parts = []
    for i in range(row.shape[0]):
        start = (row[i], *(jnp.zeros((), row.dtype),) * 3)
        low, high = jax.lax.dynamic_slice(table, start, (2, *table.shape[1:]))
        parts.append(low + weight[i] * (high - low))
    for share in weight[len(parts) :]:
        parts = [a + share * (b - a) for a, b in zip(parts[::2], parts[1::2], strict=True)]
    (s,) = parts
    return [[Pair(s[0, n], s[1, n]) for n in line] for line in number]


def _input_reflection(s: Matrix, load: Matrix, m: int) -> Matrix:
    """Return the reflection matrix of a contact before a load: R1 + T12 (1 - L R2)^-1 L T21.

    L is the reflection matrix of the load. R1 and R2 are those of the contact at its front and its
    back, and T12 and T21 its transmission matrices from back to front and from front to back.
    """
    loop = [
        [_unit(i == j) - _dot(load[i], [s[m + k][m + j] for k in range(m)]) for j in range(m)]
        for i in range(m)
    ]
    inverse = _inverse(loop)
    seen = _symmetric(m, lambda i, j: _dot(inverse[i], load[j]))
    passed = [[_dot(s[i][m:], seen[j]) for j in range(m)] for i in range(m)]
    return _symmetric(m, lambda i, j: s[i][j] + _dot(passed[i], s[j][m:]))


def _propagated(
    load: Matrix,
    constants: Constants,
    ends: tuple[float, float],
    here: jax.Array | float,
    there: jax.Array,
) -> Matrix:
    """Return the reflection matrix seen from place `here`, from that at place `there`."""
    m = len(load)
    decay, turn = (_between(one, ends, here, there) for one in (constants.decay, constants.turn))
    size, (cosine, sine) = jnp.exp(decay), _turned(turn)
    path = [Pair(size[i] * cosine[i], size[i] * sine[i]) for i in range(m)]
    return _symmetric(m, lambda i, j: path[i] * load[i][j] * path[j])


def _between(
    table: jax.Array, ends: tuple[float, float], here: jax.Array | float, there: jax.Array
) -> jax.Array:
    """Return the change of the modes' log amplitude or phase between two places, (m, n_f).

    `table` is `decay` or `turn` of :class:`Constants`. The logarithm is natural, and the phase is
    in revolutions.
    """
    if table.ndim == 2:
        return table * (there - here)
    last = table.shape[0] - 1

    def integral(place: jax.Array | float) -> jax.Array:
        x = (place - ends[0]) * (last / (ends[1] - ends[0]))
        i = jnp.clip(jnp.floor(x).astype(jnp.int32), 0, last - 1)
        low, high = table[i], table[i + 1]
        return low + (x - i) * (high - low)

    return integral(there) - integral(here)


def _inverse(a: Matrix) -> Matrix:
    """Return the inverse of a matrix of one to three rows, by cofactors.

    Elimination takes fewer operations, but a compiler that fuses its long chains of operations
    computes them repeatedly.
    """
    n = len(a)
    if n == 1:
        return [[a[0][0].inverse()]]
    if n == 2:
        scale = (a[0][0] * a[1][1] - a[0][1] * a[1][0]).inverse()
        minus = Pair(-scale.re, -scale.im)
        return [[scale * a[1][1], minus * a[0][1]], [minus * a[1][0], scale * a[0][0]]]

    def cofactor(i: int, j: int) -> Pair:
        (p, q), (r, s) = ((i + 1) % 3, (i + 2) % 3), ((j + 1) % 3, (j + 2) % 3)
        return a[p][r] * a[q][s] - a[p][s] * a[q][r]

    cofactors = [[cofactor(i, j) for j in range(3)] for i in range(3)]
    scale = _dot(a[0], cofactors[0]).inverse()
    return [[scale * cofactors[j][i] for j in range(3)] for i in range(3)]


def _turned(revolutions: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return cosine and sine of angles in revolutions, to 1e-6.

    They are polynomials over a quarter revolution. The functions of JAX reduce angles of any size
    with more digits than are needed here, and take ten times as long.
    """
    quarters = 4 * (revolutions - jnp.round(revolutions))
    whole = jnp.round(quarters)
    x = (quarters - whole) * np.float32(np.pi / 2)
    y = x * x
    sine = x * (1 + y * (-1 / 6 + y * (1 / 120 - y / 5040)))
    cosine = 1 + y * (-1 / 2 + y * (1 / 24 + y * (-1 / 720 + y / 40320)))
    odd, half = jnp.abs(whole) == 1, jnp.abs(whole) == 2
    turned = jnp.where(odd, -whole * sine, jnp.where(half, -cosine, cosine))
    return turned, jnp.where(odd, whole * cosine, jnp.where(half, -sine, sine))


def _dot(a: Sequence[Pair], b: Sequence[Pair]) -> Pair:
    found = a[0] * b[0]
    for x, y in zip(a[1:], b[1:], strict=True):
        found = found + x * y
    return found


def _unit(same: bool) -> Pair:
    return Pair(np.float32(same), np.float32(0))


def _symmetric(m: int, entry: Callable[[int, int], Pair]) -> Matrix:
    """Return a symmetric matrix from the entries on and above its diagonal."""
    return _full(m, [entry(i, j) for i in range(m) for j in range(i, m)])


def _triangle(m: int, matrix: Matrix) -> list[Pair]:
    return [matrix[i][j] for i in range(m) for j in range(i, m)]


def _full(m: int, triangle: list[Pair]) -> Matrix:
    places = [(i, j) for i in range(m) for j in range(i, m)]
    found = dict(zip(places, triangle, strict=True))
    return [[found[min(i, j), max(i, j)] for j in range(m)] for i in range(m)]
