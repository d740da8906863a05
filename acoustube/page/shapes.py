"""The pressed tube as surfaces, cut open along its length, with its section and its tool."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acoustube.indentation import Press
from acoustube.walls import thinned

Array = NDArray[np.float64]
Index = NDArray[np.int64]

OUTLINE_POINTS = 81
TOOL_RESOLUTION = 72
"""Facets around a tool."""
TOOL_LENGTH, TOOL_HEIGHT = 1.6, 0.95
"""How long a rod is drawn, and how much of a tool from below, in outer diameters of the tube."""


@dataclass(frozen=True, eq=False)
class Shape:
    """A pressed tube, cut open at x = 0; the press at z = 0.

    Attributes
    ----------
    points : array of shape (n, 3)
        In m.
    faces : dict of arrays of shape (m, 3)
        Triangles of the ``inner`` and the ``outer`` wall and of the ``cut`` between them, where
        x >= 0: seen from the open side, z runs to the right.
    inner, outer : array of shape (k, 2)
        Closed outlines (x, y) of the section at the press, in m.
    """

    points: Array
    faces: dict[str, Index]
    inner: Array
    outer: Array


@dataclass(frozen=True, eq=False)
class Tool:
    """A tool, its lowest point at the origin.

    Attributes
    ----------
    points : array of shape (n, 3)
        In m; its half x >= 0.
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
        With no more rings and points than :func:`acoustube.walls.thinned` leaves.
    """
    here = int(np.argmin(np.abs(inner[:, 0, 2])))
    sections = [_closed(wall[here, :, :2]) for wall in (inner, outer)]
    inner, outer = thinned(inner, outer)
    middle = inner.shape[1] // 2
    # Rings run up on the side x > 0.
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
    """Return the shape of a tube that nothing presses, `reach` to each side; all in m."""
    angle = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    z = np.linspace(-reach, reach, 3)
    circle = np.stack([np.sin(angle), -np.cos(angle)], axis=-1)

    def rings(radius: float) -> Array:
        ring = np.broadcast_to(radius * circle, (len(z), *circle.shape))
        along = np.broadcast_to(z[:, None, None], (len(z), len(circle), 1))
        return np.concatenate([ring, along], axis=-1)

    return from_rings(rings(bore / 2), rings(bore / 2 + wall))


def strip(number: Index) -> Index:
    """Return triangles of an open sheet of points, from their numbers (n, m)."""
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    return np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, b, d), (a, d, c))])


def _closed(outline: Array) -> Array:
    return np.concatenate([outline, outline[:1]])


def underside(press: Press, x: Array, z: Array) -> Array:
    """Return how far a tool's lower side is above its lowest point, in m; nan beside it.

    Parameters
    ----------
    press : Press
    x, z : array
        In m.
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


def tool_height(press: Press, outer: Array) -> float:
    """Return the height in m of the lowest point of a tool that just touches points (n, 3)."""
    gap = outer[:, 1] - underside(press, outer[:, 0], outer[:, 2])
    return float(np.nanmax(gap))


def tool(press: Press, tube_diameter: float) -> Tool:
    """Return the surface of a tool, as long as the tube is thick, or nearly twice."""
    import pyvista

    radius, length = press.diameter / 2, TOOL_LENGTH * tube_diameter
    if press.shape == "rod":
        axis = np.cos(press.yaw), 0.0, np.sin(press.yaw)
        centre = press.x, radius, 0.0
        solid: Any = pyvista.Cylinder(
            center=centre, direction=axis, radius=radius, height=length,
            resolution=2 * TOOL_RESOLUTION,
        )  # fmt: skip
    elif press.shape == "sphere":
        solid = pyvista.Sphere(
            radius=radius, center=(press.x, radius, 0.0), direction=(0, 1, 0),
            theta_resolution=TOOL_RESOLUTION, phi_resolution=TOOL_RESOLUTION,
        )  # fmt: skip
    else:
        solid = _punch(press, TOOL_HEIGHT * tube_diameter)
    half = solid.triangulate().clean().clip_closed_surface(normal=(1, 0, 0), origin=(0, 0, 0))
    top = 0.999 * TOOL_HEIGHT * tube_diameter
    half = half.clip_closed_surface(normal=(0, -1, 0), origin=(0, top, 0))
    # Where two sides meet at an edge its points are doubled, so that it is drawn sharp.
    sharp = half.triangulate().compute_normals(split_vertices=True, feature_angle=40)
    x = np.linspace(-1.0, 1.0, OUTLINE_POINTS) * length / 2
    if press.shape != "rod":
        x = press.x + press.diameter / 2 * np.sin(0.5 * np.pi * np.linspace(-1, 1, OUTLINE_POINTS))
    y = underside(press, x, np.zeros_like(x))
    there = np.isfinite(y)
    return Tool(
        points=np.asarray(sharp.points, float),
        faces=np.asarray(sharp.regular_faces, np.int64),
        outline=np.stack([x[there], y[there]], axis=-1),
    )


def _punch(press: Press, height: float) -> Any:
    """Return an upright punch with a rounded edge, as a surface of revolution."""
    import pyvista

    radius, edge = press.diameter / 2, press.edge
    turn = np.linspace(0, np.pi / 2, 9)
    r = np.concatenate([[0.0], radius - edge + edge * np.sin(turn), [radius, 0.0]])
    y = np.concatenate([[0.0], edge - edge * np.cos(turn), [height, height]])
    angle = np.linspace(0, 2 * np.pi, TOOL_RESOLUTION, endpoint=False)
    rings = np.stack(
        [
            press.x + r[:, None] * np.cos(angle),
            np.broadcast_to(y[:, None], (len(r), len(angle))),
            r[:, None] * np.sin(angle),
        ],
        axis=-1,
    )
    number = np.arange(rings[..., 0].size).reshape(rings.shape[:2])
    faces = strip(np.concatenate([number, number[:, :1]], axis=1))
    return pyvista.PolyData.from_regular_faces(rings.reshape(-1, 3), faces.astype(int))
