"""Scattering matrices of lumens from files, against an independent solution."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
import xarray as xr
from commands import run_here
from test_scattering import MIDDLE, RADIUS, REFERENCE, pinched

from acoustube.air import Air
from acoustube.base.errors import ConfigError
from acoustube.base.surfaces import read_lumen
from acoustube.runs.scattering_file import read
from acoustube.waves import cut_cells
from acoustube.waves.grid.straight_part import is_symmetric, straight_ends_cut
from acoustube.waves.scattering import scatter

AIR = Air(sound_speed=343.2, density=1.204)


def cells_of(case, resolution):
    return cut_cells(pinched(case), 2 * RADIUS / resolution)


@pytest.fixture(scope="module")
def flattened():
    """Lumen A on 16 cells per bore, without losses, at the reference's frequencies."""
    table = np.genfromtxt(REFERENCE, delimiter=",", names=True, dtype=None, skip_header=5)
    rows = table[table["case"] == "A"]
    found = scatter(
        cells_of("A", 16), AIR, rows["f_hz"].astype(float), reference=(MIDDLE, MIDDLE), lossy=False
    )
    return found, rows


@pytest.mark.slow
@pytest.mark.long
def test_flattened_lumen_scatters_as_the_spectral_solution(flattened):
    """Complex R00 and T00 at 16 cells per bore; measured errors of 0.0019 and 0.0039."""
    found, rows = flattened
    plane = found.modes.index("00")
    s = found.s[:, :, plane, 0, plane]
    assert np.abs(s[:, 0] - (rows["R_re"] + 1j * rows["R_im"])).max() < 0.004
    assert np.abs(s[:, 1] - (rows["T_re"] + 1j * rows["T_im"])).max() < 0.006


@pytest.mark.slow
def test_lossless_scattering_keeps_power_and_is_reciprocal(flattened):
    """Between all propagating and settled modes, within 0.5 % (measured 0.1 %)."""
    found, _ = flattened
    n = len(found.modes)
    travels = np.tile(found.propagates, (1, 2))
    checked = 0
    for s, settled, there in zip(found.s, found.settled, travels, strict=True):
        matrix = s.reshape(2 * n, 2 * n)[np.ix_(there, there)]
        if not settled.reshape(2 * n, 2 * n)[np.ix_(there, there)].all():
            continue
        checked += 1
        assert np.sum(np.abs(matrix) ** 2, axis=0) == pytest.approx(np.ones(len(matrix)), abs=5e-3)
        assert np.abs(matrix - matrix.T).max() < 5e-3
    assert checked > 0.8 * len(found.s)


@pytest.mark.slow
def test_halves_scatter_like_the_whole(monkeypatch):
    """Symmetric and antisymmetric modes apart, or all on the whole grid: the same to 2e-3."""
    from acoustube.waves import scattering

    cells, frequency = cells_of("A", 10), np.arange(10e3, 40e3, 1e3)
    halves = scatter(cells, AIR, frequency, reference=(MIDDLE, MIDDLE), lossy=False)
    monkeypatch.setattr(scattering, "is_symmetric", lambda _: False)
    whole = scatter(cells, AIR, frequency, reference=(MIDDLE, MIDDLE), lossy=False)
    assert set(whole.modes) == set(halves.modes)
    order = [whole.modes.index(name) for name in halves.modes]
    there = halves.propagates & (frequency[:, None] > halves.cut_ons + 1e3)
    both = there[:, None, :, None, None] & there[:, None, None, None, :]
    difference = np.abs(np.abs(whole.s[:, :, order][..., order]) - np.abs(halves.s))
    assert difference.max(where=both, initial=0.0) < 2e-3


def test_symmetry_and_straight_ends_are_found():
    cells = cells_of("E", 10)
    core = straight_ends_cut(cells)
    assert is_symmetric(core)
    assert core.length == pytest.approx(16e-3, abs=3 * cells.spacing[2])
    lopsided = replace(cells, volume_fraction=np.roll(cells.volume_fraction, 1, axis=0))
    assert not is_symmetric(lopsided)


