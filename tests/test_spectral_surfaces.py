"""Lumens for the spectral solver given as closed surfaces, or with ends that are not round."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
import xarray as xr
from commands import run_here
from test_spectral import AIR, CASES, RADIUS, plane, scattered, shape, wall

from acoustube.base.errors import ConfigError
from acoustube.cli import scatter as command
from acoustube.lumen import ring_faces
from acoustube.runs.scattering_file import read
from acoustube.waves import cut_cells, scatter, section_cut_ons
from acoustube.waves.spectral import (
    SurfaceRings,
    rings_of_surface,
    scatter_spectral,
    wall_of,
)
from acoustube.waves.spectral.ends import section_of

FREQUENCY = np.array([12e3, 20e3, 30e3, 38e3])


def surface_of(rings):
    return trimesh.Trimesh(rings.reshape(-1, 3), ring_faces(*rings.shape[:2]), process=False)


def pinched(case, turned=0.0, scale=1.0):
    """Lumens A and E as facets, from z = 0; the pinch is in the middle."""
    w = CASES[case][1]
    z = np.concatenate([[-20e-3, -w], np.linspace(-w, w, 65)[1:-1], [w, 20e-3]])
    t = 2 * np.pi * np.arange(160) / 160
    x, y, _, _ = (
        np.broadcast_to(part, (len(z), 160)) for part in shape(case, turned)(z[:, None], t)
    )
    points = np.stack([x, y, np.broadcast_to(z[:, None] + 20e-3, x.shape)], axis=-1)
    return surface_of(scale * points)


def d_bore(deeper=0.35):
    """A bore with a flat bottom and rounded corners, pinched from above over 16 mm."""
    z = np.concatenate([[0.0], np.linspace(8e-3, 24e-3, 49), [32e-3]])
    t = 2 * np.pi * np.arange(160) / 160 - np.pi / 2
    c, s = np.cos(t), np.sin(t)
    # A superellipse below: flat bottom, rounded corners.
    sharp = np.where(s < 0, 4.0, 2.0)
    size = RADIUS / (np.abs(c) ** sharp + np.abs(s) ** sharp) ** (1 / sharp)
    x, y = size * c, np.where(s < 0, 0.6, 1.0) * size * s
    f = np.where(np.abs(z - 16e-3) < 8e-3, 0.5 + 0.5 * np.cos(np.pi * (z - 16e-3) / 8e-3), 0.0)
    bottom = y.min()
    y = bottom + (y - bottom) * (1 - deeper * f[:, None])
    x = np.broadcast_to(x, y.shape)
    return surface_of(np.stack([x, y, np.broadcast_to(z[:, None], y.shape)], axis=-1))


@pytest.mark.parametrize("turned", [0.0, 0.4])
def test_surface_scatters_as_its_formula(turned):
    """160 facets around have 1.3e-4 less area. After the turn there is no symmetry left."""
    rings = rings_of_surface(pinched("E", turned), 20e-3)
    assert rings.symmetric  # narrowed all round: symmetric after a turn as well
    rings = rings_of_surface(pinched("A", turned), 20e-3)
    assert rings.symmetric == (turned == 0.0)
    found = scattered(wall_of(rings), FREQUENCY)
    exact = scattered(wall("A", turned), FREQUENCY)
    assert found.modes == exact.modes
    np.testing.assert_allclose(plane(found), plane(exact), atol=2e-3)


def test_faceted_lumen_is_that_of_its_pinch_and_equal_from_both_ends():
    """Facets of the straight parts do not count as changes of section, nor those of the halves."""
    half = CASES["A"][1]
    found = wall_of(rings_of_surface(pinched("A"), 20e-3))
    assert found.reversible
    assert np.array(found.breaks) == pytest.approx([-half, half], abs=0.4e-3)


def test_modes_of_any_section_are_those_of_a_round_bore_where_it_is_round():
    """Lumen A with numerical modes of its ends, with losses."""
    exact = scatter_spectral(wall("A"), AIR, FREQUENCY, symmetric_only=True)
    numerical = replace(wall("A"), circular=False)
    found = scatter_spectral(numerical, AIR, FREQUENCY, symmetric_only=True)
    assert found.modes == exact.modes
    np.testing.assert_allclose(found.cut_ons, exact.cut_ons, rtol=1e-6)
    np.testing.assert_allclose(plane(found), plane(exact), atol=1e-6)
    np.testing.assert_allclose(np.abs(found.s), np.abs(exact.s), atol=1e-5)


def test_modes_of_any_section_have_the_signs_of_a_round_bore():
    """Lumen A, and turned, without a mirror plane. (1,2) cuts on at 74 kHz; its lobes differ."""
    for turned, frequency in ((0.0, 78e3), (0.4, 47e3)):
        exact = scattered(wall("A", turned), np.array([frequency]))
        found = scattered(replace(wall("A", turned), circular=False), np.array([frequency]))
        assert found.modes == exact.modes
        np.testing.assert_allclose(found.s, exact.s, atol=1e-4)


def test_d_bore_has_the_cut_ons_of_its_grid():
    """Compared with eigenvalues on a grid of 48 cells across, whose error is about 2e-4."""
    surface = d_bore()
    found = scattered(wall_of(rings_of_surface(surface)), np.array([50e3]))
    grid = section_cut_ons(cut_cells(surface, 2 * RADIUS / 48), 1, AIR.sound_speed, 6)
    n = len(found.cut_ons)
    np.testing.assert_allclose(found.cut_ons, grid[:n], rtol=1e-3, atol=1.0)


@pytest.mark.slow
@pytest.mark.long
def test_pinched_d_bore_scatters_as_the_march():
    """At 16 cells across; (1,1) cuts on at 30.1 kHz. Measured 2.7e-3, and 1.2e-3 at 24 cells."""
    surface, frequency = d_bore(), np.array([12e3, 20e3, 34e3, 38e3])
    found = scattered(wall_of(rings_of_surface(surface, 16e-3)), frequency, symmetric_only=True)
    marched = scatter(
        cut_cells(surface, 2 * RADIUS / 16), AIR, frequency, reference=(16e-3, 16e-3), lossy=False,
        symmetric=True, symmetric_only=True,
    )  # fmt: skip
    assert found.modes == marched.modes
    np.testing.assert_allclose(plane(found), plane(marched), atol=4e-3)
    assert np.abs(plane(found)[0]).max() > 0.1


def test_bore_that_is_not_round_and_too_wide_is_refused():
    """The polynomials of an end's modes are of degree 18; 30 mm at 42 kHz need more."""
    wide = d_bore()
    wide.apply_scale(4.0)
    lumen = wall_of(rings_of_surface(wide, 64e-3))
    with pytest.raises(ConfigError, match=r"8.17 mm.* not round and as wide as 29.2 mm; lower the"):
        scatter_spectral(lumen, AIR, np.array([40e3, 42e3]))


