"""Scattering matrices with an error estimate at each frequency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from acoustube.waves.scattering import ModalScattering
from acoustube.waves.spectral.polynomials import Array
from acoustube.waves.spectral.ports import Complex

ERROR_QUANTILE = 0.95
"""Fraction of the frequencies at which the error is to be within the tolerance."""


@dataclass(frozen=True, kw_only=True, eq=False)
class SpectralScattering(ModalScattering):
    """Scattering of duct modes by a lumen, from the spectral solver.

    The sizes `degree`, `n_elements`, `n_shifts` and `n_fields` are the larger of those for the
    modes symmetric and antisymmetric about x = 0.

    Attributes
    ----------
    derivative : ndarray or None
        Derivative of `s` with respect to the parameter that moves the wall, per unit of it, of the
        shape of `s`; None if no motion was given.
    error : ndarray
        Estimated largest error of the coefficients at each frequency, (n,). Not included are, with
        losses, errors due to the boundary layers at the ports: 1e-4, in bores of 1 mm 4e-4.
    tolerance : float
        Requested largest error of a coefficient.
    degree : int
        Highest total degree of the polynomials across the tube.
    n_elements : int
        Number of elements along the tube, or along half of a tube symmetric about its middle.
    n_shifts : int
        Number of frequencies at which the full equations were solved.
    n_fields : int
        Number of fields of the reduced basis.
    """

    derivative: Complex | None
    error: Array
    tolerance: float
    degree: int
    n_elements: int
    n_shifts: int
    n_fields: int

    @property
    def typical_error(self) -> float:
        """95 % quantile of `error` over the frequencies."""
        return float(np.quantile(self.error, ERROR_QUANTILE))

    @property
    def excess(self) -> str:
        """Warning with the number of frequencies whose error exceeds the tolerance, or empty."""
        over = int((self.error > self.tolerance).sum())
        if not over:
            return ""
        return (
            f"At {over} of {len(self.error)} frequencies the estimated error of the scattering "
            f"matrix, up to {self.error.max():.1g}, exceeds the tolerance of {self.tolerance:g}."
        )
