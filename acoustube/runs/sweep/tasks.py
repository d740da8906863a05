"""The pieces of a sweep's work, as a worker does them: a path of presses, a scattering, the cases.

Each is a function of what is handed to it, so that it does not matter where or when it runs.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Generic, NamedTuple, TypeVar

import numba
import numpy as np
import xarray as xr
from threadpoolctl import threadpool_limits

from acoustube.air import air_at
from acoustube.base import cache
from acoustube.base.errors import ConfigError, SimulationError
from acoustube.base.netcdf import flag, to_netcdf, variable
from acoustube.base.rules import filled
from acoustube.base.version import __version__
from acoustube.indentation import Indentation, PressError
from acoustube.lumen import Lumen, inner_wall, measure, pressed_part, whole_tube
from acoustube.runs import presses as press_runs
from acoustube.runs import sound
from acoustube.runs.config import Config
from acoustube.runs.results import DEPTH
from acoustube.runs.scattering_file import from_dataset, to_dataset
from acoustube.runs.sweep.plan import digest
from acoustube.runs.walls import walls
from acoustube.signals import Ranging
from acoustube.waves import PlacedScatterer, Recording, Scattering, SourceEnd
from acoustube.waves.network import at_sound_speed

Result = TypeVar("Result")


class Done(NamedTuple, Generic[Result]):
    """What a piece of work gave, and whether it was remembered instead of computed.

    Attributes
    ----------
    result : object
    reused : bool
    """

    result: Result
    reused: bool


@dataclasses.dataclass(frozen=True, eq=False)
class Pressed:
    """A tube pressed to one depth.

    Attributes
    ----------
    force : float
        Of the tool on the whole tube, in N.
    height, width : float
        Of the lumen at the press, in m.
    area : float
        Of the lumen's section at the press, in m2.
    closed : bool
        Whether the lumen's walls feel each other.
    part : Lumen or None
        The pressed part; None of an untouched tube.
    walls : xarray.Dataset or None
        Its walls, thinned out; None of an untouched tube.
    """

    force: float
    height: float
    width: float
    area: float
    closed: bool
    part: Lumen | None
    walls: xr.Dataset | None = None


class PressPath(NamedTuple):
    """Presses of one tube by one tool to several depths.

    Attributes
    ----------
    at : dict of float to Pressed
        By depth in m; those that could not be reached are missing.
    stopped : str
        Why they are; empty otherwise.
    """

    at: Mapping[float, Pressed]
    stopped: str


def untouched(config: Config) -> Pressed:
    """Return what a tube is before it is pressed."""
    bore = 1e-3 * config.tube.inner_diameter_mm
    return Pressed(0.0, bore, bore, np.pi * bore**2 / 4, closed=False, part=None)


def press(config: Config, depths: Sequence[float]) -> Done[PressPath]:
    """Press a tube to several depths.

    Parameters
    ----------
    config : Config
        Its tube and its press; its own depth does not matter.
    depths : sequence of float
        Rising, in m.

    Returns
    -------
    Done of PressPath
    """
    reused = cache.holds(press_runs.remembered_as(config, depths))
    stopped = ""
    try:
        found = press_runs.pressed(config, depths)
    except PressError as error:
        found, stopped = error.indentation, str(error)
    wall = inner_wall(found.mesh)
    at = {float(found.depth[i]): _pressed(found, i, wall) for i in found.rows_at(depths)}
    return Done(PressPath(at, stopped), reused)


def _pressed(indentation: Indentation, row: int, wall: Any) -> Pressed:
    section = measure(indentation, row, np.array([indentation.presses[0].z]), wall)
    part = pressed_part(indentation, row)
    return Pressed(
        force=float(indentation.contact_force[row]),
        height=float(section.height[0]),
        width=float(section.width[0]),
        area=float(section.area[0]),
        closed=bool(indentation.closed[row]),
        part=part,
        walls=walls(part),
    )


class Band(NamedTuple):
    """What a scattering is computed for, beside its lumen.

    Attributes
    ----------
    low, high : float
        In Hz.
    temperature : float
        Of the air in degC; other temperatures follow from it.
    """

    low: float
    high: float
    temperature: float


def scattering_name(config: Config, depths: Sequence[float], depth: float, band: Band) -> str:
    """Return the name in the cache of the scattering of a press."""
    waves = config.waves
    return cache.key(
        "scattering",
        {
            "press": press_runs.remembered_as(config, depths),
            "depth": depth,
            "band": list(band),
            "step": sound.FREQUENCY_STEP,
            "air": [waves.humidity_percent, waves.pressure_kpa],
            "losses": waves.losses,
            "resolution": waves.resolution,
        },
    )


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute on one thread: workers share the cores, and sums do not depend on their number."""
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        with threadpool_limits(1, user_api="blas"):
            yield
    finally:
        numba.set_num_threads(before)


