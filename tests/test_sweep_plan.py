"""The plan of a sweep, its cases, and the presses and matrices that they share."""

import dataclasses
import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from acoustube.air import sound_speed
from acoustube.base.errors import ConfigError
from acoustube.cli import main
from acoustube.runs.config import Config
from acoustube.runs.sound import band_of
from acoustube.runs.sweep.graph import Case, load_paths, only_cases, shard
from acoustube.runs.sweep.plan import Plan, case_name, load_plan, to_toml
from acoustube.runs.sweep.plan_text import Interval, parsed
from acoustube.runs.sweep.run import run_sweep

PAPER = {"indenter_mm": ["10", "25", "35"], "depth_mm": ["0.5:8:0.5"]}


def cases_of(over, **given):
    return [Case(case_name(c), c) for c in load_plan(None, over, **given).configs()]


@pytest.mark.parametrize(
    ("words", "values"),
    [
        (["10", "25.5"], (10, 25.5)),
        (["0:8:2"], (0.0, 2.0, 4.0, 6.0, 8.0)),
        (["0.1:0.7:0.2"], (0.1, 0.3, 0.5, 0.7)),  # exact in decimals, ends included
        (["1:2:0.4"], (1.0, 1.4, 1.8)),
        (["1", "3:4:1"], (1, 3.0, 4.0)),
        (["rod", "sphere"], ("rod", "sphere")),
        (["1:8"], Interval(1.0, 8.0)),
    ],
)
def test_values_are_read_as_written(words, values):
    assert parsed("depth_mm", words) == values


@given(st.integers(0, 500), st.integers(1, 400), st.integers(1, 40))
@settings(deadline=None)
def test_ranges_have_both_ends_and_no_rounding(first, count, step):
    word = f"{first / 100:.2f}:{(first + count * step) / 100:.2f}:{step / 100:.2f}"
    values = parsed("x", [word])
    assert values == tuple((first + i * step) / 100 for i in range(count + 1))


def test_grid_is_the_product_with_the_last_fastest():
    configs = list(load_plan(None, PAPER).configs())
    found = [(c.indentation.indenter_mm, c.indentation.depth_mm) for c in configs]
    depths = [0.5 * i for i in range(1, 17)]
    assert found == [(d, depth) for d in (10.0, 25.0, 35.0) for depth in depths]
    assert {(c.waves.method, c.waves.losses, c.waves.resolution) for c in configs} == {
        ("scattering", "on", 16)
    }


