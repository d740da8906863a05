"""Cost of loading the package and printing help, shell completion, and types for users."""

import shutil
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import pytest

from acoustube.cli import _app

FORBIDDEN = (
    "jax", "numpy", "scipy", "numba", "xarray", "pandas", "dask", "h5py", "matplotlib", "pyvista",
    "vtk", "trimesh", "ipctk", "sklearn", "pyarrow", "importlib.metadata",
)  # fmt: skip
"""Modules that take longer to import than help to print; the last one loads the e-mail package."""
OPTIONAL = (
    "pyarrow", "soundfile", "serial", "cobs", "ezc3d", "distributed", "pypardiso", "gymnasium",
)  # fmt: skip
COMMANDS = [name for name in _app.app if not name.startswith("-")]


def loaded_after(code, forbidden=FORBIDDEN):
    """The forbidden modules that a fresh interpreter has loaded after some code."""
    report = f"\nimport sys\nprint('loaded', *[n for n in {forbidden!r} if n in sys.modules])"
    result = subprocess.run(
        [sys.executable, "-c", code + report], capture_output=True, text=True, check=True
    )
    return result.stdout.rpartition("loaded")[2].split()


def test_importing_the_package_imports_nothing_heavy():
    assert loaded_after("import acoustube") == []


def test_help_of_no_command_imports_anything_heavy():
    words = [["--help"], ["--version"], *([name, "--help"] for name in COMMANDS)]
    assert len(words) > 15
    code = "from acoustube.cli._app import main\n" + "\n".join(f"main({w!r})" for w in words)
    assert loaded_after(code) == []


def test_a_press_alone_imports_nothing_of_sound_nor_of_scenes():
    """Importing statistics and scenes would take a tenth of the time of a press to 4 mm."""
    names = "runs.presses", "runs.results", "reports.export.vtu", "reports.figures.run"
    code = f"import acoustube.{', acoustube.'.join(names)}"
    assert loaded_after(code, ("scipy.signal", "scipy.stats", "pyvista", "sklearn")) == []


def test_every_module_loads_without_the_optional_packages():
    code = (
        "import pkgutil, sys\n"
        f"sys.modules.update(dict.fromkeys({OPTIONAL!r}))\n"
        "import acoustube\n"
        "for module in pkgutil.walk_packages(acoustube.__path__, 'acoustube.'):\n"
        "    if module.name != 'acoustube.__main__':\n"
        "        __import__(module.name)\n"
        "print(len(sys.modules))\n"
    )
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize("name", COMMANDS)
def test_help_says_what_each_option_of_a_command_is(name, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "200")
    assert _app.main([name, "--help"]) == 0
    text = capsys.readouterr().out
    app = _app.app[name]
    if app.default_command is None:  # a group of commands
        assert all(f"{inner} " in text for inner in app if not inner.startswith("-"))
        return
    for argument in app.assemble_argument_collection(parse_docstring=True):
        if argument.parameter.name == ("*",):  # a group of options, which follow
            continue
        lines = [line for line in text.splitlines() if f" {argument.name} " in line]
        assert argument.parameter.help
        assert any(argument.parameter.help.split()[0] in line for line in lines)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_of_a_shell_knows_commands_options_and_choices(shell, tmp_path):
    assert _app.main(["--install-completion", "--shell", shell, "--output", "script"]) == 0
    text = (tmp_path / "script").read_text(encoding="utf-8")
    assert all(name in text for name in COMMANDS)
    assert "source-end" in text
    assert "absorbing" in text


@pytest.fixture(autouse=True)
def _own_home(tmp_path, monkeypatch):
    """Keep the user's start-up files unchanged by the installation of completion."""
    monkeypatch.setenv("HOME", str(tmp_path))


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["sw"], ["sweep"]),
        (["simulate", "--sup"], ["--support"]),
        (["simulate", "--support", ""], ["held", "free"]),
        (["cache", "cl"], ["clear"]),
    ],
    ids=" ".join,
)
def test_bash_completes(words, expected):
    assert _app.main(["--install-completion", "--shell", "bash", "--output", "script"]) == 0
    press_tab = (
        'source ./script; COMP_WORDS=(acoustube "$@"); COMP_CWORD=$#; _acoustube; '
        'printf "%s\\n" "${COMPREPLY[@]}"'
    )
    result = subprocess.run(
        ["bash", "-c", press_tab, "bash", *words], capture_output=True, text=True, check=True
    )
    assert result.stdout.split() == expected


def test_completion_of_an_unknown_shell_is_refused(capsys, tmp_path):
    assert _app.main(["--install-completion", "--shell", "tcsh"]) == 2
    assert '"tcsh"' in capsys.readouterr().err
    assert list(Path(tmp_path).iterdir()) == []


def test_package_states_that_it_has_types():
    assert files("acoustube").joinpath("py.typed").is_file()
