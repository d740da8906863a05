"""Recordings of all file formats, written from named arrays that may not suit the format."""

from __future__ import annotations

import zipfile
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

from tests.fuzz.corpus import TIME
from tests.fuzz.oddities import odd_text


def written(chance: Random, arrays: dict[str, Any], folder: Path) -> str:
    """Write named arrays to a file of some format, or to an NPZ where it cannot hold them."""
    ending = chance.choice((".npz", ".npz", ".mat", ".h5", ".nc", ".csv", ".wav", ".npy"))
    name = f"a{ending}"
    path = folder / name
    try:
        _WRITERS[ending](chance, arrays, path)
    except Exception:  # a format that cannot hold such an array
        path.unlink(missing_ok=True)
        name, path = "a.npz", folder / "a.npz"
        npz(chance, arrays, path)
    return name


def npz(chance: Random, arrays: dict[str, Any], path: Path) -> None:
    how = chance.choice(
        (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)
    )
    with zipfile.ZipFile(path, "w", how) as archive:
        for name, value in arrays.items():
            ending = ".npy" if chance.random() < 0.97 else ""
            try:
                with archive.open(f"{name[:60_000]}{ending}".replace("\udce9", "?"), "w") as member:
                    np.lib.format.write_array(member, np.asanyarray(value), allow_pickle=True)
            except (ValueError, OverflowError):
                continue


def _mat(chance: Random, arrays: dict[str, Any], path: Path) -> None:
    from scipy.io import savemat

    savemat(
        path, arrays, format=chance.choice(("4", "5", "5")), do_compression=chance.random() < 0.5
    )


def _hdf5(chance: Random, arrays: dict[str, Any], path: Path) -> None:
    import h5py

    with h5py.File(path, "w") as file:
        for name, value in arrays.items():
            value = np.asarray(value)
            file[name or "empty"] = value.astype(object) if value.dtype.kind == "U" else value
        odd = chance.randrange(10)
        if odd == 0:
            file.create_dataset("signal2", (10 ** chance.choice((6, 9, 12)),), "f8", chunks=(1000,))
        elif odd == 1:
            file["link"] = h5py.SoftLink("/nowhere")
            file["ring"] = h5py.SoftLink("/ring")
            file["other"] = h5py.ExternalLink("none.h5", "/x")
        elif odd == 2:
            file["loop"] = file["/"]
        elif odd == 3:
            file["reference"] = np.array([file.ref, file.ref], h5py.ref_dtype)
        elif odd == 4:
            file["compound"] = np.zeros(3, [("a", "f4"), ("b", "i4", (2,))])
        elif odd == 5:
            file.attrs["temperature"] = h5py.Empty("f8")
            file["nothing"] = h5py.Empty("f8")
        elif odd == 6:
            file.attrs["units"] = np.arange(3)
            file.attrs["temperature_c"] = chance.choice(("warm", np.nan, [1, 2], True))


def _netcdf(chance: Random, arrays: dict[str, Any], path: Path) -> None:
    import xarray as xr

    data = {
        name: (tuple(f"d{size}" for size in np.shape(value)), value)
        for name, value in arrays.items()
    }
    odd = {"units": chance.choice(("mm", "s", "days since 2000-01-01", 3.0, "")),
           "scale_factor": chance.choice((1.0, 0.0, 1e300)), "_FillValue": 0.0}  # fmt: skip
    for key in chance.sample(sorted(odd), chance.randrange(3)):
        name = chance.choice(sorted(data))
        data[name] = (*data[name][:2], {key: odd[key]})
    xr.Dataset(data).to_netcdf(path, engine=chance.choice(("h5netcdf", "scipy")))


def _csv(chance: Random, arrays: dict[str, Any], path: Path) -> None:
    values = np.atleast_2d(np.asarray(arrays["signal"]))[:, :400]
    rows = [[f"{t:.7g}", *map(str, column)] for t, column in zip(TIME, values.T, strict=False)]
    rows.insert(0, ["time_s", *(f"cycle{i}" for i in range(len(values)))])
    for _ in range(chance.choice((0, 1, 3))):
        row = chance.choice(rows)
        kind = chance.randrange(5)
        if kind == 0:
            row[chance.randrange(len(row))] = odd_text(chance)[:5000]
        elif kind == 1:
            row[chance.randrange(len(row))] = str(
                chance.choice((1, 1e308, "nan", "1,5", "0x1", -0.0))
            )
        elif kind == 2:
            row += [""] * chance.choice((1, 3, 1000))
        elif kind == 3:
            del row[chance.randrange(len(row)) :]
        else:
            rows.insert(chance.randrange(len(rows)), [odd_text(chance)[:100]])
    rows = [row for row in rows if row] or [["1"]]
    mark = chance.choice((",", ",", ";", "\t", " ", "|", ", "))
    ends = chance.choice(("\n", "\n", "\r\n", "\r"))
    code = chance.choice(("utf-8", "utf-8", "utf-16", "latin-1"))
    path.write_bytes(ends.join(mark.join(row) for row in rows).encode(code, errors="replace"))


def _wav(chance: Random, arrays: dict[str, Any], path: Path) -> None:
    from scipy.io import wavfile

    kind = chance.choice(("i2", "u1", "i4", "f4", "f8"))
    values = np.nan_to_num(np.asarray(arrays["signal"], float)).clip(-1e4, 1e4)
    wavfile.write(path, chance.choice((200_000, 1, 0, 2**31 - 1)), values.T.astype(kind))


def _npy(chance: Random, arrays: dict[str, Any], path: Path) -> None:
    np.save(path, chance.choice([arrays["signal"], *arrays.values()]), allow_pickle=True)


_WRITERS = {
    ".npz": npz, ".mat": _mat, ".h5": _hdf5, ".nc": _netcdf, ".csv": _csv, ".wav": _wav,
    ".npy": _npy,
}  # fmt: skip
