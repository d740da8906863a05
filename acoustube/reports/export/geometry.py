"""Lumens as surfaces (STL, VTP) and presses as meshes (VTU), for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import trimesh
import xarray as xr

from acoustube.base.errors import ConfigError, SimulationError
from acoustube.base.report import counted
from acoustube.base.types import Array, Index
from acoustube.base.units import MM, MM2
from acoustube.base.writing import write
from acoustube.indentation import Indentation, Mesh
from acoustube.indentation.self_contact import triangulated
from acoustube.lumen import pressed_part, ring_faces
from acoustube.reports.export import vtu
from acoustube.reports.export.press import indentation_of, mesh_of, reached, settings_of
from acoustube.runs.sweep import store

PARTS = 8
"""Number of triangles along each edge of an element's face."""
SEAM = 1e-7
"""Distance from a symmetry plane below which a point is in it, divided by the surface's size."""
TEXT = """\
The air space of a pressed tube as closed surfaces, in mm, z along the tube, y up.

{what}.
"""
WHOLE = "The whole tube at the last depth, its source end at z = 0"
PRESSED = "The pressed part of the tube, the press at z = 0; a file for each depth, see lumens.csv:"
SWEPT = "The pressed parts of tubes, the press at z = 0; see lumens.csv for their cases:"
STRAIGHTENED = "straightened, with short straight ends, as acoustube scatter requires"
AS_IT_LIES = "not straightened, with flat ends"


def write_surfaces(run: xr.Dataset, folder: Path, suffix: str) -> str:
    """Write the lumen of the whole tube (simulate), or of the pressed part at each depth (indent).

    Parameters
    ----------
    run : xarray.Dataset
        Run of ``simulate`` or ``indent``.
    folder : Path
        Empty folder.
    suffix : {"stl", "vtp"}

    Returns
    -------
    str
        What was written, in words.

    Raises
    ------
    ConfigError
        If the run was written by a version with another mesh or fewer variables.
    """
    if "lumen_face" in run:
        points = run["inner_wall"].values.reshape(-1, 3)
        _save(_surface(points, run["lumen_face"].values), folder / f"lumen.{suffix}")
        what, found = WHOLE, f"lumen.{suffix}"
    else:
        count, shape = _write_lumens(run, folder, suffix)
        what, found = f"{PRESSED} {shape}", f"lumens at {count} depths, {shape},"
    write(folder / "README.txt", TEXT.format(what=what))
    return found


def _write_lumens(run: xr.Dataset, folder: Path, suffix: str) -> tuple[int, str]:
    """Write the lumen at each depth and a table; return the number of lumens and a description."""
    rows = reached(run)
    files = [f"lumen-{number:04d}.{suffix}" for number in range(1, len(rows) + 1)]
    surfaces, what = lumens(run)
    for file, surface in zip(files, surfaces, strict=True):
        _save(surface, folder / file)
    table = {"file": files, "depth_mm": MM * run["indentation_depth"].values[rows]}
    table["lumen_area_mm2"] = MM2 * run["lumen_area"].values[rows]
    write(folder / "lumens.csv", pd.DataFrame(table).to_csv(index=False))
    return len(rows), what


def write_swept(files: Sequence[Path], folder: Path, suffix: str) -> str:
    """Write the lumens of a sweep: one file for all cases that share a press.

    Parameters
    ----------
    files : sequence of Path
        Files of the sweep, from :func:`acoustube.runs.opening.files_of`.
    folder : Path
        Empty folder.
    suffix : {"stl", "vtp"}

    Returns
    -------
    str
        Numbers of lumens and cases, in words.

    Raises
    ------
    ConfigError
        If no file has walls: no case is pressed, or an earlier version wrote the sweep.
    """
    rows: list[dict[str, Any]] = []
    count = 0
    for path in files:
        walls = store.walls(path)
        if walls is None:
            continue  # the tube is untouched, or an earlier version wrote the file
        count += 1
        rings, file = walls["inner_wall"].values.astype(float), f"lumen-{count:04d}.{suffix}"
        _save(_surface(rings.reshape(-1, 3), ring_faces(*rings.shape[:2])), folder / file)
        cases, _ = store.read(path)
        known = cases[["depth", "lumen_area"]].to_dataframe()
        rows += [
            {
                "press": name,
                "file": file,
                "depth_mm": MM * case["depth"],
                "lumen_area_mm2": MM2 * case["lumen_area"],
            }
            for name, case in known.iterrows()
        ]
    if not rows:
        where = files[0].parent if files[1:] else files[0]
        raise ConfigError(
            f"{where} holds no walls of a pressed tube: no case is pressed, or an earlier version "
            "wrote the sweep; repeat the sweep in a new folder"
        )
    write(folder / "lumens.csv", pd.DataFrame(rows).to_csv(index=False))
    write(folder / "README.txt", TEXT.format(what=f"{SWEPT} {STRAIGHTENED}"))
    return f"{counted(count, 'lumen')} of {counted(len(rows), 'case')}"


