"""Signed distances to the rigid indenters and to the ground, as functions of a point."""

from __future__ import annotations

import jax.numpy as jnp

from acoustube.indentation.material import Array, Scalar


def rod_gap(radius: Scalar, x: Scalar, z: Scalar, yaw: Scalar, point: Array) -> Array:
    """Return the signed distance in m to an infinite cylinder with its lowest line at height zero.

    Parameters
    ----------
    radius : float
        In m.
    x, z : float
        A point on its horizontal axis, in m.
    yaw : float
        Angle in rad from the x axis to the cylinder's axis, positive towards +z.
    point : array of shape (3,)
        In m.
    """
    across = -(point[0] - x) * jnp.sin(yaw) + (point[2] - z) * jnp.cos(yaw)
    return jnp.hypot(point[1] - radius, across) - radius


def sphere_gap(radius: Scalar, x: Scalar, z: Scalar, point: Array) -> Array:
    """Return the signed distance in m to a sphere with its lowest point at height zero.

    Parameters
    ----------
    radius : float
        In m.
    x, z : float
        Position of the centre, in m.
    point : array of shape (3,)
        In m.
    """
    offset = jnp.stack([point[0] - x, point[1] - radius, point[2] - z])
    return jnp.linalg.norm(offset) - radius


def punch_gap(radius: Scalar, edge: Scalar, x: Scalar, z: Scalar, point: Array) -> Array:
    """Return the signed distance in m to an upright cylinder with its flat end at height zero.

    Parameters
    ----------
    radius, edge : float
        Radii of the cylinder and of its rounded edge, in m.
    x, z : float
        Position of the axis, in m.
    point : array of shape (3,)
        In m.

    Notes
    -----
    The distance to a cylinder that is smaller by the edge radius, minus the edge radius. Inside
    that cylinder, the distances to its side and to its end are negative, and the larger one holds.
    """
    # The square root has no derivative at zero: 1e-30 keeps it differentiable on the axis, and
    # `where` inside the smaller cylinder.
    out = jnp.sqrt((point[0] - x) ** 2 + (point[2] - z) ** 2 + 1e-30) - (radius - edge)
    down = edge - point[1]
    beyond = jnp.maximum(out, 0.0) ** 2 + jnp.maximum(down, 0.0) ** 2
    outside = jnp.where(beyond > 0, jnp.sqrt(jnp.where(beyond > 0, beyond, 1.0)), 0.0)
    return outside + jnp.minimum(jnp.maximum(out, down), 0.0) - edge


def floor_gap(point: Array) -> Array:
    """Return the signed distance in m to the horizontal plane at height zero.

    Parameters
    ----------
    point : array of shape (3,)
        In m.
    """
    return point[1]
