"""Rules for settings that are several numbers, a range, or several words."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

from acoustube.base.errors import ConfigError
from acoustube.base.rules import Choice, Number

MOST_VALUES = 64
"""Largest number of values of a setting."""


@dataclass(frozen=True)
class Numbers:
    """Rule for one or more numbers within bounds, both included.

    Parameters
    ----------
    each : Number
        Rule of each number.
    span : bool
        Whether the numbers are the ends of a range: the lowest and the highest, or one number for
        both.
    """

    each: Number
    span: bool = False

    @property
    def meaning(self) -> str:
        """Name of the quantity that is set."""
        return self.each.meaning

    @property
    def allowed(self) -> str:
        """The allowed values, in words."""
        kind = "a number or [lowest, highest]" if self.span else "one or more numbers"
        return f"{kind} within {self.each.allowed}"

    def check(self, name: str, value: Any) -> tuple[float, ...]:
        """Return the values as a tuple: for a range, its lowest and highest value.

        Raises
        ------
        ConfigError
            If a value is wrong, there are none or too many, or the lowest is not first.
        """
        given = tuple(value) if isinstance(value, list | tuple) else (value,)
        most = 2 if self.span else MOST_VALUES
        if not 1 <= len(given) <= most:
            raise ConfigError(
                f"has {len(given)} values", setting=name, value=list(given)[:4],
                advice=f"use {self.allowed}",
            )  # fmt: skip
        found = tuple(self.each.check(name, one) for one in given)
        if self.span and list(found) != sorted(found):
            raise ConfigError(
                "is not in rising order",
                setting=name,
                value=list(found),
                advice="give the lowest value first",
            )
        return (found[0], found[-1]) if self.span else found


@dataclass(frozen=True)
class Words:
    """Rule for one or more of several words, each once.

    Parameters
    ----------
    each : Choice
        Rule of each word.
    """

    each: Choice

    @property
    def meaning(self) -> str:
        """Name of the quantity that is set."""
        return self.each.meaning

    @property
    def allowed(self) -> str:
        """The allowed words, in one phrase."""
        return f"one or more of {', '.join(self.each.options)}"

    def check(self, name: str, value: Any) -> tuple[str, ...]:
        """Return the words as a tuple without repetitions.

        Raises
        ------
        ConfigError
            If a word is not a choice, or there are none.
        """
        given = tuple(value) if isinstance(value, list | tuple) else (value,)
        found = tuple(dict.fromkeys(self.each.check(name, one) for one in given))
        if not found:
            raise ConfigError("is empty", setting=name, value=[], advice=f"use {self.allowed}")
        return found


def numbers(default: tuple[float, ...], each: Number, *, span: bool = False) -> Any:
    """Return a dataclass field for one or more numbers with the rule :class:`Numbers`."""
    return dataclasses.field(default=default, metadata={"rule": Numbers(each, span)})
