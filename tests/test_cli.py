"""The installed command: output, refusals and loading time."""

import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import is_dataclass
from pathlib import Path

import pytest
from commands import COMMAND, run_process

import acoustube
from acoustube.base.errors import ConfigError, SimulationError
from acoustube.base.limits import SHALLOWEST_MM
from acoustube.cli import _app

HEAVY = ("jax", "scipy", "xarray", "h5netcdf", "pyvista", "vtk", "trimesh", "matplotlib", "numpy")


def refused(words, capsys):
    """Return the one line on standard error with which the command line refuses words."""
    assert _app.main([str(word) for word in words]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("acoustube: ")
    assert captured.err.count("\n") == 1
    assert captured.err.endswith("\n")
    return captured.err


def assert_refused(words, capsys, *parts):
    line = refused(words, capsys)
    for part in parts:
        assert part in line


def test_version_is_the_packages():
    assert run_process("--version").stdout.strip() == acoustube.__version__


def test_help_names_every_option_with_its_unit():
    text = run_process("simulate", "--help", COLUMNS="300").stdout
    for option, unit in (
        ("--indenter", "2 to 100 mm; default 25"),
        ("--depth", "0.05 to 50 mm, or 0 in a sweep; default 4"),
        ("--position", "cm; default 20"),
        ("--length", "5 to 1000 cm; default 40"),
        ("--support", "default held. [choices: held, free]"),
        ("--frequency", "5 to 100 kHz; default 42"),
        ("--temperature", "-20 to 60 degC; default 20"),
        ("--resolution", "cells across the bore"),
        ("--source-end", "release, absorbing"),
        ("--config", "TOML"),
        ("--out", "Folder"),
        ("--quiet", "nothing but errors"),
    ):
        line = text[text.index(option) :]
        assert unit in line[: line.find("--", 2)]


WHOLE = [
    ("simulate --resolution 16", "resolution"),
    ("indent --steps 16", "steps"),
    ("sweep --random 16", "random"),
    ("sweep --seed 16", "seed"),
    ("sweep --workers 16", "workers"),
    ("dataset a --out b --cycles 16", "cycles"),
    ("dataset a --out b --tubes 16", "tubes"),
    ("dataset a --out b --sessions 16", "sessions"),
    ("dataset a --out b --seed 16", "seed"),
    ("dataset a --out b --workers 16", "workers"),
    ("scatter a.stl --out b.nc --resolution 16", "resolution"),
    ("process a --channel 16", "channel"),
    ("process a --samples 16", "samples"),
    ("live --port a --frame-bytes 16", "frame_bytes"),
    ("live --port a --baud 16", "baud"),
    ("calibrate a --untouched a --channel 16", "channel"),
    ("calibrate a --untouched a --samples 16", "samples"),
    ("train a --estimator echo --out b --epochs 16", "epochs"),
    ("train a --estimator echo --out b --folds 16", "folds"),
    ("train a --estimator echo --out b --seed 16", "seed"),
    ("reproduce all --workers 16", "workers"),
    ("sleeve --forearm 25 17 26 --loops 9 --tubes 16", "tubes"),
]


def parsed_or_refusal(tokens):
    """Return the arguments of a command by name, or why a number is out of its range."""
    try:
        _, bound, _ = _app.app.parse_args(tokens, exit_on_error=False, print_error=False)
    except ConfigError as error:
        return str(error)
    return bound.arguments


@pytest.mark.parametrize(("words", "name"), WHOLE)
def test_whole_numbers_are_exact_and_nothing_else_is_one(words, name, capsys):
    """2**53 + 1, which is no double, stays exact; 1e3 is whole; 3.5 is refused at once."""
    Path("a.stl").touch()
    for text, number in (("9007199254740993", 2**53 + 1), ("-3", -3), ("1e3", 1000)):
        tokens = words.replace("16", text).split()
        found = parsed_or_refusal(tokens)
        if isinstance(found, str):
            assert f"{name.replace('_', '-')} = {number} is out of range" in found
            continue
        groups = [vars(group) for group in found.values() if is_dataclass(group)]
        (value,) = [given[name] for given in (found, *groups) if name in given]
        assert value == number
        assert type(value) is int
    for text in ("3.5", "inf", "nan", "many"):
        assert _app.main(words.replace("16", text).split()) == 2
        captured = capsys.readouterr()
        assert name.replace("_", "-") in captured.err
        assert text in captured.err
        assert captured.out == ""
    assert _app.main([words.split()[0], "--help"]) == 0
    assert re.search(rf"--{name.replace('_', '-')}\s+INT\b", capsys.readouterr().out)


def test_largest_seed_that_is_documented_is_taken(capsys):
    words = ["sweep", "--depth", "1:2", "--random", "2", "--dry-run", "--seed"]
    assert _app.main([*words, str(2**63 - 1)]) == 0
    assert _app.main([*words, str(2**63)]) == 2
    assert "seed = 9223372036854775808" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("command", "allowed"), [("simulate", False), ("indent", False), ("sweep", True)]
)
def test_help_states_the_depths_that_a_command_takes(command, allowed, capsys):
    """Depth 0 is accepted by a sweep only; the help of all commands states the least depth."""
    _app.main([command, "--help"])
    words = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert f"{SHALLOWEST_MM:g} to 50 mm, or 0 in a sweep" in words
    dry = ["--dry-run"] if command == "sweep" else ["--out", "run"]
    assert (_app.main([command, "--depth", "0", *dry]) == 0) is allowed


