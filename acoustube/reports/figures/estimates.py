"""Figures of estimates against true values."""

from __future__ import annotations

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from acoustube.estimation import bins
from acoustube.estimation.model import TARGETS
from acoustube.reports.figures.run import ENVELOPE, PRESS, RETURN
from acoustube.runs.training import BINS, DISPLAY_UNITS

MOST_POINTS = 5000
"""Largest number of points of a panel: of more cycles, every n-th is drawn."""
AGAINST = "true_distance", "depth"
"""True quantities over which absolute errors are drawn, in bins."""


def figure(table: xr.Dataset, estimates: xr.Dataset) -> Figure:
    """Draw a row of panels per target: estimates over true values, errors by distance and depth.

    Parameters
    ----------
    table, estimates : xarray.Dataset
        Features with labels, from :func:`acoustube.estimation.feature_table`, and estimates, from
        :func:`acoustube.estimation.estimate`.
    """
    targets = [t for t, name in TARGETS.items() if t in table and name in estimates]
    against = [label for label in AGAINST if label in table]
    sheet = Figure(figsize=(4.2 * (1 + len(against)), 3.6 * len(targets)), layout="constrained")
    axes = sheet.subplots(len(targets), 1 + len(against), squeeze=False)
    for row, target in zip(axes, targets, strict=True):
        draw_estimates(row[0], table, estimates, target)
        for panel, label in zip(row[1:], against, strict=True):
            draw_errors(panel, table, estimates, target, label)
    return sheet


def draw_estimates(axes: Axes, table: xr.Dataset, estimates: xr.Dataset, target: str) -> None:
    """Draw estimates of a target, with their standard deviations, against true values."""
    words = _axis(target)
    truth, estimate, deviation = _scaled(table, estimates, target)
    known = np.flatnonzero(np.isfinite(truth) & np.isfinite(estimate))
    some = known[:: max(1, -(-len(known) // MOST_POINTS))]
    axes.errorbar(
        truth[some], estimate[some], deviation[some], fmt=".", ms=2, lw=0.4, alpha=0.3,
        color=ENVELOPE, ecolor=PRESS, label="estimate, 68 % interval",
    )  # fmt: skip
    ends = [np.min(truth[known], initial=np.inf), np.max(truth[known], initial=-np.inf)]
    if known.size:
        axes.plot(ends, ends, color=RETURN, lw=1, label="truth")
    axes.set(xlabel=f"true {words}", ylabel=f"estimated {words}")
    axes.legend(fontsize="small")


def draw_errors(
    axes: Axes, table: xr.Dataset, estimates: xr.Dataset, target: str, label: str
) -> None:
    """Draw absolute errors of a target as a function of a label: median and quartiles in bins.

    The median of the standard deviations that the estimator states is drawn too.
    """
    truth, estimate, deviation = _scaled(table, estimates, target)
    edges, index = bins(table[label].values, BINS[label])
    error = np.where(np.isfinite(truth - estimate), np.abs(truth - estimate), np.nan)
    full = [i for i in range(len(edges)) if np.isfinite(error[index == i]).any()]
    at = DISPLAY_UNITS[label][1] * edges[full].mean(axis=1)
    quartiles = np.array(
        [np.nanpercentile(error[index == i], [25, 50, 75]) for i in full]
    ).reshape(-1, 3).T  # fmt: skip
    stated = [np.nanmedian(deviation[index == i]) for i in full]
    axes.fill_between(at, quartiles[0], quartiles[2], color=ENVELOPE, alpha=0.2, lw=0,
                      label="quartiles")  # fmt: skip
    axes.plot(at, quartiles[1], color=ENVELOPE, lw=1.2, label="median")
    axes.plot(at, stated, color=RETURN, lw=1, ls="--", label="stated standard deviation")
    axes.set(ylim=(0, None), xlabel=f"true {_axis(label)}")
    axes.set_ylabel(f"absolute error, {_axis(target)}")
    axes.legend(fontsize="small")


def _axis(label: str) -> str:
    """Return the name of a quantity and its unit, as a label of an axis."""
    return f"{TARGETS[label]} ({DISPLAY_UNITS[label][0]})"


def _scaled(
    table: xr.Dataset, estimates: xr.Dataset, target: str
) -> tuple[NDArray[np.float64], ...]:
    """Return true value, estimate and standard deviation of a target in the figure's units."""
    name, scale = TARGETS[target], DISPLAY_UNITS[target][1]
    columns = (table[target], estimates[name], estimates[name + "_deviation"])
    return tuple(scale * column.values.astype(float) for column in columns)
