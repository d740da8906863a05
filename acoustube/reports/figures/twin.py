"""Figure of a twin: simulated and recorded cycles, and the errors of the closures' positions."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from acoustube.base.units import CM, MM, MS, PERCENT
from acoustube.inversion.twin.estimate import SPEED
from acoustube.reports.figures.run import ENVELOPE, RETURN
from acoustube.runs.twin import FittedSensor

AROUND = (-0.2e-3, 1.6e-3)
"""Start and end in s of the drawn interval, relative to the arrival of an echo."""


def twin_figure(found: FittedSensor) -> Figure:
    """Draw recorded and simulated echoes of three closures and of the untouched tube, and errors.

    The closures are the nearest, a middle and the farthest one. The errors of all closures'
    positions and the peaks of their echoes are drawn over the stated distance.
    """
    sheet = Figure(figsize=(10.0, 8.0), layout="constrained")
    grid = sheet.add_gridspec(3, 6)
    order = np.argsort(found.twin.model.places)
    chosen = [order[0], order[len(order) // 2], order[-1]]
    for k, i in enumerate(chosen):
        _draw_closure(sheet.add_subplot(grid[0, 2 * k : 2 * k + 2]), found, int(i), k == 0)
    _draw_untouched(sheet.add_subplot(grid[1, :]), found)
    _draw_errors(sheet.add_subplot(grid[2, :3]), found)
    _draw_levels(sheet.add_subplot(grid[2, 3:]), found)
    return sheet


def _draw_closure(axes: Axes, found: FittedSensor, i: int, legend: bool) -> None:
    twin = found.twin
    band, place = twin.band, float(twin.model.places[i])
    recorded = twin.data.values[i]
    simulated = twin.model(*twin.point).value[i]
    flight = 2 * place / SPEED
    # The baseband is interpolated between its samples by its Fourier series.
    time = flight + np.linspace(*AROUND, 1200)
    for values, colour, label, style in (
        (recorded, ENVELOPE, "recorded", "-"), (simulated, RETURN, "simulated", "--"),
    ):  # fmt: skip
        spectrum = np.fft.fft(values) / len(values)
        turns = np.exp(2j * np.pi * np.outer(time - band.start, band.frequency))
        axes.plot(MS * time, (turns @ spectrum).real, style, color=colour, lw=0.7, label=label)
    axes.set_title(
        f"closed at {CM * place:.1f} cm, {PERCENT * twin.explained[i]:.2f} % of energy explained",
        fontsize=9,
    )
    axes.set_xlabel("time (ms)")
    axes.set_ylabel("signal in the band (counts)")
    if legend:
        axes.legend(fontsize=8)


def _draw_untouched(axes: Axes, found: FittedSensor) -> None:
    band, rest = found.twin.band, found.rest
    used = rest.recorded != 0
    place = CM * SPEED / 2 * band.time[used]
    axes.semilogy(place, np.abs(rest.recorded[used]), color=ENVELOPE, lw=1, label="recorded")
    axes.semilogy(place, np.abs(rest.explained[used]), "--", color=RETURN, lw=1, label="simulated")
    left = np.abs(rest.recorded - rest.explained)[used]
    axes.semilogy(place, left, color="0.6", lw=0.7, label="difference")
    noise = np.sqrt(found.twin.untouched.variance)
    axes.axhline(noise, color="k", lw=0.8, ls=":", label="noise of the mean")
    axes.set_ylim(0.2 * noise, None)
    if found.length is not None:
        axes.set_xlim(0.0, 1.1 * CM * found.length)
    axes.set(xlabel="distance of the echo (cm)", ylabel="envelope (counts)")
    axes.set_title("untouched: ring-down, clutter, far end", fontsize=9)
    axes.legend(fontsize=8)


def _draw_errors(axes: Axes, found: FittedSensor) -> None:
    twin = found.twin
    posterior = twin.posterior
    axes.errorbar(
        CM * twin.model.places, MM * posterior.displacement,
        yerr=1.645 * MM * posterior.displacement_deviation, fmt=".", color=ENVELOPE, capsize=2,
    )  # fmt: skip
    axes.axhspan(-MM * posterior.placement, MM * posterior.placement, color=ENVELOPE, alpha=0.15)
    axes.axhline(0.0, color="0.6", lw=0.7)
    axes.set(xlabel="stated distance (cm)", ylabel="true minus stated (mm)")
    axes.set_title("errors of the closures' places, 90 % intervals", fontsize=9)


def _draw_levels(axes: Axes, found: FittedSensor) -> None:
    twin = found.twin
    simulated = np.abs(twin.model(*twin.point).value)
    inside = twin.data.segments == 1
    peak = np.where(inside, np.abs(twin.data.values), 0).max(axis=1)
    place = CM * twin.model.places
    axes.semilogy(place, peak, "o", color=ENVELOPE, ms=4, label="recorded")
    axes.semilogy(
        place, np.where(inside, simulated, 0).max(axis=1), "x", color=RETURN, ms=5,
        label="simulated",
    )  # fmt: skip
    axes.set(xlabel="stated distance (cm)", ylabel="peak of the echo (counts)")
    axes.set_title("echo levels of the closures", fontsize=9)
    axes.legend(fontsize=8)
