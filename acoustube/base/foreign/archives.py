"""NumPy's archives (NPZ), read without pickle and within limits."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acoustube.base.errors import ConfigError
from acoustube.base.foreign import limits


def read_archive(path: Path, kind: str) -> dict[str, NDArray[Any]]:
    """Return all arrays of an NPZ archive by name.

    Parameters
    ----------
    path : Path
    kind : str
        A key of :data:`acoustube.base.foreign.limits.SIZES`.

    Raises
    ------
    ConfigError
        If it has too many members, too long names, too much data, or arrays of Python objects.
    Exception
        Any error of zipfile or NumPy for a damaged archive. The caller converts it by
        :func:`acoustube.base.foreign.limits.reading`.
    """
    found: dict[str, NDArray[Any]] = {}
    with zipfile.ZipFile(path) as archive:
        members = archive.infolist()
        limits.check_count(path, "members", len(members), limits.ENTRIES)
        limits.check_size(path, kind, sum(info.file_size for info in members), "unpacks to")
        for info in members:
            name = info.filename.removesuffix(".npy")
            limits.check_name(path, name)
            with archive.open(info) as member:
                found[name] = _array(path, name, member, info.file_size)
    return found


def _array(path: Path, name: str, member: Any, stored: int) -> NDArray[Any]:
    """Return an array of `stored` bytes at most; raise for Python objects or more bytes."""
    version = np.lib.format.read_magic(member)
    read_header = {(1, 0): np.lib.format.read_array_header_1_0}
    shape, _, dtype = read_header.get(version, np.lib.format.read_array_header_2_0)(member)
    if dtype.hasobject:
        raise ConfigError(
            f"{path}: {name} is an array of Python objects, which could run code as they are read; "
            "save it as numbers or text"
        )
    size = dtype.itemsize
    for n in shape:
        size *= n
    if size > stored:  # before that much is allocated
        raise ValueError(f"{name} declares {size} bytes but only {stored} are stored")
    member.seek(0)
    return np.lib.format.read_array(member, allow_pickle=False)
