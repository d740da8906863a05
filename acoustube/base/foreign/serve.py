"""Child process that reads files: requests as lines of JSON, answers as arrays."""

from __future__ import annotations

import json
import os
import signal
import sys
from typing import Any, BinaryIO

import numpy as np

from acoustube.base.foreign import readers

MEMORY = 400_000_000
"""Bytes of address space for the libraries, in addition to twice what a file may unpack to."""


def serve() -> None:
    """Answer requests until standard input ends."""
    answers = os.fdopen(os.dup(1), "wb")
    # The output of a library must not be mixed with the answers.
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    for line in sys.stdin.buffer:
        request = json.loads(line)
        _limit(request["seconds"], request["bytes"])
        _answer(answers, request)
        answers.flush()  # small arrays together: each message wakes the other process


def _limit(seconds: float, size: int) -> None:
    """Set the limits of processor time and memory for the next file, where the system has them."""
    try:
        import resource
    except ImportError:  # Windows
        return
    used = resource.getrusage(resource.RUSAGE_SELF)
    spent = used.ru_utime + used.ru_stime
    wanted = {
        resource.RLIMIT_CPU: int(spent + seconds + 1),
        resource.RLIMIT_AS: _address_space() + MEMORY + 2 * size,
        resource.RLIMIT_CORE: 0,
    }
    for limit, value in wanted.items():
        _, most = resource.getrlimit(limit)
        if most != resource.RLIM_INFINITY:
            value = min(value, most)
        resource.setrlimit(limit, (value, most))


def _address_space() -> int:
    """Return the address space in use in bytes, zero where the system does not report it."""
    try:
        with open("/proc/self/statm", encoding="ascii") as file:  # noqa: PTH123
            return int(file.read().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


def _answer(answers: BinaryIO, request: dict[str, Any]) -> None:
    try:
        reader = getattr(readers, request["reader"])
        total = 0
        for number, (label, value) in enumerate(reader(request["path"], request["bytes"])):
            if number == request["entries"]:
                raise readers.Exceeded(f"has over {number} arrays and attributes, the limit")
            if isinstance(value, readers.Stored):
                _send(answers, {"label": label, **value._asdict()})
                continue
            array = np.asarray(value)
            turned = array.flags.f_contiguous and not array.flags.c_contiguous
            array = np.ascontiguousarray(array.T) if turned else np.asarray(array, order="C")
            total += array.nbytes
            if total > request["bytes"]:
                raise readers.Exceeded(
                    f"unpacks to over {request['bytes'] / 1e6:.4g} MB, the limit"
                )
            _send(
                answers,
                {
                    "label": label | {"turned": turned},
                    "dtype": array.dtype.str,
                    "shape": array.shape,
                },
            )
            answers.write(array.reshape(-1).view(np.uint8).data)
        _send(answers, {"end": True})
    except readers.Exceeded as error:
        _send(answers, {"exceeds": str(error)})
    except readers.Missing as error:
        _send(answers, {"missing": str(error)})
    except MemoryError:
        _send(answers, {"exceeds": "needs more memory than its limit allows"})
    except Exception as error:  # any error of a library
        words = " ".join(str(error).split())[:1000] or type(error).__name__
        _send(answers, {"error": words})


def _send(answers: BinaryIO, head: dict[str, Any]) -> None:
    content = json.dumps(head).encode()
    answers.write(len(content).to_bytes(4, "little") + content)
