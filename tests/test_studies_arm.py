"""Studies on an arm: geometry and counts, against closed forms and synthetic cycles."""

import numpy as np
import pytest
import xarray as xr
from test_inversion import press, tool

from acoustube.air import air_at
from acoustube.base.report import SILENT
from acoustube.inversion import Library
from acoustube.ranging import blockage
from acoustube.reports.studies import arm, human, inverted, mannequin, ranged, swipe
from acoustube.reports.studies.calibration import BAND
from acoustube.reports.studies.report import Tables
from acoustube.runs.by_force import ByForce
from acoustube.sleeve import Contacts, Helix

CONE = Helix(radius=0.045, taper=-0.06, length=0.2, loops=7, lead=0.15)
CYLINDER = Helix(radius=0.04, length=0.2, loops=7, lead=0.15)


def table(true, found, **labels):
    """Processed single cycles with given true and estimated distances."""
    features = np.stack([np.full(len(true), 0.1), found], axis=-1)
    known = {"true_distance": true, "depth": np.full(len(true), 5e-3)} | labels
    return xr.Dataset(
        {"features": (("cycle", "feature"), features)}
        | {name: ("cycle", np.asarray(values)) for name, values in known.items()},
        {"feature": ["amplitude", "distance"]},
    )


def test_sleeve_is_of_the_published_size():
    """9 loops of a tube of 250 cm, to 2 cm; two parallel tubes."""
    tubes = arm.sleeve()
    assert len(tubes) == 2
    for tube in tubes:
        assert tube.loops == 9
        assert tube.tube_length == pytest.approx(2.5, abs=0.02)


def test_gap_of_a_rod_on_a_bend_is_that_of_its_equivalent_on_a_straight_tube():
    """Gaps between circles to second order: the error 1 mm from the middle is 1.4e-3 of the gap."""
    bend, rod, z = 1 / 24.0, 25e-3, 1e-3
    gap = (rod / 2 - np.sqrt(rod**2 / 4 - z**2)) + (bend - np.sqrt(bend**2 - z**2))
    same = arm.rod_on_a_bend(rod, 1 / bend)
    assert same / 2 - np.sqrt(same**2 / 4 - z**2) == pytest.approx(gap, rel=2e-3)
    assert arm.rod_on_a_bend(rod, 0.0) == pytest.approx(rod)


def test_a_loop_along_the_tube_is_a_pitch_over_the_skin():
    loop = CYLINDER.tube_length - 0.15
    here = 0.15 + np.array([1.0, 2.5]) * loop / 7
    found = arm.over_skin(CYLINDER, here, here + loop / 7)
    assert found == pytest.approx(CYLINDER.pitch, rel=1e-6)


@pytest.mark.parametrize("helix", [CONE, CYLINDER])
def test_small_errors_over_the_skin_are_those_along_the_tube(helix):
    """The tube lies on the skin; over 1 mm chord and arc differ by 1e-5."""
    at = np.linspace(0.3, 1.4, 7)
    assert arm.over_skin(helix, at, at + 1e-3) == pytest.approx(1e-3, rel=2e-4)


def test_straight_line_of_the_unrolled_cone_is_the_shortest_way():
    """Against the shortest of curves z(psi) on the cone between positions half a turn apart."""
    from scipy.optimize import minimize

    a, b = CONE.distance(np.array([0.06, 0.06 + CONE.pitch / 2]))
    z0, z1 = CONE.height([a, b])
    turn = CONE.twist * (z1 - z0)

    def length(bulge):
        psi = np.linspace(0, 1, 400)
        z = z0 + (z1 - z0) * psi + sum(
            c * np.sin((i + 1) * np.pi * psi) for i, c in enumerate(bulge)
        )  # fmt: skip
        r = CONE.radius_at(z)
        place = np.stack([r * np.cos(turn * psi), r * np.sin(turn * psi), z])
        return np.linalg.norm(np.diff(place, axis=1), axis=0).sum()

    shortest = minimize(length, np.zeros(4)).fun
    assert float(arm.over_skin(CONE, a, b)) == pytest.approx(shortest, rel=1e-3)


def test_places_off_the_sleeve_have_no_distance_over_the_skin():
    assert np.isnan(arm.over_skin(CONE, [0.1, np.nan], [0.5, 0.5])).all()


