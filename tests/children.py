"""The child process that reads files, without a package that is installed."""

import sys

from acoustube.base.foreign import child


def without(monkeypatch, package, folder):
    """Let the child find a package that cannot be imported; a new child is started for it."""
    child._end()
    (folder / f"{package}.py").write_text("raise ImportError")
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setattr(child, "_running", [])
    assert sys.path[0] == str(folder)
