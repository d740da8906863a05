"""Polynomial basis of a section: products of Legendre polynomials in its bounding box.

The box has the centre (x0, y0), half width a and half height b. With X = (x - x0) / a and
Y = (y - y0) / b, both from -1 to 1, the functions are combinations of P_i(X) P_j(Y), i + j <= N,
orthonormal over the ellipse in the box up to a common factor. They are orthonormalised one after
the other, so that the first ones span all polynomials of a lower degree. As functions of X and Y
they do not depend on the section, because a rigid wall is the natural boundary condition of the
weak form. All integrals of products of two functions over a section follow from its moments,

    m_ij = int P_i(X) P_j(Y) dx dy = - closed int P_i(X) (int^Y P_j) b dx,

by the expansion of a product of Legendre polynomials in Legendre polynomials. All derivatives are
again in the span of the functions. A contour may overhang, because the integral along it counts the
area between contour and y0 with its sign.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular

Array = NDArray[np.float64]
Index = NDArray[np.intp]

CHUNK = 8
"""Number of sections that are integrated over at a time."""


@dataclass(frozen=True, eq=False)
class Polynomials:
    """Polynomials up to a total degree, orthonormal over an ellipse, in the order of that degree.

    Attributes
    ----------
    degree : int
    odd : bool or None
        True if antisymmetric about x = x0, False if symmetric; None for both.
    i, j : ndarray of int
        Degree in X and in Y of the products of Legendre polynomials, (n,).
    mix : ndarray
        Coefficients of the functions in these products, (n, n), a row for each function.
    partner : ndarray of int
        Degrees i and j of the products that span the X derivatives, (2, n_partner).
    partner_mix : ndarray
        Coefficients of the partner functions, which are orthonormal combinations of the products
        of `partner`, (n_partner, n_partner).
    dx : ndarray
        Coefficients of the functions' X derivatives in the partner functions, (n, n_partner).
    x_dx, dy, y_dy : ndarray
        Matrices of X d/dX, d/dY and Y d/dY in the functions, (n, n).
    """

    degree: int
    odd: bool | None
    i: Index
    j: Index
    mix: Array
    partner: Index
    partner_mix: Array
    dx: Array
    x_dx: Array
    dy: Array
    y_dy: Array

    @property
    def size(self) -> int:
        """Number of basis functions."""
        return len(self.i)

    def count(self, degree: int) -> int:
        """Return the number of polynomials up to a total degree; they are the first ones."""
        return int(np.sum(self.i + self.j <= degree))

    def values(self, x: Array, y: Array) -> Array:
        """Return the polynomials' values (n, ...) at X and Y, (...), both from -1 to 1."""
        p, q = legendre(self.degree, x), legendre(self.degree, y)
        return np.tensordot(self.mix, p[self.i] * q[self.j], 1)


@lru_cache(maxsize=32)
def polynomials(degree: int, odd: bool | None = None) -> Polynomials:
    """Return the polynomials up to a total degree; see :class:`Polynomials`."""
    i, j = _degrees(degree, odd)
    k, m = _degrees(degree, None if odd is None else not odd)
    d, xd = _derivatives(degree)

    mix, partner_mix = _mix(degree, i, j), _mix(degree, k, m)

    def product(across: Array, along: Array, other: tuple[Index, Index]) -> Array:
        return np.asarray(mix @ (across[np.ix_(i, other[0])] * along[np.ix_(j, other[1])]))

    one, back = np.eye(degree + 1), np.linalg.inv(mix)
    return Polynomials(
        degree=degree,
        odd=odd,
        i=i,
        j=j,
        mix=mix,
        partner=np.stack([k, m]),
        partner_mix=partner_mix,
        dx=product(d, one, (k, m)) @ np.linalg.inv(partner_mix),
        x_dx=product(xd, one, (i, j)) @ back,
        dy=product(one, d, (i, j)) @ back,
        y_dy=product(one, xd, (i, j)) @ back,
    )


