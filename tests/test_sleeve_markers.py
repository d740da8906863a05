"""Markers of motion capture: reading, fitting and refusals."""

import numpy as np
import pytest
from children import without
from refusals import refused
from scipy.spatial.transform import Rotation
from scipy.stats import binom

from acoustube.base.errors import ConfigError
from acoustube.sleeve import check_room, fit_arm, read_markers, wound

RADIUS, TAPER, LENGTH = 0.0326, 0.057, 0.25
TILT = Rotation.from_rotvec([0.4, -0.7, 0.3]).as_matrix()
PLACE = np.array([0.4, -0.2, 0.9])


def columns(random=None, *, n=8, noise=0.5e-3, tilted=True):
    """Two opposite columns of markers on a cone, (n, 3) each in m."""
    z = np.linspace(0, LENGTH, n)
    sides = [np.stack([side * (RADIUS + TAPER * z), 0 * z, z], axis=1) for side in (1, -1)]
    if random is not None:
        sides = [points + random.normal(0, noise, points.shape) for points in sides]
    return [points @ TILT.T + PLACE for points in sides] if tilted else sides


def true_line(arm, tilted):
    """Radius of the cone at the height of the fitted z = 0, and its taper."""
    start = (arm.frame.origin - PLACE) @ TILT[:, 2] if tilted else arm.frame.origin[2]
    return np.array([RADIUS + TAPER * start, TAPER])


def test_exact_markers_give_the_cone_and_its_axis():
    arm = fit_arm(*columns())
    assert (arm.lines[0].radius, arm.lines[0].taper) == pytest.approx((RADIUS, TAPER), rel=1e-6)
    assert arm.frame.origin == pytest.approx(PLACE, abs=1e-8)
    assert arm.frame.rotation == pytest.approx(TILT, abs=1e-7)
    assert arm.length == pytest.approx(LENGTH)
    assert np.exp(1j * np.array(arm.angles)) == pytest.approx(np.array([1, -1]), abs=1e-6)


@pytest.mark.parametrize("tilted", [True, False])
def test_intervals_hold_the_cone_in_95_of_100_trials(tilted):
    random, trials = np.random.default_rng(5), 200
    held = np.zeros(2)
    for _ in range(trials):
        arm = fit_arm(*columns(random, tilted=tilted), axis="fitted" if tilted else "z")
        low, high = arm.lines[0].interval().T
        true = true_line(arm, tilted)
        held += (low <= true) & (true <= high)
    # Limits of the binomial distribution of 200 trials at 0.95, at the level of 0.1 %.
    fewest, most = binom.ppf([5e-4, 1 - 5e-4], trials, 0.95)
    assert np.all((fewest <= held) & (held <= most))


def test_interval_in_per_cent_is_refused():
    refused(lambda: fit_arm(*columns()).lines[0].interval(95), setting="confidence", value=95)


def test_outliers_and_gaps_are_left_out_and_named():
    random = np.random.default_rng(2)
    first, second = columns(random, n=9)
    first[[2, 6]] += [0.02, 0.03, -0.01], [-0.05, 0.01, 0.0]
    second[4] = np.nan
    arm = fit_arm(first, second)
    assert np.flatnonzero(~arm.kept[0]).tolist() == [2, 6]
    assert np.flatnonzero(~arm.kept[1]).tolist() == [4]
    assert (arm.lines[0].radius, arm.lines[0].taper) == pytest.approx(
        true_line(arm, True), abs=1e-2
    )
    assert arm.lines[0].radius == pytest.approx(true_line(arm, True)[0], abs=1e-3)


def test_three_noisy_markers_are_a_column():
    """They determine no robust deviation: a line goes through any two of them."""
    random = np.random.default_rng(4)
    for _ in range(20):
        arm = fit_arm(*columns(random, n=3))
        assert np.concatenate(arm.kept).all()
        assert arm.lines[0].radius == pytest.approx(true_line(arm, True)[0], abs=2e-3)
    first, second = columns(random, n=3)
    first[1] += [0.0, 0.03, 0.0]
    with pytest.raises(ConfigError, match="only 2 markers of the first column"):
        fit_arm(first, second)


