"""A lumen's matrices in the span of a few fields, for many frequencies at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh

from acoustube.waves.spectral.discretisation import Discretisation
from acoustube.waves.spectral.polynomials import Array

LEAST = 1e-9
"""Share of a field outside the span of the others below which it is left out."""


class Reduced(NamedTuple):
    """Galerkin projection of one side.

    Attributes
    ----------
    basis : ndarray
        Orthonormal fields by their unknowns, (n, r).
    stiffness, mass : ndarray
        (r, r).
    ports : ndarray
        (r, n_ports n_modes).
    """

    basis: Array
    stiffness: Array
    mass: Array
    ports: Array

    @property
    def size(self) -> int:
        """Number of fields."""
        return len(self.ports)


def extended(system: Discretisation, before: Reduced | None, fields: Array) -> Reduced:
    """Add fields (n_elements, n_j, n, n_fields) to a projection, or begin one."""
    n_elements, n_j, n = fields.shape[:3]
    new = _unique(fields)
    # A node held at zero, and functions not in use, have to stay out of what rounding leaves.
    used = np.abs(new).sum(axis=1, keepdims=True) > 0
    new = new / np.linalg.norm(new, axis=0)
    old = np.zeros((len(new), 0)) if before is None else before.basis
    new = _orthonormal(new, old) * used
    everywhere = _everywhere(new, fields.shape)
    blocks = []
    for matrix in (system.stiffness, system.mass):
        applied = matrix.reshape(n_elements, n_j * n, n_j * n) @ everywhere
        # What an element does to a node counts there, whichever element it is.
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
    """Return a projection with the matrices of another system, of the same functions."""
    fields = _everywhere(space.basis, system.mass.shape)
    size = fields.shape[1]
    stiffness, mass = (
        np.tensordot(fields, matrix.reshape(-1, size, size) @ fields, ((0, 1), (0, 1)))
        for matrix in (system.stiffness, system.mass)
    )
    return space._replace(stiffness=stiffness, mass=mass)


def _unique(fields: Array) -> Array:
    """Return each unknown once, (n, n_fields): of an element all but its first end."""
    first = fields[0, 0]
    return np.concatenate([first, fields[:, 1:].reshape(-1, first.shape[-1])])


def _everywhere(unknowns: Array, shape: tuple[int, ...]) -> Array:
    """Return fields by elements, (n_elements, n_j n, n_fields), from their unknowns."""
    n_elements, n_j, n = shape[:3]
    fields = np.empty((n_elements, n_j, n, unknowns.shape[-1]))
    fields[:, 1:] = unknowns[n:].reshape(n_elements, n_j - 1, n, -1)
    fields[0, 0], fields[1:, 0] = unknowns[:n], fields[:-1, 1]
    return fields.reshape(n_elements, n_j * n, -1)


def _summed(loads: Array) -> Array:
    """Return the loads of unknowns from those of elements, in the order of :func:`_unique`."""
    total = loads[:, 1:].copy()
    total[:-1, 0] += loads[1:, 0]
    return np.concatenate([loads[0, 0], total.reshape(-1, loads.shape[-1])])


def _orthonormal(new: Array, old: Array) -> Array:
    """Return what is new in fields (n, m), orthonormal among themselves and to the old ones."""
    new, triangle = np.linalg.qr(new - old @ (old.T @ new))
    # Not by the triangle's diagonal: a field left out there would miss in those after it.
    turned, size, _ = np.linalg.svd(triangle)
    new = new @ turned[:, size > LEAST * size[0]]
    return np.asarray(np.linalg.qr(new - old @ (old.T @ new))[0])


def impedance(reduced: Reduced, wavenumber: Array) -> Array:
    """Return the response Z of the ports in 1/m, (n_frequencies, n, n), at wavenumbers in 1/m.

    Notes
    -----
    Z = C^T (K - k^2 M)^-1 C by the eigenvectors of K and M.
    """
    stiffness, mass = ((matrix + matrix.T) / 2 for matrix in (reduced.stiffness, reduced.mass))
    square, vector = eigh(stiffness, mass, check_finite=False)
    ports = vector.T @ reduced.ports
    weight = 1 / (square - wavenumber[:, None] ** 2)
    return np.asarray(np.matmul(ports.T * weight[:, None], ports))
