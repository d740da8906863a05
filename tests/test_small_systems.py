"""Small linear systems in JAX, and the compiled code of expressions that solve them."""

import jax
import numpy as np
import pytest
from test_design import analytic, contacts, information

from acoustube.base.small_systems import solve
from acoustube.indentation.element import quadrature
from acoustube.indentation.reference_element import HEX20
from acoustube.inversion.design import electronics, prediction
from acoustube.ranging import Rangefinder


@pytest.mark.parametrize("n", [1, 2, 4])
@pytest.mark.usefixtures("double_precision")
def test_solutions_are_those_of_lapack(n):
    random = np.random.default_rng(n)
    factor = random.normal(size=(5, n, n))
    matrix = (factor @ factor.swapaxes(1, 2) + np.eye(n))[None]
    right = random.normal(size=(7, 1, n, 3))
    np.testing.assert_allclose(
        solve(matrix, right), np.linalg.solve(matrix, right), rtol=1e-11, atol=1e-13
    )


@pytest.mark.usefixtures("double_precision")
def test_no_batched_factorisation_waits_in_the_pool_of_threads():
    """Two at once would wait for each other for ever if the pool has two threads."""
    known = information([analytic()], contacts(np.array([0.5]), np.array([10.0])))
    one = electronics.electronics_of(Rangefinder())
    many = electronics.Electronics(*(np.full(3, number) for number in one))
    given = np.stack(many, axis=-1)
    programs = (
        prediction._many.lower(given, prediction._tensors(known)),
        prediction._scored.lower(np.log(given[0, :2]), given[0], prediction._tensors(known),
                                 np.array([2.0, 0.15, 0.01, 0.3])),
        jax.jit(lambda corners: quadrature(corners, HEX20)).lower(np.ones((2, 20, 3))),
    )  # fmt: skip
    for program in programs:
        assert "lapack" not in program.as_text()
    by_lapack = jax.jit(jax.numpy.linalg.inv).lower(np.eye(2)[None])
    assert "lapack" in by_lapack.as_text()
