"""The smoothed penalty, the rigid bodies' geometry, and the balance of forces in a pressed tube."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from acoustube.indentation import contact, indent
from acoustube.indentation.contact import Bodies, contact_energy, floor_gap, rod_gap
from acoustube.indentation.element import Material
from acoustube.indentation.equilibrium import build_model, minimise, potential, rod_force
from acoustube.indentation.press import CONTACT_SMOOTHING, CONTACT_STIFFNESS
from acoustube.tube import MeshSize, Tube

STIFFNESS, SMOOTHING = 1e11, 4e-6
TUBE = Tube()
ROD = 25e-3
DEPTH = 1e-3
TOLERANCE = 1e-9  # N


@pytest.fixture(autouse=True)
def _double_precision():
    with jax.enable_x64(True):
        yield


def bodies(rod_height=0.02, floor_height=-0.006, stiffness=STIFFNESS, smoothing=SMOOTHING):
    return Bodies(*map(np.float64, (ROD / 2, rod_height, floor_height, stiffness, smoothing)))


energy = partial(contact_energy, bodies=bodies())
derivatives = [energy, jax.grad(energy), jax.grad(jax.grad(energy))]


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize("end", [-SMOOTHING, SMOOTHING])
def test_energy_and_two_derivatives_are_continuous_where_the_blend_ends(end, order):
    """The third derivative jumps by k / (2 d): over 2e-6 d the second may change by 1e-6 k.

    Twice that is allowed, in units of k d^(2 - order).
    """
    step = 1e-6 * SMOOTHING
    with jax.enable_x64(True):
        below, above = (float(derivatives[order](end + side)) for side in (-step, step))
    scale = STIFFNESS * SMOOTHING ** (2 - order)
    slope = {0: 1.0, 1: 1.0, 2: 0.5}[order]  # of the derivative next to the end, at most
    assert abs(above - below) <= 4 * slope * 1e-6 * scale


def test_nothing_is_felt_beyond_the_blend():
    """Energy, pressure and stiffness are exactly zero: no force at a distance."""
    for gap in (SMOOTHING, 1.5 * SMOOTHING, 1e-3):
        assert [float(f(gap)) for f in derivatives] == [0.0, 0.0, 0.0]


def test_penalty_is_a_straight_line_past_the_blend():
    """Energy k/2 g^2 + k d^2 / 6, pressure -k g, stiffness k; at g = 0 pressure k d / 4."""
    gap = -3 * SMOOTHING
    value, slope, curvature = (float(f(gap)) for f in derivatives)
    assert value == pytest.approx(STIFFNESS * (gap**2 / 2 + SMOOTHING**2 / 6), rel=1e-12)
    assert slope == pytest.approx(STIFFNESS * gap, rel=1e-12)
    assert curvature == pytest.approx(STIFFNESS, rel=1e-12)
    assert float(derivatives[1](0.0)) == pytest.approx(-STIFFNESS * SMOOTHING / 4, rel=1e-12)


def test_pressure_never_pulls_and_never_falls_with_penetration():
    gaps = jnp.linspace(2 * SMOOTHING, -4 * SMOOTHING, 601)
    pressure = -jax.vmap(jax.grad(energy))(gaps)
    assert jnp.all(pressure >= 0)
    assert jnp.all(jnp.diff(pressure) >= 0)


@pytest.mark.parametrize(
    ("point", "distance"),
    [
        ([0.0, 0.02 - ROD / 2, 0.0], 0.0),  # under the rod
        ([3.0, 0.02 - ROD / 2 - 1e-3, 0.0], 1e-3),  # it is endless along x
        ([0.0, 0.02, ROD], ROD / 2),  # beside it
        ([0.0, 0.02 - 3e-3, 4e-3], 5e-3 - ROD / 2),  # inside: 3-4-5
    ],
)
def test_rod_gap_is_the_distance_to_a_cylinder_along_x(point, distance):
    gap = rod_gap(jnp.array(point), bodies())
    assert float(gap) == pytest.approx(distance, abs=1e-15)


def test_floor_gap_is_the_height_above_the_floor():
    assert float(floor_gap(jnp.array([1.0, -0.005, 2.0]), bodies())) == pytest.approx(1e-3)
    assert float(floor_gap(jnp.array([1.0, -0.007, 2.0]), bodies())) == pytest.approx(-1e-3)


def test_flat_face_pressed_on_the_floor_bears_stiffness_times_depth_times_area():
    """k g A upwards, spread as 1/36, 4/36 and 16/36 over corners, edges and middle (Simpson)."""
    width, length, depth = 2e-3, 3e-3, 10e-6
    z, x = np.meshgrid([0, length / 2, length], [0, width / 2, width], indexing="ij")
    face = np.stack([x, np.full_like(x, -0.006 - depth), z], axis=-1).reshape(1, 9, 3)
    area = contact.areas(face)
    assert area.sum() == pytest.approx(width * length, rel=1e-12)
    force = -contact.forces(face, area, bodies())[0]
    simpson = np.outer([1, 4, 1], [1, 4, 1]).ravel() / 36
    assert force[:, 1] == pytest.approx(STIFFNESS * depth * width * length * simpson, rel=1e-9)
    assert np.abs(force[:, [0, 2]]).max() == 0.0


def test_contact_forces_and_tangents_are_derivatives_of_the_energy():
    """Central differences over 1e-9 m on a curved face in the rod: 1e-6 of the largest entry."""
    rng = np.random.default_rng(3)
    z, x = np.meshgrid([0.0, 1e-3, 2e-3], [0.0, 1e-3, 2e-3], indexing="ij")
    surface = 0.02 - np.sqrt((ROD / 2) ** 2 - z**2)
    face = np.stack([x, surface + 8e-6, z], axis=-1).reshape(1, 9, 3)
    area, step = contact.areas(face), 1e-9
    direction = rng.normal(size=face.shape)
    ahead, behind = (face + side * step * direction for side in (1, -1))
    energies = jax.jit(partial(contact.energies, area=area, bodies=bodies()))
    forces = jax.jit(partial(contact.forces, area=area, bodies=bodies()))
    slope = float((energies(ahead) - energies(behind))[0] / (2 * step))
    assert slope == pytest.approx(float(jnp.sum(forces(face) * direction)), rel=1e-6)
    change = np.ravel(forces(ahead) - forces(behind)) / (2 * step)
    tangent = contact.tangents(face, area, bodies())[0]
    assert tangent @ direction.ravel() == pytest.approx(change, abs=1e-6 * np.abs(change).max())


@pytest.fixture(scope="module")
def pressed():
    """A coarse tube on a free support, pressed 1 mm: its model, and a way to press it again."""
    press = indent(
        TUBE,
        rod_diameter=ROD,
        depth=DEPTH,
        support="free",
        size=MeshSize(through_wall=1, around=6, along=7),
    )
    fixed = np.zeros(press.mesh.nodes.shape, bool)
    fixed[:, [0, -1], :, 0] = True
    fixed[0, :, :, 2] = True
    with jax.enable_x64(True):
        material = Material(np.float64(TUBE.shear_modulus), np.float64(TUBE.bulk_modulus))
        model = build_model(press.mesh, material, fixed.reshape(-1, 3))
    top = TUBE.outer_diameter / 2

    def equilibrium(depth):
        rigid = bodies(
            top + ROD / 2 - depth,
            -top,
            CONTACT_STIFFNESS * TUBE.shear_modulus / TUBE.wall_thickness,
            CONTACT_SMOOTHING * TUBE.wall_thickness,
        )
        start = press.displacement[-1].reshape(-1, 3)
        result = minimise(model, start, rigid, TOLERANCE)
        assert result.converged
        return result.displacement, rigid

    return press, model, equilibrium


def test_contact_force_is_the_slope_of_the_converged_energy(pressed):
    """F = -dE/d(rod height) = dE/d(depth), by a central difference of two more equilibria.

    Over a step of 2 um the difference's own error is some (h / depth)^2 = 4e-6. The force comes
    from the rod's pressure alone; the energy knows the wall and the floor as well.
    """
    press, model, equilibrium = pressed
    step = 2e-6
    ahead, behind = (potential(model, *equilibrium(DEPTH + side * step)) for side in (1, -1))
    displacement, rigid = equilibrium(DEPTH)
    force = rod_force(model, displacement, rigid)
    assert (ahead - behind) / (2 * step) == pytest.approx(force, rel=1e-5)
    assert 4 * force == pytest.approx(press.contact_force[-1], rel=1e-6)


def test_floor_bears_what_the_rod_presses(pressed):
    """No vertical displacement is held: the forces on both sum to the out-of-balance forces.

    n nodes with a residual of norm r sum to sqrt(n) r at most.
    """
    _, model, equilibrium = pressed
    displacement, rigid = equilibrium(DEPTH)
    position = (model.mesh.points + displacement)[model.mesh.outer_faces]

    def touch(floor_height):
        moved = rigid._replace(floor_height=floor_height)
        return jnp.sum(contact.energies(position, model.outer_area, moved))

    floor_force = float(jax.grad(touch)(rigid.floor_height))
    balance = np.sqrt(len(displacement)) * TOLERANCE
    assert floor_force > 0.1
    assert floor_force == pytest.approx(rod_force(model, displacement, rigid), abs=balance)
