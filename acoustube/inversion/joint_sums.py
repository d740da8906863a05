"""Scattering of a press between bends and its derivatives, in compiled loops over frequency.

The equations are given in :mod:`acoustube.inversion.joints`. The last axis of the arrays of joints
holds four matrices of a joint, one after the other: the transmission (3, 3), the reflection back
into the straight bore (3, 3), the reflection back into the bent bore (3, 3), and the transmission
between the bent modes and the modes that pass the press unscattered (n_own, 3).
"""

from __future__ import annotations

import numba
import numpy as np

from acoustube.inversion.small_matrices import (
    OPTIONS,
    Matrix,
    Vector,
    added,
    apply,
    apply_left,
    block,
    compiled,
    dot,
    each,
    kept,
    plus,
    product,
    product_left,
    scaled,
)
from acoustube.waves.scattering import Complex

PASSED, RETURNED, REFLECTED, PASSING = 0, 9, 18, 27
"""First index of each matrix of a joint in the last axis of `joints`: transmission, reflection into
the straight and into the bent bore, transmission of the unscattered modes."""


@compiled
def _three(a: Complex) -> Vector:
    return a[0], a[1], a[2]


@compiled
def _joint(at: Complex, way: Vector) -> tuple[Matrix, Matrix]:
    """Return a joint's transmission and reflection back to the press, referred to the press."""
    ones = (1.0 + 0j, 1.0 + 0j, 1.0 + 0j)
    return scaled(way, kept(at[PASSED:]), ones), scaled(way, kept(at[RETURNED:]), way)


@compiled
def _once_more(s: Complex, out: int, into: int, b0: Matrix, b1: Matrix) -> Matrix:
    """Return a block of S + S B S, with the scattering matrix S and B = diag(`b0`, `b1`)."""
    first = product(block(s, out, 0), product(b0, block(s, 0, into)))
    second = product(block(s, out, 1), product(b1, block(s, 1, into)))
    return added(block(s, out, into), added(first, second))


@compiled
def _applied(s: Complex, out: int, v0: Vector, v1: Vector) -> Vector:
    """Return S v at port `out`, with the scattering matrix S and v = (`v0`, `v1`) by port."""
    return plus(apply(block(s, out, 0), v0), apply(block(s, out, 1), v1))


@compiled
def _applied_left(s: Complex, into: int, u0: Vector, u1: Vector) -> Vector:
    """Return u^T S at port `into`, with the scattering matrix S and u = (`u0`, `u1`) by port."""
    return plus(apply_left(u0, block(s, 0, into)), apply_left(u1, block(s, 1, into)))


@numba.njit(**OPTIONS)
def joined_values(s: Complex, joints: Complex, way: Complex, through: Complex) -> Complex:
    """Return the scattering matrices W of presses between two joints, in the modes of the bends.

    See :mod:`acoustube.inversion.joints` for the equation.

    Parameters
    ----------
    s : ndarray
        Scattering matrices S of the presses in three straight modes, (n, n_f, 2, 3, 2, 3).
    joints : ndarray
        Matrices of the joints between straight and bent bore at both ports, flattened in the order
        of the module's docstring, (2, n, n_f, n_parts).
    way : ndarray
        Propagation factors of the straight modes from the press to a joint, (n, n_f, 3).
    through : ndarray
        Propagation factors from joint to joint of the n_own modes that the press does not scatter,
        (n, n_f, n_own).

    Returns
    -------
    ndarray
        W in three bent modes, (n, n_f, 2, 3, 2, 3).
    """
    n, n_f = s.shape[:2]
    found = np.zeros((n, n_f, 2, 3, 2, 3), np.complex128)
    for a in range(n):
        for f in range(n_f):
            one, turn = s[a, f], _three(way[a, f])
            e0, b0 = _joint(joints[0, a, f], turn)
            e1, b1 = _joint(joints[1, a, f], turn)
            for out in range(2):
                for into in range(2):
                    inner = product(_once_more(one, out, into, b0, b1), e0 if into == 0 else e1)
                    whole = product_left(e0 if out == 0 else e1, inner)
                    for i in range(3):
                        for j in range(3):
                            value = whole[3 * i + j]
                            if out == into:
                                value += joints[out, a, f, REFLECTED + 3 * i + j]
                            else:
                                for o in range(through.shape[2]):
                                    k = PASSING + 3 * o
                                    value += (
                                        joints[out, a, f, k + i]
                                        * through[a, f, o]
                                        * joints[into, a, f, k + j]
                                    )
                            found[a, f, out, i, into, j] = value
    return found


