"""Layout of a sleeve in sentences, and a table of positions on the arm by distance along a tube."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from math import ceil, floor
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acoustube.base.errors import ConfigError
from acoustube.base.units import CM, CM2, MM
from acoustube.base.writing import write
from acoustube.recordings.markers import Markers
from acoustube.sleeve import Helix, Layout, nearest
from acoustube.sleeve.arm_fit import Arm

COLUMNS = (
    "tube", "distance_cm", "x_mm", "y_mm", "z_mm", "along_cm", "angle_deg", "loop", "heard",
)  # fmt: skip
ROUNDING = 1e-9
"""Rounding error in m that is allowed where a distance is compared with a detection range."""


def fit_in_words(path: Path, axis: str, markers: Markers, arm: Arm) -> list[str]:
    """Return descriptions of the markers and the fitted arm, one sentence each.

    Parameters
    ----------
    path : Path
        File of the markers.
    axis : str
        Axis of the arm: ``fitted`` midway between the columns of markers, or ``z`` of the markers.
    markers : Markers
    arm : Arm
    """
    unit = markers.unit if markers.unit_stated else f"{markers.unit}, since the file states none"
    words = [
        f"markers: {path}, columns {' and '.join(markers.names)}, in {unit}",
        "axis: midway between the columns, taken to lie on opposite sides of the arm"
        if axis == "fitted"
        else "axis: z of the markers",
    ]
    for name, line, kept, points in zip(
        markers.names, arm.lines, arm.kept, (markers.first, markers.second), strict=True
    ):
        gaps = int(np.sum(~np.all(np.isfinite(points), axis=1)))
        left = int(np.sum(~kept)) - gaps
        low, high = line.interval().T
        words.append(
            f"column {name}: r = {MM * line.radius:.2f} mm ({MM * low[0]:.2f} to "
            f"{MM * high[0]:.2f}) + {line.taper:.4f} z ({low[1]:.4f} to {high[1]:.4f}) at 95 %, "
            f"{int(kept.sum())} markers with a standard deviation of {MM * line.deviation:.2f} mm"
            + (f", {left} left out as outliers" if left else "")
            + (f", {gaps} gap{'s' * (gaps > 1)}" if gaps else "")
        )
    return words


def in_words(tubes: Sequence[Helix], found: Layout) -> list[str]:
    """Return sentences on tube lengths, spacing, detection ranges, coverage and resolution."""
    tube = tubes[0]
    lengths = " and ".join(f"{CM * length:.1f}" for length in found.tube_lengths)
    hand = f"{tube.hand}-handed"
    first = (
        f"tubes: {len(tubes)}, {hand}, {tube.loops:.4g} loops each over {CM * tube.length:.1f} "
        f"cm, pitch {CM * found.pitch:.2f} cm; {lengths} cm long with a lead of "
        f"{CM * tube.lead:g} cm"
    )
    words = [first, f"spacing: {MM * found.spacing:.1f} mm from tube to tube"]
    for number, ((near, far), each) in enumerate(
        zip(found.detection_range, tubes, strict=True), start=1
    ):
        words.append(
            f"tube {number}: presses are detected from {CM * near:.0f} to {CM * far:.0f} cm"
            + (
                f"; its first {CM * (near - each.lead):.0f} cm on the arm are in the dead zone"
                if near > each.lead + 1e-9
                else ", the dead zone lies in the lead"
            )
        )
    words.append(
        f"coverage: {100 * found.coverage:.1f} % of {CM2 * found.skin_area:.0f} cm2 of skin lie "
        f"within {MM * found.within:g} mm of the detection range of a tube, "
        f"{100 * found.blind:.1f} % next to a dead zone or beyond the reach"
    )
    words.append(
        f"resolution: {found.patches:.0f} patches of {CM2 * found.patch_area:.1f} cm2 on the "
        f"sleeve, for distances with a standard deviation of {CM * found.deviation:g} cm"
    )
    return words


def contact_in_words(tubes: Sequence[Helix], found: Layout, contact: tuple[int, float]) -> str:
    """Return the position of a contact as a sentence.

    Parameters
    ----------
    tubes : sequence of Helix
    found : Layout
    contact : tuple of int and float
        Index of the tube, from 0, and distance from the sensor along it in m.

    Raises
    ------
    ConfigError
        If the sleeve has no such tube, or the distance is outside its detection range.
    """
    number, distance = contact
    if number >= len(tubes):
        raise ConfigError(
            f"distance = {number + 1}:{CM * distance:g} is on tube {number + 1} and the sleeve "
            f"has {len(tubes)}; use 1 to {len(tubes)}"
        )
    tube = tubes[number]
    near, far = found.detection_range[number]
    if not near - ROUNDING <= distance <= far + ROUNDING:
        least, most = ceil(1e4 * (near - ROUNDING)), floor(1e4 * (far + ROUNDING))
        raise ConfigError(
            f"distance = {CM * distance:g} cm is outside the range of tube {number + 1}; "
            f"use {least / 100:g} to {most / 100:g} cm"
        )
    distance = min(max(distance, near), far)
    z = float(tube.height(distance))
    x, y, height = MM * tube.place(distance)
    along = found.deviation / float(tube.density(z))
    around = np.degrees(abs(tube.twist) * along)
    return (
        f"contact at {CM * distance:g} cm on tube {number + 1}: x {x:.1f}, y {y:.1f}, z "
        f"{height:.1f} mm, {CM * z:.1f} cm along the arm, {np.degrees(tube.angle(z)) % 360:.0f} "
        f"degrees, loop {int(_loop(tube, z))}; ± {MM * found.deviation:g} mm along the tube "
        f"is ± {MM * along:.1f} mm along the arm and {around:.0f} degrees around it; "
        + _next_in_words(tubes, distance, number)
    )


def _loop(tube: Helix, z: ArrayLike) -> NDArray[np.int64]:
    """Return the number of the loop, from 1, at each position z in m along the arm's axis."""
    loops = np.asarray(z) / tube.pitch
    return np.minimum(loops.astype(int) + 1, int(np.ceil(tube.loops)))


