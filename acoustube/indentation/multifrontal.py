"""Multifrontal Cholesky factorisation of a sparse matrix by dense blocks [1]_.

Each separator of a nested dissection (:mod:`acoustube.indentation.dissection`) is eliminated in a
dense front: its own rows, and the later rows that it and its descendants touch, that is, to which
they are coupled. The elimination leaves a dense Schur complement on the touched rows, which is
added into the parent's front. All products are computed by BLAS and LAPACK.

References
----------
.. [1] J. W. H. Liu, "The multifrontal method for sparse matrix solution: theory and practice", SIAM
   Rev. 34, 82-109 (1992). doi:10.1137/1034004
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numba
import numpy as np
from scipy import sparse
from scipy.linalg import LinAlgError
from scipy.linalg.blas import dsyrk, dtrsm, dtrsv
from scipy.linalg.lapack import dpotrf

from acoustube.base.types import Array, Index
from acoustube.indentation.dissection import Dissection, dissected


class Plan(NamedTuple):
    """Fronts of a factorisation, for all matrices of one sparsity.

    Attributes
    ----------
    place : array of int, shape (n,)
        Place of each unknown in the order of elimination.
    parent, first : array of int, shape (n_fronts,)
        As for :class:`~acoustube.indentation.dissection.Dissection`.
    starts : array of int, shape (n_fronts + 1,)
        First place that each front eliminates.
    touched : array of int, shape (n_fronts + 1,)
        Start of each front's touched rows in `rows`.
    rows : array of int, shape (n_rows,)
        Places that each front touches beyond its own, in rising order.
    into : array of int, shape (n_rows,)
        Row of each of these places in the parent's front.
    offsets : array of int, shape (n_fronts + 1,)
        Start of each front's part of the factor: its square block, then the rows below.
    schur : array of int, shape (n_fronts,)
        Start of each front's Schur complement in `stack`.
    entries : array of int, shape (n_entries,)
        Position of each entry of the matrix's lower triangle in the storage of the factor.
    stack : array
        Working storage of Schur complements, overwritten by each factorisation.
    """

    place: Index
    parent: Index
    first: Index
    starts: Index
    touched: Index
    rows: Index
    into: Index
    offsets: Index
    schur: Index
    entries: Index
    stack: Array

    @property
    def operations(self) -> float:
        """Number of additions and multiplications of a factorisation."""
        own, below = np.diff(self.starts).astype(float), np.diff(self.touched)
        return float(np.sum((own + below) ** 3 - below**3.0) / 3)


@dataclass(eq=False)
class Analysis:
    """Order of elimination of a model's matrices, and the plan of the last matrix.

    Parameters
    ----------
    points : array of shape (n, n_axes)
        Coordinates of the unknowns' nodes, undeformed.
    """

    points: Array
    _dissection: Dissection | None = field(init=False, repr=False, default=None)
    _last: tuple[sparse.csc_array, Plan] | None = field(init=False, repr=False, default=None)

    def plan(self, lower: sparse.csc_array) -> Plan:
        """Return the plan of a matrix; the first matrix's sparsity determines the dissection.

        Parameters
        ----------
        lower : sparse array of shape (n, n)
            Its lower triangle.
        """
        if self._last is not None and _same_sparsity(self._last[0], lower):
            return self._last[1]
        if self._dissection is None:
            self._dissection = dissected(lower, self.points)
        plan = planned(lower, self._dissection)
        self._last = lower, plan
        return plan


def _same_sparsity(one: sparse.csc_array, other: sparse.csc_array) -> bool:
    return np.array_equal(one.indptr, other.indptr) and np.array_equal(one.indices, other.indices)


def planned(lower: sparse.csc_array, dissection: Dissection) -> Plan:
    """Return the plan of a matrix's factorisation by fronts.

    Parameters
    ----------
    lower : sparse array of shape (n, n)
        Its lower triangle, which may have entries for pairs that the dissection separates.
    dissection : Dissection
    """
    columns = np.repeat(np.arange(lower.shape[0]), np.diff(lower.indptr))
    tree = dissection.holding(lower.indices, columns)
    order = np.argsort(tree.front, kind="stable")
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    starts = np.searchsorted(tree.front[order], np.arange(len(tree.parent) + 1))
    row, column = place[lower.indices], place[columns]
    touched, rows, pointers, entry = _rows(row, column, starts, tree.parent)
    high = np.maximum(row, column)[entry]
    into, offsets, schur, stored, size = _storage(
        high, pointers, starts, tree.parent, touched, rows
    )
    entries = np.empty_like(stored)
    entries[entry] = stored
    return Plan(
        place, tree.parent, tree.first, starts, touched, rows, into, offsets, schur, entries,
        np.empty(size),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class MultifrontalFactor:
    """Cholesky factor of a sparse matrix by fronts.

    Attributes
    ----------
    plan : Plan
    entries : array
        Entries of the factor, one front after the other: each front's square block, then the rows
        below it, both in column-major order.
    """

    plan: Plan
    entries: Array

    @property
    def place(self) -> Index:
        """Place of each unknown in the order of elimination, shape (n,)."""
        return self.plan.place

    def __call__(self, right: Array) -> Array:
        """Solve for right-hand sides of shape (n,) or (n, k)."""
        if right.ndim > 1:
            found = np.empty(right.shape)
            for column, here in zip(right.T, found.T, strict=True):
                here[:] = self(column)
            return found
        plan, solution = self.plan, np.empty(len(right))
        solution[plan.place] = right
        for here, rows, square, below in self._fronts:
            solved = dtrsv(square, solution[here], lower=1)
            solution[here] = solved
            solution[rows] -= below @ solved
        for here, rows, square, below in reversed(self._fronts):
            left = solution[here] - below.T @ solution[rows]
            solution[here] = dtrsv(square, left, lower=1, trans=1)
        return np.asarray(solution[plan.place])

    @cached_property
    def _fronts(self) -> list[tuple[slice, Index, Array, Array]]:
        """Places, touched rows and two blocks of each front that eliminates an unknown."""
        plan = self.plan
        return [
            (
                slice(plan.starts[number], plan.starts[number + 1]),
                plan.rows[plan.touched[number] : plan.touched[number + 1]],
                *self.front(int(number)),
            )
            for number in np.flatnonzero(np.diff(plan.starts))
        ]

    def front(self, number: int) -> tuple[Array, Array]:
        """Return the square block of a front's columns of the factor, and the rows below it."""
        plan = self.plan
        own = plan.starts[number + 1] - plan.starts[number]
        below = plan.touched[number + 1] - plan.touched[number]
        start, end = plan.offsets[number : number + 2]
        square = self.entries[start : start + own**2].reshape(own, own, order="F")
        return square, self.entries[start + own**2 : end].reshape(below, own, order="F")

    def forward(self, unknowns: Index) -> Array:
        """Return the columns of the factor's inverse for some unknowns.

        Parameters
        ----------
        unknowns : array of int, shape (k,)
            Numbers of the unknowns, sorted by their place in the order of elimination.

        Returns
        -------
        array of shape (n, k)
            Rows are in the order of elimination. The scalar products of the columns are the entries
            of the matrix's inverse at the unknowns, their compliance.

        Notes
        -----
        A column is zero outside the fronts from that of its unknown to the root.
        """
        plan, places = self.plan, self.plan.place[unknowns]
        found = np.zeros((len(plan.place), len(unknowns)))
        found[places, np.arange(len(unknowns))] = 1.0
        begin = np.searchsorted(places, plan.starts[plan.first])
        end = np.searchsorted(places, plan.starts[1:])
        for number in np.flatnonzero((end > begin) & (np.diff(plan.starts) > 0)):
            used = slice(begin[number], end[number])
            here = slice(plan.starts[number], plan.starts[number + 1])
            square, below = self.front(int(number))
            solved = dtrsm(1.0, square, found[here, used], lower=1)
            found[here, used] = solved
            rows = plan.rows[plan.touched[number] : plan.touched[number + 1]]
            found[rows, used] -= below @ solved
        return found


