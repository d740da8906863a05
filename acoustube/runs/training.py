"""Tables of features and of errors, from labelled cycles."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from acoustube import estimation
from acoustube.base.errors import ConfigError
from acoustube.base.units import KHZ, MS
from acoustube.estimation import FeatureSettings
from acoustube.estimation.features import LABELS
from acoustube.estimation.model import TARGETS
from acoustube.runs.twin_calibration import stated_processing
from acoustube.signals import Processing

DISPLAY_UNITS = {"true_distance": ("cm", 100.0), "depth": ("mm", 1e3), "force": ("N", 1.0)}
"""Units of the labels in tables, with the factors from SI."""
SAME_DRIVE = 0.01
"""Largest relative difference of carriers, bands and chirps' durations that count as equal."""
BINS = {"depth": 0.5e-3, "true_distance": 0.05}
"""Bin widths in m by label: the steps of the sleeve paper's depths, and those of its error map."""
# Target, quantity by which cycles are binned, limits of the bin in SI, number of cycles, errors.
Row = tuple[str, str, float, float, int, estimation.Errors]


def table_of(
    recordings: Iterable[tuple[Path, xr.Dataset]],
    feature_settings: FeatureSettings,
    report: Callable[[str, float], None],
    check: Callable[[Path, xr.Dataset], None] | None = None,
) -> xr.Dataset:
    """Return the feature table of the cycles of files, taken one after another.

    Parameters
    ----------
    recordings : iterable of (Path, xarray.Dataset)
        Each file and its recording, as from :func:`acoustube.runs.recordings.read_cycles`.
    feature_settings : FeatureSettings
    report : callable
        Called with the name of the stage and the finished fraction of a file.
    check : callable, optional
        Called with each file and its recording.

    Returns
    -------
    xarray.Dataset
        From :func:`acoustube.estimation.feature_table`. A file without sessions is one session.

    Raises
    ------
    ConfigError
        If a file cannot be read or processed, or the files differ in sampling rate.
    """
    parts: list[xr.Dataset] = []
    for path, data in recordings:
        if check is not None:
            check(path, data)
        try:
            part = estimation.feature_table(
                data, feature_settings, lambda share: report("echoes", share)
            )
        except ValueError as error:
            raise ConfigError(f"{path}: {error}") from error
        if "session" not in part:
            part["session"] = "cycle", np.full(part.sizes["cycle"], str(path))
        parts.append(part)
    rates = {float(part.attrs["sampling_rate"]) for part in parts}
    if max(rates) > 1.001 * min(rates):
        raise ConfigError(
            f"the recordings have {min(rates):g} to {max(rates):g} samples per second; use "
            "recordings of one rate"
        )
    return _joined(parts)


def check_drive(path: Path, recorded: xr.Dataset, how: Processing) -> None:
    """Raise ConfigError if a recording states another drive than it is processed for.

    Carriers are compared, bands, and the durations of chirps.

    Parameters
    ----------
    path : Path
        File of the recording, for messages.
    recorded : xarray.Dataset
    how : Processing
        Settings of the processing.
    """
    stated = stated_processing(path, recorded)
    if stated is None:
        return
    own, other = (
        (one.frequency, one.bandwidth or 0.0, one.pulse_cycles if one.bandwidth else 0.0)
        for one in (stated, how)
    )
    if not np.allclose(own, other, rtol=SAME_DRIVE):
        raise ConfigError(
            f"{path} has a drive of {_in_words(stated)}, and the recordings are processed for one "
            f"of {_in_words(how)}; use recordings of one drive"
        )


def _in_words(how: Processing) -> str:
    """Return carrier, band and duration of the drive that a processing is for."""
    half = (how.bandwidth or 0.0) / 2
    band = f" +- {KHZ * half:g}" if half else ""
    return f"{KHZ * how.frequency:.4g}{band} kHz for {MS * how.pulse_cycles / how.frequency:.3g} ms"


def _joined(parts: list[xr.Dataset]) -> xr.Dataset:
    """Join feature tables; missing labels become nan or empty."""
    variables: dict[str, Any] = {
        "features": (("cycle", "feature"), np.concatenate([p["features"].values for p in parts]))
    }
    for name in LABELS:
        known = [p[name].values for p in parts if name in p]
        if not known:
            continue
        numbers = all(values.dtype.kind in "biuf" for values in known)
        blank: Any = np.nan if numbers else ""
        columns = [p[name].values if name in p else np.full(p.sizes["cycle"], blank) for p in parts]
        variables[name] = (
            "cycle",
            np.concatenate(columns if numbers else [column.astype(str) for column in columns]),
        )
    return xr.Dataset(variables, {"feature": parts[0]["feature"].values}, parts[0].attrs)


def error_rows(targets: Sequence[str], table: xr.Dataset, estimates: xr.Dataset) -> Iterator[Row]:
    """Yield the errors of each target: of all cycles, then by depth and by distance.

    Parameters
    ----------
    targets : sequence of str
        Labels that are estimated.
    table, estimates : xarray.Dataset
        From :func:`acoustube.estimation.feature_table` and :func:`acoustube.estimation.estimate`.

    Yields
    ------
    tuple
        The target; the quantity by which cycles are binned, ``depth`` or ``distance``, and the
        lower and upper limit of the bin; the number of cycles with the target's label; and their
        errors. Units are SI. The row of all cycles has the quantity ``all`` and limits nan.
    """
    for target in targets:
        if target not in table or not np.isfinite(table[target]).any():
            continue
        name = TARGETS[target]
        columns = [table[target].values.astype(float)]
        columns += [estimates[name + s].values for s in ("", "_deviation", "_half_width")]
        known = np.isfinite(columns[0])
        yield target, "all", np.nan, np.nan, int(known.sum()), estimation.errors(*columns)
        for label, width in BINS.items():
            if label not in table:
                continue
            edges, index = estimation.bins(table[label].values, width)
            for i, (low, high) in enumerate(edges):
                inside = index == i
                some = [column[inside] for column in columns]
                count = int((known & inside).sum())
                yield target, TARGETS[label], low, high, count, estimation.errors(*some)
