"""Sixth-difference penalty against element-sized wrinkling of the inner surface.

A tube that is pressed flat folds at its sides. There the inner surface is compressed to a stretch
below 0.65 from a depth of about three quarters of the bore: beyond the onset of creases of the free
surface of a Neo-Hookean solid [1]_, and at larger depths beyond Biot's instability against wrinkles
of any wavelength (0.54) [2]_. A mesh then creases at the size of its elements, which is an artefact
of the mesh; the creases of real silicone are far smaller than an acoustic wavelength.

The energy is half a stiffness times the squared sixth differences of the displacement around each
section of the inner wall, at the sides of the tube. For a smooth displacement these differences
vanish with the sixth power of the node spacing.

References
----------
.. [1] W. Hong, X. Zhao, Z. Suo, "Formation of creases on the surfaces of elastomers and gels",
   Appl. Phys. Lett. 95, 111901 (2009).
.. [2] M. A. Biot, "Surface instability of rubber in compression", Appl. Sci. Res. A 12, 168-182
   (1963).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from acoustube.base.types import Array, Index
from acoustube.indentation.mesh import Mesh

STIFFNESS = 6.0
"""Stiffness of the penalty, in shear moduli.

A sixth of it changes the force by 0.02 % at a depth of 7 mm, 0.2 % at 7.5 mm and 0.9 % at 8 mm,
where the lumen of the default tube is closed; without the penalty the folds crease."""
ANGULAR_POWER = 8
"""Exponent of the sine of the angle from the bottom line, in a weight that favours the sides."""
SIXTH_DIFFERENCE = np.array([1.0, -6.0, 15.0, -20.0, 15.0, -6.0, 1.0])
"""Coefficients of the sixth central difference."""


def stiffness(mesh: Mesh, shear_modulus: float) -> sparse.csr_array:
    """Return the stiffness matrix of the penalty.

    Parameters
    ----------
    mesh : Mesh
        Of a swept tube; the matrix is zero for other meshes.
    shear_modulus : float
        Of the wall, in Pa.

    Returns
    -------
    sparse array of shape (3 n_nodes, 3 n_nodes)
        In N/m, the components of a node next to each other; of the modelled part.
    """
    n_nodes = len(mesh.points)
    if mesh.sweep is None:
        return sparse.csr_array((3 * n_nodes, 3 * n_nodes))
    stencils, mirrored, weights = _stencils_around(mesh)
    # In the mirror image about x = 0 the displacement along x has the opposite sign.
    odd, even = (
        _squared(stencils, SIXTH_DIFFERENCE * signs, STIFFNESS * shear_modulus * weights, n_nodes)
        for signs in (np.where(mirrored, -1.0, 1.0), np.ones(mirrored.shape))
    )
    across, rest = sparse.diags_array([1.0, 0.0, 0.0]), sparse.diags_array([0.0, 1.0, 1.0])
    return (sparse.kron(odd, across) + sparse.kron(even, rest)).tocsr()


def _squared(stencils: Index, factors: Array, weights: Array, n_nodes: int) -> sparse.csr_array:
    """Return the Hessian D^T W D of half the weighted sum of squared differences D u."""
    rows = np.repeat(np.arange(len(stencils)), SIXTH_DIFFERENCE.size)
    shape = (len(stencils), n_nodes)
    difference = sparse.csr_array((factors.ravel(), (rows, stencils.ravel())), shape=shape)
    return (difference.T @ sparse.diags_array(weights) @ difference).tocsr()


def _stencils_around(mesh: Mesh) -> tuple[Index, NDArray[np.bool_], Array]:
    """Return the stencils of the sixth difference at the nodes of the rings of element corners.

    Returns
    -------
    stencils : array of shape (n, 7)
        Node numbers in circumferential order.
    mirrored : array of bool, shape (n, 7)
        True for nodes beyond x = 0, which are mirror images.
    weights : array of shape (n,)
        Tributary length along the tube in m, times the angular weight.
    """
    assert mesh.sweep is not None
    half, grid = SIXTH_DIFFERENCE.size // 2, mesh.sweep
    inner = np.unique(mesh.inner_faces)
    stations, at = np.unique(grid.station[inner], return_inverse=True)
    # Mid-length stations have nodes at element corners only, not halfway between.
    ends = stations[::2]
    spacing = np.diff(ends, prepend=ends[0], append=ends[-1])
    lengths = (spacing[:-1] + spacing[1:]) / 2 * mesh.points[:, 2].max()
    found = []
    for i, length in enumerate(lengths):
        ring = inner[at == 2 * i]
        places = np.arange(len(ring))
        places = np.pad(places, half, "reflect") if mesh.halved[0] else np.pad(places, half, "wrap")
        outside = np.pad(np.zeros(len(ring), bool), half, constant_values=mesh.halved[0])
        windows, beyond = (
            np.lib.stride_tricks.sliding_window_view(values, SIXTH_DIFFERENCE.size)
            for values in (ring[places], outside)
        )
        found.append((windows, beyond, length * np.abs(grid.across[ring]) ** ANGULAR_POWER))
    stencils, mirrored, weights = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return stencils, mirrored, weights
