"""Cut cells against exact geometry: volumes by the divergence theorem are exact to rounding."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull, HalfspaceIntersection
from wave_lumens import BORE, pinched_tube, straight_tube

from acoustube.waves.grid import small_cells
from acoustube.waves.grid.cells import _shortened, cut_cells, with_straight_ends
from acoustube.waves.grid.polyhedron import cut_polyhedron
from acoustube.waves.grid.repeated_layers import without_repeated_layers
from acoustube.waves.grid.small_cells import share_small_volumes

SHAPE, SPACING, ORIGIN = (15, 14, 13), (0.10, 0.11, 0.12), (-0.75, -0.75, -0.75)


def rotated_box():
    box = trimesh.creation.box((0.7, 0.5, 0.6))
    box.apply_transform(trimesh.transformations.rotation_matrix(0.7, (1, 2, 3)))
    return box


def cell_wise_volume(box, cell):
    """The volume of one cell inside a convex body, by intersecting half-spaces."""
    lower = np.array(ORIGIN) + np.array(cell) * SPACING
    upper = lower + SPACING
    faces = np.hstack(
        [box.face_normals, -np.sum(box.face_normals * box.triangles[:, 0], axis=1)[:, None]]
    )
    sides = np.vstack(
        [np.hstack([np.eye(3), -upper[:, None]]), np.hstack([-np.eye(3), lower[:, None]])]
    )
    points = np.random.default_rng(0).uniform(lower, upper, (4000, 3))
    distance = (points @ faces[:, :3].T + faces[:, 3]).max(axis=1)
    if distance.min() > -1e-4:
        return None  # the reference has no safe interior point
    body = HalfspaceIntersection(np.vstack([faces, sides]), points[distance.argmin()])
    return ConvexHull(body.intersections).volume / np.prod(SPACING)


def test_fractions_of_a_rotated_box_match_half_space_intersection():
    """The reference is qhull, which is accurate to 1e-9 in these small cells."""
    box = rotated_box()
    volume = cut_polyhedron(box.triangles, ORIGIN, SPACING, SHAPE).volume
    cut = np.argwhere((volume > 0.05) & (volume < 0.95))[::7]
    compared = [(volume[tuple(c)], cell_wise_volume(box, c)) for c in cut]
    compared = [pair for pair in compared if pair[1] is not None]
    assert len(compared) > 20
    np.testing.assert_allclose(*np.transpose(compared), rtol=0, atol=1e-9)


@pytest.mark.parametrize("shift", [(0, 0, 0), (0.05, 0, 0.03), (0.0123, 0.0771, 0.0456)])
@pytest.mark.parametrize("body", [rotated_box(), trimesh.creation.icosphere(3, radius=0.4)])
def test_total_volume_equals_mesh_volume_at_any_offset(body, shift):
    """The sum over the cells is the polyhedron's volume up to rounding."""
    parts = cut_polyhedron(body.triangles + np.array(shift), ORIGIN, SPACING, SHAPE)
    assert parts.volume.sum() * np.prod(SPACING) == pytest.approx(body.volume, rel=1e-12)
    for part in parts:
        assert part.min() >= 0.0
        assert part.max() <= 1.0


def test_body_on_grid_planes_fills_its_cells_exactly():
    """Faces in grid planes belong to the side of the lumen: no layer is counted by half."""
    box = trimesh.creation.box((0.4, 0.44, 0.48))
    parts = cut_polyhedron(box.triangles, (-0.5, -0.55, -0.6), SPACING, (10, 10, 10))
    expected = np.zeros((10, 10, 10))
    expected[3:7, 3:7, 3:7] = 1.0
    np.testing.assert_allclose(parts.volume, expected, atol=1e-12)
    assert parts.open_x[3].max() == 0.0
    assert parts.open_x[4, 3:7, 3:7].min() == pytest.approx(1.0)


def test_open_areas_close_every_cell():
    """Signed open faces plus the vector area of the wall vanish in each cell.

    The wall's area inside each cell comes from an independent quadrature: every triangle is
    subdivided until its pieces are small against a cell, and each piece is attributed to the cell
    of its centroid. Pieces that straddle a plane leave an error of their size, 2e-2 of a face.
    """
    sphere = trimesh.creation.icosphere(3, radius=0.4)
    parts = cut_polyhedron(sphere.triangles, ORIGIN, SPACING, SHAPE)
    fine = sphere
    for _ in range(4):
        fine = fine.subdivide()
    vector = fine.face_normals * fine.area_faces[:, None]
    cell = np.floor((fine.triangles_center - ORIGIN) / SPACING).astype(int)
    for axis in range(3):
        wall = np.zeros(SHAPE)
        np.add.at(wall, tuple(cell.T), vector[:, axis] * SPACING[axis] / np.prod(SPACING))
        gap = np.diff(parts[1 + axis], axis=axis) + wall
        assert np.abs(gap).max() < 2e-2
        assert np.sqrt(np.mean(gap[wall != 0.0] ** 2)) < 4e-3