@pytest.mark.parametrize(
    "words",
    [
        ["--help"],
        ["simulate", "--help"],
        ["indent", "--help"],
        ["simulate", "--depth", "12"],
        ["indent", "--depth", "12"],
        ["cache", "list"],
        ["sleeve", "--loops", "9"],
    ],
)
def test_help_and_refusals_import_nothing_heavy(words):
    code = (
        "import sys\n"
        "from acoustube.cli._app import main\n"
        f"main({words!r})\n"
        f"print('heavy:', [name for name in {HEAVY!r} if name in sys.modules])\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True
    )
    assert result.stdout.endswith("heavy: []\n")


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (["--indenter", "-5"], ["indenter_mm = -5", "use 2 to 100 mm"]),
        (["--indenter", "0"], ["indenter_mm = 0", "use 2 to 100 mm"]),
        (["--indenter", "nan"], ["indenter_mm = nan"]),
        (["--indenter", "1e9"], ["indenter_mm = 1000000000"]),
        (["--depth", "-1"], ["depth_mm = -1"]),
        (["--depth", "0"], ["depth_mm = 0"]),
        (["--depth", "inf"], ["depth_mm = inf"]),
        (["--depth", "12"], ["depth_mm = 12 is past the floor", "outer diameter 11.1 mm", "8.7"]),
        (["--depth", "9"], ["beyond a closed lumen", "use at most 8.7"]),
        (["--position", "3"], ["too near the source end", "use 8.25 to 33.75"]),
        (["--position", "39"], ["too near the far end", "use 8.25 to 33.75"]),
        (["--position", "-3"], ["position_cm = -3"]),
        (["--length", "0"], ["length_cm = 0"]),
        (["--length", "1e6"], ["length_cm = 1000000"]),
        (["--length", "9"], ["length_cm = 9 is too short", "use at least 14.5"]),
        (["--frequency", "0"], ["frequency_khz = 0"]),
        (["--frequency", "1000"], ["frequency_khz = 1000", "5 to 100 kHz"]),
        (["--temperature", "-300"], ["temperature_c = -300"]),
        (["--resolution", "0"], ["resolution = 0"]),
        (["--resolution", "16.5"], ["resolution = 16.5 is not a whole number"]),
        (["--resolution", "10000"], ["resolution = 10000"]),
        (["--resolution", "8", "--frequency", "60"], ["too coarse", "use at least 12"]),
        (["--support", "glued"], ["glued", "held", "free"]),
        (["--source-end", "open"], ["open", "release", "absorbing"]),
        (["--indenter", "wide"], ["wide", "--indenter"]),
        (["--indenter"], ["--indenter", "and its value"]),
        (["--indentor", "25"], ["--indentor", "did you mean --indenter"]),
        (["--indenter", "10", "--indenter", "25"], ["--indenter", "multiple"]),
        (["25"], ["25"]),
        (["--config", "none.toml"], ["none.toml", "No such file"]),
        (["--config", "."], [". is a folder, not a file"]),
        (["--out", "."], ["name a new folder"]),
        (["--out", "/"], ["not empty"]),
        (["--out", "/proc/acoustube"], ["/proc/acoustube cannot be written"]),
    ],
    ids=" ".join,
)
def test_bad_option_is_refused_in_one_sentence(tmp_path, capsys, words, parts):
    assert_refused(["simulate", *words], capsys, *parts)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (["--depth", "9"], ["depth_mm = 9 is beyond a closed lumen", "use at most 8.7"]),
        (["--depth", "12"], ["depth_mm = 12 is past the floor", "use at most 8.7"]),
        (["--steps", "0"], ["steps = 0", "1 to 1000"]),
        (["--steps", "2.5"], ["steps = 2.5 is not a whole number"]),
        (["--shape", "cone"], ["cone", "rod", "punch", "sphere"]),
        (["--shape", "sphere", "--yaw", "10"], ["yaw_deg = 10 turns a sphere"]),
        (["--offset", "2"], ["offset_mm = 2 moves a rod"]),
        (["--shape", "sphere", "--offset", "30"], ["offset_mm = 30", "misses the tube"]),
        (["--frequency", "42"], ["--frequency"]),
        (["--tube", ""], ["surface = '' is not a name"]),
        (["--out", "."], ["name a new folder"]),
    ],
    ids=" ".join,
)
def test_bad_option_of_a_press_is_refused_in_one_sentence(tmp_path, capsys, words, parts):
    assert_refused(["indent", *words], capsys, *parts)
    assert list(tmp_path.iterdir()) == []


