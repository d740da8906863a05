"""The lumen: the air space of the pressed tube, as a watertight surface and as a profile."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from acoustube.errors import ConfigError, SimulationError
from acoustube.indentation import Indentation, Mesh
from acoustube.indentation.self_contact import triangulated

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FACETS_PER_ELEMENT = 6
"""Around: 240 facets for the default mesh, whose area is 1.5e-4 under the circle's."""
RINGS_PER_ELEMENT = 6
TRIANGLES_PER_EDGE = 8
"""Of an element's face, where sections are measured."""
PROJECTION_STEPS = 30
LEAST_STEEPNESS = 0.1
"""Least distance to the centre of curvature, as a share of the radius, that a step is taken for."""


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
    symmetric : bool
        Whether it is symmetric about x = 0.
    """

    rings: Array
    outer_rings: Array
    position: float
    symmetric: bool = True

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
    """Return the deformed inner or outer wall of the modelled part, finely sampled.

    Parameters
    ----------
    indentation : Indentation
        Of a swept tube.
    increment : int, optional
        Which increment; the last by default.
    outer : bool, optional
        The outer wall instead of the inner.

    Returns
    -------
    array of shape (n_rings, n_around, 3)
        Rings in the order of z, in m: the finite-element interpolation itself, not a fit to the
        nodes. Rings start at the bottom and run up on the side x > 0; they are closed (the last
        point is next to the first).
    """
    return _wall(indentation.mesh, indentation.position(increment), outer=outer)


def _wall(mesh: Mesh, position: Array, *, outer: bool) -> Array:
    """Return rings of one wall of a swept mesh with its nodes at `position`."""
    assert mesh.sweep is not None
    along, around, _ = mesh.sweep.shape
    faces = mesh.outer_faces if outer else mesh.inner_faces
    u, v = (np.linspace(-1, 1, n + 1) for n in (FACETS_PER_ELEMENT, RINGS_PER_ELEMENT))
    local = np.stack(np.meshgrid(u, v, indexing="xy"), axis=-1).reshape(-1, 2)
    shapes, _ = mesh.face.shape_functions(local)
    patches = np.einsum("pn,fni->fpi", shapes, position[faces])
    patches = patches.reshape(along, around, len(v), len(u), 3).swapaxes(1, 2)
    # The last ring and the last point of an element are the first of the next.
    rings = np.concatenate([patches[:, :-1].reshape(-1, around, len(u), 3), patches[-1, -1:]])
    start = rings[:, :, :-1].reshape(len(rings), -1, 3)
    if not mesh.halved[0]:
        return start
    half = np.concatenate([start, rings[:, -1, -1:]], axis=1)
    return np.concatenate([half, half[:, -2:0:-1] * [-1, 1, 1]], axis=1)


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
    tangent, turn = curve.derivative(), curve.derivative(2)
    y, z = points[..., 1], points[..., 2]
    s = z.copy()
    for _ in range(PROJECTION_STEPS):
        offset = np.stack([y, z], axis=-1) - curve(s)
        error = np.sum(offset * tangent(s), axis=-1)
        # Newton's step; the share of the way to the centre of curvature slows a plain one.
        step = error / np.maximum(1 - np.sum(offset * turn(s), axis=-1), LEAST_STEEPNESS)
        s = s + step
        if np.abs(step).max() < 1e-12:
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
        If the tube is bent too sharply to be straightened.
    """
    tube, mesh = indentation.tube, indentation.mesh
    inner, outer = (deformed_wall(indentation, increment, outer=layer) for layer in (False, True))
    round_rings = [_wall(mesh, mesh.points, outer=layer)[-1] for layer in (False, True)]
    floor = round_rings[1][0, 1]
    walls = [_straight(wall, outer[:, 0], floor, mesh) for wall in (inner, outer)]
    reach = max(np.abs(wall[..., 2]).max() for wall in walls)
    room = min(position, tube.length - position)
    if not reach < room:
        raise ConfigError(
            f"position = {position} m is too near an end; the press needs {reach:.3f} m of tube "
            "on each side."
        )
    # The tube is taken as round again within one more outer diameter.
    round_from = reach + min(tube.outer_diameter, (room - reach) / 2)
    ends = position + np.array([-1, 1]) * round_from
    rings = [
        _whole(wall, ring, position, ends, tube.length)
        for wall, ring in zip(walls, round_rings, strict=True)
    ]
    return Lumen(rings=rings[0], outer_rings=rings[1], position=position, symmetric=mesh.halved[0])


