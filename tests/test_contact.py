"""Laws of contact, shapes of the indenters, and the balance of forces in a pressed tube."""

import itertools
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.tree_util import Partial
from scipy.integrate import quad
from solids import bare_model, block, neo_hookean_solid
from threadpoolctl import threadpool_limits

from acoustube.base.errors import ConfigError
from acoustube.indentation import contact, distances, indent
from acoustube.indentation.assembly import evaluate, indenter_force
from acoustube.indentation.contact import Body
from acoustube.indentation.indenters import (
    Indenter,
    Layer,
    ground_body,
    indenter_bodies,
    touch_height,
)
from acoustube.indentation.mesh import MeshSize, sweep
from acoustube.indentation.newton import minimise
from acoustube.indentation.press import press_model
from acoustube.indentation.reference_element import QUAD8, TRI6
from acoustube.indentation.self_contact import triangulated
from acoustube.tube import Tube

pytestmark = pytest.mark.usefixtures("double_precision")

STIFFNESS, SMOOTHING = 1e11, 4e-6
MODULUS, THICKNESS = 0.1e6, 5e-3  # of the elastic layer
TUBE = Tube()
WALL = np.float64(TUBE.shear_modulus), np.float64(TUBE.wall_thickness)
ROD = 25e-3
DEPTH = 1e-3
TOLERANCE = 1e-9  # N
UP = np.array([0.0, 1.0, 0.0])


# Laws: energy per area over the gap


RIGID = partial(contact.penalty_energy, STIFFNESS, SMOOTHING)
LAYER = partial(contact.foundation_energy, MODULUS, THICKNESS, SMOOTHING)
LAWS = {"rigid": (RIGID, STIFFNESS), "layer": (LAYER, MODULUS / THICKNESS)}
CONTINUOUS = [("rigid", 0), ("rigid", 1), ("rigid", 2), ("layer", 0), ("layer", 1)]


def with_derivatives(law):
    return [law, jax.grad(law), jax.grad(jax.grad(law))]


@pytest.mark.parametrize(("name", "order"), CONTINUOUS)
@pytest.mark.parametrize("end", [-SMOOTHING, SMOOTHING])
def test_energy_and_its_derivatives_are_continuous_where_the_blend_ends(end, name, order):
    """Values on both sides of the end of the blend differ by no more than their slope.

    The third derivative jumps by k / (2 d): over 2e-6 d the second may change by 1e-6 k. Twice that
    is allowed, in units of k d^(2 - order). The layer's k is E / h; its energy and pressure are
    continuous, its stiffness is not.
    """
    law, stiffness = LAWS[name]
    step = 1e-6 * SMOOTHING
    derivative = with_derivatives(law)[order]
    below, above = (float(derivative(end + side)) for side in (-step, step))
    scale = stiffness * SMOOTHING ** (2 - order)
    slope = {0: 1.0, 1: 1.5, 2: 0.5}[order]  # of the derivative next to the end, at most
    assert abs(above - below) <= 4 * slope * 1e-6 * scale


@pytest.mark.parametrize("name", LAWS)
def test_contact_is_exactly_zero_beyond_the_blend(name):
    """Energy, pressure and stiffness are exactly zero at a distance."""
    for gap in (SMOOTHING, 1.5 * SMOOTHING, 1e-3):
        assert [float(f(gap)) for f in with_derivatives(LAWS[name][0])] == [0.0, 0.0, 0.0]


def test_penalty_is_a_straight_line_past_the_blend():
    """Energy k/2 g^2 + k d^2 / 6, pressure -k g, stiffness k; at g = 0 pressure k d / 4."""
    gap = -3 * SMOOTHING
    value, slope, curvature = (float(f(gap)) for f in with_derivatives(RIGID))
    assert value == pytest.approx(STIFFNESS * (gap**2 / 2 + SMOOTHING**2 / 6), rel=1e-12)
    assert slope == pytest.approx(STIFFNESS * gap, rel=1e-12)
    assert curvature == pytest.approx(STIFFNESS, rel=1e-12)
    assert float(jax.grad(RIGID)(0.0)) == pytest.approx(-STIFFNESS * SMOOTHING / 4, rel=1e-12)


