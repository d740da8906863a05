"""Scattering matrices next to the cut-on of a mode: interpolation there, and evanescent modes."""

from functools import partial

import numpy as np
import pytest

from acoustube.air import air_at
from acoustube.ranging import Rangefinder
from acoustube.ranging.analogue import response
from acoustube.sleeve import between_bends, design, windings
from acoustube.waves import (
    Bent,
    PlacedScatterer,
    axial_wavenumber,
    cut_on_frequency,
    joined_bends,
    spectral,
    transfer,
)
from acoustube.waves.bent_modes import bent_modes
from acoustube.waves.cut_on_steps import lossless
from acoustube.waves.interpolation import interpolate_scattering
from acoustube.waves.modes.grid_modes import change_by_losses
from acoustube.waves.scattering import ModalScattering

AIR, RADIUS, HALF = air_at(20.0), 3.95e-3, 20e-3
CUT_ON = cut_on_frequency(2, 1, RADIUS, AIR.sound_speed)
GIVEN = np.arange(27e3, 57.05e3, 100.0)
NAMES = ("00", "11c", "21c", "11s", "21s")
LOSSES = partial(change_by_losses, RADIUS, AIR)


def pressed(z, t, middles):
    """Wall of a tube flattened from above by 0.7 of its bore at one or more places."""
    depth, slope = np.zeros_like(z * t), np.zeros_like(z * t)
    for middle in middles:
        inside, angle = np.abs(z - middle) < HALF, np.pi * (z - middle) / HALF
        depth = depth + 0.7 * np.where(inside, 0.5 * (1 + np.cos(angle)), 0.0)
        slope = slope - 0.7 * np.where(inside, 0.5 * np.pi / HALF * np.sin(angle), 0.0)
    x, y = RADIUS * np.sin(t), -RADIUS * np.cos(t)
    shape = x * (1 + 0.45 * depth), (y + RADIUS) * (1 - depth) - RADIUS
    return (*shape, 0.45 * x * slope, -(y + RADIUS) * slope)


def solved(middles, frequency):
    """Scattering of the tube pressed at places in m, with reference planes at z = 0."""
    ends = min(middles) - HALF, max(middles) + HALF
    wall = spectral.analytic_wall(
        partial(pressed, middles=middles), ends=ends, radius=RADIUS, symmetric=True
    )
    return spectral.scatter_spectral(wall, AIR, frequency, symmetric_only=True)


@pytest.fixture(scope="module")
def press():
    return solved([0.0], GIVEN)


@pytest.mark.parametrize("length", [0.03, 0.12, 0.4])
def test_bend_is_interpolated_next_to_a_cut_on(length):
    """From frequencies 100 Hz apart, against the same bend computed at others.

    The mode (2,1) is slow and attenuated there. Were its transmission through 12 cm extrapolated
    to the cut-on by a polynomial, it would be 4 in place of 0.02. In 3 cm it is transmitted by 0.5.
    """
    wanted = CUT_ON + np.array([5.0, 20.0, 47.0, 130.0, 217.0, 520.0, 1030.0])
    part = Bent(length=length, curvature=28.0, torsion=3.8)
    found, there = (
        joined_bends(AIR, f, [part], radius=RADIUS, modes=NAMES, highest=6.0)
        for f in (GIVEN, wanted)
    )
    off = np.abs(interpolate_scattering(found, wanted, LOSSES) - there.s)
    assert off[:4].max() < 0.05
    assert off[4:].max() < 5e-3


@pytest.mark.parametrize("length", [0.03, 0.12])
def test_bend_is_interpolated_below_a_cut_on(length):
    """With the evanescent mode, from frequencies 100 Hz apart; continued instead, 0.3 off."""
    wanted = CUT_ON - np.array([520.0, 217.0, 130.0, 47.0, 15.0])
    part = Bent(length=length, curvature=28.0, torsion=3.8)
    found, there = (
        joined_bends(AIR, f, [part], radius=RADIUS, modes=NAMES, highest=6.0)
        for f in (GIVEN, wanted)
    )
    off = np.abs(interpolate_scattering(found, wanted, LOSSES) - there.s - there.evanescent)
    assert off.max() < 5e-3


def test_joint_of_bent_and_straight_tube_reflects_an_evanescent_mode():
    """Reflection of (2,1) and its conversion, against a bend of 20 cm by the multimodal method."""
    f = np.linspace(41.2e3, 42.1e3, 7)
    part = Bent(length=0.2, curvature=25.0)
    joint = bent_modes(AIR, f, part, radius=RADIUS, modes=NAMES, count=3)
    whole = joined_bends(AIR, f, [part], radius=RADIUS, modes=NAMES, highest=8.0)
    expected = (whole.s + whole.evanescent)[:, 0, :, 0]
    found = joint.signs[:, None] * joint.returned * joint.signs
    assert np.abs(expected[-1, 2, 2]) > 0.02
    assert np.abs(found - expected)[:, 2, [0, 2]].max() < 1e-3


