"""Figures of a sweep, drawn from a dataset of cases along the dimension ``press``."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from acoustube.base.units import CM, MM, PERCENT
from acoustube.reports.figures.run import percent
from acoustube.runs.sweep.select import by_tool, chosen, envelope_of, usual

MOST_TOOLS = 4
"""Largest number of indenters whose envelopes are drawn."""
FAINTEST = 1e-3
"""Lower end of the colour scale of envelopes, as a fraction of the send pulse."""
ROW = 1.0
"""Height in mm, on the axis of depth, of the envelope of an indenter with a single depth."""


def figure(cases: xr.Dataset) -> Figure:
    """Draw force, highest echo and distance error over depth by indenter, and the envelopes.

    Parameters
    ----------
    cases : xarray.Dataset
        Cases of a sweep, from :func:`acoustube.open_dataset`. If other settings vary too, the
        envelopes are those of the most frequent combination, and the curves are medians with the
        range of all cases.
    """
    cases = chosen(cases)
    tools = list(by_tool(cases))
    columns = max(3, min(len(tools), MOST_TOOLS))
    sheet = Figure(figsize=(4.2 * columns, 8.5), layout="constrained")
    rows: Any = sheet.subfigures(2, 1, height_ratios=[1, 1.1])
    above, below = rows
    for axes, name, scale, label in zip(
        above.subplots(1, 3), ("force", "amplitude", "error"), (1.0, PERCENT, CM),
        ("force (N)", "highest echo (% of the send pulse)", "error of the distance (cm)"),
        strict=True,
    ):  # fmt: skip
        draw_over_depth(axes, cases, name, scale, label)
        if name == "error":
            axes.axhline(0.0, color="0.7", lw=0.8, zorder=0)
    shown = tools[:columns]
    row = below.subplots(1, len(shown), squeeze=False)[0]
    for axes, (words, some) in zip(row, shown, strict=True):
        drawn = usual(some)
        image = draw_echoes(axes, drawn)
        place = CM * float(drawn["true_distance"].values[0])
        axes.set_title(f"{words}, pressed at {place:.4g} cm", fontsize="medium")
    label = "envelope, % of the send pulse"
    below.colorbar(image, ax=list(row), label=label, format=percent())
    return sheet


def draw_over_depth(axes: Axes, cases: xr.Dataset, name: str, scale: float, label: str) -> None:
    """Draw a quantity over depth for each indenter: the median, and the range of all cases."""
    for words, some in by_tool(cases):
        depths, numbers = np.unique(some["depth"].values, return_inverse=True)
        values = scale * some[name].values
        rows = [values[numbers == i] for i in range(len(depths))]
        rows = [row[np.isfinite(row)] for row in rows]
        middle = [np.median(row) if row.size else np.nan for row in rows]
        (line,) = axes.plot(MM * depths, middle, "o-", ms=3, lw=1.2, label=words)
        if max(row.size for row in rows) > 1:
            low = [row.min() if row.size else np.nan for row in rows]
            high = [row.max() if row.size else np.nan for row in rows]
            axes.fill_between(MM * depths, low, high, color=line.get_color(), alpha=0.2, lw=0)
    if not np.isfinite(cases[name].values).any():
        axes.text(0.5, 0.5, "no echo was found", ha="center", transform=axes.transAxes)
    axes.set(xlabel="depth (mm)", ylabel=label)
    axes.legend(fontsize="small")


def draw_echoes(axes: Axes, cases: xr.Dataset) -> QuadMesh:
    """Draw the envelopes of one indenter's cases over distance and depth; return the image."""
    cases = cases.sortby("depth")
    rows = [envelope_of(cases.isel(press=i)) for i in range(cases.sizes["press"])]
    place = rows[0][0]
    levels = np.maximum([np.interp(place, *row) for row in rows], FAINTEST)
    top = float(cases["tube_length"].values[0])
    depth = heights = MM * cases["depth"].values
    if len(depth) == 1:  # pcolormesh takes the height of a row from its neighbours
        heights, levels = depth + ROW * np.array([-0.25, 0.25]), np.repeat(levels, 2, axis=0)
    image = axes.pcolormesh(
        CM * place, heights, levels, norm=LogNorm(FAINTEST, 1.0), cmap="viridis", shading="nearest"
    )
    axes.axvline(CM * float(cases["true_distance"].values[0]), color="w", lw=0.8, ls=":")
    axes.plot(CM * cases["estimated_distance"].values, depth, "r.", ms=4)
    axes.set(xlim=(0, CM * top), xlabel="distance (cm)", ylabel="depth (mm)")
    return image
