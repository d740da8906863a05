"""The command ``acoustube sleeve``: markers or sizes of a forearm in, a table of places out."""

from __future__ import annotations

import csv
import re
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console

from acoustube.base.console import note
from acoustube.base.errors import ConfigError
from acoustube.base.files import partial_folder, publish
from acoustube.base.types import Array
from acoustube.base.version import __version__
from acoustube.recordings.markers import Markers
from acoustube.reports.scenes import sleeve as sleeve_scene
from acoustube.sleeve import (
    Helix,
    Layout,
    check_reach,
    check_room,
    design,
    fit_arm,
    layout,
    nearest,
    read_markers,
    wound,
)
from acoustube.sleeve.arm_fit import Arm

COLUMNS = (
    "tube", "distance_cm", "x_mm", "y_mm", "z_mm", "along_cm", "angle_deg", "loop", "heard",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What the sleeve shall be, in the user's units made SI; see the command's options.

    Attributes
    ----------
    markers : Path or None
    forearm : tuple of float or None
        Length and the two girths in m.
    loops, pitch : float or None
    tubes : int
    phase : float
        In rad.
    hand, axis : str
    lead, dead_zone, reach, outer_diameter, deviation, within, step : float
        In m.
    contacts : tuple of (int, float)
        Tube, counted from 0, and distance in m.
    unit : str or None
    columns : tuple of str or None
    """

    markers: Path | None
    forearm: tuple[float, float, float] | None
    loops: float | None
    pitch: float | None
    tubes: int
    phase: float
    hand: str
    axis: str
    lead: float
    dead_zone: float
    reach: float
    outer_diameter: float
    deviation: float
    within: float
    step: float
    contacts: tuple[tuple[int, float], ...]
    unit: str | None
    columns: tuple[str, str] | None


def run_sleeve(plan: Plan, folder: Path, console: Console) -> Path:
    """Lay out a sleeve and write its table, its figures in words and its picture.

    Parameters
    ----------
    plan : Plan
    folder : Path
        To be made: ``sleeve.csv``, ``layout.txt`` and ``figure.png``.
    console : rich.console.Console
        Where to print.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    ConfigError
        If the markers or the sizes give no sleeve, or a contact is not on it.
    """
    started = time.perf_counter()
    tubes, words, seen = _tubes(plan)
    found = layout(
        tubes,
        dead_zone=plan.dead_zone,
        reach=plan.reach,
        within=plan.within,
        deviation=plan.deviation,
    )
    check_room(tubes, plan.outer_diameter)
    words += in_words(tubes, found)
    words += [_contact(plan, tubes, found, contact) for contact in plan.contacts]
    console.print(f"[bold]acoustube {__version__}[/] sleeve", soft_wrap=True)
    for line in words:
        console.print(line, soft_wrap=True, markup=False, highlight=False)
    with partial_folder(folder) as partial:
        write_table(partial / "sleeve.csv", tubes, found, plan.step)
        (partial / "layout.txt").write_text("\n".join(words) + "\n", encoding="utf-8")
        picture = sleeve_scene.Picture(
            tubes=tuple(tubes),
            heard=found.heard,
            outer_diameter=plan.outer_diameter,
            contacts=plan.contacts,
            deviation=plan.deviation,
            markers=seen,
        )
        if not sleeve_scene.draw(picture, partial / "figure.png"):
            note(console, "VTK cannot draw on this machine; there is no picture")
        folder = publish(partial, folder)
    elapsed = time.perf_counter() - started
    console.print(f"Written to [bold]{folder}[/] in {elapsed:.0f} s.", soft_wrap=True)
    return folder


def _tubes(plan: Plan) -> tuple[list[Helix], list[str], Array]:
    """Return the tubes, where they come from in words, and the markers in m, (n, 3)."""
    if plan.markers is None:
        assert plan.forearm is not None
        length, *girths = plan.forearm
        tubes = design(
            length,
            (girths[0], girths[1]),
            loops=plan.loops,
            pitch=plan.pitch,
            n_tubes=plan.tubes,
            phase=plan.phase,
            hand=plan.hand,
            lead=plan.lead,
            outer_diameter=plan.outer_diameter,
            reach=plan.reach,
        )
        start = (
            f"forearm: {100 * length:g} cm long, {100 * girths[0]:g} cm around at the end near the "
            f"sensors, {100 * girths[1]:g} cm at the other"
        )
        return tubes, [start], np.empty((0, 3))
    markers = read_markers(plan.markers, unit=plan.unit, columns=plan.columns)
    arm = fit_arm(markers.first, markers.second, axis=plan.axis)
    loops = plan.loops if plan.pitch is None else arm.length / plan.pitch
    assert loops is not None
    tubes = wound(arm, loops, n_tubes=plan.tubes, phase=plan.phase, hand=plan.hand, lead=plan.lead)
    check_reach(tubes, plan.reach)
    return tubes, _fit_in_words(plan, markers, arm), np.concatenate([markers.first, markers.second])


def _fit_in_words(plan: Plan, markers: Markers, arm: Arm) -> list[str]:
    """Return what was read and fitted, one sentence each."""
    unit = markers.unit if markers.told else f"{markers.unit}, since nothing else is told"
    words = [
        f"markers: {plan.markers}, columns {' and '.join(markers.names)}, in {unit}",
        "axis: midway between the columns, taken to lie on opposite sides of the arm"
        if plan.axis == "fitted"
        else "axis: z of the markers",
    ]
    for name, line, kept, points in zip(
        markers.names, arm.lines, arm.kept, (markers.first, markers.second), strict=True
    ):
        gaps = int(np.sum(~np.all(np.isfinite(points), axis=1)))
        left = int(np.sum(~kept)) - gaps
        low, high = line.interval().T
        words.append(
            f"column {name}: r = {1e3 * line.radius:.2f} mm ({1e3 * low[0]:.2f} to "
            f"{1e3 * high[0]:.2f}) + {line.taper:.4f} z ({low[1]:.4f} to {high[1]:.4f}) at 95 %, "
            f"{int(kept.sum())} markers within {1e3 * line.deviation:.2f} mm"
            + (f", {left} left out as outliers" if left else "")
            + (f", {gaps} gap{'s' * (gaps > 1)}" if gaps else "")
        )
    return words


def in_words(tubes: Sequence[Helix], found: Layout) -> list[str]:
    """Return a layout's figures, one sentence each.

    Parameters
    ----------
    tubes : sequence of Helix
    found : Layout
    """
    tube = tubes[0]
    lengths = " and ".join(f"{100 * length:.1f}" for length in found.tube_lengths)
    hand = f"{tube.hand}-handed"
    first = (
        f"tubes: {len(tubes)}, {hand}, {tube.loops:.4g} loops each over {100 * tube.length:.1f} "
        f"cm, pitch {100 * found.pitch:.2f} cm; {lengths} cm long with a lead of "
        f"{100 * tube.lead:g} cm"
    )
    words = [first, f"spacing: {1e3 * found.spacing:.1f} mm from tube to tube"]
    for number, ((near, far), each) in enumerate(zip(found.heard, tubes, strict=True), start=1):
        words.append(
            f"tube {number}: presses are heard from {100 * near:.0f} to {100 * far:.0f} cm"
            + (
                f"; its first {100 * (near - each.lead):.0f} cm on the arm are in the dead zone"
                if near > each.lead + 1e-9
                else ", the dead zone lies in the lead"
            )
        )
    words.append(
        f"coverage: {100 * found.coverage:.1f} % of {1e4 * found.skin_area:.0f} cm2 of skin lie "
        f"within {1e3 * found.within:g} mm of a tube that hears them, {100 * found.blind:.1f} % at "
        "a tube that does not"
    )
    words.append(
        f"resolution: a distance known to {100 * found.deviation:g} cm tells a patch of "
        f"{1e4 * found.patch_area:.1f} cm2, {found.patches:.0f} of them on the sleeve"
    )
    return words


def _contact(plan: Plan, tubes: Sequence[Helix], found: Layout, contact: tuple[int, float]) -> str:
    """Return where a contact is, in words."""
    number, distance = contact
    if number >= len(tubes):
        raise ConfigError(
            f"distance = {number + 1}:{100 * distance:g} is on tube {number + 1} and the sleeve "
            f"has {len(tubes)}; use 1 to {len(tubes)}"
        )
    tube = tubes[number]
    near, far = found.heard[number]
    if not near <= distance <= far:
        raise ConfigError(
            f"distance = {100 * distance:g} cm is not on the part of tube {number + 1} that hears; "
            f"use {100 * near:.4g} to {100 * far:.4g} cm"
        )
    z = float(tube.height(distance))
    x, y, height = 1e3 * tube.place(distance)
    along = plan.deviation / float(tube.density(z))
    around = np.degrees(abs(tube.twist) * along)
    beside = nearest(tubes, tube.place(distance))
    return (
        f"contact at {100 * distance:g} cm on tube {number + 1}: x {x:.1f}, y {y:.1f}, z "
        f"{height:.1f} mm, {100 * z:.1f} cm along the arm, {np.degrees(tube.angle(z)) % 360:.0f} "
        f"degrees, loop {int(z / tube.pitch) + 1}; ± {1e3 * plan.deviation:g} mm along the tube "
        f"is ± {1e3 * along:.1f} mm along the arm and {around:.0f} degrees around it; the next "
        f"loop, of tube {int(beside.next_tube) + 1}, is {1e3 * float(beside.next_gap):.0f} mm "
        f"away, where it reads {100 * float(beside.next_distance):.0f} cm"
    )


def write_table(path: Path, tubes: Sequence[Helix], found: Layout, step: float) -> None:
    """Write the table from distance to place.

    Parameters
    ----------
    path : Path
        The CSV file; x, y and z are those of the markers, or of the arm where there are none.
    tubes : sequence of Helix
    found : Layout
    step : float
        Between two distances in m; the last row of a tube is its end.
    """
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(COLUMNS)
        for number, (tube, (near, far)) in enumerate(zip(tubes, found.heard, strict=True), start=1):
            end = tube.tube_length
            distance = np.append(np.arange(tube.lead, end - 1e-9, step), end)
            z = tube.height(distance)
            loop = np.minimum((z / tube.pitch).astype(int) + 1, int(np.ceil(tube.loops)))
            angle = np.round(np.degrees(tube.angle(z)), 2) % 360
            for row in zip(distance, tube.place(distance), z, angle, loop, strict=True):
                at, place, along, turned, turn = row
                heard = int(near - 1e-9 <= at <= far + 1e-9)
                cells = [f"{100 * at:.2f}", *(f"{1e3 * value:.3f}" for value in place)]
                table.writerow([number, *cells, f"{100 * along:.3f}", f"{turned:.2f}", turn, heard])


def contacts_of(words: Sequence[str]) -> tuple[tuple[int, float], ...]:
    """Return contacts from words such as ``80`` and ``2:80``: tube from 0, distance in m.

    Raises
    ------
    ConfigError
        If a word is neither.
    """
    found = []
    for word in words:
        match = re.fullmatch(r"(?:(\d+):)?(\d+(?:\.\d*)?|\.\d+)", word.strip())
        if match is None or match[1] == "0":
            raise ConfigError(
                f"distance = {word} is not a distance; use cm, as in 80, with the tube before it "
                "as in 2:80"
            )
        found.append((int(match[1] or 1) - 1, 1e-2 * float(match[2])))
    return tuple(found)
