"""Figures of the study of the sleeve paper's simulations."""

from __future__ import annotations

import json

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from acoustube.base.types import Array
from acoustube.base.units import CM, KHZ, MM, MS
from acoustube.lumen import deformed_wall
from acoustube.reports.figures import sweep as sweep_figure
from acoustube.reports.studies.simulation_cases import (
    CUT_ON,
    RODS,
    SOUND_SPEED,
    TRAPPED_AFTER_S,
    chosen,
    late_fraction,
    of_rod,
    only,
)
from acoustube.runs import presses as press_runs
from acoustube.runs.config import Config, configured

DRAWN = (2e-3, 4e-3, 6e-3, 8e-3)
"""Depths in m whose sections are drawn."""


def figures(
    lossless: xr.Dataset,
    lossy: xr.Dataset,
    low: xr.Dataset,
    carried: dict[tuple[str, float], dict[str, Array]],
) -> dict[str, Figure]:
    """Return the figures of the study by their captions.

    Parameters
    ----------
    lossless, lossy : xarray.Dataset
        Cases of the 40 cm tube at 42 kHz.
    low : xarray.Dataset
        Cases of the 1 m tube at 10, 20 and 42 kHz, with losses.
    carried : dict
        Power by mode, from :func:`acoustube.reports.studies.simulation_cases.carried_power`.
    """
    return {
        "Sections of the tube at the press, at 2, 4, 6 and 8 mm (columns; rods as rows). The top "
        "is pressed down; the bottom line is held.": _sections(lossless),
        "Highest echo and error of its distance against depth, without losses (solid) and with "
        "(dashed); the source end of the sleeve paper (above) and an absorbing one.": (
            _over_depth(lossless, lossy)
        ),
        "Envelopes of the reflected pulses (release end, no losses). Dotted: the press; red: "
        "the highest echo. Later ones are sound that was trapped near the rod.": _pulses(lossless),
        f"Echo energy later than {MS * TRAPPED_AFTER_S:g} ms after the direct echo, as a fraction "
        "of "
        "the whole, absorbing end: trapped sound, without and with losses.": _late(lossless, lossy),
        "Reflected (left) and transmitted (right) power of an incident plane wave by modes, in "
        "the pulse's band, against depth. A plane-averaging probe records only the plane wave.": (
            _modes(carried)
        ),
        "The highest echo at 10, 20 and 42 kHz, absorbing source end, with losses. Below "
        f"{KHZ * CUT_ON:.1f} kHz only the plane wave propagates; the echo rises steadily with "
        "depth only where the press is short against the wavelength, "
        f"{MM * SOUND_SPEED / 10e3:.0f} mm at "
        f"10 kHz and {MM * SOUND_SPEED / 20e3:.0f} mm at 20 kHz.": _frequencies(low),
    }


def _sections(cases: xr.Dataset) -> Figure:
    """Draw sections of wall and lumen under each rod."""
    sheet = Figure(figsize=(11, 5.5), layout="constrained")
    axes = sheet.subplots(len(RODS), len(DRAWN), sharex=True, sharey=True)
    for row, rod in zip(axes, RODS, strict=True):
        some = of_rod(cases, rod)
        depths = tuple(float(depth) for depth in some["depth"].values)
        config = configured(json.loads(str(some["configuration"].values[0])))
        walls = _walls(config, depths)
        for panel, depth in zip(row, DRAWN, strict=True):
            i = int(np.argmin(np.abs(np.array(depths) - depth)))
            _draw_section(panel, *walls[i])
            panel.set_title(
                f"{rod} mm rod, {MM * depths[i]:g} mm: {float(some['force'].values[i]):.2f} N",
                fontsize="medium",
            )
    axes[-1, 0].set(xlabel="x (mm)", ylabel="y (mm)")
    return sheet


def _walls(config: Config, depths: tuple[float, ...]) -> list[tuple[Array, Array]]:
    """Return inner and outer wall at the press, (n, 2) in mm, at each depth."""
    found = press_runs.pressed(config, [round(depth, 9) for depth in depths])
    walls = []
    for row in found.rows_at([round(depth, 9) for depth in depths]):
        rings = [deformed_wall(found, row, outer=outer)[0] for outer in (False, True)]
        walls.append((MM * rings[0][:, :2], MM * rings[1][:, :2]))
    return walls


def _draw_section(axes: Axes, inner: Array, outer: Array) -> None:
    axes.fill(*outer.T, color="#d9c9a8", lw=0)
    axes.fill(*inner.T, color="white", ec="#22405c", lw=1.2)
    axes.plot(*np.vstack([outer, outer[:1]]).T, color="#8a7a58", lw=1)
    axes.set_aspect("equal")


