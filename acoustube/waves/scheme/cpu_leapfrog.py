"""Leapfrog time stepping on the CPU, over columns of open cells.

The same scheme as `leapfrog`, with the same results except for rounding. One pass over the grid
applies operator, losses, absorbers and source to a column of cells, and writes the next pressure
into a second array, so that threads synchronise once per step. Cells that are full, with full faces
all around and without losses at the wall, need no coefficients and no memory of the wall.

The stored field is the argument of the Laplacian: the pressure plus the terms of the air's
absorption, which are local to a cell.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier
from typing import Any

import numpy as np
from numba import get_num_threads
from numpy.typing import ArrayLike, NDArray

from acoustube.base.errors import SimulationError
from acoustube.base.types import Mask
from acoustube.waves.scheme.cpu_kernel import advance
from acoustube.waves.scheme.cpu_layout import (
    CORE,
    CUT,
    AbsorberColumns,
    Columns,
    Fields,
    LossCoefficients,
    SourceAndProbes,
    Stencil,
)
from acoustube.waves.scheme.losses import Losses, RelaxationState
from acoustube.waves.scheme.operator import INTERIOR, Operator, on_device
from acoustube.waves.scheme.pml import Absorber
from acoustube.waves.scheme.problem import Scheme, Setup, State

Array = NDArray[np.floating[Any]]

WALL, ABSORBING = -1, 2
"""Kinds of cells that belong to no span: those of the wall, and those in an absorber."""
SHORTEST_CORE = 32
"""Smallest number of cells of a core span (full cells); shorter ones are added to cut spans."""
CELL_COSTS = 1.0, 4.0, 4.0
"""Relative time for a cell in a core span, a cut span and an absorber, for balancing threads."""
MOST_THREADS = 4
"""Largest number of threads; more were not tested."""


class CompiledMarcher:
    """State of a run, advanced in place by compiled code on several threads.

    Parameters
    ----------
    setup : Setup
        The discrete problem.
    state : State
        Initial state; it is not changed.
    n_threads : int, optional
        Number of threads; by default that of `default_threads`.
    """

    def __init__(self, setup: Setup, state: State, n_threads: int | None = None) -> None:
        scheme, dtype = setup.scheme, state.change.dtype
        self._losses, self._state, self._now = scheme.losses, state, 0
        self._order = np.argsort(np.asarray(scheme.probe_layers), kind="stable")
        lossy = _lossy(scheme, state, dtype)
        self._problem = (
            _columns(setup, state, n_threads or default_threads()),
            _stencil(scheme.operator, scheme, dtype),
            lossy,
            _fields(scheme, state, lossy, dtype),
            _layer(state.before, dtype),
            _layer(state.behind, dtype),
            _source_and_probes(setup, self._order, dtype),
        )

    @property
    def _fields(self) -> Fields:
        return self._problem[3]

    def advance(self, source: ArrayLike, layers: ArrayLike | None = None) -> Array:
        """Advance by as many steps as the source has samples.

        Parameters
        ----------
        source : array_like
            Source signal, (n,).
        layers : array_like of int, optional
            Number of layers that each step advances, from the first, (n,); all by default.

        Returns
        -------
        ndarray
            Pressures at the probes after each step, (n, n_probes).

        Raises
        ------
        SimulationError
            If a thread cannot be started; the state is unchanged then.
        """
        change, columns = self._fields.change, self._problem[0]
        n_threads = len(columns.bounds) - 1
        samples = _copy(source, change.dtype)
        limits = np.empty(len(samples), np.uint64)
        limits[:] = change.shape[2] if layers is None else layers
        lossy = self._problem[2].decay.size > 0
        work = np.empty((n_threads, 2, change.shape[2]), change.dtype) if lossy else None
        recorded = np.zeros((n_threads, len(samples), len(self._order)), change.dtype)
        counter = np.zeros(1, np.int64)

        def run(thread: int) -> None:
            advance(self._problem, thread, self._now, samples, limits, work, recorded, counter)

        if n_threads == 1:
            run(0)
        else:
            _run_together(run, n_threads)
        self._now = (self._now + len(samples)) % 2
        record = np.empty(recorded.shape[1:], float)
        record[:, self._order] = recorded.sum(axis=0)
        return record

    def is_finite(self) -> bool:
        """Return True if all pressures are finite."""
        return bool(np.isfinite(np.abs(self._fields.change).sum()))

    def state(self) -> State:
        """Return a copy of the state.

        Memory variables without effect (of the air within an absorber, of the wall in cells away
        from it) are not advanced.
        """
        _, _, lossy, fields, before, behind, _ = self._problem
        return State(
            pressure=on_device(_pressure(lossy, fields, self._now)),
            change=on_device(fields.change),
            before=_absorber(self._state.before, before),
            behind=_absorber(self._state.behind, behind),
            memory=_memory(self._state.memory, self._losses, fields, self._now),
        )


def _run_together(run: Callable[[int], None], n_threads: int) -> None:
    """Run a function on several threads, none of which begins before all have started.

    Raises
    ------
    SimulationError
        If a thread cannot be started; the function is then not called.
    """
    gate = Barrier(n_threads)

    def begin(thread: int) -> None:
        gate.wait()
        run(thread)

    with ThreadPoolExecutor(n_threads) as pool:
        try:
            jobs = [pool.submit(begin, thread) for thread in range(n_threads)]
        except BaseException as error:
            gate.abort()  # otherwise the threads that have started would wait for ever
            if not isinstance(error, RuntimeError):
                raise
            raise SimulationError(
                f"the wave solver could not start {n_threads} threads ({error}); set the "
                "environment variable NUMBA_NUM_THREADS to 1"
            ) from error
        for job in jobs:
            job.result()


def default_threads() -> int:
    """Return the number of threads: numba's own, up to `MOST_THREADS`.

    Numba's number is ``NUMBA_NUM_THREADS``, by default one per core, unless it was lowered by
    ``numba.set_num_threads``.
    """
    return min(get_num_threads(), MOST_THREADS)


def _copy(values: ArrayLike, dtype: Any) -> Array:
    return np.array(values, dtype, order="C")


def _scalar(*values: ArrayLike, dtype: Any) -> Array:
    return np.array([float(np.asarray(value)) for value in values], dtype)


def _stencil(operator: Operator, scheme: Scheme, dtype: Any) -> Stencil:
    """Return the coefficients of an operator as arrays for the compiled code."""
    step_squared = float(scheme.step_squared)
    area_x, area_y, area_z = (_copy(area, dtype) for area in operator[1:4])
    return Stencil(
        _copy(operator.inverse_volume, dtype) * np.asarray(step_squared, dtype),
        area_x,
        area_y,
        area_z,
        _scalar(*_full_faces(operator), dtype=dtype) * np.asarray(step_squared, dtype),
        _scalar(operator.beta, dtype=dtype),
    )


def _full(operator: Operator) -> Mask:
    """Return the mask of full cells whose faces, and axial faces of both neighbours, are full."""
    x, y, z = (np.asarray(area) for area in operator[1:4])
    x, y, z = (area == face for area, face in zip((x, y, z), _full_faces(operator), strict=True))
    across = x[1:] & x[:-1] & y[:, 1:] & y[:, :-1]
    along = z[:, :, :-3] & z[:, :, 1:-2] & z[:, :, 2:-1] & z[:, :, 3:]
    return (np.asarray(operator.inverse_volume) == 1) & across & along


def _full_faces(operator: Operator) -> tuple[Any, ...]:
    """Return the entries of `area_x`, `area_y` and `area_z` at full faces: medians of open faces.

    More than half of the open faces of a resolved lumen are full. Those in the plane x = 0 of half
    a lumen may have twice the area.
    """
    areas = (np.asarray(area) for area in (operator.area_x[1:], operator.area_y, operator.area_z))
    return tuple(
        np.median(area[area > 0]) if np.any(area > 0) else area.dtype.type(0) for area in areas
    )


def _acts_at_wall(losses: Losses | None, shape: tuple[int, ...]) -> Mask:
    """Return a mask of the cells in which the wall's losses act."""
    if losses is None:
        return np.zeros(shape, bool)
    x, y, z = (np.asarray(area) != 0 for area in losses.drag[1:4])
    across = x[1:] | x[:-1] | y[:, 1:] | y[:, :-1]
    return across | z[:, :, 1:-2] | z[:, :, 2:-1] | (np.asarray(losses.compliance) != 0)


