"""Echo of presses joined by straight tube, and its derivatives by all parameters.

Input reflection matrices are computed press by press, from the last one to the face (Redheffer's
star product, as in :mod:`acoustube.waves.network`). Derivatives are computed by the adjoint method:
a change dR of the reflection matrix at a plane changes the echo by a^T dR b. The row vector a^T
holds the amplitude of the plane wave that arrives at the face for unit amplitude of each mode that
leaves the plane towards it. The column vector b holds the amplitudes of the modes that arrive at
the plane for a plane wave of unit amplitude launched by the face.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from acoustube.base.types import Array
from acoustube.inversion.tables import MOST_MODES, FrontCoefficients, Matrices, padded
from acoustube.waves.scattering import Complex


class Echo(NamedTuple):
    """Echo of presses relative to the plane wave that the face launches, and its derivatives.

    Attributes
    ----------
    value : ndarray
        Amplitude of the plane wave that arrives at the face over that launched, (n, n_f).
    by_place : ndarray
        Derivatives by the places of the presses, per m, (n, n_presses, n_f).
    by_depth : ndarray
        Derivatives by the depths of the presses, per m, (n, n_presses, n_f).
    by_temperature : ndarray
        Derivative by temperature, per K, (n, n_f): through the propagation and, on a wrapped tube,
        through the presses' matrices, but not through the stretch.
    by_stretch : ndarray
        Derivative by the stretch of frequency in the presses' matrices, per relative change of
        frequency, (n, n_f).
    by_bore : ndarray
        Derivative by the bore between the presses, per relative change, (n, n_f); zero on a wrapped
        tube.
    """

    value: Complex
    by_place: Complex
    by_depth: Complex
    by_temperature: Complex
    by_stretch: Complex
    by_bore: Complex


class Waves(NamedTuple):
    """Wavenumbers of the modes at the nominal temperature and bore.

    Attributes
    ----------
    k : ndarray
        Axial wavenumbers in 1/m, (n_f, m).
    by_temperature : ndarray
        Their derivatives by temperature in 1/(m K), (n_f, m).
    transverse : ndarray
        Transverse wavenumbers in 1/m, (m,).
    """

    k: Complex
    by_temperature: Complex
    transverse: Array


def echo(
    before: list[Matrices], last: FrontCoefficients, places: Array, temperature: Array,
    widening: Array, waves: Waves, face: complex,
) -> Echo:  # fmt: skip
    """Return the echo of presses at the face of the source.

    Parameters
    ----------
    before : list of Matrices
        One for each press but the last, from the face on.
    last : FrontCoefficients
        Coefficients of the last press.
    places : ndarray
        Distances of the presses from the face in m, rising, (n, n_presses).
    temperature : ndarray
        Deviations of the temperature from the nominal one in K, (n,).
    widening : ndarray
        Relative deviations of the bore from the nominal one, (n,). They change the propagation of
        modes other than the plane one between the presses.
    waves : Waves
    face : complex
        Reflection coefficient of the face for all modes.

    Returns
    -------
    Echo
        Its value is (p - 1) / (1 + face), with the pressure p of the plane wave at the face over
        the launched pressure.
    """
    lengths = places.copy()
    lengths[:, 1:] -= places[:, :-1]
    from acoustube.inversion.network_sums import echoes  # Numba: not needed by acoustube.sensor

    missing = MOST_MODES - waves.k.shape[-1]
    k, heat = (
        np.pad(one, [(0, 0), (0, missing)]) if missing else np.ascontiguousarray(one)
        for one in waves[:2]
    )
    transverse = np.pad(waves.transverse, (0, missing))
    shape = len(places), len(k)
    matrices = (_stacked([press[i] for press in before], shape) for i in range(3))
    value, by_length, by_depth, *others = echoes(
        *matrices, *last, lengths, temperature, widening, k, heat, transverse, complex(face)
    )
    # A place is the end of its own section and the start of the next.
    following = np.concatenate([by_length[:, 1:], np.zeros_like(by_length[:, :1])], axis=1)
    return Echo(value, by_length - following, by_depth, *others)


def _stacked(parts: list[Complex], shape: tuple[int, ...]) -> Complex:
    """Return matrices of n parameter sets as one array, padded to three modes.

    Its shape is (n_presses, n, n_f, 2, 3, 2, 3).
    """
    if len(parts) == 1:
        return padded(parts[0], MOST_MODES)[None]
    found = np.zeros((len(parts), *shape, 2, MOST_MODES, 2, MOST_MODES), complex)
    for full, part in zip(found, parts, strict=True):
        full[:] = padded(part, MOST_MODES)
    return found