def multifrontal(lower: sparse.csc_array, plan: Plan) -> MultifrontalFactor:
    """Factorise a symmetric positive definite matrix.

    Parameters
    ----------
    lower : sparse array of shape (n, n)
        Its lower triangle.
    plan : Plan
        Of a matrix of the same sparsity.

    Returns
    -------
    MultifrontalFactor

    Raises
    ------
    scipy.linalg.LinAlgError
        If the matrix is not positive definite.
    """
    factor = MultifrontalFactor(plan, np.zeros(plan.offsets[-1]))
    factor.entries[plan.entries] = lower.data
    children: list[list[tuple[Array, Index, int]]] = [[] for _ in plan.parent]
    for number, parent in enumerate(plan.parent):
        square, below = factor.front(number)
        for left, into, split in children[number]:
            _add(square, left, into, 0, split, 0, split, 0, 0)
            _add(below, left, into, split, len(into), 0, split, len(square), 0)
        count, own = below.shape
        start = plan.schur[number]
        schur = plan.stack[start : start + count**2].reshape(count, count, order="F")
        if own:
            _, failed = dpotrf(square, lower=1, clean=0, overwrite_a=1)
            if failed:
                raise LinAlgError("The matrix is not positive definite.")
        else:
            schur[:] = 0.0
        if own and count:
            dtrsm(1.0, square, below, side=1, lower=1, trans_a=1, overwrite_b=1)
            dsyrk(-1.0, below, c=schur, lower=1, overwrite_c=1)
        for left, into, split in children[number]:
            _add(schur, left, into, split, len(into), split, len(into), own, own)
        children[number].clear()
        if parent >= 0:
            into = plan.into[plan.touched[number] : plan.touched[number + 1]]
            width = plan.starts[parent + 1] - plan.starts[parent]
            children[parent].append((schur, into, int(np.searchsorted(into, width))))
    return factor


