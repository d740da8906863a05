"""Tetrahedra of imported walls, against geometry, closed forms and the hexahedra of round tubes."""

import dataclasses
import itertools
import re
from functools import cache
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from refusals import refused
from scipy.sparse.linalg import splu
from solids import HEXAHEDRA_AT_4_MM, neo_hookean_solid, nodal_forces, quadrature

from acoustube.base.errors import ConfigError
from acoustube.indentation import Indenter, boundary_nodes, element, indent, tetrahedra
from acoustube.indentation.linear_solver import pattern
from acoustube.indentation.mesh import Mesh
from acoustube.indentation.reference_element import TET10, edges, gauss
from acoustube.indentation.tetrahedra import TetrahedronSize, tetrahedral_mesh
from acoustube.indentation.wall_surface import separate_walls, tube_of
from acoustube.runs.imported_wall import read_surface

pytestmark = pytest.mark.usefixtures("double_precision")

MU, K = 0.5e6, 25e6
BORE, WALL, LENGTH = 7.9, 1.6, 160.0  # the default tube, in mm, cut shorter
COARSE = TetrahedronSize(fine=1.5, coarse=1.5)
AROUND = 128  # facets; the chords leave the circle by 1.2 um, the area by 0.04 %
D_BORE = Path(__file__).parents[1] / "meshes" / "d_bore.stl"


def round_tube(bore=BORE, wall=WALL, length=LENGTH, along=4):
    """Return a round tube's surface in mm."""
    inside, outside = bore / 2, bore / 2 + wall
    z = np.linspace(-length / 2, length / 2, along + 1)
    outline = [(outside, s) for s in z] + [(inside, s) for s in z[::-1]]
    return trimesh.creation.revolve(np.array([*outline, outline[0]]), sections=AROUND)


def written(surface, name="wall.stl"):
    surface.export(name)
    return name


@pytest.fixture(scope="module")
def surface(tmp_path_factory):
    path = tmp_path_factory.mktemp("walls") / "round.stl"
    round_tube().export(path)
    return read_surface(path)


@pytest.fixture(scope="module")
def quarter(surface):
    """A coarse quarter of a short piece."""
    size = TetrahedronSize(fine=1.2, coarse=1.5)
    return tetrahedral_mesh(surface, reach=10e-3, halved=(True, True), size=size)


def straightened(mesh):
    points = mesh.points.copy()
    ends = mesh.elements[:, np.array(edges(3))]
    points[mesh.elements[:, 4:]] = mesh.points[ends].mean(axis=2)
    return dataclasses.replace(mesh, points=points)


# --- the surface


@pytest.mark.parametrize("name", ["wall.stl", "wall.ply", "wall.obj"])
def test_every_format_gives_the_same_tube_in_metres(name):
    """STL stores single precision, 1e-7 of 80 mm."""
    found = read_surface(written(round_tube(), name))
    np.testing.assert_allclose(found.extents, [11.1e-3, 11.1e-3, 160e-3], rtol=1e-6)
    np.testing.assert_allclose(found.bounds.sum(axis=0), 0, atol=2e-8)


def test_inside_out_surface_is_turned():
    wall = round_tube()
    wall.invert()
    assert read_surface(written(wall)).volume > 0


def test_walls_and_scales_are_those_of_the_round_tube(surface):
    """A polygon's volume over its mean perimeter is the wall times cos(pi / n): 0.03 % less."""
    inner, outer, thickness = separate_walls(surface)
    assert np.hypot(*inner.vertices[:, :2].T).max() < 3.96e-3
    assert np.hypot(*outer.vertices[:, :2].T).min() > 5.54e-3
    assert thickness == pytest.approx(1.6e-3, rel=4e-4)
    tube = tube_of(surface, shear_modulus=MU, poisson_ratio=0.49)
    assert tube.inner_diameter == pytest.approx(7.9e-3, rel=1e-6)
    assert tube.length == pytest.approx(0.16, rel=1e-6)


def test_d_bore_is_as_high_as_its_script_says():
    """The flat is 2.2 mm below the middle, the top 3.95 mm above it."""
    tube = tube_of(read_surface(D_BORE), shear_modulus=MU, poisson_ratio=0.49)
    assert tube.inner_diameter == pytest.approx(6.15e-3, rel=1e-6)
    assert 1.6e-3 < tube.wall_thickness < 2.2e-3


