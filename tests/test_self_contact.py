"""Contact of the inner wall with itself, against finite differences and the geometry."""

from dataclasses import replace

import ipctk
import numpy as np
import pytest
from scipy.spatial import cKDTree

from acoustube.indentation.mesh import Mesh, MeshSize, sweep
from acoustube.indentation.reference_element import TET10, TRI6
from acoustube.indentation.self_contact import (
    BARRIER_STIFFNESS,
    STEP_SAFETY_FACTOR,
    gap_at_pressure,
    self_contact,
    triangulated,
)
from acoustube.tube import Tube

TUBE = Tube()
RADIUS = TUBE.inner_diameter / 2
DISTANCE = 0.1e-3  # range of the barrier between the walls; half of the vertices' spacing
REACH = 4e-3
SIZE = MeshSize(through_wall=1, around=16, along=2, grading=0.1, fold=0.0, touch=0.0)
PARTS = {"quarter": (True, True), "half": (True, False), "whole": (False, False)}


def flattened(mesh, gap, askew=0.0):
    """Return the positions of nodes when the bore is pinched in the middle to a given height.

    The section is a dumbbell, y (gap / 2R + (x / R)^2), whose walls meet nowhere else. With the two
    walls shifted against each other (askew) no vertex is exactly above another, where the formula
    of their distance changes.
    """
    x, y, z = mesh.points.T
    squeeze = gap / (2 * RADIUS)
    pinched = y * (squeeze + (1 - squeeze) * (x / RADIUS) ** 2)
    return np.stack([x + askew * y, pinched, z + 0.5 * askew * y], axis=-1)


@pytest.fixture(scope="module", params=PARTS)
def mesh(request):
    return sweep(TUBE, REACH, SIZE, halved=PARTS[request.param])


@pytest.fixture(scope="module")
def quarter():
    return sweep(TUBE, REACH, SIZE)


@pytest.fixture(scope="module")
def lumen(quarter):
    return self_contact(quarter, TUBE.shear_modulus, DISTANCE)


def moved(mesh, seed=0):
    """Return a random dimensionless motion of the inner wall's nodes."""
    direction = np.zeros_like(mesh.points)
    inner = np.unique(mesh.inner_faces)
    direction[inner] = np.random.default_rng(seed).normal(size=(len(inner), 3))
    return direction


# The barrier


@pytest.mark.parametrize("share", [0.3, 0.55, 0.8])
def test_barrier_forces_are_the_slope_of_its_energy(quarter, lumen, share):
    """Central difference over 1e-9 m along a random motion, at gaps within the barrier distance.

    The truncation error is some (1e-9 / gap)^2 = 1e-9, the round-off 1e-7 of the energy's change.
    """
    position, direction, step = (
        flattened(quarter, share * DISTANCE, askew=0.013),
        moved(quarter),
        1e-9,
    )
    energy, gradient = lumen.energy_and_forces(position)
    assert energy > 0
    ahead, behind = (
        lumen.energy_and_forces(position + side * step * direction)[0] for side in (1, -1)
    )
    slope = np.sum(gradient * direction)
    assert (ahead - behind) / (2 * step) == pytest.approx(slope, rel=1e-5)


@pytest.mark.parametrize("share", [0.3, 0.55, 0.8])
def test_barrier_tangent_is_the_slope_of_its_forces(quarter, lumen, share):
    """The same central difference; symmetric to round-off."""
    position, direction, step = (
        flattened(quarter, share * DISTANCE, askew=0.013),
        moved(quarter),
        1e-9,
    )
    tangent = lumen.tangent(position)
    ahead, behind = (
        lumen.energy_and_forces(position + side * step * direction)[1].ravel() for side in (1, -1)
    )
    change = (ahead - behind) / (2 * step)
    assert tangent @ direction.ravel() == pytest.approx(change, abs=1e-4 * np.abs(change).max())
    assert abs(tangent - tangent.T).max() < 1e-10 * abs(tangent).max()


@pytest.mark.parametrize("share", [0.3, 0.55, 0.8])
def test_barrier_forces_change_with_the_undeformed_wall_as_they_do_on_another_tube(share):
    """The derivative is a central difference between tubes that are 1e-6 wider.

    Displacements are fixed. The nodes of the wider bore also move along it, so that areas and
    angles of the triangles change.
    """
    tube = sweep(TUBE, REACH, SIZE)
    displacement = flattened(tube, share * DISTANCE, askew=0.013) - tube.points
    motion = tube.points * np.array([1.0, 1.0, 0.3]) + 0.1 * tube.points[:, [1, 2, 0]]
    lumen = self_contact(tube, TUBE.shear_modulus, DISTANCE)
    found = lumen.forces_along(tube.points + displacement, motion)
    forces = []
    for step in (1e-6, -1e-6):
        points = tube.points + step * motion
        other = self_contact(replace(tube, points=points), TUBE.shear_modulus, DISTANCE)
        forces.append(other.energy_and_forces(points + displacement)[1])
    change = (forces[0] - forces[1]) / 2e-6
    assert np.abs(found - change).max() < 1e-6 * np.abs(change).max()


