"""Derivatives of a scattering matrix by motions of the wall.

For a wall that moves outwards by v_n per parameter, Hadamard's formula [1]_ gives, with the fields
x of the ports' loads,

    dZ = -int v_n (grad x . grad x^T - k^2 x x^T) dS

over the wall, without a new solution; dS follows from S = (I + Q)^-1 (Q - I), Q = D Z D.

References
----------
.. [1] Henrot, A., Pierre, M. (2018). Shape Variation and Optimization, chapter 5. European
   Mathematical Society. doi:10.4171/178
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import CubicSpline

from acoustube.waves.spectral.boundary import wall_functions, wall_matrices, wall_points
from acoustube.waves.spectral.discretisation import Discretisation
from acoustube.waves.spectral.polynomials import Array
from acoustube.waves.spectral.ports import Complex, changed_scattering
from acoustube.waves.spectral.reduction import Reduced, projected, ritz
from acoustube.waves.spectral.walls import Wall

Velocity = Callable[[Array, Array], tuple[Array, Array]]
"""From z (n, 1) in m and t (n_points,) to how x and y of the wall move per parameter."""


def wall_motion(before: Wall, after: Wall, change: float) -> Velocity:
    """Return the motion of a wall per unit of a parameter, from the walls at two of its values.

    Parameters
    ----------
    before, after : Wall
        Their lines have the same numbers of points, as those of one press at two depths.
    change : float
        Of the parameter between them. For values on either side of that of the wall that moves, the
        error is of the second order in the change.

    Returns
    -------
    callable
        For the argument `velocity` of :func:`scatter_spectral`.
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


def moved_scattering(
    system: Discretisation,
    spaces: list[Reduced],
    wall: Wall,
    velocity: Velocity,
    k: Array,
    kz: Complex,
) -> list[Complex]:
    """Return the derivative of S of each side.

    Parameters
    ----------
    system : Discretisation
    spaces : list of Reduced
    wall : Wall
    velocity : callable
    k : ndarray
        In 1/m, (n,).
    kz : ndarray
        Of the modes of all ports in 1/m, (n, n_ports n_modes).

    Returns
    -------
    list of ndarray
        At the ports, (n, n_ports n_modes, n_ports n_modes), per unit of the parameter.
    """
    points = wall_points(wall, system.rule)
    x, y = velocity(points.rule.z[:, None], points.contours.t)
    outwards = x * points.normal[0] + y * points.normal[1]
    functions = wall_functions(points, system.functions)
    parts = wall_matrices(points, functions, system.layout, outwards)
    found = []
    for space in spaces:
        stiffness, mass = (projected(system, part, space) for part in parts)
        response, change = _changed_impedance(space, stiffness, mass, k)
        found.append(changed_scattering(response, change, kz))
    return found


def _changed_impedance(
    space: Reduced, stiffness: Array, mass: Array, k: Array
) -> tuple[Array, Array]:
    """Return Z and its derivative, (n, n_ports n_modes, n_ports n_modes)."""
    square, vector = ritz(space.stiffness, space.mass)
    ports = vector.T @ space.ports
    fields = ports / (square - k[:, None] ** 2)[:, :, None]
    stiffness, mass = (vector.T @ part @ vector for part in (stiffness, mass))
    pushed = stiffness @ fields - k[:, None, None] ** 2 * (mass @ fields)
    return np.matmul(ports.T, fields), -np.matmul(fields.swapaxes(1, 2), pushed)
