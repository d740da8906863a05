"""Strain energies of the wall's material: Neo-Hookean and Mooney-Rivlin.

A material consists of an isochoric energy, as a function of parameters and the deformation
gradient, and of a bulk modulus. JAX derives stress and tangent from the energy, so that another
material needs no more than another such function.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from numpy.typing import NDArray

Array = jax.Array | NDArray[np.float64]
Scalar = Array | np.float64


class Material(NamedTuple):
    """An isochoric energy with its parameters, and a bulk modulus.

    Attributes
    ----------
    isochoric : jax.tree_util.Partial
        Energy per undeformed volume in J/m3 as a function of the deformation gradient F; its
        parameters are JAX leaves, so that new values need no recompilation.
    bulk_modulus : float
        In Pa.
    """

    isochoric: Partial
    bulk_modulus: Scalar


def neo_hookean(shear_modulus: Scalar, deformation_gradient: Array) -> Array:
    """Return the isochoric part of the Neo-Hookean strain energy.

    Parameters
    ----------
    shear_modulus : float
        Shear modulus mu in Pa.
    deformation_gradient : array of shape (3, 3)
        Deformation gradient F, dimensionless.

    Returns
    -------
    float
        Energy per undeformed volume in J/m3.

    Notes
    -----
    The whole energy is ``W = mu/2 (J^(-2/3) I1 - 3) + K/2 (J - 1)^2`` with ``I1 = F : F`` and
    ``J = det F``; see :func:`volumetric` for its second term. Its first Piola-Kirchhoff stress is
    ``P = mu J^(-2/3) (F - I1/3 F^-T) + K (J - 1) J F^-T``, and its tangent, applied to dF with
    ``t = F^-T : dF`` and ``T = F^-T dF^T F^-T``,
    ``dP = mu J^(-2/3) (dF - 2/3 (F : dF) F^-T - 2/3 t (F - I1/3 F^-T) + I1/3 T)
    + K J (2 J - 1) t F^-T - K (J - 1) J T``.

    The incompressible solid is Rivlin's [1]_; the isochoric form with J^(-2/3) is Flory's [2]_.

    References
    ----------
    .. [1] R. S. Rivlin, "Large elastic deformations of isotropic materials I. Fundamental
       concepts", Phil. Trans. R. Soc. A 240, 459-490 (1948). doi:10.1098/rsta.1948.0002
    .. [2] P. J. Flory, "Thermodynamic relations for high elastic materials", Trans. Faraday Soc.
       57, 829-838 (1961). doi:10.1039/TF9615700829
    """
    f = deformation_gradient
    return 0.5 * shear_modulus * (determinant(f) ** (-2 / 3) * jnp.sum(f * f) - 3)


def mooney_rivlin(c1: Scalar, c2: Scalar, deformation_gradient: Array) -> Array:
    """Return the isochoric part of the two-parameter Mooney-Rivlin strain energy.

    Parameters
    ----------
    c1, c2 : float
        Constants in Pa; the small-strain shear modulus is ``2 (c1 + c2)``.
    deformation_gradient : array of shape (3, 3)
        Deformation gradient F, dimensionless.

    Returns
    -------
    float
        Energy per undeformed volume in J/m3.

    Notes
    -----
    ``W = c1 (J^(-2/3) I1 - 3) + c2 (J^(-4/3) I2 - 3)`` [1]_ [2]_, where I2, the second invariant of
    F^T F, is the squared norm of the cofactor matrix of F.

    References
    ----------
    .. [1] M. Mooney, "A theory of large elastic deformation", J. Appl. Phys. 11, 582-592 (1940).
       doi:10.1063/1.1712836
    .. [2] R. S. Rivlin, D. W. Saunders, "Large elastic deformations of isotropic materials VII",
       Phil. Trans. R. Soc. A 243, 251-288 (1951). doi:10.1098/rsta.1951.0004
    """
    f = deformation_gradient
    cofactor = jnp.cross(jnp.roll(f, -1, axis=0), jnp.roll(f, -2, axis=0))
    j = jnp.dot(f[0], cofactor[0])
    first, second = j ** (-2 / 3) * jnp.sum(f * f), j ** (-4 / 3) * jnp.sum(cofactor * cofactor)
    return c1 * (first - 3) + c2 * (second - 3)


def volumetric(volume_ratio: Array, bulk_modulus: Scalar) -> Array:
    """Return the volumetric part ``K/2 (J - 1)^2`` of the strain energy in J/m3.

    Parameters
    ----------
    volume_ratio : array
        J, dimensionless.
    bulk_modulus : float
        K in Pa.
    """
    return 0.5 * bulk_modulus * (volume_ratio - 1) ** 2


def shear_modulus(material: Material) -> Array:
    """Return the small-strain shear modulus in Pa: second derivative of the energy in shear.

    Parameters
    ----------
    material : Material
    """
    shear = jnp.zeros((3, 3)).at[0, 1].set(1.0)
    return jax.hessian(lambda strain: material.isochoric(jnp.eye(3) + strain * shear))(0.0)


def determinant(f: Array) -> Array:
    """Return the determinant of a matrix as the triple product of its rows.

    Parameters
    ----------
    f : array of shape (3, 3)

    Notes
    -----
    Written out because ``jnp.linalg.det`` goes through an LU factorisation, which is slow in
    batches of small matrices and has no cheap second derivative.
    """
    return jnp.dot(f[0], jnp.cross(f[1], f[2]))
