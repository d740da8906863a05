"""Files of sensors: those written by hand, and twins."""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any

from acoustube.base.errors import ConfigError
from acoustube.base.foreign.documents import read_document
from acoustube.base.units import MPA

KIND = "twin"
"""Name of the table that only files of twins have."""
MODULUS = "young_modulus_mpa"
OF_OTHERS = ("length_cm", "priors")
"""What such a file states besides the rangefinder."""


def sensor_document(document: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Return the content of a sensor's file, of a twin's what other commands use of it.

    Parameters
    ----------
    document : mapping
        Content of the file.
    path : Path
        For messages.

    Raises
    ------
    ConfigError
        If it is a twin's file without its rangefinder.
    """
    if KIND not in document:
        return dict(document)
    own = document.get("rangefinder")
    if not isinstance(own, dict):
        raise ConfigError(f"{path} is a twin's file without [rangefinder]; make it again")
    found = dict(own)
    for name in OF_OTHERS:
        if name in document:
            found[name] = document[name]
    return found


def young_modulus(document: Mapping[str, Any], path: Path) -> tuple[float, float] | None:
    """Return Young's modulus of the wall in Pa, and its deviation, if presses told a twin it.

    Parameters
    ----------
    document : mapping
        Content of the file.
    path : Path
        For messages.

    Raises
    ------
    ConfigError
        If they are not positive numbers.
    """
    told = document.get("determined", [])
    if KIND not in document or not isinstance(told, list) or MODULUS not in told:
        return None
    found = [document.get(name) for name in (MODULUS, f"{MODULUS}_sd")]
    good = [one / MPA for one in found if isinstance(one, int | float) and 0 < one < 1e6]
    if len(good) < len(found):
        raise ConfigError(f"{path} is a damaged file of a twin; make it again")
    return good[0], good[1]


def twin_settings(path: Path) -> dict[str, Any]:
    """Return the settings of :class:`acoustube.runs.sweep.cycles.Recipe` that a twin's file states.

    Parameters
    ----------
    path : Path
        File of a sensor; of another than a twin nothing is returned.

    Raises
    ------
    ConfigError
        If its clutter or the deviation of its temperature is not of numbers.
    """
    document = read_document(path)
    if KIND not in document:
        return {}
    clutter = document.get("clutter", {})
    given = clutter.get("reflection", []) if isinstance(clutter, dict) else None
    deviation = document.get("temperature_offset_c_sd", 0.0)
    reflectors = given if isinstance(given, list) else [None]
    if not all(isinstance(one, int | float) and isfinite(one) for one in (deviation, *reflectors)):
        raise ConfigError(f"{path} is a damaged file of a twin; make it again")
    return {"offset_deviation": min(deviation, 100.0), "reflectors": tuple(map(float, reflectors))}
