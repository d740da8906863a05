"""Atomic writing of files: complete, flushed to the disk, over an existing file only on request."""

from __future__ import annotations

import contextlib
import errno
import io
import itertools
import math
import os
import uuid
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from acoustube.base import interrupts, remnants
from acoustube.base.errors import ConfigError, SimulationError
from acoustube.base.remnants import ASIDE

FULL = {
    errno.ENOSPC: "no space left on the device",
    errno.EDQUOT: "the disk quota is used up",
    errno.EFBIG: "a file may not be that large here",
}
"""Descriptions of a full disk, a quota and a file size limit, by system error number (errno)."""


class DiskFullError(SimulationError):
    """Output that does not fit on the disk.

    Parameters
    ----------
    path : path
        The file.
    reason : str
        Description from :data:`FULL`.
    needed : int
        Size of the output in bytes.
    then : str
        Further information or advice.
    """

    def __init__(self, path: Path, reason: str, needed: int, then: str = "") -> None:
        size = math.ceil(needed / 1e4) / 100  # rounded up, so that as much is enough
        super().__init__(f"{path}: {reason}; {size:g} MB are needed{'; ' * bool(then)}{then}")
        self.path, self.reason, self.needed = path, reason, needed


def write(path: str | Path, content: bytes | str, *, overwrite: bool = False) -> None:
    """Write a file atomically: under a temporary name, flushed, then renamed if the name is free.

    Parameters
    ----------
    path : str or path
        The file. In a temporary folder of :func:`acoustube.base.files.partial_folder` the file is
        written under its final name at once, and never replaces another.
    content : bytes or str
        All of it; text is written in UTF-8.
    overwrite : bool
        Whether an existing file of this name is replaced.

    Raises
    ------
    DiskFullError
        If the disk is full.
    SimulationError
        If the name is taken and `overwrite` is false; the content is then in a file of this name
        with a number.
    ConfigError
        If the file cannot be written for another reason.
    """
    write_all({path: content}, overwrite=overwrite)


def write_all(contents: Mapping[Any, bytes | str], *, overwrite: bool = False) -> None:
    """Write files, given their contents by path, atomically, all or none; see :func:`write`."""
    encoded = {
        Path(path): text.encode("utf-8", "backslashreplace") if isinstance(text, str) else text
        for path, text in contents.items()  # a text may hold a file name not in UTF-8
    }
    needed, names = sum(map(len, encoded.values())), {}
    with contextlib.ExitStack() as stack:
        complete = {}
        for path, content in encoded.items():
            with _naming_file(path, needed):
                if any(parent in _begun for parent in path.parents):
                    _to_disk(path, content)
                else:
                    complete[path] = stack.enter_context(aside(path))
                    _to_disk(complete[path], content)
        interrupts.check()
        for path, hidden in complete.items():
            with _naming_file(path, needed):
                names[path] = hidden.replace(path) if overwrite else _named(hidden, path)
                to_disk(path.parent)
    for path, name in names.items():
        if name != path:
            raise SimulationError(
                f"{path} has been made by another program meanwhile, and nothing is overwritten; "
                f"this result is in {name}"
            )


@contextlib.contextmanager
def _naming_file(path: Path, needed: int) -> Iterator[None]:
    """Convert an OSError to an error that names the file and, on a full disk, the bytes needed."""
    try:
        yield
    except OSError as error:
        if error.errno in FULL:
            raise DiskFullError(path, FULL[error.errno], needed) from error
        raise ConfigError(
            f"{path} cannot be written ({error.strerror or error}); name another place"
        ) from error


def begin(path: Path, head: bytes) -> io.FileIO:
    """Create a file with its first content, atomically, and open the file for appending.

    Parameters
    ----------
    path : Path
        New file.
    head : bytes
        First content.

    Returns
    -------
    io.FileIO
        The open file, unbuffered.

    Raises
    ------
    DiskFullError
        If the disk is full.
    OSError
        If the name is taken, or the file cannot be written for another reason. An incomplete file
        is not left behind.
    """
    try:
        with aside(path) as hidden:
            _to_disk(hidden, head)
            _link(hidden, path)
    except OSError as error:
        if error.errno in FULL:
            raise DiskFullError(path, FULL[error.errno], len(head)) from error
        raise
    return path.open("ab", buffering=0)


def _to_disk(path: Path, content: bytes) -> None:
    """Write a new file and flush it to the disk; remove the file if that fails."""
    with path.open("xb") as file:
        try:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())  # otherwise a power cut may leave an empty file
        except OSError:
            path.unlink(missing_ok=True)
            raise


def to_disk(folder: Path) -> None:
    """Flush a folder's directory entries to the disk, where the system supports it."""
    with contextlib.suppress(OSError):
        number = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)


def _named(hidden: Path, path: Path) -> Path:
    """Rename a complete file to `path`, with a number if that is taken; return the new name."""
    others = (path.with_name(f"{path.stem}-{n}{path.suffix}") for n in itertools.count(2))
    for name in itertools.chain([path], others):
        with contextlib.suppress(FileExistsError):
            _link(hidden, name)
            return name
    raise AssertionError  # the numbers do not end


def _link(hidden: Path, name: Path) -> None:
    """Move a file to a name; raise FileExistsError if that is taken."""
    try:
        os.link(hidden, name)
    except FileExistsError:
        raise
    except OSError:  # a file system without links, as on memory cards
        with name.open("xb"):
            pass
        try:
            hidden.replace(name)
        except BaseException:
            name.unlink(missing_ok=True)
            raise


_begun: dict[Path, Path | None] = {}
"""Temporary paths of the outputs that this process is making, and their records in the register.

A record is a file of :mod:`acoustube.base.remnants`; None where it could not be written.
"""


@contextlib.contextmanager
def aside(path: Path) -> Iterator[Path]:
    """Yield a temporary path next to `path`; a file or folder left there in the end is removed."""
    hidden = path.absolute().with_name(f"{ASIDE}{uuid.uuid4().hex[:8]}")
    try:
        _begun[hidden] = remnants.register(hidden)
        yield hidden
    finally:
        _end(hidden)


def _end(aside: Path) -> None:
    remnants.remove(aside)
    record = _begun.get(aside)
    if record is not None and not os.path.lexists(aside):
        with contextlib.suppress(OSError):
            record.unlink(missing_ok=True)
    _begun.pop(aside, None)


def discard() -> None:
    """Remove all outputs that this process has begun and not completed."""
    for aside in list(_begun):
        _end(aside)
