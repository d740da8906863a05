"""Reference elements: shape functions, quadrature rules and projection modes.

The elements are the 20-node serendipity brick and the 10-node tetrahedron, with their faces [1]_.
Each is given by its nodes and by the monomials that span its shape functions. The coefficients of
the monomials are the inverse of the matrix of monomials at the nodes (Vandermonde matrix).

References
----------
.. [1] O. C. Zienkiewicz, R. L. Taylor, J. Z. Zhu, "The Finite Element Method: Its Basis and
   Fundamentals", 6th ed., Elsevier (2005).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from acoustube.base.types import Array

Powers = NDArray[np.int64]


def monomials(points: Array, powers: Powers) -> tuple[Array, Array]:
    """Return monomials and their derivatives.

    Parameters
    ----------
    points : array of shape (n_points, d)
    powers : array of int, shape (n, d)
        Exponent of every coordinate in each monomial.

    Returns
    -------
    values : array of shape (n_points, n)
    slopes : array of shape (n_points, n, d)
        Derivatives with respect to the coordinates.
    """
    lowered = np.maximum(powers[:, None] - np.eye(points.shape[1], dtype=int), 0)
    values = np.prod(points[:, None] ** powers, axis=-1)
    slopes = powers * np.prod(points[:, None, None] ** lowered, axis=-1)
    return values, slopes


@dataclass(frozen=True, eq=False)
class Reference:
    """A reference element or face: shape functions, quadrature rule and projection modes.

    Parameters
    ----------
    nodes : array of shape (n_nodes, d)
        Local coordinates of the nodes.
    powers : array of int, shape (n_nodes, d)
        Exponents of the monomials that span the shape functions.
    points, weights : arrays of shape (n_points, d) and (n_points,)
        Quadrature rule.
    modes : array of int, shape (n_modes, d)
        Exponents of the monomials onto which the volume ratio is projected; empty for a face.
    stabilisation : float
        Stabilisation modulus on the unprojected part of the volume ratio, in shear moduli.
    """

    nodes: Array
    powers: Powers
    points: Array
    weights: Array
    modes: Powers
    stabilisation: float = 0.0

    def shape_functions(self, points: Array) -> tuple[Array, Array]:
        """Return the shape functions and their derivatives at local points.

        Parameters
        ----------
        points : array of shape (n_points, d)

        Returns
        -------
        values : array of shape (n_points, n_nodes)
        slopes : array of shape (n_points, n_nodes, d)
        """
        to_nodes = np.linalg.inv(monomials(self.nodes, self.powers)[0])
        values, slopes = monomials(points, self.powers)
        return values @ to_nodes, np.einsum("qmj,mn->qnj", slopes, to_nodes)

    @cached_property
    def shapes(self) -> Array:
        """Shape functions at the quadrature points, shape (n_points, n_nodes)."""
        return self.shape_functions(self.points)[0]

    @cached_property
    def slopes(self) -> Array:
        """Derivatives of the shape functions at the quadrature points, (n_points, n_nodes, d)."""
        return self.shape_functions(self.points)[1]

    @cached_property
    def projection(self) -> Array:
        """Projection modes at the quadrature points, shape (n_points, n_modes)."""
        return monomials(self.points, self.modes)[0]


def lattice(highest: int, d: int) -> Powers:
    """Return the points of the grid {0, ..., highest}^d, the first coordinate fastest.

    Parameters
    ----------
    highest, d : int
        Largest coordinate, and number of dimensions.

    Returns
    -------
    array of int, shape ((highest + 1)**d, d)
    """
    return np.array(list(product(range(highest + 1), repeat=d)))[:, ::-1]


def gauss(n: int, d: int) -> tuple[Array, Array]:
    """Return the Gauss-Legendre rule on [-1, 1]^d.

    Parameters
    ----------
    n, d : int
        Points in each direction, and number of dimensions.

    Returns
    -------
    points : array of shape (n**d, d)
    weights : array of shape (n**d,)
    """
    x, w = np.polynomial.legendre.leggauss(n)
    index = lattice(n - 1, d)
    return x[index], np.prod(w[index], axis=1)


def collapsed_gauss(n: int) -> tuple[Array, Array]:
    """Return a quadrature rule on the triangle (0,0), (1,0), (0,1), exact to degree 2 n - 2.

    The Gauss-Legendre rule on the square with one side collapsed to a corner (Duffy [1]_).

    Parameters
    ----------
    n : int
        Points in each direction of the square.

    Returns
    -------
    points : array of shape (n**2, 2)
    weights : array of shape (n**2,)

    References
    ----------
    .. [1] M. G. Duffy, "Quadrature over a pyramid or cube of integrands with a singularity at a
       vertex", SIAM J. Numer. Anal. 19, 1260-1262 (1982).
    """
    points, weights = gauss(n, 2)
    a, b = (points.T + 1) / 2
    return np.stack([a * (1 - b), b], axis=-1), weights * (1 - b) / 4


def tetrahedron_rule() -> tuple[Array, Array]:
    """Return points (4, 3) and weights (4,) on the unit tetrahedron, exact to degree 2."""
    a = (5 - np.sqrt(5)) / 20
    return np.vstack([np.full((1, 3), a), a + (1 - 4 * a) * np.eye(3)]), np.full(4, 1 / 24)


def _brick(d: int) -> tuple[Array, Powers]:
    """Return nodes and exponents of the serendipity element: 8 nodes in 2-D, 20 in 3-D."""
    grid = lattice(2, d)
    at_corner_or_edge = np.sum(grid == 1, axis=1) <= 1
    superlinear = np.sum(np.where(grid > 1, grid, 0), axis=1)
    return grid[at_corner_or_edge] - 1.0, grid[superlinear <= 2]


def _simplex(d: int) -> tuple[Array, Powers]:
    """Return nodes (corners, then mid-edge nodes) and exponents of the quadratic simplex."""
    corners = np.vstack([np.zeros((1, d)), np.eye(d)])
    pairs = np.array(edges(d))
    grid = lattice(2, d)
    middles = (corners[pairs[:, 0]] + corners[pairs[:, 1]]) / 2
    return np.vstack([corners, middles]), grid[grid.sum(axis=1) <= 2]


def edges(d: int) -> list[tuple[int, int]]:
    """Return the edges of a simplex as pairs of corners, in the order of its mid-edge nodes.

    Parameters
    ----------
    d : int
        Number of dimensions.
    """
    return [(i, j) for i in range(d + 1) for j in range(i + 1, d + 1)]


_NO_MODES = np.zeros((0, 2), int)
HEX20 = Reference(*_brick(3), *gauss(3, 3), lattice(1, 3))
"""Hexahedron of 20 nodes, with 27 quadrature points and a trilinear projection of J."""
QUAD8 = Reference(*_brick(2), *gauss(5, 2), _NO_MODES)
"""Face of :data:`HEX20`, with 25 quadrature points."""
TET10 = Reference(*_simplex(3), *tetrahedron_rule(), lattice(0, 3), stabilisation=8.0)
"""Tetrahedron of 10 nodes, with 4 quadrature points and a constant projection of J."""
TRI6 = Reference(*_simplex(2), *collapsed_gauss(4), _NO_MODES)
"""Face of :data:`TET10`, with 16 quadrature points."""
FACE = {HEX20: QUAD8, TET10: TRI6}
"""Reference element of the faces for the reference element of each kind of solid element."""
