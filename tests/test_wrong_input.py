"""Errors of new users, command by command: one sentence each, and no file is lost.

Settings refused by `simulate` and `indent` are in `test_cli`, wrong plans in `test_sweep_plan`,
surfaces in `test_scatter`, recordings in `test_recordings`.
"""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from acoustube.cli import main


@pytest.fixture
def files(tmp_path):
    """A folder with files of wrong formats, and a recording without labels."""
    (tmp_path / "text.txt").write_text("hello\n")
    (tmp_path / "bad.toml").write_text("a = \n")
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "text.stl").write_text("solid\nendsolid\n")
    (tmp_path / "text.nc").write_text("x")
    (tmp_path / "one.csv").write_text("column,x_mm,y_mm,z_mm\na,0,0,0\n")
    (tmp_path / "sensor.toml").write_text("noise = -1\n")
    for folder in ("nothing", "full"):
        (tmp_path / folder).mkdir()
    (tmp_path / "full" / "kept").write_text("kept")
    xr.Dataset(attrs={"configuration": "{}"}).to_netcdf(tmp_path / "run.nc", engine="h5netcdf")
    signal = np.random.default_rng(0).normal(size=(3, 4000))
    np.savez(tmp_path / "good.npz", signal=signal, sampling_rate=200e3, temperature=20.0)
    np.savez(tmp_path / "bare.npz", signal=signal)
    np.savez(tmp_path / "nan.npz", signal=signal * np.nan, sampling_rate=2e5, temperature=20.0)
    return tmp_path


def content(folder):
    """Every file with its bytes, and every folder."""
    return {path: path.is_file() and path.read_bytes() for path in folder.rglob("*")}


