"""Cycles of a rangefinder as sound files, and a table of their labels."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from scipy.io import wavfile

from acoustube.base.writing import write
from acoustube.reports.export.tables import check_parquet

LABELS = "labels.parquet"
TEXT = """\
Cycles of a rangefinder, one WAV file for each press and session, its cycles one after the
other.

{samples}, at the ADC's own rate.
{labels} has a row for each cycle: its file, where it starts in samples, its length, and its labels
in SI units and degC.
"""
COUNTS = "Samples are counts of the ADC less half its full scale, as 16-bit numbers"
UNQUANTISED = "Samples are counts of the ADC, not rounded, as 32-bit floating-point numbers"


def write_sounds(data: xr.Dataset, folder: Path) -> str:
    """Write a sound file for each press and session, and a table of all cycles.

    Parameters
    ----------
    data : xarray.Dataset
        Cycles, from :func:`acoustube.open_dataset`.
    folder : Path
        Empty folder.

    Returns
    -------
    str
        Numbers of cycles and files, in words.

    Raises
    ------
    ConfigError
        If the package for Parquet is missing.
    """
    check_parquet("wav")
    table = labels(data)
    n, starts = data.sizes["time"], episodes(table)
    rate, middle = round(float(data.attrs["sampling_rate"])), int(data.attrs["full_scale"]) // 2
    quantised = data["signal"].dtype.kind != "f"
    files = np.empty(len(table), object)
    offsets = np.empty(len(table), int)
    for number, part in enumerate(np.split(np.arange(len(table)), starts[1:])):
        counts = data["signal"].isel(cycle=slice(part[0], part[-1] + 1)).values
        samples = counts.astype(np.float32)
        if quantised:
            samples = (counts.astype(int) - middle).astype(np.int16)
        file = f"{number:05d}-{table['press'].iloc[part[0]]}.wav"
        sound = io.BytesIO()
        wavfile.write(sound, rate, samples.ravel())
        write(folder / file, sound.getvalue())
        files[part], offsets[part] = file, np.arange(len(part)) * n
    table.insert(0, "file", files)
    table.insert(1, "start", offsets)
    table.insert(2, "length", n)
    write(folder / LABELS, table.to_parquet(index=False))
    samples_in_words = COUNTS if quantised else UNQUANTISED
    write(folder / "README.txt", TEXT.format(samples=samples_in_words, labels=LABELS))
    return f"{len(table)} cycles in {len(starts)} files"


def labels(data: xr.Dataset) -> pd.DataFrame:
    """Return a table of labels, with a row for each cycle and a column for each label."""
    columns: dict[str, Any] = {
        str(name): values.values
        for name, values in {**data.coords, **data.data_vars}.items()
        if values.dims == ("cycle",) and name != "cycle"
    }
    return pd.DataFrame(columns)


def episodes(table: pd.DataFrame) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Return the index of the first cycle of each episode: cycles of one press and session."""
    names = (table["press"] + "/" + table["session"]).to_numpy()
    return np.flatnonzero(np.concatenate([[True], names[1:] != names[:-1]]))