def test_columns_off_the_axis_have_lines_of_their_own():
    first, second = columns(tilted=False)
    first = first * [1.2, 1, 1]
    arm = fit_arm(first, second, axis="z")
    assert arm.lines[0].radius == pytest.approx(1.2 * RADIUS)
    assert arm.lines[1].radius == pytest.approx(RADIUS)


def test_tubes_start_at_their_columns():
    first, second = columns()
    tubes = wound(fit_arm(first, second), 9)
    for tube, start in zip(tubes, (first[0], second[0]), strict=True):
        assert tube.place(tube.lead) == pytest.approx(start, abs=1e-7)


def test_tubes_of_columns_side_by_side_are_refused():
    """Columns 40 degrees apart on a cylinder: the tubes are a ninth of a loop apart."""
    turned = Rotation.from_rotvec([0, 0, np.radians(40)]).as_matrix()
    first = columns(tilted=False)[0] * [0, 0, 1] + [RADIUS, 0, 0]
    tubes = wound(fit_arm(first, first @ turned.T, axis="z"), 8)
    angle = np.arctan2(LENGTH / 8, 2 * np.pi * RADIUS)
    apart = LENGTH / 8 / 9 * np.cos(angle)
    check_room(tubes, 0.99 * apart)
    with pytest.raises(ConfigError, match=f"would be {1e3 * apart:.1f} mm apart"):
        check_room(tubes, 1.01 * apart)


def swapped():
    first, second = columns(np.random.default_rng(0))
    first[3], second[3] = second[3].copy(), first[3].copy()
    return first, second


def in_other_units():
    first, second = columns()
    return first, 1e3 * second


def partly_in_other_units():
    first, second = columns(tilted=False)
    first[5] *= 1e3
    return first, second


def on_one_line():
    first, _ = columns()
    return first, first + 1e-3 * TILT[:, 2]


def short_by_gaps():
    first, second = columns()
    first[2:] = np.nan
    return first, second


@pytest.mark.parametrize(
    ("points", "axis", "words"),
    [
        (lambda: (columns()[0][:1], columns()[1]), "fitted", ["first column has 1 marker", "3"]),
        (short_by_gaps, "fitted", ["2 markers, and 6 gaps"]),
        (on_one_line, "fitted", ["on one line", "opposite sides"]),
        (swapped, "fitted", ["marker 4", "swapped"]),
        (in_other_units, "fitted", ["one is in m and the other in mm"]),
        (partly_in_other_units, "z", ["m and mm are mixed"]),
        (lambda: tuple(1e3 * p for p in columns()), "fitted", ["mm read as m", "--unit"]),
        (lambda: tuple(1e-3 * p for p in columns()), "fitted", ["m read as mm", "--unit"]),
        (lambda: tuple(p[:, [2, 1, 0]] for p in columns(tilted=False)), "z", ["along z"]),
        (lambda: (columns()[0], columns()[1] @ TILT @ [[1, 0, 0], [0, 0, 1], [0, 1, 0]]),
         "fitted", ["degrees to each other"]),
        (lambda: tuple(0 * p for p in columns()), "fitted", ["0 m long"]),
        (lambda: (columns()[0][:, :2], columns()[1]), "fitted", ["shape (8, 2)"]),
        (columns, "y", ["axis = 'y'"]),
        (lambda: tuple(10 * p * [0.1, 0.1, 1] for p in columns(tilted=False)), "fitted",
         ["m along the axis", "0.03 to 1.5 m fit an arm"]),
    ],
)  # fmt: skip
def test_markers_that_do_not_define_an_arm_are_refused(points, axis, words):
    with pytest.raises(ConfigError) as refusal:
        fit_arm(*points(), axis=axis)
    for word in words:
        assert word in str(refusal.value)