@numba.njit(**OPTIONS)
def joined_changes(
    s: Complex, s_depth: Complex, s_stretch: Complex, joints: Complex, moved: Complex,
    way: Complex, warm: Complex, through: Complex, through_warm: Complex, waves: Complex,
) -> Complex:  # fmt: skip
    """Return the derivatives of u^T W v, the sound received from presses with the matrices W.

    Parameters
    ----------
    s, s_depth, s_stretch : ndarray
        Scattering matrices between straight modes, and their derivatives by depth and by stretch
        (a relative change of frequency), (n, n_f, 2, 3, 2, 3).
    joints, moved : ndarray
        Matrices of the joints at both ports, and their derivatives by position in 1/m,
        (2, n, n_f, n_parts).
    way, through
        See :func:`joined_values`.
    warm, through_warm : ndarray
        Relative derivatives of `way` and `through` by temperature in 1/K, (n_f, 3), (n_f, n_own).
    waves : ndarray
        In bent modes, (n, n_f, 4, 3): u at both ports, the factors with which leaving waves are
        received, then v at both ports, the amplitudes of the waves that arrive.

    Returns
    -------
    ndarray
        Derivatives by depth (1/m), stretch, position (1/m), temperature (1/K), (4, n, n_f).
    """
    n, n_f = s.shape[:2]
    found = np.empty((4, n, n_f), np.complex128)
    for a in range(n):
        for f in range(n_f):
            one, turn, heat = s[a, f], _three(way[a, f]), _three(warm[f])
            e0, b0 = _joint(joints[0, a, f], turn)
            e1, b1 = _joint(joints[1, a, f], turn)
            left, out = _three(waves[a, f, 0]), _three(waves[a, f, 1])
            right, into = _three(waves[a, f, 2]), _three(waves[a, f, 3])
            u0, u1, v0, v1 = apply(e0, left), apply(e1, out), apply(e0, right), apply(e1, into)
            # Waves scattered once by the press, and then reflected back to it by the joints.
            t0, t1 = _applied(one, 0, v0, v1), _applied(one, 1, v0, v1)
            r0, r1 = _applied_left(one, 0, u0, u1), _applied_left(one, 1, u0, u1)
            again0, again1 = apply(b0, t0), apply(b1, t1)
            before0, before1 = apply_left(r0, b0), apply_left(r1, b1)
            w0, w1 = plus(v0, again0), plus(v1, again1)
            for number in range(2):
                d = s_depth[a, f] if number == 0 else s_stretch[a, f]
                total = dot(u0, _applied(d, 0, w0, w1)) + dot(u1, _applied(d, 1, w0, w1))
                total += dot(before0, _applied(d, 0, v0, v1))
                total += dot(before1, _applied(d, 1, v0, v1))
                found[number, a, f] = total
            y0, y1 = _applied(one, 0, w0, w1), _applied(one, 1, w0, w1)
            x0, x1 = plus(u0, before0), plus(u1, before1)
            z0, z1 = _applied_left(one, 0, x0, x1), _applied_left(one, 1, x0, x1)
            m0, c0 = _joint(moved[0, a, f], turn)
            m1, c1 = _joint(moved[1, a, f], turn)
            total = dot(apply(m0, left), y0) + dot(apply(m1, out), y1)
            total += dot(z0, apply(m0, right)) + dot(z1, apply(m1, into))
            total += dot(r0, apply(c0, t0)) + dot(r1, apply(c1, t1))
            g0, g1 = kept(moved[0, a, f, REFLECTED:]), kept(moved[1, a, f, REFLECTED:])
            total += dot(left, apply(g0, right)) + dot(out, apply(g1, into))
            warmed = dot(each(heat, u0), y0) + dot(each(heat, u1), y1)
            warmed += dot(z0, each(heat, v0)) + dot(z1, each(heat, v1))
            warmed += dot(each(heat, r0), again0) + dot(each(heat, r1), again1)
            warmed += dot(before0, each(heat, t0)) + dot(before1, each(heat, t1))
            for o in range(through.shape[2]):
                k = PASSING + 3 * o
                p0, p1 = _three(joints[0, a, f, k:]), _three(joints[1, a, f, k:])
                q0, q1 = _three(moved[0, a, f, k:]), _three(moved[1, a, f, k:])
                heard0, heard1, sent0, sent1 = (
                    dot(left, p0), dot(out, p1), dot(p0, right), dot(p1, into),
                )  # fmt: skip
                part = heard0 * sent1 + heard1 * sent0
                warmed += through_warm[f, o] * through[a, f, o] * part
                part = dot(left, q0) * sent1 + heard0 * dot(q1, into)
                part += dot(out, q1) * sent0 + heard1 * dot(q0, right)
                total += through[a, f, o] * part
            found[2, a, f], found[3, a, f] = total, warmed
    return found
