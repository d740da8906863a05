"""The command ``acoustube sleeve``: the layout of tubes on a forearm."""

from __future__ import annotations

import re
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from acoustube.base.errors import ConfigError
from acoustube.base.files import partial_folder, publish
from acoustube.base.report import Reporter
from acoustube.base.rules import Number
from acoustube.base.version import __version__
from acoustube.base.writing import write
from acoustube.cli._options import WHOLE, Checked, Output, checked_folder

if TYPE_CHECKING:
    from acoustube.sleeve import Helix

FOREARM = (
    ("length of the forearm", Number(3, 150, "cm", "under the sleeve")),
    ("first girth of the forearm", Number(8, 150, "cm", "near the sensors")),
    ("second girth of the forearm", Number(8, 150, "cm", "at the other end")),
)
"""Sizes of a forearm: name and allowed range of each."""


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Arm:
    """Shape of the arm.

    Attributes
    ----------
    forearm : tuple
        Length of the sleeve, and girths of the arm at the end near the sensors and at the other, in
        cm, in place of markers.
    axis : str
        Axis of the arm: a line fitted midway between opposite columns, or the z of the markers.
    unit : str
        Unit of the markers, in place of the file's own; mm if the file states none.
    columns : tuple of str
        Names of the two columns of markers, where the file has more.
    """

    forearm: tuple[float, float, float] | None = None
    axis: Literal["fitted", "z"] = "fitted"
    unit: Literal["mm", "cm", "m"] | None = None
    columns: tuple[str, str] | None = None

    def __post_init__(self) -> None:
        for (name, rule), value in zip(FOREARM, self.forearm or (), strict=False):
            rule.check(name, value)


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Winding(Checked):
    """Number, path and diameter of the wound tubes.

    Attributes
    ----------
    loops : float
        Turns of each tube over the sleeve.
    pitch : float
        Advance per turn in cm, in place of loops.
    tubes : int
        Tubes side by side.
    phase : float
        Angle at which the first tube starts, from the first column of markers, in degrees.
    hand : str
        Handedness of the helix.
    lead : float
        Length of tube between sensor and sleeve, in cm.
    tube_diameter : float
        Outer diameter of the tube in mm.
    """

    loops: Annotated[float | None, Number(0.25, 100, "", "turns of each tube")] = None
    pitch: Annotated[float | None, Number(0.5, 100, "cm", "advance per turn")] = None
    tubes: Annotated[int, WHOLE, Number(1, 8, "", "side by side", whole=True)] = 2
    phase: Annotated[float, Number(-360, 360, "deg", "start of the first tube")] = 0.0
    hand: Literal["right", "left"] = "right"
    lead: Annotated[float, Number(0, 1000, "cm", "tube between sensor and sleeve")] = 15.0
    tube_diameter: Annotated[float, Number(1, 50, "mm", "outer")] = 11.1


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Sensing(Checked):
    """Range and accuracy of the sensor, and rows of the table.

    Attributes
    ----------
    dead_zone : float
        Distance from the sensor within which no press is detected, in cm.
    reach : float
        Farthest distance from the sensor at which a press is detected, in cm.
    distance : list
        Contacts to mark, in cm from the sensor; 2:80 is at 80 cm on the second tube.
    deviation : float
        Standard deviation of an estimated distance, in cm.
    within : float
        Half width in mm of the strip of skin that a tube covers.
    step : float
        Distance between two rows of the table, in cm.
    """

    dead_zone: Annotated[float, Number(0, 200, "cm", "without detection")] = 15.0
    reach: Annotated[float, Number(10, 2000, "cm", "farthest detection")] = 250.0
    distance: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None
    deviation: Annotated[float, Number(0.01, 100, "cm", "of a distance")] = 5.0
    within: Annotated[float, Number(1, 100, "mm", "half width of the covered skin")] = 10.0
    step: Annotated[float, Number(0.05, 50, "cm", "between rows")] = 1.0


def sleeve(
    markers: Path | None = None,
    /,
    *,
    arm: Arm = Arm(),
    winding: Winding = Winding(),
    sensing: Sensing = Sensing(),
    out: Path | None = None,
    output: Output = Output(),
) -> None:
    """Lay out a sleeve: the position on the arm of each distance along the wound tubes.

    Parameters
    ----------
    markers : Path
        Two columns of markers along the arm: a table with the columns column, x_mm, y_mm, z_mm, or
        a C3D file.
    out : Path
        Folder to write, new or empty; sleeve-1, sleeve-2 and so on if not given.
    """
    _check_one(markers, arm.forearm, ("a file of markers", "--forearm 25 17 26"))
    _check_one(winding.loops, winding.pitch, ("--loops 9", "--pitch in cm"))
    if markers is not None and not markers.is_file():
        raise ConfigError(f"{markers} is not a file; give a table or C3D file of markers")
    contacts = _contacts(sensing.distance or [])
    folder = checked_folder(out, "sleeve")
    _run(markers, arm, winding, sensing, contacts, folder, output.reporter())