def test_barrier_pushes_the_walls_apart_and_nothing_else(mesh):
    """There is no net force and no net moment, to round-off, and the upper wall is pushed up.

    The lateral force is some per cent, as far as the bore is askew.
    """
    lumen = self_contact(mesh, TUBE.shear_modulus, DISTANCE)
    position = flattened(mesh, 0.5 * DISTANCE, askew=0.013)
    _, gradient = lumen.energy_and_forces(position)
    scale = np.abs(gradient).sum()
    assert np.abs(gradient.sum(axis=0)).max() < 1e-12 * scale
    moment = np.cross(position, gradient).sum(axis=0)
    assert np.abs(moment).max() < 1e-12 * scale * np.abs(position).max()
    x, y, _ = gradient[mesh.points[:, 1] > 1e-9].sum(axis=0)
    assert y < 0
    assert abs(x) < 0.05 * abs(y)
    assert not np.any(gradient[mesh.sweep.layer > 0])


def test_barrier_is_zero_beyond_its_distance(mesh):
    """Exactly zero at rest and at any gap above the distance; positive just below."""
    lumen = self_contact(mesh, TUBE.shear_modulus, DISTANCE)
    for position in (mesh.points, flattened(mesh, 1.01 * DISTANCE)):
        energy, gradient = lumen.energy_and_forces(position)
        assert energy == 0.0
        assert not np.any(gradient)
        assert lumen.tangent(position) is None
    assert lumen.energy_and_forces(flattened(mesh, 0.9 * DISTANCE))[0] > 0


def test_barrier_grows_without_bound_as_the_walls_meet(quarter, lumen):
    """Like a logarithm: the energy rises by a constant each time the gap falls by ten.

    Measured: 7.3e-5 J, 5.6e-5, 5.4e-5, 5.3e-5.
    """
    stored = [
        lumen.energy_and_forces(flattened(quarter, DISTANCE * 10.0**-n))[0] for n in range(1, 6)
    ]
    rise = np.diff(stored)
    assert np.all(rise > 0)
    assert rise[-1] > 0.9 * rise[-2]


def test_energy_does_not_depend_on_the_unit_of_length():
    """A tube ten times as large in all dimensions stores a thousand times the energy.

    The barrier is an energy per volume times a shear modulus; to 1e-6, the library's tolerances.
    """
    stored = []
    for scale in (1.0, 10.0):
        tube = Tube(inner_diameter=scale * TUBE.inner_diameter, wall_thickness=scale * 1.6e-3)
        mesh = sweep(tube, scale * REACH, SIZE)
        lumen = self_contact(mesh, TUBE.shear_modulus, scale * DISTANCE)
        small = Mesh(mesh.points / scale, *[None] * 3, mesh.reference, mesh.halved, mesh.sweep)
        position = scale * flattened(small, 0.5 * DISTANCE)
        stored.append(lumen.energy_and_forces(position)[0])
    assert stored[1] == pytest.approx(1e3 * stored[0], rel=1e-6)


# Steps


def test_a_step_that_would_cross_is_stopped_short_of_the_first_collision(quarter, lumen):
    """For a step from a gap g to -g the walls meet half-way; the safe share of that is taken.

    The ridges are a = 0.05 mm to either side, and are polygons of vertices 0.2 mm apart: they meet
    later, by 2 a^2 / R to 5 um of 2 g = 100 um. The check errs on the safe side, by a tenth.
    """
    gap = 0.5 * DISTANCE
    start, end = (flattened(quarter, side * gap, askew=0.013) for side in (1, -1))
    share = lumen.collision_free_fraction(start, end)
    assert 0.9 * STEP_SAFETY_FACTOR * 0.5 < share < STEP_SAFETY_FACTOR * 0.55
    stopped = start + share * (end - start)
    height = (lumen.sampling @ stopped)[:, 1]
    above = (lumen.sampling @ quarter.points)[:, 1] > 0
    assert height[above].min() > height[~above].max()
    assert lumen.energy_and_forces(stopped)[0] > lumen.energy_and_forces(start)[0]


