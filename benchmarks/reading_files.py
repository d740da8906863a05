"""Time to read valid files of every format, with limits, hashes and readers in a child process.

To compare, run it with another version on the path::

    python benchmarks/reading_files.py
    PYTHONPATH=OTHER_CHECKOUT python benchmarks/reading_files.py

The smallest of several times is printed, after a first reading that loads libraries, compiled
code and the child process.

The version before the limits and this one, on one core, in ms: NPZ 3.8 and 4.5, packed 19.1 and
20.0, NPY 2.3 and 2.4, WAV 2.3 and 2.4, FLAC 25.0 and 27.1, MAT 3.2 and 4.5, HDF5 3.6 and 5.0,
netCDF 12.1 and 7.1, CSV 90.8 and 96.6, STL 35.7 and 35.3, as text 231 and 230, PLY 20.5 and 20.5,
OBJ 66.1 and 65.4, VTP 21.7 and 23.3, markers 3.1 and 3.1, C3D 24.3 and 26.0, settings 0.12 and
0.16, a scattering matrix 47.3 and 47.8.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

CYCLES, SAMPLES, RATE = 500, 4000, 200e3
REPEATS, LONGEST = 15, 6.0
"""Largest number of times that a file is read, and largest time in s spent on it."""


def main() -> None:
    """Make the files and print the times."""
    os.chdir(tempfile.mkdtemp(prefix="acoustube-reading-"))
    print(f"{'file':20} {'MB':>7} {'ms':>9}")
    for name, read in {**recordings(), **surfaces(), **others()}.items():
        if len(sys.argv) > 1 and name not in sys.argv[1:]:
            continue
        read()
        times: list[float] = []
        while len(times) < REPEATS and sum(times) < LONGEST:
            start = time.perf_counter()
            read()
            times.append(time.perf_counter() - start)
        size = Path(name).stat().st_size / 1e6 if Path(name).is_file() else 0.0
        print(f"{name:20} {size:7.2f} {1e3 * min(times):9.2f}", flush=True)


def recordings() -> dict[str, Callable[[], Any]]:
    """Write recordings; return the functions that read them."""
    import h5py
    import soundfile
    import xarray as xr
    from scipy.io import savemat, wavfile

    from acoustube.recordings import read

    chance = np.random.default_rng(0)
    signal = chance.normal(2000, 100, (CYCLES, SAMPLES)).astype(np.uint16)
    arrays = {"signal": signal, "sampling_rate": RATE, "temperature": np.full(CYCLES, 21.0)}
    np.savez("stored.npz", **arrays)
    np.savez_compressed("packed.npz", **arrays)
    np.save("cycles.npy", signal)
    counts = signal.astype(np.int16)
    wavfile.write("cycles.wav", int(RATE), counts.ravel())
    soundfile.write("cycles.flac", counts.ravel(), int(RATE), subtype="PCM_16")
    savemat("cycles.mat", arrays)
    with h5py.File("cycles.h5", "w") as file:
        for name, value in arrays.items():
            file[name] = value
    data = xr.Dataset(
        {"signal": (("cycle", "time"), signal), "temperature": ("cycle", arrays["temperature"])},
        {"time": ("time", np.arange(SAMPLES) / RATE, {"units": "s"})},
    )
    data.to_netcdf("cycles.nc", engine="h5netcdf")
    rows = np.column_stack([np.arange(SAMPLES) / RATE, signal.T])
    head = ",".join(["time_s", *(f"cycle{i}" for i in range(CYCLES))])
    np.savetxt("cycles.csv", rows, "%.7g", ",", header=head, comments="")
    options = {"rate": RATE, "temperature": 20.0}
    bare = {"samples": SAMPLES}
    given: dict[str, dict[str, Any]] = {
        "stored.npz": {}, "packed.npz": {}, "cycles.npy": options,
        "cycles.wav": options | bare, "cycles.flac": options | bare, "cycles.mat": {},
        "cycles.h5": {}, "cycles.nc": {}, "cycles.csv": {"temperature": 20.0},
    }  # fmt: skip
    # Each value is accessed, as some formats are mapped and read only then.
    return {name: lambda n=name, how=how: read(n, **how)["signal"].values.max()
            for name, how in given.items()}  # fmt: skip


def surfaces() -> dict[str, Callable[[], Any]]:
    """Write walls of 40 000 triangles; return the functions that read them."""
    import pyvista
    import trimesh

    try:
        from acoustube.base.surfaces import load
    except ImportError:
        from acoustube.surfaces import load  # type: ignore[import-not-found,no-redef]

    wall = trimesh.creation.annulus(r_min=3.95, r_max=5.55, height=60, sections=5000)
    for kind in ("stl", "ply", "obj"):
        wall.export(f"wall.{kind}")
    Path("text.stl").write_text(trimesh.exchange.stl.export_stl_ascii(wall))
    pyvista.wrap(wall).save("wall.vtp")
    names = ("wall.stl", "text.stl", "wall.ply", "wall.obj", "wall.vtp")
    return {name: lambda n=name: load(Path(n)) for name in names}


def others() -> dict[str, Callable[[], Any]]:
    """Write settings, markers and a result; return the functions that read them."""
    import ezc3d

    import acoustube
    from acoustube.ranging import blockage

    Path("settings.toml").write_text("[indentation]\ndepth_mm = 4\n")
    rows = [f"{c},{i},{s * (32 + i / 9)},0,{3 * i}" for s, c in ((1, "A"), (-1, "B"))
            for i in range(80)]  # fmt: skip
    Path("markers.csv").write_text("\n".join(["column,marker,x_mm,y_mm,z_mm", *rows]) + "\n")
    file = ezc3d.c3d()
    file["parameters"]["POINT"]["LABELS"]["value"] = [f"{c}{i}" for c in "AB" for i in range(8)]
    file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    file["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    places = np.array([[s * 32, 0, 30 * i, 1] for s in (1, -1) for i in range(8)], float)
    file["data"]["points"] = np.repeat(places.T[:, :, None], 500, axis=2)
    file.write("markers.c3d")
    try:
        from acoustube.recordings.markers import read_markers
    except ImportError:
        from acoustube.sleeve.markers import (  # type: ignore[import-not-found,no-redef]
            read_markers,
        )
    matrix = blockage(np.arange(20e3, 60e3, 10.0), 0.0).scattering
    try:
        from acoustube.base.netcdf import write_dataset
        from acoustube.runs.scattering_file import read, to_dataset
    except ImportError:
        from acoustube.io import write_dataset  # type: ignore[import-not-found,no-redef]
        from acoustube.scattered import (  # type: ignore[import-not-found,no-redef]
            read,
            to_dataset,
        )
    found = to_dataset(matrix)
    found.attrs |= {"losses": "none", "warnings": ""}
    write_dataset(found, Path("scattering.nc"))
    return {
        "settings.toml": lambda: acoustube.load_config("settings.toml"),
        "markers.csv": lambda: read_markers("markers.csv"),
        "markers.c3d": lambda: read_markers("markers.c3d"),
        "scattering.nc": lambda: read("scattering.nc"),
    }


if __name__ == "__main__":
    main()
