"""`acoustube export`: the written files are read back by libraries of the programs they are for."""

import csv
import dataclasses
import json
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
import pyvista
import soundfile
import trimesh
import xarray as xr

from acoustube.base.limits import pressed_reach
from acoustube.base.netcdf import write_dataset
from acoustube.base.surfaces import read_lumen
from acoustube.cli import main
from acoustube.indentation.mesh import sweep
from acoustube.lumen import Lumen, profile, ring_faces
from acoustube.reports.export import lerobot
from acoustube.reports.export.geometry import closed_wall
from acoustube.runs.config import Mechanics, load_config
from acoustube.runs.config.si import MESH_SIZES, press_in_si
from acoustube.runs.opening import ORDER
from acoustube.runs.scattering_file import to_dataset
from acoustube.runs.sweep import store
from acoustube.runs.walls import walls
from acoustube.waves import Scattering

CONFIG = load_config(None, Mechanics, mesh="coarse", depth_mm=2.0, steps=3)
SETTINGS = press_in_si(CONFIG)
TUBE = SETTINGS.tube
REACH = pressed_reach(TUBE.outer_diameter, SETTINGS.indenter.diameter)
SHARES = (0.1, 0.3)
"""Relative decrease of the section's height in the middle, at two depths."""
ROUND = 6e-4
"""Relative tolerance of a volume: a polygon of 144 corners has 3.2e-4 less area than its circle."""


def squeezed(points, share):
    """Displacement of all points but the bottom line; the area is as the height."""
    less = share * np.cos(0.5 * np.pi * points[:, 2] / REACH) ** 2
    height = points[:, 1] + TUBE.outer_diameter / 2
    return np.stack([0 * less, -less * height, 0 * less], axis=-1)


def numbers_of(path):
    """The columns of a table; Python reads every digit, which pandas did not always do."""
    with Path(path).open(newline="") as file:
        header, *rows = csv.reader(file)
    return {
        name: [number(cell) for cell in column] for name, *column in zip(header, *rows, strict=True)
    }


def number(cell):
    try:
        return float(cell or "nan")
    except ValueError:
        return cell


def area():
    return np.pi * TUBE.inner_diameter**2 / 4


@pytest.fixture
def press(tmp_path):
    """A run of `indent` with made-up displacements, the last depth not reached."""
    mesh = sweep(TUBE, REACH, MESH_SIZES["coarse"], halved=(True, True))
    depths = np.array([1e-3, 2e-3, 3e-3])
    moved = [squeezed(mesh.points, share) for share in SHARES]
    moved.append(np.full_like(mesh.points, np.nan))
    along = {
        name: ("depth", np.array([1.0, 2.0, np.nan]), {"units": "1", "long_name": name})
        for name in (
            "contact_force", "contact_area", "elastic_energy", "newton_residual", "lumen_area",
            "smallest_volume_ratio", "smallest_gap", "newton_iterations",
        )
    }  # fmt: skip
    data = xr.Dataset(
        along
        | {
            "indentation_depth": ("depth", depths, {"units": "m", "long_name": "depth"}),
            "converged": ("depth", np.array([1, 1, 0], np.int8)),
            "node_position": (("node", "xyz"), mesh.points),
            "node_displacement": (("depth", "node", "xyz"), np.array(moved)),
            "element_node": (("element", "corner"), mesh.elements),
            "inner_face_node": (("inner_face", "face_corner"), mesh.inner_faces),
            "outer_face_node": (("outer_face", "face_corner"), mesh.outer_faces),
        },
        {"depth": ("depth", depths, {"units": "m", "long_name": "depth"})},
        {"configuration": json.dumps(dataclasses.asdict(CONFIG))},
    )
    (tmp_path / "press").mkdir()
    write_dataset(data, tmp_path / "press" / "run.nc")
    return data


