"""Frictionless contact of the outer wall with indenters and the ground: a smoothed penalty.

Each body is an analytic signed distance and a contact law: the energy per area as a function of
that distance. The energy is integrated over the outer wall's faces at quadrature points [1]_:
node-to-surface contact would need tensile forces in the corners of quadratic faces.

References
----------
.. [1] P. Wriggers, "Computational Contact Mechanics", 2nd ed., Springer (2006).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.tree_util import Partial

from acoustube.indentation.material import Array, Scalar

CONTACT_STIFFNESS = 300.0
"""Penalty stiffness of rigid contact: pressure per penetration, in shear moduli per wall thickness.

At the pressures of a 7 mm press (under 0.5 MPa) the wall penetrates the rod by under 6 um.
"""
CONTACT_SMOOTHING = 3e-4
"""Half width of the smoothed contact onset, in wall thicknesses (0.5 um in the default tube).

The tube's initial stiffness is 0.47 N/mm: an onset wider by 4 um at the indenter and at the ground
would change the force at 0.25 mm by 3 %."""


class Body(NamedTuple):
    """A body that the outer wall can touch.

    Attributes
    ----------
    gap : jax.tree_util.Partial
        Signed distance in m as a function of a point (x, y, z), with y measured from the body's
        reference height.
    height : float
        Reference height y in m, which changes with the indentation depth.
    law : jax.tree_util.Partial
        Energy per undeformed area in J/m2 as a function of the gap.
    """

    gap: Partial
    height: Scalar
    law: Partial


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
    that cylinder, distances are negative, and the larger one (to the nearer of side and end) holds.
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


def penalty_energy(stiffness: Scalar, smoothing: Scalar, gap: Array) -> Array:
    """Return the energy per area in J/m2 of a smoothed one-sided penalty.

    Parameters
    ----------
    stiffness : float
        Pressure per penetration, in Pa/m.
    smoothing : float
        Half width of the smoothed contact onset, in m.
    gap : float
        Signed distance in m.

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


def rigid_law(shear_modulus: Any, wall_thickness: Any) -> Partial:
    """Return the contact law of a rigid body; see :func:`penalty_energy`.

    Parameters
    ----------
    shear_modulus, wall_thickness : float
        Of the tube, in Pa and m.
    """
    return Partial(
        penalty_energy,
        CONTACT_STIFFNESS * shear_modulus / wall_thickness,
        CONTACT_SMOOTHING * wall_thickness,
    )


def foundation_energy(modulus: Scalar, thickness: Scalar, smoothing: Scalar, gap: Array) -> Array:
    """Return the energy per area in J/m2 of an elastic foundation on a rigid base.

    Parameters
    ----------
    modulus, thickness : float
        Young's modulus in Pa and thickness in m.
    smoothing : float
        Half width of the smoothed contact onset, in m.
    gap : float
        Signed distance in m.

    Notes
    -----
    A Winkler foundation [1]_: independent columns in uniaxial stress, here with logarithmic strain.
    Compressed by the fraction s of its thickness h, the pressure is ``-E ln(1 - s)``, which is E s
    for small s and infinite at the base; the energy is ``E h ((1 - s) ln(1 - s) + s)``. With
    smoothing d the compression sets in as ``(d - g)^2 / (4 d)`` between the gaps d and -d.

    References
    ----------
    .. [1] K. L. Johnson, "Contact Mechanics", Cambridge University Press (1985), section 4.3 on
       elastic foundations.
    """
    d = smoothing
    compression = jnp.clip(d - gap, 0, 2 * d) ** 2 / (4 * d) - jnp.minimum(gap + d, 0)
    stretch = 1 - compression / thickness
    return modulus * thickness * (stretch * jnp.log(stretch) + 1 - stretch)


def areas(corners: Array, slopes: Array, weights: Array) -> Array:
    """Return the integration weights in m2 of all faces' quadrature points.

    Parameters
    ----------
    corners : array of shape (n_faces, n_local, 3)
        Nodes of the faces in m.
    slopes : array of shape (n_points, n_local, 2)
        Derivatives of the face's shape functions at the points.
    weights : array of shape (n_points,)
        Quadrature weights in the reference face.

    Returns
    -------
    array of shape (n_faces, n_points)
    """
    tangents = jnp.einsum("fni,qnj->fqij", corners, slopes)
    normal = jnp.cross(tangents[..., 0], tangents[..., 1])
    return jnp.linalg.norm(normal, axis=-1) * weights[None]


def energy_density(point: Array, bodies: tuple[Body, ...]) -> Array:
    """Return the contact energy per undeformed area in J/m2 at a point of the wall.

    Parameters
    ----------
    point : array of shape (3,)
        Deformed position in m.
    bodies : tuple of Body
    """
    up = jnp.array([0.0, 1.0, 0.0])
    return sum(
        (body.law(body.gap(point - body.height * up)) for body in bodies), start=jnp.zeros(())
    )


