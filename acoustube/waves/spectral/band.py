"""Solution over a band: fields at a few frequencies, and a Galerkin solution in their span."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

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
"""Largest error of S by too few shifts (frequencies solved directly), as a fraction of the whole
tolerance. It is small, because reducing this error costs little."""
EXTRA_BLOCKS = {False: 2, True: 3}
"""Number of blocks of the Krylov space at an added shift (squared wavenumber), without and with
losses. Few suffice, because most of that space is in the span of the other shifts' blocks."""
MAX_ROUNDS = 6
"""Largest number of rounds in which shifts are added: squared wavenumbers of direct solutions."""
NEAREST = 0.1
"""Smallest distance of a new shift k^2 from its neighbours, relative to their mutual distance."""


def swept(
    system: Discretisation,
    basis: Basis,
    responses: dict[float, list[Response]],
    k: Array,
    tolerance: float,
) -> tuple[list[Reduced], Complex, tuple[Array, Array], list[int]]:
    """Return reduced spaces, S, its two errors, and the spaces' sizes before the last new shifts.

    There are one space and one size for each parity along z. S, (n, 2, m, 2, m), is without losses,
    at wavenumbers `k` in 1/m, (n,). The errors are the change of S by the corrections of degree and
    elements, and the error by the choice of shifts (squared wavenumbers solved directly), (n,)
    each. `responses` receives the responses at all shifts.

    Notes
    -----
    The error of a space of m blocks at each shift is first extrapolated from the change d of S by
    the last block, as d^(m / (m - 1)): the error falls by the same factor with each block. A shift
    is then added in each interval between shifts in which this error is too large, and in one
    interval at least. In the intervals with a new shift, the change of S by the new shifts replaces
    the error. Elsewhere the larger of this change and the previous error is kept, because the
    change does not show the error there.
    """
    lossy, limit = system.layers is not None, ADAPTATION_TOLERANCE * tolerance
    blocks = KRYLOV_BLOCKS[lossy]
    for shift in basis.shifts:
        if float(shift) not in responses:
            responses[float(shift)] = respond(system, float(shift), blocks)
    sides = list(zip(*responses.values(), strict=True))
    spaces = _extended(
        system, [None] * len(sides), [[own.fields for own in side] for side in sides]
    )
    before = scattering_at(system, spaces, k)
    spaces = _extended(system, spaces, [[own.last for own in side] for side in sides])
    now = scattering_at(system, spaces, k)
    doubt = difference(system, now, before, k) ** (blocks / (blocks - 1))
    for _ in range(MAX_ROUNDS):
        more, tested = _doubtful(k, doubt, np.sort(list(responses)), limit)
        for shift in more:
            responses[shift] = respond(system, shift, EXTRA_BLOCKS[lossy])
        before, sizes = now, [space.size for space in spaces]
        sides = list(zip(*(responses[shift] for shift in more), strict=True))
        fields = [[part for own in side for part in (own.fields, own.last)] for side in sides]
        spaces = _extended(system, spaces, fields)
        now = scattering_at(system, spaces, k)
        change = difference(system, now, before, k)
        doubt = np.where(tested, change, np.maximum(change, doubt))
        if doubt.max() <= limit:
            break
    sides = list(zip(*(responses[float(shift)] for shift in basis.shifts), strict=True))
    spaces = [
        corrected(system, space, _side_by_side([own.correction for own in side]))
        for space, side in zip(spaces, sides, strict=True)
    ]
    richest = scattering_at(system, spaces, k)
    return spaces, richest, (difference(system, richest, now, k), doubt), sizes


def _extended(
    system: Discretisation, spaces: Sequence[Reduced | None], fields: list[list[Array]]
) -> list[Reduced]:
    return [
        extended(system, space, _side_by_side(own))
        for space, own in zip(spaces, fields, strict=True)
    ]


def _doubtful(
    k: Array, doubt: Array, shifts: Array, limit: float
) -> tuple[list[float], NDArray[np.bool_]]:
    """Return new shifts, one in each interval with too large an error, and a mask of wavenumbers.

    Parameters
    ----------
    k : ndarray
        In 1/m, (n,).
    doubt : ndarray
        Estimated error, (n,).
    shifts : ndarray
        In 1/m2, rising, (n_shifts,).
    limit : float
        Largest allowed error.

    Returns
    -------
    more : list of float
        New shifts in 1/m2, at least one.
    tested : ndarray of bool
        Mask of the wavenumbers in intervals with a new shift, (n,).
    """
    borders = np.concatenate([[0.0], shifts, [max(shifts[-1], k[-1] ** 2) * (1 + 1e-12)]])
    interval = np.searchsorted(shifts, k**2)
    below, above = borders[interval], borders[interval + 1]
    away = np.minimum(k**2 - below, above - k**2) > NEAREST * (above - below)
    at, largest = [], []
    for number in np.unique(interval[away]):
        here = np.flatnonzero(away & (interval == number))
        at.append(int(here[np.argmax(doubt[here])]))
        largest.append(float(doubt[interval == number].max()))
    if not at:
        return [float(shifts[-2:].mean())], np.ones(len(k), bool)
    wanted = np.array(largest) > limit
    wanted[np.argmax(largest)] = True
    chosen = np.array(at)[wanted]
    return [float(shift) for shift in k[chosen] ** 2], np.isin(interval, interval[chosen])


def _side_by_side(fields: list[Array]) -> Array:
    return np.concatenate(fields, axis=-1)


def difference(system: Discretisation, a: Complex, b: Complex, k: Array) -> Array:
    """Return the largest difference of two scattering matrices over propagating modes, (n,).

    `a` and `b` are (n, 2, m, 2, m), at wavenumbers `k` in 1/m, (n,).
    """
    travels = k[:, None] * system.radius > system.modes.zeros
    both = travels[:, None, :, None, None] & travels[:, None, None, None, :]
    return np.asarray(np.where(both, np.abs(a - b), 0.0).max(axis=(1, 2, 3, 4)))


def scattering_at(system: Discretisation, spaces: list[Reduced], k: Array) -> Complex:
    """Return S without losses, (n, 2, m, 2, m), from the reduced space of each parity along z."""
    kz = axial_wavenumbers(k, np.tile(system.modes.zeros, len(system.ports)), system.radius)
    return of_both_ports([scattering_of(impedance(space, k), kz) for space in spaces])
