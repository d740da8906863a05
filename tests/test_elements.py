"""The hexahedron, its material and Newton's method against closed forms of elasticity.

Patches are built from the tube's own mesh. The large-strain and bending tests are plane strain: one
element along the tube, all axial displacements held.
"""

from itertools import product

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import solveh_banded

from acoustube.indentation import contact, element
from acoustube.indentation.contact import Bodies
from acoustube.indentation.element import Material
from acoustube.indentation.equilibrium import build_model, minimise, residual, stiffness
from acoustube.indentation.material import determinant, neo_hookean_isochoric, volumetric
from acoustube.tube import MeshSize, Tube, quarter_mesh

MU, K = 0.5e6, 25e6
MATERIAL = Material(np.float64(MU), np.float64(K))
EDGE = 2e-3  # of the single cube, in m
ENERGIES, FORCES = jax.jit(element.energies), jax.jit(element.forces)
STRETCH = np.array([[1.2, 0.3, -0.1], [0.05, 0.9, 0.2], [-0.15, 0.1, 1.05]])
NOWHERE = Bodies(*map(np.float64, (1.0, 10.0, -10.0, 1.0, 1e-3)))  # touch nothing


@pytest.fixture(autouse=True)
def _double_precision():
    with jax.enable_x64(True):
        yield


def patch():
    """Return node coordinates, elements and which nodes are inside, of eight distorted elements.

    Quarter turns of the tube's wall, whose inner nodes are moved at random by up to 0.1 mm, a
    quarter of the spacing through the wall.
    """
    mesh = quarter_mesh(Tube(), 8e-3, MeshSize(through_wall=2, around=2, along=2))
    inside = np.zeros(mesh.nodes.shape[:3], bool)
    inside[1:-1, 1:-1, 1:-1] = True
    shift = np.random.default_rng(1).uniform(-1e-4, 1e-4, mesh.points.shape)
    points = mesh.points + inside.reshape(-1, 1) * shift
    return points, mesh.elements, inside.ravel()


def cube():
    """Return the nodes (27, 3) of one cube; x is numbered fastest."""
    z, y, x = np.meshgrid(*[[0, EDGE / 2, EDGE]] * 3, indexing="ij")
    return np.stack([x, y, z], axis=-1).reshape(27, 3)


def assembled_forces(points, elements, displacement):
    rule = element.quadrature(points[elements])
    forces = FORCES(displacement[elements], rule, MATERIAL)
    total = np.zeros_like(points)
    np.add.at(total, elements, forces)
    return total


def one_element(seed=0, size=0.02):
    """Return a distorted element's rule and random displacements that leave it regular."""
    points, elements, _ = patch()
    rule = element.quadrature(points[elements[:1]])
    displacement = np.random.default_rng(seed).uniform(-1, 1, (27, 3)) * size * 1e-3
    return jax.tree.map(lambda a: a[0], rule), displacement


# Shape functions and quadrature


def test_shape_functions_are_one_at_their_node_and_sum_to_one():
    grid = np.array(list(product([-1.0, 0.0, 1.0], repeat=3)))[:, ::-1]  # first direction fastest
    assert np.array_equal(element.shape_functions(grid)[0], np.eye(27))
    points = np.random.default_rng(0).uniform(-1, 1, (20, 3))
    values, slopes = element.shape_functions(points)
    assert values.sum(axis=1) == pytest.approx(1.0, abs=1e-14)
    assert np.abs(slopes.sum(axis=1)).max() < 1e-14


def test_shape_functions_interpolate_quadratics_exactly():
    """All 27 monomials of degree two in each direction, with their gradients, to round-off."""
    grid = np.array(list(product([-1.0, 0.0, 1.0], repeat=3)))[:, ::-1]
    points = np.random.default_rng(0).uniform(-1, 1, (10, 3))
    values, slopes = element.shape_functions(points)
    for powers in product(range(3), repeat=3):
        at_nodes = np.prod(grid**powers, axis=1)
        assert values @ at_nodes == pytest.approx(np.prod(points**powers, axis=1), abs=1e-13)
        for i in range(3):
            lower = np.array(powers) - np.eye(3, dtype=int)[i]
            exact = powers[i] * np.prod(points ** np.maximum(lower, 0), axis=1)
            assert slopes[:, :, i] @ at_nodes == pytest.approx(exact, abs=1e-13)


def test_gauss_rule_is_exact_to_degree_five():
    """On [-1, 1]^3: the product of 2 / (p + 1) for even powers, zero for odd ones."""
    for powers in product(range(6), repeat=3):
        exact = np.prod([2 / (p + 1) if p % 2 == 0 else 0.0 for p in powers])
        integral = element.POINT_WEIGHTS @ np.prod(element.POINTS**powers, axis=1)
        assert integral == pytest.approx(exact, abs=1e-13)


