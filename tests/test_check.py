"""`acoustube check`: what it reports of an installation, and that it detects what is broken."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from acoustube.base.remnants import Remnant
from acoustube.cli import check as check_command
from acoustube.cli import main
from acoustube.runs import selftest
from acoustube.runs.selftest import Outcome, Trial, all_trials

TRIALS = {trial.name.split()[0]: trial for trial in all_trials()}
QUICK = ("distance", "cut-on")


def fixed(value):
    return Trial("a number", lambda: value, 1.0, 0.1, "m")


def only(monkeypatch, *trials):
    """Run only the given tests of `check`, and leave out all that takes long."""
    monkeypatch.setattr(selftest, "all_trials", lambda: trials)
    monkeypatch.setattr(check_command, "can_draw", lambda: True)


@pytest.mark.slow
def test_this_installation_passes(capsys):
    """All results are within tolerance; 13 s of processor time, most of it compilation."""
    assert main(["check", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["passed"]
    assert len(found["tests"]) == 5
    for row in found["tests"]:
        assert abs(row["computed"] - row["expected"]) <= row["tolerance"]
    assert found["packages"]["numpy"] == np.__version__
    assert found["memory_free_gb"] is None or 0 < found["memory_free_gb"] <= found["memory_gb"]


def test_expected_reflection_is_the_independent_solution():
    table = np.genfromtxt(
        Path(__file__).with_name("data") / "scattering.csv",
        delimiter=",", names=True, dtype=None, skip_header=5,
    )  # fmt: skip
    (row,) = table[(table["case"] == "E") & (table["f_hz"] == selftest.FREQUENCY)]
    assert abs(np.hypot(row["R_re"], row["R_im"]) - selftest.REFLECTED) < 5e-6


@pytest.mark.parametrize("name", QUICK)
def test_quick_tests_pass(name):
    outcome = TRIALS[name].run()
    assert outcome.passed


@pytest.mark.parametrize(
    ("name", "broken"),
    [
        ("distance", ("signals.speed_of_sound", lambda _: 344.6)),  # 1 K too warm
        ("cut-on", ("RADIUS", 3.99e-3)),
        ("cut-on", ("cut_cells", None)),
    ],
)
def test_a_broken_stage_is_noticed(name, broken, monkeypatch):
    monkeypatch.setattr(f"acoustube.runs.selftest.{broken[0]}", broken[1])
    outcome = TRIALS[name].run()
    assert not outcome.passed
    assert ("TypeError" in outcome.problem) == (broken[1] is None)


@pytest.mark.parametrize(("value", "passed"), [(1.05, True), (1.2, False), (np.nan, False)])
def test_a_test_passes_within_its_tolerance(value, passed):
    assert Outcome("a", value, 1.0, 0.1, "m", 0.0).passed is passed


def test_failure_is_reported_in_the_table_and_in_one_sentence(monkeypatch, capsys):
    only(monkeypatch, fixed(1.0), fixed(2.0))
    assert main(["check"]) == 1
    out, err = capsys.readouterr()
    assert "passed  a number: 1 m, expected 1 m within 0.1" in out
    assert "FAILED  a number: 2 m, expected 1 m within 0.1" in out
    assert err.startswith("acoustube: 1 of 2 tests failed (a number)")
    assert err.count("\n") == 1


def test_json_holds_what_could_not_be_computed(monkeypatch, capsys):
    def fails():
        raise ImportError("no [kernel]")

    only(monkeypatch, fixed(1.0), Trial("broken", fails, 1.0, 0.1, "m"), fixed(np.nan))
    assert main(["check", "--json", "--quiet"]) == 1
    text = capsys.readouterr().out
    found = json.loads(text)
    assert not found["passed"]
    assert [row["passed"] for row in found["tests"]] == [True, False, False]
    assert [row["computed"] for row in found["tests"]] == [1.0, None, None]
    assert "NaN" not in text  # which is not JSON
    assert found["tests"][1]["problem"] == "ImportError: no [kernel]"


def test_vtk_that_ends_its_process_does_not_end_ours(monkeypatch, capsys):
    """VTK ends its process where EGL is missing; the check goes on."""
    monkeypatch.setattr(check_command, "DRAWING", "import os; os.abort()")
    monkeypatch.setattr(selftest, "all_trials", lambda: (fixed(1.0),))
    assert main(["check"]) == 0
    assert "drawing: does not work" in capsys.readouterr().out


def test_extras_are_those_of_the_package_and_a_missing_one_states_its_install_command():
    found = check_command.extras(
        ["numpy>=2.0", "no-such-package>=1; extra == 'c3d'", "numpy; extra == 'audio'",
         "pytest; extra == 'test'"],
    )  # fmt: skip
    assert [(extra.name, extra.present) for extra in found] == [("audio", True), ("c3d", False)]
    assert found[1].install == "pip install 'acoustube[c3d]'"
    project = (Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8")
    names = set(tomllib.loads(project)["project"]["optional-dependencies"])
    assert names - set(check_command.FOR_OTHERS) == set(check_command.PURPOSES)


def test_what_killed_commands_have_left_is_told(monkeypatch, capsys):
    only(monkeypatch, fixed(1.0))
    left = [Remnant(Path(f".acoustube-partial-{i}"), 4, Path("register")) for i in range(3)]
    monkeypatch.setattr(check_command, "remnants", lambda: left)
    assert main(["check"]) == 0
    told = ".acoustube-partial-0 and 2 more; acoustube cache clear removes them"
    assert told in capsys.readouterr().out


def test_read_only_cache_is_reported(monkeypatch, capsys, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("ACOUSTUBE_CACHE", str(tmp_path / "file" / "cache"))
    only(monkeypatch, fixed(1.0))
    assert main(["check"]) == 0
    assert "set ACOUSTUBE_CACHE to a writable folder" in capsys.readouterr().out
