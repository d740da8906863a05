"""The wall's strain energies, against the formulas that they document and closed forms."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from solids import bare_model, block, mooney_rivlin_solid, neo_hookean_solid, nodal_forces

from acoustube.indentation.material import determinant, mooney_rivlin, neo_hookean, volumetric
from acoustube.indentation.newton import minimise

pytestmark = pytest.mark.usefixtures("double_precision")

MU, K = 0.5e6, 25e6
C1, C2 = 0.17e6, 0.08e6
STRETCH = np.array([[1.2, 0.3, -0.1], [0.05, 0.9, 0.2], [-0.15, 0.1, 1.05]])


def neo_hookean_energy(f):
    return neo_hookean(MU, f) + volumetric(determinant(f), K)


def rotation(angle=1.1):
    c, s = np.cos(angle), np.sin(angle)
    about_z = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return about_z @ about_z[[2, 0, 1]][:, [2, 0, 1]]


def test_determinant_is_the_determinant():
    assert float(determinant(STRETCH)) == pytest.approx(np.linalg.det(STRETCH), rel=1e-14)


def test_neo_hookean_stress_is_the_documented_one():
    """P = mu J^(-2/3) (F - I1/3 F^-T) + K (J - 1) J F^-T equals the gradient of the energy."""
    ratio, inverse = np.linalg.det(STRETCH), np.linalg.inv(STRETCH).T
    isochoric = ratio ** (-2 / 3) * (STRETCH - np.sum(STRETCH**2) / 3 * inverse)
    exact = MU * isochoric + K * (ratio - 1) * ratio * inverse
    stress = jax.grad(neo_hookean_energy)(jnp.asarray(STRETCH))
    assert np.abs(stress - exact).max() < 1e-12 * np.abs(exact).max()


def test_neo_hookean_tangent_is_the_documented_one():
    """The tangent applied to a random dF equals JAX's second derivative, to round-off."""
    change = np.random.default_rng(0).normal(size=(3, 3))
    f, ratio, inverse = STRETCH, np.linalg.det(STRETCH), np.linalg.inv(STRETCH).T
    first, t, turned = np.sum(f * f), np.sum(inverse * change), inverse @ change.T @ inverse
    isochoric = ratio ** (-2 / 3) * (
        change
        - 2 / 3 * np.sum(f * change) * inverse
        - 2 / 3 * t * (f - first / 3 * inverse)
        + first / 3 * turned
    )
    volume = K * ratio * (2 * ratio - 1) * t * inverse - K * (ratio - 1) * ratio * turned
    exact = MU * isochoric + volume
    hessian = jax.hessian(neo_hookean_energy)(jnp.asarray(STRETCH))
    stress = np.einsum("ijkl,kl->ij", hessian, change)
    assert np.abs(stress - exact).max() < 1e-12 * np.abs(exact).max()


def test_mooney_rivlin_energy_is_that_of_the_principal_stretches():
    """c1 (J^(-2/3) sum l^2 - 3) + c2 (J^(-4/3) sum of products of two l^2 - 3), to round-off."""
    squares = np.linalg.svd(STRETCH, compute_uv=False) ** 2
    ratio = np.sqrt(np.prod(squares))
    second = squares[0] * squares[1] + squares[1] * squares[2] + squares[2] * squares[0]
    exact = C1 * (ratio ** (-2 / 3) * squares.sum() - 3) + C2 * (ratio ** (-4 / 3) * second - 3)
    assert float(mooney_rivlin(C1, C2, STRETCH)) == pytest.approx(exact, rel=1e-12)


def test_mooney_rivlin_without_its_second_constant_is_neo_hookean():
    """With c1 = mu / 2: energy, stress and tangent, to round-off."""
    f = jnp.asarray(STRETCH)
    for derivative in (lambda w: w, jax.grad, jax.hessian):
        one = derivative(lambda f: neo_hookean(MU, f))(f)
        two = derivative(lambda f: mooney_rivlin(MU / 2, 0.0, f))(f)
        assert np.abs(one - two).max() < 1e-12 * np.abs(one).max()