def _degrees(degree: int, odd: bool | None) -> tuple[Index, Index]:
    """Return the degrees in X and Y in the order of their sum."""
    i, j = np.indices((degree + 1, degree + 1)).reshape(2, -1)
    kept = i + j <= degree
    if odd is not None:
        kept &= i % 2 == int(odd)
    i, j = i[kept], j[kept]
    order = np.argsort(i + j, kind="stable")
    return i[order], j[order]


def _mix(degree: int, i: Index, j: Index) -> Array:
    """Return the coefficients that orthonormalise Legendre products over the unit disc."""
    r, weight = gauss(degree + 2, 0.0, 1.0)
    n_phi = 2 * degree + 4
    phi = 2 * np.pi * np.arange(n_phi) / n_phi
    p, q = (legendre(degree, np.outer(r, side)) for side in (np.cos(phi), np.sin(phi)))
    values = (p[i] * q[j] * np.sqrt(weight * r / n_phi)[:, None]).reshape(len(i), -1)
    # By QR, because the condition number of the Gram matrix is the square of that of the values.
    triangle = np.linalg.qr(values.T, mode="r")
    return np.asarray(solve_triangular(triangle, np.eye(len(i)), trans="T"))


def legendre(degree: int, x: Array) -> Array:
    """Return the Legendre polynomials, normalised to unit mean square, (degree + 1, ...)."""
    p = np.ones((degree + 1, *np.shape(x)))
    if degree > 0:
        np.multiply(x, np.sqrt(3), out=p[1])
    for n in range(1, degree):
        np.multiply(p[n], x, out=p[n + 1])
        p[n + 1] *= np.sqrt((2 * n + 1) * (2 * n + 3)) / (n + 1)
        p[n + 1] -= (n / (n + 1) * np.sqrt((2 * n + 3) / (2 * n - 1))) * p[n - 1]
    return p


def integrated_legendre(degree: int, x: Array) -> Array:
    """Return antiderivatives of the normalised Legendre polynomials, (degree + 1, ...).

    That of degree zero is x; the others vanish at -1 and 1.
    """
    norm = _norm(degree + 1, x)
    p = legendre(degree + 1, x) / norm
    q = np.empty((degree + 1, *np.shape(x)))
    q[0] = x
    q[1:] = (p[2:] - p[:-2]) / norm[1:-1] ** 2
    return q * norm[:-1]


def _norm(degree: int, x: Array) -> Array:
    return np.sqrt(2 * np.arange(degree + 1) + 1.0).reshape((-1,) + (1,) * np.ndim(x))


def _derivatives(degree: int) -> tuple[Array, Array]:
    """Return the matrices of d/dx and x d/dx in the normalised Legendre polynomials."""
    x, w = _rule(degree + 1)
    p = legendre(degree, x)
    slope = np.stack(
        [
            np.polynomial.legendre.Legendre.basis(n).deriv()(x) * np.sqrt(2 * n + 1.0)
            for n in range(degree + 1)
        ]
    )
    return (slope * w / 2) @ p.T, (slope * x * w / 2) @ p.T


@lru_cache(maxsize=8)
def _products(degree: int) -> Array:
    """Return Legendre coefficients of products P_i P_k, (degree + 1, degree + 1, 2 degree + 1)."""
    x, w = _rule(2 * degree + 1)
    p = legendre(2 * degree, x)
    low = p[: degree + 1]
    return np.asarray(np.einsum("iq,kq,mq,q->ikm", low, low, p, w / 2, optimize=True))


def moments(degree: int, x: Array, y: Array, dx: Array, height: Array) -> Array:
    """Return the moments of sections: integrals of products of normalised Legendre polynomials.

    Parameters
    ----------
    degree : int
        Highest degree in X, and in Y.
    x, y : ndarray
        Contours, anticlockwise, in the coordinates X and Y of their boxes, (n_sections, n_points).
    dx : ndarray
        Increments of x along the contour (dx/dt times the quadrature weight) in m,
        (n_sections, n_points).
    height : ndarray
        Half heights b of the boxes in m, (n_sections,).

    Returns
    -------
    ndarray
        int P_i(X) P_j(Y) dx dy in m2, (n_sections, degree + 1, degree + 1).
    """
    found = np.empty((len(x), degree + 1, degree + 2))
    # Few sections at a time, so that their polynomials fit into the processor's cache.
    for start in range(0, len(x), CHUNK):
        few = slice(start, start + CHUNK)
        p, q = legendre(degree, x[few]), legendre(degree + 1, y[few])
        p *= dx[few]
        np.matmul(p.transpose(1, 0, 2), q.transpose(1, 2, 0), out=found[few])
    return -height[:, None, None] * (found @ _antiderivatives(degree).T)