@pytest.mark.parametrize("axis", [1, 2])
def test_volume_is_the_same_whichever_axis_is_integrated(axis):
    """The divergence theorem along y or z gives the volumes found along x."""
    body, order = rotated_box(), np.roll([0, 1, 2], -axis)
    direct = cut_polyhedron(body.triangles, ORIGIN, SPACING, SHAPE).volume
    turned = cut_polyhedron(
        body.triangles[:, :, order],
        np.array(ORIGIN)[order],
        np.array(SPACING)[order],
        tuple(np.array(SHAPE)[order]),
    ).volume
    np.testing.assert_allclose(turned.transpose(np.argsort(order)), direct, atol=1e-12)


def test_half_model_equals_half_of_the_full_one():
    """Cutting at x = 0 changes nothing but the symmetry plane itself."""
    tube = pinched_tube(0.02)
    spacing = 2 * BORE / 16
    full, half = cut_cells(tube, spacing), cut_cells(tube, spacing, half=True)
    middle = full.shape[0] // 2
    np.testing.assert_allclose(half.volume_fraction, full.volume_fraction[middle:], atol=1e-12)
    np.testing.assert_allclose(half.open_y, full.open_y[middle:], atol=1e-12)
    np.testing.assert_allclose(half.open_z, full.open_z[middle:], atol=1e-12)
    np.testing.assert_allclose(half.open_x[1:], full.open_x[middle + 1 :], atol=1e-12)
    assert half.open_x[0].max() == 0.0


def test_first_layer_is_full_and_the_last_ends_at_the_cap():
    """Layers are centred on z = k dz; the half outside the tube is filled by its mirror image."""
    tube, spacing = straight_tube(0.0103), 5e-4
    cells = cut_cells(tube, spacing)
    section = tube.volume / 0.0103
    assert cells.centres(2)[0] == pytest.approx(0.0, abs=1e-15)
    np.testing.assert_allclose(cells.area()[:-1], section, rtol=1e-12)
    covered = 0.0103 - (cells.shape[2] - 1.5) * spacing
    assert cells.area()[-1] == pytest.approx(section * covered / spacing, rel=1e-9)


def test_sharing_keeps_volume_and_the_plane_wave():
    """Volumes move between neighbours; in a straight tube volumes stay equal to axial faces."""
    cells = with_straight_ends(cut_cells(straight_tube(0.01), 2 * BORE / 32), 0, 6)
    shared = share_small_volumes(cells)
    assert shared.volume_fraction.sum() == pytest.approx(cells.volume_fraction.sum(), rel=1e-9)
    inner = shared.open_z[..., 1:-1]
    np.testing.assert_allclose(inner, shared.volume_fraction[..., :-1], atol=1e-12)
    np.testing.assert_allclose(inner, shared.volume_fraction[..., 1:], atol=1e-12)


def test_sharing_keeps_the_volume_of_a_pinched_lumen():
    """Padding of cells, the last resort, changes the volume by less than 1e-4."""
    cells = cut_cells(pinched_tube(0.02, 0.7), 2 * BORE / 24)
    shared = share_small_volumes(cells)
    assert shared.volume_fraction.sum() == pytest.approx(cells.volume_fraction.sum(), rel=1e-4)
    assert shared.open_z.sum() == pytest.approx(cells.open_z.sum(), rel=1e-5)
    assert shared.open_z.min() >= 0.0


def test_open_surface_is_refused():
    tube = straight_tube(0.01)
    tube.faces = tube.faces[5:]
    with pytest.raises(ValueError, match="not closed"):
        cut_cells(tube, 5e-4)


def long_tube():
    """A pinched tube between straight ends of different lengths, neither in whole layers."""
    tube = pinched_tube(0.0722, 0.7, width=3e-3, centre=0.03)
    straight = np.abs(tube.vertices[:, 2] - 0.03) > 0.012  # the round bore up to exp(-16)
    round_bore = pinched_tube(0.0722, 0.0)
    return trimesh.Trimesh(
        np.where(straight[:, None], round_bore.vertices, tube.vertices), tube.faces, process=False
    )


