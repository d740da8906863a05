"""Scattering matrices in netCDF files."""

from __future__ import annotations

from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from acoustube.base import cache
from acoustube.base.checks import checked
from acoustube.base.errors import ConfigError
from acoustube.base.foreign.limits import reading
from acoustube.base.foreign.results import open_result
from acoustube.base.names import PATH
from acoustube.base.netcdf import flag, to_netcdf, variable
from acoustube.base.netcdf_reader import read_group
from acoustube.base.version import __version__
from acoustube.waves.scattering import Scattering
from acoustube.waves.spectral import SpectralScattering

StoredScattering = Scattering | SpectralScattering
"""Scattering matrices that runs compute and store."""
SOLVERS = "time domain", "spectral"
"""Values of the attribute ``solver``; a file without this attribute is of the time domain."""
SIZES = "tolerance", "degree", "n_elements", "n_shifts", "n_fields"
"""Attributes of a matrix from the spectral solver: tolerance and discretisation."""


def to_dataset(found: StoredScattering) -> xr.Dataset:
    """Return a scattering matrix as a dataset, the inverse of :func:`from_dataset`.

    Returns
    -------
    xarray.Dataset
        The complex matrix is ``s_real`` and ``s_imag`` (frequency, port_out, mode_out, port_in,
        mode_in). ``propagates`` (frequency, mode_in) and ``cut_on`` in Hz (mode_in) describe the
        modes. The accuracy is ``error`` (frequency) of the spectral solver, or in the time domain
        ``settled``, of the shape of the matrix: whether each coefficient has converged. Version,
        solver and grid are attributes.
    """
    dims = "frequency port_out mode_out port_in mode_in"
    s = found.s
    what = "scattering coefficient, power-normalised; zero where a mode does not propagate"
    variables = {
        "s_real": variable(dims, s.real, "1", f"real part of the {what}"),
        "s_imag": variable(dims, s.imag, "1", f"imaginary part of the {what}"),
        "propagates": flag("frequency mode_in", found.propagates, "whether the mode propagates"),
        "cut_on": variable(
            "mode_in", found.cut_ons, "Hz", "cut-on frequency; in the time domain, on the grid"
        ),
    }
    coordinates: dict[str, Any] = {
        "frequency": variable("frequency", found.frequency, "Hz", "frequency")
    }
    for name in ("port_in", "port_out"):
        coordinates[name] = variable(name, [1, 2], "1", "1: low z, 2: high z")
    for name in ("mode_in", "mode_out"):
        text = "nodal diameters, nodal circles; c: symmetric about x = 0, s: antisymmetric"
        coordinates[name] = variable(name, list(found.modes), "1", text)
    origin = {
        "title": "Scattering of duct modes by a lumen",
        "acoustube_version": __version__,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "time_convention": "exp(+j omega t)",
        "sound_speed": found.sound_speed,
        "reference_z_1": 0.0,
        "reference_z_2": 0.0,
        "extent": found.extent,
    }
    if isinstance(found, SpectralScattering):
        text = "estimated largest error of the coefficients"
        variables["error"] = variable("frequency", found.error, "1", text)
        origin |= {"solver": SOLVERS[1]} | {name: getattr(found, name) for name in SIZES}
    else:
        variables["settled"] = flag(dims, found.settled, "whether the coefficient has converged")
        origin |= {
            "solver": SOLVERS[0],
            "cell_size": found.spacing,
            "grid_shape": found.shape,
            "steps": found.steps,
            "time_step": found.time_step,
        }
    return xr.Dataset(variables, coordinates, origin)


def keep(name: str, found: StoredScattering, label: str) -> None:
    """Write a scattering matrix to the cache; nothing happens where that is impossible.

    Parameters
    ----------
    name : str
        Key from :func:`acoustube.base.cache.key`.
    found : Scattering or SpectralScattering
    label : str
        Description for the list of the cache.
    """
    content = np.frombuffer(to_netcdf(to_dataset(found)), np.uint8)
    cache.store(name, {"netcdf": content}, label)


def recall(name: str) -> StoredScattering | None:
    """Return the scattering matrix of a cache key; None if it is not in the cache."""
    known = cache.recall(name)
    if known is None:
        return None
    return from_dataset(read_group(BytesIO(known["netcdf"].tobytes())))


@checked(path=PATH)
def read(path: str | Path) -> StoredScattering:
    """Read a scattering matrix that ``acoustube scatter`` wrote.

    Returns
    -------
    Scattering or SpectralScattering
        Both reference planes are at z = 0 of the surface that was given.

    Raises
    ------
    ConfigError
        If the file is of another kind, or does not exist.
    """
    if not Path(path).is_file():
        raise ConfigError(f"{path} does not exist; write one with acoustube scatter")
    advice = "write one with acoustube scatter"
    failure = "is not a file that acoustube scatter of this version wrote"
    with reading(path, failure, advice):
        return from_dataset(open_result(path, advice, failure))


def from_dataset(data: xr.Dataset) -> StoredScattering:
    """Return the scattering matrix in a dataset from :func:`to_dataset`.

    Raises
    ------
    KeyError, ValueError, TypeError
        If the dataset is of another kind.
    """
    low, high = (float(z) for z in data.attrs["extent"])
    common: dict[str, Any] = {
        "frequency": data["frequency"].values,
        "modes": tuple(str(name) for name in data["mode_in"].values),
        "s": data["s_real"].values + 1j * data["s_imag"].values,
        "propagates": data["propagates"].values.astype(bool),
        "cut_ons": data["cut_on"].values,
        "sound_speed": float(data.attrs["sound_speed"]),
        "extent": (low, high),
    }
    if data.attrs.get("solver", SOLVERS[0]) == SOLVERS[1]:
        sizes: dict[str, Any] = {name: int(data.attrs[name]) for name in SIZES[1:]}
        return SpectralScattering(
            **common, **sizes, derivative=None, error=data["error"].values,
            tolerance=float(data.attrs["tolerance"]),
        )  # fmt: skip
    nx, ny, nz = (int(n) for n in data.attrs["grid_shape"])
    dx, dy, dz = (float(h) for h in data.attrs["cell_size"])
    return Scattering(
        **common,
        settled=data["settled"].values.astype(bool),
        spacing=(dx, dy, dz),
        shape=(nx, ny, nz),
        steps=int(data.attrs["steps"]),
        time_step=float(data.attrs["time_step"]),
    )
