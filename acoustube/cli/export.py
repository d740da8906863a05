"""The command ``acoustube export``: results in the files that other programs read."""

from __future__ import annotations

from pathlib import Path

import xarray as xr
from rich.console import Console

from acoustube.base.errors import ConfigError
from acoustube.base.files import partial_folder, publish
from acoustube.runs.opening import PATTERNS, files_of, open_dataset

NAMEABLE = "a folder of simulate, indent, sweep or dataset, or a file of scatter"
FORMATS = {
    "cycles": ("wav", "csv", "lerobot"),
    "sweep": ("csv", "stl", "vtp"),
    "simulate": ("stl", "vtp", "vtu", "csv"),
    "indent": ("stl", "vtp", "vtu", "csv"),
    "scatter": ("csv",),
}
"""What each kind of result can be written as; the first if nothing is said."""
IN_WORDS = {
    "cycles": "a dataset of cycles", "sweep": "a sweep", "simulate": "a run of simulate",
    "indent": "a run of indent", "scatter": "a scattering matrix",
}  # fmt: skip


def run_export(where: Path, out: Path, console: Console, *, wanted: str | None = None) -> Path:
    """Write a result for other programs.

    Parameters
    ----------
    where : Path
        A folder of ``simulate``, ``indent``, ``sweep`` or ``dataset``, or a file of ``scatter``.
    out : Path
        The folder to write, new or empty.
    console : rich.console.Console
        Where to print.
    wanted : str, optional
        One of :data:`FORMATS`.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    ConfigError
        If there is no result, it cannot be written so, or a package is missing.
    """
    data = _opened(where)
    kind = _kind(data, where)
    able = FORMATS[kind]
    if wanted is not None and wanted not in able:
        of_cycles = kind == "sweep" and wanted in FORMATS["cycles"]
        advice = ", or make a dataset of it with acoustube dataset" if of_cycles else ""
        raise ConfigError(
            f"format = {wanted} does not fit {where}, which is {IN_WORDS[kind]}; use "
            f"{' or '.join(able)}{advice}"
        )
    with partial_folder(out) as partial:
        found = _write(data, where, wanted or able[0], partial)
        folder = publish(partial, out)
    console.print(f"{found} written to [bold]{folder}[/].", soft_wrap=True, highlight=False)
    return folder


def _opened(where: Path) -> xr.Dataset:
    """Open a result of any kind."""
    if not where.exists():
        raise ConfigError(f"{where} does not exist; name {NAMEABLE}")
    of_many = any(where.match(pattern) for pattern in PATTERNS.values())
    path = where if where.is_file() else where / "run.nc"
    if of_many or any(any(where.glob(pattern)) for pattern in PATTERNS.values()):
        return open_dataset(where)
    if not path.is_file():
        raise ConfigError(f"{where} holds no result of acoustube; name {NAMEABLE}")
    try:
        with xr.open_dataset(path, engine="h5netcdf") as file:
            return file.load()
    except (OSError, ValueError, RuntimeError) as error:
        raise ConfigError(
            f"{path} cannot be read as a result ({' '.join(str(error).split())}); name {NAMEABLE}"
        ) from error


def _kind(data: xr.Dataset, where: Path) -> str:
    """Return what a result is."""
    if "cycle" in data.dims:
        return "cycles"
    if "press" in data.dims:
        return "sweep"
    if "s_real" in data:
        return "scatter"
    if "node_position" in data:
        return "simulate" if "lumen_face" in data else "indent"
    raise ConfigError(f"{where} is no result of acoustube; name {NAMEABLE}")


def _write(data: xr.Dataset, where: Path, wanted: str, folder: Path) -> str:
    """Write a result in one format; return what was written, in words."""
    if wanted == "csv":
        from acoustube.reports.export.tables import write_tables

        return write_tables(data, folder)
    if wanted == "wav":
        from acoustube.reports.export.sounds import write_sounds

        return write_sounds(data, folder)
    if wanted == "lerobot":
        from acoustube.reports.export.lerobot import write_episodes

        return write_episodes(data, folder)
    from acoustube.reports.export.geometry import write_meshes, write_surfaces, write_swept

    if "press" in data.dims:
        return write_swept(files_of(where), folder, wanted)
    return write_meshes(data, folder) if wanted == "vtu" else write_surfaces(data, folder, wanted)