def _over_depth(lossless: xr.Dataset, lossy: xr.Dataset) -> Figure:
    sheet = Figure(figsize=(11, 7.5), layout="constrained")
    axes = sheet.subplots(2, 2, sharex=True)
    for row, end in zip(axes, ("release", "absorbing"), strict=True):
        for cases, dash in ((chosen(lossless, end), "-"), (chosen(lossy, end), "--")):
            for i, rod in enumerate(RODS):
                some = of_rod(cases, rod)
                depth, colour = MM * some["depth"].values, f"C{i}"
                label = f"{rod} mm rod" if dash == "-" else None
                row[0].plot(depth, 100 * some["amplitude"].values, dash, marker=".", color=colour,
                            label=label)  # fmt: skip
                row[1].plot(depth, CM * some["error"].values, dash, marker=".", color=colour)
        row[0].set(yscale="log", ylabel="highest echo (% of the send pulse)")
        row[1].set_ylabel("error of the distance (cm)")
        row[1].axhline(0, color="0.7", lw=0.8, zorder=0)
        row[0].set_title(f"{end} source end", fontsize="medium")
    axes[0, 0].legend(fontsize="small")
    for panel in axes[1]:
        panel.set_xlabel("depth (mm)")
    return sheet


def _pulses(cases: xr.Dataset) -> Figure:
    sheet = Figure(figsize=(12, 4), layout="constrained")
    axes = sheet.subplots(1, len(RODS), sharey=True)
    for panel, rod in zip(axes, RODS, strict=True):
        image = sweep_figure.draw_echoes(panel, of_rod(chosen(cases, "release"), rod).sel(
            source_end="release"))  # fmt: skip
        panel.set_title(f"{rod} mm rod", fontsize="medium")
    sheet.colorbar(image, ax=list(axes), label="envelope, relative to the send pulse")
    return sheet


def _late(lossless: xr.Dataset, lossy: xr.Dataset) -> Figure:
    sheet = Figure(figsize=(7, 4), layout="constrained")
    axes = sheet.subplots()
    for cases, dash in ((lossless, "-"), (lossy, "--")):
        fractions = cases.assign(late=("press", late_fraction(cases)))
        for i, rod in enumerate(RODS):
            some = of_rod(fractions, rod)
            label = f"{rod} mm rod" + " with losses" * (dash == "--")
            axes.plot(MM * some["depth"].values, 100 * some["late"].values, dash, marker=".",
                      color=f"C{i}", label=label)  # fmt: skip
    axes.set(xlabel="depth (mm)", ylabel="late energy (%)", ylim=(0, 100))
    axes.legend(fontsize="small")
    return sheet


def _modes(carried: dict[tuple[str, float], dict[str, Array]]) -> Figure:
    sheet = Figure(figsize=(11, 8), layout="constrained")
    axes = sheet.subplots(len(RODS), 2, sharex=True, sharey="col")
    names = {"00": "plane", "11c": "(1,1)", "21c": "(2,1)", "01": "(0,1)"}
    for row, rod in zip(axes, RODS, strict=True):
        depths = sorted(depth for name, depth in carried if name == rod)
        for port, panel in enumerate(row):
            for mode, words in names.items():
                percent = [100 * carried[rod, d].get(mode, np.zeros(2))[port] for d in depths]
                panel.plot(MM * np.array(depths), percent, ".-", label=words)
            panel.set(yscale="log", ylim=(1e-4, 150))
            panel.set_title(f"{rod} mm rod, {('reflected', 'transmitted')[port]}",
                            fontsize="medium")  # fmt: skip
        row[0].set_ylabel("power (%)")
    axes[0, 0].legend(fontsize="small")
    for panel in axes[-1]:
        panel.set_xlabel("depth (mm)")
    return sheet


def _frequencies(cases: xr.Dataset) -> Figure:
    sheet = Figure(figsize=(12, 4), layout="constrained")
    axes = sheet.subplots(1, len(RODS), sharey=True)
    for panel, rod in zip(axes, RODS, strict=True):
        for frequency in (10e3, 20e3, 42e3):
            some = of_rod(chosen(only(cases, "carrier_frequency", frequency), "absorbing"), rod)
            panel.plot(MM * some["depth"].values, 100 * some["amplitude"].values, ".-",
                       label=f"{KHZ * frequency:g} kHz")  # fmt: skip
        panel.set(yscale="log", xlabel="depth (mm)")
        panel.set_title(f"{rod} mm rod", fontsize="medium")
    axes[0].set_ylabel("highest echo (% of the send pulse)")
    axes[0].legend(fontsize="small")
    return sheet
