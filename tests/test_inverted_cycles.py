"""`acoustube evaluate LIBRARY`: the inversion's errors in the table of the trained estimators."""

import csv
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from commands import run_here
from test_inversion import press, tool

from acoustube.base.errors import ConfigError
from acoustube.inversion import Contact, Estimate, Library
from acoustube.ranging import Rangefinder, record
from acoustube.recordings import write
from acoustube.runs.inversion import RecordingInverter, Sensor, read_sensor
from acoustube.runs.inverted_cycles import alike, inverted
from acoustube.runs.libraries import files
from acoustube.runs.libraries.build import build_library
from acoustube.runs.libraries.plan import tool_plans
from acoustube.runs.sweep.workers import Workers

PRESSES = ((0.53, 3e-3), (0.91, 5e-3))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    where = tmp_path_factory.mktemp("evaluated")
    (plan,) = tool_plans({"depth_mm": ["1:3:0.5"]}, 0.01)
    (where / "lib").mkdir()
    files.write_tool(where / "lib" / plan.name, tool(), plan)
    write(record([], n_cycles=60, tube_seed=7, seed=11), where / "free.nc")
    (where / "cycles").mkdir()
    for i, (place, depth) in enumerate(PRESSES):
        data = record([press(depth, place)], n_cycles=10, tube_seed=7, seed=i)
        labels = {"true_distance": place, "depth": depth, "force": 2e6 * depth**2}
        for name, value in labels.items():
            data[name] = "cycle", np.full(10, value)
        write(data, where / "cycles" / f"p{i}.nc")
    return where


def test_finished_library_is_left_as_it_is_by_a_pool_of_workers(folder):
    """As the studies build their libraries, with the pool of the previous study."""
    plans = tool_plans({"depth_mm": ["1:3:0.5"]}, 0.01)
    before = (folder / "lib" / plans[0].name).read_bytes()
    assert build_library(plans, folder / "lib", workers=Workers(1))
    assert (folder / "lib" / plans[0].name).read_bytes() == before


def test_error_of_the_thermometer_is_what_a_file_or_a_simulated_recording_states(tmp_path):
    """Sensor's file first; 0 if neither states it. A dataset states the mean over its sessions."""
    silent, stated = tmp_path / "silent.toml", tmp_path / "stated.toml"
    silent.write_text("sampling_rate = 250e3")
    stated.write_text("temperature_bias = -0.3")
    simulated = record([], Rangefinder(temperature_bias=0.7))
    recorded = simulated.assign_attrs(source="recording")
    del recorded.attrs["rangefinder"]
    dataset = simulated.assign_coords(session=("cycle", ["1"]))
    for path, data, bias in (
        (stated, simulated, -0.3), (stated, recorded, -0.3), (silent, simulated, 0.7),
        (silent, recorded, 0.0), (silent, None, 0.0), (silent, dataset, 0.7),
    ):  # fmt: skip
        assert read_sensor(path).temperature_bias(data) == bias
    assert Sensor().temperature_bias(simulated) == 0.7
    with pytest.raises(ConfigError, match="rangefinder of a recording"):
        Sensor().temperature_bias(simulated.assign_attrs(rangefinder="damaged"))


def test_untouched_recordings_of_another_rate_are_refused():
    def recorded(rate):
        signal = {"signal": (("cycle", "time"), np.zeros((2, 600), int))}
        return xr.Dataset(
            signal | {"temperature": ("cycle", [20.0, 20.0])}, attrs={"sampling_rate": rate}
        )

    inverter = RecordingInverter(Library((tool(),)), Sensor(), [(Path("free"), recorded(100e3))])
    with pytest.raises(ConfigError, match="free has 100000 samples per second and a 200000"):
        inverter._untouched(Path("a"), recorded(200e3))


