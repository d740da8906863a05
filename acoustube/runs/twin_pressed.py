"""Modulus of a twin's wall and compliance of its ground, from recordings of known presses."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from acoustube.base.errors import ConfigError
from acoustube.base.report import Reporter
from acoustube.base.units import CM, MM, MS, PERCENT
from acoustube.inversion import Contact, Inversion, Library, Priors
from acoustube.inversion.goodness import MISFIT
from acoustube.inversion.twin import Material, Press, fit_material
from acoustube.inversion.twin.estimate import radius
from acoustube.runs.inversion import RecordingInverter, Sensor
from acoustube.runs.inverted_cycles import alike
from acoustube.runs.libraries.files import open_library
from acoustube.runs.twin import FittedSensor, PressedState, read_recordings
from acoustube.runs.twin_file import deviations_of, rangefinder_of, tube_length

MEASURED = ("depth", "force")
"""Labels of recorded presses, at least one of which is required: depth in m, force in N."""
LABELS = ("true_distance", "diameter", *MEASURED)
"""Labels of recorded presses that are used, in m and N."""
MOST_CYCLES = 50
"""Largest number of cycles of a press that are inverted together."""
NEAR = 0.05
"""Largest distance in m between a contact and the labelled position of the same press."""
SAME_TOOL = 0.1e-3
"""Largest difference in m between diameters of the same tool."""
WRONG_BORE, OTHER_BORE = 0.03, 0.005
"""Least relative differences of the bores of twin and library for an error, and for a note."""


def fitted_material(
    found: FittedSensor,
    pressed: Sequence[Path],
    untouched: Sequence[Path],
    library: Path,
    options: Mapping[str, Any],
    pulse_at: str | float | None,
    *,
    report: Reporter,
    check: Callable[[], None],
) -> tuple[Material, tuple[PressedState, ...]]:
    """Estimate wall and ground of a twin's tube from presses; return both and the presses.

    Parameters
    ----------
    found : FittedSensor
    pressed : sequence of Path
        Files and folders with recordings of presses, each labelled by depth or force.
    library : Path
        Folder of a library with the tools that press.
    untouched, options, pulse_at, report, check
        As of :func:`acoustube.runs.twin.fitted_sensor`.

    Raises
    ------
    ConfigError
        If a recording cannot be used or begins at another time than the closures', or the library
        has another bore or lacks a tool.
    """
    known = open_library(library)
    _check_bore(found, known, library, report)
    free = read_recordings(untouched, options, pulse_at)
    inverters: dict[tuple[int, ...], RecordingInverter] = {}
    states: list[PressedState] = []
    recordings = read_recordings(pressed, options, pulse_at)
    _check_starts(found, recordings)
    with report.progress(check) as show:
        for path, data in recordings:
            labels = [name for name in LABELS if name in data]
            if not any(name in data for name in MEASURED):
                raise ConfigError(
                    f"the pressed cycles of {path} have no label depth or force; give one in the "
                    "file or in a sidecar"
                )
            for part, label, share in presses_of(data, labels):
                tools = _tools(known, label["diameter"], path)
                if tools not in inverters:
                    inverters[tools] = _inverter(found, known, tools, free)
                own = inverters[tools]
                ((_, inverted),) = own.groups(path, part, part.sizes["cycle"], check)
                states.append(_state(path, label, inverted, own.tool_library))
                show(path.name, share)
    material = fit_material([state.press for state in states])
    return material, tuple(states)


def _check_starts(found: FittedSensor, recordings: Sequence[tuple[Path, xr.Dataset]]) -> None:
    """Raise unless recordings begin at the same time from the send pulse as those of closures."""
    band = found.twin.band
    for path, data in recordings:
        start = float(data["time"].values[0])
        if abs(start - band.start) > 0.5 / band.rate:
            raise ConfigError(
                f"{path} begins at {MS * start:.4g} ms from the send pulse and the closed cycles "
                f"at {MS * band.start:.4g} ms; record all alike"
            )


def presses_of(
    data: xr.Dataset, labels: Sequence[str]
) -> Iterator[tuple[xr.Dataset, dict[str, float], float]]:
    """Yield the first cycles of each press, its labels, and the fraction of cycles done.

    A press is a run of consecutive cycles with equal labels. After the first :data:`MOST_CYCLES`,
    further cycles add no information on the labelled quantities.

    Parameters
    ----------
    data : Dataset
    labels : sequence of str
        Those of :data:`LABELS` that the cycles have; the others are nan in the result.
    """
    for whole, share in alike(data, labels, data.sizes["cycle"]):
        part = whole.isel(cycle=slice(0, MOST_CYCLES))
        yield (
            part,
            {name: float(part[name].values[0]) if name in labels else np.nan for name in LABELS},
            share,
        )


def _check_bore(found: FittedSensor, known: Library, path: Path, report: Reporter) -> None:
    """Raise if the bores of library and twin differ; note a small difference."""
    own = radius(found.twin)[0]
    off = abs(known.radius / own - 1)
    words = (
        f"{path} is for a bore of {2 * MM * known.radius:.4g} mm, and the twin's is "
        f"{2 * MM * own:.4g} mm; make a library with acoustube library --bore {2 * MM * own:.4g}"
    )
    if off > WRONG_BORE:
        raise ConfigError(words)
    if off > max(OTHER_BORE, 3 * found.twin.deviation("log_radius")):
        report.note(words)


def _tools(known: Library, diameter: float, path: Path) -> tuple[int, ...]:
    """Return the indices of the library's tools of a diameter in m; all of them if it is nan."""
    if not np.isfinite(diameter):
        return tuple(range(len(known.tools)))
    found = tuple(
        i for i, one in enumerate(known.tools) if abs(one.diameter - diameter) < SAME_TOOL
    )
    if not found:
        tools = ", ".join(one.name for one in known.tools)
        raise ConfigError(
            f"{path} is of an indenter of {MM * diameter:g} mm and the library of {tools}; compute "
            f"one with acoustube library --indenter {MM * diameter:g}"
        )
    return found


