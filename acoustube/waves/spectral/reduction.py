"""Reduced-order model of a lumen: Galerkin projection onto a few fields, for many frequencies."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh, lu_factor, lu_solve, solve_triangular, svd

from acoustube.waves.spectral.discretisation import Discretisation
from acoustube.waves.spectral.elimination import product
from acoustube.waves.spectral.polynomials import Array
from acoustube.waves.spectral.ports import Complex

DEPENDENCE_TOLERANCE = 1e-12
"""Singular value below which a direction of new fields is dropped as linearly dependent. Beforehand
the new fields are normalised, and their parts in the span of the known fields subtracted."""

NO_MASS, NEGATIVE_MASS = 1e-12, -1e-8
"""Eigenvalues of the mass matrix, scaled to a unit diagonal, relative to the largest. Below the
first a direction has no mass except for rounding. Below the second the volume is negative, because
the sections overlap themselves."""
SAMPLE_TOLERANCE = 1e-5
"""Singular value of the sampled solutions with losses, relative to the largest, below which a
direction is dropped."""
MAX_MATRICES = 32
"""Number of frequencies whose matrices are in memory at the same time."""


class Reduced(NamedTuple):
    """Galerkin projection of a lumen's matrices onto a few fields.

    The fields of a lumen that is symmetric along z have one parity.

    Attributes
    ----------
    fields : ndarray
        Orthonormal fields of the basis, (n_elements, n_basis, n_fields).
    corrections : ndarray
        Orthonormal fields in those functions of the enriched basis that the basis lacks,
        (n_elements, size - n_basis, n_corrections).
    stiffness, mass : ndarray
        Projected matrices, (r, r), r = n_fields + n_corrections.
    ports : ndarray
        Projected loads of the ports' modes, (r, n_ports n_modes).
    """

    fields: Array
    corrections: Array
    stiffness: Array
    mass: Array
    ports: Array

    def first(self, n: int) -> Reduced:
        """Return the projection on the first n of `fields`, without corrections."""
        return self._replace(
            fields=self.fields[..., :n], corrections=self.corrections[..., :0],
            stiffness=self.stiffness[:n, :n], mass=self.mass[:n, :n], ports=self.ports[:n],
        )  # fmt: skip

    @property
    def size(self) -> int:
        """Number of fields of the reduced basis, corrections included."""
        return len(self.ports)


def extended(system: Discretisation, before: Reduced | None, fields: Array) -> Reduced:
    """Add fields (n_elements, n_basis, n_fields) to a projection without corrections."""
    n = fields.shape[1]
    nothing = np.zeros((len(fields), system.layout.size - n, 0))
    old = fields[..., :0] if before is None else before.fields
    new = _orthonormal(fields, old)
    everything = np.concatenate([old, new], axis=-1)
    found = list(system.low.projected(everything, new))
    if before is not None:
        # Only the rows and columns of the new fields are computed.
        size = old.shape[-1]
        found = [
            np.block([[known, own[:size]], [own[:size].T, own[size:]]])
            for known, own in zip((before.stiffness, before.mass), found, strict=True)
        ]
    ports = product(everything, system.load[:, :n])
    return Reduced(everything, nothing, found[0], found[1], ports)


def corrected(system: Discretisation, before: Reduced, corrections: Array) -> Reduced:
    """Add corrections (n_elements, size - n_basis, n_corrections) to a projection without any."""
    new = _orthonormal(corrections, corrections[..., :0])
    n = before.fields.shape[1]
    found = []
    for known, cross, rest in zip(
        (before.stiffness, before.mass), system.cross, system.rest, strict=True
    ):
        beside = product(new, cross @ before.fields)
        found.append(np.block([[known, beside.T], [beside, product(new, rest @ new)]]))
    ports = np.concatenate([before.ports, product(new, system.load[:, n:])])
    return Reduced(before.fields, new, found[0], found[1], ports)


def ritz(stiffness: Array, mass: Array) -> tuple[Array, Array]:
    """Return the squared wavenumbers k^2 and modes v of a projection, K v = k^2 M v.

    Parameters
    ----------
    stiffness, mass : ndarray
        K and M, (r, r).

    Returns
    -------
    square, vector : ndarray
        Squared wavenumbers in 1/m2, (m,), and modes as columns of unit mass, (r, m); m < r where
        functions are linearly dependent to rounding.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the mass of a direction is negative, because sections overlap themselves.

    Notes
    -----
    Where the walls almost touch, polynomials over the whole section are linearly dependent, up to
    rounding, in the remaining air, and M is singular. The span is then that of the eigenvectors
    of M with nonzero eigenvalues.
    """
    stiffness, mass = ((matrix + matrix.T) / 2 for matrix in (stiffness, mass))
    try:
        square, vector = eigh(stiffness, mass, check_finite=False)
    except np.linalg.LinAlgError:
        scale = 1 / np.sqrt(np.abs(np.diag(mass)))
        weight, turned = np.linalg.eigh(mass * scale * scale[:, None])
        if weight[0] < NEGATIVE_MASS * weight[-1]:
            raise
        kept = weight > NO_MASS * weight[-1]
        span = scale[:, None] * turned[:, kept] / np.sqrt(weight[kept])
        square, vector = np.linalg.eigh(span.T @ stiffness @ span)
        vector = span @ vector
    return square, vector


def projected(system: Discretisation, matrix: Array, space: Reduced) -> Array:
    """Project matrices in polynomials, (n_elements, size, size), onto a reduced space, (r, r)."""
    fields, corrections = system.in_polynomials(space.fields, space.corrections)
    everything = np.zeros((*matrix.shape[:2], space.size))
    n, count = system.layout.n_basis, fields.shape[-1]
    everything[:, :n, :count], everything[:, n:, count:] = fields, corrections
    return product(everything, matrix @ everything)


def _orthonormal(new: Array, old: Array) -> Array:
    """Return the new fields, orthonormalised among themselves and against the old fields.

    Linearly dependent fields are dropped. Fields are (n_elements, n, n_fields).
    """
    shape = new.shape[:2]
    flat = new.reshape(-1, new.shape[-1])
    known = old.reshape(len(flat), old.shape[-1])
    flat = flat / np.linalg.norm(flat, axis=0)
    flat -= known @ (known.T @ flat)
    # By singular values, not by the diagonal of the factor R of QR: a field dropped by its diagonal
    # entry would be missing from later fields.
    _, size, turned = np.linalg.svd(np.linalg.qr(flat, mode="r"))
    kept = size > DEPENDENCE_TOLERANCE
    flat = flat @ (turned[kept].T / size[kept])
    flat -= known @ (known.T @ flat)
    # The second orthonormalisation uses the Gram matrix, which is several times as fast.
    factor = np.linalg.cholesky(flat.T @ flat)
    flat = solve_triangular(factor, flat.T, lower=True, check_finite=False).T
    return np.asarray(flat.reshape(*shape, flat.shape[1]))


class LossyModel(NamedTuple):
    """Matrices of a lumen with boundary layers, in the basis of its lossless modes.

    At a wavenumber k the system matrix is diag(`square`) - k^2, minus the wall's matrices times
    their loss factors.

    Attributes
    ----------
    square : ndarray
        Squared wavenumbers of the modes in 1/m2, (r,).
    vector : ndarray
        Coefficients of the modes in the fields of the projection, (n_fields, r).
    ports : ndarray
        Projected loads of the ports' modes, (r, n_ports n_modes).
    stiffness, mass : ndarray
        Integrals over the wall, one for each function of position of the losses, (n_parts, r, r).
    """

    square: Array
    vector: Array
    ports: Array
    stiffness: Array
    mass: Array


class LossyBand(NamedTuple):
    """Frequency-dependent factors of the equations with losses.

    Attributes
    ----------
    wavenumber : ndarray
        Wavenumber of free sound in the air in 1/m, (n,).
    viscous, thermal : ndarray
        Factors in m of the wall's stiffness, and of its mass times k^2, (n, n_parts).
    flux : ndarray
        Components along the lossless modes (rows) of the flux of each lossy mode (columns),
        (n, n_ports n_modes, n_ports n_modes).
    """

    wavenumber: Complex
    viscous: Complex
    thermal: Complex
    flux: Complex

    def at(self, which: NDArray[np.intp]) -> LossyBand:
        """Return the factors at the frequencies with the indices `which`."""
        return LossyBand(*(part[which] for part in self))

    @property
    def factors(self) -> Complex:
        """Factors of K, M and the wall's matrices in the system matrix, (n, 2 + 2 n_parts).

        K and M are those of the lumen without losses, n is the number of frequencies. The wall's
        matrices are in the order of :class:`LossyModel`: all of `stiffness`, then all of `mass`.
        """
        square = self.wavenumber[:, None] ** 2
        one = np.ones_like(square)
        return np.concatenate([one, -square, -self.viscous, -square * self.thermal], axis=1)


def lossy_model(reduced: Reduced, wall: list[tuple[Array, Array]]) -> LossyModel:
    """Return the matrices of a lumen with boundary layers in the basis of its lossless modes.

    `wall` has the wall's stiffness and mass in the space of `reduced`, (r, r) each, for every
    function of position of the losses.
    """
    square, vector = ritz(reduced.stiffness, reduced.mass)
    stiffness, mass = (
        np.stack([vector.T @ part @ vector for part in parts]) for parts in zip(*wall, strict=True)
    )
    return LossyModel(square, vector, vector.T @ reduced.ports, stiffness, mass)


def lossy_fields(model: LossyModel, band: LossyBand, blocks: int = 1) -> Complex:
    """Return the fields excited by the lossy port modes, and further blocks of their Krylov spaces.

    Returns
    -------
    ndarray
        Coefficients of the r lossless modes, (n_frequencies, blocks, r, n_ports n_modes). Each
        block after the first is the response to M times the preceding block, scaled to norm one.
    """
    found = np.empty((len(band.wavenumber), blocks, *model.ports.shape), complex)
    diagonal = np.diag_indices(len(model.square))
    flat = np.concatenate([model.stiffness, model.mass]).reshape(2 * len(model.mass), -1)
    for number, (k, viscous, thermal, flux) in enumerate(zip(*band, strict=True)):
        losses = np.concatenate([viscous, k**2 * thermal])
        # As real products; otherwise the matrices would be copied as complex ones.
        real, imaginary = np.stack([losses.real, losses.imag]) @ flat
        matrix = -(real + 1j * imaginary).reshape(model.mass.shape[1:])
        matrix[diagonal] += model.square - k**2
        factors = lu_factor(matrix, check_finite=False, overwrite_a=True)
        load = model.ports @ flux
        for block in range(blocks):
            # M is the identity matrix in these coordinates.
            load = lu_solve(factors, load / np.linalg.norm(load) ** (block > 0), check_finite=False)
            found[number, block] = load
    return found


class LossySolution(NamedTuple):
    """Fields excited by the lossy port modes, by a Galerkin projection onto a span.

    Attributes
    ----------
    span : ndarray
        Basis of the span as coefficients of the lossless modes, (r, n_span).
    fields : ndarray
        Coefficients of the fields in this basis, (n_frequencies, n_span, n_ports n_modes).
    """

    span: Complex
    fields: Complex


def lossy_impedance(
    model: LossyModel, band: LossyBand, columns: Complex, tolerance: float = SAMPLE_TOLERANCE
) -> tuple[Complex, LossySolution]:
    """Return the impedance matrix between the ports' lossy modes, and the solution that gives it.

    Parameters
    ----------
    model : LossyModel
    band : LossyBand
    columns : ndarray
        Solutions at sample frequencies, (r, n_columns), which span the reduced basis of a Galerkin
        projection. They are also the test functions, because the system matrix is symmetric.
    tolerance : float
        Singular value of the columns, relative to the largest, below which a direction is dropped.

    Returns
    -------
    impedance : ndarray
        In m, (n_frequencies, n_ports n_modes, n_ports n_modes).
    solution : LossySolution
    """
    turned, size, _ = svd(columns / np.linalg.norm(columns, axis=0), full_matrices=False)
    span = turned[:, size > tolerance * size[0]]
    load = span.T @ model.ports
    one, own = span.T @ span, (span.T * model.square) @ span
    walls = np.stack([span.T @ part @ span for part in [*model.stiffness, *model.mass]])
    flat = np.concatenate([[own, one], walls]).reshape(2 + len(walls), -1)
    factors = band.factors
    found = np.empty(band.flux.shape, complex)
    fields = np.empty((len(found), *load.shape), complex)
    for start in range(0, len(found), MAX_MATRICES):
        few = slice(start, start + MAX_MATRICES)
        matrices = (factors[few] @ flat).reshape(-1, *one.shape)
        right = load @ band.flux[few]
        fields[few] = np.linalg.solve(matrices, right)
        found[few] = right.swapaxes(1, 2) @ fields[few]
    return found, LossySolution(span, fields)


def impedance(reduced: Reduced, wavenumber: Array) -> Array:
    """Return the impedance matrix Z of the ports without losses in m, (n_frequencies, n, n).

    Z = C^T (K - k^2 M)^-1 C, with the ports' loads C, stiffness K, mass M and wavenumbers k in 1/m,
    is computed with the eigenvectors of K and M.
    """
    square, vector = ritz(reduced.stiffness, reduced.mass)
    ports = vector.T @ reduced.ports
    weight = 1 / (square - wavenumber[:, None] ** 2)
    return np.asarray(np.matmul(ports.T * weight[:, None], ports))
