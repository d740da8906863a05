"""Guide of a press: its load path on a coarse mesh, interpolated at the nodes of the fine one.

Few elements and a loose tolerance suffice to find where contact begins and which way the wall
folds. The fine mesh then needs only a correction at each requested depth, and no load path of its
own. The idea is the nested iteration of multigrid methods [1]_.

References
----------
.. [1] W. L. Briggs, V. E. Henson, S. F. McCormick, "A Multigrid Tutorial", 2nd ed., SIAM (2000),
   chapter 3.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.interpolate import PchipInterpolator

from acoustube.base.types import Array, Index
from acoustube.indentation.indenters import Indenter
from acoustube.indentation.mesh import Mesh, MeshSize, Sweep, sweep
from acoustube.indentation.result import Indentation
from acoustube.tube import Tube

COARSE = MeshSize(through_wall=1, around=12, along=10)
"""Numbers of elements of the coarse mesh."""
LEAST_RATIO = 2.0
"""Smallest ratio of the fine to the coarse mesh's number of elements at which a guide is used."""


class Guide(NamedTuple):
    """A load path on a coarse mesh, with its interpolation at the nodes of a fine mesh.

    Attributes
    ----------
    reach : float
        Largest depth of the load path in m.
    path : callable
        Interpolates the displacements on the coarse mesh, (n_coarse, 3) in m, at a depth in m.
    prolongation : sparse array of shape (n_nodes, n_coarse)
        Interpolates values of the coarse mesh at the nodes of the fine one.
    """

    reach: float
    path: PchipInterpolator
    prolongation: sparse.csr_array

    def displacement(self, depth: float) -> Array:
        """Return the displacements (n_nodes, 3) of the fine mesh's nodes at a depth, both in m."""
        return np.asarray(self.prolongation @ self.path(depth))


def guide(coarse: Indentation, fine: Mesh) -> Guide:
    """Return the interpolation of a coarse mesh's load path at the nodes of a fine mesh.

    Parameters
    ----------
    coarse : Indentation
        Press of a mesh from :func:`coarse_mesh`, with at least two rows.
    fine : Mesh
        Swept mesh of the same part of the tube.
    """
    path = PchipInterpolator(coarse.depth, coarse.displacement)
    return Guide(float(coarse.depth[-1]), path, prolongation(coarse.mesh, fine))


def coarse_mesh(fine: Mesh, tube: Tube, indenters: Sequence[Indenter]) -> Mesh | None:
    """Return a coarse mesh of the part of a round tube that a fine mesh covers.

    Parameters
    ----------
    fine : Mesh
    tube : Tube
    indenters : sequence of Indenter

    Returns
    -------
    Mesh or None
        None if the fine mesh is not swept, or has too few elements for a guide.
    """
    if fine.sweep is None:
        return None
    places = [indenter.z for indenter in indenters]
    mesh = sweep(tube, fine.points[:, 2].max(), COARSE, halved=fine.halved, presses=places)
    return mesh if len(fine.elements) >= LEAST_RATIO * len(mesh.elements) else None


def prolongation(coarse: Mesh, fine: Mesh) -> sparse.csr_array:
    """Return the interpolation of nodal values from one mesh of a tube to another.

    Parameters
    ----------
    coarse, fine : Mesh
        Swept, of the same part of the tube.

    Returns
    -------
    sparse array of shape (n_fine, n_coarse)
    """
    assert coarse.sweep is not None
    assert fine.sweep is not None
    whole = not coarse.halved[0]
    places = [
        _element_coordinates(own, other, period)
        for own, other, period in zip(
            _coordinates(coarse.sweep),
            _coordinates(fine.sweep),
            (None, 2 * np.pi if whole else None, None),
            strict=True,
        )
    ]
    (i, a), (j, b), (k, c) = places
    _, around, through = coarse.sweep.shape
    nodes = coarse.elements[(i * around + j) * through + k]
    shapes, _ = coarse.reference.shape_functions(np.stack([c, b, a], axis=-1))
    rows = np.repeat(np.arange(len(nodes)), nodes.shape[1])
    shape = len(fine.points), len(coarse.points)
    return sparse.csr_array((shapes.ravel(), (rows, nodes.ravel())), shape=shape)


def _coordinates(grid: Sweep) -> tuple[Array, Array, Array]:
    """Return station, angle from the bottom line in rad, and layer of every node, as in `Sweep`."""
    angle = np.arctan2(grid.across, -grid.up) % (2 * np.pi)
    return grid.station, np.where(np.isclose(angle, 2 * np.pi), 0.0, angle), grid.layer


def _element_coordinates(own: Array, other: Array, period: float | None) -> tuple[Index, Array]:
    """Return the element that holds each fine node, counted along an axis, and the place in it.

    `own` and `other` are the coordinates of the coarse and of the fine nodes along the axis;
    `period` is the axis's length if it is closed. The place is the local coordinate, -1 to 1.
    """
    lines = np.unique(np.round(own, 9))
    if period is not None:
        lines = np.append(lines, period)
    place = np.interp(other, lines, np.arange(len(lines)) / 2)
    element = np.minimum(place.astype(int), len(lines) // 2 - 1)
    return element, 2 * (place - element) - 1