def without_facets(n):
    wall = round_tube()
    wall.update_faces(np.arange(len(wall.faces)) >= n)
    return wall


def folded_through():
    """A tube whose inner wall crosses the outer one in the middle."""
    wall = round_tube()
    middle = np.isclose(wall.vertices[:, 2], 0) & (
        np.hypot(*wall.vertices[:, :2].T) < BORE / 2 + 0.1
    )
    wall.vertices[middle, :2] *= 1.6
    return wall


def on_its_side():
    wall = round_tube()
    wall.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    return wall


@pytest.mark.parametrize(
    ("wall", "what"),
    [
        (lambda: without_facets(1), "not closed: 3 edges"),
        (folded_through, "intersects itself"),
        (lambda: trimesh.creation.cylinder(5, 100), "has 0 holes"),
        (on_its_side, "not a tube along z"),
        (lambda: trimesh.creation.torus(8, 2), "not a tube along z"),
        (lambda: round_tube() + round_tube().apply_translation([20, 0, 0]), "2 separate bodies"),
        (lambda: round_tube().apply_scale(1e-3), "160 mm if its numbers were metres"),
    ],
    ids=["hole", "crossing", "rod", "turned", "torus", "two", "metres"],
)
def test_surfaces_that_are_not_a_tube_are_refused(wall, what):
    with pytest.raises(ConfigError, match=what):
        read_surface(written(wall()))


def test_missing_and_unreadable_files_are_refused():
    with pytest.raises(ConfigError, match="does not exist"):
        read_surface("nowhere.stl")
    Path("words.obj").write_text("this is no surface\n")
    with pytest.raises(ConfigError, match=re.escape("words.obj")):
        read_surface("words.obj")


def test_walls_too_thin_to_mesh_are_refused_with_their_thickness():
    foil = read_surface(written(round_tube(wall=0.1)))
    with pytest.raises(ConfigError, match=r"0\.1 mm thick in the mean, is too thin"):
        tetrahedral_mesh(foil, reach=50e-3)
    worn = round_tube()
    bore = np.hypot(*worn.vertices[:, :2].T) < BORE / 2 + 0.1
    worn.vertices[bore, 1] += 1.5
    with pytest.raises(ConfigError, match=r"0\.1 mm thick at its thinnest place"):
        tetrahedral_mesh(read_surface(written(worn)), reach=50e-3)


@pytest.mark.parametrize(
    ("values", "setting"),
    [({"fine": 0.0}, "fine"), ({"coarse": np.nan}, "coarse"), ({"near": -1.0}, "near"),
     ({"near": 3.0}, "near"), ({"near": 2.0, "far": 1.0}, "near")],
)  # fmt: skip
def test_impossible_edge_lengths_are_refused(values, setting):
    refused(lambda: TetrahedronSize(**values), setting=setting)


def test_piece_longer_than_the_tube_is_refused(surface):
    with pytest.raises(ConfigError, match=r"reach = 0\.09 m, .* is not between 0 and 0\.08 m"):
        tetrahedral_mesh(surface, reach=90e-3)


# --- the mesh


def test_mesh_has_the_volume_of_the_surface(surface, quarter):
    """Sides that follow the facets to within a thousandth of the wall lose less than 0.2 %."""
    rule = quadrature(quarter.points[quarter.elements], TET10)
    expected = surface.volume * (10 / 160) / 2
    assert np.sum(rule.weights) == pytest.approx(expected, rel=2e-3)
    assert np.min(rule.weights) > 0


def test_walls_and_symmetry_planes_are_where_they_belong(quarter):
    """Nodes on facets are inside their circle by up to 1.2 um, on the outer wall by 1.7 um.

    One in a hundred may stay where the mesher put it, for the quality of its elements, within the
    envelope.
    """
    inner, outer = (np.unique(faces) for faces in (quarter.inner_faces, quarter.outer_faces))
    radius = np.hypot(*quarter.points[:, :2].T)
    for nodes, wall in ((inner, 3.95e-3), (outer, 5.55e-3)):
        off = np.abs(radius[nodes] - wall)
        assert np.mean(off < 2e-6) > 0.99
        assert off.max() < 1.5 * boundary_nodes.ENVELOPE * 1.6e-3
    assert quarter.points[:, [0, 2]].min() == 0
    assert quarter.points[:, 2].max() == 10e-3
    sides = np.concatenate([quarter.inner_faces, quarter.outer_faces])
    every = boundary_nodes.boundary_faces(quarter.elements, quarter.points)
    sides, every = ({tuple(sorted(face)) for face in faces} for faces in (sides, every))
    faces = np.array(list(every - sides))
    x, z = quarter.points[faces][..., 0], quarter.points[faces][..., 2]
    planes = [np.all(at, axis=1) for at in (x == 0, z == 0, z == 10e-3)]
    assert min(plane.sum() for plane in planes) > 20
    assert np.all(np.sum(planes, axis=0) == 1)


