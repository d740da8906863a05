"""A tube's lumen on a Cartesian grid of cut cells.

The grid has the exact open fractions of the volume and of the faces of each cell. With pressures in
the cells and velocities on the faces this is the conformal (cut-cell) form of the FDTD method,
known from electromagnetics [1]_ and acoustics [2]_, and a finite-volume method as in room acoustics
[3]_.

References
----------
.. [1] Dey, S. and Mittra, R. (1997). A locally conformal finite-difference time-domain (FDTD)
   algorithm for modeling three-dimensional perfectly conducting objects. IEEE Microwave and Guided
   Wave Letters 7, 273-275.
.. [2] Tolan, J. G. and Schneider, J. B. (2003). Locally conformal method for acoustic
   finite-difference time-domain modeling of rigid surfaces. Journal of the Acoustical Society of
   America 114, 2575-2581.
.. [3] Bilbao, S. (2013). Modeling of complex geometries and boundary conditions in finite
   difference/finite volume time domain room acoustics simulation. IEEE Transactions on Audio,
   Speech, and Language Processing 21, 1524-1533. doi:10.1109/TASL.2013.2256897
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from acoustube.base.checks import FLAG, Reals, checked
from acoustube.waves.grid.polyhedron import (
    ROUNDING,
    SNAP,
    Array,
    Fractions,
    cut_polyhedron,
    twice_area,
)

Spacing = tuple[float, float, float]
Indices = NDArray[np.intp]
STRAIGHT_LAYERS = 4
"""Number of layers of a straight end that are cut into cells; the others are copies."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CutCells:
    """A lumen on a Cartesian grid.

    Attributes
    ----------
    spacing : tuple of float
        Cell size (dx, dy, dz) in m.
    origin : tuple of float
        Lower corner (x, y, z) of the first cell in m; x is zero in a half model.
    length : float
        Axial length L of the lumen in m. The end z = L need not be a grid plane.
    volume_fraction : ndarray
        Open fraction of each cell, (nx, ny, nz).
    open_x, open_y, open_z : ndarray
        Open fraction of the faces normal to x, y, z, shapes (nx+1, ny, nz), (nx, ny+1, nz) and
        (nx, ny, nz+1). A zero is a rigid wall or a symmetry plane.
    """

    spacing: Spacing
    origin: Spacing
    length: float
    volume_fraction: Array
    open_x: Array
    open_y: Array
    open_z: Array

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of cells (nx, ny, nz)."""
        nx, ny, nz = self.volume_fraction.shape
        return nx, ny, nz

    def centres(self, axis: int) -> Array:
        """Return the coordinates of the cell centres along an axis in m."""
        steps = np.arange(self.shape[axis]) + 0.5
        return self.origin[axis] + steps * self.spacing[axis]

    def area(self) -> Array:
        """Return the mean cross-section of each layer in m2, (nz,); half of it in a half model."""
        dx, dy, _ = self.spacing
        open_cells: Array = self.volume_fraction.sum(axis=(0, 1))
        return open_cells * dx * dy


@checked(surface=trimesh.Trimesh, spacing=Reals(1e-9, 1e6, "m"), half=FLAG)
def cut_cells(
    surface: trimesh.Trimesh, spacing: float | ArrayLike, *, half: bool = False
) -> CutCells:
    """Return the cut cells of a tube's lumen.

    Parameters
    ----------
    surface : trimesh.Trimesh
        Watertight surface of the lumen in m, with outward normals and the bore axis x = y = 0, from
        a flat cap at z = 0 to one at z = L.
    spacing : float or (3,) array_like
        Cell size in m, the same in all directions or (dx, dy, dz).
    half : bool
        Keep the half x > 0 only; the plane x = 0 is then a rigid symmetry plane.

    Returns
    -------
    CutCells
        Exact fractions. x = 0 and y = 0 are grid planes; cell centres lie at z = k dz. The first
        layer spans -dz/2 to dz/2; its outer half mirrors the inner one. The number of cells across
        is even (along x also in the half model), so that few array shapes occur.

    Raises
    ------
    ValueError
        If the surface is open, turned inside out, does not start at z = 0, folds through itself,
        or the spacing is not positive.
    """
    steps = np.broadcast_to(np.asarray(spacing, dtype=float), (3,))
    _check(surface, steps)
    triangles, layers = _shortened(np.asarray(surface.triangles), float(steps[2]))
    length = float(triangles[..., 2].max())
    reach = np.ceil(np.abs(surface.bounds).max(axis=0)[:2] / steps[:2] - SNAP)
    half_x, half_y = 2 * int(np.ceil(reach[0] / 2)), int(np.ceil(reach[1]))
    shape = (half_x * (1 if half else 2), 2 * half_y, int(layers[-1]) + 1)
    origin = steps * (0.0 if half else -half_x, -half_y, -0.5)
    parts = cut_polyhedron(triangles, origin, steps, shape)
    if half:
        parts.open_x[0] = 0.0
    _complete_first_layer(parts)
    cells = CutCells(
        spacing=_triple(steps), origin=_triple(origin), length=length,
        volume_fraction=parts.volume, open_x=parts.open_x, open_y=parts.open_y,
        open_z=parts.open_z,
    )  # fmt: skip
    return replace(select_layers(cells, layers), length=float(surface.bounds[1, 2]))


def _shortened(triangles: Array, step: float) -> tuple[Array, Indices]:
    """Shorten a tube's straight ends; also return which layer of the result equals each layer.

    Parameters
    ----------
    triangles : ndarray
        (n, 3, 3) in m.
    step : float
        Thickness of a layer in m.

    Returns
    -------
    triangles : ndarray
        Triangles of the tube shortened by whole layers, without those that then have no area.
    layers : ndarray of int
        For each layer of the tube, the index of the equal layer of the shorter tube.
    """
    z = triangles[..., 2]
    length = float(z.max())
    n_layers = int(np.ceil(length / step + 0.5 - SNAP))
    # A facet of a straight end has a normal without z component, exactly, as its x, y repeat.
    (ux, uy), (vx, vy) = ((triangles[:, i, :2] - triangles[:, 0, :2]).T for i in (1, 2))
    cap = np.all(z == z[:, :1], axis=1) & ((z[:, 0] == z.min()) | (z[:, 0] == length))
    shaped = z[(ux * vy - uy * vx != 0.0) & ~cap]
    first, last = (shaped.min(), shaped.max()) if len(shaped) else (length / 2, length / 2)
    before = max(int(first / step) - STRAIGHT_LAYERS, 0)
    after = max(int((length - last) / step) - STRAIGHT_LAYERS, 0)
    moved = triangles.copy()
    moved[..., 2] = np.clip(z, before * step if before else None, length - after * step)
    # Clipping may reverse the orientation of a facet of irregular shape within its plane.
    area, left = twice_area(triangles), twice_area(moved)
    if np.any(np.sum(area * left, axis=1) < -ROUNDING * np.sum(area * area, axis=1)):
        return triangles, np.arange(n_layers)
    moved[..., 2] -= before * step
    moved = moved[np.any(left != 0.0, axis=1)]
    # Each omitted layer equals the first layer, or the last but two: the last layers may extend
    # beyond the end of the tube.
    short = np.arange(n_layers - before - after)
    behind = max(len(short) - 2, 1)
    layers = np.concatenate(
        [np.zeros(before), short[:behind], np.full(after, behind - 1), short[behind:]]
    )
    return moved, layers.astype(np.intp)


def _check(surface: trimesh.Trimesh, steps: Array) -> None:
    """Validate that the surface is closed and starts at z = 0, and the spacing positive."""
    if not np.all(steps > 0.0):
        raise ValueError(f"spacing = {steps} m must be positive")
    if not surface.is_watertight or surface.volume <= 0.0:
        raise ValueError(
            "surface is not closed with outward normals; repair it with "
            "trimesh.repair.fix_normals and fill_holes"
        )
    start = surface.bounds[0, 2]
    if abs(start) > 1e-3 * steps[2]:
        raise ValueError(f"surface starts at z = {start:.4g} m; move its source end to z = 0")


def _complete_first_layer(parts: Fractions) -> None:
    """Fill the half of the first layer before z = 0 with the mirror image of the inner half."""
    for part in (parts.volume, parts.open_x, parts.open_y):
        part[..., 0] = np.minimum(2.0 * part[..., 0], 1.0)
    parts.open_z[..., 0] = parts.open_z[..., 1]


def _triple(values: Array) -> Spacing:
    """Return three values as plain floats."""
    x, y, z = (float(v) for v in values)
    return x, y, z


def select_layers(cells: CutCells, layers: Indices) -> CutCells:
    """Return a grid that consists of some layers of another, each with its lower face.

    Parameters
    ----------
    cells : CutCells
        The grid.
    layers : ndarray of int
        Indices of the layers, (n,). The last must be the grid's last, whose upper face is kept.
    """
    parts = {n: getattr(cells, n)[..., layers] for n in ("volume_fraction", "open_x", "open_y")}
    length = cells.length + (len(layers) - cells.shape[2]) * cells.spacing[2]
    return replace(cells, length=length, open_z=cells.open_z[..., [*layers, -1]], **parts)


def with_straight_ends(cells: CutCells, before: int, after: int | None) -> CutCells:
    """Return a lumen with straight continuations of its ends.

    Parameters
    ----------
    cells : CutCells
        The lumen.
    before : int
        Number of layers added before z = 0, each with the first layer's cross-section.
    after : int or None
        Number of layers added behind the last layer that lies wholly in the lumen; the rest of
        the lumen is replaced. None keeps the rigid cap at z = L.

    Returns
    -------
    CutCells
        With outermost faces as open as in an endless continuation; `length` is still that of the
        lumen.
    """
    dz = cells.spacing[2]
    last = cells.shape[2] - 1
    if after is not None:
        last = int(np.floor(cells.length / dz - 0.5 + 1e-6))
    section = np.arange(-before, last + 1 + (after or 0)).clip(0, last)
    take = {n: getattr(cells, n)[..., section] for n in ("volume_fraction", "open_x", "open_y")}
    # Faces between two copies have the open fractions of the section, so that plane waves stay
    # plane.
    volume = take["volume_fraction"]
    open_z = np.concatenate([volume, volume[..., -1:]], axis=2)
    open_z[..., before + 1 : before + last + 1] = cells.open_z[..., 1 : last + 1]
    if after is None:
        open_z[..., -1] = cells.open_z[..., last + 1]
    origin = (*cells.origin[:2], cells.origin[2] - before * dz)
    return replace(cells, origin=origin, open_z=open_z, **take)
