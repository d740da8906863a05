"""Frictionless contact of the outer wall with the tools above and the ground below.

Each body is an analytic signed distance and a law that turns it into an energy per area. The energy
is integrated over the outer wall's faces at quadrature points; contact at the nodes of quadratic
faces would ask for tensile forces in the corners.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax.tree_util import Partial

from acoustube.indentation.material import Array, Scalar


class Body(NamedTuple):
    """Something that the outer wall touches.

    Attributes
    ----------
    gap : jax.tree_util.Partial
        Signed distance in m as a function of a point (x, y, z) seen from the body's reference
        height.
    height : float
        The body's reference height y in m; what moves in a press.
    law : jax.tree_util.Partial
        Energy per undeformed area in J/m2 as a function of the gap.
    """

    gap: Partial
    height: Scalar
    law: Partial


def rod_gap(radius: Scalar, x: Scalar, z: Scalar, yaw: Scalar, point: Array) -> Array:
    """Return the distance to an endless cylinder whose lowest line is at height zero.

    Parameters
    ----------
    radius : float
        In m.
    x, z : float
        A point of its axis, in m.
    yaw : float
        Angle in rad from the x axis towards the z axis in which it lies.
    point : array of shape (3,)
    """
    across = -(point[0] - x) * jnp.sin(yaw) + (point[2] - z) * jnp.cos(yaw)
    return jnp.hypot(point[1] - radius, across) - radius


def sphere_gap(radius: Scalar, x: Scalar, z: Scalar, point: Array) -> Array:
    """Return the distance to a sphere over (x, z) whose lowest point is at height zero."""
    offset = jnp.stack([point[0] - x, point[1] - radius, point[2] - z])
    return jnp.linalg.norm(offset) - radius


def punch_gap(radius: Scalar, edge: Scalar, x: Scalar, z: Scalar, point: Array) -> Array:
    """Return the distance to an upright cylinder over (x, z) whose flat end is at height zero.

    Parameters
    ----------
    radius, edge : float
        Of the cylinder, and of its rounded edge, in m.
    x, z : float
        In m.
    point : array of shape (3,)

    Notes
    -----
    The distance to a rounded profile: to the cylinder that is smaller by the edge's radius, less
    that radius. Inside it, the larger (nearer) of the distances to the side and to the end.
    """
    # The root of zero has no slope: the axis is passed at 1e-15 m, the flat end goes around it.
    out = jnp.sqrt((point[0] - x) ** 2 + (point[2] - z) ** 2 + 1e-30) - (radius - edge)
    down = edge - point[1]
    beyond = jnp.maximum(out, 0.0) ** 2 + jnp.maximum(down, 0.0) ** 2
    outside = jnp.where(beyond > 0, jnp.sqrt(jnp.where(beyond > 0, beyond, 1.0)), 0.0)
    return outside + jnp.minimum(jnp.maximum(out, down), 0.0) - edge


def floor_gap(point: Array) -> Array:
    """Return the distance to the ground, whose surface is at height zero."""
    return point[1]


def rigid(stiffness: Scalar, smoothing: Scalar, gap: Array) -> Array:
    """Return the energy per area in J/m2 of a smoothed one-sided penalty.

    Parameters
    ----------
    stiffness : float
        Pressure per penetration, in Pa/m.
    smoothing : float
        Gap in m at which contact begins to be felt.
    gap : float
        In m.

    Notes
    -----
    With gap g, stiffness k and smoothing d: zero for g > d, ``k (d - g)^3 / (12 d)`` for
    ``|g| <= d``, and ``k/2 g^2 + k d^2 / 6`` below, so that energy, pressure and stiffness are
    continuous and the pressure is exactly ``-k g`` once g < -d.
    """
    d = smoothing
    blend = jnp.clip(d - gap, 0, 2 * d) ** 3 / (12 * d)
    beyond = jnp.minimum(gap + d, 0)
    return stiffness * (blend + 0.5 * beyond**2 - d * beyond)


def layer(modulus: Scalar, thickness: Scalar, smoothing: Scalar, gap: Array) -> Array:
    """Return the energy per area in J/m2 of an elastic layer on a rigid base.

    Parameters
    ----------
    modulus, thickness : float
        Young's modulus in Pa and thickness in m.
    smoothing : float
        Gap in m at which contact begins to be felt.
    gap : float
        In m.

    Notes
    -----
    A foundation of independent columns in uniaxial stress with a logarithmic strain: compressed by
    the share s of its thickness h, the pressure is ``-E ln(1 - s)``, which is E s for a small s and
    does not let the base be reached; the energy is ``E h ((1 - s) ln(1 - s) + s)``. With smoothing
    d the compression sets in as ``(d - g)^2 / (4 d)`` between the gaps d and -d.
    """
    d = smoothing
    compression = jnp.clip(d - gap, 0, 2 * d) ** 2 / (4 * d) - jnp.minimum(gap + d, 0)
    left = 1 - compression / thickness
    return modulus * thickness * (left * jnp.log(left) + 1 - left)


def areas(corners: Array, slopes: Array, weights: Array) -> Array:
    """Return the area in m2 that each quadrature point of each face stands for.

    Parameters
    ----------
    corners : array of shape (n_faces, n_local, 3)
        Nodes of the faces in m.
    slopes : array of shape (n_points, n_local, 2)
        Slopes of the face's shape functions at the points.
    weights : array of shape (n_points,)
        Of the points in the reference face.

    Returns
    -------
    array of shape (n_faces, n_points)
    """
    tangents = jnp.einsum("fni,qnj->fqij", corners, slopes)
    normal = jnp.cross(tangents[..., 0], tangents[..., 1])
    return jnp.linalg.norm(normal, axis=-1) * weights[None]


def density(point: Array, bodies: tuple[Body, ...]) -> Array:
    """Return the contact energy per undeformed area in J/m2 at a point of the wall."""
    up = jnp.array([0.0, 1.0, 0.0])
    return sum(
        (body.law(body.gap(point - body.height * up)) for body in bodies), start=jnp.zeros(())
    )


def energy(position: Array, area: Array, shapes: Array, bodies: tuple[Body, ...]) -> Array:
    """Return the contact energy in J of one face with deformed nodes (n_local, 3) in m."""
    return area @ jax.vmap(density, (0, None))(shapes @ position, bodies)


def energies_and_forces(
    position: Array, area: Array, shapes: Array, bodies: tuple[Body, ...]
) -> tuple[Array, Array]:
    """Return the contact energy in J and its gradient in N of every face.

    Parameters
    ----------
    position : array of shape (n_faces, n_local, 3)
        Deformed nodes in m.
    area : array of shape (n_faces, n_points)
        From :func:`areas`.
    shapes : array of shape (n_points, n_local)
        The face's shape functions at its points.
    bodies : tuple of Body

    Returns
    -------
    energies : array of shape (n_faces,)
    forces : array of shape (n_faces, n_local, 3)
    """
    one = jax.value_and_grad(energy)
    return jax.vmap(one, (0, 0, None, None))(position, area, shapes, bodies)


def tangents(position: Array, area: Array, shapes: Array, bodies: tuple[Body, ...]) -> Array:
    """Return the second derivative of every face's energy, (n_faces, 3 n_local, 3 n_local)."""

    def of_one(position: Array, area: Array) -> Array:
        stiffness = jax.vmap(jax.hessian(density), (0, None))(shapes @ position, bodies)
        n = position.size
        return jnp.einsum("q,qa,qb,qij->aibj", area, shapes, shapes, stiffness).reshape(n, n)

    return jax.vmap(of_one)(position, area)


def force(position: Array, area: Array, shapes: Array, body: Body) -> Array:
    """Return the force in N on a body, upwards: minus dE/d(height), over the faces given."""

    def total(height: Scalar) -> Array:
        moved = (body._replace(height=height),)
        one = jax.vmap(energy, (0, 0, None, None))
        return jnp.sum(one(position, area, shapes, moved))

    return -jax.grad(total)(body.height)


def touched_area(position: Array, area: Array, shapes: Array, body: Body) -> Array:
    """Return how much of the `area` (n_faces, n_points) a body touches: where its gap is negative.

    In m2; position has shape (n_faces, n_local, 3).
    """
    up = jnp.array([0.0, 1.0, 0.0])

    def gap(point: Array) -> Array:
        return body.gap(point - body.height * up)

    points = jnp.einsum("qn,fni->fqi", shapes, position)
    return jnp.sum(area * (jax.vmap(jax.vmap(gap))(points) < 0))
