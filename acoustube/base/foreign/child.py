"""Reading of files by C libraries in a child process, so that a crash becomes an error message.

The child is started with the first such file, and reads all later ones. It has limits of memory and
time, and sends plain arrays, no Python objects. A crash or a limit ends it, and the next file gets
a new one. Arrays that a file stores uncompressed can be memory-mapped by this process instead.
"""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np

from acoustube.base.errors import ConfigError
from acoustube.base.foreign import limits

START = """
import sys
sys.path[:] = {path!r}
from acoustube.base.foreign.serve import serve
serve()
"""
PIPE = 1 << 20
"""Size of the pipes' buffers in bytes, where the system lets one choose: arrays then pass as fast
as memory is copied."""
KEPT = 1 << 25
"""Bytes of freed memory that glibc, if present, does not return to the system after a file is read.
Otherwise each page of this memory would have to be requested anew for the next file, which takes
several times as long as copying it."""
WALL = 10
"""Ratio of a reader's limit of elapsed time to that of processor time; CPU or disk may be busy."""
NUMERIC = "biufcU"
"""Values of ``dtype.kind`` of the arrays that are accepted from the child."""

Entries = list[tuple[dict[str, Any], Any]]


class ReadingError(Exception):
    """A file that could not be read, and why."""


class MissingPackage(ReadingError):  # noqa: N818
    """A package that a reader needs is missing or incomplete; the message is its name."""


class _Child:
    """Process that reads files."""

    def __init__(self) -> None:
        self.owner = os.getpid()
        code = START.format(path=[entry for entry in sys.path if entry])
        single = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        kept = dict.fromkeys(("MALLOC_MMAP_THRESHOLD_", "MALLOC_TRIM_THRESHOLD_"), str(KEPT))
        self.process = subprocess.Popen(
            [sys.executable, "-I", "-c", code], pipesize=PIPE,
            env=os.environ | single | kept,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        )  # fmt: skip

    def close(self) -> None:
        """End the process."""
        self.process.kill()
        self.process.wait()
        for stream in (self.process.stdin, self.process.stdout):
            if stream is not None:
                with contextlib.suppress(OSError):  # a request that was not sent
                    stream.close()


_running: list[_Child] = []
_lock = threading.Lock()


def read(reader: str, path: Path, kind: str) -> Entries:
    """Read a file in the child process.

    Parameters
    ----------
    reader : str
        Name of a function of :mod:`acoustube.base.foreign.readers`.
    path : Path
    kind : str
        A key of :data:`acoustube.base.foreign.limits.SIZES`.

    Returns
    -------
    list of tuple
        What the reader yields: a label, and an array, or a number or text in place of an array
        without axes. An array that the file stores uncompressed may be memory-mapped.

    Raises
    ------
    ReadingError
        If the reader fails, crashes or exceeds its time.
    MissingPackage
        If a package that the reader needs is missing.
    ConfigError
        If the file is no regular file, or exceeds a limit of size, entries or memory.
    """
    size = limits.check_file(path, kind)
    seconds = limits.factor() * (limits.SECONDS + size / limits.BYTES_PER_SECOND)
    request = {
        "reader": reader, "path": str(path.absolute()), "seconds": seconds,
        "bytes": limits.largest(kind), "entries": int(limits.ENTRIES * limits.factor()),
    }  # fmt: skip
    with _lock:
        child = _started()
        late = threading.Timer(WALL * seconds, child.process.kill)
        late.start()
        try:
            return _answer(child, request, path, kind)
        except BaseException:  # an interrupt too, which leaves an answer in the pipe
            _end()
            raise
        finally:
            late.cancel()


def _started() -> _Child:
    """Return the child of this process, started if there is none."""
    if _running and (_running[0].owner != os.getpid() or _running[0].process.poll() is not None):
        _running.clear()  # a process that was forked must not use its parent's
    if not _running:
        _running.append(_Child())
    return _running[0]


@atexit.register
def _end() -> None:
    for child in _running:
        if child.owner == os.getpid():
            child.close()
    _running.clear()


def _answer(child: _Child, request: dict[str, Any], path: Path, kind: str) -> Entries:
    """Send a request to the child; return the labels and arrays of its answer."""
    assert child.process.stdin is not None
    try:
        child.process.stdin.write(json.dumps(request).encode() + b"\n")
        child.process.stdin.flush()
    except OSError:
        raise ReadingError(_death(child)) from None
    found: Entries = []
    total = 0
    while True:
        head = json.loads(_received(child, int.from_bytes(_received(child, 4), "little")))
        if "end" in head:
            return found
        if "exceeds" in head:
            raise ConfigError(f"{path} {head['exceeds']}; {limits.RAISE}")
        if "missing" in head:
            raise MissingPackage(head["missing"])
        if "error" in head:
            raise ReadingError(head["error"])
        dtype, shape = np.dtype(head["dtype"]), tuple(int(n) for n in head["shape"])
        total += int(np.prod(shape, dtype=object)) * dtype.itemsize
        if dtype.kind not in NUMERIC or dtype.hasobject:
            raise ReadingError(f"it holds values of type {dtype}")
        limits.check_size(path, kind, total, "unpacks to")
        if head.get("offset") is not None and 0 not in shape:
            values: Any = np.memmap(path, dtype, "c", head["offset"], shape)
        else:
            values = np.empty(shape, dtype)
            _receive(child, memoryview(values.reshape(-1).view(np.uint8)))
        values = values.T if head["label"].get("turned") else values
        found.append((head["label"], values if values.ndim else values.item()))


def _received(child: _Child, size: int) -> bytearray:
    found = bytearray(size)
    _receive(child, memoryview(found))
    return found


def _receive(child: _Child, target: memoryview) -> None:
    """Fill a buffer with the next bytes from the child; raise ReadingError if it has ended."""
    stream: Any = child.process.stdout
    while target:
        n = stream.readinto(target)
        if not n:
            raise ReadingError(_death(child))
        target = target[n:]


def _death(child: _Child) -> str:
    """Return the reason why the child process has ended."""
    code = -child.process.wait()
    if code in (getattr(signal, "SIGXCPU", None), getattr(signal, "SIGKILL", None)):
        return "it takes longer than any good file of its size"
    return "its reader crashed"
