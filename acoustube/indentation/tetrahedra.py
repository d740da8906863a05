"""Meshes of quadratic tetrahedra for a wall given as a closed surface (STL, PLY, OBJ or VTP).

A piece of the surface is cut out around the indenter and filled with linear tetrahedra by fTetWild
[1]_ (through ``pytetwild``), which :mod:`acoustube.indentation.boundary_nodes` makes quadratic.
fTetWild uses random numbers that cannot be seeded: each call returns another mesh, and the force
differs by some tenths of a per cent.

Notes
-----
The stiffness of the elements depends on the treatment of their volume ratio J. With J projected
onto a constant and a stabilisation modulus k on the unprojected part, the force error of the sleeve
paper's tube (a quarter, free, under a 25 mm rod at a depth of 2 mm), relative to the reference
solution of 1.0305 N, is (mu shear modulus, K bulk modulus):

==========================  =======  ======  ======  ======  =======  ==========
edges, in wall thicknesses  k = 0    4 mu    8 mu    10 mu   K        unknowns
==========================  =======  ======  ======  ======  =======  ==========
1                           -25.2 %  -3.3 %  +0.0 %  +0.9 %  +4.7 %   20 000
0.65                        -        -1.3 %  -0.2 %  -       +1.3 %   30 000
==========================  =======  ======  ======  ======  =======  ==========

Hexahedra have +0.1 %. The projection alone (k = 0) leaves hourglass modes without stiffness;
without it (k = K) the elements lock. Quadrature with 14 points in place of 4 changed the force by
0.6 % with k = 0 and by 1.5 to 2 % with k = K, on one layer of elements. The choice is k = 8 mu. At
4 mm its errors are +0.7 and +0.1 % for the two edges (k = K with the shorter edges +1.9 %,
hexahedra +0.3 %), and at 6 mm +3.8 and +2.0 % (+5.3 %, +1.2 %). The order of convergence falls: the
displacements of a smooth problem converge with order 2.2, not 3.

References
----------
.. [1] Y. Hu, T. Schneider, B. Wang, D. Zorin, D. Panozzo, "Fast tetrahedral meshing in the wild",
   ACM Trans. Graph. 39, 117 (2020). doi:10.1145/3386569.3392385
"""

from __future__ import annotations

import itertools
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from acoustube.base import moved
from acoustube.base.checks import check_fields
from acoustube.base.errors import ConfigError, SimulationError
from acoustube.base.rules import Number
from acoustube.base.types import Array, Index
from acoustube.base.units import PERCENT
from acoustube.indentation.boundary_nodes import ENVELOPE, Plane, jacobians, quadratic
from acoustube.indentation.mesh import Mesh
from acoustube.indentation.reference_element import TET10, edges
from acoustube.indentation.wall_surface import (
    SYMMETRY_TOLERANCE,
    check_thickness,
    separate_walls,
    symmetries,
)

MIN_QUALITY = 0.01
"""Smallest Jacobian determinant in an element, divided by that of a regular element with the same
mean square edge.

Meshes of a round and of a D-shaped bore had 0.045 to 0.2; below the limit, a single element stops
the solver."""
MAX_OFF_SURFACE = 0.01
"""Largest fraction of a wall's nodes off its surface, above which another mesh is tried.

Nodes stay off the surface where they would distort their elements. No node may be off
a flat end or a plane of symmetry."""
ATTEMPTS = 6
"""Largest number of meshes tried. About one in twenty has a flat element next to an end or a plane
of symmetry, one in twelve has more than `MAX_OFF_SURFACE` of a wall's nodes off its surface. Rarely
(in none of 200 meshes) a dented plane of symmetry is taken for a third wall."""
VOLUME_TOLERANCE = 0.01
"""Largest difference between the volumes of the mesh and of the wall, relative to the latter."""
CHILD = """
import numpy, pytetwild
arguments = {name: a if a.ndim else a.item() for name, a in numpy.load("in.npz").items()}
points, tetrahedra = pytetwild.tetrahedralize(**arguments)
numpy.savez("out.npz", points=points, tetrahedra=tetrahedra)
"""
"""Program of the child process that calls pytetwild."""
STOP_ENERGY = 15.0
"""Distortion energy (AMIPS) of the worst tetrahedron below which fTetWild ends the improvement of
a mesh; a regular tetrahedron has 3."""
SIZE_STATIONS = 33
"""Number of stations along the tube between which the edge length is interpolated."""


