"""Derivatives of the spectral solver's scattering matrix by motions of the wall."""

from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pytest
from test_spectral import AIR, CASES, RADIUS, rings, shape, wall
from test_spectral_losses import pressed_flat

from acoustube.air import air_at
from acoustube.base.errors import ConfigError
from acoustube.waves import spectral
from acoustube.waves.spectral import first_basis, partition, solver
from acoustube.waves.spectral import lossy as lossy_fields

FREQUENCY = np.array([12e3, 30e3, 41e3, 56e3])
LEAD = partition.LEAD
TOLERANCE = 1e-5
"""Tolerance relative to the largest derivative at each frequency; most agree within 1e-6."""
STEP = 1e-3
"""Step of differences of the fourth order: halved or doubled, it changes them by 6e-7 at most where
the bore changes by 0.5 % at 56 kHz, 0.5 kHz below a cut-on, and by 1e-7 elsewhere."""


def scattered(of, *, lossy, frequency=FREQUENCY, **options):
    air = air_at(20.0) if lossy else AIR
    options = {"symmetric_only": True} | options
    return spectral.scatter_spectral(of, air, frequency, lossy=lossy, **options)


def differences(wall_at, step, **options):
    """Return central differences of S of the fourth order, at the initial degree of the derivative.

    With losses S then lacks the corrections by higher degrees: from degree 8 to 10 it changes by
    1e-5. A direction that enters or leaves the span of the lossy fields between the walls would
    change S by 1e-8, and a small derivative by 2e-4 of it.
    """

    def basis(*given, **settings):
        return first_basis.first_basis(*given, **settings | {"moving": True})

    span = lossy_fields.SAMPLE_TOLERANCE * lossy_fields.MOVING_SAMPLES
    with (
        patch.object(solver, "first_basis", basis),
        patch.object(lossy_fields, "SAMPLE_TOLERANCE", span),
    ):
        less, more = (
            [scattered(wall_at(sign * n * step), **options).s for n in (1, 2)] for sign in (-1, 1)
        )
    return (8 * (more[0] - less[0]) - (more[1] - less[1])) / (12 * step)


def assert_alike(found, expected, tolerance):
    """Compare derivatives relative to the largest one at each frequency."""
    size = np.abs(expected).max(axis=(1, 2, 3, 4), keepdims=True)
    np.testing.assert_allclose(found / size, expected / size, atol=tolerance)


@pytest.mark.parametrize("lossy", [False, True])
@pytest.mark.parametrize("case", ["A", "E"])
def test_derivative_by_depth_is_that_of_differences(case, lossy):
    """By the share h by which the lumen is pinched, for all modes symmetric about x = 0."""
    w = CASES[case][1]

    def velocity(z, t):
        f = np.where(np.abs(z) < w, 0.5 * (1 + np.cos(np.pi * z / w)), 0.0)
        x, y = RADIUS * np.sin(t), -RADIUS * np.cos(t)
        if case == "A":
            return 0.45 * x * f, -(y + RADIUS) * f
        return -x * f, -y * f

    found = scattered(wall(case), lossy=lossy, velocity=velocity).derivative
    expected = differences(lambda h: wall(case, deeper=h), STEP, lossy=lossy, tolerance=1e-6)
    assert_alike(found, expected, TOLERANCE)


@pytest.mark.parametrize("lossy", [False, True])
@pytest.mark.parametrize("case", ["A", "E"])
def test_derivative_by_the_bore_is_that_of_differences(monkeypatch, case, lossy):
    """All radii are scaled: the modes of the ends, their cut-ons and wavenumbers change too.

    The differences keep the ports at the same heights: with losses S depends on their positions,
    its difference at 12 kHz by 2e-5.
    """
    w, lines = CASES[case][1], shape(case)

    def wall_at(wider):
        def scaled(z, t):
            return tuple((1 + wider) * part for part in lines(z, t))

        radius = (1 + wider) * RADIUS
        return spectral.analytic_wall(scaled, ends=(-w, w), radius=radius, reversible=True)

    def velocity(z, t):
        x, y, *_ = lines(z, t)
        return x, y

    def ports_at_the_same_heights(wider):
        monkeypatch.setattr(partition, "LEAD", LEAD / (1 + wider))
        return wall_at(wider)

    found = scattered(wall_at(0.0), velocity=velocity, lossy=lossy).derivative
    options = {"lossy": lossy}
    expected = differences(ports_at_the_same_heights, STEP, tolerance=1e-6, **options)
    assert_alike(found, expected, TOLERANCE)


@pytest.mark.parametrize("lossy", [False, True])
def test_derivative_by_the_bore_of_an_ellipse_is_that_of_differences(monkeypatch, lossy):
    """Ends that are not round have numerical modes; those odd in x are included."""
    w, lines = CASES["E"][1], shape("E")
    frequency = np.array([30e3, 41e3])

    def squeezed(z, t):
        x, y, x_z, y_z = lines(z, t)
        return x, 0.8 * y, x_z, 0.8 * y_z

    def wall_at(wider):
        def scaled(z, t):
            return tuple((1 + wider) * part for part in squeezed(z, t))

        radius = (1 + wider) * np.sqrt(0.8) * RADIUS
        round_ends = spectral.analytic_wall(scaled, ends=(-w, w), radius=radius, reversible=True)
        return replace(round_ends, circular=False)

    def ports_at_the_same_heights(wider):
        monkeypatch.setattr(partition, "LEAD", LEAD / (1 + wider))
        return wall_at(wider)

    def velocity(z, t):
        x, y, *_ = squeezed(z, t)
        return x, y

    options = {"lossy": lossy, "frequency": frequency, "symmetric_only": False}
    found = scattered(wall_at(0.0), velocity=velocity, **options)
    assert "11s" in found.modes
    expected = differences(ports_at_the_same_heights, STEP, tolerance=1e-6, **options)
    assert_alike(found.derivative, expected, TOLERANCE)


