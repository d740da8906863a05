"""Modes of a circular duct: cut-on frequencies and viscothermal propagation."""

from __future__ import annotations

from dataclasses import dataclass
from math import acos, pi, sqrt
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import jnp_zeros, jve

from acoustube.air import Air
from acoustube.base.checks import FREQUENCY, LENGTH, SPEED, WAVES, Reals, checked
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number

MOST_WAVES = 300
"""Largest circumference of a bore, in wavelengths, for which modes are computed."""


@dataclass(frozen=True, kw_only=True)
class Mode:
    """A duct mode: m nodal diameters, n nodal circles, and its cut-on frequency in Hz."""

    m: int
    n: int
    cut_on: float


def bessel_zero(m: int, n: int) -> float:
    """Return j'mn, the n-th zero of the derivative of J_m; for the plane mode (0, 0) it is 0.

    Raises
    ------
    ValueError
        If m is negative, or n < 1 except in (0, 0).
    """
    if (m, n) == (0, 0):
        return 0.0
    if m < 0 or n < 1:
        raise ValueError(
            f"mode ({m}, {n}) does not exist; the plane mode is (0, 0), all others have n >= 1"
        )
    return float(jnp_zeros(m, n)[-1])


@checked(
    m=Number(-1000, 1000, whole=True),
    n=Number(-1000, 1000, whole=True),
    radius=LENGTH,
    sound_speed=SPEED,
)
def cut_on_frequency(m: int, n: int, radius: float, sound_speed: float) -> float:
    """Return the cut-on frequency j'mn c / (2 pi R) in Hz, for a radius R in m and c in m/s."""
    return bessel_zero(m, n) * sound_speed / (2.0 * pi * radius)


@checked(frequency=FREQUENCY, radius=LENGTH, sound_speed=SPEED)
def modes_below(frequency: float, radius: float, sound_speed: float) -> list[Mode]:
    """Return the modes that propagate at a frequency.

    Parameters
    ----------
    frequency : float
        In Hz.
    radius : float
        Bore radius in m.
    sound_speed : float
        In m/s.

    Returns
    -------
    list of Mode
        In the order of their cut-ons, the plane mode first. A mode with m > 0 is a degenerate pair.

    Raises
    ------
    ConfigError
        If the bore's circumference is more than `MOST_WAVES` wavelengths.
    """
    highest = 2.0 * pi * frequency * radius / sound_speed
    if highest > MOST_WAVES:
        raise ConfigError(
            f"frequency = {frequency:g} Hz in a bore of radius = {radius:g} m at sound_speed = "
            f"{sound_speed:g} m/s has too many modes; use at most "
            f"{MOST_WAVES * frequency / highest:.3g} Hz"
        )
    modes = [Mode(m=0, n=0, cut_on=0.0)]
    for m in range(int(highest) + 1):  # j'm1 > m
        # Near `highest`, J'm is a cosine of this phase (Debye); one zero more for its error near m.
        phase = sqrt(highest**2 - m**2) - m * acos(m / highest) if highest else 0.0
        zeros = np.asarray(jnp_zeros(m, int(phase / pi) + 2))
        cut_ons = zeros[zeros < highest] * (sound_speed / (2.0 * pi * radius))
        modes += [Mode(m=m, n=n, cut_on=float(f)) for n, f in enumerate(cut_ons, start=1)]
    return sorted(modes, key=lambda mode: mode.cut_on)


@checked(band=Reals(0, 1e12, "Hz", last=2), radius=LENGTH, sound_speed=SPEED)
def cut_ons_in_band(band: tuple[float, float], radius: float, sound_speed: float) -> list[Mode]:
    """Return the higher-order modes whose cut-on lies in a band.

    Near its cut-on, a small error decides whether a mode propagates.

    Parameters
    ----------
    band : tuple of float
        Lowest and highest frequency in Hz.
    radius, sound_speed : float
        Bore radius in m and speed of sound in m/s.

    Returns
    -------
    list of Mode
        In the order of their cut-ons.

    Raises
    ------
    ConfigError
        As :func:`modes_below`.
    """
    lowest, highest = band
    return [m for m in modes_below(highest, radius, sound_speed) if 0.0 < m.cut_on >= lowest]


