"""The pressed tube in three dimensions."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from acoustube.reports.scenes.offscreen import Image, Mesh, View, rendering

if TYPE_CHECKING:  # the solvers, which a command that draws nothing does not need
    from acoustube.indentation import Indenter

LAYER = "#cfdccb"
WALL, LUMEN, SECTION, ROD, GROUND = "#d9c7b0", "#4f8fc0", "#b59f83", "#9aa3ad", "#e9e9e9"
STRIP_PIXELS = (2400, 260)
CLOSE_UP_PIXELS = (1800, 760)
STRIP_MAGNIFICATION = 3.0
"""Magnification of the cross-section in the view `strip`, relative to the scale along the tube."""


def drawing(walls: xr.Dataset) -> AbstractContextManager[Callable[[], dict[str, Image] | None]]:
    """Draw the tube of a run in a separate process, while this one goes on.

    Parameters
    ----------
    walls : xarray.Dataset
        A run, or its walls alone (:func:`acoustube.runs.results.walls`).

    Returns
    -------
    context manager of a callable
        See :func:`acoustube.reports.scenes.offscreen.rendering`; the pictures are named
        ``close_up`` and ``strip``.
    """
    from acoustube.runs.config import Mechanics, configured
    from acoustube.runs.config.si import press_in_si

    settings = json.loads(walls.attrs["configuration"])
    config = configured({name: settings[name] for name in ("tube", "indentation")}, Mechanics)
    press = press_in_si(config)
    thickness = None if press.layer is None else press.layer.thickness
    cut = half_walls(walls)
    return rendering(
        {"close_up": close_up(walls, cut, press.indenter, thickness), "strip": strip(cut)}
    )


def half_walls(dataset: xr.Dataset) -> dict[str, tuple[Any, Any]]:
    """Return the tube cut open at x = 0: points and triangles of its parts with x >= 0.

    Parameters
    ----------
    dataset : xarray.Dataset
        A run.

    Returns
    -------
    dict
        ``inner`` and ``outer`` wall, and the ``cut`` between them at the bottom and the top; each
        with points (n, 3) in m and triangles (m, 3).
    """
    inner, outer = dataset["inner_wall"].values, dataset["outer_wall"].values
    middle = inner.shape[1] // 2
    # The first half of a ring runs from bottom to top on the side x > 0.
    behind = [wall[:, : middle + 1] for wall in (inner, outer)]
    edges = [np.stack([inner[:, i], outer[:, i]], axis=1) for i in (0, middle)]
    parts = {"inner": behind[:1], "outer": behind[1:], "cut": edges}
    return {name: _joined([_strip(sheet) for sheet in sheets]) for name, sheets in parts.items()}


def _strip(sheet: NDArray[np.float64]) -> tuple[Any, Any]:
    """Return the points (n m, 3) and the triangles of a grid of points (n, m, 3)."""
    from acoustube.reports.page import shapes

    number = np.arange(sheet.shape[0] * sheet.shape[1]).reshape(sheet.shape[:2])
    return sheet.reshape(-1, 3), shapes.strip(number)


def _joined(meshes: list[tuple[Any, Any]]) -> tuple[Any, Any]:
    """Return several meshes, each of points and triangles, as one mesh."""
    offsets = np.cumsum([0, *(len(points) for points, _ in meshes)])
    faces = [faces + offset for (_, faces), offset in zip(meshes, offsets, strict=False)]
    return np.concatenate([points for points, _ in meshes]), np.concatenate(faces)


def _walls(walls: dict[str, tuple[Any, Any]], magnification: float) -> list[Mesh]:
    """Return the surfaces of the opened tube along z, with x and y magnified."""
    scale = [magnification, magnification, 1.0]
    return [
        Mesh(
            points=walls[name][0] * scale,
            faces=walls[name][1],
            look={"color": colour, "smooth_shading": name != "cut", "ambient": 0.25},
        )
        for name, colour in (("outer", WALL), ("inner", LUMEN), ("cut", SECTION))
    ]


def close_up(
    dataset: xr.Dataset,
    walls: dict[str, tuple[Any, Any]],
    press: Indenter,
    layer: float | None = None,
) -> View:
    """Return a view of the pressed part in true proportions, with the indenter and the ground.

    Parameters
    ----------
    dataset : xarray.Dataset
        A run.
    walls : dict
        From :func:`half_walls` of the run.
    press : Indenter
    layer : float, optional
        Thickness of the elastic layer under the tube in m, if there is one.
    """
    position = float(dataset["true_distance"])
    outer = dataset["outer_wall"].values - [0.0, 0.0, position]
    size = float(np.ptp(outer[0, :, 1]))
    shaded = {"smooth_shading": True, "split_sharp_edges": True}
    points, faces = tool_behind(press, outer)
    moved = [0.0, 0.0, position]
    tool = Mesh(points=points + moved, faces=faces, look={"color": ROD, "ambient": 0.35, **shaded})
    side, far = (-0.4 * size, 1.4 * size), 6 * size
    if layer is None:
        points, faces = _slab(*side, -0.56 * size, -0.5 * size, far)
        look: dict[str, Any] = {"color": GROUND}
    else:
        sheets = layer_sheets(outer, side, far, -0.5 * size - min(layer, size))
        points, faces = _joined([_strip(sheet) for sheet in sheets])
        look = {"color": LAYER, **shaded}
    floor = Mesh(points=points + moved, faces=faces, look=look)
    camera = {
        "focal_point": (0, 0.25 * size, position),
        "position": (-6.0 * size, 2.6 * size, position - 3.6 * size),
        "up": (0, 1, 0),
        "view_angle": 21,
        "clipping_range": (0.1 * size, 40 * size),
    }
    return View(pixels=CLOSE_UP_PIXELS, meshes=(*_walls(walls, 1.0), tool, floor), camera=camera)


def _slab(left: float, right: float, bottom: float, top: float, far: float) -> tuple[Any, Any]:
    """Return points and triangles of a box from -far to far along the tube."""
    import trimesh

    box = trimesh.creation.box(bounds=[[left, bottom, -far], [right, top, far]])
    return np.asarray(box.vertices), np.asarray(box.faces)


def tool_behind(press: Indenter, outer: Any) -> tuple[Any, Any]:
    """Return points (n, 3) in m and triangles of the half x >= 0 of an indenter on the wall.

    Parameters
    ----------
    press : Indenter
    outer : array of shape (n_rings, n_around, 3)
        The outer wall in m, the press at z = 0.
    """
    from acoustube.reports.page.shapes import tool, tool_height

    made = tool(press, float(np.ptp(outer[0, :, 1])))
    return made.points + np.array([0, tool_height(press, outer.reshape(-1, 3)), 0]), made.faces


def layer_sheets(outer: Any, side: tuple[float, float], far: float, bottom: float) -> list[Any]:
    """Return the top and the front of an elastic layer, as grids of points (n, m, 3) in m.

    The top is lowered where the tube sinks into the layer.

    Parameters
    ----------
    outer : array of shape (n_rings, n_around, 3)
        The outer wall in m, the press at z = 0.
    side : tuple of float
        Least and greatest x of the layer in m.
    far : float
        Extent of the layer along the tube to each side of the press, in m.
    bottom : float
        Height y of the layer's underside in m.
    """
    rings = outer[np.abs(outer[:, 0, 2]) <= far]
    unloaded = outer[0, :, 1].min()
    x = np.linspace(*side, 160)
    sheet = []
    for ring in rings:
        lower = ring[ring[:, 1] < ring[:, 1].mean()]
        lower = lower[np.argsort(lower[:, 0])]
        y = np.minimum(np.interp(x, lower[:, 0], lower[:, 1], np.inf, np.inf), unloaded)
        sheet.append(np.stack([x, y, np.full_like(x, ring[0, 2])], axis=-1))
    top = np.array(sheet)
    below = top[:, 0] * [1.0, 0.0, 1.0] + [0.0, bottom, 0.0]
    return [top, np.stack([top[:, 0], below])]


def strip(walls: dict[str, tuple[Any, Any]]) -> View:
    """Return a view of the whole tube; the picture's width is exactly the tube's length.

    The tube is seen from x < 0, so that distances grow to the right, as in plots.

    Parameters
    ----------
    walls : dict
        From :func:`half_walls`.
    """
    length = float(walls["outer"][0][:, 2].max())
    camera = {
        "parallel_projection": True,
        "focal_point": (0, 0, length / 2),
        # From a little above, at a right angle to the axis, so that it is drawn to scale.
        "position": (-length * np.cos(0.35), length * np.sin(0.35), length / 2),
        "up": (0, 1, 0),
        "parallel_scale": 0.5 * length * STRIP_PIXELS[1] / STRIP_PIXELS[0],
        "clipping_range": (0.01 * length, 10 * length),
    }
    meshes = tuple(_walls(walls, STRIP_MAGNIFICATION))
    return View(pixels=STRIP_PIXELS, meshes=meshes, camera=camera)
