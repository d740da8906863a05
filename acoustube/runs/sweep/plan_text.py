"""Values of a plan's settings as text, on the command line and in a TOML file."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import lcm
from typing import Any

from acoustube.base.errors import ConfigError, short
from acoustube.base.files import toml_array
from acoustube.runs.config import section_of

MOST_CASES = 10_000_000
"""Largest number of cases of a plan, and largest number of values of a range."""

Values = tuple[Any, ...]


@dataclass(frozen=True)
class Interval:
    """Range from which a random plan draws a setting, in the unit stated by the setting's name."""

    low: float
    high: float

    def __str__(self) -> str:
        return f"{short(self.low)}:{short(self.high)}"


def parsed(name: str, words: Sequence[str]) -> Values | Interval:
    """Parse the values of a setting from the command line.

    Parameters
    ----------
    name : str
        Name of the setting.
    words : sequence of str
        Numbers, words and ranges ``first:last:step`` that include both ends; or one range
        ``low:high`` alone.

    Returns
    -------
    tuple or Interval
        The values; an Interval for ``low:high``.

    Raises
    ------
    ConfigError
        If a range is not valid.
    """
    if len(words) == 1 and words[0].count(":") == 1:
        low, high = (_number(name, words[0], part) for part in words[0].split(":"))
        return Interval(float(low), float(high))
    values: list[Any] = []
    for word in words:
        if ":" in word:
            values += _range(name, word)
        else:
            values.append(_literal(word))
    return tuple(values)


def other_settings(words: Sequence[str], taken: Collection[str] = ()) -> dict[str, list[str]]:
    """Parse settings written as name=value,value; return the texts of the values by name.

    Raises
    ------
    ConfigError
        If a word is not written so, or a name is no setting, given twice or in `taken`.
    """
    found: dict[str, list[str]] = {}
    for word in words:
        name, equals, values = word.partition("=")
        if not equals:
            raise ConfigError(
                "gives no values", setting="vary", value=word, advice="write NAME=VALUE,VALUE",
            )  # fmt: skip
        section_of(name)
        if name in found or name in taken:
            raise ConfigError(f"{name} is given twice; give it once")
        found[name] = values.split(",")
    return found


def _range(name: str, word: str) -> list[float]:
    """Return the values of a range first:last:step, computed exactly from its decimal digits."""
    parts = word.split(":")
    if len(parts) != 3:
        raise ConfigError(f"{name} = {word} is not a range; write first:last:step")
    first, last, step = (_number(name, word, part) for part in parts)
    if step <= 0 or last < first:
        raise ConfigError(f"{name} = {word} has no values; use first <= last and a step over 0")
    if (last - first) / step > MOST_CASES:
        raise ConfigError(f"{name} = {word} has over {MOST_CASES:.0e} values; use a larger step")
    # Integers over a common denominator are as exact as fractions, and twenty times as fast.
    whole = lcm(first.denominator, step.denominator)
    start, stride = int(first * whole), int(step * whole)
    return [(start + i * stride) / whole for i in range(int((last - first) / step) + 1)]


def _number(name: str, word: str, part: str) -> Fraction:
    """Return a number exactly; raise if it exceeds the range of a float."""
    try:
        if re.search(r"e[+-]?[\d_]{4}", part, re.IGNORECASE):  # would fill the memory
            raise OverflowError
        number = Fraction(part.strip())
        float(number)
        return number
    except (ValueError, ZeroDivisionError, OverflowError) as error:
        raise ConfigError(
            f"{name} = {word} is not a range of numbers; write first:last:step, such as 0:8:0.5"
        ) from error


def _literal(word: str) -> Any:
    """Return a word as a number if it states one, else the word."""
    try:
        return int(word)
    except ValueError:
        pass
    try:
        return float(word)
    except ValueError:
        return word


def axis_of(path: Any, name: str, values: Any) -> Values | Interval:
    """Return the values of a setting that a file gives as a list, as one value, or as a range.

    Raises
    ------
    ConfigError
        If they are a table, or a range is not valid.
    """
    if isinstance(values, str):
        return parsed(name, [values])
    if isinstance(values, dict):
        raise ConfigError(
            f"{path}: [sweep.over] {name} is a table; give a list such as [1, 2], or a range "
            'such as "1:8:0.5"'
        )
    found: list[Any] = []
    for value in values if isinstance(values, list) else [values]:
        found += _range(name, value) if isinstance(value, str) and ":" in value else [value]
    return tuple(found)


def to_toml_value(value: Any) -> Any:
    """Return a value, or the values of a setting, as they are written in a TOML document."""
    if isinstance(value, Interval):
        return str(value)
    return toml_array(value) if isinstance(value, tuple) else value