@checked(
    m=Number(-1000, 1000, whole=True),
    n=Number(-1000, 1000, whole=True),
    frequency=WAVES,
    radius=LENGTH,
    air=Air,
)
def axial_wavenumber(
    m: int, n: int, frequency: ArrayLike, radius: float, air: Air, *, lossy: bool = True
) -> NDArray[np.complex128]:
    """Return the axial wavenumber kz of a mode of a round bore, for exp(+j omega t - j kz z).

    Parameters
    ----------
    m, n : int
        Numbers of nodal diameters and of nodal circles; (0, 0) is the plane mode.
    frequency : array_like
        In Hz, real or complex. With a negative imaginary part, spectra are those of signals times a
        decaying exponential.
    radius : float
        Bore radius in m.
    air : Air
        Gas in the lumen.
    lossy : bool
        With the losses at a smooth isothermal wall and the absorption in the air.

    Returns
    -------
    ndarray
        kz in 1/m, of the shape of `frequency`. The attenuation in Np/m is minus its imaginary part.
        Below cut-on kz is imaginary, except for the effect of losses.

    Raises
    ------
    ValueError
        If there is no such mode: m is negative, or n < 1 except in (0, 0).

    Notes
    -----
    The plane mode has the solution of Zwikker and Kosten [1]_, the low reduced frequency limit of
    Kirchhoff's [2]_: with F(s) = 1 - 2 J1(s) / (s J0(s)),
    s_v = R sqrt(-j omega / nu) and s_t = sqrt(Pr) s_v,

        kz^2 = k^2 (gamma - (gamma - 1) F(s_t)) / F(s_v).

    For higher-order modes the boundary layers are included to first order [3]_: with
    D_v = sqrt(nu / (j omega)), D_t = D_v / sqrt(Pr) and Q = 2/R for m = 0, otherwise
    2 / (R (1 - m^2/j'^2)),

        kz^2 (1 - D_v Q) = k^2 (1 + (gamma - 1) D_t Q) - (j'/R)^2 + D_v Q m^2/R^2.

    The absorption of the air is in k = omega / c - j alpha.

    References
    ----------
    .. [1] Zwikker, C. and Kosten, C. W. (1949). Sound Absorbing Materials. Elsevier, New York.
    .. [2] Tijdeman, H. (1975). On the propagation of sound waves in cylindrical tubes. Journal of
       Sound and Vibration 39, 1-33. doi:10.1016/S0022-460X(75)80206-9
    .. [3] Bruneau, A. M., Bruneau, M., Herzog, P. and Kergomard, J. (1987). Boundary layer
       attenuation of higher order modes in waveguides. Journal of Sound and Vibration 119, 15-27.
       doi:10.1016/0022-460X(87)90186-6
    """
    frequency = np.asarray(frequency)
    frequency = frequency.astype(np.result_type(frequency, float), copy=False)  # float16 overflows
    omega, zero = 2 * pi * frequency, bessel_zero(m, n)
    k = omega / air.sound_speed + 0j
    if not lossy:
        return _root(k**2 - (zero / radius) ** 2)
    k = k - 1j * air.absorption(frequency.real)
    if zero == 0.0:
        return _root(k**2 * _zwikker_kosten(omega, radius, air))
    across = 2 / (radius * (1 - (m / zero) ** 2))
    viscous = across * np.sqrt(air.viscous_diffusivity / (1j * omega))
    thermal = viscous / sqrt(air.prandtl)
    right = k**2 * (1 + (air.heat_capacity_ratio - 1) * thermal)
    right += viscous * (m / radius) ** 2 - (zero / radius) ** 2
    return _root(right / (1 - viscous))


def _zwikker_kosten(omega: NDArray[Any], radius: float, air: Air) -> NDArray[np.complex128]:
    """Return (kz / k)^2 of the plane mode after Zwikker and Kosten."""
    viscous = radius * np.sqrt(-1j * omega / air.viscous_diffusivity)
    # Scaled Bessel functions: the plain ones overflow at large imaginary arguments.
    part_v, part_t = (
        1 - 2 * jve(1, s) / (s * jve(0, s)) for s in (viscous, sqrt(air.prandtl) * viscous)
    )
    gamma = air.heat_capacity_ratio
    return np.asarray((gamma - (gamma - 1) * part_t) / part_v)


def _root(square: NDArray[Any]) -> NDArray[np.complex128]:
    """Return the square root whose wave decays or propagates towards +z."""
    root = np.sqrt(square)
    return np.where(root.imag > 0, -root, root)


@checked(frequency=FREQUENCY)
def attenuation(m: int, n: int, frequency: float, radius: float, air: Air) -> float:
    """Return a mode's attenuation in Np/m; see :func:`axial_wavenumber`.

    Parameters
    ----------
    m, n : int
        Numbers of nodal diameters and of nodal circles; (0, 0) is the plane mode.
    frequency : float
        In Hz.
    radius : float
        Bore radius in m.
    air : Air
        Gas in the lumen.

    Returns
    -------
    float
        In Np/m; below cut-on that of the evanescent wave.

    Raises
    ------
    ValueError
        If there is no such mode.
    """
    return -float(axial_wavenumber(m, n, frequency, radius, air).imag)
