"""Plane mode of a bore whose wall yields: an elastic tube of any thickness, with its inertia.

References
----------
* Waves in elastic tubes of finite thickness: Atabek, H. B. and Lew, H. S. (1966). Wave propagation
  through a viscous incompressible fluid contained in an initially stressed elastic tube.
  Biophysical Journal 6, 481-503.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import iv, kv

from acoustube.air import Air
from acoustube.base.checks import LENGTH, Instance, Reals, check_fields, checked
from acoustube.base.errors import SimulationError
from acoustube.base.rules import Number
from acoustube.tube import shear_modulus_from_shore
from acoustube.waves.modes.round_duct import axial_wavenumber

Complex = NDArray[np.complex128]

FREQUENCIES = Reals(1e-6, 1e12, "Hz")
MOST_STEPS, TOLERANCE = 50, 1e-10
"""Largest number of steps of the secant method, and largest residual of its equation, relative to
the squared wavenumber. Near the wall's resonance up to 20 steps are needed, elsewhere 2 to 4."""


@dataclass(frozen=True, kw_only=True)
class YieldingWall:
    """Tube wall of an incompressible, linear viscoelastic material, free on the outside.

    Attributes
    ----------
    thickness : float
        In m.
    shear_modulus : float
        In Pa, at small strain; by default that of Shore A 35. At ultrasonic frequencies silicone is
        stiffer.
    density : float
        In kg/m3.
    loss_factor : float
        Ratio of the imaginary to the real part of the shear modulus.

    Raises
    ------
    ConfigError
        If thickness, modulus or density is not positive, or the loss factor not from 0 to 10.
    """

    thickness: float = 1.6e-3
    shear_modulus: float = shear_modulus_from_shore(35.0)
    density: float = 1100.0
    loss_factor: float = 0.1

    def __post_init__(self) -> None:
        """Validate all numbers."""
        check_fields(
            self, thickness=LENGTH, shear_modulus=Number(1e-3, 1e15, "Pa"),
            density=Number(1e-3, 1e6, "kg/m3"), loss_factor=Number(0, 10),
        )  # fmt: skip


@checked(frequency=FREQUENCIES, radius=LENGTH, wall=Instance((YieldingWall,)))
def wall_compliance(
    frequency: ArrayLike, wavenumber: ArrayLike, radius: float, wall: YieldingWall
) -> Complex:
    """Return the outward radial displacement of the inner wall per pressure in the bore.

    Parameters
    ----------
    frequency : array_like
        In Hz, real, (n,).
    wavenumber : array_like
        Axial wavenumber of the pressure in 1/m, (n,).
    radius : float
        Bore radius in m.
    wall : YieldingWall

    Returns
    -------
    ndarray
        In m/Pa, for exp(+j omega t - j k z), (n,).

    Raises
    ------
    ConfigError
        If a frequency or the radius is not real, positive and finite.

    Notes
    -----
    The wall extends from the inner radius a to the outer radius b. In an incompressible wall the
    pressure P is harmonic, with solutions ``I0(k r)`` and ``K0(k r)``, and displaces the wall by
    ``grad P / (rho omega^2)``. Shear waves have the solutions ``I1(s r)`` and ``K1(s r)`` with
    ``s^2 = k^2 - rho omega^2 / mu``. The four amplitudes follow from the tractions on both faces:
    the pressure on the inner face, none on the outer. For long waves the ratio of pressure to
    displacement is that of a ring, ``a (2 mu (1/a^2 - 1/b^2) - omega^2 rho ln(b/a))``.
    """
    omega = 2 * pi * np.atleast_1d(np.asarray(frequency, float))
    k = np.atleast_1d(np.asarray(wavenumber, complex))
    modulus = wall.shear_modulus * (1 + 1j * wall.loss_factor)
    inertia = wall.density * omega**2
    s = np.sqrt(k**2 - inertia / modulus)
    matrix = np.zeros((len(omega), 4, 4), complex)
    for row, r in ((0, radius), (2, radius + wall.thickness)):
        radial, along = _tractions(k, s, r, modulus, inertia)
        matrix[:, row], matrix[:, row + 1] = radial, along
    right = np.zeros((len(omega), 4, 1), complex)
    right[:, 0] = -1.0
    scale = np.abs(matrix).max(axis=1, keepdims=True)
    rows = np.abs(matrix / scale).max(axis=2, keepdims=True)
    amplitude = np.linalg.solve(matrix / scale / rows, right / rows)[:, :, 0] / scale[:, 0]
    shapes = _displacements(k, s, radius, inertia)[0]
    return np.asarray((shapes * amplitude).sum(axis=1))


