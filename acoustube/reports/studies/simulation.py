"""The paper's simulations (section II-D, Fig. 2): three rods, all depths, a tube of 40 cm.

Beyond them: what losses and the source end change, what stays trapped beside a rod, which modes
carry the sound, and the same presses at 10 and 20 kHz.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from acoustube import signals
from acoustube.base.report import Reporter
from acoustube.base.types import Array
from acoustube.base.units import CM, MM
from acoustube.lumen import deformed_wall
from acoustube.reports.figures import sweep as sweep_figure
from acoustube.reports.studies.presses import matrices, swept
from acoustube.reports.studies.report import Level, Row, Scale, Study
from acoustube.runs import presses as press_runs
from acoustube.runs.config import Config, configured
from acoustube.runs.config.si import settings_in_si
from acoustube.runs.sweep import select
from acoustube.waves import Scattering

RODS = {"10": (3.03, 1.22), "25": (2.95, 1.92), "35": (2.51, 1.64)}
"""Published mean absolute error of the distance in cm and its deviation, by diameter in mm."""
DEPTHS, FEW_DEPTHS = "0.5:8:0.5", "3:6:3"
TRAPPED_AFTER = 0.4e-3
"""Time in s after the direct echo's middle from which sound was trapped: the pulse lasts 0.26 ms,
its reflection by the source end comes 0.12 ms later."""
LOSSY = {"losses": ["on"], "frequency_khz": ["10", "20", "42"], "length_cm": ["40", "100"]}
"""With losses, lower carriers too. Their pulses of 11 cycles, 38 cm long at 10 kHz, need the longer
tube; one scattering matrix serves all."""
DEFAULT = settings_in_si(Config())
"""Of the sweeps, but for what they vary."""
CARRIER, PROBE = DEFAULT.pulse.frequency, DEFAULT.probe
"""In Hz, and the place of the plane that sound is heard at in m."""
DRAWN = (2e-3, 4e-3, 6e-3, 8e-3)
"""Depths in m whose sections are drawn."""


def study(scale: Scale, work: Path, report: Reporter) -> Study:
    """Press with three rods, and find them by their echoes.

    Parameters
    ----------
    scale : Scale
    work : Path
        Where sweeps are kept.
    report : Reporter

    Returns
    -------
    Study
    """
    depths = [FEW_DEPTHS if scale.quick else DEPTHS]
    rods = {"indenter_mm": list(RODS), "depth_mm": depths}

    def at(name: str, level: Level, **over: list[str]) -> xr.Dataset:
        return swept(work / name, {**rods, **over}, level, scale, report)

    lossless = at("lossless", scale.level, losses=["off"])
    heard = at("lossy", scale.level, **LOSSY)
    lossy = _only(_only(heard, "carrier_frequency", CARRIER), "tube_length", 0.4)
    low = _only(heard, "tube_length", 1.0)
    coarser = None if scale.coarser is None else at("coarser", scale.coarser, losses=["off"])
    carried = carried_power(work / "lossless")
    return Study(
        title="Simulation study: three rods on a straight tube (Fig. 2)",
        text=TEXT,
        rows=[
            *_error_rows(lossless, lossy, coarser),
            *_amplitude_rows(lossless, low, coarser),
            *_time_rows(lossless, coarser),
        ],
        figures={
            "Sections of the tube at the press, at 2, 4, 6 and 8 mm (columns; rods as rows). The "
            "top is pressed down; the bottom line is held.": _sections(lossless),
            "Highest echo and error of its distance against depth, without losses (solid) and with "
            "(dashed); the source end of the paper (above) and an absorbing one.": _over_depth(
                lossless, lossy
            ),
            "Envelopes of the reflected pulses (release end, no losses). Dotted: the press; red: "
            "the highest echo. Later ones were trapped beside the rod.": _pulses(lossless),
            "Echo energy that comes later than 0.4 ms after the direct echo, as a share of all, "
            "absorbing end: trapped sound, and what losses leave of it.": _late(lossless, lossy),
            "Where the power of an incident plane wave goes, in the band of the pulse, against "
            "depth: reflected (left) and transmitted (right), by modes. Most of what comes back at "
            "42 kHz is in (1,1), which a plane-averaging probe does not hear.": _modes(carried),
            "The highest echo at 10, 20 and 42 kHz, absorbing end, with losses. Below 25.5 kHz "
            "the plane wave is alone; the echo rises steadily with depth only where the press is "
            "short against the wavelength, 34 mm at 10 kHz and 17 mm at 20 kHz.": _frequencies(low),
        },
    )


TEXT = """\
The paper's 40 cm tube is pressed in its middle by rods of 10, 25 and 35 mm until it is closed. A
pulse of 11 cycles at 42 kHz leaves a pressure-driven end, which afterwards is a pressure release; a
plane 2 cm away listens; the far end absorbs. The envelope's highest peak, if it is over 0.1 % of
the send pulse, tells the distance.