def test_volume_of_a_patch_does_not_depend_on_the_nodes_inside():
    """Moving inner nodes shifts volume between elements; the sum is the outer shape's."""
    points, elements, _ = patch()
    straight = quarter_mesh(Tube(), 8e-3, MeshSize(through_wall=2, around=2, along=2)).points
    volumes = [element.quadrature(p[elements]).weights.sum(axis=1) for p in (points, straight)]
    assert np.abs(volumes[0] - volumes[1]).max() > 1e-3 * volumes[1].min()
    assert volumes[0].sum() == pytest.approx(volumes[1].sum(), rel=1e-13)
    assert element.quadrature(cube()[None]).weights.sum() == pytest.approx(EDGE**3, rel=1e-14)


# Patch, rigid motion, derivatives


def test_affine_displacement_is_reproduced_and_leaves_inner_nodes_free():
    """Patch test: F constant; the forces inside vanish to 1e-12 of those outside.

    The rule integrates the gradients' cofactors exactly, so only round-off remains.
    """
    points, elements, inside = patch()
    displacement = points @ (STRETCH - np.eye(3)).T
    rule = element.quadrature(points[elements])
    for i, nodes in enumerate(elements):
        f = element.deformation_gradients(displacement[nodes], rule.gradients[i])
        assert np.abs(np.asarray(f) - STRETCH).max() < 1e-12
    force = assembled_forces(points, elements, displacement)
    assert np.abs(force[~inside]).max() > 1.0
    assert np.abs(force[inside]).max() < 1e-12 * np.abs(force).max()


def rotation(angle=1.1):
    c, s = np.cos(angle), np.sin(angle)
    about_z = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return about_z @ about_z[[2, 0, 1]][:, [2, 0, 1]]


def test_rigid_rotation_leaves_no_energy_and_no_force():
    """Round-off: energy under 1e-13 of mu V, forces under 1e-12 of mu times a cross-section."""
    points, elements, _ = patch()
    displacement = points @ (rotation() - np.eye(3)).T + [1e-3, 2e-3, -3e-3]
    rule = element.quadrature(points[elements])
    energy = ENERGIES(displacement[elements], rule, MATERIAL).sum()
    assert abs(energy) < 1e-13 * K * rule.weights.sum()
    assert np.abs(assembled_forces(points, elements, displacement)).max() < 1e-12 * K * EDGE**2


def test_energy_does_not_see_a_rotation_and_forces_turn_with_it():
    """Objectivity: E(Q x) = E(x), f(Q x) = Q f(x), to round-off."""
    points, elements, _ = patch()
    turn = rotation()
    bent = points + 0.1 * np.sin(points[:, [1, 2, 0]] * 300.0) * 1e-3
    rule = element.quadrature(points[elements])
    cases = [bent - points, bent @ turn.T - points]
    energies = [ENERGIES(u[elements], rule, MATERIAL) for u in cases]
    assert energies[0].min() > 0
    assert energies[1] == pytest.approx(np.asarray(energies[0]), rel=1e-11)
    forces = [assembled_forces(points, elements, u) for u in cases]
    assert np.abs(forces[1] - forces[0] @ turn.T).max() < 1e-11 * np.abs(forces[0]).max()


def test_forces_are_the_slope_of_the_energy():
    """Central difference along a random direction, 1e-8 m: truncation and round-off near 1e-8."""
    rule, displacement = one_element()
    direction = np.random.default_rng(5).normal(size=(27, 3))
    step = 1e-8
    rule = jax.tree.map(lambda a: a[None], rule)
    ahead, behind = (
        float(ENERGIES((displacement + side * direction)[None], rule, MATERIAL)[0])
        for side in (step, -step)
    )
    force = FORCES(displacement[None], rule, MATERIAL)[0]
    assert (ahead - behind) / (2 * step) == pytest.approx(float(jnp.sum(force * direction)), 1e-6)


def test_tangent_is_the_second_derivative_of_the_energy():
    """The condensed formula against JAX's Hessian of the energy, to round-off; symmetric."""
    rule, displacement = one_element()
    tangent = jax.jit(element.tangent)(displacement, rule, MATERIAL)
    hessian = jax.jit(jax.hessian(element.energy))(displacement, rule, MATERIAL).reshape(81, 81)
    scale = jnp.abs(hessian).max()
    assert jnp.abs(tangent - hessian).max() < 1e-12 * scale
    assert jnp.abs(tangent - tangent.T).max() < 1e-12 * scale


