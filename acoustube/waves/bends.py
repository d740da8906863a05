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

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import reduce
from math import ceil, log2, pi

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.linalg import expm

from acoustube.air import Air
from acoustube.base.checks import BORE, FREQUENCIES, Optional, Several, check_fields, checked
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.waves.grid.polyhedron import Array
from acoustube.waves.modes import cut_on_frequency
from acoustube.waves.modes.bore_couplings import BoreModes, bore_modes
from acoustube.waves.modes.grid_modes import mode_numbers, wavenumbers
from acoustube.waves.port_waves import Complex
from acoustube.waves.scattering import ModalScattering, PlaneWave
from acoustube.waves.star_product import from_transfer, star_product

LARGEST_ZERO = 10.0
"""Largest j'mn, zero of a Bessel function's derivative, of the modes in the sums. With 14 the
scattering by the bends of a tube wrapped as in the sleeve paper ("Wearable, Fabric-Embedded
Acoustic Waveguides for Meter-Scale Contact Localization and Force Sensing") changes by 1e-5."""
SLICE_EXPONENT = 0.5
"""Largest growth exponent of the most evanescent mode over a slice."""
CUT_ON_MARGIN = 1e-6
"""Lower limit of abs(kz) / k: closer to cut-on, forward and backward wave are almost the same."""
FREQUENCY_BATCH = 64
"""Number of frequencies that are computed together."""
PLANE_NODES = 33
"""Number of nodes over frequency for interpolation of the plane wave's wavenumber in a bend."""
LONGEST = 100.0
"""Largest length of a bend in m: along a longer one the amplitudes underflow."""
LARGEST_CURVATURE = 0.95
"""Largest ratio of bore radius to bend radius; at 1 the inner wall is folded."""
HIGHEST = Number(1, 30.5)
"""Bounds of the largest Bessel zero j'mn: from 30.6, of (1,10), names as ``11c`` are ambiguous."""
NAMES = Optional(Several(str, 1))


