"""Dimensioned drawing of a sensor: cross-section of its tube, and the sensor from the side."""

from __future__ import annotations

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from acoustube.base.report import counted
from acoustube.base.units import KHZ, MM, US
from acoustube.ranging import Burst, Chirp
from acoustube.runs.config.goal import DesignGoal
from acoustube.runs.design.candidates import Candidate

WALL, AIR, PART, GROUND = "#c9d6df", "#ffffff", "#4a6572", "#d9cbb0"
MEASURE = {"arrowstyle": "<->", "lw": 0.8, "shrinkA": 0, "shrinkB": 0}
SIDE = 16.0
"""Length of the drawn tube in outer diameters; two break lines show that it is shortened."""


def drawing(design: DesignGoal, candidate: Candidate) -> Figure:
    """Draw the cross-section of a sensor's tube to scale, and the sensor from the side, shortened.

    Parameters
    ----------
    design : DesignGoal
    candidate : Candidate
    """
    sheet = Figure(figsize=(10.0, 3.4), layout="constrained")
    left, right = sheet.subplots(1, 2, width_ratios=(1, 2.4))
    _section(left, design, candidate)
    _side(right, design, candidate)
    return sheet


def _section(axes: Axes, design: DesignGoal, candidate: Candidate) -> None:
    """Draw the tube's cross-section on the ground, with dimensions in mm."""
    bore, wall = candidate.tube.bore, candidate.tube.wall
    outer = bore + 2 * wall
    radius = outer / 2
    _ground(axes, design, -1.6 * radius, 3.2 * radius, -radius)
    axes.add_patch(Circle((0, 0), radius, fc=WALL, ec="k", lw=1))
    axes.add_patch(Circle((0, 0), bore / 2, fc=AIR, ec="k", lw=1))
    axes.plot([-1.15 * radius, 1.15 * radius], [0, 0], "k-.", lw=0.5)
    axes.plot([0, 0], [-1.15 * radius, 1.15 * radius], "k-.", lw=0.5)
    _measure(axes, (-bore / 2, 0.12 * radius), (bore / 2, 0.12 * radius), f"bore {bore:g}")
    _measure(axes, (-radius, 1.3 * radius), (radius, 1.3 * radius), f"outer {outer:g}")
    for x in (-radius, radius):
        axes.plot([x, x], [0, 1.4 * radius], "k-", lw=0.4)
    axes.annotate(
        f"wall {wall:g}, {candidate.tube.shore:.0f} Shore A", (0.62 * radius, -0.62 * radius),
        xytext=(0.2 * radius, -1.75 * radius), fontsize=8, arrowprops={"arrowstyle": "->"},
    )  # fmt: skip
    axes.set(xlim=(-1.7 * radius, 1.7 * radius), ylim=(-2.1 * radius, 1.8 * radius), aspect="equal")
    axes.set_title("section of the tube (mm)", fontsize=9)
    axes.axis("off")


