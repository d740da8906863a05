"""Figures of a run. Each function draws on given matplotlib axes and opens no window."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import Formatter, FuncFormatter

from acoustube.base.units import CM, MM, MM2, PERCENT
from acoustube.reports.scenes.offscreen import Image
from acoustube.reports.scenes.tube import STRIP_MAGNIFICATION, STRIP_PIXELS

AREA, SIGNAL, ENVELOPE, SEND, RETURN, PRESS = (
    "#4f8fc0", "#b8bec6", "#22405c", "#3a7d44", "#c1443c", "#777777",
)  # fmt: skip
NO_DRAWING = "VTK cannot draw on this machine: see 'The figure' in the README"


def figure(dataset: xr.Dataset, images: Mapping[str, Image] | None = None) -> Figure:
    """Draw one press: the tube, the lumen's area and the signal, over a shared distance.

    Parameters
    ----------
    dataset : xarray.Dataset
        A run of ``simulate``.
    images : mapping of str to image, optional
        The three-dimensional pictures of :func:`acoustube.reports.scenes.tube.drawing`. Without
        them, a sentence is shown in their place.
    """
    sheet = Figure(figsize=(11, 11.5), layout="constrained")
    top, *shared = sheet.subplots(4, 1, height_ratios=[4.4, 1.3, 2, 3.2])
    for axes in shared[:-1]:
        axes.sharex(shared[-1])
        axes.tick_params(labelbottom=False)
    draw_close_up(top, dataset, images)
    draw_strip(shared[0], dataset, images)
    draw_area(shared[1], dataset)
    draw_signal(shared[2], dataset)
    for axes in shared:
        axes.axvline(CM * float(dataset["true_distance"]), color=PRESS, lw=1, ls=":")
    shared[-1].set_xlim(0, CM * float(dataset["z"][-1]))
    shared[-1].set_xlabel("distance from the source end (cm)")
    return sheet


def draw_close_up(axes: Axes, dataset: xr.Dataset, images: Mapping[str, Image] | None) -> None:
    """Show the pressed part in true proportions, with force and size of the lumen in the title."""
    axes.set_axis_off()
    last = dataset.isel(depth=-1)
    axes.set_title(
        f"bore {MM * float(dataset['width_profile'][0]):.1f} mm, "
        f"pressed {MM * float(last['indentation_depth']):.2f} mm deep: "
        f"force {float(last['contact_force']):.2f} N, "
        f"lumen {MM * float(last['lumen_height']):.2f} mm high, "
        f"{MM2 * float(last['lumen_area']):.1f} mm² open"
    )
    if images:
        axes.imshow(images["close_up"])
    else:
        axes.text(0.5, 0.5, NO_DRAWING, ha="center", va="center", transform=axes.transAxes)


def draw_strip(axes: Axes, dataset: xr.Dataset, images: Mapping[str, Image] | None) -> None:
    """Show the whole tube, cut open along its length, to scale along the axis of distance."""
    axes.set_yticks([])
    axes.spines[["left", "right", "top"]].set_visible(False)
    axes.set_ylabel(f"tube\n(section x {STRIP_MAGNIFICATION:g})")
    if images:
        length = CM * float(dataset["z"][-1])
        aspect = STRIP_PIXELS[1] / STRIP_PIXELS[0]
        axes.imshow(images["strip"], extent=(0, length, 0, aspect * length), aspect="auto")


def draw_area(axes: Axes, dataset: xr.Dataset) -> None:
    """Plot the lumen's cross-section along the tube."""
    z, area = CM * dataset["z"].values, MM2 * dataset["area_profile"].values
    axes.fill_between(z, area, color=AREA, alpha=0.35, lw=0)
    axes.plot(z, area, color=AREA)
    axes.set_ylim(0, 1.15 * area.max())
    axes.set_ylabel("lumen area (mm²)")


def draw_signal(axes: Axes, dataset: xr.Dataset) -> None:
    """Plot signal and envelope against the distance that corresponds to their delay."""
    chosen = str(dataset["distance"].attrs["source_end"])
    case = dataset.sel(source_end=chosen)
    distance = _place(case, case["time"].values)
    limit = _limit(case)
    pressure = case["pressure"] / np.abs(case["pressure"]).max()
    axes.plot(distance, pressure, color=SIGNAL, lw=0.6, label="pressure at the probe")
    axes.plot(distance, case["envelope"], color=ENVELOPE, label="envelope")
    for end in dataset["source_end"].values:
        if end != chosen:
            other = dataset.sel(source_end=end)
            label = f"envelope, {end} source end"
            axes.plot(distance, other["envelope"], "--", color=ENVELOPE, lw=0.8, label=label)
    _mark_pulses(axes, case, limit)
    axes.set_ylim(-limit, limit)
    label_amplitude(axes)
    axes.legend(loc="lower right", fontsize="small", framealpha=0.9)
    axes.set_title(f"source end: {chosen}", loc="right", fontsize="small")


def label_amplitude(axes: Axes) -> None:
    """Label the ordinate in % of the send pulse; its values are fractions."""
    axes.set_ylabel("% of the send pulse")
    axes.yaxis.set_major_formatter(percent())


def percent() -> Formatter:
    """Return a tick formatter that shows fractions in %, for a linear or a logarithmic axis."""
    return FuncFormatter(lambda value, _: Formatter.fix_minus(f"{PERCENT * value:g}"))


