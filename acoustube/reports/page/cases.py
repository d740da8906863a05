"""Content of the HTML page of a sweep, read from its folder."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
import xarray as xr

from acoustube import signals
from acoustube.base.errors import ConfigError
from acoustube.base.foreign.limits import reading
from acoustube.base.foreign.results import check_result, settings_in
from acoustube.base.units import CM
from acoustube.reports.page.content import (
    PULSED,
    Along,
    Content,
    Group,
    Signal,
    Spectrum,
    State,
    signal_of,
    tool_in_words,
)
from acoustube.reports.page.shapes import Shape, from_rings, round_tube, tool, tool_height
from acoustube.runs import sound
from acoustube.runs.config import Config, configured
from acoustube.runs.config.si import SISettings, settings_in_si
from acoustube.runs.opening import PATTERNS
from acoustube.runs.scattering_file import from_dataset
from acoustube.runs.sweep import select, store
from acoustube.waves.network import at_sound_speed
from acoustube.waves.spectral import SpectralScattering

ADVICE = "repeat the command acoustube sweep to recompute it"
"""Advice in the error message on a damaged file."""
MOST_CASES = 400
"""Largest number of cases of a page; beyond it, some positions are omitted."""
UNTOUCHED_REACH = 0.08
"""Drawn length of an untouched tube on each side of the press's position, in m."""
TOOL = ("shape", "indenter_mm", "yaw_deg", "offset_mm")

# Indenter as JSON, position in cm, and all other settings but the depth as JSON.
Key = tuple[str, float, str]


class Found(NamedTuple):
    """A case of a sweep, and the file that contains it."""

    name: str
    config: Config
    path: Path


def read_sweep(folder: Path) -> Content:
    """Return the content of the page of a sweep.

    Returns
    -------
    Content
        A group for each indenter, position and combination of other settings. If there are more
        than `MOST_CASES` cases, positions are omitted evenly along the tube.

    Raises
    ------
    ConfigError
        If the sweep has no finished case, a damaged file, or more than `MOST_CASES` cases at one
        position.
    """
    with reading(folder, "holds a damaged file", ADVICE):
        cases = list(_cases(folder))
        if not cases:
            raise ConfigError(
                f"{folder} is a sweep without a finished case; repeat the command acoustube sweep "
                "to finish some"
            )
        groups, notes = limited(_grouped(cases))
        states, described = _states([case for group in groups.values() for case in group])
    shared, varying = _shared([case.config for group in groups.values() for case in group])
    return Content(
        title=f"{folder.resolve().name}: a soft tube, pressed {len(states)} times",
        lead=PULSED,
        groups=[_group(group, states, varying) for group in groups.values()],
        settings=shared,
        origin=described | {"cases": f"{len(states)} of {len(cases)}"},
        notes=notes,
        missing=_missing(list(states.values())),
    )


def _cases(folder: Path) -> Iterator[Found]:
    """Yield each case of a sweep's folder once."""
    seen: set[str] = set()
    for path in sorted(folder.glob(PATTERNS["press"])):
        check_result(path, ADVICE)
        # Read with h5py, since xarray takes a tenth of a second per file.
        with h5py.File(path) as file:
            names, settings = (file[name].asstr()[:] for name in ("press", "configuration"))
        for name, text in zip(names, settings, strict=True):
            if str(name) not in seen:
                seen.add(str(name))
                yield Found(str(name), configured(settings_in(text, path)), path)


def _grouped(cases: Sequence[Found]) -> dict[Key, list[Found]]:
    """Return cases by indenter, position and other settings, in order of increasing depth."""
    groups: dict[Key, list[Found]] = {}
    for case in sorted(cases, key=_order):
        groups.setdefault(_key(case.config), []).append(case)
    return groups


def _order(case: Found) -> tuple[Any, ...]:
    press = case.config.indentation
    tools = tuple(getattr(press, name) for name in TOOL)
    return (*tools, *_key(case.config)[1:], press.depth_mm)


