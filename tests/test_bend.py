"""Scattering by bends, against finite elements, closed forms and conservation laws."""

import csv
from pathlib import Path

import numpy as np
import pytest
from refusals import refused

from acoustube.air import air_at
from acoustube.base.errors import ConfigError
from acoustube.waves import (
    Bent,
    PlacedScatterer,
    axial_wavenumber,
    bend,
    cut_on_frequency,
    joined_bends,
    transfer,
)
from acoustube.waves.interpolation import interpolate_scattering
from acoustube.waves.modes import bessel_zero
from acoustube.waves.modes.grid_modes import wavenumbers

AIR = air_at(20.0)
RADIUS = 3.95e-3
BAND = np.array([8e3, 24e3, 30e3, 40e3, 42e3, 42.5e3, 50e3])
WRAP = {"bend_radius": 0.04, "angle": 2 * np.pi, "torsion": 3.4}


def reference():
    """R and T of the plane mode by frequency and mode, as written by bend_reference.py."""
    with (Path(__file__).parent / "data" / "bend.csv").open() as file:
        return [
            (
                float(row["frequency_hz"]),
                row["mode"],
                float(row["r_real"]) + 1j * float(row["r_imag"]),
                float(row["t_real"]) + 1j * float(row["t_imag"]),
            )
            for row in csv.DictReader(file)
        ]


def test_sharp_bend_of_90_degrees_scatters_as_in_three_dimensional_finite_elements():
    rows = reference()
    frequency = np.unique([row[0] for row in rows])
    c = AIR.sound_speed / 343.2
    found = bend(
        AIR,
        c * frequency,
        radius=RADIUS,
        bend_radius=0.01,
        angle=np.pi / 2,
        lossy=False,
        highest=14,
    )
    for f, mode, r, t in rows:
        i, k = np.searchsorted(frequency, f), found.modes.index(mode)
        assert found.s[i, 0, k, 0, 0] == pytest.approx(r, abs=1e-3)
        assert found.s[i, 1, k, 0, 0] == pytest.approx(t, abs=1e-3)


@pytest.mark.parametrize("torsion", [0.0, 3.4, -40.0])
def test_power_is_conserved_and_both_ways_are_alike(torsion):
    found = bend(AIR, BAND, radius=RADIUS, **WRAP | {"torsion": torsion}, lossy=False)
    n = len(found.modes)
    for s, travels in zip(found.s, found.propagates, strict=True):
        matrix = s.reshape(2 * n, 2 * n)[np.ix_(np.tile(travels, 2), np.tile(travels, 2))]
        assert matrix.conj().T @ matrix == pytest.approx(np.eye(len(matrix)), abs=1e-10)
        assert matrix == pytest.approx(matrix.T, abs=1e-10)
    assert np.all(found.s[~found.propagates.any(axis=1)] == 0)


@pytest.mark.parametrize("lossy", [True, False])
def test_straight_limit_is_the_straight_bore(lossy):
    found = bend(
        AIR, BAND, radius=RADIUS, bend_radius=1e5, angle=0.1 / 1e5, torsion=0.0, lossy=lossy
    )
    waves = wavenumbers(found.modes, BAND, RADIUS, AIR, lossy=lossy)
    path = np.where(found.propagates, np.exp(-1j * waves * 0.1), 0)
    straight = path[:, :, None] * np.eye(len(found.modes))
    assert found.planes == pytest.approx((-0.05, 0.05))
    assert found.s[:, 0, :, 0] == pytest.approx(0 * straight, abs=1e-4)
    assert found.s[:, 1, :, 0] == pytest.approx(straight, abs=1e-4)


def test_coupling_is_proportional_to_a_small_curvature():
    weak, strong = (
        bend(AIR, [42e3], radius=RADIUS, bend_radius=r, angle=0.02 / r, lossy=False).s[
            0, 1, 1, 0, 0
        ]
        for r in (2.0, 0.2)
    )
    assert abs(strong / weak) == pytest.approx(10, rel=0.01)


def test_twisted_straight_bore_turns_its_modes_by_the_torsion():
    turn = 0.6
    found = bend(
        AIR, [42e3], radius=RADIUS, bend_radius=1e6, angle=0.05e-6, torsion=turn / 0.05, lossy=False
    )
    c, s = found.modes.index("11c"), found.modes.index("11s")
    path = np.exp(-0.05j * axial_wavenumber(1, 1, 42e3, RADIUS, AIR, lossy=False))
    # A field that keeps its orientation rotates backwards relative to axes that turn.
    turned = path * np.array([np.cos(turn), -np.sin(turn)])
    assert found.s[0, 1, [c, s], 0, c] == pytest.approx(turned, abs=1e-4)


