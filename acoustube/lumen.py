"""The lumen: the air space of the pressed tube, as a watertight surface and as a profile."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from acoustube.errors import ConfigError, SimulationError
from acoustube.indentation import Indentation
from acoustube.indentation.element import lagrange

Array = NDArray[np.float64]

FACETS_PER_ELEMENT = 8
"""Around: 192 facets for the default mesh, whose area is 2e-4 under the circle's."""
RINGS_PER_ELEMENT = 6
PROJECTION_STEPS = 20


@dataclass(frozen=True, eq=False)
class Lumen:
    """The air space of the whole tube, and the outer wall around it.

    Parameters
    ----------
    rings : array of shape (n_rings, n_around, 3)
        The inner wall as a stack of rings from end to end: points (x, y, z) in m,
        anticlockwise seen from the far end, the first at the bottom and the middle one at the
        top; z runs from 0 at the source end to the tube's length.
    outer_rings : array of shape (n_rings, n_around, 3)
        The outer wall likewise.
    position : float
        Where along z the press is, in m.
    """

    rings: Array
    outer_rings: Array
    position: float

    @property
    def surface(self) -> trimesh.Trimesh:
        """The air space's closed surface, with flat caps at both ends, in m, pointing outwards."""
        return trimesh.Trimesh(
            self.rings.reshape(-1, 3), ring_faces(*self.rings.shape[:2]), process=False
        )


@dataclass(frozen=True, eq=False)
class Profile:
    """The lumen's cross-section along the tube; every array has shape (n,).

    Parameters
    ----------
    z : array
        Distance from the source end in m.
    area : array
        In m2.
    height : array
        Distance in m from the bottom to the top of the section at x = 0.
    width : array
        Greatest extent across, in m.
    """

    z: Array
    area: Array
    height: Array
    width: Array


def ring_faces(n_rings: int, n_around: int) -> NDArray[np.int64]:
    """Return the triangles (n, 3) that close a stack of rings, numbered ring by ring."""
    number = np.arange(n_rings * n_around).reshape(n_rings, n_around)
    a, c = number[:-1], number[1:]
    b, d = np.roll(a, -1, axis=1), np.roll(c, -1, axis=1)
    wall = [np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, d), (a, d, c))]
    return np.concatenate([*wall, _fan(number[0])[:, ::-1], _fan(number[-1])])