def test_cycles_are_averaged_one_by_one_and_not_by_parts():
    """The mean of all 16 cycles, given in parts of 9 and 7, to rounding."""
    cycles = arm_cycles(16)
    mean = human.averaged([cycles.isel(cycle=slice(0, 9)), cycles.isel(cycle=slice(9, None))])
    assert mean["signal"].dims == ("cycle", "time")
    assert mean["signal"].values == pytest.approx(
        cycles["signal"].values.mean(axis=0, keepdims=True), abs=1e-9
    )
    assert mean["force"].values == pytest.approx([3.0])
    assert mean["temperature"].values == pytest.approx([cycles["temperature"].values.mean()])


def arm_cycles(n):
    press = blockage(BAND, 0.5)
    return arm.cycles_of(
        press.scattering, 0.5, [], tube=0, n_cycles=n, name="made", labels={"force": 3.0}
    )


def test_force_levels_are_met_in_their_middle_and_within():
    for level in human.LEVELS:
        forces = human.forces_of(level)
        assert forces.mean() == pytest.approx(np.mean(level))
        assert level[0] < forces.min() < forces.max() < level[1]


def test_located_presses_are_counted_by_level_and_false_positives_apart():
    found = table(
        [0.5, 0.5, 1.0, 1.5, 1.5], [0.52, np.nan, 1.0, 0.7, 1.6],
        level=[2.0, 4.0, 6.0, 6.0, 4.0], number=[0, 0, 1, 1, 0], force=[3.0] * 5,
    )  # fmt: skip
    rows = {row.quantity: row for row in human.distance_rows(Tables(found))}
    counts = [rows[f"located presses, {w} N"].ours for w in ("2-4", "4-6", "6-8")]
    assert counts == [1, 1, 1]
    assert rows["errors over 25 cm (false positives)"].ours == 1
    assert rows["farthest located press"].ours == pytest.approx(150)
    assert rows["distance: median absolute error"].ours == pytest.approx(6.0)


def test_farthest_press_is_located_in_half_of_its_cycles():
    found = table([1.2] * 4 + [1.8] * 4, [1.2, 1.21, 1.2, np.nan, 1.8, np.nan, np.nan, 0.4])
    assert mannequin.farthest(found) == pytest.approx(1.2)


def test_rows_of_the_ground_are_read_at_five_newtons():
    force = np.linspace(0, 8, 9)
    path = ByForce(force, 1e-3 * force, 0.5e-3 * force, *3 * (0 * force,))
    rows = human.ground_rows({"arm": path})
    assert [row.ours for row in rows] == pytest.approx([5.0, 2.5])


def test_tracked_contact_is_compared_with_the_nearest_true_one():
    none = Contacts(np.empty(0, np.int64), np.empty(0), np.empty(0), np.empty(0))
    two = Contacts(np.arange(2), np.array([0.61, 0.78]), np.zeros(2), np.ones(2))
    track = swipe.Track(np.arange(2.0), np.tile([0.6, 0.8], (2, 1)), [], [none, two], np.zeros(2))
    off = swipe.errors_of(track)
    assert np.isnan(off[0]).all()
    assert off[1] == pytest.approx([0.01, 0.02])


@pytest.mark.slow
def test_recordings_of_the_sleeve_are_inverted():
    """A press 3 mm deep on the wrapped tube: position within 1 mm, force within 5 %.

    Its bends are joined by all their modes, while the inversion uses bent modes; the tolerance is
    that of the tests of wrapped tubes, millimetres.
    """
    place, depth = 0.71, 3e-3
    one = press(depth, place, np.arange(33e3, 51e3, 100.0)).scattering
    cycles = arm.cycles_of(
        one, place, arm.bent_around(arm.sleeve()[0], place, one), tube=0, n_cycles=inverted.GROUP,
        name="made", labels={"depth": depth, "force": 2e6 * depth**2},
    )  # fmt: skip
    inverter = arm.sleeve_inverter(Library((tool(),)), 0, one)
    found = inverted.inverted_table([cycles], inverter, SILENT)
    assert ranged.found_distance(found) == pytest.approx([place], abs=1e-3)
    assert found["estimated_force"].values == pytest.approx([18.0], rel=0.05)


@pytest.mark.slow
@pytest.mark.long
def test_swipe_of_a_closed_tube_is_followed_to_a_centimetre():
    """A complete reflection that moves at 5 cm/s: 2.5 mm per cycle."""
    closed = blockage(BAND, 0.5).scattering
    case = xr.Dataset({"force": 7.0})
    track, _ = swipe.swiped({8e-3: (case, closed)}, quick=True)
    off = swipe.errors_of(track)
    assert np.isfinite(off).mean() > 0.85
    assert np.sqrt(np.nanmean(off**2)) < 0.01


def test_air_of_the_studies_is_that_of_the_calibration():
    assert air_at(arm.TEMPERATURE).sound_speed == pytest.approx(343.2, abs=0.1)
