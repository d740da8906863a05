"""Tasks of a sweep that cases share: the presses of a load path, and the scattering of a press.

Each is a function of its arguments alone, so that it does not matter where or when it runs.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Generic, NamedTuple, TypeVar

import numba
import numpy as np
import xarray as xr
from threadpoolctl import threadpool_limits

from acoustube.air import air_at
from acoustube.base import cache
from acoustube.base.errors import ConfigError, SimulationError
from acoustube.indentation import Indentation, PressError
from acoustube.lumen import Lumen, inner_wall, measure, pressed_part
from acoustube.runs import presses as press_runs
from acoustube.runs import scattering_file, sound
from acoustube.runs.config.si import SIPress, SISettings
from acoustube.runs.scattering_file import StoredScattering
from acoustube.runs.walls import walls

Result = TypeVar("Result")


class Done(NamedTuple, Generic[Result]):
    """Result of a task, and whether the result came from the cache."""

    result: Result
    reused: bool


@dataclasses.dataclass(frozen=True, eq=False)
class Pressed:
    """A tube pressed to one depth.

    Attributes
    ----------
    force : float
        Force of the indenter on the whole tube in N.
    height, width : float
        Height and width of the lumen at the press in m.
    area : float
        Cross-section of the lumen at the press in m2.
    closed : bool
        Whether the lumen's walls are in contact.
    part : Lumen or None
        The pressed part; None for an untouched tube.
    walls : xarray.Dataset or None
        Walls of the pressed part with fewer points; None for an untouched tube.
    """

    force: float
    height: float
    width: float
    area: float
    closed: bool
    part: Lumen | None
    walls: xr.Dataset | None = None


class PressPath(NamedTuple):
    """Presses of one tube by one indenter to several depths.

    Attributes
    ----------
    at : dict of float to Pressed
        Presses by depth in m, without depths that failed.
    failed : dict of float to str
        Reason for each other depth: it was not reached, or the tube is bent too sharply there.
    """

    at: Mapping[float, Pressed]
    failed: Mapping[float, str]


def untouched(settings: SIPress) -> Pressed:
    """Return the force, 0, and the lumen of an undeformed tube."""
    bore = settings.tube.inner_diameter
    return Pressed(0.0, bore, bore, np.pi * bore**2 / 4, closed=False, part=None)


def press(settings: SIPress, depths: Sequence[float]) -> Done[PressPath]:
    """Press a tube to several depths, or read the press from the cache.

    Depths that cannot be reached, or whose lumen cannot be straightened, do not affect the others.

    Parameters
    ----------
    settings : SIPress
        Settings of the press, whose own depth is ignored.
    depths : sequence of float
        Rising depths in m.
    """
    found, failed, reused = _reached(settings, depths)
    if found is None:
        return Done(PressPath({}, failed), reused)
    wall, at = inner_wall(found.mesh), {}
    for row in found.rows_at(depths):
        depth = float(found.depth[row])
        try:
            at[depth] = _pressed(found, row, wall)
            failed.pop(depth, None)
        except (SimulationError, ValueError) as error:
            failed[depth] = " ".join(str(error).split())
    return Done(PressPath(at, failed), reused)


def _reached(
    settings: SIPress, depths: Sequence[float]
) -> tuple[Indentation | None, dict[float, str], bool]:
    """Return a press, the reasons why it may lack some depths, and whether it was cached.

    Depths that are refused, as where an indenter beside the axis would meet the floor, are left
    out, the deepest first. The press is None if there are no others.
    """
    failed: dict[float, str] = {}
    for count in range(len(depths), 0, -1):
        possible = depths[:count]
        reused = cache.holds(press_runs.cache_key(settings, possible))
        try:
            return press_runs.press_to(settings, possible), failed, reused
        except PressError as error:
            return error.indentation, failed | dict.fromkeys(possible, str(error)), reused
        except ConfigError as error:
            failed[possible[-1]] = str(error)
    return None, failed, False


def _pressed(indentation: Indentation, row: int, wall: Any) -> Pressed:
    section = measure(indentation, row, np.array([indentation.indenters[0].z]), wall)
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
    """Frequency band and air temperature of a scattering matrix.

    Attributes
    ----------
    low, high : float
        Ends of the band in Hz.
    temperature : float
        Air temperature in degC of the matrix, from which that at other temperatures follows.
    """

    low: float
    high: float
    temperature: float


def scattering_key(settings: SISettings, depths: Sequence[float], depth: float, band: Band) -> str:
    """Return the cache key of the scattering matrix at one depth of a press to `depths`, in m."""
    return cache.key(
        "scattering",
        {
            "press": press_runs.cache_key(settings, depths),
            "depth": depth,
            "band": list(band),
            "step": sound.FREQUENCY_STEP,
            "air": [settings.humidity, settings.pressure],
            "lossy": settings.lossy,
            "resolution": settings.resolution,
            "method": settings.method,
        },
    )


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute on one thread: workers share the cores, and rounding does not depend on threads."""
    before = numba.get_num_threads()
    numba.set_num_threads(1)
    try:
        with threadpool_limits(1, user_api="blas"):
            yield
    finally:
        numba.set_num_threads(before)


def scattering(
    settings: SISettings, name: str, band: Band, part: Lumen, label: str
) -> Done[StoredScattering]:
    """Compute the scattering of a pressed part, or read it from the cache.

    Parameters
    ----------
    settings : SISettings
        Settings, of which method, grid, humidity, pressure and losses are used.
    name : str
        Cache key; see :func:`scattering_key`.
    band : Band
        Frequency band, and temperature of the air.
    part : Lumen
        From :func:`acoustube.lumen.pressed_part`.
    label : str
        Description for the list of the cache.
    """
    known = scattering_file.recall(name)
    if known is not None:
        return Done(known, True)
    air = air_at(band.temperature, humidity=settings.humidity, pressure=settings.pressure)
    with one_thread():
        found, _, _ = sound.scattering_of(
            part, air, (band.low, band.high), method=settings.method,
            bore=settings.tube.inner_diameter,
            resolution=settings.resolution, lossy=settings.lossy,
        )  # fmt: skip
    scattering_file.keep(name, found, label)
    return Done(found, False)