def test_cycles_without_a_label_are_one_sentence(folder, tmp_path):
    data = record([], n_cycles=2, tube_seed=7)
    data["depth"] = "cycle", np.full(2, np.nan)
    write(data, tmp_path / "p.nc")
    done = run_here("evaluate", folder / "lib", tmp_path / "p.nc")
    assert done.returncode == 2
    assert "have no label" in done.stderr
    done = run_here("evaluate", tmp_path / "p.nc", tmp_path / "p.nc", "--sensor", "s.toml")
    assert done.returncode == 2
    assert "--sensor needs a library" in done.stderr


@pytest.mark.slow
def test_errors_of_the_inversion_are_written(folder, tmp_path):
    """Two groups of a recording; positions within 0.3 mm, as in tests of the inversion."""
    done = run_here(
        "evaluate", folder / "lib", folder / "cycles", "--untouched", folder / "free.nc",
        "--group", 10, "--out", tmp_path / "t.csv", "--figure", tmp_path / "f.png",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "inversion, library of 25 mm rod; 2 groups of up to 10 cycles, contacts in 2" in (
        " ".join(done.stdout.split())
    )
    with (tmp_path / "t.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    whole = {row["target"]: row for row in rows if row["by"] == "all"}
    assert set(whole) == {"distance", "depth", "force"}
    assert all(row["cycles"] == row["estimated"] == "2" for row in whole.values())
    assert float(whole["distance"]["rmse"]) < 0.03
    assert float(whole["depth"]["rmse"]) < 0.05
    assert float(whole["force"]["median_relative_percent"]) < 5
    by_depth = [row for row in rows if (row["target"], row["by"]) == ("depth", "depth")]
    assert sum(int(row["cycles"]) for row in by_depth) == 2
    assert (tmp_path / "f.png").read_bytes()[1:4] == b"PNG"


def contact(probability, distance, force):
    """Return a contact whose intervals are a hundredth of its values wide."""
    around = {
        name: Estimate(value, 0.01, {0.68: (value, 1.01 * value), 0.9: (value, 1.02 * value)},
                       *np.ones((3, 1)))
        for name, value in (("distance", distance), ("depth", 1e-3), ("force", force))
    }  # fmt: skip
    return Contact(probability=probability, tool=0, **around)


@pytest.mark.parametrize(
    ("contacts", "distance"),
    [
        ([(1.0, 0.3, 1.0), (0.65, 2.3, 8.0)], 0.3),  # false, less probable, of high force
        ([(1.0, 0.3, 1.0), (1.0, 0.9, 2.0)], 0.9),
        ([(0.4, 0.3, 1.0)], np.nan),
        ([], np.nan),
    ],
)
def test_estimate_is_the_most_probable_contact(contacts, distance):
    data = record([], n_cycles=3).assign(true_distance=("cycle", np.full(3, 0.3)))
    found = SimpleNamespace(contacts=[contact(*one) for one in contacts])
    inverter = SimpleNamespace(groups=lambda *_: [(0, found)])
    table, estimates = inverted([(Path("a.nc"), data)], inverter, 3, lambda *_: None)
    assert table["true_distance"].values == pytest.approx([0.3])
    assert estimates["distance"].values == pytest.approx([distance], nan_ok=True)
    assert estimates["distance_half_width"].values == pytest.approx([0.01 * distance], nan_ok=True)


@pytest.mark.parametrize("name", ["press", "tube", "session"])
def test_cycles_of_another_case_specimen_or_session_are_another_group(name):
    """The same press in other air, in another specimen or by another thermometer."""
    data = xr.Dataset({"depth": ("cycle", np.full(7, 2e-3))}, {name: ("cycle", [*"aaabbbb"])})
    parts = [part[name].values.tolist() for part, _ in alike(data, ["depth"], 3)]
    assert parts == [[*"aaa"], [*"bbb"], ["b"]]


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (("lib", "free.nc"), "has no label true_distance or depth or force"),
        (("cycles", "cycles"), "library"),
        (("nothing", "cycles"), "does not exist"),
    ],
)
def test_what_cannot_be_evaluated_is_one_sentence(folder, words, reason):
    done = run_here("evaluate", *(folder / word for word in words))
    assert done.returncode == 2
    assert reason in done.stderr
    assert "Traceback" not in done.stderr
    assert not Path("t.csv").exists()
