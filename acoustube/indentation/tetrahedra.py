"""Quadratic tetrahedra for a wall that is given as a closed surface: STL, PLY or OBJ.

A piece of the surface is cut out around the press, filled with linear tetrahedra by fTetWild [1]_
(through ``pytetwild``), and its elements are made quadratic: the wall's nodes are put back onto the
surface, those of symmetry planes exactly into their plane. fTetWild draws random numbers that
cannot be seeded: each call gives another mesh, whose force differs by some tenths of a per cent.

Notes
-----
How stiff the elements are depends on what is done to their volume ratio J. With a modulus k against
what the projection onto a constant leaves out of it, the paper's tube (a quarter, free, under a
25 mm rod at a depth of 2 mm) needs, against the reference force of 1.0305 N:

==========================  =======  ======  ======  ======  =======  ==========
edges, in wall thicknesses  k = 0    4 mu    8 mu    10 mu   K        unknowns
==========================  =======  ======  ======  ======  =======  ==========
1                           -25.2 %  -3.3 %  +0.0 %  +0.9 %  +4.7 %   20 000
0.65                        -        -1.3 %  -0.2 %  -       +1.3 %   30 000
==========================  =======  ======  ======  ======  =======  ==========

while hexahedra give +0.1 %. The constant alone (k = 0) leaves each element swellings that nothing
resists; no projection (k = K) locks. A rule of 14 points in place of 4 changed the force by 0.6 %
with the former and by 1.5 to 2 % with the latter, on one layer of elements. So k = 8 mu, which with
these edges gives +0.7 and +0.1 % at 4 mm (hexahedra +0.3 %, K with the shorter edges +1.9 %) and
+3.8 and +2.0 % at 6 mm (hexahedra +1.2 %, K +5.3 %). It costs some order: displacements of a smooth
problem converge with order 2.2, not 3.

References
----------
.. [1] Y. Hu, T. Schneider, B. Wang, D. Zorin, D. Panozzo, "Fast tetrahedral meshing in the wild",
   ACM Trans. Graph. 39, 117 (2020). doi:10.1145/3386569.3392385
"""

from __future__ import annotations

import contextlib
import itertools
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytetwild
import trimesh
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import connected_components, reverse_cuthill_mckee

from acoustube import surfaces
from acoustube.errors import ConfigError
from acoustube.indentation.mesh import Mesh
from acoustube.indentation.reference import TET10, edges
from acoustube.tube import Tube

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Mask = NDArray[np.bool_]

ENVELOPE = 1 / 25
"""How far the linear tetrahedra may leave the surface, in wall thicknesses.

Their corners are put back onto it; a narrow envelope only forces small elements around the bore."""
SYMMETRY = 0.02
"""How far the mirror image of a wall may be off it, in wall thicknesses."""
THINNEST = 0.25
"""Least thickness of a wall anywhere, in mean thicknesses: elements are sized by the mean."""
LARGEST_COUNT = 60_000
"""Most tetrahedra that a mesh is expected to have; a wall that needs more is too thin."""
LEAST_JACOBIAN = 0.2
"""Least Jacobian anywhere in an element with curved sides, as a share of the straight one's."""
LEAST_QUALITY = 0.01
"""Least Jacobian anywhere in an element, as a share of that of a regular one with such edges.

Meshes of a round and of a D-shaped bore had 0.045 to 0.2; below the share, one element decides
what the solver can do."""
THERE = 1e-3
"""How far a node that is on a wall or plane may be off it, in wall thicknesses."""
ASTRAY = 0.01
"""Share of a wall's nodes that may stay off it for the sake of their elements; of a plane, none."""
ATTEMPTS = 6
"""Meshes drawn before giving up; about one in twenty has a flat element beside a plane, and one in
twelve more nodes astray than it may."""
VOLUME_TOLERANCE = 0.01
ACROSS = 0.7
"""Least cosine between the normals of a plane and of a face that lies in it."""
SETTLING_ROUNDS = 3
"""Times that a node where a wall meets a plane is put onto the one and into the other."""
STOP_ENERGY = 15.0
"""Distortion of the worst tetrahedron at which fTetWild stops (a regular one has 3)."""
SIZE_STATIONS = 33
"""Places along the tube between which the edge length is interpolated."""
FILL = 0.13
"""Volume of a tetrahedron among many, in cubes of the edge asked for (a regular one has 0.118)."""

