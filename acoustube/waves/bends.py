"""Sound in a bent tube: how a bend scatters the modes of a round bore.

Along a bent and twisted centre line of curvature kappa and torsion tau, with x across the tube
towards the centre of curvature and h = 1 - kappa x, sound of frequency omega obeys, u being the
axial velocity times omega rho and T = d/ds - tau d/dphi what changes along the line,

    T p = -j h u,    T u = -j (k^2 h + div h grad) p,

with div and grad across the tube. Nothing is neglected in it: a torus, and a helix too, are
straightened exactly. With p and u as sums of the straight bore's modes psi_m, normalised over the
section, this becomes

    a' = -j B a_u + tau M a,    a_u' = -j K a + tau M a_u,
    B = 1 - kappa X,    K = k_z^2 - kappa (k^2 X - Y),
    X = <psi x psi>,    Y = <grad psi x grad psi>,    M = <psi d psi/dphi>,

where k_z^2 is the diagonal of the straight bore's wavenumbers, with the losses at its wall; what
curvature changes of the losses is left out. The coefficients do not depend on s: the matrix of a
slice, too short for its evanescent modes to grow, is doubled by the star product until it is the
whole bend. This is the multimodal method of the references with doubling in place of the Riccati
equation of the impedance. Where a tube is bent more here and less there, its parts are joined by
the same product.

A bend flattens the tube. To first order that moves the cut-ons of the modes (1, n) alone, see
:func:`acoustube.sleeve.ovalisation.cut_on_shift`: their k_z^2 on the diagonal. What it couples in
amplitude where it sets in is left out: a tube flattens gradually.

References
----------
Félix, S. and Pagneux, V. (2001). Sound propagation in rigid bends: a multimodal approach. Journal
of the Acoustical Society of America 110, 1329-1337. doi:10.1121/1.1391249

Félix, S. and Pagneux, V. (2002). Multimodal analysis of acoustic propagation in three-dimensional
bends. Wave Motion 36, 157-168. doi:10.1016/S0165-2125(02)00009-4
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from math import ceil, log2, pi
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm
from scipy.special import jv, jvp

from acoustube.air import Air
from acoustube.base.errors import ConfigError
from acoustube.waves.grid.polyhedron import Array
from acoustube.waves.modes import axial_wavenumber, bessel_zero, cut_on_frequency, modes_below
from acoustube.waves.modes.grid_modes import mode_numbers
from acoustube.waves.scattering import Complex, ModalScattering

HIGHEST = 10.0
"""Largest j'mn of the modes in the sums; with 14 in its place the paper's tube changes by 1e-5."""
SLICE = 0.5
"""Growth exponent of the most evanescent mode over a slice."""
NEAREST_CUT_ON = 1e-6
"""Least kz over k: beside it a mode's two directions cannot be told apart."""
CHUNK = 64
"""Frequencies that are computed together."""
SHARPEST = 0.95
"""Largest bore radius over bend radius; at 1 the inner wall is folded."""


@dataclass(frozen=True, kw_only=True, eq=False)
class BoreModes:
    """Modes of the round bore of radius 1, and how curvature and torsion couple them.

    Attributes
    ----------
    names : tuple of str
        As ``00``, ``11c``, ``11s``; those with c are cos(m phi) and those with s sin(m phi), phi
        from the centre of curvature: from -y towards +x, where a press comes from +y.
    zeros : ndarray
        j'mn, (n,).
    x, across, twist : ndarray
        X, Y and M of the module's equations, (n, n), in units of the bore's radius.
    flattening : ndarray
        What the squared cut-on wavenumbers gain per ovality, (n,), in the same units.
    """

    names: tuple[str, ...]
    zeros: Array
    x: Array
    across: Array
    twist: Array
    flattening: Array