def test_faces_cover_the_walls_with_normals_away_from_the_axis(quarter):
    """The area of the facets is the circle's less 1e-4; the curved sides add as little."""
    for faces, radius in ((quarter.inner_faces, 3.95e-3), (quarter.outer_faces, 5.55e-3)):
        points = quarter.points[faces]
        tangents = np.einsum("fni,qnj->fqij", points, quarter.face.slopes)
        normal = np.cross(tangents[..., 0], tangents[..., 1])
        position = np.einsum("fni,qn->fqi", points, quarter.face.shapes)
        assert np.all(np.sum(normal * position * [1, 1, 0], axis=-1) > 0)
        area = np.sum(np.linalg.norm(normal, axis=-1) * quarter.face.weights)
        assert area == pytest.approx(np.pi * radius * 10e-3, rel=1e-3)


def test_only_symmetries_that_the_wall_has_are_used():
    """A bore off the middle by half a wall has a mirror image along the tube only."""
    wall = round_tube()
    bore = np.hypot(*wall.vertices[:, :2].T) < BORE / 2 + 0.1
    wall.vertices[bore, 0] += 0.8
    size = TetrahedronSize(fine=1.5, coarse=1.5)
    mesh = tetrahedral_mesh(read_surface(written(wall)), reach=5e-3, halved=(True, True), size=size)
    assert mesh.halved == (False, True)


def test_element_whose_curved_side_would_turn_it_over_stays_straight():
    """The middle of one edge is moved through the opposite corner, that of another one a little."""
    straight = TET10.nodes
    target = straight.copy()
    target[4] = straight[3]
    kept = boundary_nodes.limit_distortion(straight, target, np.arange(10)[None])
    np.testing.assert_array_equal(kept, straight)
    target[4] = straight[4] + [0, -0.02, 0]
    moved = boundary_nodes.limit_distortion(straight, target, np.arange(10)[None])
    np.testing.assert_array_equal(moved, target)


# --- the elements


def test_affine_displacement_leaves_inner_nodes_of_straight_elements_free(quarter):
    """Inner forces cancel to round-off, 1e-11 of the largest; curved sides would leave 1e-3."""
    mesh = straightened(quarter)
    stretch = np.array([[0.2, 0.1, -0.1], [0.05, -0.1, 0.2], [-0.15, 0.1, 0.05]])
    forces = nodal_forces(mesh, neo_hookean_solid(MU, K), mesh.points @ stretch.T)
    faces = mesh.elements[:, boundary_nodes.TETRAHEDRON_FACES].reshape(-1, 6)
    _, first, count = np.unique(
        np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
    )
    inside = np.setdiff1d(np.arange(len(mesh.points)), faces[first[count == 1]])
    assert len(inside) > 100
    assert np.abs(forces[inside]).max() < 1e-11 * np.abs(forces).max()


def test_rigid_rotation_leaves_curved_elements_without_force(quarter):
    """Round-off, 1e-16 of K = 50 mu, is 1e-12 of the forces of a stretch by 1 %."""
    material = neo_hookean_solid(MU, K)
    turn = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])[:3, :3]
    rotated = nodal_forces(quarter, material, quarter.points @ turn.T - quarter.points)
    stretched = nodal_forces(quarter, material, 0.01 * quarter.points)
    assert np.abs(rotated).max() < 1e-10 * np.abs(stretched).max()


