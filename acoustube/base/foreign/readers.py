"""Readers of other programs' files, most by C libraries; they run only in the child process.

Each takes the path and the largest number of bytes that its arrays may have together (`most`), and
yields labels and arrays. Nothing heavy is imported before it is needed: the imports of this module
and its readers delay the first file.
"""

from __future__ import annotations

import mmap
import warnings
from collections.abc import Iterator, Mapping
from math import prod
from typing import Any, NamedTuple

import numpy as np

# Label (name, unit and the like), and an array, a number, a text or a Stored.
Entry = tuple[dict[str, Any], Any]

BLOCK = 1 << 28
"""Largest size in bytes of a chunk of a dataset, which is read at once."""
LARGE, SAMPLE = 1_000_000, 256
"""Smallest size of an array that is searched for in its file, and size of the part that is searched
for before the whole is compared, in bytes."""
_DIMENSION = b"This is a netCDF dimension"


class Exceeded(Exception):  # noqa: N818
    """Error of a file that exceeds a limit; its message follows the file's name in a sentence."""


class Missing(ImportError):  # noqa: N818
    """A package that is not installed, or lacks the library that it wraps."""


class Stored(NamedTuple):
    """An uncompressed, contiguous array in a file, which can be memory-mapped.

    Attributes
    ----------
    offset : int
        In bytes from the start of the file.
    dtype : str
    shape : tuple of int
    """

    offset: int
    dtype: str
    shape: tuple[int, ...]


def mat(path: str, most: int) -> Iterator[Entry]:
    """Read MATLAB's files of any version; of equal names in structures the first is kept."""
    import h5py

    if h5py.is_hdf5(path):
        yield from hdf5(path, most)
        return
    from scipy.io.matlab import loadmat

    # Without mat_dtype, MATLAB's doubles are read as the integers that they are packed into.
    tree = loadmat(path, mat_dtype=True, simplify_cells=True)
    with open(path, "rb") as file:  # noqa: PTH123
        content = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    for name, value in _flat(tree).items():
        if (plain := _plain(value)) is not None:
            stored = _located(content, plain)
            turned = {} if stored is None else {"turned": not plain.flags.c_contiguous}
            yield {"name": name} | turned, plain if stored is None else stored


def _located(content: mmap.mmap, array: Any) -> Stored | None:
    """Return the place where a file holds the bytes of a large array, if any; else None.

    An array that is contiguous by columns is returned as its transpose, contiguous by rows.
    """
    flat = array if array.flags.c_contiguous else array.T
    if array.nbytes < LARGE or not flat.flags.c_contiguous:
        return None
    values = flat.reshape(-1).view(np.uint8)
    offset = content.find(values[:SAMPLE].tobytes())
    if not 0 <= offset <= len(content) - values.size:
        return None
    there = np.frombuffer(content, np.uint8, values.size, offset)
    whole = values.size // 8 * 8  # compared by eight
    same = np.array_equal(there[:whole].view(np.uint64), values[:whole].view(np.uint64))
    if not same or not np.array_equal(there[whole:], values[whole:]):
        return None
    return Stored(offset, flat.dtype.str, flat.shape)


def _flat(tree: Mapping[str, Any]) -> dict[str, Any]:
    """Return the leaves of a nested structure by name, without private ones (``__header__``).

    Of equal names the first is kept.
    """
    found: dict[str, Any] = {}
    for name, value in tree.items():
        leaves = _flat(value) if isinstance(value, Mapping) else {name: value}
        found = leaves | found
    return {name: value for name, value in found.items() if not name.startswith("__")}


def _plain(value: Any) -> Any:
    """Return numbers or text as an array; None for anything else."""
    try:
        array = np.asarray(value)
    except ValueError:  # lists of unequal lengths
        return None
    if array.dtype.kind in "OST":
        text = all(isinstance(one, str | bytes | int | float) for one in array.flat)
        array = array.astype(str) if text else array
    return array if array.dtype.kind in "biufcU" else None


