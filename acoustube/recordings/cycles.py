"""Dataset of a recording's cycles from named arrays: samples, sampling rate, labels, checked."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from acoustube.base.errors import ConfigError
from acoustube.base.foreign import child
from acoustube.base.foreign.limits import check_file, reading
from acoustube.base.foreign.results import check_result, open_result
from acoustube.base.netcdf import variable
from acoustube.base.rules import Number
from acoustube.base.sampling import sampling_rate
from acoustube.base.version import __version__
from acoustube.recordings.checks import (
    check_samples,
    check_statements,
    check_temperature,
    clipped_cycles,
    silent_cycles,
    suspect_lengths,
)

Named = dict[str, Any]

RATE = Number(1e3, 1e7, "Hz", "samples per second")
SAMPLES = Number(2, 2**40, "samples", "length of a cycle", whole=True)

MAX_LEAD_TIME = 0.1
"""A time axis is taken to be 0 at the trigger if its first sample is less than this time in s from
0."""
RATE_TOLERANCE = 1e-3
"""Largest relative difference between a given sampling rate and that of the time axis: the accuracy
of times with four digits."""

ADVICE = "copy or export it again"
"""What to do about a damaged netCDF file."""

SUSPECT_CYCLE_LENGTH = 0.03
"""Duration in s above which a cycle may be several cycles: in it, sound travels 5 m and back."""

LABELS = {
    "true_distance": ("m", "true distance"),
    "depth": ("m", "depth of the press"),
    "force": ("N", "contact force"),
    "diameter": ("m", "diameter of the indenter"),
}


def read_own_netcdf(path: Path) -> xr.Dataset | None:
    """Return the checked dataset of a netCDF file that acoustube wrote.

    Parameters
    ----------
    path : Path
        A file with ``signal`` (cycle, time), ``temperature`` (cycle), and either ``time`` or the
        attribute ``sampling_rate``. The missing one of the two is added.

    Returns
    -------
    xarray.Dataset or None
        None if the file is of another kind.

    Raises
    ------
    ConfigError
        If its values cannot be used.
    """
    names = _own_names(path)
    if names is None or not {"signal", "temperature"} <= names:
        return None
    data = open_result(path, ADVICE)
    shapes = {"signal": ("cycle", "time"), "temperature": ("cycle",)}
    if any(name not in data or data[name].dims != dims for name, dims in shapes.items()):
        return None
    known = {str(name): value for name, value in data.attrs.items() if name == "sampling_rate"}
    if "time" in data.coords:
        known["time"] = data["time"].values
    signal = _real(path, data["signal"].values)
    rate = _rate(path, known, (signal.shape[1],))
    check_samples(path, signal)
    check_temperature(path, data["temperature"].values)
    single = [name for name in LABELS if name in data and not data[name].ndim]
    data = data.assign({name: data[name].broadcast_like(data["temperature"]) for name in single})
    check_statements(path, data, LABELS)
    if "time" not in data.coords:
        data = data.assign_coords(time=_time(signal.shape[1], rate))
    return data.assign_attrs(data.attrs | {"sampling_rate": rate})


def own_statements(path: Path) -> xr.Dataset | None:
    """Return attributes and variables of a netCDF file that acoustube wrote, but for the signal.

    The variables are those of one value, or of one per cycle. None is returned for a file of
    another kind. Raise ConfigError if the file is damaged, or a result and not a recording.
    """
    if _own_names(path) is None:
        return None
    check_result(path, ADVICE)
    with (
        reading(path, "cannot be read as netCDF", ADVICE),
        xr.open_dataset(path, engine="h5netcdf") as data,
    ):
        return data[[n for n, one in data.variables.items() if set(one.dims) <= {"cycle"}]].load()


def _own_names(path: Path) -> set[str] | None:
    """Return the names of the variables of a netCDF-4 file; None if acoustube did not write it.

    Raise ConfigError if it is a result and not a recording.
    """
    check_file(path, "recording")
    with reading(path, "cannot be read as netCDF", ADVICE):
        entries = child.read("names", path, "recording")
    found: tuple[set[str], set[str]] = set(), set()
    for label, _ in entries:
        found["attribute" in label].add(label["name"])
    names, attributes = found
    if "configuration" in names | attributes:
        raise ConfigError(
            f"{path} is a result of acoustube simulate, indent or sweep and not a recording; "
            "acoustube dataset makes recordings of a sweep"
        )
    return names if "acoustube_version" in attributes else None


def assemble(
    path: Path, known: Named, others: Named, labels: Named, notes: list[str]
) -> xr.Dataset:
    """Return the dataset of a recording from the contents of its file and given values.

    Parameters
    ----------
    path : Path
        The file, for messages and the attribute ``file``.
    known : dict
        Values by quantity, in SI units and degC; see :func:`acoustube.recordings.tables.meaning`.
    others : dict
        Arrays of other names in the file. Arrays of one value per cycle become labels.
    labels : dict
        Labels by name from elsewhere: each must have one value per cycle, or one for all.
    notes : list of str
        Warnings so far, to which further ones are appended.

    Returns
    -------
    xarray.Dataset
        See :func:`acoustube.recordings.read`.

    Raises
    ------
    ConfigError
        If something is missing or cannot be used.
    """
    record = _one_channel(path, _signal(path, known, others), known.get("channel"))
    signal = _cut(path, record, known, notes)
    n, length = signal.shape
    total = record.size if record.ndim == 1 else n
    rate = _rate(path, known, (length, record.size))
    if record.ndim == 1 and n == 1 and length > SUSPECT_CYCLE_LENGTH * rate:
        notes.append(
            f"The record of {length / rate:.3g} s was taken for one cycle; give samples, the "
            "number in a cycle, if it holds several."
        )
    if "temperature" not in known:
        raise ConfigError(
            f"{path} does not state the temperature; give temperature in degC, or temperature_c in "
            f"{path.stem}.toml in the same folder"
        )
    low, high = check_samples(path, signal)
    notes += clipped_cycles(signal, rate, low, high) + silent_cycles(low, high)
    each = partial(_per_cycle, path, shape=signal.shape, total=total)
    temperature = _number(path, "temperature", each("temperature", known["temperature"]))
    check_temperature(path, temperature)
    known_labels = {q: _number(path, q, each(q, known[q])) for q in LABELS if q in known}
    notes += suspect_lengths(known_labels)
    free = _of_length(others, n, notes)
    free |= {name: _words(path, name, each(name, v)) for name, v in labels.items()}
    for name in ("signal", "temperature", "time", "cycle", *known_labels):
        if free.pop(name, None) is not None:
            notes.append(f"{name} is stated twice: the one of unknown unit is left out.")
    variables = {
        "signal": variable("cycle time", signal, "1", "recorded signal, in the recorder's unit"),
        "temperature": variable("cycle", temperature, "degC", "temperature of the air"),
        **{name: variable("cycle", v, *LABELS[name]) for name, v in known_labels.items()},
        **{name: variable("cycle", v, "unknown", f"label {name}") for name, v in free.items()},
    }
    cycle = variable("cycle", np.arange(n), "1", "number of the cycle")
    attributes = {
        "sampling_rate": rate,
        "source": "recording",
        "file": path.name,
        "acoustube_version": __version__,
        "warnings": "\n".join(notes),
    }
    time = _time(length, rate, _start(known, length))
    return xr.Dataset(variables, {"cycle": cycle, "time": time}, attributes)


def _signal(path: Path, known: Named, others: Named) -> NDArray[Any]:
    """Return ``signal``, or else take from `others` the only numeric array with the most axes."""
    if "signal" in known:
        return _real(path, known["signal"])
    arrays = {name: np.asarray(value) for name, value in others.items()}
    for axes in (3, 2, 1):
        fit = {name: array for name, array in arrays.items() if array.ndim == axes}
        able = [name for name, a in fit.items() if a.size > 1 and a.dtype.kind in "iuf"]
        if len(able) == 1:
            return _real(path, others.pop(able[0]))
        if able:
            break
    raise ConfigError(
        f"{path} holds {', '.join(arrays) or 'no arrays'}, none of which is known as the signal; "
        "name one of them signal"
    )


def _real(path: Path, values: Any) -> NDArray[Any]:
    array = np.asarray(values)
    if array.dtype.kind not in "iuf" or array.ndim not in (1, 2, 3):
        raise ConfigError(
            f"{path} holds a signal of type {array.dtype} and shape {array.shape}; give real "
            "numbers of shape (cycle, time)"
        )
    return array


def _one_channel(path: Path, array: NDArray[Any], channel: Any) -> NDArray[Any]:
    """Return one channel of (cycle, time, channel), and a single cycle as (time,)."""
    count = array.shape[2] if array.ndim == 3 else 1
    if channel is None and count > 1:
        raise ConfigError(
            f"{path} has {count} channels; choose one with channel = 0 to {count - 1}"
        )
    rule = Number(0, max(count - 1, 0), "", "channels count from 0", whole=True)
    if count == 1 and channel != 0 and isinstance(channel, int | float):
        raise ConfigError(
            f"{path}: channel = {channel:g}, but the file has one channel; leave it out"
        )
    chosen = int(rule.check(f"{path}: channel", 0 if channel is None else channel))
    cycles = array[..., chosen] if array.ndim == 3 else array
    return cycles[0] if cycles.ndim == 2 and len(cycles) == 1 else cycles


def _cut(path: Path, record: NDArray[Any], known: Named, notes: list[str]) -> NDArray[Any]:
    """Return a record reshaped to (cycle, time), without a copy."""
    wanted = _single(path, "samples", known.get("samples_per_cycle"))
    length = None if wanted is None else int(SAMPLES.check(f"{path}: samples", wanted))
    if record.ndim == 2:
        lengths = [n for n in (np.size(known.get("time", ())), length) if n and n in record.shape]
        if lengths and record.shape[1] != lengths[0]:
            record = record.T
        if length not in (None, record.shape[1]):
            raise ConfigError(
                f"{path}: samples = {length} does not fit cycles of shape {record.shape}; leave it "
                f"out, or give {record.shape[1]}"
            )
    n, count = record.shape[-1], len(record) if record.ndim == 2 else 1
    if n < 2 or not count:
        raise ConfigError(
            f"{path} holds {count} cycles of {n} samples; record at least one cycle of two samples"
        )
    if record.ndim == 2:
        return record
    length = length or n
    if length > n:
        raise ConfigError(f"{path}: samples = {length} is longer than the record of {n}; lower it")
    if rest := n % length:
        notes.append(f"The last {rest} samples are not a complete cycle of {length}: left out.")
    return record[: n - rest].reshape(-1, length)


def _rate(path: Path, known: Named, lengths: tuple[int, ...]) -> float:
    """Return the sampling rate in Hz, as given or else of the time axis.

    Raise ConfigError if neither is there, they disagree, or the number of times on the axis is not
    one of `lengths`.
    """
    given = _single(path, "sampling rate", known.get("sampling_rate"))
    axis = None
    if "time" in known:
        try:
            axis = sampling_rate(known["time"])
        except (ValueError, TypeError) as error:
            raise ConfigError(f"{path}: {error}") from error
        if np.size(known["time"]) not in lengths:
            raise ConfigError(
                f"{path}: its time axis has {np.size(known['time'])} values for {lengths[0]} "
                "samples; give one for each"
            )
    if given is None and axis is None:
        raise ConfigError(
            f"{path} does not state its sampling rate; give rate in Hz, or sampling_rate_hz in "
            f"{path.stem}.toml in the same folder"
        )
    # Nine digits: the last ones of a step taken from times are rounding errors.
    rate = float(RATE.check(f"{path}: rate", float(f"{axis:.9g}") if given is None else given))
    if axis is not None and abs(axis / rate - 1) > RATE_TOLERANCE:
        raise ConfigError(
            f"{path}: rate = {rate:g} Hz contradicts its time axis, which has {axis:g} Hz; correct "
            "one of them"
        )
    return rate


def _single(path: Path, name: str, value: Any) -> Any:
    """Return the unique value of an array as a plain number."""
    if value is None:
        return None
    try:
        values = np.unique(np.asarray(value))
    except (TypeError, ValueError) as error:  # lists of unequal lengths, or tables
        raise ConfigError(f"{path}: {name} is not a number; give one") from error
    if values.size != 1:
        raise ConfigError(f"{path}: {name} has {values.size} different values; give one")
    return values.tolist()[0]


def _per_cycle(
    path: Path, name: str, value: Any, shape: tuple[int, ...], total: int
) -> NDArray[Any]:
    """Return one value per cycle from one per cycle, one for all, or one per sample (averaged)."""
    n, length = shape
    try:
        values = np.asarray(value).squeeze()
    except ValueError as error:
        raise ConfigError(
            f"{path}: {name} is a list of unequal lists; give one value per cycle"
        ) from error
    if values.ndim == 0:
        return np.full(n, values)
    if values.shape == (total,) and total != n and values.dtype.kind in "iuf":
        return np.asarray(values[: n * length].reshape(n, length).mean(axis=1))
    if values.shape != (n,):
        raise ConfigError(
            f"{path}: {name} has shape {values.shape} for {n} cycles of {length} samples; give one "
            "value per cycle, or set samples if the length of the cycles is wrong"
        )
    return values


def _number(path: Path, name: str, values: NDArray[Any]) -> NDArray[np.float64]:
    try:
        if values.dtype.kind == "b":
            raise TypeError
        return values.astype(float)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{path}: {name} = {values[0]!r} is not a number; correct it") from error


def _words(path: Path, name: str, values: NDArray[Any]) -> NDArray[Any]:
    """Return the values of a label; raise unless they are numbers or words."""
    if values.dtype.kind not in "biufU":
        raise ConfigError(f"{path}: {name} is neither numbers nor words; give one value per cycle")
    return values


def _of_length(others: Named, n: int, notes: list[str]) -> Named:
    """Return the arrays of one number or word per cycle; note which arrays are left out."""
    found = {}
    for name, value in others.items():
        values = np.asarray(value)
        values = values.astype(str) if values.dtype.kind in "OT" else values
        if values.shape == (n,) and values.dtype.kind in "biufU":
            found[name] = values
        elif values.size > 1:
            notes.append(f"{name} of shape {values.shape} is not one value per cycle: left out.")
    return found


def _start(known: Named, length: int) -> float:
    """Return the time of a cycle's first sample in s, from its time axis with the trigger at 0.

    It is 0 without a time axis, for an axis over several cycles, and for an axis that starts
    :data:`MAX_LEAD_TIME` or more from 0: such axes do not refer to the trigger.
    """
    time = np.ravel(known.get("time", ()))
    near = time.size == length and abs(float(time[0])) < MAX_LEAD_TIME
    return float(time[0]) if near else 0.0


def _time(length: int, rate: float, start: float = 0.0) -> Any:
    return variable("time", start + np.arange(length) / rate, "s", "time since the trigger")