def test_long_waves_travel_faster_by_the_square_root_of_the_lighter_air():
    """The phase of a long wave in a bend is compared with that of Keefe and Benade's inertance.

    In the limit of low frequency the flow in a bend is a vortex, u = 1 / h, so that its inertance
    is smaller by the mean of 1 / h, which is 2 (1 - sqrt(1 - b^2)) / b^2 with b the bore's radius
    over the bend's. The compliance is that of the straight bore (Keefe and Benade, J. Acoust. Soc.
    Am. 74, 320, 1983). The contribution of the ends cancels in the difference of two bends.
    """
    b, f = 0.4, np.array([20.0])
    k = 2 * np.pi * f[0] / AIR.sound_speed
    phase = [
        np.angle(
            bend(
                AIR, f, radius=RADIUS, bend_radius=RADIUS / b, angle=angle, lossy=False, highest=20
            ).s[0, 1, 0, 0, 0]
        )
        for angle in (4.0, 8.0)
    ]
    # The phase of T of a short piece is the mean of the changes by inertance and by compliance.
    length = 4.0 * RADIUS / b
    lighter = 2 * (1 - np.sqrt(1 - b**2)) / b**2
    gained = (phase[1] - phase[0]) / (k * length) + 1
    assert gained == pytest.approx(0.5 * (1 - 1 / lighter), rel=0.02)


@pytest.mark.parametrize("torsion", [0.0, 12.0])
def test_plane_wave_in_a_gentle_bend_is_nearly_that_of_the_straight_bore(torsion):
    """Within 1 %, also at frequencies at which evanescent modes have wavenumbers of 20 to 100/m."""
    f = np.array([200.0, 1e3, 3e3])
    found = bend(
        AIR, f, radius=RADIUS, bend_radius=0.05, angle=1.0, torsion=torsion, modes=["00"]
    ).inside
    straight = axial_wavenumber(0, 0, f, RADIUS, AIR)
    assert found.wavenumber[0] == pytest.approx(straight, rel=0.01)


def test_scattering_of_a_bend_is_interpolated_from_low_frequencies_on():
    """In the middle between frequencies 100 Hz apart within 1e-3; measured 4e-4."""
    f = np.arange(500.0, 6e3, 100.0)
    words = {"radius": RADIUS, "bend_radius": 0.05, "angle": 1.5, "highest": 6}
    middle = f[:-1] + 50
    found = interpolate_scattering(bend(AIR, f, **words), middle)
    assert np.abs(found - bend(AIR, middle, **words).s).max() < 1e-3


def test_two_halves_of_a_bend_make_the_whole_in_a_cascade():
    """A bend equals its halves in a cascade, at 20 kHz, where only the plane mode propagates.

    A cascade leaves out the evanescent fields of the two ends that meet, which would cancel in the
    whole bend. Each is of the size of the reflection at one end of this bend, 2e-3; the tolerance
    is twice that.
    """
    f = np.arange(18e3, 22e3, 100.0)
    sizes = {"radius": RADIUS, "bend_radius": 0.04, "lossy": False}
    half = bend(AIR, f, angle=np.pi / 2, **sizes)
    whole = bend(AIR, f, angle=np.pi, **sizes)
    step = 0.04 * np.pi / 4
    heard = [
        transfer(
            placed,
            AIR,
            f[5:-5],
            radius=RADIUS,
            length=0.4,
            probes=(0.39,),
            source_reflection=0.0,
            lossy=False,
        )
        for placed in (
            [PlacedScatterer(half, 0.2 - step), PlacedScatterer(half, 0.2 + step * (1 + 1e-12))],
            [PlacedScatterer(whole, 0.2)],
        )
    ]
    assert heard[0] == pytest.approx(heard[1], abs=4e-3)


def test_parts_of_one_curvature_make_one_bend():
    """Parts of equal curvature, joined with all modes, equal the whole to rounding."""
    part = {"curvature": 25.0, "torsion": 3.4, "ovality": 0.05}
    lengths = (0.03, 0.11, 0.06)
    parts = joined_bends(AIR, BAND, [Bent(length=n, **part) for n in lengths], radius=RADIUS)
    whole = joined_bends(AIR, BAND, [Bent(length=sum(lengths), **part)], radius=RADIUS)
    assert parts.s == pytest.approx(whole.s, abs=1e-9)
    assert parts.extent == pytest.approx(whole.extent)


