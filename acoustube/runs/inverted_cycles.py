"""Estimates of labelled cycles by inversion, in the format of the trained estimators."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from acoustube.base.errors import ConfigError
from acoustube.estimation.model import TARGETS
from acoustube.inversion import Contact, Estimate, Inversion
from acoustube.runs.inversion import RecordingInverter

LEVELS = 0.68, 0.9
"""Probabilities of the central intervals: those of the trained estimators, to two digits."""
APART = "press", "tube", "session"
"""Labels that are equal within a group, since air, clutter or thermometer may differ with them."""


def inverted(
    recordings: Iterable[tuple[Path, xr.Dataset]],
    inverter: RecordingInverter,
    size: int,
    report: Callable[[str, float], None],
) -> tuple[xr.Dataset, xr.Dataset]:
    """Return labels and estimates of groups of cycles with equal labels.

    Parameters
    ----------
    recordings : iterable of (Path, xarray.Dataset)
        Files, which messages name, and their labelled cycles, from
        :func:`acoustube.runs.recordings.read_cycles`.
    inverter : RecordingInverter
    size : int
        Largest number of cycles in a group.
    report : callable
        Called with the name of the stage and the finished fraction of a file.

    Returns
    -------
    table : xarray.Dataset
        Labels of the groups in SI units, one along ``cycle`` for each group.
    estimates : xarray.Dataset
        Format of :func:`acoustube.estimation.estimate`, along the same dimension. Estimates are
        those of the most probable contact; of contacts equally probable within 0.01, of that with
        the largest force. ``_deviation`` and ``_half_width`` are half the widths of the central
        intervals of 68 % and 90 %. All are nan where no contact has a probability above 0.5.

    Raises
    ------
    ConfigError
        If a recording does not match the sensor, or has no label.
    """
    labels: dict[str, list[float]] = {name: [] for name in TARGETS}
    columns: dict[str, list[float]] = {}
    for path, data in recordings:
        known = [name for name in TARGETS if name in data]
        if not known:
            raise ConfigError(
                f"{path} has no label {' or '.join(TARGETS)}; give one in the file or in a sidecar"
            )
        for part, share in alike(data, known, size):
            ((_, found),) = inverter.groups(path, part, part.sizes["cycle"], lambda: None)
            for name, values in labels.items():
                values.append(float(part[name].values[0]) if name in known else np.nan)
            for name, value in _estimated(found).items():
                columns.setdefault(name, []).append(value)
            report("inverted", share)
    given = {name: values for name, values in labels.items() if np.isfinite(values).any()}
    table, estimates = (
        xr.Dataset({name: ("cycle", np.array(values)) for name, values in some.items()})
        for some in (given, columns)
    )
    return table, estimates


def alike(data: xr.Dataset, labels: Sequence[str], size: int) -> Iterator[tuple[xr.Dataset, float]]:
    """Yield groups of consecutive cycles with equal labels, and the finished fraction of cycles.

    A group has at most `size` cycles, of one case, specimen and session where these are stated. A
    label that is nan counts as -1, a value that no other label has.
    """
    columns = [np.nan_to_num(data[name].values.astype(float), nan=-1.0) for name in labels]
    columns += [
        np.unique(data[name].values, return_inverse=True)[1]
        for name in APART
        if name in data and data[name].dims == ("cycle",)
    ]
    values, n = np.stack(columns), data.sizes["cycle"]
    edges = [0, *(1 + np.flatnonzero(np.any(np.diff(values, axis=1) != 0, axis=0))), n]
    for first, last in pairwise(edges):
        for start in range(int(first), int(last), size):
            end = min(start + size, int(last))
            yield data.isel(cycle=slice(start, end)), end / n


def _estimated(found: Inversion) -> dict[str, float]:
    """Return the estimates of a group by name, with the half widths of their intervals."""
    likely = [one for one in found.contacts if one.probability > 0.5]
    best: Contact | None = max(likely, key=_rank, default=None)
    row: dict[str, Any] = {}
    for name in TARGETS.values():
        known: Estimate | None = None if best is None else getattr(best, name)
        row[name] = np.nan if known is None else known.value
        for suffix, level in zip(("_deviation", "_half_width"), LEVELS, strict=True):
            ends = (np.nan, np.nan) if known is None else known.intervals[level]
            row[name + suffix] = (ends[1] - ends[0]) / 2
    return row


def _rank(contact: Contact) -> tuple[float, float]:
    """Return the sort key of a contact: its rounded probability, then its force."""
    return round(contact.probability, 2), contact.force.value