def _inverter(
    found: FittedSensor,
    known: Library,
    tools: tuple[int, ...],
    free: Sequence[tuple[Path, xr.Dataset]],
) -> RecordingInverter:
    # The bore is taken as the library's, so that depths belong to the library's forces.
    sensor = Sensor(
        rangefinder=rangefinder_of(found), length=tube_length(found),
        priors=Priors(**deviations_of(found), bore=0.0),
    )  # fmt: skip
    return RecordingInverter(Library(tuple(known.tools[i] for i in tools)), sensor, free, most=1)


def _state(
    path: Path, label: Mapping[str, float], inverted: Inversion, library: Library
) -> PressedState:
    """Return a press with stated depth and force, and with the depth estimated from its echo."""
    contact, reason = _contact(inverted, label["true_distance"])
    tool = library.tools[0 if contact is None else contact.tool]
    place = label["true_distance"]
    depth, deviation = np.nan, np.nan
    if contact is not None:
        place = place if np.isfinite(place) else contact.distance.value
        if not reason:
            depth, deviation = contact.depth.value, contact.depth.deviation
    stated, force = label["depth"], label["force"]
    if reason and len(library.tools) > 1:
        reason += ", and its labels do not say which of several indenters pressed"
        stated = force = np.nan
    press = Press(tool, depth, deviation, stated, force)
    return PressedState(source=str(path), place=place, press=press, reason=reason)


def _contact(inverted: Inversion, place: float) -> tuple[Contact | None, str]:
    """Return the contact nearest to a place in m, and why its depth is unusable ("" if usable)."""
    likely = [one for one in inverted.contacts if one.probability > 0.5]
    if not likely:
        return None, "no contact is found in its echo"
    contact = min(likely, key=lambda one: abs(one.distance.value - place))
    if abs(contact.distance.value - place) > NEAR:
        return contact, f"its echo comes from {CM * contact.distance.value:.1f} cm"
    # The residual would leave out most presses: the twin's tube may differ from the library's.
    if inverted.misfit > MISFIT:
        return contact, f"its echo differs from the library's by {PERCENT * inverted.misfit:.0f} %"
    return contact, ""
