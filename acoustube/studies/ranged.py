"""What the processing tells of cycles: their distance, and whether it is right."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from acoustube import estimation
from acoustube.estimation import Errors

Array = NDArray[np.float64]
FALSE = 0.25
"""Error of the distance in m from which a detection is a false positive."""
RELIABLE = 0.5
"""Share of the cycles that must tell the distance to 25 cm for a contact to be reliable."""


def distance_errors(table: xr.Dataset) -> Errors:
    """Return the errors of the distance of cycles with an echo, in m."""
    return estimation.errors(table["true_distance"].values, found_distance(table))


def found_distance(table: xr.Dataset) -> Array:
    """Return the estimated distance of cycles in m; nan without an echo."""
    return np.asarray(table["features"].sel(feature="distance").values)


def told(table: xr.Dataset) -> NDArray[np.bool_]:
    """Return which cycles tell the distance to 25 cm."""
    return np.asarray(np.abs(found_distance(table) - table["true_distance"].values) < FALSE)


def shallowest(table: xr.Dataset, nearest: float, farthest: float) -> float:
    """Return the least depth in m from which all presses in a range are told reliably.

    nan if even the deepest are not.
    """
    place = table["true_distance"].values
    inside = table.isel(cycle=(place >= nearest) & (place <= farthest))
    depths, number = np.unique(inside["depth"].values.round(9), return_inverse=True)
    good = [np.mean(told(inside)[number == i]) > RELIABLE for i in range(len(depths))]
    if not good or not good[-1]:
        return float("nan")
    unreliable = np.flatnonzero(~np.array(good))
    return float(depths[unreliable[-1] + 1] if unreliable.size else depths[0])
