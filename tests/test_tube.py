"""The tube's material constants and its mesh, against the geometry that the mesh stands for."""

import numpy as np
import pytest

from acoustube.errors import ConfigError
from acoustube.indentation import contact, element
from acoustube.tube import MeshSize, Tube, quarter_mesh, shear_modulus_from_shore

HALF_LENGTH = 60e-3
TUBE = Tube()
SIZE = MeshSize(through_wall=2, around=12, along=5)
INNER, OUTER = TUBE.inner_diameter / 2, TUBE.outer_diameter / 2


@pytest.fixture(scope="module")
def mesh():
    return quarter_mesh(TUBE, HALF_LENGTH, SIZE)


def interpolated_sector(half_angle):
    """Return the area of a sector with a parabolic arc, over the circle's.

    The arc through (cos a, -sin a), (1, 0), (cos a, sin a) is x = 1 - (1 - cos a) s^2,
    y = s sin a; 1/2 int (x dy - y dx) = sin a (4 - cos a) / 3, which is a (1 - a^4/30 + ...).
    """
    return np.sin(half_angle) * (4 - np.cos(half_angle)) / (3 * half_angle)


def test_shore_35_has_the_papers_shear_modulus():
    """0.5074 MPa is what the paper rounds to; half of its last digit."""
    assert shear_modulus_from_shore(35.0) == pytest.approx(0.5074e6, abs=50.0)
    assert Tube().shear_modulus == shear_modulus_from_shore(35.0)


def test_bulk_modulus_of_silicone_is_50_shear_moduli():
    """nu = 0.49: K / mu = 2 x 1.49 / 0.06 = 49.67. nu = 0 leaves K = 2 mu / 3."""
    tube = Tube(poisson_ratio=0.49)
    assert tube.bulk_modulus / tube.shear_modulus == pytest.approx(49.67, abs=0.005)
    assert Tube(poisson_ratio=0.0, shear_modulus=3.0).bulk_modulus == pytest.approx(2.0)


@pytest.mark.parametrize("around", [3, 12])
def test_mesh_volume_is_the_half_annulus_to_the_interpolation_error(around):
    """The quadrature is exact for these maps, so that what is missing is the parabolas' share.

    a^4 / 30 with a = pi / (2 around): 2.5e-3 for 3 elements, 9.8e-6 for the default 12.
    """
    size = MeshSize(through_wall=2, around=around, along=3)
    mesh = quarter_mesh(TUBE, HALF_LENGTH, size)
    volume = element.quadrature(mesh.points[mesh.elements]).weights.sum()
    exact = np.pi / 2 * (OUTER**2 - INNER**2) * HALF_LENGTH
    half_angle = np.pi / (2 * around)
    assert volume == pytest.approx(exact * interpolated_sector(half_angle), rel=1e-12)
    assert 1 - volume / exact == pytest.approx(half_angle**4 / 30, rel=0.1)


def test_jacobians_are_positive_out_to_the_corners(mesh):
    """At the Gauss points and at all 27 nodes; their signs are the elements' handedness."""
    corners = mesh.points[mesh.elements]
    assert element.quadrature(corners).weights.min() > 0
    grid = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    _, slopes = element.shape_functions(grid)
    assert np.linalg.det(np.einsum("eni,qnj->eqij", corners, slopes)).min() > 0


def test_nodes_lie_on_circles_from_bottom_to_top(mesh):
    """Evenly spaced radii and angles, within round-off; exactly on the plane x = 0 at both ends."""
    x, y, _ = np.moveaxis(mesh.nodes, -1, 0)
    radius = np.linspace(INNER, OUTER, 5)
    assert np.hypot(x, y) == pytest.approx(np.broadcast_to(radius, x.shape), rel=1e-14)
    angle = np.linspace(0, np.pi, 25)[:, None]
    assert np.arctan2(x, -y) == pytest.approx(np.broadcast_to(angle, x.shape), abs=1e-14)
    assert np.all(x[:, [0, -1]] == 0.0)
    assert np.all(y[:, 0] < 0)
    assert np.all(y[:, -1] > 0)


def test_stations_run_from_the_press_and_are_graded_towards_it(mesh):
    """sinh(g i / n) / sinh(g), nearly g / sinh(g) of an even division at the press."""
    z = mesh.nodes[:, 0, 0, 2]
    assert np.all(mesh.nodes[..., 2] == z[:, None, None])
    assert z[0] == 0.0
    assert z[-1] == pytest.approx(HALF_LENGTH, rel=1e-15)
    edges = z[::2]
    even = HALF_LENGTH / SIZE.along
    assert edges[1] / even == pytest.approx(SIZE.grading / np.sinh(SIZE.grading), rel=0.06)
    assert np.all(np.diff(edges, 2) > 0)
    assert z[1::2] == pytest.approx((edges[1:] + edges[:-1]) / 2, rel=1e-14)


def test_nodes_are_numbered_with_the_axial_station_slowest(mesh):
    """So that an element spans three stations of numbers only: the bandwidth."""
    n_along, n_around, n_through, _ = mesh.nodes.shape
    assert (n_along, n_around, n_through) == (11, 25, 5)
    assert np.all(np.diff(mesh.points[:, 2]) >= 0)
    span = mesh.elements.max(axis=1) - mesh.elements.min(axis=1)
    assert span.max() < 3 * n_around * n_through


def test_elements_have_the_local_order_of_the_shape_functions(mesh):
    """Local coordinates run through the wall, around, along; every node belongs to an element."""
    corners = mesh.points[mesh.elements].reshape(-1, 3, 3, 3, 3)  # along, around, through
    radius = np.hypot(corners[..., 0], corners[..., 1])
    angle = np.arctan2(corners[..., 0], -corners[..., 1])
    assert np.all(np.diff(corners[..., 2], axis=1) > 0)
    assert np.all(np.diff(angle, axis=2) > 0)
    assert np.all(np.diff(radius, axis=3) > 0)
    assert mesh.elements.shape == (SIZE.along * SIZE.around * SIZE.through_wall, 27)
    assert np.array_equal(np.unique(mesh.elements), np.arange(len(mesh.points)))


def test_outer_faces_cover_the_outer_wall(mesh):
    """On the outer radius within round-off; half a cylinder's area.

    A parabola's length is a (1 + O(a^4)), with a factor under 1/10: 3e-5 is ample at a = pi / 24.
    """
    corners = mesh.points[mesh.outer_faces]
    assert corners.shape == (SIZE.along * SIZE.around, 9, 3)
    assert np.hypot(corners[..., 0], corners[..., 1]) == pytest.approx(OUTER, rel=1e-14)
    area = contact.areas(corners)
    assert area.min() > 0
    assert area.sum() == pytest.approx(np.pi * OUTER * HALF_LENGTH, rel=3e-5)


@pytest.mark.parametrize("name", ["inner_diameter", "wall_thickness", "length", "shear_modulus"])
@pytest.mark.parametrize("value", [0.0, -1e-3, np.nan, np.inf])
def test_impossible_sizes_are_refused_by_name(name, value):
    with pytest.raises(ConfigError, match=f"{name} = {value}"):
        Tube(**{name: value})


@pytest.mark.parametrize("value", [0.5, -0.1, np.nan])
def test_impossible_poisson_ratio_is_refused(value):
    with pytest.raises(ConfigError, match=f"poisson_ratio = {value}"):
        Tube(poisson_ratio=value)
