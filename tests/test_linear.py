"""Assembly and factorisation of the stiffness matrix, against dense matrices."""

import numpy as np
import pytest
from scipy import sparse
from scipy.linalg import LinAlgError

from acoustube.indentation import linear_solver
from acoustube.indentation.dissection import dissected
from acoustube.indentation.multifrontal import Analysis

N_NODES = 9
ELEMENTS = np.array([[0, 1, 3], [1, 2, 4], [3, 4, 5], [5, 7, 6]])
FACES = np.array([[0, 3], [5, 7], [8, 2]])


@pytest.fixture
def free():
    """Mask of the unknown components: two thirds, of all nodes but one."""
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
    """For the unknowns only, in their order; to the round-off of a few additions."""
    pattern = linear_solver.pattern(free, [ELEMENTS, FACES])
    lower = pattern.assemble(element_matrices())
    unknown = free.ravel()
    exact = np.tril(dense_sum(element_matrices())[np.ix_(unknown, unknown)])
    assert pattern.n_free == free.sum()
    assert lower.shape == exact.shape
    assert np.abs(lower.toarray() - exact).max() < 1e-14
    assert lower.nnz == np.count_nonzero(exact)


def test_assembled_matrix_has_sorted_columns_without_duplicates(free):
    """A factorisation may rely on this format of a compressed sparse matrix."""
    lower = linear_solver.pattern(free, [ELEMENTS, FACES]).assemble(element_matrices())
    for start, end in zip(lower.indptr[:-1], lower.indptr[1:], strict=True):
        assert np.all(np.diff(lower.indices[start:end]) > 0)


def test_one_pattern_serves_other_matrices(free):
    """The pattern holds no values: twice the matrices give twice the sum."""
    pattern = linear_solver.pattern(free, [ELEMENTS, FACES])
    matrices = element_matrices()
    once, twice = (pattern.assemble([scale * m for m in matrices]) for scale in (1, 2))
    assert np.array_equal(2 * once.toarray(), twice.toarray())


def test_restricted_matrix_is_that_of_the_unknowns(free):
    """Restricting a matrix of all components equals assembling the elements' matrices."""
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


METHODS = [pardiso, linear_solver.factorise]


@pytest.mark.parametrize("method", METHODS)
def test_factorisation_solves(method):
    """Compared with a dense solve; the condition of the matrix leaves 1e-10."""
    matrix = band_matrix()
    right = np.random.default_rng(3).normal(size=len(matrix))
    before = right.copy()
    solve = method(lower_of(matrix))
    exact = np.linalg.solve(matrix, right)
    assert np.abs(solve(right) - exact).max() < 1e-10 * np.abs(exact).max()
    assert np.abs(solve(2 * right) - 2 * exact).max() < 1e-10 * np.abs(exact).max()
    assert np.array_equal(right, before)


@pytest.mark.parametrize("count", [0, 1, 3])
def test_columns_are_solved_as_they_are_alone(count):
    matrix = band_matrix()
    right = np.random.default_rng(3).normal(size=(len(matrix), count))
    solution = linear_solver.factorise(lower_of(matrix))(right)
    np.testing.assert_allclose(solution, np.linalg.solve(matrix, right), atol=1e-10)


@pytest.mark.parametrize("method", METHODS)
def test_factorisation_refuses_an_indefinite_matrix(method):
    """The lowest eigenvalue is shifted to just below zero, and then far below."""
    lowest = np.linalg.eigvalsh(band_matrix()).min()
    assert lowest > 0
    for shift in (-1.01 * lowest, -100 * lowest):
        with pytest.raises(LinAlgError):
            method(lower_of(band_matrix(shift=shift)))
    method(lower_of(band_matrix(shift=-0.99 * lowest)))


def grid_matrix(shape, width=1, shift=0.0):
    """Return the lower triangle of a random matrix on the points of a grid, and the points.

    Entries are between points up to `width` apart along each axis; positive definite without a
    shift.
    """
    points = np.stack([axis.ravel() for axis in np.indices(shape)], axis=1).astype(float)
    near = np.abs(points[:, None] - points).max(axis=2) <= width
    entries = np.where(near, np.random.default_rng(5).normal(size=near.shape), 0.0)
    entries = entries + entries.T
    diagonal = np.abs(entries).sum(axis=1) + shift
    np.fill_diagonal(entries, diagonal)
    return entries, points