@pytest.mark.parametrize("share", [0.01, 0.3, 0.9])
def test_layer_pressed_by_a_share_of_its_thickness_bears_minus_e_times_the_logarithm(share):
    """Pressure -E ln(1 - s), stiffness E / (h (1 - s)), energy E h ((1 - s) ln(1 - s) + s).

    The 12 digits of the energy are relative to E h, of which it is the small difference.
    """
    value, slope, curvature = (float(f(-share * THICKNESS)) for f in with_derivatives(LAYER))
    exact = (1 - share) * np.log(1 - share) + share
    assert value == pytest.approx(MODULUS * THICKNESS * exact, abs=1e-12 * MODULUS * THICKNESS)
    assert -slope == pytest.approx(-MODULUS * np.log(1 - share), rel=1e-12)
    assert curvature == pytest.approx(MODULUS / (THICKNESS * (1 - share)), rel=1e-12)


@pytest.mark.parametrize("name", LAWS)
def test_pressure_never_pulls_and_never_falls_with_penetration(name):
    """Pressure is positive and increases, to the round-off of a pressure k d."""
    law, stiffness = LAWS[name]
    gaps = jnp.linspace(2 * SMOOTHING, -4 * SMOOTHING, 601)
    pressure = -jax.vmap(jax.grad(law))(gaps)
    least = -1e-9 * stiffness * SMOOTHING
    assert jnp.all(pressure >= least)
    assert jnp.all(jnp.diff(pressure) >= least)


# Shapes: the signed distance against the nearest point of the surface


RADIUS, EDGE, X, Z, YAW = 4e-3, 0.7e-3, 0.5e-3, -0.3e-3, 0.6
GAPS = {
    "rod": Partial(distances.rod_gap, RADIUS, X, Z, YAW),
    "sphere": Partial(distances.sphere_gap, RADIUS, X, Z),
    "punch": Partial(distances.punch_gap, RADIUS, EDGE, X, Z),
}


def rod_surface(u, v):
    """Surface of a cylinder, 30 mm of it, whose axis is turned from x towards z by the yaw."""
    along = np.array([np.cos(YAW), 0.0, np.sin(YAW)])
    across = np.array([-np.sin(YAW), 0.0, np.cos(YAW)])
    turn = 2 * np.pi * v
    ring = np.cos(turn) * UP[:, None, None] + np.sin(turn) * across[:, None, None]
    line = 30e-3 * (u - 0.5) * along[:, None, None]
    return np.array([X, RADIUS, Z])[:, None, None] + line + RADIUS * ring


def sphere_surface(u, v):
    polar, turn = np.pi * u, 2 * np.pi * v
    unit = np.array([np.sin(polar) * np.cos(turn), np.cos(polar), np.sin(polar) * np.sin(turn)])
    return np.array([X, RADIUS, Z])[:, None, None] + RADIUS * unit


def punch_surface(u, v):
    """Flat end, quarter circle and 10 mm of the side, by arc length along the profile."""
    flat, arc, side = RADIUS - EDGE, np.pi / 2 * EDGE, 10e-3
    s = u * (flat + arc + side)
    angle = np.clip((s - flat) / EDGE, 0, np.pi / 2)
    radius = np.minimum(s, flat) + EDGE * np.sin(angle)
    height = EDGE * (1 - np.cos(angle)) + np.maximum(s - flat - arc, 0)
    turn = 2 * np.pi * v
    return np.array([X + radius * np.cos(turn), height, Z + radius * np.sin(turn)])


SURFACES = {"rod": rod_surface, "sphere": sphere_surface, "punch": punch_surface}


