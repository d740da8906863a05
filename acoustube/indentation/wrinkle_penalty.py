"""What keeps the inner surface of the lateral folds smooth.

A tube that is pressed flat folds at its sides. There the inner surface is compressed along the fold
to less than 0.65 of its length from a depth of about three quarters of the bore: past the limit at
which the free surface of a Neo-Hookean solid creases [1]_, and later past that at which it loses
stiffness against wrinkles of any length (0.54) [2]_. A mesh then creases at the size of its
elements, which is a state of the mesh, not of the tube; where real silicone creases, the crease is
far smaller than anything that matters to the sound.

So the inner wall carries a skin that resists nothing but wrinkles of the size of its elements: an
energy in the sixth differences of the displacement around the sections, at the sides of the tube.
Of a smooth displacement they vanish with the sixth power of the spacing.

References
----------
.. [1] W. Hong, X. Zhao, Z. Suo, "Formation of creases on the surfaces of elastomers and gels",
   Appl. Phys. Lett. 95, 111901 (2009). doi:10.1063/1.3211917
.. [2] M. A. Biot, "Surface instability of rubber in compression", Appl. Sci. Res. A 12, 168-182
   (1963). doi:10.1007/BF03184638
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from acoustube.base.types import Array, Index
from acoustube.indentation.mesh import Mesh

STIFFNESS = 6.0
"""Of the skin, in shear moduli.

A sixth as much changes the force by 0.02 % up to 7 mm, 0.2 % at 7.5 mm and 0.9 % at 8 mm, where the
lumen of the paper's tube is closed; none lets the folds crease."""
CONCENTRATION = 8
"""Power of the sine of the angle from the bottom line with which the skin fades from the sides."""
DIFFERENCE = np.array([1.0, -6.0, 15.0, -20.0, 15.0, -6.0, 1.0])


def skin(mesh: Mesh, shear_modulus: float) -> sparse.csr_array:
    """Return the skin's stiffness.

    Parameters
    ----------
    mesh : Mesh
        A swept tube's; other meshes have no skin.
    shear_modulus : float
        Of the wall, in Pa.

    Returns
    -------
    sparse array of shape (3 n_nodes, 3 n_nodes)
        In N/m, the components of a node next to each other. A symmetric part has its share of the
        whole tube's.
    """
    n_nodes = len(mesh.points)
    if mesh.sweep is None:
        return sparse.csr_array((3 * n_nodes, 3 * n_nodes))
    stencils, mirrored, weights = _around(mesh)
    # In the mirror image of x = 0 the displacement along x has the other sign.
    odd, even = (
        _stiffness(stencils, DIFFERENCE * signs, STIFFNESS * shear_modulus * weights, n_nodes)
        for signs in (np.where(mirrored, -1.0, 1.0), np.ones(mirrored.shape))
    )
    across, rest = sparse.diags_array([1.0, 0.0, 0.0]), sparse.diags_array([0.0, 1.0, 1.0])
    return (sparse.kron(odd, across) + sparse.kron(even, rest)).tocsr()


def _stiffness(stencils: Index, factors: Array, weights: Array, n_nodes: int) -> sparse.csr_array:
    """Return the second derivative of half the weighted squares of differences."""
    rows = np.repeat(np.arange(len(stencils)), DIFFERENCE.size)
    shape = (len(stencils), n_nodes)
    difference = sparse.csr_array((factors.ravel(), (rows, stencils.ravel())), shape=shape)
    return (difference.T @ sparse.diags_array(weights) @ difference).tocsr()


def _around(mesh: Mesh) -> tuple[Index, NDArray[np.bool_], Array]:
    """Return, for every node of every ring, what the difference around it is made of.

    Returns
    -------
    stencils : array of shape (n, 7)
        Numbers of the nodes around, in their order.
    mirrored : array of bool, shape (n, 7)
        Whether a mirror image of the node is meant, beyond x = 0.
    weights : array of shape (n,)
        Length in m along the tube that it stands for, fading from the sides.
    """
    assert mesh.sweep is not None
    half, grid = DIFFERENCE.size // 2, mesh.sweep
    inner = np.unique(mesh.inner_faces)
    stations, at = np.unique(grid.station[inner], return_inverse=True)
    # Half way along the elements there is a node at every other place only.
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
            np.lib.stride_tricks.sliding_window_view(values, DIFFERENCE.size)
            for values in (ring[places], outside)
        )
        found.append((windows, beyond, length * np.abs(grid.across[ring]) ** CONCENTRATION))
    stencils, mirrored, weights = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return stencils, mirrored, weights