def test_dissection_separates_its_parts():
    """One unknown of each entry is in the subtree of the other's front; separators are planes."""
    matrix, points = grid_matrix((24, 9, 3))
    tree = dissected(lower_of(matrix), points)
    rows, columns = np.nonzero(matrix)
    low, high = np.sort([tree.front[rows], tree.front[columns]], axis=0)
    assert np.all(tree.first[high] <= low)
    assert len(tree.parent) > 5
    (last,) = np.nonzero(tree.front == len(tree.parent) - 1)
    assert len(last) == 9 * 3
    assert np.ptp(points[last, 0]) == 0


def test_pairs_that_a_dissection_separates_are_moved_to_where_it_does_not():
    matrix, points = grid_matrix((24, 9, 3))
    tree = dissected(lower_of(matrix), points)
    rng = np.random.default_rng(6)
    rows, columns = rng.integers(len(points), size=(2, 20))
    kept = tree.holding(rows, columns)
    assert not np.array_equal(kept.front, tree.front)
    for pairs in ((rows, columns), np.nonzero(matrix)):
        low, high = np.sort([kept.front[pairs[0]], kept.front[pairs[1]]], axis=0)
        assert np.all(kept.first[high] <= low)


@pytest.mark.parametrize("width", [1, 2])
@pytest.mark.parametrize("shape", [(1, 1), (40, 8), (14, 7, 4)])
def test_fronts_solve_as_a_dense_matrix(shape, width):
    """Another matrix of the same sparsity, then one with more entries; 1 and 2 right sides."""
    matrix, points = grid_matrix(shape, width)
    analysis = Analysis(points)
    rng = np.random.default_rng(7)
    joined = matrix.copy()
    for first, second in rng.integers(len(points), size=(5, 2)):
        joined[first, second] = joined[second, first] = 0.1
    for each in (matrix, 2 * matrix + np.eye(len(matrix)), joined, matrix):
        solve = linear_solver.factorise(lower_of(each), analysis)
        for right in (rng.normal(size=len(each)), rng.normal(size=(len(each), 2))):
            exact = np.linalg.solve(each, right)
            assert solve(right) == pytest.approx(exact, abs=1e-12 * np.abs(exact).max())


def test_fronts_refuse_an_indefinite_matrix_wherever_its_negative_pivot_is():
    matrix, points = grid_matrix((40, 8))
    analysis = Analysis(points)
    for wrong in (0, 17, 160, 319):
        spoilt = matrix.copy()
        spoilt[wrong, wrong] = -1.0
        with pytest.raises(LinAlgError):
            linear_solver.factorise(lower_of(spoilt), analysis)
    linear_solver.factorise(lower_of(matrix), analysis)


def test_parts_without_common_entries_are_solved_too():
    """Two blocks: the separator between them is empty."""
    block, points = grid_matrix((20, 10))
    matrix = np.block([[block, np.zeros_like(block)], [np.zeros_like(block), 2 * block]])
    points = np.concatenate([points, points + np.array([20, 0])])
    right = np.random.default_rng(8).normal(size=len(matrix))
    exact = np.linalg.solve(matrix, right)
    found = linear_solver.factorise(lower_of(matrix), Analysis(points))(right)
    assert found == pytest.approx(exact, abs=1e-12 * np.abs(exact).max())


def test_pardiso_serves_large_work_where_it_is_installed(monkeypatch):
    called, lower = [], lower_of(band_matrix())
    monkeypatch.setattr(linear_solver, "pardiso", lambda *_: called.append("pardiso"))
    library = object()
    monkeypatch.setattr(linear_solver, "_pypardiso", lambda: library)
    linear_solver.factorise(lower)
    monkeypatch.setattr(linear_solver, "LARGEST_OWN_WORK", 1.0)
    linear_solver.factorise(lower)
    library = None
    linear_solver.factorise(lower)
    assert called == ["pardiso"]