def _place(case: xr.Dataset, time: Any) -> Any:
    """Return the distance in cm of an echo that is received at a time in s."""
    delay = time - float(case["send_time"])
    return CM * (float(case["probe_position"]) + float(case["sound_speed"]) * delay / 2)


def _limit(case: xr.Dataset) -> float:
    """Return the limit of the ordinate: 2.5 times the echo, which cuts off most send pulses."""
    echo = float(case["echo_amplitude"])
    return float(np.clip(2.5 * echo, 0.02, 1.1)) if np.isfinite(echo) else 0.05


def _mark_pulses(axes: Axes, case: xr.Dataset, limit: float) -> None:
    """Mark where the send pulse and the highest echo are."""
    behind = {"boxstyle": "square,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.8}
    probe = CM * float(case["probe_position"])
    axes.axvline(probe, color=SEND, lw=1.2)
    axes.annotate(
        "send pulse, cut off" if limit < 1 else "send pulse",
        (probe, limit),
        xytext=(6, -16),
        textcoords="offset points",
        color=SEND,
        bbox=behind,
    )
    height = float(case["echo_amplitude"])
    if not np.isfinite(height):
        return
    estimate = float(_place(case, float(case["return_time"])))
    error = estimate - CM * float(case["true_distance"])
    axes.plot(estimate, height, "o", color=RETURN)
    axes.annotate(
        f"return pulse: {estimate:.2f} cm ({error:+.2f} cm), "
        f"{PERCENT * height:.2f} % of the send pulse",
        (estimate, height),
        xytext=(0, 12),
        textcoords="offset points",
        ha="center",
        color=RETURN,
        bbox=behind,
    )


def press_figure(dataset: xr.Dataset) -> Figure:
    """Draw a press alone: force and lumen against depth, and the lumen along the tube.

    Parameters
    ----------
    dataset : xarray.Dataset
        From :func:`acoustube.runs.results.press_dataset`.
    """
    sheet = Figure(figsize=(11, 7), layout="constrained")
    grid = sheet.add_gridspec(2, 2, height_ratios=[1, 1.1])
    draw_force(sheet.add_subplot(grid[0, 0]), dataset)
    draw_lumen(sheet.add_subplot(grid[0, 1]), dataset)
    draw_profiles(sheet.add_subplot(grid[1, :]), dataset)
    return sheet


def draw_force(axes: Axes, dataset: xr.Dataset) -> None:
    """Plot the force against the depth, and mark where the lumen is closed."""
    depth, force = MM * dataset["indentation_depth"].values, dataset["contact_force"].values
    axes.plot(np.insert(depth, 0, 0), np.insert(force, 0, 0), "-", color=ENVELOPE)
    closed = dataset["closed"].values.astype(bool)
    axes.plot(depth[~closed], force[~closed], "o", color=ENVELOPE, ms=4, label="lumen open")
    if closed.any():
        axes.plot(depth[closed], force[closed], "s", color=RETURN, ms=5, label="lumen closed")
    axes.set(xlabel="depth (mm)", ylabel="force (N)")
    axes.set_xlim(left=0)
    axes.set_ylim(bottom=0)
    axes.legend(loc="upper left", fontsize="small")


def draw_lumen(axes: Axes, dataset: xr.Dataset) -> None:
    """Plot height, width and area of the lumen at the press against the depth."""
    depth = MM * dataset["indentation_depth"].values
    height, width = (MM * dataset[f"lumen_{name}"].values for name in ("height", "width"))
    section = MM2 * dataset["lumen_area"].values
    axes.plot(depth, height, color=ENVELOPE, label="height (mm)")
    axes.plot(depth, width, color=SEND, label="width (mm)")
    axes.set(xlabel="depth (mm)", ylabel="lumen at the press (mm)")
    axes.set_xlim(left=0)
    axes.set_ylim(0, _top(height, width))
    area = axes.twinx()
    area.plot(depth, section, color=AREA, ls="--")
    area.set_ylabel("area (mm²), dashed", color=AREA)
    area.set_ylim(0, _top(section))
    axes.legend(loc="lower left", fontsize="small")


def draw_profiles(axes: Axes, dataset: xr.Dataset) -> None:
    """Plot the lumen's area along the tube at every depth, coloured by depth."""
    z, area = MM * dataset["z"].values, MM2 * dataset["lumen_area_profile"].values
    depth = MM * dataset["depth"].values
    shades = ScalarMappable(Normalize(0, depth[-1]), "viridis_r")
    for row, colour in zip(area, shades.to_rgba(depth), strict=True):
        axes.plot(z, row, color=colour, lw=1)
    axes.figure.colorbar(shades, ax=axes, label="depth (mm)", pad=0.01)
    axes.set(xlabel="distance from the press (mm)", ylabel="lumen area (mm²)", xlim=(z[0], z[-1]))
    axes.set_ylim(0, _top(area))


def _top(*curves: Any) -> float:
    """Return the upper limit of the axis of ordinates for curves; 1 if all values are nan."""
    highest = np.max([np.max(curve, initial=0.0, where=np.isfinite(curve)) for curve in curves])
    return 1.15 * float(highest) or 1.0


def picture(sheet: Figure, path: Path) -> bytes:
    """Return a figure as the content of an image file; no screen is needed.

    Parameters
    ----------
    sheet : matplotlib.figure.Figure
    path : Path
        Its suffix selects the format: PNG, PDF or SVG. The file is not written.
    """
    drawn = io.BytesIO()
    sheet.savefig(drawn, format=path.suffix[1:].lower(), dpi=130)
    return drawn.getvalue()
