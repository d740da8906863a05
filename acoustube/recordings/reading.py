"""Reading of one file or many, with sidecar files and arguments that override them."""

from __future__ import annotations

import difflib
import json
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from acoustube.base.checks import checked
from acoustube.base.errors import ConfigError
from acoustube.base.files import check_netcdf_name
from acoustube.base.foreign.documents import read_document
from acoustube.base.foreign.limits import reading
from acoustube.base.foreign.results import settings_in
from acoustube.base.names import PATH, PATHS
from acoustube.base.netcdf import write_dataset
from acoustube.base.version import __version__
from acoustube.recordings.checks import check_statements
from acoustube.recordings.cycles import LABELS, assemble, own_statements, read_own_netcdf
from acoustube.recordings.formats import KINDS, load
from acoustube.recordings.tables import Note, separate_known

_SIDECAR = {
    "sampling_rate_hz": "sampling_rate",
    "temperature_c": "temperature",
    "channel": "channel",
    "samples_per_cycle": "samples_per_cycle",
    "labels": "labels",
}


def read(
    path: str | Path,
    *,
    rate: float | None = None,
    temperature: ArrayLike | None = None,
    channel: int | None = None,
    samples: int | None = None,
) -> xr.Dataset:
    """Read one recording.

    Parameters
    ----------
    path : str or Path
        NPZ, NPY, CSV, TSV, WAV, FLAC, MAT, HDF5 or netCDF. A sidecar file of the same name with
        the suffix ``.toml`` or ``.json`` may state any of ``sampling_rate_hz``, ``temperature_c``,
        ``channel``, ``samples_per_cycle`` and a table ``labels``.
    rate : float, optional
        Samples per second. Arguments override the sidecar file, which overrides the file.
    temperature : float or array of shape (cycle,), optional
        Temperature of the air in degC.
    channel : int, optional
        Channel to read, from 0.
    samples : int, optional
        Samples per cycle of a continuous record. In an array of two axes, the axis of this length,
        or of the length of the time axis, is time; without either, rows are cycles.

    Returns
    -------
    xarray.Dataset
        ``signal`` (cycle, time) in the type that it is stored in, ``temperature`` (cycle) in degC,
        labels (cycle): those of known quantities, and all arrays of one value per cycle;
        coordinates ``cycle`` and ``time`` in s. Attributes: ``sampling_rate`` in Hz, ``source``,
        ``file``, ``warnings`` (one per line). A file of :func:`write` is returned as it was written
        if no other argument is given and there is no sidecar file; else its attributes and its
        variables of one value per cycle are kept, except those that are given. If the temperature
        is given, the mean error of the thermometer that the file states is set to zero.

    Raises
    ------
    ConfigError
        If the file cannot be read, lacks the rate or temperature, or holds values that are not
        finite, out of range, all equal or contradictory.

    Notes
    -----
    A label or a temperature of a continuous record that has a value for each sample is averaged
    over each cycle. How text tables are understood: :func:`acoustube.recordings.tables.read_table`.
    """
    PATH.check("path", path)
    path = Path(path)
    _check_kind(path)
    given = {
        "sampling_rate": rate,
        "temperature": temperature,
        "channel": channel,
        "samples_per_cycle": samples,
    }
    with reading(path, "cannot be read as a recording", "export it again, or correct its sidecar"):
        over = _sidecar(path) | {name: value for name, value in given.items() if value is not None}
        netcdf = path.suffix.lower() == ".nc"
        if netcdf and not over and (whole := read_own_netcdf(path)) is not None:
            return whole
        own = own_statements(path) if netcdf else None
        contents = load(path)
        notes = [str(value) for value in contents.values() if isinstance(value, Note)]
        arrays = {
            name: one
            for name, one in contents.items()
            if not isinstance(one, Note)
            and (own is None or name not in own.attrs or name == "sampling_rate")
        }
        known, others = separate_known(arrays)
        named, labels = separate_known(over.pop("labels", {}))
        wrong = [name for name in named if name not in LABELS]
        if wrong := wrong + [name for name in labels if name == "signal"]:
            raise ConfigError(
                f"{path}: the labels of its sidecar state {wrong[0]}, which is not a label; rename "
                "it"
            )
        found = assemble(path, known | named | over, others, labels, notes)
        elsewhere = {*named, *labels, *(["temperature"] if "temperature" in over else [])}
        return found if own is None else _with_own(path, found, own, elsewhere)


def _with_own(path: Path, data: xr.Dataset, own: xr.Dataset, elsewhere: set[str]) -> xr.Dataset:
    """Return a recording with attributes and variables of its file, which acoustube wrote.

    The variables are those of one value per cycle, as they were written, except those of the names
    stated `elsewhere`. If the temperature is stated elsewhere, the error of the thermometer is set
    to zero.
    """
    notes = f"{own.attrs.get('warnings', '')}\n{data.attrs['warnings']}".split("\n")
    kept = own.attrs | {
        "sampling_rate": data.attrs["sampling_rate"],
        "warnings": "\n".join(dict.fromkeys(note for note in notes if note)),
    }
    if "temperature" in elsewhere and "rangefinder" in kept:
        stated = settings_in(kept["rangefinder"], path) | {"temperature_bias": 0.0}
        kept["rangefinder"] = json.dumps(stated)
    each = [
        name for name, one in own.variables.items()
        if one.ndim and one.size == data.sizes["cycle"] and name not in elsewhere
    ]  # fmt: skip
    if each:
        single = {name for name, one in own.variables.items() if not one.ndim}
        known = {"signal", "temperature", *elsewhere, *single}
        data = data[[name for name in data.data_vars if name in known]]
        data = data.assign({name: own.variables[name] for name in each})
        data = data.set_coords([name for name in each if name in own.coords])
    data = data.assign_attrs(kept)
    check_statements(path, data, LABELS)
    return data


