"""Sparse stiffness matrix: assembly from element matrices, and direct factorisation."""

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
from scipy.linalg import LinAlgError

from acoustube.base.types import Array, Index
from acoustube.indentation.multifrontal import Analysis, multifrontal

Solve = Callable[[Array], Array]

LARGEST_OWN_WORK = 1e11
"""Number of operations of a factorisation above which PARDISO is used if it is installed.

On the largest mesh measured (5e10 operations) multifrontal Cholesky was faster than PARDISO."""
_PARDISO_POSITIVE_DEFINITE = 2
_PARDISO_NOT_POSITIVE = -4


@dataclass(frozen=True, eq=False)
class Pattern:
    """Sparsity pattern of the stiffness matrix's lower triangle, and the map from element matrices.

    Attributes
    ----------
    free : array of bool, shape (n_nodes, 3)
        Displacement components that are unknowns; the others are zero.
    source : array of int, shape (n_entries,)
        Positions in the concatenated element matrices, grouped by the entry they are summed into.
    starts : array of int, shape (n_nonzeros,)
        Start of each group in `source`.
    rows, columns : array of int, shape (n_nonzeros,)
        Row and column of each group, sorted by column.
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
        """Assemble the lower triangle of the stiffness matrix.

        Parameters
        ----------
        matrices : sequence of array of shape (n_elements, n, n)
            Element matrices in the order of the connectivities given to :func:`pattern`.

        Returns
        -------
        sparse array of shape (n_free, n_free)
        """
        entries = np.concatenate([np.ravel(matrix) for matrix in matrices])
        values = np.add.reduceat(entries[self.source], self.starts)
        pointers = np.searchsorted(self.columns, np.arange(self.n_free + 1))
        shape = (self.n_free, self.n_free)
        return sparse.csc_array((values, self.rows, pointers), shape=shape)

    def restrict(self, matrix: Any) -> sparse.csc_array:
        """Return the lower triangle of a matrix, rows and columns of the unknowns only.

        Parameters
        ----------
        matrix : sparse array of shape (3 n_nodes, 3 n_nodes)
        """
        free = np.flatnonzero(self.free.ravel())
        return sparse.tril(matrix[free][:, free], format="csc")


def pattern(free: NDArray[np.bool_], connectivities: Sequence[Index]) -> Pattern:
    """Return the sparsity pattern of a stiffness matrix.

    Parameters
    ----------
    free : array of bool, shape (n_nodes, 3)
        Displacement components that are unknowns.
    connectivities : sequence of array of int, shape (n_elements, n_local)
        Node numbers of the elements, one array for each kind.
    """
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


def factorise(lower: sparse.csc_array, analysis: Analysis | None = None) -> Solve:
    """Factorise a symmetric positive definite matrix by the fastest direct method for its size.

    Parameters
    ----------
    lower : sparse array of shape (n, n)
        Lower triangle of the matrix, with its diagonal.
    analysis : Analysis, optional
        Elimination order of this or a similar matrix. By default it is computed with the numbers
        of the unknowns as their coordinates.

    Returns
    -------
    callable
        Solver for right-hand sides of shape (n,) or (n, k).

    Raises
    ------
    scipy.linalg.LinAlgError
        If the matrix is not positive definite.

    Notes
    -----
    Multifrontal Cholesky takes between a third and all of the time of banded Cholesky.
    """
    analysis = analysis or Analysis(np.arange(lower.shape[0], dtype=float)[:, None])
    plan = analysis.plan(lower)
    if plan.operations > LARGEST_OWN_WORK and (library := _pypardiso()) is not None:
        return pardiso(lower, library)
    return multifrontal(lower, plan)


def pardiso(lower: sparse.csc_array, library: Any) -> Solve:
    """Factorise by PARDISO of Intel's MKL; result and errors as for :func:`factorise`.

    Parameters
    ----------
    lower : sparse array of shape (n, n)
        Lower triangle of the matrix, with its diagonal.
    library : module
        ``pypardiso.pardiso_wrapper``.
    """
    # The upper triangle by rows is the lower triangle of a symmetric matrix by columns.
    n = lower.shape[0]
    upper = sparse.csr_matrix((lower.data, lower.indices, lower.indptr), shape=(n, n))
    # A copy, because every new solver looks for MKL on the disk, which takes 0.2 s.
    solver = copy(_unused_solver(library))
    solver.pt, solver.iparm = np.zeros_like(solver.pt), np.zeros_like(solver.iparm)
    # From 2025 on, MKL misreads the defaults of its parameters unless the first is set, which
    # states that all are given; the second selects nested dissection.
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

    # MKL stores the factors outside of Python's memory management.
    weakref.finalize(solve, solver.free_memory, everything=True).atexit = False
    return solve


@cache
def _pypardiso() -> Any:
    """Return pypardiso's solver module, or None if it or MKL is not installed."""
    try:
        return import_module("pypardiso.pardiso_wrapper")
    except ImportError:
        return None


@cache
def _unused_solver(library: Any) -> Any:
    """Return a solver of positive definite matrices that is never used itself, only copied."""
    return library.PyPardisoSolver(mtype=_PARDISO_POSITIVE_DEFINITE)
