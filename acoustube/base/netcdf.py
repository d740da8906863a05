"""Variables and files of netCDF."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from acoustube.base.writing import write

Variable = tuple[tuple[str, ...], Any, dict[str, Any]]


def variable(dims: str, values: Any, units: str, long_name: str) -> Variable:
    """Return a variable with unit and long name; `dims` are names separated by spaces."""
    return tuple(dims.split()), np.asarray(values), {"units": units, "long_name": long_name}


def flag(dims: str, values: Any, long_name: str) -> Variable:
    """Return a Boolean variable as netCDF stores it; `dims` are names separated by spaces."""
    attributes = {"long_name": long_name, "flag_values": [0, 1], "flag_meanings": "no yes"}
    return tuple(dims.split()), np.asarray(values, np.int8), {"units": "1"} | attributes


def to_netcdf(data: xr.Dataset | xr.DataTree, encoding: Any = None) -> bytes:
    """Return a dataset, or a tree of them, as a netCDF-4 file.

    Made in memory: HDF5 itself does not survive a full disk.

    Parameters
    ----------
    data : xarray.Dataset or xarray.DataTree
    encoding : mapping, optional
        As :meth:`xarray.Dataset.to_netcdf` takes it.
    """
    import dask

    # Otherwise xarray asks a Dask cluster that this process is connected to for a lock, in vain.
    with dask.config.set(scheduler="synchronous"):
        return bytes(data.to_netcdf(engine="h5netcdf", encoding=encoding))


def write_dataset(dataset: xr.Dataset, path: Path, *, overwrite: bool = False) -> None:
    """Write a dataset as a compressed netCDF-4 file, in one step.

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