def nearest(surface, point):
    """Return the least distance to a surface, by a search on ever smaller windows.

    Each of nine zooms keeps a tenth of the last window, which holds the nearest point: the square
    of the last spacing is far below the round-off.
    """
    centre, half = np.array([0.5, 0.5]), 0.5
    for _ in range(10):
        u, v = (np.linspace(c - half, c + half, 81) for c in centre)
        grid = np.meshgrid(np.clip(u, 0, 1), v, indexing="ij")
        distance = np.linalg.norm(surface(*grid) - point[:, None, None], axis=0)
        i, j = np.unravel_index(np.argmin(distance), distance.shape)
        centre, half = np.array([u[i], v[j]]), half / 10
    return distance.min()


def around_the_tool(n=40):
    """Return points in a box around the lower end of the tools; some are inside a tool."""
    rng = np.random.default_rng(4)
    return rng.uniform([-6e-3, -2e-3, -6e-3], [6e-3, 6e-3, 6e-3], (n, 3))


def is_inside(name, point):
    x, y, z = point - [X, 0.0, Z]
    if name == "sphere":
        return x**2 + (y - RADIUS) ** 2 + z**2 < RADIUS**2
    if name == "rod":
        across = z * np.cos(YAW) - x * np.sin(YAW)
        return across**2 + (y - RADIUS) ** 2 < RADIUS**2
    rho = np.hypot(x, z)
    in_corner = rho > RADIUS - EDGE and y < EDGE
    rounded = np.hypot(rho - RADIUS + EDGE, y - EDGE) < EDGE
    return rho < RADIUS and y > 0 and (rounded or not in_corner)


@pytest.mark.parametrize("name", GAPS)
def test_gap_is_the_distance_to_the_nearest_point_of_the_surface(name):
    """The gap equals the distance found by search, to 1e-10 m; it is negative inside."""
    gap = jax.jit(GAPS[name])
    inside = [is_inside(name, point) for point in around_the_tool()]
    assert 5 < sum(inside) < 35
    for point, within in zip(around_the_tool(), inside, strict=True):
        exact = nearest(SURFACES[name], point) * (-1 if within else 1)
        assert float(gap(point)) == pytest.approx(exact, abs=1e-10)


@pytest.mark.parametrize("name", GAPS)
def test_gradient_of_the_gap_has_length_one(name):
    """The gradient of a signed distance has length one, outside and just inside, to round-off."""
    points = jnp.asarray(around_the_tool())
    gaps, slopes = jax.jit(jax.vmap(jax.value_and_grad(GAPS[name])))(points)
    outside = np.asarray(gaps) > 0
    assert outside.sum() > 5
    assert np.linalg.norm(slopes, axis=1)[outside] == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("name", GAPS)
def test_gap_has_finite_derivatives_on_every_line_where_its_formula_changes(name):
    """Derivatives are finite on the axis, at the lowest point, the flat end and the edge's start.

    They are not where the nearest point is not unique: on a rod's axis and at a sphere's centre.
    """
    across = [0.0, 1e-6, RADIUS - EDGE, RADIUS, 6e-3]
    heights = [-1e-3, 0.0, 1e-6, EDGE, 2e-3]
    offsets = [(x, y) for x, y in itertools.product(across, heights)]
    points = jnp.array([[X + x, y, Z] for x, y in offsets])
    slopes = jax.jit(jax.vmap(jax.grad(GAPS[name])))(points)
    curvatures = jax.jit(jax.vmap(jax.hessian(GAPS[name])))(points)
    assert np.all(np.isfinite(slopes))
    assert np.all(np.isfinite(curvatures))
    assert np.linalg.norm(slopes, axis=1).max() < 1 + 1e-9


def test_flat_end_of_a_punch_is_flat_up_to_its_axis():
    """Under the end and just inside it the gap is the height difference, with zero curvature."""
    offsets = itertools.product([0.0, 1e-9, 1e-3, 3.2e-3], [-1e-3, 0.0, 1e-5])
    points = jnp.array([[X + x, y, Z] for x, y in offsets])
    gaps, slopes = jax.jit(jax.vmap(jax.value_and_grad(GAPS["punch"])))(points)
    assert np.asarray(gaps) == pytest.approx(-np.asarray(points)[:, 1], abs=1e-15)
    assert np.abs(slopes - jnp.array([[0.0, -1.0, 0.0]])).max() < 1e-12
    assert np.abs(jax.jit(jax.vmap(jax.hessian(GAPS["punch"])))(points)).max() < 1e-9