@pytest.mark.parametrize("half", [False, True])
def test_copied_layers_of_straight_ends_are_those_that_would_be_cut(half):
    """The reference is the surface narrowed by up to 1e-7, which has no layers to copy."""
    tube, spacing = long_tube(), (2 * BORE / 16, 2 * BORE / 16, 4.3e-4)
    narrowing = tube.copy()
    narrowing.vertices[:, :2] *= 1.0 - 1e-7 * narrowing.vertices[:, 2:] / 0.0722
    assert len(set(_shortened(np.asarray(narrowing.triangles), spacing[2])[1])) == 169
    assert len(set(_shortened(np.asarray(tube.triangles), spacing[2])[1])) < 75
    copied, cut = (cut_cells(each, spacing, half=half) for each in (tube, narrowing))
    assert copied.shape == cut.shape
    assert copied.length == cut.length
    for name in ("volume_fraction", "open_x", "open_y", "open_z"):
        np.testing.assert_allclose(getattr(copied, name), getattr(cut, name), atol=1e-5)


def rectangular_duct(subdivisions):
    """Duct 8 mm wide and high, 30 mm long, with walls on the planes of a grid of 0.5 mm."""
    duct = trimesh.creation.box((8e-3, 8e-3, 30e-3))
    duct.apply_translation((0, 0, 15e-3))
    for _ in range(subdivisions):
        duct = duct.subdivide()
    return duct


@pytest.mark.parametrize("subdivisions", [0, 5])
def test_walls_on_grid_planes_close_the_cells_within(subdivisions):
    """For facets of any size; some fine ones are within the copied layers."""
    cells = cut_cells(rectangular_duct(subdivisions), 5e-4)
    full = np.zeros(cells.shape)
    full[:, :, :-1], full[:, :, -1] = 1.0, 0.5
    inside = (np.abs(cells.centres(0)) < 4e-3)[:, None] & (np.abs(cells.centres(1)) < 4e-3)
    np.testing.assert_allclose(cells.volume_fraction, full * inside[:, :, None], atol=1e-9)
    np.testing.assert_allclose(cells.open_x[[0, -1]], 0.0, atol=1e-9)
    np.testing.assert_allclose(cells.open_x[1:-1], full[1:] * inside[1:, :, None], atol=1e-9)


def test_facets_of_a_straight_wall_may_have_any_shape():
    """The walls of a duct are triangulated at random; copying layers must not turn the facets."""
    rng = np.random.default_rng(3)
    duct = rectangular_duct(4)
    transverse, along = np.abs(duct.vertices[:, :2]), duct.vertices[:, 2:]
    moved = (transverse.max(axis=1) > 3.99e-3) & (transverse.min(axis=1) < 3.99e-3)
    moved &= np.abs(along[:, 0] - 15e-3) < 14.9e-3
    shift = rng.uniform(-1e-4, 1e-4, (len(duct.vertices), 3))
    shift[:, :2][transverse > 3.99e-3] = 0.0
    duct.vertices = duct.vertices + np.where(moved[:, None], shift, 0.0)
    cells, regular = cut_cells(duct, 5e-4), cut_cells(rectangular_duct(0), 5e-4)
    np.testing.assert_allclose(cells.volume_fraction, regular.volume_fraction, atol=1e-9)


def test_sharing_is_the_same_without_repeated_layers(monkeypatch):
    """Cells of a long straight end share volume as those of a short one do."""
    cells = with_straight_ends(cut_cells(pinched_tube(0.02, 0.7), 2 * BORE / 24), 40, 40)
    short, layers = without_repeated_layers(cells, 3)
    assert short.shape[2] < cells.shape[2] - 60
    for name in ("volume_fraction", "open_x", "open_y"):
        np.testing.assert_array_equal(getattr(short, name)[..., layers], getattr(cells, name))
    shared = share_small_volumes(cells)
    all_layers = np.arange(cells.shape[2])
    monkeypatch.setattr(
        small_cells, "without_repeated_layers", lambda cells, _: (cells, all_layers)
    )
    whole = share_small_volumes(cells)
    np.testing.assert_array_equal(shared.volume_fraction, whole.volume_fraction)
    np.testing.assert_array_equal(shared.open_z, whole.open_z)
