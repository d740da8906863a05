"""Closed forms of the plane wave's wavenumber in round and in rectangular ducts with losses."""

import numpy as np
from scipy.special import jve

from acoustube.waves import axial_wavenumber


def kirchhoff(frequency, radius, air):
    """Return the wavenumber in 1/m of the plane mode of a round tube by Kirchhoff's equation.

    The linearised equations of Navier, Stokes and Fourier with a velocity and a temperature that
    vanish at the wall: an acoustic and a thermal wave with the wavenumbers q, and a vortical one.
    """
    omega, c2 = 2 * np.pi * frequency, air.sound_speed**2
    nu, gamma = air.viscosity / air.density, air.heat_capacity_ratio
    b = gamma * nu / air.prandtl / (1j * omega)
    stretch = 4 / 3 * 1j * omega * nu
    q = np.roots([b * (c2 / gamma + stretch), c2 + stretch - omega**2 * b, -(omega**2)])
    q = q[np.argsort(np.abs(q))]
    density = (1 + b * q) / (gamma - 1)
    flow = c2 / gamma * (density + 1) / (1j * omega + 4 / 3 * nu * q)

    def residual(kz):
        across = np.sqrt(np.array([*q, -1j * omega / nu]) - kz**2)
        ratio = jve(1, across * radius) / jve(0, across * radius)
        first, second, vortical = across * ratio
        turned = kz**2 * (flow[1] - flow[0]) * vortical / across[2] ** 2
        return flow[0] * first - flow[1] * second - turned

    kz = axial_wavenumber(0, 0, np.array([frequency]), radius, air)[0]
    for _ in range(50):
        step = 1e-7 * kz
        change = residual(kz) * 2 * step / (residual(kz + step) - residual(kz - step))
        kz = kz - change
        if abs(change) < 1e-12 * abs(kz):
            break
    return kz


def classical_absorption(frequency, air):
    """Return the attenuation in Np/m in the bulk that is part of Kirchhoff's equation."""
    diffusivity = air.viscous_diffusivity * (4 / 3 + (air.heat_capacity_ratio - 1) / air.prandtl)
    return (2 * np.pi * frequency) ** 2 * diffusivity / (2 * air.sound_speed**3)


def rectangular(frequency, width, height, air, terms=400):
    """Return the wavenumbers in 1/m of the plane mode of a rectangular duct with losses.

    The pressure is assumed uniform over the cross-section.

    Stinson, M. R. (1991), Journal of the Acoustical Society of America 89, 550-558.
    """
    m = (2 * np.arange(terms) + 1) * np.pi

    def mean(square):
        walls = (m[:, None] / width) ** 2 + (m / height) ** 2
        return (64 / (m[:, None] * m) ** 2 * square / (square + walls)).sum()

    omega, gamma = 2 * np.pi * frequency, air.heat_capacity_ratio
    viscous = 1j * omega * air.density / air.viscosity
    flow, heat = (np.array([mean(s) for s in part]) for part in (viscous, viscous * air.prandtl))
    kz = omega / air.sound_speed * np.sqrt((gamma - (gamma - 1) * heat) / flow)
    return np.where(kz.imag > 0, -kz, kz)