def test_section_of_two_parts_is_refused():
    left, right = (trimesh.creation.cylinder(1e-3, 20e-3, sections=24) for _ in range(2))
    left.apply_translation([-2e-3, 0, 0])
    right.apply_translation([2e-3, 0, 0])
    with pytest.raises(ConfigError, match="consists of 2 parts; use the time-domain solver"):
        rings_of_surface(trimesh.util.concatenate([left, right]))


def narrowed(length, radius, n=100):
    """A round bore with a given radius by z, by rings that are close around its middle alone."""
    middle = length / 2
    z = np.unique([0.0, *np.linspace(middle - 12e-3, middle + 12e-3, n), length])
    t = 2 * np.pi * np.arange(64) / 64
    r = np.broadcast_to(radius(z), z.shape)[:, None]
    return surface_of(np.stack([r * np.sin(t), -r * np.cos(t), z[:, None] + 0 * t], axis=-1))


def test_long_tube_is_cut_where_its_section_changes():
    """A throat in 4 m of tube, 500 bores: its sections are those of a tube of 3 cm."""

    def throat(length):
        surface = narrowed(
            length, lambda z: RADIUS * (1 - 0.6 * np.exp(-(((z - length / 2) / 2e-3) ** 2)))
        )
        return wall_of(rings_of_surface(surface, length / 2))

    short, long = throat(30e-3), throat(4.0)
    z = np.linspace(-6e-3, 6e-3, 121)
    y = [-of.lines(z)[1].min(axis=1) for of in (short, long)]
    wanted = RADIUS * (1 - 0.6 * np.exp(-((z / 2e-3) ** 2)))
    assert y[0] == pytest.approx(wanted, abs=20e-6)
    assert y[1] == pytest.approx(wanted, abs=20e-6)


def test_straight_part_of_a_surface_needs_no_sections():
    """Only the pinch, of 24 mm, and two sections at each end are cut, evenly spaced."""
    rings = rings_of_surface(pinched("A"), 20e-3).rings
    heights = rings[1:-1, 0, 2]
    assert heights[2] > 7e-3
    step = np.diff(heights)[3]
    assert np.diff(heights)[2:-2] == pytest.approx(np.full(len(heights) - 5, step))
    assert rings[2, :, :2] == pytest.approx(rings[1, :, :2], abs=1e-9)


