"""Sound in a bore with a yielding wall, against rings, radial finite elements and a rigid wall."""

import numpy as np
import pytest

from acoustube.air import air_at
from acoustube.base.errors import ConfigError, SimulationError
from acoustube.waves.modes import axial_wavenumber
from acoustube.waves.modes.yielding_wall import (
    YieldingWall,
    wall_compliance,
    yielding_wavenumber,
)

RADIUS, AIR = 3.95e-3, air_at(20.0)
WALL = YieldingWall()
FREQUENCY = np.array([1e3, 2e3, 5e3, 10e3, 20e3, 42e3, 60e3])
GAUSS = ((-np.sqrt(0.6), 5 / 9), (0.0, 8 / 9), (np.sqrt(0.6), 5 / 9))


def by_finite_elements(frequency, k, n=60):
    """Displacement of the inner wall per pressure, by quadratic elements with linear pressure.

    Taylor and Hood's pair in the radial direction; the axial displacement is j times an unknown, so
    that for a real wavenumber the form is symmetric.
    """
    modulus = WALL.shear_modulus * (1 + 1j * WALL.loss_factor)
    omega = 2 * np.pi * frequency
    nodes = np.linspace(RADIUS, RADIUS + WALL.thickness, 2 * n + 1)
    m = len(nodes)
    whole = np.zeros((2 * m + n + 1,) * 2, complex)
    for e in range(n):
        at = [2 * e, 2 * e + 1, 2 * e + 2]
        h = nodes[at[2]] - nodes[at[0]]
        dofs = [*at, *(m + i for i in at), 2 * m + e, 2 * m + e + 1]
        for x, weight in GAUSS:
            shape = np.array([x * (x - 1) / 2, 1 - x**2, x * (x + 1) / 2])
            slope = np.array([x - 0.5, -2 * x, x + 0.5]) * 2 / h
            r = shape @ nodes[at]
            zero = np.zeros(3)
            # Strains rr, tt, zz and the shear, of u_r and w with u_z = j w exp(-j k z).
            b = np.array([
                np.r_[slope, zero], np.r_[shape / r, zero], np.r_[zero, k * shape],
                np.r_[-k * shape, slope],
            ])  # fmt: skip
            stiff = b.T @ np.diag([2, 2, 2, 1]) @ b * modulus
            mass = np.zeros((6, 6))
            mass[:3, :3] = mass[3:, 3:] = np.outer(shape, shape) * WALL.density * omega**2
            pressure = np.array([(1 - x) / 2, (1 + x) / 2])
            block = np.zeros((8, 8), complex)
            block[:6, :6] = stiff - mass
            block[:6, 6:] = -np.outer(b[0] + b[1] + b[2], pressure)
            block[6:, :6] = block[:6, 6:].T
            whole[np.ix_(dofs, dofs)] += block * r * weight * h / 2
    right = np.zeros(len(whole), complex)
    right[0] = RADIUS  # the pressure pushes the inner face outwards
    return np.linalg.solve(whole, right)[0]


@pytest.mark.parametrize("frequency", FREQUENCY)
def test_wall_moves_as_finite_elements_do(frequency):
    """From 1 to 60 kHz, with a wave along the tube; 60 elements are accurate to 1e-3."""
    k = 2 * np.pi * frequency / AIR.sound_speed
    exact = wall_compliance(frequency, k, RADIUS, WALL)[0]
    assert abs(by_finite_elements(frequency, k) - exact) < 1e-3 * abs(exact)


def test_long_wave_moves_the_wall_as_a_ring():
    """To 2e-3 for a wavelength a thousand times the width of the bore."""
    k = np.full(3, 2 * np.pi / (2000 * RADIUS))
    frequency = np.array([200.0, 1e3, 5e3])
    a, b = RADIUS, RADIUS + WALL.thickness
    modulus = WALL.shear_modulus * (1 + 1j * WALL.loss_factor)
    stiffness = 2 * modulus * (a**-2 - b**-2)
    inertia = (2 * np.pi * frequency) ** 2 * WALL.density * np.log(b / a)
    ring = 1 / (a * (stiffness - inertia))
    assert wall_compliance(frequency, k, a, WALL) == pytest.approx(ring, rel=2e-3)


def test_speed_rises_by_the_walls_inertia_and_is_the_rigid_walls_in_the_limit():
    """By 0.66 % at 10 kHz, as for a ring, and an order less at 42 kHz; heavy walls do not move."""
    rigid = axial_wavenumber(0, 0, FREQUENCY, RADIUS, AIR)
    soft = yielding_wavenumber(FREQUENCY, RADIUS, AIR, WALL)
    rise = rigid.real / soft.real - 1
    assert rise[FREQUENCY == 10e3][0] == pytest.approx(0.0066, rel=0.1)
    assert 0 < rise[FREQUENCY == 42e3][0] < 0.001
    heavy = YieldingWall(density=1e6, shear_modulus=1e12)
    still = yielding_wavenumber(FREQUENCY, RADIUS, AIR, heavy)
    assert still == pytest.approx(rigid, rel=1e-6)


@pytest.mark.parametrize(
    "wall",
    [
        WALL, YieldingWall(thickness=0.3e-3),
        YieldingWall(thickness=0.5e-3, shear_modulus=2e5, loss_factor=0.02),
    ],
)  # fmt: skip
def test_wavenumber_solves_its_equation_about_the_walls_resonance(wall):
    """The resonances are at 1.5, 1.7 and 1 kHz; far above, two fixed-point steps give the same."""
    f = np.linspace(200, 6e3, 300)
    rigid = axial_wavenumber(0, 0, f, RADIUS, AIR)

    def squared(k):
        yields = wall_compliance(f, k, RADIUS, wall)
        return rigid**2 + 2 * AIR.density * (2 * np.pi * f) ** 2 * yields / RADIUS

    found = yielding_wavenumber(f, RADIUS, AIR, wall)
    assert found**2 == pytest.approx(squared(found), rel=1e-9)
    assert found.real.min() > 0
    assert found.imag.max() < 0
    twice = np.sqrt(squared(np.sqrt(squared(rigid))))
    above = f > 5e3
    assert found[above] == pytest.approx(twice[above], rel=1e-5)


def test_wall_that_is_too_thick_for_the_frequency_is_told():
    """Over 800 wavelengths of shear waves, at which the Bessel functions overflow."""
    thick = YieldingWall(thickness=60e-3, shear_modulus=1e5, loss_factor=0.5)
    with pytest.raises(SimulationError, match="not found at 100000 Hz"):
        yielding_wavenumber([10e3, 100e3], 20e-3, AIR, thick)


def test_complex_frequencies_are_refused():
    """The wall's inertia and modulus are those of a real frequency."""
    with pytest.raises(ConfigError, match="give real numbers"):
        yielding_wavenumber(np.array([20e3 - 100j]), RADIUS, AIR, WALL)
    with pytest.raises(ConfigError, match="give real numbers"):
        wall_compliance(np.array([20e3 - 100j]), np.array([366.0]), RADIUS, WALL)
