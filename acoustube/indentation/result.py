"""Results of an indentation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acoustube.base.errors import SimulationError
from acoustube.base.types import Array
from acoustube.indentation import indenters
from acoustube.indentation.assembly import Measures
from acoustube.indentation.contact import Body
from acoustube.indentation.indenters import Layer, Press, Support
from acoustube.indentation.material import Material
from acoustube.indentation.mesh import Mesh
from acoustube.tube import Tube

RESULTS = ("depth", "displacement", "iterations", "residual", *Measures._fields)
"""Names of an indentation's arrays with a row per increment."""


@dataclass(frozen=True, eq=False)
class Indentation:
    """A press, increment by increment; the first row is first touch.

    Parameters
    ----------
    tube : Tube
    presses : tuple of Press
    support : {"held", "free"}
    layer : Layer or None
    material : Material
    mesh : Mesh
        The undeformed part that is modelled.
    depth : array of shape (n_increments,)
        How far the presses have come down from first touch, in m (times the share of each).
    displacement : array of shape (n_increments, n_nodes, 3)
        Nodal displacements in m.
    iterations : array of shape (n_increments,)
        Newton iterations that each increment took.
    residual : array of shape (n_increments,)
        Norm of the out-of-balance nodal forces, in N.
    press_force, contact_area : arrays of shape (n_increments, n_presses)
        Of the whole tube: upward force in N on each press, and the deformed area in m2 that it
        touches.
    energy : array of shape (n_increments,)
        Elastic energy of the whole tube in J.
    smallest_volume_ratio : array of shape (n_increments,)
        Smallest J at any quadrature point.
    smallest_gap : array of shape (n_increments,)
        Between the lower and the upper inner wall, in m.
    touch_heights : tuple of float
        Height y in m of the lowest point of each press at first touch.
    closing_distance : float
        Gap in m at which the lumen's walls begin to feel each other.
    """

    tube: Tube
    presses: tuple[Press, ...]
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
    closing_distance: float

    @property
    def contact_force(self) -> Array:
        """Force in N of all presses together, shape (n_increments,)."""
        return self.press_force.sum(axis=1)

    @property
    def closed(self) -> NDArray[np.bool_]:
        """Whether the lumen's walls feel each other, shape (n_increments,)."""
        return self.smallest_gap < self.closing_distance

    @property
    def results(self) -> dict[str, Array]:
        """All arrays with a row per increment, by name."""
        return {name: getattr(self, name) for name in RESULTS}

    def rows_at(self, depths: Sequence[float]) -> list[int]:
        """Return the numbers of those increments that are at one of the given depths, in m."""
        wanted = set(depths)
        return [i for i, depth in enumerate(self.depth) if depth in wanted]

    def position(self, increment: int = -1) -> Array:
        """Return the deformed nodes, shape (n_nodes, 3), in m."""
        return self.mesh.points + self.displacement[increment]

    def bodies(self, increment: int = -1) -> tuple[Body, ...]:
        """Return the presses at an increment, and last the ground."""
        return bodies_at(self, self.depth[increment])


class PressError(SimulationError):
    """A press that could not go on.

    Attributes
    ----------
    indentation : Indentation
        Every increment that had converged.
    """

    def __init__(self, message: str, indentation: Indentation) -> None:
        super().__init__(message)
        self.indentation = indentation


def bodies_at(indentation: Indentation, depth: float) -> tuple[Body, ...]:
    """Return the presses at a depth in m, and last the ground."""
    tube, presses = indentation.tube, indentation.presses
    heights = [
        touch - press.share * depth
        for touch, press in zip(indentation.touch_heights, presses, strict=True)
    ]
    bottom = np.float64(indentation.mesh.points[:, 1].min())
    wall = np.float64(tube.shear_modulus), np.float64(tube.wall_thickness)
    return *indenters.tools(tube, presses, heights), indenters.ground(
        *wall, bottom, indentation.layer
    )
