"""Task of a sweep for each case: the recording, and the press located in it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from acoustube.base.errors import ConfigError, SimulationError
from acoustube.base.netcdf import flag, variable
from acoustube.base.version import __version__
from acoustube.lumen import whole_tube
from acoustube.runs import sound
from acoustube.runs.config import Config
from acoustube.runs.config.si import SISettings, settings_in_si
from acoustube.runs.provenance import configuration
from acoustube.runs.results import DEPTH, ECHO
from acoustube.runs.scattering_file import StoredScattering
from acoustube.runs.sweep.tasks import Done, Pressed, one_thread
from acoustube.signals import Ranging
from acoustube.waves import PlacedScatterer, Recording, SourceEnd
from acoustube.waves.network import at_sound_speed


class CaseResults(NamedTuple):
    """Results of cases that share a press.

    Attributes
    ----------
    dataset : xarray.Dataset or None
        Results of the cases that succeeded, along ``press``; None if none did.
    failed : dict of str
        Reasons why the other cases failed, by name of the case.
    """

    dataset: xr.Dataset | None
    failed: Mapping[str, str]


def simulate_cases(
    cases: Mapping[str, Config], pressed: Pressed, matrix: StoredScattering | None
) -> Done[CaseResults]:
    """Send pulses through tubes with the same press, and locate the presses by their echoes.

    Parameters
    ----------
    cases : mapping of str to Config
        Cases by name.
    pressed : Pressed
        Press that all cases share.
    matrix : Scattering or None
        Scattering matrix of that press. None if the tube is untouched, or to compute whole tubes in
        the time domain.
    """
    rows, failed = {}, {}
    with one_thread():
        for name, config in cases.items():
            try:
                rows[name] = _record_and_locate(settings_in_si(config), pressed, matrix)
            except (ConfigError, SimulationError, ValueError) as error:
                failed[name] = " ".join(str(error).split())
    gathered = _gathered({n: cases[n] for n in rows}, pressed, rows) if rows else None
    return Done(CaseResults(gathered, failed), False)


def placed(settings: SISettings, matrix: StoredScattering | None) -> list[PlacedScatterer]:
    """Return a list with the scattering of a case at its position, in its air.

    The list is empty if `matrix` is None: the tube is untouched.
    """
    if matrix is None:
        return []
    return [PlacedScatterer(at_sound_speed(matrix, settings.air.sound_speed), settings.position)]


Row = tuple[dict[SourceEnd, Recording], dict[SourceEnd, Ranging]]


def _record_and_locate(
    settings: SISettings, pressed: Pressed, matrix: StoredScattering | None
) -> Row:
    """Return the recordings of a case and the results of their processing, by source end."""
    if matrix is None and pressed.part is not None:
        whole = whole_tube(pressed.part, settings.position, settings.tube.length)
        recordings, _ = sound.tube_recordings(settings, whole)
    else:
        recordings = sound.joined_recordings(settings, placed(settings, matrix))
    rangings = {end: sound.locate(settings, found) for end, found in recordings.items()}
    return recordings, rangings


def _gathered(cases: Mapping[str, Config], pressed: Pressed, rows: Mapping[str, Row]) -> xr.Dataset:
    """Return the results of cases that share a press as a dataset.

    Its dimension ``press`` has one element for each case, with the case's name as coordinate.
    """
    variables = _labels(list(cases.values())) | _measured(pressed, len(cases))
    pressures = [_resampled(recordings) for recordings, _ in rows.values()]
    longest = max(pressure.shape[1] for pressure in pressures)
    padded = np.full((len(rows), len(sound.SOURCE_ENDS), longest), np.nan, np.float32)
    for row, pressure in zip(padded, pressures, strict=True):
        row[:, : pressure.shape[1]] = pressure
    rangings = [ranging for _, ranging in rows.values()]
    text = "mean pressure on the probe plane, relative to the pulse's peak"
    variables["pressure"] = variable("press source_end time", padded, "1", text)
    for name, (own, units, words) in ECHO.items():
        values = [[getattr(one[end], own) for end in sound.SOURCE_ENDS] for one in rangings]
        variables[name] = variable("press source_end", values, units, words)
    coordinates = {
        "press": variable("press", list(cases), "1", "name of the case"),
        "source_end": variable(
            "source_end", list(sound.SOURCE_ENDS), "1", "boundary condition after the pulse"
        ),
        "time": variable(
            "time", np.arange(longest) * sound.TIME_STEP, "s",
            "time since the pulse starts to leave the source end",
        ),
    }  # fmt: skip
    origin = {
        "title": "Presses of a soft acoustic waveguide",
        "source": "simulation",
        "acoustube_version": __version__,
    }
    return xr.Dataset(variables, coordinates, origin)


def _resampled(recordings: Mapping[SourceEnd, Recording]) -> Any:
    """Return the pressure at the probe in steps of `sound.TIME_STEP`, (n_ends, n)."""
    first = recordings[sound.SOURCE_ENDS[0]]
    pressure = np.stack([recordings[end].pressure[0] for end in sound.SOURCE_ENDS])
    if first.time_step == sound.TIME_STEP:
        return pressure
    from scipy.interpolate import CubicSpline

    time = np.arange(int(first.time[-1] / sound.TIME_STEP) + 1) * sound.TIME_STEP
    return CubicSpline(first.time, pressure, axis=1)(time)


LABELS: dict[str, tuple[str, str, Callable[[SISettings], Any]]] = {
    "diameter": ("m", "diameter of the indenter", lambda s: s.indenter.diameter),
    "shape": ("1", "shape of the indenter", lambda s: s.indenter.shape),
    "support": ("1", "support of the tube", lambda s: s.support),
    "depth": ("m", DEPTH, lambda s: s.depth),
    "true_distance": ("m", "distance of the press from the source end", lambda s: s.position),
    "inner_diameter": ("m", "diameter of the bore", lambda s: s.tube.inner_diameter),
    "wall_thickness": ("m", "thickness of the wall", lambda s: s.tube.wall_thickness),
    "tube_length": ("m", "length of the tube", lambda s: s.tube.length),
    "shear_modulus": ("Pa", "shear modulus of the wall", lambda s: s.tube.shear_modulus),
    "temperature": ("degC", "temperature of the air", lambda s: s.temperature),
    "carrier_frequency": ("Hz", "carrier of the pulse", lambda s: s.pulse.frequency),
    "chosen_source_end": ("1", "source end that the settings select", lambda s: s.source_end),
}
"""Labels of a case in SI units and degC: unit, description, and its value in the settings."""


def _labels(configs: Sequence[Config]) -> dict[str, Any]:
    """Return the labels of cases, and all their settings as JSON."""
    settings = [settings_in_si(config) for config in configs]
    found = {
        name: variable("press", [value(s) for s in settings], units, long_name)
        for name, (units, long_name, value) in LABELS.items()
    }
    texts = [configuration(config) for config in configs]
    return found | {"configuration": variable("press", texts, "1", "all settings, as JSON")}


def _measured(pressed: Pressed, n: int) -> dict[str, Any]:
    """Return force and lumen of a press as variables, repeated for n cases."""
    table = {
        "force": (pressed.force, "N", "force of the indenter on the whole tube"),
        "lumen_height": (pressed.height, "m", "height of the lumen at the press"),
        "lumen_width": (pressed.width, "m", "width of the lumen at the press"),
        "lumen_area": (pressed.area, "m2", "cross-section of the lumen at the press"),
    }
    found = {name: variable("press", np.full(n, v), *words) for name, (v, *words) in table.items()}
    text = "whether the lumen's walls are in contact"
    return found | {"closed": flag("press", np.full(n, pressed.closed), text)}