def _kinds(setup: Setup, state: State) -> NDArray[np.integer[Any]]:
    """Return the kind of each cell: of a core or a cut span, in an absorber, or wall."""
    scheme = setup.scheme
    wall = _acts_at_wall(scheme.losses, state.change.shape)
    open_cells = (np.asarray(scheme.operator.inverse_volume) > 0) | wall
    open_cells[:, :, setup.source_layer] |= np.asarray(scheme.source) != 0
    kinds = np.where(_full(scheme.operator) & ~wall, CORE, CUT)
    kinds[:, :, : _n_layers(state.before)] = ABSORBING
    kinds[:, :, kinds.shape[2] - _n_layers(state.behind) :] = ABSORBING
    kinds[~open_cells] = WALL
    return kinds


def _columns(setup: Setup, state: State, n_threads: int) -> Columns:
    """Return the columns that contain open cells, and their spans outside the absorbers."""
    kinds = _kinds(setup, state)
    _, ny, nz = kinds.shape
    kinds = kinds.reshape(-1, nz)
    rows, begins, ends = _runs(kinds)
    short = (kinds[rows, begins] == CORE) & (ends - begins < SHORTEST_CORE)
    for row, begin, end in zip(rows[short], begins[short], ends[short], strict=True):
        kinds[row, begin:end] = CUT
    rows, begins, ends = _runs(kinds)
    kind = kinds[rows, begins]
    marched = (kind == CORE) | (kind == CUT)
    listed = np.flatnonzero((kinds != WALL).any(axis=1))
    total = np.cumsum(np.array([0.0, *CELL_COSTS])[kinds[listed] - WALL].sum(axis=1))
    bounds = np.searchsorted(total, np.linspace(0.0, total[-1], n_threads + 1)[1:-1])
    return Columns(
        place=np.stack(np.divmod(listed, ny), axis=1).astype(np.uint64),
        first=np.searchsorted(rows[marched], [*listed, len(kinds)]),
        spans=np.stack([begins, ends, kind], axis=1)[marched].astype(np.uint64),
        bounds=np.array([0, *bounds, len(listed)]),
    )