def test_press_is_interpolated_next_to_a_cut_on(press):
    """Four times as accurate with the losses of the straight tube as without."""
    wanted = CUT_ON + np.array([5.0, 20.0, 47.0, 130.0, 217.0, 520.0, 1030.0])
    there = solved([0.0], wanted).s
    m = there.shape[2]
    off, rough = (
        np.abs(interpolate_scattering(press, wanted, given)[:, :, :m, :, :m] - there)
        for given in (LOSSES, None)
    )
    assert off.max() < 0.03
    assert off.max() < 0.3 * rough.max()


def test_evanescent_mode_joins_two_presses_just_below_its_cut_on(press):
    """Two presses 4.5 cm apart as a network, against a lumen with both.

    Below the cut-on of (2,1) their scattering matrices have no coefficients of this mode. Its
    evanescent field nevertheless reaches from one press to the other.
    """
    apart, first = 0.045, 0.1
    f = CUT_ON + np.array([-90.0, -60.0, -30.0, -10.0, 10.0, 60.0])
    both = solved([0.0, apart], f).s[:, 0, 0, 0, 0]
    way = np.exp(-2j * axial_wavenumber(0, 0, f, RADIUS, AIR) * first)
    placed = [PlacedScatterer(press, first + z) for z in (0.0, apart)]
    sound = transfer(
        placed, AIR, f, radius=RADIUS, length=0.5, probes=(0.0,), source_reflection=0.0
    )
    # Without the continuation of their matrices below the cut-on it is 3e-3.
    assert np.abs(sound[0] - 1 - both * way).max() < 1e-3


def test_recording_of_a_press_between_bends_has_no_late_part(press):
    """A step of the spectrum at the cut-on would cause one, growing towards the cycle's end."""
    helix = design(0.26, (0.18, 0.266), loops=9)[0]
    bends = windings(helix, AIR, GIVEN, [0.3], reach=0.03, radius=RADIUS, modes=press.modes)
    device = Rangefinder(clutter=0.0, far_reflection=0.0)
    placed = [*bends, between_bends(PlacedScatterer(press, 0.3), 0.03)]
    time, voltage = response(placed, device, radius=RADIUS, length=2.5)
    counts = voltage * 2**device.bits / device.full_scale
    late, loud = (
        np.abs(counts[(time > a) & (time < b)]).max() for a, b in ((15e-3, 1), (1.8e-3, 4e-3))
    )
    # Measured 2e-3 of it; with the step 0.1.
    assert late < 5e-3 * loud


@pytest.mark.parametrize("imaginary", [0.0, -36.0])
def test_interpolated_coefficients_are_continuous_at_a_cut_on(press, imaginary):
    """Also without losses; below, an evanescent mode decays: u is negative imaginary."""
    assert lossless(np.array([0.9]), 1.0).imag[0] == pytest.approx(-np.sqrt(1 - 0.81))
    beside = CUT_ON + np.array([-1e-6, 1e-6]) + 1j * imaginary
    for given in (LOSSES, None):
        below, above = interpolate_scattering(press, beside, given)
        # The square root of u, without losses, is 3e-3 at 1e-6 Hz from the cut-on.
        assert np.abs(above - below).max() < 0.01 * np.abs(above).max()


def test_lossy_matrices_of_two_modes_that_begin_at_0_hz_are_interpolated():
    given = np.linspace(0.0, 30e3, 301)
    cut_on = cut_on_frequency(1, 1, RADIUS, AIR.sound_speed)
    s = np.zeros((len(given), 2, 2, 2, 2), complex)
    s[:, 0, :, 1] = s[:, 1, :, 0] = np.eye(2)
    s[given < cut_on, :, 1] = 0.0
    through = ModalScattering(
        frequency=given, modes=("00", "11c"), s=s, propagates=given[:, None] > [0.0, cut_on],
        cut_ons=np.array([0.0, cut_on]), sound_speed=AIR.sound_speed, extent=(-0.01, 0.01),
    )  # fmt: skip
    found = interpolate_scattering(through, np.array([27.05e3, 28.05e3]), LOSSES)
    assert found[:, 1, 1, 0, 1] == pytest.approx(1.0, abs=1e-3)


def test_parts_of_a_gradual_bend_are_interpolated():
    curvature, torsion = np.linspace(29.0, 23.0, 80), np.linspace(3.8, 2.5, 80)
    parts = [
        Bent(length=0.01, curvature=k, torsion=t) for k, t in zip(curvature, torsion, strict=True)
    ]
    parts.append(Bent(length=0.004, curvature=23.0, torsion=2.5))
    f = np.array([38e3, 41e3, 42.5e3])
    every, some = (
        joined_bends(AIR, f, parts, radius=RADIUS, modes=NAMES, highest=6.0, gradual=gradual)
        for gradual in (False, True)
    )
    assert some.s == pytest.approx(every.s, abs=1e-7)
    assert some.inside.wavenumber == pytest.approx(every.inside.wavenumber, abs=1e-6)
    assert some.inside.length == pytest.approx(every.inside.length, abs=0)
