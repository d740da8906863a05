"""Scattering with boundary layers and the air's absorption, in the span of the lossless fields."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from acoustube.waves.spectral.boundary import wall_functions, wall_matrices, wall_points
from acoustube.waves.spectral.discretisation import DEGREE_INCREASE, Discretisation
from acoustube.waves.spectral.layers import LayerSeries, layer_series, lossy_ends
from acoustube.waves.spectral.polynomials import Array, polynomials
from acoustube.waves.spectral.ports import Complex, scattering_of
from acoustube.waves.spectral.reduction import Reduced, lossy_impedance, reassembled
from acoustube.waves.spectral.sound import Air
from acoustube.waves.spectral.walls import Wall

CHECK_STRIDE = 12
"""Stride of the frequencies that are solved in the smaller space too."""


def with_layers(
    system: Discretisation, wall: Wall, edges: Array, degree: int, odd: bool | None, n_points: int
) -> Discretisation:
    """Return a discretisation with the wall's integrals, for which fields are added to the span."""
    points = wall_points(wall, edges, n_points)
    functions = wall_functions(points, polynomials(degree + DEGREE_INCREASE, odd))
    one = np.ones_like(points.area)
    layers = wall_matrices(points, functions, edges, system.order + 1, one, tangential=True)
    return replace(system, layers=layers)


def wall_projections(
    system: Discretisation,
    spaces: list[Reduced],
    wall: Wall,
    edges: Array,
    degree: int,
    odd: bool | None,
    n_points: int,
    frequency: Array,
    air: Air,
) -> tuple[LayerSeries, list[list[Reduced]]]:
    """Return the wall's losses over a band, and their integrals in the space of each side."""
    points = wall_points(wall, edges, n_points)
    functions = wall_functions(points, polynomials(degree + DEGREE_INCREASE, odd))
    series = layer_series(points, frequency, air)
    found: list[list[Reduced]] = [[] for _ in spaces]
    for weight in series.weights:
        stiffness, mass = wall_matrices(
            points, functions, edges, system.order + 1, weight, tangential=True
        )
        part = replace(system, stiffness=stiffness, mass=mass)
        for side, space in zip(found, spaces, strict=True):
            side.append(reassembled(part, space))
    return series, found


def lossy_scattering(
    system: Discretisation,
    spaces: list[Reduced],
    walls: list[list[Reduced]],
    series: LayerSeries,
    frequency: Array,
    air: Air,
    sizes: list[int],
) -> tuple[list[Complex], Complex, Array]:
    """Return S of each side, the wavenumbers of the ends' modes, and the change in a smaller space.

    Parameters
    ----------
    system : Discretisation
    spaces : list of Reduced
        Of each side.
    walls, series
        From :func:`wall_projections`.
    frequency : ndarray
        In Hz, (n,).
    air : Air
    sizes : list of int
        How many of the first fields of each side make the poorer space.

    Returns
    -------
    s : list of ndarray
        At the ports, (n, n_ports n_modes, n_ports n_modes).
    kz : ndarray
        In 1/m, (n, n_modes).
    lacking : ndarray
        Largest change of a coefficient of modes that propagate, (n,); between some frequencies.
    """
    k = 2 * np.pi * frequency / air.sound_speed - 1j * air.absorption(frequency)
    kz, flux = lossy_ends(k, system.modes, system.radius, frequency, air)
    n_ports = len(system.ports)
    flux = np.stack([block_diag(*[f] * n_ports) for f in flux])
    kz_all = np.tile(kz, (1, n_ports))
    losses = series.viscous, series.thermal
    few = np.unique(np.append(np.arange(0, len(k), CHECK_STRIDE), len(k) - 1))
    travels = np.tile(k.real[:, None] * system.radius > system.modes.zeros, (1, n_ports))
    lacking = np.zeros(len(few))
    found = []
    for space, wall, n in zip(spaces, walls, sizes, strict=True):
        s = scattering_of(lossy_impedance(space, wall, losses, k, flux), kz_all)
        poorer = lossy_impedance(
            space.first(n), [part.first(n) for part in wall],
            (losses[0][few], losses[1][few]), k[few], flux[few],
        )  # fmt: skip
        change = np.abs(scattering_of(poorer, kz_all[few]) - s[few])
        both = travels[few][:, :, None] & travels[few][:, None]
        lacking = np.maximum(lacking, np.where(both, change, 0.0).max(axis=(1, 2)))
        found.append(s)
    return found, kz, np.interp(frequency, frequency[few], lacking)