def test_one_value_is_shared_and_wins_over_the_file(tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text(
        "[waves]\nresolution = 20\n[sweep.over]\ndepth_mm = '1:3:1'\nwall_mm = [1, 2]\n"
    )
    plan = load_plan(path, {"wall_mm": ["1.5"], "frequency_khz": ["20", "42"]})
    assert dict(plan.over) == {"depth_mm": (1.0, 2.0, 3.0), "frequency_khz": (20, 42)}
    configs = list(plan.configs())
    assert len(plan) == len(configs) == 6
    assert {(c.tube.wall_mm, c.waves.resolution) for c in configs} == {(1.5, 20)}


@pytest.mark.parametrize(
    "plan",
    [
        load_plan(None, PAPER),
        load_plan(None, {"depth_mm": ["1:7"], "shape": ["rod", "sphere"]}, count=5, seed=3),
        Plan(given={"tube": {"length_cm": 60.0}}, cases=({"depth_mm": 2}, {"wall_mm": 1.2})),
        load_plan(None, {"depth_mm": ["1:5:0.005"], "shape": ["rod", "sphere"]}),
    ],
    ids=["grid", "random", "list", "long"],
)
def test_plan_survives_its_file(plan, tmp_path):
    path = tmp_path / "sweep.toml"
    path.write_text(to_toml(plan))
    again = load_plan(path)
    assert list(again.configs()) == list(dataclasses.replace(plan, given=again.given).configs())
    assert to_toml(again) == to_toml(load_plan(path))


@pytest.mark.parametrize("sampler", ["sobol", "latin"])
def test_random_plan_fills_its_ranges_and_depends_on_its_seed_alone(sampler):
    over = {"depth_mm": ["1:7"], "temperature_c": ["10:30"], "indenter_mm": ["10", "25"]}
    plan = load_plan(None, over, count=64, sampler=sampler, seed=1)
    columns = plan.columns()
    for name, (low, high) in {"depth_mm": (1, 7), "temperature_c": (10, 30)}.items():
        # Both samplers put as many points into each half, and so into each quarter.
        counts, _ = np.histogram(columns[name], bins=4, range=(low, high))
        assert list(counts) == [16] * 4
    assert sorted(columns["indenter_mm"]) == [10] * 32 + [25] * 32
    assert list(plan.configs()) == list(
        load_plan(None, over, count=64, sampler=sampler, seed=1).configs()
    )
    other = load_plan(None, over, count=64, sampler=sampler, seed=2).columns()
    assert not np.array_equal(columns["depth_mm"], other["depth_mm"])


@pytest.mark.parametrize("share", [(4, 3), (1, 2, 3)])
def test_shares_that_no_plan_has_are_refused(share):
    with pytest.raises(ConfigError, match=r"share = .* is not a part of a plan"):
        run_sweep(load_plan(None, PAPER), "study", share=share)
    assert not Path("study").exists()


@pytest.mark.parametrize("sampler", ["sobol", "latin"])
def test_whole_numbers_of_a_range_are_equally_frequent(sampler):
    over = {"cycles": ["8.5:12.5"], "resolution": ["20:23"]}
    columns = load_plan(None, over, count=64, sampler=sampler, seed=1).columns()
    for name, values in {"cycles": range(9, 13), "resolution": range(20, 24)}.items():
        assert sorted(columns[name]) == [value for value in values for _ in range(16)]
    with pytest.raises(ConfigError, match=r"cycles = 8.2:8.7 holds no whole number"):
        load_plan(None, {"cycles": ["8.2:8.7"]}, count=4)


def test_case_is_named_by_the_hash_of_its_settings():
    config = Config()
    text = json.dumps(dataclasses.asdict(config), sort_keys=True)
    assert case_name(config) == hashlib.sha256(text.encode()).hexdigest()[:16]
    names = {case.name for case in cases_of(PAPER)}
    assert len(names) == 48


def test_paper_plan_shares_three_load_paths_and_48_scatterings():
    over = PAPER | {
        "position_cm": ["10", "20", "30"], "temperature_c": ["15", "25"],
        "frequency_khz": ["40", "42"],
    }  # fmt: skip
    found = load_paths(cases_of(over))
    assert [len(path.groups) for path in found] == [16, 16, 16]
    assert {len(group.cases) for path in found for group in path.groups} == {12}
    assert [path.settings.indenter.diameter for path in found] == [10e-3, 25e-3, 35e-3]
    assert found[0].depths == tuple(1e-3 * 0.5 * i for i in range(1, 17))


def test_tube_length_needs_no_other_press_and_bore_does():
    assert len(load_paths(cases_of({"length_cm": ["40", "80"]}))) == 1
    assert len(load_paths(cases_of({"inner_diameter_mm": ["6", "7.9"]}))) == 2
    assert len(load_paths(cases_of({"shore_a": ["30", "35"], "depth_mm": ["1", "2"]}))) == 2


def test_band_of_a_scattering_covers_all_its_pulses_in_their_air():
    cases = cases_of({"frequency_khz": ["30", "42"], "temperature_c": ["10", "30"]})
    ((group,),) = (path.groups for path in load_paths(cases))
    for case in cases:
        ratio = sound_speed(group.band.temperature) / sound_speed(case.config.waves.temperature_c)
        low, high = (ratio * edge for edge in band_of(case.settings.pulse))
        assert group.band.low <= low < high <= group.band.high
    assert group.band.high - group.band.low < 50e3


def test_untouched_tubes_and_whole_marches_need_no_scattering():
    untouched, pressed = load_paths(cases_of({"depth_mm": ["0", "2"]}))[0].groups
    assert (untouched.depth, untouched.band) == (0.0, None)
    assert pressed.band is not None
    (marched,) = load_paths(cases_of({"method": ["full"]}))[0].groups
    assert marched.band is None


def test_remaining_work_keeps_all_depths_of_a_load_path():
    found = load_paths(cases_of(PAPER))
    wanted = found[1].groups[4].cases[0].name
    (path,) = only_cases(found, {wanted})
    assert path.depths == found[1].depths
    assert [case.name for group in path.groups for case in group.cases] == [wanted]
    assert only_cases(found, set()) == []


@given(st.integers(1, 70))
@settings(deadline=None, max_examples=25)
def test_shares_are_disjoint_and_complete(count):
    found = load_paths(cases_of(PAPER))
    shares = [shard(found, number, count) for number in range(1, count + 1)]
    assert sum(map(len, shares)) == 48
    assert set().union(*shares) == {case.name for case in cases_of(PAPER)}
    if count == 3:
        assert [len(share) for share in shares] == [16, 16, 16]


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (["--depth", "8:0:1"], ["depth_mm = 8:0:1 has no values"]),
        (["--depth", "0:8:-1"], ["has no values", "step over 0"]),
        (["--depth", "0:8:x"], ["depth_mm = 0:8:x is not a range of numbers"]),
        (["--depth", "0:8:0"], ["has no values"]),
        (["--depth", "0:1e30000000:1"], ["depth_mm = 0:1e30000000:1"]),
        (["--depth", "1e-30000000:8:1"], ["depth_mm = 1e-30000000:8:1"]),
        (["--depth", "1e400:2e400:1e400"], ["depth_mm = 1e400:2e400:1e400"]),
        (["--depth", "0:1e999999999:1"], ["depth_mm = 0:1e999999999:1"]),
        (["--depth", "1:1e400", "--random", "4"], ["depth_mm = 1:1e400"]),
        (["--depth", "0:1e400", "--random", "5"], ["depth_mm = 0:1e400"]),
        (["--depth", "1:8"], ["range without a step", "--random"]),
        (["--depth", "1:2:3:4"], ["write first:last:step"]),
        (["--depth", "0:8:1e-9"], ["larger step"]),
        (["--depth", "2", "2"], ["same value twice"]),
        (["--depth", "2", "12"], ["case 2 (", "depth_mm = 12", "past the floor"]),
        (["--depth", "0.01", "2"], ["case 1 (", "smallest supported depth", "0.05"]),
        (["--depth", "deep"], ["depth_mm = 'deep' is not a number"]),
        (["--shape", "rod", "cone"], ["case 2", "'cone'", "rod", "sphere"]),
        (["--position", "20", "39"], ["case 2", "too near the far end"]),
        (["--vary", "wall=1,2"], ["wall is not a setting", "did you mean wall_mm"]),
        (["--vary", "wall_mm"], ["vary = wall_mm gives no values"]),
        (["--random", "0", "--depth", "1:8"], ["random = 0 is out of range"]),
        (["--random", "8"], ["needs a range"]),
        (["--random", "2.5", "--depth", "1:8"], ["2.5 is not a whole number"]),
        (["--random", "2", "--depth", "8:1"], ["depth_mm = 8:1 must have low < high"]),
        (["--seed", "-1"], ["seed = -1 is out of range"]),
        (["--workers", "0"], ["workers = 0 is out of range"]),
        (["--shard", "3"], ["shard = 3 is not a shard", "3/40"]),
        (["--shard", "5/4"], ["shard = 5/4 is not a shard"]),
        (["--plan", "none.toml"], ["none.toml cannot be read"]),
        ([], ["out is missing"]),
    ],
    ids=" ".join,
)
def test_wrong_plans_are_refused_in_one_sentence(words, parts, capsys, tmp_path):
    out = ["--out", "new"] if words else []
    assert main(["sweep", *words, *out]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert all(part in line for part in parts), line
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("[sweep]\nsteps = 3\n", ["steps is not a setting", "over"]),
        ("[sweep]\nover = 3\n", ["over"]),
        ("[sweep.over]\ndepth_mm = {a = 1}\n", ["depth_mm is a table; give a list"]),
        ("[sweep.over]\ndepth_mm = []\n", ["depth_mm has no values", "no cases"]),
        ("[sweep.over]\ndepht_mm = [1]\n", ["depht_mm is not a setting", "depth_mm"]),
        ("[sweep.over]\ndepth_mm=[1]\n[[sweep.case]]\nwall_mm=1\n", ["give one"]),
        ("[sweep]\ncase = 1\n", ["case"]),
        ("sweep = 1\n", ["sweep"]),
        ("[tubes]\nwall_mm = 1\n", ["[tubes] is not a section"]),
    ],
)
def test_wrong_plan_files_are_refused_in_one_sentence(text, parts, capsys, tmp_path):
    (tmp_path / "plan.toml").write_text(text)
    assert main(["sweep", "--plan", "plan.toml", "--out", "new"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert all(part in line for part in parts), line


def test_large_plans_are_counted_without_being_run(capsys):
    words = ["--indenter", "10", "25", "35", "--depth", "0:8:0.5", "--length", "250"]
    words += ["--position", "20:220:0.1"]
    assert main(["sweep", *words, "--dry-run"]) == 0
    out = capsys.readouterr().out
    assert "102051" in out
    assert "load paths           3," in out
    assert "scattering matrices  48," in out or "scattering matrices  51," in out
    with pytest.raises(ConfigError, match="use at most"):
        load_plan(None, {"position_cm": ["20:220:0.0002"], "depth_mm": ["1:8:0.5"]})
