"""Text tables of measured signals, and the names of quantities in files of any kind."""

from __future__ import annotations

import contextlib
import csv
import itertools
import re
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acoustube.base.errors import ConfigError
from acoustube.base.foreign import limits
from acoustube.base.sampling import sampling_rate

LONGEST_ROW = 1 << 24
"""Largest number of characters of a row that are read before its columns are counted."""

# Arrays and single values by the name that they have in the file, and at most one Note.
Contents = dict[str, Any]


class Note(str):
    """Remark on how a file was read; its type distinguishes it from the file's contents."""


_METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_HERTZ = {"Hz": 1.0, "kHz": 1e3, "MHz": 1e6}
_QUANTITIES: dict[str, tuple[str, dict[str, float]]] = {
    "signal": (
        "signals recording recordings waveform waveforms samples data adc pressure voltage value",
        {},
    ),
    "time": ("times t", {"s": 1.0, "ms": 1e-3, "us": 1e-6}),
    "sampling_rate": ("sample_rate sampling_frequency sample_frequency rate fs", _HERTZ),
    "temperature": ("temperatures temp air_temperature", dict.fromkeys(("degC", "C"), 1.0)),
    "samples_per_cycle": ("", {}),
    "true_distance": ("distance", _METRES),
    "depth": ("indentation_depth", _METRES),
    "force": ("contact_force", {"N": 1.0, "mN": 1e-3}),
    "diameter": ("indenter_diameter", _METRES),
}
_OTHER_WORDS = {
    "m": "meter meters metre metres",
    "cm": "centimeter centimeters centimetre centimetres",
    "mm": "millimeter millimeters millimetre millimetres",
    "s": "sec second seconds",
    "ms": "msec millisecond milliseconds",
    "us": "usec microsecond microseconds",
    "Hz": "hertz 1_s s_1 sps s_s sa_s samples_s samples_per_second",
    "kHz": "kilohertz ksps ks_s ksa_s",
    "MHz": "megahertz msps ms_s msa_s",
    "degC": "celsius deg_c degree_c degrees_c degree_celsius degrees_celsius",
    "N": "newton newtons",
    "mN": "millinewton millinewtons",
}
"""Other words for a unit, in lower case with underscores, as :func:`plain` returns them."""
_NO_UNIT = {"", "1", "unknown", "none"}
"""Units, in lower case, that state nothing: the quantity is then in SI units or degC."""
_MEANINGS = {
    form + end: (quantity, scale)
    for quantity, (others, units) in _QUANTITIES.items()
    for name in (quantity, *others.split())
    for form in (name, name.replace("_", ""))
    for end, scale in [
        ("", 1.0),
        *(
            (f"_{word}", scale)
            for unit, scale in units.items()
            for word in (unit.lower(), *_OTHER_WORDS.get(unit, "").split())
        ),
    ]
}
_COUNTING_COLUMNS = {"", "index", "cycle", "sample", "n", "i"}
"""Names of index columns, which contain row numbers and no data."""


def plain(name: str) -> str:
    """Return a name in lower case with underscores: ``Depth (mm)`` becomes ``depth_mm``."""
    letters = name.casefold().replace("μ", "u").replace("℃", "c")
    return re.sub(r"[^a-z0-9]+", "_", letters).strip("_")


def meaning(name: str) -> tuple[str, float]:
    """Return the quantity that a name denotes, and the factor from its unit to SI or degC.

    Parameters
    ----------
    name : str
        Such as ``fs``, ``Temperature (°C)`` or ``depth_mm``.

    Returns
    -------
    str, float
        Such as ``depth`` and 0.001; an empty name and 1 for an unknown one.
    """
    return _MEANINGS.get(plain(name), ("", 1.0))


def with_unit(path: Path, name: str, unit: str | None) -> str:
    """Return the name of a value with the unit that its file states for it.

    Parameters
    ----------
    path : Path
        For messages.
    name : str
        Name of the value in the file.
    unit : str or None
        Such as ``mm``; None if the file states none. Of several words that are no unit together,
        the first is the unit.

    Returns
    -------
    str
        Such as ``depth_mm``; `name` if it is not that of a quantity with units, if it already
        contains a unit, or if `unit` states nothing.

    Raises
    ------
    ConfigError
        If the unit is not one of those of the quantity.
    """
    words = (unit or "").split()
    if not _lacks_unit(name) or not words or words[0].lower() in _NO_UNIT:
        return name
    for stated in (" ".join(words), words[0]):
        if plain(stated) and meaning(f"{name}_{stated}")[0]:
            return f"{name}_{stated}"
    *others, last = _QUANTITIES[meaning(name)[0]][1]
    raise ConfigError(
        f"{path} states {name} in {' '.join(words)[:40]}; use {', '.join(others)} or {last}"
    )