def _side(axes: Axes, design: DesignGoal, candidate: Candidate) -> None:
    """Draw rangefinders, shortened tube, indenter and far end from the side."""
    bore, wall = candidate.tube.bore, candidate.tube.wall
    outer = bore + 2 * wall
    length, part = SIDE * outer, 1.6 * outer
    _ground(axes, design, 0, length, -outer / 2)
    for low, colour in ((-outer / 2, WALL), (bore / 2, WALL), (-bore / 2, AIR)):
        high = wall if colour == WALL else bore
        axes.add_patch(Rectangle((0, low), length, high, fc=colour, ec="k", lw=0.8))
    axes.plot([-part, length + part], [0, 0], "k-.", lw=0.5)
    _device(axes, -part, part, outer, candidate)
    if candidate.ends == 2:
        _device(axes, length, part, outer, candidate)
    else:
        axes.add_patch(Rectangle((length, -outer / 2), part / 2, outer, fc="#9a8c98", ec="k"))
        axes.text(length + part / 4, 0.8 * outer, "foam", ha="center", fontsize=8)
    middle, tool = 0.62 * length, max(design.goal.tools_mm)
    axes.add_patch(
        Circle((middle, outer / 2 + tool / 2), tool / 2, fc="none", ec="#c1443c", lw=1.2)
    )
    axes.text(
        middle + 0.6 * tool, outer + tool / 2, f"rod {tool:g} mm", color="#c1443c", fontsize=8
    )
    for shift in (0, 0.5 * outer):  # break lines
        x = 0.3 * length + shift
        path = [x, x + 0.3 * outer, x - 0.3 * outer, x]
        height = [-0.9 * outer, -0.25 * outer, 0.25 * outer, 0.9 * outer]
        axes.plot(path, height, "w-", lw=3)
        axes.plot(path, height, "k-", lw=0.6)
    words = f"{MM * design.goal.reach_m:.0f} mm, straight"
    _measure(axes, (0, -1.9 * outer), (length, -1.9 * outer), words)
    axes.text(-part, -3.1 * outer, _words(candidate), fontsize=8, va="top")
    axes.set(xlim=(-1.2 * part, length + 1.2 * part), aspect="equal",
             ylim=(-5.2 * outer, outer / 2 + 1.2 * tool))  # fmt: skip
    axes.set_title("from the side (the tube is shortened)", fontsize=9)
    axes.axis("off")


def _device(axes: Axes, start: float, part: float, outer: float, candidate: Candidate) -> None:
    axes.add_patch(Rectangle((start, -0.6 * outer), part, 1.2 * outer, fc=PART, ec="k"))
    axes.text(
        start + part / 2, 0.9 * outer, candidate.transducer, ha="center", fontsize=8, color=PART
    )


def _words(candidate: Candidate) -> str:
    """Return a description of the transducer, the pulse, the ADC and the number of rangefinders."""
    r = candidate.rangefinder
    assert isinstance(r.drive, Burst | Chirp)
    if candidate.transducer == "loudspeaker":
        band = f"loudspeaker and microphone, {KHZ * r.low_corner:g} to {KHZ * r.high_corner:g} kHz"
    else:
        band = f"transducer {KHZ * r.resonance:.2f} kHz, quality factor {r.quality_factor:g}"
    lasting = f"{US * r.drive.duration:.0f} us"
    pulse = f"burst of {r.drive.duration * r.drive.frequency:g} cycles, {lasting}"
    if isinstance(r.drive, Chirp):
        low, high = (r.drive.frequency + s * r.drive.bandwidth / 2 for s in (-1, 1))
        pulse = f"chirp {KHZ * low:.2f} to {KHZ * high:.2f} kHz, {lasting}"
    return (
        f"{band}; {pulse};\n{r.bits} bits at {KHZ * r.sampling_rate:g} kHz, "
        f"{r.n_samples} samples a cycle; {counted(candidate.ends, 'rangefinder')}"
    )


def _ground(axes: Axes, design: DesignGoal, start: float, width: float, top: float) -> None:
    goal = design.goal
    if goal.support == "table":
        axes.add_patch(Rectangle((start, top - 0.15 * abs(top)), width, 0.15 * abs(top), fc=GROUND,
                                 ec="k", hatch="////", lw=0.5))  # fmt: skip
        return
    axes.add_patch(Rectangle((start, top - 0.5 * abs(top)), width, 0.5 * abs(top), fc="#f1d9c6",
                             ec="k", lw=0.5))  # fmt: skip
    axes.text(start, top - 0.45 * abs(top), f"soft layer {goal.layer_mm:g} mm", fontsize=7)


def _measure(axes: Axes, start: tuple[float, float], end: tuple[float, float], words: str) -> None:
    """Draw a dimension line with its value."""
    axes.annotate("", end, xytext=start, arrowprops=MEASURE)
    axes.annotate(words, ((start[0] + end[0]) / 2, start[1]), xytext=(0, 2),
                  textcoords="offset points", ha="center", va="bottom", fontsize=8)  # fmt: skip
