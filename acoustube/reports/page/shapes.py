"""The pressed tube as surfaces, cut open along its length, with its section and the indenter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acoustube.base.types import Array, Index
from acoustube.indentation import Indenter
from acoustube.lumen.thinning import decimate_rings

OUTLINE_POINTS = 81
TOOL_RESOLUTION = 72
"""Number of facets around half an indenter, and of points along the profile of a sphere."""
TOOL_LENGTH, TOOL_HEIGHT = 1.6, 0.95
"""Drawn length of a rod, and drawn height of an indenter, in outer diameters of the tube."""


@dataclass(frozen=True, eq=False)
class Shape:
    """Surfaces of a pressed tube, cut open at x = 0, with the press at z = 0.

    Attributes
    ----------
    points : array of shape (n, 3)
        Points of the surfaces in m.
    faces : dict of arrays of shape (m, 3)
        Triangles of the ``inner`` and the ``outer`` wall and of the ``cut`` between them, all at
        x >= 0. Seen from the open side, z runs to the right.
    inner, outer : array of shape (k, 2)
        Closed outlines (x, y) of the section at the press, in m.
    """

    points: Array
    faces: dict[str, Index]
    inner: Array
    outer: Array


@dataclass(frozen=True, eq=False)
class Tool:
    """Surface of an indenter, with its lowest point at y = z = 0.

    Attributes
    ----------
    points : array of shape (n, 3)
        Points of its half x >= 0 in m.
    faces : array of shape (m, 3)
    outline : array of shape (k, 2)
        Its lower side (x, y) in the plane z = 0, in m.
    """

    points: Array
    faces: Index
    outline: Array


def from_rings(inner: Array, outer: Array) -> Shape:
    """Return the shape of a tube from rings of its walls.

    Parameters
    ----------
    inner, outer : array of shape (n_rings, n_around, 3)
        Rings in m as in :class:`acoustube.lumen.Lumen`, the press at z = 0.

    Returns
    -------
    Shape
        Its points are those that :func:`acoustube.lumen.thinning.decimate_rings` keeps.
    """
    here = int(np.argmin(np.abs(inner[:, 0, 2])))
    sections = [_closed(wall[here, :, :2]) for wall in (inner, outer)]
    inner, outer = decimate_rings(inner, outer)
    middle = inner.shape[1] // 2
    # The first half of a ring runs from bottom to top on the side x > 0.
    halves = [wall[:, : middle + 1] for wall in (inner, outer)]
    n = halves[0][..., 0].size
    number = np.arange(2 * n).reshape(2, *halves[0].shape[:2])
    sheets = [number[:, :, i].T for i in (0, -1)] + [number[:, i].T for i in (0, -1)]
    return Shape(
        points=np.concatenate([half.reshape(-1, 3) for half in halves]),
        faces={
            "inner": strip(number[0]),
            "outer": strip(number[1]),
            "cut": np.concatenate([strip(sheet) for sheet in sheets]),
        },
        inner=sections[0],
        outer=sections[1],
    )


def round_tube(bore: float, wall: float, reach: float) -> Shape:
    """Return the shape of an untouched tube from z = -reach to reach; all lengths in m."""
    angle = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    z = np.linspace(-reach, reach, 3)
    circle = np.stack([np.sin(angle), -np.cos(angle)], axis=-1)

    def rings(radius: float) -> Array:
        ring = np.broadcast_to(radius * circle, (len(z), *circle.shape))
        along = np.broadcast_to(z[:, None, None], (len(z), len(circle), 1))
        return np.concatenate([ring, along], axis=-1)

    return from_rings(rings(bore / 2), rings(bore / 2 + wall))


def strip(number: Index) -> Index:
    """Return the triangles (k, 3) of a grid of points, given the indices of its points, (n, m)."""
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    return np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, d), (a, d, c))])


def _closed(outline: Array) -> Array:
    return np.concatenate([outline, outline[:1]])


def underside(press: Indenter, x: Array, z: Array) -> Array:
    """Return the height in m of an indenter's lower side above its lowest point; nan outside.

    Parameters
    ----------
    press : Indenter
    x, z : array
        Positions across and along the tube in m.
    """
    radius = press.diameter / 2
    x = x - press.x
    if press.shape == "rod":
        s = z * np.cos(press.yaw) - x * np.sin(press.yaw)
        edge = radius
    else:
        s = np.hypot(x, z)
        edge = radius if press.shape == "sphere" else press.edge
    beyond = np.maximum(np.abs(s) - (radius - edge), 0.0)
    inside = np.abs(s) <= radius
    height = edge - np.sqrt(np.maximum(edge**2 - beyond**2, 0.0))
    return np.where(inside, height, np.nan)


def tool_height(press: Indenter, outer: Array) -> float:
    """Return the height y in m of the lowest point of an indenter that touches points (n, 3) in m.

    The indenter rests on the points from above, without penetrating any.
    """
    gap = outer[:, 1] - underside(press, outer[:, 0], outer[:, 2])
    return float(np.nanmax(gap))


def tool(press: Indenter, tube_diameter: float) -> Tool:
    """Return the surface of an indenter: its half x >= 0, up to `TOOL_HEIGHT`.

    Parameters
    ----------
    press : Indenter
    tube_diameter : float
        Outer diameter of the tube in m.
    """
    radius, top = press.diameter / 2, TOOL_HEIGHT * tube_diameter
    reach = TOOL_LENGTH * tube_diameter / 2
    if press.shape == "rod":
        sheets = _rod(radius, press.yaw, min(top, 2 * radius), reach)
        x = np.linspace(-reach, reach, OUTLINE_POINTS)
    else:
        side = _sphere_side(radius, top) if press.shape == "sphere" else _punch_side(press, top)
        sheets = _turned(*side, press.x)
        x = press.x + radius * np.sin(0.5 * np.pi * np.linspace(-1, 1, OUTLINE_POINTS))
    y = underside(press, x, np.zeros_like(x))
    there = np.isfinite(y)
    starts = np.cumsum([0, *(sheet[..., 0].size for sheet in sheets)])
    numbers = [
        start + np.arange(sheet[..., 0].size).reshape(sheet.shape[:2])
        for start, sheet in zip(starts, sheets, strict=False)
    ]
    return Tool(
        points=np.concatenate([sheet.reshape(-1, 3) for sheet in sheets]),
        faces=np.concatenate([strip(number) for number in numbers]),
        outline=np.stack([x[there], y[there]], axis=-1),
    )


def _rod(radius: float, yaw: float, top: float, reach: float) -> list[Array]:
    """Return the surfaces of a horizontal cylinder that is cut off at height `top`.

    They are the half x >= 0 of its side, the flat top, the section at x = 0, and the end face, each
    a grid of points (n, m, 3) in m.
    """
    half = np.arccos(1 - top / radius)
    turn = np.linspace(-half, half, 2 * TOOL_RESOLUTION)
    s = _closed(np.stack([radius * np.sin(turn), radius * (1 - np.cos(turn))], axis=-1))
    across, y = s[:, 0], s[:, 1]

    def at(t: Array) -> Array:
        x, z = t * np.cos(yaw) - across * np.sin(yaw), t * np.sin(yaw) + across * np.cos(yaw)
        return np.stack([x, y, z], axis=-1)

    start = across * np.tan(yaw)
    # A thick rod at a large angle is drawn longer; otherwise the cut would be beyond its end.
    cut, end = at(start), at(np.full_like(across, max(reach, 1.2 * start.max())))
    # The flat top is a grid of its own, so that its edges are sharp.
    return [np.stack([cut, end])[:, :-1], np.stack([cut, end])[:, -2:], _cap(cut), _cap(end)]


def _sphere_side(radius: float, top: float) -> tuple[Array, Array]:
    """Return radius and height along the side of a sphere, from its lowest point up."""
    turn = np.linspace(0, np.arccos(1 - min(top, 2 * radius) / radius), TOOL_RESOLUTION)
    return radius * np.sin(turn), radius * (1 - np.cos(turn))


def _punch_side(press: Indenter, top: float) -> tuple[Array, Array]:
    """Return radius and height along the side of a punch, from its middle out and up."""
    edge, turn = press.edge, np.linspace(0, np.pi / 2, 13)
    flat = np.linspace(0, press.diameter / 2 - edge, 7)
    straight = np.linspace(min(edge, top), top, 5)[1:]
    r = [flat[:-1], press.diameter / 2 - edge + edge * np.sin(turn), np.full(4, press.diameter / 2)]
    y = [np.zeros(6), edge * (1 - np.cos(turn)), straight]
    return np.concatenate(r), np.concatenate(y)


def _turned(radius: Array, y: Array, x: float) -> list[Array]:
    """Return the half x >= 0 of a body of revolution: side, cut at x = 0, and top.

    Each is a grid of points (n, m, 3) in m.

    Parameters
    ----------
    radius, y : array of shape (n,)
        Radius and height in m along the side, from the lowest point up.
    x : float
        Position of the vertical axis in m.
    """
    # The points of each circle have x >= 0; a circle without such points becomes a single point.
    share = np.divide(-x, radius, out=np.full_like(radius, -np.sign(x)), where=radius > 0)
    reach = np.arccos(np.clip(share, -1, 1))
    if (reach > 0).any():
        y = np.clip(y, y[reach > 0].min(), y[reach > 0].max())
    angle = reach[:, None] * np.linspace(-1, 1, TOOL_RESOLUTION + 1)
    across = np.maximum(x + radius[:, None] * np.cos(angle), 0.0)
    z = np.where(reach[:, None] > 0, radius[:, None] * np.sin(angle), 0.0)
    side = np.stack([across, np.broadcast_to(y[:, None], z.shape), z], axis=-1)
    return [side, side[:, [0, -1]], _cap(_closed(side[-1]))]


def _cap(rim: Array) -> Array:
    """Return the surface inside a convex rim (n, 3), as a grid (2, n, 3) of rim and mean point."""
    return np.stack([rim, np.broadcast_to(rim.mean(axis=0), rim.shape)])
