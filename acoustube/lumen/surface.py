"""Surface of the lumen: the deformed inner wall as rings of points, from end to end of the tube."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import NDArray

from acoustube.base.checks import FLAG, LENGTH, PLACE, checked
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.base.types import Array
from acoustube.indentation import Indentation, Mesh
from acoustube.indentation.self_contact import gap_at_pressure
from acoustube.lumen.profiles import INCREMENT, check_increment
from acoustube.lumen.straightening import straighten

FACETS_PER_ELEMENT = 6
"""Number of facets around the tube per element. The default mesh has 240 in all; their area is
smaller than the circle's by a relative 1.6e-4."""
RINGS_PER_ELEMENT = 6
"""Number of rings along the tube per element."""
SEALING_PRESSURE = 1e3
"""Contact pressure in Pa above which soft walls seal. It is far above the sound pressure, and less
than a hundredth of the pressure that the barrier of the self-contact exerts on silicone at half its
activation distance."""
STRAIGHTENING_ROOM = 1.02
"""Largest length of a bent pressed part, once straightened, relative to its undeformed length."""


@dataclass(frozen=True, eq=False)
class Lumen:
    """The air space of the whole tube, and the outer wall around it.

    Parameters
    ----------
    rings : array of shape (n_rings, n_around, 3)
        Inner wall as rings of points (x, y, z) in m. Each ring runs from the bottom over the top
        back to the bottom, anticlockwise seen from the far end. z runs from 0 at the source end to
        the length of the tube.
    outer_rings : array of shape (n_rings, n_around, 3)
        Outer wall likewise.
    position : float
        Position of the indenter along z, in m.
    symmetric : bool
        True if the lumen is symmetric about x = 0.
    sealing_gap : float
        Height in m of gaps whose walls are pressed together by `SEALING_PRESSURE`. They count as
        half sealed, although the barrier of the self-contact keeps them open. With 0, the default,
        no gap counts as sealed.
    same : float
        Distance in m up to which two rings, or the lumen and its mirror image, count as equal.
    """

    rings: Array
    outer_rings: Array
    position: float
    symmetric: bool = True
    sealing_gap: float = 0.0
    same: float = 1e-9

    @property
    def surface(self) -> trimesh.Trimesh:
        """Closed surface of the air space in m, with flat ends and outward normals."""
        return trimesh.Trimesh(
            self.rings.reshape(-1, 3), ring_faces(*self.rings.shape[:2]), process=False
        )


@checked(
    n_rings=Number(2, 1e6, "rings", whole=True),
    n_around=Number(3, 1e6, "points", whole=True),
)
def ring_faces(n_rings: int, n_around: int) -> NDArray[np.int64]:
    """Return the triangles of the closed surface through a stack of rings, with flat ends.

    Parameters
    ----------
    n_rings, n_around : int
        Number of rings, and of points on each ring. Points are numbered ring by ring.

    Returns
    -------
    array of int, shape (n_triangles, 3)
        Numbers of the points, with outward normals if the rings are anticlockwise seen from the
        last.

    Raises
    ------
    ConfigError
        If there are fewer than two rings, or three points per ring.
    """
    number = np.arange(n_rings * n_around).reshape(n_rings, n_around)
    a, c = number[:-1], number[1:]
    b, d = np.roll(a, -1, axis=1), np.roll(c, -1, axis=1)
    wall = [np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, b, d), (a, d, c))]
    return np.concatenate([*wall, _fan(number[0])[:, ::-1], _fan(number[-1])])


