"""The command ``acoustube cache``: list, measure and clear the cached results."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from cyclopts import App, Parameter

from acoustube.base import cache, remnants
from acoustube.base.errors import readable
from acoustube.base.report import counted

app = App(
    name="cache",
    help="List or delete cached results: presses and scattering matrices.",
    default_parameter=Parameter(negative=()),
)


@app.command(name="list")
def list_cache() -> None:
    """List the cached results, the newest first."""
    for entry in cache.entries():
        written = datetime.fromtimestamp(entry.modified).strftime("%Y-%m-%d %H:%M")
        print(f"{written}  {entry.size / 1e6:6.1f} MB  {readable(entry.label)}")


@app.command(name="size")
def cache_size() -> None:
    """Print the number of results, their size and folder, and the size of JAX's compiled code."""
    found, code = cache.entries(), cache.compiled()
    print(f"{counted(len(found), 'result')}, {_megabytes(found)} in {cache.folder()}")
    print(f"compiled code, {_megabytes(code)}")


@app.command(name="clear")
def clear_cache() -> None:
    """Delete all cached results, JAX's compiled code, and temporary files of killed commands."""
    code = cache.compiled()
    left = remnants.clear()
    gone = cache.clear()
    halves = f" and {counted(len(left), 'incomplete output')}" * bool(left)
    print(
        f"deleted {counted(len(gone), 'result')}{halves}, {_megabytes([*gone, *code, *left])} freed"
    )


def _megabytes(entries: Sequence[cache.Entry | remnants.Remnant]) -> str:
    return f"{sum(entry.size for entry in entries) / 1e6:.1f} MB"
