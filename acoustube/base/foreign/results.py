"""Result files of this package, checked before HDF5 opens them in this process."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from acoustube.base.errors import ConfigError
from acoustube.base.foreign import child, limits
from acoustube.base.foreign.documents import parsed
from acoustube.base.netcdf import Seal, seal_of

if TYPE_CHECKING:
    import xarray as xr

FAILURE = "cannot be read as a result"


def check_result(path: str | Path, advice: str, failure: str = FAILURE) -> Seal:
    """Raise ConfigError if a result is damaged, or not a netCDF-4 file.

    Files with a seal (:mod:`acoustube.base.netcdf`) are hashed. Others, of earlier versions or of
    other programs, are read once from end to end in the child process.

    Parameters
    ----------
    path : str or Path
    advice : str
        What to do about a damaged file.
    failure : str
        What the message says of a file that cannot be read.

    Returns
    -------
    Seal
        INTACT or NONE.
    """
    limits.check_file(path, "result")
    with limits.reading(path, failure, advice):
        seal = seal_of(path)
        if seal is Seal.BROKEN:
            raise ConfigError(f"{path} is damaged: its checksum is wrong; {advice}")
        if seal is Seal.NONE:
            child.read("survey", Path(path), "result")
    return seal


def open_result(path: str | Path, advice: str, failure: str = FAILURE) -> xr.Dataset:
    """Check a result file and read it into memory; raise ConfigError as :func:`check_result`."""
    from acoustube.base.netcdf_reader import read_group

    check_result(path, advice, failure)
    with limits.reading(path, failure, advice):
        return read_group(path)


def settings_in(text: Any, source: str | Path) -> dict[str, Any]:
    """Return the settings that a result holds as a text in JSON.

    Raises
    ------
    ConfigError
        If the text is not valid JSON, is not a table, or exceeds a limit.
    """
    found = parsed(str(text), source)
    if not isinstance(found, dict):
        raise ConfigError(f"{source} holds no settings of acoustube; name a file that it wrote")
    return found
