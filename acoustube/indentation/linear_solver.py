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
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded
from scipy.linalg.blas import dtrsm
from scipy.sparse.linalg import splu

from acoustube.base.types import Array, Index

Solve = Callable[[Array], Array]

LARGEST_BANDED_WORK = 5e10
"""Unknowns times squared bandwidth above which PARDISO is faster than banded Cholesky."""
LARGEST_BAND = 3e8
"""Entries of the band (2.4 GB) above which it is not stored."""
FORWARD_BLOCK = 96
"""Columns of a banded factor that are eliminated together."""
_PARDISO_POSITIVE_DEFINITE = 2
_PARDISO_NOT_POSITIVE = -4


@dataclass(frozen=True, eq=False)
class Pattern:
    """Sparsity pattern of the stiffness matrix's lower triangle, with the map from its elements.

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


def factorise(lower: sparse.csc_array, order: Index | None = None) -> Solve:
    """Factorise a symmetric positive definite matrix by the fastest direct method for its size.

    Parameters
    ----------
    lower : sparse array of shape (n, n)
        Lower triangle of the matrix, with its diagonal; the unknowns are numbered along the tube.
    order : array of int, shape (n,), optional
        Another order of the unknowns, used if its band is narrower.

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
    Banded Cholesky [1]_ runs at the processor's peak rate, with n b^2 operations for a bandwidth b;
    it is the fastest up to about 5e10, which only a whole tube or a fine section exceeds. Above,
    PARDISO is, if pypardiso is installed. SuperLU took 4 to 10 times as long as banded Cholesky on
    swept tubes: it is for a band too large to store.

    References
    ----------
    .. [1] G. H. Golub, C. F. Van Loan, "Matrix Computations", 4th ed., Johns Hopkins University
       Press (2013), section 4.3.
    """
    n = lower.shape[0]
    if order is not None and bandwidth(lower, order) >= bandwidth(lower):
        order = None
    width = bandwidth(lower, order) + 1
    if n * width**2 > LARGEST_BANDED_WORK and (library := _pypardiso()) is not None:
        return pardiso(lower, library)
    return superlu(lower) if n * width > LARGEST_BAND else banded(lower, order)


def section_order(points: Array, free: NDArray[np.bool_]) -> Index:
    """Return the order of the unknowns by section, and in each section from its bottom upwards.

    Both sides of a ring are numbered together, so that the band of a whole tube is narrow.

    Parameters
    ----------
    points : array of shape (n_nodes, 3)
        In m; the tube lies along z.
    free : array of bool, shape (n_nodes, 3)
        Displacement components that are unknowns.

    Returns
    -------
    array of int, shape (n_free,)
    """
    _, y, z = points[np.nonzero(free)[0]].T
    return np.lexsort((y, z))


def bandwidth(lower: sparse.csc_array, order: Index | None = None) -> int:
    """Return the half bandwidth of a matrix: the largest distance of an entry from the diagonal.

    Parameters
    ----------
    lower : sparse array of shape (n, n)
        Its lower triangle.
    order : array of int, shape (n,), optional
        Another order of the unknowns.
    """
    rows, columns = _places(lower, order)
    return int(np.abs(rows - columns).max(initial=0))


def _places(lower: sparse.csc_array, order: Index | None) -> tuple[Index, Index]:
    """Return the row and column of every entry after reordering the unknowns."""
    columns = np.repeat(np.arange(lower.shape[0]), np.diff(lower.indptr))
    if order is None:
        return lower.indices, columns
    place = np.argsort(order)
    return place[lower.indices], place[columns]


@dataclass(frozen=True, eq=False)
class BandedFactor:
    """Cholesky factor of a banded matrix.

    Attributes
    ----------
    band : array of shape (bandwidth + 1, n)
        Lower triangle of the factor by columns, as LAPACK stores it.
    place : array of int, shape (n,)
        Place of each unknown in the order of elimination.
    """

    band: Array
    place: Index

    def __call__(self, right: Array) -> Array:
        """Solve for right-hand sides of shape (n,) or (n, k)."""
        ordered = np.empty_like(right)
        ordered[self.place] = right
        solution = cho_solve_banded((self.band, True), ordered, check_finite=False)
        return np.asarray(solution[self.place])

    def forward(self, unknowns: Index) -> Array:
        """Return the columns of the factor's inverse of some unknowns.

        Parameters
        ----------
        unknowns : array of int, shape (k,)
            In the order of elimination.

        Returns
        -------
        array of shape (n, k)
            In the order of elimination. The products of its columns are the entries of the matrix's
            inverse at the unknowns, their compliance.

        Notes
        -----
        By blocks of columns, with matrix products; LAPACK solves for one right-hand side after the
        other, which takes ten times as long. A column is zero up to its unknown, so that few rows
        are computed for unknowns that are eliminated late.
        """
        width, n = len(self.band) - 1, self.band.shape[1]
        first = self.place[unknowns]
        found = np.zeros((n, len(unknowns)))
        found[first, np.arange(len(unknowns))] = 1.0
        entries, block = self.band.ravel(order="F"), max(1, min(FORWARD_BLOCK, width))
        for start in range(int(first.min(initial=n)), n, block):
            here = min(block, n - start)
            rows, count = min(here + width, n - start), int(np.searchsorted(first, start + here))
            # Row i and column j of the factor are i + j * width after its first entry.
            dense = as_strided(
                entries[start * (width + 1) :], (rows, here), (8, 8 * width), writeable=False
            )
            below, last = found[start + here : start + rows, :count], width + 1 - here
            solved = dtrsm(1.0, dense[:here], found[start : start + here, :count], lower=1)
            found[start : start + here, :count] = solved
            below[:last] -= dense[here : width + 1] @ solved
            below[last:] -= np.triu(dense[width + 1 :], 1) @ solved
        return found


def banded(lower: sparse.csc_array, order: Index | None = None) -> BandedFactor:
    """Factorise by banded Cholesky; arguments, result and errors as of :func:`factorise`.

    Notes
    -----
    The last unknowns are eliminated first: those of the middle of a press, which is at the start of
    half a tube, come late; see :meth:`BandedFactor.forward`.
    """
    n = lower.shape[0]
    rows, columns = _places(lower, order)
    offset = np.abs(rows - columns)
    band = np.zeros((int(offset.max()) + 1, n), order="F")
    band[offset, n - 1 - np.maximum(rows, columns)] = lower.data
    factor = cholesky_banded(band, overwrite_ab=True, lower=True, check_finite=False)
    place = np.arange(n) if order is None else np.argsort(order)
    return BandedFactor(factor, n - 1 - place)


def superlu(lower: sparse.csc_array) -> Solve:
    """Factorise by sparse LU in SciPy; argument, result and errors as of :func:`factorise`.

    Notes
    -----
    In symmetric mode with a pivoting threshold of zero, every pivot is on the diagonal and the
    factors are L D L^T with D the diagonal of U. By Sylvester's law of inertia [1]_ D has as many
    negative entries as the matrix has negative eigenvalues. At a zero pivot the library swaps rows,
    which its permutations show, or fails.

    References
    ----------
    .. [1] J. J. Sylvester, "A demonstration of the theorem that every homogeneous quadratic
       polynomial is reducible by real orthogonal substitutions to the form of a sum of positive and
       negative squares", Philosophical Magazine 4, 138-142 (1852).
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
    """Factorise by PARDISO of Intel's MKL; result and errors as of :func:`factorise`.

    Parameters
    ----------
    lower : sparse array of shape (n, n)
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
    return library.PyPardisoSolver(mtype=_PARDISO_POSITIVE_DEFINITE)
