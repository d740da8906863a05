"""Errors: settings or files that cannot be used, and solvers that did not finish."""

from __future__ import annotations

import re
from math import log10
from numbers import Real
from typing import Any

MOST_DIGITS = 40
"""Largest number of digits of a whole number that is printed in full, not as its magnitude."""


class ConfigError(ValueError):
    """A setting, a file or a folder that cannot be used.

    The message is one sentence that names the argument, its value, what is allowed and what to do
    next. The command line prints it and ends with exit code 2.

    Parameters
    ----------
    reason : str
        The sentence; if `setting` is given, only what follows "setting = value" in it.
    setting : str, optional
        Name of the argument or setting, with its unit: ``depth_mm``.
    value : optional
        The value that was given.
    unit : str, optional
        Unit of the value, where the name does not state it.
    allowed : optional
        A pair of bounds, both included, or the words to choose from.
    advice : str, optional
        What to do, as an imperative: "use at most 8.7".

    Attributes
    ----------
    setting, value, allowed, advice
        The parameters; None where they do not apply.
    """

    def __init__(
        self,
        reason: str,
        *,
        setting: str | None = None,
        value: Any = None,
        unit: str = "",
        allowed: tuple[Any, ...] | None = None,
        advice: str | None = None,
    ) -> None:
        given = f"{short(value)} {unit}".rstrip()
        sentence = reason if setting is None else f"{setting} = {given} {reason}"
        whole = sentence if advice is None else f"{sentence}; {advice}"
        super().__init__(readable(whole))  # it may name a file of any length
        self.setting, self.value = setting, value
        self.allowed, self.advice = allowed, advice


class SimulationError(RuntimeError):
    """A stage that could not finish, although its settings are valid.

    The message says which stage stopped, why, and what to change. The command
    line prints it and ends with exit code 1.
    """


def about(path: object, error: Exception) -> str:
    """Return an error's message as one line, preceded by `path` unless the message contains it."""
    text = " ".join(str(error).split())
    return text if str(path) in text else f"{path}: {text}"


def short(value: Any) -> str:
    """Return a value as a short text: a number in its shortest exact form, 12 rather than 12.0."""
    if isinstance(value, int) and abs(value) >= 10**MOST_DIGITS:  # more than Python may print
        return f"{'-' if value < 0 else ''}1e{int(log10(abs(value)))}"
    interval = getattr(getattr(value, "dtype", None), "kind", "") == "m"  # timedelta64 is a Real
    if isinstance(value, int | str) or not isinstance(value, Real) or interval:
        return _shortened(str(value), LONGEST_WORD)
    return repr(float(value)).removesuffix(".0")


LONGEST_WORD, LONGEST_TEXT, LONGEST_SENTENCE = 200, 3000, 600
"""Largest numbers of characters shown: of a word, of a text, and of the sentence of an error."""


def readable(text: str, longest: int = LONGEST_TEXT) -> str:
    """Return a text as it can be shown: long parts shortened, control characters as codes.

    Parameters
    ----------
    text : str
        With values that a user has given, of any length and content.
    longest : int
        Largest number of characters shown.
    """
    if not text.isprintable():
        text = "".join(
            c if c.isprintable() or c in "\n\t" else c.encode("unicode_escape").decode()
            for c in text
        )
    if len(text) > LONGEST_WORD:
        words = re.split(r"(\s+)", text)
        text = "".join(_shortened(word, LONGEST_WORD) for word in words)
    return _shortened(text, longest)


def _shortened(text: str, most: int) -> str:
    left_out = len(text) - most
    if left_out <= 0:
        return text
    return f"{text[: most // 2]}...({left_out} characters)...{text[-most // 2 :]}"