def test_a_simulated_indenter_that_misses_the_tube_is_refused_before_anything_is_printed(
    tmp_path, capsys
):
    path = tmp_path / "a.toml"
    path.write_text('[indentation]\nshape = "punch"\noffset_mm = -25\n')
    assert_refused(["simulate", "--config", path], capsys, "25 mm punch misses the tube")
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    "words",
    [
        ["simulate", "--depth", "12"],
        ["indent", "--shape", "cone"],
        ["indent", "--tube", "missing.stl"],
        ["simulate", "--config", "missing.toml"],
        ["simulat"],
    ],
    ids=" ".join,
)
def test_a_process_refuses_as_the_function_does(tmp_path, capsys, words):
    """The installed command ends with code 2 and prints the same line, and nothing else."""
    result = run_process(*words)
    assert result.returncode == 2
    assert result.stdout == ""
    assert result.stderr == refused(words, capsys)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("shape", ["missing", "broken"])
def test_surface_that_is_no_tube_leaves_nothing(tmp_path, capsys, shape):
    if shape == "broken":
        (tmp_path / "a.stl").write_text("solid nothing\nendsolid nothing\n")
    before = list(tmp_path.iterdir())
    assert_refused(["indent", "--tube", "a.stl", "--out", "run", "--quiet"], capsys, "a.stl")
    assert list(tmp_path.iterdir()) == before


