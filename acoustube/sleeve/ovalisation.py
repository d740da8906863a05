"""Flattening of a wrapped tube (Brazier), and its effect on the cut-ons.

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
from acoustube.waves.modes import bessel_zero

COLLAPSE = 2 / 9
"""Ovality at which a long thin tube kinks, by the same reference."""


@checked(tube=Tube, curvature=Number(-1e6, 1e6, "1/m"))
def ovality(tube: Tube, curvature: float) -> float:
    """Return the relative decrease of the bore's radius in the plane of a bend.

    Parameters
    ----------
    tube : Tube
    curvature : float
        Of its centre line in 1/m.

    Returns
    -------
    float
        The radius grows as much across the bend.

    Raises
    ------
    ConfigError
        If the tube would kink.

    Notes
    -----
    The wall of a thin tube that is bent freely moves by zeta R, zeta = (1 - nu^2) kappa^2 R^4 / t^2
    with R the mean radius. A wall as thick as a third of its radius is stiffer, and is supported by
    a pocket or the arm: this is an upper bound.
    """
    mean = tube.inner_diameter / 2 + tube.wall_thickness / 2
    found = (1 - tube.poisson_ratio**2) * (curvature * mean**2 / tube.wall_thickness) ** 2
    if found > COLLAPSE:
        raise ConfigError(
            f"flattens the tube by {100 * found:.0f} %, and it kinks from {100 * COLLAPSE:.0f} %",
            setting="curvature", value=curvature, unit="1/m",
            advice="wrap it less tightly, or take a thicker wall",
        )  # fmt: skip
    return found * mean / (tube.inner_diameter / 2)


def cut_on_shift(m: int, n: int, ovality: float) -> float:
    """Return the relative change of the cut-on of a mode (m, n) in a flattened bore.

    Parameters
    ----------
    m, n : int
        Mode. Of a pair (1, n), that which varies in the plane of the bend, ``c`` along an arm; the
        other's shift is the negative. All other modes shift by the ovality squared only: 0 here.
    ovality : float
        zeta of the bore, as :func:`ovality` returns it.

    Notes
    -----
    Hadamard's formula for a rigid wall moved outwards by w, d(k^2) = -integral of w (k^2 psi^2 -
    (grad psi)^2) over the wall for psi of unit norm, with w = -zeta R cos 2 phi and psi = J_1 cos
    phi: d(k^2) / k^2 = zeta (1 + 1/j'^2) / (1 - 1/j'^2).
    """
    if m != 1:
        return 0.0
    inverse = bessel_zero(m, n) ** -2
    return 0.5 * ovality * (1 + inverse) / (1 - inverse)