def _fan(rim: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the triangle fan of a convex polygon from its first point."""
    return np.stack([np.full(len(rim) - 2, rim[0]), rim[1:-1], rim[2:]], axis=-1)


@checked(indentation=Indentation, increment=INCREMENT, outer=FLAG)
def deformed_wall(indentation: Indentation, increment: int = -1, *, outer: bool = False) -> Array:
    """Return the deformed inner or outer wall of the modelled part as rings of points.

    Parameters
    ----------
    indentation : Indentation
        Indentation of a round (swept) tube.
    increment : int, optional
        Number of the increment; the last by default.
    outer : bool, optional
        Return the outer wall instead of the inner.

    Returns
    -------
    array of shape (n_rings, n_around, 3)
        Points in m, evaluated from the finite-element interpolation; rings in the order of z. Each
        ring runs from the bottom over the side x > 0; its last point is next to the first.

    Raises
    ------
    ConfigError
        If there is no such increment, or the wall is an imported one.
    """
    check_increment(indentation, increment)
    if indentation.mesh.sweep is None:
        raise ConfigError("indentation is of an imported wall; give one of a round tube")
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


@checked(indentation=Indentation, position=PLACE, increment=INCREMENT)
def lumen(indentation: Indentation, position: float, increment: int = -1) -> Lumen:
    """Build the lumen of the whole tube: the deformed part between undeformed ends.

    Parameters
    ----------
    indentation : Indentation
    position : float
        Distance in m from the source end to the indenter, along the tube.
    increment : int, optional
        Number of the increment; the last by default.

    Returns
    -------
    Lumen
        Straightened along the tube's bottom line, which is already straight in a held tube.

    Raises
    ------
    ConfigError
        If the modelled part does not fit between the tube's ends, there is no such increment, or
        the wall is an imported one.
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
        raise _too_near_an_end(position, tube.length, reach)
    # Over one more outer diameter at most, the section blends into the undeformed circle.
    round_from = reach + min(tube.outer_diameter, (room - reach) / 2)
    ends = position + np.array([-1, 1]) * round_from
    rings = [
        _with_ends(wall, ring, position, ends, tube.length)
        for wall, ring in zip(walls, round_rings, strict=True)
    ]
    sealing_gap = gap_at_pressure(
        SEALING_PRESSURE, indentation.barrier_distance, tube.shear_modulus
    )
    return Lumen(
        rings=rings[0], outer_rings=rings[1], position=position, symmetric=mesh.halved[0],
        sealing_gap=sealing_gap,
    )  # fmt: skip


@checked(indentation=Indentation, increment=INCREMENT)
def pressed_part(indentation: Indentation, increment: int = -1) -> Lumen:
    """Build the lumen of the deformed part, between short undeformed ends.

    Parameters
    ----------
    indentation : Indentation
    increment : int, optional
        Number of the increment; the last by default.

    Returns
    -------
    Lumen
        As returned by :func:`lumen`, with the indenter in its middle.

    Raises
    ------
    ConfigError
        If there is no such increment, or the wall is an imported one.
    SimulationError
        If the tube is bent too sharply to be straightened.
    """
    tube = indentation.tube
    # A tube that lifts off the floor becomes slightly longer when it is straightened.
    half = STRAIGHTENING_ROOM * float(indentation.mesh.points[:, 2].max()) + 2 * tube.outer_diameter
    short = dataclasses.replace(tube, length=2 * half)
    return lumen(dataclasses.replace(indentation, tube=short), half, increment)


@checked(part=Lumen, position=PLACE, length=LENGTH)
def whole_tube(part: Lumen, position: float, length: float) -> Lumen:
    """Return the lumen of a whole tube from the lumen of its pressed part.

    Parameters
    ----------
    part : Lumen
        From :func:`pressed_part`.
    position, length : float
        Position of the indenter and length of the tube, in m.

    Raises
    ------
    ConfigError
        If the pressed part does not fit between the tube's ends.
    """
    walls = part.rings, part.outer_rings
    reach = max(np.abs(wall[2:-2, :, 2] - part.position).max() for wall in walls)
    room = min(position, length - position)
    if not reach < room:
        raise _too_near_an_end(position, length, reach)
    # The section blends into the circle as by `lumen`, over a shorter length near an end.
    blend = min(part.position - float(part.rings[1, 0, 2]) - reach, (room - reach) / 2)
    outer_z = np.array([0, position - reach - blend, position + reach + blend, length])

    def longer(rings: Array) -> Array:
        moved = rings + np.array([0.0, 0.0, position - part.position])
        moved[[0, 1, -2, -1], :, 2] = outer_z[:, None]
        return np.asarray(moved)

    return dataclasses.replace(
        part, rings=longer(part.rings), outer_rings=longer(part.outer_rings), position=position
    )


def _too_near_an_end(position: float, length: float, reach: float) -> ConfigError:
    """Return the error of a position that is not more than `reach` from both ends of a tube."""
    least = (np.floor(1e3 * reach) + 1) / 1e3  # in whole mm
    advice = f"use {least:.3f} m or more from both ends"
    if 2 * least > length:
        advice = f"use a tube of {2 * least:.3f} m or more"
    return ConfigError(
        f"is too near an end of the tube with length = {length:g} m", setting="position",
        value=position, unit="m", advice=advice,
    )  # fmt: skip


def _straight(wall: Array, bottom: Array, floor: float, mesh: Mesh) -> Array:
    """Straighten the rings along the tube's bottom line, on both sides of z = 0.

    The line is moved to the height `floor` of the undeformed tube, because on a soft layer the
    whole tube moves down.
    """
    middle = 0 if mesh.halved[1] else int(np.argmin(np.abs(bottom[:, 2])))
    risen = np.array([0.0, floor - bottom[middle, 1], 0.0])
    wall, bottom = wall + risen, bottom + risen
    if mesh.halved[1]:
        half = straighten(wall, bottom)
        return np.concatenate([half[:0:-1] * [1, 1, -1], half])
    # The line is put at the height `floor`, and its point nearest to z = 0 keeps its z.
    before = np.sum(np.linalg.norm(np.diff(bottom[: middle + 1], axis=0), axis=1))
    start = np.array([0.0, floor - bottom[0, 1], bottom[middle, 2] - before])
    return np.asarray(straighten(wall, bottom, level=False) + start)


def _with_ends(pressed: Array, ring: Array, position: float, ends: Array, length: float) -> Array:
    """Add undeformed rings to deformed ones: at z = 0, at both z in `ends` and at z = length."""
    z = np.array([0, *ends, length])
    straight = ring * [1, 1, 0] + z[:, None, None] * [0, 0, 1]
    moved = pressed + np.array([0, 0, position])
    return np.concatenate([straight[:2], moved, straight[2:]])
