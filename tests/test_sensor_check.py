"""Parameters of a sensor that its recordings contradict."""

import re

import numpy as np
import pytest
from commands import run_here
from test_inversion import press, tool

from acoustube.inversion import Priors
from acoustube.ranging import Rangefinder, record
from acoustube.recordings import write
from acoustube.runs.libraries import files
from acoustube.runs.libraries.plan import tool_plans
from acoustube.runs.sensor_check import differing


def with_prior(values, deviation, prior):
    """Estimates of a parameter with a normal prior, from measured values."""
    precision, known = deviation**-2.0, prior**-2.0
    whole = precision + known
    return [(value * precision / whole, whole**-0.5) for value in values]


def test_estimates_of_several_groups_are_combined_with_one_prior():
    """As by normal distributions: the mean of all measured values, drawn to zero once."""
    values = 7e-3 + np.array([-1.0, 2.0, 0.5, -0.3]) * 1e-3
    given = [{"bore": one} for one in with_prior(values, 1.5e-3, 0.005)]
    ((name, ratio, deviation),) = differing(given, Priors())
    precision = len(values) / 1.5e-3**2
    assert name == "bore"
    assert deviation == pytest.approx((precision + 4e4) ** -0.5, rel=1e-9)
    assert ratio == pytest.approx(values.mean() * precision / (precision + 4e4), rel=1e-9)
    assert not differing(given[:1], Priors())  # four standard deviations
    assert not differing([*given, {}], Priors(bore=0.0))  # stated as known
    small = [{"bore": one} for one in with_prior(values / 2, 1e-5, 0.005)]
    assert not differing(small, Priors())  # such as errors of the solvers cause
    assert not differing([], Priors())


def test_command_reports_another_resonance(tmp_path):
    """The transducer's is 0.5 % higher than stated; two presses determine it to 0.1 %."""
    (plan,) = tool_plans({"depth_mm": ["1:3:0.5"]}, 0.01)
    (tmp_path / "lib").mkdir()
    files.write_tool(tmp_path / "lib" / plan.name, tool(), plan)
    real, cycles = Rangefinder(resonance=42.21e3), []
    write(record([], real, n_cycles=60, tube_seed=7, seed=11), tmp_path / "free.nc")
    for i, (place, depth) in enumerate([(0.43, 4e-3), (0.61, 5e-3)]):
        cycles.append(tmp_path / f"p{i}.nc")
        write(record([press(depth, place)], real, n_cycles=20, tube_seed=7, seed=i), cycles[-1])
    done = run_here(
        "invert", *cycles, "--library", tmp_path / "lib", "--untouched", tmp_path / "free.nc",
        "--group", 20, "--out", tmp_path / "c.csv",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    told = " ".join((done.stdout + done.stderr).split())
    assert float(re.search(r"resonance = (\d+)", told)[1]) == pytest.approx(42.21e3, rel=1e-3)
    assert "--bore" not in told
