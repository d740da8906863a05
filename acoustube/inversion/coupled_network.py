"""Echo of presses along a wrapped tube, with derivatives by all parameters.

The equations are those of :mod:`acoustube.inversion.network`, except that wavenumbers vary along
the tube, matrices vary with position and temperature, and modes convert before the first press.
"""

from __future__ import annotations

import numpy as np

from acoustube.inversion.joints import Joined
from acoustube.inversion.network import Echo
from acoustube.inversion.paths import Entry, Section
from acoustube.waves.scattering import Complex


def coupled_echo(
    presses: list[Joined], sections: list[Section], face: complex, entry: Entry | None = None
) -> Echo:
    """Return the echo that presses along a wrapped tube cause at the face of the source.

    Parameters
    ----------
    presses : list of Joined
        One for each press, in the order from the face.
    sections : list of Section
        The propagation before each press.
    face : complex
        Reflection coefficient of the face for all modes.
    entry : Entry, optional
        Propagation from the face to the start of the first section, if that is not the face.

    Returns
    -------
    Echo
        Its value is (p - 1) / (1 + face), where p is the pressure of the plane wave at the face
        divided by the launched pressure.
    """
    blocks = [_blocks(press.value) for press in presses]
    paths = [section.factor for section in sections]
    eye = np.eye(paths[0].shape[-1])
    # From the last press to the face: the reflection in front of each press and, for the multiple
    # reflections behind it, the inverse of I - B R2. B is the reflection of all that follows, and
    # R2 that of the press from behind.
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
    value, heated, left, right = _at_face(loads[0], face, entry)
    by_place: list[Complex] = []
    by_depth: list[Complex] = []
    stretched = np.zeros_like(value)
    for i, (_, t12, t21, r2) in enumerate(blocks):
        onwards, back = _apply(loads[i], right), _apply_left(left, loads[i])
        both = -1j * (left * onwards + back * right)
        heated += _sum(sections[i].by_temperature, both)
        if i:
            by_place[-1] = by_place[-1] - _sum(sections[i].at_start, both)
        by_place.append(_sum(sections[i].at_end, both))
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
        deepened, stretch, moved, warmed = presses[i].changes(left, right, out, into)
        by_depth.append(deepened)
        by_place[-1] = by_place[-1] + moved
        stretched += stretch
        heated += warmed
        left, right = next_left, next_right
    return Echo(
        value, np.stack(by_place, axis=1), np.stack(by_depth, axis=1), heated, stretched,
        np.zeros_like(value),
    )  # fmt: skip


def _at_face(
    load: Complex, face: complex, entry: Entry | None
) -> tuple[Complex, Complex, Complex, Complex]:
    """Return the echo at the face, its derivative by temperature in the entry, and two vectors.

    The first vector is the row of factors with which the modes that leave the start of the first
    section towards the face are received. The second is the column of the modes' amplitudes that
    arrive at this start from the face. Both are (n, n_f, m).
    """
    at_face = load if entry is None else entry.matrix.swapaxes(-1, -2) @ load @ entry.matrix
    eye = np.eye(at_face.shape[-1])
    inverse: Complex = np.asarray(np.linalg.inv(eye - face * at_face), complex)
    left: Complex = np.asarray(inverse[..., 0, :], complex)
    right: Complex = np.asarray(inverse[..., :, 0], complex)
    value = _between(left, at_face[..., :, :1], np.ones_like(right[..., :1]))
    heated = np.zeros_like(value)
    if entry is not None:
        onwards, back = _apply(at_face, right), _apply_left(left, at_face)
        heated += -1j * _sum(entry.by_temperature, left * onwards + back * right)
        left, right = _apply(entry.matrix, left), _apply(entry.matrix, right)
    return value, heated, left, right


def _blocks(s: Complex) -> tuple[Complex, Complex, Complex, Complex]:
    """Return the blocks R1, T12 (from port 2 to port 1), T21 and R2 of a scattering matrix."""
    return s[..., 0, :, 0, :], s[..., 0, :, 1, :], s[..., 1, :, 0, :], s[..., 1, :, 1, :]


def _apply(matrix: Complex, vector: Complex) -> Complex:
    return np.asarray((matrix @ vector[..., None])[..., 0])


def _apply_left(vector: Complex, matrix: Complex) -> Complex:
    return np.asarray((vector[..., None, :] @ matrix)[..., 0, :])


def _between(left: Complex, matrix: Complex, right: Complex) -> Complex:
    return np.asarray(_sum(left, _apply(matrix, right)))


def _sum(a: Complex, b: Complex) -> Complex:
    return np.asarray((a * b).sum(axis=-1))