def pressed_part(indentation: Indentation, increment: int = -1) -> Lumen:
    """Build the lumen of the deformed part alone, between short ends that are straight.

    Parameters
    ----------
    indentation : Indentation
    increment : int, optional
        Which increment; the last by default.

    Returns
    -------
    Lumen
        As :func:`lumen`, the press in its middle.

    Raises
    ------
    SimulationError
        If the tube is bent too sharply to be straightened.
    """
    tube = indentation.tube
    # A tube that tilts off the floor gains a little length when it is straightened.
    half = 1.02 * float(indentation.mesh.points[:, 2].max()) + 2 * tube.outer_diameter
    short = dataclasses.replace(tube, length=2 * half)
    return lumen(dataclasses.replace(indentation, tube=short), half, increment)


def whole_tube(part: Lumen, position: float, length: float) -> Lumen:
    """Return the lumen of a whole tube from that of its pressed part.

    Parameters
    ----------
    part : Lumen
        From :func:`pressed_part`.
    position, length : float
        Of the press and of the tube, in m.

    Returns
    -------
    Lumen

    Raises
    ------
    ConfigError
        If the pressed part does not fit between the tube's ends.
    """
    shift = np.array([0.0, 0.0, position - part.position])

    def longer(rings: Array) -> Array:
        moved = rings + shift
        if not 0 < moved[1, :, 2].min() <= moved[-2, :, 2].max() < length:
            raise ConfigError(
                f"position = {position} m is too near an end; the press needs {part.position:.3f} "
                "m of tube on each side."
            )
        moved[0, :, 2], moved[-1, :, 2] = 0.0, length
        return moved

    return dataclasses.replace(
        part, rings=longer(part.rings), outer_rings=longer(part.outer_rings), position=position
    )


def _straight(wall: Array, bottom: Array, floor: float, mesh: Mesh) -> Array:
    """Straighten the rings of both sides of the press along the tube's bottom line.

    That line comes to lie at the height `floor`, where that of the straight tube lies: on a soft
    layer the press takes the whole tube down.
    """
    middle = 0 if mesh.halved[1] else int(np.argmin(np.abs(bottom[:, 2])))
    risen = np.array([0.0, floor - bottom[middle, 1], 0.0])
    wall, bottom = wall + risen, bottom + risen
    if mesh.halved[1]:
        half = straighten(wall, bottom)
        return np.concatenate([half[:0:-1] * [1, 1, -1], half])
    mirror = np.array([1, 1, -1])
    before = straighten(wall[middle::-1] * mirror, bottom[middle::-1] * mirror) * mirror
    return np.concatenate([before[:0:-1], straighten(wall[middle:], bottom[middle:])])


def _whole(pressed: Array, ring: Array, position: float, ends: Array, length: float) -> Array:
    """Add undeformed rings to the pressed ones, from `ends` to the ends of the tube."""
    z = np.array([0, *ends, length])
    straight = ring * [1, 1, 0] + z[:, None, None] * [0, 0, 1]
    moved = pressed + np.array([0, 0, position])
    return np.concatenate([straight[:2], moved, straight[2:]])


def inner_wall(mesh: Mesh) -> tuple[Any, Index]:
    """Return the sampling and the triangles with which sections of a lumen are measured."""
    return triangulated(mesh, parts=TRIANGLES_PER_EDGE)


