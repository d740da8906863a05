"""Register of incomplete outputs, in which those of killed processes are found.

The folder ``begun`` of the cache has a file for each output: process, machine and path.
"""

from __future__ import annotations

import os
import platform
import shutil
import time
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from acoustube.base import cache
from acoustube.base.errors import ConfigError

ASIDE = ".acoustube-partial-"
"""Start of the names of incomplete outputs."""
BEGUN = "begun"
FORGOTTEN = 7 * 86400.0
"""Age in s at which an output that another machine has begun counts as left behind."""


class Remnant(NamedTuple):
    """Incomplete output of a process that is gone.

    Attributes
    ----------
    path : Path
        Hidden file or folder.
    size : int
        In bytes.
    record : Path
        File of the register that lists this output.
    """

    path: Path
    size: int
    record: Path


def register(path: Path) -> Path | None:
    """Register an output that is begun; return the record, to be deleted when it is complete.

    None is returned where the record cannot be written.

    Parameters
    ----------
    path : Path
        Temporary path of the output.
    """
    with suppress(OSError, ConfigError):  # without a cache there is no register
        folder = cache.folder() / BEGUN
        folder.mkdir(parents=True, exist_ok=True)
        record = folder / path.name.lstrip(".")
        words = f"{os.getpid()} {platform.node()}\n".encode() + os.fsencode(path.absolute())
        try:
            record.write_bytes(words)
        except OSError:
            record.unlink(missing_ok=True)
            raise
        return record
    return None


def remnants() -> list[Remnant]:
    """Return the incomplete outputs of killed processes."""
    found = []
    with suppress(OSError, ConfigError):
        for record in sorted((cache.folder() / BEGUN).iterdir()):
            path = _abandoned(record)
            if path is not None:
                found.append(Remnant(path, size(path), record))
    return found


def clear() -> list[Remnant]:
    """Remove the incomplete outputs of killed processes; return them."""
    gone = remnants()
    for remnant in gone:
        remove(remnant.path)
        if not os.path.lexists(remnant.path):
            remnant.record.unlink(missing_ok=True)
    return gone


def remove(path: Path) -> None:
    """Remove a file, or a folder with its content, if it is there and can be removed."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with suppress(OSError):
            path.unlink(missing_ok=True)


def _abandoned(record: Path) -> Path | None:
    """Return the output of a record if it exists and its process has ended, else None.

    A record of a process that has ended is deleted if its output does not exist.
    """
    try:
        words, _, name = record.read_bytes().partition(b"\n")
        process, machine = words.decode().split(" ", 1)
        path = Path(os.fsdecode(name))
        if machine != platform.node():
            gone = time.time() - record.stat().st_mtime > FORGOTTEN
        else:
            gone = not _runs(int(process))
    except (OSError, ValueError):
        return None
    if gone and not os.path.lexists(path):  # it was completed, or not yet made
        record.unlink(missing_ok=True)
        return None
    # Nothing but an incomplete output may be deleted, whatever a damaged record says.
    return path if gone and path.name == f".{record.name}" and path.name.startswith(ASIDE) else None


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        pass
    return True


def size(path: Path) -> int:
    """Return the size of a file, or of all files of a folder, in bytes."""
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(file.stat().st_size for file in files if file.is_file())
