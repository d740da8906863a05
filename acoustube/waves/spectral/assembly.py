"""Stiffness and mass of a lumen in polynomials across it and line elements along it.

In an element the pressure is a sum of L_j(z) P_i(X, Y), with the shape functions L_j of a line
element, polynomials P_i, X = (x - x0(z)) / a(z) and Y = (y - y0(z)) / b(z). The bounding box of a
section has the centre (x0, y0), half width a and half height b. The z derivative at fixed x and y
is

    d/dz (L_j P_i) = L_j' P_i + L_j B P_i,
    B = -(x0'/a) d_X - (a'/a) X d_X - (y0'/b) d_Y - (b'/b) Y d_Y,

and B P_i is again in the span of the P_i, so that stiffness and mass,

    K = int grad p . grad q dV,    M = int p q dV,

require only the sections' Gram matrices int P_i P_k dx dy. Within an element x0, a, y0 and b are
polynomials in z that interpolate the extent of the wall at Gauss-Lobatto points, and are therefore
continuous along the tube.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from acoustube.waves.spectral.polynomials import (
    Array,
    Index,
    Polynomials,
    gauss_lobatto,
    gram,
    lobatto,
    moments,
)
from acoustube.waves.spectral.quadrature import AxialRule
from acoustube.waves.spectral.walls import Contours, Wall

BOX_POINTS = 5
"""Number of Gauss-Lobatto points per element at which its box is interpolated."""


class Sections(NamedTuple):
    """Gram matrices of the sections at all points along a lumen, (n_points, n, n) each.

    P is the column of the n polynomials across the tube, and B P that of their z derivatives at
    fixed x and y.

    Attributes
    ----------
    mass : ndarray
        int P P^T dx dy, in m2.
    along : ndarray
        int P (B P)^T dx dy, in m.
    across : ndarray
        int grad P . grad P^T dx dy, dimensionless, where grad P has the z component B P.
    """

    mass: Array
    along: Array
    across: Array


class Boxes(NamedTuple):
    """Boxes around sections, and their z derivatives (`_z`, dimensionless), (n_sections,) each.

    (x0, y0) is the centre, a the half width and b the half height, in m.
    """

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
    """Matrices of the elements along a lumen, in the basis enriched for the error estimate.

    Attributes
    ----------
    stiffness, mass : ndarray
        (n_elements, size, size), in m and m3; see :class:`Layout`.
    first, last : ndarray
        Boxes of the sections at the first and at the last edge: x0, a, y0, b in m, (4,).
    sections : Sections
        Gram matrices of the polynomials of the basis itself.
    """

    stiffness: Array
    mass: Array
    first: Array
    last: Array
    sections: Sections


def assemble(wall: Wall, rule: AxialRule, basis: Polynomials, layout: Layout) -> Elements:
    """Integrate the stiffness and mass of all elements of a lumen.

    Parameters
    ----------
    wall : Wall
    rule : AxialRule
        Quadrature along the elements.
    basis : Polynomials
        Polynomials across the tube, in the basis enriched for the error estimate.
    layout : Layout
    """
    boxes, first, last = element_boxes(wall, rule)
    mass, along, across = section_matrices(wall.contours(rule.z, basis.degree), boxes, basis)
    stiffness = along_elements(rule, layout, mass, along, across)
    heavy = along_elements(rule, layout, None, None, mass)
    kept = slice(layout.n)
    sections = Sections(*(part[:, kept, kept].copy() for part in (mass, along, across)))
    return Elements(stiffness, heavy, first, last, sections)


class Layout(NamedTuple):
    """Order of the unknowns of an element: those of the basis, then those that enrich it.

    The basis has the functions L_j P_i, L_j along and P_i across the tube, with j <= `order`,
    i < `n`. The basis enriched for the error estimate adds those with j <= `order`, i >= `n`, and
    then those with j = `order` + 1, i < `n`. In each of the three groups i varies fastest.

    Attributes
    ----------
    n, n_all : int
        Number of functions across the tube, of the basis and of the enriched basis.
    order : int
        Degree of the basis along an element.
    """

    n: int
    n_all: int
    order: int

    @property
    def n_basis(self) -> int:
        """Number of unknowns of an element in the basis."""
        return self.n * (self.order + 1)

    @property
    def n_higher(self) -> int:
        """Number of unknowns of an element for the higher degrees across the tube."""
        return (self.n_all - self.n) * (self.order + 1)

    @property
    def size(self) -> int:
        """Number of unknowns of an element in the enriched basis."""
        return self.n_basis + self.n_higher + self.n

    def end(self, j: int) -> Index:
        """Return the indices (n_all,) of the unknowns at the low (j = 0) or high (j = 1) end."""
        more = self.n_all - self.n
        return np.concatenate(
            [j * self.n + np.arange(self.n), self.n_basis + j * more + np.arange(more)]
        )


@lru_cache(maxsize=8)
def _places(layout: Layout) -> Index:
    """Return the flat indices, (size, size), that take an element's matrix from an array.

    The array has the entries for L_j P_i times L_k P_m, L_j along and P_i across the tube, in the
    order j, k, i, m, (order + 2, order + 2, n_all, n_all).
    """
    n, n_all, n_j = layout.n, layout.n_all, layout.order + 1
    low, high = np.arange(n), np.arange(n, n_all)
    rows = [(j, i) for part in (low, high) for j in range(n_j) for i in part]
    j, i = np.array(rows + [(n_j, i) for i in low]).T
    first, second = (j[:, None] * (n_j + 1) + j), (i[:, None] * n_all + i)
    return np.asarray(first * n_all**2 + second)


def along_elements(
    rule: AxialRule, layout: Layout, slopes: Array | None, mixed: Array | None, values: Array
) -> Array:
    """Integrate products of the shape functions L_j and of their z derivatives L_j' along elements.

    Parameters
    ----------
    rule : AxialRule
    layout : Layout
    slopes : ndarray or None
        Factors of L_j' L_k' at all points, (n_points, n_all, n_all); None for zero.
    mixed : ndarray or None
        Factors of L_j' L_k, of the shape of `slopes`; their transposes are those of L_j L_k'.
    values : ndarray
        Factors of L_j L_k, of the same shape.

    Returns
    -------
    ndarray
        Element matrices, (n_elements, size, size).
    """
    n_j = layout.order + 2
    value, slope = lobatto(n_j - 1, rule.point)
    weighted = value * rule.weight, slope * rule.weight
    found = np.empty((len(rule.step), layout.size, layout.size))
    places = _places(layout)
    for number, half in enumerate(rule.step / 2):
        here = rule.of(number)

        def pairs(f: Array, g: Array, here: slice = here) -> Array:
            return (f[:, None, here] * g[:, here]).reshape(n_j**2, -1)

        def flat(part: Array, here: slice = here) -> Array:
            return part[here].reshape(-1, layout.n_all**2)

        terms = [(half * pairs(weighted[0], value), flat(values))]
        if slopes is not None:
            terms.append((pairs(weighted[1], slope) / half, flat(slopes)))
        if mixed is not None:
            terms.append((pairs(weighted[1], value), flat(mixed)))
            terms.append((pairs(weighted[0], slope), flat(mixed.swapaxes(1, 2))))
        factors, parts = zip(*terms, strict=True)
        total = np.concatenate(factors, axis=1) @ np.concatenate(parts)
        np.take(total.ravel(), places, out=found[number], mode="clip")
    return found


def element_boxes(wall: Wall, rule: AxialRule) -> tuple[Boxes, Array, Array]:
    """Return the bounding boxes of sections: at a rule's points, at the first and at the last edge.

    Each of the latter two is x0, a, y0, b (centre and half width in x, then in y) in m, (4,).
    """
    nodes = gauss_lobatto(BOX_POINTS)
    step = rule.step
    z = (rule.edges[:-1, None] + step[:, None] * (nodes + 1) / 2).ravel()
    x, y, *_ = wall.lines(z)
    low = np.stack([x.min(axis=1), y.min(axis=1)])
    high = np.stack([x.max(axis=1), y.max(axis=1)])
    middle, half = (low + high) / 2, (high - low) / 2
    if wall.symmetric:
        middle[0] = 0.0
    extent = np.stack([middle[0], half[0], middle[1], half[1]]).reshape(4, len(step), -1)
    vander = np.polynomial.legendre.legvander
    inverse = np.linalg.inv(vander(nodes, BOX_POINTS - 1))
    change = np.polynomial.legendre.legder(np.eye(BOX_POINTS), axis=0)
    value = vander(rule.point, BOX_POINTS - 1) @ inverse
    slope = vander(rule.point, BOX_POINTS - 2) @ change @ inverse
    own = extent[:, rule.element]
    at = (own * value).sum(axis=-1)
    along = (own * slope).sum(axis=-1) * (2 / step)[rule.element]
    return Boxes(*at, *along), extent[:, 0, 0], extent[:, -1, -1]


def section_matrices(
    contours: Contours, boxes: Boxes, basis: Polynomials
) -> tuple[Array, Array, Array]:
    """Return int P P^T, int P (B P)^T and int grad P . grad P^T of each section.

    Each is (n_sections, n, n). P is the column of the n polynomials, and B P that of their z
    derivatives at fixed x and y. The components of grad P are its x and y derivatives and B P.
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