def test_batched_tangents_are_those_of_each_element():
    """40 elements, more than one batch of 32 and not a multiple of it."""
    mesh = quarter_mesh(Tube(), 8e-3, MeshSize(through_wall=2, around=5, along=4))
    rule = element.quadrature(mesh.points[mesh.elements])
    displacement = np.random.default_rng(2).uniform(-1e-5, 1e-5, (40, 27, 3))
    batch = jax.jit(element.tangents)(displacement, rule, MATERIAL)
    tangent = jax.jit(element.tangent)
    for i in (0, 31, 32, 39):
        single = tangent(displacement[i], jax.tree.map(lambda a, i=i: a[i], rule), MATERIAL)
        assert jnp.abs(batch[i] - single).max() < 1e-12 * jnp.abs(single).max()


# Material


def test_homogeneous_stretch_stores_the_closed_form_energy():
    """V [mu/2 (J^(-2/3) sum lambda^2 - 3) + K/2 (J - 1)^2] with J = 1.012, to round-off."""
    points, elements, _ = patch()
    stretches = np.array([1.3, 0.8, 0.973])
    rule = element.quadrature(points[elements])
    ratio = np.prod(stretches)
    density = MU / 2 * (ratio ** (-2 / 3) * np.sum(stretches**2) - 3) + K / 2 * (ratio - 1) ** 2
    displacement = points * (stretches - 1)
    energy = ENERGIES(displacement[elements], rule, MATERIAL).sum()
    assert energy == pytest.approx(density * rule.weights.sum(), rel=1e-12)


def test_stress_is_the_documented_one():
    """P = mu J^(-2/3) (F - I1/3 F^-T) + K (J - 1) J F^-T, against the energy's gradient."""

    def energy(f):
        return neo_hookean_isochoric(f, MU) + volumetric(determinant(f), K)

    ratio, inverse = np.linalg.det(STRETCH), np.linalg.inv(STRETCH).T
    isochoric = ratio ** (-2 / 3) * (STRETCH - np.sum(STRETCH**2) / 3 * inverse)
    exact = MU * isochoric + K * (ratio - 1) * ratio * inverse
    stress = jax.grad(energy)(jnp.asarray(STRETCH))
    assert np.abs(stress - exact).max() < 1e-12 * np.abs(exact).max()


@pytest.mark.parametrize(
    ("strain", "component", "modulus"),
    [
        ([[1, 0, 0], [0, 0, 0], [0, 0, 0]], (0, 0), K + 4 / 3 * MU),  # uniaxial strain
        ([[1, 0, 0], [0, 0, 0], [0, 0, 0]], (1, 1), K - 2 / 3 * MU),  # and what holds it sideways
        ([[0, 1, 0], [0, 0, 0], [0, 0, 0]], (0, 1), MU),  # simple shear
        ([[1, 0, 0], [0, 1, 0], [0, 0, 1]], (2, 2), 3 * K),  # expansion
    ],
)
def test_small_strains_obey_hooke(strain, component, modulus):
    """Stress read from the nodal forces on a cube's face; the next order in a strain of 1e-7."""
    points, size = cube(), 1e-7
    displacement = points @ (size * np.array(strain, float)).T
    rule = element.quadrature(points[None])
    force = FORCES(displacement[None], rule, MATERIAL)[0]
    i, j = component
    face = points[:, j] == EDGE
    stress = float(force[face, i].sum()) / EDGE**2
    assert stress / size == pytest.approx(modulus, rel=3e-6)


def test_projection_keeps_trilinear_fields_and_averages_squares():
    """On any element the first; on a cube xi^2 becomes its mean 1/3 (Legendre's orthogonality)."""
    rule, _ = one_element()
    field = element.PROJECTION @ np.array([1.0, 0.3, -0.2, 0.1, 0.05, -0.04, 0.03, 0.02])
    assert np.abs(element.project(field, rule) - field).max() < 1e-13
    straight = jax.tree.map(lambda a: a[0], element.quadrature(cube()[None]))
    assert np.abs(element.project(element.XI**2, straight) - 1 / 3).max() < 1e-13


# Plane-strain rings


def ring(tube, size, *, fixed):
    """Return the model of a slice of a tube, 1 mm long, with `fixed(nodes)` held besides."""
    mesh = quarter_mesh(tube, 1e-3, size)
    held = np.zeros(mesh.nodes.shape, bool)
    held[..., 2] = True
    held[:, [0, -1], :, 0] = True
    fixed(held)
    material = Material(np.float64(tube.shear_modulus), np.float64(tube.bulk_modulus))
    return build_model(mesh, material, held.reshape(-1, 3))


