"""Modes of the straight ends of a lumen with boundary layers: axial wavenumbers and fluxes."""

from __future__ import annotations

import numpy as np
from scipy.sparse.csgraph import connected_components

from acoustube.air import Air
from acoustube.waves.spectral.ends import Rim, Section
from acoustube.waves.spectral.layers import (
    curvature,
    filling,
    gap_widths,
    layer_thickness,
    narrow_sections,
)
from acoustube.waves.spectral.polynomials import Array, Index
from acoustube.waves.spectral.ports import Complex, PortModes

UNCOUPLED = 1e-8
"""Largest magnitude of the entries between two modes, in the dimensionless matrices of the lossy
eigenproblem, at which these modes count as uncoupled, by symmetry."""


def lossy_ends(
    k: Complex, modes: PortModes, radius: float, rim: Rim, frequency: Array, air: Air
) -> tuple[Complex, Complex]:
    """Return the axial wavenumbers of the ends' modes with boundary layers, and their fluxes.

    Parameters
    ----------
    k : ndarray
        Wavenumbers of free sound in the air in 1/m, complex with absorption, (n,).
    modes : PortModes
        Modes of the ends without losses.
    radius : float
        The wall's `radius` in m.
    rim : Rim
        Products of the modes along the contour.
    frequency : ndarray
        In Hz, (n,).
    air : Air

    Returns
    -------
    kz : ndarray
        In 1/m, (n, n_modes).
    flux : ndarray
        Components along the lossless modes (rows) of the flux of each lossy mode (columns),
        (n, n_modes, n_modes).

    Notes
    -----
    D_v, D_t and f are the layers' thicknesses and factor of :mod:`acoustube.waves.spectral.layers`.
    f G is the contour integral of f psi_a psi_b for lossless modes psi, f G' that for their
    derivatives along the contour, kt their cut-on wavenumber, and N = 1 - D_v f G. A lossy mode
    with coefficients v in the lossless modes solves
    kz^2 N v = (k^2 (1 + (gamma - 1) D_t f G) - kt^2 + D_v f G') v. The flux is N v, normalised to
    v^T N v = 1.
    """
    layers = layer_thickness(frequency, air)
    width, roundness = np.array([2 * radius]), np.ones(1)
    if rim.section is not None:
        width, roundness = _section_widths(rim.section, float(np.abs(layers[0][0])))
    viscous, thermal = (d[:, None] * filling(width, roundness, d[:, None]) for d in layers)
    one = np.eye(len(modes))
    inertia = one - np.tensordot(viscous, rim.product, 1)
    thermal = (air.heat_capacity_ratio - 1) * np.tensordot(thermal, rim.product, 1)
    right = k[:, None, None] ** 2 * (one + thermal)
    right = right - np.diag((modes.zeros / radius) ** 2)
    right = right + np.tensordot(viscous, rim.slope, 1)
    square = np.zeros((len(k), len(modes)), complex)
    vector = np.zeros_like(inertia)
    number = _independent(inertia, right * radius**2)
    for group in range(number.max(initial=-1) + 1):
        # Modes of equal cut-on that do not couple, as 11c and 11s, would else mix arbitrarily.
        own = np.flatnonzero(number == group)
        block = np.ix_(np.arange(len(k)), own, own)
        square[:, own], vector[block] = _eigenmodes(inertia[block], right[block])
    norm = np.sqrt(np.einsum("fam,fab,fbm->fm", vector, inertia, vector))
    vector = vector / norm[:, None]
    vector = vector * np.where(np.einsum("fmm->fm", vector).real < 0, -1, 1)[:, None]
    root = np.sqrt(square)
    return np.where(root.imag > 0, -root, root), inertia @ vector


def _independent(inertia: Complex, right: Complex) -> Index:
    """Return the number of the group of each mode, (n_modes,); modes of two groups do not couple.

    `inertia` and `right` are the dimensionless matrices of the eigenproblem, (n, n_modes, n_modes).
    """
    coupled = np.maximum(np.abs(inertia), np.abs(right)).max(axis=0, initial=0.0) > UNCOUPLED
    return np.asarray(connected_components(coupled, directed=False)[1], int)


def _eigenmodes(inertia: Complex, right: Complex) -> tuple[Complex, Complex]:
    """Return the eigenvalues s (n, m) and eigenvectors v (n, m, m) of right v = s inertia v.

    They are in the order of the lossless modes that are the largest components of v.
    """
    square, vector = np.linalg.eig(np.linalg.solve(inertia, right))
    back = np.argsort(np.argmax(np.abs(vector), axis=1), axis=1)
    return np.take_along_axis(square, back, 1), np.take_along_axis(vector, back[:, None], 2)


def _section_widths(section: Section, thickness: float) -> tuple[Array, Array]:
    """Return gap widths in m and weights b (see `layers`) along an end's contour, (n_points,)."""
    contours, halved = section.contours, section.basis.odd is not None
    measured = narrow_sections(contours, section.boxes, halved, thickness)
    width = gap_widths(contours, section.extent, halved, measured)
    return width[0], np.clip(curvature(contours) * width / 2, 0.0, 1.0)[0]
