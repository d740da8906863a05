"""Files and folders: where a run may be written, and how it gets there in one piece."""

from __future__ import annotations

import contextlib
import itertools
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from acoustube.errors import ConfigError

if TYPE_CHECKING:  # the command line imports this module before it needs xarray
    import xarray as xr


def check_out(path: str | Path) -> Path:
    """Check that a run can be written to a folder, and leave no trace.

    Parameters
    ----------
    path : str or path
        The folder. It need not exist, nor need its parents; an empty folder will do.

    Returns
    -------
    Path
        The folder as an absolute path.

    Raises
    ------
    ConfigError
        If something is there already, or nothing can be written there.
    """
    try:
        folder = Path(path).expanduser().resolve()
        _check_free(path, folder)
        ancestor = next(parent for parent in folder.parents if parent.exists())
        # Trying is the only test that holds for root, read-only disks and access lists alike.
        with tempfile.TemporaryDirectory(prefix=".acoustube-", dir=ancestor):
            return folder
    except (OSError, RuntimeError, ValueError) as error:
        if isinstance(error, ConfigError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(
            f"out = {path} cannot be written ({reason}); name a folder that you may write to"
        ) from error


def fresh_folder(stem: str) -> Path:
    """Return a folder name in the current folder that is not taken, such as ``simulate-3``.

    Parameters
    ----------
    stem : str
        What the name begins with.
    """
    return next(name for n in itertools.count(1) if not (name := Path(f"{stem}-{n}")).exists())


def _check_free(path: str | Path, folder: Path) -> None:
    """Refuse a name that is taken."""
    if folder.exists() or folder.is_symlink():
        if not folder.is_dir():
            raise ConfigError(f"out = {path} is a file; name a new folder")
        if any(folder.iterdir()):
            raise ConfigError(
                f"out = {path} is not empty and nothing is overwritten; name a new folder"
            )
        # The finished run is renamed to its final name, and these two cannot be replaced so.
        if os.path.ismount(folder) or folder == Path.cwd():
            raise ConfigError(f"out = {path} cannot be replaced; name a new folder inside it")


@contextlib.contextmanager
def write_folder(path: str | Path) -> Iterator[Path]:
    """Write a folder aside and give it its name only when it is complete.

    Parameters
    ----------
    path : str or path
        The folder to be made; see :func:`check_out`.

    Yields
    ------
    Path
        A temporary folder beside it. When the block ends it is renamed; when the block is left by
        an exception, an interrupt included, it is removed.

    Raises
    ------
    ConfigError
        If the folder cannot be made, also when another run has made it in the meantime.
    """
    folder = check_out(path)
    partial = folder.with_name(f".{folder.name}.partial-{os.getpid()}")
    try:
        partial.mkdir(parents=True)
    except FileExistsError as error:
        raise ConfigError(
            f"{partial} is in the way, left by a run that was killed; remove it"
        ) from error
    try:
        yield partial
        _check_free(path, folder)
        with contextlib.suppress(FileNotFoundError):
            folder.rmdir()  # only ever an empty one; not every system renames onto it
        partial.rename(folder)
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise


def write_dataset(dataset: xr.Dataset, path: Path) -> None:
    """Write a dataset as a compressed netCDF-4 file.

    Parameters
    ----------
    dataset : xarray.Dataset
    path : path
        The file; an existing one is replaced.
    """
    packed = {"zlib": True, "complevel": 4, "shuffle": True}
    large = [name for name, variable in dataset.variables.items() if variable.size > 1000]
    dataset.to_netcdf(path, engine="h5netcdf", encoding=dict.fromkeys(large, packed))
