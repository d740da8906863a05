"""Positions of motion-capture markers on a sleeve, from CSV and C3D files.

A text table has one marker per row and names its columns: ``column``, the column of markers that it
belongs to; ``x``, ``y``, ``z``, or ``x_mm`` and so on; and, if there are several frames,
``marker``. In a C3D file the letters of a marker's label name its column: A1, A2, ..., B1, B2.
"""

from __future__ import annotations

import csv
import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from acoustube.base.errors import ConfigError
from acoustube.base.foreign import child
from acoustube.base.foreign.limits import check_file, reading
from acoustube.base.types import Array
from acoustube.recordings.tables import plain

UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
DEFAULT_UNIT = "mm"
"""Unit of motion capture, for files that do not state one."""
GAP_CELLS = {"", "nan", "na", "none", "-"}

# Coordinates of each frame, by column and marker.
Rows = dict[str, dict[str, list[Array]]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Markers:
    """Two columns of markers.

    Attributes
    ----------
    first, second : ndarray
        Coordinates in m, (n, 3), in the order of the file; gaps are nan.
    names : tuple of str
        Names of the columns.
    unit : str
        Unit of the file's coordinates: ``mm``, ``cm`` or ``m``.
    unit_stated : bool
        True if the file, or the caller, stated the unit.
    """

    first: Array
    second: Array
    names: tuple[str, str]
    unit: str
    unit_stated: bool


def read_markers(
    path: str | Path, *, unit: str | None = None, columns: Sequence[str] | None = None
) -> Markers:
    """Read two columns of markers.

    Parameters
    ----------
    path : str or path
        A C3D file, or a text table with commas, semicolons or tabs.
    unit : str, optional
        ``mm``, ``cm`` or ``m``; by default that which the file states, or else mm.
    columns : sequence of str, optional
        The names of the two columns, where the file has others too.

    Returns
    -------
    Markers
        Median position of each marker over the frames.

    Raises
    ------
    ConfigError
        If `unit` is unknown, the file is missing, too large, cannot be read, states another unit
        with no `unit` given, or does not have two columns, or the package ezc3d, which reads C3D,
        is missing.
    """
    path = Path(path)
    if unit is not None and unit not in UNITS:
        raise ConfigError(f"unit = {unit!r} is not a unit of markers; use mm, cm or m")
    if not path.exists():
        raise ConfigError(f"{path} does not exist; give the name of a table or C3D file of markers")
    check_file(path, "markers")
    with reading(
        path, "cannot be read as markers", "it is damaged or of another kind: export it again"
    ):
        rows, own = (_from_c3d if path.suffix.lower() == ".c3d" else _from_table)(path)
    if unit is None and own is not None and own not in UNITS:
        raise ConfigError(
            f"{path} states the unit {own}; state its true unit by unit (--unit): mm, cm or m, or "
            "convert it to one of these"
        )
    first, second = names = _column_names(rows, columns, path)
    known = unit or own
    scale = UNITS[known or DEFAULT_UNIT]
    return Markers(
        first=scale * _median_positions(rows[first]),
        second=scale * _median_positions(rows[second]),
        names=names,
        unit=known or DEFAULT_UNIT,
        unit_stated=known is not None,
    )


def _column_names(rows: Rows, wanted: Sequence[str] | None, path: Path) -> tuple[str, str]:
    """Return the names of the two columns."""
    names = tuple(wanted) if wanted is not None else tuple(rows)
    found = ", ".join(rows) or "none"
    if len(names) == 2 and names[0] == names[1]:
        raise ConfigError(
            "is one column twice", setting="columns", value=", ".join(names),
            advice=f"name two of {found}",
        )  # fmt: skip
    if len(names) != 2 or not set(names) <= set(rows):
        missing = [name for name in names if name not in rows]
        wrong = f"has no column {missing[0]}; it has" if missing else "has columns of markers named"
        raise ConfigError(
            f"{path} {wrong} {found}, and two are needed; name them by columns (--columns)"
        )
    return names[0], names[1]


def _median_positions(column: dict[str, list[Array]]) -> Array:
    """Return the median position (n, 3) of each marker, nan for a marker that is in no frame."""
    found = []
    for frames in column.values():
        seen = np.array([frame for frame in frames if np.all(np.isfinite(frame))])
        found.append(np.median(seen, axis=0) if len(seen) else np.full(3, np.nan))
    return np.array(found)


def _from_table(path: Path) -> tuple[Rows, str | None]:
    """Return the markers of a text table, and the unit that it states, if any."""
    with path.open(encoding="utf-8-sig", newline="") as file:
        lines = [line for line in file if line.strip() and not line.startswith("#")]
    if not lines:
        raise ConfigError(f"{path} is empty; its first row should be column, x, y, z")
    separator = next((s for s in "\t;" if s in lines[0]), ",")
    header, *cells = csv.reader(lines, delimiter=separator)
    places, unit = _header([plain(name) for name in header], path)
    rows: Rows = {}
    fresh = (f"row {n}" for n in itertools.count(1))
    for number, row in enumerate(cells, start=2):
        if len(row) < len(header):
            raise ConfigError(
                f"{path}: row {number} has {len(row)} cells for {len(header)} columns"
            )
        column = row[places["column"]].strip()
        marker = row[places["marker"]].strip() if "marker" in places else next(fresh)
        values = [_number(row[places[axis]], f"{path}: row {number}") for axis in "xyz"]
        rows.setdefault(column, {}).setdefault(marker, []).append(np.array(values))
    return rows, unit


def _header(names: list[str], path: Path) -> tuple[dict[str, int], str | None]:
    """Return the index of each column by its name, and the unit in the names of x, y, z, if any."""
    places: dict[str, int] = {}
    units = set()
    for i, name in enumerate(names):
        match = re.fullmatch(r"([xyz])(?:_(mm|cm|m))?", name)
        if match:
            places[match[1]] = i
            units.add(match[2])
        elif name in ("column", "marker"):
            places[name] = i
    missing = [name for name in ("column", "x", "y", "z") if name not in places]
    if missing:
        raise ConfigError(
            f"{path} lacks {', '.join(missing)} in its first row, which should be column, x_mm, "
            "y_mm, z_mm"
        )
    if len(units) > 1:
        raise ConfigError(f"{path} has x, y and z in different units; use one unit")
    return places, units.pop()


def _number(cell: str, where: str) -> float:
    """Return a cell as a number, nan for a gap."""
    if cell.strip().casefold() in GAP_CELLS:
        return float("nan")
    try:
        return float(cell)
    except ValueError:
        raise ConfigError(
            f"{where} holds {cell!r}, which is not a number; leave gaps empty"
        ) from None


def _from_c3d(path: Path) -> tuple[Rows, str | None]:
    """Return the markers of a C3D file, and the unit that it states, if any."""
    try:
        found = {label["name"]: value for label, value in child.read("c3d", path, "markers")}
    except child.MissingPackage:
        raise ConfigError(
            f"{path} needs the package ezc3d; run pip install 'acoustube[c3d]', or save the "
            "markers as CSV"
        ) from None
    unit = found["unit"].strip().lower() or None
    rows: Rows = {}
    for label, places in zip(found["labels"], np.moveaxis(found["points"], 0, -1), strict=True):
        # Vicon puts the subject before the label, as in arm:A1.
        name = label.strip().rpartition(":")[2]
        rows.setdefault(name.rstrip("0123456789 _-"), {})[name] = list(places)
    return rows, unit
