"""Valid files of every kind, from which the cases are made by mutation."""

from __future__ import annotations

import contextlib
import io
import json
import os
from pathlib import Path

import numpy as np

TIME = np.arange(1200) / 200e3
N_CYCLES = 3


def recording() -> dict[str, np.ndarray]:
    """Return a short recording with its labels, as named arrays."""
    chance = np.random.default_rng(0)
    since = TIME - 130e-6 - np.array([0.0, 4e-3])[:, None]
    send, echo = np.exp(-((since / 60e-6) ** 2)) * np.sin(2 * np.pi * 42e3 * since)
    noise = chance.normal(0, 0.003, (N_CYCLES, TIME.size))
    return {
        "signal": 2000 + 1000 * (send + 0.2 * echo + noise),
        "sampling_rate": np.array(200e3),
        "temperature": np.full(N_CYCLES, 21.0),
        "true_distance_cm": np.full(N_CYCLES, 70.0),
        "depth_mm": np.linspace(2, 3, N_CYCLES),
        "force": np.linspace(1, 2, N_CYCLES),
    }


def build(folder: Path) -> None:
    """Write all valid files to a new folder, in a minute, or in seconds from a cache."""
    partial = folder.with_name(f"{folder.name}-{os.getpid()}")
    partial.mkdir(parents=True)
    here = Path.cwd()
    os.chdir(partial)
    try:
        _recordings()
        _surfaces()
        _markers()
        _texts()
        _models()
        _results()
    finally:
        os.chdir(here)
    with contextlib.suppress(OSError):  # another process may have been faster
        partial.rename(folder)


def _recordings() -> None:
    import h5py
    import xarray as xr
    from scipy.io import savemat, wavfile

    arrays = recording()
    np.savez("good.npz", **arrays)
    np.savez_compressed("packed.npz", **arrays)
    np.save("good.npy", arrays["signal"])
    counts = arrays["signal"].astype(np.int16)
    wavfile.write("good.wav", 200_000, counts.ravel())
    with contextlib.suppress(ImportError, OSError):
        import soundfile

        soundfile.write("good.flac", counts.ravel(), 200_000, subtype="PCM_16")
    savemat("good.mat", arrays | {"struct": {"inner": np.arange(3.0), "text": "words"}})
    savemat("packed.mat", arrays, do_compression=True)
    savemat("old.mat", {"signal": arrays["signal"]}, format="4")
    with h5py.File("good.h5", "w") as file:
        for name, value in arrays.items():
            file[name] = value
        file.attrs["temperature_c"] = 20.0
        file.create_dataset("group/packed", data=arrays["signal"], compression="gzip", chunks=True)
    data = xr.Dataset(
        {"signal": (("cycle", "time"), arrays["signal"]), "force": ("cycle", arrays["force"])},
        {"time": ("time", TIME, {"units": "s"})},
        {"temperature_c": 20.0},
    )
    data.to_netcdf("good.nc", engine="h5netcdf")
    data.to_netcdf("old.nc", engine="scipy")
    rows = [",".join(["time_s", *(f"cycle{i}" for i in range(N_CYCLES))])]
    rows += [f"{t:.7f}," + ",".join(f"{v:.1f}" for v in column)
             for t, column in zip(TIME, arrays["signal"].T, strict=True)]  # fmt: skip
    Path("good.csv").write_text("\n".join(rows) + "\n")


def _surfaces() -> None:
    import pyvista
    import trimesh

    lumen = trimesh.creation.cylinder(radius=3.95, height=20, sections=12)
    lumen.apply_translation((0, 0, 10))
    wall = trimesh.creation.annulus(r_min=3.95, r_max=5.55, height=60, sections=12)
    for name, surface in (("lumen", lumen), ("wall", wall)):
        for kind in ("stl", "ply", "obj"):
            surface.export(f"{name}.{kind}")
        Path(f"{name}_text.stl").write_text(trimesh.exchange.stl.export_stl_ascii(surface))
        mesh = pyvista.wrap(surface)
        mesh.save(f"{name}.vtp")
        mesh.save(f"{name}_text.vtp", binary=False)


