"""The lumen of pressed and undeformed tubes, against closed forms and the independent solution."""

import dataclasses
from pathlib import Path

import jax
import numpy as np
import pytest
from refusals import refused
from test_indentation import DEEP, pressed, reference

from acoustube.base.limits import CLEARANCE, JOINED_CLEARANCE, pressed_reach
from acoustube.indentation import Indenter, MeshSize, indent
from acoustube.indentation.mesh import sweep
from acoustube.indentation.press import first_touch, neo_hookean_wall, press_model
from acoustube.indentation.self_contact import BARRIER_DISTANCE
from acoustube.lumen import (
    deformed_wall,
    lumen,
    measure,
    pressed_part,
    profile,
    ring_faces,
    straighten,
    whole_tube,
)
from acoustube.tube import Tube
from acoustube.waves import cut_cells
from acoustube.waves.grid.straight_part import straight_ends_cut
from acoustube.waves.spectral import wall_of
from acoustube.waves.spectral.partition import LEAD

TUBE = Tube(length=0.4)
RADIUS = TUBE.inner_diameter / 2
ROD = 25e-3
AREA_AT_4_MM = np.loadtxt(
    Path(__file__).parent / "data" / "indentation_rod25_area_at_4mm.csv", delimiter=",", skiprows=4
)


def fabricated(displacement=0.0, *, rod=ROD, z=0.0):
    """Return an indentation of one increment with given instead of computed displacements."""
    reach = pressed_reach(TUBE.outer_diameter, rod) + z
    mesh = sweep(TUBE, reach, halved=(True, z == 0.0), presses=[z])
    with jax.enable_x64(True):
        untouched = first_touch(
            TUBE,
            (Indenter(diameter=rod, z=z),),
            support="held",
            layer=None,
            material=neo_hookean_wall(TUBE),
            mesh=mesh,
            barrier_distance=BARRIER_DISTANCE * TUBE.inner_diameter,
        )
        moved = np.zeros(mesh.points.shape) + displacement
        gap = press_model(untouched).lumen.smallest_gap(mesh.points + moved)
    return dataclasses.replace(
        untouched,
        depth=np.array([1e-3]),
        displacement=moved[None],
        smallest_gap=np.array([gap]),
    )


def polygon(rings):
    """Return the area over R^2 of a polygon in a circle with corners in the rings' directions."""
    angle = np.unwrap(np.arctan2(rings[0, :, 0], -rings[0, :, 1]))
    return np.sum(np.sin(np.diff(angle, append=angle[0] + 2 * np.pi))) / 2


POLYGON = polygon(lumen(fabricated(), 0.15).rings)


def section(rings, z):
    """Cut a stack of rings."""
    return profile(rings.reshape(-1, 3), ring_faces(*rings.shape[:2]), np.asarray(z, float))


def test_undeformed_lumen_is_a_polygon_along_its_whole_length():
    """216 facets, up to half longer than the average: 2.5e-4 below the circle's area.

    The elements' parabolas are a^4 / 30 = 1e-5 below it. Volume, areas and widths are those of the
    polygon within 1.5e-5, and never above.
    """
    straight = lumen(fabricated(), 0.15)
    area = POLYGON * RADIUS**2
    assert area == pytest.approx(np.pi * RADIUS**2, rel=2.5e-4)
    assert straight.surface.volume == pytest.approx(area * TUBE.length, rel=1.5e-5)
    found = section(straight.rings, np.linspace(0.0, TUBE.length * (1 - 1e-12), 101))
    assert found.area == pytest.approx(np.full(101, area), rel=1.5e-5)
    assert found.area.max() <= area * (1 + 1e-12)
    assert found.height == pytest.approx(np.full(101, 2 * RADIUS), rel=1e-12)
    assert found.width == pytest.approx(np.full(101, 2 * RADIUS), rel=1e-12)