def _next_in_words(tubes: Sequence[Helix], distance: float, number: int) -> str:
    """Return a sentence on the loop nearest to the point at a distance in m along a tube."""
    beside = nearest(tubes, tubes[number].place(distance))
    if not np.isfinite(beside.next_gap):
        return "there is no other loop"
    return (
        f"the next loop, of tube {int(beside.next_tube) + 1}, is "
        f"{MM * float(beside.next_gap):.0f} mm away, at "
        f"{CM * float(beside.next_distance):.0f} cm along that tube"
    )


def write_table(path: Path, tubes: Sequence[Helix], found: Layout, step: float) -> None:
    """Write a CSV table of the positions on the arm at evenly spaced distances along each tube.

    Parameters
    ----------
    path : Path
        The CSV file; its x, y and z are coordinates of the markers, or of the arm without markers.
    tubes : sequence of Helix
    found : Layout
    step : float
        Spacing of the distances in m; the last row of a tube is its end.
    """
    text = io.StringIO()
    table = csv.writer(text)
    table.writerow(COLUMNS)
    for number, (tube, (near, far)) in enumerate(
        zip(tubes, found.detection_range, strict=True), start=1
    ):
        end = tube.tube_length
        distance = np.append(np.arange(tube.lead, end - 1e-9, step), end)
        z = tube.height(distance)
        angle = np.round(np.degrees(tube.angle(z)), 2) % 360
        for row in zip(distance, tube.place(distance), z, angle, _loop(tube, z), strict=True):
            at, place, along, turned, turn = row
            detected = int(near - ROUNDING <= at <= far + ROUNDING)
            cells = [f"{CM * at:.2f}", *(f"{MM * value:.3f}" for value in place)]
            table.writerow([number, *cells, f"{CM * along:.3f}", f"{turned:.2f}", turn, detected])
    write(path, text.getvalue())