def cube(n):
    """Return the unit cube as n^3 boxes of six tetrahedra each."""
    axis = np.arange(2 * n + 1) / (2 * n)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    places = (2 * n + 1) ** np.arange(2, -1, -1)
    corners = np.array(
        [
            np.cumsum(np.vstack([np.zeros(3, int), np.eye(3, dtype=int)[list(order)]]), axis=0)
            for order in itertools.permutations(range(3))
        ]
    )
    starts = np.array(list(itertools.product(range(n), repeat=3)))
    odd = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0
    corners[odd] = corners[odd][:, [0, 2, 1, 3]]
    middles = corners[:, np.array(edges(3))].sum(axis=2)
    local = np.concatenate([2 * corners, middles], axis=1)
    elements = ((2 * starts[:, None, None] + local) @ places).reshape(-1, 10)
    none = np.zeros((0, 6), int)
    return Mesh(points, elements, none, none, TET10, (False, False))


def exact(point):
    """A smooth displacement whose dilatation is of the order mu / K of its gradient."""

    def potential(p):
        return jnp.stack([jnp.sin(2 * p[1] + p[2]), jnp.cos(p[2] - p[0]), jnp.sin(p[0] + 2 * p[1])])

    slope = jax.jacfwd(potential)(point)
    curl = jnp.stack(
        [slope[2, 1] - slope[1, 2], slope[0, 2] - slope[2, 0], slope[1, 0] - slope[0, 1]]
    )
    squeeze = jnp.stack([jnp.sin(3 * point[0]), jnp.sin(3 * point[1]), jnp.sin(3 * point[2])])
    return curl + MU / K * squeeze


def body_force(point):
    """Minus the divergence of Hooke's stress."""

    def stress(p):
        slope = jax.jacfwd(exact)(p)
        strain, dilatation = (slope + slope.T) / 2, jnp.trace(slope)
        return 2 * MU * strain + (K - 2 / 3 * MU) * dilatation * jnp.eye(3)

    return -jnp.einsum("ijj->i", jax.jacfwd(stress)(point))


@cache
def boundary_force():
    """Return the work of the boundary's tractions on a stretch along x, the integral of t_x x.

    By the divergence theorem, the integral of the stress s_xx less x times the body force; with ten
    Gauss points per edge exact to round-off.
    """
    points, weights = gauss(10, 3)
    points, weights = (points + 1) / 2, weights / 8

    def density(point):
        slope = jax.jacfwd(exact)(point)
        stress = 2 * MU * slope[0, 0] + (K - 2 / 3 * MU) * jnp.trace(slope)
        return stress - point[0] * body_force(point)[0]

    return float(weights @ jax.jit(jax.vmap(density))(points))


forces_at = jax.jit(jax.vmap(jax.vmap(body_force)))


def matrices_and_loads(corners):
    """Return the matrices and loads of 48 elements, for which both are compiled once."""
    rule = quadrature(corners, TET10)
    matrices = element.tangents(np.zeros_like(corners), rule, neo_hookean_solid(MU, K))
    force = np.asarray(forces_at(np.einsum("qn,eni->eqi", TET10.shapes, corners)))
    return matrices, np.einsum("eq,qn,eqi->eni", rule.weights, TET10.shapes, force)