def _fan(rim: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return triangles that span a convex rim from its first point."""
    return np.stack([np.full(len(rim) - 2, rim[0]), rim[1:-1], rim[2:]], axis=-1)


def deformed_wall(indentation: Indentation, increment: int = -1, *, outer: bool = False) -> Array:
    """Return the deformed inner or outer wall of the modelled half, finely sampled.

    Parameters
    ----------
    indentation : Indentation
    increment : int, optional
        Which increment; the last by default.
    outer : bool, optional
        The outer wall instead of the inner.

    Returns
    -------
    array of shape (n_rings, n_around, 3)
        Rings of the half z >= 0, from the press outwards, in m: the finite-element
        interpolation itself, not a fit to the nodes. Rings start at the bottom and run up on the
        side x > 0; they are closed (the last point is next to the first).
    """
    layer = -1 if outer else 0
    nodes = indentation.mesh.nodes[:, :, layer]
    nodes = nodes + indentation.displacement[increment, :, :, layer]
    half = _refine(_refine(nodes, RINGS_PER_ELEMENT, axis=0), FACETS_PER_ELEMENT, axis=1)
    mirrored = half[:, -2:0:-1] * [-1, 1, 1]
    return np.concatenate([half, mirrored], axis=1)


def _refine(nodes: Array, parts: int, axis: int) -> Array:
    """Sample quadratic elements along an axis, `parts` intervals each."""
    local = np.linspace(-1, 1, parts + 1)[:-1]
    shapes, _ = lagrange(local)
    moved = np.moveaxis(nodes, axis, 0)
    corners = np.stack([moved[0:-1:2], moved[1::2], moved[2::2]], axis=1)
    fine = np.einsum("pn,en...->ep...", shapes, corners).reshape(-1, *moved.shape[1:])
    return np.moveaxis(np.concatenate([fine, moved[-1:]]), 0, axis)


def straighten(points: Array, line: Array) -> Array:
    """Express points in coordinates along and across a curve in the plane x = 0.

    A tube on a free support tilts off the floor beside the press. Sound follows it round so gentle
    a bend; the wave solver wants it straight.

    Parameters
    ----------
    points : array of shape (..., 3)
        Points (x, y, z) in m.
    line : array of shape (n, 3)
        The curve, from z = 0 outwards; its tangent at z = 0 is along z.

    Returns
    -------
    array of shape (..., 3)
        x unchanged; y the signed distance from the curve plus the height of its first point; z
        the arc length to the nearest point of the curve.

    Raises
    ------
    SimulationError
        If the curve bends more sharply than the points are far from it.
    """
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    # The chord is shorter than the arc by a relative (h kappa)^2 / 24, under 1e-5 here.
    curve = CubicSpline(arc, line[:, 1:], bc_type=((1, [0.0, 1.0]), (2, [0.0, 0.0])))
    tangent, y, z = curve.derivative(), points[..., 1], points[..., 2]
    s = z.copy()
    for _ in range(PROJECTION_STEPS):
        offset = np.stack([y, z], axis=-1) - curve(s)
        error = np.sum(offset * tangent(s), axis=-1)
        s = s + error
        if np.abs(error).max() < 1e-12:
            break
    else:
        raise SimulationError("The pressed tube is bent too sharply to be straightened.")
    direction = tangent(s)
    normal = np.stack([direction[..., 1], -direction[..., 0]], axis=-1)
    across = np.sum((np.stack([y, z], axis=-1) - curve(s)) * normal, axis=-1)
    return np.stack([points[..., 0], line[0, 1] + across, s], axis=-1)


def lumen(indentation: Indentation, position: float, increment: int = -1) -> Lumen:
    """Build the lumen of the whole tube: the deformed part, and the straight rest.

    Parameters
    ----------
    indentation : Indentation
    position : float
        Distance in m from the source end to the press, along the tube.
    increment : int, optional
        Which increment; the last by default.

    Returns
    -------
    Lumen
        Straightened along the tube's bottom line (which in a held tube is straight already).

    Raises
    ------
    ConfigError
        If the modelled part does not fit between the tube's ends.
    SimulationError
        If opposite walls have passed through each other.
    """
    tube = indentation.tube
    inner, outer = (deformed_wall(indentation, increment, outer=layer) for layer in (False, True))
    if np.min(inner[:, inner.shape[1] // 2, 1] - inner[:, 0, 1]) <= 0:
        raise SimulationError(
            f"The lumen is closed at a depth of {1e3 * indentation.depth[increment]:.2f} mm, "
            "which the wave model does not hold for; ask for less depth."
        )
    bottom = outer[:, 0]
    walls = [straighten(wall, bottom) for wall in (inner, outer)]
    reach = max(wall[..., 2].max() for wall in walls)
    room = min(position, tube.length - position)
    if not reach < room:
        raise ConfigError(
            f"position = {position} m is too near an end; the press needs {reach:.3f} m of tube "
            "on each side."
        )
    # The tube is taken as round again within one more outer diameter.
    round_from = reach + min(tube.outer_diameter, (room - reach) / 2)
    rings = [
        _whole(wall, diameter / 2, position, round_from, tube.length)
        for wall, diameter in zip(walls, (tube.inner_diameter, tube.outer_diameter), strict=True)
    ]
    return Lumen(rings=rings[0], outer_rings=rings[1], position=position)


def _whole(half: Array, radius: float, position: float, round_from: float, length: float) -> Array:
    """Mirror the rings of the pressed half, and add round ones from there to the tube's ends."""
    mirrored = half[:0:-1] * [1, 1, -1]
    pressed = np.concatenate([mirrored, half])
    pressed[..., 2] += position
    angle = np.linspace(0, 2 * np.pi, half.shape[1], endpoint=False)
    circle = np.stack([radius * np.sin(angle), -radius * np.cos(angle), 0 * angle], axis=-1)
    z = np.array([0, position - round_from, position + round_from, length])
    straight = circle + z[:, None, None] * [0, 0, 1]
    return np.concatenate([straight[:2], pressed, straight[2:]])


def profile(rings: Array, z: Array) -> Profile:
    """Cut rings by the planes z = const and measure the sections.

    Parameters
    ----------
    rings : array of shape (n_rings, n_around, 3)
        A :attr:`Lumen.rings`, or the rings of :func:`deformed_wall`, in m. The first point of a
        ring is at the bottom, the middle one at the top.
    z : array of shape (n,)
        Where to cut, in m.

    Returns
    -------
    Profile
    """
    lines = np.moveaxis(rings, 1, 0)  # one curve along the tube for every point of a ring
    section = np.stack(
        [[np.interp(z, line[:, 2], line[:, i]) for line in lines] for i in (0, 1)], axis=-1
    )
    x, y = section[..., 0], section[..., 1]
    area = 0.5 * np.sum(x * np.roll(y, -1, axis=0) - y * np.roll(x, -1, axis=0), axis=0)
    return Profile(
        z=np.asarray(z, float),
        area=area,
        height=y[len(y) // 2] - y[0],
        width=x.max(axis=0) - x.min(axis=0),
    )
