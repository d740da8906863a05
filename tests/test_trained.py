"""The commands train and evaluate on files."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from commands import run_here
from labelled_cycles import cycles
from test_package import loaded_by

from acoustube import estimation, recordings
from acoustube.ranging import IDEAL, Burst, Chirp, Rangefinder, Tones

TRAIN = ("train", "a.nc", "--out", "m.model", "--prominence", "0.001")
ECHO = (*TRAIN, "--estimator", "echo", "--folds", "3", "--epochs", "4")


@pytest.fixture(scope="module")
def recorded():
    return cycles(70, seed=2)


@pytest.fixture(autouse=True)
def _files(recorded, tmp_path):
    recordings.write(recorded, tmp_path / "a.nc")


def refused(words, code=2, command=ECHO):
    """Assert that a command ends with one sentence on standard error."""
    result = run_here(*command)
    assert result.returncode == code, result
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("acoustube: ")
    assert words in lines[0]


@pytest.mark.slow
def test_a_model_is_trained_and_its_errors_are_written():
    result = run_here(*ECHO)
    assert result.returncode == 0, result.stderr
    assert (
        "70 cycles, echoes in 70; the estimator echo learns distance, depth, force from 70"
        in result.stdout
    )
    assert "epoch 1 of 4: loss" in result.stdout
    assert "held-out loss" in result.stdout
    result = run_here("evaluate", "m.model", "a.nc", "--out", "t.csv", "--figure", "f.png")
    assert result.returncode == 0, result.stderr
    assert "echo, trained on 70 cycles; 70 cycles, echoes in 70" in result.stdout
    rows = list(csv.DictReader(Path("t.csv").read_text().splitlines()))
    whole = {row["target"]: row for row in rows if row["by"] == "all"}
    assert {name: row["unit"] for name, row in whole.items()} == {
        "distance": "cm", "depth": "mm", "force": "N",
    }  # fmt: skip
    assert 0 < float(whole["depth"]["median"]) < 3
    by_depth = [row for row in rows if (row["target"], row["by"]) == ("force", "depth")]
    assert sum(int(row["cycles"]) for row in by_depth) == 70
    steps = [float(row["to"]) - float(row["from"]) for row in by_depth]
    assert steps == pytest.approx([0.5] * len(steps))
    assert all(float(row["from"]) % 5 == 0 for row in rows if row["by"] == "distance")
    assert Path("f.png").read_bytes().startswith(b"\x89PNG")
    (line,) = [line for line in result.stdout.splitlines() if line.startswith("depth, mm")]
    assert line.split()[2] == f"{float(whole['depth']['median']):.3g}"


def sensor_of(drive):
    """Return the attribute with which a dataset states its rangefinder."""
    return {"rangefinder": Rangefinder(drive=drive).to_json()}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drive", "expected"),
    [
        (Burst(frequency=41e3), (41e3, 13.0, None)),
        (Chirp(frequency=40e3, bandwidth=8e3, duration=1e-3), (40e3, 40.0, 8e3)),
    ],
)
def test_cycles_are_processed_for_the_carrier_that_their_dataset_states(drive, expected, recorded):
    recordings.write(recorded.assign_attrs(sensor_of(drive)), "a.nc")
    result = run_here(*TRAIN, "--estimator", "network", "--folds", "2", "--epochs", "3", "--quiet")
    assert (result.returncode, result.stderr) == (0, "")
    how = estimation.load(Path("m.model")).feature_settings.processing
    assert (how.frequency, how.pulse_cycles, how.bandwidth) == pytest.approx(expected)
    assert how.prominence == 0.001


def test_cycles_of_other_carriers_or_several_tones_are_not_trained_on_together(recorded):
    few = recorded.isel(cycle=slice(2))
    for name, drive in (("a.nc", Burst()), ("b.nc", Chirp(frequency=20e3, bandwidth=4e3))):
        recordings.write(few.assign_attrs(sensor_of(drive)), name)
    words = "b.nc has a drive of 20 +- 2 kHz for 1 ms, and the recordings are processed for one of"
    refused(words, command=("train", "a.nc", "b.nc", *ECHO[2:]))
    recordings.write(few.assign_attrs(sensor_of(Tones(frequencies=(40e3, 42e3)))), "a.nc")
    refused("a.nc: the compressed pulse of kind = 'Tones' has no single maximum")
    recordings.write(few.assign_attrs(rangefinder='{"drive": {"kind": ["Burst"]}}'), "a.nc")
    refused("a.nc: its drive is damaged")
    recordings.write(few.assign_attrs(rangefinder=IDEAL.to_json()), "a.nc")
    refused("2 of 2 cycles have an echo")


@pytest.mark.slow
@pytest.mark.parametrize("estimator", ["network", "boosting"])
def test_other_estimators_train_from_the_command_line_too(estimator):
    result = run_here(*TRAIN, "--estimator", estimator, "--folds", "2", "--epochs", "3", "--quiet")
    assert (result.returncode, result.stdout, result.stderr) == (0, "", "")
    result = run_here("evaluate", "m.model", "a.nc")
    assert result.returncode == 0, result.stderr
    assert ("depth" in result.stdout) == (estimator == "boosting")


@pytest.mark.slow
def test_unsuitable_labels_are_refused_in_one_sentence(recorded):
    bare = recorded.drop_vars(["force", "depth", "true_distance"])
    recordings.write(bare, "a.nc")
    refused("no label true_distance or depth or force")
    recordings.write(recorded.assign(force=0 * recorded["force"] + 2), "a.nc")
    refused("force is 2 N in all cycles")
    recordings.write(recorded.assign(force=recorded["force"] * np.nan), "a.nc")
    refused("no label force", command=(*TRAIN, "--estimator", "network"))
    recordings.write(recorded.isel(cycle=slice(12)), "a.nc")
    refused("12 of 12 cycles have an echo")
    recordings.write(recorded.drop_vars("tube"), "a.nc")
    refused("no label tube", command=(*ECHO, "--by", "tube"))
    assert not Path("m.model").exists()


def test_wrong_words_are_refused_before_anything_is_read():
    refused("missing.nc does not exist", command=(*ECHO[:1], "missing.nc", *ECHO[2:]))
    refused("needs a file or a folder", command=(*ECHO[:1], *ECHO[2:]))
    refused("epochs = 2.5 is not a whole number", command=(*ECHO[:-1], "2.5"))
    refused("folds", command=(*TRAIN, "--estimator", "echo", "--folds", "1"))
    refused("m.model does not exist", command=("evaluate", "m.model", "a.nc"))
    Path("m.model").write_text("taken")
    refused("m.model exists and nothing is overwritten")
    refused("m.model is not a model", command=("evaluate", "m.model", "a.nc"))
    refused("must end in", command=("evaluate", "m.model", "a.nc", "--figure", "f.txt"))


@pytest.mark.slow
def test_a_model_of_another_version_and_cycles_without_labels_are_refused(recorded):
    assert run_here(*ECHO, "--quiet").returncode == 0
    recordings.write(recorded.drop_vars(["force", "depth", "true_distance"]), "b.nc")
    refused("no label true_distance or depth or force", command=("evaluate", "m.model", "b.nc"))
    with np.load("m.model") as archive:
        arrays = {name: archive[name] for name in archive.files}
    header = json.loads(str(arrays["header"])) | {"format": 0, "acoustube_version": "0.0.1"}
    with Path("old.model").open("wb") as file:
        np.savez(file, **(arrays | {"header": np.array(json.dumps(header))}))
    refused("written by acoustube 0.0.1 in format 0", command=("evaluate", "old.model", "a.nc"))


@pytest.mark.slow
def test_files_without_a_session_are_one_each(recorded):
    for name, part in (("a.nc", slice(35)), ("b.nc", slice(35, 70))):
        recordings.write(recorded.drop_vars("session").isel(cycle=part), name)
    result = run_here("train", "a.nc", "b.nc", *ECHO[2:], "--by", "session")
    assert result.returncode == 2
    assert "3 folds cannot be made of 2 groups" in result.stderr
    result = run_here("train", "a.nc", "b.nc", *TRAIN[2:], "--estimator", "echo", "--by", "session",
                  "--folds", "2", "--epochs", "2")  # fmt: skip
    assert result.returncode == 0, result.stderr


def test_help_loads_no_solver():
    loaded = loaded_by("import acoustube.cli._app")
    assert not {"jax", "sklearn", "optax", "numba", "xarray"} & set(loaded)
