"""Straightening of a bent tube: coordinates along and across a curve in its plane."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from acoustube.base.checks import FLAG, PLACES, Reals, checked
from acoustube.base.errors import SimulationError
from acoustube.base.types import Array

PROJECTION_STEPS = 30
"""Largest number of Newton steps towards the nearest point of the curve."""
MIN_SLOPE = 0.1
"""Lower bound of the derivative in Newton's method. The derivative is the ratio of a point's
distance from the centre of curvature to the radius of curvature."""


@checked(points=PLACES, line=Reals(-1e6, 1e6, "m", ndim=2, last=3), level=FLAG)
def straighten(points: Array, line: Array, *, level: bool = True) -> Array:
    """Transform points to coordinates along and across a curve in the plane x = 0.

    A tube on a free support lifts off the floor away from the indenter. So gentle a bend does not
    reflect sound, and the wave solver requires a straight tube.

    Parameters
    ----------
    points : array of shape (..., 3)
        Points (x, y, z) in m.
    line : array of shape (n, 3)
        Points on the curve in m, in the order of z.
    level : bool
        Whether the curve's tangent at its first point is along z, as in a plane of symmetry. The
        curvature vanishes at an end whose tangent is not given.

    Returns
    -------
    array of shape (..., 3)
        Coordinates in m: x is unchanged, y is the distance from the curve, positive above it, plus
        the height y of its first point, z is the arc length from there to the nearest point of the
        curve.

    Raises
    ------
    SimulationError
        If the search for the nearest point does not converge, as where a point's distance from the
        curve is not smaller than the radius of curvature.
    ValueError
        If the curve has fewer than two points, or the same point twice in succession.
    """
    points, line = np.asarray(points, float), np.asarray(line, float)
    if len(line) < 2:
        raise ValueError("line has fewer than 2 points; give more")
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    if not np.all(np.diff(arc) > 0):
        raise ValueError("line has the same point twice in succession; give each once")
    # A chord h is shorter than an arc of curvature kappa by a fraction (h kappa)^2 / 24 < 1e-5.
    free = (2, [0.0, 0.0])
    curve = CubicSpline(arc, line[:, 1:], bc_type=((1, [0.0, 1.0]) if level else free, free))
    tangent, turn = curve.derivative(), curve.derivative(2)
    y, z = points[..., 1], points[..., 2]
    s = z - line[0, 2]
    for _ in range(PROJECTION_STEPS):
        offset = np.stack([y, z], axis=-1) - curve(s)
        error = np.sum(offset * tangent(s), axis=-1)
        # Newton's step for the foot of the perpendicular.
        step = error / np.maximum(1 - np.sum(offset * turn(s), axis=-1), MIN_SLOPE)
        s = s + step
        if np.abs(step).max(initial=0.0) < 1e-12:
            break
    else:
        raise SimulationError(
            "the pressed tube is bent too sharply to be straightened; use support 'held', a larger "
            "indenter or a smaller depth"
        )
    direction = tangent(s)
    normal = np.stack([direction[..., 1], -direction[..., 0]], axis=-1)
    across = np.sum((np.stack([y, z], axis=-1) - curve(s)) * normal, axis=-1)
    return np.stack([points[..., 0], line[0, 1] + across, s], axis=-1)
