"""Inversion of recordings: sensors, groups of cycles, and tables of contacts."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from acoustube.base.errors import ConfigError
from acoustube.base.foreign.results import settings_in
from acoustube.base.rules import Number, nearest
from acoustube.base.units import CM
from acoustube.inversion import (
    Baseband,
    ForwardModel,
    Inversion,
    Inverter,
    Library,
    Priors,
    Wrap,
    baseband_of,
)
from acoustube.inversion.clutter import Reflectors, mean_reflectors, reflectors
from acoustube.inversion.model import check_band
from acoustube.ranging import Rangefinder
from acoustube.recordings.reading import stated_length
from acoustube.runs.config import read_document
from acoustube.runs.sensor_file import sensor_document, young_modulus
from acoustube.runs.sweep.dataset import rangefinder_in
from acoustube.runs.wrap import read_wrap

USUAL_LENGTH = 2.5
"""Tube length in m, assumed where neither the sensor's file nor the recording states one."""
SAME_AIR = 0.25
"""Largest difference in K between the air temperatures of untouched cycles that are averaged. If
there are untouched cycles, a forward model is reused for air that differs from its own by less:
their clutter then shows the difference, and the inversion estimates it."""
EQUAL_AIR = 0.02
"""Largest difference of air temperature in K up to which a forward model is reused if there are no
untouched cycles. Such a difference changes an estimated distance of 1.6 m by 0.06 mm."""
BLOCK = 50
"""Least number of untouched cycles whose temperatures are averaged; a recording of fewer is one
block. The thermometer's noise is negligible in the mean of so many."""
LENGTH = Number(1, 1000, "cm", "length of the tube")
BAND_ADVICE = (
    "name the recordings' own rangefinder by --sensor, or make a library with its --frequency and "
    "--temperature"
)
"""Advice where the band of a library does not contain that of the rangefinder."""


@dataclass(frozen=True, kw_only=True)
class Sensor:
    """Known properties of a rangefinder and its tube.

    Attributes
    ----------
    rangefinder : Rangefinder or None
        None for that of the sleeve paper, with the sampling rate of the recordings.
    known_thermometer : bool
        Whether the ``temperature_bias`` of `rangefinder` is that of the sensor. False where a file
        does not state it.
    length : float or None
        Length of the tube in m, used where a recording does not state it.
    priors : Priors
        Standard deviations of the uncertain quantities.
    young_modulus : (float, float) or None
        Young's modulus of the wall and its standard deviation, in Pa; None for that of the library.
    wrap : Wrap or None
        Curvature of the wrapped tube; None for a straight one.
    """

    rangefinder: Rangefinder | None = None
    known_thermometer: bool = True
    length: float | None = None
    priors: Priors = field(default_factory=Priors)
    young_modulus: tuple[float, float] | None = None
    wrap: Wrap | None = None

    def own(self, library: Library) -> Library:
        """Return a library, its forces scaled to the sensor's Young's modulus if this is known.

        Raises
        ------
        ConfigError
            If the forces of the library do not scale with the modulus.
        """
        return (
            library
            if self.young_modulus is None
            else library.with_young_modulus(*self.young_modulus)
        )

    def temperature_bias(self, recorded: xr.Dataset | None = None) -> float:
        """Return the mean error of the thermometer in K, reading minus air.

        It is that of the sensor if known. Otherwise it is the error that `recorded` states, as
        recordings of :func:`acoustube.ranging.record` and datasets do, and 0 if nothing states it.
        """
        if self.rangefinder is not None and self.known_thermometer:
            return self.rangefinder.temperature_bias
        if recorded is None:
            return 0.0
        stated = recorded.attrs.get("rangefinder", "{}")
        own = settings_in(stated, "the attribute rangefinder of a recording")
        return float(own.get("temperature_bias", 0.0))