def test_ground_is_as_high_as_asked():
    floor = ground_body(*WALL, -6e-3, None)
    for y, distance in ((-5e-3, 1e-3), (-7e-3, -1e-3)):
        assert float(floor.gap(jnp.array([1.0, y - floor.height, 2.0]))) == pytest.approx(distance)


def test_ground_is_rigid_or_the_layer_that_is_asked_for():
    """At 0.1 mm the pressure is E ln(1 - s) of the layer, over 100 times that of a floor."""
    gap = -1e-4
    soft = ground_body(*WALL, 0.0, Layer(thickness=THICKNESS, modulus=MODULUS))
    pressure = -float(jax.grad(soft.law)(gap))
    assert pressure == pytest.approx(-MODULUS * np.log(1 + gap / THICKNESS), rel=1e-12)
    assert -float(jax.grad(ground_body(*WALL, 0.0, None).law)(gap)) > 100 * pressure


# First touch


@pytest.fixture(scope="module")
def outer_wall():
    """Points of the outer wall, 68 um apart in the circumferential direction."""
    mesh = sweep(TUBE, 20e-3, MeshSize(through_wall=1, around=64, along=6, fold=0.0))
    sampling, _ = triangulated(mesh, mesh.outer_faces)
    return sampling @ mesh.points


R = TUBE.outer_diameter / 2


@pytest.mark.parametrize("shape", ["rod", "sphere", "punch"])
def test_a_tool_over_the_axis_touches_the_top_line(outer_wall, shape):
    """At the outer radius, to round-off: the top line has a vertex at the press."""
    gap = Indenter(shape=shape, diameter=8e-3).gap()
    assert touch_height(outer_wall, gap) == pytest.approx(R, abs=1e-12)


@pytest.mark.parametrize("x", [1e-3, 3e-3])
def test_a_sphere_beside_the_axis_touches_where_the_circles_do(outer_wall, x):
    """Two circles R and r touch when their centres are R + r apart: h = sqrt(..) - r.

    The nearest vertex is up to 34 um from the point of contact. Over this distance the gap between
    two circles grows by s^2 (1/R + 1/r) / 2, which is up to 0.25 um: 0.5 um is allowed.
    """
    r = 4e-3
    height = touch_height(outer_wall, Indenter(shape="sphere", diameter=2 * r, x=x).gap())
    assert height == pytest.approx(np.sqrt((R + r) ** 2 - x**2) - r, abs=0.5e-6)


def test_a_punch_beside_the_axis_touches_with_its_edge(outer_wall):
    """The edge, a circle e about (x - r + e, h + e), touches the tube's, as for spheres."""
    r, e, x = 4e-3, 0.4e-3, 6e-3
    press = Indenter(shape="punch", diameter=2 * r, x=x, edge_radius=e)
    height = touch_height(outer_wall, press.gap())
    # The error by the spacing goes as 1 / e: 34 um lead to 1.6 um.
    exact = np.sqrt((R + e) ** 2 - (x - r + e) ** 2) - e
    assert height == pytest.approx(exact, abs=2e-6)


@pytest.mark.parametrize("edge", [0.4e-3, None])
def test_gap_to_a_punch_of_another_diameter_is_that_of_a_new_punch(edge):
    """A given edge radius stays; the default one is a tenth of the new radius."""
    point = np.array([3.9e-3, 0.2e-3, 0.0])
    first, other = (Indenter(shape="punch", diameter=d, edge_radius=edge) for d in (8e-3, 8.4e-3))
    assert first.gap(8.4e-3)(point) == pytest.approx(float(other.gap()(point)), rel=1e-12)