@pytest.fixture
def cycles(tmp_path):
    """A dataset of two presses, two sessions each, three cycles of ten samples in each."""
    rng = np.random.default_rng(1)
    n = 12
    depth = np.repeat([0.0, 2e-3], 6)
    along = {
        "temperature": 20 + rng.random(n), "force": 100 * depth, "depth": depth,
        "true_distance": np.where(depth > 0, 0.8, np.nan),
    }  # fmt: skip
    data = xr.Dataset(
        {name: ("cycle", values, {"units": "SI"}) for name, values in along.items()}
        | {"signal": (("cycle", "time"), rng.integers(0, 4096, (n, 10)).astype(np.uint16))},
        {
            "cycle": np.arange(n),
            "time": np.arange(10) / 200e3,
            "press": ("cycle", np.repeat(["a", "b"], 6)),
            "tube": ("cycle", np.repeat(["t"], n)),
            "session": ("cycle", np.tile(np.repeat(["s1", "s2"], 3), 2)),
        },
        {"sampling_rate": 200e3, "full_scale": 4096, "rangefinder": '{"cycle_rate": 20.0}'},
    )
    (tmp_path / "cycles").mkdir()
    write_dataset(data, tmp_path / "cycles" / "cycles-1.nc")
    return data


@pytest.mark.usefixtures("press")
@pytest.mark.parametrize("suffix", ["stl", "vtp"])
def test_lumen_of_each_depth_has_the_volume_of_the_squeezed_tube(suffix):
    """pi r^2 (L - s (2 reach) / 2): the mean of cos^2 over the squeezed part is one half."""
    assert main(["export", "press", "--format", suffix, "--out", "out"]) == 0
    table = pd.read_csv("out/lumens.csv")
    assert list(table["depth_mm"]) == pytest.approx([1.0, 2.0])
    assert "as acoustube scatter requires" in Path("out/README.txt").read_text()
    for file, share in zip(table["file"], SHARES, strict=True):
        surface, start = read_lumen(f"out/{file}")
        length = surface.extents[2]
        assert start == pytest.approx(-length / 2, rel=1e-6)
        expected = area() * (length - share * REACH)
        assert surface.volume == pytest.approx(expected, rel=ROUND)


@pytest.mark.usefixtures("press")
def test_stl_of_a_press_is_in_millimetres():
    assert main(["export", "press", "--out", "out"]) == 0
    surface = trimesh.load_mesh("out/lumen-0001.stl")
    assert surface.is_watertight
    assert surface.extents[0] == pytest.approx(1e3 * TUBE.inner_diameter, rel=1e-4)


@pytest.mark.parametrize("halved", [(True, True), (True, False), (False, False)])
def test_wall_as_it_lies_is_closed_and_has_its_volume(halved):
    """The wall of a round tube, whole or in halves, with ends closed by fans of triangles."""
    mesh = sweep(TUBE, REACH, MESH_SIZES["coarse"], halved=halved)
    surface = closed_wall(mesh, mesh.points + squeezed(mesh.points, 0.2))
    assert surface.is_watertight
    assert surface.volume == pytest.approx(area() * REACH * (2 - 0.2), rel=ROUND)


def test_wall_that_an_old_run_does_not_name_is_refused(press, tmp_path, capsys):
    (tmp_path / "old").mkdir()
    settings = json.loads(press.attrs["configuration"])
    settings["tube"]["surface"], settings["indentation"]["mesh"] = "wall.stl", "usual"
    older = press.drop_vars(["inner_face_node", "outer_face_node"])
    older.attrs["configuration"] = json.dumps(settings)
    write_dataset(older, tmp_path / "old" / "run.nc")
    assert main(["export", "old", "--out", "out"]) == 2
    assert "repeat acoustube indent" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_meshes_hold_the_displacements_of_the_depths_that_were_reached(press):
    assert main(["export", "press", "--format", "vtu", "--out", "out"]) == 0
    series = pyvista.get_reader("out/press.pvd")
    assert series.time_values == pytest.approx([1.0, 2.0])
    for number, share in enumerate(SHARES, start=1):
        grid = pyvista.read(f"out/press-{number:04d}.vtu")
        expected = squeezed(np.asarray(grid.points), share)
        assert np.abs(grid["displacement"] - expected).max() < 1e-12
    assert grid.n_cells == press.sizes["element"]