def read_sensor(path: Path) -> Sensor:
    """Read a sensor from a TOML file.

    Parameters
    ----------
    path : Path
        TOML file with ``length_cm``, the parameters of :class:`acoustube.ranging.Rangefinder`, its
        drive in a table ``[drive]``, standard deviations of :class:`acoustube.inversion.Priors` in
        a table ``[priors]``, and a table ``[wrap]`` (:func:`acoustube.runs.wrap.read_wrap`);
        alternatively the file of a twin.

    Raises
    ------
    ConfigError
        If the file cannot be read, or a name or a value is wrong.
    """
    given = read_document(path)
    document, modulus = sensor_document(given, path), young_modulus(given, path)
    length, priors = document.pop("length_cm", None), document.pop("priors", {})
    wrap = read_wrap(document.pop("wrap"), path) if "wrap" in document else None
    known = [one.name for one in dataclasses.fields(Priors)]
    if not isinstance(priors, dict):
        raise ConfigError(f"{path}: priors = {priors!r} must be a section, written [priors]")
    for name in priors:
        if name not in known:
            raise ConfigError(f"{path}: [priors] {name} is not known{nearest(name, known)}")
    try:
        metres = None if length is None else LENGTH.check("length_cm", length) / CM
        found = Priors(**priors)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    return Sensor(
        rangefinder=rangefinder_in(document, path),
        known_thermometer="temperature_bias" in document, length=metres, priors=found,
        young_modulus=modulus, wrap=wrap,
    )  # fmt: skip


