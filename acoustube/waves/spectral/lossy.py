"""Scattering with boundary layers and the air's absorption, in the span of the lossless fields."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.ndimage import maximum_filter1d

from acoustube.waves.spectral.boundary import wall_functions, wall_matrices, wall_points
from acoustube.waves.spectral.discretisation import DEGREE_INCREASE, Discretisation
from acoustube.waves.spectral.layers import LayerSeries, layer_series, lossy_ends
from acoustube.waves.spectral.polynomials import Array, polynomials
from acoustube.waves.spectral.ports import Complex, scattering_of
from acoustube.waves.spectral.reduction import (
    LossyBand,
    LossyModel,
    Reduced,
    lossy_fields,
    lossy_impedance,
    lossy_model,
    reassembled,
)
from acoustube.waves.spectral.sound import Air
from acoustube.waves.spectral.walls import Wall

SAMPLES_PER_RESONANCE, SPARE_SAMPLES = 4.0, 12
"""Fields from directly solved frequencies per resonance of the lumen, and further frequencies."""
SAMPLE_GRADING = 1.6
"""They are even in this power of the frequency."""


def with_layers(
    system: Discretisation, wall: Wall, edges: Array, degree: int, odd: bool | None, n_points: int
) -> Discretisation:
    """Return a discretisation with the boundary layers' wall integrals for its Krylov space."""
    points = wall_points(wall, edges, n_points)
    functions = wall_functions(points, polynomials(degree + DEGREE_INCREASE, odd))
    one = np.ones_like(points.area)
    layers = wall_matrices(points, functions, edges, system.layout, one, tangential=True)
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
            points, functions, edges, system.layout, weight, tangential=True
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
    kz, flux = lossy_ends(k, system.modes, system.radius, system.rim, frequency, air)
    n_ports = len(system.ports)
    flux = np.stack([block_diag(*[f] * n_ports) for f in flux])
    kz_all = np.tile(kz, (1, n_ports))
    band = LossyBand(k, series.viscous, series.thermal, flux)
    travels = np.tile(k.real[:, None] * system.radius > system.modes.zeros, (1, n_ports))
    lacking = np.zeros(len(k))
    found = []
    for space, wall, n in zip(spaces, walls, sizes, strict=True):
        model = lossy_model(space, wall)
        sampled = _sampled(model, k)
        s = scattering_of(
            lossy_impedance(model, band, lossy_fields(model, band.at(sampled))), kz_all
        )
        # Where the fields sampled are farthest away.
        few = np.unique((sampled[:-1] + sampled[1:])[1::2] // 2)
        few = few if len(few) else sampled
        poorer = lossy_model(space.first(n), [part.first(n) for part in wall])
        checks = [_direct(part, band.at(few), kz_all[few]) for part in (model, poorer)]
        both = travels[few][:, :, None] & travels[few][:, None]
        change = np.abs(checks[1] - checks[0]) + np.abs(checks[0] - s[few])
        change = np.where(both, change, 0.0).max(axis=(1, 2))
        between = np.interp(frequency, frequency[few], maximum_filter1d(change, 3))
        lacking = np.maximum(lacking, between)
        found.append(s)
    return found, kz, lacking


def _sampled(model: LossyModel, k: Complex) -> NDArray[np.intp]:
    """Return the numbers of the frequencies at which the equations are solved directly."""
    resonances = np.sum(model.square < k.real[-1] ** 2)
    count = SPARE_SAMPLES + int(np.ceil(SAMPLES_PER_RESONANCE * resonances / model.ports.shape[1]))
    # Resonances are dense where many modes propagate.
    grades = np.linspace(k.real[0] ** SAMPLE_GRADING, k.real[-1] ** SAMPLE_GRADING, count)
    return np.unique(np.abs(k.real - grades[:, None] ** (1 / SAMPLE_GRADING)).argmin(axis=1))


def _direct(model: LossyModel, band: LossyBand, kz: Complex) -> Complex:
    """Return S of directly solved frequencies."""
    fields = lossy_fields(model, band)
    return scattering_of((model.ports @ band.flux).swapaxes(1, 2) @ fields, kz)