def hdf5(path: str, most: int) -> Iterator[Entry]:
    """Read HDF5: datasets with their units, and attributes, as far as they are numbers or text.

    MATLAB's text, empty arrays and references, and netCDF dimensions without values, are left out.
    """
    import h5py

    with h5py.File(path) as file:
        total = 0
        for name, item in _items(file):
            for key, value in item.attrs.items():
                if (plain := _plain(value)) is not None:
                    yield {"name": key, "attribute": True, "of": name}, plain
            if isinstance(item, h5py.Dataset) and "#refs#" not in name:
                total = _counted(item, total, most)
                if (value := _values(item)) is not None:
                    unit = item.attrs.get("units")
                    words = unit if isinstance(unit, str) else None
                    label = {"name": name.rpartition("/")[2], "unit": words}
                    yield label | {"transposed": "MATLAB_class" in item.attrs}, value


def names(path: str, most: int) -> Iterator[Entry]:  # noqa: ARG001
    """Read the names of the variables and attributes of an HDF5 file; of other files, nothing."""
    import h5py

    if h5py.is_hdf5(path):
        with h5py.File(path) as file:
            yield from (({"name": name, "attribute": True}, 0) for name in file.attrs)
            yield from (({"name": name}, 0) for name in file)


def survey(path: str, most: int) -> Iterator[Entry]:
    """Read an entire HDF5 file to test that it is readable; yield nothing."""
    import h5py

    with h5py.File(path) as file:
        total = 0
        for _, item in _items(file):
            dict(item.attrs)
            if not isinstance(item, h5py.Dataset):
                continue
            total = _counted(item, total, most)
            if item.chunks is None:
                item[()]
            elif prod(item.chunks) * item.dtype.itemsize > BLOCK:
                raise ValueError(f"it has chunks of over {BLOCK / 1e6:.0f} MB, the limit")
            else:
                for part in item.iter_chunks():
                    item[part]
    yield from ()


def _items(file: Any) -> list[tuple[str, Any]]:
    found = [("", file)]
    file.visititems(lambda name, item: found.append((name, item)))
    return found


def _counted(item: Any, total: int, most: int) -> int:
    """Return `total` plus the bytes of a dataset; raise if that exceeds `most`."""
    total += item.size * item.dtype.itemsize if item.size else 0
    if total > most:
        raise Exceeded(
            f"declares {total / 1e6:.4g} MB of arrays, over the limit of {most / 1e6:.4g} MB"
        )
    return total


def _values(item: Any) -> Any:
    """Return a dataset's values, or their :class:`Stored` place; None if not numbers or text."""
    import h5py

    nothing = "MATLAB_empty" in item.attrs or item.attrs.get("MATLAB_class") == b"char"
    if nothing or bytes(item.attrs.get("NAME", b"")).startswith(_DIMENSION):
        return None
    if h5py.check_string_dtype(item.dtype) is not None:
        return np.asarray(item.asstr()[()], dtype=str)
    return None if item.dtype.kind not in "biufc" else _stored(item)


def _stored(item: Any) -> Any:
    """Return a contiguous dataset's place in its file, or the values if chunked or compressed."""
    if item.external or item.is_virtual:
        raise ValueError(f"{item.name} is stored in another file")
    offset = item.id.get_offset() if item.chunks is None and item.size else None
    if offset is None:
        return item[()]
    return Stored(int(offset), item.dtype.str, item.shape)


def netcdf(path: str, most: int) -> Iterator[Entry]:
    """Read netCDF: attributes, and every variable, decoded by its scale, offset and fill value."""
    import h5py

    if h5py.is_hdf5(path):
        with h5py.File(path) as file:
            yield from _attributes(file.attrs)
            total = 0
            for name, item in file.items():
                if isinstance(item, h5py.Dataset):
                    total = _counted(item, total, most)
                    if (value := _values(item)) is not None:
                        yield _variable(name, value, dict(item.attrs), lambda i=item: i[()])
        return
    from scipy.io import netcdf_file

    # Whole variables are mapped, and read only once it is known whether they are unpacked.
    with warnings.catch_warnings(), netcdf_file(path, mmap=True) as file:
        warnings.simplefilter("ignore")
        yield from _attributes(file._attributes)
        start = file._mm_buf.__array_interface__["data"][0]
        for name, item in file.variables.items():
            values = np.asarray(item.data)
            place = Stored(
                values.__array_interface__["data"][0] - start, values.dtype.str, values.shape
            )
            value = place if values.flags.c_contiguous and values.size else values
            if values.dtype.kind == "S":
                value = np.ascontiguousarray(values).view(f"S{(*values.shape, 1)[-1]}")[..., 0]
                value = np.char.decode(value, "utf-8", "replace")
            yield _variable(name, value, item._attributes, lambda v=values: v)