def test_lumen_of_a_run_is_the_whole_tube(tmp_path, press):
    ring = np.stack([np.cos(a := np.arange(64) * np.pi / 32), np.sin(a), 0 * a], axis=-1)
    rings = 4e-3 * ring + np.array([0.0, 0.0, 1.0]) * np.array([0.0, 0.1, 0.4])[:, None, None]
    run = press.drop_vars("converged").assign(
        inner_wall=(("ring", "around", "xyz"), rings),
        lumen_face=(("face", "vertex"), ring_faces(3, 64)),
    )
    (tmp_path / "run").mkdir()
    write_dataset(run, tmp_path / "run" / "run.nc")
    assert main(["export", "run", "--out", "out"]) == 0
    surface = trimesh.load_mesh("out/lumen.stl")
    assert surface.bounds[:, 2] == pytest.approx([0, 400])
    assert surface.is_watertight
    assert surface.volume == pytest.approx(32 * np.sin(np.pi / 32) * 16 * 400, rel=1e-6)


def test_tables_hold_every_number_exactly_with_its_unit(press):
    assert main(["export", "press", "--format", "csv", "--out", "out"]) == 0
    table = numbers_of("out/press.csv")
    for name in ("contact_force", "indentation_depth", "converged"):
        np.testing.assert_array_equal(table[name], press[name].values)
    columns = pd.read_csv("out/columns.csv").set_index("column")
    assert columns.loc["indentation_depth", "unit"] == "m"
    assert set(columns.index) == set(table)


def test_table_of_a_sweep_has_a_column_for_each_source_end(tmp_path):
    names = (
        "inner_diameter", "wall_thickness", "shear_modulus", "tube_length", "diameter",
        "carrier_frequency", "temperature", "true_distance", "depth",
    )  # fmt: skip
    ends = ["release", "absorbing"]
    data = xr.Dataset(
        {name: ("press", np.array([2.0, 1.0])) for name in names}
        | {"support": ("press", ["held"] * 2), "shape": ("press", ["rod"] * 2)}
        | {"configuration": ("press", ["{}"] * 2)}
        | {"estimated_distance": (("press", "source_end"), np.array([[0.1, 0.2], [0.3, np.nan]]))},
        {"press": ["x", "y"], "source_end": ends},
    )
    (tmp_path / "sweep").mkdir()
    write_dataset(data, tmp_path / "sweep" / "cases-1.nc")
    assert main(["export", "sweep", "--out", "out"]) == 0
    table = pd.read_csv("out/cases.csv")
    assert list(table["press"]) == ["y", "x"]  # sorted as open_dataset sorts
    assert list(table["estimated_distance_release"]) == [0.3, 0.1]
    assert np.isnan(table["estimated_distance_absorbing"][0])
    assert "configuration" not in table
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "cases.csv",
        "columns.csv",
    ]


def test_table_of_a_scattering_matrix_has_a_row_for_each_coefficient(tmp_path):
    rng = np.random.default_rng(2)
    s = rng.normal(size=(2, 2, 2, 2, 2)) + 1j * rng.normal(size=(2, 2, 2, 2, 2))
    matrix = Scattering(
        frequency=np.array([20e3, 42e3]), modes=("00", "11c"), s=s, cut_ons=np.array([0, 25e3]),
        propagates=np.ones((2, 2), bool), settled=s.real > 0, sound_speed=343.2,
        extent=(0.0, 0.0), spacing=(1e-3,) * 3, shape=(8, 8, 8), steps=1, time_step=1e-6,
    )  # fmt: skip
    write_dataset(to_dataset(matrix), tmp_path / "s.nc")
    assert main(["export", "s.nc", "--out", "out"]) == 0
    table = pd.read_csv("out/scattering.csv", dtype={"mode_in": str, "mode_out": str})
    assert len(table) == matrix.s.size
    values = table["s_real"].to_numpy() + 1j * table["s_imag"].to_numpy()
    np.testing.assert_allclose(values.reshape(matrix.s.shape), matrix.s)
    keys = ["frequency", "port_out", "mode_out", "port_in", "mode_in"]
    converted = table.set_index(keys).loc[(42e3, 2, "11c", 1, "00")]
    assert converted["s_imag"] == pytest.approx(matrix.s[1, 1, 1, 0, 0].imag)
    assert converted["settled"] == matrix.settled[1, 1, 1, 0, 0]
    described = pd.read_csv("out/columns.csv")
    assert set(described["column"]) == {*keys, "s_real", "s_imag", "settled"}


