"""Quadratic solid element with a projected volume ratio: energy, internal force and stiffness.

Displacement elements lock volumetrically in a nearly incompressible wall. The volumetric energy is
therefore a function of the volume ratio J projected, element by element, onto a few functions: the
three-field method of Simo, Taylor and Pister [1]_ condensed to displacements, a relative of the
F-bar method [2]_. The forces derive from an energy, so that the tangent is symmetric. The
unprojected part of J has no energy in hexahedra; in tetrahedra it has a stabilisation modulus k of
8 shear moduli.

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

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numba
import numpy as np
from numpy.typing import NDArray

from acoustube.base.small_systems import solve
from acoustube.indentation.material import (
    Array,
    Material,
    Scalar,
    determinant,
    shear_modulus,
    volumetric,
)
from acoustube.indentation.reference_element import Reference


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
    inverse = solve(mass, jnp.eye(modes.shape[1])[None])
    return Quadrature(gradients, weights, inverse, stabilisation, jnp.asarray(modes))


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
        Of this element alone: its arrays lack the axis of elements.

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
        Of this element alone: its arrays lack the axis of elements.
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


def tangents(
    displacement: Array,
    rule: Quadrature,
    material: Material,
    pressure_share: float = 1.0,
    *,
    count: int | None = None,
) -> NDArray[np.float64]:
    """Return the tangent stiffness in N/m of every element: the Hessians of :func:`energy`.

    Parameters
    ----------
    displacement, rule, material
        As for :func:`energies_and_forces`.
    pressure_share : float
        Fraction of the pressure p in the geometric stiffness, p times the second derivative of J.
        With 0 the volumetric part is positive semidefinite, but the result is not the Hessian where
        there is a pressure.
    count : int, optional
        Number of leading elements whose matrices are returned; all by default.

    Returns
    -------
    array of shape (count, 3 n_local, 3 n_local)

    Notes
    -----
    Equal to ``jax.hessian(energy)``, in a fifth of its time. With the pressure
    ``p = K (J_projected - 1) + k (J - J_projected)`` the 9 x 9 moduli at a point are the Hessian of
    ``W_iso + p J`` by F at constant p, plus k times the outer product of dJ/dF with itself. The
    projection adds a matrix whose rank is the number of its modes. JAX derives the moduli from the
    material's energy; a compiled loop contracts them with the shape gradients, 3.5 times as fast as
    the batched products of XLA.
    """
    arrays = rule.gradients, rule.modes, *_moduli(displacement, rule, material, pressure_share)
    count = len(displacement) if count is None else count
    return _contracted(count, *(np.asarray(array) for array in arrays))


@jax.jit
def _moduli(
    displacement: Array, rule: Quadrature, material: Material, pressure_share: Scalar
) -> tuple[Array, Array, Array]:
    """Return weighted elastic moduli and cofactors of F at the points, and the modes' stiffness.

    The weights are the points' integration weights. Shapes (3, 3, 3, 3, n_elements, n_points),
    (3, 3, n_elements, n_points), and (n_elements, n_modes, n_modes). The points come last, so that
    the compiler vectorises over them.
    """
    points = rule.weights.shape
    grad = jnp.einsum("eni,eqnj->ijeq", displacement, rule.gradients).reshape(3, 3, -1)
    f = jnp.eye(3)[:, :, None] + grad
    j, cofactor = jax.vmap(jax.value_and_grad(determinant), -1, -1)(f)
    j = j.reshape(points)
    projected = jax.vmap(project, (0, _EACH))(j, rule)
    slope = jax.grad(lambda j: jnp.sum(volumetric(j, material.bulk_modulus)))
    k = _stabilisation(rule, material)
    unprojected = jnp.broadcast_to(k[:, None], points)
    pressure = pressure_share * (slope(projected) + unprojected * (j - projected))

    def second(f: Array, p: Array) -> Array:
        return jax.hessian(lambda f: material.isochoric(f) + p * determinant(f))(f)

    moduli = jax.vmap(second, -1, -1)(f, pressure.ravel())
    outer = cofactor[:, :, None, None] * cofactor[None, None]
    moduli += unprojected.reshape(1, 1, 1, 1, -1) * outer
    weights = rule.weights.reshape(1, 1, -1)
    return (
        (weights[None, None] * moduli).reshape(3, 3, 3, 3, *points),
        (weights * cofactor).reshape(3, 3, *points),
        (material.bulk_modulus - k)[:, None, None] * rule.mass_inverse,
    )


@numba.njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz"})
def _contracted(
    count: int, gradients: Any, modes: Any, moduli: Any, cofactors: Any, stiffness: Any
) -> Any:  # pragma: no cover - compiled
    """Return elements' tangents from the results of :func:`_moduli`, (count, 3 n_local, 3 n_local).

    The three components of a node are adjacent in rows and columns. Only pairs of components i <= k
    are computed; the others follow by symmetry.
    """
    _, n_points, n_local, _ = gradients.shape
    result = np.empty((count, 3 * n_local, 3 * n_local))
    across = np.empty((n_local, 3 * n_points))
    half = np.empty((3 * n_points, 6 * n_local))
    swelling = np.empty((n_points, 3 * n_local))
    weighted_modes = np.ascontiguousarray(modes.T)
    pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    for e in range(count):
        for q in range(n_points):
            g = gradients[e, q]
            for j in range(3):
                for n in range(n_local):
                    across[n, 3 * q + j] = g[n, j]
                for b, (i, k) in enumerate(pairs):
                    m0, m1, m2 = (
                        moduli[i, j, k, 0, e, q],
                        moduli[i, j, k, 1, e, q],
                        moduli[i, j, k, 2, e, q],
                    )
                    for n in range(n_local):
                        half[3 * q + j, b * n_local + n] = (
                            m0 * g[n, 0] + m1 * g[n, 1] + m2 * g[n, 2]
                        )
                c = cofactors[j, :, e, q]
                for n in range(n_local):
                    swelling[q, 3 * n + j] = c[0] * g[n, 0] + c[1] * g[n, 1] + c[2] * g[n, 2]
        blocks = across @ half
        slopes = weighted_modes @ swelling
        squeezed = slopes.T @ (stiffness[e] @ slopes)
        for n in range(3 * n_local):
            for m in range(3 * n_local):
                result[e, n, m] = squeezed[n, m]
        for b, (i, k) in enumerate(pairs):
            for n in range(n_local):
                for m in range(n_local):
                    value = blocks[n, b * n_local + m]
                    result[e, 3 * n + i, 3 * m + k] += value
                    if i != k:
                        result[e, 3 * m + k, 3 * n + i] += value
    return result


def compile_contraction() -> None:
    """Compile the loop of :func:`tangents`, by calling it for no element."""
    arrays = (np.zeros((0,) * n_axes) for n_axes in (4, 2, 6, 4, 3))
    _contracted(0, *(_as_from_jax(array) for array in arrays))


def _as_from_jax(array: NDArray[np.float64]) -> NDArray[np.float64]:
    """Mark an array as read-only, as JAX's arrays are for numba, and return it."""
    array.flags.writeable = False
    return array


def volume_ratios(displacement: Array, rule: Quadrature) -> Array:
    """Return the volume ratios J at the points of every element, (n_elements, n_points).

    Arguments as for :func:`energies_and_forces`.
    """

    def of_one(displacement: Array, gradients: Array) -> Array:
        return jax.vmap(determinant)(deformation_gradients(displacement, gradients))

    return jax.vmap(of_one)(displacement, rule.gradients)
