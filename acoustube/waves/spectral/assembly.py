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
    """Matrices of line elements with the basis functions L_j P_i, j from 0 to `order`.

    Attributes
    ----------
    stiffness, mass : ndarray
        (n_elements, n_j, n_i, n_j, n_i), in m and m3.
    first, last : ndarray
        The box x0, a, y0, b at both ends in m, (4,).
    """

    stiffness: Array
    mass: Array
    first: Array
    last: Array


def assemble(wall: Wall, edges: Array, basis: Polynomials, order: int, n_points: int) -> Elements:
    """Integrate the stiffness and mass of all elements of a lumen.

    Parameters
    ----------
    wall : Wall
    edges : ndarray
        Boundaries of the elements along z in m, (n_elements + 1,), increasing.
    basis : Polynomials
    order : int
        Highest degree along an element.
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
    stiffness = along_elements(step, order, (points, weights), mass, along, across)
    return Elements(stiffness, along_elements(step, order, (points, weights), None, None, mass),
                    first, last)  # fmt: skip


def along_elements(
    step: Array,
    order: int,
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
    order : int
        Highest degree along an element.
    rule : tuple of ndarray
        Points from -1 to 1 and weights, (n_points,).
    slopes, mixed, values : ndarray
        Factors of L_j' L_k', of L_j' L_k (and of its mirror image) and of L_j L_k at all points,
        (n_elements n_points, n, n); the first two may be none.

    Returns
    -------
    ndarray
        (n_elements, order + 1, n, order + 1, n).
    """
    points, weights = rule
    value, slope = lobatto(order, points)
    n, n_j = values.shape[-1], order + 1

    def combined(f: Array, g: Array, part: Array) -> Array:
        pair = np.einsum("jq,kq,q->jkq", f, g, weights).reshape(-1, len(points))
        found = np.matmul(pair, part.reshape(len(step), len(points), -1))
        return found.reshape(len(step), n_j, n_j, n, n).transpose(0, 1, 3, 2, 4)

    half = (step / 2)[:, None, None, None, None]
    total = half * combined(value, value, values)
    if slopes is not None:
        total += combined(slope, slope, slopes) / half
    if mixed is not None:
        cross = combined(slope, value, mixed)
        total += cross + cross.transpose(0, 3, 4, 1, 2)
    return total


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
