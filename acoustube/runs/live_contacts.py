"""Contacts in the cycles of a board as they arrive, by a tracker that inverts each cycle."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acoustube.base.errors import ConfigError
from acoustube.base.units import CM, MM
from acoustube.inversion import (
    Clutter,
    ContactTracker,
    ForwardModel,
    Tracked,
    baseband_of,
    measured_clutter,
)
from acoustube.inversion.model import check_band
from acoustube.ranging import Rangefinder
from acoustube.recordings.echotube_stream import PULSE_WIDTH_BYTES
from acoustube.runs.contact_table import CONTACT_COLUMNS, contact_cells
from acoustube.runs.inversion import BAND_ADVICE, USUAL_LENGTH, Sensor, read_sensor
from acoustube.runs.libraries.files import open_library

COLUMNS = ("cycle", "received_s", "contact", *CONTACT_COLUMNS)
"""Columns of the table of contacts; the units are in the names."""
BITS = 8
"""Resolution of a board's samples in bits."""
FEWEST = 8
"""Smallest number of untouched cycles from which clutter is estimated."""
BACKLOG, LONGEST_BACKLOG = 2, 20
"""Largest number of waiting cycles at which contacts that appear or disappear are still sought in a
cycle, and largest number of waiting cycles, and of successive cycles without a search, at which a
cycle is used to follow the known contacts. Beyond it, cycles are skipped until one is searched."""


@dataclass(frozen=True, kw_only=True)
class Contacts:
    """Settings of the search for contacts in a stream.

    Attributes
    ----------
    folder : Path
        Folder of the library.
    sensor : Path or None
        TOML file of the sensor, see :func:`acoustube.runs.inversion.read_sensor`.
    rest : float
        Time in s at the start during which the tube is untouched and its clutter is estimated; 0
        to assume no clutter.
    most : int
        Largest number of contacts.
    table : Path or None
        New CSV file with one row of :data:`COLUMNS` per contact and cycle; None for no file.
    """

    folder: Path
    sensor: Path | None = None
    rest: float = 3.0
    most: int = 3
    table: Path | None = None

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of the table."""
        return COLUMNS


class Follower:
    """Tracker of the contacts in the cycles of a stream, which first estimates the clutter.

    Parameters
    ----------
    how : Contacts
    rate : float
        Sampling rate in Hz.
    n_samples : int
        Samples of a cycle, including the first two, which the board replaces by the pulse width.
    temperature : float
        Temperature in degC that the thermometer reads; the sensor's bias is subtracted.

    Raises
    ------
    ConfigError
        If the library or the sensor cannot be read, or does not match the stream.
    """

    def __init__(self, how: Contacts, rate: float, n_samples: int, temperature: float) -> None:
        self.how = how
        sensor = Sensor() if how.sensor is None else read_sensor(how.sensor)
        self.tool_library = sensor.own(open_library(how.folder))
        rangefinder = sensor.rangefinder or Rangefinder(sampling_rate=rate, bits=BITS)
        if abs(rangefinder.sampling_rate / rate - 1) > 1e-3:
            raise ConfigError(
                f"the stream has rate = {rate:g} Hz and the sensor sampling_rate = "
                f"{rangefinder.sampling_rate:g} Hz; state the same in both"
            )
        if rangefinder.bits != BITS:
            raise ConfigError(
                f"a board sends samples of {BITS} bits and the sensor has {rangefinder.bits}; "
                f"state bits = {BITS} and their full_scale in the file of the sensor"
            )
        air = temperature - sensor.temperature_bias()
        self.sensor = replace(sensor, rangefinder=rangefinder)
        self.base = baseband_of(
            rangefinder, self.tool_library.radius, sensor.length or USUAL_LENGTH, air,
            self.tool_library.modes, n_samples, sensor.wrap,
        )  # fmt: skip
        check_band(self.tool_library, self.base, BAND_ADVICE)
        self.untouched: list[NDArray[np.uint8]] = []
        self.began: float | None = None
        self.before: float | None = None
        self.n_skipped, self.n_hurried, self.behind = 0, 0, 0
        self.times: list[float] = []
        self.tracker: ContactTracker | None = self._tracker(None)
        if how.rest:  # made only to raise its errors before the rest, not after it
            self.tracker = None

    @property
    def learning(self) -> bool:
        """True while the clutter is estimated from the untouched tube."""
        return self.tracker is None

    def update(
        self, samples: NDArray[np.uint8], received: float, waiting: int = 0
    ) -> Tracked | None:
        """Return the contacts after a cycle; None if it is skipped or used for the clutter.

        Parameters
        ----------
        samples : ndarray
            Samples of the cycle from the third on, (n_samples - 2,).
        received : float
            Arrival time in s, with an arbitrary origin.
        waiting : int
            Number of cycles that have arrived since; see :data:`BACKLOG`.
        """
        cycle = np.concatenate([np.repeat(samples[:1], PULSE_WIDTH_BYTES), samples])
        if self.tracker is None:
            self.began = received if self.began is None else self.began
            self.untouched.append(cycle)
            enough = len(self.untouched) >= FEWEST and received - self.began >= self.how.rest
            if enough:
                clutter = measured_clutter(self.base, np.array(self.untouched))
                self.tracker = self._tracker(clutter)
                self.untouched = []
            return None
        search = waiting <= BACKLOG
        self.behind = 0 if search else max(self.behind + 1, waiting)
        if self.behind > LONGEST_BACKLOG:
            self.n_skipped += 1
            return None
        elapsed = None if self.before is None else max(received - self.before, 1e-3)
        self.before = received
        start = time.perf_counter()
        self.n_hurried += not search
        found = self.tracker.update(cycle, elapsed, search=search)
        self.times.append(time.perf_counter() - start)
        del self.times[:-2000]
        return found

    def _tracker(self, clutter: Clutter | None) -> ContactTracker:
        model = ForwardModel(self.tool_library, self.base, clutter, self.sensor.priors)
        return ContactTracker(model, self.how.most)

    def rows(self, number: int, received: float, found: Tracked | None) -> list[list[object]]:
        """Return a row of :data:`COLUMNS` for each contact of a cycle; none if `found` is None.

        `number` is that of the cycle, and `received` its arrival as Unix time in s.
        """
        if found is None:
            return []
        return [
            [number, f"{received:.6f}", name, *contact_cells(one, found.misfit, self.tool_library)]
            for name, one in zip(found.numbers, found.contacts, strict=True)
        ]


def in_words(found: Tracked) -> list[str]:
    """Return a line for each contact, with standard deviations, and one if the misfit is large."""
    lines = []
    for number, one in zip(found.numbers, found.contacts, strict=True):
        parts = (one.distance, CM, 2), (one.depth, MM, 2), (one.force, 1.0, 1)
        place, depth, force = (
            f"{scale * e.value:.{digits}f} ± {scale * e.deviation:.{digits}f}"
            for e, scale, digits in parts
        )
        sure = f"{100 * one.probability:.0f} %"
        lines.append(f"contact {number}: {place} cm, {depth} mm, {force} N, {sure}")
    if not found.fits:
        reason = "the echo differs from the library's, or a contact is not found yet"
        lines.append(f"misfit {found.misfit:.2f}: {reason}")
    return lines


def drawn(found: Tracked, width: int) -> str:
    """Return the tube as a row of `width` characters, with the contacts on it.

    The row ends at the largest distance whose echo arrives within a cycle.
    """
    row, length = ["─"] * width, float(found.place[-1])
    for one in found.contacts:
        row[min(width - 1, max(0, int(width * one.distance.value / length)))] = "▼"
    return "".join(row)
