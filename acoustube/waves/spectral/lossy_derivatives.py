"""Derivatives of a scattering matrix with boundary layers by motions of the wall.

With losses the integrals over the wall change too: their points move, the area and directions of
the wall change, and so do the gaps, on which the layers depend. The polynomials stay fixed in
space. The system matrix is A. With the loads C of the lossless modes and the fluxes F of the lossy
ones, the loads of the latter are R = C F, and their fields x solve A x = R. The impedance matrix
Z = R^T x changes by

    dZ = dR^T x + x^T dR - x^T dA x,

as without losses (:mod:`acoustube.waves.spectral.derivatives`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from acoustube.air import Air
from acoustube.waves.spectral.boundary import tangential_matrices, wall_points
from acoustube.waves.spectral.derivatives import NO_MODES, Changes, modes_like, reduced_changes
from acoustube.waves.spectral.discretisation import Discretisation
from acoustube.waves.spectral.elimination import product
from acoustube.waves.spectral.end_layers import lossy_ends
from acoustube.waves.spectral.ends import rim_of
from acoustube.waves.spectral.layers import LayerSeries, changed_series
from acoustube.waves.spectral.lossy import (
    LAYER_DEGREE,
    LossySide,
    both_ports,
    layer_functions,
    wall_layout,
)
from acoustube.waves.spectral.motion import Motion
from acoustube.waves.spectral.polynomials import Array, Index
from acoustube.waves.spectral.ports import Complex, changed_scattering
from acoustube.waves.spectral.reduction import MAX_MATRICES, LossyBand, Reduced


class WallChanges(NamedTuple):
    """Derivatives of the boundary-layer terms by a shape parameter.

    Each is a sum of products of a function of frequency and a matrix. One side is one parity along
    z.

    Attributes
    ----------
    viscous, thermal : ndarray
        Functions of frequency, (n_frequencies, n_parts): first those of the losses, in m, then
        those of the derivatives of the losses, in m per unit of the parameter.
    sides : list of tuple of ndarray
        Stiffness and mass in the space of each side, (n_parts, n_fields, n_fields): derivatives of
        the wall integrals for the former functions, the integrals themselves for the latter.
    """

    viscous: Complex
    thermal: Complex
    sides: list[tuple[Array, Array]]


def wall_changes(
    system: Discretisation,
    motion: Motion,
    spaces: list[Reduced],
    series: LayerSeries,
    frequency: Array,
    air: Air,
) -> WallChanges:
    """Return the derivatives of the boundary-layer terms in the reduced space of each side.

    Parameters
    ----------
    system : Discretisation
    motion : Motion
    spaces : list of Reduced
    series : LayerSeries
        Losses at the wall.
    frequency : ndarray
        In Hz, (n,).
    air : Air
    """
    assert system.layers is not None
    base, layout = system.layers.points, wall_layout(system)
    less, more = (wall_points(w, base.rule, LAYER_DEGREE) for w in (motion.less, motion.more))
    # The gaps move with the wall; the polynomials stay fixed.
    there = [
        (points, layer_functions(system, points._replace(boxes=base.boxes)))
        for points in (less, more)
    ]
    turned = changed_series(base, (less, more), motion.step, frequency, air)
    fields = [system.in_polynomials(space.fields, space.corrections)[0] for space in spaces]
    found: list[list[tuple[Array, Array]]] = [[] for _ in spaces]

    def add(integrals: tuple[Array, Array], where: Index) -> None:
        for side, own in zip(found, fields, strict=True):
            stiffness, mass = (product(own[where], part @ own[where]) for part in integrals)
            side.append((stiffness, mass))

    for weight in series.weights:
        where = np.unique(base.rule.element[weight.any(axis=1)])
        before, after = (
            tangential_matrices(points, functions, layout, weight, where)
            for points, functions in there
        )
        stiffness, mass = ((b - a) / motion.step for a, b in zip(before, after, strict=True))
        add((stiffness, mass), where)
    for weight in turned.weights:
        where = np.unique(base.rule.element[weight.any(axis=1)])
        own = tangential_matrices(base, system.layers.functions, layout, weight, where)
        add(own, where)
    return WallChanges(
        np.concatenate([series.viscous, turned.viscous], axis=1),
        np.concatenate([series.thermal, turned.thermal], axis=1),
        [(np.stack([k for k, _ in side]), np.stack([m for _, m in side])) for side in found],
    )


def changed_ends(
    system: Discretisation, motion: Motion, k: Complex, frequency: Array, air: Air
) -> tuple[Complex, Complex]:
    """Return the derivatives of the lossy modes' axial wavenumbers and of their fluxes.

    Parameters
    ----------
    system : Discretisation
    motion : Motion
    k : ndarray
        Wavenumbers of free sound in the air in 1/m, (n,).
    frequency : ndarray
        In Hz, (n,).
    air : Air

    Returns
    -------
    drift : ndarray
        In 1/m per unit of the parameter, (n, n_modes).
    flux : ndarray
        Per unit of the parameter, (n, n_modes, n_modes).

    Raises
    ------
    ConfigError
        If two modes of an end that is not round have the same cut-on.
    """
    found = []
    odd = system.functions.odd
    for wall in (motion.less, motion.more):
        modes, _ = modes_like(wall, system.modes, NO_MODES, odd)
        rim = rim_of(wall, modes, odd)
        found.append(lossy_ends(k, modes, wall.radius, rim, frequency, air))
    drift, flux = ((after - before) / motion.step for before, after in zip(*found, strict=True))
    return drift, flux


def moved_lossy_scattering(
    system: Discretisation,
    sides: list[LossySide],
    spaces: list[Reduced],
    changes: Changes,
    walls: WallChanges,
    ends: tuple[Complex, Complex],
) -> list[Complex]:
    """Return the derivative of S with losses for each side (parity along z).

    Parameters
    ----------
    system : Discretisation
    sides : list of LossySide
        The solutions, from :func:`acoustube.waves.spectral.lossy.lossy_scattering`.
    spaces : list of Reduced
    changes : Changes
    walls : WallChanges
    ends : tuple of ndarray
        From :func:`changed_ends`.

    Returns
    -------
    list of ndarray
        At the ports, (n, n_ports n_modes, n_ports n_modes), per unit of the parameter.
    """
    drift = np.tile(ends[0], (1, len(system.ports)))
    flux_change = both_ports(ends[1], len(system.ports))
    found = []
    for side, space, (stiffness, mass) in zip(sides, spaces, walls.sides, strict=True):
        bulk = reduced_changes(system, space, changes)
        span = side.model.vector @ side.solution.span
        parts = np.stack([span.T @ part @ span for part in [bulk[0], bulk[1], *stiffness, *mass]])
        band = side.band._replace(viscous=walls.viscous, thermal=walls.thermal)
        pushed = _quadratic(parts, band, side.solution.fields)
        loads = (span.T @ bulk[2]) @ band.flux + (span.T @ space.ports) @ flux_change
        loaded = loads.swapaxes(1, 2) @ side.solution.fields
        change = loaded + loaded.swapaxes(1, 2) - pushed
        found.append(changed_scattering(side.impedance, change, side.kz, drift))
    return found


def _quadratic(parts: Complex, band: LossyBand, fields: Complex) -> Complex:
    """Return x^T dA x of fields x at all frequencies, (n, n_ports n_modes, n_ports n_modes).

    dA is the sum of `parts`, (2 + 2 n_parts, n_span, n_span), times the band's `factors`.
    """
    factors, flat = band.factors, parts.reshape(len(parts), -1)
    found = np.empty(band.flux.shape, complex)
    for start in range(0, len(found), MAX_MATRICES):
        few = slice(start, start + MAX_MATRICES)
        matrices = (factors[few] @ flat).reshape(-1, *parts.shape[1:])
        found[few] = fields[few].swapaxes(1, 2) @ (matrices @ fields[few])
    return found
