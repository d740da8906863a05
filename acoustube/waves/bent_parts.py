"""Scattering of the modes of a round bore by bends: the multimodal method.

The centre line has the curvature kappa, the torsion tau and the arc length s. Let x point across
the tube towards the centre of curvature, phi be the azimuth and h = 1 - kappa x. At the angular
frequency omega = k c the pressure p and u, the axial velocity times omega rho, obey

    T p = -j h u,    T u = -j (k^2 h + div h grad) p,    T = d/ds - tau d/dphi,

with div and grad across the tube. This is exact for a torus and for a helix. With p and u as sums
of the straight bore's modes psi_m, of coefficients a and a_u, the equations become

    a' = -j B a_u + tau M a,    a_u' = -j K a + tau M a_u,
    B = 1 - kappa X,    K = k_z^2 - kappa (k^2 X - Y),
    X = <psi x psi>,    Y = <grad psi x grad psi>,    M = <psi d psi/dphi>.

<> is the mean over the section, for modes of mean square 1, and k_z^2 the diagonal matrix of the
straight bore's squared axial wavenumbers, with its losses; the effect of curvature on these is
neglected. No coefficient depends on s. The scattering matrix of a slice, too short for its
evanescent modes to grow, is doubled by the star product until it is that of the bend: the
multimodal method of [1]_ and [2]_, with doubling in place of the Riccati equation. Parts of
different curvature are combined by the same product.

A bend flattens the tube. To first order this shifts the cut-ons of the modes (1, n) only, see
:mod:`acoustube.waves.modes.bore_couplings`; their k_z^2 on the diagonal changes accordingly. The
coupling where the flattening begins is neglected, because a tube flattens gradually.

References
----------
.. [1] Félix, S. and Pagneux, V. (2001). Sound propagation in rigid bends: a multimodal approach.
   Journal of the Acoustical Society of America 110, 1329-1337.
.. [2] Félix, S. and Pagneux, V. (2002). Multimodal analysis of acoustic propagation in
   three-dimensional bends. Wave Motion 36, 157-168. doi:10.1016/S0165-2125(02)00009-4
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from math import ceil, log2, pi

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.linalg import expm

from acoustube.air import Air
from acoustube.base.checks import check_fields
from acoustube.base.rules import Number
from acoustube.waves.grid.polyhedron import Array
from acoustube.waves.modes.bore_couplings import BoreModes
from acoustube.waves.modes.grid_modes import wavenumbers
from acoustube.waves.port_waves import Complex
from acoustube.waves.scattering import PlaneWave
from acoustube.waves.star_product import from_transfer, star_product

SLICE_EXPONENT = 0.5
"""Largest growth exponent of the most evanescent mode over a slice."""
CUT_ON_MARGIN = 1e-6
"""Lower limit of abs(kz) / k: closer to cut-on, forward and backward wave are almost the same."""
GRADUAL_NODES = 7
"""Number of parts of a gradual bend that are computed; the others are interpolated. With 9 nodes
the scattering of the sleeve paper's tube changes by less than 1e-7."""
PLANE_NODES = 33
"""Number of nodes over frequency for interpolation of the plane wave's wavenumber in a bend."""
SAME_LENGTH = 1e-12
"""Difference in m up to which the lengths of parts count as equal."""
LONGEST = 100.0
"""Largest length of a bend in m: along a longer one the amplitudes underflow."""


@dataclass(frozen=True, kw_only=True)
class Bent:
    """A part of a tube of constant curvature and torsion.

    Attributes
    ----------
    length : float
        Length of the centre line in m.
    curvature, torsion : float
        Curvature and torsion of the centre line in 1/m; see
        :func:`acoustube.waves.bend`.
    ovality : float
        Relative decrease of the bore's radius in the plane of the bend, and increase across it.

    Raises
    ------
    ConfigError
        If the length is not from 1e-9 to 100 m, the curvature negative or the ovality beyond +-1.
    """

    length: float
    curvature: float
    torsion: float = 0.0
    ovality: float = 0.0

    def __post_init__(self) -> None:
        check_fields(
            self, length=Number(1e-9, LONGEST, "m"), curvature=Number(0, 1e6, "1/m"),
            torsion=Number(-1e6, 1e6, "1/m"), ovality=Number(-1, 1),
        )  # fmt: skip


def equal_parts(parts: Sequence[Bent]) -> list[list[Bent]]:
    """Return neighbouring parts of equal length and ovality as groups, in their order."""
    groups = [[parts[0]]]
    for part in parts[1:]:
        last = groups[-1][-1]
        same = abs(part.length - last.length) < SAME_LENGTH and part.ovality == last.ovality
        if same:
            groups[-1].append(part)
        else:
            groups.append([part])
    return groups


