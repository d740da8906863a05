"""The command ``acoustube export``: results in the files that other programs read."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from acoustube.base.errors import ConfigError
from acoustube.base.files import check_out, partial_folder, publish
from acoustube.base.foreign.limits import OF_CONTENT, reading
from acoustube.cli._options import Output

if TYPE_CHECKING:
    import xarray as xr

NAMEABLE = "a folder of simulate, indent, sweep or dataset, or a file of scatter"
FORMATS = {
    "cycles": ("wav", "csv", "lerobot"),
    "sweep": ("csv", "stl", "vtp"),
    "simulate": ("stl", "vtp", "vtu", "csv"),
    "indent": ("stl", "vtp", "vtu", "csv"),
    "scatter": ("csv",),
}
"""Formats of each kind of result, the default first."""
IN_WORDS = {
    "cycles": "a dataset of cycles", "sweep": "a sweep", "simulate": "a run of simulate",
    "indent": "a run of indent", "scatter": "a scattering matrix",
}  # fmt: skip


def export(
    results: Path,
    /,
    *,
    kind: Annotated[
        Literal["wav", "csv", "stl", "vtp", "vtu", "lerobot"] | None, Parameter(name="--format")
    ] = None,
    out: Path,
    output: Output = Output(),
) -> None:
    """Write results as files for other programs.

    Parameters
    ----------
    results : Path
        Folder that ``simulate``, ``indent``, ``sweep`` or ``dataset`` wrote, or file that
        ``scatter`` wrote.
    kind : str
        Format. For datasets: wav (default, with a Parquet table), csv (labels) or lerobot
        (episodes for robot learning). For simulate and indent: stl (default, the lumen at each
        depth), vtp (the same), vtu (the mesh at each depth) or csv. For sweeps: csv (default), stl
        or vtp. For scatter: csv.
    out : Path
        Folder to write, which must be new or empty.
    """
    out = check_out(out)
    data = _opened(results)
    of = _kind(data, results)
    formats = FORMATS[of]
    if kind is not None and kind not in formats:
        of_cycles = of == "sweep" and kind in FORMATS["cycles"]
        advice = ", or make a dataset of it with acoustube dataset" if of_cycles else ""
        raise ConfigError(
            f"format = {kind} does not fit {results}, which is {IN_WORDS[of]}; use "
            f"{' or '.join(formats)}{advice}"
        )
    advice = "repeat the command that wrote it"
    damaged = reading(results, "is damaged or no result of acoustube", advice, OF_CONTENT)
    with partial_folder(out) as partial, damaged:
        found = _write(data, results, kind or formats[0], partial)
        folder = publish(partial, out)
    output.reporter().line(f"{found} written to {folder}.")


def _opened(where: Path) -> xr.Dataset:
    """Open a result of any kind; raise if there is none."""
    from acoustube.base.foreign.results import open_result
    from acoustube.runs.opening import PATTERNS, open_dataset

    if not where.exists():
        raise ConfigError(f"{where} does not exist; name {NAMEABLE}")
    of_many = any(where.match(pattern) for pattern in PATTERNS.values())
    path = where if where.is_file() else where / "run.nc"
    if of_many or any(any(where.glob(pattern)) for pattern in PATTERNS.values()):
        return open_dataset(where)
    if not path.is_file():
        raise ConfigError(f"{where} holds no result of acoustube; name {NAMEABLE}")
    return open_result(path, f"name {NAMEABLE}")


def _kind(data: xr.Dataset, where: Path) -> str:
    """Return the kind of a result, a key of :data:`FORMATS`."""
    if "cycle" in data.dims:
        return "cycles"
    if "press" in data.dims:
        return "sweep"
    if "s_real" in data:
        return "scatter"
    if "node_position" in data:
        return "simulate" if "lumen_face" in data else "indent"
    raise ConfigError(f"{where} is not a result of acoustube; name {NAMEABLE}")


def _write(data: xr.Dataset, where: Path, wanted: str, folder: Path) -> str:
    """Write a result in a format to a folder; return a description of the files."""
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
    from acoustube.runs.opening import files_of

    if "press" in data.dims:
        return write_swept(files_of(where), folder, wanted)
    return write_meshes(data, folder) if wanted == "vtu" else write_surfaces(data, folder, wanted)
