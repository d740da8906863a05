"""Result of an indentation: displacements, forces and contact at every increment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acoustube.base.errors import SimulationError
from acoustube.base.types import Array
from acoustube.indentation.assembly import EquilibriumResults
from acoustube.indentation.contact import Body
from acoustube.indentation.indenters import (
    Indenter,
    Layer,
    Support,
    ground_body,
    indenter_bodies,
)
from acoustube.indentation.material import Material
from acoustube.indentation.mesh import Mesh
from acoustube.tube import Tube

RESULTS = ("depth", "displacement", "iterations", "residual", *EquilibriumResults._fields)
"""Names of the arrays of an indentation with a row per increment."""


@dataclass(frozen=True, eq=False)
class Indentation:
    """Result of a press at every increment; the first row is first contact.

    Parameters
    ----------
    tube : Tube
    indenters : tuple of Indenter
    support : {"held", "free"}
    layer : Layer or None
    material : Material
    mesh : Mesh
        Undeformed mesh of the modelled part.
    depth : array of shape (n_increments,)
        Indentation depth in m. An indenter has travelled this depth times its `depth_fraction`
        since first contact.
    displacement : array of shape (n_increments, n_nodes, 3)
        Nodal displacements in m.
    iterations : array of shape (n_increments,)
        Newton iterations of each increment.
    residual : array of shape (n_increments,)
        Norm of the residual (out-of-balance) nodal forces, in N.
    press_force, contact_area : arrays of shape (n_increments, n_indenters)
        Upward force on each indenter in N and its contact area in m2, of the whole tube.
    energy : array of shape (n_increments,)
        Elastic energy of the whole tube in J.
    smallest_volume_ratio : array of shape (n_increments,)
        Smallest volume ratio J at the quadrature points.
    smallest_gap : array of shape (n_increments,)
        Smallest distance across the lumen in m, between the lower and the upper part of the inner
        wall.
    touch_heights : tuple of float
        Height y in m of the lowest point of each indenter at first contact.
    barrier_distance : float
        Activation distance of the self-contact barrier, in m.
    """

    tube: Tube
    indenters: tuple[Indenter, ...]
    support: Support
    layer: Layer | None
    material: Material
    mesh: Mesh
    depth: Array
    displacement: Array
    iterations: NDArray[np.int64]
    residual: Array
    press_force: Array
    contact_area: Array
    energy: Array
    smallest_volume_ratio: Array
    smallest_gap: Array
    touch_heights: tuple[float, ...]
    barrier_distance: float

    @property
    def contact_force(self) -> Array:
        """Total force in N on all indenters, shape (n_increments,)."""
        return self.press_force.sum(axis=1)

    @property
    def closed(self) -> NDArray[np.bool_]:
        """Mask of increments with a closed lumen: gap under `barrier_distance`, (n_increments,)."""
        return self.smallest_gap < self.barrier_distance

    @property
    def results(self) -> dict[str, Array]:
        """All arrays with a row per increment, by name."""
        return {name: getattr(self, name) for name in RESULTS}

    def rows_at(self, depths: Sequence[float]) -> list[int]:
        """Return the numbers of the increments at given depths.

        Parameters
        ----------
        depths : sequence of float
            In m; depths without an increment are left out.
        """
        wanted = set(depths)
        return [i for i, depth in enumerate(self.depth) if depth in wanted]

    def position(self, increment: int = -1) -> Array:
        """Return the positions of the deformed nodes of an increment.

        Parameters
        ----------
        increment : int, optional
            Number of the increment; the last by default.

        Returns
        -------
        array of shape (n_nodes, 3)
            In m.
        """
        return self.mesh.points + self.displacement[increment]

    def bodies(self, increment: int = -1) -> tuple[Body, ...]:
        """Return the indenters and, last, the ground as contact bodies at an increment.

        Parameters
        ----------
        increment : int, optional
            Number of the increment; the last by default.
        """
        return bodies_at(self, self.depth[increment])


class PressError(SimulationError):
    """A press whose increments stopped converging.

    Attributes
    ----------
    indentation : Indentation
        Every converged increment.
    """

    def __init__(self, message: str, indentation: Indentation) -> None:
        super().__init__(message)
        self.indentation = indentation


def bodies_at(indentation: Indentation, depth: float) -> tuple[Body, ...]:
    """Return the indenters and, last, the ground as contact bodies.

    Parameters
    ----------
    indentation : Indentation
    depth : float
        Indentation depth in m.
    """
    tube, indenters = indentation.tube, indentation.indenters
    heights = [
        touch - indenter.depth_fraction * depth
        for touch, indenter in zip(indentation.touch_heights, indenters, strict=True)
    ]
    bottom = np.float64(indentation.mesh.points[:, 1].min())
    wall = np.float64(tube.shear_modulus), np.float64(tube.wall_thickness)
    ground = ground_body(*wall, bottom, indentation.layer)
    return *indenter_bodies(tube, indenters, heights), ground
