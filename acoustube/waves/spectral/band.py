"""Solution over a band: fields at the shifts, and their span at all frequencies."""

from __future__ import annotations

import numpy as np

from acoustube.waves.spectral.discretisation import (
    Discretisation,
    Response,
    respond,
)
from acoustube.waves.spectral.first_basis import KRYLOV_BLOCKS, Basis
from acoustube.waves.spectral.polynomials import Array
from acoustube.waves.spectral.ports import (
    Complex,
    axial_wavenumbers,
    of_both_ports,
    scattering_of,
)
from acoustube.waves.spectral.reduction import Reduced, corrected, extended, impedance

ADAPTATION_TOLERANCE = 0.25
"""Fraction of the tolerance for the errors that cost little: of the shifts and of the points."""
MAX_EXTRA_SHIFTS = 8


def swept(
    system: Discretisation,
    basis: Basis,
    responses: dict[float, list[Response]],
    k: Array,
    tolerance: float,
) -> tuple[list[Reduced], Complex, Array, list[int]]:
    """Return the largest basis per parity, S, its errors, and basis sizes before the last shift."""
    blocks = KRYLOV_BLOCKS[system.layers is not None]
    for shift in basis.shifts:
        if float(shift) not in responses:
            responses[float(shift)] = respond(system, float(shift), blocks)
    n_sides = len(system.sides)
    spaces = [
        extended(system, None, _side_by_side([r[side].fields for r in responses.values()]))
        for side in range(n_sides)
    ]
    before = scattering_at(system, spaces, k)
    spaces = [
        extended(system, space, _side_by_side([r[side].last for r in responses.values()]))
        for side, space in enumerate(spaces)
    ]
    now = scattering_at(system, spaces, k)
    for _ in range(MAX_EXTRA_SHIFTS):
        doubt = difference(system, now, before, k)
        shift = _worst(k, doubt, np.array(list(responses)))
        responses[shift] = respond(system, shift, blocks)
        before, sizes = now, [space.size for space in spaces]
        spaces = [
            extended(system, space, _side_by_side([response.fields, response.last]))
            for space, response in zip(spaces, responses[shift], strict=True)
        ]
        now = scattering_at(system, spaces, k)
        if difference(system, now, before, k).max() <= ADAPTATION_TOLERANCE * tolerance:
            break
    spaces = [
        corrected(system, space, _side_by_side([r[side].correction for r in responses.values()]))
        for side, space in enumerate(spaces)
    ]
    richest = scattering_at(system, spaces, k)
    lacking = difference(system, richest, now, k)
    error = lacking + difference(system, now, before, k)
    return spaces, richest, error, sizes


def _side_by_side(fields: list[Array]) -> Array:
    return np.concatenate(fields, axis=-1)


def _worst(k: Array, doubt: Array, shifts: Array) -> float:
    """Return the squared wavenumber of largest estimated error, away from the shifts so far."""
    gap = np.diff(np.sort(shifts)).min()
    away = np.abs(k[:, None] ** 2 - shifts).min(axis=1) > 0.1 * gap
    if not away.any():
        return float(np.sort(shifts)[-2:].mean())
    return float(k[np.argmax(np.where(away, doubt, -1.0))] ** 2)


def difference(system: Discretisation, a: Complex, b: Complex, k: Array) -> Array:
    """Return the largest difference of propagating coefficients at each wavenumber."""
    travels = k[:, None] * system.radius > system.modes.zeros
    both = travels[:, None, :, None, None] & travels[:, None, None, None, :]
    return np.asarray(np.where(both, np.abs(a - b), 0.0).max(axis=(1, 2, 3, 4)))


def scattering_at(system: Discretisation, spaces: list[Reduced], k: Array) -> Complex:
    """Return S at the ports, (n, 2, m, 2, m), from the reduced space of each side."""
    kz = axial_wavenumbers(k, np.tile(system.modes.zeros, len(system.ports)), system.radius)
    return of_both_ports([scattering_of(impedance(space, k), kz) for space in spaces])