def _check_one(first: object, second: object, words: tuple[str, str]) -> None:
    """Raise unless exactly one of two values is given."""
    if first is None and second is None:
        raise ConfigError(f"sleeve needs {', or '.join(words)}; give one of them")
    if first is not None and second is not None:
        raise ConfigError(f"sleeve takes {' or '.join(words)}, not both; leave one of them out")


def _run(
    markers: Path | None,
    arm: Arm,
    winding: Winding,
    sensing: Sensing,
    contacts: Sequence[tuple[int, float]],
    folder: Path,
    report: Reporter,
) -> None:
    """Lay out a sleeve and write its table, its properties in words and its picture."""
    from acoustube.reports.scenes import sleeve as sleeve_scene
    from acoustube.reports.sleeve_table import contact_in_words, in_words, write_table
    from acoustube.sleeve import check_room, layout

    started = time.perf_counter()
    wound, sensor = winding.in_si(), sensing.in_si()
    if markers is None:
        tubes, words, seen = _tubes_on_forearm(arm, wound, sensor.reach)
    else:
        tubes, words, seen = _tubes_on_markers(markers, arm, wound, sensor.reach)
    found = layout(
        tubes, dead_zone=sensor.dead_zone, reach=sensor.reach, within=sensor.within,
        deviation=sensor.deviation,
    )  # fmt: skip
    check_room(tubes, wound.tube_diameter)
    words += in_words(tubes, found)
    words += [contact_in_words(tubes, found, contact) for contact in contacts]
    report.line(f"acoustube {__version__} sleeve")
    for line in words:
        report.line(line)
    with partial_folder(folder) as partial:
        write_table(partial / "sleeve.csv", tubes, found, sensor.step)
        write(partial / "layout.txt", "\n".join(words) + "\n")
        picture = sleeve_scene.Picture(
            tubes=tuple(tubes), detection_range=found.detection_range, contacts=tuple(contacts),
            outer_diameter=wound.tube_diameter, deviation=sensor.deviation, markers=seen,
        )  # fmt: skip
        if not sleeve_scene.draw(picture, partial / "figure.png"):
            report.note("VTK cannot draw on this machine: see 'The figure' in the README")
        folder = publish(partial, folder)
    report.line(f"Written to {folder} in {time.perf_counter() - started:.0f} s.")


def _tubes_on_forearm(
    arm: Arm, winding: SimpleNamespace, reach: float
) -> tuple[list[Helix], list[str], Any]:
    """Return the tubes on a conical arm, its sizes in words, and no markers, (0, 3)."""
    import numpy as np

    from acoustube.runs.config.si import CENTI
    from acoustube.sleeve import design

    assert arm.forearm is not None
    length, near, far = (CENTI * size for size in arm.forearm)
    tubes = design(
        length, (near, far), loops=winding.loops, pitch=winding.pitch, n_tubes=winding.tubes,
        phase=winding.phase, hand=winding.hand, lead=winding.lead,
        outer_diameter=winding.tube_diameter, reach=reach,
    )  # fmt: skip
    sizes = (
        "forearm: {:g} cm long, {:g} cm around at the end near the sensors, {:g} cm at the other"
    )
    return tubes, [sizes.format(*arm.forearm)], np.empty((0, 3))


def _tubes_on_markers(
    path: Path, shape: Arm, winding: SimpleNamespace, reach: float
) -> tuple[list[Helix], list[str], Any]:
    """Return the tubes on the fitted arm, the fit in words, and the markers in m, (n, 3)."""
    import numpy as np

    from acoustube.reports.sleeve_table import fit_in_words
    from acoustube.sleeve import check_reach, fit_arm, read_markers, wound

    markers = read_markers(path, unit=shape.unit, columns=shape.columns)
    try:
        arm = fit_arm(markers.first, markers.second, axis=shape.axis)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    loops = winding.loops if winding.pitch is None else arm.length / winding.pitch
    tubes = wound(
        arm, loops, n_tubes=winding.tubes, phase=winding.phase, hand=winding.hand,
        lead=winding.lead,
    )  # fmt: skip
    check_reach(tubes, reach)
    words = fit_in_words(path, shape.axis, markers, arm)
    return tubes, words, np.concatenate([markers.first, markers.second])


def _contacts(words: Sequence[str]) -> list[tuple[int, float]]:
    """Parse contacts such as ``80`` and ``2:80``: tube number from 0, and distance in m."""
    from acoustube.runs.config.si import CENTI

    found = []
    for word in words:
        match = re.fullmatch(r"(?:(\d+):)?(\d+(?:\.\d*)?|\.\d+)", word.strip())
        if match is None or match[1] == "0":
            raise ConfigError(
                "is not a distance", setting="distance", value=word,
                advice="use cm, as in 80, with the tube before it as in 2:80",
            )  # fmt: skip
        found.append((int(match[1] or 1) - 1, CENTI * float(match[2])))
    return found