def table(path, rows, header="column,marker,x_mm,y_mm,z_mm"):
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


def test_tables_state_units_frames_and_gaps(tmp_path):
    rows = ["A,A1,1,2,3", "A,A1,3,2,3", "A,A1,2,2,99", "A,A2,,,", "B,B1,4,5,6", "B,B2,7,8,9"]
    markers = read_markers(table(tmp_path / "m.csv", rows))
    assert markers.first[0] == pytest.approx([2e-3, 2e-3, 3e-3])
    assert np.all(np.isnan(markers.first[1]))
    assert markers.second == pytest.approx(1e-3 * np.array([[4, 5, 6], [7, 8, 9]]))
    assert (markers.unit, markers.unit_stated) == ("mm", True)
    bare = table(tmp_path / "b.csv", ["A;1;2;3", "B;4;5;6"], "column;x;y;z")
    assert read_markers(bare).unit_stated is False
    assert read_markers(bare, unit="cm").second == pytest.approx(1e-2 * np.array([[4, 5, 6]]))


@pytest.mark.parametrize(
    ("rows", "header", "words"),
    [
        (["A,1,2,3"], "column,x,y,z", ["named A, and two", "--columns"]),
        (["A,1,2,3", "B,1,2,3", "C,1,2,3"], "column,x,y,z", ["A, B, C"]),
        (["A,1,2"], "column,x,y", ["lacks z in its first row"]),
        (["A,1,two,3"], "column,x,y,z", ["row 2", "'two'"]),
        (["A,1,2"], "column,x,y,z", ["row 2 has 3 cells for 4"]),
        (["A,1,2,3"], "column,x_mm,y_m,z_mm", ["different units"]),
    ],
)
def test_tables_without_two_columns_of_markers_are_refused(tmp_path, rows, header, words):
    with pytest.raises(ConfigError) as refusal:
        read_markers(table(tmp_path / "m.csv", rows, header))
    for word in words:
        assert word in str(refusal.value)


def test_one_column_named_twice_is_refused(tmp_path):
    path = table(tmp_path / "m.csv", ["A,1,2,3", "B,1,2,3"], "column,x,y,z")
    with pytest.raises(ConfigError, match="columns = A, A is one column twice; name two of A, B"):
        read_markers(path, columns=["A", "A"])


def test_c3d_is_read_as_the_table(tmp_path):
    ezc3d = pytest.importorskip("ezc3d")
    first, second = columns()
    file = ezc3d.c3d()
    labels = [f"arm:{name}{i}" for name in "AB" for i in range(1, 9)]
    file["parameters"]["POINT"]["LABELS"]["value"] = labels
    file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    file["parameters"]["POINT"]["RATE"]["value"] = [100]
    points = 1e3 * np.concatenate([first, second]).T[:, :, None] * np.ones(3)
    file["data"]["points"] = np.concatenate([points, np.ones((1, 16, 3))])
    file.write(str(tmp_path / "m.c3d"))
    markers = read_markers(tmp_path / "m.c3d")
    assert markers.names == ("A", "B")
    assert markers.unit_stated
    assert markers.first == pytest.approx(first, abs=1e-6)
    assert markers.second == pytest.approx(second, abs=1e-6)
    file["parameters"]["POINT"]["UNITS"]["value"] = ["meters"]
    file.write(str(tmp_path / "n.c3d"))
    with pytest.raises(ConfigError, match=r"n\.c3d states the unit meters; state its true unit"):
        read_markers(tmp_path / "n.c3d")
    assert read_markers(tmp_path / "n.c3d", unit="mm").first == pytest.approx(first, abs=1e-6)


def test_c3d_without_its_reader_says_what_to_install(tmp_path, monkeypatch):
    without(monkeypatch, "ezc3d", tmp_path)
    path = tmp_path / "m.c3d"
    path.write_bytes(b"")
    with pytest.raises(ConfigError, match=r"pip install 'acoustube\[c3d\]'"):
        read_markers(path)
