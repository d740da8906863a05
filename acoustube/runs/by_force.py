"""Presses at given forces, interpolated on a load path that was solved by depth.

A press is solved by depth, since a wall that snaps through has several states at one force; as long
as the force rises along the path, each force belongs to one depth. On soft ground part of the
indentation depth is the settlement of the ground; the sound depends on the closure of the lumen,
which is therefore given too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator

from acoustube.base.errors import ConfigError, SimulationError
from acoustube.base.types import Array
from acoustube.base.units import MM
from acoustube.indentation import Indentation
from acoustube.lumen import inner_wall, measure

FORCE_DROP_TOLERANCE = 1e-3
"""Fall of the force between increments, relative to its maximum, that counts as solver error."""

LARGEST_SPACING = 1 / 12
"""Largest distance of the depths that are interpolated between, in bore diameters."""


@dataclass(frozen=True, eq=False)
class ByForce:
    """Presses at given forces; all arrays have the forces' shape.

    Attributes
    ----------
    force : array
        In N.
    depth : array
        Indentation depth from first contact in m.
    closing : array
        Closure of the lumen: loss of its height at the press, in m.
    sinking : array
        Settlement of the ground under the tube's bottom line at the press, in m.
    lumen_area : array
        At the press, in m2.
    """

    force: Array
    depth: Array
    closing: Array
    sinking: Array
    lumen_area: Array


def by_force(indentation: Indentation, force: ArrayLike) -> ByForce:
    """Interpolate a load path at given contact forces.

    Parameters
    ----------
    indentation : Indentation
        A path from first contact; see :func:`acoustube.indentation.indent`.
    force : array_like
        Total over all indenters, in N.

    Raises
    ------
    ConfigError
        If a force is negative, or more than at the path's end, or depths are too far apart.
    SimulationError
        If the force falls along the path, so that the depth is not unique.

    Notes
    -----
    Between increments by monotonic cubics (PCHIP), which are monotone in the force.
    """
    wanted, path = np.asarray(force, float), indentation.contact_force
    spacing = LARGEST_SPACING * indentation.tube.inner_diameter
    widest = float(np.diff(indentation.depth).max())
    if widest > spacing:
        raise ConfigError(
            f"The press has depths {MM * widest:.3g} mm apart, too far to interpolate between; "
            f"press to depths at most {MM * spacing:.3g} mm apart."
        )
    fall = np.maximum.accumulate(path) - path
    if np.any(fall > FORCE_DROP_TOLERANCE * path.max()):
        row = int(np.argmax(fall))
        raise SimulationError(
            f"the force falls to {path[row]:.3g} N at {MM * indentation.depth[row]:.3g} mm depth, "
            "so that the depth is not unique; give a depth"
        )
    outside = wanted[~((wanted >= 0) & (wanted <= path[-1]))]
    if outside.size:
        raise ConfigError(
            f"is not between 0 and {path[-1]:.4g} N, which the path reaches at "
            f"{MM * indentation.depth[-1]:.4g} mm", setting="force", value=float(outside[0]),
            unit="N", allowed=(0.0, float(path[-1])), advice="press deeper",
        )  # fmt: skip
    rising = np.concatenate([[True], path[1:] > np.maximum.accumulate(path)[:-1]])
    table = np.stack(_along(indentation), axis=1)[rising]
    found = PchipInterpolator(path[rising], table)(wanted)
    return ByForce(wanted, *np.moveaxis(found, -1, 0))


def _along(indentation: Indentation) -> tuple[Array, Array, Array, Array]:
    """Return depth, loss of lumen height, settlement and lumen area at each increment."""
    mesh, wall = indentation.mesh, inner_wall(indentation.mesh)
    middle = np.array([indentation.indenters[0].z])
    rows = range(len(indentation.depth))
    sections = [measure(indentation, row, middle, wall) for row in rows]
    height = np.array([float(section.height[0]) for section in sections])
    area = np.array([float(section.area[0]) for section in sections])
    below = mesh.bottom[np.argmin(np.abs(mesh.points[mesh.bottom, 2] - middle[0]))]
    sinking = -indentation.displacement[:, below, 1]
    return indentation.depth, height[0] - height, sinking, area
