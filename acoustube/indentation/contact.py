"""Frictionless contact of the outer wall with indenters and the ground: a smoothed penalty.

Each body is an analytic signed distance and a contact law: the energy per area as a function of
that distance. The energy is integrated over the outer wall's faces at quadrature points [1]_:
node-to-surface contact would need tensile forces in the corners of quadratic faces. The area is
that of the undeformed wall for a rigid body, and for an elastic foundation that of its own surface
under the deformed wall.

References
----------
.. [1] P. Wriggers, "Computational Contact Mechanics", 2nd ed., Springer (2006).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial

from acoustube.indentation.material import Array, Scalar
from acoustube.indentation.reference_element import Reference

CONTACT_STIFFNESS = 300.0
"""Penalty stiffness of rigid contact: pressure per penetration, in shear moduli per wall thickness.

At the pressures of a 7 mm press (under 0.5 MPa) the wall penetrates the rod by under 6 um.
"""
CONTACT_SMOOTHING = 3e-4
"""Half width of the smoothed contact onset, in wall thicknesses (0.5 um in the default tube).

The tube's initial stiffness is 0.47 N/mm: an onset wider by 4 um at the indenter and at the ground
would change the force at a depth of 0.25 mm by 3 %."""
VERTICAL_SMOOTHING = 0.1
"""Largest absolute projected area, per undeformed area, at which :func:`covered_area` is smoothed.

There a wall that does not stretch is within 6 degrees of the vertical."""
UP = np.array([0.0, 1.0, 0.0])
"""Unit vector against the direction of the press."""


def undeformed_area(projected: Array) -> Array:
    """Return the area of a rigid body's contact law, per undeformed area: one.

    Parameters
    ----------
    projected : float
        Projected area as for :func:`covered_area`.
    """
    return jnp.ones_like(projected)


def smoothed_positive_part(value: Array, smoothing: Scalar | float) -> Array:
    """Return ``max(value, 0)``, with the parabola ``(value + d)^2 / (4 d)`` between -d and d.

    Parameters
    ----------
    value : float
    smoothing : float
        The half width d, in the unit of `value`.
    """
    blend = jnp.clip(value + smoothing, 0, 2 * smoothing) ** 2 / (4 * smoothing)
    return blend + jnp.maximum(value - smoothing, 0)


def covered_area(projected: Array) -> Array:
    """Return the area of a foundation's surface that the wall covers, per undeformed area.

    Parameters
    ----------
    projected : float
        Area of the deformed wall's projection onto the horizontal plane, per undeformed area;
        negative where the wall faces up.

    Notes
    -----
    The positive part of `projected`: where the wall faces up, the surface below it is already
    covered by a lower part of the wall. It is smoothed by :data:`VERTICAL_SMOOTHING`, because the
    forces would jump where a wall becomes vertical. The smoothing does not affect a rigid round
    tube up to a settlement of 0.9 radii. Where folds lie one above the other, each part that faces
    down is counted.
    """
    return smoothed_positive_part(projected, VERTICAL_SMOOTHING)


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
        Energy per area in J/m2 as a function of the gap.
    area : jax.tree_util.Partial
        The area that the law refers to, per undeformed area, as a function of the projected area:
        :func:`undeformed_area` or :func:`covered_area`.
    """

    gap: Partial
    height: Scalar
    law: Partial
    area: Partial = Partial(undeformed_area)


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
    """Return the energy of an elastic foundation on a rigid base, in J per m2 of its surface.

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

    Each column is compressed by the wall above it, and the area of the columns is horizontal: the
    energy is integrated over the area that the wall covers, ``-n_y da`` of the deformed element da
    with the outward normal n (:func:`covered_area`). By the divergence theorem its derivative with
    respect to the wall's displacements is the pressure, normal to the wall, and at the rim of the
    covered area the energy per area, as a force per length.

    References
    ----------
    .. [1] K. L. Johnson, "Contact Mechanics", Cambridge University Press (1985), section 4.3 on
       elastic foundations.
    """
    stretch = 1 - smoothed_positive_part(-gap, smoothing) / thickness
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


def _basis(face: Reference) -> Array:
    """Return the shape functions and their two derivatives, shape (n_points, n_local, 3)."""
    return np.concatenate([face.shapes[..., None], face.slopes], axis=-1)


def _per_area(area: Array, face: Reference) -> Array:
    """Return the area of the reference face per undeformed area at the points, in 1/m2."""
    return face.weights / jnp.where(area > 0, area, 1.0)


def _projected(local: Array, per_area: Scalar) -> Array:
    """Return the projected area per undeformed area, the argument of :func:`covered_area`."""
    _, first, second = local
    return (first[0] * second[2] - first[2] * second[0]) * per_area


