"""Folder of a sweep: complete result files, records of failures, and the plan.

A file of results has the hash of its cases' names in its name, and the hash of its content inside.
Nothing is written twice, so that any number of sweeps may write to one folder.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
import time
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from acoustube.base.errors import ConfigError, SimulationError
from acoustube.base.files import check_out, check_writable
from acoustube.base.foreign.results import check_result
from acoustube.base.netcdf import Seal, to_netcdf
from acoustube.base.netcdf_reader import read_group
from acoustube.base.remnants import ASIDE
from acoustube.base.version import __version__
from acoustube.base.writing import DiskFullError
from acoustube.base.writing import write as put
from acoustube.runs.sweep.plan import digest

PLAN = "sweep.toml"
"""Name of the file of the plan."""
FAILURES = "failed"
"""Name of the folder with a JSON file for each failed case."""
SHARD = re.compile(r"cases-[0-9a-f]{32}\.nc")
"""Pattern of the names of result files."""
SCATTERING = "scattering"
"""netCDF group of a results file with the scattering matrix of its press."""
WALLS = "walls"
"""netCDF group of a results file with the walls of its pressed tube; not every file has it."""
ABANDONED = 3600.0
"""Age in s at which a partial file counts as left behind by a killed run."""


class Contents(NamedTuple):
    """Contents of a sweep's folder.

    Attributes
    ----------
    finished : dict of Path
        File of each finished case, by name of the case.
    damaged : list of Path
        Files of results whose content differs from what was written.
    foreign : list of Path
        Files that are not those of a sweep.
    """

    finished: dict[str, Path]
    damaged: list[Path]
    foreign: list[Path]


def prepared(path: str | Path) -> Path:
    """Return a writable folder for a sweep, created if it does not exist.

    Raises
    ------
    ConfigError
        If the folder cannot be written to, or holds something else.
    """
    folder = Path(path).expanduser().resolve()
    if not _begun(folder):
        try:
            folder = check_out(path)
        except ConfigError:
            if not _begun(folder):  # begun by another sweep at the same time
                raise
    try:
        folder.mkdir(parents=True, exist_ok=True)
        check_writable(folder)
        _sweep_up(folder)
    except OSError as error:
        raise ConfigError(
            f"cannot be written ({error.strerror})",
            setting="out",
            value=path,
            advice="name a writable folder",
        ) from error
    return folder


def _begun(folder: Path) -> bool:
    """Return whether a folder is a sweep's: it has a plan, or only files that are being written."""
    if not folder.is_dir() or (folder / PLAN).is_file():
        return folder.is_dir()
    names = [path.name for path in folder.iterdir()]
    return bool(names) and all(name.startswith(ASIDE) for name in names)


def _sweep_up(folder: Path) -> None:
    """Delete old partial files, which killed runs have left behind."""
    for path in folder.glob(f"{ASIDE}*"):
        with contextlib.suppress(OSError):
            if path.is_file() and time.time() - path.stat().st_mtime > ABANDONED:
                path.unlink()


def contents(folder: Path) -> Contents:
    """Return the contents of a sweep's folder, after a check of each file of results."""
    finished: dict[str, Path] = {}
    damaged: list[Path] = []
    foreign: list[Path] = []
    for path in sorted(folder.iterdir()):
        if SHARD.fullmatch(path.name):
            names = intact(path)
            damaged += [path] * (names is None)
            finished |= dict.fromkeys(names or [], path)
        elif not (path.name in (PLAN, FAILURES) or path.name.startswith(ASIDE)):
            foreign += [path] * (path.suffix != ".damaged")
    return Contents(finished, damaged, foreign)


def intact(path: Path) -> list[str] | None:
    """Return the name of the case of each press or cycle in a file; None if the file is damaged."""
    import h5py

    try:
        if check_result(path, "") is Seal.INTACT:
            with h5py.File(path) as file:
                return [str(name) for name in file["press"].asstr()[:]]
        data, matrix = read(path)
        if data.attrs["content"] != _content(data, matrix, walls(path)):
            return None
        return [str(name) for name in data["press"].values]
    except Exception:  # a damaged file raises many kinds of errors, all of the same meaning
        return None


def read(path: Path) -> tuple[xr.Dataset, xr.Dataset | None]:
    """Return the cases of a results file, and their common scattering matrix; None without one."""
    data = read_group(path)
    return data, read_group(path, SCATTERING) if data.attrs["scattering"] == "yes" else None


def lacks_scattering(path: Path) -> bool:
    """Return whether a file has pressed cases without a scattering matrix."""
    import h5py

    with h5py.File(path) as file:
        return SCATTERING not in file and bool(np.any(file["depth"][:] > 0))


def sound_of(path: Path) -> tuple[bytes, ...]:
    """Return bore, temperature, carrier and matrix frequencies of a file, as bytes to compare."""
    import h5py

    names = "inner_diameter", "temperature", "carrier_frequency", f"{SCATTERING}/frequency"
    with h5py.File(path) as file:
        return tuple(file[name][:].tobytes() for name in names if name in file)


