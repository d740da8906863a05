"""File formats of measured signals, read as named arrays without interpretation."""

from __future__ import annotations

import warnings
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acoustube.base.errors import ConfigError
from acoustube.recordings.tables import Contents, meaning, read_table


def load(path: Path) -> Contents:
    """Read the named arrays of a file; NPY and WAV are memory-mapped.

    Parameters
    ----------
    path : Path
        A file whose suffix is in :data:`KINDS`.

    Returns
    -------
    dict
        Signals of shape (cycle, time), (time,) or, with channels, (cycle, time, channel).

    Raises
    ------
    ConfigError
        If the file is damaged or of another kind.
    """
    kind, loader = KINDS[path.suffix.lower()]
    try:
        return loader(path)
    except ConfigError:
        raise
    # The readers raise whatever their parsing trips over.
    except Exception as error:
        reason = " ".join(str(error).split()) or "it is empty"
        raise ConfigError(
            f"{path} cannot be read as {kind} ({reason}); it is cut short, "
            "damaged or a file of another kind: export it again"
        ) from error


def _npy(path: Path) -> Contents:
    return {"signal": np.load(path, mmap_mode="c", allow_pickle=False)}


def _npz(path: Path) -> Contents:
    found: Contents = {}
    with zipfile.ZipFile(path) as archive:
        for info in archive.infolist():
            name = info.filename.removesuffix(".npy")
            with archive.open(info) as member:
                found[name] = _array(path, name, member)
    return found


def _array(path: Path, name: str, member: Any) -> NDArray[Any]:
    """Return an array of an archive; raise for Python objects, which could run code when read."""
    try:
        return np.lib.format.read_array(member, allow_pickle=False)
    except ValueError as error:
        if "Object arrays" not in str(error):
            raise
        raise ConfigError(
            f"{path}: {name} is an array of Python objects, which could run code as they are read; "
            "save it as numbers or text"
        ) from error


def _wav(path: Path) -> Contents:
    from scipy.io import wavfile

    with path.open("rb") as file:
        head = file.read(8)
    size, declared = path.stat().st_size, int.from_bytes(head[4:], "little") + 8
    if head[:4] == b"RIFF" and size + 1 < declared:  # not all writers pad to an even length
        raise EOFError(f"it ends after {size} of {declared} bytes")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", wavfile.WavFileWarning)  # of chunks that are not sound
        try:
            rate, samples = wavfile.read(path, mmap=True)
        except ValueError as error:
            if "3-byte" not in str(error):
                raise
            rate, samples = wavfile.read(path)
            samples >>= 8  # scipy puts the three bytes at the upper end of four
    return {"sampling_rate": rate, "signal": samples.reshape(1, len(samples), -1)}


def _flac(path: Path) -> Contents:
    try:
        import soundfile
    except (ImportError, OSError) as error:  # OSError: without the library that it wraps
        raise ConfigError(
            f"{path} needs the package soundfile to be read; install acoustube[audio], or convert "
            "the file to WAV"
        ) from error
    with soundfile.SoundFile(path) as file:
        # Eight and 24 bits come at the upper end of the type that holds them.
        kinds = {"PCM_S8": ("int16", 8), "PCM_16": ("int16", 0), "PCM_24": ("int32", 8)}
        dtype, shift = kinds[file.subtype]
        samples = file.read(dtype=dtype, always_2d=True)
        if len(samples) < file.frames:
            raise EOFError(f"it ends after {len(samples)} of {file.frames} samples")
        samples >>= shift
        return {"sampling_rate": file.samplerate, "signal": samples[np.newaxis]}


def _mat(path: Path) -> Contents:
    import h5py
    from scipy.io import loadmat

    if h5py.is_hdf5(path):
        return _hdf5(path)
    # Without mat_dtype, MATLAB's doubles are read as the integers that they are packed into.
    return _flat(loadmat(path, mat_dtype=True, simplify_cells=True))


def _flat(tree: Mapping[str, Any]) -> Contents:
    """Return the leaves of a nested structure by name; of equal names the first."""
    found: Contents = {}
    for name, value in tree.items():
        leaves = _flat(value) if isinstance(value, Mapping) else {name: value}
        found = leaves | found
    return {name: value for name, value in found.items() if not name.startswith("__")}


def _hdf5(path: Path) -> Contents:
    """Read HDF5, and MATLAB's files of version 7.3."""
    import h5py

    found: Contents = {}

    def take(name: str, item: Any) -> None:
        known = {key: value for key, value in item.attrs.items() if meaning(key)[0]}
        found.update(known | found)
        if isinstance(item, h5py.Dataset) and "#refs#" not in name:
            value = _hdf5_values(item)
            if value is not None:
                name = _with_unit(name.rpartition("/")[2], item.attrs.get("units"))
                found.setdefault(name, value)

    with h5py.File(path) as file:
        take("", file)
        file.visititems(take)
    return found


def _hdf5_values(item: Any) -> Any:
    """Return a dataset's values; None if they are neither numbers nor text."""
    import h5py

    nothing = "MATLAB_empty" in item.attrs or item.attrs.get("MATLAB_class") == b"char"
    if nothing or str(item.attrs.get("NAME", b"")).startswith("b'This is a netCDF dimension"):
        return None
    if h5py.check_string_dtype(item.dtype) is not None:
        return np.asarray(item.asstr()[()], dtype=str)
    if item.dtype.kind not in "biufc":
        return None
    # MATLAB's first axis is the last in the file, and it has no arrays of one axis.
    return item[()].T.squeeze() if "MATLAB_class" in item.attrs else item[()]


def _with_unit(name: str, unit: Any) -> str:
    """Return a name with its unit, as ``depth_mm``, if that is a known name; else the name."""
    joined = f"{name}_{unit}"
    return joined if isinstance(unit, str) and meaning(joined)[0] else name


def _netcdf(path: Path) -> Contents:
    data = open_netcdf(path)
    arrays = {_with_unit(str(n), v.attrs.get("units")): v.values for n, v in data.variables.items()}
    return {str(name): value for name, value in data.attrs.items()} | arrays


def open_netcdf(path: Path) -> Any:
    """Return the contents of a netCDF file, as an xarray.Dataset in memory."""
    import h5py
    import xarray as xr

    engine = "h5netcdf" if h5py.is_hdf5(path) else "scipy"
    if engine == "h5netcdf":
        h5py.File(path).close()  # h5netcdf prints a traceback for a file that this cannot open
    with xr.open_dataset(path, engine=engine, decode_times=False) as file:
        return file.load()


KINDS: dict[str, tuple[str, Callable[[Path], Contents]]] = {
    ".npz": ("NPZ", _npz),
    ".npy": ("NPY", _npy),
    ".csv": ("CSV", read_table),
    ".tsv": ("TSV", read_table),
    ".wav": ("WAV", _wav),
    ".flac": ("FLAC", _flac),
    ".mat": ("MAT", _mat),
    ".h5": ("HDF5", _hdf5),
    ".hdf5": ("HDF5", _hdf5),
    ".nc": ("netCDF", _netcdf),
}
"""Name and reader of each kind of file, by suffix."""