def test_a_yawed_rod_touches_at_the_height_of_the_top_line(outer_wall):
    """The lowest line of an endless rod crosses the tube's top line at any angle."""
    gap = Indenter(shape="rod", diameter=10e-3, yaw=0.5).gap()
    assert touch_height(outer_wall, gap) == pytest.approx(R, abs=1e-12)


@pytest.mark.parametrize("shape", ["sphere", "punch"])
def test_a_press_that_misses_is_refused(outer_wall, shape):
    """The tool is beside the tube, by more than the sum of both radii."""
    gap = Indenter(shape=shape, diameter=4e-3, x=R + 2.1e-3).gap()
    with pytest.raises(ConfigError, match="misses the tube"):
        touch_height(outer_wall, gap)


# Forces on the faces


def body(gap, height, law=RIGID):
    return Body(gap, np.float64(height), Partial(law.func, *map(np.float64, law.args)))


FLOOR = Partial(distances.floor_gap)
TOUCH, TANGENTS, FORCE = (
    jax.jit(function, static_argnames="face")
    for function in (contact.energies_and_forces, contact.tangents, contact.force)
)


def areas(corners, face):
    return contact.areas(corners, face.slopes, face.weights)


def test_flat_face_pressed_on_the_floor_bears_stiffness_times_depth_times_area():
    """The nodal forces are k g A times the integrals of the shape functions.

    These are -1/12 for each corner and 1/3 for each midside node. Forces at nodes alone could not
    pull at the corners; it is the pressure at the quadrature points that is one-sided.
    """
    width, length, depth = 2e-3, 3e-3, 10e-6
    corners = (QUAD8.nodes + 1) / 2 * [width, length]
    face = np.insert(corners, 1, -0.006 - depth, axis=1)[None]
    area = areas(face, QUAD8)
    assert area.sum() == pytest.approx(width * length, rel=1e-12)
    floor = body(FLOOR, -0.006)
    _, gradient = TOUCH(face, area, QUAD8, (floor,))
    force = -np.asarray(gradient)[0]
    share = np.where(np.any(QUAD8.nodes == 0, axis=1), 1 / 3, -1 / 12)
    assert force[:, 1] == pytest.approx(STIFFNESS * depth * width * length * share, rel=1e-9)
    assert np.abs(force[:, [0, 2]]).max() == 0.0
    on_floor = FORCE(face, area, QUAD8, floor)
    assert float(on_floor) == pytest.approx(-STIFFNESS * depth * width * length, rel=1e-9)


def test_triangle_pressed_on_the_floor_bears_it_at_the_middles_of_its_edges():
    """Shape functions integrate to 0 at each corner, a third of k g A at each midside node."""
    width, length, depth = 2e-3, 3e-3, 10e-6
    face = np.insert(TRI6.nodes * [width, length], 1, -depth, axis=1)[None]
    area = areas(face, TRI6)
    floor = body(FLOOR, 0.0)
    _, gradient = TOUCH(face, area, TRI6, (floor,))
    total = STIFFNESS * depth * width * length / 2
    exact = total * np.array([0, 0, 0, 1, 1, 1]) / 3
    assert -np.asarray(gradient)[0][:, 1] == pytest.approx(exact, abs=1e-9 * total)


@pytest.mark.parametrize("name", GAPS)
def test_contact_forces_and_tangents_are_derivatives_of_the_energy(name):
    """Forces and tangents are central differences over 1e-9 m, to 1e-6 of the largest entry.

    The face is curved and follows the tool 8 um inside it, where the law is a parabola; there are
    two bodies.
    """
    rng = np.random.default_rng(3)
    flat = np.array([X, Z]) + (QUAD8.nodes + 1) * [0.3e-3, 0.4e-3]
    rise = np.array([-float(GAPS[name](jnp.array([x, 0.0, z]))) for x, z in flat])
    face = np.insert(flat, 1, 0.02 - rise + 8e-6, axis=1)[None]
    both = (body(GAPS[name], 0.02), body(FLOOR, 0.02 - 2e-6))
    area, step = areas(face, QUAD8), 1e-9
    direction = rng.normal(size=face.shape)
    energy = check_derivatives(face, area, QUAD8, both, step, direction)
    assert energy > 0