def _nodes(n: int) -> tuple[NDArray[np.int_], Array]:
    """Return the numbers of the parts of a group of n that are computed, and interpolation weights.

    The numbers are the nearest to Chebyshev's nodes. Row i of the weights, (n, n_nodes), holds the
    values of Lagrange's polynomials at part i.
    """
    if n <= 2 * GRADUAL_NODES:
        return np.arange(n), np.eye(n)
    x = -np.cos(pi * (np.arange(GRADUAL_NODES) + 0.5) / GRADUAL_NODES)
    nodes = np.rint((n - 1) * (x + 1) / 2).astype(int)
    apart = nodes[:, None] - nodes + np.eye(GRADUAL_NODES)
    factors = (np.arange(n)[:, None, None] - nodes) / apart
    factors[:, np.eye(GRADUAL_NODES, dtype=bool)] = 1.0
    return nodes, np.asarray(factors.prod(axis=2))


def _interpolated(groups: list[list[Bent]], of: Callable[[Bent], Complex]) -> Iterator[Complex]:
    """Yield a quantity of each part, an array, computed at the nodes of each group."""
    for group in groups:
        nodes, weights = _nodes(len(group))
        known = np.stack([of(group[i]) for i in nodes])
        for row in weights:
            yield np.tensordot(row, known, 1)


def scattering_of_parts(
    air: Air,
    frequency: Array,
    bore: BoreModes,
    radius: float,
    groups: list[list[Bent]],
    lossy: bool,
) -> Iterator[Complex]:
    """Return the scattering matrices of all parts, not power-normalised, each (n, 2 m, 2 m)."""
    return _interpolated(
        groups, lambda part: _part_scattering(air, frequency, bore, radius, part, lossy)
    )


def plane_wave(
    air: Air,
    frequency: Array,
    bore: BoreModes,
    radius: float,
    groups: list[list[Bent]],
    lossy: bool,
) -> PlaneWave:
    """Return the plane wave in bends: the bent bore's travelling mode of largest wavenumber."""
    few = len(frequency) <= PLANE_NODES
    at = frequency if few else np.linspace(frequency[0], frequency[-1], PLANE_NODES)

    def wavenumber_in(part: Bent) -> Complex:
        generator, _ = bend_generator(air, at, bore, radius, part, lossy)
        own = 1j * np.linalg.eigvals(generator)
        # With losses or torsion the wavenumbers of evanescent modes have real parts too.
        travels = np.abs(own.imag) <= own.real
        first = np.argmax(np.where(travels, own.real, -np.inf), axis=1)
        return np.asarray(np.take_along_axis(own, first[:, None], 1)[:, 0])

    wavenumber: Complex = np.stack(list(_interpolated(groups, wavenumber_in)))
    if not few:
        wavenumber = CubicSpline(at, wavenumber, axis=1)(frequency)
    return PlaneWave(np.array([part.length for group in groups for part in group]), wavenumber)


def _part_scattering(
    air: Air, frequency: Array, bore: BoreModes, radius: float, part: Bent, lossy: bool
) -> Complex:
    """Return the scattering matrix of a part, not power-normalised, (n, 2 m, 2 m)."""
    generator, admittance = bend_generator(air, frequency, bore, radius, part, lossy)
    growth = part.length * max(bore.zeros.max(), 1.0) / radius  # the plane mode's zero is 0
    n_doublings = max(0, ceil(log2(growth / SLICE_EXPONENT)))
    slice_ = expm(generator * (part.length / 2**n_doublings))
    s = from_transfer(slice_, admittance)
    for _ in range(n_doublings):
        s = star_product(s, s)
    return s


def bend_generator(
    air: Air, frequency: Array | Complex, bore: BoreModes, radius: float, part: Bent, lossy: bool
) -> tuple[Complex, Complex]:
    """Return the matrix of the coupled equations in a bend, and the admittances of straight modes.

    Parameters
    ----------
    air : Air
    frequency : ndarray
        In Hz, real or complex, (n,).
    bore : BoreModes
        The m modes in the sums.
    radius : float
        Bore radius in m.
    part : Bent
    lossy : bool

    Returns
    -------
    generator : ndarray
        Matrix of d/ds for the modes' pressures a, then a_u / k (module's text), 1/m, (n, 2 m, 2 m).
    admittance : ndarray
        k_z / k of each mode in the straight bore, (n, m).
    """
    k = (2 * pi * frequency / air.sound_speed)[:, None, None]
    waves = wavenumbers(bore.names, frequency, radius, air, lossy=lossy)
    nearest = CUT_ON_MARGIN * k[:, 0]
    waves = np.where(np.abs(waves) < np.abs(nearest), nearest, waves)
    m, kappa = len(bore.names), part.curvature * radius
    squares = waves**2 - part.ovality * bore.flattening / radius**2
    # Velocities are divided by k, so that all blocks have the same order of magnitude.
    to_pressure = np.eye(m) - kappa * bore.x
    to_velocity = squares[:, :, None] * np.eye(m) / k**2 - kappa * (
        bore.x - bore.across / (radius * k) ** 2
    )
    generator = np.zeros((len(frequency), 2 * m, 2 * m), complex)
    generator[:, :m, :m] = generator[:, m:, m:] = part.torsion * bore.twist
    generator[:, :m, m:] = -1j * k * to_pressure
    generator[:, m:, :m] = -1j * k * to_velocity
    return generator, waves / k[:, 0]