def measure(
    indentation: Indentation,
    increment: int,
    z: Array,
    wall: tuple[Any, Index] | None = None,
) -> Profile:
    """Measure the lumen of the whole tube across planes z = const of the pressed part.

    Parameters
    ----------
    indentation : Indentation
    increment : int
    z : array of shape (n,)
        Deformed axial positions in m, the middle of the modelled part at zero.
    wall : optional
        What :func:`inner_wall` returned, so that it need not be formed for every increment.

    Returns
    -------
    Profile
    """
    mesh = indentation.mesh
    sampling, triangles = wall or inner_wall(mesh)
    seen = np.abs(z) if mesh.halved[1] else z
    vertices = sampling @ indentation.position(increment)
    found = profile(vertices, triangles, seen, halved=mesh.halved[0])
    return dataclasses.replace(found, z=np.asarray(z, float))


def profile(vertices: Array, triangles: Index, z: Array, *, halved: bool = False) -> Profile:
    """Cut a tube-like surface by the planes z = const and measure the sections.

    Parameters
    ----------
    vertices : array of shape (n_vertices, 3)
        In m.
    triangles : array of shape (n_triangles, 3)
        Consistently oriented.
    z : array of shape (n,)
        Where to cut, in m.
    halved : bool
        Whether the surface is the half x >= 0 of a symmetric one, which is measured.

    Returns
    -------
    Profile
        Zero where a plane does not meet the surface.

    Notes
    -----
    The area is half the sum of ``x dy - y dx`` over the segments in which the plane cuts the
    triangles, so that neither their order nor the closing line x = 0 of a half matters.
    """
    z = np.asarray(z, float)
    plane, start, end = _segments(vertices, triangles, z)
    cross = start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0]
    area = 0.5 * np.abs(np.bincount(plane, cross, minlength=z.size))
    x = np.concatenate([start[:, 0], end[:, 0]])
    left, right = _extent(np.tile(plane, 2), x, z.size)
    middle = start[:, 0] * end[:, 0] <= 0
    run = np.where(middle, end[:, 0] - start[:, 0], 1.0)
    share = np.divide(-start[:, 0], run, out=np.zeros_like(run), where=run != 0)
    y = start[:, 1] + share * (end[:, 1] - start[:, 1])
    bottom, top = _extent(plane[middle], y[middle], z.size)
    return Profile(
        z=z,
        area=2 * area if halved else area,
        height=top - bottom,
        width=2 * right if halved else right - left,
    )


def _segments(vertices: Array, triangles: Index, z: Array) -> tuple[Index, Array, Array]:
    """Return where planes cut triangles: number of the plane, start and end (n, 2) in it.

    A corner in the plane counts as below it.
    """
    order = np.argsort(z, kind="stable")
    heights = vertices[triangles, 2]
    first = np.searchsorted(z[order], heights.min(axis=1), side="left")
    count = np.searchsorted(z[order], heights.max(axis=1), side="left") - first
    which = np.repeat(np.arange(len(triangles)), count)
    within = np.arange(which.size) - np.repeat(np.cumsum(count) - count, count)
    plane = order[np.repeat(first, count) + within]
    corners = vertices[triangles[which]]
    below = corners[..., 2] <= z[plane, None]
    lone_below = below.sum(axis=1) == 1
    lone = np.argmax(below == lone_below[:, None], axis=1)
    turned = np.take_along_axis(corners, (lone[:, None] + np.arange(3))[..., None] % 3, axis=1)
    ahead, behind = (_crossing(turned[:, 0], turned[:, i], z[plane]) for i in (1, 2))
    forwards = lone_below[:, None]
    return plane, np.where(forwards, ahead, behind), np.where(forwards, behind, ahead)


def _crossing(a: Array, b: Array, z: Array) -> Array:
    """Return where the lines from a to b pass z, as (x, y)."""
    share = (z - a[:, 2]) / (b[:, 2] - a[:, 2])
    return a[:, :2] + share[:, None] * (b - a)[:, :2]


def _extent(plane: Index, values: Array, n: int) -> tuple[Array, Array]:
    """Return the least and the greatest of the values in each of n planes, zero where none is."""
    low, high = np.full(n, np.inf), np.full(n, -np.inf)
    np.minimum.at(low, plane, values)
    np.maximum.at(high, plane, values)
    met = high >= low
    return np.where(met, low, 0.0), np.where(met, high, 0.0)