LAYER_BODY = ground_body(*WALL, 0.0, Layer(thickness=THICKNESS, modulus=MODULUS))


@pytest.mark.parametrize("reference", [QUAD8, TRI6], ids=["quad", "triangle"])
@pytest.mark.parametrize("degrees", [0, 50, 90])
def test_forces_and_tangents_of_a_layer_include_the_area_that_the_wall_covers(degrees, reference):
    """The same on a curved face 1 mm deep in the layer: level, inclined, and vertical.

    The face is stretched by a tenth. On the vertical one the covered area is within its blend.
    """
    rng = np.random.default_rng(5)
    x, z = 1e-3 * reference.nodes.T
    bent = np.stack([x, 20 * x**2 - 1e-3, z], axis=-1)[None]
    area = areas(bent, reference)
    turn = np.deg2rad(degrees)
    cos, sin = np.cos(turn), np.sin(turn)
    face = bent * [1.1, 1.0, 1.0] @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
    face[..., 1] += -1e-3 - face[..., 1].max()
    direction = rng.normal(size=face.shape)
    assert check_derivatives(face, area, reference, (LAYER_BODY,), 1e-9, direction) > 0


def check_derivatives(face, area, reference, bodies, step, direction):
    """Compare force and tangent with central differences, to 1e-6; return the energy in J."""
    ahead, behind = (
        TOUCH(face + side * step * direction, area, reference, bodies) for side in (1, -1)
    )
    energy, gradient = TOUCH(face, area, reference, bodies)
    slope = float((ahead[0] - behind[0])[0] / (2 * step))
    assert slope == pytest.approx(float(jnp.sum(gradient * direction)), rel=1e-6)
    change = np.ravel(ahead[1] - behind[1]) / (2 * step)
    tangent = np.asarray(TANGENTS(face, area, reference, bodies))[0]
    assert tangent @ direction.ravel() == pytest.approx(change, abs=1e-6 * np.abs(change).max())
    return float(energy[0])


def test_wall_that_faces_up_presses_on_no_layer():
    """The same face turned over, with its normal up, has no energy; its columns are below others.

    Facing down, it has that of its area.
    """
    down = np.insert(1e-3 * QUAD8.nodes, 1, -1e-3, axis=1)[None]
    up = down * [-1.0, 1.0, 1.0]
    below, above = (
        float(TOUCH(face, areas(face, QUAD8), QUAD8, (LAYER_BODY,))[0][0]) for face in (down, up)
    )
    assert below == pytest.approx(4e-6 * float(LAYER_BODY.law(-1e-3)), rel=1e-12)
    assert above == 0.0


SINKING = [1e-3, 2e-3, 4e-3, 7e-3]  # m; the last is over the outer radius


def sunk(sinking, layer):
    """Return the force per length in N/m of a rigid round tube sunk into a layer, and its chord.

    The mesh has the default's elements around; the tube is straight, and one element long.
    """
    size = MeshSize(through_wall=1, around=20, along=1, fold=0.65)
    mesh = sweep(TUBE, 10e-3, size)
    model = bare_model(mesh, neo_hookean_solid(MU, MU), np.zeros(mesh.points.shape, bool))
    force = indenter_force(
        model, np.full_like(mesh.points, -sinking * UP), ground_body(*WALL, -R, layer)
    )
    return -force / 20e-3, np.sqrt(R**2 - max(R - sinking, 0.0) ** 2)


