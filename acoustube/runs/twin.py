"""Fit of a sensor's twin to recordings from files, which are read and checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import ceil, log2
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from acoustube.air import ABSOLUTE_ZERO, air_at
from acoustube.base.errors import ConfigError
from acoustube.base.report import Reporter
from acoustube.base.units import CM
from acoustube.inversion.twin import (
    Background,
    Group,
    Material,
    Press,
    Twin,
    fit_background,
    fit_twin,
)
from acoustube.inversion.twin.estimate import SPEED
from acoustube.recordings.reading import stated_length
from acoustube.runs.recordings import read_recordings

BITS = (8, 10, 12, 14, 16)
"""Possible resolutions of a converter in bits."""
VOLTS = 1.8
"""Assumed full scale of the converter in V; from counts, voltages follow only relative to it."""
MOST_CLOSURES = 200
"""Largest number of closures that are used; if there are more, evenly spaced ones are chosen."""
MOST_CLUTTER = 5e-3
"""Largest accepted fraction of the incident power that an untouched tube reflects per length, in
1/m: -23 dB re 1/m. Ordinary tubes reflect -48 dB re 1/m."""
SAME_PLACE = 1e-4
"""Step in m to which labels of position are rounded, to group the cycles of one closure."""


@dataclass(frozen=True, kw_only=True)
class Bench:
    """Known properties of the tube, its air and the converter; None for unknown ones.

    Attributes
    ----------
    length : float or None
        Length of the tube in m.
    bits : int or None
        Resolution of the converter; derived from the counts by default.
    humidity : float or None
        Relative humidity of the air in per cent; None for the speed of sound in dry air.
    """

    length: float | None = None
    bits: int | None = None
    humidity: float | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class PressedState:
    """A recorded press.

    Attributes
    ----------
    source : str
        File of the recording.
    place : float
        Distance of the press in m: as stated, or else as estimated from its echo; nan if neither
        exists.
    press : Press
        Tool, depth from the echo, and stated depth and force.
    reason : str
        Reason why the echo gives no depth; empty if it gives one.
    """

    source: str
    place: float
    press: Press
    reason: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class FittedSensor:
    """Twin of a sensor, and the recordings to which it was fitted.

    Attributes
    ----------
    twin : Twin
        Parameters fitted to the echoes of closures.
    rest : Background
        Ring-down, far end, clutter and noise.
    closed : list of Group
        Cycles of each closure.
    untouched : Group
        Cycles of the untouched tube.
    bits : int
        Resolution of the converter.
    quantised : bool
        Whether the recordings are counts.
    full_scale : float
        Voltage of ``2**bits`` counts.
    temperature_noise : float
        Standard deviation in K of the reported temperature within a recording, the median over all
        recordings.
    length : float or None
        Stated length of the tube in m.
    material : Material or None
        Wall and ground as estimated from presses; None without recordings of presses.
    pressed : tuple of PressedState
        The recorded presses.
    """

    twin: Twin
    rest: Background
    closed: list[Group]
    untouched: Group
    bits: int
    quantised: bool
    full_scale: float
    temperature_noise: float
    length: float | None
    material: Material | None = None
    pressed: tuple[PressedState, ...] = ()

    @property
    def per_volt(self) -> float:
        """Counts per volt."""
        return float(2**self.bits / self.full_scale)

    @property
    def dry_offset(self) -> float:
        """Temperature offset in K with which dry air has the speed of sound of the humid air."""
        offset, humidity = self.twin.value("temperature_offset"), self.twin.model.humidity
        if humidity is None:
            return offset
        air = float(np.mean(self.twin.model.temperatures)) + offset
        ratio = air_at(air, humidity=humidity, moist=True).sound_speed / air_at(air).sound_speed
        return offset + (ratio**2 - 1) * (air - ABSOLUTE_ZERO)


def fitted_sensor(
    closed: Sequence[Path],
    untouched: Sequence[Path],
    options: Mapping[str, Any],
    pulse_at: str | float | None,
    *,
    bench: Bench,
    report: Reporter,
    check: Callable[[], None],
) -> FittedSensor:
    """Fit the simulator to recordings of a closed and of an untouched tube.

    Parameters
    ----------
    closed, untouched : sequence of Path
        Files and folders with recordings.
    options : mapping
        Options of :func:`acoustube.recordings.read`.
    pulse_at : float, "auto" or None
        As of :func:`acoustube.runs.recordings.aligned`.
    bench : Bench
    report : Reporter
    check : callable
        Called with the progress, to raise a keyboard interrupt that a library suppressed.

    Raises
    ------
    ConfigError
        If a recording cannot be used; the file and the reason are named.
    """
    shut = read_recordings(closed, options, pulse_at)
    free = read_recordings(untouched, options, pulse_at)
    rate, start = _alike([*shut, *free])
    converter = _converter([*shut, *free], bench.bits)
    if converter[1]:
        shut, free = _of_counts(shut), _of_counts(free)
    groups = [group for path, data in shut for group in _groups(path, data)]
    lengths = [bench.length, *(stated_length(data) for _, data in [*shut, *free])]
    stated = next((length for length in lengths if length is not None), None)
    if len(groups) > MOST_CLOSURES:
        report.note(f"of {len(groups)} closures {MOST_CLOSURES} are used")
        chosen = np.linspace(0, len(groups) - 1, MOST_CLOSURES).astype(int)
        groups = [groups[i] for i in chosen]
    rest = Group(
        np.concatenate([data["signal"].values for _, data in free]),
        float(np.mean(np.concatenate([data["temperature"].values for _, data in free]))),
        source=str(free[0][0]),
    )
    for path, data in [*shut, *free]:
        for words in str(data.attrs.get("warnings", "")).splitlines():
            # Ring-downs are usually clipped, and clipped echoes are reported one by one.
            if "extreme codes" not in words:
                report.note(f"{path}: {words}")
    with report.progress(check) as show:
        try:
            twin = fit_twin(
                groups,
                rest,
                rate,
                start,
                length=stated,
                humidity=bench.humidity,
                show=lambda what, done: show(what, done),
            )
        except ConfigError as error:
            names = [group.source for group in (rest, *groups)]
            if any(name in str(error) for name in names):
                raise
            raise ConfigError(f"{groups[0].source} and {rest.source}: {error}") from error
        show("measuring the clutter", 0.5)
        found = fit_background(twin, rest, groups, stated)
    _check_untouched(twin, found, rest)
    noises = [float(np.std(data["temperature"].values)) for _, data in [*shut, *free]]
    return FittedSensor(
        twin=twin, rest=found, closed=groups, untouched=rest, bits=converter[0],
        quantised=converter[1], full_scale=converter[2],
        temperature_noise=float(np.median(noises)), length=stated,
    )  # fmt: skip


def _alike(parts: Sequence[tuple[Path, xr.Dataset]]) -> tuple[float, float]:
    """Return sampling rate in Hz and start in s of recordings; raise unless they are the same."""
    first, data = parts[0]
    rate, n = float(data.attrs["sampling_rate"]), data.sizes["time"]
    start = float(data["time"].values[0])
    for path, one in parts[1:]:
        other, m = float(one.attrs["sampling_rate"]), one.sizes["time"]
        if abs(other / rate - 1) > 1e-6 or m != n:
            raise ConfigError(
                f"{path} has cycles of {m} samples at {other:g} Hz, and {first} of {n} at {rate:g} "
                "Hz; use one sampling rate and length"
            )
        if abs(float(one["time"].values[0]) - start) > 0.5 / rate:
            raise ConfigError(
                f"{path} and {first} begin at different times before the send pulse; record all "
                "alike"
            )
    return rate, start


def _groups(path: Path, data: xr.Dataset) -> list[Group]:
    """Return the cycles of each closure of a recording, by its label true_distance."""
    if "true_distance" not in data:
        raise ConfigError(
            f"the closed cycles of {path} have no label true_distance; give it in the file or in a "
            "sidecar, and name the recordings of the closed tube before those of the untouched one"
        )
    places = np.asarray(data["true_distance"].values, float)
    if not np.any(np.isfinite(places)):
        raise ConfigError(f"the label true_distance of {path} holds no number; correct it")
    keys = np.round(places / SAME_PLACE)
    found = []
    for key in np.unique(keys[np.isfinite(keys)]):
        these = keys == key
        found.append(
            Group(
                data["signal"].values[these],
                float(np.mean(data["temperature"].values[these])),
                float(np.mean(places[these])),
                str(path),
            )
        )
    return found


def _of_counts(parts: Sequence[tuple[Path, xr.Dataset]]) -> list[tuple[Path, xr.Dataset]]:
    """Return recordings with their counts, which may be stored as other numbers, as integers."""
    return [(path, data.assign(signal=data["signal"].astype(int))) for path, data in parts]


def _converter(
    parts: Sequence[tuple[Path, xr.Dataset]], bits: int | None
) -> tuple[int, bool, float]:
    """Return resolution in bits, whether samples are counts, and full scale in V."""
    low = min(float(data["signal"].min()) for _, data in parts)
    high = max(float(data["signal"].max()) for _, data in parts)
    counts = [data["signal"] for _, data in parts]
    whole = all(
        np.issubdtype(one.dtype, np.integer) or (bits is not None and not np.any(one.values % 1))
        for one in counts
    )
    if bits is not None and (not whole or low < 0):
        raise ConfigError("bits needs counts, but samples are fractions or negative; leave it out")
    if not whole or low < 0 or high >= 2 ** BITS[-1]:
        # Samples in an unknown unit, which is taken to be the volt.
        return 16, False, float(2**16)
    if bits is None:
        stated = [data.attrs["full_scale"] for _, data in parts if "full_scale" in data.attrs]
        least = ceil(log2(high + 1)) if high > 0 else 1
        bits = round(log2(float(stated[0]))) if stated else next(b for b in BITS if b >= least)
    if high >= 2**bits:
        raise ConfigError(
            "is too few", setting="bits", value=bits,
            advice=f"use {ceil(log2(high + 1))} or more, as counts reach {high:g}",
        )  # fmt: skip
    return bits, True, VOLTS


def _check_untouched(twin: Twin, rest: Background, untouched: Group) -> None:
    """Raise if the untouched cycles hold the echo of a press or a closure."""
    if rest.clutter.value > MOST_CLUTTER:
        raise ConfigError(
            f"the untouched cycles of {untouched.source} hold echoes along the whole tube, as of "
            "presses; record them without contact"
        )
    reflected = np.abs(np.convolve(rest.reflectivity, np.ones(8), mode="same"))
    power = np.sqrt(np.convolve(reflected**2, np.ones(8) / 8, mode="same"))
    beyond = rest.places > 0.5 * SPEED * twin.band.first + 0.05
    inside = beyond & (rest.places < 0.98 * float(twin.model.places.max()))
    if not inside.any():
        return
    largest = int(np.argmax(np.where(inside, power, 0)))
    if power[largest] > 0.3:
        raise ConfigError(
            f"the untouched cycles of {untouched.source} hold an echo near "
            f"{CM * rest.places[largest]:.0f} cm as strong as that of a closure; record them "
            "without contact"
        )