def _markers() -> None:
    lines = ["column,marker,x_mm,y_mm,z_mm"]
    for side, column in ((1, "A"), (-1, "B")):
        lines += [f"{column},{i},{side * (32 + i)},0,{30 * i}" for i in range(8)]
    Path("markers.csv").write_text("\n".join(lines) + "\n")
    with contextlib.suppress(ImportError):
        import ezc3d

        file = ezc3d.c3d()
        labels = [f"{column}{i}" for column in "AB" for i in range(8)]
        places = np.array([[s * (32 + i), 0, 30 * i, 1] for s in (1, -1) for i in range(8)], float)
        file["parameters"]["POINT"]["LABELS"]["value"] = labels
        file["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
        file["parameters"]["POINT"]["RATE"]["value"] = [100.0]
        file["data"]["points"] = np.repeat(places.T[:, :, None], 3, axis=2)
        file.write("markers.c3d")


def _texts() -> None:
    from acoustube.ranging import Rangefinder
    from acoustube.runs.config import Config, to_toml

    Path("settings.toml").write_text(to_toml(Config()))
    Path("goal.toml").write_text("[goal]\nreach_m = 1.5\nforces_n = [2, 10]\n")
    Path("plan.toml").write_text(
        "[tube]\nlength_cm = 40\n\n[sweep]\ncount = 8\nseed = 1\n\n[sweep.over]\n"
        'depth_mm = "1:4"\nindenter_mm = [10, 25]\n'
    )
    Path("cases.toml").write_text(
        "[[sweep.case]]\ndepth_mm = 1.0\n\n[[sweep.case]]\ndepth_mm = 2.0\nindenter_mm = 10\n"
    )
    sensor = json.loads(Rangefinder().to_json())
    Path("sensor.json").write_text(json.dumps(sensor))
    Path("sidecar.toml").write_text(
        "sampling_rate_hz = 200000\ntemperature_c = 20.0\nchannel = 0\n\n[labels]\n"
        'true_distance_cm = 70.0\ndepth_mm = [2.0, 2.5, 3.0]\nsession = "one"\n'
    )
    Path("sidecar.json").write_text(
        json.dumps({"sampling_rate_hz": 200e3, "temperature_c": 20, "labels": {"force": 1.0}})
    )


def _models() -> None:
    from acoustube import estimation, signals
    from acoustube.signals import Processing, TimeGain
    from acoustube.signals.calibration import Estimate
    from tests.labelled_cycles import HOW, cycles

    places = np.linspace(0.2, 2, 10)
    numbers = (Estimate(-0.25, 0.01), Estimate(2.0, 0.1), Estimate(0.9, 0.1), Estimate(0.42, 0.01))
    signals.save(
        signals.Calibration(
            processing=Processing(gain=TimeGain(*(n.value for n in numbers)), prominence=0.02),
            sampling_rate=200e3, **dict(zip(("c1", "c2", "c3", "c4"), numbers, strict=True)),
            amplitude_rmse=0.01, slope=Estimate(1.0, 0.01), intercept=Estimate(0.0, 0.01),
            distance_rmse=0.001, false_alarms=0.0, true_distance=places,
            estimated_distance=places, amplitude=np.linspace(0.6, 0.2, 10),
        ),
        "calibration.toml",
    )  # fmt: skip
    data = cycles(56, seed=2)
    data.isel(cycle=slice(4)).to_netcdf("labelled.nc", engine="h5netcdf")
    small = {"boosting": {"max_iter": 3}, "echo": {"epochs": 1}, "network": {"epochs": 1}}
    for name, settings in small.items():
        how = estimation.FeatureSettings(
            kind=estimation.model.kind_of_features(name), processing=HOW
        )
        table = estimation.feature_table(data, how)
        model = estimation.train(table, name, how, n_folds=2, **settings)
        estimation.save(model, f"{name}.model")


def _results() -> None:
    """Compute small results of each kind, with settings of the tests, which are cached."""
    import xarray as xr

    from acoustube.base.netcdf import write_dataset
    from acoustube.ranging import blockage
    from acoustube.runs.scattering_file import to_dataset

    small = ("--indenter", "25", "--depth", "0.6")
    settings = ("--vary", "mesh=coarse", "resolution=11", "--workers", "1")
    _command("sweep", *small, "0", *settings, "--out", "sweep")
    _command("dataset", "sweep", "--cycles", "2", "--out", "cycles", "--workers", "1")
    Path("coarse.toml").write_text('[indentation]\nmesh = "coarse"\n')
    _command("indent", *small, "--steps", "1", "--config", "coarse.toml", "--out", "indent")
    found = to_dataset(blockage(np.array([20e3, 30e3]), 0.0).scattering)
    found.attrs |= {"losses": "none", "warnings": ""}
    write_dataset(found, Path("scatter.nc"))
    xr.Dataset({"x": ("press", [1.0, 2.0])}).to_netcdf("foreign.nc", engine="h5netcdf")
    _command("sleeve", "--forearm", "25", "17", "26", "--loops", "9", "--out", "sleeve")


def _command(*words: str) -> None:
    """Run a command that must succeed."""
    from acoustube.cli import main

    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        code = main(words)
    if code:
        raise RuntimeError(f"{' '.join(words)} ended with {code}: {out.getvalue()}")