_CORNERS = np.array(list(itertools.combinations(range(4), 3)))
_FACES = np.array(
    [[*face, *(4 + edges(3).index((face[i], face[j])) for i, j in edges(2))] for face in _CORNERS]
)
"""Local nodes of a tetrahedron's four faces, each in the order of the face's own nodes."""
FLIPPED = np.array([0, 2, 1, 4, 3, 5])
"""A face's nodes in the order that turns its normal around."""


@dataclass(frozen=True, kw_only=True)
class TetrahedronSize:
    """Length of the elements' edges.

    Parameters
    ----------
    fine, coarse : float
        Near the press and far from it, in mean wall thicknesses.
    near, far : float
        Distance from the press at which the edges begin and end to grow from `fine` to `coarse`,
        in heights of the tube.
    """

    fine: float = 0.65
    coarse: float = 1.8
    near: float = 1.0
    far: float = 3.0


# ---------------------------------------------------------------------------------------------
# The surface


def read_surface(path: str | Path, unit: float = 1e-3) -> trimesh.Trimesh:
    """Read a tube's wall from a file.

    Parameters
    ----------
    path : str or Path
        STL, PLY or OBJ; its z axis is along the tube, +y where the press comes from.
    unit : float
        Length in m that the file's numbers count; millimetres by default.

    Returns
    -------
    trimesh.Trimesh
        A closed surface in m, its normals outwards, the middle of its bounding box at the origin.

    Raises
    ------
    ConfigError
        If the file cannot be read, or its surface is not that of one tube: open, crossing itself,
        of several bodies, without two flat ends across z, or without one bore.
    """
    path = Path(path)
    surface = surfaces.load(path)
    surfaces.check_closed(surface, path)
    if unit == 1e-3:
        surfaces.check_millimetres(surface, path)
    if surface.volume < 0:
        surface.invert()
    surface.apply_translation(-surface.bounds.mean(axis=0))
    surfaces.check_crossings(surface, path)
    surface.apply_scale(unit)
    if surface.euler_number != 0:
        raise ConfigError(
            f"{path}: the surface has {1 - surface.euler_number // 2} holes through it; a tube "
            "has one, its bore. Remove what is not the wall."
        )
    walls(surface, str(path))
    return surface


class Walls(NamedTuple):
    """The two walls of a tube, and the mean distance in m between them."""

    inner: trimesh.Trimesh
    outer: trimesh.Trimesh
    thickness: float


def walls(surface: trimesh.Trimesh, name: str = "surface") -> Walls:
    """Separate the inner wall of a tube from the outer.

    Parameters
    ----------
    surface : trimesh.Trimesh
        Closed, in m, along z.
    name : str
        What an error calls it.

    Raises
    ------
    ConfigError
        If it has no two flat ends across z with one opening each.
    """
    low, high = surface.bounds[:, 2]
    z = surface.triangles[..., 2]
    tolerance = 1e-4 * min(surface.extents)
    ends = np.all(z < low + tolerance, axis=1) | np.all(z > high - tolerance, axis=1)
    sides = _part(surface, ~ends)
    parts = surfaces.components(sides)
    if not ends.any() or parts.max() != 1:
        raise ConfigError(
            f"{name} is not a tube along z: between flat ends it has {parts.max() + 1} separate "
            "walls, not an inner and an outer one; turn it so that it lies along z, and cut its "
            "ends square."
        )
    inner, outer = sorted(
        (_part(sides, parts == i) for i in (0, 1)), key=lambda wall: float(wall.extents[0])
    )
    return Walls(inner, outer, float(2 * surface.volume / (inner.area + outer.area)))


def _part(surface: trimesh.Trimesh, chosen: Mask) -> trimesh.Trimesh:
    """Return some of a surface's facets."""
    part = trimesh.Trimesh(surface.vertices, surface.faces[chosen], process=False)
    part.remove_unreferenced_vertices()
    return part


