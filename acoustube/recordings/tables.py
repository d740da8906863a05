"""Text tables of measured signals, and the names of quantities in files of any kind."""

from __future__ import annotations

import contextlib
import itertools
import re
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acoustube.base.foreign import limits
from acoustube.base.sampling import sampling_rate

LONGEST_ROW = 1 << 24
"""Largest number of characters of a row that are read before its columns are counted."""

# Arrays and single values by the name that they have in the file, and at most one Note.
Contents = dict[str, Any]


class Note(str):
    """Remark on how a file was read; its type distinguishes it from the file's contents."""


_METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
_HERTZ = {"hz": 1.0, "khz": 1e3, "mhz": 1e6}
_QUANTITIES: dict[str, tuple[str, dict[str, float]]] = {
    "signal": (
        "signals recording recordings waveform waveforms samples data adc pressure voltage value",
        {},
    ),
    "time": ("times t", {"s": 1.0, "ms": 1e-3, "us": 1e-6}),
    "sampling_rate": ("sample_rate sampling_frequency sample_frequency rate fs", _HERTZ),
    "temperature": ("temperatures temp air_temperature", dict.fromkeys(("c", "degc"), 1.0)),
    "samples_per_cycle": ("", {}),
    "true_distance": ("distance", _METRES),
    "depth": ("indentation_depth", _METRES),
    "force": ("contact_force", {"n": 1.0, "mn": 1e-3}),
    "diameter": ("indenter_diameter", _METRES),
}
_MEANINGS = {
    form + unit: (quantity, scale)
    for quantity, (others, units) in _QUANTITIES.items()
    for name in (quantity, *others.split())
    for form in (name, name.replace("_", ""))
    for unit, scale in [("", 1.0), *((f"_{unit}", scale) for unit, scale in units.items())]
}
_COUNTING_COLUMNS = {"", "index", "cycle", "sample", "n", "i"}
"""Names of index columns, which contain row numbers and no data."""


def plain(name: str) -> str:
    """Return a name in lower case with underscores: ``Depth (mm)`` becomes ``depth_mm``."""
    return re.sub(r"[^a-z0-9]+", "_", name.casefold().replace("μ", "u")).strip("_")


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


def read_table(path: Path) -> Contents:
    """Read a text table of cycles.

    Parameters
    ----------
    path : Path
        Columns separated by tabs, semicolons or commas; with semicolons or tabs, the decimal sign
        may be a comma. The first row may name the columns; lines before it that begin with ``#``
        may hold ``key: value``.

    Returns
    -------
    dict
        ``signal`` of shape (cycle, time), and the other columns and settings by name. A Note states
        where cycles were taken to be in columns.

    Raises
    ------
    ValueError
        If the table is empty, has too many columns or not one for each name, or a sample is not a
        number.

    Notes
    -----
    With a column ``time``, every other column without a known name is a cycle. Else, with known
    labels such as ``temperature``, or with two or more columns whose names end in a number and
    others that do not, each row is a cycle. Else the longer side is the time, and rows are cycles
    where both are equal. In a table without names whose rows outnumber the columns, a first column
    that increases evenly in steps under 10 ms is the time; of two columns, in steps of any size.
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
    comments, first, second = lines[:start], lines[start], "".join(lines[start + 1 : start + 2])
    separator = next((s for s in "\t;" if s in first), ",")
    cells = [cell.strip().strip('"') for cell in first.strip("\r\n").split(separator)]
    limits.check_count(path, "columns", max(len(cells), second.count(separator)), limits.COLUMNS)
    header = _is_header(cells)
    # The default since 3.1, where naming it is deprecated.
    old = tuple(int(part) for part in pandas.__version__.split(".")[:2]) < (3, 1)
    exact = {"float_precision": "round_trip"} if old else {}
    frame = pandas.read_csv(
        path,
        sep=separator,
        decimal="," if separator != "," and "," in (second or first) else ".",
        header=None,
        skiprows=start + header,
        comment="#",
        **exact,
        encoding_errors="replace",
        low_memory=False,
    )
    if first.strip("\r\n").endswith(separator) and frame.iloc[:, -1].isna().all():
        frame, cells = frame.iloc[:, :-1], cells[: frame.shape[1] - 1]  # rows end with a separator
    arrays = (frame[i].to_numpy() for i in range(frame.shape[1]))
    columns = [a if a.dtype.kind in "biuf" else a.astype(str) for a in arrays]
    if header and len(cells) != len(columns):
        raise ValueError(f"the header has {len(cells)} names for {len(columns)} columns")
    pairs = [re.match(r"#\s*([^:=]+?)\s*[:=]\s*(\S+)", line) for line in comments]
    settings = {pair[1]: _number(pair[2]) for pair in pairs if pair and meaning(pair[1])[0]}
    return cells if header else [], columns, settings


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
