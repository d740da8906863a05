"""Options of the compiler behind JAX."""

import subprocess
import sys
from importlib.metadata import version

import pytest

from acoustube.base import compilation
from acoustube.base.compilation import QUICK, compile_quickly

(EMITTERS, _), (LEVEL, _) = QUICK.items()


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        ("", f"{EMITTERS}=false {LEVEL}=1"),
        ("--xla_dump_to=x", f"--xla_dump_to=x {EMITTERS}=false {LEVEL}=1"),
        (f"{EMITTERS}=true", f"{EMITTERS}=true {LEVEL}=1"),
        (f"{LEVEL}=3 {EMITTERS}=true", f"{LEVEL}=3 {EMITTERS}=true"),
    ],
)
def test_options_are_added_where_they_are_not_set(flags, expected, monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", flags)
    monkeypatch.setattr(compilation, "version", lambda _: "0.10.2")
    monkeypatch.setattr(compilation, "find_spec", lambda _: None)
    compile_quickly()
    assert compilation.os.environ["XLA_FLAGS"] == expected


@pytest.mark.parametrize(("found", "plugin"), [("0.11.0", None), ("0.10.2", "jax_cuda13_plugin")])
def test_other_versions_and_those_for_gpus_are_left_as_they_are(found, plugin, monkeypatch):
    """An option that XLA does not know would end the process."""
    monkeypatch.setenv("XLA_FLAGS", "")
    monkeypatch.setattr(compilation, "version", lambda _: found)
    monkeypatch.setattr(compilation, "find_spec", lambda name: name if name == plugin else None)
    compile_quickly()
    assert compilation.os.environ["XLA_FLAGS"] == ""


@pytest.mark.skipif(
    not version("jaxlib").startswith(compilation.KNOWN), reason="the options are for other versions"
)
def test_jax_takes_the_options(monkeypatch):
    """JAX compiles with the options in its own process, whose exit code is checked."""
    monkeypatch.setenv("XLA_FLAGS", "")
    monkeypatch.setattr(compilation, "find_spec", lambda _: None)
    compile_quickly()
    ran = subprocess.run(
        [sys.executable, "-c", "import jax; print(jax.jit(lambda x: x + 1)(1.0))"],
        env={**compilation.os.environ, "JAX_PLATFORMS": "cpu"}, capture_output=True, text=True,
    )  # fmt: skip
    assert all(name in compilation.os.environ["XLA_FLAGS"] for name in QUICK)
    assert (ran.returncode, ran.stdout) == (0, "2.0\n"), ran.stderr
