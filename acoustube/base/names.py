"""Checks of file names that are passed to public functions."""

from __future__ import annotations

import errno
import os
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from typing import Any

from acoustube.base.errors import ConfigError


@dataclass(frozen=True)
class FileNames:
    """Rule for the name of a file or a folder, which need not exist.

    Parameters
    ----------
    many : bool
        Whether several names are allowed too.
    """

    many: bool = False

    def check(self, name: str, value: Any) -> None:
        """Raise ConfigError unless the value is a name that a file can have."""
        if isinstance(value, str | os.PathLike):
            _check_one(name, value)
            return
        several = isinstance(value, Iterable) and not isinstance(value, bytes | dict)
        if not self.many or not several or getattr(value, "ndim", 1) == 0:
            raise ConfigError(
                f"is of type {type(value).__name__}", setting=name, value=repr(value),
                advice="give a str or a PathLike" + (", or a list of them" if self.many else ""),
            )  # fmt: skip
        if isinstance(value, Collection):  # an iterator is checked as it is used
            for one in value:
                PATH.check(f"each of {name}", one)


def _check_one(name: str, value: Any) -> None:
    """Raise if a name is one that no file can have."""
    try:
        os.lstat(value)
    except (OSError, ValueError, TypeError) as error:  # null characters, or not text
        if isinstance(error, OSError) and error.errno != errno.ENAMETOOLONG:
            return
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(
            f"is no name of a file ({reason})", setting=name, value=str(value),
            advice="give another name",
        ) from error  # fmt: skip


PATH, PATHS = FileNames(), FileNames(many=True)
