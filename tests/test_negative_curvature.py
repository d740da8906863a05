"""Steps at an indefinite matrix: against its generalised eigenvectors, and at a saddle."""

import numpy as np
import pytest
from scipy import linalg, sparse

from acoustube.indentation import negative_curvature
from acoustube.indentation.negative_curvature import SMALLEST_CURVATURE, curved_step

SIZE = 40
CURVATURES = (-0.3, 0.05, 0.004)
"""Curvatures of the indefinite matrix relative to the convex one in three directions; else 1."""


@pytest.fixture(scope="module")
def pair():
    """A convex matrix, its orthonormal vectors, and a matrix that differs in three of them."""
    rng = np.random.default_rng(3)
    root = np.tril(rng.normal(size=(SIZE, SIZE)), -1) + 5 * np.eye(SIZE)
    convex = root @ root.T
    turned, _ = np.linalg.qr(rng.normal(size=(SIZE, SIZE)))
    vectors = linalg.solve_triangular(root, turned, lower=True, trans="T")
    duals = convex @ vectors
    matrix = convex + (duals[:, :3] * (np.array(CURVATURES) - 1)) @ duals[:, :3].T
    return convex, vectors, matrix


@pytest.fixture(autouse=True)
def to_the_end(monkeypatch):
    """Continue until the Lanczos vectors span the directions in which the matrices differ."""
    monkeypatch.setattr(negative_curvature, "ENOUGH", 1e-9)


def solver(convex):
    factor = linalg.cho_factor(convex)
    return lambda right: linalg.cho_solve(factor, right)


def test_step_has_the_absolute_curvatures(pair):
    """Four Lanczos steps are exact, as the matrices differ in three directions."""
    convex, vectors, matrix = pair
    gradient = np.random.default_rng(4).normal(size=SIZE)
    found = curved_step(sparse.csc_array(np.tril(matrix)), solver(convex), gradient)
    curvature = np.maximum(np.abs([*CURVATURES, *np.ones(SIZE - 3)]), SMALLEST_CURVATURE)
    expected = -vectors @ ((vectors.T @ gradient) / curvature)
    np.testing.assert_allclose(found.step, expected, atol=1e-8 * np.abs(expected).max())
    assert gradient @ found.step < 0


def test_least_curvature_and_its_direction_are_found(pair):
    convex, vectors, matrix = pair
    gradient = np.random.default_rng(5).normal(size=SIZE)
    found = curved_step(sparse.csc_array(np.tril(matrix)), solver(convex), gradient)
    assert found.curvature == pytest.approx(CURVATURES[0], rel=1e-8)
    assert found.lowest @ convex @ found.lowest == pytest.approx(1.0, rel=1e-8)
    assert abs(found.lowest @ convex @ vectors[:, 0]) == pytest.approx(1.0, rel=1e-8)


def test_away_from_a_saddle_the_distance_doubles_and_with_the_convex_matrix_it_grows_slower(pair):
    """Ten Newton steps on a quadratic energy, from near the saddle at zero."""
    convex, vectors, matrix = pair
    state = slow = 1e-3 * (vectors[:, 0] + vectors[:, 1])
    for _ in range(10):
        found = curved_step(sparse.csc_array(np.tril(matrix)), solver(convex), matrix @ state)
        state = state + found.step
        slow = slow - solver(convex)(matrix @ slow)
    along = vectors.T @ convex @ state
    assert along[0] == pytest.approx(1e-3 * 2**10, rel=1e-6)
    assert abs(along[1]) < 1e-9
    grown = 1e-3 * (1 - CURVATURES[0]) ** 10
    assert (vectors.T @ convex @ slow)[0] == pytest.approx(grown, rel=1e-6)