def test_outer_rings_are_a_wall_thickness_away():
    """Ring by ring and point by point, at the same z.

    The elements at the top and bottom are half longer than the average; the sagitta of their
    parabolas, a^4 / 30 of the radius, differs by 1.5e-4 of the wall thickness between the walls.
    """
    straight = lumen(fabricated(), 0.15)
    gap = straight.outer_rings - straight.rings
    assert np.abs(gap[..., 2]).max() < 1e-15
    assert np.hypot(gap[..., 0], gap[..., 1]) == pytest.approx(TUBE.wall_thickness, rel=2e-4)


@pytest.fixture(scope="module")
def pressed_lumen():
    return lumen(pressed(1, 2), 0.15)


def test_lumen_is_pressed_where_the_tool_is():
    """A dent at 30 mm beside the middle, by its centre of gravity; between rings within 20 um."""
    place, untouched = 30e-3, fabricated(z=30e-3)
    _, y, z = untouched.mesh.points.T
    dent = 1e-3 * np.exp(-(((z - place) / 3e-3) ** 2)) * np.clip(y / RADIUS, 0, None)
    moved = np.zeros((1, len(z), 3))
    moved[0, :, 1] = -dent
    rings = lumen(dataclasses.replace(untouched, displacement=moved), 0.2).rings
    z = 0.2 + place + np.linspace(-10e-3, 10e-3, 401)
    missing = 2 * RADIUS - section(rings, z).height
    assert (z @ missing) / missing.sum() == pytest.approx(0.2 + place, abs=20e-6)


def test_surface_is_closed_and_faces_outwards_from_end_to_end(pressed_lumen):
    surface = pressed_lumen.surface
    assert surface.is_watertight
    assert surface.is_winding_consistent
    assert surface.volume > 0
    assert surface.bounds[:, 2] == pytest.approx([0.0, Tube().length], abs=1e-15)
    assert np.all(np.diff(pressed_lumen.rings[:, 0, 2]) > 0)
    assert len(surface.faces) == 2 * surface.vertices.shape[0] - 4  # Euler: a sphere


def test_rings_start_at_the_bottom_and_top_is_in_the_middle(pressed_lumen):
    """Points run anticlockwise as seen from the far end (from +z): x > 0 comes first."""
    rings = pressed_lumen.rings
    middle = rings.shape[1] // 2
    assert np.abs(rings[:, [0, middle], 0]).max() < 1e-15
    assert np.all(rings[:, 0, 1] < rings[:, middle, 1])
    assert np.all(rings[:, 1:middle, 0] > 0)
    assert rings[:, 1:middle] == pytest.approx(rings[:, :middle:-1] * [-1, 1, 1], abs=1e-15)


def test_lumen_is_the_same_on_both_sides_of_the_press(pressed_lumen):
    """The lumen is symmetric about `position`, where it is narrowest, to round-off of shifted z."""
    offset = np.linspace(0, 50e-3, 201)
    ahead, behind = (section(pressed_lumen.rings, 0.15 + s * offset) for s in (1, -1))
    assert ahead.area == pytest.approx(behind.area, rel=1e-9)
    assert np.argmin(ahead.area) == 0
    assert np.all(np.diff(ahead.area[:60]) > 0)


def test_section_at_the_press_is_that_of_calculix(pressed_lumen):
    """At z = position the straightened tube is cut square, as the reference: 0.1 mm2, 0.02 mm."""
    found = section(pressed_lumen.rings, [0.15])
    expected = reference()[2]
    assert 1e6 * found.area[0] == pytest.approx(expected["lumen_area_mm2"], abs=0.1)
    assert 1e3 * found.height[0] == pytest.approx(expected["lumen_height_mm"], abs=0.02)
    assert 1e3 * found.width[0] == pytest.approx(expected["lumen_width_mm"], abs=0.02)


