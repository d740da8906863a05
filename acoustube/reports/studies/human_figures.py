"""Figures of the study of a human arm: distances, presses on several grounds, and places."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.image import imread

from acoustube.base.units import CM, MM
from acoustube.reports.figures.run import PRESS
from acoustube.reports.scenes import sleeve as sleeve_scene
from acoustube.reports.studies import ranged
from acoustube.reports.studies.arm import sleeve
from acoustube.runs.by_force import ByForce
from acoustube.sleeve import layout
from acoustube.sleeve.layouts import OUTER_DIAMETER

LEVELS = ((2.0, 4.0), (4.0, 6.0), (6.0, 8.0))
"""Levels of force: range of each in N."""
COLOURS = ("#7fb3d5", "#e59866", "#943126")
"""Colours of the levels."""


def distances(table: xr.Dataset) -> Figure:
    """Draw estimated against true distance, and located presses by force and distance."""
    sheet = Figure(figsize=(12, 5), layout="constrained")
    left, right = sheet.subplots(1, 2)
    true, found = CM * table["true_distance"].values, CM * ranged.found_distance(table)
    level, number = table["level"].values, table["number"].values
    for (low, high), colour in zip(LEVELS, COLOURS, strict=True):
        for tube, marker in enumerate("os"):
            some = (level == low) & (number == tube)
            label = f"{low:g}-{high:g} N" if tube == 0 else None
            left.plot(true[some], found[some], marker, ms=5, color=colour, label=label)
    false = ranged.false_positives(table)
    left.plot(true[false], found[false], "o", ms=12, mfc="none", mec="0.5")
    left.plot([15, 215], [15, 215], "k", lw=0.8)
    left.set(xlabel="true distance (cm)", ylabel="estimated distance (cm)")
    left.legend()
    edges = np.arange(0, 241, 30.0)
    width = 8.0
    for i, ((low, high), colour) in enumerate(zip(LEVELS, COLOURS, strict=True)):
        at = edges[:-1] + 15 + (i - 1) * width
        good, bad = (
            np.histogram(true[(level == low) & which], edges)[0]
            for which in (ranged.located(table), false)
        )
        right.bar(at, good, width, color=colour, label=f"{low:g}-{high:g} N")
        right.bar(at, bad, width, bottom=good, color="0.6")
    right.set(
        xlabel="true distance (cm)", ylabel="located presses", xticks=edges,
        yticks=[0, 1, 2], ylim=(0, 2.6),
    )  # fmt: skip
    right.legend(ncols=3)
    return sheet


def grounds(paths: dict[str, ByForce]) -> Figure:
    """Draw travel of the indenter and loss of lumen height against force; `paths` are by ground."""
    sheet = Figure(figsize=(10, 4.2), layout="constrained")
    left, right = sheet.subplots(1, 2, sharey=True)
    for name, path in paths.items():
        left.plot(path.force, MM * path.depth, label=name)
        right.plot(path.force, MM * path.closing, label=name)
    for axes, words in (
        (left, "travel of the indenter (mm)"),
        (right, "loss of lumen height (mm)"),
    ):
        axes.set(xlabel="force (N)", ylabel=words)
        for low, _ in LEVELS:
            axes.axvline(low, color=PRESS, lw=0.5)
    left.legend()
    return sheet


def arm(table: xr.Dataset) -> Figure | None:
    """Draw true and estimated places of the hardest presses on the sleeve's first tube.

    None is returned where VTK cannot draw.
    """
    tube = sleeve()[0]
    hard = (table["number"].values == 0) & (table["level"].values == LEVELS[-1][0])
    part = table.isel(cycle=hard)
    found = ranged.found_distance(part)
    picture = sleeve_scene.Picture(
        tubes=(tube,),
        detection_range=layout([tube]).detection_range,
        outer_diameter=OUTER_DIAMETER,
        contacts=tuple((0, float(z)) for z in part["true_distance"].values),
        deviation=0.0,
        markers=np.empty((0, 3)),
        estimates=tuple(
            (0, float(z)) for z in found if np.isfinite(tube.height(z))
        ),
    )  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.png"
        if not sleeve_scene.draw(picture, path):
            return None
        image = imread(path)
    sheet = Figure(figsize=(11, 6.2))
    axes = sheet.add_axes((0, 0, 1, 1))
    axes.imshow(image)
    axes.set_axis_off()
    return sheet
