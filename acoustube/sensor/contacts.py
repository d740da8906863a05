"""Contacts of a simulation: their validation, and the conversion between depth and force."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.base.types import Array
from acoustube.base.units import CM, MM
from acoustube.sensor.tables import PressTables

HALF_PRESS = 0.015
"""Half the length in m of tube that a contact deforms."""
SAME = 1e-6
"""Largest difference of diameters that count as equal, relative to the difference between the
diameters of adjacent tools."""


@dataclass(frozen=True, kw_only=True)
class Contact:
    """One contact with the tube.

    Attributes
    ----------
    place : float
        Distance from the source end in m.
    depth : float or None
        Indentation depth from first contact in m.
    force : float or None
        Contact force in N, in place of the depth.
    diameter : float or None
        Diameter of the tool in m; None for the only tool of a library.

    Raises
    ------
    ConfigError
        If not exactly one of depth and force is given, or a value is outside its range.
    """

    place: float
    depth: float | None = None
    force: float | None = None
    diameter: float | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        Number(0, 1e3, "m").check("place", self.place)
        for name, most, unit in (("depth", 1.0, "m"), ("force", 1e6, "N"), ("diameter", 1.0, "m")):
            if (value := getattr(self, name)) is not None:
                Number(0, most, unit).check(name, value)
        if (self.depth is None) == (self.force is None):
            raise ConfigError(
                f"a contact at {self.place:g} m has depth {self.depth} and force {self.force}; "
                "give one of them"
            )


def contact_arrays(
    tables: PressTables, contacts: Sequence[Contact], most: int
) -> tuple[Array, Array, Array]:
    """Return places, depths and diameters of contacts in m, each (1, most).

    Columns beyond the given contacts have place and depth 0.

    Raises
    ------
    ConfigError
        If there are more than `most` contacts, a force or a diameter is outside the library's
        range, or a diameter is missing and there are several tools.
    """
    if len(contacts) > most:
        raise ConfigError(
            f"{len(contacts)} contacts are more than most_contacts = {most}; make a sensor for more"
        )
    place, depth = np.zeros((2, 1, most))
    diameter = np.full((1, most), tables.diameters[0])
    for i, one in enumerate(contacts):
        place[0, i], diameter[0, i] = one.place, diameter_of(tables, one.diameter)
        depth[0, i] = (
            one.depth if one.depth is not None else depth_at(tables, one.force or 0, one.diameter)
        )
    return place, depth, diameter


def diameter_of(tables: PressTables, diameter: float | None) -> float:
    """Return a tool's diameter in m; for None, that of the library's only tool.

    Raises
    ------
    ConfigError
        If the diameter is outside the library's range, or None and there are several tools.
    """
    known = tables.diameters
    words = " and ".join(f"{MM * one:g}" for one in known)
    if diameter is None:
        if len(known) > 1:
            raise ConfigError(
                f"the library has indenters of {words} mm; state the contact's diameter"
            )
        return float(known[0])
    Number(0, 1.0, "m").check("diameter", diameter)
    if not known[0] * (1 - 1e-6) <= diameter <= known[-1] * (1 + 1e-6):
        raise ConfigError(
            f"an indenter of diameter {MM * diameter:g} mm is not in the library, which has "
            f"{words} mm; make one with acoustube library --indenter"
        )
    return float(diameter)


def force_at(tables: PressTables, depth: float, diameter: float | None) -> float:
    """Return the force in N of a tool at a depth in m; `diameter` as in :func:`diameter_of`.

    Raises
    ------
    ConfigError
        If the depth or the diameter is outside the library's range.
    """
    known, forces = _path(tables, diameter)
    Number(0, float(known[-1]), "m").check("depth", depth)
    return float(np.interp(depth, known, forces))


def depth_at(tables: PressTables, force: float, diameter: float | None) -> float:
    """Return the depth in m at which a tool exerts a force in N.

    `diameter` is as in :func:`diameter_of`.

    Raises
    ------
    ConfigError
        If the force or the diameter is outside the library's range.
    """
    known, forces = _path(tables, diameter)
    Number(0, float(forces[-1]), "N").check("force", force)
    return float(np.interp(force, forces, known))


def _path(tables: PressTables, diameter: float | None) -> tuple[Array, Array]:
    """Return depths in m and forces in N of a tool, for any diameter between those of two tools."""
    size = diameter_of(tables, diameter)
    low, high, weight = _neighbours(tables, np.array(size))
    paths = []
    for tool in (int(low), int(high)):
        n = int(np.isfinite(tables.depths[tool]).sum())
        paths.append((tables.depths[tool, :n], tables.forces[tool, :n]))
    depth = np.unique(np.concatenate([path[0] for path in paths]))
    depth = depth[depth <= min(path[0][-1] for path in paths)]
    forces = [np.interp(depth, *path) for path in paths]
    return depth, (1 - weight) * forces[0] + weight * forces[1]


def _neighbours(
    tables: PressTables, diameter: Array
) -> tuple[NDArray[np.integer[Any]], NDArray[np.integer[Any]], Array]:
    """Return the indices of the tools below and above diameters, and the weights of the latter.

    At the diameter of a tool, both are that tool.
    """
    known = tables.diameters
    low = np.clip(np.searchsorted(known, diameter, side="right") - 1, 0, max(len(known) - 2, 0))
    high = np.minimum(low + 1, len(known) - 1)
    width = np.where(high > low, known[high] - known[low], 1.0)
    weight = np.clip((diameter - known[low]) / width, 0, 1)
    first, second = weight < SAME, weight > 1 - SAME
    return np.where(second, high, low), np.where(first, low, high), weight


def check_contacts(
    tables: PressTables,
    place: Array,
    depth: Array,
    diameter: Array,
    span: tuple[float, float],
    apart: float,
) -> None:
    """Check that contacts lie within the ranges of tube and library, and apart from each other.

    Parameters
    ----------
    tables : PressTables
    place, depth, diameter : ndarray
        Of the contacts in m, (n, n_contacts); contacts of depth 0 are ignored.
    span : (float, float)
        Nearest and farthest place in m.
    apart : float
        Least distance between two contacts in m.

    Raises
    ------
    ConfigError
        If a contact is outside these ranges, or too close to another.
    """
    there = depth > 0
    low, high, _ = _neighbours(tables, diameter)
    most = np.minimum(tables.deepest[low], tables.deepest[high])
    known = tables.diameters[[0, -1]] * (1 - 1e-6, 1 + 1e-6)
    for wrong, words in (
        (there & ((diameter < known[0]) | (diameter > known[1])), "diameter"),
        (there & (depth > most * (1 + 1e-6)), "depth"),
        (there & ((place < span[0]) | (place > span[1])), "place"),
    ):  # fmt: skip
        if np.any(wrong):
            i = tuple(np.argwhere(wrong)[0])
            if words == "diameter":
                diameter_of(tables, float(diameter[i]))
            if words == "depth":
                Number(0, float(most[i]), "m", "of the library").check("depth", depth[i])
            Number(*span, "m", "where the tube can be pressed").check("place", place[i])
    ordered = np.sort(np.where(there, place, np.inf), axis=1)
    between = np.diff(np.where(np.isfinite(ordered), ordered, 1e9), axis=1)
    near = (between < apart) & np.isfinite(ordered[:, 1:])
    if np.any(near):
        row, i = np.argwhere(near)[0]
        a, b = CM * ordered[row, i : i + 2]
        raise ConfigError(
            f"contacts at {a:.4g} and {b:.4g} cm meet; place them {CM * apart:g} cm apart "
            "or farther"
        )