ENERGIES = {
    "neo-hookean": lambda f: neo_hookean(MU, f),
    "mooney-rivlin": lambda f: mooney_rivlin(C1, C2, f),
}


@pytest.mark.parametrize("name", ENERGIES)
def test_energy_is_invariant_under_rotation_and_change_of_volume(name):
    """W(Q F R) = W(F) = W(a F), to round-off: isotropic, objective and isochoric."""
    energy = ENERGIES[name]
    turned = rotation() @ STRETCH @ rotation(0.4)
    assert float(energy(turned)) == pytest.approx(float(energy(STRETCH)), rel=1e-12)
    assert float(energy(1.3 * STRETCH)) == pytest.approx(float(energy(STRETCH)), rel=1e-12)


@pytest.mark.parametrize(
    ("name", "modulus"), [("neo-hookean", MU), ("mooney-rivlin", 2 * (C1 + C2))]
)
def test_small_shear_modulus_is_the_documented_one(name, modulus):
    """No stress in the rest state; simple shear stores mu g^2 / 2, whose curvature is mu."""
    rest = jnp.eye(3)
    assert np.abs(jax.grad(ENERGIES[name])(rest)).max() < 1e-9 * modulus
    stiffness = jax.hessian(ENERGIES[name])(rest)
    assert float(stiffness[0, 1, 0, 1]) == pytest.approx(modulus, rel=1e-12)


@pytest.mark.parametrize("stretch", [0.5, 0.8, 1.5, 2.5])
@pytest.mark.parametrize(("c1", "c2"), [(C1, C2), (MU / 2, 0.0)])
def test_stretched_bar_bears_mooney_and_rivlins_stress(stretch, c1, c2):
    """Nominal 2 (l - 1/l^2) (c1 + c2/l), true 2 (l^2 - 1/l) (c1 + c2/l), for an incompressible bar.

    One cubic element is stretched with free sides. Derivation: with the lateral stretches l^(-1/2)
    W = c1 (l^2 + 2/l - 3) + c2 (2 l + 1/l^2 - 3), and the nominal stress is dW/dl. At a bulk
    modulus of 1e4 shear moduli the volume changes by the stress over 3 K, some 1e-4, and the
    nominal stress by a few times that: 5e-4 is allowed.
    """
    edge, modulus = 2e-3, 2 * (c1 + c2)
    mesh = block(*[np.array([0.0, edge])] * 3)
    material = mooney_rivlin_solid(c1, c2, 1e4 * modulus)
    fixed = mesh.points == 0.0
    fixed[:, 2] |= mesh.points[:, 2] == edge
    true = 2 * (stretch**2 - 1 / stretch) * (c1 + c2 / stretch)
    # The initial state needs the pressure that leaves the sides free; else the bar is unstable.
    side = np.sqrt((1 + true / (3e4 * modulus)) / stretch)
    start = mesh.points * (np.array([side, side, stretch]) - 1)
    result = minimise(bare_model(mesh, material, fixed), start, (), 1e-9)
    assert result.converged
    force = nodal_forces(mesh, material, result.displacement)
    end = mesh.points[:, 2] == edge
    nominal = force[end, 2].sum() / edge**2
    assert nominal == pytest.approx(2 * (stretch - stretch**-2) * (c1 + c2 / stretch), rel=5e-4)
    side = 1 + result.displacement[mesh.points[:, 0] == edge, 0].mean() / edge
    assert nominal / side**2 == pytest.approx(true, rel=5e-4)


def test_a_new_value_of_a_constant_compiles_nothing():
    """The constants are leaves of the tree: one trace serves for any values."""
    traces = []

    @jax.jit
    def energy(material):
        traces.append(None)
        return material.isochoric(jnp.asarray(STRETCH)) * material.bulk_modulus

    values = [float(energy(neo_hookean_solid(mu, K))) for mu in (1.0, 2.0)]
    assert values[1] == pytest.approx(2 * values[0], rel=1e-14)
    assert len(traces) == 1