@dataclass(frozen=True, kw_only=True)
class Bent:
    """A part of a tube of constant curvature and torsion.

    Attributes
    ----------
    length : float
        Length of the centre line in m.
    curvature, torsion : float
        Curvature and torsion of the centre line in 1/m; see :func:`bend`.
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


@checked(
    air=Air, frequency=FREQUENCIES, radius=BORE, bend_radius=Number(-1e6, 1e6, "m"),
    angle=Number(-1e6, 1e6, "rad"), torsion=Number(-1e6, 1e6, "1/m"), modes=NAMES, highest=HIGHEST,
)  # fmt: skip
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
    highest: float = LARGEST_ZERO,
) -> ModalScattering:
    """Return the scattering matrix of a bend between two straight ends of a round bore.

    Parameters
    ----------
    air : Air
    frequency : array_like
        Rising frequencies in Hz, (n,).
    radius : float
        Bore radius in m.
    bend_radius : float
        Bend radius 1 / kappa, from the centre of curvature to the centre line, in m.
    angle : float
        Turning angle in rad; the length of the centre line is `bend_radius` times this angle.
    torsion : float
        Torsion of the centre line in 1/m, positive for a right-handed helix; 0 for a plane bend.
        The modes at the far end refer to the normal there, which points to the axis of a helix.
    lossy : bool
        With the losses of the straight bore.
    modes : sequence of str, optional
        Modes of the result, in this order: those of the presses with which it is combined. By
        default, all modes that propagate at the highest frequency.
    highest : float
        Largest j'mn of the modes that are computed, from 1 to 30.5.

    Returns
    -------
    ModalScattering
        Power-normalised, with a reference plane at either end; the position is the bend's middle.

    Raises
    ------
    ConfigError
        If a size is not positive, the bend is too sharp, the frequencies do not increase, `highest`
        is too low for them, or a mode is not among those computed.

    Notes
    -----
    The centre of curvature lies towards -y. The modes' signs are those of all scattering matrices:
    of J_m times cos(m phi) or sin(m phi), with phi from -y towards +x.
    """
    _check_bend(radius, bend_radius, angle)
    _check_length(angle, bend_radius)
    part = Bent(length=angle * bend_radius, curvature=1 / bend_radius, torsion=torsion)
    return joined_bends(
        air, frequency, [part], radius=radius, lossy=lossy, modes=modes, highest=highest
    )


@checked(
    air=Air, frequency=FREQUENCIES, parts=Several(Bent, 1), radius=BORE, modes=NAMES,
    highest=HIGHEST,
)  # fmt: skip
def joined_bends(
    air: Air,
    frequency: ArrayLike,
    parts: Sequence[Bent],
    *,
    radius: float,
    lossy: bool = True,
    modes: Sequence[str] | None = None,
    highest: float = LARGEST_ZERO,
) -> ModalScattering:
    """Return the scattering matrix of several bends in series.

    Parameters
    ----------
    air, frequency, radius, lossy, modes, highest
        See :func:`bend`.
    parts : sequence of Bent
        In their order along the tube. The normal, towards the centre of curvature, is continuous.

    Returns
    -------
    ModalScattering
        See :func:`bend`, also for the errors that are raised.
    """
    frequency = np.atleast_1d(np.asarray(frequency, float))
    _check_curvature(radius, max(part.curvature for part in parts))
    _check_sound(frequency, radius, highest, air)
    bore = bore_modes(highest)
    names = _result_modes(modes, bore, frequency, radius, air)
    scattered = [
        reduce(
            star_product, [_bend_scattering(air, some, bore, radius, part, lossy) for part in parts]
        )
        for some in np.array_split(frequency, ceil(len(frequency) / FREQUENCY_BATCH))
    ]
    s = np.concatenate(scattered)
    length = sum(part.length for part in parts)
    found = _power_normalised(s, names, bore, air, frequency, radius=radius, length=length)
    return replace(found, inside=_plane_wave(air, frequency, bore, radius, parts, lossy))


def _plane_wave(
    air: Air, frequency: Array, bore: BoreModes, radius: float, parts: Sequence[Bent], lossy: bool
) -> PlaneWave:
    """Return the plane wave in bends: the bent bore's travelling mode of largest wavenumber."""
    few = len(frequency) <= PLANE_NODES
    nodes = frequency if few else np.linspace(frequency[0], frequency[-1], PLANE_NODES)
    found = []
    for part in parts:
        generator, _ = bend_generator(air, nodes, bore, radius, part, lossy)
        own = 1j * np.linalg.eigvals(generator)
        # With losses or torsion the wavenumbers of evanescent modes have real parts too.
        travels = np.abs(own.imag) <= own.real
        first = np.argmax(np.where(travels, own.real, -np.inf), axis=1)
        found.append(np.take_along_axis(own, first[:, None], 1)[:, 0])
    wavenumber = np.stack(found)
    if not few:
        wavenumber = CubicSpline(nodes, wavenumber, axis=1)(frequency)
    return PlaneWave(np.array([part.length for part in parts]), wavenumber)


def _power_normalised(
    s: Complex,
    names: tuple[str, ...],
    bore: BoreModes,
    air: Air,
    frequency: Array,
    *,
    radius: float,
    length: float,
) -> ModalScattering:
    """Return the power-normalised scattering of some modes between the ends of a bend."""
    cut_ons = np.array(
        [cut_on_frequency(*mode_numbers(name), radius, air.sound_speed) for name in names]
    )
    propagates = frequency[:, None] > cut_ons
    place = mode_places(names, bore)
    m = len(bore.names)
    s = s.reshape(len(frequency), 2, m, 2, m)[:, :, place][..., place]
    straight = wavenumbers(names, frequency, radius, air, lossy=False)
    # The amplitude is the square root of the power, and no power propagates below cut-on.
    size = np.where(propagates, np.sqrt(np.abs(straight)), 0.0)
    inverse = np.where(propagates, 1 / np.where(size > 0, size, 1), 0.0)
    s = size[:, None, :, None, None] * s * inverse[:, None, None, None, :]
    return ModalScattering(
        frequency=frequency,
        modes=names,
        s=s,
        propagates=propagates,
        cut_ons=cut_ons,
        sound_speed=air.sound_speed,
        extent=(-length / 2, length / 2),
        planes=(-length / 2, length / 2),
    )