def compile_kernels() -> None:
    """Compile the loops over the fronts, by calling them for no front."""
    none, start = np.zeros(0, np.int64), np.zeros(1, np.int64)
    touched, rows, pointers, _ = _rows(none, none, start, none)
    _storage(none, pointers, start, none, touched, rows)
    by_column, by_row = np.zeros((2, 2), order="F"), np.zeros((2, 2))
    for target in (by_column, by_row):  # a block of one row or column has both orders
        _add(target, by_column, none, 0, 0, 0, 0, 0, 0)


@numba.njit(cache=True)
def _add(
    target: Any, left: Any, into: Any,
    row: int, last_row: int, column: int, last_column: int, above: int, before: int,
) -> None:  # pragma: no cover - compiled  # fmt: skip
    """Add rows and columns of a Schur complement's lower triangle to a block of the parent.

    The block begins after `above` rows and `before` columns of the parent's front.
    """
    for j in range(column, last_column):
        goal, source = target[:, into[j] - before], left[:, j]
        for i in range(max(row, j), last_row):
            # An unsigned index spares the check for negative indices, which count from the end.
            goal[np.uintp(into[i] - above)] += source[np.uintp(i)]


@numba.njit(cache=True)
def _rows(rows: Any, columns: Any, starts: Any, parent: Any) -> Any:  # pragma: no cover - compiled
    """Return `touched` and `rows` of a :class:`Plan`, and the order of the matrix's entries.

    The entries are sorted by column: the place of their row or column that is eliminated first.
    Their order is given by the start of each column, (n + 1,), and the numbers of the entries.
    """
    n, count, fronts = starts[-1], len(rows), len(parent)
    pointers = np.zeros(n + 1, np.int64)
    for e in range(count):
        pointers[min(rows[e], columns[e]) + 1] += 1
    for i in range(n):
        pointers[i + 1] += pointers[i]
    fill, entry = pointers[:-1].copy(), np.empty(count, np.int64)
    for e in range(count):
        low = min(rows[e], columns[e])
        entry[fill[low]] = e
        fill[low] += 1
    touched, found = np.zeros(fronts + 1, np.int64), np.empty(4 * n + 1, np.int64)
    seen = np.full(n, -1)
    for f in range(fronts):
        end, used = starts[f + 1], touched[f]
        if len(found) < used + n:
            longer = np.empty(2 * len(found) + n, np.int64)
            for p in range(used):
                longer[p] = found[p]
            found = longer
        for p in range(pointers[starts[f]], pointers[end]):
            high = max(rows[entry[p]], columns[entry[p]])
            if high >= end and seen[high] != f:
                seen[high] = f
                found[used] = high
                used += 1
        for child in range(f):
            if parent[child] == f:
                for p in range(touched[child], touched[child + 1]):
                    if found[p] >= end and seen[found[p]] != f:
                        seen[found[p]] = f
                        found[used] = found[p]
                        used += 1
        found[touched[f] : used].sort()
        touched[f + 1] = used
    return touched, found[: touched[-1]], pointers, entry


@numba.njit(cache=True)
def _storage(
    high: Any, pointers: Any, starts: Any, parent: Any, touched: Any, found: Any
) -> Any:  # pragma: no cover - compiled
    """Return into, offsets, schur and entries of a :class:`Plan`, and the size of its stack.

    The entries are in the order of `high`, which holds the later-eliminated row of each.
    """
    n, fronts = starts[-1], len(parent)
    local, offsets = np.empty(n, np.int64), np.zeros(fronts + 1, np.int64)
    into, entries = np.empty(len(found), np.int64), np.empty(len(high), np.int64)
    depth, schur = np.zeros(fronts, np.int64), np.empty(fronts, np.int64)
    top, deepest = np.zeros(2, np.int64), np.zeros(2, np.int64)
    for f in range(fronts - 1, -1, -1):
        if parent[f] >= 0:
            depth[f] = depth[parent[f]] + 1
    for f in range(fronts):
        own, below = starts[f + 1] - starts[f], touched[f + 1] - touched[f]
        for i in range(own):
            local[starts[f] + i] = i
        for i in range(below):
            local[found[touched[f] + i]] = own + i
        # Even and odd levels of the tree have separate stacks: a front's children are on top of
        # one, and its own complement is put on the other.
        side = depth[f] % 2
        for child in range(f):
            if parent[child] == f:
                top[1 - side] -= (touched[child + 1] - touched[child]) ** 2
                for p in range(touched[child], touched[child + 1]):
                    into[p] = local[found[p]]
        schur[f] = top[side]
        top[side] += below * below
        deepest[side] = max(deepest[side], top[side])
        for j in range(own):
            for p in range(pointers[starts[f] + j], pointers[starts[f] + j + 1]):
                row = local[high[p]]
                inside, across = j * own + row, own * own + j * below + row - own
                entries[p] = offsets[f] + (inside if row < own else across)
        offsets[f + 1] = offsets[f] + own * (own + below)
    for f in range(fronts):
        if depth[f] % 2:
            schur[f] += deepest[0]
    return into, offsets, schur, entries, deepest[0] + deepest[1]
