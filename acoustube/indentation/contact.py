"""Frictionless contact of the outer wall with rigid bodies: the rod above, the floor below.

Each body is an analytic signed distance. The contact energy is integrated over the outer wall's
faces at quadrature points; contact at the nodes of quadratic faces would ask for tensile forces
in the corners.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from acoustube.indentation.element import gauss, shape_functions
from acoustube.indentation.material import Array, Scalar

FACE_POINTS, FACE_POINT_WEIGHTS = gauss(5, 2)
FACE_SHAPES, FACE_SLOPES = shape_functions(FACE_POINTS)


class Bodies(NamedTuple):
    """The rigid bodies and the stiffness of the contact with them.

    Attributes
    ----------
    rod_radius, rod_height : float
        Radius of the rod, which lies along x over z = 0, and height y of its axis, in m.
    floor_height : float
        Height y of the floor, in m.
    stiffness : float
        Pressure per penetration, in Pa/m.
    smoothing : float
        Gap in m at which contact begins to be felt; from there to minus this gap the pressure
        rises from zero to the penalty's straight line.
    """

    rod_radius: Scalar
    rod_height: Scalar
    floor_height: Scalar
    stiffness: Scalar
    smoothing: Scalar


def rod_gap(point: Array, bodies: Bodies) -> Array:
    """Return the signed distance in m from a point (x, y, z) to the rod's surface."""
    height = point[1] - bodies.rod_height
    return jnp.sqrt(height**2 + point[2] ** 2) - bodies.rod_radius


def floor_gap(point: Array, bodies: Bodies) -> Array:
    """Return the signed distance in m from a point (x, y, z) to the floor."""
    return point[1] - bodies.floor_height


def contact_energy(gap: Array, bodies: Bodies) -> Array:
    """Return the energy per area in J/m2 of a smoothed one-sided penalty.

    Notes
    -----
    With gap g, stiffness k and smoothing d: zero for g > d, ``k (d - g)^3 / (12 d)`` for
    ``|g| <= d``, and ``k/2 g^2 + k d^2 / 6`` below, so that energy, pressure and stiffness are
    continuous and the pressure is exactly ``-k g`` once g < -d.
    """
    d = bodies.smoothing
    blend = jnp.clip(d - gap, 0, 2 * d) ** 3 / (12 * d)
    beyond = jnp.minimum(gap + d, 0)
    return bodies.stiffness * (blend + 0.5 * beyond**2 - d * beyond)


def areas(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the undeformed area in m2 at each point of faces (n_faces, 9, 3)."""
    tangents = np.einsum("fni,qnj->fqij", corners, FACE_SLOPES)
    normal = np.cross(tangents[..., 0], tangents[..., 1])
    return np.linalg.norm(normal, axis=-1) * FACE_POINT_WEIGHTS


def energy(position: Array, area: Array, bodies: Bodies) -> Array:
    """Return the contact energy in J of one face with deformed nodes (9, 3) in m."""

    def at_point(shape: Array) -> Array:
        point = shape @ position
        rod = contact_energy(rod_gap(point, bodies), bodies)
        return rod + contact_energy(floor_gap(point, bodies), bodies)

    return area @ jax.vmap(at_point)(jnp.asarray(FACE_SHAPES))


def energies(position: Array, area: Array, bodies: Bodies) -> Array:
    """Return :func:`energy` of every face; position has shape (n_faces, 9, 3)."""
    return jax.vmap(energy, (0, 0, None))(position, area, bodies)


def forces(position: Array, area: Array, bodies: Bodies) -> Array:
    """Return the gradient of every face's energy, shape (n_faces, 9, 3), in N."""
    return jax.vmap(jax.grad(energy), (0, 0, None))(position, area, bodies)


def tangents(position: Array, area: Array, bodies: Bodies) -> Array:
    """Return the second derivative of every face's energy, shape (n_faces, 27, 27), in N/m."""
    hessian = jax.vmap(jax.hessian(energy), (0, 0, None))(position, area, bodies)
    return hessian.reshape(-1, 27, 27)


def rod_force(position: Array, area: Array, bodies: Bodies) -> Array:
    """Return the force in N on the rod, upwards: minus dE/d(rod_height), over the faces given."""

    def total(rod_height: Scalar) -> Array:
        return jnp.sum(energies(position, area, bodies._replace(rod_height=rod_height)))

    return -jax.grad(total)(bodies.rod_height)
