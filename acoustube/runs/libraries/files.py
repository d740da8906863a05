"""Folders of libraries: a netCDF file for each tool, complete and sealed."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from acoustube.base.checks import checked
from acoustube.base.errors import ConfigError
from acoustube.base.files import check_out, check_writable
from acoustube.base.foreign.limits import reading
from acoustube.base.foreign.results import check_result
from acoustube.base.names import PATH
from acoustube.base.netcdf import to_netcdf, variable
from acoustube.base.remnants import ASIDE
from acoustube.base.version import __version__
from acoustube.base.writing import write
from acoustube.inversion import Library, Tool
from acoustube.runs.config import configured
from acoustube.runs.config.tube_in_si import tube_in_si
from acoustube.runs.provenance import configuration

if TYPE_CHECKING:
    import h5netcdf
    import xarray as xr

    from acoustube.runs.libraries.plan import ToolPlan

PATTERN = "tool-*.nc"
ADVICE = "make one with acoustube library"
FAILURE = "is not a file that acoustube library of this version wrote"


def prepared(out: str | Path) -> Path:
    """Return the absolute path of a library's folder, created unless it is to be resumed.

    Raises
    ------
    ConfigError
        If the folder holds something else, or cannot be written.
    """
    folder = Path(out).expanduser().resolve()
    names = [path.name for path in folder.iterdir()] if folder.is_dir() else []
    if not names or not all(Path(name).match(PATTERN) or name.startswith(ASIDE) for name in names):
        folder = check_out(out)
    folder.mkdir(parents=True, exist_ok=True)
    check_writable(folder)
    return folder


def write_tool(path: Path, tool: Tool, plan: ToolPlan) -> None:
    """Write the file of a tool atomically, compressed and with its checksum."""
    data = to_dataset(tool, plan)
    large = [name for name, v in data.variables.items() if v.size > 1000]
    packed = {"zlib": True, "complevel": 1, "shuffle": True}
    write(path, to_netcdf(data, dict.fromkeys(large, packed)), overwrite=True)


def to_dataset(tool: Tool, plan: ToolPlan) -> xr.Dataset:
    """Return a tool as a dataset, with version, tube and settings as attributes."""
    import xarray as xr  # not needed for reading

    dims = "depth frequency port_out mode_out port_in mode_in"
    what = "scattering coefficient, power-normalised; zero where a mode does not propagate"
    real, imaginary = (part.astype(np.float32) for part in (tool.s.real, tool.s.imag))
    variables = {
        "s_real": variable(dims, real, "1", f"real part of the {what}"),
        "s_imag": variable(dims, imaginary, "1", f"imaginary part of the {what}"),
        "force": variable("depth", tool.force, "N", "force of the tool on the tube"),
        "force_error": variable("depth", tool.force_error, "N", "estimated error of the force"),
        "error": variable("depth", tool.error, "1", "estimated error of the coefficients"),
        "interpolation_error": variable(
            "depth", np.append(tool.interpolation_error, 0.0), "1",
            "estimated relative rms error of interpolation from each depth to the next",
        ),
    }  # fmt: skip
    modes = "nodal diameters, nodal circles; c: symmetric about x = 0"
    coordinates: dict[str, Any] = {
        "depth": variable("depth", tool.depth, "m", "indentation depth from first contact"),
        "frequency": variable("frequency", tool.frequency, "Hz", "frequency"),
    }
    for name in ("in", "out"):
        coordinates[f"port_{name}"] = variable(f"port_{name}", [1, 2], "1", "1: low z, 2: high z")
        coordinates[f"mode_{name}"] = variable(f"mode_{name}", list(tool.modes), "1", modes)
    origin = {
        "title": "Scattering of a tool over depth",
        "acoustube_version": __version__,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "time_convention": "exp(+j omega t)",
        "solver": "spectral",
        "shape": tool.shape,
        "diameter": tool.diameter,
        "inner_diameter": 2 * tool.radius,
        "sound_speed": tool.sound_speed,
        "tolerance": plan.tolerance,
        "configuration": configuration(plan.config),
    }
    return xr.Dataset(variables, coordinates, origin)


def from_file(data: h5netcdf.File) -> Tool:
    """Return the tool in an open file of :func:`write_tool`.

    Raises
    ------
    KeyError, ValueError, TypeError
        If the file is of another kind, or holds values that are not finite.
    """
    s = np.empty(data["s_real"].shape, np.complex64)
    s.real, s.imag = data["s_real"][...], data["s_imag"][...]
    columns: dict[str, Any] = {
        name: np.asarray(data[name][...], float)
        for name in ("depth", "frequency", "force", "force_error", "error")
    }
    between = np.asarray(data["interpolation_error"][...], float)[:-1]
    for name, values in (*columns.items(), ("s", s.view(np.float32)), ("error", between)):
        if not np.isfinite(values).all():
            raise ValueError(f"{name} holds values that are not finite")
    modes = (m.decode() if isinstance(m, bytes) else str(m) for m in data["mode_in"][...])
    return Tool(
        **columns, s=s, interpolation_error=between,
        modes=tuple(modes), shape=str(data.attrs["shape"]), diameter=float(data.attrs["diameter"]),
        radius=float(data.attrs["inner_diameter"]) / 2,
        sound_speed=float(data.attrs["sound_speed"]),
        **_wall(data.attrs.get("configuration")),
    )  # fmt: skip


def _wall(configuration: str | None) -> dict[str, Any]:
    """Return the wall's modulus in Pa and Poisson's ratio by name, given settings as JSON.

    The result is empty if forces do not scale with the modulus, as on an elastic layer.
    """
    if configuration is None:
        return {}
    config = configured(json.loads(configuration))
    if config.indentation.layer_mm is not None:
        return {}
    tube = tube_in_si(config.tube)
    return {"young_modulus": tube.young_modulus, "poisson_ratio": tube.poisson_ratio}


@checked(path=PATH)
def open_library(path: str | Path) -> Library:
    """Read a library that ``acoustube library`` wrote.

    Parameters
    ----------
    path : str or Path
        Folder of the library, or file of one tool.

    Returns
    -------
    Library
        Tools in the order of their shapes and diameters.

    Raises
    ------
    ConfigError
        If there is no library, a file is damaged, or the tools are not of one tube, band and air.
    """
    import h5netcdf  # not xarray, which takes 75 MB more with pandas

    found = Path(path)
    with reading(found, "cannot be opened", ADVICE):  # a parent folder may be unreadable
        if not found.exists():
            raise ConfigError(f"{path} does not exist; {ADVICE}")
        files = sorted(found.glob(PATTERN)) if found.is_dir() else [found]
    if not files:
        raise ConfigError(f"{path} holds no file of a library; {ADVICE}")
    tools = []
    for file in files:
        with reading(file, FAILURE, ADVICE):
            check_result(file, ADVICE, FAILURE)
            with h5netcdf.File(file, "r") as data:
                tools.append(from_file(data))
    return Library(tuple(sorted(tools, key=lambda tool: (tool.shape, tool.diameter))))
