"""The swept mesh of the tube, whole or reduced by symmetry, against its geometry."""

import numpy as np
import pytest
from solids import quadrature

from acoustube.indentation import contact
from acoustube.indentation.mesh import USUAL_MESH, MeshSize, sweep
from acoustube.indentation.padding import in_blocks
from acoustube.indentation.reference_element import HEX20, QUAD8
from acoustube.tube import Tube

pytestmark = pytest.mark.usefixtures("double_precision")

REACH = 60e-3
TUBE = Tube()
SIZE = MeshSize(through_wall=2, around=12, along=5)
INNER, OUTER = TUBE.inner_diameter / 2, TUBE.outer_diameter / 2
PARTS = {"quarter": (True, True), "right half": (True, False), "front half": (False, True)}
PARTS["whole"] = (False, False)


@pytest.fixture(scope="module", params=PARTS)
def mesh(request):
    return sweep(TUBE, REACH, SIZE, halved=PARTS[request.param])


def angle_and_radius(points):
    """Return the angle from the bottom line towards +x, from -pi to pi, and the radius."""
    x, y, _ = np.moveaxis(points, -1, 0)
    return np.arctan2(x, -y), np.hypot(x, y)


def volumes(mesh):
    blocks = [quadrature(mesh.points[b], mesh.reference) for b in in_blocks(mesh.elements)]
    return np.concatenate([rule.weights.sum(axis=1) for rule in blocks])[: len(mesh.elements)]


def interpolated_sector(half_angle):
    """Return the area of a sector with a parabolic arc, over that of the circle.

    The arc through (cos a, -sin a), (1, 0), (cos a, sin a) is x = 1 - (1 - cos a) s^2, y = s sin a;
    1/2 int (x dy - y dx) = sin a (4 - cos a) / 3, which is a (1 - a^4/30 + ...).
    """
    return np.sin(half_angle) * (4 - np.cos(half_angle)) / (3 * half_angle)


# Volume and shape


@pytest.mark.parametrize("around", [3, 12])
@pytest.mark.parametrize("part", PARTS)
def test_volume_of_every_part_is_its_share_of_the_tube_to_the_interpolation_error(part, around):
    """The quadrature is exact for these maps: the volume lacks only the error of the parabolas.

    With an even division it is a^4 / 30, a = pi / (2 around): 2.5e-3 for 3 elements, 9.8e-6 for 12.
    """
    size = MeshSize(through_wall=2, around=around, along=3, fold=0.0, touch=0.0)
    mesh = sweep(TUBE, REACH, size, halved=PARTS[part])
    volume = mesh.copies * volumes(mesh).sum()
    exact = np.pi * (OUTER**2 - INNER**2) * 2 * REACH
    half_angle = np.pi / (2 * around)
    assert volume == pytest.approx(exact * interpolated_sector(half_angle), rel=1e-12)
    assert 1 - volume / exact == pytest.approx(half_angle**4 / 30, rel=0.1)


def test_parts_sum_to_the_same_whole_with_elements_that_shrink_towards_the_folds():
    """The sums agree to round-off; the largest element is 1.4 times the average."""
    sums = []
    for part in PARTS.values():
        mesh = sweep(TUBE, REACH, SIZE, halved=part)
        sums.append(mesh.copies * volumes(mesh).sum())
    assert sums == pytest.approx([sums[0]] * 4, rel=1e-13)
    assert sums[0] == pytest.approx(np.pi * (OUTER**2 - INNER**2) * 2 * REACH, rel=1e-4)


def test_jacobians_are_positive_out_to_the_corners(mesh):
    """At quadrature points and all nodes; the sign is the elements' orientation."""
    assert volumes(mesh).min() > 0
    _, slopes = HEX20.shape_functions(HEX20.nodes)
    jacobian = np.einsum("eni,qnj->eqij", mesh.points[mesh.elements], slopes)
    assert np.linalg.det(jacobian).min() > 0


def test_nodes_lie_on_circles_through_the_wall(mesh):
    """Radii are evenly spaced to round-off; where only x >= 0 is meshed no node has x below 0."""
    _, radius = angle_and_radius(mesh.points)
    layer = 4 * (radius - INNER) / (OUTER - INNER)
    assert np.abs(layer - np.round(layer)).max() < 1e-12
    assert np.array_equal(np.unique(np.round(layer)), np.arange(5))
    for axis, halved in ((0, mesh.halved[0]), (2, mesh.halved[1])):
        lowest = mesh.points[:, axis].min()
        assert lowest == (0.0 if halved else -mesh.points[:, axis].max())


