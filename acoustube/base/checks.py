"""Checks of the arguments of public functions, before anything is computed."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from numbers import Number as AnyNumber
from typing import Any, ParamSpec, TypeVar

from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number

P = ParamSpec("P")
T = TypeVar("T")

LARGEST = 1e100
"""Default largest magnitude of real numbers: squares and sums of such numbers are finite."""


@dataclass(frozen=True)
class Reals:
    """Rule for an array of real numbers within bounds.

    Parameters
    ----------
    low, high : float
        Bounds, both included.
    unit : str
        Unit of the values and of the bounds.
    ndim : int, optional
        Number of axes; any if None.
    axes : int
        Smallest number of axes.
    last : int, optional
        Length of the last axis, such as 3 for coordinates.
    missing : bool
        Whether nan and inf are allowed, as missing values.
    empty : bool
        Whether an empty array is allowed. An array of two or more axes whose last axis is not
        empty, such as one of shape (0, 3), is always allowed.
    kinds : str
        Allowed values of ``dtype.kind``, such as ``iu`` for integers and ``U`` for strings.
    """

    low: float = -LARGEST
    high: float = LARGEST
    unit: str = ""
    ndim: int | None = None
    axes: int = 0
    last: int | None = None
    missing: bool = False
    empty: bool = False
    kinds: str = "iufb"

    def check(self, name: str, value: Any) -> Any:
        """Return the value; a list is returned as an array.

        Raises
        ------
        ConfigError
            If the values are not real, not within the bounds, or not of the right shape.
        """
        import numpy as np  # the command line imports this module before it needs arrays

        try:
            array = np.asarray(value)
        except Exception as error:  # its own conversion may raise anything
            raise self._error(name, value, "is not an array", "give numbers") from error
        if np.ma.is_masked(value):
            raise self._error(name, value, "has masked elements", "fill or remove them")
        if array.dtype.kind not in self.kinds:
            numbers = f"{'real' if 'f' in self.kinds else 'whole'} numbers"
            wanted = f"give {numbers}{' or strings' if 'U' in self.kinds else ''}"
            raise self._error(name, value, f"is of type {array.dtype}", wanted)
        if array.ndim < self.axes or array.ndim != (array.ndim if self.ndim is None else self.ndim):
            raise self._error(name, value, f"has shape {array.shape}", self._wanted_axes())
        if self.last is not None and (array.ndim == 0 or array.shape[-1] != self.last):
            wanted = f"give an array of shape (..., {self.last})"
            raise self._error(name, value, f"has shape {array.shape}", wanted)
        found = array if isinstance(value, list) else value
        if array.size == 0:
            if self.empty or (array.ndim > 1 and array.shape[-1]):
                return found
            raise self._error(name, value, f"is empty, of shape {array.shape}", "give values")
        if self.missing:
            array = array[np.isfinite(array)]
        if array.dtype.kind == "U":
            return found
        # Written so that nan fails too.
        if array.size and not (float(array.min()) >= self.low and float(array.max()) <= self.high):
            raise self._error(name, value, "is out of range or not finite")
        return found

    def _wanted_axes(self) -> str:
        """Return the advice for an array with a wrong number of axes."""
        if self.ndim == 0:
            return "give one number"
        if self.ndim is None:
            return f"give an array of {self.axes} or more axes"
        return f"give an array of {self.ndim} {'axis' if self.ndim == 1 else 'axes'}"

    def _error(self, name: str, value: Any, reason: str, advice: str = "") -> ConfigError:
        """Return the error of a value; by default its advice states the bounds."""
        bounds = f"{self.low:g} to {self.high:g} {self.unit}".rstrip()
        return ConfigError(
            reason, setting=name, value=_in_words(value),
            allowed=(self.low, self.high), advice=advice or f"use numbers from {bounds}",
        )  # fmt: skip


def _in_words(value: Any) -> Any:
    """Return the first values of an array or a list as text; anything else unchanged."""
    if isinstance(value, str | bytes | dict) or not getattr(
        value, "ndim", hasattr(value, "__len__")
    ):
        return value
    first = ", ".join(str(one) for one in islice(value, 3))
    return f"[{first}{', ...' if len(value) > 3 else ''}]"


@dataclass(frozen=True)
class Complex:
    """Rule for a finite complex number, or an array, list or tuple of finite complex numbers.

    Parameters
    ----------
    least, most : float
        Smallest and largest magnitude.
    axes : int, optional
        Largest number of axes; any if None.
    """

    least: float
    most: float
    axes: int | None = None

    def check(self, name: str, value: Any) -> Any:
        """Return the value; a list or tuple is returned as an array.

        Raises
        ------
        ConfigError
            If a value is not finite, or its magnitude not within the bounds.
        """
        import numpy as np

        array = np.empty(0)
        if isinstance(value, AnyNumber | np.ndarray | list | tuple):
            with suppress(ValueError):  # rows of different length
                array = np.asarray(value)
        size = np.abs(array) if array.dtype.kind in "iufc" else np.empty(0)
        if not (size.size and size.min() >= self.least and size.max() <= self.most):
            raise ConfigError(
                "is not finite or out of range", setting=name, value=_in_words(value),
                advice=f"use numbers of magnitude {self.least:g} to {self.most:g}",
            )  # fmt: skip
        if self.axes is not None and array.ndim > self.axes:
            wanted = f"an array of at most {self.axes} dimensions" if self.axes else "one number"
            raise ConfigError(
                f"has shape {array.shape}", setting=name, value=_in_words(value),
                advice=f"give {wanted}",
            )  # fmt: skip
        return array if isinstance(value, list | tuple) else value


@dataclass(frozen=True)
class Instance:
    """Rule for an instance of given classes."""

    kinds: tuple[type, ...]

    def check(self, name: str, value: Any) -> None:
        """Raise ConfigError unless the value is of one of the classes."""
        if not isinstance(value, self.kinds):
            words = " or ".join(_with_article(kind.__name__) for kind in self.kinds)
            raise ConfigError(
                f"is of type {type(value).__name__}", setting=name, value=value,
                advice=f"give {words}",
            )  # fmt: skip


def _with_article(noun: str) -> str:
    return f"{'an' if noun[0].lower() in 'aeiou' else 'a'} {noun}"


@dataclass(frozen=True)
class Flag:
    """Rule for a Boolean, True or False."""

    def check(self, name: str, value: Any) -> None:
        """Raise ConfigError unless the value is a Boolean, of Python or of NumPy."""
        kind = getattr(getattr(value, "dtype", None), "kind", "")
        if not isinstance(value, bool) and not (kind == "b" and value.ndim == 0):
            raise ConfigError(
                "is neither true nor false", setting=name, value=_in_words(value),
                advice="use True or False",
            )  # fmt: skip


@dataclass(frozen=True)
class Either:
    """Rule for an instance of given classes, or a value that obeys another rule."""

    kinds: tuple[type, ...]
    rule: Any

    def check(self, name: str, value: Any) -> None:
        """Raise ConfigError unless the value is of one of the classes or obeys the rule."""
        if not isinstance(value, self.kinds):
            check_argument(name, value, self.rule)


Optional = functools.partial(Either, (type(None),))
"""Rule for a value that obeys another rule, or None."""


@dataclass(frozen=True)
class Several:
    """Rule for a sequence of values, each of which obeys another rule.

    Parameters
    ----------
    each : rule
        A class, or an object with a method ``check``, such as a :class:`Number`.
    least : int
        Smallest number of values.
    """

    each: Any
    least: int = 0

    def check(self, name: str, value: Any) -> None:
        """Raise ConfigError unless the value is a sequence of values that obey the rule."""
        alone = isinstance(value, str | bytes | dict) or getattr(value, "ndim", 1) == 0
        if alone or not hasattr(value, "__len__"):
            raise ConfigError("is not a sequence", setting=name, value=value, advice="give a list")
        if len(value) < self.least:
            raise ConfigError(
                f"has only {len(value)} entries", setting=name, value=value,
                advice=f"give {self.least} or more",
            )  # fmt: skip
        for one in value:
            check_argument(f"each of {name}", one, self.each)


def check_argument(name: str, value: Any, rule: Any) -> Any:
    """Return an argument if it obeys a rule, else raise ConfigError.

    A class as a rule allows its instances. Under a rule for a number, a number of NumPy is returned
    as a plain float or int; if only whole numbers are allowed, any number as an int. A list is
    returned as an array under a rule for real or for complex numbers, a tuple only under the
    latter.
    """
    if isinstance(rule, type):
        rule = Instance((rule,))
    if isinstance(rule, Either) and not isinstance(value, rule.kinds):
        return check_argument(name, value, rule.rule)
    if isinstance(rule, Number) and getattr(value, "ndim", None) == 0:
        value = value.item()  # NumPy's numbers, and arrays of one
    found = rule.check(name, value)
    plain = isinstance(rule, Number) and (rule.whole or not isinstance(value, int | float))
    return found if plain or isinstance(rule, Complex | Reals) else value


def checked(**rules: Any) -> Callable[[Callable[P, T]], Callable[P, T]]:
    """Return a decorator that checks arguments by rules before the function is called.

    Parameters
    ----------
    **rules
        Rule for each argument, by its name: a class, or an object with a method
        ``check(name, value)``, such as :class:`~acoustube.base.rules.Number` or :class:`Reals`. An
        argument that is left out, or is its default, is not checked.
    """

    def decorate(function: Callable[P, T]) -> Callable[P, T]:
        signature = inspect.signature(function)
        defaults = {n: p.default for n, p in signature.parameters.items()}
        unknown = rules.keys() - defaults.keys()
        if unknown:
            raise TypeError(f"{function.__name__} has no arguments {unknown}")

        @functools.wraps(function)
        def call(*args: P.args, **kwargs: P.kwargs) -> T:
            given = signature.bind(*args, **kwargs)
            for name, value in given.arguments.items():
                if name in rules and value is not defaults[name]:
                    given.arguments[name] = check_argument(name, value, rules[name])
            return function(*given.args, **given.kwargs)

        return call

    return decorate


def check_fields(instance: Any, **rules: Any) -> None:
    """Raise ConfigError unless the fields of a dataclass obey rules; defaults are not checked.

    Fields with a rule are set to what :func:`check_argument` returns, also if the class is frozen.

    Parameters
    ----------
    instance : object
    **rules
        As for :func:`checked`.
    """
    for name, rule in rules.items():
        value = getattr(instance, name)
        if value is not getattr(type(instance), name, inspect.Parameter.empty):
            object.__setattr__(instance, name, check_argument(name, value, rule))


def check_alike(**arrays: Any) -> None:
    """Raise ConfigError unless arrays have the same shape.

    Parameters
    ----------
    **arrays
        The arrays by name.
    """
    import numpy as np

    shapes = {name: np.shape(array) for name, array in arrays.items()}
    if len(set(shapes.values())) > 1:
        words = " and ".join(f"{name} has shape {shape}" for name, shape in shapes.items())
        raise ConfigError(f"{words}; give arrays of one shape")


SAMPLES = Reals(axes=1)
TIMES = Reals(-1e9, 1e9, "s", ndim=1)
CELSIUS = Reals(-273.15, 1e4, "degC, over absolute zero")
PLACES = Reals(-1e6, 1e6, "m", last=3, empty=True)
RATE = Number(1e-3, 1e12, "Hz")
FREQUENCY = Number(1e-3, 1e12, "Hz")
LENGTH = Number(1e-9, 1e6, "m")
BORE = Number(1e-5, 1e3, "m")
PLACE = Number(-1e6, 1e6, "m")
DISTANCE = Number(0, 1e6, "m")
SPEED = Number(1, 1e5, "m/s")
TEMPERATURE = Number(-273.15, 1e4, "degC, over absolute zero")
KELVIN = Number(0, 1e4, "K")
SECONDS = Number(-1e6, 1e6, "s")
DURATION = Number(1e-12, 1e6, "s")
FREQUENCIES = Reals(0, 1e12, "Hz")
PROMINENCE = Number(0, LARGEST)
GAPS = Reals(missing=True, empty=True)
FLAG = Flag()
REFLECTION = Complex(0, 1e3)
ONE_REFLECTION = Complex(0, 1e3, axes=0)
WAVES = Complex(1e-6, 1e12)
WAVE_SERIES = Complex(1e-6, 1e12, axes=1)
CYCLES = Number(0.1, 1e4, "cycles")
ANGLE = Number(-1e6, 1e6, "rad")
SEED = Number(0, 2**63 - 1, whole=True)