def scattering(config: Config, name: str, band: Band, part: Lumen, label: str) -> Done[Scattering]:
    """Return the scattering of a pressed part.

    Parameters
    ----------
    config : Config
        Its grid, its air and its losses.
    name : str
        In the cache.
    band : Band
    part : Lumen
    label : str
        What it is, in words.

    Returns
    -------
    Done of Scattering
    """
    known = _recalled(name)
    if known is not None:
        return Done(known, True)
    waves = config.waves
    air = air_at(
        band.temperature, humidity=waves.humidity_percent, pressure=1e3 * waves.pressure_kpa
    )
    with one_thread():
        found, _ = sound.scattering_of(
            part, air, (band.low, band.high), bore=1e-3 * config.tube.inner_diameter_mm,
            resolution=waves.resolution, lossy=waves.losses == "on",
        )  # fmt: skip
    content = np.frombuffer(to_netcdf(to_dataset(found)), np.uint8)
    cache.store(name, {"netcdf": content}, label)
    return Done(found, False)


def _recalled(name: str) -> Scattering | None:
    known = cache.recall(name)
    if known is None:
        return None
    with xr.open_dataset(known["netcdf"].tobytes(), engine="h5netcdf") as data:
        return from_dataset(data.load())


class Heard(NamedTuple):
    """What came of some cases.

    Attributes
    ----------
    dataset : xarray.Dataset or None
        Of those that succeeded, along ``press``.
    failed : dict of str
        Why the others did not, by name.
    """

    dataset: xr.Dataset | None
    failed: Mapping[str, str]


def hear(cases: Mapping[str, Config], pressed: Pressed, matrix: Scattering | None) -> Done[Heard]:
    """Send pulses through tubes that are pressed alike, and find the presses by their echoes.

    Parameters
    ----------
    cases : mapping of str to Config
        By name.
    pressed : Pressed
        The press that all of them have.
    matrix : Scattering or None
        Of it; without, whole tubes are marched.

    Returns
    -------
    Done of Heard
    """
    rows, failed = {}, {}
    with one_thread():
        for name, config in cases.items():
            try:
                rows[name] = _one(config, pressed, matrix)
            except (ConfigError, SimulationError, ValueError) as error:
                failed[name] = " ".join(str(error).split())
    gathered = _gathered({n: cases[n] for n in rows}, pressed, rows) if rows else None
    return Done(Heard(gathered, failed), False)


def placed(config: Config, matrix: Scattering | None) -> list[PlacedScatterer]:
    """Return the presses of a case: its one press in its air, or none of an untouched tube."""
    if matrix is None:
        return []
    speed = sound.air_of(config).sound_speed
    return [
        PlacedScatterer(
            at_sound_speed(matrix, speed), 1e-2 * filled(config.indentation.position_cm)
        )
    ]


Row = tuple[dict[SourceEnd, Recording], dict[SourceEnd, Ranging]]


def _one(config: Config, pressed: Pressed, matrix: Scattering | None) -> Row:
    """Return the recordings and rangings of a case."""
    if matrix is None and pressed.part is not None:
        position, length = filled(config.indentation.position_cm), config.tube.length_cm
        whole = whole_tube(pressed.part, 1e-2 * position, 1e-2 * length)
        recordings, _ = sound.listen(config, whole)
    else:
        recordings = sound.joined(config, placed(config, matrix))
    return recordings, {end: sound.locate(config, heard) for end, heard in recordings.items()}