@pytest.mark.parametrize("sinking", SINKING)
def test_rigid_tube_in_a_layer_bears_the_pressure_of_the_columns_under_its_chord(sinking):
    """Integral of -E ln(1 - c / h) over the chord, c = d - R + sqrt(R^2 - x^2).

    The pressure sets in between the points of a face, which leaves up to 0.03 %, and beyond 0.9 R
    the blend of the covered area 0.03 %: 0.06 % is allowed. Over the wall's area in place of the
    layer's the force would be 4 to 31 % too large.
    """
    layer = Layer(thickness=10e-3, modulus=MODULUS)
    force, chord = sunk(sinking, layer)

    def pressure(x):
        compression = sinking - R + np.sqrt(R**2 - x**2)
        return -layer.modulus * np.log(1 - compression / layer.thickness)

    assert force == pytest.approx(2 * quad(pressure, 0, chord)[0], rel=6e-4)


def test_rigid_tube_in_a_thick_layer_bears_the_area_of_its_segment():
    """E / h times the segment under the chord, R^2 (a - sin a cos a) with cos a = 1 - d / R.

    In a layer of 1 m the pressure at 2 mm is linear to half its strain, 0.1 %, besides the 0.06 %
    above.
    """
    sinking, layer = 2e-3, Layer(thickness=1.0, modulus=1e7)
    angle = np.arccos(1 - sinking / R)
    segment = R**2 * (angle - np.sin(angle) * np.cos(angle))
    force, _ = sunk(sinking, layer)
    assert force == pytest.approx(layer.modulus / layer.thickness * segment, rel=1.6e-3)


def test_touched_area_is_that_of_the_points_inside():
    """Two of five columns of quadrature points of a tilted face are below the floor.

    In Gauss's weights the middle column has 64 / 225; the other four columns share the rest in
    halves.
    """
    corners = QUAD8.nodes * [2e-3, 1e-3]
    tilted = np.insert(corners, 1, corners[:, 0] * 0.01 + 1e-7, axis=1)[None]
    area = areas(tilted, QUAD8)
    touched = contact.contact_area(tilted, area, QUAD8.shapes, body(FLOOR, 0.0))
    assert float(touched / area.sum()) == pytest.approx((1 - 64 / 225) / 2, abs=1e-9)


# Hertz's line contact


MU, NU = 0.5e6, 0.49


def pressed_block(rod, width, reach, cells):
    """Press a rod into a block in plane strain, up to a contact half width of about `width`.

    The block is `reach` half widths wide and deep and slides on a plane without friction. It has
    `cells` elements over the half width, and longer and longer ones beyond twice the half width.

    Returns
    -------
    Force per length in N/m, pressure in the middle in Pa, and twice the root of the second moment
    of the pressure, in m, which is the half width of an elliptic pressure.
    """
    coarse = 2 + np.cumsum(1.3 ** np.arange(1, 60)) / cells
    beside = width * np.concatenate([np.arange(2 * cells + 1) / cells, coarse[coarse < reach]])
    slab = width / cells
    mesh = block(np.array([0.0, slab]), -beside[::-1], beside, (False, True))
    _, y, z = mesh.points.T
    fixed = np.stack([np.full(len(z), True), y == y.min(), z == 0], axis=-1)
    model = bare_model(mesh, neo_hookean_solid(MU, 2 * MU * (1 + NU) / (3 * (1 - 2 * NU))), fixed)
    peak = 2 * MU / (1 - NU) * width / (2 * rod)
    # At the peak pressure the surfaces overlap by 1/1000 of the depth of the contact, b^2 / (2 R).
    penalty = 1e3 * peak / (width**2 / (2 * rod))
    law = Partial(contact.penalty_energy, np.float64(penalty), np.float64(1e-4 * width**2 / rod))
    gap = Indenter(diameter=2 * rod).gap()
    # How far a rod sinks into a block of depth d [Johnson, Contact Mechanics, section 5.6].
    depth = width**2 / (4 * rod) * (2 * np.log(4 * reach) - NU / (1 - NU))
    tool = Body(gap, np.float64(-depth), law)
    start = np.zeros_like(mesh.points)
    result = minimise(model, start, (tool,), 1e-9 * peak * width * slab)
    assert result.converged, result.reason
    displacement = result.displacement
    corners = (mesh.points + displacement)[mesh.outer_faces]
    points = np.einsum("qn,fni->fqi", QUAD8.shapes, corners) - float(tool.height) * UP
    pressing = jax.jit(jax.vmap(jax.vmap(lambda x: -jax.grad(law)(gap(x)))))
    pressure = np.asarray(pressing(points))
    weighted = pressure * np.concatenate(model.outer_areas)[: len(mesh.outer_faces)]
    second = np.sum(weighted * points[..., 2] ** 2) / np.sum(weighted)
    middle = pressure.ravel()[np.argmin(np.abs(points[..., 2]))]
    return indenter_force(model, displacement, tool) / slab, middle, 2 * np.sqrt(second)


