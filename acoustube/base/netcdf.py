"""NetCDF variables and files, and the seal of a file: a checksum that reveals damage.

The HDF5 library does not detect all damage: one changed byte may silently change any value. The
seal is at the end of the file, where HDF5 does not read: `MARK` and the SHA-256 of all bytes before
`MARK`.
"""

from __future__ import annotations

import hashlib
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from acoustube.base.writing import write

if TYPE_CHECKING:
    import xarray as xr

MARK = b"acoustube SHA-256 of what precedes\n"
BLOCK = 1 << 20
"""Bytes that are hashed at a time."""


class Seal(Enum):
    """Result of testing a file's checksum; NONE if it has none, as files of other programs."""

    INTACT = "intact"
    BROKEN = "broken"
    NONE = "none"


# Names of the dimensions, values and attributes, as xarray takes a variable.
Variable = tuple[tuple[str, ...], Any, dict[str, Any]]


def variable(dims: str, values: Any, units: str, long_name: str) -> Variable:
    """Return a variable with unit and long name; `dims` are names separated by spaces."""
    return tuple(dims.split()), np.asarray(values), {"units": units, "long_name": long_name}


def flag(dims: str, values: Any, long_name: str) -> Variable:
    """Return a Boolean variable as 8-bit integers 0 and 1; `dims` are separated by spaces."""
    attributes = {"long_name": long_name, "flag_values": [0, 1], "flag_meanings": "no yes"}
    return tuple(dims.split()), np.asarray(values, np.int8), {"units": "1"} | attributes


def seal_of(path: str | Path) -> Seal:
    """Return whether a file's checksum matches its content."""
    end = len(MARK) + hashlib.sha256().digest_size
    with Path(path).open("rb") as file:
        left = file.seek(0, 2) - end
        file.seek(max(left, 0))
        mark, written = file.read(len(MARK)), file.read()
        if left < 0 or mark != MARK:
            return Seal.NONE
        file.seek(0)
        found = hashlib.sha256()
        while left > 0 and (block := file.read(min(BLOCK, left))):
            found.update(block)
            left -= len(block)
    return Seal.INTACT if found.digest() == written else Seal.BROKEN


def to_netcdf(data: xr.Dataset | xr.DataTree, encoding: Any = None) -> bytes:
    """Return the content of a sealed netCDF-4 file with a dataset or a tree of datasets.

    The file is made in memory, since HDF5 itself does not survive a full disk.

    Parameters
    ----------
    data : xarray.Dataset or xarray.DataTree
    encoding : mapping, optional
        As :meth:`xarray.Dataset.to_netcdf` takes it.
    """
    import dask

    # Otherwise xarray would in vain request a lock from a Dask cluster of this process.
    with dask.config.set(scheduler="synchronous"):
        content = bytes(data.to_netcdf(engine="h5netcdf", encoding=encoding))
    return content + MARK + hashlib.sha256(content).digest()


def write_dataset(dataset: xr.Dataset, path: Path, *, overwrite: bool = False) -> None:
    """Write a dataset as a sealed netCDF-4 file, atomically; large variables are compressed.

    Errors are those of :func:`acoustube.base.writing.write`.

    Parameters
    ----------
    dataset : xarray.Dataset
    path : path
        The file.
    overwrite : bool
        Whether an existing file is replaced.
    """
    packed = {"zlib": True, "complevel": 4, "shuffle": True}
    large = [name for name, variable in dataset.variables.items() if variable.size > 1000]
    write(path, to_netcdf(dataset, dict.fromkeys(large, packed)), overwrite=overwrite)
