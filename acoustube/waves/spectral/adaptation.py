"""Adaptation of degree and elements to an error tolerance, and the remaining truncation error."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from acoustube.waves.spectral.discretisation import (
    Discretisation,
    Response,
    discretise,
    respond,
)
from acoustube.waves.spectral.first_basis import ELEMENT_DEGREE, KRYLOV_BLOCKS, Basis
from acoustube.waves.spectral.lossy import with_layers
from acoustube.waves.spectral.partition import split
from acoustube.waves.spectral.polynomials import Array
from acoustube.waves.spectral.ports import axial_wavenumbers, changed_scattering
from acoustube.waves.spectral.truncation import excess_across, missing_along
from acoustube.waves.spectral.walls import Wall

MAX_DEGREE = 16
ADAPTATION_SHIFTS = (0.5, 0.8, 1.0)
"""Shifts (squared wavenumbers) at which the basis is adapted: their indices in the list of all
shifts, as fractions of the last index."""
COARSE_ERROR_RATIO = 30.0
"""Ratio of error to tolerance above which the polynomial degree is raised by 4 instead of 2."""
MAX_ADAPTATIONS = 8


class Adapted(NamedTuple):
    """Discretisation refined until S meets a tolerance at test shifts, or until a limit is reached.

    Attributes
    ----------
    system : Discretisation
    basis : Basis
    responses : dict
        Responses by squared wavenumber in 1/m2: a list with one for each parity along z.
    """

    system: Discretisation
    basis: Basis
    responses: dict[float, list[Response]]


def discretised(
    wall: Wall,
    k: Array,
    odd: bool | None,
    basis: Basis,
    *,
    lossy: bool,
    order: int = ELEMENT_DEGREE,
) -> Discretisation:
    """Assemble the matrices of a lumen in a basis, with its boundary layers if it is lossy.

    Parameters
    ----------
    wall : Wall
    k : ndarray
        Wavenumbers in 1/m, (n,), rising.
    odd : bool or None
        True for fields antisymmetric about x = 0, False for symmetric ones; None for both.
    basis : Basis
    lossy : bool
        Whether the wall has boundary layers.
    order : int
        Polynomial degree along an element.
    """
    system = discretise(wall, basis.edges, basis.degree, order, odd, float(k[-1]))
    return with_layers(system, wall, basis.flat) if lossy else system


def adapted(
    wall: Wall,
    k: Array,
    odd: bool | None,
    basis: Basis,
    wanted: float,
    known: Adapted | None,
    *,
    lossy: bool,
) -> Adapted:
    """Raise the degree and split elements until S meets a tolerance, or until a limit is reached.

    S is tested at a few shifts. The limits are :data:`MAX_DEGREE` and :data:`MAX_ADAPTATIONS`.

    Parameters
    ----------
    wall, k, odd, lossy
        As for :func:`discretised`.
    basis : Basis
        Initial basis.
    wanted : float
        Tolerance of the largest change of S by a higher degree across the tube, and of the sum
        over all elements of the change of S by a higher degree along each.
    known : Adapted or None
        Previous result, whose responses include all shifts of the basis.
    """
    shifts = basis.shifts
    probes = _probes(shifts)
    for left in reversed(range(MAX_ADAPTATIONS)):
        if known is not None:
            (system, _, responses), known = known, None
        else:
            system = discretised(wall, k, odd, basis, lossy=lossy)
            blocks = KRYLOV_BLOCKS[lossy]
            responses = {float(shift): respond(system, float(shift), blocks) for shift in probes}
        at_probes = {float(shift): responses[float(shift)] for shift in probes}
        by_degree, by_element = _errors(system, at_probes)
        too_low, too_long = by_degree > wanted, by_element.sum() > wanted
        if not (too_low or too_long):
            break
        degree, edges = basis.degree, basis.edges
        if too_low:
            degree += 4 if by_degree > COARSE_ERROR_RATIO * wanted else 2
        if too_long:
            edges = split(edges, by_element > 0.5 * wanted / len(by_element))
        if degree > MAX_DEGREE or not left:
            break
        basis = Basis(degree, edges, shifts, basis.flat)
    return Adapted(system, basis, responses)


def _probes(shifts: Array) -> Array:
    """Return those of the shifts (squared wavenumbers) at which the basis is adapted."""
    return shifts[np.round(np.array(ADAPTATION_SHIFTS) * (len(shifts) - 1)).astype(int)]


def truncation_ratio(
    system: Discretisation, responses: dict[float, list[Response]], k: Array
) -> Array:
    """Return the ratio of the truncation error of S to the change of S by the corrections, (n,).

    The corrections of the impedance are `by_degree` and `by_element` of :class:`Response`. The
    ratio is interpolated over k^2 between the responses.

    Parameters
    ----------
    system : Discretisation
    responses : dict
        By squared wavenumber in 1/m2, in rising order: one response for each parity along z.
    k : ndarray
        Wavenumbers in 1/m, (n,).
    """
    missing = missing_along(system, responses)
    ratio = []
    for shift, sides in responses.items():
        here = {shift: sides}
        across = excess_across(system, here)
        by_degree, by_element = _errors(system, here)
        whole = across * by_degree + _largest_changes(system, here, missing).sum()
        ratio.append(whole / max(by_degree + by_element.sum(), np.finfo(float).tiny))
    return np.asarray(np.interp(k**2, list(responses), ratio))


def _errors(system: Discretisation, responses: dict[float, list[Response]]) -> tuple[float, Array]:
    """Return the largest changes of S by higher degrees, across the tube and along each element."""
    corrections = {
        shift: [np.concatenate([side.by_degree[None], side.by_element]) for side in sides]
        for shift, sides in responses.items()
    }
    found = _largest_changes(system, responses, corrections)
    return float(found[0]), found[1:]


def _largest_changes(
    system: Discretisation,
    responses: dict[float, list[Response]],
    corrections: dict[float, list[Array]],
) -> Array:
    """Return the largest change of S over all shifts by each of n impedance corrections, (n,)."""
    found = []
    zeros = np.tile(system.modes.zeros, len(system.ports))
    for shift, sides in responses.items():
        k = np.sqrt([shift])
        travels = np.flatnonzero(zeros < k * system.radius)
        kz = axial_wavenumbers(k, zeros, system.radius)
        for side, changes in zip(sides, corrections[shift], strict=True):
            changed = changed_scattering(side.impedance[None], changes, kz)
            found.append(np.abs(changed[:, travels][..., travels]).max(axis=(1, 2), initial=0.0))
    return np.asarray(np.max(found, axis=0))
