"""Datasets of cycles: labels, seeds, the schema of recordings, and completion after interrupts."""

import dataclasses
import json
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pandas as pd
import pytest
import tomlkit
import xarray as xr
from scipy.io import wavfile

import acoustube
from acoustube import recordings, signals
from acoustube.base.errors import ConfigError
from acoustube.base.foreign.documents import read_document
from acoustube.cli import main
from acoustube.ranging import Burst, Rangefinder, digitiser, record
from acoustube.runs.config import Config, configured
from acoustube.runs.config.si import settings_in_si
from acoustube.runs.scattering_file import from_dataset
from acoustube.runs.sweep import store
from acoustube.runs.sweep.case_results import placed
from acoustube.runs.sweep.cycles import Recipe, in_session, record_one, seed_of
from acoustube.runs.sweep.dataset import _check_band, rangefinder_in, run_dataset
from acoustube.runs.sweep.plan import load_plan
from acoustube.runs.sweep.run import run_sweep
from acoustube.runs.twin_sessions import recipe_settings

pytestmark = pytest.mark.slow

OVER = {
    "depth_mm": ["0", "0.6"], "position_cm": ["50", "90"], "length_cm": ["150"],
    "temperature_c": ["15", "25"], "method": ["spectral"], "losses": ["off"],
    "mesh": ["coarse"],
}  # fmt: skip
RECIPE = Recipe(n_cycles=3, n_tubes=2, n_sessions=2, seed=7)


def rangefinder_of_file(path):
    return rangefinder_in(read_document(path), path)


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sweep") / "small"
    assert run_sweep(load_plan(None, OVER), folder, executor=ThreadPoolExecutor(1))
    return folder


@pytest.fixture(scope="module")
def dataset(sweep, tmp_path_factory):
    folder = tmp_path_factory.mktemp("dataset") / "small"
    return run_dataset([sweep], folder, RECIPE, executor=ThreadPoolExecutor(1))


def test_every_case_tube_and_session_has_its_cycles(dataset):
    data = acoustube.open_dataset(dataset)
    assert data["signal"].shape == (8 * 3 * 2 * 2, 4000)
    assert data["signal"].dtype == np.uint16
    # Every combination occurs three times; two specimens of one tube, each in two sessions.
    table = data[["press", "tube", "session"]].to_dataframe().reset_index()
    assert set(table.groupby(["press", "tube", "session"]).size()) == {3}
    assert table["press"].nunique() == 8
    assert table["tube"].nunique() == 2
    assert table["session"].nunique() == 4
    assert list(data["cycle"].values) == list(range(96))


def test_labels_are_those_of_the_sweep(sweep, dataset):
    cases = acoustube.open_dataset(sweep).load()
    data = acoustube.open_dataset(dataset)
    for name in ("depth", "force", "lumen_area", "shape", "inner_diameter", "shear_modulus"):
        expected = cases[name].sel(press=data["press"].values).values
        np.testing.assert_array_equal(data[name].values, expected)
        assert data[name].attrs["units"] == cases[name].attrs["units"]
    pressed = data["depth"].values > 0
    distance = cases["true_distance"].sel(press=data["press"].values).values
    np.testing.assert_array_equal(data["true_distance"].values[pressed], distance[pressed])
    assert np.isnan(data["true_distance"].values[~pressed]).all()
    assert set(data["air_temperature"].values) == {15.0, 25.0}
    # The board's reading has an offset of up to half a kelvin, and 0.1 K of noise between cycles.
    error = data["temperature"].values - data["air_temperature"].values
    of_session = pd.Series(error).groupby(data["session"].values)
    assert (of_session.mean().abs() < 0.6).all()
    assert of_session.mean().std() > 0.1
    assert (of_session.std().between(0.05, 0.15)).all()


def test_cycles_are_those_of_the_rangefinder(sweep, dataset):
    """The counts equal those of `ranging.record` for the scattering of the case."""
    cycles = acoustube.open_dataset(dataset).load()
    chosen = (cycles["depth"].values > 0) & (cycles["air_temperature"].values == 25)
    first = cycles.isel(cycle=int(np.argmax(chosen)))
    name, tube = str(first["press"].values), str(first["tube"].values)
    path = store.contents(sweep).finished[name]
    data, matrix = store.read(path)
    config = configured(json.loads(str(data["configuration"].sel(press=name).values)))
    session = int(str(first["session"].values)[-1])
    expected = record(
        placed(settings_in_si(config), from_dataset(matrix)), Rangefinder(), length=1.5,
        temperature=25.0, n_cycles=1, first_cycle=seed_of(name) % 72_000,
        seed=seed_of(name, tube, session, 7),
        session_seed=seed_of(tube, session, 7), tube_seed=seed_of(tube, 7),
    )  # fmt: skip
    np.testing.assert_array_equal(first["signal"].values, expected["signal"].values[0])


