"""Resumable tables of benchmarks: a CSV file to which the missing rows are added."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

Row = Mapping[str, object]


def completed(
    table: Path,
    columns: Sequence[str],
    key: Sequence[str],
    cases: Iterable[tuple],
    rows_of: Callable[..., Row | Iterable[Row]],
) -> list[dict[str, str]]:
    """Compute the rows of a table that are missing, and return all of its rows.

    Parameters
    ----------
    table : Path
        CSV file; created if it does not exist.
    columns : sequence of str
    key : sequence of str
        Columns that name a case.
    cases : iterable of tuple
        Arguments of `rows_of`, of which the first are the values of `key`.
    rows_of : callable
        Returns the row, or the rows, of a case.
    """
    there = {tuple(row[name] for name in key) for row in rows_in(table)}
    with table.open("a", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, columns, restval="")
        if file.tell() == 0:
            writer.writeheader()
        for case in cases:
            if tuple(map(str, case[: len(key)])) not in there:
                found = rows_of(*case)
                writer.writerows([found] if isinstance(found, Mapping) else found)
                file.flush()
    return rows_in(table)


def rows_in(table: Path) -> list[dict[str, str]]:
    """Return the rows of a table, none if there is no file."""
    if not table.exists():
        return []
    with table.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))
