"""Direct solution of K - s M along the tube: static condensation, then block elimination."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acoustube.waves.spectral.polynomials import Array


class Factors(NamedTuple):
    """Factors of static condensation of the elements, then of block elimination of their nodes.

    Attributes
    ----------
    matrix : ndarray
        Of the elements, (n_elements, n_j n, n_j n).
    inside : ndarray
        Inverses of the elements' inner blocks, (n_elements, n_inner, n_inner).
    follow : ndarray
        Negative response of the interior unknowns to those of the two ends,
        (n_elements, n_inner, 2 n).
    nodes : ndarray
        Inverses of the nodes' blocks, (n_elements + 1, n, n).
    onwards : ndarray
        Negative response of each node but the first to the one before it, (n_elements, n, n).
    """

    matrix: Array
    inside: Array
    follow: Array
    nodes: Array
    onwards: Array


def factor(matrix: Array, n: int) -> Factors:
    """Factor the matrix of a chain of elements.

    Parameters
    ----------
    matrix : ndarray
        K - s M, (n_elements, n_j n, n_j n); the first two groups of n unknowns are the ends'.
    n : int
        Number of functions across the tube.

    Notes
    -----
    By explicit inverses, which makes all that follows products of stacks of matrices. The first
    node is the last to be eliminated, so that it can be held or free with the same factors.
    """
    border = 2 * n
    coupling = matrix[:, border:, :border]
    inside = np.linalg.inv(matrix[:, border:, border:])
    follow = inside @ coupling
    ends = matrix[:, :border, :border] - coupling.swapaxes(1, 2) @ follow
    nodes = np.zeros((len(ends) + 1, n, n))
    nodes[:-1] += ends[:, :n, :n]
    nodes[1:] += ends[:, n:, n:]
    onwards = np.empty((len(ends), n, n))
    nodes[-1] = np.linalg.inv(nodes[-1])
    for number in range(len(ends) - 1, -1, -1):
        coupled = ends[number, :n, n:]
        onwards[number] = nodes[number + 1] @ coupled.T
        nodes[number] = np.linalg.inv(nodes[number] - coupled @ onwards[number])
    return Factors(matrix, np.asarray(inside), np.asarray(follow), nodes, onwards)


def solve(factors: Factors, load: Array, held: NDArray[np.bool_]) -> Array:
    """Solve the factored system for load vectors.

    Parameters
    ----------
    factors : Factors
    load : ndarray
        Of each element, (n_elements, n_j n, n_loads); a node's loads are summed.
    held : ndarray of bool
        For which loads the pressure at the first node is prescribed as zero, (n_loads,).

    Returns
    -------
    ndarray
        Of the loads' shape; the value at a node is repeated in both of its elements.

    Notes
    -----
    With one step of iterative refinement, without which inverses leave rough errors in the fields.
    """
    found = _solve_once(factors, load, held)
    return found + _solve_once(factors, load - factors.matrix @ found, held)


def _solve_once(factors: Factors, load: Array, held: NDArray[np.bool_]) -> Array:
    n_elements, n = len(load), factors.nodes.shape[-1]
    inner = load[:, 2 * n :]
    border = load[:, : 2 * n] - factors.follow.swapaxes(1, 2) @ inner
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
    return np.concatenate([both, factors.inside @ inner - factors.follow @ both], axis=1)
