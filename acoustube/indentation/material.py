"""Strain energy of the wall's material."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

Array = jax.Array | NDArray[np.float64]
Scalar = Array | np.float64


def neo_hookean_isochoric(deformation_gradient: Array, shear_modulus: Scalar) -> Array:
    """Return the isochoric part of the Neo-Hookean strain energy.

    Parameters
    ----------
    deformation_gradient : array of shape (3, 3)
        Deformation gradient F, dimensionless.
    shear_modulus : float
        Shear modulus mu in Pa.

    Returns
    -------
    float
        Energy per undeformed volume in J/m3.

    Notes
    -----
    The whole energy is ``W = mu/2 (J^(-2/3) I1 - 3) + K/2 (J - 1)^2`` with ``I1 = F : F`` and
    ``J = det F``; see :func:`volumetric` for its second term. Its first Piola-Kirchhoff stress is
    ``P = mu J^(-2/3) (F - I1/3 F^-T) + K (J - 1) J F^-T``. Stress and tangent are derived from
    the energy by JAX.

    The form with J^(-2/3) is due to Flory [1]_.

    References
    ----------
    .. [1] P. J. Flory, "Thermodynamic relations for high elastic materials", Trans. Faraday Soc.
       57, 829-838 (1961). doi:10.1039/TF9615700829
    """
    f = deformation_gradient
    return 0.5 * shear_modulus * (determinant(f) ** (-2 / 3) * jnp.sum(f * f) - 3)


def volumetric(volume_ratio: Array, bulk_modulus: Scalar) -> Array:
    """Return the volumetric part ``K/2 (J - 1)^2`` of the strain energy in J/m3."""
    return 0.5 * bulk_modulus * (volume_ratio - 1) ** 2


def determinant(f: Array) -> Array:
    """Return the determinant of a 3 x 3 matrix as a triple product of its rows.

    Written out because ``jnp.linalg.det`` goes through an LU factorisation, which is slow in
    batches of small matrices and has no cheap second derivative.
    """
    return jnp.dot(f[0], jnp.cross(f[1], f[2]))