def lumens(run: xr.Dataset) -> tuple[list[trimesh.Trimesh], str]:
    """Return the lumen of the pressed part at each depth, in m, the press at z = 0.

    Parameters
    ----------
    run : xarray.Dataset
        Run of ``indent``.

    Returns
    -------
    surfaces : list of trimesh.Trimesh
        Closed, with outward normals. The lumen of a round tube is straightened along its bottom
        line, between short ends of straight tube, by :func:`acoustube.lumen.pressed_part`. That of
        an imported wall, or of a tube bent too sharply to be straightened, is left as deformed.
    what : str
        Whether the lumens are straightened, in words.

    Raises
    ------
    ConfigError
        If the run was written by a version with another mesh or fewer variables.
    """
    if settings_of(run).tube.surface is None:
        indentation = indentation_of(run)
        rows = range(len(indentation.depth))
        try:
            return [_straightened(indentation, row) for row in rows], STRAIGHTENED
        except SimulationError:
            mesh, positions = indentation.mesh, [indentation.position(row) for row in rows]
            return [closed_wall(mesh, position) for position in positions], AS_IT_LIES
    mesh = mesh_of(run)
    if not len(mesh.inner_faces):
        raise ConfigError(
            "the run was written by a version of acoustube that did not keep which faces are the "
            "inner wall's; repeat acoustube indent, which stores the press"
        )
    moved = mesh.points + run["node_displacement"].values[reached(run)]
    return [closed_wall(mesh, position) for position in moved], AS_IT_LIES


def _straightened(indentation: Indentation, row: int) -> trimesh.Trimesh:
    part = pressed_part(indentation, row)
    surface = part.surface
    surface.apply_translation([0.0, 0.0, -part.position])
    return surface


def closed_wall(mesh: Mesh, position: Array) -> trimesh.Trimesh:
    """Return the inner wall of the whole tube, closed at each end by a fan of triangles.

    Parameters
    ----------
    mesh : Mesh
        Mesh, halved or not, whose inner wall is open only at the ends of the tube.
    position : array of shape (n_nodes, 3)
        Positions of the mesh's nodes in m.
    """
    sampling, faces = triangulated(mesh, parts=PARTS)
    points = sampling @ position
    for axis, halved in zip((0, 2), mesh.halved, strict=True):
        if halved:
            points, faces = _doubled(points, faces, axis)
    surface = _surface(*_capped(points, np.asarray(faces, np.int64)))
    surface.fix_normals()
    return surface


def _doubled(points: Array, faces: Index, axis: int) -> tuple[Array, Index]:
    """Add a surface's mirror image about coordinate `axis` = 0, sharing points in that plane."""
    own = np.arange(len(points))
    seam = np.abs(points[:, axis]) < SEAM * np.ptp(points, axis=0).max()
    number = np.where(seam, own, len(points) + np.cumsum(~seam) - 1)
    image = points[~seam].copy()
    image[:, axis] *= -1
    return np.concatenate([points, image]), np.concatenate([faces, number[faces][:, ::-1]])


def _capped(points: Array, faces: Index) -> tuple[Array, Index]:
    """Close each hole of a surface by a fan of triangles around the middle of its rim."""
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, first, count = np.unique(
        np.sort(edges, axis=1), axis=0, return_index=True, return_counts=True
    )
    following = dict(edges[first[count == 1]].tolist())
    while following:
        start, here = following.popitem()
        rim = [start]
        while here != start:
            rim.append(here)
            here = following.pop(here)
        middle, rim_points = len(points), np.array(rim)
        points = np.concatenate([points, points[rim_points].mean(axis=0, keepdims=True)])
        onward = np.roll(rim_points, -1)
        fan = np.stack([onward, rim_points, np.full(len(rim), middle)], axis=-1)
        faces = np.concatenate([faces, fan])
    return points, faces


def _surface(points: Array, faces: Index) -> trimesh.Trimesh:
    return trimesh.Trimesh(points, faces, process=False)


def _save(surface: trimesh.Trimesh, path: Path) -> None:
    """Write a surface, which is in m, to a file in mm, the unit in which surfaces are read."""
    points = MM * surface.vertices
    if path.suffix == ".stl":
        bare = trimesh.Trimesh(points, surface.faces, process=False)
        write(path, trimesh.exchange.stl.export_stl(bare))
        return
    import pyvista

    write(path, vtu.in_xml(pyvista.PolyData.from_regular_faces(points, surface.faces)))


def write_meshes(run: xr.Dataset, folder: Path) -> str:
    """Write the finite-element mesh and its displacements at each depth, for ParaView.

    Parameters
    ----------
    run : xarray.Dataset
        Run of ``simulate`` or ``indent``.
    folder : Path
        Empty folder.

    Returns
    -------
    str
        Number of depths, in words.
    """
    rows = reached(run)
    depths, displacements = run["indentation_depth"].values, run["node_displacement"].values
    vtu.write(mesh_of(run), depths[rows], displacements[rows], folder)
    return f"meshes at {len(rows)} depths"