class RecordingInverter:
    """Inversion of recordings of one sensor, with a forward model for each air temperature.

    Parameters
    ----------
    library : Library
    sensor : Sensor
    untouched : sequence of (Path, xarray.Dataset), optional
        Recordings of the untouched tube, from which its clutter is estimated; without any, no
        clutter is assumed.
    most : int
        Largest number of contacts.
    """

    def __init__(
        self,
        library: Library,
        sensor: Sensor,
        untouched: Sequence[tuple[Path, xr.Dataset]] = (),
        most: int = 3,
    ) -> None:
        self.tool_library, self.sensor, self.most = sensor.own(library), sensor, most
        self.untouched = untouched
        self._known: dict[tuple[Any, ...], tuple[float, Inverter]] = {}
        self._reflectors: dict[tuple[Any, ...], Reflectors] = {}

    def from_other_end(
        self, length: float, untouched: Sequence[tuple[Path, xr.Dataset]]
    ) -> RecordingInverter:
        """Return the inversion of recordings of the same rangefinder at the tube's other end.

        Parameters
        ----------
        length : float
            Length of the tube in m.
        untouched : sequence of (Path, xarray.Dataset)
            Recordings of the untouched tube from the other end.

        Raises
        ------
        ConfigError
            If the wrapped part ends beyond the tube.
        """
        wrap = None if self.sensor.wrap is None else self.sensor.wrap.from_other_end(length)
        sensor = dataclasses.replace(self.sensor, wrap=wrap, length=length)
        return RecordingInverter(self.tool_library, sensor, untouched, self.most)

    def groups(
        self, path: Path, data: xr.Dataset, size: int, check: Callable[[], None]
    ) -> Iterator[tuple[int, Inversion]]:
        """Yield the number, from 0, of each group of consecutive cycles, and its inversion.

        Parameters
        ----------
        path : Path
            File of the recording, for messages.
        data : xarray.Dataset
            From :func:`acoustube.recordings.read`.
        size : int
            Number of cycles in a group; the last group may have fewer.
        check : callable
            Called before each group, to raise a keyboard interrupt that a library suppressed.

        Raises
        ------
        ConfigError
            If the recording does not match the sensor, the library or the untouched cycles.
        """
        rangefinder = self._rangefinder(path, data)
        signal, temperature = data["signal"], data["temperature"].values
        for number, start in enumerate(range(0, signal.sizes["cycle"], size)):
            check()
            part = slice(start, start + size)
            air = float(np.mean(temperature[part])) - self.sensor.temperature_bias(data)
            inverter = self._inverter(path, data, rangefinder, air)
            yield number, inverter(signal.values[part])

    def _rangefinder(self, path: Path, data: xr.Dataset) -> Rangefinder:
        """Return the rangefinder of a recording, after a check of its sampling rate and samples."""
        rate = float(data.attrs["sampling_rate"])
        found = self.sensor.rangefinder or dataclasses.replace(Rangefinder(), sampling_rate=rate)
        if abs(rate / found.sampling_rate - 1) > 1e-3:
            raise ConfigError(
                f"{path} has {rate:g} samples per second and the sensor {found.sampling_rate:g}; "
                "state the rate of the recordings in the file of the sensor"
            )
        low, high = float(data["signal"].min()), float(data["signal"].max())
        if low < 0 or high >= 2**found.bits or high - low < 2:
            raise ConfigError(
                f"{path} holds samples from {low:.4g} to {high:.4g}, not counts of a converter of "
                f"{found.bits} bits; state bits and full_scale in the file of the sensor, or "
                "record counts"
            )
        return found

    def _inverter(
        self, path: Path, data: xr.Dataset, rangefinder: Rangefinder, air: float
    ) -> Inverter:
        """Return the inverter for a recording at an air temperature in degC, new or made before."""
        key = (data.sizes["time"], length := self.length(data) or USUAL_LENGTH, rangefinder)
        known = self._known.get(key)
        if known is not None and abs(known[0] - air) < (SAME_AIR if self.untouched else EQUAL_AIR):
            return known[1]
        base = self._baseband(rangefinder, length, air, data.sizes["time"])
        check_band(self.tool_library, base, BAND_ADVICE)
        clutter = None
        if self.untouched:
            if key not in self._reflectors:
                free = self._untouched(path, data)
                parts = [
                    reflectors(self._baseband(rangefinder, length, own, data.sizes["time"]), cycles)
                    for cycles, own in free
                ]
                self._reflectors[key] = mean_reflectors(parts, [len(one) for one, _ in free])
            clutter = self._reflectors[key].clutter(base)
        model = ForwardModel(self.tool_library, base, clutter, self.sensor.priors)
        inverter = Inverter(model, self.most)
        self._known[key] = air, inverter
        return inverter

    def _baseband(
        self, rangefinder: Rangefinder, length: float, air: float, n_samples: int
    ) -> Baseband:
        return baseband_of(
            rangefinder,
            self.tool_library.radius,
            length,
            air,
            self.tool_library.modes,
            n_samples,
            self.sensor.wrap,
        )

    def length(self, data: xr.Dataset) -> float | None:
        """Return the length of a recording's tube in m, None if it is not stated.

        The length that the recording states takes precedence over that of the sensor's file, since
        contacts beyond the end of the tube would be missed.
        """
        own = stated_length(data)
        return self.sensor.length if own is None else own

    def _untouched(self, path: Path, data: xr.Dataset) -> list[tuple[Any, float]]:
        """Return the untouched cycles, (n, n_samples), at each air temperature in degC.

        Blocks of cycles whose mean temperatures differ by :data:`SAME_AIR` or less are joined.
        """
        found: list[tuple[Any, Any]] = []
        for source, one in self.untouched:
            if one.sizes["time"] != data.sizes["time"]:
                raise ConfigError(
                    f"{source} has cycles of {one.sizes['time']} samples and {path} of "
                    f"{data.sizes['time']}; record both alike"
                )
            rate, own = data.attrs["sampling_rate"], one.attrs["sampling_rate"]
            if abs(own / rate - 1) > 1e-3:
                raise ConfigError(
                    f"{source} has {own:g} samples per second and {path} {rate:g}; record both "
                    "alike"
                )
            air = one["temperature"].values - self.sensor.temperature_bias(one)
            blocks = max(1, len(air) // BLOCK)
            parts = (np.array_split(values, blocks) for values in (one["signal"].values, air))
            found += zip(*parts, strict=True)
        groups: list[list[tuple[Any, Any]]] = []
        for cycles, air in sorted(found, key=lambda known: float(np.mean(known[1]))):
            if not groups or np.mean(air) - np.mean(groups[-1][0][1]) > SAME_AIR:
                groups.append([])
            groups[-1].append((cycles, air))
        joined = [[np.concatenate(part) for part in zip(*group, strict=True)] for group in groups]
        return [(cycles, float(np.mean(air))) for cycles, air in joined]
