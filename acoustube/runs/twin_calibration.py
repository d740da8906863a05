"""Calibration of a sensor from recordings of closures that are simulated with its twin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from acoustube import signals
from acoustube.base.errors import ConfigError
from acoustube.base.foreign.documents import read_document
from acoustube.base.foreign.results import settings_in
from acoustube.base.units import CM, MM, PERCENT, US
from acoustube.ranging import Burst, Chirp, Rangefinder, blockage, record
from acoustube.ranging.analogue import oversampling, within
from acoustube.ranging.rangefinder import Drive
from acoustube.runs.sensor_file import (
    KIND,
    finite_numbers,
    sensor_document,
    twin_settings,
)
from acoustube.runs.sweep.dataset import DRIVES, rangefinder_in
from acoustube.signals import Calibration, Processing
from acoustube.waves import Pulse

FIRST, APART = 0.2, 0.05
"""Distance of the nearest simulated closure, and spacing of closures, in m (sleeve paper)."""
BEFORE_END = 0.05
"""Distance in m of the farthest closure from the tube's end."""
FEWEST = 8
"""Smallest number of closures of a calibration."""
LEAST_SPEED = 330.0
"""Lowest speed of sound in m/s at which the farthest closure's echo must be within the cycle."""
CYCLES, UNTOUCHED = 3, 100
"""Number of simulated cycles of each closure, and of the untouched tube."""
AIR = 20.0
"""Air temperature in degC of the simulated recordings.

A calibration depends on it only through the losses, which change by some per cent per 10 K.
"""
SIGMAS, FALSE_ALARMS = (2.8, 5.0, 8.0, 12.0, 20.0), 0.01
"""Least prominences to try, in standard deviations of untouched cycles, and largest accepted
fraction of untouched cycles with a false echo. The first prominence within this limit is used."""
LOW_PASS = 10e3
"""Highest cut-off in Hz of the envelope's low-pass; half the carrier is used if it is lower."""
OUTSIDE = 0.9
"""Highest frequency of simulated closures, relative to half the sampling rate of computation."""


def is_twin(path: Path) -> bool:
    """Return whether a file is that of a twin; False if it cannot be read."""
    try:
        return KIND in read_document(path)
    except ConfigError:
        return False


def twin_calibration(path: Path) -> Calibration:
    """Return the calibration of the sensor of a twin's file.

    Raises
    ------
    ConfigError
        If the file is damaged, the tube is too short for the closures, or the sensor's echoes do
        not suffice for a calibration.

    Notes
    -----
    Cycles of closures every 5 cm, and of the untouched tube with its measured clutter, are
    simulated with the twin and passed to :func:`acoustube.signals.calibrate`. The error of the
    thermometer is not included: temperatures must be corrected by it.
    """
    document = read_document(path)
    own = replace(rangefinder_in(document, path), temperature_bias=0.0, temperature_noise=0.0)
    stated = [document.get(name) for name in ("inner_diameter_mm", "length_cm", "trigger_us")]
    diameter, along, start = finite_numbers(stated, path)
    bore, length, trigger = diameter / MM, along / CM, start / US
    common: dict[str, Any] = {
        "radius": bore / 2, "length": length, "temperature": AIR,
        "reflectors": within(twin_settings(path)["reflectors"], length),
    }  # fmt: skip
    try:
        return _calibrated(own, trigger, common)
    except ValueError as error:
        raise ConfigError(f"{path}: the twin gives no calibration: {error}") from error