def linear_response(model, load):
    """Return the displacements (n_along, n_around, n_through, 3) under small nodal forces."""
    band = stiffness(model, np.zeros_like(model.mesh.points), NOWHERE)
    displacement = np.zeros_like(model.mesh.nodes)
    free = model.free.reshape(displacement.shape)
    displacement[free] = solveh_banded(band, load[free], lower=True)
    return displacement


RIVLIN = [(1.05, 0.02296), (1.25, 0.08463), (1.5, 0.12378), (2.0, 0.15440)]


@pytest.mark.parametrize(("stretch", "pressure_mpa"), RIVLIN)
def test_inflated_tube_bears_rivlins_pressure(stretch, pressure_mpa):
    """Incompressible, axial stretch 1: P = mu [ln(la / lb) + (1 / lb^2 - 1 / la^2) / 2].

    The inner wall is moved out by the stretch and P read as the work of its nodal forces per swept
    area. At nu = 0.4999 (K = 5000 mu) the wall's volume shrinks by P / K = 6e-5; four layers of
    quadratics leave less than 1e-3. 0.5 % is allowed.
    """
    tube = Tube(shear_modulus=0.507e6, poisson_ratio=0.4999)

    def fixed(held):
        held[:, :, 0, :2] = True  # the inner wall

    model = ring(tube, MeshSize(through_wall=4, around=4, along=1), fixed=fixed)
    inner, nodes = tube.inner_diameter / 2, model.mesh.nodes
    radius = np.hypot(nodes[..., 0], nodes[..., 1])[..., None]
    radial = nodes * [1, 1, 0] / radius
    deformed = np.sqrt(radius**2 + (stretch**2 - 1) * inner**2)
    start = ((deformed - radius) * radial).reshape(-1, 3)
    result = minimise(model, start, NOWHERE, 1e-9)
    assert result.converged
    everywhere = build_model(model.mesh, model.material, np.zeros_like(model.free))
    force = residual(everywhere, result.displacement, NOWHERE).reshape(nodes.shape)
    work = np.sum(force[:, :, 0] * radial[:, :, 0])  # per metre of the inner radius
    pressure = work / (np.pi * stretch * inner * 1e-3)  # half a circle, 1 mm long
    outer = np.sqrt(1 + (stretch**2 - 1) * (tube.inner_diameter / tube.outer_diameter) ** 2)
    exact = np.log(stretch / outer) + (outer**-2 - stretch**-2) / 2
    assert pressure == pytest.approx(tube.shear_modulus * exact, rel=5e-3)
    assert pressure == pytest.approx(1e6 * pressure_mpa, rel=5e-3)


def test_pinched_thin_ring_deflects_like_a_curved_beam():
    """0.14878 W R^3 / (E' I) under the load, 0.13662 across, and the next order in t / R.

    A ring with R / t = 25 is pinched at two opposite points of its middle line by W per length.
    Castigliano with bending, normal and shear energy gives pi/4 k1 - 2/pi k2^2 and
    k1/2 - k2 + 2/pi k2^2, with k1 = 1 - a + b, k2 = 1 - a, a = I / (A R^2) and
    b = (6/5) a E' / G: 0.38 and 0.15 % over the thin ring. What is left is of order (t / R)^2 too,
    with the profile of the shear, and the mesh's: 0.1 % is allowed.
    """
    thickness, radius, nu = 1e-3, 25e-3, 0.49
    tube = Tube(inner_diameter=2 * radius - thickness, wall_thickness=thickness, poisson_ratio=nu)

    def fixed(held):
        held[:, 0, 2, 1] = True  # the middle line's bottom

    around = 64
    model = ring(tube, MeshSize(through_wall=2, around=around, along=1), fixed=fixed)
    pinch = 1e-3  # N/m
    load = np.zeros(model.mesh.nodes.shape)
    load[:, -1, 2, 1] = -pinch / 2 * 1e-3 * np.array([1, 4, 1]) / 6  # half the ring, 1 mm long
    displacement = linear_response(model, load)
    modulus = 2 * tube.shear_modulus / (1 - nu)  # E' = E / (1 - nu^2)
    beam = pinch * radius**3 / (modulus * thickness**3 / 12)
    a = (thickness / radius) ** 2 / 12
    b = 1.2 * a * modulus / tube.shear_modulus
    k1, k2 = 1 - a + b, 1 - a
    deflection = -displacement[0, -1, 2, 1] / beam
    across = 2 * displacement[0, around, 2, 0] / beam
    assert deflection == pytest.approx(np.pi / 4 * k1 - 2 / np.pi * k2**2, rel=1e-3)
    assert across == pytest.approx(k1 / 2 - k2 + 2 / np.pi * k2**2, rel=1e-3)
    assert deflection == pytest.approx(0.14878, rel=5e-3)
    assert across == pytest.approx(0.13662, rel=5e-3)


