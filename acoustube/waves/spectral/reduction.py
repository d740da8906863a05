"""Reduced-order model of a lumen: Galerkin projection onto a few fields, for many frequencies."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh, solve

from acoustube.waves.spectral.discretisation import Discretisation
from acoustube.waves.spectral.polynomials import Array
from acoustube.waves.spectral.ports import Complex

DEPENDENCE_TOLERANCE = 1e-9
"""Relative norm of a field's component outside the span below which it is dropped."""


class Reduced(NamedTuple):
    """Galerkin projection for one parity along z.

    Attributes
    ----------
    basis : ndarray
        Coefficients of the orthonormal fields, (n, r).
    stiffness, mass : ndarray
        (r, r).
    ports : ndarray
        (r, n_ports n_modes).
    """

    basis: Array
    stiffness: Array
    mass: Array
    ports: Array

    def first(self, n: int) -> Reduced:
        """Return the projection on the first n fields."""
        return Reduced(self.basis[:, :n], self.stiffness[:n, :n], self.mass[:n, :n], self.ports[:n])

    @property
    def size(self) -> int:
        """Number of fields of the reduced basis."""
        return len(self.ports)


def extended(system: Discretisation, before: Reduced | None, fields: Array) -> Reduced:
    """Add fields (n_elements, n_j, n, n_fields) to a projection, or create one."""
    n_elements, n_j, n = fields.shape[:3]
    new = _unique(fields)
    # Prescribed nodes and unused functions stay exactly zero, despite rounding.
    used = np.abs(new).sum(axis=1, keepdims=True) > 0
    new = new / np.linalg.norm(new, axis=0)
    old = np.zeros((len(new), 0)) if before is None else before.basis
    new = _orthonormal(new, old) * used
    everywhere = _everywhere(new, fields.shape)
    blocks = []
    for matrix in (system.stiffness, system.mass):
        applied = matrix.reshape(n_elements, n_j * n, n_j * n) @ everywhere
        # Assembly: contributions of both neighbouring elements to a node are summed.
        summed = _summed(applied.reshape(*fields.shape[:3], -1))
        blocks.append((old.T @ summed, new.T @ summed))
    ports = new.T @ _summed(system.load)
    if before is None:
        return Reduced(new, blocks[0][1], blocks[1][1], ports)
    stiffness, mass = (
        np.block([[matrix, cross], [cross.T, own]])
        for matrix, (cross, own) in zip((before.stiffness, before.mass), blocks, strict=True)
    )
    return Reduced(
        np.concatenate([before.basis, new], axis=-1), stiffness, mass,
        np.concatenate([before.ports, ports]),
    )  # fmt: skip


def reassembled(system: Discretisation, space: Reduced) -> Reduced:
    """Return the projection of another discretisation onto the same fields."""
    fields = _everywhere(space.basis, system.mass.shape)
    size = fields.shape[1]
    stiffness, mass = (
        np.tensordot(fields, matrix.reshape(-1, size, size) @ fields, ((0, 1), (0, 1)))
        for matrix in (system.stiffness, system.mass)
    )
    return space._replace(stiffness=stiffness, mass=mass)


def _unique(fields: Array) -> Array:
    """Return fields as global unknowns, (n, n_fields): of an element all but its first end."""
    first = fields[0, 0]
    return np.concatenate([first, fields[:, 1:].reshape(-1, first.shape[-1])])


def _everywhere(unknowns: Array, shape: tuple[int, ...]) -> Array:
    """Return fields per element, (n_elements, n_j n, n_fields), from their global unknowns."""
    n_elements, n_j, n = shape[:3]
    fields = np.empty((n_elements, n_j, n, unknowns.shape[-1]))
    fields[:, 1:] = unknowns[n:].reshape(n_elements, n_j - 1, n, -1)
    fields[0, 0], fields[1:, 0] = unknowns[:n], fields[:-1, 1]
    return fields.reshape(n_elements, n_j * n, -1)


def _summed(loads: Array) -> Array:
    """Assemble element loads into loads of the global unknowns, in the order of :func:`_unique`."""
    total = loads[:, 1:].copy()
    total[:-1, 0] += loads[1:, 0]
    return np.concatenate([loads[0, 0], total.reshape(-1, loads.shape[-1])])


def _orthonormal(new: Array, old: Array) -> Array:
    """Orthonormalise fields (n, m) against the old ones, and drop linearly dependent ones."""
    new, triangle = np.linalg.qr(new - old @ (old.T @ new))
    # Not by the diagonal of R: a field dropped there would be missing from later ones.
    turned, size, _ = np.linalg.svd(triangle)
    new = new @ turned[:, size > DEPENDENCE_TOLERANCE * size[0]]
    return np.asarray(np.linalg.qr(new - old @ (old.T @ new))[0])


def lossy_impedance(
    reduced: Reduced,
    wall: list[Reduced],
    losses: tuple[Complex, Complex],
    wavenumber: Complex,
    flux: Complex,
) -> Complex:
    """Return the response of the ports' lossy modes in 1/m, (n_frequencies, n, n).

    Parameters
    ----------
    reduced : Reduced
    wall : list of Reduced
        Integrals over the wall in the same fields, one for each function of the place.
    losses : tuple of ndarray
        Factors of their stiffness and of their mass in m, (n_frequencies, n_parts).
    wavenumber : ndarray
        Of free sound in the air in 1/m, (n_frequencies,).
    flux : ndarray
        What the flux of each lossy mode has of the lossless ones, (n_frequencies, n, n).
    """
    square, vector = eigh(
        *((part + part.T) / 2 for part in (reduced.stiffness, reduced.mass)), check_finite=False
    )
    ports = vector.T @ reduced.ports
    stiffness, mass = (
        np.stack([vector.T @ part @ vector for part in parts])
        for parts in ([q.stiffness for q in wall], [q.mass for q in wall])
    )
    found = np.empty(flux.shape, complex)
    diagonal = np.diag_indices(len(square))
    for number, k in enumerate(wavenumber):
        viscous, thermal = losses[0][number], k**2 * losses[1][number]
        matrix = -np.tensordot(viscous, stiffness, 1) - np.tensordot(thermal, mass, 1)
        matrix[diagonal] += square - k**2
        load = ports @ flux[number]
        found[number] = load.T @ solve(matrix, load, check_finite=False, overwrite_a=True)
    return found


def impedance(reduced: Reduced, wavenumber: Array) -> Array:
    """Return the impedance matrix Z of the ports in 1/m, (n_frequencies, n, n).

    Notes
    -----
    Z = C^T (K - k^2 M)^-1 C by the eigenvectors of K and M.
    """
    stiffness, mass = ((matrix + matrix.T) / 2 for matrix in (reduced.stiffness, reduced.mass))
    square, vector = eigh(stiffness, mass, check_finite=False)
    ports = vector.T @ reduced.ports
    weight = 1 / (square - wavenumber[:, None] ** 2)
    return np.asarray(np.matmul(ports.T * weight[:, None], ports))