def walls(path: Path) -> xr.Dataset | None:
    """Return the walls of the tube that the cases of a results file share; None without them."""
    import h5py

    with h5py.File(path) as content:
        if WALLS not in content:
            return None
    return read_group(path, WALLS)


def write(
    folder: Path,
    data: xr.Dataset,
    matrix: xr.Dataset | None,
    walls: xr.Dataset | None = None,
) -> Path:
    """Write the results of some cases atomically, and return the path of the file.

    Parameters
    ----------
    folder : Path
    data : xarray.Dataset
        The results, with the dimension ``press``.
    matrix : xarray.Dataset or None
        The scattering matrix that the cases share.
    walls : xarray.Dataset or None
        The walls of the tube that the cases share, from :func:`acoustube.runs.walls.walls`.

    Raises
    ------
    SimulationError
        If the file cannot be written, as on a full disk.
    """
    path = folder / f"cases-{digest(sorted(map(str, data['press'].values)))[:32]}.nc"
    write_file(path, data, matrix, walls)
    return path


def write_file(
    path: Path,
    data: xr.Dataset,
    matrix: xr.Dataset | None = None,
    walls: xr.Dataset | None = None,
    *,
    chunks: Mapping[str, int] | None = None,
) -> None:
    """Write a dataset atomically, compressed and with the hash of its content.

    Parameters
    ----------
    path : Path
    data : xarray.Dataset
    matrix, walls : xarray.Dataset or None
        Scattering matrix and walls that belong to the dataset.
    chunks : mapping of str to int, optional
        Chunk length along the first dimension, by variable.

    Raises
    ------
    SimulationError
        If it cannot be written, as on a full disk.
    """
    groups = {SCATTERING: matrix, WALLS: walls}
    data = data.assign_attrs({name: "no" if g is None else "yes" for name, g in groups.items()})
    data.attrs["content"] = _content(data, matrix, walls)
    parts, encoding = {"/": data}, {"/": _packed(data, chunks)}
    for name, group in groups.items():
        if group is not None:
            parts[f"/{name}"], encoding[f"/{name}"] = group, _packed(group)
    content = to_netcdf(xr.DataTree.from_dict(parts), encoding)
    _put(path, content)


def _put(path: Path, content: bytes | str) -> None:
    """Write a file to a folder that can be resumed, in place of a file of that name."""
    try:
        put(path, content, overwrite=True)
    except DiskFullError as error:
        there = f"everything in {path.parent} is intact"
        raise DiskFullError(error.path, error.reason, error.needed, there) from error
    except ConfigError as error:
        raise SimulationError(str(error)) from error


def _packed(data: xr.Dataset, chunks: Mapping[str, int] | None = None) -> dict[Any, dict[str, Any]]:
    """Return the encoding of each variable: compression of large ones, and chunks."""
    large = [name for name, v in data.variables.items() if v.size > 1000 and v.dtype.kind in "fiu"]
    packed: dict[Any, dict[str, Any]] = {
        name: {"zlib": True, "complevel": 1, "shuffle": True} for name in large
    }
    for name, first in (chunks or {}).items():
        shape = data[name].shape
        packed.setdefault(name, {})["chunksizes"] = (min(first, shape[0]), *shape[1:])
    return packed


def _content(*parts: xr.Dataset | None) -> str:
    """Return the hash of the names, shapes and values of all variables."""
    found = hashlib.sha256()
    for part in parts:
        for name, values in sorted((part.variables if part is not None else {}).items()):
            array = np.asarray(values.values)
            array = array.astype("U") if array.dtype.kind in "OUS" else array
            text = array.dtype.kind == "U"
            found.update(f"{name} {array.shape}".encode())
            found.update("\0".join(array.ravel()).encode() if text else array.tobytes())
    return found.hexdigest()


def set_aside(path: Path) -> Path:
    """Rename a damaged file so that it is not read, and return its new path."""
    return path.replace(path.with_name(f"{path.name}.damaged"))


def failures(folder: Path) -> dict[str, str]:
    """Return the reasons why cases have failed, by name of the case."""
    found = {}
    for path in sorted((folder / FAILURES).glob("*.json")):
        try:
            found[path.stem] = str(json.loads(path.read_text(encoding="utf-8"))["reason"])
        except (OSError, ValueError, KeyError, TypeError):
            continue  # not a record of a failure: the case is tried again
    return found


def record_failure(folder: Path, name: str, reason: str, configuration: Mapping[str, Any]) -> None:
    """Write a file that states the reason of a case's failure, and the settings of the case."""
    content = {
        "reason": reason,
        "configuration": configuration,
        "when": datetime.now(UTC).isoformat(timespec="seconds"),
        "acoustube_version": __version__,
    }
    with contextlib.suppress(OSError):  # writing the file reports the reason
        (folder / FAILURES).mkdir(exist_ok=True)
    _put(folder / FAILURES / f"{name}.json", json.dumps(content, indent=1) + "\n")


def delete_failures(folder: Path, names: Iterable[str]) -> None:
    """Delete the files of failed cases, given the names of the cases."""
    for name in names:
        (folder / FAILURES / f"{name}.json").unlink(missing_ok=True)