def _check_bend(radius: float, bend_radius: float, angle: float) -> None:
    """Validate bore radius, bend radius and angle."""
    for name, value in (("radius", radius), ("bend_radius", bend_radius), ("angle", angle)):
        if not 0 < value < np.inf:
            advice = "give m, and rad for the angle"
            raise ConfigError("must be positive", setting=name, value=value, advice=advice)
    if radius > LARGEST_CURVATURE * bend_radius:
        raise ConfigError(
            f"is too sharp for a bore radius of {radius:.4g} m", setting="bend_radius",
            value=bend_radius, unit="m", allowed=(radius / LARGEST_CURVATURE, np.inf),
            advice=f"use {radius / LARGEST_CURVATURE:.4g} m or more",
        )  # fmt: skip


def _check_curvature(radius: float, curvature: float) -> None:
    """Validate the largest curvature of several bends, up to rounding."""
    if curvature * radius > LARGEST_CURVATURE * (1 + 1e-9):
        most = LARGEST_CURVATURE / radius
        raise ConfigError(
            f"is too sharp for a bore radius of {radius:.4g} m", setting="curvature",
            value=curvature, unit="1/m", allowed=(0, most),
            advice=f"use at most {0.999 * most:.4g}",
        )  # fmt: skip


def _check_length(angle: float, bend_radius: float) -> None:
    """Validate the length of a bend's centre line."""
    if not 1e-9 <= angle * bend_radius <= LONGEST:
        raise ConfigError(
            f"and bend_radius = {bend_radius:g} m make a bend of {angle * bend_radius:.3g} m",
            setting="angle", value=angle, unit="rad", advice=f"use 1e-09 to {LONGEST:g} m",
        )  # fmt: skip


def _check_sound(frequency: Array, radius: float, highest: float, air: Air) -> None:
    """Validate that the frequencies increase, and that the modes suffice for the highest."""
    if frequency.ndim != 1 or not np.all(np.diff(frequency, prepend=0.0) > 0) or not frequency.size:
        raise ConfigError("frequency must be positive and increasing; give a 1-D array in Hz")
    least = 2 * pi * frequency[-1] * radius / air.sound_speed / 0.8
    if least > highest:
        advice = f"use {ceil(100 * least) / 100:g} or more"
        if least > HIGHEST.high:
            most = frequency[-1] * HIGHEST.high / least
            advice = f"use frequencies up to {int(most)} Hz with highest = {HIGHEST.high:g}"
        raise ConfigError(
            f"is too low for frequency = {frequency[-1]:g} Hz and radius = {radius:g} m",
            setting="highest", value=highest, advice=advice,
        )  # fmt: skip


def _result_modes(
    wanted: Sequence[str] | None, bore: BoreModes, frequency: Array, radius: float, air: Air
) -> tuple[str, ...]:
    """Return the modes of the result, in the order of their cut-ons if none are named."""
    if wanted is None:
        reached = bore.zeros < 2 * pi * frequency[-1] * radius / air.sound_speed
        return tuple(name for name, is_in in zip(bore.names, reached, strict=True) if is_in)
    mode_places(wanted, bore)
    return tuple(wanted)


def mode_places(wanted: Sequence[str], bore: BoreModes) -> list[int]:
    """Return the indices of modes among those of a bore; raise ConfigError if one is missing."""
    unknown = [name for name in wanted if name not in bore.names]
    if unknown:
        raise ConfigError(
            f"are not among those computed, {', '.join(bore.names)}", setting="modes",
            value=", ".join(unknown), allowed=tuple(bore.names), advice="raise highest",
        )  # fmt: skip
    return [bore.names.index(name) for name in wanted]


def _bend_scattering(
    air: Air, frequency: Array, bore: BoreModes, radius: float, part: Bent, lossy: bool
) -> Complex:
    """Return the scattering matrix of a bend, not power-normalised, (n, 2 m, 2 m)."""
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