def energy_density(local: Array, per_area: Scalar, bodies: tuple[Body, ...]) -> Array:
    """Return the contact energy per undeformed area in J/m2 at a point of the wall.

    Parameters
    ----------
    local : array of shape (3, 3)
        Deformed position in m, and its derivatives with respect to both coordinates of the face.
    per_area : float
        Area of the reference face per undeformed area, in 1/m2.
    bodies : tuple of Body
    """
    projected = _projected(local, per_area)
    return sum(
        (body.area(projected) * body.law(body.gap(local[0] - body.height * UP)) for body in bodies),
        start=jnp.zeros(()),
    )


def energy(position: Array, area: Array, face: Reference, bodies: tuple[Body, ...]) -> Array:
    """Return the contact energy in J of one face.

    Parameters
    ----------
    position : array of shape (n_local, 3)
        Deformed nodes in m.
    area : array of shape (n_points,)
        Undeformed area of the points in m2, from :func:`areas`; zero for a face without energy.
    face : Reference
    bodies : tuple of Body
    """
    local = jnp.einsum("qna,ni->qai", _basis(face), position)
    return area @ jax.vmap(energy_density, (0, 0, None))(local, _per_area(area, face), bodies)


def energies_and_forces(
    position: Array, area: Array, face: Reference, bodies: tuple[Body, ...]
) -> tuple[Array, Array]:
    """Return the contact energy in J and its gradient in N of every face.

    Parameters
    ----------
    position : array of shape (n_faces, n_local, 3)
        Deformed nodes in m.
    area : array of shape (n_faces, n_points)
        Of the undeformed faces, in m2, from :func:`areas`; zero for faces without energy.
    face : Reference
        Reference element of the faces.
    bodies : tuple of Body

    Returns
    -------
    energies : array of shape (n_faces,)
    forces : array of shape (n_faces, n_local, 3)
    """
    one = jax.value_and_grad(energy)
    return jax.vmap(lambda position, area: one(position, area, face, bodies))(position, area)


def tangents(position: Array, area: Array, face: Reference, bodies: tuple[Body, ...]) -> Array:
    """Return the contact stiffness in N/m of every face, shape (n_faces, 3 n_local, 3 n_local).

    Arguments as for :func:`energies_and_forces`.
    """
    basis, bend = _basis(face), jax.vmap(jax.hessian(energy_density), (0, 0, None))

    def of_one(position: Array, area: Array) -> Array:
        local = jnp.einsum("qna,ni->qai", basis, position)
        stiffness = area[:, None, None, None, None] * bend(local, _per_area(area, face), bodies)
        n = position.size
        half = jnp.einsum("qaibj,qmb->qaimj", stiffness, basis)
        return jnp.einsum("qna,qaimj->nimj", basis, half).reshape(n, n)

    return jax.vmap(of_one)(position, area)


class Touch(NamedTuple):
    """Gaps between the wall's points and bodies; arrays with axes (body, face, point).

    Attributes
    ----------
    gap : array of shape (n_bodies, n_faces, n_points)
        In m.
    normal : array of shape (n_bodies, n_faces, n_points, 3)
        Gradient of the gap with respect to the point's position.
    area : array of shape (n_bodies, n_faces, n_points)
        Area in m2 that the body's law refers to.
    """

    gap: Any
    normal: Any
    area: Any


def gaps(position: Array, area: Array, face: Reference, bodies: tuple[Body, ...]) -> Touch:
    """Return the gaps between the faces' points and bodies, their gradients, and areas.

    Arguments as for :func:`energies_and_forces`.
    """
    basis = _basis(face)

    def at_point(local: Array, area: Scalar, per_area: Scalar) -> Touch:
        projected = _projected(local, per_area)
        found = []
        for body in bodies:
            gap = jax.value_and_grad(lambda point, body=body: body.gap(point - body.height * UP))
            found.append((*gap(local[0]), area * body.area(projected)))
        return Touch(*(jnp.stack(part) for part in zip(*found, strict=True)))

    def of_one(position: Array, area: Array) -> Touch:
        local = jnp.einsum("qna,ni->qai", basis, position)
        return jax.vmap(at_point, out_axes=1)(local, area, _per_area(area, face))

    return jax.vmap(of_one, out_axes=1)(position, area)


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


def force(position: Array, area: Array, face: Reference, body: Body) -> Array:
    """Return the upward force in N of all faces on a body: minus d(energy) / d(body's height).

    Arguments as for :func:`energies_and_forces`, with one body in place of a tuple.
    """

    def total(height: Scalar) -> Array:
        moved = (body._replace(height=height),)
        return jnp.sum(
            jax.vmap(lambda position, area: energy(position, area, face, moved))(position, area)
        )

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

    def gap(point: Array) -> Array:
        return body.gap(point - body.height * UP)

    points = jnp.einsum("qn,fni->fqi", shapes, position)
    return jnp.sum(area * (jax.vmap(jax.vmap(gap))(points) < 0))