As published there are no losses. With them, and with a source end that absorbs, as a transducer
does more nearly, the same presses are heard again.

The distance's error has two values: under 1 cm where the direct echo is highest, 5 to 6 cm where
the highest is sound that was trapped beside the rod, in a mode (2,1) whose cut-on in the widened
lumen lies below the carrier and in the round bore just above. A mean over depths is a mixture of
the two. With a pressure-release end the echo is heard twice, 0.117 ms apart, which adds 2 to 3 cm
where the second lobe is the higher.

The direct echo itself moves from about a centimetre beyond the press to almost one before it as the
press deepens, since its near flank takes over: time of flight does depend on depth, though the
speed of sound does not."""


def chosen(cases: xr.Dataset, end: str) -> xr.Dataset:
    """Return cases with amplitude, distance and its error at one source end."""
    return select.chosen(cases.assign(chosen_source_end=("press", [end] * cases.press.size)))


def of_rod(cases: xr.Dataset, rod: str) -> xr.Dataset:
    """Return the cases of a rod, given its diameter in mm, by depth."""
    return _only(cases, "diameter", 1e-3 * float(rod)).sortby("depth")


def mean_error(cases: xr.Dataset | None, rod: str, end: str = "release") -> tuple[float, float]:
    """Return mean and deviation of a rod's absolute errors in cm, where there is an echo."""
    if cases is None:
        return float("nan"), float("nan")
    size = CM * np.abs(of_rod(chosen(cases, end), rod)["error"].values)
    return float(np.nanmean(size)), float(np.nanstd(size))


def _error_rows(lossless: xr.Dataset, lossy: xr.Dataset, coarser: xr.Dataset | None) -> list[Row]:
    why = (
        "A mixture of two values, under 1 cm and 5 to 6 cm (see the text); which depths show which "
        "decides the mean. The paper's depths and least prominence are not stated."
    )
    rows = []
    for rod, published in RODS.items():
        ours, other = mean_error(lossless, rod), mean_error(coarser, rod)
        for i, what in enumerate(("mean absolute error", "its deviation")):
            rows.append(
                Row(
                    quantity=f"{rod} mm rod: {what} of the distance", unit="cm",
                    published=published[i], ours=ours[i], coarser=other[i], why=why,
                )
            )  # fmt: skip
    for words, cases, end in (
        ("with losses", lossy, "release"),
        ("absorbing source end", lossless, "absorbing"),
        ("absorbing source end, with losses", lossy, "absorbing"),
    ):
        rows += [
            Row(
                quantity=f"{rod} mm rod: mean absolute error, {words}", unit="cm",
                ours=mean_error(cases, rod, end)[0], why="Not published.",
            )
            for rod in RODS
        ]  # fmt: skip
    return rows


def _amplitude_rows(lossless: xr.Dataset, low: xr.Dataset, coarser: xr.Dataset | None) -> list[Row]:
    rows = [
        Row(
            quantity="depths at which the 10 mm rod echoes most", unit="%", published=100.0,
            ours=_smallest_wins(lossless),
            coarser=None if coarser is None else _smallest_wins(coarser),
            why="Published as: the largest amplitudes occur for the 10 mm indenter.",
        )
    ]  # fmt: skip
    for frequency in (10e3, 20e3, 42e3):
        for rod in RODS:
            some = of_rod(_only(low, "carrier_frequency", frequency), rod)
            rows.append(
                Row(
                    quantity=f"{rod} mm rod, {frequency / 1e3:g} kHz: steps of depth at which "
                    "the echo rises", unit="%",
                    ours=100 * rising(chosen(some, "absorbing")["amplitude"].values),
                    why="100 % is monotonic. The paper expects it below 25.5 kHz, where only the "
                    "plane wave propagates; but at 20 kHz both flanks of a press of 24 mm and more "
                    "reflect, and interfere.",
                )
            )  # fmt: skip
    return rows


def rising(amplitude: Array) -> float:
    """Return the share of neighbours that rise; a missing echo counts as none at all."""
    return float(np.mean(np.diff(np.nan_to_num(amplitude)) >= 0))


def _smallest_wins(cases: xr.Dataset) -> float:
    there = chosen(cases, "release")
    heights = np.stack([np.nan_to_num(of_rod(there, rod)["amplitude"].values) for rod in RODS])
    heard = heights.max(axis=0) > 0
    return 100 * float(np.mean(heights.argmax(axis=0)[heard] == 0))


def _only(cases: xr.Dataset, label: str, value: float) -> xr.Dataset:
    """Return the cases with one value of a label."""
    return cases.isel(press=np.flatnonzero(np.isclose(cases[label].values, value)))