def _n_layers(absorber: Absorber | None) -> int:
    return 0 if absorber is None else absorber.transverse.shape[2]


def _runs(values: NDArray[np.integer[Any]]) -> tuple[NDArray[np.integer[Any]], ...]:
    """Return row, begin and end of all runs of equal values in the rows of an array."""
    starts = np.pad(values[:, 1:] != values[:, :-1], ((0, 0), (1, 1)), constant_values=True)
    rows, places = np.nonzero(starts)
    within = rows[1:] == rows[:-1]
    return rows[:-1][within], places[:-1][within], places[1:][within]


def _air_first(losses: Losses) -> tuple[NDArray[np.integer[Any]], int]:
    """Return the permutation that puts the air's relaxations first, and the number of these."""
    of_air = np.array([float(lag) != 0 for lag in losses.bulk])
    return np.argsort(~of_air, kind="stable"), int(of_air.sum())


def _lossy(scheme: Scheme, state: State, dtype: Any) -> LossCoefficients:
    """Return the coefficients of the losses, empty without losses."""
    losses, shape = scheme.losses, state.change.shape
    if losses is None:
        none, nowhere = np.zeros(0, dtype), np.zeros((0, 0, 0), dtype)
        still = Stencil(nowhere, nowhere, nowhere, nowhere, none, none)
        weight = np.zeros(shape[2], dtype)
        return LossCoefficients(
            still, nowhere, nowhere, weight, none, none, none, none, np.zeros(2, dtype)
        )
    order, n_air = _air_first(losses)
    decay, gain, wall, bulk = (
        _scalar(*values, dtype=dtype)[order]
        for values in (losses.decay, losses.gain, losses.wall, losses.bulk)
    )
    return LossCoefficients(
        drag=_stencil(losses.drag, scheme, dtype),
        compliance=_copy(losses.compliance, dtype),
        implicit_factor=_copy(losses.implicit_factor, dtype),
        weight=_copy(losses.weight, dtype).ravel(),
        decay=decay, gain=gain, wall=wall * (decay - 1), bulk=bulk[:n_air].copy(),
        scalars=_scalar(losses.response, losses.rate, dtype=dtype),
    )  # fmt: skip


