"""The quadratic solid element with a projected volume ratio: energy, internal force, tangent.

Quadratic displacements alone are too stiff for a nearly incompressible wall under large bending.
The volumetric energy is therefore written in the volume ratio J projected, element by element,
onto a few functions: the three-field method of Simo, Taylor and Pister [1]_ condensed to
displacements. It stays an energy, so that the tangent is symmetric. What the projection leaves out
of J costs nothing, or, on tetrahedra, a modulus k of the order of the shear modulus.

References
----------
.. [1] J. C. Simo, R. L. Taylor, K. S. Pister, "Variational and projection methods for the volume
   constraint in finite deformation elasto-plasticity", Comput. Methods Appl. Mech. Eng. 51,
   177-208 (1985). doi:10.1016/0045-7825(85)90033-7
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from acoustube.indentation.material import Array, Material, determinant, shear_modulus, volumetric
from acoustube.indentation.reference_element import Reference

ELEMENTS_PER_BATCH = 32
"""Elements whose tangents are formed together: enough to vectorise, few enough for the cache."""


class Quadrature(NamedTuple):
    """What the integrals over each element need.

    Attributes
    ----------
    gradients : array of shape (n_elements, n_points, n_local, 3)
        Gradients of the shape functions in the undeformed tube, in 1/m.
    weights : array of shape (n_elements, n_points)
        Undeformed volume that each point stands for, in m3.
    mass_inverse : array of shape (n_elements, n_modes, n_modes)
        Inverse of the projection's mass matrix, in 1/m3.
    remainder : array of shape (n_elements,)
        Modulus against what the projection leaves out of J, in shear moduli.
    modes : array of shape (n_points, n_modes)
        The functions that J is projected onto.
    """

    gradients: Array
    weights: Array
    mass_inverse: Array
    remainder: Array
    modes: Array


_EACH = Quadrature(0, 0, 0, 0, None)  # type: ignore[arg-type]  # the axes of elements, for vmap


def quadrature(corners: Array, reference: Reference) -> Quadrature:
    """Prepare the integrals over elements with node coordinates (n_elements, n_local, 3) in m.

    Traceable by JAX, so that results can be differentiated with respect to the tube's shape.
    """
    jacobian = jnp.einsum("eni,qnj->eqij", corners, reference.slopes)
    cofactor = jnp.cross(jnp.roll(jacobian, -1, axis=-2), jnp.roll(jacobian, -2, axis=-2))
    volume = jnp.sum(jacobian[..., 0, :] * cofactor[..., 0, :], axis=-1)
    weights = volume * reference.weights[None]
    gradients = jnp.einsum("qnj,eqij->eqni", reference.slopes, cofactor) / volume[..., None, None]
    modes = reference.projection
    mass = jnp.einsum("eq,qa,qb->eab", weights, modes, modes)
    remainder = jnp.full(len(corners), reference.remainder)
    return Quadrature(gradients, weights, jnp.linalg.inv(mass), remainder, jnp.asarray(modes))


def deformation_gradients(displacement: Array, gradients: Array) -> Array:
    """Return F = I + grad u at the points of one element, shape (n_points, 3, 3)."""
    return jnp.eye(3)[None] + jnp.einsum("ni,qnj->qij", displacement, gradients)


def project(volume_ratio: Array, rule: Quadrature) -> Array:
    """Return J at the points of one element, projected onto the modes."""
    moments = rule.modes.T @ (rule.weights * volume_ratio)
    return rule.modes @ (rule.mass_inverse @ moments)


def energy(displacement: Array, rule: Quadrature, material: Material) -> Array:
    """Return the strain energy in J of one element with nodal displacements (n_local, 3) in m."""
    f = deformation_gradients(displacement, rule.gradients)
    isochoric = jax.vmap(material.isochoric)(f)
    volume_ratio = jax.vmap(determinant)(f)
    projected = project(volume_ratio, rule)
    mean = volumetric(projected, material.bulk_modulus)
    left = 0.5 * _remainder(rule, material) * (volume_ratio - projected) ** 2
    return rule.weights @ (isochoric + mean + left)


def _remainder(rule: Quadrature, material: Material) -> Array:
    """Return the modulus in Pa against what the projection leaves out of J."""
    return jnp.minimum(rule.remainder * shear_modulus(material), material.bulk_modulus)


def tangent(displacement: Array, rule: Quadrature, material: Material) -> Array:
    """Return the second derivative of :func:`energy`, shape (3 n_local, 3 n_local), in N/m.

    The same as ``jax.hessian(energy)``, four times as fast: the pressure p = K (J_projected - 1)
    + k (J - J_projected) acts at a point as W_iso + p J, whose 9 x 9 second derivative, with k
    times the square of dJ, is contracted with the shape gradients; the projection adds a term of
    the rank of its modes.
    """
    f = deformation_gradients(displacement, rule.gradients)
    volume_ratio, cofactor = jax.vmap(jax.value_and_grad(determinant))(f)
    projected = project(volume_ratio, rule)
    pressure = jax.vmap(jax.grad(volumetric), (0, None))(projected, material.bulk_modulus)
    left = _remainder(rule, material)
    moduli = jax.vmap(
        lambda f, p: jax.hessian(lambda f: material.isochoric(f) + p * determinant(f))(f)
    )(f, pressure + left * (volume_ratio - projected))
    moduli += left * jnp.einsum("qij,qkl->qijkl", cofactor, cofactor)
    half = jnp.einsum("q,qijkl,qml->qijmk", rule.weights, moduli, rule.gradients)
    stiffness = jnp.einsum("qnj,qijmk->nimk", rule.gradients, half)
    n = displacement.size
    slopes = jnp.einsum(
        "q,qa,qij,qnj->nia", rule.weights, rule.modes, cofactor, rule.gradients
    ).reshape(n, -1)
    volumetric_part = slopes @ ((material.bulk_modulus - left) * rule.mass_inverse) @ slopes.T
    return stiffness.reshape(n, n) + volumetric_part


def energies_and_forces(
    displacement: Array, rule: Quadrature, material: Material
) -> tuple[Array, Array]:
    """Return energy in J and internal force in N of every element.

    Parameters
    ----------
    displacement : array of shape (n_elements, n_local, 3)
        In m.
    rule : Quadrature
    material : Material

    Returns
    -------
    energies : array of shape (n_elements,)
    forces : array of shape (n_elements, n_local, 3)
    """
    return jax.vmap(jax.value_and_grad(energy), (0, _EACH, None))(displacement, rule, material)


def tangents(displacement: Array, rule: Quadrature, material: Material) -> Array:
    """Return :func:`tangent` of every element, shape (n_elements, 3 n_local, 3 n_local)."""
    each, modes = rule[:-1], rule.modes
    return jax.lax.map(
        lambda case: tangent(case[0], Quadrature._make((*case[1], modes)), material),
        (displacement, each),
        batch_size=ELEMENTS_PER_BATCH,
    )


def volume_ratios(displacement: Array, rule: Quadrature) -> Array:
    """Return J at every point of every element, shape (n_elements, n_points)."""

    def of_one(displacement: Array, gradients: Array) -> Array:
        return jax.vmap(determinant)(deformation_gradients(displacement, gradients))

    return jax.vmap(of_one)(displacement, rule.gradients)
