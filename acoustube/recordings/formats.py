"""File formats of measured signals, read as named arrays without interpretation."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from acoustube.base.errors import ConfigError
from acoustube.base.foreign import child
from acoustube.base.foreign.archives import read_archive
from acoustube.base.foreign.limits import check_file, check_name, reading
from acoustube.recordings.tables import Contents, meaning, read_table, with_unit


def load(path: Path) -> Contents:
    """Read the named arrays of a file; those stored uncompressed may be memory-mapped.

    Parameters
    ----------
    path : Path
        A file whose suffix is in :data:`KINDS`.

    Returns
    -------
    dict
        Arrays and single values by name, and a Note if the layout of a table had to be guessed.
        A signal has the shape (cycle, time), (time,) or, with channels, (cycle, time, channel).

    Raises
    ------
    ConfigError
        If the file is damaged, of another kind, exceeds a limit of
        :mod:`acoustube.base.foreign.limits` or states an unknown unit, or a package that reads it
        is missing.
    """
    kind, loader = KINDS[path.suffix.lower()]
    check_file(path, "table" if loader is read_table else "recording")
    failure = f"cannot be read as {kind}"
    with reading(
        path, failure, "it is cut short, damaged or a file of another kind: export it again"
    ):
        contents = loader(path)
        for name in contents:
            check_name(path, name)
        return contents


def _wav(path: Path) -> Contents:
    from scipy.io import wavfile

    with path.open("rb") as file:
        head = file.read(8)
    size, declared = path.stat().st_size, int.from_bytes(head[4:], "little") + 8
    if head[:4] == b"RIFF" and size + 1 < declared:  # not all writers pad to an even length
        raise EOFError(f"it ends after {size} of {declared} bytes")
    try:
        rate, samples = wavfile.read(path, mmap=True)
    except ValueError as error:
        if "3-byte" not in str(error):
            raise
        rate, samples = wavfile.read(path)
        samples >>= 8  # scipy puts the three bytes into the upper three of four
    return {"sampling_rate": rate, "signal": samples.reshape(1, len(samples), -1)}


def _flac(path: Path) -> Contents:
    try:
        found = _from_child(path, "flac")
    except child.MissingPackage as error:
        raise ConfigError(
            f"{path} needs the package soundfile; run pip install 'acoustube[audio]', or convert "
            "the file to WAV"
        ) from error
    return found | {"signal": found["signal"][np.newaxis]}


def _from_child(path: Path, kind: str) -> Contents:
    """Return a file's arrays and attributes by name; of equal names the first counts.

    The names of arrays include their units. Attributes with unknown names are left out, except
    those of netCDF.
    """
    found: Contents = {}
    for label, value in child.read(kind, path, "recording"):
        name = label["name"]
        if label.get("attribute"):
            if kind == "netcdf" or meaning(name)[0]:
                found.setdefault(name, value)
            continue
        # MATLAB's first axis is the last in the file, and it has no arrays of one axis.
        array = value.T.squeeze() if label.get("transposed") else value
        found.setdefault(with_unit(path, name, label.get("unit")), array)
    return found


KINDS: dict[str, tuple[str, Callable[[Path], Contents]]] = {
    ".npz": ("NPZ", lambda path: dict(read_archive(path, "recording"))),
    ".npy": ("NPY", lambda path: {"signal": np.load(path, mmap_mode="c", allow_pickle=False)}),
    ".csv": ("CSV", read_table),
    ".tsv": ("TSV", read_table),
    ".wav": ("WAV", _wav),
    ".flac": ("FLAC", _flac),
    ".mat": ("MAT", lambda path: _from_child(path, "mat")),
    ".h5": ("HDF5", lambda path: _from_child(path, "hdf5")),
    ".hdf5": ("HDF5", lambda path: _from_child(path, "hdf5")),
    ".nc": ("netCDF", lambda path: _from_child(path, "netcdf")),
}
"""Name and reader of each kind of file, by suffix."""
