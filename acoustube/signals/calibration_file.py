"""TOML files of calibrations."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from tomlkit.items import Item

from acoustube.base.errors import ConfigError
from acoustube.base.files import toml_array
from acoustube.base.foreign.documents import read_document
from acoustube.base.foreign.limits import reading
from acoustube.base.writing import write
from acoustube.signals.calibration import Calibration, Estimate
from acoustube.signals.filters import TimeGain
from acoustube.signals.processing import Processing

_NUMBERS = ("sampling_rate", "amplitude_rmse", "distance_rmse", "false_alarms")
_FITS = ("c1", "c2", "c3", "c4", "slope", "intercept")
_LISTS = ("true_distance", "estimated_distance", "amplitude")
_UNITS = {
    "frequency": "Hz", "pulse_cycles": "carrier cycles sent", "offset_cutoff": "Hz",
    "template_cycles": "carrier cycles of the matched filter", "bandwidth": "Hz, of a chirp",
    "window": "of the chirp's template", "cutoff": "Hz, of the envelope",
    "prominence": "relative to the send pulse", "nearest": "m", "farthest": "m", "send_shift": "s",
    "gain": "c1 tanh(c2 (l - c3)) + c4", "sampling_rate": "Hz", "c1": "1", "c2": "1/m", "c3": "m",
    "c4": "1", "slope": "m/m", "intercept": "m, before the shift", "amplitude_rmse": "1",
    "distance_rmse": "m", "false_alarms": "fraction of the untouched cycles",
    "true_distance": "m", "estimated_distance": "m", "amplitude": "relative to the send pulse",
}  # fmt: skip


def save(calibration: Calibration, path: str | Path) -> None:
    """Write a calibration to a new TOML file, each value with its unit.

    Parameters
    ----------
    calibration : Calibration
    path : str or Path

    Raises
    ------
    ConfigError
        If the file exists or cannot be written.
    SimulationError
        If the disk is full.
    """
    if os.path.lexists(path):
        raise ConfigError(f"{path} exists and nothing is overwritten; name a new file")
    write(path, in_toml(calibration))


def in_toml(calibration: Calibration) -> str:
    """Return the content of the file of a calibration, each value with its unit.

    Parameters
    ----------
    calibration : Calibration
    """
    document = tomlkit.document()
    document.add(tomlkit.comment("A calibration of acoustube; every value with its unit."))
    processing, fitted = tomlkit.table(), tomlkit.table()
    for name in calibration.processing.__dataclass_fields__:
        value = getattr(calibration.processing, name)
        processing.add(name, False if value is None else _toml(value, _UNITS[name]))
    for name in (*_NUMBERS, *_FITS, *_LISTS):
        unit = f"{_UNITS[name]}; its deviation" if name in _FITS else _UNITS[name]
        fitted.add(name, _toml(getattr(calibration, name), unit))
    document.add("processing", processing)
    document.add(tomlkit.nl())
    document.add("calibration", fitted)
    return tomlkit.dumps(document)


def _toml(value: Any, unit: str) -> Item:
    """Return the TOML item of a number or an array of numbers, with the unit as a comment."""
    if isinstance(value, str):
        return tomlkit.item(value).comment(unit)
    several = np.ndim(value) > 0
    item = toml_array(float(one) for one in value) if several else tomlkit.item(float(value))
    return item.comment(unit)


def load(path: str | Path) -> Calibration:
    """Read a calibration that :func:`save` wrote.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    Calibration

    Raises
    ------
    ConfigError
        If the file cannot be read or is not a calibration.
    """
    with reading(path, "is not a calibration", "acoustube calibrate writes one"):
        document = _document(path)
        found, fits = document["calibration"], dict[str, Any]()
        for name in _FITS:
            value, deviation = found[name]
            fits[name] = Estimate(float(value), float(deviation))
        fits |= {name: np.asarray(found[name], float) for name in _LISTS}
        fits |= {name: float(found[name]) for name in _NUMBERS}
        processing = _processing(document["processing"])
        if not fits["sampling_rate"] > 2 * processing.cutoff:
            raise ValueError("sampling_rate must be over twice the cutoff")
        return Calibration(processing=processing, **fits)
    raise AssertionError  # unreachable: the block returns or raises


def _document(path: str | Path) -> dict[str, Any]:
    try:
        return read_document(path)
    except ConfigError as error:  # of any kind: its message says what is expected
        raise ValueError(str(error).removeprefix(f"{path} ")) from error


def _processing(given: Mapping[str, Any]) -> Processing:
    values: dict[str, Any] = {n: None if v is False else v for n, v in given.items()}
    if values.get("gain") is not None:
        values["gain"] = TimeGain(*(float(c) for c in values["gain"]))
    return Processing(**values)