def test_surface_that_changes_over_too_long_a_part_is_refused():
    z = np.linspace(0, 1.0, 1500)
    radius = RADIUS * (1 + 0.1 * np.sin(2 * np.pi * z / 0.05) * (np.abs(z - 0.5) < 0.45))
    t = 2 * np.pi * np.arange(16) / 16
    x, y = (radius[:, None] * part for part in (np.sin(t), -np.cos(t)))
    wavy = surface_of(np.stack([x, y, z[:, None] + 0 * t], axis=-1))
    with pytest.raises(ConfigError, match=r"changes over 9\d\d(\.\d)? mm, and the spectral"):
        rings_of_surface(wavy)


def test_barrel_that_is_not_straight_at_its_ends_is_refused():
    """As a surface, whose ends are cut inside of it, and as rings."""
    z = np.linspace(0, 30e-3, 64)
    t = 2 * np.pi * np.arange(64) / 64
    r = RADIUS * (1 + 0.3 * np.sin(np.pi * z / 30e-3))[:, None]
    rings = np.stack([r * np.sin(t), -r * np.cos(t), z[:, None] + 0 * t], axis=-1)
    with pytest.raises(ConfigError, match="not straight at its ends"):
        rings_of_surface(surface_of(rings), 15e-3)
    with pytest.raises(ConfigError, match="not straight at its ends"):
        wall_of(SurfaceRings(rings, 15e-3, True, 1e-6))


def test_modes_of_equal_cut_on_keep_their_own_coefficients():
    section = section_of(replace(wall("A"), circular=False), False)
    zeros = section.modes.zeros.copy()
    zeros[2] = zeros[1]
    modes = replace(section.modes, zeros=zeros)
    chosen = replace(section, modes=modes).chosen(modes.part(slice(0, 4)))
    assert np.array_equal(chosen, section.coefficients[:, :4])


def test_ends_of_different_section_are_refused():
    z = np.linspace(0, 40e-3, 41)
    radius = RADIUS * (1 + 0.1 / (1 + np.exp(-(z - 20e-3) / 2e-3)))
    profile = np.column_stack([np.r_[0, radius, 0], np.r_[0, z, z[-1]]])
    surface = trimesh.creation.revolve(profile, sections=64)
    with pytest.raises(ConfigError, match="differ in section"):
        wall_of(rings_of_surface(surface))


WORDS = ["--band", "10", "30", "--step", "2", "--out", "s.nc"]


@pytest.fixture
def lumen_file():
    surface = pinched("A", scale=1e3)
    surface.apply_translation([0, 0, -20])
    surface.export("lumen.stl")
    return "lumen.stl"


def test_command_writes_the_matrix_with_its_estimated_error(lumen_file):
    """The reference planes are at z = 0 of the file, the middle of the pinch."""
    result = run_here("scatter", lumen_file, *WORDS, "--method", "spectral", "--lossless")
    assert result.returncode == 0, result.stderr
    assert "estimated error of the coefficients" in result.stdout.replace("\n", " ")
    with xr.open_dataset("s.nc", engine="h5netcdf") as data:
        assert data.attrs["solver"] == "spectral"
        assert data.attrs["losses"] == "none"
        assert data["error"].max() < 1e-3
    found = read("s.nc")
    exact = scattered(wall("A"), found.frequency)
    # The command's air is 20 degC with humidity: 343.4 m/s for 343.2.
    np.testing.assert_allclose(np.abs(plane(found)), np.abs(plane(exact)), atol=3e-3)


def test_command_marches_lumens_unsuitable_for_the_spectral_solver(lumen_file, monkeypatch):
    marched = scattered(wall("E"), 1e3 * np.arange(10.0, 31.0, 2.0), symmetric_only=True)

    def unsuitable(*_):
        raise ConfigError("the section at z = 3 mm consists of 2 parts")

    monkeypatch.setattr(command, "_spectral", unsuitable)
    monkeypatch.setattr(command, "_marched", lambda *_: (marched, []))
    result = run_here("scatter", lumen_file, *WORDS, "--method", "spectral")
    assert result.returncode == 0, result.stderr
    words = " ".join(result.stdout.split())
    assert "since the spectral solver cannot: the section at z" in words
    assert Path("s.nc").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--method", "fast"], "method"),
        (["--tolerance", "0.5"], "tolerance = 0.5 is out of range; use 1e-06 to 0.1"),
    ],
)
def test_wrong_options_are_refused_in_one_sentence(lumen_file, options, words):
    result = run_here("scatter", lumen_file, *WORDS, *options)
    assert result.returncode == 2
    assert words in result.stderr
    assert result.stderr.count("\n") == 1
