"""Walls of lumens that are given as closed surfaces, from contours of their sections.

The surface is cut at evenly spaced z, as far as its section changes. Each contour is followed from
its lowest point under the middle of the section, and divided evenly by arc length, which gives a
stack of rings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components, depth_first_order
from scipy.spatial import KDTree

from acoustube.base.errors import ConfigError
from acoustube.base.units import MM
from acoustube.waves.spectral.lumens import NOT_STRAIGHT
from acoustube.waves.spectral.polynomials import Array

STEP = 0.06
"""Distance between sections, relative to the size (larger of width and height) of the end."""
MOST_SECTIONS = 1200
"""Largest number of sections of one surface."""
AROUND = 240
"""Number of points of a contour."""
ALIKE = 4e-4
"""Distance up to which sections, or mirror images, count as equal, relative to the size of the end:
facets deviate from a smooth wall by about as much."""
RIM_POINTS = 20000
"""Number of points of an end's contour to which the wall is compared; they are closer together than
half of `ALIKE`."""


@dataclass(frozen=True, eq=False)
class SurfaceRings:
    """A closed surface as a stack of rings.

    Attributes
    ----------
    rings : ndarray
        (n_rings, n_around, 3) in m, as those of a lumen.
    position : float
        Coordinate z in m that becomes the origin.
    symmetric : bool
        True if symmetric about x = 0.
    same : float
        Distance in m up to which rings, or mirror images, count as equal.
    sealing_gap : float
        Height in m of gaps that are half sealed; by default 0, and no gap is sealed.
    """

    rings: Array
    position: float
    symmetric: bool
    same: float
    sealing_gap: float = 0.0


def rings_of_surface(surface: trimesh.Trimesh, position: float = 0.0) -> SurfaceRings:
    """Return the sections of a closed surface along z as rings.

    Parameters
    ----------
    surface : trimesh.Trimesh
        Surface in m, between flat ends normal to z.
    position : float
        Coordinate z in m that becomes the origin.

    Returns
    -------
    SurfaceRings

    Raises
    ------
    ConfigError
        If a section consists of several parts, the ends are not straight, or the section changes
        over a part too long for `MOST_SECTIONS`.
    """
    low, high = surface.bounds[:, 2]
    z = surface.vertices[:, 2]
    rim = surface.vertices[z - low < 1e-9 + 1e-6 * (high - low), :2]
    size = float(np.ptp(rim, axis=0).max())
    heights = _heights(surface, size)
    contours = [_contour(surface, height, AROUND) for height in heights]
    for end, next_to_it in (contours[:2], contours[:-3:-1]):
        if np.abs(end - next_to_it).max() > ALIKE * size:
            raise ConfigError(NOT_STRAIGHT)
    planes = [low, *heights, high]
    rings = np.array([contours[0], *contours, contours[-1]])
    rings = np.concatenate(
        [rings, np.broadcast_to(np.reshape(planes, (-1, 1, 1)), (*rings.shape[:2], 1))], axis=2
    )
    mirrored = np.roll(rings[:, ::-1], 1, axis=1) * [-1, 1, 1]
    symmetric = bool(np.abs(mirrored - rings).max() < ALIKE * size)
    if symmetric:
        rings = (rings + mirrored) / 2
    rings[[0, 1]], rings[[-2, -1]] = _straightened(rings, ALIKE * size)
    return SurfaceRings(rings, position, symmetric, ALIKE * size)


def _heights(surface: trimesh.Trimesh, size: float) -> Array:
    """Return the z of the sections: two at each end, and those where the section changes."""
    low, high = surface.bounds[:, 2]
    n = max(int(np.ceil((high - low) / (STEP * size))), 4)
    # Away from the ends, and from round numbers, at which vertices may lie.
    step, first = (high - low) / n, 0.503
    start, stop = _changed_part(surface, size, low + first * step, high - (1 - first) * step)
    begin = max(int((start - low) / step) - 2, 0)
    end = min(int((stop - low) / step) + 3, n)
    if end - begin > MOST_SECTIONS:
        raise ConfigError(
            f"the lumen's section changes over {MM * (stop - start):.4g} mm, and the spectral "
            f"solver takes {MM * MOST_SECTIONS * step:.4g} mm at most; cut the lumen into parts, "
            "or use the time-domain solver, acoustube.waves.scatter or --method march"
        )
    numbers = np.unique([0, 1, n - 2, n - 1, *range(begin, end)])
    return np.asarray(low + (high - low) * (numbers + first) / n)


def _changed_part(
    surface: trimesh.Trimesh, size: float, first: float, last: float
) -> tuple[float, float]:
    """Return the range of z in m in which the section differs from those of the two ends.

    Their sections are those at z = `first` and z = `last`. The flat faces of the ends do not count.
    """
    low, high = surface.bounds[:, 2]
    heights, edge = surface.triangles[..., 2], 1e-9 + 1e-6 * (high - low)
    begins, ends = heights.min(axis=1), heights.max(axis=1)
    wall = (ends > low + edge) & (begins < high - edge)
    middles = surface.vertices[surface.edges_unique].mean(axis=1)
    groups = (
        (surface.vertices, surface.faces), (middles, surface.faces_unique_edges),
        (surface.triangles_center, np.arange(len(surface.faces))[:, None]),
    )  # fmt: skip
    found = []
    for end in (first, last):
        tree = KDTree(_contour(surface, end, RIM_POINTS))
        off = np.zeros(len(surface.faces), bool)
        for points, of_face in groups:
            near = tree.query(points[:, :2], distance_upper_bound=ALIKE / 2 * size)[0]
            off |= np.isinf(near)[of_face].any(axis=1)
        found.append(off & wall)
    if not (found[0].any() and found[1].any()):
        return low, low
    return float(begins[found[0]].min()), float(ends[found[1]].max())


def _contour(surface: trimesh.Trimesh, height: float, n: int) -> Array:
    """Return n points (x, y), evenly spaced along the contour of a section, (n, 2)."""
    vertices = surface.vertices
    above = vertices[:, 2] > height
    edges = surface.edges_unique
    crossed = above[edges[:, 0]] != above[edges[:, 1]]
    number = np.cumsum(crossed) - 1
    sides = surface.faces_unique_edges
    cut = crossed[sides]
    faces = cut.any(axis=1)
    pairs = number[sides[faces][cut[faces]]].reshape(-1, 2)
    a, b = vertices[edges[crossed, 0]], vertices[edges[crossed, 1]]
    share = (height - a[:, 2]) / (b[:, 2] - a[:, 2])
    points = a[:, :2] + share[:, None] * (b - a)[:, :2]
    links = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(points),) * 2)
    n_parts, _ = connected_components(links, directed=False)
    if n_parts > 1:
        raise ConfigError(
            f"the section at z = {MM * height:.4g} mm consists of {n_parts} parts; use the "
            "time-domain solver, acoustube.waves.scatter or --method march"
        )
    order, _ = depth_first_order(links, 0, directed=False)
    return _even(points[order], n)


def _even(loop: Array, n: int) -> Array:
    """Return n evenly spaced points on a polygon, anticlockwise from below its centroid, (n, 2)."""
    x, y = loop.T
    ahead = np.roll(loop, -1, axis=0)
    cross = x * ahead[:, 1] - ahead[:, 0] * y
    if cross.sum() < 0:
        return _even(loop[::-1], n)
    middle = float(((x + ahead[:, 0]) * cross).sum() / (3 * cross.sum()))
    passes = (x <= middle) != (ahead[:, 0] <= middle)
    share = (middle - x[passes]) / (ahead[passes, 0] - x[passes])
    heights = y[passes] + share * (ahead[passes, 1] - y[passes])
    lowest = int(np.argmin(heights))
    first = int(np.flatnonzero(passes)[lowest]) + 1
    start = np.array([[middle, heights[lowest]]])
    closed = np.concatenate([start, np.roll(loop, -first, axis=0), start])
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))])
    at = length[-1] * np.arange(n) / n
    return np.stack([np.interp(at, length, part) for part in closed.T], axis=-1)


def _straightened(rings: Array, same: float) -> tuple[Array, Array]:
    """Return the first and last two rings, made equal if both ends have the same section."""
    first, last = rings[[0, 1]].copy(), rings[[-2, -1]].copy()
    if np.abs(first[0, :, :2] - last[1, :, :2]).max() < same:
        last[..., :2] = first[:1, :, :2]
    return first, last