def test_area_far_from_the_press_is_the_bores_although_the_tube_tilts(pressed_lumen):
    """Beyond 1.5 rod diameters the area is pi R^2 within 0.05 %, of which the facets take 0.018 %.

    Measured 1e-5 below the polygon, by the parabolas. Without straightening, slices z = const of
    the tilted tube would be 6e-4 larger, which a tolerance of 1e-4 detects.
    """
    distance = np.linspace(1.5 * ROD, pressed_reach(Tube().outer_diameter, ROD) - 1e-3, 40)
    found = section(pressed_lumen.rings, 0.15 + distance)
    assert found.area == pytest.approx(np.full(40, np.pi * RADIUS**2), rel=5e-4)
    assert found.area == pytest.approx(np.full(40, POLYGON * RADIUS**2), rel=1e-4)
    tilted = deformed_wall(pressed(1, 2))
    assert tilted[-1, 0, 1] - tilted[0, 0, 1] > 1e-3  # it does tilt


@pytest.mark.slow
@pytest.mark.xdist_group("calculix")  # whose press it is
def test_area_along_a_deep_press_is_that_of_calculix():
    """Slices z = const of the tilted wall at 4 mm, to 54 mm from the press: 0.1 mm2.

    Measured 0.015 mm2 at most; the source of the reference is stated in its file.
    """
    found = pressed(*DEEP)
    (increment,) = np.flatnonzero(found.depth == 4e-3)
    z, area = AREA_AT_4_MM[AREA_AT_4_MM[:, 0] < 55].T
    assert len(z) > 25
    section = measure(found, increment, 1e-3 * z)
    assert 1e6 * section.area == pytest.approx(area, abs=0.1)


def cone(n):
    """Return rings of ellipses with half axes 2 - z and 1 + z / 2, for z from 0 to 1."""
    z = np.linspace(0, 1, 5)[:, None]
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    x, y = (2 - z) * np.sin(angle), 3 - (1 + 0.5 * z) * np.cos(angle)
    return np.stack([x, y, 0 * angle + z], axis=-1)


def test_profile_of_a_cone_of_ellipses_converges_at_second_order():
    """The area tends to pi a b: its error falls by 16 with four times the facets.

    Height and width are those of the axes, where the rings have points; between two rings they are
    exact because the axes are linear in z.
    """
    cuts = np.linspace(0, 0.999, 23)
    a, b = 2 - cuts, 1 + 0.5 * cuts
    coarse, fine = (section(cone(n), cuts) for n in (64, 256))
    errors = [np.abs(found.area / (np.pi * a * b) - 1).max() for found in (coarse, fine)]
    assert errors[1] < 2e-4
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.1)
    assert fine.height == pytest.approx(2 * b, rel=1e-12)
    assert fine.width == pytest.approx(2 * a, rel=1e-12)
    assert np.array_equal(fine.z, cuts)


def test_half_of_a_symmetric_surface_measures_the_whole():
    """Only triangles with x >= 0; the closing line x = 0 adds no area. Planes in any order."""
    rings, cuts = cone(64), np.array([0.7, 0.1, 0.33])
    half = rings[:, :33].copy()
    half[:, [0, -1], 0] = 0.0  # sin(pi) is not
    number = np.arange(half[..., 0].size).reshape(half.shape[:2])
    a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, :-1], number[1:, 1:]
    faces = np.concatenate([np.stack(t, -1).reshape(-1, 3) for t in ((a, b, d), (a, d, c))])
    found, whole = profile(half.reshape(-1, 3), faces, cuts, halved=True), section(rings, cuts)
    assert found.height == pytest.approx(whole.height, rel=1e-12)
    assert found.width == pytest.approx(whole.width, rel=1e-12)
    # The diagonals of the two halves lie differently: second order in the facets.
    assert found.area == pytest.approx(whole.area, rel=1e-3)


def test_planes_beside_the_surface_measure_nothing():
    beside = section(cone(16), [-0.1, 1.1])
    assert np.all(beside.area == 0)
    assert np.all(beside.height == 0)
    assert np.all(beside.width == 0)


