"""Figures of a design: the Pareto front of its candidates, and maps of expected errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from acoustube.base.units import CM, MM, PERCENT
from acoustube.runs.design.candidates import Candidate
from acoustube.runs.design.choice import Map

LEVELS = 0.01, 1.0
"""Relative standard deviations of the force at the ends of the colour scale."""


def front_figure(
    front: Sequence[Candidate], named: Sequence[tuple[str, Candidate]], reach: float
) -> Figure:
    """Draw the rms error of force of candidates over their reach, coloured by resolution.

    Parameters
    ----------
    front : sequence of Candidate
        Candidates none of which dominates another (Pareto front).
    named : sequence of (str, Candidate)
        Labels, and the candidates to mark with them.
    reach : float
        Required reach in m.
    """
    sheet = Figure(figsize=(8.0, 5.0), layout="constrained")
    axes = sheet.subplots()
    values = np.array([one.objectives for one in front])
    drawn = axes.scatter(
        values[:, 0], PERCENT * values[:, 1], c=CM * values[:, 2], s=18, cmap="viridis"
    )
    sheet.colorbar(drawn, label="resolution (cm)")
    for i, (name, one) in enumerate(named):
        x, y = one.objectives[0], PERCENT * one.objectives[1]
        axes.plot(x, y, "o", mfc="none", mec="#c1443c", ms=10)
        axes.annotate(name, (x, y), xytext=(8, 8 + 12 * i), textcoords="offset points", fontsize=9,
                      arrowprops={"arrowstyle": "-", "lw": 0.5})  # fmt: skip
    axes.axvline(reach, color="#777777", ls=":", lw=1, label="required reach")
    axes.set_yscale("log")
    for which in (axes.yaxis.set_major_formatter, axes.yaxis.set_minor_formatter):
        which("{x:g}")
    axes.set_xlabel("reach (m): farthest place at which the lightest press is detected")
    axes.set_ylabel("rms deviation of force (%)")
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3, which="both")
    return sheet


def map_figure(found: Map, title: str) -> Figure:
    """Draw maps of the standard deviations of force and of position, over position and force.

    Parameters
    ----------
    found : Map
    title : str
    """
    sheet = Figure(figsize=(10.0, 3.6), layout="constrained")
    left, right = sheet.subplots(1, 2)
    for axes, values, label, ends in (
        (left, PERCENT * found.force_error, "deviation of force (%)", (PERCENT * LEVELS[0],
         PERCENT * LEVELS[1])),
        (right, MM * found.place_error, "deviation of place (mm)", (0.1, 1000.0)),
    ):  # fmt: skip
        drawn = axes.pcolormesh(
            CM * found.place, found.force, values, norm=LogNorm(*ends), shading="nearest",
            cmap="viridis_r",
        )  # fmt: skip
        axes.set_yscale("log")
        axes.set_xlabel("place (cm)")
        axes.set_ylabel("force (N)")
        ticks = found.force[:: max(len(found.force) // 5, 1)]
        axes.set_yticks(ticks, [f"{one:.3g}" for one in ticks], minor=False)
        axes.minorticks_off()
        beside = axes.secondary_yaxis("right")
        depths = found.depth[:: max(len(found.force) // 5, 1)]
        beside.set_yticks(ticks, [f"{MM * one:.1f} mm" for one in depths])
        beside.minorticks_off()
        sheet.colorbar(drawn, ax=axes, label=label)
    sheet.suptitle(title, fontsize=10)
    return sheet