def test_specimens_sessions_and_cycles_differ(dataset):
    data = acoustube.open_dataset(dataset).load()
    one = data.isel(cycle=data["press"].values == data["press"].values[0])
    counts = one["signal"].values.astype(int)
    assert len(np.unique(counts, axis=0)) == len(counts)
    means = {
        tube: counts[one["tube"].values == tube].mean(axis=0) for tube in np.unique(one["tube"])
    }
    first, second = means.values()
    # Between 2 and 5 ms, behind the ring-down: noise of 0.2 counts and its rounding, 0.37 together,
    # make 0.21 in the difference of two means of 6 cycles.
    assert (first - second)[400:1000].std() > 0.35


def test_cycles_of_a_session_share_its_drift(dataset):
    """All cases of a session have one slow drift of 11 counts rms over an hour."""
    data = acoustube.open_dataset(dataset).load()
    offset = data["signal"].isel(time=slice(3800, None)).mean("time").values
    name = data["session"].values[0]
    counts = Recipe().rangefinder_for(settings_in_si(Config()))
    first = data["press"].values[data["session"].values == name]
    cycles = np.array([seed_of(str(press)) % 72_000 for press in first])
    drift = digitiser._drift(counts, cycles, seed_of(name[:-2], int(name[-1]), 7))
    expected = (counts.offset + drift) * 4096 / 1.8
    # Three cycles of a case are within 0.2 s; the rest of the sound is under a count.
    assert np.abs(offset[data["session"].values == name] - expected).max() < 1.5
    assert np.abs(offset[data["session"].values != name][: len(first)] - expected).max() > 3


