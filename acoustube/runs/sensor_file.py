"""Files of sensors: those written by hand, and twins."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from math import inf, isfinite
from pathlib import Path
from typing import Any

import tomlkit

from acoustube.base.errors import ConfigError
from acoustube.base.foreign.documents import read_document
from acoustube.base.units import MPA, US
from acoustube.ranging import Rangefinder

KIND = "twin"
"""Name of the table that only files of twins have."""
MODULUS = "young_modulus_mpa"
"""Name of the entry with Young's modulus of the wall in a twin's file."""
OF_OTHERS = ("length_cm", "priors", "wrap")
"""Entries of a sensor's file in addition to the parameters of the rangefinder."""


def sensor_document(document: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Return the entries of a sensor's file that other commands use.

    These are the parameters of the rangefinder and the entries :data:`OF_OTHERS`. The further
    entries of a twin's file are left out.

    Raises
    ------
    ConfigError
        If the file is that of a twin, but has no rangefinder.
    """
    if KIND not in document:
        return dict(document)
    own = document.get("rangefinder")
    if not isinstance(own, dict):
        raise ConfigError(f"{path} is a twin's file without [rangefinder]; make it again")
    return own | {name: document[name] for name in OF_OTHERS if name in document}


def young_modulus(document: Mapping[str, Any], path: Path) -> tuple[float, float] | None:
    """Return Young's modulus of the wall and its standard deviation in Pa.

    None is returned if the file is not that of a twin, or its recordings do not determine it.

    Raises
    ------
    ConfigError
        If the modulus or its deviation is not a positive number.
    """
    if KIND not in document or MODULUS not in determined(document):
        return None
    found = [document.get(name) for name in (MODULUS, f"{MODULUS}_sd")]
    modulus, deviation = finite_numbers(found, path, least=1e-6, most=1e6)
    return modulus / MPA, deviation / MPA


def determined(document: Mapping[str, Any]) -> list[Any]:
    """Return the names of the parameters that a twin's file states as determined by recordings."""
    found = document.get("determined")
    return found if isinstance(found, list) else []


def finite_numbers(
    values: Iterable[Any], path: Path, *, least: float = -inf, most: float = inf
) -> list[float]:
    """Return values of a twin's file as numbers from `least` to `most`.

    Raises
    ------
    ConfigError
        If a value is not a finite number, or out of range.
    """
    found = list(values)
    for one in found:
        if not isinstance(one, int | float) or not isfinite(one) or not least <= one <= most:
            raise ConfigError(f"{path} is a damaged file of a twin; make it again")
    return [float(one) for one in found]


def add_rangefinder(table: Any, rangefinder: Rangefinder) -> None:
    """Add the parameters of a rangefinder, its drive in a table of its own, to a TOML table."""
    words = json.loads(rangefinder.to_json())
    drive = words.pop("drive")
    for name, value in (words | {"drive": drive}).items():
        table.add(name, tomlkit.item(value))


def twin_settings(path: Path) -> dict[str, Any]:
    """Return the settings of :class:`acoustube.runs.sweep.cycles.Recipe` that a twin's file states.

    Parameters
    ----------
    path : Path
        File of a sensor; the result is empty unless it is the file of a twin.

    Returns
    -------
    dict
        ``offset_deviation`` in K, ``trigger`` in s and ``reflectors``, as attributes of the recipe.

    Raises
    ------
    ConfigError
        If the file cannot be read, or the clutter, the standard deviation of the temperature or the
        trigger is not numeric.
    """
    document = read_document(path)
    if KIND not in document:
        return {}
    clutter = document.get("clutter", {})
    given = clutter.get("reflection", []) if isinstance(clutter, dict) else None
    offset = document.get("temperature_offset_c_sd", 0.0)
    reflectors = given if isinstance(given, list) else [None]
    given_trigger = document.get("trigger_us", 0.0)
    deviation, trigger, *reflection = finite_numbers((offset, given_trigger, *reflectors), path)
    return {
        "offset_deviation": min(deviation, 100.0), "reflectors": tuple(reflection),
        "trigger": trigger / US,
    }  # fmt: skip
