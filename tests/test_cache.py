"""Cached results are found again, are ignored when damaged, and can be listed and cleared."""

import os
import resource
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

import acoustube
from acoustube.base import cache
from acoustube.base.errors import ConfigError
from acoustube.indentation import indent
from acoustube.indentation.mesh import MeshSize
from acoustube.runs import presses as press_runs
from acoustube.runs.config import Config, Mechanics, load_config

ARRAYS = {"depth": np.linspace(0, 1, 5), "count": np.arange(3), "none": np.zeros((0, 2))}


@pytest.fixture(autouse=True)
def _empty(tmp_path, monkeypatch):
    monkeypatch.setenv("ACOUSTUBE_CACHE", str(tmp_path / "cache"))


def test_what_is_stored_is_recalled_bit_by_bit():
    assert cache.recall("a") is None
    cache.store("a", ARRAYS)
    found = cache.recall("a")
    assert found.keys() == ARRAYS.keys()
    for name, array in ARRAYS.items():
        assert found[name].dtype == array.dtype
        assert np.array_equal(found[name], array)


@pytest.mark.parametrize("kept", [0, 1, 30, 100, -200, -1])
def test_entry_that_was_cut_short_counts_as_missing_and_is_replaced(kept):
    cache.store("a", ARRAYS)
    path = cache.folder() / "a.npz"
    path.write_bytes(path.read_bytes()[:kept])
    assert cache.recall("a") is None
    cache.store("a", ARRAYS)
    assert np.array_equal(cache.recall("a")["depth"], ARRAYS["depth"])


def test_entry_whose_content_changed_counts_as_missing():
    """Entries with a flipped byte anywhere, or written by another program, are not returned."""
    cache.store("a", ARRAYS)
    path = cache.folder() / "a.npz"
    good = path.read_bytes()
    for place in range(0, len(good), 37):
        path.write_bytes(good[:place] + bytes([good[place] ^ 1]) + good[place + 1 :])
        found = cache.recall("a")
        # A byte of the archive's own headers may not matter; then the content is unchanged.
        assert found is None or all(np.array_equal(found[n], ARRAYS[n]) for n in ARRAYS)
    np.savez(path, depth=np.zeros(3))
    assert cache.recall("a") is None


def test_name_depends_on_everything_given_and_on_the_code(monkeypatch):
    name = cache.key("press", {"depth": 1.0, "tube": {"wall": 2}})
    assert name == cache.key("press", {"tube": {"wall": 2}, "depth": 1.0})
    assert name != cache.key("press", {"tube": {"wall": 3}, "depth": 1.0})
    assert name != cache.key("scattering", {"depth": 1.0, "tube": {"wall": 2}})
    monkeypatch.setattr(cache, "_code", lambda _: "changed")
    assert name != cache.key("press", {"depth": 1.0, "tube": {"wall": 2}})


MODULES = {
    "__init__.py": "",
    "entry.py": """
        from typing import TYPE_CHECKING
        import package.inner.deep
        if TYPE_CHECKING:
            from package import typed
        def f():
            from package import late
            return late
    """,
    "inner/__init__.py": "",
    "inner/deep.py": """
        from package.inner.below import step as go
        NUMBER = 3
        def g(x):
            return go(x) + NUMBER
    """,
    "inner/below/__init__.py": "from package.inner.below.steps import step",
    "inner/below/steps.py": "def step(x): return x",
    "late.py": "LATE = 1",
    "typed.py": "T = int",
    "apart.py": "import sys; sys.exit('imported')",
}


@pytest.fixture
def package(tmp_path):
    """A package of modules that import one another; importing any of them leaves a trace."""
    folder = tmp_path / "package"
    for name, text in MODULES.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(textwrap.dedent(text))
    return folder


def digest(package):
    return cache.code_digest(package.parent, ["package.entry"])