def test_dataset_does_not_depend_on_workers_or_files(sweep, dataset, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["--cycles", "3", "--tubes", "2", "--sessions", "2", "--seed", "7", "--quiet"]
    assert main(["dataset", str(sweep), *words, "--workers", "2", "--out", "two"]) == 0
    # The same cases, computed one share after the other, are in other files.
    for share in ("2/4", "1/4", "4/4", "3/4"):
        number, count = map(int, share.split("/"))
        run_sweep(
            load_plan(None, OVER), "shares", executor=ThreadPoolExecutor(1),
            share=(number, count),
        )  # fmt: skip
    run_dataset(["shares"], "shared", RECIPE, executor=ThreadPoolExecutor(1))
    expected = acoustube.open_dataset(dataset).load()
    for other in ("two", "shared"):
        xr.testing.assert_identical(acoustube.open_dataset(other).load(), expected)


def test_other_seeds_make_other_noise(sweep, dataset, tmp_path):
    other = run_dataset(
        [sweep],
        tmp_path / "other",
        Recipe(n_cycles=3, n_tubes=2, n_sessions=2),
        executor=ThreadPoolExecutor(1),
    )
    a, b = (acoustube.open_dataset(folder)["signal"].values for folder in (dataset, other))
    assert (a != b).any(axis=1).all()


def test_dataset_is_read_and_processed_as_a_recording(dataset):
    ((_, data),) = recordings.read_all([dataset])
    assert data.attrs["sampling_rate"] == 200e3
    found = signals.locate(
        data["time"].values, data["signal"].values, signals.Processing(),
        temperature=data["temperature"].values,
    )  # fmt: skip
    assert found.distance.shape == (96,)
    assert main(["process", str(dataset), "--out", "table.csv", "--quiet"]) == 0
    assert len(pd.read_csv("table.csv")) == 96


def test_dataset_is_opened_lazily_in_chunks(dataset):
    data = acoustube.open_dataset([dataset])
    assert data["signal"].chunks is not None
    assert data["signal"].chunks[0][0] == 64
    both = acoustube.open_dataset(str(dataset.parent / "*"))
    assert both.sizes == data.sizes


def test_interrupted_dataset_goes_on_and_a_damaged_file_is_mended(
    sweep, dataset, tmp_path, monkeypatch
):
    monkeypatch.setattr("acoustube.runs.sweep.dataset.CYCLES_PER_FILE", 24)  # two cases a file
    folder = run_dataset([sweep], tmp_path / "parts", RECIPE, executor=ThreadPoolExecutor(1))
    files = sorted(folder.glob("cycles-*.nc"))
    assert len(files) == 4
    files[1].unlink()
    files[2].write_bytes(files[2].read_bytes()[:3000])
    before = files[0].stat().st_mtime_ns
    run_dataset([sweep], folder, RECIPE, executor=ThreadPoolExecutor(1))
    assert files[0].stat().st_mtime_ns == before
    xr.testing.assert_identical(
        acoustube.open_dataset(folder).load(), acoustube.open_dataset(dataset).load()
    )


def test_dataset_of_several_sessions_states_its_rangefinder(dataset):
    """The errors of the thermometer, which differ between sessions, are 0 in the mean."""
    stated = json.loads(acoustube.open_dataset(dataset).attrs["rangefinder"])
    expected = dataclasses.replace(Rangefinder(), temperature_bias=0.0)
    assert stated == json.loads(expected.to_json())


def test_cycles_recorded_before_the_drive_begin_before_time_zero(sweep):
    """As those of real recorders: time zero is the drive, or before it by a twin's trigger."""
    name, path = next(iter(store.contents(sweep).finished.items()))
    still = Rangefinder(noise=0.0, drift=0.0)
    early = dataclasses.replace(still, lead=1e-3)
    plain = record_one(name, path, Recipe(rangefinder=still))
    found = record_one(name, path, Recipe(rangefinder=early, trigger=2e-5))
    assert plain["time"].values[0] == 0
    assert found["time"].values[0] == pytest.approx(-0.98e-3)
    shift = np.abs(found["signal"].values[:, 200:] - plain["signal"].values[:, :-200].astype(int))
    assert shift.max() <= 1


def test_card_states_the_contents(dataset):
    text = (dataset / "README.md").read_text()
    assert "96 simulated cycles of 4000 samples at 200 kHz" in text
    assert "* cycles without contact: 48" in text
    assert "| depth | 0 | 0.6 | mm |" in text
    assert "| place | 50 | 90 | cm |" in text
    assert "the seed is 7" in text
    assert "`clutter` (1.5e-05 1/m)" in text


def test_export_writes_sound_files_with_their_labels(dataset, capsys):
    assert main(["export", str(dataset), "--out", "sounds"]) == 0
    assert "96 cycles in 32 files written to" in " ".join(capsys.readouterr().out.split())
    table = pd.read_parquet("sounds/labels.parquet")
    data = acoustube.open_dataset(dataset).load()
    for i in (0, 17, 95):
        row = table.iloc[i]
        rate, samples = wavfile.read(f"sounds/{row['file']}")
        assert rate == 200_000
        part = samples[row["start"] : row["start"] + row["length"]].astype(int) + 2048
        np.testing.assert_array_equal(part, data["signal"].values[i])
        assert row["force"] == data["force"].values[i]
        assert row["tube"] == data["tube"].values[i]


def test_show_draws_a_sweep(sweep, capsys):
    assert main(["show", str(sweep), "--out", "sweep.png"]) == 0
    assert "8 cases drawn" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (["dataset", "--out", "new"], ["needs the folder of a sweep"]),
        (["dataset", "none", "--out", "new"], ["none does not exist"]),
        (["dataset", "SWEEP", "--cycles", "0", "--out", "new"], ["cycles = 0 is out of range"]),
        (["dataset", "SWEEP", "--seed", "-1", "--out", "new"], ["seed = -1"]),
        (["dataset", "SWEEP", "--cycles", "9", "--out", "DATASET"], ["cycles of another sweep"]),
        (["dataset", "SWEEP", "--out", "SWEEP"], ["is not empty"]),
        (["dataset", "SWEEP", "--rangefinder", "none.toml", "--out", "new"], ["none.toml"]),
        (["show", "DATASET", "--out", "a.png"], ["is a dataset of cycles"]),
        (["show", "SWEEP", "--out", "a.txt"], ["must end in one of"]),
        (["show", ".", "--out", "a.png"], ["holds no results"]),
        (
            ["export", "SWEEP", "--format", "wav", "--out", "new"],
            ["which is a sweep", "acoustube dataset"],
        ),
    ],
    ids=lambda value: " ".join(value),
)
def test_what_cannot_be_done_is_said_in_one_sentence(words, parts, sweep, dataset, capsys):
    names = {"SWEEP": str(sweep), "DATASET": str(dataset)}
    assert main([names.get(word, word) for word in words]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert all(part in line for part in parts), line


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("noise = -1", "noise = -1 is out of range"),
        ("nose = 1", "nose is not a parameter; did you mean noise?"),
        ("[prior]", "prior is not a parameter; did you mean priors?"),
        ("[drive]\ncycle = 3", "cycle is not a parameter; did you mean cycles?"),
        ("noise =", "not valid TOML"),
        ("[drive]\nkind = 'Pulse'", "kind"),
        ("[drive]\nkind = {of = 'Burst'}", "kind"),
        ("face_reflection = [0.8, 0.8]", "face_reflection"),
        ("face_reflection = [0.3, true]", "face_reflection"),
    ],
)
def test_wrong_rangefinders_are_refused(text, part, tmp_path):
    path = tmp_path / "sensor.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=part.replace("?", r"\?")):
        rangefinder_of_file(path)