def test_a_step_without_collision_is_taken_whole(quarter, lumen):
    start = flattened(quarter, 5 * DISTANCE)
    assert lumen.collision_free_fraction(start, flattened(quarter, 3 * DISTANCE)) == 1.0
    assert lumen.collision_free_fraction(start, start + np.array([1e-3, 2e-3, -1e-3])) == 1.0


# Triangles


def areas(vertices, triangles):
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


def test_vertices_lie_on_the_quadratic_faces(mesh):
    """Vertices lie on the parabola x = 1 - (1 - cos a) (y / sin a)^2 of each element's arc.

    x points to the middle of the arc, of half angle a, on a circle of radius 1; to round-off.
    """
    sampling, _ = triangulated(mesh)
    x, y, z = (sampling @ mesh.points / RADIUS).T
    half_angle = np.pi / (2 * SIZE.around)
    angle = np.arctan2(x, -y)
    turned = angle - (np.floor(angle / (2 * half_angle) + 1e-9) + 0.5) * 2 * half_angle
    radius = np.hypot(x, y)
    out, along = radius * np.cos(turned), radius * np.sin(turned)
    parabola = 1 - (1 - np.cos(half_angle)) * (along / np.sin(half_angle)) ** 2
    assert out == pytest.approx(parabola, abs=1e-12)
    assert np.abs(z).max() == pytest.approx(REACH / RADIUS, rel=1e-12)


@pytest.mark.parametrize("parts", [1, 3, 4])
def test_no_vertex_is_there_twice(mesh, parts):
    """There are as many as in a structured grid, and no two closer than a tenth of its spacing."""
    sampling, triangles = triangulated(mesh, parts=parts)
    along, around, _ = mesh.sweep.shape
    rings, columns = parts * along + 1, parts * around + (1 if mesh.halved[0] else 0)
    vertices = sampling @ mesh.points
    assert sampling.shape == (rings * columns, len(mesh.points))
    assert triangles.shape == (2 * along * around * parts**2, 3)
    assert np.array_equal(np.unique(triangles), np.arange(len(vertices)))
    distance, _ = cKDTree(vertices).query(vertices, k=2)
    assert distance[:, 1].min() > 0.1 * np.pi * RADIUS / (SIZE.around * parts)
    assert sampling.sum(axis=1) == pytest.approx(1.0, abs=1e-12)


def test_triangles_are_joined_and_all_turned_the_same_way(mesh):
    """Each edge belongs to at most two triangles, which pass it in opposite directions.

    Edges with one triangle are those of the rims: both ends, and both seams of a half.
    """
    _, triangles = triangulated(mesh)
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    assert len(np.unique(edges, axis=0)) == len(edges)
    _, count = np.unique(np.sort(edges, axis=1), axis=0, return_counts=True)
    along, around, _ = mesh.sweep.shape
    rims = 2 * 4 * around + (2 * 4 * along if mesh.halved[0] else 0)
    assert count.max() == 2
    assert np.sum(count == 1) == rims


def test_triangles_area_converges_to_that_of_the_wall(quarter):
    """With the square of the number of parts; the rest is the parabolas' own error."""
    face = quarter.face
    corners = quarter.points[quarter.inner_faces]
    tangents = np.einsum("fni,qnj->fqij", corners, face.slopes)
    normal = np.cross(tangents[..., 0], tangents[..., 1])
    exact = np.sum(np.linalg.norm(normal, axis=-1) * face.weights)
    assert exact == pytest.approx(np.pi * RADIUS * REACH, rel=1e-4)
    error = []
    for parts in (2, 4, 8):
        sampling, triangles = triangulated(quarter, parts=parts)
        error.append(exact - areas(sampling @ quarter.points, triangles).sum())
    assert np.log2(np.array(error[:-1]) / error[1:]) == pytest.approx([2.0, 2.0], abs=0.02)


def curved_triangles():
    """Return a mesh of two six-node triangles that share an edge, on z = x^2 - x y / 2.

    Their map is the identity in x and y, so that the quadratic surface is represented exactly.
    """
    corners = np.array([[0, 0], [1, 0], [0, 1], [1, 1]])
    faces = []
    for a, b, c in ((0, 1, 2), (1, 3, 2)):
        origin, one, two = corners[[a, b, c]]
        faces.append(origin + TRI6.nodes @ np.array([one - origin, two - origin]))
    places, number = np.unique(np.concatenate(faces), axis=0, return_inverse=True)
    x, y = places.T
    points = 1e-3 * np.column_stack([x, y, x**2 - x * y / 2])
    faces = number.reshape(2, 6)
    return Mesh(points, np.zeros((0, 10), int), faces, faces, TET10, (False, False))


