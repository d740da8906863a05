"""Validation rules of settings, and the base class of sections, which checks their settings."""

from __future__ import annotations

import dataclasses
import difflib
from dataclasses import dataclass
from numbers import Real
from typing import Any

from acoustube.base.errors import ConfigError


@dataclass(frozen=True)
class Number:
    """Rule for a finite number within bounds, both included.

    Parameters
    ----------
    low, high : float
        Bounds.
    unit : str
        Unit of the value and of the bounds, empty for a pure number.
    meaning : str
        What the setting is; it becomes the comment in a written configuration.
    whole : bool
        Whether only whole numbers are allowed.
    """

    low: float
    high: float
    unit: str = ""
    meaning: str = ""
    whole: bool = False

    @property
    def allowed(self) -> str:
        """The range in words."""
        kind = "a whole number from " if self.whole else ""
        return f"{kind}{self.low:g} to {self.high:g} {self.unit}".rstrip()

    def check(self, name: str, value: Any) -> float | int:
        """Return the value as a plain number.

        Raises
        ------
        ConfigError
            If it is not a finite number of the right kind within the bounds.
        """
        if not _is_number(value):
            raise self._error(name, repr(value), "is not a number")
        # Written so that nan fails too; Python compares an int of any size, float() would not.
        if not self.low <= value <= self.high:
            raise self._error(name, value, "is out of range", self.meaning and f" ({self.meaning})")
        if not self.whole:
            return float(value)
        if value != int(value):
            raise self._error(name, value, "is not a whole number")
        return int(value)

    def _error(self, name: str, value: Any, reason: str, meaning: str = "") -> ConfigError:
        """Return the error of a value that is not allowed."""
        return ConfigError(
            reason, setting=name, value=value, allowed=(self.low, self.high),
            advice=f"use {self.allowed}{meaning}",
        )  # fmt: skip


@dataclass(frozen=True)
class Choice:
    """Rule for one of several allowed words.

    Parameters
    ----------
    options : tuple of str
        The words.
    meaning : str
        What the setting is.
    """

    options: tuple[str, ...]
    meaning: str = ""

    @property
    def allowed(self) -> str:
        """The words, joined."""
        return " or ".join(f'"{option}"' for option in self.options)

    def check(self, name: str, value: Any) -> str:
        """Return the value.

        Raises
        ------
        ConfigError
            If it is not one of the options.
        """
        if not (isinstance(value, str) and value in self.options):
            raise ConfigError(
                "is not a choice", setting=name, value=repr(value), allowed=self.options,
                advice=f"use {self.allowed}",
            )  # fmt: skip
        return str(value)


@dataclass(frozen=True)
class File:
    """Rule for the name of a file.

    Parameters
    ----------
    meaning : str
        What the setting is.
    """

    meaning: str

    @property
    def allowed(self) -> str:
        """Allowed values, in words."""
        return "the name of a file"

    def check(self, name: str, value: Any) -> str:
        """Return the value.

        Raises
        ------
        ConfigError
            If it is not a str, or empty, or not in UTF-8. Whether the file exists is not checked.
        """
        if not (isinstance(value, str) and value.strip()):
            raise ConfigError(
                "is not a name", setting=name, value=repr(value), advice=f"use {self.allowed}"
            )
        try:
            value.encode()
        except UnicodeEncodeError as error:  # the shell's stand-ins for bytes of another encoding
            raise ConfigError(
                "is not in UTF-8", setting=name, value=repr(value), advice="rename the file"
            ) from error
        return value


def _is_number(value: Any) -> bool:
    """Return whether a value is a number, which excludes Booleans, as in `wall_mm = true`.

    It also excludes NumPy's time intervals, whose class is an integer's.
    """
    if isinstance(value, bool) or not isinstance(value, Real):
        return False
    return getattr(getattr(value, "dtype", None), "kind", "f") in "iuf"


def setting(default: Any, rule: Number | Choice | File) -> Any:
    """Return a dataclass field with a default value, and a rule in its metadata."""
    return dataclasses.field(default=default, metadata={"rule": rule})


class Section:
    """Base class of dataclasses of settings; checks each field by its rule when an object is made.

    None is allowed where it is the default. Numbers are stored as int or float.
    """

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):  # type: ignore[arg-type]
            value = getattr(self, field.name)
            if value is None and field.default is None:
                continue
            checked = field.metadata["rule"].check(field.name, value)
            object.__setattr__(self, field.name, checked)


def nearest(name: str, known: Any) -> str:
    """Return the end of a message: the nearest known word, or all known words if none is near."""
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    if near:
        return f"; did you mean {near[0]}?"
    return f"; known are {', '.join(known)}"