def slightly_turned_pinch(degrees):
    """A bore slightly pinched from above, along a line turned from across the tube."""
    wall = [[RADIUS, z] for z in np.linspace(0, 0.04, 160)]
    tube = trimesh.creation.revolve([[0, 0], *wall, [0, 0.04]], sections=64)
    x, y, z = tube.vertices.T.copy()
    angle = np.radians(degrees)
    along = (z - 0.02) * np.cos(angle) - x * np.sin(angle)
    tube.vertices[:, 1] -= 0.011 * np.exp(-((along / 4e-3) ** 2)) * (y + RADIUS)
    return tube


@pytest.mark.slow
@pytest.mark.long
def test_slightly_skewed_lumen_couples_modes_of_either_symmetry():
    """Mirrored pinches couple the plane wave to (1,1) across the tube with opposite signs.

    The cells differ from their mirror images by less than 2 %, as those of a symmetric lumen may.
    Computed by halves, the coupling would be zero. Mirroring about x = 0 reverses the sign of that
    mode only. The two marches are independent; the triangles of their grids let them differ by a
    tenth.
    """
    spacing = 2 * RADIUS / 11
    frequency = np.arange(30e3, 40e3, 1e3)
    coupled = []
    for degrees in (12, -12):
        cells = cut_cells(slightly_turned_pinch(degrees), (spacing,) * 3)
        assert is_symmetric(straight_ends_cut(cells))
        found = scatter(cells, AIR, frequency, reference=(0.02, 0.02), lossy=False, symmetric=False)
        coupled.append(found.s[:, :, found.modes.index("11s"), 0, found.modes.index("00")])
    assert np.abs(coupled[0]).max() > 1e-3
    assert np.abs(coupled[0] + coupled[1]).max() < 0.1 * np.abs(coupled[0]).max()


def test_lumens_without_two_like_straight_ends_are_refused():
    z = np.linspace(0, 0.04, 60)
    for radius, part in (
        (RADIUS * (1 + 0.2 * z / z[-1]), "not straight at its end of low z"),
        (np.where(z < 0.02, RADIUS, 0.8 * RADIUS), "differ in section"),
        (np.full(60, RADIUS), "not symmetric about x = 0"),
    ):
        profile = [[0, 0], *np.column_stack([radius, z]), [0, z[-1]]]
        tube = trimesh.creation.revolve(np.array(profile), sections=64)
        tube.apply_translation([1e-3 * part.startswith("not symmetric"), 0, 0])
        with pytest.raises(ConfigError, match=part):
            straight_ends_cut(cut_cells(tube, 2 * RADIUS / 10))


def saved(surface, name="lumen.stl"):
    surface.export(name)
    return name


def cylinder(radius=4.0, length=40.0):
    return trimesh.creation.cylinder(radius, length, sections=64)


def opened():
    surface = cylinder()
    surface.update_faces(np.arange(len(surface.faces)) > 3)
    return surface


def inverted():
    surface = cylinder()
    surface.invert()
    return surface


def lying():
    surface = cylinder()
    surface.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    return surface


def crossing():
    surface = trimesh.creation.cylinder(4.0, 40.0, sections=32).subdivide().subdivide()
    middle = np.abs(surface.vertices[:, 2]) < 2
    surface.vertices[middle, 0] *= -1
    return surface


def touching():
    z = np.linspace(-20, 20, 121)
    surface = trimesh.creation.revolve([[0, -20], *[[4, s] for s in z], [0, 20]], sections=32)
    vertices = surface.vertices.copy()
    vertices[:, 1] *= np.clip(np.abs(vertices[:, 2]) / 4, 0, 1)
    surface.vertices = vertices
    return surface


@pytest.mark.parametrize(
    ("surface", "part"),
    [
        (opened, "not closed"),
        (touching, "touches itself"),
        (inverted, "inside out"),
        (lying, "does not lie along z"),
        (crossing, "intersects itself"),
        (lambda: cylinder(0.004, 0.04), "if its numbers were metres"),
        (lambda: trimesh.creation.annulus(3.95, 5.55, 40), "has a hole through it, as the wall"),
    ],
)
def test_surfaces_that_are_no_lumen_are_refused(surface, part):
    with pytest.raises(ConfigError, match=part):
        read_lumen(saved(surface()))