def changed(package, name, old, new):
    """Return whether an edit of a module changes the digest."""
    before, path = digest(package), package / name
    text = path.read_text()
    assert not old or old in text
    path.write_text(text.replace(old, new) if old else new + text)
    os.utime(path, ns=(0, path.stat().st_mtime_ns + 10**9))
    return digest(package) != before


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("entry.py", "return late", "return 2"),
        ("inner/deep.py", "NUMBER = 3", "NUMBER = 4"),
        ("inner/deep.py", "go(x)", "go(-x)"),
        ("inner/below/__init__.py", "", "import os\n"),
        ("inner/below/steps.py", "return x", "return -x"),
        ("late.py", "LATE = 1", "LATE = 2"),
    ],
)
def test_digest_changes_with_the_code_of_an_imported_module(package, name, old, new):
    assert changed(package, name, old, new)


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("entry.py", "", '"""A module."""\n'),
        ("inner/deep.py", "NUMBER = 3", 'NUMBER = 3  # three\n"""A number."""'),
        ("inner/deep.py", "def g(x):", "def g(\n    x\n):\n    'Add.'\n"),
        ("typed.py", "int", "str"),
        ("apart.py", "imported", "read"),
    ],
)
def test_digest_ignores_prose_and_modules_not_imported(package, name, old, new):
    assert not changed(package, name, old, new)


def test_digest_is_remembered_but_not_from_a_damaged_file(package):
    first = digest(package)
    sources = cache.folder() / cache.SOURCES
    assert sources.is_file()
    for damaged in ("", "[]", "{", '{"a": 1}', '{"a": [1, 2, 3, 4]}'):
        sources.write_text(damaged)
        assert digest(package) == first


def test_digest_of_a_module_that_is_gone_fails(package):
    (package / "entry.py").unlink()
    with pytest.raises(ModuleNotFoundError):
        digest(package)


@pytest.mark.parametrize(
    ("kind", "module"),
    [
        ("press", "base.surfaces"),
        ("press", "indentation.tetrahedra"),
        ("press", "indentation.contact"),
        ("scattering", "air"),
        ("scattering", "lumen.surface"),
        ("scattering", "runs.surface_scattering"),
        ("scattering", "waves.scheme.problem"),
        ("scattering", "waves.scheme.cpu_kernel"),
    ],
)
def test_every_stage_of_a_result_counts_in_its_key(kind, module, tmp_path):
    """A module is changed in a copy of the package; the digest of the copy must change."""
    root = Path(acoustube.__file__).parent
    copied = tmp_path / "acoustube"
    shutil.copytree(root, copied, ignore=shutil.ignore_patterns("__pycache__"))
    before = cache.code_digest(tmp_path, cache.CODE[kind])
    assert before == cache.code_digest(root.parent, cache.CODE[kind])
    home = copied.joinpath(*module.split("."))
    path = home / "__init__.py" if home.is_dir() else home.with_suffix(".py")
    path.write_text(path.read_text() + "\nMORE = 1\n")
    assert cache.code_digest(tmp_path, cache.CODE[kind]) != before


COMPILE = """
from acoustube.base.cache import keep_compiled_code
keep_compiled_code()
import jax
print(float(jax.jit(lambda x: x + 1)(1.0)), jax.config.jax_compilation_cache_dir)
"""


def compiling(largest_file=resource.RLIM_INFINITY, **environment):
    """Compile a function in its own process, without the tests' folder for compiled code."""

    def limit():
        resource.setrlimit(resource.RLIMIT_FSIZE, (largest_file, largest_file))

    own = {k: v for k, v in os.environ.items() if not k.startswith(("JAX", "PYTHONWARN"))}
    ran = subprocess.run(
        [sys.executable, "-c", COMPILE],
        env=own | environment,
        preexec_fn=limit,
        capture_output=True,
        text=True,
    )
    assert ran.returncode == 0
    assert ran.stdout.startswith("2.0 ")
    assert ran.stderr == ""
    return ran.stdout.split()[1]