def tube_of(surface: trimesh.Trimesh, *, shear_modulus: float, poisson_ratio: float) -> Tube:
    """Return a round tube with the scales of a surface.

    Parameters
    ----------
    surface : trimesh.Trimesh
        From :func:`read_surface`.
    shear_modulus : float
        Of the wall, in Pa.
    poisson_ratio : float

    Returns
    -------
    Tube
        Its inner diameter is the height of the bore over x = 0 at mid-length, its wall as thick as
        the surface's in the mean.

    Raises
    ------
    ConfigError
        If the surface is no tube, or x = 0 misses its bore.
    """
    inner, _, thickness = walls(surface)
    middle = [0.0, 0.0, surface.bounds[:, 2].mean()]
    ring = trimesh.intersections.mesh_plane(inner, [0.0, 0.0, 1.0], middle)
    (x0, x1), (y0, y1) = ring[..., 0].T, ring[..., 1].T
    crossing = (np.minimum(x0, x1) <= 0) & (np.maximum(x0, x1) >= 0) & (x0 != x1)
    if not crossing.any():
        raise ConfigError("The bore is nowhere over x = 0 at mid-length; centre the tube on z.")
    heights = (y0 - x0 * (y1 - y0) / np.where(crossing, x1 - x0, 1.0))[crossing]
    return Tube(
        inner_diameter=float(np.ptp(heights)),
        wall_thickness=thickness,
        length=float(surface.extents[2]),
        shear_modulus=shear_modulus,
        poisson_ratio=poisson_ratio,
    )


# ---------------------------------------------------------------------------------------------
# The mesh


class Plane(NamedTuple):
    """A plane across an axis (0 for x, 2 for z) that bounds the piece; it lies on `side` of it."""

    axis: int
    value: float
    side: int


def tetrahedral_mesh(
    surface: trimesh.Trimesh,
    *,
    reach: float,
    halved: tuple[bool, bool] = (False, False),
    presses: Sequence[float] = (0.0,),
    size: TetrahedronSize | None = None,
) -> Mesh:
    """Mesh a piece of a tube's wall with quadratic tetrahedra.

    Parameters
    ----------
    surface : trimesh.Trimesh
        From :func:`read_surface`.
    reach : float
        Length of the piece to each side of z = 0, in m.
    halved : tuple of bool
        Whether the load is symmetric about x = 0, and about z = 0; where the wall is so too, only
        x >= 0 or z >= 0 is meshed.
    presses : sequence of float
        Places along z at which the mesh is fine, in m.
    size : TetrahedronSize, optional
        Length of the elements' edges.

    Returns
    -------
    Mesh
        Its inner faces' normals point into the wall and its outer faces' away from it, as those of
        :func:`acoustube.indentation.mesh.sweep`.

    Raises
    ------
    ConfigError
        If the piece is longer than the tube, the wall is too thin, or parts of it are lost.
    """
    size = size or TetrahedronSize()
    whole = walls(surface)
    if not 0 < reach <= (1 + 1e-9) * surface.extents[2] / 2:
        raise ConfigError(
            f"reach = {reach:.6g} m is outside 0 to {surface.extents[2] / 2:.6g} m, half the "
            "length of the surface; use a longer tube."
        )
    both = [Plane(2, -reach, 1), Plane(2, reach, -1)]
    symmetric = _symmetries(_cut(surface, both), halved, SYMMETRY * whole.thickness)
    planes = [Plane(0, 0.0, 1)] * symmetric[0]
    planes += [Plane(2, 0.0, 1), both[1]] if symmetric[1] else both
    piece = _cut(surface, planes)
    z = np.linspace(piece.bounds[0, 2], piece.bounds[1, 2], SIZE_STATIONS)
    edge = whole.thickness * _edge_lengths(z, presses, size, whole.outer.extents[1])
    _check_thickness(piece, whole, edge)
    best, least = None, 1.0  # a mesh with a node off a plane, which counts as 1, is never taken
    for _ in range(ATTEMPTS):
        points, tetrahedra = _filled(piece, z, edge, whole.thickness)
        mesh, astray = _quadratic(points, tetrahedra, planes, whole, symmetric)
        if astray < least and _qualities(mesh.points, mesh.elements).min() > LEAST_QUALITY:
            best, least = mesh, astray
        if least <= ASTRAY:
            break
    if best is None:
        raise ConfigError(
            f"The wall could not be filled with sound tetrahedra in {ATTEMPTS} attempts; repair "
            "the surface, or ask for other edge lengths."
        )
    _check_volume(best.points, best.elements, piece)
    return best


