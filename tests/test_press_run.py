"""The command ``acoustube indent``: its files, its cache, and its results when a press fails."""

import dataclasses
from io import StringIO
from types import SimpleNamespace

import numpy as np
import pytest
import pyvista
import xarray as xr
from commands import run_here
from rich.console import Console
from test_tetrahedra import D_BORE

from acoustube import load_config
from acoustube.base import cache
from acoustube.base.console import ConsoleReporter
from acoustube.cli import indent as indent_command
from acoustube.indentation import (
    MeshSize,
    PressError,
    indent,
    load_path,
    restored,
    tetrahedra,
)
from acoustube.indentation.self_contact import triangulated
from acoustube.reports.figures import run as run_figure
from acoustube.runs import presses as press_runs
from acoustube.runs.config import Mechanics
from acoustube.runs.config.si import press_in_si
from acoustube.runs.presses import MESH

COARSE = MeshSize(through_wall=1, around=6, along=6)

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Run the command; return its result and the folder."""
    folder = tmp_path_factory.mktemp("presses") / "press"
    words = ["--indenter", "25", "--depth", "0.5", "--steps", "2", "--support", "free"]
    result = run_here("indent", *words, "--out", folder)
    assert result.returncode == 0, result.stderr
    return result, folder


@pytest.fixture(scope="module")
def dataset(finished):
    with xr.open_dataset(finished[1] / "run.nc", engine="h5netcdf") as data:
        return data.load()


def test_coarse_mesh_is_stiffer_by_what_is_documented(monkeypatch, tmp_path):
    """1 x 12 x 10 elements are 3 to 4 % too stiff (docs/findings.md); and cached apart."""
    monkeypatch.setenv("ACOUSTUBE_CACHE", str(tmp_path))
    force = {}
    for mesh in ("coarse", "usual"):
        config = load_config(None, Mechanics, depth_mm=1, mesh=mesh)
        force[mesh] = press_runs.pressed(config, [1e-3]).contact_force[-1]
    assert 1.02 < force["coarse"] / force["usual"] < 1.06


def test_folder_holds_data_settings_figure_and_meshes(finished):
    _, folder = finished
    names = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    assert names == {
        "run.nc",
        "config.toml",
        "figure.png",
        "vtu/press.pvd",
        "vtu/press-0001.vtu",
        "vtu/press-0002.vtu",
    }
    settings = load_config(folder / "config.toml", Mechanics)
    assert settings.indentation.steps == 2
    assert settings.indentation.support == "free"


def test_depths_are_equally_spaced_and_met(dataset):
    assert dataset.sizes["depth"] == 2
    assert dataset["indentation_depth"].values == pytest.approx([0.25e-3, 0.5e-3], rel=1e-15)
    assert list(dataset["converged"].values) == [1, 1]
    assert list(dataset["closed"].values) == [0, 0]
    assert "0.01975 mm" in dataset.attrs["closed"]


def test_force_and_section_are_those_of_the_independent_solution(dataset):
    """CalculiX at 0.25 and 0.5 mm: 0.11873 and 0.25197 N, to 1 %; 0.01 mm and 0.1 mm2.

    At 0.25 mm the contact is narrower than an element: measured 1.4 %, and 0.5 % at 0.5 mm.
    """
    assert dataset["contact_force"].values[0] == pytest.approx(0.11873, rel=0.02)
    assert dataset["contact_force"].values[1] == pytest.approx(0.25197, rel=0.015)
    assert 1e3 * dataset["lumen_height"].values == pytest.approx([7.68764, 7.44431], abs=0.01)
    assert 1e3 * dataset["lumen_width"].values == pytest.approx([8.03456, 8.18937], abs=0.01)
    assert 1e6 * dataset["lumen_area"].values == pytest.approx([48.75173, 48.39382], abs=0.1)


def test_profile_is_narrowest_at_the_press_and_round_far_from_it(dataset):
    """At 50 mm the area is that of the bore, 49.017 mm2, within 0.02."""
    z, area = dataset["z"].values, dataset["lumen_area_profile"].values
    assert area.shape == (2, z.size)
    assert z[z.size // 2] == 0.0
    assert area[:, z.size // 2] == pytest.approx(dataset["lumen_area"].values, rel=1e-12)
    assert 1e6 * area[:, 0] == pytest.approx([49.017, 49.017], abs=0.02)
    assert np.all(np.argmin(area, axis=1) == z.size // 2)


def test_every_variable_has_a_unit_and_a_name(dataset):
    bare = [
        name
        for name, variable in dataset.variables.items()
        if not {"units", "long_name"} <= set(variable.attrs)
    ]
    assert bare == []


def test_work_of_the_press_is_in_the_wall(dataset):
    """The force's work from 0.25 to 0.5 mm, by the trapezoidal rule, is the energy to 3 %."""
    energy, force = dataset["elastic_energy"].values, dataset["contact_force"].values
    assert np.diff(energy)[0] == pytest.approx(0.25e-3 * force.mean(), rel=0.03)


def test_meshes_for_paraview_have_the_elements_volume(finished, dataset):
    """VTK's volume of the quadratic cells is that of the quarter; the last file has the last row.

    VTK splits a quadratic cell into linear ones: 1 % of the curved wall.
    """
    grid = pyvista.read(finished[1] / "vtu" / "press-0002.vtu")
    assert grid.n_cells == dataset.sizes["element"]
    assert set(grid.celltypes) == {pyvista.CellType.QUADRATIC_HEXAHEDRON}
    sizes = grid.compute_cell_sizes(length=False, area=False)["Volume"]
    assert sizes.min() > 0
    reach = grid.bounds[5]
    assert sizes.sum() == pytest.approx(np.pi / 2 * (5.55e-3**2 - 3.95e-3**2) * reach, rel=0.01)
    moved = dataset["node_displacement"].values[-1]
    assert np.array_equal(grid.point_data["displacement"], moved)


