"""Libraries of scattering over depth: their refinement, their files and their command."""

from types import SimpleNamespace

import numpy as np
import pytest
from commands import run_here

from acoustube.base.errors import ConfigError
from acoustube.base.types import Array
from acoustube.runs import presses
from acoustube.runs.libraries import files
from acoustube.runs.libraries.build import PressRows, joined, parts_of
from acoustube.runs.libraries.plan import tool_plans
from acoustube.runs.libraries.refinement import Refinement, deviation


class Matrix:
    """Scattering with a resonance whose frequency decreases faster and faster with depth."""

    def __init__(self, depth: float) -> None:
        f = np.linspace(0.8, 1.2, 169)[:, None, None, None, None]
        d = 1e3 * depth
        resonance = 1 / (1 + 150j * (f - 1.1 + 8e-4 * d**3))
        self.s = np.ones((1, 2, 1, 2, 1)) * (0.003 * d**2 * (1 + resonance) * np.exp(-5j * f))


def refined(tolerance):
    first = np.arange(1, 7.01, 0.25) * 1e-3
    found = Refinement(tolerance, [float(d) for d in first])
    level = list(first)
    while level:
        for depth in level:
            found.add(float(depth), Matrix(depth))
        level = found.next()
    return found


@pytest.mark.parametrize("tolerance", [0.05, 0.005])
def test_splines_over_refined_depths_meet_the_tolerance(tolerance):
    from scipy.interpolate import CubicSpline

    found = refined(tolerance)
    depths: Array = np.array(found.depths)
    spline = CubicSpline(depths, np.array([found.known[d].s for d in found.depths]))
    between = np.random.default_rng(0).uniform(depths[0], depths[-1], 60)
    errors = np.array([deviation(spline(d), Matrix(d).s) for d in between])
    assert np.median(errors) < 0.3 * tolerance
    # Where the first depths do not resolve a resonance, their estimates say little about it.
    assert errors.max() < 1.5 * tolerance
    assert len(depths) > 1.5 * len(refined(0.2).depths) if tolerance < 0.01 else len(depths) < 100
    told = found.between()[np.searchsorted(depths, between) - 1]
    assert np.mean(errors < 2 * told) > 0.95
    # The estimates exceed the errors by no more than their factor of safety.
    assert np.median(told / errors) < 10


def test_depths_are_finest_where_scattering_varies_fastest():
    depths = np.array(refined(0.005).depths)
    steps = np.diff(depths)
    assert steps[depths[:-1] > 5.5e-3].mean() < 0.5 * steps[depths[:-1] < 2.5e-3].mean()


def test_depth_that_fails_ends_the_tool_there():
    found = Refinement(0.01, [1e-3, 2e-3, 3e-3, 4e-3, 5e-3, 6e-3])
    for depth in found.first:
        if depth < 5.5e-3:
            found.add(depth, Matrix(depth))
        else:
            found.fail(depth, "too narrow")
    assert not found.waiting
    assert max(found.next()) < 5e-3
    assert found.depths[-1] == 5e-3
    assert found.reason == "too narrow"


def test_depth_that_fails_between_others_is_left_out():
    found = Refinement(0.01, [1e-3, 1.5e-3, 2e-3, 2.5e-3, 3e-3, 3.5e-3])
    level = list(found.first)
    while level:
        for depth in level:
            if abs(depth - 2.25e-3) < 1e-6:
                found.fail(depth, "no convergence")
            else:
                found.add(depth, Matrix(depth))
        level = found.next()
    assert found.depths[-1] == 3.5e-3
    assert found.reason == ""
    assert 2.25e-3 not in found.depths


def test_plans_are_all_combinations_but_those_of_depths():
    plans = tool_plans({"indenter_mm": ["10", "25"], "depth_mm": ["1:3:0.5"]}, 0.01)
    assert [plan.settings.indenter.diameter for plan in plans] == [10e-3, 25e-3]
    assert len({plan.name for plan in plans}) == 2
    for plan in plans:
        assert plan.first[0] == pytest.approx(1e-3)
        assert plan.first[-1] == pytest.approx(3e-3)
        # Rows before the first depth, and none farther apart than a sixteenth of the bore.
        assert plan.pressed[0] < 0.6e-3
        assert np.diff(plan.pressed).max() <= 7.9e-3 / 16 + 1e-9