def _cut(surface: trimesh.Trimesh, planes: Sequence[Plane]) -> trimesh.Trimesh:
    """Return the closed part of a surface on one side of planes."""
    import pyvista  # slow to import, and only these surfaces need it

    cut = pyvista.wrap(surface)
    for axis, value, side in planes:
        normal, origin = np.eye(3)[axis] * side, np.eye(3)[axis] * value
        cut = cut.clip_closed_surface(normal=normal, origin=origin)
    cut = cut.triangulate().clean(tolerance=1e-9 * surface.scale, absolute=True)
    return trimesh.Trimesh(np.asarray(cut.points, float), cut.regular_faces)


def _closest(wall: trimesh.Trimesh, points: Array) -> Array:
    """Return the points of a wall that are closest to the given ones."""
    import pyvista

    _, found = pyvista.wrap(wall).find_closest_cell(points, return_closest_point=True)  # type: ignore[misc]
    return np.asarray(found)


def _symmetries(
    piece: trimesh.Trimesh, asked: tuple[bool, bool], tolerance: float
) -> tuple[bool, bool]:
    """Return about which of x = 0 and z = 0 a piece is its own mirror image, of those asked for."""
    points = np.concatenate([piece.vertices, piece.triangles_center])
    found = []
    for wanted, axis in zip(asked, (0, 2), strict=True):
        mirrored = points * np.where(np.arange(3) == axis, -1.0, 1.0)
        off = np.linalg.norm(_closest(piece, mirrored) - mirrored, axis=1)
        found.append(bool(wanted and off.max() < tolerance))
    return found[0], found[1]


def _edge_lengths(
    z: Array, presses: Sequence[float], size: TetrahedronSize, height: float
) -> Array:
    """Return the edge length asked for at stations along the tube, in wall thicknesses."""
    distance = np.min(np.abs(z[:, None] - np.asarray(presses)), axis=1)
    return np.interp(distance / height, [size.near, size.far], [size.fine, size.coarse])


def _check_thickness(piece: trimesh.Trimesh, whole: Walls, edge: Array) -> None:
    """Refuse a wall that a mesh sized by its mean thickness would not resolve."""
    inside = _sampled(whole.inner)
    least = np.linalg.norm(_closest(whole.outer, inside) - inside, axis=1).min()
    if least < THINNEST * whole.thickness:
        raise ConfigError(
            f"The wall is {1e3 * least:.3g} mm thick at its thinnest place, under a quarter of its "
            f"mean of {1e3 * whole.thickness:.3g} mm, and cannot be meshed; make it at least "
            f"{1e3 * THINNEST * whole.thickness:.3g} mm there."
        )
    count = piece.volume * np.mean(1 / edge**3) / FILL
    if count > LARGEST_COUNT:
        needed = whole.thickness * np.sqrt(count / LARGEST_COUNT)
        raise ConfigError(
            f"The wall, {1e3 * whole.thickness:.3g} mm thick in the mean, is too thin for its "
            f"size: it would take {count:.0f} tetrahedra, {LARGEST_COUNT} are allowed; make it "
            f"about {1e3 * needed:.2g} mm, model a shorter piece, or ask for longer edges."
        )


def _sampled(wall: trimesh.Trimesh) -> Array:
    """Return the corners, middles of edges and centres of a wall's facets."""
    middles = wall.vertices[wall.edges_unique].mean(axis=1)
    return np.concatenate([wall.vertices, middles, wall.triangles_center])


def _filled(piece: trimesh.Trimesh, z: Array, edge: Array, thickness: float) -> tuple[Array, Index]:
    """Fill a closed surface with tetrahedra of the edge lengths asked for along z.

    Returns
    -------
    points : array of shape (n_points, 3)
        In m.
    tetrahedra : array of shape (n_tetrahedra, 4)
        Of positive volume.
    """
    box, cells = _column(piece.bounds, z)
    diagonal = float(np.linalg.norm(piece.extents))
    # It leaves a file in the current folder.
    with tempfile.TemporaryDirectory() as aside, contextlib.chdir(aside):
        points, tetrahedra = pytetwild.tetrahedralize(
            # In wall thicknesses, for lengths near one.
            piece.vertices / thickness,
            piece.faces,
            edge_length_fac=float(edge.max() / diagonal),
            epsilon=ENVELOPE * thickness / diagonal,
            stop_energy=STOP_ENERGY,
            num_threads=1,
            bg_vertices=box / thickness,
            bg_tets=cells.astype(np.int32),
            bg_values=np.repeat(edge, 4) / thickness,
        )
    used, corners = np.unique(tetrahedra, return_inverse=True)
    points, corners = thickness * points[used], corners.reshape(-1, 4)
    return points, _upright(points, corners)