def _time_rows(lossless: xr.Dataset, coarser: xr.Dataset | None) -> list[Row]:
    """Return how far the direct echo moves with depth, while it is the highest."""
    why = (
        "The wall is rigid for sound at 42 kHz, the speed of sound the same at all depths: what "
        "moves is the part of the press that reflects. The paper suspects a speed that depends on "
        "depth, and finds little of it in its simulations too."
    )
    return [
        Row(
            quantity=f"{rod} mm rod: range over depth of the distance told by the direct echo",
            unit="cm", ours=direct_range(lossless, rod),
            coarser=None if coarser is None else direct_range(coarser, rod), why=why,
        )
        for rod in RODS
    ]  # fmt: skip


def direct_range(cases: xr.Dataset, rod: str) -> float:
    """Return the range in cm of the estimates that are within 2 cm of the press."""
    error = CM * of_rod(chosen(cases, "absorbing"), rod)["error"].values
    near = error[np.abs(error) < 2.0]
    return float(np.ptp(near)) if near.size else float("nan")


def late_share(cases: xr.Dataset, end: str = "absorbing") -> Array:
    """Return the share of the echo's energy that comes later than :data:`TRAPPED_AFTER`."""
    signal = np.nan_to_num(cases["pressure"].sel(source_end=end).values.astype(float)) ** 2
    time = cases["time"].values
    way = 2 * cases["true_distance"].values - PROBE
    middle = DEFAULT.pulse.duration / 2 + way / signals.speed_of_sound(cases["temperature"].values)
    after = time[None] - middle[:, None]
    echo = after > -DEFAULT.pulse.duration / 2
    return np.asarray(
        (signal * (after > TRAPPED_AFTER)).sum(axis=1)
        / np.maximum((signal * echo).sum(axis=1), 1e-30)
    )


# ---------------------------------------------------------------------------------------------
# Modes


def carried_power(folder: Path) -> dict[tuple[str, float], dict[str, Array]]:
    """Return where the power of an incident plane wave goes, averaged over the pulse's spectrum.

    Returns
    -------
    dict
        By diameter in mm and depth in m; then by mode: reflected and transmitted shares.
    """
    found = {}
    for cases, matrix in matrices(folder):
        rod = f"{MM * float(cases['diameter'].values[0]):g}"
        found[rod, float(cases["depth"].values[0])] = _shares(matrix)
    return found


def _shares(matrix: Scattering) -> dict[str, Array]:
    """Return the shares of power of each mode, (reflected, transmitted)."""
    weight = np.abs(_spectrum(matrix.frequency)) ** 2
    plane = matrix.modes.index("00")
    power = np.abs(matrix.s[:, :, :, 0, plane]) ** 2
    mean = np.einsum("f,fpm->pm", weight / weight.sum(), power)
    return {mode: mean[:, i] for i, mode in enumerate(matrix.modes)}


def _spectrum(frequency: NDArray[Any]) -> Any:
    """Return the pulse's spectrum, up to a factor, at frequencies in Hz."""
    pulse = DEFAULT.pulse
    time = np.arange(0.0, pulse.duration, 1e-6)
    return np.exp(-2j * np.pi * np.outer(frequency, time)) @ np.asarray(pulse(time))


# ---------------------------------------------------------------------------------------------
# Figures


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
    axes[-1, 0].set_xlabel("x (mm)")
    axes[-1, 0].set_ylabel("y (mm)")
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
        row[0].set_yscale("log")
        row[0].set_ylabel("highest echo (% of the send pulse)")
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
    sheet.colorbar(image, ax=list(axes), label="envelope, share of the send pulse")
    return sheet


def _late(lossless: xr.Dataset, lossy: xr.Dataset) -> Figure:
    sheet = Figure(figsize=(7, 4), layout="constrained")
    axes = sheet.subplots()
    for cases, dash in ((lossless, "-"), (lossy, "--")):
        shares = cases.assign(late=("press", late_share(cases)))
        for i, rod in enumerate(RODS):
            some = of_rod(shares, rod)
            label = f"{rod} mm rod" + " with losses" * (dash == "--")
            axes.plot(MM * some["depth"].values, 100 * some["late"].values, dash, marker=".",
                      color=f"C{i}", label=label)  # fmt: skip
    axes.set_xlabel("depth (mm)")
    axes.set_ylabel("energy that comes late (%)")
    axes.set_ylim(0, 100)
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
                share = [100 * carried[rod, d].get(mode, np.zeros(2))[port] for d in depths]
                panel.plot(MM * np.array(depths), share, ".-", label=words)
            panel.set_yscale("log")
            panel.set_ylim(1e-4, 150)
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
            some = of_rod(chosen(_only(cases, "carrier_frequency", frequency), "absorbing"), rod)
            panel.plot(MM * some["depth"].values, 100 * some["amplitude"].values, ".-",
                       label=f"{frequency / 1e3:g} kHz")  # fmt: skip
        panel.set_yscale("log")
        panel.set_xlabel("depth (mm)")
        panel.set_title(f"{rod} mm rod", fontsize="medium")
    axes[0].set_ylabel("highest echo (% of the send pulse)")
    axes[0].legend(fontsize="small")
    return sheet