@pytest.mark.parametrize("parts", [1, 2, 5])
def test_six_node_triangles_are_sampled_on_their_surface(parts):
    """(n + 1)^2 vertices on the square, n^2 triangles for each face, equally oriented."""
    mesh = curved_triangles()
    assert len(mesh.points) == 9
    sampling, triangles = triangulated(mesh, parts=parts)
    x, y, z = 1e3 * (sampling @ mesh.points).T
    assert len(x) == (parts + 1) ** 2
    assert z == pytest.approx(x**2 - x * y / 2, abs=1e-12)
    grid = np.round(np.column_stack([x, y]) * parts, 9)
    assert np.array_equal(grid, np.round(grid))
    assert triangles.shape == (2 * parts**2, 3)
    a, b, c = (np.column_stack([x, y])[triangles[:, i]] for i in range(3))
    turn = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert turn == pytest.approx(1 / parts**2, rel=1e-9)


def test_triangles_of_six_node_faces_have_the_surfaces_area():
    """int sqrt(1 + z_x^2 + z_y^2) by TRI6's rule and by 40 parts: (1 / 40)^2 / 10 apart."""
    mesh = curved_triangles()
    tangents = np.einsum("fni,qnj->fqij", mesh.points[mesh.inner_faces], TRI6.slopes)
    normal = np.cross(tangents[..., 0], tangents[..., 1])
    exact = np.sum(np.linalg.norm(normal, axis=-1) * TRI6.weights)
    sampling, triangles = triangulated(mesh, parts=40)
    assert areas(sampling @ mesh.points, triangles).sum() == pytest.approx(exact, rel=2e-4)


def test_another_wall_may_be_sampled(quarter):
    """Vertices of the outer wall are at its radius, within the parabola's sagitta a^4 / 8."""
    sampling, _ = triangulated(quarter, quarter.outer_faces)
    vertices = sampling @ quarter.points
    outer = TUBE.outer_diameter / 2
    radius = np.hypot(vertices[:, 0], vertices[:, 1])
    assert radius == pytest.approx(outer, rel=(np.pi / 16) ** 4 / 8)


def test_pressure_of_a_gap_is_that_between_level_plates():
    """Plates of side 1 in 8 by 8 squares.

    The weights of the pairs of nodes, edges and faces do not add up to one exactly: 0.9 to 1.7.
    """
    n, distance, modulus = 9, 2.5e-3, 1.0
    x, z = (part.ravel() for part in np.meshgrid(*[np.linspace(0, 1, n)] * 2, indexing="ij"))
    number = np.arange(n * n).reshape(n, n)
    a, b, c, d = (
        number[i : n - 1 + i, j : n - 1 + j].ravel() for i, j in ((0, 0), (1, 0), (0, 1), (1, 1))
    )
    lower = np.concatenate([np.stack([a, c, b], -1), np.stack([b, c, d], -1)])
    faces = np.concatenate([lower, lower[:, ::-1] + n * n]).astype(np.int32)
    for pressure in (0.05, 0.5):
        gap = gap_at_pressure(pressure, distance, modulus)
        heights = (np.repeat([0, y], n * n) for y in (1.0, gap))
        rest, near = (
            np.asfortranarray(np.stack([np.tile(x, 2), y, np.tile(z, 2)], -1)) for y in heights
        )
        mesh = ipctk.CollisionMesh(rest, ipctk.edges(faces), faces)
        pairs = ipctk.NormalCollisions()
        pairs.use_area_weighting = True
        pairs.collision_set_type = ipctk.NormalCollisions.CollisionSetType.IMPROVED_MAX_APPROX
        pairs.build(mesh, near, distance)
        barrier = ipctk.BarrierPotential(
            distance, BARRIER_STIFFNESS * modulus, use_physical_barrier=True
        )
        force = barrier.gradient(pairs, mesh, near).reshape(-1, 3)[n * n :, 1].sum()
        assert 0.9 * pressure < abs(force) < 1.7 * pressure


def test_gap_falls_with_pressure_from_the_activation_distance_on():
    """The energy's pole dominates high pressures: p = 2 K / r, as for very soft walls."""
    gaps = [gap_at_pressure(p, 1.0, 1.0) for p in (-1.0, 0.0, 1.0, 2.9e5, 3.1e5, 1e12)]
    assert gaps[:2] == [1.0, 1.0]
    assert np.all(np.diff(gaps[1:]) < 0)
    assert gaps[3:5] == pytest.approx([0.6 / 2.9e5, 0.6 / 3.1e5], rel=1e-5)
    assert gaps[5] == pytest.approx(0.6e-12)
