"""Reflection at the face of presses joined by straight tube, with derivatives by all parameters.

The input reflection matrices are built up from the last press to the face (Redheffer's star
product, as in :mod:`acoustube.waves.network`). Derivatives come from the adjoint: with the row
vector of the waves that reach the face from a plane, and the column vector of those that reach the
plane from the face, the derivative of the echo is that of the reflection there between the two.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from acoustube.base.types import Array
from acoustube.inversion.tables import Matrices
from acoustube.waves.scattering import Complex


class Echo(NamedTuple):
    """Echo of presses relative to the wave that the face launches, and its derivatives.

    Attributes
    ----------
    value : ndarray
        (n, n_f).
    by_place : ndarray
        Per m, (n, n_presses, n_f).
    by_depth : ndarray
        Per m, (n, n_presses, n_f).
    by_temperature : ndarray
        Of the waves in straight tube only, per K, (n, n_f).
    by_stretch : ndarray
        Of the presses' matrices, per relative change of frequency, (n, n_f).
    """

    value: Complex
    by_place: Complex
    by_depth: Complex
    by_temperature: Complex
    by_stretch: Complex


class Waves(NamedTuple):
    """Axial wavenumbers in 1/m and their derivatives by temperature in 1/(m K), (n, n_f, m)."""

    k: Complex
    by_temperature: Complex


def echo(presses: list[Matrices], places: Array, waves: Waves, face: complex) -> Echo:
    """Return the echo of presses at the face of the source.

    Parameters
    ----------
    presses : list of Matrices
        One for each press, from the face on.
    places : ndarray
        Distances from the face in m, rising, (n, n_presses).
    waves : Waves
    face : complex
        Reflection coefficient of the face, of all modes.

    Returns
    -------
    Echo
        Its value is that of (p - 1) / (1 + face), with the pressure p at the face of the plane
        wave.
    """
    blocks = [_blocks(press.value) for press in presses]
    lengths = np.diff(places, axis=1, prepend=0.0)
    paths = [np.exp(-1j * waves.k * lengths[:, i, None, None]) for i in range(len(presses))]
    eye = np.eye(waves.k.shape[-1])
    # From the last press to the face: the reflection before each press and what it loops with.
    loads: list[Complex] = []
    loops: list[tuple[Complex, Complex] | None] = []
    behind: Complex | None = None
    for (r1, t12, t21, r2), path in zip(blocks[::-1], paths[::-1], strict=True):
        if behind is None:
            reflection, loop = r1, None
        else:
            loop = np.linalg.inv(eye - behind @ r2), behind
            reflection = r1 + t12 @ (loop[0] @ (behind @ t21))
        behind = path[..., :, None] * reflection * path[..., None, :]
        loads.insert(0, behind)
        loops.insert(0, loop)
    inverse: Complex = np.asarray(np.linalg.inv(eye - face * loads[0]), complex)
    left: Complex = np.asarray(inverse[..., 0, :], complex)
    right: Complex = np.asarray(inverse[..., :, 0], complex)
    value = _between(left, loads[0][..., :, :1], np.ones_like(right[..., :1]))
    by_length, by_depth = [], []
    heated, stretched = np.zeros_like(value), np.zeros_like(value)
    for i, (_, t12, t21, r2) in enumerate(blocks):
        onwards, back = _apply(loads[i], right), _apply_left(left, loads[i])
        by_length.append(-1j * _sum(waves.k, left * onwards + back * right))
        by_heat = _sum(waves.by_temperature, left * onwards + back * right)
        heated += -1j * lengths[:, i, None] * by_heat
        left, right = np.asarray(left * paths[i]), np.asarray(paths[i] * right)
        loop = loops[i]
        if loop is None:
            out, into, next_left, next_right = None, None, left, right
        else:
            # Waves between this press and the next, towards the face and away from it.
            inner, load = loop
            sent = _apply(t21, right)
            into = _apply(inner, _apply(load, sent))
            out = _apply_left(_apply_left(_apply_left(left, t12), inner), load)
            next_left = _apply_left(_apply_left(left, t12), inner)
            next_right = sent + _apply(r2, into)
        by_depth.append(_moved(presses[i].by_depth, left, right, out, into))
        stretched += _moved(presses[i].by_stretch, left, right, out, into)
        left, right = next_left, next_right
    lengthened = np.stack(by_length, axis=1)
    # A place is the end of its own section and the start of the next.
    following = np.concatenate([lengthened[:, 1:], np.zeros_like(lengthened[:, :1])], axis=1)
    return Echo(value, lengthened - following, np.stack(by_depth, axis=1), heated, stretched)


def _blocks(s: Complex) -> tuple[Complex, Complex, Complex, Complex]:
    """Return the reflection at port 1, transmission 2 to 1 and 1 to 2, reflection at port 2."""
    return s[..., 0, :, 0, :], s[..., 0, :, 1, :], s[..., 1, :, 0, :], s[..., 1, :, 1, :]


def _moved(
    change: Complex, left: Complex, right: Complex, out: Complex | None, into: Complex | None
) -> Complex:
    """Return the change of the echo for a change of a press's matrix."""
    r1, t12, t21, r2 = _blocks(change)
    found = _between(left, r1, right)
    if out is not None and into is not None:
        found = found + _between(left, t12, into) + _between(out, t21, right)
        found = found + _between(out, r2, into)
    return found


def _apply(matrix: Complex, vector: Complex) -> Complex:
    return np.asarray((matrix @ vector[..., None])[..., 0])


def _apply_left(vector: Complex, matrix: Complex) -> Complex:
    return np.asarray((vector[..., None, :] @ matrix)[..., 0, :])


def _between(left: Complex, matrix: Complex, right: Complex) -> Complex:
    return np.asarray(_sum(left, _apply(matrix, right)))


def _sum(a: Complex, b: Complex) -> Complex:
    return np.asarray((a * b).sum(axis=-1))
