"""Modes of the round bore, and their coupling by curvature, torsion and flattening."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np
from scipy.special import jv, jvp

from acoustube.waves.grid.polyhedron import Array
from acoustube.waves.modes.round_duct import bessel_zero, modes_below


@dataclass(frozen=True, kw_only=True, eq=False)
class BoreModes:
    """Modes of the round bore of radius 1, n in number, with their coupling coefficients in a bend.

    Attributes
    ----------
    names : tuple of str
        As ``00``, ``11c``, ``11s``: c stands for cos(m phi), s for sin(m phi), with phi measured
        from the direction of the centre of curvature, from -y towards +x; a press comes from +y.
    zeros : ndarray
        Zeros j'mn of the Bessel functions' derivatives: cut-on wavenumbers times radius, (n,).
    x, across, twist : ndarray
        Matrices X, Y and M of the equations in :mod:`acoustube.waves.bent_parts`, (n, n).
    flattening : ndarray
        Derivatives of the squared cut-on wavenumbers of the bore of radius 1 with respect to the
        ovality (`bent_parts.Bent`), (n,).
    """

    names: tuple[str, ...]
    zeros: Array
    x: Array
    across: Array
    twist: Array
    flattening: Array


def bore_modes(highest: float) -> BoreModes:
    """Return the modes of a round bore up to a largest j'mn, with their coupling coefficients.

    Parameters
    ----------
    highest : float
        Upper bound of the modes' j'mn, the zeros of the Bessel functions' derivatives.

    Notes
    -----
    The integrals over the section use a Gauss rule along the radius and the trapezoidal rule in
    azimuth, which is exact to rounding for the smooth products of the modes.
    """
    known = modes_below(highest, 1 / (2 * pi), 1.0)
    sides = [(mode.m, mode.n, side) for mode in known for side in ("c", "s")[: 1 + (mode.m > 0)]]
    most = max(m for m, _, _ in sides)
    nodes, weights = np.polynomial.legendre.leggauss(int(highest) + 24)
    r, n_angles = 0.5 * (nodes + 1)[:, None], 2 * most + 4
    phi = 2 * pi * np.arange(n_angles) / n_angles
    area = (0.5 * weights)[:, None] * r * (2 * pi / n_angles) / pi
    fields = [_mode_fields(m, n, side, r, phi) for m, n, side in sides]
    psi, d_r, d_phi = (np.array([field[i] for field in fields]) for i in range(3))
    norm = np.sqrt(np.einsum("irp,irp,rp->i", psi, psi, area + 0 * phi))[:, None, None]
    psi, d_r, d_phi = psi / norm, d_r / norm, d_phi / norm
    arm = area * r * np.cos(phi)

    def over_section(left: Array, weight: Array, right: Array) -> Array:
        return np.asarray(np.einsum("irp,rp,jrp->ij", left, weight, right, optimize=True))

    return BoreModes(
        names=tuple(f"{m}{n}{side if m else ''}" for m, n, side in sides),
        zeros=np.array([bessel_zero(m, n) for m, n, _ in sides]),
        x=over_section(psi, arm, psi),
        across=over_section(d_r, arm, d_r) + over_section(d_phi / r, arm, d_phi / r),
        twist=over_section(psi, area + 0 * phi, d_phi),
        flattening=np.array([_flattened(m, n, side) for m, n, side in sides]),
    )


def _flattened(m: int, n: int, side: str) -> float:
    """Return the derivative of a squared cut-on wavenumber with respect to the ovality zeta.

    The bore's radius R is 1. Hadamard's formula for a rigid wall moved outwards by w is d(k^2) =
    -integral of w (k^2 psi^2 - (grad psi)^2) over the wall, for psi of unit norm. With w = -zeta R
    cos 2 phi and psi ~ J_1 cos phi it gives d(k^2) / k^2 = zeta (1 + 1/j'^2) / (1 - 1/j'^2), and
    the negative for sin phi. The cut-ons of other modes than (1, n) shift only to second order in
    the ovality.
    """
    if m != 1:
        return 0.0
    square = bessel_zero(m, n) ** 2
    return (1 if side == "c" else -1) * square * (square + 1) / (square - 1)


def _mode_fields(m: int, n: int, side: str, r: Array, phi: Array) -> tuple[Array, Array, Array]:
    """Return a mode and its partial derivatives in r and phi, on a grid (r, phi)."""
    zero = bessel_zero(m, n)
    around, turned = (np.cos, np.sin) if side == "c" else (np.sin, np.cos)
    sign = -m if side == "c" else m
    shape = jv(m, zero * r)
    slope = zero * jvp(m, zero * r)
    return shape * around(m * phi), slope * around(m * phi), sign * shape * turned(m * phi)
