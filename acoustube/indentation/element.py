"""Quadratic solid element with a projected volume ratio: energy, internal force and stiffness.

Displacement elements lock volumetrically in a nearly incompressible wall. The volumetric energy is
therefore a function of the volume ratio J projected, element by element, onto a few functions: the
three-field method of Simo, Taylor and Pister [1]_ condensed to displacements, a relative of the
F-bar method [2]_. It derives from an energy, so that the tangent is symmetric. The unprojected part
of J has no energy in hexahedra; in tetrahedra it has a stabilisation modulus k of the order of the
shear modulus.

References
----------
.. [1] J. C. Simo, R. L. Taylor, K. S. Pister, "Variational and projection methods for the volume
   constraint in finite deformation elasto-plasticity", Comput. Methods Appl. Mech. Eng. 51,
   177-208 (1985). doi:10.1016/0045-7825(85)90033-7
.. [2] E. A. de Souza Neto, D. Peric, M. Dutko, D. R. J. Owen, "Design of simple low order finite
   elements for large strain analysis of nearly incompressible solids", Int. J. Solids Struct. 33,
   3277-3296 (1996).
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

from acoustube.indentation.material import Array, Material, determinant, shear_modulus, volumetric
from acoustube.indentation.reference_element import Reference

ELEMENTS_PER_BATCH = 32
"""Elements whose tangents are formed together: enough to vectorise, and they fit the CPU cache."""


class Quadrature(NamedTuple):
    """Quadrature of the elements: shape function gradients, weights and projection of J.

    Attributes
    ----------
    gradients : array of shape (n_elements, n_points, n_local, 3)
        Gradients of the shape functions in the undeformed tube, in 1/m.
    weights : array of shape (n_elements, n_points)
        Integration weights: undeformed volume of each point, in m3.
    mass_inverse : array of shape (n_elements, n_modes, n_modes)
        Inverse of the projection's mass matrix, in 1/m3.
    stabilisation : array of shape (n_elements,)
        Stabilisation modulus on the unprojected part of J, in shear moduli.
    modes : array of shape (n_points, n_modes)
        Functions onto which J is projected, at the points.
    """

    gradients: Array
    weights: Array
    mass_inverse: Array
    stabilisation: Array
    modes: Array


_EACH = Quadrature(0, 0, 0, 0, None)  # type: ignore[arg-type]  # the axes of elements, for vmap


def quadrature(corners: Array, reference: Reference) -> Quadrature:
    """Return the quadrature of elements.

    Traceable by JAX, so that results can be differentiated with respect to the tube's shape.

    Parameters
    ----------
    corners : array of shape (n_elements, n_local, 3)
        Undeformed nodes in m.
    reference : Reference
        Kind of element.
    """
    jacobian = jnp.einsum("eni,qnj->eqij", corners, reference.slopes)
    cofactor = jnp.cross(jnp.roll(jacobian, -1, axis=-2), jnp.roll(jacobian, -2, axis=-2))
    volume = jnp.sum(jacobian[..., 0, :] * cofactor[..., 0, :], axis=-1)
    weights = volume * reference.weights[None]
    gradients = jnp.einsum("qnj,eqij->eqni", reference.slopes, cofactor) / volume[..., None, None]
    modes = reference.projection
    mass = jnp.einsum("eq,qa,qb->eab", weights, modes, modes)
    stabilisation = jnp.full(len(corners), reference.stabilisation)
    return Quadrature(gradients, weights, jnp.linalg.inv(mass), stabilisation, jnp.asarray(modes))


def deformation_gradients(displacement: Array, gradients: Array) -> Array:
    """Return the deformation gradients F = I + grad u of one element.

    Parameters
    ----------
    displacement : array of shape (n_local, 3)
        Nodal displacements in m.
    gradients : array of shape (n_points, n_local, 3)
        Gradients of the shape functions, in 1/m.

    Returns
    -------
    array of shape (n_points, 3, 3)
    """
    return jnp.eye(3)[None] + jnp.einsum("ni,qnj->qij", displacement, gradients)


def project(volume_ratio: Array, rule: Quadrature) -> Array:
    """Return the L2 projection of the volume ratio onto the modes of one element.

    Parameters
    ----------
    volume_ratio : array of shape (n_points,)
        J at the points.
    rule : Quadrature
        Of the one element: without the axis of elements.

    Returns
    -------
    array of shape (n_points,)
    """
    moments = rule.modes.T @ (rule.weights * volume_ratio)
    return rule.modes @ (rule.mass_inverse @ moments)


def energy(displacement: Array, rule: Quadrature, material: Material) -> Array:
    """Return the strain energy in J of one element.

    Parameters
    ----------
    displacement : array of shape (n_local, 3)
        Nodal displacements in m.
    rule : Quadrature
        Of the one element: without the axis of elements.
    material : Material
    """
    f = deformation_gradients(displacement, rule.gradients)
    isochoric = jax.vmap(material.isochoric)(f)
    volume_ratio = jax.vmap(determinant)(f)
    projected = project(volume_ratio, rule)
    mean = volumetric(projected, material.bulk_modulus)
    unprojected = 0.5 * _stabilisation(rule, material) * (volume_ratio - projected) ** 2
    return rule.weights @ (isochoric + mean + unprojected)


def _stabilisation(rule: Quadrature, material: Material) -> Array:
    """Return the stabilisation modulus in Pa, at most the bulk modulus."""
    return jnp.minimum(rule.stabilisation * shear_modulus(material), material.bulk_modulus)


def tangent(displacement: Array, rule: Quadrature, material: Material) -> Array:
    """Return the tangent stiffness of one element in N/m: the Hessian of :func:`energy`.

    Arguments as of :func:`energy`.

    Returns
    -------
    array of shape (3 n_local, 3 n_local)

    Notes
    -----
    Equal to ``jax.hessian(energy)`` and four times as fast. With the pressure
    ``p = K (J_projected - 1) + k (J - J_projected)`` the 9 x 9 moduli at a point are the Hessian of
    ``W_iso + p J`` at constant p plus ``k dJ dJ``; they are contracted with the shape gradients.
    The projection adds a matrix of the rank of its modes.
    """
    f = deformation_gradients(displacement, rule.gradients)
    volume_ratio, cofactor = jax.vmap(jax.value_and_grad(determinant))(f)
    projected = project(volume_ratio, rule)
    pressure = jax.vmap(jax.grad(volumetric), (0, None))(projected, material.bulk_modulus)
    k = _stabilisation(rule, material)
    moduli = jax.vmap(
        lambda f, p: jax.hessian(lambda f: material.isochoric(f) + p * determinant(f))(f)
    )(f, pressure + k * (volume_ratio - projected))
    moduli += k * jnp.einsum("qij,qkl->qijkl", cofactor, cofactor)
    half = jnp.einsum("q,qijkl,qml->qijmk", rule.weights, moduli, rule.gradients)
    stiffness = jnp.einsum("qnj,qijmk->nimk", rule.gradients, half)
    n = displacement.size
    slopes = jnp.einsum(
        "q,qa,qij,qnj->nia", rule.weights, rule.modes, cofactor, rule.gradients
    ).reshape(n, -1)
    volumetric_part = slopes @ ((material.bulk_modulus - k) * rule.mass_inverse) @ slopes.T
    return stiffness.reshape(n, n) + volumetric_part


def energies_and_forces(
    displacement: Array, rule: Quadrature, material: Material
) -> tuple[Array, Array]:
    """Return the strain energy in J and the internal forces in N of every element.

    Parameters
    ----------
    displacement : array of shape (n_elements, n_local, 3)
        Nodal displacements in m.
    rule : Quadrature
    material : Material

    Returns
    -------
    energies : array of shape (n_elements,)
    forces : array of shape (n_elements, n_local, 3)
    """
    return jax.vmap(jax.value_and_grad(energy), (0, _EACH, None))(displacement, rule, material)


def tangents(displacement: Array, rule: Quadrature, material: Material) -> Array:
    """Return the tangent stiffness in N/m of every element, (n_elements, 3 n_local, 3 n_local).

    Arguments as of :func:`energies_and_forces`.
    """
    each, modes = rule[:-1], rule.modes
    return jax.lax.map(
        lambda case: tangent(case[0], Quadrature._make((*case[1], modes)), material),
        (displacement, each),
        batch_size=ELEMENTS_PER_BATCH,
    )


def volume_ratios(displacement: Array, rule: Quadrature) -> Array:
    """Return the volume ratios J at the points of every element, (n_elements, n_points).

    Arguments as of :func:`energies_and_forces`.
    """

    def of_one(displacement: Array, gradients: Array) -> Array:
        return jax.vmap(determinant)(deformation_gradients(displacement, gradients))

    return jax.vmap(of_one)(displacement, rule.gradients)
