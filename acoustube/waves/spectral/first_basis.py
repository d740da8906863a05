"""Initial discretisation: polynomial degree, elements, and shifts (squared wavenumbers)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acoustube.base.errors import ConfigError
from acoustube.base.units import MM
from acoustube.waves.spectral.discretisation import DEGREE_INCREASE
from acoustube.waves.spectral.ends import SECTION_DEGREE, end_modes
from acoustube.waves.spectral.partition import partition
from acoustube.waves.spectral.polynomials import Array
from acoustube.waves.spectral.ports import axial_wavenumbers
from acoustube.waves.spectral.quadrature import axial_rule
from acoustube.waves.spectral.walls import Wall

ELEMENT_DEGREE = 7
"""Polynomial degree along an element."""
LEAST_DEGREE = 8
DEGREE_PER_WAVE = 1.2
"""Initial polynomial degree across the tube per unit of k R (wavenumber times radius), to which
`DEGREE_MARGIN` is added."""
DEGREE_MARGIN = 3
FLAT, FLAT_DEGREES, LEAST_FLAT_DEGREE = 0.03, 2, 12
"""`FLAT` is the half height or half width of a section, relative to the radius of the ends, below
which a lumen counts as flat. `FLAT_DEGREES` is the increase of the degree across the tube of flat
lumens, and `LEAST_FLAT_DEGREE` their least degree."""
FIELDS_PER_WAVE = {False: 1.9, True: 1.2}
"""Number of fields of the reduced space per resonance of the lumen (half wavelength of a mode) up
to the highest frequency, without and with losses."""
KRYLOV_BLOCKS = {False: 4, True: 3}
"""Number of blocks of the Krylov space at each shift (squared wavenumber), without and with losses.

The response to the boundary layers is included at the shifts only. With losses, more shifts with
fewer blocks therefore give smaller errors in a space of the same size."""
SPARE_SHIFTS = {False: 2, True: 6}
"""Number of shifts beyond those that `FIELDS_PER_WAVE` requires, without and with losses."""
GRADING = 1.4
"""Exponent p: the wavenumbers k of the shifts are equally spaced in k^p."""
ABOVE_CUT_ON = 1.1
"""Wavenumber, relative to a mode's cut-on, of the additional shift that each mode has with losses.
There the response of the layers to a mode whose axial wavenumber has just become real changes fast.
"""
CLOSEST = 0.2
"""Smallest distance in k of an additional shift from the others, relative to the largest distance
between neighbouring shifts."""
DERIVATIVE_DEGREES = {False: 4, True: 2}
"""Increase of the degree across the tube for derivatives, without and with losses: their error is
of first order in the error of the field, that of the scattering matrix of second order."""


@dataclass(frozen=True, eq=False)
class Basis:
    """Parameters of a discretisation: degree across the tube, elements along it, and shifts.

    Attributes
    ----------
    degree : int
        Total degree across the tube.
    edges : ndarray
        Boundaries of the elements along the tube in m, (n_elements + 1,).
    shifts : ndarray
        Squared wavenumbers in 1/m2 at which the full equations are solved, (n_shifts,).
    flat : bool
        Whether a section is so flat that its walls may be pressed together.
    """

    degree: int
    edges: Array
    shifts: Array
    flat: bool = False


def first_basis(
    wall: Wall, odd: bool | None, k: Array, *, lossy: bool, moving: bool = False
) -> Basis:
    """Return the initial discretisation, chosen by the wavelength and the bore.

    Parameters
    ----------
    wall : Wall
    odd : bool or None
        True for fields antisymmetric about x = 0, False for symmetric ones; None for both.
    k : ndarray
        Wavenumbers in 1/m, (n,), rising.
    lossy : bool
        Whether the wall has boundary layers.
    moving : bool
        Whether derivatives by a motion of the wall are required.

    Raises
    ------
    ConfigError
        If ends that are not round are too wide for the wavelength.
    """
    reach = float(k[-1]) * wall.radius
    degree = max(LEAST_DEGREE, int(np.ceil(DEGREE_PER_WAVE * reach + DEGREE_MARGIN)))
    edges = partition(wall, float(k[-1]))
    flat = bool(flat_elements(wall, edges).any())
    if flat:
        degree = max(degree + FLAT_DEGREES, LEAST_FLAT_DEGREE)
    degree += DERIVATIVE_DEGREES[lossy] * moving
    degree += degree % 2
    if not wall.circular and degree + DEGREE_INCREASE > SECTION_DEGREE:
        raise ConfigError(
            f"a wavelength of {MM * 2 * np.pi / k[-1]:.3g} mm, that of the highest frequency, is "
            f"too short for this bore, which is not round and as wide as "
            f"{MM * 2 * wall.radius:.3g} mm; lower the frequency, or use the time-domain solver "
            "(acoustube.waves.scatter)"
        )
    modes = end_modes(wall, reach, odd)
    kz = axial_wavenumbers(k[-1:], modes.zeros, wall.radius).real
    waves = float(kz.sum()) * (edges[-1] - edges[0]) / np.pi
    per_shift = KRYLOV_BLOCKS[lossy] * len(modes) * (1 if wall.reversible else 2)
    n_shifts = SPARE_SHIFTS[lossy] + int(np.ceil(FIELDS_PER_WAVE[lossy] * waves / per_shift))
    high = float(k[-1])
    low = min(max(float(k[0]), 0.1 * high), 0.9 * high)
    shifts = np.linspace(low**GRADING, high**GRADING, n_shifts) ** (1 / GRADING)
    if lossy:
        shifts = _with_more(shifts, ABOVE_CUT_ON * modes.zeros[modes.zeros > 0] / wall.radius)
    return Basis(degree, edges, shifts**2, flat)


def flat_elements(wall: Wall, edges: Array) -> NDArray[np.bool_]:
    """Return a mask of the elements with a section flatter than `FLAT`, (n_elements,).

    Parameters
    ----------
    wall : Wall
    edges : ndarray
        Boundaries of the elements in m, (n_elements + 1,).
    """
    # At the points of the quadrature: the flattest section may be inside an element.
    rule = axial_rule(edges, ELEMENT_DEGREE + 1, wall.knots)
    x, y, *_ = wall.lines(rule.z)
    flat = np.minimum(np.ptp(x, axis=1), np.ptp(y, axis=1)) < 2 * FLAT * wall.radius
    return np.isin(np.arange(len(edges) - 1), rule.element[flat])


def _with_more(shifts: Array, more: Array) -> Array:
    """Return `shifts`, with those wavenumbers of `more` below the last shift and close to none."""
    close = CLOSEST * np.diff(shifts).max()
    for shift in more[more < shifts[-1]]:
        if np.abs(shifts - shift).min() > close:
            shifts = np.append(shifts, shift)
    return np.sort(shifts)
