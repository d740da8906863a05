"""Flattening of a wrapped tube (Brazier).

References
----------
Brazier, L. G. (1927). On the flexure of thin cylindrical shells and other "thin" sections.
Proceedings of the Royal Society A 116, 104-114. doi:10.1098/rspa.1927.0125
"""

from __future__ import annotations

from acoustube.base.checks import checked
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.tube import Tube

COLLAPSE = 2 / 9
"""Relative decrease of the mean radius in the plane of a bend at which a long thin tube kinks."""


@checked(tube=Tube, curvature=Number(-1e6, 1e6, "1/m"))
def ovality(tube: Tube, curvature: float) -> float:
    """Return the relative decrease of the bore's radius in the plane of a bend.

    Parameters
    ----------
    tube : Tube
    curvature : float
        Curvature of the tube's centre line in 1/m.

    Returns
    -------
    float
        Relative decrease. Perpendicular to the plane the radius increases by the same amount.

    Raises
    ------
    ConfigError
        If the tube would kink.

    Notes
    -----
    In a thin tube of mean radius R and wall thickness t, bent freely to the curvature kappa, the
    wall moves by zeta R, with zeta = (1 - nu^2) kappa^2 R^4 / t^2 and Poisson's ratio nu. This is
    an upper bound: a wall as thick as a third of R is stiffer, and a pocket or the arm supports it.
    """
    found = _flattening(tube, curvature)
    if found > COLLAPSE:
        raise ConfigError(
            f"flattens the tube by {100 * found:.0f} %, and it kinks from {100 * COLLAPSE:.0f} %",
            setting="curvature", value=curvature, unit="1/m",
            advice="wrap it less tightly, or take a thicker wall",
        )  # fmt: skip
    return found * _mean_radius(tube) / (tube.inner_diameter / 2)


def kinks(tube: Tube, curvature: float) -> bool:
    """Return whether a tube kinks at a curvature of its centre line in 1/m, see :func:`ovality`."""
    return _flattening(tube, curvature) > COLLAPSE


def _flattening(tube: Tube, curvature: float) -> float:
    """Return the relative change of the mean radius of a tube that is bent freely."""
    thinness = curvature * _mean_radius(tube) ** 2 / tube.wall_thickness
    return float((1 - tube.poisson_ratio**2) * thinness**2)


def _mean_radius(tube: Tube) -> float:
    return tube.inner_diameter / 2 + tube.wall_thickness / 2
