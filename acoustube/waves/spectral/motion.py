"""Motions of a wall with a parameter: the depth of a press, the size of an indenter, the bore.

Quantities that depend on the wall through integrals only are differentiated by central differences
of these integrals, between walls displaced by `DISPLACEMENT` of the radius. The error is of second
order in the displacement, and no solution is differenced.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from acoustube.base.errors import ConfigError
from acoustube.waves.spectral.polynomials import Array
from acoustube.waves.spectral.walls import Wall

DISPLACEMENT = 1e-6
"""Largest displacement of the wall in either direction, relative to the radius of the ends. The
relative error of a derivative is then 1e-10 due to rounding, 1e-7 due to the differences in a gap
of 20 um."""
SLOPE_STEP = 1e-5
"""Step in z of the central differences for the z derivative of a motion, relative to the radius."""
SAMPLES = 200
"""Number of sections at which displacements are evaluated, for their maximum and symmetries, and
also at the sections' mirror images about the middle."""
ALIKE = 1e-5
"""Largest difference of displacements that count as equal, relative to the largest displacement."""

Velocity = Callable[[Array, Array], tuple[Array, Array]]
"""Derivative of a wall's position by a parameter of its shape, such as the depth of a press: a
function of z (n, 1) in m and of the angle t along the contour, from 0 to 2 pi, (n_points,). Its
values are the derivatives of x and y in m per unit of that parameter, (n, n_points) each."""


class Motion(NamedTuple):
    """Motion of a wall with a parameter, and the walls before and after a small parameter step.

    Attributes
    ----------
    velocity : callable
        See `Velocity`.
    less, more : Wall
        The walls before and after.
    step : float
        Step of the parameter between the two walls.
    ends : bool
        Whether the straight ends move.
    """

    velocity: Velocity
    less: Wall
    more: Wall
    step: float
    ends: bool


def wall_motion(before: Wall, after: Wall, change: float) -> Velocity:
    """Return the motion of a wall per unit of a parameter, from the walls at two of its values.

    Parameters
    ----------
    before, after : Wall
        Walls with the same number of points around, such as those of one press at two depths.
    change : float
        Change of the parameter between them. If the two values lie symmetrically about that of the
        wall that moves, the error is of second order in the change.

    Returns
    -------
    callable
        A function for the argument `velocity` of :func:`scatter_spectral`.
    """

    def velocity(z: Array, t: Array) -> tuple[Array, Array]:
        moved = [
            (there - here) / change
            for here, there in zip(before.lines(z[:, 0])[:2], after.lines(z[:, 0])[:2], strict=True)
        ]
        turn = 2 * np.pi * np.arange(moved[0].shape[1] + 1) / moved[0].shape[1]
        x, y = (
            CubicSpline(turn, np.concatenate([part, part[:, :1]], 1), axis=1, bc_type="periodic")(t)
            for part in moved
        )
        return x, y

    return velocity


def motion_of(wall: Wall, velocity: Velocity) -> Motion:
    """Return a motion of a wall, with the walls before and after a small step.

    Raises
    ------
    ConfigError
        If the wall is symmetric and the motion is not, if the ends move differently, or if round
        ends do not stay round.
    """
    low, high = wall.ends
    sections = np.linspace(low - wall.radius, high + wall.radius, SAMPLES)
    sections = np.sort(np.append(sections, 2 * wall.middle - sections))
    n = wall.lines(sections[:1])[0].shape[1]
    x, y = _at(velocity, sections, n)
    fastest = float(np.hypot(x, y).max())
    size = DISPLACEMENT * wall.radius / fastest if fastest > 0 else 1.0
    same = ALIKE * fastest
    if wall.symmetric:
        _require(np.abs(x + _mirrored(x)).max() <= same, "is symmetric about x = 0")
        _require(np.abs(y - _mirrored(y)).max() <= same, "is symmetric about x = 0")
    if wall.reversible:
        apart = max(np.abs(x - x[::-1]).max(), np.abs(y - y[::-1]).max())
        _require(apart <= same, "is symmetric about its middle")
    apart = max(np.abs(x[0] - x[-1]).max(), np.abs(y[0] - y[-1]).max())
    if apart > same:
        raise ConfigError(
            "the motion of the wall must be the same at both ends; give one that is zero there"
        )
    t = 2 * np.pi * np.arange(n) / n
    widening = 0.0
    if wall.circular:
        there_x, there_y, *_ = (part[0] for part in wall.lines(sections[:1]))
        radius = np.hypot(there_x, there_y)
        outwards = (x[0] * there_x + y[0] * there_y) / radius
        widening = float(outwards.mean())
        if np.abs(outwards - widening).max() > same:
            raise ConfigError(
                "the wall's displacement must keep its round ends round; give a wall with "
                "circular=False, or a displacement that does not change the ends"
            )
    less, more = (
        replace(
            wall,
            lines=_displaced(wall, velocity, t, by),
            radius=wall.radius + by * widening,
            unmoved=wall,
        )
        for by in (-size, size)
    )
    ends = float(np.hypot(x[0], y[0]).max()) > same
    return Motion(velocity, less, more, 2 * size, ends)


def _require(kept: np.bool_ | bool, what: str) -> None:
    if not kept:
        raise ConfigError(
            f"the motion breaks a symmetry of the wall, which {what}; declare the wall without it "
            "(symmetric=False, reversible=False), or give a motion that keeps it"
        )


def _mirrored(speed: Array) -> Array:
    """Return velocities, (n, n_points), taken at the points mirrored about x = 0."""
    return np.roll(speed[:, ::-1], 1, axis=1)


def _at(velocity: Velocity, z: Array, n: int) -> tuple[Array, Array]:
    """Return the x and y components of a velocity at n lines of a wall, (n_sections, n) each."""
    still = np.zeros((len(z), n))
    x, y = velocity(z[:, None], 2 * np.pi * np.arange(n) / n)
    return still + x, still + y


def _displaced(
    wall: Wall, velocity: Velocity, t: Array, by: float
) -> Callable[[Array], tuple[Array, Array, Array, Array]]:
    """Return the function `lines` of a wall displaced by the step `by` of the parameter."""
    h = SLOPE_STEP * wall.radius

    def lines(z: Array) -> tuple[Array, Array, Array, Array]:
        here, before, after = (_at(velocity, z + d, len(t)) for d in (0.0, -h, h))
        along = [(b - a) / (2 * h) for a, b in zip(before, after, strict=True)]
        x, y, x_z, y_z = wall.lines(z)
        return x + by * here[0], y + by * here[1], x_z + by * along[0], y_z + by * along[1]

    return lines