@dataclass(frozen=True, kw_only=True)
class TetrahedronSize:
    """Edge lengths of the elements.

    Parameters
    ----------
    fine, coarse : float
        Edge length near the indenter and far from it, in mean wall thicknesses.
    near, far : float
        Distances from the indenter between which the edges grow from `fine` to `coarse`, in outer
        heights of the tube.

    Raises
    ------
    ConfigError
        If an edge length is not positive, a distance is negative, or `near` is not below `far`.
    """

    fine: float = 0.65
    coarse: float = 1.8
    near: float = 1.0
    far: float = 3.0

    def __post_init__(self) -> None:
        """Check the ranges and the order of the distances."""
        edge, distance = Number(1e-2, 1e3, "wall thicknesses"), Number(0, 1e6, "outer heights")
        check_fields(self, fine=edge, coarse=edge, near=distance, far=distance)
        if self.near >= self.far:
            raise ConfigError(
                f"is not below far = {self.far:g}", setting="near", value=self.near,
                advice="use a smaller one",
            )  # fmt: skip


def tetrahedral_mesh(
    surface: trimesh.Trimesh,
    *,
    reach: float,
    halved: tuple[bool, bool] = (False, False),
    size: TetrahedronSize | None = None,
    note: Callable[[str], None] | None = None,
) -> Mesh:
    """Mesh a piece of a tube's wall with quadratic tetrahedra.

    Parameters
    ----------
    surface : trimesh.Trimesh
        From :func:`acoustube.runs.imported_wall.read_surface`, in m.
    reach : float
        Length of the piece to each side of z = 0, in m.
    halved : tuple of bool
        Symmetry of the load about x = 0, and about z = 0; where the wall is symmetric too, only
        x >= 0 or z >= 0 is meshed.
    size : TetrahedronSize, optional
        Edge lengths of the elements, the smallest about z = 0.
    note : callable, optional
        Called with a sentence where more than :data:`MAX_OFF_SURFACE` of the nodes of the best mesh
        are off the wall's surface.

    Returns
    -------
    Mesh
        The normals of its inner faces point into the wall, those of its outer faces away from it,
        as in :func:`acoustube.indentation.mesh.sweep`.

    Raises
    ------
    ConfigError
        If the piece is longer than the tube, the wall is too thin, or the mesh is not sound.
    SimulationError
        If fTetWild fails, as on a surface that intersects itself.
    """
    size = size or TetrahedronSize()
    whole = separate_walls(surface)
    if not 0 < reach <= (1 + 1e-9) * surface.extents[2] / 2:
        raise ConfigError(
            f"reach = {reach:.6g} m, the length of tube that the press takes on each side, is not "
            f"between 0 and {surface.extents[2] / 2:.6g} m, half the length of the surface; use a "
            "longer tube"
        )
    both = [Plane(2, -reach, 1), Plane(2, reach, -1)]
    symmetric = symmetries(_cut(surface, both), halved, SYMMETRY_TOLERANCE * whole.thickness)
    planes = [Plane(0, 0.0, 1)] * symmetric[0]
    planes += [Plane(2, 0.0, 1), both[1]] if symmetric[1] else both
    piece = _cut(surface, planes)
    z = np.linspace(piece.bounds[0, 2], piece.bounds[1, 2], SIZE_STATIONS)
    edge = whole.thickness * _edge_lengths(z, size, whole.outer.extents[1])
    check_thickness(piece, whole, edge)
    best, least = None, 1.0  # a mesh with a node off a plane, which counts as 1, is never accepted
    refused = 0
    for _ in range(ATTEMPTS):
        points, tetrahedra = _tetrahedralised(piece, z, edge, whole.thickness)
        try:
            mesh, off_surface = quadratic(points, tetrahedra, planes, whole, symmetric)
        except ConfigError:  # not two walls
            refused += 1
            if refused == ATTEMPTS:
                raise
            continue
        if off_surface < least and qualities(mesh.points, mesh.elements).min() > MIN_QUALITY:
            best, least = mesh, off_surface
        if least <= MAX_OFF_SURFACE:
            break
    if best is None:
        raise ConfigError(
            f"the wall could not be filled with well-shaped tetrahedra in {ATTEMPTS} attempts; "
            "repair the surface, or choose other edge lengths (from Python)"
        )
    _check_volume(best.points, best.elements, piece)
    if least > MAX_OFF_SURFACE and note is not None:
        note(
            f"{100 * least:.2g} % of the nodes on the wall are off its surface in the best of "
            f"{ATTEMPTS} meshes, over {100 * MAX_OFF_SURFACE:g} %: the force may err; smooth the "
            "surface."
        )
    return best


def _cut(surface: trimesh.Trimesh, planes: Sequence[Plane]) -> trimesh.Trimesh:
    """Return the closed part of a surface on one side of each plane."""
    import pyvista  # slow to import, and needed by imported surfaces only

    cut = pyvista.wrap(surface)
    for axis, value, side in planes:
        normal, origin = np.eye(3)[axis] * side, np.eye(3)[axis] * value
        cut = cut.clip_closed_surface(normal=normal, origin=origin)
    cut = cut.triangulate().clean(tolerance=1e-9 * surface.scale, absolute=True)
    return trimesh.Trimesh(np.asarray(cut.points, float), cut.regular_faces)


def _edge_lengths(z: Array, size: TetrahedronSize, height: float) -> Array:
    """Return the edge lengths at stations z in m, in wall thicknesses, for a tube's height in m."""
    return np.interp(np.abs(z) / height, [size.near, size.far], [size.fine, size.coarse])