def test_nodes_lie_exactly_on_the_planes_of_symmetry(mesh):
    """Coordinates there are exactly zero, as constraints are found by them.

    This holds on every line of nodes along the tube at the bottom and top, and for the middle on
    every ring: there are as many nodes as elsewhere. x = 0 has 2 n_through + 1 nodes at the bottom
    and as many at the top of a full station.
    """
    x, y, z = mesh.points.T
    near = np.abs(x) < 1e-9
    assert np.array_equal(near, x == 0.0)
    stations, count = np.unique(z[near], return_counts=True)
    full = 2 * (2 * SIZE.through_wall + 1)
    assert np.array_equal(count[::2], np.full(len(count[::2]), full))
    assert len(stations) == 2 * mesh.sweep.shape[0] + 1
    assert np.sum(y[near] < 0) == np.sum(y[near] > 0)
    at_middle = z == 0.0
    assert np.array_equal(at_middle, np.abs(z) < 1e-9)
    assert at_middle.sum() == np.sum(z == z.max())


def test_elements_around_shrink_at_the_sides_and_ends_by_the_shares_asked_for():
    """To 1 - fold and 1 - touch times those of an even division, within an element's width."""
    size = MeshSize(through_wall=1, around=45, along=1, fold=0.6, touch=0.3)
    mesh = sweep(TUBE, REACH, size)
    angle, _ = angle_and_radius(mesh.points[mesh.elements])
    widths = np.ptp(angle, axis=1) / (np.pi / 45)
    assert widths[22] == pytest.approx(0.4, rel=0.02)
    assert widths[[0, -1]] == pytest.approx([0.7, 0.7], rel=0.02)
    assert np.all(np.diff(widths[:9]) > 0)
    assert np.all(np.diff(widths[13:23]) < 0)
    assert widths == pytest.approx(widths[::-1], rel=1e-9)
    assert widths.sum() == pytest.approx(45.0, rel=1e-12)


def test_layers_shrink_towards_the_inner_wall_by_the_share_asked_for():
    """Thicknesses grow linearly, from 1 - inner to 1 + inner averages at the two walls."""
    size = MeshSize(through_wall=4, around=3, along=1, inner=0.5)
    mesh = sweep(TUBE, REACH, size)
    layers = np.unique(mesh.sweep.layer)
    assert np.diff(layers[::2]) * 4 == pytest.approx([0.625, 0.875, 1.125, 1.375], rel=1e-12)
    assert layers[1::2] == pytest.approx((layers[:-1:2] + layers[2::2]) / 2, rel=1e-12)
    assert layers[[0, -1]] == pytest.approx([0.0, 1.0], abs=1e-15)
    even = sweep(TUBE, REACH, MeshSize(through_wall=4, around=3, along=1))
    assert volumes(mesh).sum() == pytest.approx(volumes(even).sum(), rel=1e-12)


def test_a_whole_tube_is_the_mirror_image_of_its_half():
    """The same set of nodes as the half and its reflection, to 1e-12 m."""
    half, whole = (sweep(TUBE, REACH, SIZE, halved=(h, False)) for h in (True, False))
    mirrored = np.concatenate([half.points, half.points[half.points[:, 0] > 0] * [-1, 1, 1]])
    assert len(mirrored) == len(whole.points)

    def ordered(points):
        return points[np.lexsort(np.round(points * 1e9).astype(int).T)]

    assert np.abs(ordered(mirrored) - ordered(whole.points)).max() < 1e-12


# Along the tube


def stations(mesh):
    return np.unique(mesh.points[:, 2])


def test_stations_run_from_the_press_and_are_graded_towards_it():
    """Stations are at sinh(g i / n) / sinh(g), rounded to 1e-12 of the reach.

    The rounding makes equal stations equal.
    """
    z = stations(sweep(TUBE, REACH, SIZE))
    assert len(z) == 2 * SIZE.along + 1
    assert z[0] == 0.0
    ends = z[::2]
    i = np.arange(SIZE.along + 1)
    graded = np.sinh(SIZE.grading * i / SIZE.along) / np.sinh(SIZE.grading)
    assert ends == pytest.approx(REACH * graded, abs=1e-12 * REACH)
    assert np.all(np.diff(ends, 2) > 0)
    assert z[1::2] == pytest.approx((ends[1:] + ends[:-1]) / 2, abs=1e-12 * REACH)


def test_a_tube_meshed_to_both_sides_has_the_stations_of_its_half_twice():
    half, whole = (stations(sweep(TUBE, REACH, SIZE, halved=(True, h))) for h in (True, False))
    assert whole == pytest.approx(np.concatenate([-half[:0:-1], half]), abs=1e-13)


def test_every_press_has_a_station_and_the_fine_elements_there():
    """With two presses off the middle the element beside each is as fine as for one, to 10 %.

    The last element of each stretch is cut to fit, which scales the others of the stretch: with n
    elements by up to the growth of one, (1 + g / n) / 2; 16 elements and 3.0 leave 9 %.
    """
    places = [-12e-3, 20e-3]
    z = stations(sweep(TUBE, REACH, USUAL_MESH, halved=(True, False), presses=places))[::2]
    one = stations(sweep(TUBE, REACH, USUAL_MESH))[::2]
    assert z[[0, -1]] == pytest.approx([-REACH, REACH], rel=1e-15)
    for place in places:
        nearest = np.argmin(np.abs(z - place))
        assert z[nearest] == pytest.approx(place, abs=1e-12)
        beside = np.diff(z[nearest - 1 : nearest + 2])
        assert beside == pytest.approx([one[1]] * 2, rel=0.1)
    # They grow from each press to the middle between the two, and shrink from there to the next.
    middle = np.argmin(np.abs(z - 4e-3))
    assert z[middle] == pytest.approx(4e-3, abs=1e-12)
    between = (z >= places[0] - 1e-9) & (z <= places[1] + 1e-9)
    lengths = np.diff(z[between])
    assert np.argmax(lengths) in (np.sum(between[:middle]) - 1, np.sum(between[:middle]))


