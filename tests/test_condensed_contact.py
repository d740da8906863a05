"""Newton steps with exact contact, against the whole problem and dense matrices."""

import dataclasses

import jax
import numpy as np
import pytest
from scipy import sparse

from acoustube.indentation import Indenter, Layer, MeshSize, assembly, linear_solver, newton, press
from acoustube.indentation.condensed_contact import CondensedContact
from acoustube.indentation.result import bodies_at
from acoustube.tube import Tube

pytestmark = pytest.mark.usefixtures("double_precision")
MESH = MeshSize(through_wall=1, around=8, along=6)
TOUCHED, PRESSED = 0.2e-3, 0.3e-3


@pytest.fixture(scope="module")
def tube():
    """First contact of a tube on the floor, its model, and displacements at 0.2 mm."""
    with jax.enable_x64(True):
        untouched = press.first_touch(
            Tube(), (Indenter(),), support="free", layer=None,
            material=press.neo_hookean_wall(Tube()),
            mesh=press._mesh(Tube(), (Indenter(),), MESH, whole=False), barrier_distance=2e-5,
        )  # fmt: skip
        model = press.press_model(untouched)
        state = untouched.displacement[0]
        for depth in (0.05e-3, 0.1e-3, 0.15e-3, TOUCHED):
            state = newton.minimise(model, state, bodies_at(untouched, depth), 1e-9).displacement
    return untouched, model, state


def condensed(tube, depth):
    """Return tangent, condensed contact and state at 0.2 mm with the bodies at a depth."""
    untouched, model, state = tube
    bodies = bodies_at(untouched, depth)
    tangent = assembly.stiffness(model, state, bodies)
    contact = CondensedContact(model, bodies, linear_solver.factorise(tangent), state)
    return tangent + sparse.tril(tangent, -1).T, contact, assembly.evaluate(model, state, bodies)


def left_over(tube, tangent, contact, state, step):
    """Return the residual after a step, with a linear wall and the exact contact."""
    _, model, displacement = tube
    moved = np.zeros_like(displacement)
    moved[model.free] = step

    reference = model.mesh.face
    blocks = list(zip(model.outer_faces, model.outer_areas, strict=True))

    def touch(at):
        total = np.zeros_like(at)
        for nodes, area in blocks:
            faces = (model.mesh.points + at)[nodes]
            _, local = assembly._touch(faces, area, reference, contact.bodies)
            np.add.at(total, nodes, np.asarray(local))
        return total[model.free]

    linear = np.zeros_like(displacement)
    for nodes, area in blocks:
        faces = (model.mesh.points + displacement)[nodes]
        local = assembly._touch_tangents(faces, area, reference, contact.bodies)
        within = np.einsum("fab,fb->fa", local, moved[nodes].reshape(len(local), -1))
        np.add.at(linear, nodes, np.asarray(within).reshape(*nodes.shape, 3))
    wall = tangent @ step - linear[model.free]
    change = touch(displacement + moved) - touch(displacement)
    return float(np.linalg.norm(state.gradient + wall + change))


def test_residual_of_a_step_is_small_and_due_to_the_rods_curvature(tube):
    """At 0.1 mm deeper a linear step leaves a twelfth of the residual, the exact step a thousandth.

    The rest is the effect of the rod's curvature.
    """
    tangent, contact, state = condensed(tube, PRESSED)
    linear = -contact.factor(state.gradient)
    assert left_over(tube, tangent, contact, state, linear) > 0.05 * state.norm
    step = contact.step(state)
    assert left_over(tube, tangent, contact, state, step) < 1e-3 * state.norm


def test_step_without_a_change_of_contact_is_newtons(tube):
    """At the solution no node's contact changes: the step is Newton's, to round-off."""
    _, contact, state = condensed(tube, TOUCHED)
    assert contact.step(state) == pytest.approx(-contact.factor(state.gradient), abs=1e-18)


def test_definiteness_is_that_of_the_whole_tangent(tube, monkeypatch):
    """For an ever softer contact zone, against all eigenvalues of the tangent."""
    tangent, contact, state = condensed(tube, PRESSED)
    contact.step(state)
    known = contact._stiffness
    found = []
    for factor in (2.0, 0.5, 0.0, -0.3, -1.0, -3.0):
        changed = known + (factor - 1) * (known + 0.1 * known.max())
        monkeypatch.setattr(contact, "_laws", lambda *_, changed=changed: (None, changed))
        whole = tangent.toarray()
        whole[np.ix_(contact._zone, contact._zone)] += contact._zone_stiffness(changed)
        lowest = np.linalg.eigvalsh(whole)[0]
        found.append(contact.positive_definite(state.displacement))
        assert found[-1] == (lowest > 0)
    assert True in found
    assert False in found


@pytest.mark.parametrize(
    "layer", [None, Layer(thickness=5e-3, modulus=1e6)], ids=["floor", "layer"]
)
def test_contact_solved_exactly_saves_factorisations_and_changes_no_state(tube, layer, monkeypatch):
    """0.1 mm deeper, on floor or layer: the same state, half as many factorisations or fewer."""
    untouched, model, state = tube
    untouched = dataclasses.replace(untouched, layer=layer)
    bodies, factorise, count = bodies_at(untouched, PRESSED), linear_solver.factorise, []

    def counted(*arguments):
        count.append(1)
        return factorise(*arguments)

    monkeypatch.setattr(linear_solver, "factorise", counted)
    monkeypatch.setattr(newton, "LEAST_CONDENSED_WORK", 0)
    found = newton.minimise(model, state, bodies, 1e-9)
    few = len(count)
    monkeypatch.setattr(newton, "CondensedContact", lambda *_: None)
    plain = newton.minimise(model, state, bodies, 1e-9)
    assert found.converged
    assert plain.converged
    assert np.abs(found.displacement - plain.displacement).max() < 1e-9
    assert 2 * few <= len(count) - few


@pytest.mark.parametrize(("n", "half_width"), [(1, 0), (40, 6), (300, 130), (250, 97)])
def test_forward_columns_give_the_inverse(n, half_width):
    """Products of forward columns equal a dense inverse, for unknowns in one front and in many."""
    rng = np.random.default_rng(n)
    root = np.triu(np.tril(rng.normal(size=(n, n))), -half_width) + 3 * half_width * np.eye(n)
    matrix = root @ root.T + np.eye(n)
    factor = linear_solver.factorise(sparse.csc_array(np.tril(matrix)))
    unknowns = rng.permutation(n)[: max(1, n // 3)]
    unknowns = unknowns[np.argsort(factor.place[unknowns])]
    columns = factor.forward(unknowns)
    exact = np.linalg.inv(matrix)[np.ix_(unknowns, unknowns)]
    assert columns.T @ columns == pytest.approx(exact, abs=1e-12 * np.abs(exact).max())