@lru_cache(maxsize=8)
def _antiderivatives(degree: int) -> Array:
    """Return the antiderivatives of the normalised polynomials, (degree + 1, degree + 2).

    Each row holds the coefficients in the normalised polynomials.
    """
    n = np.arange(degree + 1)
    norm = np.sqrt(2 * np.arange(degree + 2) + 1.0)
    found = np.zeros((degree + 1, degree + 2))
    found[n, n + 1] = 1 / (norm[:-1] * norm[1:])
    found[n[1:], n[:-1]] = -1 / (norm[1:-1] * norm[:-2])
    return found


def gram(moment: Array, degree: int, i: Index, j: Index) -> Array:
    """Return Gram matrices of products P_i(X) P_j(Y) of normalised Legendre polynomials.

    Parameters
    ----------
    moment : ndarray
        Moments of the sections in m2, (n_sections, 2 degree + 1, 2 degree + 1).
    degree : int
        Highest degree of the functions in X, and in Y.
    i, j : ndarray of int
        Degrees of the functions in X and Y, (n,).

    Returns
    -------
    ndarray
        In m2, (n_sections, n, n).
    """
    product = _products(degree)
    used, place = np.unique(i, return_inverse=True)
    across = product[np.ix_(used, used)].reshape(len(used) ** 2, -1)
    along = product.reshape((degree + 1) ** 2, -1).T
    both = np.matmul(np.matmul(across, moment), along)
    row = place[:, None] * len(used) + place
    column = j[:, None] * (degree + 1) + j
    return np.asarray(both[:, row, column])


def lobatto(degree: int, x: Array) -> tuple[Array, Array]:
    """Return the shape functions of a line element from -1 to 1, and their derivatives.

    Parameters
    ----------
    degree : int
        Degree of the element.
    x : ndarray
        Points from -1 to 1, (n,).

    Returns
    -------
    values, slopes : ndarray
        (degree + 1, n): first the two linear functions that are one at the left and at the right
        end, then the integrated Legendre polynomials of degrees 2, 3, ..., zero at both ends.
    """
    value = np.empty((degree + 1, len(x)))
    slope = np.empty_like(value)
    value[0], value[1] = (1 - x) / 2, (1 + x) / 2
    slope[0], slope[1] = -0.5, 0.5
    # With orthonormal slopes the stiffness matrix of a uniform rod is the identity.
    value[2:] = integrated_legendre(degree - 1, x)[1:] / np.sqrt(2)
    slope[2:] = legendre(degree - 1, x)[1:] / np.sqrt(2)
    return value, slope


def gauss(n: int, low: float = -1.0, high: float = 1.0) -> tuple[Array, Array]:
    """Return the points and weights of Gauss's rule over an interval."""
    x, w = _rule(n)
    return low + (high - low) * (x + 1) / 2, w * (high - low) / 2


@lru_cache(maxsize=64)
def _rule(n: int) -> tuple[Array, Array]:
    """Return the points and weights of Gauss's rule from -1 to 1, not to be written to."""
    x, w = np.polynomial.legendre.leggauss(n)
    x.flags.writeable = w.flags.writeable = False
    return x, w


def gauss_lobatto(n: int) -> Array:
    """Return n Gauss-Lobatto points from -1 to 1, the ends among them."""
    inner: Any = np.polynomial.legendre.Legendre.basis(n - 1).deriv().roots()
    return np.concatenate([[-1.0], np.sort(inner.real), [1.0]])
