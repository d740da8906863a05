"""Runs of equal layers along a tube, which are computed once and copied."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from acoustube.waves.grid.cells import CutCells, select_layers

Indices = NDArray[np.intp]


def without_repeated_layers(cells: CutCells, kept: int) -> tuple[CutCells, Indices]:
    """Return a grid whose runs of equal layers are shortened.

    Parameters
    ----------
    cells : CutCells
        The grid.
    kept : int
        Number of layers kept at each end of a run.

    Returns
    -------
    cells : CutCells
        The shorter grid.
    layers : ndarray of int
        For each layer, the index of the equal layer of the shorter grid, (nz,).
    """
    faces = cells.open_z
    same = np.all(faces[..., 1:-1] == faces[..., :-2], axis=(0, 1))
    same &= np.all(faces[..., 2:] == faces[..., 1:-1], axis=(0, 1))
    for part in (cells.volume_fraction, cells.open_x, cells.open_y):
        same &= np.all(part[..., 1:] == part[..., :-1], axis=(0, 1))
    # A layer is omitted if the `kept` layers on either side equal it.
    alike = np.concatenate([[0], np.cumsum(same)])
    inner = np.arange(kept, len(alike) - kept)
    uniform = alike[inner + kept] - alike[inner - kept] == 2 * kept
    taken = np.ones(len(alike), bool)
    taken[inner[uniform]] = False
    layers = np.cumsum(taken) - 1
    return select_layers(cells, np.flatnonzero(taken)), layers