def _calibrated(own: Rangefinder, trigger: float, common: Mapping[str, Any]) -> Calibration:
    """Return the calibration of a rangefinder whose drive starts `trigger` s after time zero."""
    band = np.array([100.0, OUTSIDE * oversampling(own) * own.sampling_rate / 2])
    reach = LEAST_SPEED * own.n_samples / own.sampling_rate / 2
    how = _processing_for(own.drive)
    places = np.arange(FIRST, min(common["length"] - BEFORE_END, reach), APART)
    if len(places) < FEWEST:
        raise ConfigError(
            f"a tube of {CM * common['length']:.3g} cm is too short for the {FEWEST} closures of a "
            "simulated calibration; give a calibration (--calibration)"
        )
    shut = [
        record([blockage(band, float(z))], own, n_cycles=CYCLES, seed=i, session_seed=0, **common)
        for i, z in enumerate(places)
    ]
    free = record([], own, n_cycles=UNTOUCHED, seed=len(places), session_seed=0, **common)
    # Times from time zero of the twin's recordings, which may begin earlier.
    time = free["time"].values - own.lead + trigger
    cycles = np.concatenate([one["signal"].values for one in shut])
    for sigmas in SIGMAS:
        found = signals.calibrate(
            time, cycles, np.repeat(places, CYCLES), free["signal"].values, how,
            temperature=AIR, untouched_temperature=AIR, sigmas=sigmas,
        )  # fmt: skip
        if found.false_alarms <= FALSE_ALARMS:
            return found
    raise ConfigError(
        f"{PERCENT * found.false_alarms:.0f} % of its untouched cycles show an echo above "
        f"{SIGMAS[-1]:g} standard deviations; record the untouched tube again, without contact"
    )


def thermometer(path: Path) -> float:
    """Return the error in K of a sensor's thermometer, reading minus air; 0 if not in its file.

    Raises
    ------
    ConfigError
        If the file cannot be read, or is not that of a sensor.
    """
    document = sensor_document(read_document(path), path)
    rangefinder = rangefinder_in(document, path)
    return rangefinder.temperature_bias if "temperature_bias" in document else 0.0


def corrections(sensor: Path | None, calibration: str | None) -> tuple[str | None, float]:
    """Return the file or name of the calibration to use, and the thermometer's error in K.

    The error is reading minus air, 0 without a sensor. The calibration is None if neither argument
    gives one.

    Parameters
    ----------
    sensor : Path or None
        File of a sensor; the file of a twin also gives a calibration.
    calibration : str or None
        File or name of a calibration, which takes precedence over that of the twin.
    """
    if sensor is None:
        return calibration, 0.0
    own = str(sensor) if is_twin(sensor) else None
    return calibration or own, thermometer(sensor)


def processing_of(sensor: Path | None) -> Processing:
    """Return the settings to process a sensor's cycles with, for its carrier and a chirp's band.

    Parameters
    ----------
    sensor : Path or None
        File of a sensor or a twin. The settings are those of the sleeve paper with None.

    Raises
    ------
    ConfigError
        If the file cannot be read, or the drive has several tones, whose compressed pulse has no
        single maximum.
    """
    if sensor is None:
        return Processing()
    drive = rangefinder_in(read_document(sensor), sensor).drive
    try:
        return _processing_for(drive)
    except ValueError as error:
        raise ConfigError(f"{sensor}: {error}") from error


def stated_processing(path: Path, recorded: xr.Dataset) -> Processing | None:
    """Return the settings to process cycles with, for the drive that their recording states.

    Parameters
    ----------
    path : Path
        File of the recording, for messages.
    recorded : xarray.Dataset
        Recordings of :func:`acoustube.ranging.record` and datasets have the attribute
        ``rangefinder``.

    Returns
    -------
    Processing or None
        None if no drive is stated, or one without a carrier.

    Raises
    ------
    ConfigError
        If the statement is damaged, or the drive has several tones.
    """
    if "rangefinder" not in recorded.attrs:
        return None
    words = settings_in(recorded.attrs["rangefinder"], path).get("drive")
    if words is None:
        return None
    try:
        kind = (DRIVES | {"Pulse": Pulse}).get(words["kind"])
        if kind is None:
            return None
        return _processing_for(kind(**{k: value for k, value in words.items() if k != "kind"}))
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from error
    except (AttributeError, KeyError, TypeError) as error:
        raise ConfigError(f"{path}: its drive is damaged; record it again") from error


def _processing_for(drive: Drive) -> Processing:
    """Return the settings to process echoes of a burst, a pulse or a chirp with."""
    if not isinstance(drive, Burst | Chirp | Pulse):
        raise ConfigError(
            "the compressed pulse of kind = 'Tones' has no single maximum, by which an echo would "
            "be located; use Chirp here, or acoustube invert"
        )
    own = Processing(
        frequency=drive.frequency, cutoff=min(LOW_PASS, drive.frequency / 2),
        pulse_cycles=drive.duration * drive.frequency,
    )  # fmt: skip
    return replace(own, bandwidth=drive.bandwidth) if isinstance(drive, Chirp) else own
