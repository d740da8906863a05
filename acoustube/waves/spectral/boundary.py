"""Integrals over a lumen's wall of products of the basis functions, and of their gradients."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from acoustube.waves.spectral.assembly import Boxes, Layout, along_elements, element_boxes
from acoustube.waves.spectral.polynomials import Array, Index, Polynomials, polynomials
from acoustube.waves.spectral.quadrature import AxialRule
from acoustube.waves.spectral.walls import Contours, Wall

WALL_DEGREE = 4
"""Total degree of polynomials for whose products the default number of quadrature points round the
tube suffices, in the derivatives of stiffness and mass by motions of the wall."""


class WallPoints(NamedTuple):
    """Quadrature points of a wall, with normals and weights.

    Attributes
    ----------
    rule : AxialRule
        Coordinates z of the sections, with weights.
    contours : Contours
    boxes : Boxes
    normal : ndarray
        Outward unit normals, (3, n_sections, n_points).
    area : ndarray
        Wall area of each point per length along z, in m, (n_sections, n_points).
    halved : bool
        Whether the points are those of x > 0 only, with weights that include the mirror images.
    sealing_gap : float
        Height in m of a gap that is half sealed; see `layers.SEALING_WIDTH`.
    """

    rule: AxialRule
    contours: Contours
    boxes: Boxes
    normal: Array
    area: Array
    halved: bool
    sealing_gap: float = 0.0


class WallFunctions(NamedTuple):
    """The n polynomials across the tube, and their derivatives in 1/m, at points of a wall.

    Each is (n_sections, n, n_points). The z derivative `p_z` is that at fixed x and y.
    """

    p: Array
    p_x: Array
    p_y: Array
    p_z: Array


def wall_points(wall: Wall, rule: AxialRule, degree: int = WALL_DEGREE) -> WallPoints:
    """Return quadrature points of a wall: those of a rule along the tube, times those around.

    The number of points around suffices for products of two polynomials of total degree `degree`.
    """
    boxes, _, _ = element_boxes(wall, rule)
    contours = wall.contours(rule.z, degree)
    turned = contours.x_t * contours.y_z - contours.y_t * contours.x_z
    normal = np.stack([contours.y_t, -contours.x_t, turned])
    size = np.sqrt((normal**2).sum(axis=0))
    area = size * contours.weight
    return WallPoints(rule, contours, boxes, normal / size, area, wall.symmetric, wall.sealing_gap)


def wall_functions(points: WallPoints, basis: Polynomials) -> WallFunctions:
    """Return the polynomials across the tube and their derivatives at points of a wall."""
    boxes = Boxes(*(part[:, None] for part in points.boxes))
    x = (points.contours.x - boxes.x0) / boxes.a
    y = (points.contours.y - boxes.y0) / boxes.b
    p = basis.values(x, y)
    other = None if basis.odd is None else not basis.odd
    partner = polynomials(basis.degree, other).values(x, y)
    p_x = np.tensordot(basis.dx, partner, 1) / boxes.a
    p_y = np.tensordot(basis.dy, p, 1) / boxes.b
    p_z = -(boxes.x0_z + boxes.a_z * x) * p_x - (boxes.y0_z + boxes.b_z * y) * p_y
    return WallFunctions(*(part.swapaxes(0, 1) for part in (p, p_x, p_y, p_z)))


def wall_matrices(
    points: WallPoints, functions: WallFunctions, layout: Layout, weight: Array
) -> tuple[Array, Array]:
    """Return stiffness and mass integrals over the wall with a weight w.

    Parameters
    ----------
    points : WallPoints
    functions : WallFunctions
    layout : Layout
    weight : ndarray
        w at the points, (n_sections, n_points).

    Returns
    -------
    stiffness, mass : ndarray
        int w grad p . grad q dA and int w p q dA, (n_elements, size, size).
    """
    p, p_x, p_y, p_z = functions
    share = (weight * points.area)[:, None]
    mass = _product(p * share, p)
    values = _product(p_x * share, p_x) + _product(p_y * share, p_y) + _product(p_z * share, p_z)
    stiffness = along_elements(points.rule, layout, mass, _product(p * share, p_z), values)
    return stiffness, along_elements(points.rule, layout, None, None, mass)


class TangentialFunctions(NamedTuple):
    """Polynomials across the tube at points of a wall, and their tangential derivatives.

    Attributes
    ----------
    p, around, along : ndarray
        Values, derivatives along the contour, and derivatives along the wall at right angles to
        the contour, (n_sections, n, n_points). The derivatives are in 1/m.
    rise : ndarray
        Component along the tube of the direction of `along`, (n_sections, 1, n_points).
    """

    p: Array
    around: Array
    along: Array
    rise: Array


def tangential_functions(points: WallPoints, functions: WallFunctions) -> TangentialFunctions:
    """Return the polynomials and their tangential derivatives at points of a wall."""
    p, p_x, p_y, p_z = functions
    contours = points.contours
    speed = np.hypot(contours.x_t, contours.y_t)
    t_x, t_y = ((part / speed)[:, None] for part in (contours.x_t, contours.y_t))
    n_x, n_y, n_z = (part[:, None] for part in points.normal)
    rise = n_x * t_y - n_y * t_x
    along = n_z * (t_x * p_y - t_y * p_x) + rise * p_z
    return TangentialFunctions(p, t_x * p_x + t_y * p_y, along, rise)


def tangential_matrices(
    points: WallPoints,
    functions: TangentialFunctions,
    layout: Layout,
    weight: Array,
    elements: Index,
) -> tuple[Array, Array]:
    """Return stiffness (of tangential gradients) and mass over the wall of some elements.

    Parameters
    ----------
    points : WallPoints
    functions : TangentialFunctions
    layout : Layout
    weight : ndarray
        Weight w at the points, (n_sections, n_points).
    elements : ndarray of int
        Numbers of the elements, rising, (n,).

    Returns
    -------
    stiffness, mass : ndarray
        int w grad p . grad q dA, with gradients along the wall, and int w p q dA, (n, size, size).
    """
    here = np.isin(points.rule.element, elements)
    share = (weight * points.area)[here, None]
    p, around, along, rise = (part[here] for part in functions)
    weighted = p * share
    mass = _product(weighted, p)
    values = _product(around * share, around) + _product(along * share, along)
    mixed, slopes = _product(weighted * rise, along), _product(weighted * rise**2, p)
    rule = points.rule.only(elements)
    stiffness = along_elements(rule, layout, slopes, mixed, values)
    return stiffness, along_elements(rule, layout, None, None, mass)


def _product(a: Array, b: Array) -> Array:
    return np.matmul(a, b.swapaxes(1, 2))
