"""The plan of a sweep: the values of its varied settings, and the resulting cases.

Nothing heavy is imported, and cases are made one by one, so that the size of a plan of a million
cases is known in seconds.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

from acoustube.base.checks import Optional, checked
from acoustube.base.errors import ConfigError, short
from acoustube.base.names import PATH
from acoustube.base.rules import Choice, Number
from acoustube.base.version import __version__
from acoustube.runs.config import (
    Config,
    Given,
    configured,
    given_in,
    is_whole,
    read_document,
    section_of,
)
from acoustube.runs.sweep.plan_text import (
    MOST_CASES,
    Interval,
    Values,
    axis_of,
    parsed,
    to_toml_value,
)

DEFAULTS: Given = {
    "waves": {"method": "scattering", "losses": "on", "resolution": 16},
}
"""Defaults of a sweep that differ from those of a single run: scattering matrices with losses, on a
grid that gives reflection coefficients to 0.005."""

SAMPLERS = ("sobol", "latin")
COUNT = Number(1, MOST_CASES, "", "cases of a random plan", whole=True)
SEED = Number(0, 2**63 - 1, "", "seed of a random plan", whole=True)
SAMPLER = Choice(SAMPLERS, "how a random plan fills the ranges")
RANDOM: dict[str, Number | Choice] = {"count": COUNT, "sampler": SAMPLER, "seed": SEED}
"""Settings of a random plan, with their rules."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """The cases of a sweep.

    Attributes
    ----------
    given : dict
        Settings that all cases have, by section.
    over : dict of str
        The settings that vary, each with its values, or in a random plan with its `Interval`. In a
        grid the last setting varies fastest.
    cases : tuple of dict
        The settings of each case that vary, in place of `over`.
    count : int
        Number of cases of a random plan; 0 for a grid.
    sampler : {"sobol", "latin"}
        Method by which a random plan fills the ranges: Sobol points or a Latin hypercube.
    seed : int
        Seed of a random plan.

    Raises
    ------
    ConfigError
        If a setting is not known, values are missing or repeated, there are too many cases, or both
        `over` and `cases` are given.
    """

    given: Given = field(default_factory=dict)
    over: Mapping[str, Values | Interval] = field(default_factory=dict)
    cases: tuple[Mapping[str, Any], ...] = ()
    count: int = 0
    sampler: str = "sobol"
    seed: int = 0

    def __post_init__(self) -> None:
        if self.over and self.cases:
            raise ConfigError("a plan has [sweep.over] or a list of [[sweep.case]]; give one")
        COUNT.check("count", self.count or 1)
        SEED.check("seed", self.seed)
        SAMPLER.check("sampler", self.sampler)
        if len(self) > MOST_CASES:
            raise ConfigError(f"the plan has {len(self):.3g} cases; use at most {MOST_CASES:.0e}")
        for name, values in self.over.items():
            section_of(name)
            _check_axis(name, values, random=self.count > 0)
        for case in self.cases:
            for name in case:
                section_of(name)

    def __len__(self) -> int:
        if self.cases:
            return len(self.cases)
        return self.count or math.prod(len(values) for values in self._axes.values())

    def distinct(self, names: Sequence[str]) -> int:
        """Return the number of distinct combinations of the values that some settings have."""
        import numpy as np

        if not (self.cases or self.count):
            return math.prod(len(v) for n, v in self._axes.items() if n in names)
        columns = [np.array(v, str) for n, v in self.columns().items() if n in names]
        codes = [np.unique(column, return_inverse=True)[1] for column in columns]
        return np.unique(np.stack(codes), axis=1).shape[1] if codes else 1

    @property
    def _axes(self) -> dict[str, Values]:
        return {n: v for n, v in self.over.items() if not isinstance(v, Interval)}

    def columns(self) -> dict[str, Any]:
        """Return the values of each varied setting, (n_cases,); None in cases without it."""
        import numpy as np

        if self.cases:
            names = {name: None for case in self.cases for name in case}
            return {name: [case.get(name) for case in self.cases] for name in names}
        if self.count:
            return _sampled(self)
        sizes = [len(values) for values in self._axes.values()]
        if not sizes:
            return {}
        places = np.unravel_index(np.arange(math.prod(sizes)), sizes)
        return {
            name: np.array(values)[place]
            for (name, values), place in zip(self._axes.items(), places, strict=True)
        }

    def configs(self, numbers: Sequence[int] | None = None) -> Iterator[Config]:
        """Yield the settings of each case, or of the cases with given numbers, from 0.

        Raises
        ------
        ConfigError
            If a case is not valid; the message names its varied settings.
        """
        columns = self.columns()
        for i in range(len(self)) if numbers is None else numbers:
            given = {name: values[i] for name, values in columns.items()}
            # Scalars of NumPy are converted to Python's.
            varied = {n: v.item() if hasattr(v, "item") else v for n, v in given.items()}
            try:
                yield configured(self.given, **varied)
            except ConfigError as error:
                words = ", ".join(f"{name} = {value}" for name, value in varied.items())
                where = f"case {i + 1} ({words}): " if words else ""
                raise ConfigError(f"{where}{error}") from error


def _check_axis(name: str, values: Values | Interval, *, random: bool) -> None:
    if isinstance(values, Interval):
        if not random:
            raise ConfigError(
                f"{name} = {values} is a range without a step; give {values}:STEP or, in a sweep, "
                "the number of random cases, count (--random)"
            )
        if not -math.inf < values.low < values.high < math.inf:
            raise ConfigError(f"{name} = {values} must have low < high")
        if is_whole(name) and math.ceil(values.low) > math.floor(values.high):
            raise ConfigError(f"{name} = {values} holds no whole number; give a wider range")
    elif not values:
        raise ConfigError(f"{name} has no values, so that the plan has no cases; give one or more")
    elif not all(isinstance(value, int | float | str) for value in values):
        raise ConfigError(f"{name} = {list(values)} must be numbers or words")
    elif len(set(values)) < len(values):
        raise ConfigError(f"{name} has the same value twice; give each once")


def _sampled(plan: Plan) -> dict[str, Any]:
    """Return random values of each setting of a plan.

    The values of a list, and the whole numbers within a range, are equally frequent.
    """
    import warnings

    import numpy as np
    from scipy.stats import qmc

    engine = {"sobol": qmc.Sobol, "latin": qmc.LatinHypercube}[plan.sampler]
    drawn = engine(len(plan.over) or 1, seed=np.random.default_rng(plan.seed))
    with warnings.catch_warnings():
        # A number of cases that is not a power of two, with less even points, is allowed.
        warnings.simplefilter("ignore", UserWarning)
        points = drawn.random(plan.count)
    found = {}
    for (name, values), share in zip(plan.over.items(), points.T, strict=False):
        if not isinstance(values, Interval):
            found[name] = np.array(values)[_places(share, len(values))]
        elif is_whole(name):
            first, last = math.ceil(values.low), math.floor(values.high)
            found[name] = first + _places(share, last - first + 1)
        else:
            found[name] = np.round(values.low + share * (values.high - values.low), 6)
    return found


def _places(share: Any, count: int) -> Any:
    """Return the indices of the `count` equal parts of [0, 1] in which the values `share` lie."""
    import numpy as np

    return np.minimum((share * count).astype(int), count - 1)


@checked(path=Optional(PATH), over=Optional(Mapping))
def load_plan(
    path: str | Path | None = None,
    over: Mapping[str, Sequence[str]] | None = None,
    **given: Any,
) -> Plan:
    """Build a plan from the defaults, overridden by a file and then by the command line.

    Parameters
    ----------
    path : str or path, optional
        A TOML file with the sections of :func:`acoustube.load_config`, which all cases share, and
        ``[sweep.over]`` with settings that vary, or a list of ``[[sweep.case]]``; ``[sweep]`` may
        have ``count``, ``sampler`` and ``seed``.
    over : mapping of str to sequence of str, optional
        Settings that vary, with texts for :func:`acoustube.runs.sweep.plan_text.parsed`; they
        override the file. A setting with one value is shared by all cases.
    **given
        ``count``, ``sampler``, ``seed``; None means not given.

    Raises
    ------
    ConfigError
        If the file cannot be read, or a name or a value is wrong.
    """
    document = read_document(Path(path)) if path is not None else {}
    sweep = _checked_section(path, document.pop("sweep", {}))
    document.pop("acoustube_version", None)
    shared = given_in(Path(path), document) if path is not None else {}
    axes = {name: axis_of(path, name, values) for name, values in sweep.get("over", {}).items()}
    cases = tuple(sweep.get("case", ()))
    if "case" in sweep and not cases:
        raise ConfigError(f"{path}: [[sweep.case]] is empty and so the plan has no cases; add some")
    for name, words in (over or {}).items():
        if not isinstance(words, list | tuple) or any(not isinstance(w, str) for w in words):
            raise ConfigError(
                f"over has {short(words)} for {short(name)}; give a list of texts such as ['1:8:1']"
            )
        if any(name in case for case in cases):
            raise ConfigError(f"{name} is given by the cases of {path}; leave the option out")
        values = parsed(name, words)
        axes.pop(name, None)
        if isinstance(values, tuple) and len(values) == 1:
            shared.setdefault(section_of(name), {})[name] = values[0]
        else:
            axes[name] = values
    numbers = {name: sweep[name] for name in RANDOM if name in sweep}
    numbers |= {name: value for name, value in given.items() if value is not None}
    numbers = {name: RANDOM[name].check(name, value) for name, value in numbers.items()}
    for name in ("sampler", "seed"):
        if name in numbers and "count" not in numbers:
            raise ConfigError(
                f"{name} = {numbers[name]} is of a random plan; give count, its number of cases, "
                "with --random, or leave it out"
            )
    for section, defaults in DEFAULTS.items():
        shared[section] = defaults | shared.get(section, {})
    for section in shared:
        shared[section] = {n: v for n, v in shared[section].items() if n not in axes}
    if numbers.get("count") and not axes:
        raise ConfigError("a random plan needs a range; give one, such as 1:8 for depth_mm")
    return Plan(given=shared, over=axes, cases=cases, **numbers)


def _checked_section(path: Any, sweep: Any) -> dict[str, Any]:
    """Return the section [sweep] of a file; raise if the section is wrong."""
    known = ("over", "case", *RANDOM)
    if not isinstance(sweep, dict):
        raise ConfigError(f"{path}: sweep must be a section, written [sweep] or [sweep.over]")
    for name, value in sweep.items():
        if name not in known:
            raise ConfigError(
                f"{path}: [sweep] {name} is not a setting; use one of {', '.join(known)}"
            )
        if name == "over" and not isinstance(value, dict):
            raise ConfigError(f"{path}: over must be a section, written [sweep.over]")
        if name == "case" and not (
            isinstance(value, list) and all(isinstance(case, dict) for case in value)
        ):
            raise ConfigError(f"{path}: case must be a list of sections, written [[sweep.case]]")
    for name in chain(sweep.get("over", ()), *sweep.get("case", ())):
        try:
            section_of(name)
        except ConfigError as error:
            raise ConfigError(f"{path}: {error}") from error
    return sweep


def to_toml(plan: Plan) -> str:
    """Return a plan as a TOML document that :func:`load_plan` reads back unchanged."""
    import tomlkit

    document = tomlkit.document()
    document.add("acoustube_version", __version__)
    document.add(tomlkit.nl())
    for section, values in plan.given.items():
        if values:
            document.add(section, tomlkit.item({n: to_toml_value(v) for n, v in values.items()}))
            document.add(tomlkit.nl())
    sweep: dict[str, Any] = {}
    if plan.count:
        sweep |= {"count": plan.count, "sampler": plan.sampler, "seed": plan.seed}
    if plan.over:
        sweep["over"] = {name: to_toml_value(values) for name, values in plan.over.items()}
    if plan.cases:
        sweep["case"] = [{n: to_toml_value(v) for n, v in case.items()} for case in plan.cases]
    document.add("sweep", tomlkit.item(sweep))
    return tomlkit.dumps(document)


def case_name(config: Config) -> str:
    """Return the name of a case: the first 16 digits of the hash of its settings."""
    return digest(dataclasses.asdict(config))[:16]


def tube_name(config: Config) -> str:
    """Return the name of a tube: the first 8 digits of the hash of its settings."""
    return digest(dataclasses.asdict(config.tube))[:8]


def digest(content: Any) -> str:
    """Return the SHA-256, in hexadecimal, of data as JSON with sorted names."""
    text = json.dumps(content, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