def errors_of_the_cube(n):
    """Return errors of the nodes' displacements, and of the force, with exact boundary values.

    Root mean square in m, and relative error of the result of :func:`boundary_force`.
    """
    mesh = cube(n)
    wanted = np.asarray(jax.jit(jax.vmap(exact))(mesh.points))
    inside = np.all((mesh.points > 0) & (mesh.points < 1), axis=1)
    parts = [
        matrices_and_loads(part) for part in np.split(mesh.points[mesh.elements], (n // 2) ** 3)
    ]
    matrices, loads = (np.concatenate(some) for some in zip(*parts, strict=True))
    load = np.zeros_like(mesh.points)
    np.add.at(load, mesh.elements, loads)
    lower = pattern(np.ones_like(wanted, bool), [mesh.elements]).assemble([matrices])
    stiffness = (lower + lower.T).tocsr()
    stiffness.setdiag(lower.diagonal())
    free = np.repeat(inside, 3)
    right = load.ravel()[free] - (stiffness[free][:, ~free] @ wanted.ravel()[~free])
    found = wanted.ravel().copy()
    found[free] = splu(stiffness[free][:, free].tocsc()).solve(right)
    reaction = (stiffness @ found - load.ravel()).reshape(-1, 3)
    stretched = float(reaction[:, 0] @ mesh.points[:, 0])
    off = np.sqrt(np.mean((found - wanted.ravel())[free] ** 2))
    return off, abs(stretched / boundary_force() - 1)


def test_displacement_converges_with_order_two_to_three_and_force_with_order_four():
    """Quadratic displacements have order 3, a constant pressure in each element order 2.

    Measured with 2, 4 and 6 elements per edge: 2.4 and 2.2 for the displacement, 4.06 and 4.02 for
    the force. Linear elements have order 2 at best, and order 1.2 with this bulk modulus.
    """
    n = np.array([2, 4, 6])
    errors = np.array([errors_of_the_cube(count) for count in n])
    orders = np.diff(np.log(errors), axis=0) / -np.diff(np.log(n))[:, None]
    assert np.all((orders[:, 0] > 2.1) & (orders[:, 0] < 2.7))
    assert orders[:, 1] == pytest.approx([4.0, 4.0], abs=0.2)


PIECE = 5e-3
"""Length in m of the quarter that is filled in the tests of bad draws."""


def filled_quarter():
    """Return points in m and tetrahedra of a quarter of the tube: bricks, each cut in six."""
    n = np.array([4, 12, 4])  # through the wall, around and along: more than one around any node
    r, angle, z = (np.linspace(0, 1, k + 1) for k in n)
    r, angle, z = np.meshgrid(
        (BORE / 2 + WALL * r) / 1e3, np.pi * (angle - 0.5), PIECE * z, indexing="ij"
    )
    points = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=-1).reshape(-1, 3)
    strides = np.array([(n[1] + 1) * (n[2] + 1), n[2] + 1, 1])
    first = np.stack(np.meshgrid(*map(np.arange, n), indexing="ij"), axis=-1) @ strides
    paths = [np.cumsum([0, *order]) for order in itertools.permutations(strides)]
    cells = (first.reshape(-1, 1, 1) + np.array(paths)).reshape(-1, 4)
    return points, tetrahedra._positively_oriented(points, cells)


@pytest.fixture
def same_draw(monkeypatch):
    """Fill the piece of these tests with the same sound tetrahedra in each attempt."""
    draw = filled_quarter()
    monkeypatch.setattr(tetrahedra, "_tetrahedralised", lambda *_: draw)


def test_a_mesh_whose_ends_are_not_all_plane_is_drawn_again(surface, monkeypatch):
    """A dent in a plane of symmetry, in the middle of the wall, counts as a third wall."""
    sound, cells = filled_quarter()
    dented = sound.copy()
    radius = np.hypot(*sound[:, :2].T)
    middle = (sound[:, 2] == 0) & np.isclose(radius, 1e-3 * (BORE + WALL) / 2)
    dented[np.flatnonzero(middle)[6], 2] = WALL / 4e3
    draws = [(dented, cells), (sound, cells)]
    monkeypatch.setattr(tetrahedra, "_tetrahedralised", lambda *_: draws.pop(0))
    tetrahedral_mesh(surface, reach=PIECE, halved=(True, True), size=COARSE)
    assert draws == []

    draws.extend([(dented, cells)] * tetrahedra.ATTEMPTS)
    with pytest.raises(ConfigError, match="3 separate sides"):
        tetrahedral_mesh(surface, reach=PIECE, halved=(True, True), size=COARSE)
    assert draws == []


@pytest.mark.usefixtures("same_draw")
def test_a_mesh_with_a_flat_element_is_drawn_again(surface, monkeypatch):
    """One element in twenty has four corners in one plane: its volume of zero makes forces NaN."""
    flat, shape = [True], boundary_nodes.quadratic
    # Nodes off a plane, in one mesh of twenty, are tested elsewhere: here only shapes count.
    monkeypatch.setattr(tetrahedra, "quadratic", lambda *piece: (shape(*piece)[0], 0.0))
    worst = tetrahedra.MIN_QUALITY

    def judged(*_):
        return np.array([(0.9 if flat and flat.pop() else 1.1) * worst, 1.0])

    monkeypatch.setattr(tetrahedra, "qualities", judged)
    tetrahedral_mesh(surface, reach=PIECE, halved=(True, True), size=COARSE)
    assert flat == []

    flat.extend([True] * tetrahedra.ATTEMPTS)
    with pytest.raises(ConfigError, match="could not be filled with well-shaped tetrahedra"):
        tetrahedral_mesh(surface, reach=PIECE, halved=(True, True), size=COARSE)
    assert flat == []


@pytest.mark.usefixtures("same_draw")
@pytest.mark.parametrize(
    ("shares", "taken"), [([0.5, 0.002, 0.0], 1), ([1.0, 0.2, 0.3], 1), ([0.01, 0.0], 0)]
)
def test_a_mesh_whose_nodes_are_astray_is_drawn_again(shares, taken, surface, monkeypatch):
    """Until one node in a hundred or fewer is astray; after three meshes the best is taken.

    It is taken with a note.
    """
    shape, drawn = boundary_nodes.quadratic, []

    def astray(*piece):
        drawn.append(shape(*piece)[0])
        return drawn[-1], shares[len(drawn) - 1]

    monkeypatch.setattr(tetrahedra, "quadratic", astray)
    monkeypatch.setattr(tetrahedra, "qualities", lambda *_: np.ones(1))
    monkeypatch.setattr(tetrahedra, "ATTEMPTS", 3)
    told = []
    mesh = tetrahedral_mesh(
        surface, reach=PIECE, halved=(True, True), size=COARSE, note=told.append
    )
    assert mesh is drawn[taken]
    over = shares[taken] > 0.01
    assert len(drawn) == (3 if over else taken + 1)
    assert [text[:16] for text in told] == ["20 % of the node"] * over


@pytest.mark.usefixtures("same_draw")
def test_mesh_with_a_node_off_a_plane_of_symmetry_is_never_taken(surface, monkeypatch):
    """Such a node would be unconstrained; `quadratic` reports it as a share of one."""
    shape = boundary_nodes.quadratic
    monkeypatch.setattr(tetrahedra, "quadratic", lambda *piece: (shape(*piece)[0], 1.0))
    with pytest.raises(ConfigError):
        tetrahedral_mesh(surface, reach=PIECE, halved=(True, True), size=COARSE)


def test_quality_of_a_regular_tetrahedron_is_one():
    corners = np.array([[1, 1, 1], [-1, 1, -1], [1, -1, -1], [-1, -1, 1]]) / 7
    points = np.concatenate([corners, [(corners[i] + corners[j]) / 2 for i, j in edges(3)]])
    assert tetrahedra.qualities(points, np.arange(10)[None]) == pytest.approx(1.0)


# --- presses

REACH = 40e-3
"""Meshed length in m on one side; 40 to 100 mm give the reference's force to 0.01 %."""


def pressed(surface, depth, support, size=None):
    tube = tube_of(surface, shear_modulus=507433.0, poisson_ratio=0.49)
    press = Indenter(diameter=25e-3)
    mesh = tetrahedral_mesh(surface, reach=REACH, halved=press.halves, size=size)
    assert mesh.halved == (True, True)
    return indent(tube, press, depth=depth, support=support, mesh=mesh)


@pytest.mark.slow
@pytest.mark.long
def test_force_of_tetrahedra_is_that_of_the_reference_and_of_hexahedra(surface):
    """Within 2 % at 4 mm of CalculiX's hexahedra (2.11272 N, known to 0.5 %) and of acoustube's.

    One element through the wall: measured 0.7 to 0.9 % too high; with the default's edges, two
    thirds as long, within 0.6 %.
    """
    size = TetrahedronSize(fine=1.0, coarse=2.0)
    tetrahedra = pressed(surface, 4e-3, "free", size).contact_force[-1]
    assert tetrahedra == pytest.approx(2.11272, rel=0.02)
    assert tetrahedra == pytest.approx(HEXAHEDRA_AT_4_MM, rel=0.02)


@pytest.mark.slow
@pytest.mark.long
def test_d_bore_is_pressed_to_three_fifths_of_its_height():
    """No increment fails, and no element comes near to inversion (J stays above 0.9)."""
    wall = read_surface(D_BORE)
    depth = 0.6 * tube_of(wall, shear_modulus=MU, poisson_ratio=0.49).inner_diameter
    press = pressed(wall, depth, "free", TetrahedronSize(fine=1.0, coarse=2.0))
    assert press.depth[-1] == pytest.approx(depth)
    assert np.all(np.diff(press.contact_force) > 0)
    assert press.smallest_volume_ratio.min() > 0.9