def ovalised(tube, layers, around):
    """Return the bore's closing under an outer traction q cos(2 theta), over q / mu, in m."""

    def fixed(held):
        held[:, 0, 0, 1] = True  # against moving as a whole, which the load does not do

    model = ring(tube, MeshSize(through_wall=layers, around=around, along=1), fixed=fixed)
    faces = model.mesh.outer_faces
    points = np.einsum("qn,fni->fqi", contact.FACE_SHAPES, model.mesh.points[faces])
    angle = np.arctan2(points[..., 0], -points[..., 1])
    normal = np.stack([np.sin(angle), -np.cos(angle), 0 * angle], axis=-1)
    traction = -np.cos(2 * angle)[..., None] * normal * model.outer_area[..., None]
    load = np.zeros_like(model.mesh.points)
    np.add.at(load, faces, np.einsum("qn,fqi->fni", contact.FACE_SHAPES, traction))
    displacement = linear_response(model, load.reshape(model.mesh.nodes.shape))
    return tube.shear_modulus * (displacement[0, 0, 0, 1] - displacement[0, -1, 0, 1])


def michell(tube):
    """Return the same from Michell's plane-strain solution for a thick ring.

    Airy function (A r^2 + B r^4 + C + D / r^2) cos(2 theta), whose stresses and displacements are
    those of Barber, Elasticity, tables 8.1 and 9.1, kappa = 3 - 4 nu.
    """
    inner, outer = tube.inner_diameter / 2, tube.outer_diameter / 2

    def tractions(r):
        return [[-2, 0, -4 / r**2, -6 / r**4], [2, 6 * r**2, -2 / r**2, -6 / r**4]]

    a, b, c, d = np.linalg.solve([*tractions(inner), *tractions(outer)], [0, 0, -1, 0])
    kappa = 3 - 4 * tube.poisson_ratio
    r = inner
    radial = (-2 * a * r + b * (kappa - 3) * r**3 + c * (kappa + 1) / r + 2 * d / r**3) / 2
    return -2 * radial  # bottom and top both move in; the closing is positive


@pytest.mark.parametrize(("layers", "around", "error"), [(2, 12, 5e-3), (4, 24, 5e-4)])
@pytest.mark.parametrize("nu", [0.3, 0.49, 0.4999])
def test_thick_ring_is_ovalised_as_michell_says_and_does_not_lock(nu, layers, around, error):
    """The paper's section, from K = 2.2 mu to 5000 mu, with the default mesh and one twice as fine.

    Interpolation is all the error there is: it must not grow with K / mu. It falls by 12 from one
    mesh to the next (measured: 0.37 to 0.40 %, then 0.03 %).
    """
    tube = Tube(poisson_ratio=nu)
    assert ovalised(tube, layers, around) == pytest.approx(michell(tube), rel=error)


def test_stiffness_hardly_changes_with_incompressibility_and_layers():
    """Beyond the exact change, nu = 0.499 adds under 0.1 % to 0.49; layers add under 0.5 %."""
    soft, hard = Tube(poisson_ratio=0.49), Tube(poisson_ratio=0.499)
    change = ovalised(hard, 2, 12) / ovalised(soft, 2, 12)
    assert change == pytest.approx(michell(hard) / michell(soft), rel=1e-3)
    assert ovalised(hard, 2, 12) == pytest.approx(ovalised(hard, 4, 12), rel=5e-3)


def test_newton_gives_up_across_a_buckling_and_in_inverted_elements():
    """A ring shrunk by 40 % is in pressure beyond any stable shape; turned inside out, it is NaN.

    Neither may be reported as an equilibrium, nor be left by a step from a meaningless tangent.
    """
    tube = Tube()

    def fixed(held):
        held[:, 0, 0, 1] = True

    model = ring(tube, MeshSize(through_wall=1, around=4, along=1), fixed=fixed)
    about = model.mesh.points[0]  # the held node
    for factors, finite in (([-0.4, -0.4, 0.0], True), ([-1.5, 0.0, 0.0], False)):
        squeeze = (model.mesh.points - about) * factors
        result = minimise(model, squeeze, NOWHERE, 1e-9)
        assert not result.converged
        assert result.iterations == 0
        assert np.isfinite(result.residual) == finite
        assert np.array_equal(result.displacement, squeeze)