def test_cache_is_listed_sized_and_cleared(tmp_path):
    folder = tmp_path / "cache"
    folder.mkdir()
    (folder / f"{32 * '0'}.npz").write_bytes(bytes(2_000_000))
    (folder / "compiled-x").mkdir()
    (folder / "compiled-x" / "jit_f-cache").write_bytes(bytes(3_000_000))
    environment = {"ACOUSTUBE_CACHE": str(folder)}
    listed = run_process("cache", "list", **environment).stdout
    assert listed.startswith("20")
    assert listed.endswith("     2.0 MB  \n")
    size = f"1 result, 2.0 MB in {folder}\ncompiled code, 3.0 MB\n"
    assert run_process("cache", "size", **environment).stdout == size
    cleared = run_process("cache", "clear", **environment).stdout
    assert cleared == "deleted 1 result, 5.0 MB freed\n"
    size = f"0 results, 0.0 MB in {folder}\ncompiled code, 0.0 MB\n"
    assert run_process("cache", "size", **environment).stdout == size


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("[waves]\nfrequncy_khz = 42", "did you mean frequency_khz?"),
        ("[wavs]\nfrequency_khz = 42", "did you mean waves?"),
        ("[indentation]\ndepth_mm = '4'", "depth_mm = '4' is not a number"),
        ('"a\\nb" = 1', "outside a section"),
        ("[tube", "is not valid TOML"),
        ("\xff", "is not a text file in UTF-8"),
    ],
)
def test_bad_file_is_refused_in_one_sentence(tmp_path, capsys, text, part):
    path = tmp_path / "a.toml"
    path.write_text(text, encoding="latin-1")
    assert_refused(["simulate", "--config", "a.toml", "--out", "run"], capsys, part)
    assert list(tmp_path.iterdir()) == [path]


def test_unknown_command_is_refused_with_the_nearest(capsys):
    assert_refused(["simulat"], capsys, "simulat", "did you mean", "simulate")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may read all")
def test_unreadable_file_is_refused(tmp_path, capsys):
    path = tmp_path / "a.toml"
    path.touch(mode=0o000)
    assert_refused(["simulate", "--config", "a.toml"], capsys, "a.toml", "Permission denied")


def test_folder_with_a_run_is_refused_and_kept(tmp_path, capsys):
    run = tmp_path / "run"
    run.mkdir()
    (run / "run.nc").write_text("kept")
    assert_refused(["simulate", "--out", "run"], capsys, "out = run is not empty")
    assert (run / "run.nc").read_text() == "kept"


def test_refusal_comes_before_any_solver_is_loaded():
    """JAX alone takes more than a second to import."""
    result = run_process("simulate", "--depth", "12", PYTHONPROFILEIMPORTTIME="1")
    assert result.returncode == 2
    loaded = {line.rsplit("|")[-1].strip() for line in result.stderr.splitlines()}
    assert "acoustube.runs.config" in loaded
    assert not loaded & {"jax", "numba", "scipy.sparse", "pyvista"}


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (SimulationError("the press did not converge;\nuse a smaller depth"), 1),
        (OSError(28, "No space left on device"), 1),
        (KeyboardInterrupt(), 130),
    ],
)
def test_failure_in_a_command_is_one_sentence_and_a_code(monkeypatch, capsys, error, code):
    def fail(*_args, **_options):
        raise error

    monkeypatch.setattr(_app, "app", fail)
    assert _app.main(["check"]) == code
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="needs POSIX signals")
@pytest.mark.parametrize(
    ("delay", "number"), [(0.3, signal.SIGINT), (1.5, signal.SIGTERM), (4, signal.SIGINT)]
)
def test_interrupt_at_any_moment_leaves_nothing(tmp_path, tmp_path_factory, delay, number):
    """Interrupts while modules load and while the press is computed; not before Python runs."""
    nothing_kept = {"ACOUSTUBE_CACHE": str(tmp_path_factory.mktemp("cache"))}
    with subprocess.Popen(
        [COMMAND, "simulate", "--resolution", "12", "--out", "new/run"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | nothing_kept,
        # Tests that run in the background inherit that interrupts are ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as process:
        time.sleep(delay)
        process.send_signal(number)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == 128 + number, errors
    # JAX may print a note on an interrupt that it has ignored; the last line is acoustube's.
    assert errors.splitlines()[-1].startswith("acoustube: interrupted")
    assert list(tmp_path.iterdir()) == []


def test_file_names_are_printed_as_they_are(capsys):
    name = "My. Folder/No. Such.toml"
    assert_refused(["simulate", "--config", name], capsys, name)
