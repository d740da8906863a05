"""The command ``acoustube export``: cycles as sound files and a table of their labels."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from rich.console import Console
from scipy.io import wavfile

from acoustube.errors import ConfigError
from acoustube.io import partial_folder, publish
from acoustube.opening import open_dataset

LABELS = "labels.parquet"
TEXT = """\
Cycles of a rangefinder, one WAV file for each press and session, its cycles one after the
other.

Samples are counts of the ADC less half its full scale, as 16-bit numbers at the ADC's own rate.
{labels} has a row for each cycle: its file, where it starts in samples, its length, and its labels
in SI units and degC.
"""


def run_export(where: Path, out: Path, console: Console) -> Path:
    """Write a dataset of cycles as WAV files and a Parquet table.

    Parameters
    ----------
    where : Path
        The dataset's folder.
    out : Path
        The folder to write, new or empty.
    console : rich.console.Console
        Where to print.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    ConfigError
        If there is no dataset, or the package for Parquet is missing.
    """
    _check_parquet()
    data = open_dataset(where)
    if "cycle" not in data.dims:
        raise ConfigError(f"{where} is a sweep; make a dataset of it with acoustube dataset")
    with partial_folder(out) as partial:
        table = _written(data, partial)
        table.to_parquet(partial / LABELS, index=False)
        (partial / "README.txt").write_text(TEXT.format(labels=LABELS), encoding="utf-8")
        folder = publish(partial, out)
    n_files = table["file"].nunique()
    console.print(
        f"{len(table)} cycles written to {n_files} files in [bold]{folder}[/].", soft_wrap=True
    )
    return folder


def _check_parquet() -> None:
    try:
        import pyarrow  # noqa: F401
    except ImportError as error:
        raise ConfigError(
            "export needs the package pyarrow for Parquet; install acoustube[parquet]"
        ) from error


def _written(data: xr.Dataset, folder: Path) -> pd.DataFrame:
    """Write a sound file for each press, and return the table of all cycles."""
    table = _labels(data)
    names = table["press"].to_numpy()
    records = names + table["session"].to_numpy()
    starts = np.flatnonzero(np.concatenate([[True], records[1:] != records[:-1]]))
    n = data.sizes["time"]
    rate, middle = round(float(data.attrs["sampling_rate"])), int(data.attrs["full_scale"]) // 2
    files = np.empty(len(table), object)
    offsets = np.empty(len(table), int)
    for number, part in enumerate(np.split(np.arange(len(table)), starts[1:])):
        counts = data["signal"].isel(cycle=slice(part[0], part[-1] + 1)).values.astype(int)
        file = f"{number:05d}-{names[part[0]]}.wav"
        wavfile.write(folder / file, rate, (counts - middle).astype(np.int16).ravel())
        files[part], offsets[part] = file, np.arange(len(part)) * n
    table.insert(0, "file", files)
    table.insert(1, "start", offsets)
    table.insert(2, "length", n)
    return table


def _labels(data: xr.Dataset) -> pd.DataFrame:
    """Return what is known of each cycle, a column each."""
    columns: dict[str, Any] = {
        str(name): values.values
        for name, values in {**data.coords, **data.data_vars}.items()
        if values.dims == ("cycle",) and name != "cycle"
    }
    return pd.DataFrame(columns)
