"""Compiled loops for the recorded spectrum: the echo through the transducer, and the clutter.

The recorded spectrum is ``exp(g + j p) G H^2 X`` plus the clutter, with the echo X at the face, the
deviations g and p of gain and phase, the gain G without the transducer's resonance, and the
transducer's response ``H = 1 / (1 + j Q (f / f0 - f0 / f))``. The loops run frequency by frequency;
derivatives are in the order of the parameters, place and depth of each press in turn and then the
seven nuisance parameters.
"""

from __future__ import annotations

import numba
import numpy as np

from acoustube.base.types import Array
from acoustube.inversion.sample_sums import SingleComplex
from acoustube.inversion.small_matrices import OPTIONS
from acoustube.waves.scattering import Complex


@numba.njit(**OPTIONS)
def recorded(
    value: Complex, by_place: Complex, by_depth: Complex, by_temperature: Complex,
    by_stretch: Complex, by_bore: Complex, nuisances: Array, frequency: Array, sent: Complex,
    resonator: tuple[float, float], warming: float,
) -> tuple[Complex, SingleComplex]:  # fmt: skip
    """Return recorded spectra of echoes and their derivatives by all parameters.

    Parameters
    ----------
    value, by_temperature, by_stretch, by_bore : ndarray
        Echo at the face and its derivatives by temperature, by stretch of the frequency in the
        presses and by the bore between them, (n, n_f).
    by_place, by_depth : ndarray
        Its derivatives by place and depth of the presses, (n, n_presses, n_f).
    nuisances : ndarray
        Nuisance parameters, (n, 7).
    frequency : ndarray
        In Hz, (n_f,).
    sent : ndarray
        Gain from reflection coefficient to recorded spectrum, without the transducer's resonance,
        in counts s, (n_f,).
    resonator : (float, float)
        Nominal resonance of the transducer in Hz, and its quality factor.
    warming : float
        Derivative of the stretch by temperature in 1/K.

    Returns
    -------
    ndarray
        Spectra in counts s, (n, n_f).
    ndarray
        Their derivatives in single precision, (n, 2 n_presses + 7, n_f).
    """
    n, p, n_f = by_place.shape
    found = np.empty((n, n_f), np.complex128)
    slopes = np.empty((n, 2 * p + 7, n_f), np.complex64)
    for a in range(n):
        turn = np.exp(nuisances[a, 1]) * complex(np.cos(nuisances[a, 2]), np.sin(nuisances[a, 2]))
        resonance = resonator[0] * (1 + nuisances[a, 3])
        quality = resonator[1] * (1 + nuisances[a, 4])
        for f in range(n_f):
            here, inverse = frequency[f] / resonance, resonance / frequency[f]
            off = here - inverse
            response = 1 / complex(1, quality * off)
            factor = turn * sent[f] * response * response
            for i in range(p):
                slopes[a, 2 * i, f] = factor * by_place[a, i, f]
                slopes[a, 2 * i + 1, f] = factor * by_depth[a, i, f]
            echo = factor * value[a, f]
            found[a, f] = echo
            slope = -2j * response * echo  # by `quality * off`
            warm = by_temperature[a, f] + warming * by_stretch[a, f]
            slopes[a, 2 * p, f] = factor * warm
            slopes[a, 2 * p + 1, f] = echo
            slopes[a, 2 * p + 2, f] = 1j * echo
            slopes[a, 2 * p + 3, f] = -slope * quality * (here + inverse) * resonator[0] / resonance
            slopes[a, 2 * p + 4, f] = slope * off * resonator[1]
            slopes[a, 2 * p + 5, f] = factor * by_stretch[a, f]
            slopes[a, 2 * p + 6, f] = factor * (by_stretch[a, f] + by_bore[a, f])
    return found, slopes


@numba.njit(**OPTIONS)
def add_clutter(
    found: Complex, slopes: SingleComplex, beyond: Complex, passed: Complex, gain: Complex,
    warming: float,
) -> None:  # fmt: skip
    """Add the clutter, attenuated by the presses before it, and its derivatives, in place.

    With the clutter C(z) of all the tube beyond z and the two-way transmissions t_i of the presses
    at z_i, it is C(0) - C(z_1) + t_1 (C(z_1) - C(z_2)) + t_1 t_2 (C(z_2) - ...) + ...

    Parameters
    ----------
    found, slopes : ndarray
        Results of :func:`recorded`.
    beyond : ndarray
        C(0) and C(z_i), and their derivatives by place and temperature, (3, n, n_presses + 1, n_f).
    passed : ndarray
        t_i, and their derivatives by depth and stretch, (n_presses, 3, n, n_f).
    gain : ndarray
        Gain from reflection coefficient to recorded spectrum, in counts s, (n_f,).
    warming : float
        Derivative of the stretch by temperature in 1/K.
    """
    n, n_f = found.shape
    p = len(passed)
    for a in range(n):
        for f in range(n_f):
            total, warm = beyond[0, a, 0, f], beyond[2, a, 0, f]
            stretched, transmitted = 0j, 1 + 0j
            for i in range(p):
                # The sum is C(0) + sum_i (t_1 ... t_i - t_1 ... t_i-1) C(z_i).
                share = transmitted * (passed[i, 0, a, f] - 1)
                total += share * beyond[0, a, i + 1, f]
                warm += share * beyond[2, a, i + 1, f]
                slopes[a, 2 * i, f] += gain[f] * share * beyond[1, a, i + 1, f]
                # What arrives through press i is proportional to t_i.
                onwards, product = transmitted * beyond[0, a, i + 1, f], transmitted
                for j in range(i + 1, p):
                    onwards += product * (passed[j, 0, a, f] - 1) * beyond[0, a, j + 1, f]
                    product = product * passed[j, 0, a, f]
                slopes[a, 2 * i + 1, f] += gain[f] * passed[i, 1, a, f] * onwards
                stretched += passed[i, 2, a, f] * onwards
                transmitted = transmitted * passed[i, 0, a, f]
            found[a, f] += gain[f] * total
            slopes[a, 2 * p, f] += gain[f] * (warm + warming * stretched)
            slopes[a, 2 * p + 5, f] += gain[f] * stretched
            slopes[a, 2 * p + 6, f] += gain[f] * stretched
