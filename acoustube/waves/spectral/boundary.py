"""Integrals over a lumen's wall of products of its functions, and of their gradients."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from acoustube.waves.spectral.assembly import Boxes, Layout, along_elements, element_boxes
from acoustube.waves.spectral.polynomials import Array, Polynomials, gauss, polynomials
from acoustube.waves.spectral.walls import Contours, Wall

WALL_DEGREE = 4
"""Degree that limits the number of points round the tube: the integrands are small corrections."""


class WallPoints(NamedTuple):
    """Points of a wall with their normals, weights and derivatives.

    Attributes
    ----------
    z : ndarray
        Heights of the sections in m, (n_sections,).
    contours : Contours
    boxes : Boxes
    normal : ndarray
        Outward, (3, n_sections, n_points).
    area : ndarray
        Wall area that each point stands for, per length along z, in m, (n_sections, n_points).
    halved : bool
        Whether the points are those of x > 0, and stand for their mirror images too.
    sealing_gap : float
        Gaps up to this height in m pass no sound.
    """

    z: Array
    contours: Contours
    boxes: Boxes
    normal: Array
    area: Array
    halved: bool
    sealing_gap: float = 0.0


class WallFunctions(NamedTuple):
    """The polynomials and their gradients at points of a wall, (n_sections, n, n_points) each."""

    p: Array
    p_x: Array
    p_y: Array
    p_z: Array


def wall_points(wall: Wall, edges: Array, n_points: int) -> WallPoints:
    """Return the wall at Gauss points (n_points to an element) along the tube."""
    points, _ = gauss(n_points)
    step = np.diff(edges)
    z = (edges[:-1, None] + step[:, None] * (points + 1) / 2).ravel()
    boxes, _, _ = element_boxes(wall, edges, points)
    contours = wall.contours(z, WALL_DEGREE)
    turned = contours.x_t * contours.y_z - contours.y_t * contours.x_z
    normal = np.stack([contours.y_t, -contours.x_t, turned])
    size = np.sqrt((normal**2).sum(axis=0))
    return WallPoints(
        z, contours, boxes, normal / size, size * contours.weight, wall.symmetric, wall.sealing_gap
    )


def wall_functions(points: WallPoints, basis: Polynomials) -> WallFunctions:
    """Return the polynomials and their gradients, the last at fixed L_j, at points of a wall."""
    boxes = Boxes(*(part[:, None] for part in points.boxes))
    x = (points.contours.x - boxes.x0) / boxes.a
    y = (points.contours.y - boxes.y0) / boxes.b
    p = basis.values(x, y)
    other = None if basis.odd is None else not basis.odd
    p_x = np.tensordot(basis.dx, polynomials(basis.degree, other).values(x, y), 1) / boxes.a
    p_y = np.tensordot(basis.dy, p, 1) / boxes.b
    p_z = -(boxes.x0_z + boxes.a_z * x) * p_x - (boxes.y0_z + boxes.b_z * y) * p_y
    return WallFunctions(*(part.swapaxes(0, 1) for part in (p, p_x, p_y, p_z)))


def wall_matrices(
    points: WallPoints,
    functions: WallFunctions,
    edges: Array,
    layout: Layout,
    weight: Array,
    *,
    tangential: bool,
) -> tuple[Array, Array]:
    """Integrate over the wall with a weight.

    Parameters
    ----------
    points : WallPoints
    functions : WallFunctions
    edges : ndarray
        Borders of the elements in m.
    layout : Layout
    weight : ndarray
        (n_sections, n_points).
    tangential : bool
        Whether only gradients along the wall count.

    Returns
    -------
    stiffness, mass : ndarray
        int w grad p . grad q and int w p q, (n_elements, size, size).
    """
    p, p_x, p_y, p_z = functions
    share = (weight * points.area)[:, None]
    n_x, n_y, n_z = (part[:, None] for part in points.normal)

    def product(a: Array, b: Array) -> Array:
        return np.matmul(a * share, b.swapaxes(1, 2))

    mass = product(p, p)
    values = product(p_x, p_x) + product(p_y, p_y) + product(p_z, p_z)
    mixed, slopes = product(p, p_z), mass
    if tangential:
        across = n_x * p_x + n_y * p_y + n_z * p_z
        values -= product(across, across)
        mixed = mixed - product(n_z * p, across)
        slopes = product((1 - n_z**2) * p, p)
    n_points = len(points.z) // (len(edges) - 1)
    step, rule = np.diff(edges), gauss(n_points)
    stiffness = along_elements(step, layout, rule, slopes, mixed, values)
    return stiffness, along_elements(step, layout, rule, None, None, mass)
