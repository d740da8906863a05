"""States interpolated between the depths of a press, against presses to these depths."""

import dataclasses

import numpy as np
import pytest
from refusals import refused

from acoustube.base.errors import ConfigError
from acoustube.indentation import DepthPath, Indentation, Indenter, MeshSize, indent
from acoustube.lumen import measure
from acoustube.tube import Tube

SIZE = MeshSize(through_wall=1, around=12, along=10)


def rows_of(press: Indentation, rows: list[int]) -> Indentation:
    results = {name: values[rows] for name, values in press.results.items()}
    return dataclasses.replace(press, **results)


@pytest.fixture(scope="module")
def solved():
    """A press to every quarter of a millimetre, down to 3 mm."""
    depth = 0.25e-3 * np.arange(1, 13)
    press = indent(Tube(), Indenter(diameter=25e-3), depth=depth, support="free", mesh=SIZE)
    return rows_of(press, [0, *press.rows_at(depth)])


@pytest.fixture(scope="module")
def path(solved):
    """The path through every second of its rows."""
    return DepthPath(rows_of(solved, list(range(0, 13, 2))))


def test_path_goes_through_its_rows(path):
    rows = path.indentation
    assert path.displacement(rows.depth) == pytest.approx(rows.displacement, abs=1e-12)
    assert path.press_force(rows.depth) == pytest.approx(rows.press_force, abs=1e-12)
    assert path.error(rows.depth).contact_force == pytest.approx(0)


def test_states_between_rows_are_those_of_presses_to_their_depth(solved, path):
    """Interpolated displacements are within the estimate and 10 um, forces within 0.2 %.

    Measured an eighth to a fifth of the estimate, and 0.06 % of the force; the rows on either side
    are 250 um away.
    """
    between = solved.depth[1::2]
    error = np.abs(path.displacement(between) - solved.displacement[1::2]).max(axis=(1, 2))
    assert np.all(error < path.error(between).displacement)
    assert error.max() < 10e-6
    force = solved.contact_force[1::2]
    assert path.contact_force(between) == pytest.approx(force, rel=2e-3)


def test_estimate_grows_with_the_distance_of_the_rows(solved, path):
    """Rows 1 mm apart have a larger error than rows 0.5 mm apart, and a larger estimate."""
    far = DepthPath(rows_of(solved, [0, 2, 4, 8, 12]))
    place = 2.5e-3
    off = np.abs(far.displacement(place) - solved.displacement[10]).max()
    assert off > np.abs(path.displacement(place) - solved.displacement[10]).max()
    assert off < far.error(place).displacement
    assert far.error(place).displacement > path.error(place).displacement


def test_estimate_beside_a_close_pair_of_rows_is_that_of_one_row(path):
    """A row 5 um before that at 2.5 mm predicts it, but not the states up to the next, at 3 mm."""
    rows = path.indentation.depth
    paired = DepthPath(path.at(np.sort(np.append(rows, rows[-2] - 5e-6))))
    one, two = (found.error(2.75e-3) for found in (path, paired))
    assert two.displacement == pytest.approx(one.displacement, rel=0.1)
    assert two.contact_force == pytest.approx(one.contact_force, rel=0.1)


def test_derivatives_are_slopes_and_have_no_step_at_a_row(path):
    """Central differences over 1 um of a curve with a third derivative under 1e8 N/m3."""
    step, depth = 1e-6, np.array([0.8e-3, 1.7e-3])
    for value in (path.displacement, path.contact_force):
        slope = (value(depth + step) - value(depth - step)) / (2 * step)
        scale = np.abs(slope).max()
        assert value(depth, 1) == pytest.approx(slope, abs=1e-5 * scale)
        row = path.indentation.depth[3]
        before, after = value(row - 1e-9, 1), value(row + 1e-9, 1)
        assert after == pytest.approx(before, abs=1e-5 * scale)


def test_rows_at_any_depth_are_measured_like_solved_ones(solved, path):
    """The section at 1.75 mm is that of a press: height and width to 3 um, the area to 0.1 %."""
    found = path.at([0.9e-3, 1.75e-3])
    assert isinstance(found, Indentation)
    assert list(found.depth) == [0.9e-3, 1.75e-3]
    assert np.all(np.isnan(found.residual))
    here, there = measure(found, 1, np.zeros(1)), measure(solved, 7, np.zeros(1))
    assert here.height == pytest.approx(there.height, abs=3e-6)
    assert here.area == pytest.approx(there.area, rel=1e-3)
    assert found.energy[1] == pytest.approx(solved.energy[7], rel=2e-2)
    assert found.smallest_gap[1] == pytest.approx(solved.smallest_gap[7], abs=20e-6)


def test_gap_near_first_contact_is_between_those_of_the_first_rows(path):
    """The smallest gap falls with depth; before the second row it is larger than that row's."""
    rows = path.indentation
    found = path.at([0.0, 1e-4])
    assert found.smallest_gap[0] == rows.smallest_gap[0]
    assert rows.smallest_gap[0] > found.smallest_gap[1] > rows.smallest_gap[1]
    unknown = dataclasses.replace(rows, smallest_gap=np.append(np.nan, rows.smallest_gap[1:]))
    assert DepthPath(unknown).at([1e-4]).smallest_gap == rows.smallest_gap[1]


def test_depths_beyond_the_rows_and_too_few_rows_are_refused(solved, path):
    for depth in (-1e-6, [1e-3, 3.1e-3], np.nan):
        refused(lambda depth=depth: path.displacement(depth), setting="depth")
    with pytest.raises(ConfigError, match="increasing"):
        path.at([2e-3, 1e-3])
    with pytest.raises(ConfigError, match=r"begins at a depth of 0\.00025 m"):
        DepthPath(rows_of(solved, list(range(1, 13))))
    with pytest.raises(ConfigError, match="has 4 rows"):
        DepthPath(rows_of(solved, [0, 4, 8, 12]))
