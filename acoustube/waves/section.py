"""Cut-on frequencies of any cross-section."""

from __future__ import annotations

from math import pi

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import eigsh

from acoustube.waves.cells import CutCells


def section_cut_ons(
    cells: CutCells, layer: int, sound_speed: float, n_modes: int = 4
) -> NDArray[np.float64]:
    """Return the cut-on frequencies of the cross-section at one layer of cells.

    Where the section changes slowly, a mode travels where its local cut-on is below its frequency
    and decays elsewhere.

    Parameters
    ----------
    cells : CutCells
        The lumen. Of a half model only the modes symmetric about x = 0 are found.
    layer : int
        Index of the layer along z.
    sound_speed : float
        In m/s.
    n_modes : int
        How many.

    Returns
    -------
    ndarray
        Frequencies in Hz, (n_modes,), ascending; the first is the plane mode's zero.

    Notes
    -----
    The eigenvalue problem ``sum A (p - p') = (2 pi f h / c)^2 V p`` of the wave stage's own cut
    cells across the tube, by shift-inverted Lanczos iteration.
    """
    dx, dy, _ = cells.spacing
    volume = cells.volume_fraction[:, :, layer]
    inside = volume > 0.0
    number = np.cumsum(inside).reshape(inside.shape) - 1
    coupling = sp.csr_matrix((number.max() + 1,) * 2)
    for axis, open_faces, h in ((0, cells.open_x, dx), (1, cells.open_y, dy)):
        area = np.moveaxis(open_faces[:, :, layer], axis, 0)[1:-1]
        at = np.moveaxis(number, axis, 0)
        open_here = area > 0.0
        pairs = at[:-1][open_here], at[1:][open_here]
        coupling = coupling + sp.csr_matrix((area[open_here] / h**2, pairs), coupling.shape)
    coupling = coupling + coupling.T
    stiffness = sp.diags(np.asarray(coupling.sum(axis=1)).ravel()) - coupling
    # Just below zero: the plane mode's eigenvalue is zero and would make the shift singular.
    squares = eigsh(
        stiffness.tocsc(),
        n_modes,
        sp.diags(volume[inside]).tocsc(),
        sigma=-1e-6 / dx**2,
        return_eigenvectors=False,
    )
    return np.sqrt(np.sort(np.abs(squares))) * sound_speed / (2.0 * pi)
