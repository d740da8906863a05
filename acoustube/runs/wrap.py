"""Curvature of tubes that are wrapped around forearms, from a sleeve or the file of a sensor."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from acoustube.base.errors import ConfigError
from acoustube.base.rules import Choice, Number, nearest
from acoustube.base.units import CM, MM
from acoustube.inversion import Wrap
from acoustube.sleeve import Helix, design
from acoustube.sleeve.helix import HANDS

NODES = 9
"""Number of positions with a stated curvature. Curvature varies by a third along a forearm."""
FOREARM = "forearm_cm"
"""Entry of ``[wrap]`` with the values of :data:`SIZES`."""
SIZES = (
    ("length of the forearm", Number(3, 150, "cm", "under the sleeve")),
    ("first girth of the forearm", Number(8, 150, "cm", "near the sensor")),
    ("second girth of the forearm", Number(8, 150, "cm", "at the other end")),
)
"""Sizes of a forearm: name and allowed range of each."""
WINDING: dict[str, Any] = {
    "loops": Number(0.25, 100, "", "turns of the tube"),
    "pitch_cm": Number(0.5, 100, "cm", "advance per turn"),
    "lead_cm": Number(0, 1000, "cm", "tube between sensor and sleeve"),
    "tube_diameter_mm": Number(1, 50, "mm", "outer"),
    "hand": Choice(tuple(HANDS)),
}
"""Further entries of ``[wrap]``: the options of ``acoustube sleeve`` that determine curvature."""
LONGEST = 100.0
"""Longest tube in m."""


def wrap_of(helix: Helix) -> Wrap:
    """Return curvature and torsion of a tube of a sleeve at :data:`NODES` positions along it."""
    place = np.linspace(helix.lead, helix.tube_length, NODES)
    curvature, torsion = helix.bend(helix.height(place))
    return Wrap(place=place, curvature=curvature, torsion=torsion)


def read_wrap(table: Any, path: Path) -> Wrap:
    """Return curvature and torsion of the tube that ``[wrap]`` of a sensor's file describes.

    Parameters
    ----------
    table : mapping
        ``forearm_cm``; ``loops`` or ``pitch_cm``; optionally ``lead_cm``, ``tube_diameter_mm`` and
        ``hand``, with the defaults of ``acoustube sleeve``.
    path : Path
        File of the sensor, for messages.

    Raises
    ------
    ConfigError
        If a name or a value is wrong, or the tube cannot be wound in this way.
    """
    if not isinstance(table, Mapping):
        raise ConfigError(f"{path}: wrap = {table!r} must be a section, written [wrap]")
    known = (FOREARM, *WINDING)
    for name in table:
        if name not in known:
            raise ConfigError(f"{path}: [wrap] {name} is not known{nearest(name, known)}")
    try:
        given = {name: WINDING[name].check(name, table[name]) for name in WINDING if name in table}
        length, *girths = _forearm(table.get(FOREARM))
        options = {
            name: given[words] / unit
            for name, words, unit in (
                ("pitch", "pitch_cm", CM), ("lead", "lead_cm", CM),
                ("outer_diameter", "tube_diameter_mm", MM), ("loops", "loops", 1.0),
            )
            if words in given
        }  # fmt: skip
        if "hand" in given:
            options["hand"] = given["hand"]
        (tube,) = design(length, (girths[0], girths[1]), n_tubes=1, reach=LONGEST, **options)
        return wrap_of(tube)
    except ConfigError as error:
        raise ConfigError(f"{path}: [wrap] {error}") from error


def _forearm(sizes: Any) -> list[float]:
    """Return the length and both girths of a forearm in m; raise if a size is wrong."""
    if not isinstance(sizes, list) or len(sizes) != len(SIZES):
        raise ConfigError(
            f"needs {FOREARM} = [26, 18, 26.6], say: length of the sleeve, and girths of the arm "
            "at the end near the sensor and at the other"
        )
    checked = zip(SIZES, sizes, strict=True)
    return [float(rule.check(name, size)) / CM for (name, rule), size in checked]