def case_file(folder, name, walls):
    """A file of a sweep with one case."""
    data = xr.Dataset(
        {label: ("press", [1.0]) for label in ORDER if label not in ("press", "support", "shape")}
        | {"support": ("press", ["held"]), "shape": ("press", ["rod"])}
        | {"lumen_area": ("press", [40e-6])},
        {"press": [name]},
    )
    store.write_file(folder / f"cases-{name}.nc", data, None, walls)


def test_lumens_of_a_sweep_are_those_of_its_files(tmp_path):
    """A straight bore of 4 mm by 100 mm, of 64 corners; coordinates are kept to 1e-4."""
    ring = np.stack([np.cos(a := np.arange(64) * np.pi / 32), np.sin(a), 0 * a], axis=-1)
    rings = 4e-3 * ring + np.array([0.0, 0.0, 1.0]) * np.linspace(-0.05, 0.05, 5)[:, None, None]
    part = Lumen(rings=rings + np.array([0.0, 0.0, 0.05]), outer_rings=1.4 * rings, position=0.05)
    case_file(tmp_path, "a", walls(part))
    case_file(tmp_path, "b", None)
    assert main(["export", ".", "--format", "stl", "--out", "out"]) == 0
    table = pd.read_csv("out/lumens.csv")
    assert list(table["press"]) == ["a"]
    surface = trimesh.load_mesh(f"out/{table['file'][0]}")
    assert surface.is_watertight
    expected = 32 * np.sin(np.pi / 32) * 16 * 100
    assert surface.volume == pytest.approx(expected, rel=4e-4)


def test_sweep_without_walls_is_refused(tmp_path, capsys):
    case_file(tmp_path, "b", None)
    assert main(["export", ".", "--format", "stl", "--out", "out"]) == 2
    assert "no case is pressed" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_sound_files_hold_the_counts(cycles):
    assert main(["export", "cycles", "--out", "out"]) == 0
    table = pd.read_parquet("out/labels.parquet")
    assert table["file"].nunique() == 4
    for i, row in table.iterrows():
        samples, rate = soundfile.read(f"out/{row['file']}", dtype="int16")
        assert rate == 200_000
        part = samples[row["start"] : row["start"] + row["length"]].astype(int) + 2048
        np.testing.assert_array_equal(part, cycles["signal"].values[i])


@pytest.mark.parametrize("offset", [0.0, 0.9])
def test_samples_that_are_not_counts_are_kept(cycles, tmp_path, offset):
    """Cycles of a sensor with quantised = False: float64 about the offset, here of 1.8 V."""
    mean = offset / 1.8 * 65536
    samples = mean + np.random.default_rng(3).normal(size=cycles["signal"].shape)
    attributes = {
        "full_scale": 65536,
        "rangefinder": json.dumps({"offset": offset, "full_scale": 1.8}),
    }
    data = cycles.assign(signal=(("cycle", "time"), samples)).assign_attrs(attributes)
    (tmp_path / "floats").mkdir()
    write_dataset(data, tmp_path / "floats" / "cycles-1.nc")
    assert main(["export", "floats", "--out", "out"]) == 0
    read = [soundfile.read(path, dtype="float32")[0] for path in sorted(Path("out").glob("*.wav"))]
    np.testing.assert_array_equal(np.concatenate(read), samples.ravel().astype(np.float32))
    assert "floating-point" in Path("out/README.txt").read_text()
    assert main(["export", "floats", "--format", "lerobot", "--out", "episodes"]) == 0
    frames, _ = frames_of(tmp_path / "episodes")
    signal = 32768 * np.stack(frames["observation.signal"])
    np.testing.assert_allclose(signal, samples - mean, rtol=1e-5)