def _column(bounds: Array, z: Array) -> tuple[Array, Index]:
    """Return a column of boxes around a piece, between stations, each of six tetrahedra."""
    low, high = bounds + 0.1 * np.ptp(bounds[:, :2]) * np.array([[-1.0], [1.0]])
    z = z.copy()
    z[[0, -1]] = low[2], high[2]
    points = np.array([(x, y, s) for s in z for y in (low[1], high[1]) for x in (low[0], high[0])])
    # Along every order of the three axes, from a box's first corner to its last.
    paths = [np.cumsum([0, *order]) for order in itertools.permutations((1, 2, 4))]
    cells = 4 * np.arange(len(z) - 1)[:, None, None] + np.array(paths)
    return points, _upright(points, cells.reshape(-1, 4))


def _upright(points: Array, tetrahedra: Index) -> Index:
    """Return tetrahedra with the corners of those of negative volume in another order."""
    upside_down = _jacobians(points, tetrahedra)[:, 0] < 0
    return np.where(upside_down[:, None], tetrahedra[:, [0, 2, 1, 3]], tetrahedra)


def _quadratic(
    points: Array,
    tetrahedra: Index,
    planes: Sequence[Plane],
    whole: Walls,
    halved: tuple[bool, bool],
) -> tuple[Mesh, float]:
    """Make linear tetrahedra quadratic, their boundary on the walls and planes of the piece.

    The second value is the larger share of a wall's nodes that could not be put onto it, or one
    where a node could not be put into its plane.
    """
    pairs, middle = _middles(tetrahedra, len(points))
    elements = np.hstack([tetrahedra, middle])
    straight = np.concatenate([points, points[pairs].mean(axis=1)])
    faces = _boundary(elements, straight)
    in_plane = _faces_in_planes(straight[faces], planes, 2 * ENVELOPE * whole.thickness)
    inner, outer = _separated(faces[~in_plane.any(axis=0)], straight)
    snapped = [
        (plane, np.unique(faces[mask])) for plane, mask in zip(planes, in_plane, strict=True)
    ]
    bounds = [(whole.inner, np.unique(inner)), (whole.outer, np.unique(outer))]
    n = len(points)
    corners = _settled(straight, bounds, snapped)[:n]
    start = _in_planes(straight, snapped)[:n]
    corners = _sound(start, corners, tetrahedra)
    straight = np.concatenate([corners, corners[pairs].mean(axis=1)])
    target = _settled(straight, bounds, snapped)
    settled = target.copy()
    settled[:n] = corners
    curved = _sound(straight, settled, elements)
    off = np.linalg.norm(curved - target, axis=1) > THERE * whole.thickness
    across = any(off[nodes].any() for _, nodes in snapped)
    astray = 1.0 if across else max(float(np.mean(off[nodes])) for _, nodes in bounds)
    order = _order(elements, curved)
    number = np.argsort(order)
    mesh = Mesh(
        points=curved[order],
        elements=number[elements],
        inner_faces=number[inner[:, FLIPPED]],
        outer_faces=number[outer],
        reference=TET10,
        halved=halved,
    )
    return mesh, astray


def _middles(tetrahedra: Index, n_points: int) -> tuple[Index, Index]:
    """Return every edge's two ends, and the numbers (n_tetrahedra, 6) of their middle nodes."""
    ends = np.sort(tetrahedra[:, edges(3)].reshape(-1, 2), axis=1)
    pairs, number = np.unique(ends, axis=0, return_inverse=True)
    return pairs, n_points + number.reshape(-1, 6)