def energy(position: Array, area: Array, shapes: Array, bodies: tuple[Body, ...]) -> Array:
    """Return the contact energy in J of one face.

    Parameters
    ----------
    position : array of shape (n_local, 3)
        Deformed nodes in m.
    area : array of shape (n_points,)
        Undeformed area of the points in m2, from :func:`areas`.
    shapes : array of shape (n_points, n_local)
        Shape functions of the face at its points.
    bodies : tuple of Body
    """
    return area @ jax.vmap(energy_density, (0, None))(shapes @ position, bodies)


def energies_and_forces(
    position: Array, area: Array, shapes: Array, bodies: tuple[Body, ...]
) -> tuple[Array, Array]:
    """Return the contact energy in J and its gradient in N of every face.

    Parameters
    ----------
    position : array of shape (n_faces, n_local, 3)
        Deformed nodes in m.
    area : array of shape (n_faces, n_points)
        Of the undeformed faces, in m2, from :func:`areas`.
    shapes : array of shape (n_points, n_local)
        Shape functions of the face at its points.
    bodies : tuple of Body

    Returns
    -------
    energies : array of shape (n_faces,)
    forces : array of shape (n_faces, n_local, 3)
    """
    one = jax.value_and_grad(energy)
    return jax.vmap(one, (0, 0, None, None))(position, area, shapes, bodies)


def tangents(position: Array, area: Array, shapes: Array, bodies: tuple[Body, ...]) -> Array:
    """Return the contact stiffness in N/m of every face, shape (n_faces, 3 n_local, 3 n_local).

    Arguments as for :func:`energies_and_forces`.
    """

    def of_one(position: Array, area: Array) -> Array:
        stiffness = jax.vmap(jax.hessian(energy_density), (0, None))(shapes @ position, bodies)
        n = position.size
        return jnp.einsum("q,qa,qb,qij->aibj", area, shapes, shapes, stiffness).reshape(n, n)

    return jax.vmap(of_one)(position, area)


def gaps(position: Array, shapes: Array, bodies: tuple[Body, ...]) -> tuple[Array, Array]:
    """Return the gaps between the faces' points and bodies, and the gradients of the gaps.

    Parameters
    ----------
    position : array of shape (n_faces, n_local, 3)
        Deformed nodes in m.
    shapes : array of shape (n_points, n_local)
        Shape functions of the face at its points.
    bodies : tuple of Body

    Returns
    -------
    gap : array of shape (n_bodies, n_faces, n_points)
        In m.
    normal : array of shape (n_bodies, n_faces, n_points, 3)
        Gradient with respect to the point's position.
    """
    up = jnp.array([0.0, 1.0, 0.0])
    points = jnp.einsum("qn,fni->fqi", shapes, position)
    found = []
    for body in bodies:
        at = jax.value_and_grad(lambda point, body=body: body.gap(point - body.height * up))
        found.append(jax.vmap(jax.vmap(at))(points))
    return jnp.stack([gap for gap, _ in found]), jnp.stack([normal for _, normal in found])


def pressures(gap: Array, bodies: tuple[Body, ...]) -> tuple[Array, Array]:
    """Return the contact laws' first derivative in Pa and second in Pa/m with respect to the gap.

    Parameters
    ----------
    gap : array of shape (n_bodies, n_faces, n_points)
        In m.
    bodies : tuple of Body

    Returns
    -------
    two arrays of shape (n_bodies, n_faces, n_points)
        The first holds minus the contact pressure.
    """
    slopes = [jax.vmap(jax.vmap(jax.grad(body.law)))(gap[i]) for i, body in enumerate(bodies)]
    bends = [
        jax.vmap(jax.vmap(jax.grad(jax.grad(body.law))))(gap[i]) for i, body in enumerate(bodies)
    ]
    return jnp.stack(slopes), jnp.stack(bends)


def force(position: Array, area: Array, shapes: Array, body: Body) -> Array:
    """Return the upward force in N of all faces on a body: minus d(energy) / d(body's height).

    Arguments as for :func:`energies_and_forces`, with one body in place of a tuple.
    """

    def total(height: Scalar) -> Array:
        moved = (body._replace(height=height),)
        one = jax.vmap(energy, (0, 0, None, None))
        return jnp.sum(one(position, area, shapes, moved))

    return -jax.grad(total)(body.height)


def contact_area(position: Array, area: Array, shapes: Array, body: Body) -> Array:
    """Return the contact area in m2 with a body: the part of `area` where the gap is negative.

    Parameters
    ----------
    position : array of shape (n_faces, n_local, 3)
        Deformed nodes in m.
    area : array of shape (n_faces, n_points)
        Deformed area of the points, in m2.
    shapes : array of shape (n_points, n_local)
        Shape functions of the face at its points.
    body : Body
    """
    up = jnp.array([0.0, 1.0, 0.0])

    def gap(point: Array) -> Array:
        return body.gap(point - body.height * up)

    points = jnp.einsum("qn,fni->fqi", shapes, position)
    return jnp.sum(area * (jax.vmap(jax.vmap(gap))(points) < 0))
