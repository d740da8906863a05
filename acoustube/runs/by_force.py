"""From force to press: what a tool that is pushed, and not moved, does on a given substrate.

A press is solved by depth, since a wall that snaps has several states at one force; as long as the
force rises along the path, each force on it belongs to one depth. On soft ground the tool's travel
says little: part of it is the ground's. What the sound meets is the lumen, so that its loss of
height stands beside the travel.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import PchipInterpolator

from acoustube.base.errors import ConfigError, SimulationError
from acoustube.base.types import Array
from acoustube.indentation import Indentation
from acoustube.lumen import inner_wall, measure

FALLING = 1e-3
"""Share of the greatest force by which it may fall between increments, as solvers do, not walls."""


@dataclass(frozen=True, eq=False)
class ByForce:
    """Presses at given forces; all arrays have the forces' shape.

    Attributes
    ----------
    force : array
        In N.
    depth : array
        The tool's travel from first touch in m.
    closing : array
        By how much the lumen at the press is lower than the bore, in m.
    sinking : array
        By how much the tube's bottom line at the press sinks into the ground, in m.
    lumen_area : array
        At the press, in m2.
    """

    force: Array
    depth: Array
    closing: Array
    sinking: Array
    lumen_area: Array


def by_force(indentation: Indentation, force: ArrayLike) -> ByForce:
    """Return the presses of a path at which a tool bears given forces.

    Parameters
    ----------
    indentation : Indentation
        A path from first touch; see :func:`acoustube.indentation.indent`.
    force : array_like
        On all its tools together, in N.

    Returns
    -------
    ByForce

    Raises
    ------
    ConfigError
        If a force is negative, or more than at the path's end.
    SimulationError
        If the force falls on the way, so that it does not tell the press.

    Notes
    -----
    Between increments by monotonic cubics (PCHIP), which keep the order of forces.
    """
    wanted, path = np.asarray(force, float), indentation.contact_force
    fall = np.maximum.accumulate(path) - path
    if np.any(fall > FALLING * path.max()):
        row = int(np.argmax(fall))
        raise SimulationError(
            f"the force falls to {path[row]:.3g} N at {1e3 * indentation.depth[row]:.3g} mm depth, "
            "so that it does not tell the press; give a depth"
        )
    outside = wanted[~((wanted >= 0) & (wanted <= path[-1]))]
    if outside.size:
        raise ConfigError(
            f"force = {outside[0]:.4g} N is not between 0 and {path[-1]:.4g} N, which the path "
            f"reaches at {1e3 * indentation.depth[-1]:.4g} mm; press deeper"
        )
    rising = np.concatenate([[True], path[1:] > np.maximum.accumulate(path)[:-1]])
    table = np.stack(_along(indentation), axis=1)[rising]
    found = PchipInterpolator(path[rising], table)(wanted)
    return ByForce(wanted, *np.moveaxis(found, -1, 0))


def _along(indentation: Indentation) -> tuple[Array, Array, Array, Array]:
    """Return depth, closing, sinking and lumen area at each increment."""
    mesh, wall = indentation.mesh, inner_wall(indentation.mesh)
    middle = np.array([indentation.indenters[0].z])
    rows = range(len(indentation.depth))
    sections = [measure(indentation, row, middle, wall) for row in rows]
    height = np.array([float(section.height[0]) for section in sections])
    area = np.array([float(section.area[0]) for section in sections])
    below = mesh.bottom[np.argmin(np.abs(mesh.points[mesh.bottom, 2] - middle[0]))]
    sinking = -indentation.displacement[:, below, 1]
    return indentation.depth, height[0] - height, sinking, area