def _lacks_unit(name: str) -> bool:
    """Return whether a name is that of a quantity with units, and contains none of them."""
    quantity = meaning(name)[0]
    units = _QUANTITIES[quantity][1] if quantity else {}
    return any(meaning(f"{name}_{unit}")[0] for unit in units)  # depth_mm_mm has no meaning


def separate_known(contents: Mapping[str, Any]) -> tuple[Contents, Contents]:
    """Return known quantities in SI units and degC, and the others under their own names."""
    known: Contents = {}
    others: Contents = {}
    contents = {name.replace("/", "_"): v for name, v in contents.items() if name != "cycle"}
    # The names of this package take precedence over their synonyms, and stated units over none.
    for name, value in sorted(contents.items(), key=lambda one: _order(one[0])):
        quantity, scale = meaning(name)
        if not quantity or quantity in known or (quantity == "signal" and np.ndim(value) == 0):
            others[name] = value
        else:
            known[quantity] = value if scale == 1 else _scaled(name, value, scale)
    return known, others


def _order(name: str) -> tuple[bool, bool]:
    """Return a sorting key: whether a name is unknown or a synonym, and whether it lacks a unit."""
    quantity = meaning(name)[0]
    return not quantity or not name.startswith(quantity), _lacks_unit(name)


def _scaled(name: str, value: Any, scale: float) -> NDArray[np.float64]:
    try:
        return np.asarray(value, float) * scale
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{name} = {value!r} is not a number; correct it") from error


def read_table(path: Path) -> Contents:
    """Read a text table of cycles.

    Parameters
    ----------
    path : Path
        Columns separated by tabs, semicolons or commas; with semicolons or tabs, the decimal sign
        may be a comma. The first row may name the columns; lines before it that begin with ``#``
        may hold ``key: value`` or ``key: value unit``.

    Returns
    -------
    dict
        ``signal`` of shape (cycle, time), and the other columns and settings by name. A Note states
        where cycles were taken to be in columns.

    Raises
    ------
    ValueError
        If the table is empty, has too many columns or not one for each name, a sample is not a
        number, or a unit is unknown.

    Notes
    -----
    With a column ``time``, every other column without a known name is a cycle. Else, with known
    labels such as ``temperature``, or with two or more columns whose names end in a number and
    others that do not, each row is a cycle. Else the longer side is the time, and rows are cycles
    where both are equal. In a table without names whose rows outnumber the columns, a first column
    that increases evenly in steps under 10 ms is the time. If the table has only two columns, the
    steps may be of any size.
    """
    names, columns, settings = _cells(path)
    return settings | (_named_columns(names, columns) if names else _unnamed_columns(columns))


def _cells(path: Path) -> tuple[list[str], list[NDArray[Any]], Contents]:
    """Return names of columns (none without a header), columns, and settings ``# key: value``."""
    import pandas

    with path.open(encoding="utf-8-sig", errors="replace") as file:
        lines = list(itertools.islice(iter(partial(file.readline, LONGEST_ROW), ""), 1000))
    start = next((i for i, line in enumerate(lines) if line.strip() and line[0] != "#"), None)
    if start is None:
        raise ValueError("it is empty")
    first, second = lines[start], "".join(lines[start + 1 : start + 2])
    separator, cells = _split(first)
    limits.check_count(path, "columns", max(len(cells), second.count(separator)), limits.COLUMNS)
    header = _is_header(cells)
    # The default since 3.1, where naming it is deprecated.
    old = tuple(int(part) for part in pandas.__version__.split(".")[:2]) < (3, 1)
    options: dict[str, Any] = {"float_precision": "round_trip"} if old else {}
    options |= {
        "sep": separator,
        "decimal": _decimal_sign(lines[start + header :], separator),
        "header": None,
        "skiprows": start + header,
        "comment": "#",
        "encoding_errors": "replace",
        "low_memory": False,
    }
    frame = pandas.read_csv(path, **options)
    texts = [i for i in frame if frame[i].dtype.kind not in "biuf" or frame[i].isna().all()]
    if texts:  # in which NA and None are words, and not gaps between numbers
        gaps = {"keep_default_na": False, "na_values": ["", "nan", "NaN"]}
        frame[texts] = pandas.read_csv(path, usecols=texts, **gaps, **options)
    if first.strip("\r\n").endswith(separator) and frame.iloc[:, -1].isna().all():
        frame, cells = frame.iloc[:, :-1], cells[: frame.shape[1] - 1]  # rows end with a separator
    arrays = (frame[i].to_numpy() for i in range(frame.shape[1]))
    columns = [a if a.dtype.kind in "biuf" else a.astype(str) for a in arrays]
    if header and len(cells) != len(columns):
        raise ValueError(f"the header has {len(cells)} names for {len(columns)} columns")
    return cells if header else [], columns, _settings(path, lines[:start])


def _split(row: str) -> tuple[str, list[str]]:
    """Return the separator of a table's first row, and its cells, of which some may be quoted."""
    outside = re.sub('"[^"]*"', "", row)
    separator = next((s for s in "\t;" if s in outside), ",")
    if '"' not in row:
        return separator, [cell.strip() for cell in row.strip("\r\n").split(separator)]
    cells = next(csv.reader([row.strip("\r\n")], delimiter=separator, skipinitialspace=True))
    return separator, [cell.strip().strip('"') for cell in cells]