def _boundary(elements: Index, points: Array) -> Index:
    """Return the nodes of the faces that one element only has, their normals outwards."""
    faces = elements[:, _FACES].reshape(-1, 6)
    _, first, count = np.unique(
        np.sort(faces[:, :3], axis=1), axis=0, return_index=True, return_counts=True
    )
    alone = first[count == 1]
    a, b, c = np.moveaxis(points[faces[alone, :3]], 1, 0)
    centre = points[elements[alone // 4, :4]].mean(axis=1)
    inwards = np.sum(np.cross(b - a, c - a) * (centre - a), axis=1) > 0
    return np.where(inwards[:, None], faces[alone][:, FLIPPED], faces[alone])


def _faces_in_planes(faces: Array, planes: Sequence[Plane], tolerance: float) -> Mask:
    """Return which faces (n_faces, 6, 3) lie in which plane, shape (n_planes, n_faces)."""
    a, b, c = np.moveaxis(faces[:, :3], 1, 0)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.array(
        [
            np.all(np.abs(faces[..., plane.axis] - plane.value) < tolerance, axis=1)
            & (np.abs(normal[:, plane.axis]) > ACROSS)
            for plane in planes
        ]
    )


def _separated(faces: Index, points: Array) -> tuple[Index, Index]:
    """Return the faces of the inner and of the outer wall: the connected parts of the sides."""
    which = np.repeat(np.arange(len(faces)), 3)
    ones = np.ones(len(which))
    beside = sparse.csr_array((ones, (which, faces[:, 3:].ravel())))
    n, part = connected_components(beside @ beside.T, directed=False)
    if n != 2:
        raise ConfigError(
            f"The meshed wall has {n} separate sides, not an inner and an outer one; repair thin "
            "or damaged places of the surface, or ask for shorter edges."
        )
    outer = part[np.argmax(points[faces, 1].max(axis=1))]
    return faces[part != outer], faces[part == outer]


def _settled(
    points: Array,
    bounds: Sequence[tuple[trimesh.Trimesh, Index]],
    snapped: Sequence[tuple[Plane, Index]],
) -> Array:
    """Return the nodes with those of walls on their wall, and those of planes in their plane."""
    for _ in range(SETTLING_ROUNDS):
        points = points.copy()
        for wall, nodes in bounds:
            points[nodes] = _closest(wall, points[nodes])
        points = _in_planes(points, snapped)
    return points


def _in_planes(points: Array, snapped: Sequence[tuple[Plane, Index]]) -> Array:
    points = points.copy()
    for plane, nodes in snapped:
        points[nodes, plane.axis] = plane.value
    return points


def _sound(start: Array, target: Array, elements: Index) -> Array:
    """Move nodes from start to target, except those of elements that it would badly distort.

    Elements that are flat at the start stay so; `_qualities` tells.
    """
    least = LEAST_JACOBIAN * _jacobians(start, elements[:, :4])[:, 0]
    moved = target.copy()
    while np.any(bad := _jacobians(moved, elements).min(axis=1) < least):
        nodes = np.unique(elements[bad])
        if np.array_equal(moved[nodes], start[nodes]):
            break
        moved[nodes] = start[nodes]
    return moved


def _jacobians(points: Array, elements: Index) -> Array:
    """Return the Jacobian (n_elements, n_points) at nodes and points, or of linear ones."""
    if elements.shape[1] == 4:
        sides = points[elements[:, 1:]] - points[elements[:, :1]]
        return np.linalg.det(sides)[:, None]
    slopes = TET10.shape_functions(np.concatenate([TET10.nodes, TET10.points]))[1]
    return np.linalg.det(np.einsum("eni,qnj->eqij", points[elements], slopes))


def _qualities(points: Array, elements: Index) -> Array:
    """Return each element's least Jacobian over that of a regular one with its mean square edge."""
    corners = points[elements[:, :4]]
    sides = np.array([corners[:, i] - corners[:, j] for i, j in edges(3)])
    edge = np.sqrt(np.mean(np.sum(sides**2, axis=-1), axis=0))
    return np.sqrt(2) * _jacobians(points, elements).min(axis=1) / edge**3


def _check_volume(points: Array, elements: Index, piece: trimesh.Trimesh) -> None:
    at_points = _jacobians(points, elements)[:, len(TET10.nodes) :]
    volume = float(np.sum(at_points @ TET10.weights))
    if abs(volume - piece.volume) > VOLUME_TOLERANCE * piece.volume:
        raise ConfigError(
            f"The mesh has {100 * volume / piece.volume:.1f} % of the wall's volume: parts of the "
            "surface were lost; repair thin or damaged places, or ask for shorter edges."
        )


def _order(elements: Index, points: Array) -> Index:
    """Return the nodes in an order that keeps the stiffness matrix a narrow band."""
    n = elements.shape[1]
    rows, columns = np.repeat(elements, n, axis=1).ravel(), np.tile(elements, n).ravel()
    graph = sparse.csr_array((np.ones(len(rows)), (rows, columns)), shape=(len(points),) * 2)
    return reverse_cuthill_mckee(graph, symmetric_mode=True).astype(np.int64)
