"""Stiffness and mass of a lumen in polynomials across it and line elements along it.

In an element the pressure is a sum of L_j(z) P_i(X, Y), with X = (x - x0(z)) / a(z) and
Y = (y - y0(z)) / b(z). Its derivative along the tube at fixed x and y is

    d/dz (L_j P_i) = L_j' P_i + L_j B P_i,
    B = -(x0'/a) d_X - (a'/a) X d_X - (y0'/b) d_Y - (b'/b) Y d_Y,

again in the span of the P_i, so that

    K = int grad p . grad q dV,    M = int p q dV

need only the sections' Gram matrices int P_i P_k dx dy. Within an element the box is a polynomial
through the extent of the wall at Gauss-Lobatto points, so that it is continuous along the tube.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from acoustube.waves.spectral.polynomials import (
    Array,
    Index,
    Polynomials,
    gauss,
    gauss_lobatto,
    gram,
    lobatto,
    moments,
)
from acoustube.waves.spectral.walls import Contours, Wall

BOX_POINTS = 5
"""Number of Gauss-Lobatto points per element at which its box is interpolated."""


class Boxes(NamedTuple):
    """Boxes around sections, (n_sections,) each, in m, and their derivatives along the tube."""

    x0: Array
    a: Array
    y0: Array
    b: Array
    x0_z: Array
    a_z: Array
    y0_z: Array
    b_z: Array


@dataclass(frozen=True, eq=False)
class Elements:
    """Matrices of line elements in the enriched basis.

    Attributes
    ----------
    stiffness, mass : ndarray
        (n_elements, size, size), in m and m3; see :class:`Layout`.
    first, last : ndarray
        The box x0, a, y0, b at both ends in m, (4,).
    """

    stiffness: Array
    mass: Array
    first: Array
    last: Array


def assemble(
    wall: Wall, edges: Array, basis: Polynomials, layout: Layout, n_points: int
) -> Elements:
    """Integrate the stiffness and mass of all elements of a lumen.

    Parameters
    ----------
    wall : Wall
    edges : ndarray
        Boundaries of the elements along z in m, (n_elements + 1,), increasing.
    basis : Polynomials
    layout : Layout
    n_points : int
        Gauss points along an element.

    Returns
    -------
    Elements
    """
    points, weights = gauss(n_points)
    step = np.diff(edges)
    z = (edges[:-1, None] + step[:, None] * (points + 1) / 2).ravel()
    boxes, first, last = element_boxes(wall, edges, points)
    mass, along, across = section_matrices(wall.contours(z, basis.degree), boxes, basis)
    stiffness = along_elements(step, layout, (points, weights), mass, along, across)
    inertia = along_elements(step, layout, (points, weights), None, None, mass)
    return Elements(stiffness, inertia, first, last)


class Layout(NamedTuple):
    """Order of the unknowns of an element: those of the basis, then those of the enriched one.

    The basis has the functions L_j P_i with j <= `order`, i < `n`; the enriched one in addition
    those with i >= `n`, and then those with j = `order` + 1, i < `n`.

    Attributes
    ----------
    n, n_all : int
        Number of functions across the tube of both.
    order : int
        Degree along an element of the basis.
    """

    n: int
    n_all: int
    order: int

    @property
    def n_basis(self) -> int:
        """Number of unknowns of the basis."""
        return self.n * (self.order + 1)

    @property
    def n_higher(self) -> int:
        """Number of unknowns of the functions across the tube that the basis lacks."""
        return (self.n_all - self.n) * (self.order + 1)

    @property
    def size(self) -> int:
        """Number of all unknowns of an element."""
        return self.n_basis + self.n_higher + self.n

    def end(self, j: int) -> Index:
        """Return the places of the unknowns of an end, j = 0 or 1, for all functions across."""
        more = self.n_all - self.n
        return np.concatenate(
            [j * self.n + np.arange(self.n), self.n_basis + j * more + np.arange(more)]
        )

    def ordered(self, matrix: Array) -> Array:
        """Return matrices (n_elements, n_j, n_j, n_all, n_all) in this order, two-dimensional."""
        n, n_j, ends = self.n, self.order + 1, np.cumsum([0, self.n_basis, self.n_higher, self.n])
        low, high, lower, last = slice(n), slice(n, None), slice(n_j), slice(n_j, None)
        groups = list(zip((lower, lower, last), (low, high, low), ends[:-1], ends[1:], strict=True))
        found = np.empty((len(matrix), self.size, self.size))
        for j, i, a, b in groups:
            for k, m, c, d in groups:
                part = matrix[:, j, k, i, m].transpose(0, 1, 3, 2, 4)
                found[:, a:b, c:d].reshape(part.shape)[...] = part
        return found


def along_elements(
    step: Array,
    layout: Layout,
    rule: tuple[Array, Array],
    slopes: Array | None,
    mixed: Array | None,
    values: Array,
) -> Array:
    """Integrate products of the functions L_j and of their slopes along elements.

    Parameters
    ----------
    step : ndarray
        Lengths of the elements in m, (n_elements,).
    layout : Layout
    rule : tuple of ndarray
        Points from -1 to 1 and weights, (n_points,).
    slopes, mixed, values : ndarray
        Factors of L_j' L_k', of L_j' L_k (and of its mirror image) and of L_j L_k at all points,
        (n_elements n_points, n_all, n_all); the first two may be none.

    Returns
    -------
    ndarray
        (n_elements, size, size).
    """
    points, weights = rule
    n_j = layout.order + 2
    value, slope = lobatto(n_j - 1, points)
    half = (step / 2)[:, None, None]

    def pairs(f: Array, g: Array) -> Array:
        return np.asarray((f[:, None] * g * weights).reshape(n_j**2, -1))

    def flat(part: Array) -> Array:
        return part.reshape(len(step), len(points), -1)

    terms = [(pairs(value, value), half * flat(values))]
    if slopes is not None:
        terms.append((pairs(slope, slope), flat(slopes) / half))
    if mixed is not None:
        terms.append((pairs(slope, value), flat(mixed)))
        terms.append((pairs(value, slope), flat(mixed.swapaxes(1, 2))))
    factors, parts = zip(*terms, strict=True)
    total = np.matmul(np.concatenate(factors, axis=1), np.concatenate(parts, axis=1))
    return layout.ordered(total.reshape(len(step), n_j, n_j, layout.n_all, layout.n_all))


def element_boxes(wall: Wall, edges: Array, points: Array) -> tuple[Boxes, Array, Array]:
    """Return the boxes at points (n,) of each element, from -1 to 1, and those at both ends."""
    nodes = gauss_lobatto(BOX_POINTS)
    step = np.diff(edges)
    z = (edges[:-1, None] + step[:, None] * (nodes + 1) / 2).ravel()
    x, y, *_ = wall.lines(z)
    low = np.stack([x.min(axis=1), y.min(axis=1)])
    high = np.stack([x.max(axis=1), y.max(axis=1)])
    middle, half = (low + high) / 2, (high - low) / 2
    if wall.symmetric:
        middle[0] = 0.0
    extent = np.stack([middle[0], half[0], middle[1], half[1]]).reshape(4, len(step), -1)
    vander = np.polynomial.legendre.legvander
    value = vander(points, BOX_POINTS - 1) @ np.linalg.inv(vander(nodes, BOX_POINTS - 1))
    change = np.polynomial.legendre.legder(np.eye(BOX_POINTS), axis=0)
    slope = vander(points, BOX_POINTS - 2) @ change @ np.linalg.inv(vander(nodes, BOX_POINTS - 1))
    at = (extent @ value.T).reshape(4, -1)
    along = (extent @ slope.T * (2 / step)[:, None]).reshape(4, -1)
    return Boxes(*at, *along), extent[:, 0, 0], extent[:, -1, -1]


def section_matrices(
    contours: Contours, boxes: Boxes, basis: Polynomials
) -> tuple[Array, Array, Array]:
    """Return int P P^T, int P (B P)^T and int grad P . grad P^T of each section.

    The gradient of the last is that at fixed L_j: d/dx, d/dy and B. Each (n_sections, n, n).
    """
    n = basis.degree
    x = (contours.x - boxes.x0[:, None]) / boxes.a[:, None]
    y = (contours.y - boxes.y0[:, None]) / boxes.b[:, None]
    moment = moments(2 * n, x, y, contours.x_t * contours.weight, boxes.b)
    mass = basis.mix @ gram(moment, n, basis.i, basis.j) @ basis.mix.T
    partner = basis.partner_mix @ gram(moment, n, *basis.partner) @ basis.partner_mix.T
    drift = -(
        _scaled(boxes.a_z / boxes.a, basis.x_dx)
        + _scaled(boxes.y0_z / boxes.b, basis.dy)
        + _scaled(boxes.b_z / boxes.b, basis.y_dy)
    )
    if basis.odd is None:
        drift -= _scaled(boxes.x0_z / boxes.a, basis.dx)
    along = mass @ drift.swapaxes(1, 2)
    across = drift @ along
    across += (basis.dx @ partner @ basis.dx.T) / boxes.a[:, None, None] ** 2
    across += (basis.dy @ mass @ basis.dy.T) / boxes.b[:, None, None] ** 2
    return mass, along, across


def _scaled(factor: Array, matrix: Array) -> Array:
    return np.asarray(factor[:, None, None] * matrix)