def _gathered(cases: Mapping[str, Config], pressed: Pressed, rows: Mapping[str, Row]) -> xr.Dataset:
    """Return cases of one press as a dataset."""
    variables = _settings(list(cases.values())) | _measured(pressed, len(cases))
    pressures = [_resampled(recordings) for recordings, _ in rows.values()]
    longest = max(pressure.shape[1] for pressure in pressures)
    padded = np.full((len(rows), len(sound.SOURCE_ENDS), longest), np.nan, np.float32)
    for row, pressure in zip(padded, pressures, strict=True):
        row[:, : pressure.shape[1]] = pressure
    rangings = [ranging for _, ranging in rows.values()]
    found = {
        "pressure": ("press source_end time", padded, "1",
                     "mean pressure on the probe plane, as a share of the pulse's peak"),
        "estimated_distance": ("press source_end", _taken(rangings, "distance"), "m",
                               "distance that the highest echo tells"),
        "echo_amplitude": ("press source_end", _taken(rangings, "amplitude"), "1",
                           "highest echo, as a share of the send pulse"),
        "send_time": ("press source_end", _taken(rangings, "send_time"), "s",
                      "maximum of the send pulse"),
        "return_time": ("press source_end", _taken(rangings, "return_time"), "s",
                        "maximum of the highest echo"),
    }  # fmt: skip
    variables |= {name: variable(*parts) for name, parts in found.items()}
    coordinates = {
        "press": variable("press", list(cases), "1", "name of the case"),
        "source_end": variable(
            "source_end", list(sound.SOURCE_ENDS), "1", "what the source end does after the pulse"
        ),
        "time": variable(
            "time", np.arange(longest) * sound.TIME_STEP, "s",
            "time since the pulse starts to leave",
        ),
    }  # fmt: skip
    origin = {
        "title": "Presses of a soft acoustic waveguide",
        "source": "simulation",
        "acoustube_version": __version__,
    }
    return xr.Dataset(variables, coordinates, origin)


def _taken(rangings: Sequence[Mapping[SourceEnd, Ranging]], name: str) -> Any:
    return [[getattr(ranging[end], name) for end in sound.SOURCE_ENDS] for ranging in rangings]


def _resampled(recordings: Mapping[SourceEnd, Recording]) -> Any:
    """Return the pressure for each source end on the common time axis, (n_ends, n)."""
    first = recordings[sound.SOURCE_ENDS[0]]
    pressure = np.stack([recordings[end].pressure[0] for end in sound.SOURCE_ENDS])
    if first.time_step == sound.TIME_STEP:
        return pressure
    from scipy.interpolate import CubicSpline

    time = np.arange(int(first.time[-1] / sound.TIME_STEP) + 1) * sound.TIME_STEP
    return CubicSpline(first.time, pressure, axis=1)(time)


SETTINGS: dict[str, tuple[str, str, Callable[[Config], Any]]] = {
    "diameter": ("m", "diameter of the indenter", lambda c: 1e-3 * c.indentation.indenter_mm),
    "shape": ("1", "shape of the indenter", lambda c: c.indentation.shape),
    "support": ("1", "what the tube rests on", lambda c: c.indentation.support),
    "depth": ("m", DEPTH, lambda c: 1e-3 * c.indentation.depth_mm),
    "true_distance": (
        "m", "distance of the press from the source end",
        lambda c: 1e-2 * filled(c.indentation.position_cm),
    ),
    "inner_diameter": ("m", "bore of the tube", lambda c: 1e-3 * c.tube.inner_diameter_mm),
    "wall_thickness": ("m", "wall of the tube", lambda c: 1e-3 * c.tube.wall_mm),
    "tube_length": ("m", "length of the tube", lambda c: 1e-2 * c.tube.length_cm),
    "shear_modulus": ("Pa", "shear modulus of the wall", press_runs.shear_modulus_from),
    "temperature": ("degC", "temperature of the air", lambda c: c.waves.temperature_c),
    "carrier_frequency": ("Hz", "carrier of the pulse", lambda c: 1e3 * c.waves.frequency_khz),
    "chosen_source_end": ("1", "the source end that was asked for", lambda c: c.waves.source_end),
    "configuration": ("1", "all settings, as JSON", lambda c: to_json(c)),
}  # fmt: skip
"""What a case is labelled with, in SI units and degC."""


def to_json(config: Config) -> str:
    """Return all settings as JSON."""
    import json

    return json.dumps(dataclasses.asdict(config), sort_keys=True)


def _settings(configs: Sequence[Config]) -> dict[str, Any]:
    return {
        name: variable("press", [read(config) for config in configs], units, long_name)
        for name, (units, long_name, read) in SETTINGS.items()
    }


def _measured(pressed: Pressed, n: int) -> dict[str, Any]:
    """Return what the mechanics says of a press, for each of n cases."""
    table = {
        "force": (pressed.force, "N", "force of the tool on the whole tube"),
        "lumen_height": (pressed.height, "m", "height of the lumen at the press"),
        "lumen_width": (pressed.width, "m", "width of the lumen at the press"),
        "lumen_area": (pressed.area, "m2", "cross-section of the lumen at the press"),
    }
    found = {
        name: variable("press", np.full(n, value), units, text)
        for name, (value, units, text) in table.items()
    }
    text = "whether the lumen's walls feel each other"
    return found | {"closed": flag("press", np.full(n, pressed.closed), text)}


def tube_of(config: Config) -> str:
    """Return what tells tubes apart: the hash of the tube's settings."""
    return digest(dataclasses.asdict(config.tube))[:8]