def test_lists_are_measured_and_straightened_as_arrays():
    rings = cone(12)
    points, triangles = rings.reshape(-1, 3), ring_faces(*rings.shape[:2])
    z = [0.1, 0.2]
    found = profile(points.tolist(), triangles.tolist(), z)
    assert np.array_equal(found.area, profile(points, triangles, np.array(z)).area)
    assert profile(points, triangles, []).area.shape == (0,)
    assert measure(fabricated(), -1, []).height.shape == (0,)
    line = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.02]]
    assert straighten([[0.0, 1e-3, 0.01]], line)[0] == pytest.approx([0.0, 1e-3, 0.01])


def tilted(angle, z=0.0):
    """Return a press at z whose only displacement is a rotation by an angle about the x axis."""
    points = fabricated(z=z).mesh.points
    turn = [[1, 0, 0], [0, np.cos(angle), np.sin(angle)], [0, -np.sin(angle), np.cos(angle)]]
    return fabricated(points @ np.transpose(turn) - points, z=z)


@pytest.mark.parametrize("z", [0.0, 20e-3])
def test_sections_beyond_and_through_the_ends_of_the_modelled_part_are_nan(z):
    """A circle that is cut at an angle has the area over its cosine; the mesh is 1e-5 below it."""
    press = tilted(0.2, z)
    end = press.mesh.points[:, 2].max()
    places = np.array([0.8, 0.98, 1.0, 1.2]) * end
    found = measure(press, 0, np.concatenate([places, -places]))
    assert np.array_equal(np.isnan(found.area), [False, True, True, True] * 2)
    assert np.array_equal(np.isnan(found.area), np.isnan(found.height))
    assert np.array_equal(np.isnan(found.area), np.isnan(found.width))
    area = np.pi * RADIUS**2 / np.cos(0.2)
    assert found.area[[0, 4]] == pytest.approx([area, area], rel=2e-4)


def test_straight_tube_that_tilts_as_a_whole_stays_straight():
    """The press is not at z = 0, where the bottom line is not level."""
    found = lumen(tilted(0.08, 20e-3), 0.2)
    for rings in (found.rings, found.outer_rings):
        assert np.ptp(rings[..., :2], axis=0).max() < 1e-12
        assert np.ptp(rings[..., 2], axis=1).max() < 1e-12


def test_ring_faces_close_a_prism_of_known_volume():
    """A unit square prism of height 2 in three rings: 12 + 8 triangles, volume 2, outwards."""
    square = np.array([[0, -1], [1, 0], [0, 1], [-1, 0]]) / np.sqrt(2)
    points = np.array([[x, y, z] for z in (0.0, 0.5, 2.0) for x, y in square])
    faces = ring_faces(3, 4)
    assert len(faces) == 20
    a, b, c = np.moveaxis(points[faces], 1, 0)
    assert np.sum(a * np.cross(b, c)) / 6 == pytest.approx(2.0, rel=1e-14)
    outwards = np.sum(np.cross(b - a, c - a) * ((a + b + c) / 3 - [0, 0, 1]), axis=1)
    assert outwards.min() > 0


def test_straightening_maps_an_arc_back_to_the_straight_tube():
    """An arc (y, z) = (y0, 0) + R_c (1 - cos, sin), less an offset inwards.

    h = 0.1 mm and R_c = 1 m: the chords lose h^2 / 24 = 4e-10 of the length and the spline's free
    end is wrong by h^2 / (9 R_c) = 1e-9 in its last interval; 1e-9 m is allowed before that.
    """
    bend, bottom, length = 1.0, -5.55e-3, 60e-3
    angle = np.linspace(0, length / bend, 601)
    line = np.stack([0 * angle, bottom + bend * (1 - np.cos(angle)), bend * np.sin(angle)], -1)
    turn, offset = angle[:580:7, None], np.linspace(0, 11.1e-3, 5)
    radius = bend - offset
    y, z = bottom + bend - radius * np.cos(turn), radius * np.sin(turn)
    bent = np.stack([np.full_like(y, 2e-3), y, z], axis=-1)
    straight = straighten(bent, line)
    assert np.all(straight[..., 0] == 2e-3)
    assert np.abs(straight[..., 1] - (bottom + offset)).max() < 1e-9
    assert np.abs(straight[..., 2] - bend * turn).max() < 1e-9


