"""Shape functions and quadrature rules of the reference elements, against polynomials."""

from itertools import product
from math import factorial

import numpy as np
import pytest

from acoustube.indentation.reference_element import (
    FACE,
    HEX20,
    QUAD8,
    TET10,
    TRI6,
    collapsed_gauss,
    edges,
    gauss,
    tetrahedron_rule,
)

ELEMENTS = {"hex20": HEX20, "quad8": QUAD8, "tet10": TET10, "tri6": TRI6}
BRICKS, SIMPLICES = ("hex20", "quad8"), ("tet10", "tri6")


def powers_up_to(degree, d):
    return [p for p in product(range(degree + 1), repeat=d) if sum(p) <= degree]


def over_brick(powers):
    """Return the integral of a monomial over [-1, 1]^d."""
    return np.prod([2 / (p + 1) if p % 2 == 0 else 0.0 for p in powers])


def over_simplex(powers):
    """Return the integral of a monomial over the unit simplex: a! b! ... / (a + b + ... + d)!."""
    return np.prod([factorial(p) for p in powers]) / factorial(sum(powers) + len(powers))


def inside(name, n=12):
    """Return random points inside a reference element."""
    d = ELEMENTS[name].nodes.shape[1]
    rng = np.random.default_rng(0)
    if name in BRICKS:
        return rng.uniform(-1, 1, (n, d))
    return rng.dirichlet(np.ones(d + 1), n)[:, :d]


def reproduced(name):
    """Return the exponents of the monomials in the space of an element.

    Serendipity elements: those whose degree, not counting the exponents of one, is at most two (8
    in the plane, 20 in space); simplices: those of degree two or less (6 and 10).
    """
    d = ELEMENTS[name].nodes.shape[1]
    if name in SIMPLICES:
        return powers_up_to(2, d)
    return [p for p in product(range(3), repeat=d) if p.count(2) <= 1]


@pytest.mark.parametrize("name", ELEMENTS)
def test_shape_functions_are_one_at_their_node_and_sum_to_one(name):
    """To the round-off of a matrix inverse, 1e-13."""
    element = ELEMENTS[name]
    values, _ = element.shape_functions(element.nodes)
    assert np.abs(values - np.eye(len(element.nodes))).max() < 1e-13
    values, slopes = element.shape_functions(inside(name))
    assert values.sum(axis=1) == pytest.approx(1.0, abs=1e-13)
    assert np.abs(slopes.sum(axis=1)).max() < 1e-13


@pytest.mark.parametrize("name", ELEMENTS)
def test_shape_functions_interpolate_their_polynomials_exactly(name):
    """All monomials of the element, as many as nodes, with gradients, to round-off."""
    element = ELEMENTS[name]
    points = inside(name)
    values, slopes = element.shape_functions(points)
    exponents = reproduced(name)
    assert len(exponents) == len(element.nodes)
    for powers in exponents:
        at_nodes = np.prod(element.nodes**powers, axis=1)
        assert values @ at_nodes == pytest.approx(np.prod(points**powers, axis=1), abs=1e-12)
        for i, p in enumerate(powers):
            lower = np.maximum(np.array(powers) - np.eye(len(powers), dtype=int)[i], 0)
            exact = p * np.prod(points**lower, axis=1)
            assert slopes[:, :, i] @ at_nodes == pytest.approx(exact, abs=1e-12)


@pytest.mark.parametrize("name", BRICKS)
def test_brick_nodes_are_its_corners_and_the_middles_of_its_edges(name):
    nodes = ELEMENTS[name].nodes
    d = nodes.shape[1]
    at_middle = np.sum(nodes == 0, axis=1)
    assert np.sum(at_middle == 0) == 2**d
    assert np.sum(at_middle == 1) == d * 2 ** (d - 1)
    assert len(np.unique(nodes, axis=0)) == len(nodes)


@pytest.mark.parametrize("name", SIMPLICES)
def test_simplex_nodes_are_its_corners_and_then_the_middles_of_their_pairs(name):
    nodes = ELEMENTS[name].nodes
    d = nodes.shape[1]
    corners, middles = nodes[: d + 1], nodes[d + 1 :]
    assert len(np.unique(corners, axis=0)) == d + 1
    assert np.array_equal(middles, [(corners[i] + corners[j]) / 2 for i, j in edges(d)])


def test_faces_of_an_element_carry_the_shape_functions_of_their_own_kind():
    """A solid's shape functions on a face equal those of the face element at that face's nodes."""
    for solid, face in FACE.items():
        flat = np.abs(solid.nodes[:, 2] - solid.nodes[:, 2].min()) == 0
        points = inside("quad8" if solid is HEX20 else "tri6")
        values, _ = solid.shape_functions(np.column_stack([points, np.full(12, solid.nodes.min())]))
        assert np.abs(values[:, ~flat]).max() < 1e-12
        order = [
            np.flatnonzero(np.all(solid.nodes[flat][:, :2] == node, axis=1))[0]
            for node in face.nodes
        ]
        exact, _ = face.shape_functions(points)
        assert np.abs(values[:, flat][:, order] - exact).max() < 1e-12


@pytest.mark.parametrize("d", [2, 3])
@pytest.mark.parametrize("n", [3, 5])
def test_gauss_rule_is_exact_to_its_degree_and_not_beyond(n, d):
    """n points are exact to degree 2 n - 1 in each direction; three of them to degree five."""
    points, weights = gauss(n, d)
    assert points.shape == (n**d, d)
    for powers in product(range(2 * n), repeat=d):
        integral = weights @ np.prod(points**powers, axis=1)
        assert integral == pytest.approx(over_brick(powers), abs=1e-13)
    beyond = weights @ points[:, 0] ** (2 * n)
    assert abs(beyond / over_brick((2 * n, *[0] * (d - 1))) - 1) > 1e-3


@pytest.mark.parametrize("n", [2, 4])
def test_collapsed_gauss_rule_is_exact_to_its_degree_and_not_beyond(n):
    """It is exact to degree 2 n - 2 on the triangle; the collapse uses one degree.

    b^(2n-1) is not integrated exactly.
    """
    points, weights = collapsed_gauss(n)
    for powers in powers_up_to(2 * n - 2, 2):
        integral = weights @ np.prod(points**powers, axis=1)
        assert integral == pytest.approx(over_simplex(powers), abs=1e-14)
    beyond = weights @ points[:, 1] ** (2 * n - 1)
    assert abs(beyond / over_simplex((0, 2 * n - 1)) - 1) > 1e-5


def test_tetrahedron_rule_is_exact_to_degree_two_and_not_beyond():
    points, weights = tetrahedron_rule()
    for powers in powers_up_to(2, 3):
        integral = weights @ np.prod(points**powers, axis=1)
        assert integral == pytest.approx(over_simplex(powers), abs=1e-15)
    assert abs(weights @ points[:, 0] ** 3 / over_simplex((3, 0, 0)) - 1) > 1e-2


@pytest.mark.parametrize("name", ELEMENTS)
def test_an_elements_own_rule_lies_inside_it_and_fills_it(name):
    element = ELEMENTS[name]
    d = element.nodes.shape[1]
    assert element.weights.min() > 0
    size = 2**d if name in BRICKS else 1 / factorial(d)
    assert element.weights.sum() == pytest.approx(size, rel=1e-14)
    assert np.all(element.points > element.nodes.min(axis=0))
    if name in BRICKS:
        assert np.all(element.points < 1)
    else:
        assert np.all(element.points.sum(axis=1) < 1)