@pytest.mark.slow
def test_compiled_code_is_cached_and_damaged_files_are_ignored():
    kept = Path(compiling())
    assert kept.parent == cache.folder()
    first = {entry.path.name for entry in cache.compiled()}
    assert first
    for entry in cache.compiled():
        content = entry.path.read_bytes()
        entry.path.write_bytes(content[: len(content) // 2])
    compiling()
    assert {entry.path.name for entry in cache.compiled()} == first
    assert cache.clear() == []
    assert not kept.exists()


@pytest.mark.slow
def test_compiling_needs_no_cache(tmp_path):
    """With a cache that is read-only, full, a file, or another one chosen by the user."""
    compiling(ACOUSTUBE_CACHE="/proc/nothing/there")
    compiling(largest_file=100, ACOUSTUBE_CACHE=str(tmp_path / "full"))
    assert all(file.stat().st_size <= 100 for file in (tmp_path / "full").rglob("*-cache"))
    compiling(ACOUSTUBE_CACHE=str(tmp_path / "full"))
    (tmp_path / "file").write_text("")
    assert compiling(ACOUSTUBE_CACHE=str(tmp_path / "file")) == "None"
    chosen = str(tmp_path / "chosen")
    assert compiling(JAX_COMPILATION_CACHE_DIR=chosen) == chosen
    assert cache.compiled() == []


def test_entries_are_listed_sized_and_cleared():
    assert cache.entries() == []
    names = {letter: 32 * letter for letter in "ab"}
    for letter, name in names.items():
        cache.store(name, ARRAYS, f"press {letter}")
    (cache.folder() / "acoustube-left-over.part").write_bytes(b"x")
    foreign = cache.folder() / "recordings.npz"
    foreign.write_bytes(b"somebody's")
    found = cache.entries()
    labels = {entry.path.stem: entry.label for entry in found}
    assert labels == {name: f"press {letter}" for letter, name in names.items()}
    assert all(entry.size == entry.path.stat().st_size > 0 for entry in found)
    assert {entry.path.stem for entry in cache.clear()} == set(names.values())
    assert list(cache.folder().iterdir()) == [foreign]


def test_read_only_folder_disables_the_cache_without_an_error(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("ACOUSTUBE_CACHE", str(tmp_path / "file" / "cache"))
    cache.store("a", ARRAYS)
    assert cache.recall("a") is None
    assert cache.entries() == []


def test_folder_that_cannot_be_looked_up_disables_the_cache_without_an_error(monkeypatch):
    """As one in another user's home: its status is denied, which pathlib raises."""
    looked_up = os.stat

    def denied(path, *arguments, **options):
        if str(path).startswith("/denied"):
            raise PermissionError(13, "Permission denied", str(path))
        return looked_up(path, *arguments, **options)

    monkeypatch.setattr(os, "stat", denied)
    monkeypatch.setenv("ACOUSTUBE_CACHE", "/denied/cache")
    assert cache.folder() == Path("/denied/cache")
    assert not cache.holds("a")
    assert cache.recall("a") is None


def test_folder_in_the_home_of_nobody_is_refused(monkeypatch):
    monkeypatch.setenv("ACOUSTUBE_CACHE", "~no-such-user/cache")
    with pytest.raises(ConfigError, match="is in no known home folder"):
        cache.folder()


def test_press_is_computed_once_for_all_frequencies(monkeypatch):
    """A press is computed again only for another depth or tube, or when its entry is damaged."""
    calls = []

    def counted(*arguments, **options):
        calls.append(options["depth"])
        options["mesh"] = MeshSize(through_wall=1, around=6, along=5)
        return indent(*arguments, **options)

    coarse = MeshSize(through_wall=1, around=6, along=5)
    recalled = press_runs.restored
    monkeypatch.setattr(press_runs, "indent", counted)
    monkeypatch.setattr(
        press_runs, "restored", lambda *a, **o: recalled(*a, **(o | {"mesh": coarse}))
    )
    first = press_runs.pressed(Config(), [1e-4])
    again = press_runs.pressed(load_config(frequency_khz=30), [1e-4])
    assert len(calls) == 1
    assert np.array_equal(first.displacement, again.displacement)
    assert again.indenters == first.indenters
    press_runs.pressed(Config(), [2e-4])
    press_runs.pressed(load_config(None, Mechanics, wall_mm=1.5), [1e-4])
    assert len(calls) == 3
    for entry in cache.entries():
        entry.path.write_bytes(entry.path.read_bytes()[:500])
    repaired = press_runs.pressed(Config(), [1e-4])
    assert len(calls) == 4
    assert np.array_equal(first.displacement, repaired.displacement)
