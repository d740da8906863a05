"""The child process that reads files, made to lack an installed package."""

import sys

from acoustube.base.foreign import child


def without(monkeypatch, package, folder):
    """Make a package unimportable for the child process; a new child is started for it."""
    child._end()
    (folder / f"{package}.py").write_text("raise ImportError")
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setattr(child, "_running", [])
    assert sys.path[0] == str(folder)
