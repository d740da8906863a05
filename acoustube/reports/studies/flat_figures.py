"""Figures of the study of a tube on a flat table: distances, maps by depth and distance, forces."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from acoustube import estimation
from acoustube.base.types import Array
from acoustube.base.units import CM, MM
from acoustube.reports.studies.ranged import FALSE_POSITIVE_ERROR, found_distance, located

BIN = 0.05
"""Width in m of the maps' bins of distance, as in the sleeve paper, whose map has 38 bins."""


def distances(table: xr.Dataset) -> Figure:
    """Draw estimated against true distance of cycles, coloured by depth."""
    sheet = Figure(figsize=(7.5, 6), layout="constrained")
    draw_distances(sheet.subplots(), table)
    return sheet


def draw_distances(axes: Axes, table: xr.Dataset) -> None:
    """Draw estimated against true distance on axes; of more than 8000 cycles, every n-th."""
    some = table.isel(cycle=slice(None, None, max(1, -(-table.sizes["cycle"] // 8000))))
    points = axes.scatter(
        CM * some["true_distance"].values, CM * found_distance(some), s=5,
        c=MM * some["depth"].values, cmap="viridis_r", lw=0,
    )  # fmt: skip
    axes.plot([15, 215], [15, 215], "k", lw=0.8)
    for bound in (15, 215):
        axes.axhline(bound, color="0.5", lw=0.8, ls="--")
    axes.set(xlabel="true distance (cm)", ylabel="estimated distance (cm)")
    axes.figure.colorbar(points, ax=axes, label="depth (mm)")


def over_map(table: xr.Dataset, values: NDArray[Any]) -> tuple[Array, Array, Array]:
    """Return the mean of the finite values of cycles, by bin of distance and by depth.

    Returns
    -------
    places : array of shape (n,)
        Lower edges in m of the bins of distance that contain cycles.
    depths : array of shape (m,)
        Depths in m.
    mean : array of shape (m, n)
        In the unit of the values; nan in bins without a finite value.
    """
    edges, column = estimation.bins(table["true_distance"].values, BIN)
    depths, row = np.unique(table["depth"].values.round(9), return_inverse=True)
    good = np.isfinite(values)
    shape = (len(depths), len(edges))
    number = np.ravel_multi_index((row[good], column[good]), shape)
    total = np.bincount(number, values[good], minlength=shape[0] * shape[1])
    count = np.bincount(number, minlength=shape[0] * shape[1])
    with np.errstate(invalid="ignore"):
        mean = (total / count).reshape(shape)
    return edges[:, 0], depths, mean


def maps(table: xr.Dataset) -> Figure:
    """Draw maps of the mean absolute distance error and of the percentage of errors below 25 cm."""
    sheet = Figure(figsize=(12, 4.5), layout="constrained")
    left, right = sheet.subplots(1, 2)
    size = np.abs(found_distance(table) - table["true_distance"].values)
    _draw_map(left, *over_map(table, CM * size), "mean absolute error (cm)", vmax=50)
    _draw_map(right, *over_map(table, 100.0 * located(table)), "located cycles (%)", vmax=100)
    return sheet


def _draw_map(
    axes: Axes, places: Array, depths: Array, values: Array, label: str, **colours: Any
) -> None:
    axes.set_facecolor("0.8")
    image = axes.pcolormesh(
        CM * (places + BIN / 2), MM * depths, values, shading="nearest", **colours
    )
    axes.set(xlabel="true distance (cm)", ylabel="depth (mm)")
    axes.figure.colorbar(image, ax=axes, label=label)


def amplitudes(first: xr.Dataset, second: xr.Dataset) -> Figure:
    """Draw maps of the mean height of the envelope's highest peak in each of two datasets."""
    sheet = Figure(figsize=(12, 4.5), layout="constrained")
    for axes, table in zip(sheet.subplots(1, 2), (first, second), strict=True):
        heights = np.asarray(table["features"].sel(feature="amplitude").values)
        wrong = np.abs(found_distance(table) - table["true_distance"].values)
        places, depths, mean = over_map(table, heights)
        mean[~(over_map(table, wrong)[2] <= FALSE_POSITIVE_ERROR)] = np.nan
        _draw_map(axes, places, depths, smoothed(mean), "highest peak (fraction of the send pulse)",
                  norm=LogNorm(1e-3, 1.0))  # fmt: skip
    return sheet


def smoothed(values: Array) -> Array:
    """Return a map smoothed in its logarithm by a Gaussian of one bin; nan values stay nan."""
    known = np.isfinite(values)
    weight = gaussian_filter(known.astype(float), 1.0)
    total = gaussian_filter(np.where(known, np.log(np.where(known, values, 1.0)), 0.0), 1.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(known, np.exp(total / weight), np.nan)


def forces(table: xr.Dataset, estimates: xr.Dataset) -> Figure:
    """Draw true and estimated forces against depth, and a map of the relative errors."""
    sheet = Figure(figsize=(12, 4.5), layout="constrained")
    left, right = sheet.subplots(1, 2)
    truth, found = table["force"].values, estimates["force"].values
    places = np.unique(table["true_distance"].values.round(9))
    depths = np.unique(table["depth"].values.round(9))
    by_depth = [truth[np.isclose(table["depth"].values, depth)][0] for depth in depths]
    left.plot(MM * depths, by_depth, color="0.5", lw=3, label="truth")
    for i, place in enumerate(places):
        mean = _means(table, found, place, depths)
        left.plot(MM * depths, mean, ".-", color=f"C{i}", lw=0.8, label=f"{CM * place:g} cm")
    left.set(xlabel="depth (mm)", ylabel="force (N)", ylim=(0, None))
    left.legend(fontsize="small")
    relative = 100 * np.abs(found - truth) / np.maximum(truth, 1e-9)
    image = np.stack([_means(table, relative, place, depths) for place in places])
    right.set_facecolor("0.8")
    drawn = right.pcolormesh(MM * depths, CM * places, image, shading="nearest", vmin=0, vmax=100)
    right.set(xlabel="depth (mm)", ylabel="true distance (cm)")
    sheet.colorbar(drawn, ax=right, label="mean absolute relative error (%)")
    return sheet


def _means(table: xr.Dataset, values: Array, place: float, depths: NDArray[Any]) -> Array:
    """Return the mean at each depth of the finite values of cycles at one place, (n_depths,)."""
    here = np.isclose(table["true_distance"].values, place) & np.isfinite(values)
    at, depth = values[here], table["depth"].values[here]
    some = [at[np.isclose(depth, one)] for one in depths]
    return np.array([one.mean() if one.size else np.nan for one in some])