def _attributes(found: Mapping[str, Any]) -> Iterator[Entry]:
    for key, value in found.items():
        plain = value.decode("utf-8", "replace") if isinstance(value, bytes) else _plain(value)
        if plain is not None:
            yield {"name": key, "attribute": True}, plain


def _variable(name: str, value: Any, attributes: Mapping[str, Any], values: Any) -> Entry:
    """Return a variable, decoded by its scale, offset and fill value.

    `value` is returned where nothing is to be decoded; `values` is a function that reads the array.
    """
    unit = attributes.get("units")
    unit = unit.decode("utf-8", "replace") if isinstance(unit, bytes) else unit
    label = {"name": name, "unit": unit if isinstance(unit, str) else None}
    numbers = {
        key: np.ravel(attributes[key])[0]
        for key in ("_FillValue", "missing_value", "scale_factor", "add_offset")
        if key in attributes and np.asarray(attributes[key]).dtype.kind in "iuf"
    }
    numbers = {key: number for key, number in numbers.items() if number == number}
    if not numbers:
        return label, value
    array = np.asarray(values())
    if array.dtype.kind not in "iuf":
        return label, array
    gaps = np.isin(array, [numbers[k] for k in ("_FillValue", "missing_value") if k in numbers])
    if "scale_factor" in numbers or "add_offset" in numbers or gaps.any():
        array = array * float(numbers.get("scale_factor", 1)) + float(numbers.get("add_offset", 0))
        array[gaps] = np.nan
    return label, array


def flac(path: str, most: int) -> Iterator[Entry]:
    """Read FLAC: sampling rate in Hz, and integer samples of shape (time, channel)."""
    try:
        import soundfile
    except (ImportError, OSError) as error:
        raise Missing("soundfile") from error
    with soundfile.SoundFile(path) as file:
        # Samples of 8 and 24 bits come in the upper bits of a 16- and a 32-bit integer.
        kinds = {"PCM_S8": ("int16", 8), "PCM_16": ("int16", 0), "PCM_24": ("int32", 8)}
        dtype, shift = kinds[file.subtype]
        if file.frames * file.channels * np.dtype(dtype).itemsize > most:
            raise Exceeded(f"declares {file.frames} samples, over the limit of {most / 1e6:.4g} MB")
        samples = file.read(dtype=dtype, always_2d=True)
        if len(samples) < file.frames:
            raise EOFError(f"it ends after {len(samples)} of {file.frames} samples")
        samples >>= shift
        yield {"name": "sampling_rate"}, file.samplerate
        yield {"name": "signal"}, samples


def c3d(path: str, most: int) -> Iterator[Entry]:  # noqa: ARG001
    """Read the markers of a C3D file: labels, units, and points of shape (3, marker, frame)."""
    try:
        import ezc3d
    except (ImportError, OSError) as error:
        raise Missing("ezc3d") from error
    content = ezc3d.c3d(path)
    point = content["parameters"]["POINT"]
    yield {"name": "labels"}, np.array(list(point["LABELS"]["value"]), dtype=str)
    units = list(point.get("UNITS", {}).get("value", []))
    yield {"name": "unit"}, str(units[0]) if units else ""
    yield {"name": "points"}, content["data"]["points"][:3]


def vtp(path: str, most: int) -> Iterator[Entry]:  # noqa: ARG001
    """Read the points (point, 3) and triangles (face, 3) of a VTP file."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkFiltersCore import vtkTriangleFilter
    from vtkmodules.vtkIOXML import vtkXMLPolyDataReader

    reader, triangles = vtkXMLPolyDataReader(), vtkTriangleFilter()
    reader.SetFileName(path)
    triangles.SetInputConnection(reader.GetOutputPort())
    triangles.PassLinesOff()
    triangles.PassVertsOff()
    triangles.Update()
    if reader.GetErrorCode() or not triangles.GetOutput().GetPoints():
        raise ValueError("VTK cannot read it")
    found = triangles.GetOutput()
    if not found.GetNumberOfPolys():
        raise ValueError("it has no facets")
    points = vtk_to_numpy(found.GetPoints().GetData()).astype(float)
    faces = vtk_to_numpy(found.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    if faces.min() < 0 or faces.max() >= len(points):
        raise ValueError("its facets refer to points that do not exist")
    yield {"name": "points"}, points
    yield {"name": "faces"}, faces.astype(np.int64)