def _tetrahedralised(
    piece: trimesh.Trimesh, z: Array, edge: Array, thickness: float
) -> tuple[Array, Index]:
    """Fill a closed surface with tetrahedra of edge lengths `edge` at stations `z`, all in m.

    Returns
    -------
    points : array of shape (n_points, 3)
        In m.
    tetrahedra : array of shape (n_tetrahedra, 4)
        Of positive volume.
    """
    box, cells = _column(piece.bounds, z)
    diagonal = float(np.linalg.norm(piece.extents))
    points, tetrahedra = _in_child(
        # In wall thicknesses, so that lengths are near one.
        vertices=piece.vertices / thickness,
        faces=piece.faces,
        edge_length_fac=edge.max() / diagonal,
        epsilon=ENVELOPE * thickness / diagonal,
        stop_energy=STOP_ENERGY,
        num_threads=1,
        bg_vertices=box / thickness,
        bg_tets=cells.astype(np.int32),
        bg_values=np.repeat(edge, 4) / thickness,
    )
    used, corners = np.unique(tetrahedra, return_inverse=True)
    points, corners = thickness * points[used], corners.reshape(-1, 4)
    return points, _positively_oriented(points, corners)


def _in_child(**arguments: Any) -> tuple[Array, Index]:
    """Run pytetwild in a child process; return points (n_points, 3) and tetrahedra (n, 4).

    In this process pytetwild would hold the global interpreter lock, so that interrupts wait for
    minutes, would write a file into the current folder, and might crash.
    """
    with tempfile.TemporaryDirectory() as folder:
        np.savez(Path(folder) / "in.npz", **arguments)
        command = [sys.executable, "-c", CHILD]
        try:
            subprocess.run(command, cwd=folder, capture_output=True, check=True)
        except subprocess.CalledProcessError as error:
            last = error.stderr.decode(errors="replace").strip().splitlines()[-1:]
            raise SimulationError(
                f"the wall could not be filled with tetrahedra ({''.join(last) or 'a crash'}); "
                "check that the surface does not intersect itself"
            ) from error
        with np.load(Path(folder) / "out.npz") as made:
            return made["points"], made["tetrahedra"]


def _column(bounds: Array, z: Array) -> tuple[Array, Index]:
    """Return the background mesh: boxes along z around a piece, each of six tetrahedra."""
    low, high = bounds + 0.1 * np.ptp(bounds[:, :2]) * np.array([[-1.0], [1.0]])
    z = z.copy()
    z[[0, -1]] = low[2], high[2]
    points = np.array([(x, y, s) for s in z for y in (low[1], high[1]) for x in (low[0], high[0])])
    # One tetrahedron for each order of the axes on the path from a box's first corner to its last.
    paths = [np.cumsum([0, *order]) for order in itertools.permutations((1, 2, 4))]
    cells = 4 * np.arange(len(z) - 1)[:, None, None] + np.array(paths)
    return points, _positively_oriented(points, cells.reshape(-1, 4))


def _positively_oriented(points: Array, tetrahedra: Index) -> Index:
    """Return tetrahedra with two corners swapped in those of negative volume."""
    negative = jacobians(points, tetrahedra)[:, 0] < 0
    return np.where(negative[:, None], tetrahedra[:, [0, 2, 1, 3]], tetrahedra)


def qualities(points: Array, elements: Index) -> Array:
    """Return the shape quality of tetrahedra.

    Parameters
    ----------
    points : array of shape (n_nodes, 3)
        In m.
    elements : array of int, shape (n_elements, 10)

    Returns
    -------
    array of shape (n_elements,)
        Smallest Jacobian determinant, divided by that of a regular tetrahedron with the same mean
        square edge.
    """
    corners = points[elements[:, :4]]
    sides = np.array([corners[:, i] - corners[:, j] for i, j in edges(3)])
    edge = np.sqrt(np.mean(np.sum(sides**2, axis=-1), axis=0))
    return np.sqrt(2) * jacobians(points, elements).min(axis=1) / edge**3


def _check_volume(points: Array, elements: Index, piece: trimesh.Trimesh) -> None:
    """Raise if the mesh does not fill the wall."""
    at_points = jacobians(points, elements)[:, len(TET10.nodes) :]
    volume = float(np.sum(at_points @ TET10.weights))
    if abs(volume - piece.volume) > VOLUME_TOLERANCE * piece.volume:
        raise ConfigError(
            f"the mesh has {PERCENT * volume / piece.volume:.1f} % of the wall's volume: parts of "
            "the surface were lost; repair thin or damaged places, or choose shorter edges (from "
            "Python)"
        )


__getattr__ = moved.renamed(
    __name__,
    {
        "read_surface": "acoustube.runs.imported_wall.read_surface",
        "tube_of": "acoustube.indentation.wall_surface.tube_of",
    },
)
