"""Content of the HTML page of a run of ``acoustube simulate`` or ``acoustube indent``."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from acoustube.base.errors import ConfigError
from acoustube.base.foreign.limits import reading
from acoustube.base.foreign.results import open_result, settings_in
from acoustube.base.units import CM, MM
from acoustube.reports.page.content import (
    PRESSED,
    PULSED,
    Along,
    Content,
    Group,
    Signal,
    State,
    signal_of,
    tool_in_words,
)
from acoustube.reports.page.shapes import Shape, from_rings, tool, tool_height
from acoustube.reports.page.solid import Solid
from acoustube.runs import sound
from acoustube.runs.config import Config, Mechanics, configured
from acoustube.runs.config.si import press_in_si, settings_in_si

RUN = "run.nc"
REACH = 4.0
"""Length to each side of the press, in outer diameters of the tube, over which the lumen is
measured at each depth but the last. Walls at the last depth are drawn over twice this length."""
PLACES = 201
"""Number of positions along the tube at which the lumen is measured at each depth but the last."""


def folder_of(where: str | Path) -> Path:
    """Return the folder of a result, given the folder itself or ``run.nc`` in it."""
    return Path(where).parent if Path(where).name == RUN else Path(where)


@contextmanager
def reading_run(folder: Path) -> Iterator[xr.Dataset]:
    """Read the run of a folder, as a context.

    Parameters
    ----------
    folder : Path
        A folder that contains ``run.nc``.

    Yields
    ------
    xarray.Dataset
        The run.

    Raises
    ------
    ConfigError
        If the file is damaged or of another kind, also if that is found only within the context.
    """
    path, advice = folder / RUN, "write one with either command"
    failure = "is damaged or no run of acoustube simulate or indent"
    with reading(path, failure, advice):
        yield open_result(path, advice, failure)


def read_run(folder: Path) -> Content:
    """Return the content of the page of a run; see :func:`reading_run` for folder and errors."""
    with reading_run(folder) as data:
        simulated = "source_end" in data.dims
        settings = settings_in(data.attrs["configuration"], folder / RUN)
        if simulated:
            group = _simulated(data, configured(settings))
        else:
            group = _indented(data, configured(settings, Mechanics))
    return Content(
        title=f"{folder.resolve().name}: a soft tube, pressed",
        lead=PULSED if simulated else PRESSED,
        groups=[group],
        settings=settings,
        origin=_origin(data),
        notes=[note for note in str(data.attrs.get("warnings", "")).splitlines() if note],
        missing=_missing(data, simulated),
    )


def _origin(data: xr.Dataset) -> dict[str, str]:
    names = {
        "acoustube_version": "acoustube version", "created": "computed", "device": "device",
        "precision": "precision", "accuracy": "accuracy",
        "configuration_hash": "hash of the settings",
    }  # fmt: skip
    return {words: str(data.attrs[name]) for name, words in names.items() if name in data.attrs}


def _missing(data: xr.Dataset, simulated: bool) -> dict[str, str]:
    if not simulated:
        silent = "This is a press alone (acoustube indent): no sound was computed."
        return {"signal": silent, "spectrum": silent}
    last = MM * float(data["indentation_depth"][-1])
    return {
        "signal": f"The sound was computed at the last depth only, {last:g} mm.",
        "spectrum": "A run of acoustube simulate records one pulse and has no scattering matrix; "
        "acoustube sweep and acoustube scatter compute the reflection over frequency.",
    }


def _rows(data: xr.Dataset) -> list[int]:
    """Return the indices of the depths that were reached; raise ConfigError if there are none."""
    there = np.isfinite(data["contact_force"].values)
    if "converged" in data:
        there &= data["converged"].values.astype(bool)
    rows = [int(i) for i in np.flatnonzero(there)]
    if not rows:
        raise ConfigError("the press reached none of its depths, so there is nothing to show")
    return rows


def _indented(data: xr.Dataset, config: Mechanics) -> Group:
    """Return the group of a run of ``indent``: a state for each depth, without sound."""
    solid, press = _solid(data), press_in_si(config).indenter
    z = data["z"].values
    states = []
    for row in _rows(data):
        moved = data["node_displacement"].values[row]
        area = data["lumen_area_profile"].values[row]
        cut = np.isfinite(area)
        along = Along(z=z[cut], area=area[cut])
        height = tool_height(press, solid.outer_wall(moved))
        states.append(_state(data, row, solid.shape(moved), height, along))
    return _group(config, states, solid, position=np.nan, length=np.nan)


def _simulated(data: xr.Dataset, config: Config) -> Group:
    """Return the group of a run of ``simulate``: a state for each depth, the last with a signal."""
    solid, press = _solid(data), press_in_si(config).indenter
    rows, position = _rows(data), float(data["true_distance"])
    outer_diameter = float(np.ptp(solid.nodes[:, 1]))
    z = np.linspace(-REACH, REACH, PLACES) * outer_diameter
    states = []
    for row in rows[:-1]:
        moved = data["node_displacement"].values[row]
        along = Along(z=z, area=solid.area(moved, z))
        height = tool_height(press, solid.outer_wall(moved))
        states.append(_state(data, row, solid.shape(moved), height, along))
    walls = [data[name].values - [0, 0, position] for name in ("inner_wall", "outer_wall")]
    near = np.abs(walls[0][:, 0, 2]) < 2 * REACH * outer_diameter
    along = Along(z=data["z"].values - position, area=data["area_profile"].values)
    shape = from_rings(*(wall[near] for wall in walls))
    height = tool_height(press, walls[1][near].reshape(-1, 3))
    states.append(_state(data, rows[-1], shape, height, along, _signal(data, config)))
    length = float(data["z"][-1])
    return _group(config, states, solid, position=position, length=length)


def _solid(data: xr.Dataset) -> Solid:
    return Solid(data["node_position"].values, data["element_node"].values.astype(np.int64))


def _state(
    data: xr.Dataset, row: int, shape: Shape, height: float, along: Along,
    signal: Signal | None = None,
) -> State:  # fmt: skip
    at = data.isel(depth=row)
    return State(
        depth=float(at["indentation_depth"]),
        force=float(at["contact_force"]),
        height=float(at["lumen_height"]),
        width=float(at["lumen_width"]),
        area=float(at["lumen_area"]),
        shape=shape,
        tool_height=height,
        along=along,
        signal=signal,
    )


def _group(
    config: Config | Mechanics, states: list[State], solid: Solid, *, position: float, length: float
) -> Group:
    outer_diameter = float(np.ptp(solid.nodes[:, 1]))
    far = solid.area(np.zeros_like(solid.nodes), np.array([0.5 * solid.nodes[:, 2].max()]))
    settings = press_in_si(config)
    return Group(
        tool=tool_in_words(config),
        place="" if np.isnan(position) else f"{CM * position:g} cm",
        other="",
        states=states,
        solid=tool(settings.indenter, outer_diameter),
        position=position,
        length=length,
        bore_area=float(far[0]),
        outer_diameter=outer_diameter,
        floor=np.nan if settings.layer is not None else float(solid.nodes[:, 1].min()),
    )


def _signal(data: xr.Dataset, config: Config) -> Signal:
    """Return the signal at the probe with the selected source end."""
    end = str(data["distance"].attrs["source_end"])
    case = data.sel(source_end=end)
    probe, speed = float(case["probe_position"]), float(case["sound_speed"])

    def place(time: Any) -> Any:
        return probe + speed * (time - float(case["send_time"])) / 2

    peaks = np.isfinite(case["peak_time"].values)
    return signal_of(
        case["time"].values,
        case["pressure"].values.astype(float),
        case["envelope"].values,
        case["peak_time"].values[peaks],
        case["peak_amplitude"].values[peaks],
        place=place,
        faded=float(case["send_time"]) + sound.blind_time(settings_in_si(config)),
        estimate=float(case["estimated_distance"]),
        amplitude=float(case["echo_amplitude"]),
        probe=probe,
        source_end=end,
    )
