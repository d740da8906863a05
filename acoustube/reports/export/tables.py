"""CSV tables of results: one for each dimension, such as time, and one that lists all columns."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pandas as pd
import xarray as xr

from acoustube.base.errors import ConfigError
from acoustube.base.writing import write

TABLES = {
    "press": "cases", "cycle": "cycles", "depth": "press", "time": "signal", "z": "profile",
}  # fmt: skip
"""Names of the tables, by the dimension along which their rows run."""
EXPANDED = ("source_end",)
"""Dimensions that do not run along rows: a variable has a column for each of their values."""
LEFT_OUT = ("configuration",)
COEFFICIENTS = ["s_real", "s_imag", "settled", "error"]
"""Variables of a scattering matrix that are columns of its table, if present."""


def write_tables(data: xr.Dataset, folder: Path) -> str:
    """Write a table for each dimension of :data:`TABLES`, of the variables with no other dimension.

    A dimension of :data:`EXPANDED` does not count as another one. A scattering matrix has one
    table, with a row for each coefficient. ``columns.csv`` gives unit and meaning of each column.

    Parameters
    ----------
    data : xarray.Dataset
        Any result.
    folder : Path
        Empty folder.

    Returns
    -------
    str
        Names and numbers of rows of the tables, in words.
    """
    known, written = [], []
    for dimension, stem in TABLES.items():
        if dimension not in data.dims:
            continue
        columns = _columns(data, dimension)
        if set(columns) <= {dimension}:
            continue  # all variables along it have another dimension too
        table = pd.DataFrame({name: variable.values for name, variable in columns.items()})
        write(folder / f"{stem}.csv", table.to_csv(index=False))
        known += [_described(stem, name, variable) for name, variable in columns.items()]
        written.append(f"{stem}.csv with {len(table)} rows")
    if "s_real" in data:
        kept = [name for name in COEFFICIENTS if name in data]
        table = data[kept].to_dataframe().reset_index()
        write(folder / "scattering.csv", table.to_csv(index=False))
        known += [_described("scattering", name, data[name]) for name in table.columns]
        written.append(f"scattering.csv with {len(table)} rows")
    write(folder / "columns.csv", pd.DataFrame(known).to_csv(index=False))
    return f"{', '.join(written)}"


def _columns(data: xr.Dataset, dimension: str) -> dict[str, xr.DataArray]:
    """Return the columns of a table: the variables along a dimension, and its coordinate first."""
    found: dict[str, xr.DataArray] = {}
    for name, variable in {**data.coords, **data.data_vars}.items():
        if name in LEFT_OUT or dimension not in variable.dims:
            continue
        others = [other for other in variable.dims if other != dimension]
        if not others:
            found[str(name)] = variable
        elif others[0] in EXPANDED and len(others) == 1:
            for value in data[others[0]].values:
                found[f"{name}_{value}"] = variable.sel({others[0]: value})
    if dimension in found:
        return {dimension: found.pop(dimension)} | found
    return found


def _described(stem: str, name: str, variable: xr.DataArray) -> dict[str, Any]:
    return {
        "table": f"{stem}.csv",
        "column": name,
        "unit": variable.attrs.get("units", ""),
        "meaning": variable.attrs.get("long_name", ""),
    }


def check_parquet(what: str) -> None:
    """Raise ConfigError if the package for Parquet is missing."""
    try:
        import pyarrow  # noqa: F401
    except ImportError as error:
        raise ConfigError(
            f"format = {what} needs the package pyarrow; run pip install 'acoustube[parquet]', or "
            "use format csv"
        ) from error