@dataclass(frozen=True, kw_only=True)
class Bent:
    """A part of a tube of one curvature.

    Attributes
    ----------
    length : float
        Of its centre line in m.
    curvature, torsion : float
        Of its centre line in 1/m; see :func:`bend`.
    ovality : float
        By which share the bore's radius is smaller in the plane of the bend, and larger across.

    Raises
    ------
    ConfigError
        If the length is not positive, or the curvature negative.
    """

    length: float
    curvature: float
    torsion: float = 0.0
    ovality: float = 0.0

    def __post_init__(self) -> None:
        if not (0 < self.length < np.inf and 0 <= self.curvature < np.inf):
            raise ConfigError(
                f"a part {self.length} m long of curvature {self.curvature} 1/m is no bend; use "
                "positive numbers"
            )


def bend(
    air: Air,
    frequency: ArrayLike,
    *,
    radius: float,
    bend_radius: float,
    angle: float,
    torsion: float = 0.0,
    lossy: bool = True,
    modes: Sequence[str] | None = None,
    highest: float = HIGHEST,
) -> ModalScattering:
    """Return how a bend between two straight ends scatters the modes of a round bore.

    Parameters
    ----------
    air : Air
    frequency : array_like
        Rising frequencies in Hz, (n,).
    radius : float
        Of the bore in m.
    bend_radius : float
        1 / kappa, from the centre of curvature to the centre line, in m.
    angle : float
        By which the centre line turns in rad; its length is `bend_radius` times this.
    torsion : float
        Of the centre line in 1/m, positive for a right-handed screw; 0 for a plane bend. The modes
        at the far end are those about the normal there: towards the arm all along a helix.
    lossy : bool
        With the losses of the straight bore.
    modes : sequence of str, optional
        Those of the result, in this order: those of the presses beside it in a cascade. All that
        propagate at the highest frequency if not given.
    highest : float
        Largest j'mn of the modes that are computed.

    Returns
    -------
    ModalScattering
        Power-normalised, with both reference planes at the bend's middle, as if the tube were
        straight: place it there.

    Raises
    ------
    ConfigError
        If a size is not positive, the bend is too sharp, the frequencies do not rise, or a mode is
        not among those computed.

    Notes
    -----
    The centre of curvature lies towards -y. The modes' signs are those of a lumen symmetric about
    x = 0, which is computed by halves.
    """
    _check_bend(radius, bend_radius, angle)
    part = Bent(length=angle * bend_radius, curvature=1 / bend_radius, torsion=torsion)
    return joined_bends(
        air, frequency, [part], radius=radius, lossy=lossy, modes=modes, highest=highest
    )


def joined_bends(
    air: Air,
    frequency: ArrayLike,
    parts: Sequence[Bent],
    *,
    radius: float,
    lossy: bool = True,
    modes: Sequence[str] | None = None,
    highest: float = HIGHEST,
) -> ModalScattering:
    """Return how a tube that is bent in several ways, one after another, scatters its modes.

    Parameters
    ----------
    air, frequency, radius, lossy, modes, highest
        See :func:`bend`.
    parts : sequence of Bent
        From port 1 to port 2. The normal, towards the centre of curvature, goes on from one to the
        next.

    Returns
    -------
    ModalScattering
        See :func:`bend`.

    Raises
    ------
    ConfigError
        See :func:`bend`.
    """
    frequency = np.atleast_1d(np.asarray(frequency, float))
    _check_sound(frequency, radius, highest, air)
    bore = bore_modes(highest)
    names = _result_modes(modes, bore, frequency, radius, air)
    length = sum(part.length for part in parts)
    scattered = [
        reduce(_joined, [_bent(air, some, bore, radius, part, lossy) for part in parts])
        for some in np.array_split(frequency, ceil(len(frequency) / CHUNK))
    ]
    cut_ons = np.array(
        [cut_on_frequency(*mode_numbers(name), radius, air.sound_speed) for name in names]
    )
    propagates = frequency[:, None] > cut_ons
    place = [bore.names.index(name) for name in names]
    m = len(bore.names)
    s = np.concatenate(scattered).reshape(len(frequency), 2, m, 2, m)[:, :, place][..., place]
    waves = _wavenumbers(names, frequency, radius, air, lossy)
    straight = _wavenumbers(names, frequency, radius, air, False)
    # What carries the same power has the same amplitude, and nothing travels below cut-on.
    size = np.where(propagates, np.sqrt(np.abs(straight)), 0.0)
    inverse = np.where(propagates, np.exp(0.5j * waves * length) / np.where(size > 0, size, 1), 0.0)
    size = size * np.where(propagates, np.exp(0.5j * waves * length), 0.0)
    s = size[:, None, :, None, None] * s * inverse[:, None, None, None, :]
    return ModalScattering(
        frequency=frequency,
        modes=names,
        s=s,
        propagates=propagates,
        cut_ons=cut_ons,
        sound_speed=air.sound_speed,
        extent=(-length / 2, length / 2),
    )