def test_motion_of_ends_with_two_modes_of_one_cut_on_is_refused():
    """A round bore, stated neither as round nor as symmetric, has (1,1) twice."""
    lines = shape("E")
    known = spectral.analytic_wall(lines, ends=(-CASES["E"][1], CASES["E"][1]), radius=RADIUS)
    unknown = replace(known, circular=False, symmetric=False)

    def velocity(z, t):
        return tuple(lines(z, t)[:2])

    with pytest.raises(ConfigError, match="same frequency"):
        scattered(unknown, lossy=False, frequency=np.array([30e3]), velocity=velocity)


@pytest.mark.parametrize("lossy", [False, True])
def test_derivative_by_the_motion_of_rings_is_that_of_differences(lossy):
    """A lumen as left by a press moves as between two depths; a wall of splines has corners."""
    frequency = np.array([20e3, 42e3, 56e3])
    shallow, deep = rings("E"), rings("E", deeper=0.02)

    def wall_at(share):
        moved = shallow.rings + share * (deep.rings - shallow.rings)
        return spectral.wall_of(SimpleNamespace(**{**vars(shallow), "rings": moved}))

    step = 0.05
    motion = spectral.wall_motion(wall_at(-step), wall_at(step), 2 * step)
    options = {"lossy": lossy, "frequency": frequency}
    found = scattered(wall_at(0.0), velocity=motion, **options).derivative
    assert_alike(found, differences(wall_at, step, tolerance=1e-5, **options), TOLERANCE)


def test_reference_planes_beyond_the_ends_take_part_in_the_derivative_by_the_bore():
    """A straight length d on either side multiplies a mode by exp(-j kz d)."""
    frequency, d, lines = np.array([30e3]), 5e-3, shape("A")

    def velocity(z, t):
        x, y, *_ = lines(z, t)
        return x, y

    options = {"lossy": False, "frequency": frequency, "velocity": velocity}
    here = scattered(wall("A"), **options)
    there = scattered(wall("A"), reference=(-d, d), **options)
    transverse, k = (2 * np.pi * f / AIR.sound_speed for f in (here.cut_ons, frequency))
    kz = np.sqrt(k**2 - transverse**2)
    # From kz^2 = k^2 - kt^2, where kt is inversely proportional to the radius.
    change = -1j * d * transverse**2 / kz
    turn = np.exp(-1j * kz * d)
    expected = np.einsum("a,paqb,b->paqb", turn, here.derivative[0], turn)
    expected += (change[:, None, None] + change) * there.s[0]
    np.testing.assert_allclose(
        there.derivative[0], expected, atol=1e-9 * np.abs(expected).max(), rtol=0
    )


def test_derivative_of_walls_that_seal_is_that_of_differences():
    """By the height of a gap of 16 um, within the transition from sealed to open.

    The tolerance is 1.2 %: beside a seal the error of the field, and so of its derivative, falls
    slowly with the degree. With a fixed seal the derivative would be 30 % off.
    """
    frequency, sealing = np.array([12e3, 20e3, 30e3]), 17e-6

    def wall_at(higher):
        return replace(pressed_flat(8e-6 * (1 + higher)), sealing_gap=sealing)

    motion = spectral.wall_motion(wall_at(-0.5), wall_at(0.5), 1.0)
    options = {"lossy": True, "frequency": frequency}
    found = scattered(wall_at(0.0), velocity=motion, **options).derivative
    assert_alike(found, differences(wall_at, 1e-2, **options), 2e-2)


def test_motion_that_breaks_a_symmetry_of_the_wall_is_refused():
    def sideways(z, t):
        return 1 + 0 * z * t, 0 * z * t

    def at_one_side(z, t):
        f = np.exp(-(((z - 2e-3) / 2e-3) ** 2))
        return f * np.sin(t), -f * np.cos(t)

    def along(z, t):
        return (1 + 1e3 * z) * np.sin(t), -(1 + 1e3 * z) * np.cos(t)

    for velocity, words in ((sideways, "x = 0"), (at_one_side, "its middle")):
        with pytest.raises(ConfigError, match=words):
            scattered(wall("E"), lossy=False, velocity=velocity)
    with pytest.raises(ConfigError, match="the same at both ends"):
        scattered(wall("E", reversible=False), lossy=False, velocity=along)


def test_motion_about_one_place_needs_a_wall_that_counts_as_not_reversible():
    """The derivative is that of differences, although the wall is symmetric about its middle."""
    w, lines = CASES["E"][1], shape("E")

    def bump(z):
        return np.exp(-(((z - 2e-3) / 2e-3) ** 2)) * (np.abs(z) < w) * (1 - (z / w) ** 2) ** 2

    def bump_z(z):
        h = 1e-8
        return (bump(z + h) - bump(z - h)) / (2 * h)

    def wall_at(share):
        def moved(z, t):
            x, y, x_z, y_z = lines(z, t)
            c, s = np.sin(t), -np.cos(t)
            by, along = share * RADIUS * bump(z), share * RADIUS * bump_z(z)
            return x + by * c, y + by * s, x_z + along * c, y_z + along * s

        return spectral.analytic_wall(moved, ends=(-w, w), radius=RADIUS)

    def velocity(z, t):
        return RADIUS * bump(z) * np.sin(t), -RADIUS * bump(z) * np.cos(t)

    found = scattered(wall_at(0.0), lossy=True, velocity=velocity).derivative
    assert_alike(found, differences(wall_at, STEP, lossy=True, tolerance=1e-6), TOLERANCE)
