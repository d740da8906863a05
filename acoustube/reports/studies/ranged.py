"""Errors of distances and forces estimated from cycles, and their rows in the tables."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from acoustube import estimation
from acoustube.base.types import Array
from acoustube.base.units import CM, PERCENT
from acoustube.estimation import Errors
from acoustube.reports.studies.report import Row, Tables, compared_row

FALSE_POSITIVE_ERROR = 0.25
"""Least error of the distance in m with which a detection counts as a false positive."""
FIRST_DATASET_DEPTH = 0.9e-3
"""Depth in m that all presses of the flat table's first dataset exceed."""
DEEP = 6.5e-3
"""Depth in m above which a press is deep: the sleeve paper states its errors separately."""
RELIABLE_FRACTION = 0.5
"""A contact is reliable if more than this fraction of its cycles has an error below 25 cm."""


def distance_errors(table: xr.Dataset) -> Errors:
    """Return the statistics in m of the distance errors of cycles with an echo."""
    return estimation.errors(table["true_distance"].values, found_distance(table))


def force_errors(table: xr.Dataset) -> Errors:
    """Return statistics in N of the force errors of an inversion, where it detects a contact."""
    return estimation.errors(table["force"].values, table["estimated_force"].values)


def error_of_deep(table: xr.Dataset) -> float:
    """Return the mean absolute error in cm of the distance of presses deeper than 6.5 mm."""
    off = np.abs(found_distance(table) - table["true_distance"].values)
    return CM * float(np.nanmean(off[table["depth"].values.round(9) > DEEP]))


def found_distance(table: xr.Dataset) -> Array:
    """Return the estimated distance of cycles in m; nan without an echo."""
    return np.asarray(table["features"].sel(feature="distance").values)


def located(table: xr.Dataset) -> NDArray[np.bool_]:
    """Return the mask of located cycles: their distance error is below 25 cm."""
    return np.asarray(
        np.abs(found_distance(table) - table["true_distance"].values) < FALSE_POSITIVE_ERROR
    )


def false_positives(table: xr.Dataset) -> NDArray[np.bool_]:
    """Return the mask of the cycles with an echo whose distance is wrong by 25 cm or more."""
    return np.asarray(np.isfinite(found_distance(table)) & ~located(table))


def shallowest(table: xr.Dataset, nearest: float, farthest: float) -> float:
    """Return the least depth in m from which on most cycles have an error below 25 cm.

    Cycles at all positions from `nearest` to `farthest` in m count together. The result is nan if
    most cycles of the deepest presses have no echo or a larger error.
    """
    place = table["true_distance"].values
    inside = table.isel(cycle=(place >= nearest) & (place <= farthest))
    depths, number = np.unique(inside["depth"].values.round(9), return_inverse=True)
    good = [np.mean(located(inside)[number == i]) > RELIABLE_FRACTION for i in range(len(depths))]
    if not good or not good[-1]:
        return float("nan")
    unreliable = np.flatnonzero(~np.array(good))
    return float(depths[unreliable[-1] + 1] if unreliable.size else depths[0])


def measure_rows(
    what: str,
    unit: str,
    ours: Errors,
    *,
    why: str,
    scale: float = 1.0,
    published: Sequence[float | None] = (None, None, None),
    coarser: Errors | None = None,
    inversion: Errors | None = None,
) -> list[Row]:
    """Return rows of median, RMSE and IQR of errors: the columns of the sleeve paper's tables.

    Parameters
    ----------
    what, unit : str
        The estimated quantity, and its unit in the report.
    ours : Errors
        Statistics of the errors by the sleeve paper's processing.
    why : str
        As in :class:`~acoustube.reports.studies.report.Row`.
    scale : float
        Factor from the unit of the errors to that of the report.
    published : sequence of float or None
        Published median, RMSE and IQR in the unit of the report.
    coarser, inversion : Errors, optional
        Statistics of the errors with a coarser mesh and grid, and by waveform inversion.
    """
    return [
        Row(
            quantity=f"{what}: {words} absolute error", unit=unit, published=number,
            ours=scale * getattr(ours, name),
            coarser=None if coarser is None else scale * getattr(coarser, name),
            inversion=None if inversion is None else scale * getattr(inversion, name), why=why,
        )
        for name, words, number in zip(
            ("median", "rmse", "iqr"), ("median", "RMSE of the", "IQR of the"), published,
            strict=True,
        )
    ]  # fmt: skip


def distance_rows(tables: Tables, published: Sequence[float], why: str) -> list[Row]:
    """Return the rows of distance errors that correspond to one row of the paper's Table I."""
    ours, coarser, inversion = tables.measured(distance_errors)
    return measure_rows(
        "distance", "cm", ours, why=why, scale=CM, published=published, coarser=coarser,
        inversion=inversion,
    )  # fmt: skip


def detection_rows(tables: Tables) -> list[Row]:
    """Return rows of the percentages of cycles with an echo, and with an error over 25 cm."""
    return [
        compared_row(
            lambda cycles: PERCENT * float(np.mean(np.isfinite(found_distance(cycles)))), tables,
            quantity="cycles with an echo", unit="%",
            why="Not published. By inversion: recordings in which it finds a contact.",
        ),
        compared_row(
            lambda cycles: PERCENT * float(np.mean(false_positives(cycles))), tables,
            quantity="cycles with an error over 25 cm (false positives)", unit="%",
            why="Not published for single cycles.",
        ),
    ]  # fmt: skip
