"""Direct solution of (K - s M) x = f along the tube: condensation of elements, then elimination.

K is the stiffness, M the mass, s a squared wavenumber, x the field and f the load. The inner
unknowns of an element belong to functions that vanish at both of its ends. They are the
coefficients of the element's modes with zero pressure at the ends, for which K and M are diagonal.
For each s only diagonal matrices have therefore to be inverted in an element [1]_.

References
----------
.. [1] Craig, R. R., Bampton, M. C. C. (1968). Coupling of substructures for dynamic analyses. AIAA
   Journal 6, 1313-1319. doi:10.2514/3.4741
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

from acoustube.waves.spectral.polynomials import Array

DEPENDENCE = 1e-12
"""Eigenvalue of the mass matrix, scaled to a unit diagonal, relative to the largest, below which
functions count as linearly dependent."""

SURPLUS = 1e30
"""Squared wavenumber in 1/m2 assigned to the zero vectors that replace modes of an element if its
functions are linearly dependent."""


class Chain(NamedTuple):
    """Matrices of a chain of elements, whose interior unknowns are amplitudes of their eigenmodes.

    The eigenmodes of an element vanish at its ends and have unit mass (Craig and Bampton). There
    are n unknowns at each end. The unknowns of an element are in the order of its low end, its high
    end and its inner modes.

    Attributes
    ----------
    square : ndarray
        Squared wavenumbers of the elements' modes in 1/m2, (n_elements, n_inner).
    stiffness, mass : ndarray
        Matrices of the unknowns at the ends of the elements, (n_elements, 2 n, 2 n).
    pull, drag : ndarray
        Stiffness and mass that couple modes and ends, (n_elements, n_inner, 2 n).
    """

    square: Array
    stiffness: Array
    mass: Array
    pull: Array
    drag: Array

    def times_mass(self, field: Array) -> Array:
        """Return the products of M with fields (n_elements, 2 n + n_inner, n_fields)."""
        border = self.mass.shape[-1]
        ends, inner = field[:, :border], field[:, border:]
        return np.concatenate(
            [self.mass @ ends + self.drag.swapaxes(1, 2) @ inner, self.drag @ ends + inner], axis=1
        )

    def projected(self, left: Array, right: Array) -> tuple[Array, Array]:
        """Return left^T K right and left^T M right, (n_left, n_right), summed over the elements.

        `left` and `right` are fields, (n_elements, 2 n + n_inner, n_left or n_right).
        """
        border = self.mass.shape[-1]
        a, b = left[:, border:], right[:, border:]
        a_ends, b_ends = left[:, :border], right[:, :border]
        found = []
        for own, cross, inner in (
            (self.stiffness, self.pull, self.square[..., None] * b),
            (self.mass, self.drag, b),
        ):
            ends = own @ b_ends + cross.swapaxes(1, 2) @ b
            found.append(product(a_ends, ends) + product(a, inner + cross @ b_ends))
        return found[0], found[1]


class Factors(NamedTuple):
    """Block factors of K - s M, with stiffness K, mass M and squared wavenumber s.

    The modes inside the elements are eliminated first (static condensation), then the nodes between
    elements, the last one first.

    Attributes
    ----------
    chain : Chain
    inside : ndarray
        Inverses of the diagonal entries of the inner modes, (n_elements, n_inner, 1).
    coupling : ndarray
        Entries of K - s M between modes and ends, (n_elements, n_inner, 2 n).
    nodes : ndarray
        Inverses of the nodes' blocks after elimination of all later nodes, (n_elements + 1, n, n).
    onwards : ndarray
        Matrices that give minus the value at node i + 1 from that at node i, if there are no loads
        beyond node i, (n_elements, n, n).
    """

    chain: Chain
    inside: Array
    coupling: Array
    nodes: Array
    onwards: Array


def product(a: Array, b: Array) -> Array:
    """Return the inner products (n_a, n_b) of fields a, (n_elements, n, n_a), with fields b."""
    flat = a.shape[0] * a.shape[1]
    return np.asarray(a.reshape(flat, a.shape[-1]).T @ b.reshape(flat, b.shape[-1]))


def inner_modes(stiffness: Array, mass: Array) -> tuple[Array, Array]:
    """Return the eigenmodes of the inner unknowns of each element, K v = k^2 M v.

    Parameters
    ----------
    stiffness, mass : ndarray
        K and M, (n_elements, n, n).

    Returns
    -------
    square, modes : ndarray
        Squared wavenumbers k^2 in 1/m2, (n_elements, n), and modes as columns, normalised to
        v^T M v = 1, (n_elements, n, n). If functions are linearly dependent, the surplus modes are
        zero and their `square` is `SURPLUS`.
    """
    scale = 1 / np.sqrt(np.einsum("eii->ei", mass))
    stiffness, mass = (part * scale[:, None] * scale[:, :, None] for part in (stiffness, mass))
    square, modes = np.empty_like(scale), np.empty_like(mass)
    for number, (k, m) in enumerate(zip(stiffness, mass, strict=True)):
        square[number], modes[number] = _modes(k, m)
    return square, modes * scale[:, :, None]


def _modes(stiffness: Array, mass: Array) -> tuple[Array, Array]:
    """Return squared wavenumbers and modes of one element, for a mass matrix of unit diagonal."""
    try:
        root = np.linalg.cholesky(mass)
        healthy = np.diag(root).min() ** 2 > DEPENDENCE
    except np.linalg.LinAlgError:
        healthy = False
    if healthy:
        half = solve_triangular(root, stiffness, lower=True, check_finite=False)
        whole = solve_triangular(root, half.T, lower=True, check_finite=False)
        square, modes = np.linalg.eigh(whole)
        return square, solve_triangular(root, modes, trans=1, lower=True, check_finite=False)
    weight, turned = np.linalg.eigh(mass)
    kept = weight > DEPENDENCE * weight[-1]
    turned = turned[:, kept] / np.sqrt(weight[kept])
    own, modes = np.linalg.eigh(turned.T @ stiffness @ turned)
    square = np.full(len(mass), SURPLUS)
    square[: len(own)] = own
    found = np.zeros_like(mass)
    found[:, : len(own)] = turned @ modes
    return square, found


def factor(chain: Chain, shift: float) -> Factors:
    """Return the block factors of K - s M at a squared wavenumber s, `shift`, in 1/m2.

    Notes
    -----
    With explicit inverses, all further operations are products of stacks of matrices. The first
    node is eliminated last, so that its pressure may be zero or free with the same factors.
    """
    n = chain.mass.shape[-1] // 2
    coupling = chain.pull - shift * chain.drag
    inside = 1 / (chain.square - shift)[..., None]
    ends = chain.stiffness - shift * chain.mass - coupling.swapaxes(1, 2) @ (inside * coupling)
    nodes = np.zeros((len(ends) + 1, n, n))
    nodes[:-1] += ends[:, :n, :n]
    nodes[1:] += ends[:, n:, n:]
    onwards = np.empty((len(ends), n, n))
    nodes[-1] = np.linalg.inv(nodes[-1])
    for number in range(len(ends) - 1, -1, -1):
        coupled = ends[number, :n, n:]
        onwards[number] = nodes[number + 1] @ coupled.T
        nodes[number] = np.linalg.inv(nodes[number] - coupled @ onwards[number])
    return Factors(chain, inside, coupling, nodes, onwards)


def solve(factors: Factors, load: Array, held: NDArray[np.bool_]) -> Array:
    """Solve the factored system for load vectors.

    Parameters
    ----------
    factors : Factors
    load : ndarray
        Load vectors of each element, (n_elements, 2 n + n_inner, n_loads); the loads of both
        elements at a node are summed.
    held : ndarray of bool
        True for loads for which the pressure at the first node is prescribed as zero, (n_loads,).

    Returns
    -------
    ndarray
        Fields, of the shape of `load`; the value at a node is repeated in both of its elements.
    """
    n_elements, n = len(load), factors.nodes.shape[-1]
    inner = factors.inside * load[:, 2 * n :]
    border = load[:, : 2 * n] - factors.coupling.swapaxes(1, 2) @ inner
    nodal = np.zeros((n_elements + 1, n, load.shape[-1]))
    nodal[:-1] += border[:, :n]
    nodal[1:] += border[:, n:]
    for number in range(n_elements - 1, -1, -1):
        nodal[number] -= factors.onwards[number].T @ nodal[number + 1]
    nodal = factors.nodes @ nodal
    nodal[0][:, held] = 0.0
    for number in range(n_elements):
        nodal[number + 1] -= factors.onwards[number] @ nodal[number]
    both = np.concatenate([nodal[:-1], nodal[1:]], axis=1)
    return np.concatenate([both, inner - factors.inside * (factors.coupling @ both)], axis=1)
