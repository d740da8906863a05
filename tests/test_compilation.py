"""Options of the compiler behind JAX."""

import subprocess
import sys
from importlib.metadata import version

import pytest

from acoustube.base import compilation
from acoustube.base.compilation import EMITTERS, compile_quickly


@pytest.mark.parametrize(
    ("flags", "expected"),
    [
        (None, f"{EMITTERS}=false"),
        ("--xla_dump_to=x", f"--xla_dump_to=x {EMITTERS}=false"),
        (f"{EMITTERS}=true", f"{EMITTERS}=true"),
    ],
)
def test_option_is_added_where_it_is_not_set(flags, expected, monkeypatch):
    if flags is None:
        monkeypatch.delenv("XLA_FLAGS", raising=False)
    else:
        monkeypatch.setenv("XLA_FLAGS", flags)
    monkeypatch.setattr(compilation, "version", lambda _: "0.10.2")
    compile_quickly()
    assert compilation.os.environ["XLA_FLAGS"] == expected


def test_other_versions_are_left_as_they_are(monkeypatch):
    """An option that XLA does not know would end the process."""
    monkeypatch.delenv("XLA_FLAGS", raising=False)
    monkeypatch.setattr(compilation, "version", lambda _: "0.11.0")
    compile_quickly()
    assert "XLA_FLAGS" not in compilation.os.environ


@pytest.mark.skipif(
    not version("jaxlib").startswith(compilation.KNOWN), reason="the option is for other versions"
)
def test_jax_takes_the_option():
    """In a process of its own, whose exit code tells."""
    ran = subprocess.run(
        [sys.executable, "-c", "import jax; print(jax.jit(lambda x: x + 1)(1.0))"],
        env={**compilation.os.environ, "JAX_PLATFORMS": "cpu"}, capture_output=True, text=True,
    )  # fmt: skip
    assert EMITTERS in compilation.os.environ["XLA_FLAGS"]
    assert (ran.returncode, ran.stdout) == (0, "2.0\n"), ran.stderr