HELP = "; see acoustube"
FOREARM = "sleeve --forearm 25 17 26 --loops 9"
TRAIN = "train good.npz --estimator network"
CASES = {
    # The words themselves.
    "nonsense": ['Unknown command "nonsense"', "available commands: simulate", HELP],
    "cache cler": ['"cler"', "did you mean", '"clear"'],
    "cache clear all": ['unexpected argument "all"', "acoustube cache clear --help"],
    "simulate --indenter 25 35": ['unexpected argument "35"', "acoustube simulate --help"],
    "simulate --indenter 25 35 36": ['unexpected arguments "35 36"'],
    "simulate --steps 5": ["--steps is not an option", "--config FILE with steps in [indentation]"],
    "simulate --bore 6": ["--bore is not an option", "inner_diameter_mm in [tube]"],
    "sweep --mesh coarse": ["--mesh is not an option", "give --vary mesh=VALUE"],
    "simulate --depth": ["simulate needs --depth and its value", HELP],
    "simulate --depth 3mm": ["--depth", '"3mm" is not a number', "without a unit"],
    "simulate --length 40,5": ["--length", '"40,5" is not a number'],
    "simulate --support Held": ["--support", '"Held"', 'did you mean "held"'],
    "simulate --losses yes": ["--losses", '"yes"', '"off"', '"on"'],
    "simulate --out text.txt": ["out = text.txt is a file", "name a new folder"],
    "simulate --out text.txt/run": ["out = text.txt/run", "Not a directory", "writable folder"],
    "simulate --config bad.toml": ["bad.toml is not valid TOML", "line 1"],
    "indent --position 20": ["--position", "acoustube indent --help"],
    "check now": ['unexpected argument "now"', "acoustube check --help"],
    "check --verbose": ["--verbose", HELP],
    "cite none": ["none does not exist", "name a result, or nothing"],
    "cite text.txt": ["text.txt is not a result", "simulate, indent, sweep"],
    "cite good.npz": ["good.npz is not a model", "acoustube train writes one"],
    # Sweeps, and what is made of them.
    "sweep --depth 1 --sampler sobol --dry-run": ["sampler = sobol", "random plan", "--random"],
    "sweep --depth 1 --seed 3 --dry-run": ["seed = 3 is of a random plan", "leave it out"],
    "sweep --depth 1:2 --random 5.5 --dry-run": ["random = 5.5 is not a whole number", "from 1"],
    "sweep --depth 1:2 --random -5 --dry-run": ["random = -5 is out of range"],
    "sweep --depth 1:2 --random 5 --sampler halton --dry-run": ["halton", '"sobol"', '"latin"'],
    "sweep --depth 1 --workers two --dry-run": ["--workers", '"two" is not a number'],
    "sweep --depth 1 --retry all --out new": ["--retry", '"all"', '"failed"'],
    "sweep --depth 1 --out full": ["out = full is not empty", "name a new folder"],
    "sweep --depth 1 --out text.txt": ["out = text.txt is a file"],
    "sweep --plan bad.toml --dry-run": ["bad.toml is not valid TOML"],
    "sweep --vary depth_mm=1,2 --depth 3 --dry-run": ["depth_mm is given twice"],
    "dataset nothing": ["--out and its value"],
    "dataset nothing --out new": ["nothing holds no sweep", "acoustube sweep"],
    "dataset nothing --cycles 2.5 --out new": ["cycles = 2.5 is not a whole number"],
    "dataset nothing --tubes 0 --out new": ["tubes = 0 is out of range", "from 1"],
    "dataset nothing --workers 1e9 --out new": ["workers = 1000000000", "1 to 1024"],
    "dataset nothing --rangefinder sensor.toml --out new": ["sensor.toml: noise = -1", "0 to"],
    "show text.nc --out a.png": ["text.nc is not a file of acoustube sweep or dataset"],
    "export nothing --out full": ["out = full is not empty"],
    # Waves.
    "scatter none.stl --out s.nc": ["none.stl does not exist", "STL, PLY, OBJ or VTP"],
    "scatter text.txt --out s.nc": ["text.txt cannot be read as a surface", "STL"],
    "scatter text.stl --out text.txt": ["out = text.txt exists", "name a new file"],
    "scatter text.stl --out none/s.nc": ["out = none/s.nc", "does not exist; make it"],
    "scatter text.stl --band 5 --out s.nc": ["--band", "2", "only got 1"],
    "scatter text.stl --band 5000 60000 --out s.nc": ["band = 5000 60000 kHz", "give it in kHz"],
    "scatter text.stl --out s.txt": ["out = s.txt is not the name of a netCDF file"],
    "scatter nothing --out s.nc": ["nothing is a folder", "STL, PLY, OBJ or VTP"],
    "scatter text.stl --band 60 5 --out s.nc": ["band = 60 5 kHz is invalid"],
    "scatter text.stl --step 0 --out s.nc": ["step = 0 kHz must divide the band of 55 kHz"],
    "scatter text.stl --step 1e-320 --out s.nc": ["step = ", "equal steps"],
    "scatter text.stl --temperature 293 --out s.nc": ["temperature = 293", "-20 to 60 degC"],
    "scatter text.stl --humidity 150 --out s.nc": ["humidity = 150", "0 to 100 %"],
    "scatter text.stl --pressure 101325 --out s.nc": ["pressure = 101325", "10 to 200 kPa"],
    # Signals.
    "process": ["process needs a file or a folder"],
    "process good.npz --samples 1.5": ["samples = 1.5", "whole number"],
    "process good.npz --channel 0.5": ["channel = 0.5 is not a whole number"],
    "process good.npz --prominence 5": ["prominence = 5 is out of range", "fraction"],
    "process good.npz --calibration text.txt": ["text.txt is not a calibration", "calibrate"],
    "process good.npz --out text.txt": ["out = text.txt exists"],
    "process good.npz --figure text.txt": ["figure = text.txt exists"],
    "process good.npz --figure a.doc": ["figure = a.doc must end in", ".png"],
    "live --port none --baud 1": ["baud = 1 is out of range", "300 to"],
    "live --port none --rate 0": ["rate = 0 is out of range", "Hz"],
    "live --port none --out text.txt": ["out = text.txt exists"],
    "calibrate good.npz": ["--untouched and its value"],
    "calibrate good.npz --untouched good.npz": ["--out", "--name"],
    "calibrate good.npz --untouched none.npz --out new": ["none.npz does not exist"],
    "calibrate good.npz --untouched good.npz --out new": ["no label true_distance", "sidecar"],
    "calibrate good.npz --untouched good.npz --name a/b": ["name = a/b", "letters"],
    # Estimators.
    "train good.npz --out new": ["--estimator and its value"],
    "train good.npz --estimator forest --out new": ['"forest"', '"network"', '"boosting"'],
    f"{TRAIN} --out new": ["no label force", "sidecar"],
    f"{TRAIN} --epochs 1.5 --out new": ["epochs = 1.5 is not a whole number"],
    f"{TRAIN} --folds 1 --out new": ["folds = 1 is out of range", "2 to 100"],
    f"{TRAIN} --out text.txt": ["out = text.txt exists"],
    "train nothing --estimator network --out new": ["nothing holds no recordings", ".npz"],
    "evaluate none.model good.npz": ["none.model does not exist", "which train writes"],
    "evaluate nothing good.npz": ["nothing holds no file of a library", "which train writes"],
    "evaluate text.txt good.npz": ["text.txt is not a model (not a NumPy archive)"],
    "evaluate good.npz good.npz": ["good.npz is not a model", "train writes one"],
    "evaluate good.npz": ["evaluate needs a file or a folder"],
    # Sleeves.
    "sleeve one.csv": ["--loops", "--pitch"],
    "twin none.npz none.npz --rate 200 --out t.toml": ["rate = 200", "1000"],
    "sleeve one.csv --forearm 25 17 26 --loops 9": ["a file of markers or --forearm", "not both"],
    "sleeve --forearm 25 17 26 --loops 9 --pitch 4": ["--loops 9 or --pitch", "not both"],
    "sleeve one.csv --loops 9": ["one.csv", "named a", "--columns"],
    "sleeve empty.csv --loops 9": ["empty.csv is empty", "column, x, y, z"],
    "sleeve --forearm 25 17 --loops 9": ["--forearm", "3", "only got 2"],
    "sleeve --forearm 25 17 x --loops 9": ["--forearm", '"x" is not a number'],
    f"{FOREARM} --tubes 1.5": ["tubes = 1.5 is not a whole number"],
    f"{FOREARM} --distance 3:80": ["distance = 3:80", "use 1 to 2"],
    f"{FOREARM} --unit km": ["--unit", '"km"', '"mm"'],
    f"{FOREARM} --out full": ["out = full is not empty"],
}


