"""Direct solution of K - s M along the tube: static condensation, then block elimination."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import lu_factor, lu_solve

from acoustube.waves.spectral.polynomials import Array

Factors = tuple[Any, Any]


@dataclass(frozen=True, eq=False)
class Condensed:
    """Elements after static condensation of their interior unknowns.

    Attributes
    ----------
    inside : list of tuple
        Factors of each element's inner block.
    follow : ndarray
        Negative response of the interior unknowns to those of the two ends,
        (n_elements, n_inner, 2 n).
    ends : ndarray
        Condensed matrix (Schur complement) of both ends of each element, (n_elements, 2 n, 2 n).
    """

    inside: list[Factors]
    follow: Array
    ends: Array


@dataclass(frozen=True, eq=False)
class Chain:
    """Factors of the nodes along the tube in the order of z.

    Attributes
    ----------
    nodes : list of tuple
    onwards : list of ndarray
        Negative response of each node to the next, (n, n).
    couplings : ndarray
        Coupling matrix of each node to the next, (n_elements, n, n).
    held : bool
        True if the pressure at the first node is prescribed as zero.
    """

    nodes: list[Factors]
    onwards: list[Array]
    couplings: Array
    held: bool


def condense(matrix: Array) -> Condensed:
    """Eliminate the interior unknowns of each element (static condensation).

    Parameters
    ----------
    matrix : ndarray
        K - s M, (n_elements, n_j, n, n_j, n); the functions j = 0 and 1 are the ends'.
    """
    n_elements, n_j, n = matrix.shape[:3]
    flat = matrix.reshape(n_elements, n_j * n, n_j * n)
    border = 2 * n
    coupling = flat[:, border:, :border]
    inside = [lu_factor(block, check_finite=False) for block in flat[:, border:, border:]]
    follow = np.stack(
        [lu_solve(f, c, check_finite=False) for f, c in zip(inside, coupling, strict=True)]
    )
    ends = flat[:, :border, :border] - coupling.swapaxes(1, 2) @ follow
    return Condensed(inside, follow, ends)


def eliminate(condensed: Condensed, *, held: bool) -> Chain:
    """Factor the nodal system, with the pressure at the first node prescribed as zero or free."""
    ends = condensed.ends
    n_elements, n = len(ends), ends.shape[1] // 2
    couplings = ends[:, :n, n:].copy()
    diagonal = np.zeros((n_elements + 1, n, n))
    diagonal[:-1] += ends[:, :n, :n]
    diagonal[1:] += ends[:, n:, n:]
    if held:
        diagonal[0], couplings[0] = np.eye(n), 0.0
    nodes: list[Factors] = []
    onwards: list[Array] = []
    for number, block in enumerate(diagonal):
        if number:
            block = block - couplings[number - 1].T @ onwards[-1]
        nodes.append(lu_factor(block, check_finite=False))
        if number < n_elements:
            onwards.append(lu_solve(nodes[-1], couplings[number], check_finite=False))
    return Chain(nodes, onwards, couplings, held)


def solve(condensed: Condensed, chain: Chain, load: Array) -> Array:
    """Solve the factored system for load vectors.

    Parameters
    ----------
    condensed : Condensed
    chain : Chain
    load : ndarray
        Of each element, (n_elements, n_j, n, n_loads); a node's loads are summed.

    Returns
    -------
    ndarray
        Of that shape; the value at a node is repeated in both of its elements.
    """
    n_elements, n_j, n, n_loads = load.shape
    inner = load[:, 2:].reshape(n_elements, (n_j - 2) * n, n_loads)
    border = load[:, :2].reshape(n_elements, 2 * n, n_loads)
    border = border - condensed.follow.swapaxes(1, 2) @ inner
    nodal = np.zeros((n_elements + 1, n, n_loads))
    nodal[:-1] += border[:, :n]
    nodal[1:] += border[:, n:]
    if chain.held:
        nodal[0] = 0.0
    for number, factors in enumerate(chain.nodes):
        if number:
            nodal[number] -= chain.couplings[number - 1].T @ nodal[number - 1]
        nodal[number] = lu_solve(factors, nodal[number], check_finite=False)
    for number in range(n_elements - 1, -1, -1):
        nodal[number] -= chain.onwards[number] @ nodal[number + 1]
    if chain.held:
        nodal[0] = 0.0
    both = np.concatenate([nodal[:-1], nodal[1:]], axis=1)
    found = np.empty_like(load)
    found[:, :2] = both.reshape(n_elements, 2, n, n_loads)
    inner = np.stack(
        [lu_solve(f, g, check_finite=False) for f, g in zip(condensed.inside, inner, strict=True)]
    )
    found[:, 2:] = (inner - condensed.follow @ both).reshape(n_elements, n_j - 2, n, n_loads)
    return found
