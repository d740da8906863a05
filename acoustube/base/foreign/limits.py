"""Limits on the content of files that are read, and error messages for unreadable files.

``--limits FACTOR``, or the environment variable ``ACOUSTUBE_LIMITS``, multiplies all of them but
the nesting, which Python's stack bounds.
"""

from __future__ import annotations

import contextlib
import functools
import logging
import os
import stat
import warnings
from collections.abc import Iterator
from math import isfinite
from pathlib import Path

from acoustube.base.errors import ConfigError

SIZES = {
    "settings": 5_000_000, "table": 100_000_000, "markers": 50_000_000, "surface": 100_000_000,
    "model": 500_000_000, "recording": 1_000_000_000, "result": 4_000_000_000,
}  # fmt: skip
"""Largest size in bytes of a file of each kind, both as stored and unpacked."""
ENTRIES = 10_000
"""Largest number of arrays and attributes of a file."""
COLUMNS = 50_000
"""Largest number of columns of a text table."""
NAME = 200
"""Largest number of characters of a name in a file."""
NESTING = 100
"""Largest depth of nested tables and lists."""
SECONDS, BYTES_PER_SECOND = 3.0, 2e6
"""Largest processor time of a reader in a child process, for a file of n bytes, in s:
``factor() * (SECONDS + n / BYTES_PER_SECOND)``."""
VARIABLE = "ACOUSTUBE_LIMITS"
RAISE = f"give --limits FACTOR, or set {VARIABLE} = FACTOR, to raise the limits"
"""What to do about a file that exceeds a limit."""

OF_CONTENT = (
    ArithmeticError, AttributeError, LookupError, MemoryError, NotImplementedError, RecursionError,
    TypeError, ValueError,
)  # fmt: skip
"""Errors raised when a result does not have the variables or values expected in it."""

_KINDS = {
    stat.S_ISDIR: "a folder", stat.S_ISFIFO: "a pipe", stat.S_ISCHR: "a device",
    stat.S_ISBLK: "a device", stat.S_ISSOCK: "a socket",
}  # fmt: skip


def factor() -> float:
    """Return the factor on all limits, from the environment variable; 1 if that is not set.

    Raises
    ------
    ConfigError
        If the environment variable is not a positive number.
    """
    text = os.environ.get(VARIABLE, "1")
    with contextlib.suppress(ValueError):
        if isfinite(number := float(text)) and number > 0:
            return number
    raise ConfigError(f"{VARIABLE} = {text} is not a number over 0; correct it, or unset it")


def largest(kind: str) -> int:
    """Return the largest size in bytes of a file of a kind: :data:`SIZES` times :func:`factor`."""
    return int(SIZES[kind] * factor())


def check_file(path: str | Path, kind: str) -> int:
    """Check that a path is a regular file that is not too large.

    Parameters
    ----------
    path : str or Path
    kind : str
        A key of :data:`SIZES`.

    Returns
    -------
    int
        Size of the file in bytes.

    Raises
    ------
    ConfigError
        If there is no such file, it is a pipe, a device, a folder or a file of the operating system
        (as in /proc), or it is larger than the limit.
    """
    try:
        status = Path(path).stat()
    except (OSError, ValueError) as error:  # ValueError: a null character in the name
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(
            f"{path} cannot be read ({reason}); check the name of the file"
        ) from error
    for is_kind, what in _KINDS.items():
        if is_kind(status.st_mode):
            raise ConfigError(f"{path} is {what}, not a file; name a file")
    if status.st_dev in _of_system():
        raise ConfigError(
            f"{path} is of the operating system, whose files have no fixed size; name another file"
        )
    check_size(path, kind, status.st_size)
    return status.st_size


@functools.cache
def _of_system() -> frozenset[int]:
    """Return the devices of the file systems whose regular files may be endless or block a reader.

    An example is /proc/kmsg, under any name.
    """
    found = set()
    for folder in ("/proc", "/sys", "/sys/kernel/tracing", "/sys/kernel/debug"):
        with contextlib.suppress(OSError):
            found.add(os.stat(folder).st_dev)  # noqa: PTH116
    return frozenset(found - {os.stat("/").st_dev})  # noqa: PTH116


def check_size(path: str | Path, kind: str, size: float, what: str = "holds") -> None:
    """Raise ConfigError if a file, or what is stored in it, exceeds the limit of its kind.

    Parameters
    ----------
    path : str or Path
    kind : str
        A key of :data:`SIZES`.
    size : float
        In bytes.
    what : str
        Verb of the message, between the path and the size.
    """
    if size > largest(kind):
        raise ConfigError(
            f"{path} {what} {size / 1e6:.4g} MB, over the limit of {largest(kind) / 1e6:.4g} MB "
            f"for a {kind}; {RAISE}"
        )


def check_count(path: str | Path, what: str, count: int, limit: int) -> None:
    """Raise ConfigError if `count` exceeds a limit times :func:`factor`; `what` names the items."""
    if count > limit * factor():
        raise ConfigError(
            f"{path} has {count} {what}, over the limit of {limit * factor():g}; {RAISE}"
        )


def check_name(path: str | Path, name: str) -> None:
    """Raise ConfigError if a name in a file is longer than :data:`NAME` times :func:`factor`."""
    if len(name) > NAME * factor():
        raise ConfigError(
            f"{path} holds a name of {len(name)} characters, {name[:20]}..., over the limit of "
            f"{NAME * factor():g}; {RAISE}"
        )


@contextlib.contextmanager
def reading(
    path: str | Path,
    failure: str,
    advice: str,
    errors: type[Exception] | tuple[type[Exception], ...] = Exception,
) -> Iterator[None]:
    """Convert any failure to read a file to a ConfigError, and suppress libraries' warnings.

    Parameters
    ----------
    path : str or Path
    failure : str
        What the message says of the file, such as "is not a model".
    advice : str
        What to do.
    errors : type or tuple of type, optional
        Errors to convert besides ConfigError; :data:`OF_CONTENT` if the block also writes files,
        whose OSError is then passed on.
    """
    silent = logging.root.manager.disable
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            logging.disable(logging.CRITICAL)  # some libraries log the tracebacks that they handle
            yield
    except ConfigError as error:
        if error.setting is None:  # otherwise it concerns an argument that the file states
            if str(path) in str(error) or Path(path).name in str(error).split(": ")[0]:
                raise
            raise ConfigError(f"{path}: {error}") from error
        raise ConfigError(f"{path} {failure} ({error}); {advice}") from error
    # Readers raise any error of their parsing, including RecursionError and MemoryError.
    except errors as error:
        raise ConfigError(f"{path} {failure} ({reason(error)}); {advice}") from error
    finally:
        logging.disable(silent)


def reason(error: Exception) -> str:
    """Return why a file could not be read, in a few words."""
    if isinstance(error, RecursionError):
        return "it is nested too deeply"
    if isinstance(error, MemoryError):
        return "it needs more memory than there is"
    if isinstance(error, KeyError):
        return f"it has no {error.args[0]}" if error.args else "something is missing"
    words = getattr(error, "strerror", None) or " ".join(str(error).split()).removeprefix("Error: ")
    return str(words) or type(error).__name__