def test_lumen_is_read_in_metres_from_zero():
    surface, start = read_lumen(saved(cylinder()))
    assert start == pytest.approx(-0.02)
    assert surface.bounds[:, 2] == pytest.approx([0.0, 0.04])
    assert surface.is_watertight


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (["missing.stl"], "missing.stl does not exist"),
        (["lumen.stl", "--band", "60", "5"], "0 < low < high"),
        (["lumen.stl", "--band", "5", "10", "--step", "3"], "equal steps; use 2.5"),
        (["lumen.stl", "--band", "5", "inf"], "is above 1000 kHz; give it in kHz"),
        (["lumen.stl", "--humidity", "120"], "humidity = 120 is out of range; use 0 to 100 %"),
        (["lumen.stl", "--band", "5", "600", "--step", "5"], "cells per wavelength"),
        (["lumen.stl", "--resolution", "4"], "resolution = 4 is out of range; use a whole number"),
        (["lumen.stl", "--resolution", "12.7"], "resolution = 12.7 is not a whole number"),
        (
            ["lumen.stl", "--temperature", "99"],
            "temperature = 99 is out of range; use -20 to 60 degC",
        ),
    ],
)
def test_what_cannot_be_computed_is_refused_in_one_sentence(words, part):
    saved(cylinder())
    result = run_here("scatter", *words, "--out", "s.nc")
    assert result.returncode == 2
    assert part in result.stderr
    assert result.stderr.count("\n") == 1
    assert not Path("s.nc").exists()


def test_band_of_the_plane_mode_alone():
    """Below the cut-on of (1,1) no mode is antisymmetric."""
    found = scatter(cells_of("A", 10), AIR, np.arange(10e3, 20e3, 1e3), reference=(MIDDLE, MIDDLE))
    assert found.modes == ("00",)
    assert np.all(np.abs(found.s[:, :, 0, 0, 0]).max(axis=1) > 0.5)
    for frequency in ([0.0, 1e3], [2e3, 1e3], 5.0):
        with pytest.raises(ConfigError, match=r"^frequency "):
            scatter(cells_of("A", 10), AIR, np.array(frequency))


@pytest.mark.slow
def test_command_writes_the_matrix_of_a_straight_tube():
    """With losses and reference planes at z = 0 the transmission is one and the reflection zero."""
    saved(cylinder())
    words = ["--band", "10", "30", "--step", "2", "--resolution", "10", "--out", "s.nc"]
    result = run_here("scatter", "lumen.stl", *words)
    assert result.returncode == 0, result.stderr
    assert "cut on inside the band: 11" in result.stdout.replace("\n", " ")
    with xr.open_dataset("s.nc", engine="h5netcdf") as data:
        dims = ("frequency", "port_out", "mode_out", "port_in", "mode_in")
        assert data["s_real"].dims == data["s_imag"].dims == dims
        assert list(data["frequency"].values) == pytest.approx(np.arange(10e3, 31e3, 2e3))
        assert list(data["port_in"].values) == [1, 2]
        assert {"00", "11c", "11s"} == set(data["mode_in"].values)
        assert data.attrs["sound_speed"] == pytest.approx(343.2, abs=0.1)
        assert data.attrs["reference_z_1"] == data.attrs["reference_z_2"] == 0.0
        plane = data.sel(mode_in="00", mode_out="00", port_in=1)
        assert plane["s_real"].sel(port_out=2).values == pytest.approx(np.ones(11), abs=5e-3)
        assert np.abs(plane["s_imag"]).max() < 5e-3
        assert np.abs(plane["s_real"].sel(port_out=1)).max() < 5e-3
        low = data.sel(frequency=slice(0, 25e3), mode_in="11c")
        assert np.abs(low["s_real"]).max() == 0.0
    press = read("s.nc")
    assert press.s == pytest.approx(data["s_real"].values + 1j * data["s_imag"].values)
    assert press.modes == tuple(data["mode_in"].values)
    assert press.propagates.sum() == 11 + 2 * 3
    # A straight tube is cut in its middle.
    assert press.extent == pytest.approx((-0.001, 0.001), abs=2e-3)
    with pytest.raises(ConfigError, match=r"lumen.stl is not a file that acoustube scatter of"):
        read("lumen.stl")
    with pytest.raises(ConfigError, match=r"missing.nc does not exist; write one"):
        read("missing.nc")