def _displacements(k: Complex, s: Complex, r: float, inertia: NDArray[np.float64]) -> list[Complex]:
    """Return the radial displacement of the four solutions and its r derivative, (n, 4) each."""
    i0, i1, k0, k1 = (f(n, k * r) for f in (iv, kv) for n in (0, 1))
    j0, j1, y0, y1 = (f(n, s * r) for f in (iv, kv) for n in (0, 1))
    radial = np.stack([k * i1 / inertia, -k * k1 / inertia, j1, y1], axis=1)
    slope = np.stack([
        k * (k * i0 - i1 / r) / inertia, k * (k * k0 + k1 / r) / inertia,
        s * j0 - j1 / r, -s * y0 - y1 / r,
    ], axis=1)  # fmt: skip
    return [radial, slope]


def _tractions(
    k: Complex, s: Complex, r: float, modulus: complex, inertia: NDArray[np.float64]
) -> tuple[Complex, Complex]:
    """Return the radial and axial tractions of the four solutions on a cylinder, (n, 4) each."""
    radial, slope = _displacements(k, s, r, inertia)
    i0, i1, k0, k1 = (f(n, k * r) for f in (iv, kv) for n in (0, 1))
    j1, y1 = iv(1, s * r), kv(1, s * r)
    zero = np.zeros_like(k)
    pressure = np.stack([i0, k0, zero, zero], axis=1)
    # The r derivative of the axial displacement: from grad P, and from zero divergence.
    turned = np.stack([
        -1j * k * k * i1 / inertia, 1j * k * k * k1 / inertia, -1j * s**2 * j1 / k,
        -1j * s**2 * y1 / k,
    ], axis=1)  # fmt: skip
    return (
        -pressure + 2 * modulus * slope,
        modulus * (turned - 1j * k[:, None] * radial),
    )


@checked(frequency=FREQUENCIES, radius=LENGTH, air=Instance((Air,)), wall=Instance((YieldingWall,)))
def yielding_wavenumber(
    frequency: ArrayLike, radius: float, air: Air, wall: YieldingWall, *, lossy: bool = True
) -> Complex:
    """Return the axial wavenumber of the plane mode of a bore with a yielding wall.

    Parameters
    ----------
    frequency : array_like
        In Hz, real, (n,).
    radius : float
        Bore radius in m.
    air : Air
    wall : YieldingWall
    lossy : bool
        With the losses of :func:`acoustube.waves.modes.axial_wavenumber`.

    Returns
    -------
    ndarray
        kz in 1/m, (n,).

    Raises
    ------
    ConfigError
        If a frequency or the radius is not real, positive and finite.
    SimulationError
        If the wavenumber does not converge, as where the wall is hundreds of wavelengths of its
        shear waves thick.

    Notes
    -----
    With the radius a, the wavenumber k0 between rigid walls, the density rho of the air and the
    displacement u per pressure of :func:`wall_compliance`,
    ``kz^2 = k0^2 + 2 rho omega^2 u(kz) / a``: the section yields to the pressure, which is uniform
    over it. Above the wall's resonance, 1.5 kHz in the sleeve paper's tube, the wall's inertia
    raises the phase velocity and lowers the group velocity. The equation is solved by the secant
    method for kz^2, from k0^2 and from the right-hand side at kz = k0.
    """
    f = np.atleast_1d(np.asarray(frequency, float))
    rigid = axial_wavenumber(0, 0, f, radius, air, lossy=lossy)
    factor = 2 * air.density * (2 * pi * f) ** 2 / radius

    def excess(square: Complex) -> Complex:
        yields = wall_compliance(f, _forward(square), radius, wall)
        return np.asarray(square - rigid**2 - factor * yields)

    with np.errstate(all="ignore"):
        before = rigid**2
        off_before = excess(before)
        square = before - off_before
        for _ in range(MOST_STEPS):
            off = excess(square)
            moving = ~(np.abs(off) <= TOLERANCE * np.abs(square))
            if not moving.any():
                return _forward(square)
            change = np.where(off == off_before, 1.0, off - off_before)
            step = np.where(moving, off * (square - before) / change, 0.0)
            before, off_before, square = square, off, square - step
    raise SimulationError(
        f"the plane mode of a bore with a yielding wall was not found at {f[moving][0]:g} Hz; use "
        "another frequency or a thinner wall"
    )


def _forward(square: Complex) -> Complex:
    """Return the square root whose wave decays or propagates towards +z."""
    root = np.sqrt(square)
    return np.where(root.imag > 0, -root, root)