def test_labels_of_cycles_are_a_table(cycles):
    assert main(["export", "cycles", "--format", "csv", "--out", "out"]) == 0
    table = numbers_of("out/cycles.csv")
    np.testing.assert_array_equal(table["temperature"], cycles["temperature"].values)
    assert list(table["session"][:4]) == ["s1", "s1", "s1", "s2"]


@pytest.mark.usefixtures("cycles")
def test_folder_in_the_home_and_link_to_an_empty_folder_are_written(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert main(["export", "cycles", "--format", "csv", "--out", "~/out"]) == 0
    assert (tmp_path / "out" / "cycles.csv").is_file()
    (tmp_path / "empty").mkdir()
    (tmp_path / "link").symlink_to("empty")
    assert main(["export", "cycles", "--format", "csv", "--out", "link"]) == 0
    assert (tmp_path / "link" / "cycles.csv").is_file()
    assert not (tmp_path / "link-2").exists()


def frames_of(folder):
    files = sorted(folder.glob("data/*/*.parquet"))
    return pd.concat([pd.read_parquet(path) for path in files], ignore_index=True), files


@pytest.mark.usefixtures("cycles")
def test_episodes_have_the_columns_and_numbers_of_the_layout(tmp_path):
    assert main(["export", "cycles", "--format", "lerobot", "--out", "out"]) == 0
    out = tmp_path / "out"
    info = json.loads((out / "meta" / "info.json").read_text())
    assert info["codebase_version"] == "v3.0"
    assert (info["total_episodes"], info["total_frames"], info["fps"]) == (4, 12, 20)
    frames, (path,) = frames_of(out)
    assert path.relative_to(out).as_posix() == info["data_path"].format(chunk_index=0, file_index=0)
    assert set(frames.columns) == set(info["features"])
    schema = pq.read_schema(path)
    for name, feature in info["features"].items():
        kind = schema.field(name).type
        if feature["shape"] != [1]:
            assert kind.list_size == feature["shape"][0]
            kind = kind.value_type
        assert kind.to_pandas_dtype() is getattr(np, feature["dtype"])
    assert list(frames["index"]) == list(range(12))
    assert list(frames["episode_index"]) == [0] * 3 + [1] * 3 + [2] * 3 + [3] * 3
    assert list(frames["frame_index"]) == [0, 1, 2] * 4
    assert frames["timestamp"].values == pytest.approx(frames["frame_index"].values / 20)
    assert set(frames["task_index"]) == {0}
    assert pq.ParquetFile(path).num_row_groups == 4


def test_frames_hold_signal_and_label(cycles, tmp_path):
    assert main(["export", "cycles", "--format", "lerobot", "--out", "out"]) == 0
    frames, _ = frames_of(tmp_path / "out")
    signal = np.stack(frames["observation.signal"])
    np.testing.assert_array_equal(2048 * signal + 2048, cycles["signal"].values)
    assert frames["observation.temperature"].values == pytest.approx(
        cycles["temperature"].values, abs=1e-5
    )
    action = np.stack(frames["action"])
    assert action[:6] == pytest.approx(np.zeros((6, 4)))
    assert action[6:] == pytest.approx(np.tile([1.0, 0.8, 2e-3, 0.2], (6, 1)))


@pytest.mark.usefixtures("cycles")
def test_metadata_list_episodes_tasks_and_statistics(tmp_path):
    assert main(["export", "cycles", "--format", "lerobot", "--out", "out"]) == 0
    meta = tmp_path / "out" / "meta"
    frames, _ = frames_of(tmp_path / "out")
    listed = pd.read_parquet(meta / "episodes" / "chunk-000" / "file-000.parquet")
    assert list(listed["dataset_from_index"]) == [0, 3, 6, 9]
    assert list(listed["dataset_to_index"]) == [3, 6, 9, 12]
    assert list(listed["length"]) == [3] * 4
    assert list(listed["press"] + listed["session"]) == ["as1", "as2", "bs1", "bs2"]
    tasks = pd.read_parquet(meta / "tasks.parquet")
    assert list(tasks.index) == list(listed["tasks"][0])
    stats = json.loads((meta / "stats.json").read_text())
    assert set(stats) == set(frames.columns)
    for name in ("observation.signal", "action", "observation.temperature"):
        values = np.stack(frames[name]).reshape(12, -1).astype(float)
        assert stats[name]["mean"] == pytest.approx(values.mean(axis=0))
        assert stats[name]["std"] == pytest.approx(values.std(axis=0), abs=1e-6)
        assert stats[name]["max"] == pytest.approx(values.max(axis=0))
        assert stats[name]["count"] == [12]


@pytest.mark.usefixtures("cycles")
def test_frames_are_spread_over_files_of_whole_episodes(tmp_path, monkeypatch):
    monkeypatch.setattr(lerobot, "FILE_MEGABYTES", 7 * 40e-6)  # seven frames of ten samples
    monkeypatch.setattr(lerobot, "FILES_PER_CHUNK", 1)
    assert main(["export", "cycles", "--format", "lerobot", "--out", "out"]) == 0
    out = tmp_path / "out"
    frames, files = frames_of(out)
    names = [path.relative_to(out / "data").as_posix() for path in files]
    assert names == ["chunk-000/file-000.parquet", "chunk-001/file-000.parquet"]
    assert list(frames["index"]) == list(range(12))
    listed = pd.read_parquet(out / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
    assert list(listed["data/chunk_index"]) == [0, 0, 1, 1]
    assert list(listed["data/file_index"]) == [0, 0, 0, 0]


@pytest.mark.usefixtures("press", "cycles")
@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (["press", "--format", "wav"], ["format = wav", "a run of indent", "stl or vtp or vtu"]),
        (["press", "--format", "lerobot"], ["format = lerobot does not fit press"]),
        (["cycles", "--format", "stl"], ["a dataset of cycles", "wav or csv or lerobot"]),
        (["cycles", "--format", "mp3"], ["mp3", "--format", "wav"]),
        (["none"], ["none does not exist"]),
        (["text.nc"], ["text.nc cannot be read as a result"]),
        (["other.nc"], ["other.nc is not a result of acoustube"]),
    ],
    ids=lambda value: " ".join(value),
)
def test_unsupported_exports_are_refused_and_nothing_is_written(words, parts, tmp_path, capsys):
    (tmp_path / "text.nc").write_text("no file")
    write_dataset(xr.Dataset({"a": 1.0}), tmp_path / "other.nc")
    assert main(["export", *words, "--out", "out"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    for part in parts:
        assert part in line
    assert not (tmp_path / "out").exists()


@pytest.mark.usefixtures("cycles")
@pytest.mark.parametrize("kind", ["wav", "lerobot"])
def test_missing_parquet_is_reported_with_what_to_install(kind, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert main(["export", "cycles", "--format", kind, "--out", "out"]) == 2
    line = capsys.readouterr().err
    assert "acoustube[parquet]" in line
    assert "use format csv" in line
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_press_that_was_computed_is_written_as_it_was(tmp_path):
    """The area at the press from a cut through the STL file is that of the table, to 1e-3."""
    config = '[indentation]\nmesh = "coarse"\ndepth_mm = 0.4\nsteps = 2\nsupport = "free"\n'
    (tmp_path / "a.toml").write_text(config)
    assert main(["indent", "--config", "a.toml", "--out", "run", "--quiet"]) == 0
    assert main(["export", "run", "--out", "out"]) == 0
    for row in pd.read_csv("out/lumens.csv").itertuples():
        surface = trimesh.load_mesh(f"out/{row.file}")
        cut = profile(surface.vertices, surface.faces, np.array([1e-3]))
        assert cut.area[0] == pytest.approx(row.lumen_area_mm2, rel=1e-3)
