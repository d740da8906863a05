"""Result files of this package, checked before HDF5 opens them in this process."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import xarray as xr

from acoustube.base.errors import ConfigError
from acoustube.base.foreign import child, limits
from acoustube.base.foreign.documents import parsed
from acoustube.base.netcdf import Seal, seal_of


def check_result(path: str | Path, advice: str) -> None:
    """Raise if a result is damaged, or no netCDF-4 file.

    Files with a seal (:mod:`acoustube.base.netcdf`) are hashed. Others, of earlier versions or of
    other programs, are read once from end to end in the child process.

    Parameters
    ----------
    path : str or Path
    advice : str
        What to do about a damaged file.

    Raises
    ------
    ConfigError
    """
    limits.check_file(path, "result")
    with limits.reading(path, "cannot be read as a result", advice):
        seal = seal_of(path)
        if seal is Seal.BROKEN:
            raise ConfigError(f"{path} is damaged: its bytes are not those written; {advice}")
        if seal is Seal.NONE:
            child.read("survey", Path(path), "result")


def open_result(
    path: str | Path, advice: str, needed: Iterable[str] = (), group: str | None = None
) -> xr.Dataset:
    """Return a result in memory, checked.

    Parameters
    ----------
    path : str or Path
    advice : str
        What to do about a damaged file, or one without what is needed.
    needed : iterable of str
        Variables and attributes that it must have.
    group : str, optional
        Group of the file.

    Raises
    ------
    ConfigError
    """
    check_result(path, advice)
    with limits.reading(path, "cannot be read as a result", advice):
        with xr.open_dataset(path, engine="h5netcdf", group=group) as file:
            data = file.load()
        if missing := [n for n in needed if n not in data.variables and n not in data.attrs]:
            raise ConfigError(f"{path} is no such result, it has no {missing[0]}; {advice}")
        return data


def attributes(path: str | Path, advice: str) -> dict[str, Any]:
    """Return the attributes of a result, checked.

    Raises
    ------
    ConfigError
    """
    return dict(open_result(path, advice).attrs)


def settings_in(text: Any, source: str | Path) -> dict[str, Any]:
    """Return the settings that a result holds as JSON.

    Raises
    ------
    ConfigError
        If they are not a table.
    """
    found = parsed(str(text), source)
    if not isinstance(found, dict):
        raise ConfigError(f"{source} holds no settings of acoustube; name what it wrote")
    return found
