"""Figures of a run. Each function draws on axes that it is given, and shows nothing by itself."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from acoustube.scene import STRIP_MAGNIFICATION, STRIP_PIXELS, Image

AREA, SIGNAL, ENVELOPE, SEND, RETURN, PRESS = (
    "#4f8fc0", "#b8bec6", "#22405c", "#3a7d44", "#c1443c", "#777777",
)  # fmt: skip
CM = 100.0
NO_DRAWING = "VTK cannot draw on this machine: see 'The figure' in the README"


def figure(dataset: xr.Dataset, images: Mapping[str, Image] | None = None) -> Figure:
    """Draw one press: the tube, the lumen's area and the signal, over a shared distance.

    Parameters
    ----------
    dataset : xarray.Dataset
        A run.
    images : mapping of str to image, optional
        The three-dimensional pictures of :func:`acoustube.scene.draw`.

    Returns
    -------
    matplotlib.figure.Figure
        Not shown and not saved.
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


def draw_close_up(axes: Axes, dataset: xr.Dataset, images: Mapping[str, Image] | None) -> Axes:
    """Show the pressed part in true proportions, with force and section in the title."""
    axes.set_axis_off()
    last = dataset.isel(depth=-1)
    axes.set_title(
        f"pressed {1e3 * float(last['indentation_depth']):.2f} mm deep: "
        f"force {float(last['contact_force']):.2f} N, "
        f"lumen {1e3 * float(last['lumen_height']):.2f} mm high, "
        f"{1e6 * float(last['lumen_area']):.1f} mm² open"
    )
    if images:
        axes.imshow(images["close_up"])
    else:
        axes.text(0.5, 0.5, NO_DRAWING, ha="center", va="center", transform=axes.transAxes)
    return axes


def draw_strip(axes: Axes, dataset: xr.Dataset, images: Mapping[str, Image] | None) -> Axes:
    """Show the whole tube, opened along its length, on a true axis of distance."""
    axes.set_yticks([])
    axes.spines[["left", "right", "top"]].set_visible(False)
    axes.set_ylabel(f"tube\n(section x {STRIP_MAGNIFICATION:g})")
    if images:
        length = CM * float(dataset["z"][-1])
        aspect = STRIP_PIXELS[1] / STRIP_PIXELS[0]
        axes.imshow(images["strip"], extent=(0, length, 0, aspect * length), aspect="auto")
    return axes


def draw_area(axes: Axes, dataset: xr.Dataset) -> Axes:
    """Plot the lumen's cross-section along the tube."""
    z, area = CM * dataset["z"].values, 1e6 * dataset["area_profile"].values
    axes.fill_between(z, area, color=AREA, alpha=0.35, lw=0)
    axes.plot(z, area, color=AREA)
    axes.set_ylim(0, 1.15 * area.max())
    axes.set_ylabel("lumen area (mm²)")
    return axes


def draw_signal(axes: Axes, dataset: xr.Dataset) -> Axes:
    """Plot signal and envelope against the distance that their delay stands for."""
    chosen = str(dataset["distance"].attrs["source_end"])
    case = dataset.sel(source_end=chosen)
    speed, probe = float(dataset["sound_speed"]), float(dataset.attrs["probe"])
    send = float(case["send_time"])

    def place(time: xr.DataArray | float) -> np.ndarray:
        return CM * (probe + speed * (np.asarray(time) - send) / 2)

    distance = place(dataset["time"])
    pressure = case["pressure"] / np.abs(case["pressure"]).max()
    echo = case["envelope"].where(dataset["time"] > send + _fading(dataset)).max()
    # The send pulse is cut off so that the echo, often a hundredth of it, can be seen.
    limit = float(np.clip(2.5 * echo, 0.02, 1.1)) if np.isfinite(echo) else 1.1
    axes.plot(distance, pressure, color=SIGNAL, lw=0.6, label="pressure at the probe")
    axes.plot(distance, case["envelope"], color=ENVELOPE, label="envelope")
    other = [str(end) for end in dataset["source_end"].values if end != chosen]
    for end in other:
        shifted = dataset.sel(source_end=end)
        axes.plot(
            distance,
            shifted["envelope"],
            color=ENVELOPE,
            lw=0.8,
            ls="--",
            label=f"envelope, {end} source end",
        )
    axes.axvline(CM * probe, color=SEND, lw=1.2)
    axes.annotate(
        "send pulse" + (", cut off" if limit < 1 else ""),
        (CM * probe, limit),
        xytext=(6, -14),
        textcoords="offset points",
        color=SEND,
    )
    if np.isfinite(float(case["return_time"])):
        estimate, height = float(place(float(case["return_time"]))), float(case["echo_amplitude"])
        axes.plot(estimate, height, "o", color=RETURN)
        error = estimate - CM * float(dataset["true_distance"])
        axes.annotate(
            f"return pulse: {estimate:.2f} cm ({error:+.2f} cm), "
            f"{100 * height:.2f} % of the send pulse",
            (estimate, height),
            xytext=(0, 12),
            textcoords="offset points",
            ha="center",
            color=RETURN,
        )
    axes.set_ylim(-limit, limit)
    axes.set_ylabel("share of the send pulse")
    axes.legend(loc="lower right", fontsize="small", framealpha=0.9)
    axes.set_title(f"source end: {chosen}", loc="right", fontsize="small")
    return axes


def _fading(dataset: xr.Dataset) -> float:
    """Return how long after its maximum the send pulse is over, in s."""
    return float(dataset.attrs["pulse_duration"])


def save(sheet: Figure, path: Path) -> None:
    """Write a figure as PNG, drawn without a screen."""
    with mpl.rc_context({"font.size": 10}):
        sheet.savefig(path, dpi=130)