def test_pressed_block_has_the_width_and_the_pressure_of_hertz():
    """Hertz: b = sqrt(4 F' R / (pi E*)), peak pressure 2 F' / (pi b), E* = 2 mu / (1 - nu).

    A rod of 25 mm radius is pressed in until the half width b is 0.26 mm, b / R = 1 %: strains are
    half that. The second moment of the elliptic pressure is b^2 / 4. The measured errors are
    -0.13 % of b and 0.15 % of the pressure that follows from the force. The finite size of the
    block has an effect of some (b / d)^2 = 0.25 %: 0.5 % is allowed. With half as many elements, in
    a smaller block, the pressure is off by 5 %.
    """
    rod, width = 25e-3, 0.25e-3
    force, middle, half_width = pressed_block(rod, width, reach=20, cells=4)
    b = np.sqrt(4 * force * rod * (1 - NU) / (2 * np.pi * MU))
    assert 0.9 * width < b < 1.1 * width
    assert half_width == pytest.approx(b, rel=5e-3)
    assert middle == pytest.approx(2 * force / (np.pi * b), rel=5e-3)


# A tube between a rod and the floor


@pytest.fixture(scope="module")
def pressed():
    """A coarse tube on a free support, pressed 1 mm: its model, and a way to press it again."""
    with jax.enable_x64(True), threadpool_limits(1, user_api="blas"):
        size = MeshSize(through_wall=1, around=6, along=7)
        press = indent(TUBE, Indenter(diameter=ROD), depth=DEPTH, support="free", mesh=size)
        model = press_model(press)

    def equilibrium(depth):
        heights = [height - depth for height in press.touch_heights]
        bodies = (*indenter_bodies(TUBE, press.indenters, heights), press.bodies()[-1])
        result = minimise(model, press.displacement[-1], bodies, TOLERANCE)
        assert result.converged
        return result.displacement, bodies

    return press, model, equilibrium


@pytest.mark.slow
def test_contact_force_is_the_slope_of_the_converged_energy(pressed):
    """F = -dE/d(rod height) = dE/d(depth), by a central difference between two more equilibria.

    The step of 0.2 um is within the contact's onset; the difference has an error of some (h /
    onset)^2 of the force's change over it, 1e-7. The force is the integral of the rod's pressure
    alone, while the energy includes the wall and the floor.
    """
    press, model, equilibrium = pressed
    step = 2e-7
    ahead, behind = (evaluate(model, *equilibrium(DEPTH + side * step)).energy for side in (1, -1))
    displacement, bodies = equilibrium(DEPTH)
    force = indenter_force(model, displacement, bodies[0])
    assert press.mesh.copies == 4
    assert 4 * (ahead - behind) / (2 * step) == pytest.approx(force, rel=1e-6)


@pytest.mark.slow
def test_floor_bears_what_the_rod_presses(pressed):
    """The forces of rod and floor sum to the out-of-balance forces.

    Those of n nodes with a residual of norm r sum to sqrt(n) r at most, on each of four copies.
    """
    press, model, equilibrium = pressed
    displacement, bodies = equilibrium(DEPTH)
    rod, floor = (indenter_force(model, displacement, each) for each in bodies)
    balance = press.mesh.copies * np.sqrt(len(displacement)) * TOLERANCE
    assert rod > 0.4
    assert -floor == pytest.approx(rod, abs=balance)