def test_second_run_is_recalled_and_the_same(finished, tmp_path):
    words = ["--indenter", "25", "--depth", "0.5", "--steps", "2", "--support", "free"]
    assert run_here("indent", *words, "--out", "again").returncode == 0
    with (
        xr.open_dataset(finished[1] / "run.nc", engine="h5netcdf") as first,
        xr.open_dataset(tmp_path / "again" / "run.nc", engine="h5netcdf") as second,
    ):
        assert np.array_equal(first["node_displacement"], second["node_displacement"])


def test_truncated_cache_entry_is_computed_again_and_reported(tmp_path, monkeypatch):
    """The note is printed and stored in the file; the results equal those of the first run.

    The third run computes nothing.
    """
    computed = []

    def coarse(*args, **options):
        computed.append(name)
        return indent(*args, **(options | {"mesh": COARSE}))

    monkeypatch.setenv("ACOUSTUBE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(press_runs, "indent", coarse)
    monkeypatch.setattr(
        press_runs, "restored", lambda *a, **o: restored(*a, **(o | {"mesh": COARSE}))
    )
    config, found = load_config(None, Mechanics, depth_mm=0.05, steps=1), []
    for name in ("first", "second", "third"):
        printed = StringIO()
        indent_command.run_press(
            config, tmp_path / name, ConsoleReporter(Console(file=printed, width=400))
        )
        (entry,) = (tmp_path / "cache").glob("*.npz")
        if name == "first":
            entry.write_bytes(entry.read_bytes()[:500])
        said = f"note: The cached press {entry} is damaged and was not used"
        with xr.open_dataset(tmp_path / name / "run.nc", engine="h5netcdf") as data:
            assert (said in printed.getvalue()) == (name == "second")
            assert ("is damaged" in data.attrs["warnings"]) == (name == "second")
            found.append(data["node_displacement"].values)
    assert computed == ["first", "second"]
    assert np.array_equal(found[0], found[1])
    assert np.array_equal(found[1], found[2])


def test_notes_on_the_mesh_of_an_imported_wall_are_kept_with_the_press(tmp_path, monkeypatch):
    """The mesh is stubbed, and noted; the press is that of the deepest of its depths."""
    mesh = SimpleNamespace(sweep=None, halved=(True, True), **dict.fromkeys(MESH, np.zeros(2)))

    def meshed(_surface, *, note, **_options):
        note("it is rough")
        return mesh

    results = {"depth": np.zeros(2)}
    monkeypatch.setenv("ACOUSTUBE_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(tetrahedra, "tetrahedral_mesh", meshed)
    monkeypatch.setattr(press_runs, "Mesh", SimpleNamespace)
    monkeypatch.setattr(
        press_runs, "indent", lambda *_a, **o: SimpleNamespace(mesh=o["mesh"], results=results)
    )
    monkeypatch.setattr(press_runs, "restored", lambda _t, _i, known, **_o: known["depth"])
    config = load_config(None, Mechanics, depth_mm=0.5, surface=str(D_BORE))
    for _ in range(2):
        notes = []
        found = press_runs.pressed(config, [0.5e-3, 2e-3], note=notes.append)
        assert notes == ["it is rough"]
    assert np.array_equal(found, np.zeros(2))  # that of the cache
    (entry,) = cache.entries()
    assert ", 2 mm deep, " in entry.label


def test_press_that_stops_keeps_and_reports_converged_depths(tmp_path, monkeypatch):
    """Newton's method fails beyond 0.35 mm: increments are halved down to the smallest."""
    minimise = load_path.minimise

    def blocked(model, start, bodies, tolerance):
        found = minimise(model, start, bodies, tolerance)
        if bodies[0].height < 5.55e-3 - 0.35e-3:
            return dataclasses.replace(found, converged=False, reason="buckling")
        return found

    monkeypatch.setattr(load_path, "minimise", blocked)
    monkeypatch.setattr(press_runs, "indent", lambda *a, **o: indent(*a, **(o | {"mesh": COARSE})))
    config = load_config(None, Mechanics, depth_mm=0.6, steps=6)
    with pytest.raises(PressError, match=r"stopped at a depth of 0\.35 mm of 0\.60 mm"):
        indent_command.run_press(config, tmp_path / "kept", ConsoleReporter(Console(quiet=True)))
    with xr.open_dataset(tmp_path / "kept" / "run.nc", engine="h5netcdf") as data:
        assert list(data["converged"].values) == [1, 1, 1, 0, 0, 0]
        assert np.all(np.isfinite(data["contact_force"].values[:3]))
        assert np.all(np.isnan(data["contact_force"].values[3:]))
        assert np.all(np.isnan(data["lumen_area_profile"].values[3:]))
        assert "buckling" in data.attrs["warnings"]
        sheet = run_figure.press_figure(data)
    assert len(sheet.axes) == 5  # force, lumen with its area, profiles with their colours


@pytest.mark.parametrize("dtype", [np.float32, np.int64])
def test_depths_of_any_number_type_have_a_key(dtype):
    settings = press_in_si(Mechanics())
    depths = np.array([1, 2], dtype)
    assert press_runs.cache_key(settings, depths) == press_runs.cache_key(settings, [1.0, 2.0])


def test_triangles_of_the_lumen_are_oriented_alike():
    """Each inner edge occurs once in each direction."""
    found = indent(load_tube(), depth=5e-5, mesh=COARSE)
    _, faces = triangulated(found.mesh)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    _, counts = np.unique(edges, axis=0, return_counts=True)
    assert counts.max() == 1


def load_tube():
    return press_in_si(load_config(None, Mechanics)).tube