@pytest.mark.parametrize("side", ["c", "s"])
def test_flattened_straight_bore_delays_its_modes_as_their_cut_ons_move(side):
    """The phase of (1,1) over 5 cm follows its shifted cut-on, within 1 % of the change.

    The ovality is 1 %: terms of second order in it are below 1 % of the change.
    """
    f, length, ovality = 42e3, 0.05, 0.01
    found = joined_bends(
        AIR,
        [f],
        [Bent(length=length, curvature=0.0, ovality=ovality)],
        radius=RADIUS,
        lossy=False,
        modes=(f"11{side}", "00"),
    )
    cut_on = cut_on_frequency(1, 1, RADIUS, AIR.sound_speed)
    square = bessel_zero(1, 1) ** 2
    shift = 0.5 * ovality * (square + 1) / (square - 1) * (1 if side == "c" else -1)
    round_one, flat = np.sqrt(f**2 - (cut_on * np.array([1, 1 + shift])) ** 2)
    k = 2 * np.pi / AIR.sound_speed
    turned = np.exp(1j * k * (round_one - flat) * length)
    through = found.s[0, 1, 0, 0, 0] * np.exp(1j * k * round_one * length)
    assert through == pytest.approx(turned, abs=0.01 * abs(turned - 1) + 1e-3)
    assert found.s[0, 1, 1, 0, 1] == pytest.approx(np.exp(-1j * k * f * length), abs=1e-9)


def test_bent_part_of_length_zero_is_refused():
    refused(lambda: Bent(length=0.0, curvature=1.0), setting="length", value=0.0)


def test_more_modes_change_a_wrapped_tube_by_less_than_a_ten_thousandth():
    few, many = (
        bend(AIR, BAND, radius=RADIUS, **WRAP, lossy=False, highest=highest).s
        for highest in (10.0, 14.0)
    )
    assert np.abs(few - many).max() < 1e-3
    assert np.abs(np.abs(few) ** 2 - np.abs(many) ** 2).max() < 2e-4


def test_modes_of_a_press_can_be_asked_for():
    found = bend(AIR, BAND, radius=RADIUS, **WRAP, modes=("00", "11c", "21c"))
    every = bend(AIR, BAND, radius=RADIUS, **WRAP)
    assert found.modes == ("00", "11c", "21c")
    assert found.s[:, 1, 1, 0, 0] == pytest.approx(every.s[:, 1, 1, 0, 0])


@pytest.mark.parametrize(
    ("setting", "given", "value"),
    [
        ("bend_radius", 0.004, 0.004),
        ("angle", 0, 0),
        ("radius", -1, -1),
        ("highest", 4.0, 4.0),
        ("highest", 33.0, 33.0),
        ("modes", ("00", "99c"), "99c"),
        ("modes", (), ()),
    ],
)
def test_bends_that_cannot_be_are_refused(setting, given, value):
    words = {"radius": RADIUS, **WRAP, setting: given}
    error = refused(lambda: bend(AIR, BAND, **words), setting=setting, value=value)
    if setting == "bend_radius":
        assert error.allowed[0] == pytest.approx(4.158e-3, rel=1e-3)


def test_frequencies_that_need_ambiguous_modes_are_refused_with_the_highest_possible():
    """Modes (1,10) and above would have names that are misread."""
    words = {"radius": 25e-3, "bend_radius": 0.2, "angle": 0.5}
    error = refused(lambda: bend(AIR, [60e3], **words), setting="highest")
    assert "use frequencies up to 53316 Hz with highest = 30.5" in error.advice
    with pytest.raises(ConfigError, match="each of modes = 0 is of type int"):
        bend(AIR, BAND, radius=RADIUS, **WRAP, modes=[0])


def test_parts_that_are_too_sharp_are_refused():
    parts = [Bent(length=0.1, curvature=c) for c in (25.0, 300.0)]
    error = refused(
        lambda: joined_bends(AIR, BAND, parts, radius=RADIUS), setting="curvature", value=300.0
    )
    assert error.allowed[1] == pytest.approx(0.95 / RADIUS)


def test_frequencies_that_fall_are_refused():
    with pytest.raises(ConfigError, match="frequency must be positive"):
        bend(AIR, BAND[::-1], radius=RADIUS, **WRAP)
