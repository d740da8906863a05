"""Scattering with boundary layers and the air's absorption, in the span of the lossless fields."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.ndimage import maximum_filter1d

from acoustube.air import Air
from acoustube.waves.spectral.assembly import Layout
from acoustube.waves.spectral.boundary import (
    TangentialFunctions,
    WallPoints,
    tangential_functions,
    tangential_matrices,
    wall_functions,
    wall_points,
)
from acoustube.waves.spectral.discretisation import Discretisation, Layers
from acoustube.waves.spectral.elimination import product
from acoustube.waves.spectral.end_layers import lossy_ends
from acoustube.waves.spectral.first_basis import flat_elements
from acoustube.waves.spectral.layers import LayerSeries, layer_series
from acoustube.waves.spectral.polynomials import Array
from acoustube.waves.spectral.ports import Complex, scattering_of
from acoustube.waves.spectral.quadrature import axial_rule
from acoustube.waves.spectral.reduction import (
    SAMPLE_TOLERANCE,
    LossyBand,
    LossyModel,
    LossySolution,
    Reduced,
    lossy_fields,
    lossy_impedance,
    lossy_model,
)
from acoustube.waves.spectral.walls import Wall

SAMPLES_PER_RESONANCE, SPARE_SAMPLES = 1.6, 8
"""`SAMPLES_PER_RESONANCE` is the number of fields per resonance of the lumen that are computed
directly: one for each port mode at each sampled frequency. `SPARE_SAMPLES` is the number of sampled
frequencies in addition to those that this requires."""
LOSSY_BLOCKS = 3
"""Number of blocks of the Krylov space at each sampled frequency."""
CHECKS = 12
"""Largest number of frequencies at which the error of S with losses is computed; it is interpolated
to the others."""
MOVING_SAMPLES = 1e-3
"""Factor that multiplies `SAMPLE_TOLERANCE`, the singular value below which solutions are dropped,
if derivatives are required: their error is of first order in the error of the fields."""
LAYER_DEGREE = 6
"""Total degree of polynomials for whose products the number of quadrature points round the tube
suffices, in the integrals over the boundary layers."""
LAYER_BLOCKS = {False: 2, True: 3}
"""Number of Krylov blocks for boundary layers at each shift; the key True is for flat lumens."""
LAYER_PIECES = 2
"""Number of pieces of an element with a flat section, for the quadrature of the layers: walls pass
from open to sealed within a fraction of the element. In other elements kinks of the wall do not
matter, because losses are small corrections."""
SAMPLE_GRADING = 1.6
"""Exponent p: the sampled frequencies are equally spaced in f^p."""


def with_layers(system: Discretisation, wall: Wall, flat: bool) -> Discretisation:
    """Return a discretisation with the boundary layers' wall integrals for its Krylov space.

    Parameters
    ----------
    system : Discretisation
    wall : Wall
    flat : bool
        Whether the lumen counts as flat; see :class:`Basis`.
    """
    edges = system.rule.edges
    rule = axial_rule(edges, system.layout.order, _pieces(wall, edges) if flat else np.zeros(0))
    at = wall_points(wall, rule, LAYER_DEGREE)
    low = layer_functions(system, at)
    every = np.arange(len(rule.step))
    even = tangential_matrices(at, low, wall_layout(system), np.ones_like(at.area), every)
    stiffness, mass = (system.in_modes(part) for part in even)
    return replace(system, layers=Layers(at, low, stiffness, mass, LAYER_BLOCKS[flat]))


def _pieces(wall: Wall, edges: Array) -> Array:
    """Return the coordinates z in m at which elements with a flat section are divided."""
    here = flat_elements(wall, edges)
    parts = np.arange(1, LAYER_PIECES) / LAYER_PIECES
    return np.ravel(edges[:-1][here, None] + np.outer(np.diff(edges)[here], parts))


def layer_functions(system: Discretisation, points: WallPoints) -> TangentialFunctions:
    """Return the basis across the tube and its tangential derivatives at points of a wall."""
    richer = tangential_functions(points, wall_functions(points, system.functions))
    return TangentialFunctions(*(part[:, : system.layout.n] for part in richer))


def wall_layout(system: Discretisation) -> Layout:
    """Return the layout of elements with the unknowns of the basis only."""
    return Layout(system.layout.n, system.layout.n, system.layout.order - 1)


def wall_projections(
    system: Discretisation, layers: Layers, spaces: list[Reduced], frequency: Array, air: Air
) -> tuple[LayerSeries, list[list[tuple[Array, Array]]]]:
    """Return the losses at the wall as sums of products, and projections of their wall integrals.

    The projections are a list for each parity along z. It has stiffness and mass,
    (n_fields, n_fields) each, for every function of position of the losses.
    """
    series = layer_series(layers.points, frequency, air)
    found: list[list[tuple[Array, Array]]] = [[] for _ in spaces]
    fields = [system.in_polynomials(space.fields, space.corrections)[0] for space in spaces]
    layout = wall_layout(system)
    for weight in series.weights:
        where = np.unique(layers.points.rule.element[weight.any(axis=1)])
        parts = tangential_matrices(layers.points, layers.functions, layout, weight, where)
        for side, own in zip(found, fields, strict=True):
            stiffness, mass = (product(own[where], part @ own[where]) for part in parts)
            side.append((stiffness, mass))
    return series, found


class LossySide(NamedTuple):
    """Solution with losses for one parity along z.

    Attributes
    ----------
    model : LossyModel
    band : LossyBand
        With the fluxes of the modes of all ports.
    solution : LossySolution
    impedance : ndarray
        Impedance matrix in m, (n, n_ports n_modes, n_ports n_modes).
    kz : ndarray
        Axial wavenumbers of the modes of all ports in 1/m, (n, n_ports n_modes).
    """

    model: LossyModel
    band: LossyBand
    solution: LossySolution
    impedance: Complex
    kz: Complex

    @property
    def scattering(self) -> Complex:
        """S at the ports, (n, n_ports n_modes, n_ports n_modes)."""
        return scattering_of(self.impedance, self.kz)


def both_ports(part: Complex, n_ports: int) -> Complex:
    """Return block-diagonal matrices for all ports, from those for one, (n, n_modes, n_modes)."""
    return np.stack([block_diag(*[one] * n_ports) for one in part])


def lossy_scattering(
    system: Discretisation,
    spaces: list[Reduced],
    walls: list[list[tuple[Array, Array]]],
    series: LayerSeries,
    frequency: Array,
    air: Air,
    sizes: list[int],
    *,
    moving: bool = False,
) -> tuple[list[LossySide], Complex, Array]:
    """Return solutions with losses, the ends' axial wavenumbers, and an estimated error of S.

    Parameters
    ----------
    system : Discretisation
    spaces : list of Reduced
        Reduced space of each side (parity along z).
    walls, series
        From :func:`wall_projections`.
    frequency : ndarray
        In Hz, (n,).
    air : Air
    sizes : list of int
        For each side, the number of fields of its smaller space: the first ones of its space.
    moving : bool
        Whether derivatives by a motion of the wall are required.

    Returns
    -------
    sides : list of LossySide
    kz : ndarray
        Axial wavenumbers of the lossy modes of an end in 1/m, (n, n_modes).
    lacking : ndarray
        Estimated error of S, (n,), interpolated from a few frequencies: for each coefficient the
        magnitudes of its changes in the smaller spaces and in a direct solution are added; the
        error is the largest of these sums over the propagating modes.
    """
    k = 2 * np.pi * frequency / air.sound_speed - 1j * air.absorption(frequency)
    kz, flux = lossy_ends(k, system.modes, system.radius, system.rim, frequency, air)
    n_ports = len(system.ports)
    flux = both_ports(flux, n_ports)
    kz_all = np.tile(kz, (1, n_ports))
    band = LossyBand(k, series.viscous, series.thermal, flux)
    travels = np.tile(k.real[:, None] * system.radius > system.modes.zeros, (1, n_ports))
    lacking = np.zeros(len(k))
    found = []
    for space, wall, n in zip(spaces, walls, sizes, strict=True):
        model = lossy_model(space, wall)
        sampled = _sampled(model, k, system.modes.zeros / system.radius)
        fields = lossy_fields(model, band.at(sampled), LOSSY_BLOCKS)
        columns = [
            block[:, there]
            for blocks, there in zip(fields, travels[sampled], strict=True)
            for block in blocks
        ]
        # For evanescent modes the first block only: it is almost the same at all frequencies.
        columns += list(fields[:, 0])
        everything = np.concatenate(columns, axis=1)
        least = SAMPLE_TOLERANCE * (MOVING_SAMPLES if moving else 1.0)
        response, solution = lossy_impedance(model, band, everything, least)
        found.append(LossySide(model, band, solution, response, kz_all))
        s = found[-1].scattering
        # The error is estimated midway between sampled frequencies.
        between = np.unique((sampled[:-1] + sampled[1:]) // 2)
        between = between if len(between) else sampled
        few = between[np.unique(np.linspace(0, len(between) - 1, CHECKS).astype(int))]
        poorer = lossy_model(space.first(n), [(k[:n, :n], m[:n, :n]) for k, m in wall])
        checks = [_direct(part, band.at(few), kz_all[few]) for part in (model, poorer)]
        both = travels[few][:, :, None] & travels[few][:, None]
        change = np.abs(checks[1] - checks[0]) + np.abs(checks[0] - s[few])
        change = np.where(both, change, 0.0).max(axis=(1, 2))
        change = np.interp(frequency, frequency[few], maximum_filter1d(change, 3))
        lacking = np.maximum(lacking, change)
    return found, kz, lacking


def _sampled(model: LossyModel, k: Complex, cut_ons: Array) -> NDArray[np.intp]:
    """Return the indices of the frequencies at which the equations are solved directly.

    `k` and the cut-on wavenumbers are in 1/m.
    """
    resonances = np.sum(model.square < k.real[-1] ** 2)
    count = SPARE_SAMPLES + int(np.ceil(SAMPLES_PER_RESONANCE * resonances / model.ports.shape[1]))
    # Resonances are dense where many modes propagate.
    grades = np.linspace(k.real[0] ** SAMPLE_GRADING, k.real[-1] ** SAMPLE_GRADING, count)
    within = cut_ons[(cut_ons > k.real[0]) & (cut_ons < k.real[-1])]
    wanted = np.concatenate([grades ** (1 / SAMPLE_GRADING), within])
    return np.unique(np.abs(k.real - wanted[:, None]).argmin(axis=1))


def _direct(model: LossyModel, band: LossyBand, kz: Complex) -> Complex:
    """Return S at all frequencies of a band, each solved directly."""
    fields = lossy_fields(model, band)
    return scattering_of((model.ports @ band.flux).swapaxes(1, 2) @ fields[:, 0], kz)
