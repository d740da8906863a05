"""Sweeps and datasets of any number of files, opened lazily as one dataset."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from glob import glob
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from acoustube.base.checks import FLAG, checked
from acoustube.base.errors import ConfigError
from acoustube.base.foreign.limits import reading
from acoustube.base.foreign.results import check_result
from acoustube.base.names import PATHS

ORDER = (
    "inner_diameter", "wall_thickness", "shear_modulus", "tube_length", "support", "shape",
    "diameter", "carrier_frequency", "temperature", "true_distance", "depth", "press",
)  # fmt: skip
"""Labels by which cases are sorted; the last varies fastest."""
PATTERNS = {"press": "cases-*.nc", "cycle": "cycles-*.nc"}
"""Result files of a folder, by the dimension along which they are joined."""


@checked(verify=FLAG)
def open_dataset(where: str | Path | Iterable[str | Path], *, verify: bool = True) -> xr.Dataset:
    """Open sweeps, or datasets of cycles, as one dataset.

    Parameters
    ----------
    where : str, path or several
        Folders that ``acoustube sweep`` or ``acoustube dataset`` wrote, their files, or patterns
        such as ``"runs/*"``.
    verify : bool
        Whether the hash of each file is checked first, at about 1 GB/s, and damaged files are
        refused; False for a large dataset that was verified before.

    Returns
    -------
    xarray.Dataset
        A sweep has the dimension ``press``, whose coordinate contains the names of the cases,
        each case once, sorted by tube, tool, sound, position and depth. A dataset of cycles has the
        dimension ``cycle``, with a coordinate ``press`` that contains the case of each cycle.
        Values are read when they are used.

    Raises
    ------
    ConfigError
        If there are no files, a file is damaged or another program's, sweeps and datasets are
        mixed, or cycles differ in sampling rate.

    Examples
    --------
    >>> data = open_dataset("runs/*")  # doctest: +SKIP
    >>> data.isel(cycle=slice(64))["signal"].values  # doctest: +SKIP
    """
    paths = files_of(where)
    kinds = {
        dimension for dimension, pattern in PATTERNS.items() for p in paths if p.match(pattern)
    }
    if not kinds:
        raise ConfigError(
            f"{where} is not a file of acoustube sweep or dataset; name a folder that one of them "
            "wrote"
        )
    if len(kinds) != 1:
        raise ConfigError(
            f"{where} holds sweeps and datasets, which have different dimensions; open one kind"
        )
    (dimension,) = kinds
    command = "sweep" if dimension == "press" else "dataset"
    advice = f"repeat acoustube {command}, which computes it again"
    for path in paths:
        _check_file(path, dimension, advice, verify=verify)
    with reading(str(paths[0].parent), "cannot be read", advice):
        found = xr.open_mfdataset(
            paths, engine="h5netcdf", combine="nested", concat_dim=dimension, join="outer",
            data_vars="minimal", coords="minimal", compat="override",
            combine_attrs="drop_conflicts",
        )  # fmt: skip
        for internal in ("content", "scattering", "walls"):
            found.attrs.pop(internal, None)
        if dimension == "press":
            cases = found.drop_duplicates("press")
            order = np.lexsort([cases[name].values for name in reversed(ORDER)])
            return cases.isel(press=order)
        if "sampling_rate" not in found.attrs:
            raise ConfigError(f"{where} holds cycles of different sampling rates; open one of them")
        return found.assign_coords(cycle=np.arange(found.sizes["cycle"]))


def _check_file(path: Path, dimension: str, advice: str, *, verify: bool) -> None:
    """Raise if a file is damaged, or another program wrote it under such a name."""
    import h5py

    if verify:
        check_result(path, advice)
    needed = ORDER if dimension == "press" else ("press", "signal")
    with reading(path, "is damaged", advice), h5py.File(path) as file:
        missing = [name for name in needed if not isinstance(file.get(name), h5py.Dataset)]
        of_length = [file[name].shape[:1] for name in needed if name not in missing]
    if missing:
        raise ConfigError(
            f"{path} is not a file of acoustube sweep or dataset (it has no {missing[0]}); move it "
            "elsewhere"
        )
    if len(set(of_length)) > 1:
        raise ConfigError(f"{path} is damaged: its columns differ in length; {advice}")


def files_of(where: str | Path | Iterable[str | Path]) -> list[Path]:
    """Return the netCDF files of sweeps and datasets, in the order of `where`, then by name.

    Parameters
    ----------
    where : str, path or several
        As of :func:`open_dataset`.

    Raises
    ------
    ConfigError
        If there are no such files, or `where` is not a path.
    """
    PATHS.check("where", where)
    given: Sequence[Any] = [where] if isinstance(where, str | Path) else list(where)
    found: list[Path] = []
    for one in given:
        named = [Path(one)] if Path(one).exists() else [Path(p) for p in glob(str(one))]  # noqa: PTH207
        for path in sorted(named):
            inside = [p for pattern in PATTERNS.values() for p in sorted(path.glob(pattern))]
            found += [path] if path.is_file() and path.suffix == ".nc" else inside
    if not found:
        missing = [one for one in given if not Path(one).exists()]
        raise ConfigError(
            f"{missing[0]} does not exist; name a folder that acoustube sweep or dataset wrote"
            if missing
            else f"{', '.join(map(str, given))} holds no results of acoustube sweep or dataset; "
            "name a folder that one of them wrote"
        )
    return found