@pytest.mark.parametrize(
    "words", [["process"], ["cite"], ["export", "--out", "o"], ["scatter", "--out", "o.nc"]]
)
def test_file_name_that_is_not_in_utf_8_is_printed_by_its_codes(words, capsys):
    assert main([*words, "\udcff.nc"]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") <= 2
    assert "\\udcff.nc" in told


@pytest.mark.parametrize("words", CASES)
def test_what_is_wrong_is_said_in_one_sentence(words, files, capsys):
    before = content(files)
    assert main(words.split()) == 2
    captured = capsys.readouterr()
    (line,) = captured.err.splitlines()
    assert captured.out == ""
    assert line.startswith("acoustube: ")
    for part in CASES[words]:
        assert part in line
    assert not line.endswith(";")
    assert content(files) == before


@pytest.mark.parametrize("command", ["show . --out a.png", "export . --out new", "cite ."])
@pytest.mark.parametrize("kind", ["damaged", "foreign"])
def test_file_that_is_no_sweeps_is_named_with_what_to_do(kind, command, tmp_path, capsys):
    """Two files with the name of a sweep's file: one is damaged, one is of another program."""
    path = tmp_path / "cases-1.nc"
    xr.Dataset({"x": ("press", [1.0, 2.0])}).to_netcdf(path, engine="h5netcdf")
    if kind == "damaged":
        path.write_bytes(path.read_bytes()[:8] + bytes(4000))
    before = content(tmp_path)
    assert main(command.split()) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "cases-1.nc" in line
    assert "; " in line
    assert "acoustube sweep" in line
    assert content(tmp_path) == before


@pytest.mark.parametrize(
    ("words", "part"),
    [
        ("none.npz", "none.npz does not exist; name a recording"),
        ("text.txt", "text.txt is not of a kind that can be read; use .npz"),
        ("empty.csv", "empty.csv cannot be read as CSV (it is empty)"),
        ("nothing", "nothing holds no recordings; name a folder"),
        ("bare.npz", "does not state its sampling rate; give rate in Hz"),
        ("bare.npz --rate 200000", "does not state the temperature; give temperature in degC"),
        ("bare.npz --rate 200 --temperature 20", "rate = 200 is out of range; use 1000"),
        ("bare.npz --rate 200000 --temperature 293", "temperature = 293 degC in cycle 0"),
        ("nan.npz", "12000 samples are missing, NaN or infinite, the first in cycle 0"),
        ("good.npz --channel 5", "channel = 5, but the file has one channel; leave it out"),
        ("run.nc", "run.nc is a result of acoustube simulate, indent or sweep"),
        ("good.npz --samples 100", "samples = 100 does not fit cycles of shape (3, 4000)"),
    ],
)
def test_recording_that_cannot_be_processed_is_named_and_the_rest_goes_on(
    words, part, files, capsys
):
    """Exit code 1 where the second file is processed, and 2 where nothing is, or written."""
    before = content(files)
    other = "good.npz" if "--" not in words else ""
    code = main(["process", *words.split(), *other.split(), "--out", "new.csv"])
    assert code == (1 if other else 2)
    assert part in " ".join(capsys.readouterr().err.split())
    if other:
        assert len(Path("new.csv").read_text().splitlines()) == 4
        Path("new.csv").unlink()
    assert content(files) == before