def _key(config: Config) -> Key:
    settings = dataclasses.asdict(config)
    press = settings["indentation"]
    kind = json.dumps([press.pop(name) for name in TOOL])
    place = float(press.pop("position_cm"))
    del press["depth_mm"]
    return kind, place, json.dumps(settings, sort_keys=True)


def limited(groups: dict[Key, list[Found]]) -> tuple[dict[Key, list[Found]], list[str]]:
    """Return groups with at most `MOST_CASES` cases at evenly chosen positions, and a note.

    Raise ConfigError if one position alone has more cases. Without omitted cases, no note is given.
    """
    places = sorted({place for _, place, _ in groups})
    count = sum(map(len, groups.values()))
    if count <= MOST_CASES:
        return groups, []
    for most in range(max(1, len(places) * MOST_CASES // count), 0, -1):
        chosen = {places[i] for i in np.linspace(0, len(places) - 1, most).round().astype(int)}
        kept = {key: cases for key, cases in groups.items() if key[1] in chosen}
        left = sum(map(len, kept.values()))
        if left <= MOST_CASES:
            break
    else:
        raise ConfigError(
            f"the sweep has {count} cases, {left} of them at one place, and a page holds "
            f"{MOST_CASES}; sweep fewer into a folder of their own (presses and scattering are "
            "cached)"
        )
    note = f"The page holds {left} of the sweep's {count} cases: {most} of {len(places)} places."
    return kept, [note]


def _states(cases: Sequence[Found]) -> tuple[dict[str, State], dict[str, str]]:
    """Return the state of each case by its name, and the origin of the data."""
    by_file: dict[Path, list[Found]] = {}
    for case in cases:
        by_file.setdefault(case.path, []).append(case)
    states, versions = {}, set()
    for path, some in by_file.items():
        data, matrix = store.read(path)
        versions.add(str(data.attrs["acoustube_version"]))
        walls = store.walls(path)
        sides = () if walls is None else (walls["inner_wall"], walls["outer_wall"])
        shape = from_rings(*(side.values.astype(float) for side in sides)) if sides else None
        for name, config, _ in some:
            settings = settings_in_si(config)
            states[name] = _state(data.sel(press=name), settings, matrix, walls, shape)
    return states, {"acoustube version": ", ".join(sorted(versions)), "source": "acoustube sweep"}


def _state(
    case: xr.Dataset, settings: SISettings, matrix: xr.Dataset | None, walls: xr.Dataset | None,
    shape: Shape | None,
) -> State:  # fmt: skip
    depth = float(case["depth"])
    along, height = None, np.nan
    if depth == 0:
        shape, along, height = _untouched(settings)
    elif walls is not None and shape is not None:
        along = Along(z=walls["z"].values, area=walls["area_profile"].values.astype(float))
        outer = walls["outer_wall"].values.astype(float)
        height = tool_height(settings.indenter, outer.reshape(-1, 3))
    return State(
        depth=depth,
        force=float(case["force"]),
        height=float(case["lumen_height"]),
        width=float(case["lumen_width"]),
        area=float(case["lumen_area"]),
        shape=shape,
        tool_height=height,
        along=along,
        signal=_signal(case),
        spectrum=None if matrix is None or depth == 0 else _spectrum(matrix, settings),
    )


def _untouched(settings: SISettings) -> tuple[Shape, Along, float]:
    """Return shape and cross-section of an untouched tube, and the height of an indenter on it.

    The height is the coordinate y in m of the indenter's lowest point.
    """
    bore, wall = settings.tube.inner_diameter, settings.tube.wall_thickness
    shape = round_tube(bore, wall, UNTOUCHED_REACH)
    z = np.array([-UNTOUCHED_REACH, UNTOUCHED_REACH])
    along = Along(z=z, area=np.full(2, np.pi * bore**2 / 4))
    return shape, along, tool_height(settings.indenter, _dense(bore / 2 + wall))


def _dense(radius: float) -> Any:
    """Return closely spaced points (n, 3) on top of a straight tube of given radius, near z = 0."""
    angle, z = np.meshgrid(np.linspace(0, np.pi, 181), np.linspace(-2, 2, 41) * radius)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1).reshape(-1, 3)


def _signal(case: xr.Dataset) -> Signal:
    """Return the signal at the probe with the selected source end."""
    end = str(case["chosen_source_end"].values)
    settings, recording, ranging = select.ranged(case.sel(source_end=end))

    def place(time: Any) -> Any:
        away = signals.distance(time - ranging.send_time, settings.temperature)
        return settings.probe + away

    return signal_of(
        np.asarray(recording.time, float),
        np.asarray(recording.pressure[0], float),
        np.asarray(ranging.envelope),
        ranging.echoes.times,
        ranging.echoes.amplitudes,
        place=place,
        faded=float(ranging.send_time) + sound.blind_time(settings),
        estimate=float(ranging.distance),
        amplitude=float(ranging.amplitude),
        probe=settings.probe,
        source_end=end,
    )


def _spectrum(matrix: xr.Dataset, settings: SISettings) -> Spectrum:
    """Return the plane wave's reflection coefficient at port 1, the end at low z, by frequency."""
    found = at_sound_speed(from_dataset(matrix), settings.air.sound_speed)
    plane = found.modes.index("00")
    higher = zip(found.modes, found.cut_ons, strict=True)
    return Spectrum(
        frequency=np.asarray(found.frequency, float),
        reflection=np.abs(found.s[:, 0, plane, 0, plane]),
        settled=found.error <= found.tolerance
        if isinstance(found, SpectralScattering)
        else found.settled[:, 0, plane, 0, plane],
        cut_ons={name: float(cut_on) for name, cut_on in higher if cut_on > 0},
        carrier=settings.pulse.frequency,
    )


def _shared(configs: Sequence[Config]) -> tuple[dict[str, Any], list[tuple[str, str]]]:
    """Return the settings that are equal in all cases, and the names of those that vary."""
    every = [dataclasses.asdict(config) for config in configs]
    shared: dict[str, Any] = {}
    varying = []
    for section, values in every[0].items():
        shared[section] = {}
        for name, value in values.items():
            if all(settings[section][name] == value for settings in every):
                shared[section][name] = value
            else:
                varying.append((section, name))
    return shared, varying


def _group(
    cases: Sequence[Found], states: Mapping[str, State], varying: Sequence[tuple[str, str]]
) -> Group:
    config = cases[0].config
    typed, settings = dataclasses.asdict(config), settings_in_si(config)
    tube = settings.tube
    others = [(s, n) for s, n in varying if n not in (*TOOL, "position_cm", "depth_mm")]
    return Group(
        tool=tool_in_words(config),
        place=f"{CM * settings.position:g} cm",
        other=", ".join(f"{name} = {typed[section][name]}" for section, name in others),
        states=[states[case.name] for case in cases],
        solid=tool(settings.indenter, tube.outer_diameter),
        position=settings.position,
        length=tube.length,
        bore_area=np.pi * tube.inner_diameter**2 / 4,
        outer_diameter=tube.outer_diameter,
        floor=np.nan if settings.layer is not None else -tube.outer_diameter / 2,
    )


def _missing(states: Sequence[State]) -> dict[str, str]:
    """Return, by the name of each picture, the text that is shown if it is missing."""
    return {
        "shape": "This sweep was written before files held the deformed walls. Sweep into a new "
        "folder to see them.",
        "along": "",
        "signal": "",
        "spectrum": "An untouched tube reflects nothing."
        if any(state.spectrum for state in states)
        else "These cases were simulated as whole tubes, without a scattering matrix; use method "
        "scattering, the default of a sweep, to have the reflection over frequency.",
    }
