"""Results that need not be computed twice, in files named by the hash of what they depend on.

An entry is a NumPy archive with the SHA-256 of its own content. One that cannot be read, or whose
content is not what it was, counts as missing and is replaced.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import tempfile
import zipfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from platformdirs import user_cache_path

from acoustube.errors import ConfigError

if TYPE_CHECKING:  # the command line lists and clears without NumPy
    from numpy.typing import NDArray

    Arrays = Mapping[str, NDArray[Any]]

DIGEST = "digest"
NAME, PREFIX = re.compile("[0-9a-f]{32}"), "acoustube-"
LIBRARIES = ("ipctk", "pytetwild")
"""Packages whose version decides a result, beside acoustube's own code."""
CODE = {
    "press": ("tube.py", "limits.py", "mechanics.py", "indentation"),
    "scattering": ("air.py", "chain.py", "lumen.py", "waves"),
}
"""Modules, and folders of modules, that each kind of result is computed by."""
ONLY_USED = ("cascade.py", "bends.py")
"""Modules of these folders that take no part: they join what was computed."""


class Entry(NamedTuple):
    """A result in the cache.

    Attributes
    ----------
    path : Path
    size : int
        In bytes.
    modified : float
        When it was written, in seconds since 1970.
    """

    path: Path
    size: int
    modified: float

    @property
    def label(self) -> str:
        """What it is, in words; empty where it cannot be read."""
        try:
            with zipfile.ZipFile(self.path) as archive:
                return archive.comment.decode(errors="replace")
        except (OSError, zipfile.BadZipFile):
            return ""


def folder() -> Path:
    """Return where entries are kept: ``$ACOUSTUBE_CACHE``, or the user's cache folder.

    Raises
    ------
    ConfigError
        If a file is there.
    """
    chosen = os.environ.get("ACOUSTUBE_CACHE")
    found = Path(chosen).expanduser() if chosen else user_cache_path("acoustube")
    if found.is_file():
        raise ConfigError(f"ACOUSTUBE_CACHE = {found} is a file; name a folder")
    return found


def key(kind: str, dependencies: Mapping[str, Any]) -> str:
    """Return the name of a result.

    Parameters
    ----------
    kind : {"press", "scattering"}
        What it is.
    dependencies : mapping
        Everything that the result depends on, in what JSON can hold. The source code that computes
        it is added here.
    """
    text = json.dumps(dict(dependencies) | {"code": _code(kind)}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


@cache
def _code(kind: str) -> str:
    """Return the hash of the modules that a kind of result is computed by."""
    # Slow to import, and the command line's help needs neither.
    from importlib.metadata import version
    from importlib.resources import files

    package = files("acoustube")
    parts = [package.joinpath(name) for name in CODE[kind]]
    modules = [m for part in parts for m in (part.iterdir() if part.is_dir() else [part])]
    code = hashlib.sha256()
    for module in sorted(modules, key=lambda module: module.name):
        if module.name.endswith(".py") and module.name not in ONLY_USED:
            code.update(module.read_bytes())
    for library in LIBRARIES:
        code.update(version(library).encode())
    return code.hexdigest()


def holds(name: str) -> bool:
    """Tell whether there is an entry, which may still prove damaged."""
    return (folder() / f"{name}.npz").is_file()


def recall(name: str) -> dict[str, NDArray[Any]] | None:
    """Return the arrays of an entry, or None where there is none that can be trusted."""
    import numpy as np

    try:
        with (folder() / f"{name}.npz").open("rb") as file, np.load(file) as archive:
            arrays = {array: archive[array] for array in archive.files}
    except Exception:  # a damaged archive fails in many ways, and all mean the same
        return None
    digest = arrays.pop(DIGEST, None)
    return arrays if digest is not None and str(digest) == _digest(arrays) else None


def store(name: str, arrays: Arrays, label: str = "") -> None:
    """Write an entry in one step; where that is impossible it is only not remembered.

    Parameters
    ----------
    name : str
        From :func:`key`.
    arrays : mapping of str to array
    label : str
        What it is, in words, for a list.
    """
    import numpy as np

    try:
        folder().mkdir(parents=True, exist_ok=True)
        part: dict[str, Any] = {"dir": folder(), "prefix": PREFIX, "suffix": ".part"}
        with tempfile.NamedTemporaryFile(**part, delete=False) as file:
            try:
                content: dict[str, Any] = {**arrays, DIGEST: np.array(_digest(arrays))}
                np.savez_compressed(file, **content)
                file.close()
                with zipfile.ZipFile(file.name, "a") as archive:
                    archive.comment = label.encode()
                Path(file.name).replace(folder() / f"{name}.npz")
            except BaseException:
                file.close()
                Path(file.name).unlink(missing_ok=True)
                raise
    except OSError:
        return


def _digest(arrays: Arrays) -> str:
    import numpy as np

    content = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        content.update(f"{name} {array.dtype.str} {array.shape}".encode())
        content.update(array.tobytes())
    return content.hexdigest()


def entries() -> list[Entry]:
    """Return all entries, the newest first."""
    paths = [path for path in folder().glob("*.npz") if NAME.fullmatch(path.stem)]
    found = [(path, path.stat()) for path in paths]
    listed = [Entry(path, status.st_size, status.st_mtime) for path, status in found]
    return sorted(listed, key=lambda entry: -entry.modified)


def clear() -> list[Entry]:
    """Remove all entries, and what an interrupted write left, but nothing else; return them."""
    gone = entries()
    for path in [*(entry.path for entry in gone), *folder().glob(f"{PREFIX}*.part")]:
        path.unlink(missing_ok=True)
    return gone