def test_sharp_bend_is_straightened_up_to_near_its_centre():
    """The radius is 12 mm, with points up to 9 mm inwards, as in deep presses of a free tube.

    h = 24 um: h^3 / R_c^2 and h^2 / 24 of the length are under 1e-8 m; 1e-8 is allowed.
    """
    bend = 12e-3
    angle = np.linspace(0, 1.2, 600)
    line = np.stack([0 * angle, bend * (1 - np.cos(angle)), bend * np.sin(angle)], axis=-1)
    turn, offset = np.linspace(0.1, 1.0, 50)[:, None], np.linspace(-3e-3, 9e-3, 5)
    y, z = bend - (bend - offset) * np.cos(turn), (bend - offset) * np.sin(turn)
    straight = straighten(np.stack([0 * y, y, z], axis=-1), line)
    assert np.abs(straight[..., 1] - offset).max() < 1e-8
    assert np.abs(straight[..., 2] - bend * turn).max() < 1e-8


def test_tube_that_has_sunk_as_a_whole_is_the_straight_tube():
    """On a soft layer a press lowers the tube; there is no step where the mesh ends."""
    mesh = fabricated().mesh
    found = lumen(fabricated(np.tile([0.0, -4e-3, 0.0], (len(mesh.points), 1))), 0.2)
    for rings in (found.rings, found.outer_rings):
        assert np.ptp(rings[..., :2], axis=0).max() < 1e-12


def test_straightening_leaves_a_straight_tube_alone():
    z = np.linspace(0, 60e-3, 50)
    line = np.stack([0 * z, 0 * z - 5e-3, z], axis=-1)
    points = np.random.default_rng(0).uniform(0, 5e-2, (20, 3))
    assert straighten(points, line) == pytest.approx(points, abs=1e-15)


@pytest.mark.parametrize("position", [0.05, 0.36])
def test_press_too_near_an_end_is_refused(position):
    """56.9 mm are needed on each side: four outer diameters and half a rod."""
    error = refused(lambda: lumen(fabricated(), position), setting="position", value=position)
    assert "0.057 m" in error.advice
    lumen(fabricated(), 0.06)


def test_advice_for_a_press_too_near_an_end_can_be_followed():
    """With a rod of 10 mm, 49.4 mm are needed on each side; a tube of 9 cm is too short."""
    found = fabricated(rod=10e-3)
    error = refused(lambda: lumen(found, 0.01), setting="position", value=0.01)
    assert error.advice == "use 0.050 m or more from both ends"
    lumen(found, 0.05)
    short = dataclasses.replace(found, tube=Tube(length=0.09))
    error = refused(lambda: lumen(short, 0.045), setting="position", value=0.045)
    assert error.advice == "use a tube of 0.100 m or more"
    lumen(dataclasses.replace(found, tube=Tube(length=0.1)), 0.05)


def test_closed_lumen_is_a_closed_surface_that_does_not_cross_itself():
    """Walls 0.015 mm apart are in contact by the barrier; the gap between them remains."""
    mesh = fabricated().mesh
    _, y, z = mesh.points.T
    share = np.exp(-((z / 5e-3) ** 2)) * (1 + y / np.hypot(*mesh.points[:, :2].T)) / 2
    down = share[:, None] * [0.0, -1.0, 0.0]  # from zero at the bottom to the full one at the top
    found = lumen(fabricated(7.885e-3 * down), 0.2)
    assert found.surface.is_watertight
    (height,) = profile(
        found.rings.reshape(-1, 3), ring_faces(*found.rings.shape[:2]), np.array([0.2])
    ).height
    assert height == pytest.approx(0.015e-3, rel=0.01)