@pytest.mark.parametrize("face", [0.3, 0.3 + 0.1j])
def test_rangefinder_that_is_written_is_read_again(face, tmp_path):
    written = Rangefinder(face_reflection=face, drive=Burst(cycles=8.0), noise=1e-3)
    path = tmp_path / "sensor.toml"
    path.write_text(tomlkit.dumps(json.loads(written.to_json())))
    assert rangefinder_of_file(path) == written


def test_file_of_a_sensor_records_but_for_a_wrapped_tube(tmp_path):
    """A design's file, with the tube's length, is accepted; one of a wrapped tube is not."""
    path = tmp_path / "sensor.toml"
    path.write_text("length_cm = 200\nnoise = 0.001\n[priors]\nstretch = 0.001\n")
    settings, _ = recipe_settings([path])
    assert settings["rangefinder"].noise == 1e-3
    path.write_text("length_cm = 200\n[wrap]\nforearm_cm = [25, 17, 26]\nloops = 9\n")
    with pytest.raises(ConfigError, match=r"\[wrap\]"):
        recipe_settings([path])


def test_rangefinder_is_read_from_a_file(tmp_path):
    path = tmp_path / "sensor.toml"
    path.write_text("noise = 0.001\n[drive]\ncycles = 8\n")
    found = rangefinder_of_file(path)
    assert (found.noise, found.drive.cycles, found.resonance) == (1e-3, 8.0, 42e3)


def test_errors_of_the_thermometer_are_drawn_about_zero_for_either_sign():
    for bias in (1.5, -1.5):
        drawn = [
            in_session(Rangefinder(temperature_bias=bias), seed, Recipe()).temperature_bias
            for seed in range(40)
        ]
        assert max(map(abs, drawn)) < 1.5
        assert abs(np.mean(drawn)) < 0.5
        assert np.std(drawn) > 0.5
    silent = Rangefinder(temperature_bias=0.0)
    assert in_session(silent, 1, Recipe()).temperature_bias == 0.0


def test_reflectors_of_a_recipe_may_be_an_array():
    listed, array = (Recipe(reflectors=kind([1e-3, -2e-3])) for kind in (tuple, np.array))
    assert listed.name == array.name


def test_presses_of_a_whole_tube_are_not_recorded_as_untouched(tmp_path):
    """A sweep with method = full stores no scattering matrix."""
    for depth, matrix, lacks in ((4e-3, None, True), (0.0, None, False), (4e-3, {}, False)):
        data = xr.Dataset({"depth": ("press", [depth])}, {"press": [f"p{depth:g}{matrix}"]})
        path = store.write(tmp_path, data, matrix if matrix is None else xr.Dataset(matrix))
        assert store.lacks_scattering(path) == lacks
        if lacks:
            with pytest.raises(ConfigError, match="case p has no scattering matrix"):
                _check_band({"cycles": [("p", path)]}, Recipe())


def test_modulus_that_one_session_determines_is_that_of_all(tmp_path):
    for name, modulus in (("a", "young_modulus_mpa"), ("b", "trigger_us")):
        (tmp_path / f"{name}.toml").write_text(
            "temperature_offset_c = 0.3\ntemperature_offset_c_sd = 0.1\nlength_cm = 100\n"
            "young_modulus_mpa = 1.1\nyoung_modulus_mpa_sd = 0.05\ntrigger_us = 0.0\n"
            f"determined = ['{modulus}']\n[twin]\n[rangefinder]\ntemperature_bias = -0.3\n"
            "[clutter]\nreflection = [1e-3, 1e-3]\n"
        )
    settings, _ = recipe_settings([tmp_path / "a.toml", tmp_path / "b.toml"])
    assert settings["young_modulus"] == pytest.approx(1.1e6)


def test_sweeps_and_datasets_are_not_mixed(sweep, dataset):
    with pytest.raises(ConfigError, match="open one kind"):
        acoustube.open_dataset([sweep, dataset])