def _decimal_sign(rows: list[str], separator: str) -> str:
    """Return a comma if it separates no cells and a cell is a number with one, else a point."""
    edge = rf"\s*(?:\"|{separator}|^|$)\s*"
    number = re.compile(rf"{edge}[-+]?\d*,\d+(?:[eE][-+]?\d+)?{edge}")
    found = separator != "," and any("," in row and number.search(row) for row in rows)
    return "," if found else "."


def _settings(path: Path, comments: list[str]) -> Contents:
    """Return known quantities in comments ``# key: value unit``, but no signal or time (of day)."""
    pairs = (re.match(r"#\s*([^:=]+?)\s*[:=]\s*(\S+)\s*(.*)", line) for line in comments)
    return {
        with_unit(path, key, "" if value.endswith((",", ";")) else _unit_of(unit)): _number(value)
        for key, value, unit in (pair.groups() for pair in pairs if pair)
        if meaning(key)[0] not in ("", "time", "signal")
    }


def _unit_of(words: str) -> str:
    """Return the unit in the text after a comment's value, without a remark after ``#``.

    The result is empty if there is no unit, or a remark in brackets in its place.
    """
    unit = words.partition("#")[0].strip()
    return "" if unit.startswith("(") else unit


def _is_header(cells: list[str]) -> bool:
    """Return whether a first row names columns: by words, or by numbers from 0 or 1."""
    numbers = [_number(cell) for cell in cells if cell]
    n = len(numbers)
    counts = n > 2 and any(numbers == list(range(i, i + n)) for i in (0, 1))
    return counts or any(isinstance(number, str) for number in numbers)


def _number(text: str) -> float | str:
    try:
        return float(text.replace(",", ".") or "nan")
    except ValueError:
        return text


def _named_columns(names: list[str], columns: list[NDArray[Any]]) -> Contents:
    """Sort named columns into time, labels and samples, and the samples into cycles."""
    kept = [
        (n, c) for n, c in zip(names, columns, strict=True) if plain(n) not in _COUNTING_COLUMNS
    ]
    known = {name for name, _ in kept if meaning(name)[0] not in ("", "signal")}
    timed = any(meaning(name)[0] == "time" for name in known)
    others = [name for name, _ in kept if name not in known]
    numbered = [name for name in others if re.search(r"\d\W*$", name)]
    are_samples = set(others if timed or len(numbered) < 2 else numbered)
    samples = [column for name, column in kept if name in are_samples]
    labels = {name: column for name, column in kept if name not in are_samples}
    if timed or len(samples) == 1:
        return labels | {"signal": _stacked(samples)}
    return labels | ({"signal": _stacked(samples).T} if labels else _by_shape(samples))


def _unnamed_columns(columns: list[NDArray[Any]]) -> Contents:
    """Sort columns without names into time and samples, and the samples into cycles."""
    if 1 < len(columns) < len(columns[0]):
        with contextlib.suppress(ValueError, TypeError):
            rate = sampling_rate(columns[0])
            # Of two columns, the first is a time axis even if its rate is rejected later.
            if rate > 100 or len(columns) == 2:
                return {"time": columns[0], "signal": _stacked(columns[1:])}
    return _by_shape(columns)


def _by_shape(columns: list[NDArray[Any]]) -> Contents:
    """Return the signal with the longer side as time; rows are cycles where both are equal."""
    samples = _stacked(columns)
    if len(columns) == 1:
        return {"signal": samples}
    if samples.shape[0] >= samples.shape[1]:
        return {"signal": samples.T}
    note = Note(
        f"The table of {samples.shape[1]} rows and {len(columns)} columns was taken for cycles in "
        f"columns; give samples = {len(columns)} if its rows are cycles."
    )
    return {"signal": samples, "note": note}


def _stacked(columns: Iterable[NDArray[Any]]) -> NDArray[Any]:
    """Return columns as an array of shape (column, row), integers in the smallest signed type."""
    columns = list(columns)
    for i, column in enumerate(columns):
        if column.dtype.kind not in "iuf":
            words = [str(v) for v in column.tolist() if isinstance(_number(str(v)), str)]
            raise ValueError(
                f"column {i + 1} of the samples holds text: {words[:1] or column.dtype}"
            )
    if not columns:
        raise ValueError("no column holds samples")
    if any(column.dtype.kind == "f" for column in columns):
        return np.stack(columns)
    low, high = min(c.min() for c in columns), max(c.max() for c in columns)
    signed = (np.dtype(name) for name in ("i2", "i4", "i8"))
    fit = (d for d in signed if np.iinfo(d).min <= low and high <= np.iinfo(d).max)
    return np.stack(columns).astype(next(fit, columns[0].dtype))