@pytest.mark.parametrize("position", [0.1, 0.23, 0.0625, 0.3375])
def test_whole_tube_of_a_pressed_part_is_the_lumen(position):
    """The rings are the same, also at the first and the last position that settings allow."""
    found = pressed(1, 2)
    whole, built = whole_tube(pressed_part(found), position, 0.4), lumen(found, position)
    assert np.ptp(whole.rings[..., 2]) == pytest.approx(0.4, abs=1e-12)
    np.testing.assert_allclose(whole.rings, built.rings, atol=1e-12)
    np.testing.assert_allclose(whole.outer_rings, built.outer_rings, atol=1e-12)
    assert whole.surface.volume == pytest.approx(built.surface.volume, rel=1e-6)
    error = refused(
        lambda: whole_tube(pressed_part(found), 0.02, 0.4), setting="position", value=0.02
    )
    whole_tube(pressed_part(found), float(error.advice.split()[1]), 0.4)


@pytest.mark.parametrize("resolution", [8, 24])
def test_part_computed_alone_fits_the_places_that_settings_allow(resolution):
    """Its straight ends, of both solvers, begin within the clearance for joined parts."""
    part, across = pressed_part(pressed(1, 2)), TUBE.inner_diameter / resolution
    room = pressed_reach(TUBE.outer_diameter, ROD) + JOINED_CLEARANCE * TUBE.outer_diameter
    length = 2 * part.position
    cells = cut_cells(part.surface, (across, across, length / np.ceil(length / across)))
    core = straight_ends_cut(cells)
    end = core.origin[2] + core.length + core.spacing[2] / 2 - part.position
    farthest = [abs(place) + LEAD * RADIUS for place in wall_of(part).ends]
    for place in (*farthest, part.position - core.origin[2], end):
        assert room - TUBE.outer_diameter < place < room


def test_each_increment_has_its_own_lumen():
    """The first increment is the undeformed tube, the one of 1 mm has the reference's height."""
    found = pressed(1, 2)
    (one,) = np.flatnonzero(found.depth == 1e-3)
    heights = [section(lumen(found, 0.2, i).rings, [0.2]).height[0] for i in (0, one)]
    assert heights[0] == pytest.approx(2 * RADIUS, rel=1e-9)
    assert 1e3 * heights[1] == pytest.approx(reference()[1]["lumen_height_mm"], abs=0.02)


def test_pressing_takes_air_out_of_the_lumen(pressed_lumen):
    """The surface's volume is the integral of the profile, but for the trapezoids' error, 2e-6."""
    z = np.linspace(0, Tube().length * (1 - 1e-12), 8001)
    taken = POLYGON * RADIUS**2 * Tube().length - pressed_lumen.surface.volume
    missing = np.trapezoid(POLYGON * RADIUS**2 - section(pressed_lumen.rings, z).area, z)
    assert taken > 0
    assert taken == pytest.approx(missing, rel=1e-4)


@pytest.mark.parametrize("support", ["held", "free"])
def test_nearest_allowed_place_still_fits_the_tube(support):
    """The settings leave half an outer diameter; a press shifts its end by less than 0.2 mm."""
    tube = Tube(length=0.16)
    pressed = indent(
        tube,
        Indenter(diameter=10e-3),
        depth=4e-3,
        support=support,
        mesh=MeshSize(through_wall=1, around=8, along=8),
    )
    nearest = pressed_reach(tube.outer_diameter, 10e-3) + CLEARANCE * tube.outer_diameter
    for position in (nearest, tube.length - nearest):
        assert lumen(pressed, position).surface.is_watertight