def _fields(scheme: Scheme, state: State, lossy: LossCoefficients, dtype: Any) -> Fields:
    """Return the fields of a state as arrays for the compiled code."""
    memory, nowhere = state.memory, np.zeros((0, 0, 0), dtype)
    ahead, change = _twice(state.pressure), _copy(state.change, dtype)
    if scheme.losses is None or memory is None:
        nothing = np.zeros((0, 0, 0, 0), dtype)
        return Fields(
            ahead, change, nowhere, nothing, nowhere, np.zeros((2, 0, 0, 0), dtype), nowhere
        )
    order, n_air = _air_first(scheme.losses)
    relaxed = np.stack([np.asarray(memory.relaxed[i]) for i in order], axis=2)
    lagging = np.einsum("j,xyjz->xyz", lossy.bulk, relaxed[:, :, :n_air])
    ahead[(0, *INTERIOR)] += lossy.weight * (lossy.scalars[1] * change - lagging)
    return Fields(
        ahead, change,
        pressure=_copy(state.pressure, dtype),
        relaxed=relaxed,
        relaxing=np.einsum("j,xyjz->xyz", lossy.wall, relaxed),
        integral=_twice(memory.integral),
        increment=_copy(memory.increment, dtype),
    )  # fmt: skip


def _twice(field: ArrayLike) -> Array:
    """Return an array for a field at two time levels, the second zero."""
    field = np.asarray(field)
    both = np.zeros((2, *field.shape), field.dtype)
    both[0] = field
    return both


def _pressure(lossy: LossCoefficients, fields: Fields, now: int) -> Array:
    """Return the pressure, (nx+2, ny+2, nz+4), at time level `now`, 0 or 1.

    It is the argument of the Laplacian, `Fields.ahead`, except where the air absorbs.
    """
    ahead = fields.ahead[now]
    if fields.pressure.size == 0:
        return ahead
    absorbs = np.pad(lossy.weight != 0, 2)
    return np.where(absorbs, fields.pressure, ahead)


def _memory(
    memory: RelaxationState | None, losses: Losses | None, fields: Fields, now: int
) -> RelaxationState | None:
    """Return the memory variables of the losses."""
    if memory is None or losses is None:
        return memory
    place = np.argsort(_air_first(losses)[0])
    relaxed = tuple(on_device(fields.relaxed[:, :, i]) for i in place)
    return RelaxationState(relaxed, on_device(fields.integral[now]), on_device(fields.increment))


def _layer(layer: Absorber | None, dtype: Any) -> AbsorberColumns:
    """Return the arrays of an absorber, empty without one."""
    if layer is None:
        nothing = np.zeros((0, 0, 0), dtype)
        return AbsorberColumns(*(np.zeros((3, 0), dtype),) * 2, *(nothing,) * 4)
    stretches = (np.stack([np.asarray(c).ravel() for c in stretch]) for stretch in layer[:2])
    return AbsorberColumns(*stretches, *(_copy(part, dtype) for part in layer[2:]))


def _absorber(before: Absorber | None, layer: AbsorberColumns) -> Absorber | None:
    """Return an absorber with its advanced state."""
    if before is None:
        return None
    return Absorber(before.cells, before.faces, *(on_device(part) for part in layer[2:]))


def _source_and_probes(
    setup: Setup, order: NDArray[np.integer[Any]], dtype: Any
) -> SourceAndProbes:
    """Return source layer and probe weights."""
    scheme = setup.scheme
    planes, counts = np.unique(np.asarray(scheme.probe_layers, np.uint64), return_counts=True)
    return SourceAndProbes(
        shape=_copy(scheme.source, dtype),
        keep=_scalar(scheme.keep, dtype=dtype),
        layer=setup.source_layer,
        planes=planes,
        plane_of=np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        weights=_copy(np.asarray(scheme.probe_weights)[:, :, order], dtype),
    )
