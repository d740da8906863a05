"""Output files and folders: checks before a run, and atomic writing."""

from __future__ import annotations

import contextlib
import errno
import itertools
import os
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from acoustube.base import interrupts, remnants
from acoustube.base.errors import ConfigError
from acoustube.base.names import PATH
from acoustube.base.remnants import ASIDE
from acoustube.base.writing import DiskFullError, aside, to_disk

if TYPE_CHECKING:  # the command line imports this module before it needs xarray
    from tomlkit.items import Array


def check_out(path: str | Path) -> Path:
    """Check that a run can be written to a folder, without leaving files there.

    Parameters
    ----------
    path : str or path
        The folder. Neither it nor its parents need exist; an empty folder is allowed.

    Returns
    -------
    Path
        The folder as an absolute path.

    Raises
    ------
    ConfigError
        If the path is that of a file, a folder that is not empty, the current folder or a mount
        point, or if nothing can be written there.
    """
    try:
        folder = Path(path).expanduser().resolve()
        _check_free(path, folder)
        ancestor = next(parent for parent in folder.parents if parent.exists())
        # Trying is the only test that holds for root, read-only disks and access lists alike.
        check_writable(ancestor)
        return folder
    except (OSError, RuntimeError, ValueError) as error:
        if isinstance(error, ConfigError):
            raise
        reason = getattr(error, "strerror", None) or error
        raise ConfigError(
            f"out = {path} cannot be written ({reason}); name a writable folder"
        ) from error


def check_surface(path: str | Path) -> None:
    """Raise ConfigError unless the file of a surface exists, and is a regular file."""
    if not Path(path).is_file():
        other = "is a pipe or a device, not a file" if Path(path).exists() else "does not exist"
        what = "is a folder" if Path(path).is_dir() else other
        raise ConfigError(f"{path} {what}; give the name of a surface: STL, PLY, OBJ or VTP")


def check_netcdf_name(path: Path) -> None:
    """Raise ConfigError unless a name is that of a netCDF file."""
    if path.suffix.lower() != ".nc":
        raise ConfigError(f"out = {path} is not the name of a netCDF file; let it end in .nc")


def check_new_file(path: Path, name: str = "out") -> None:
    """Raise ConfigError unless a file is new, its name is valid, and its folder can be written.

    Parameters
    ----------
    path : Path
    name : str
        Name of the option that gave the path.
    """
    PATH.check(name, path)
    if os.path.lexists(path):
        raise ConfigError(f"{name} = {path} exists and nothing is overwritten; name a new file")
    folder = path.absolute().parent
    if not folder.is_dir():
        raise ConfigError(f"{name} = {path} is in a folder that does not exist; make it first")
    try:
        check_writable(folder)
    except OSError as error:
        raise ConfigError(
            f"{name} = {path} cannot be written ({error.strerror}); name a writable folder"
        ) from error


def check_writable(folder: Path) -> None:
    """Raise OSError if no file can be created in a folder."""
    with contextlib.suppress(AttributeError, NotImplementedError, IsADirectoryError):
        # A file without a name leaves no trace, whenever this process is ended.
        try:
            os.close(os.open(folder, os.O_TMPFILE | os.O_RDWR))
            return
        except OSError as error:
            if error.errno != errno.EOPNOTSUPP:
                raise
    with tempfile.TemporaryDirectory(prefix=ASIDE, dir=folder):
        pass


def fresh_folder(stem: str) -> Path:
    """Return a folder name in the current folder that is not taken, such as ``simulate-3``.

    Parameters
    ----------
    stem : str
        Beginning of the name.
    """
    return next(name for n in itertools.count(1) if not (name := Path(f"{stem}-{n}")).exists())


def _check_free(path: str | Path, folder: Path) -> None:
    """Raise ConfigError if a folder is taken or cannot be replaced; the message names `path`."""
    if folder.exists() or folder.is_symlink():
        if not folder.is_dir():
            raise ConfigError(f"out = {path} is a file; name a new folder")
        if any(folder.iterdir()):
            raise ConfigError(
                f"out = {path} is not empty and nothing is overwritten; name a new folder"
            )
        # The finished run is renamed to this name, which cannot replace either of these folders.
        if os.path.ismount(folder) or folder == Path.cwd():
            raise ConfigError(
                f"out = {path} is the current folder or a mount point, which cannot be replaced; "
                "name a new folder inside it"
            )


@contextlib.contextmanager
def partial_folder(path: str | Path) -> Iterator[Path]:
    """Make a temporary folder for an output folder, and remove it in the end.

    Parameters
    ----------
    path : str or path
        The output folder, to which :func:`publish` renames the temporary folder; see
        :func:`check_out`.

    Yields
    ------
    Path
        Temporary folder next to `path`. If it is still there when the block ends, as after an
        exception or an interrupt, it is removed with the parents that were made for it.

    Raises
    ------
    ConfigError
        If the folder is taken or cannot be made.
    DiskFullError
        If the block raises it; the message then names the final path and all bytes needed.
    """
    folder = check_out(path)
    made = list(itertools.takewhile(lambda parent: not parent.exists(), folder.parents))
    try:
        with aside(folder) as partial:
            try:
                partial.mkdir(parents=True)
            except OSError as error:
                raise ConfigError(
                    f"out = {path} cannot be written ({error.strerror}); name a writable folder"
                ) from error
            try:
                yield partial
            except DiskFullError as error:
                shown = Path(str(error.path).replace(str(partial), str(path)))
                needed = remnants.size(partial) + error.needed
                rest = "the files after it need more"
                raise DiskFullError(shown, error.reason, needed, rest) from error
    finally:
        for parent in made:
            with contextlib.suppress(OSError):  # the run, or another, is in it
                parent.rmdir()


def publish(partial: Path, path: str | Path) -> Path:
    """Rename a complete temporary folder to its final name, atomically.

    Parameters
    ----------
    partial : path
        The folder of :func:`partial_folder`.
    path : str or path
        The requested name.

    Returns
    -------
    Path
        The actual name: if another run has taken `path` in the meantime, a number is added, so
        that nothing is overwritten and nothing lost.

    Raises
    ------
    OSError
        If the folder cannot be renamed for another reason.
    """
    interrupts.check()
    folder = Path(path).expanduser().absolute()
    numbered = (folder.with_name(f"{folder.name}-{n}") for n in itertools.count(2))
    for name in itertools.chain([folder], numbered):
        try:
            _check_free(path, name)
            with contextlib.suppress(FileNotFoundError):
                name.rmdir()  # removes empty folders only; some systems cannot rename onto them
            published = partial.rename(name)
        except (ConfigError, FileExistsError, NotADirectoryError):
            continue
        except OSError as error:
            if error.errno != errno.ENOTEMPTY:  # another run was a moment earlier
                raise
            continue
        to_disk(published.parent)
        return published
    raise AssertionError  # the numbers do not end


def toml_array(values: Iterable[Any]) -> Array:
    """Return the TOML array of some values.

    The array is parsed from text, since each append of tomlkit takes longer than the one before.

    Parameters
    ----------
    values : iterable
        Numbers or words.
    """
    import tomlkit

    return tomlkit.array(f"[{', '.join(tomlkit.item(value).as_string() for value in values)}]")