def bore_modes(highest: float) -> BoreModes:
    """Return the modes of a round bore up to a j'mn, and their couplings.

    Parameters
    ----------
    highest : float
        Largest j'mn.

    Notes
    -----
    The integrals over the section are a Gauss rule along the radius times the trapezoidal rule
    around, exact to rounding for the smooth products of the modes.
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
    lever = area * r * np.cos(phi)

    def over_section(left: Array, weight: Array, right: Array) -> Array:
        return np.asarray(np.einsum("irp,rp,jrp->ij", left, weight, right, optimize=True))

    return BoreModes(
        names=tuple(f"{m}{n}{side if m else ''}" for m, n, side in sides),
        zeros=np.array([bessel_zero(m, n) for m, n, _ in sides]),
        x=over_section(psi, lever, psi),
        across=over_section(d_r, lever, d_r) + over_section(d_phi / r, lever, d_phi / r),
        twist=over_section(psi, area + 0 * phi, d_phi),
        flattening=np.array([_flattened(m, n, side) for m, n, side in sides]),
    )


def _flattened(m: int, n: int, side: str) -> float:
    """Return what a mode's squared cut-on wavenumber gains per ovality, by Hadamard's formula."""
    if m != 1:
        return 0.0
    square = bessel_zero(m, n) ** 2
    return (1 if side == "c" else -1) * square * (square + 1) / (square - 1)


def _mode_fields(m: int, n: int, side: str, r: Array, phi: Array) -> tuple[Array, Array, Array]:
    """Return a mode and its derivatives by r and phi, (r, phi)."""
    zero = bessel_zero(m, n)
    around, turned = (np.cos, np.sin) if side == "c" else (np.sin, np.cos)
    sign = -m if side == "c" else m
    shape = jv(m, zero * r)
    slope = zero * jvp(m, zero * r)
    return shape * around(m * phi), slope * around(m * phi), sign * shape * turned(m * phi)


def _check_bend(radius: float, bend_radius: float, angle: float) -> None:
    """Refuse what is no bend, in the words of its sizes."""
    for name, value in (("radius", radius), ("bend_radius", bend_radius), ("angle", angle)):
        if not 0 < value < np.inf:
            raise ConfigError(f"{name} = {value} must be positive; give m, and rad for the angle")
    if radius > SHARPEST * bend_radius:
        raise ConfigError(
            f"bend_radius = {1e3 * bend_radius:.4g} mm is too sharp for a bore radius of "
            f"{1e3 * radius:.4g} mm; use {1e3 * radius / SHARPEST:.4g} mm or more"
        )


def _check_sound(frequency: Array, radius: float, highest: float, air: Air) -> None:
    """Refuse frequencies that do not rise, or that the modes do not reach."""
    if frequency.ndim != 1 or not (frequency[0] > 0 and np.all(np.diff(frequency) > 0)):
        raise ConfigError("frequency must rise from a value over 0; give one row of Hz")
    if 2 * pi * frequency[-1] * radius / air.sound_speed > 0.8 * highest:
        raise ConfigError(
            f"frequency = {frequency[-1]:g} Hz needs modes up to j' = "
            f"{2 * pi * frequency[-1] * radius / air.sound_speed / 0.8:.3g} and has those up to "
            f"{highest:g}; raise highest"
        )


def _result_modes(
    wanted: Sequence[str] | None, bore: BoreModes, frequency: Array, radius: float, air: Air
) -> tuple[str, ...]:
    """Return the modes of the result, in the order of their cut-ons if none are named."""
    if wanted is None:
        reached = bore.zeros < 2 * pi * frequency[-1] * radius / air.sound_speed
        return tuple(name for name, is_in in zip(bore.names, reached, strict=True) if is_in)
    unknown = [name for name in wanted if name not in bore.names]
    if unknown:
        raise ConfigError(
            f"modes = {', '.join(unknown)} are not among those computed; raise highest"
        )
    return tuple(wanted)


def _wavenumbers(
    names: Sequence[str], frequency: Array, radius: float, air: Air, lossy: bool
) -> Complex:
    """Return k_z of modes, (n_frequencies, n_modes)."""
    return np.stack(
        [
            axial_wavenumber(*mode_numbers(name), frequency, radius, air, lossy=lossy)
            for name in names
        ],
        axis=-1,
    )


def _bent(
    air: Air, frequency: Array, bore: BoreModes, radius: float, part: Bent, lossy: bool
) -> Complex:
    """Return the scattering of pressures at the ends of a bend, (n, 2 m, 2 m)."""
    k = (2 * pi * frequency / air.sound_speed)[:, None, None]
    waves = _wavenumbers(bore.names, frequency, radius, air, lossy)
    waves = np.where(np.abs(waves) < NEAREST_CUT_ON * k[:, 0], NEAREST_CUT_ON * k[:, 0], waves)
    m, bent = len(bore.names), part.curvature * radius
    squares = waves**2 - part.ovality * bore.flattening / radius**2
    # Velocities over k, so that all blocks are of one size.
    to_pressure = np.eye(m) - bent * bore.x
    to_velocity = squares[:, :, None] * np.eye(m) / k**2 - bent * (
        bore.x - bore.across / (radius * k) ** 2
    )
    generator = np.zeros((len(frequency), 2 * m, 2 * m), complex)
    generator[:, :m, :m] = generator[:, m:, m:] = part.torsion * bore.twist
    generator[:, :m, m:] = -1j * k * to_pressure
    generator[:, m:, :m] = -1j * k * to_velocity
    n_doublings = max(0, ceil(log2(part.length * bore.zeros.max() / radius / SLICE)))
    slice_ = expm(generator * (part.length / 2**n_doublings))
    s = _as_scattering(slice_, waves / k[:, 0])
    for _ in range(n_doublings):
        s = _joined(s, s)
    return s


def _as_scattering(transfer: Complex, admittance: Complex) -> Complex:
    """Return the scattering of a slice from its transfer of pressure and velocity."""
    m = admittance.shape[1]
    one = np.broadcast_to(np.eye(m), (len(admittance), m, m))
    y = admittance[:, :, None] * one
    basis = np.block([[one, one], [y, -y]])
    w = np.linalg.solve(basis, transfer @ basis)
    back = np.linalg.inv(w[:, m:, m:])
    turned = w[:, :m, m:] @ back
    return np.block([[-back @ w[:, m:, :m], back], [w[:, :m, :m] - turned @ w[:, m:, :m], turned]])


def _joined(first: Complex, second: Complex) -> Complex:
    """Return the scattering of two parts in a row (Redheffer's star product)."""
    m = first.shape[1] // 2
    (a11, a12), (a21, a22) = _blocks(first, m)
    (b11, b12), (b21, b22) = _blocks(second, m)
    echo = np.linalg.solve(np.eye(m) - a22 @ b11, np.concatenate([a21, a22 @ b12], axis=2))
    onward, returned = echo[:, :, :m], echo[:, :, m:]
    return np.block(
        [
            [a11 + a12 @ b11 @ onward, a12 @ (b12 + b11 @ returned)],
            [b21 @ onward, b22 + b21 @ returned],
        ]
    )


def _blocks(s: Complex, m: int) -> Any:
    """Return the four blocks of a scattering matrix: [port out][port in]."""
    return (s[:, :m, :m], s[:, :m, m:]), (s[:, m:, :m], s[:, m:, m:])
