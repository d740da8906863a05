"""The stiffness matrix: where the entries of the element matrices go, and how it is factorised."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from scipy.sparse.linalg import splu

from acoustube.base.types import Array, Index

Solve = Callable[[Array], Array]

LARGEST_BANDED_WORK = 5e10
"""Unknowns times squared bandwidth beyond which PARDISO is quicker than banded Cholesky."""
LARGEST_BAND = 3e8
"""Numbers in the band (2.4 GB) beyond which it is not stored."""
_PARDISO_POSITIVE_DEFINITE = 2
_PARDISO_NOT_POSITIVE = -4


@dataclass(frozen=True, eq=False)
class Pattern:
    """Where each entry of the element matrices goes in the lower triangle of the stiffness matrix.

    Attributes
    ----------
    free : array of bool, shape (n_nodes, 3)
        Displacement components that are unknowns; the others are zero.
    source : array of int
        Positions of the entries in the concatenated element matrices, those that are summed into
        one place next to each other.
    starts : array of int
        Where in `source` each such group begins.
    rows, columns : array of int
        Place of each group, sorted by column.
    """

    free: NDArray[np.bool_]
    source: Index
    starts: Index
    rows: Index
    columns: Index

    @property
    def n_free(self) -> int:
        """Number of unknowns."""
        return int(self.free.sum())

    def assemble(self, matrices: Sequence[Array]) -> sparse.csc_array:
        """Return the lower triangle of the sum of element matrices."""
        entries = np.concatenate([np.ravel(matrix) for matrix in matrices])
        values = np.add.reduceat(entries[self.source], self.starts)
        pointers = np.searchsorted(self.columns, np.arange(self.n_free + 1))
        shape = (self.n_free, self.n_free)
        return sparse.csc_array((values, self.rows, pointers), shape=shape)

    def restrict(self, matrix: Any) -> sparse.csc_array:
        """Return the lower triangle of a matrix of all components, for the unknowns only."""
        free = np.flatnonzero(self.free.ravel())
        return sparse.tril(matrix[free][:, free], format="csc")


def pattern(free: NDArray[np.bool_], connectivities: Sequence[Index]) -> Pattern:
    """Prepare the assembly of element matrices, each over the nodes of a row of a connectivity."""
    number = np.where(free, np.cumsum(free).reshape(free.shape) - 1, -1)
    rows, columns = [], []
    for nodes in connectivities:
        unknowns = number[nodes].reshape(len(nodes), -1)
        size = unknowns.shape[1]
        rows.append(np.repeat(unknowns, size, axis=1).ravel())
        columns.append(np.tile(unknowns, size).ravel())
    row, column = np.concatenate(rows), np.concatenate(columns)
    (source,) = np.nonzero((column >= 0) & (row >= column))
    place = column[source] * free.sum() + row[source]
    order = np.argsort(place, kind="stable")
    places, starts = np.unique(place[order], return_index=True)
    columns_, rows_ = np.divmod(places, free.sum())
    return Pattern(free, source[order], starts, rows_.astype(np.int32), columns_)


def factorise(lower: sparse.csc_array, order: Index | None = None) -> Solve:
    """Factorise by the direct method that is quickest for the matrix.

    Parameters
    ----------
    lower : sparse array of shape (n, n)
        Lower triangle of a symmetric matrix, with its diagonal, whose unknowns are numbered along
        the tube.
    order : array of int, shape (n,), optional
        Another order of the unknowns, taken where it makes the band narrower.

    Returns
    -------
    callable
        Solves for right-hand sides of shape (n,) or (n, k).

    Raises
    ------
    scipy.linalg.LinAlgError
        If the matrix is not positive definite.

    Notes
    -----
    Banded Cholesky works as fast as the processor can multiply, but its work is n b^2 for a
    bandwidth b; it is the quickest up to some 5e10, which only a whole tube or a fine section
    exceeds. Beyond that PARDISO is, if pypardiso is installed. SuperLU took 4 to 10 times as long
    as banded Cholesky on swept tubes: it is for a band that is too large to store.
    """
    n = lower.shape[0]
    if order is not None and bandwidth(lower, order) >= bandwidth(lower):
        order = None
    width = bandwidth(lower, order) + 1
    if n * width**2 > LARGEST_BANDED_WORK and (library := _pypardiso()) is not None:
        return pardiso(lower, library)
    return superlu(lower) if n * width > LARGEST_BAND else banded(lower, order)


def section_order(points: Array, free: NDArray[np.bool_]) -> Index:
    """Return the order of the unknowns section by section, and in each from its bottom upwards.

    Two sides of a ring are then numbered together: its last nodes are not far from its first.

    Parameters
    ----------
    points : array of shape (n_nodes, 3)
        In m; the tube lies along z.
    free : array of bool, shape (n_nodes, 3)
        Which displacement components are unknowns.
    """
    _, y, z = points[np.nonzero(free)[0]].T
    return np.lexsort((y, z))


def bandwidth(lower: sparse.csc_array, order: Index | None = None) -> int:
    """Return the largest distance of an entry from the diagonal, with the unknowns in an order."""
    rows, columns = _places(lower, order)
    return int(np.abs(rows - columns).max(initial=0))


def _places(lower: sparse.csc_array, order: Index | None) -> tuple[Index, Index]:
    """Return row and column of every entry, with the unknowns in an order."""
    columns = np.repeat(np.arange(lower.shape[0]), np.diff(lower.indptr))
    if order is None:
        return lower.indices, columns
    place = np.argsort(order)
    return place[lower.indices], place[columns]


def banded(lower: sparse.csc_array, order: Index | None = None) -> Solve:
    """Factorise by banded Cholesky; arguments, result and errors as of :func:`factorise`."""
    rows, columns = _places(lower, order)
    offset = np.abs(rows - columns)
    band = np.zeros((int(offset.max()) + 1, lower.shape[0]), order="F")
    band[offset, np.minimum(rows, columns)] = lower.data
    factor = cholesky_banded(band, overwrite_ab=True, lower=True, check_finite=False), True
    if order is None:
        return lambda right: cho_solve_banded(factor, right, check_finite=False)
    place = np.argsort(order)
    return lambda right: cho_solve_banded(factor, right[order], check_finite=False)[place]


def superlu(lower: sparse.csc_array) -> Solve:
    """Factorise by sparse elimination in SciPy; result and errors as of :func:`factorise`.

    Notes
    -----
    With no pivoting threshold in symmetric mode, every pivot is taken from the diagonal and the
    factors are L D L^T with D the diagonal of U. By Sylvester's law D then has as many negative
    entries as the matrix has negative eigenvalues. A zero pivot makes the library swap rows, which
    shows in its permutations, or give up.
    """
    matrix = (lower + sparse.tril(lower, -1).T).tocsc()
    options = {"SymmetricMode": True}
    try:
        factor = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    except RuntimeError as error:
        raise LinAlgError(f"The matrix is singular: {error}.") from error
    symmetric = np.array_equal(factor.perm_r, factor.perm_c)
    if not (symmetric and np.all(factor.U.diagonal() > 0)):
        raise LinAlgError("The matrix is not positive definite.")
    return factor.solve


def pardiso(lower: sparse.csc_array, library: Any) -> Solve:
    """Factorise by PARDISO in Intel's MKL; result and errors as of :func:`factorise`.

    Parameters
    ----------
    lower : sparse array of shape (n, n)
    library : module
        ``pypardiso.pardiso_wrapper``.
    """
    # Row by row, the upper triangle of a symmetric matrix is its lower one column by column.
    n = lower.shape[0]
    upper = sparse.csr_matrix((lower.data, lower.indices, lower.indptr), shape=(n, n))
    # A copy, because every new solver looks for MKL on the disk, which takes 0.2 s.
    solver = copy(_unused_solver(library))
    solver.pt, solver.iparm = np.zeros_like(solver.pt), np.zeros_like(solver.iparm)
    # From 2025 on, MKL takes the defaults of its parameters amiss unless the first is set, which
    # says that all are given; the second asks for nested dissection.
    solver.set_iparm(1, 1)
    solver.set_iparm(2, 2)
    try:
        solver.factorize(upper)
    except library.PyPardisoError as error:
        solver.free_memory(everything=True)
        if error.value == _PARDISO_NOT_POSITIVE:
            raise LinAlgError("The matrix is not positive definite.") from error
        raise

    def solve(right: Array) -> Array:
        return solver.solve(upper, right)

    # MKL keeps the factors where Python's memory management does not see them.
    weakref.finalize(solve, solver.free_memory, everything=True).atexit = False
    return solve


@cache
def _pypardiso() -> Any:
    """Return pypardiso's module of the solver, or None where it or MKL is not installed."""
    try:
        return import_module("pypardiso.pardiso_wrapper")
    except ImportError:
        return None


@cache
def _unused_solver(library: Any) -> Any:
    return library.PyPardisoSolver(mtype=_PARDISO_POSITIVE_DEFINITE)
