"""Leapfrog time stepping of the pressure and of its change per step.

The scheme is the staggered pressure-velocity scheme with the velocities eliminated (see
`operator`). It is implemented twice: here in JAX, which runs on GPUs and can be differentiated, and
in `cpu_leapfrog` for the CPU, where the latter is several times as fast. Both take all coefficients
as arguments, so that no compilation is needed for a second lumen of equal shape.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from numpy.typing import NDArray

from acoustube.base.errors import SimulationError
from acoustube.waves.scheme.losses import (
    RelaxationState,
    advance_relaxations,
    bulk_absorption,
    lossy_change,
)
from acoustube.waves.scheme.operator import (
    INTERIOR,
    Operator,
    laplacian,
    on_device,
    with_halo,
)
from acoustube.waves.scheme.pml import Absorber, pml_step
from acoustube.waves.scheme.problem import Scheme, Setup, State

Progress = Callable[[float], object]
Array = NDArray[np.floating[Any]]
CHUNK = 250
"""Number of steps between two calls of `progress`."""
UNROLL = 2
"""Steps per loop iteration: with two, XLA copies no field and stores fewer intermediates."""


def initial_state(setup: Setup, pressure: ArrayLike) -> State:
    """Return the state of air at rest under a given pressure.

    Parameters
    ----------
    setup : Setup
        The discrete problem.
    pressure : (nx, ny, nz) array_like
        In Pa, on the grid with its absorbers; it should be zero in the absorbers.

    Returns
    -------
    State
        Initial state of a run.
    """
    silence, scheme = setup.state, setup.scheme
    field, change = _from_rest(on_device(pressure, silence.change.dtype), scheme)
    return silence._replace(pressure=field, change=change)


@jax.jit
def _from_rest(pressure: jax.Array, scheme: Scheme) -> tuple[jax.Array, jax.Array]:
    """Return a pressure with halo, and its change over the step before a start at rest."""
    operator = scheme.operator
    field = with_halo(jnp.where(operator.inverse_volume > 0.0, pressure, 0.0))
    # Half a step backwards, so that the first step is that of a start at rest.
    return field, -0.5 * scheme.step_squared * laplacian(field, operator)


def march(
    setup: Setup,
    state: State,
    source: Array,
    *,
    layers: NDArray[np.integer[Any]] | None = None,
    progress: Progress | None = None,
    compiled: bool | None = None,
) -> tuple[State, Array]:
    """Advance a state by as many steps as the source has samples.

    Parameters
    ----------
    setup : Setup
        The discrete problem.
    state : State
        Initial state.
    source : ndarray
        Source signal, (n,): with a release end the pressures to which the source layer is set, with
        an absorbing end the increments of its pressure.
    layers : ndarray of int, optional
        Number of layers, from the first, that have to be advanced in each step, (n,), such as those
        from `audible_layers`; all by default. Only the compiled implementation omits the others,
        which then keep the state of an earlier step.
    progress : callable, optional
        Called with the finished fraction after each chunk.
    compiled : bool, optional
        Use the compiled implementation rather than JAX; by default if JAX runs on the CPU.

    Returns
    -------
    state : State
        State after the last step.
    pressure : ndarray
        Pressure at the probes after each step, (n_probes, n).

    Raises
    ------
    SimulationError
        If the pressure is no longer finite, or a thread of the compiled implementation cannot be
        started.
    """
    marcher = _marcher(setup, state, compiled)
    records = []
    for begin in range(0, len(source), CHUNK):
        piece = source[begin : begin + CHUNK]
        end = begin + len(piece)
        records.append(marcher.advance(piece, None if layers is None else layers[begin:end]))
        if not marcher.is_finite():
            raise SimulationError(
                f"waves: the pressure diverged between steps {begin} and {end}; "
                f"the time step {setup.time_step:.4g} s is over the stable limit: leave time_step "
                "unset, or use a value below stable_step(cells, air)"
            )
        if progress is not None:
            progress(end / len(source))
    return marcher.state(), np.concatenate(records).T


class Marcher(Protocol):
    """State that is advanced in place."""

    def advance(self, source: Array, layers: NDArray[np.integer[Any]] | None = None) -> Array:
        """Advance by one step per sample; return the pressures at the probes, (n, n_probes)."""

    def is_finite(self) -> bool:
        """Return True if all pressures are finite."""

    def state(self) -> State:
        """Return the state."""


def _marcher(setup: Setup, state: State, compiled: bool | None) -> Marcher:
    """Return the marcher of a state: by default compiled on a CPU, in JAX elsewhere."""
    if compiled is None:
        compiled = jax.default_backend() == "cpu"
    if not compiled:
        return _TracedMarcher(setup, state)
    # Imports numba, which takes a second.
    from acoustube.waves.scheme.cpu_leapfrog import CompiledMarcher

    return CompiledMarcher(setup, state)


class _TracedMarcher:
    """State advanced by JAX."""

    def __init__(self, setup: Setup, state: State) -> None:
        self._setup, self._state = setup, state

    def advance(self, source: Array, layers: NDArray[np.integer[Any]] | None = None) -> Array:  # noqa: ARG002
        piece = jnp.asarray(source, self._state.change.dtype)
        self._state, record = run_chunk(
            self._state, self._setup.scheme, piece, source_layer=self._setup.source_layer
        )
        return np.asarray(record, dtype=float)

    def is_finite(self) -> bool:
        return bool(np.isfinite(float(jnp.sum(jnp.abs(self._state.change)))))

    def state(self) -> State:
        return self._state


class _Fields(NamedTuple):
    """Fields of a `State` without halos, as advanced by a single pass over the grid.

    With the argument of the Laplacian stored, all other operations of a step are local to a cell,
    so that a compiler for GPUs fuses them into one kernel, which reads and writes each array once.

    Attributes
    ----------
    ahead : Array
        Argument of the Laplacian: the pressure plus `losses.bulk_absorption`, in Pa, (nx, ny, nz).
    pressure : Array or None
        In Pa, (nx, ny, nz); without losses it is `ahead`, and this is None.
    change : Array
        Pressure change over the last step, in Pa, (nx, ny, nz).
    before, behind : Absorber or None
    memory : RelaxationState or None
        With the half-integral without halo.
    """

    ahead: jax.Array
    pressure: jax.Array | None
    change: jax.Array
    before: Absorber | None
    behind: Absorber | None
    memory: RelaxationState | None


@partial(jax.jit, static_argnames=("source_layer",))
def run_chunk(
    state: State, scheme: Scheme, source: jax.Array, *, source_layer: int
) -> tuple[State, jax.Array]:
    """Advance by several steps in JAX, differentiably, and record the probes after each step.

    Parameters
    ----------
    state : State
    scheme : Scheme
    source : array of shape (n_steps,)
        Source signal in each step; see `march`.
    source_layer : int
        Index of the source layer.

    Returns
    -------
    state : State
    record : array of shape (n_steps, n_probes)
        Pressure at each probe after each step.
    """
    step = partial(_step, scheme, source_layer)
    fields, record = lax.scan(step, _fields(state, scheme), source, unroll=UNROLL)
    return _state(fields), record


def _fields(state: State, scheme: Scheme) -> _Fields:
    """Return the fields of a state without halos."""
    pressure, memory = state.pressure[INTERIOR], state.memory
    if scheme.losses is None or memory is None:
        return _Fields(pressure, None, state.change, state.before, state.behind, None)
    memory = memory._replace(integral=memory.integral[INTERIOR])
    added = bulk_absorption(scheme.losses, memory, state.change)
    return _Fields(pressure + added, pressure, state.change, state.before, state.behind, memory)


def _state(fields: _Fields) -> State:
    """Return a state from its fields without halos."""
    pressure = fields.ahead if fields.pressure is None else fields.pressure
    memory = fields.memory
    if memory is not None:
        memory = memory._replace(integral=with_halo(memory.integral))
    return State(with_halo(pressure), fields.change, fields.before, fields.behind, memory)


def _step(
    scheme: Scheme, source_layer: int, fields: _Fields, sample: jax.Array
) -> tuple[_Fields, jax.Array]:
    """Advance by one leapfrog step: absorbers, then all cells with the source, then probes."""
    around, pressure = with_halo(fields.ahead), fields.pressure
    before, first = _absorber_step(fields.before, 0, around, scheme)
    n_behind = 0 if fields.behind is None else fields.behind.transverse.shape[2]
    last = fields.change.shape[2] - n_behind
    behind, end = _absorber_step(fields.behind, last, around, scheme)
    losses, memory = scheme.losses, fields.memory
    if losses is None or memory is None or pressure is None:
        change = fields.change + scheme.step_squared * laplacian(around, scheme.operator)
        change = _replace_ends(first, change, end)
        ahead = _driven(fields.ahead + change, scheme, source_layer, sample)
        return _Fields(ahead, None, change, before, behind, None), _probe(ahead, scheme)
    change = lossy_change(
        losses, memory, scheme.operator, around, pressure, fields.change, scheme.step_squared
    )
    change = _replace_ends(first, change, end)
    memory = advance_relaxations(losses, memory, pressure, change)
    pressure = _driven(pressure + change, scheme, source_layer, sample)
    ahead = pressure + bulk_absorption(losses, memory, change)
    return _Fields(ahead, pressure, change, before, behind, memory), _probe(pressure, scheme)


def _replace_ends(first: jax.Array | None, middle: jax.Array, end: jax.Array | None) -> jax.Array:
    """Return a field whose first and last layers are replaced."""
    # By selection, because XLA does not fuse a concatenation with the following operations.
    n = middle.shape[2]
    layer = jnp.arange(n)
    if first is not None:
        padded = jnp.pad(first, ((0, 0), (0, 0), (0, n - first.shape[2])))
        middle = jnp.where(layer < first.shape[2], padded, middle)
    if end is not None:
        padded = jnp.pad(end, ((0, 0), (0, 0), (n - end.shape[2], 0)))
        middle = jnp.where(layer >= n - end.shape[2], padded, middle)
    return middle


def _absorber_step(
    layer: Absorber | None, first: int, around: jax.Array, scheme: Scheme
) -> tuple[Absorber | None, jax.Array | None]:
    """Return an absorber after a step and its pressure change; both are None without absorber."""
    if layer is None:
        return None, None
    near, local = _window(around, scheme.operator, first, layer.transverse.shape[2])
    return pml_step(layer, near, local, scheme.step_squared)


def _window(
    pressure: jax.Array, operator: Operator, first: int, n_layers: int
) -> tuple[jax.Array, Operator]:
    """Return the pressure of some layers and two on each side, and the layers' coefficients."""
    cells = slice(first, first + n_layers)
    local = Operator(
        inverse_volume=operator.inverse_volume[:, :, cells],
        area_x=operator.area_x[:, :, cells],
        area_y=operator.area_y[:, :, cells],
        area_z=operator.area_z[:, :, first : first + n_layers + 3],
        beta=operator.beta,
    )
    return pressure[:, :, first : first + n_layers + 4], local


def _driven(pressure: jax.Array, scheme: Scheme, source_layer: int, sample: jax.Array) -> jax.Array:
    """Return the pressure with the source layer set to a sample, or incremented by it."""
    layer = jnp.arange(pressure.shape[2]) == source_layer
    driven = scheme.keep * pressure + sample * scheme.source[:, :, None]
    return jnp.where(layer, driven, pressure)


def _probe(pressure: jax.Array, scheme: Scheme) -> jax.Array:
    """Return the weighted sums of the pressure over the probed layers, (n_probes,)."""
    planes = jnp.take(pressure, scheme.probe_layers, axis=2)
    return jnp.sum(planes * scheme.probe_weights, axis=(0, 1))
