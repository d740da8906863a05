"""Assembly and factorisation of the stiffness matrix, against dense matrices."""

import numpy as np
import pytest
from scipy import sparse
from scipy.linalg import LinAlgError

from acoustube.indentation import linear_solver

N_NODES = 9
ELEMENTS = np.array([[0, 1, 3], [1, 2, 4], [3, 4, 5], [5, 7, 6]])
FACES = np.array([[0, 3], [5, 7], [8, 2]])


@pytest.fixture
def free():
    """Which components are unknowns: two thirds, of every node but one."""
    chosen = np.random.default_rng(0).random((N_NODES, 3)) < 0.7
    chosen[4] = False
    return chosen


def symmetric(rng, n, size):
    matrices = rng.normal(size=(n, size, size))
    return matrices + np.swapaxes(matrices, 1, 2)


def element_matrices():
    rng = np.random.default_rng(1)
    return [symmetric(rng, len(nodes), 3 * nodes.shape[1]) for nodes in (ELEMENTS, FACES)]


def dense_sum(matrices):
    """Return the sum over all components, entry by entry."""
    total = np.zeros((3 * N_NODES, 3 * N_NODES))
    for connectivity, ofs in zip((ELEMENTS, FACES), matrices, strict=True):
        for nodes, matrix in zip(connectivity, ofs, strict=True):
            components = (3 * nodes[:, None] + np.arange(3)).ravel()
            total[np.ix_(components, components)] += matrix
    return total


def test_assembled_matrix_is_the_lower_triangle_of_the_dense_sum(free):
    """Of the unknowns only, in their order; to round-off of a few additions."""
    pattern = linear_solver.pattern(free, [ELEMENTS, FACES])
    lower = pattern.assemble(element_matrices())
    unknown = free.ravel()
    exact = np.tril(dense_sum(element_matrices())[np.ix_(unknown, unknown)])
    assert pattern.n_free == free.sum()
    assert lower.shape == exact.shape
    assert np.abs(lower.toarray() - exact).max() < 1e-14
    assert lower.nnz == np.count_nonzero(exact)


def test_assembled_matrix_has_sorted_columns_without_duplicates(free):
    """What a factorisation may expect of a compressed sparse matrix."""
    lower = linear_solver.pattern(free, [ELEMENTS, FACES]).assemble(element_matrices())
    for start, end in zip(lower.indptr[:-1], lower.indptr[1:], strict=True):
        assert np.all(np.diff(lower.indices[start:end]) > 0)


def test_one_pattern_serves_other_matrices(free):
    """The pattern keeps nothing of the values: twice the matrices are twice the sum."""
    pattern = linear_solver.pattern(free, [ELEMENTS, FACES])
    matrices = element_matrices()
    once, twice = (pattern.assemble([scale * m for m in matrices]) for scale in (1, 2))
    assert np.array_equal(2 * once.toarray(), twice.toarray())


def test_restricted_matrix_is_that_of_the_unknowns(free):
    """The same from a matrix of all components as from the elements'."""
    matrices = element_matrices()
    pattern = linear_solver.pattern(free, [ELEMENTS, FACES])
    restricted = pattern.restrict(sparse.csr_array(dense_sum(matrices)))
    assert np.abs((restricted - pattern.assemble(matrices)).toarray()).max() < 1e-14


def band_matrix(n=40, half_width=6, shift=0.0):
    """Return a symmetric band matrix; positive definite without a negative shift."""
    rng = np.random.default_rng(2)
    factor = np.tril(rng.normal(size=(n, n))) - np.tril(rng.normal(size=(n, n)), -half_width)
    factor = np.triu(factor, -half_width + 1) + 3 * np.eye(n)
    return factor @ factor.T + shift * np.eye(n)


def lower_of(matrix):
    return sparse.csc_array(np.tril(matrix))


def pardiso(lower):
    return linear_solver.pardiso(lower, pytest.importorskip("pypardiso.pardiso_wrapper"))


METHODS = [linear_solver.banded, linear_solver.superlu, pardiso, linear_solver.factorise]


@pytest.mark.parametrize("method", METHODS)
def test_factorisation_solves(method):
    """Against a dense solve; the matrix's condition leaves 1e-10."""
    matrix = band_matrix()
    right = np.random.default_rng(3).normal(size=len(matrix))
    before = right.copy()
    solve = method(lower_of(matrix))
    exact = np.linalg.solve(matrix, right)
    assert np.abs(solve(right) - exact).max() < 1e-10 * np.abs(exact).max()
    assert np.abs(solve(2 * right) - 2 * exact).max() < 1e-10 * np.abs(exact).max()
    assert np.array_equal(right, before)


@pytest.mark.parametrize("method", METHODS)
def test_factorisation_refuses_an_indefinite_matrix(method):
    """Shifted so that the lowest eigenvalue is just below zero, then one that is far below."""
    lowest = np.linalg.eigvalsh(band_matrix()).min()
    assert lowest > 0
    for shift in (-1.01 * lowest, -100 * lowest):
        with pytest.raises(LinAlgError):
            method(lower_of(band_matrix(shift=shift)))
    method(lower_of(band_matrix(shift=-0.99 * lowest)))


def shuffled():
    """Return a band matrix in a random order, and the order that makes it a band again."""
    matrix = band_matrix()
    order = np.random.default_rng(4).permutation(len(matrix))
    return matrix[np.ix_(order, order)], np.argsort(order)


@pytest.mark.parametrize("method", [linear_solver.banded, linear_solver.factorise])
def test_another_order_narrows_the_band_and_leaves_the_solution(method):
    matrix, order = shuffled()
    lower = lower_of(matrix)
    assert linear_solver.bandwidth(lower) > 30
    assert linear_solver.bandwidth(lower, order) == np.max(np.nonzero(band_matrix()[0]))
    right = np.random.default_rng(3).normal(size=(len(matrix), 2))
    exact = np.linalg.solve(matrix, right)
    assert np.abs(method(lower, order)(right) - exact).max() < 1e-10 * np.abs(exact).max()


def test_sections_are_numbered_one_after_the_other_from_below():
    points = np.array([[0, 1, 0], [0, 0, 2], [1, 0, 0], [0, -1, 2]], float)
    free = np.ones((4, 3), bool)
    free[2, 1] = False
    # Unknowns 0-2 are of the first node, 3-5 of the second, 6-7 of the third, 8-10 of the fourth.
    assert list(linear_solver.section_order(points, free)) == [6, 7, 0, 1, 2, 8, 9, 10, 3, 4, 5]


@pytest.fixture
def chosen(monkeypatch):
    """Record which methods are called."""
    called = []
    for name in ("banded", "superlu", "pardiso"):
        monkeypatch.setattr(linear_solver, name, lambda *_, name=name: called.append(name))
    return called


def test_banded_serves_until_its_work_is_large_and_superlu_beyond_its_memory(chosen, monkeypatch):
    """PARDISO takes over where it is installed; without it the band goes on while it fits."""
    lower = lower_of(band_matrix())
    library = None
    monkeypatch.setattr(linear_solver, "_pypardiso", lambda: library)
    linear_solver.factorise(lower)
    monkeypatch.setattr(linear_solver, "LARGEST_BANDED_WORK", 1.0)
    linear_solver.factorise(lower)
    monkeypatch.setattr(linear_solver, "LARGEST_BAND", 1.0)
    linear_solver.factorise(lower)
    library = object()
    linear_solver.factorise(lower)
    assert chosen == ["banded", "banded", "superlu", "pardiso"]