def test_four_depths_whose_middles_fail_are_no_tool():
    """Each of them left out leaves three, too few to estimate the error of interpolation."""
    found = Refinement(0.005, [1e-3, 2e-3, 3e-3, 4e-3])
    for depth in found.first:
        found.add(depth, SimpleNamespace(s=np.full((5, 2, 1, 2, 1), 100 * depth, complex)))
    for depth in found.next():
        found.fail(depth, "it is closed")
    assert not found.next()
    assert not np.isfinite(found.between()).any()


def test_press_ends_where_one_of_its_parts_does():
    def rows(depths, stopped=""):
        depth = np.array([0.0, *depths])
        return PressRows({"depth": depth, "displacement": depth[:, None] * [1.0, 2.0]}, stopped)

    # The deep part has increments of its own on the way.
    parts = [1, 2, 3], [4, 5]
    whole = joined([rows([1, 2, 3]), rows([1.5, 3.01, 4, 5])], parts)
    assert whole.arrays["depth"].tolist() == [0, 1, 2, 3, 4, 5]
    assert whole.arrays["displacement"][:, 1].tolist() == [0, 2, 4, 6, 8, 10]
    assert not whole.stopped
    short = joined([rows([1, 2], "it has stopped"), rows([4, 5])], parts)
    assert (short.arrays["depth"].tolist(), short.stopped) == ([0, 1, 2], "it has stopped")
    short = joined([rows([1, 2, 3]), rows([1.5, 3.01], "it has stopped")], parts)
    assert (short.arrays["depth"].tolist(), short.stopped) == ([0, 1, 2, 3], "it has stopped")


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--indenter", 25, "--depth", 3], "needs 4 or more depths"),
        (["--indenter", 25, "--depth", "1:3:0.5", "--frequency", 40, 42], "of one frequency and"),
        (["--indenter", 25, "--depth", "1:60:1"], "depth_mm"),
        (["--indenter", 25, "--depth", "1:3"], "first:last:step|range without a step"),
        (["--indenter", 25, "--tolerance", 2], "tolerance"),
    ],
)
def test_wrong_plan_is_one_sentence(tmp_path, words, reason):
    import re

    done = run_here("library", *words, "--out", tmp_path / "lib")
    assert done.returncode == 2
    assert re.search(reason, done.stderr)
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "lib").exists()


def test_folder_of_something_else_is_left_alone(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    done = run_here("library", "--depth", "1:3:0.5", "--out", tmp_path)
    assert done.returncode == 2
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


@pytest.mark.slow
def test_library_is_that_of_presses_to_its_depths(tmp_path, monkeypatch):
    """In a narrow tube: forces are those of one press, and a repetition computes nothing."""
    # A folder of its own: a whole press in the cache would not be solved in parts.
    monkeypatch.setenv("ACOUSTUBE_CACHE", str(tmp_path / "cache"))
    settings = tmp_path / "lossless.toml"
    settings.write_text('[waves]\nlosses = "off"\n')
    words = ["library", "--config", settings, "--indenter", 10, "--bore", 4, "--depth",
             "0.4:1:0.2", "--tolerance", 0.1, "--workers", 1, "--out", "lib"]  # fmt: skip
    done = run_here(*words)
    assert done.returncode == 0, done.stderr
    library = files.open_library("lib")
    (tool,) = library.tools
    assert tool.name == "10 mm rod"
    assert np.all(np.diff(tool.force) > 0)
    # The press was solved in two parts: residuals may be 1e-5 of the smallest force.
    (plan,) = tool_plans(
        {"indenter_mm": ["10"], "inner_diameter_mm": ["4"], "depth_mm": ["0.4:1:0.2"]},
        0.1,
        settings,
    )
    assert len(parts_of(plan)) == 2
    whole = presses.press_to(plan.settings, plan.pressed)
    assert parts_of(plan) == [plan.pressed]  # now in the cache
    force = whole.contact_force[whole.rows_at(plan.first)]
    assert tool.force[np.isin(tool.depth, plan.first)] == pytest.approx(force, rel=1e-5)
    again = run_here(*words)
    assert "1 of 1 indenters finished" in again.stdout
    assert library.modes == ("00", "11c")


def test_damaged_or_foreign_library_is_one_sentence(tmp_path):
    with pytest.raises(ConfigError, match="does not exist"):
        files.open_library(tmp_path / "none")
    with pytest.raises(ConfigError, match="holds no file of a library"):
        files.open_library(tmp_path)
    (tmp_path / "tool-1.nc").write_bytes(b"not a file of HDF5")
    with pytest.raises(ConfigError, match="acoustube library"):
        files.open_library(tmp_path)
