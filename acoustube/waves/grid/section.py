"""The cross-section of a grid: stiffness matrix and cut-on frequencies."""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import eigsh

from acoustube.base.checks import SPEED, checked
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.waves.grid.cells import CutCells


def section_stiffness(area_x: Any, area_y: Any, inside: NDArray[np.bool_]) -> sp.csr_matrix:
    """Return the stiffness matrix ``sum A (p - p')`` of the open cells of a layer.

    The sum is over the transverse faces of a cell of pressure p; A is the weighted open area of a
    face, and p' the pressure of the cell beyond it.

    Parameters
    ----------
    area_x, area_y : ndarray
        Weighted open areas of the faces, (nx+1, ny) and (nx, ny+1). Beyond an open face at the
        boundary of the grid the pressure is zero.
    inside : ndarray of bool
        The open cells, (nx, ny).

    Returns
    -------
    sparse matrix of shape (n, n)
        Rows and columns in the order of the open cells in ``inside.ravel()``.
    """
    n = int(inside.sum())
    number = np.where(inside, np.cumsum(inside).reshape(inside.shape) - 1, -1)
    matrix = sp.csr_matrix((n, n))
    for axis, area in enumerate((area_x, area_y)):
        flow = np.moveaxis(np.asarray(area, float), axis, 0)
        at = np.pad(np.moveaxis(number, axis, 0), ((1, 1), (0, 0)), constant_values=-1)
        low, high = at[:-1], at[1:]
        pairs = (low, low, 1), (high, high, 1), (low, high, -1), (high, low, -1)
        for row, column, sign in pairs:
            there = (row >= 0) & (column >= 0) & (flow > 0)
            places = row[there], column[there]
            matrix = matrix + sp.csr_matrix((sign * flow[there], places), (n, n))
    return matrix


@checked(
    cells=CutCells,
    layer=Number(-1e9, 1e9, whole=True),
    sound_speed=SPEED,
    n_modes=Number(1, 1e6, "modes", whole=True),
)
def section_cut_ons(
    cells: CutCells, layer: int, sound_speed: float, n_modes: int = 4
) -> NDArray[np.float64]:
    """Return the cut-on frequencies of the cross-section at one layer of cells.

    In a slowly varying section, a mode propagates where its local cut-on is below the frequency
    and is evanescent elsewhere.

    Parameters
    ----------
    cells : CutCells
        The lumen. A half model has only the modes symmetric about x = 0.
    layer : int
        Index of the layer along z; negative indices count from the last.
    sound_speed : float
        In m/s.
    n_modes : int
        Number of modes.

    Returns
    -------
    ndarray
        Frequencies in Hz, (n_modes,), ascending; the first is that of the plane mode, zero.

    Raises
    ------
    ConfigError
        If there is no such layer, or it does not have more open cells than modes.

    Notes
    -----
    The eigenvalue problem of the layer, ``sum A (p - p') = (2 pi f h / c)^2 V p`` with the open
    fractions A of the faces and V of the cells and the cell size h, is solved by shift-inverted
    Lanczos iteration.
    """
    dx, dy, _ = cells.spacing
    n_layers = cells.volume_fraction.shape[2]
    if not -n_layers <= layer < n_layers:
        raise ConfigError(f"layer = {layer} is out of range; use 0 to {n_layers - 1}")
    volume = cells.volume_fraction[:, :, layer]
    inside = volume > 0.0
    if not n_modes < inside.sum():
        raise ConfigError(
            f"n_modes = {n_modes} are too many of {inside.sum()} cells; use fewer, or a finer grid"
        )
    faces = cells.open_x[:, :, layer] / dx**2, cells.open_y[:, :, layer] / dy**2
    stiffness = section_stiffness(*faces, inside)
    # The shift is just below zero, the plane mode's eigenvalue, at which the matrix is singular.
    # With a fixed start vector, equal sections have equal cut-ons to the last digit.
    squares = eigsh(
        stiffness.tocsc(),
        n_modes,
        sp.diags(volume[inside]).tocsc(),
        sigma=-1e-6 / dx**2,
        return_eigenvectors=False,
        v0=np.random.default_rng(0).standard_normal(int(inside.sum())),
    )
    return np.sqrt(np.sort(np.abs(squares))) * sound_speed / (2.0 * pi)
