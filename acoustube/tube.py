"""Straight tube of circular cross-section: sizes and elastic moduli."""

from __future__ import annotations

from dataclasses import dataclass
from math import log10

import numpy as np

from acoustube.base.checks import LENGTH, Reals, check_fields, checked
from acoustube.base.rules import Number


@checked(shore_a=Reals(0, 100, "Shore A"))
def shear_modulus_from_shore(shore_a: float) -> float:
    """Return the shear modulus of a silicone from its Shore A hardness.

    Parameters
    ----------
    shore_a : float or array_like
        Hardness on the Shore A scale, 0 to 100.

    Returns
    -------
    float or ndarray
        Shear modulus in Pa, of the shape of `shore_a`.

    Raises
    ------
    ConfigError
        If a hardness is outside 0 to 100.

    Notes
    -----
    ``mu = E / 3`` for an incompressible material, with Young's modulus
    ``E = 10**(0.0235 S - 0.64)`` in MPa at the hardness S. The sleeve paper [1]_ uses this
    relation; Qi et al. [2]_ fitted it to finite elements of the durometer test for S from 20 to 80.

    References
    ----------
    .. [1] "Wearable, Fabric-Embedded Acoustic Waveguides for Meter-Scale Contact Localization and
       Force Sensing".
    .. [2] H. J. Qi, K. Joyce, M. C. Boyce, "Durometer hardness and the stress-strain behavior of
       elastomeric materials", Rubber Chem. Technol. 76, 419-435 (2003). doi:10.5254/1.3547752
    """
    hardness = shore_a if isinstance(shore_a, float | int) else np.asarray(shore_a, float)
    return 1e6 * 10 ** (0.0235 * hardness - 0.64) / 3


def shore_from_shear_modulus(shear_modulus: float) -> float:
    """Return the Shore A hardness of a silicone from its shear modulus.

    Parameters
    ----------
    shear_modulus : float
        In Pa.

    Returns
    -------
    float
        Hardness; not limited to the scale's range of 0 to 100.

    Raises
    ------
    ConfigError
        If the modulus is outside 1e-3 to 1e15 Pa.

    See Also
    --------
    shear_modulus_from_shore : Its inverse.
    """
    modulus = Number(1e-3, 1e15, "Pa").check("shear_modulus", shear_modulus)
    return float((log10(3e-6 * modulus) + 0.64) / 0.0235)


@dataclass(frozen=True, kw_only=True)
class Tube:
    """A straight tube of circular cross-section.

    The defaults are those of the sleeve paper; see :func:`shear_modulus_from_shore`.

    Parameters
    ----------
    inner_diameter, wall_thickness, length : float
        Bore, wall and length, in m.
    shear_modulus : float
        Small-strain shear modulus in Pa; by default that of Shore A 35.
    poisson_ratio : float
        Poisson's ratio, 0 to 0.4999.

    Raises
    ------
    ConfigError
        If a size or the modulus is not positive and finite, or the Poisson's ratio is not in
        [0, 0.4999].
    """

    inner_diameter: float = 7.9e-3
    wall_thickness: float = 1.6e-3
    length: float = 0.4
    shear_modulus: float = shear_modulus_from_shore(35.0)
    poisson_ratio: float = 0.49

    def __post_init__(self) -> None:
        check_fields(
            self, inner_diameter=LENGTH, wall_thickness=LENGTH, length=LENGTH,
            shear_modulus=Number(1e-3, 1e15, "Pa"),
            poisson_ratio=Number(0, 0.4999, "", "0.49 for silicone"),
        )  # fmt: skip

    @property
    def outer_diameter(self) -> float:
        """Outer diameter in m."""
        return self.inner_diameter + 2 * self.wall_thickness

    @property
    def young_modulus(self) -> float:
        """Young's modulus in Pa, ``2 mu (1 + nu)``."""
        return 2 * self.shear_modulus * (1 + self.poisson_ratio)

    @property
    def bulk_modulus(self) -> float:
        """Bulk modulus in Pa, ``2 mu (1 + nu) / (3 (1 - 2 nu))``."""
        nu = self.poisson_ratio
        return 2 * self.shear_modulus * (1 + nu) / (3 * (1 - 2 * nu))
