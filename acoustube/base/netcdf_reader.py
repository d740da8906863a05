"""Reader of netCDF-4 files for xarray, for the files that acoustube writes.

It reads the same variables and attributes as xarray's engine h5netcdf in a sixth of the time, since
it asks HDF5 for each attribute once. It expects what :mod:`acoustube.base.netcdf` writes: names of
dimensions and variables that agree, and no types defined by the user.
"""

from __future__ import annotations

from typing import Any

import h5py
import numpy as np
import xarray as xr
from xarray.backends import BackendArray, BackendEntrypoint
from xarray.core import indexing

SMALL = 10_000
"""Largest number of values of a variable that are read when a file is opened. More are read when
they are used."""
INTERNAL = frozenset({
    "CLASS", "NAME", "DIMENSION_LIST", "REFERENCE_LIST", "_Netcdf4Dimid", "_Netcdf4Coordinates",
    "_NCProperties", "_nc3_strict",
})  # fmt: skip
"""Attributes of HDF5 and netCDF that are not attributes of a variable."""
WITHOUT_VALUES = b"This is a netCDF dimension but not a netCDF variable"
"""Start of the name of a dimension that has no coordinate."""


class Reader(BackendEntrypoint):
    """Engine of :func:`xarray.open_dataset` for the netCDF-4 files that acoustube writes."""

    def open_dataset(
        self,
        filename_or_obj: Any,
        *,
        drop_variables: Any = None,  # noqa: ARG002  asked for by xarray
        group: str = "/",
    ) -> xr.Dataset:
        """Return the variables and attributes of a group.

        Parameters
        ----------
        filename_or_obj : path or binary file
            The file.
        drop_variables : None
            Not used.
        group : str
            Name of the group.

        Returns
        -------
        xarray.Dataset
            Variables with more than :data:`SMALL` values are read when they are used.
        """
        found = {}
        with h5py.File(filename_or_obj) as file:
            for name, item in file[group].items():
                attrs = dict(item.attrs)
                empty = bytes(attrs.get("NAME", b"")).startswith(WITHOUT_VALUES)
                if isinstance(item, h5py.Dataset) and not empty:
                    dimensions = _dimensions(file, item, attrs)
                    found[name] = xr.Variable(
                        dimensions, _values(filename_or_obj, item), _shown(attrs)
                    )
            return xr.decode_cf(xr.Dataset(found, attrs=_shown(dict(file[group].attrs))))


class _Values(BackendArray):
    """Values of a variable, which are read when they are indexed."""

    def __init__(self, source: Any, item: h5py.Dataset) -> None:
        self.source, self.name, self.shape, self.dtype = source, item.name, item.shape, item.dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        support = indexing.IndexingSupport.OUTER_1VECTOR
        return indexing.explicit_indexing_adapter(key, self.shape, support, self._read)

    def _read(self, key: Any) -> Any:
        with h5py.File(self.source) as file:
            return file[self.name][key]


def _values(source: Any, item: h5py.Dataset) -> Any:
    """Return a variable's values or, if these are many numbers, access to them in the source."""
    if h5py.check_string_dtype(item.dtype):
        return np.asarray(item.asstr()[()], str)
    return indexing.LazilyIndexedArray(_Values(source, item)) if item.size > SMALL else item[()]


def _dimensions(file: h5py.File, item: h5py.Dataset, attrs: dict[str, Any]) -> tuple[str, ...]:
    """Return the names of a variable's dimensions; of axes without one, in a damaged file, any."""
    own = item.name.rsplit("/", 1)[-1]
    if "DIMENSION_LIST" in attrs:
        scales = [h5py.h5r.get_name(scale[0], file.id) for scale in attrs["DIMENSION_LIST"]]
        return tuple(scale.decode().rsplit("/", 1)[-1] for scale in scales)
    if attrs.get("CLASS") == b"DIMENSION_SCALE":
        return (own,)
    return tuple(f"{own}_axis_{i}" for i in range(item.ndim))


def _shown(attrs: dict[str, Any]) -> dict[str, Any]:
    """Return the attributes that netCDF shows; arrays of one value as this, of texts as lists."""
    return {name: _plain(value) for name, value in attrs.items() if name not in INTERNAL}


def _plain(value: Any) -> Any:
    if not isinstance(value, np.ndarray):
        return value
    if value.size == 1:
        return value.ravel()[0]
    return value.tolist() if value.dtype == object else value