def read_all(
    paths: str | Path | Iterable[str | Path], **options: Any
) -> Iterator[tuple[Path, xr.Dataset | ConfigError]]:
    """Read many recordings, and continue after one that cannot be read.

    Parameters
    ----------
    paths : str, Path or iterable of these
        Files and folders; see :func:`find`.
    **options
        Arguments of :func:`read`.

    Yields
    ------
    Path, xarray.Dataset or ConfigError
        The file, and its recording or the error.
    """
    seen = set()
    for entry in _entries(paths):
        try:
            files = find(entry)
        except ConfigError as error:
            yield entry, error
            continue
        for path in files:
            if path not in seen:
                seen.add(path)
                try:
                    yield path, read(path, **options)
                except ConfigError as error:
                    yield path, error


def find(paths: str | Path | Iterable[str | Path]) -> list[Path]:
    """Return the recordings among files and in folders.

    Parameters
    ----------
    paths : str, Path or iterable of these
        A folder stands for all recordings in it and its subfolders, in natural order (run9 before
        run10); hidden files are left out.

    Returns
    -------
    list of Path
        Each file once.

    Raises
    ------
    ConfigError
        If an entry does not exist, is of an unknown kind or a folder without recordings; the
        message has a line for each such entry.
    """
    found: dict[Path, None] = {}
    wrong = []
    for entry in _entries(paths):
        try:
            found |= dict.fromkeys(_in_folder(entry) if entry.is_dir() else [_check_kind(entry)])
        except ConfigError as error:
            wrong.append(str(error))
    if wrong:
        raise ConfigError("\n".join(wrong))
    return list(found)


@checked(dataset=xr.Dataset, path=PATH)
def write(dataset: xr.Dataset, path: str | Path) -> None:
    """Write a recording as netCDF; :func:`read` returns it, with the version that wrote it.

    Parameters
    ----------
    dataset : xarray.Dataset
        From :func:`read` or :func:`acoustube.ranging.record`.
    path : str or Path
        A name that ends in ``.nc``; an existing file is replaced once the new one is complete.

    Raises
    ------
    ConfigError
        If the name ends otherwise, or the file cannot be written.
    SimulationError
        If the disk is full.
    """
    path = Path(path)
    check_netcdf_name(path)
    write_dataset(dataset.assign_attrs(acoustube_version=__version__), path, overwrite=True)


def _entries(paths: str | Path | Iterable[str | Path]) -> list[Path]:
    PATHS.check("paths", paths)
    return [Path(p) for p in ([paths] if isinstance(paths, str | Path) else paths)]


def _in_folder(folder: Path) -> list[Path]:
    inside = [
        path
        for path in folder.rglob("*")
        if path.suffix.lower() in KINDS
        and path.is_file()
        and not any(part.startswith(".") for part in path.relative_to(folder).parts)
    ]
    if not inside:
        raise ConfigError(f"{folder} holds no recordings; name a folder of {' '.join(KINDS)} files")
    return sorted(inside, key=_natural)


def _natural(path: Path) -> list[str | int]:
    """Return a natural sorting key: ``run10`` comes after ``run9``."""
    parts = re.split(r"(\d+)", str(path))
    return [int(part) if i % 2 else part for i, part in enumerate(parts)]


def _check_kind(path: Path) -> Path:
    if not path.exists():
        raise ConfigError(f"{path} does not exist; name a recording")
    if path.is_dir():
        raise ConfigError(f"{path} is a folder; name a recording in it")
    if path.suffix.lower() not in KINDS:
        raise ConfigError(f"{path} is not of a kind that can be read; use {' '.join(KINDS)}")
    return path


def _sidecar(path: Path) -> dict[str, Any]:
    """Return the values of a file's sidecar by quantity, as `assemble` takes them, if any."""
    sidecars = [
        file for suffix in (".toml", ".json") if (file := path.with_suffix(suffix)).is_file()
    ]
    if not sidecars:
        return {}
    if len(sidecars) > 1:
        raise ConfigError(
            f"{sidecars[0]} and {sidecars[1].name} both describe {path.name}; keep one"
        )
    values = read_document(sidecars[0], sidecars[0].suffix)
    if {"processing", "calibration"} <= set(values) or {"twin", "rangefinder"} <= set(values):
        return {}  # a calibration or a twin of the same name as its recording
    for key in values:
        if key not in _SIDECAR:
            near = difflib.get_close_matches(key, _SIDECAR, n=1) or _SIDECAR
            raise ConfigError(f"{sidecars[0]}: {key} is not known; use {', '.join(near)}")
    if not isinstance(values.get("labels", {}), dict):
        raise ConfigError(f"{sidecars[0]}: labels must be a table of names and their values")
    return {_SIDECAR[key]: value for key, value in values.items()}


def stated_length(data: xr.Dataset) -> float | None:
    """Return the length of the tube in m that a recording states for its first cycle, or None.

    Parameters
    ----------
    data : xarray.Dataset
        With ``tube_length`` as a variable or as an attribute.
    """
    if "tube_length" in data and np.all(np.isfinite(data["tube_length"].values)):
        return float(data["tube_length"].values.flat[0])
    return float(data.attrs["tube_length"]) if "tube_length" in data.attrs else None
