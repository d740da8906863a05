"""Conversion of a tube's settings to SI units, without importing the stages of press and sound."""

from __future__ import annotations

from acoustube.runs.config.settings import TubeSettings
from acoustube.tube import Tube, shear_modulus_from_shore

MILLI, CENTI, KILO, MEGA = 1e-3, 1e-2, 1e3, 1e6


def tube_in_si(settings: TubeSettings) -> Tube:
    """Return the tube that settings describe, in SI units."""
    return Tube(
        inner_diameter=MILLI * settings.inner_diameter_mm,
        wall_thickness=MILLI * settings.wall_mm,
        length=CENTI * settings.length_cm,
        shear_modulus=_shear_modulus(settings),
        poisson_ratio=settings.poisson_ratio,
    )


def _shear_modulus(settings: TubeSettings) -> float:
    if settings.shear_modulus_mpa is not None:
        return MEGA * settings.shear_modulus_mpa
    assert settings.shore_a is not None  # shore_a or shear_modulus_mpa is given
    return shear_modulus_from_shore(settings.shore_a)