def test_presses_in_mirror_image_make_one_set_of_stations_in_the_half():
    """Positions -p and p coincide in a part that is halved along the tube."""
    both = stations(sweep(TUBE, REACH, SIZE, presses=[-20e-3, 20e-3]))
    one = stations(sweep(TUBE, REACH, SIZE, presses=[20e-3]))
    assert np.array_equal(both, one)
    assert np.min(np.abs(both - 20e-3)) < 1e-12


# Numbering and faces


def test_nodes_are_numbered_along_the_tube(mesh):
    """The numbers of an element span three stations only, which limits the bandwidth."""
    assert np.all(np.diff(mesh.points[:, 2]) >= 0)
    _, count = np.unique(mesh.points[:, 2], return_counts=True)
    span = mesh.elements.max(axis=1) - mesh.elements.min(axis=1)
    assert span.max() < 2 * count.max() + count.min()


def test_elements_have_the_local_order_of_the_shape_functions(mesh):
    """Local coordinates run through the wall, around, along; every node belongs to an element.

    Along each of them radius, angle or z of the corners increases, and midside nodes lie between.
    """
    corners = mesh.points[mesh.elements]
    angle, radius = angle_and_radius(corners)
    centre = angle_and_radius(corners[:, HEX20.nodes[:, 2] < 0].mean(axis=1))[0][:, None]
    turned = np.angle(np.exp(1j * (angle - centre)))
    for axis, coordinate in enumerate((radius, turned, corners[..., 2])):
        low, mid, high = (coordinate[:, HEX20.nodes[:, axis] == side] for side in (-1, 0, 1))
        assert np.all(low.max(axis=1) < mid.min(axis=1))
        assert np.all(mid.max(axis=1) < high.min(axis=1))
    around = SIZE.around * (1 if mesh.halved[0] else 2)
    along = SIZE.along * (1 if mesh.halved[1] else 2)
    assert mesh.sweep.shape == (along, around, SIZE.through_wall)
    assert mesh.elements.shape == (along * around * SIZE.through_wall, 20)
    assert np.array_equal(np.unique(mesh.elements), np.arange(len(mesh.points)))


@pytest.mark.parametrize("which", ["inner", "outer"])
def test_faces_cover_the_wall(mesh, which):
    """Nodes are at the wall's radius to round-off; the area is that of the cylinder.

    A parabola's length is a (1 + O(a^4)), with a factor under 1/10. The largest half angle, at the
    bottom, is 1.6 pi / 24: 2e-4 is sufficient.
    """
    faces = mesh.inner_faces if which == "inner" else mesh.outer_faces
    radius = INNER if which == "inner" else OUTER
    corners = mesh.points[faces]
    assert corners.shape == (np.prod(mesh.sweep.shape[:2]), 8, 3)
    assert np.hypot(corners[..., 0], corners[..., 1]) == pytest.approx(radius, rel=1e-14)
    area = np.asarray(contact.areas(corners, QUAD8.slopes, QUAD8.weights))
    assert area.min() > 0
    assert mesh.copies * area.sum() == pytest.approx(2 * np.pi * radius * 2 * REACH, rel=2e-4)


def test_faces_follow_the_elements_in_order(mesh):
    """The k-th face of either wall belongs to the k-th column of elements through the wall."""
    columns = mesh.elements.reshape(-1, SIZE.through_wall, 20)
    for faces, layer, side in ((mesh.inner_faces, 0, -1), (mesh.outer_faces, -1, 1)):
        own = columns[:, layer][:, HEX20.nodes[:, 0] == side]
        assert np.array_equal(np.sort(own, axis=1), np.sort(faces, axis=1))


def test_bottom_is_the_lowest_line_of_the_outer_wall(mesh):
    """All nodes at x = 0 and y = -R, one per station."""
    points = mesh.points[mesh.bottom]
    assert np.all(points[:, 0] == 0)
    assert points[:, 1] == pytest.approx(-OUTER, rel=1e-15)
    assert len(points) == 2 * mesh.sweep.shape[0] + 1


def test_place_moves_the_nodes_to_another_size(mesh):
    """The coordinates of the sweep give the mesh of a tube of another size, to round-off.

    The presses are at z = 0, whose station is the same for any reach.
    """
    other = Tube(inner_diameter=5e-3, wall_thickness=1e-3)
    anew = sweep(other, 40e-3, SIZE, halved=mesh.halved)
    placed = np.stack(mesh.sweep.place(5e-3, 1e-3, 40e-3), axis=-1)
    assert np.abs(placed - anew.points).max() < 1e-15
