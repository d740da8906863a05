"""Presses at given contact forces, interpolated on a load path that was solved at given depths.

The finite elements prescribe the depth, since a wall that snaps through has several states at one
force. As long as the force rises along the path, each force belongs to one depth. On soft ground
part of the indentation depth is the settlement of the ground. The sound depends on the loss of
height of the lumen, which is therefore returned too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from acoustube.base.errors import ConfigError, SimulationError
from acoustube.base.types import Array
from acoustube.base.units import MM
from acoustube.indentation import DepthPath, Indentation
from acoustube.lumen import inner_wall, measure

FORCE_DROP_TOLERANCE = 1e-3
"""Largest fall of the force below its earlier maximum that counts as solver error, relative to the
largest force of the load path."""

LARGEST_SPACING = 1 / 12
"""Largest spacing of the depths of a load path that is interpolated, in bore diameters."""
BISECTIONS = 50
"""Number of bisections between two solved depths of a load path, down to round-off."""


@dataclass(frozen=True, eq=False)
class ByForce:
    """Presses at given contact forces; all arrays have the shape of the forces.

    With several indenters, lumen and ground are those at the first one.

    Attributes
    ----------
    force : array
        Contact force in N.
    depth : array
        Indentation depth from first contact in m.
    closing : array
        Closure of the lumen: loss of its height at the press, in m.
    sinking : array
        Settlement of the ground under the tube's bottom line at the press, in m.
    lumen_area : array
        Cross-section of the lumen at the press, in m2.
    force_error : array
        Estimated error of the interpolated force at `depth`, in N. The force of a press solved at
        that depth differs from the requested one by up to about twice this error.
    """

    force: Array
    depth: Array
    closing: Array
    sinking: Array
    lumen_area: Array
    force_error: Array


def by_force(indentation: Indentation, force: ArrayLike) -> ByForce:
    """Return depth, lumen and settlement of a load path at given contact forces.

    Parameters
    ----------
    indentation : Indentation
        Load path from first contact; see :func:`acoustube.indentation.indent`.
    force : array_like
        Total contact force of all indenters, in N.

    Raises
    ------
    ConfigError
        If a force is negative or exceeds that at the end of the path, or if the path has fewer than
        five depths, with that of first contact, or depths more than :data:`LARGEST_SPACING` bore
        diameters apart.
    SimulationError
        If the force falls along the path, so that a force belongs to several depths.

    Notes
    -----
    The depth is where the cubic spline of the force over depth has the given force, between the
    first two solved depths whose forces enclose it. The lumen is that of the interpolated
    wall at this depth, and the error that of :meth:`acoustube.indentation.DepthPath.error`.
    """
    wanted, path = np.asarray(force, float), indentation.contact_force
    spacing = LARGEST_SPACING * indentation.tube.inner_diameter
    widest = float(np.diff(indentation.depth).max(initial=0.0))
    if widest > spacing:
        raise ConfigError(
            f"the press has depths {MM * widest:.3g} mm apart, too far to interpolate between; "
            f"press to depths at most {MM * spacing:.3g} mm apart"
        )
    fall = np.maximum.accumulate(path) - path
    if np.any(fall > FORCE_DROP_TOLERANCE * path.max()):
        row = int(np.argmax(fall))
        raise SimulationError(
            f"the force falls to {path[row]:.3g} N at {MM * indentation.depth[row]:.3g} mm depth, "
            "so that depth is not a unique function of force; give a depth"
        )
    outside = wanted[~((wanted >= 0) & (wanted <= path[-1]))]
    if outside.size:
        raise ConfigError(
            f"is not between 0 and {path[-1]:.4g} N, the force at the last depth, "
            f"{MM * indentation.depth[-1]:.4g} mm", setting="force", value=float(outside[0]),
            unit="N", allowed=(0.0, float(path[-1])),
            advice="use a force in this range, or press deeper",
        )  # fmt: skip
    spline = DepthPath(indentation)
    depth = _depths(spline, np.ravel(wanted))
    each, back = np.unique(depth, return_inverse=True)
    found = each, *_measured(spline, each), spline.error(each).contact_force
    depth, closing, sinking, area, error = (v[back].reshape(wanted.shape) for v in found)
    return ByForce(wanted, depth, closing, sinking, area, error)


def _depths(spline: DepthPath, force: Array) -> Array:
    """Return the depths in m, (n,), at which the spline has forces in N, (n,), by bisection."""
    rows, path = spline.indentation.depth, spline.indentation.contact_force
    # The first solved depth whose force is at least that given; the one before has a lower force.
    after = np.searchsorted(np.maximum.accumulate(path), force)
    low, high = rows[np.maximum(after - 1, 0)], rows[after]
    for _ in range(BISECTIONS):
        middle = (low + high) / 2
        below = spline.contact_force(middle) < force
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return np.asarray(high)


def _measured(spline: DepthPath, depth: Array) -> tuple[Array, Array, Array]:
    """Return closure in m, settlement in m and lumen area in m2 at rising depths in m, all (n,)."""
    mesh, wall = spline.indentation.mesh, inner_wall(spline.indentation.mesh)
    middle = np.array([spline.indentation.indenters[0].z])
    undeformed = measure(spline.indentation, 0, middle, wall)
    states = spline.at(depth)
    sections = [measure(states, row, middle, wall) for row in range(len(depth))]
    height = np.array([float(section.height[0]) for section in sections])
    area = np.array([float(section.area[0]) for section in sections])
    below = mesh.bottom[np.argmin(np.abs(mesh.points[mesh.bottom, 2] - middle[0]))]
    sinking = -states.displacement[:, below, 1]
    return float(undeformed.height[0]) - height, sinking, area
