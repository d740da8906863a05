"""Leapfrog marching of the pressure and of its change per step.

The pressure-velocity scheme with the velocities eliminated (see `wave_operator`). It is written
twice: here in JAX, which runs on GPUs and can be differentiated, and in `compiled` for the CPU,
where that is several times as fast. Both take all coefficients as arguments, so a second lumen of
equal shape is not compiled again.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, Protocol

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.typing import ArrayLike
from numpy.typing import NDArray

from acoustube.base.errors import SimulationError
from acoustube.waves.scheme.losses import Memory, lose
from acoustube.waves.scheme.operator import INTERIOR, Operator, laplacian, with_halo
from acoustube.waves.scheme.pml import Absorber, absorb
from acoustube.waves.scheme.problem import Scheme, Setup, State

Progress = Callable[[float], object]
Array = NDArray[np.floating[Any]]
CHUNK = 250  # steps between two reports


def initial_state(setup: Setup, pressure: ArrayLike) -> State:
    """Return the state of air at rest under a given pressure.

    Parameters
    ----------
    setup : Setup
        The discrete problem.
    pressure : (nx, ny, nz) array_like
        In Pa, on the marched grid; it should vanish in the absorbers.

    Returns
    -------
    State
        Start of a march.
    """
    silence, operator = setup.state, setup.scheme.operator
    field = with_halo(jnp.asarray(pressure, silence.change.dtype))
    field = field.at[INTERIOR].multiply(operator.inverse_volume > 0.0)
    # Half a step backwards, so that the first step arrives where a start at rest does.
    change = -0.5 * setup.scheme.step_squared * laplacian(field, operator)
    return silence._replace(pressure=field, change=change)


def march(
    setup: Setup,
    state: State,
    source: Array,
    *,
    progress: Progress | None = None,
    compiled: bool | None = None,
) -> tuple[State, Array]:
    """Advance a state by as many steps as the source has samples.

    Parameters
    ----------
    setup : Setup
        The discrete problem.
    state : State
        Where to start.
    source : ndarray
        What the source layer is set to, or receives, in each step, (n,).
    progress : callable, optional
        Called with the finished fraction after each chunk.
    compiled : bool, optional
        Whether to march in compiled columns rather than in JAX; by default where JAX computes on
        the CPU.

    Returns
    -------
    state : State
        After the last step.
    pressure : ndarray
        Plane-averaged pressure at the probes after each step, (n_probes, n).

    Raises
    ------
    SimulationError
        If the pressure stops being finite.
    """
    marcher = _marcher(setup, state, compiled)
    records = []
    for begin in range(0, len(source), CHUNK):
        piece = source[begin : begin + CHUNK]
        records.append(marcher.advance(piece))
        end = begin + len(piece)
        if not marcher.is_finite():
            raise SimulationError(
                f"waves: the pressure left the range of numbers between steps {begin} and {end}; "
                f"the time step {setup.time_step:.4g} s is over the stable limit: leave time_step "
                "unset, or use a value below stable_step(cells, air)"
            )
        if progress is not None:
            progress(end / len(source))
    return marcher.state(), np.concatenate(records).T


class Marcher(Protocol):
    """A state that is advanced in place."""

    def advance(self, source: Array) -> Array:
        """Advance by as many steps as the source has samples; return the probes', (n, n_probes)."""

    def is_finite(self) -> bool:
        """Return whether all pressures are numbers."""

    def state(self) -> State:
        """Return the state."""


def _marcher(setup: Setup, state: State, compiled: bool | None) -> Marcher:
    """Return what advances a state: compiled columns on a CPU, JAX elsewhere."""
    if compiled is None:
        compiled = jax.default_backend() == "cpu"
    if not compiled:
        return _TracedMarcher(setup, state)
    from acoustube.waves.scheme.cpu_leapfrog import (
        CompiledMarcher,  # imports numba, which takes a second
    )

    return CompiledMarcher(setup, state)


class _TracedMarcher:
    """A state advanced by JAX."""

    def __init__(self, setup: Setup, state: State) -> None:
        self._setup, self._state = setup, state

    def advance(self, source: Array) -> Array:
        piece = jnp.asarray(source, self._state.change.dtype)
        self._state, record = _run_chunk(
            self._state, self._setup.scheme, piece, source_layer=self._setup.source_layer
        )
        return np.asarray(record, dtype=float)

    def is_finite(self) -> bool:
        return bool(np.isfinite(float(jnp.sum(jnp.abs(self._state.change)))))

    def state(self) -> State:
        return self._state


def acoustic_energy(setup: Setup, state: State) -> float:
    """Return the discrete energy that leapfrog conserves between rigid walls, without absorbers.

    With p' the pressure one step earlier and w = p - p', per unit of dt^2,
    E = (<w, w> - dt^2 <p', L p>) / 2 in the volume-weighted inner product; L is self-adjoint.
    """
    operator = setup.scheme.operator
    volume = np.asarray(setup.cells.volume_fraction)
    earlier = np.asarray(state.pressure[INTERIOR] - state.change, dtype=float)
    change = np.asarray(state.change, dtype=float)
    force = np.asarray(laplacian(state.pressure, operator), dtype=float) * setup.time_step**2
    return 0.5 * float(np.sum(volume * (change**2 - earlier * force)))


@partial(jax.jit, static_argnames=("source_layer",))
def _run_chunk(
    state: State, scheme: Scheme, source: jax.Array, *, source_layer: int
) -> tuple[State, jax.Array]:
    """Advance by some steps and record the probes after each."""
    return lax.scan(partial(_step, scheme, source_layer), state, source)


def _step(
    scheme: Scheme, source_layer: int, state: State, sample: jax.Array
) -> tuple[State, jax.Array]:
    """Advance by one leapfrog step: all cells, the absorbers' anew, then source and probes."""
    pressure = state.pressure
    # The absorbers' cells are advanced twice, but the loop over all cells stays one fused kernel:
    # regions updated one by one took 1.4 times as long.
    memory, change = _advance(state, scheme)
    before, change = _absorb_at(state.before, 0, pressure, change, scheme)
    n_behind = 0 if state.behind is None else state.behind.transverse.shape[2]
    behind, change = _absorb_at(state.behind, change.shape[2] - n_behind, pressure, change, scheme)
    pressure = _drive(pressure.at[INTERIOR].add(change), scheme, source_layer, sample)
    return State(pressure, change, before, behind, memory), _probe(pressure, scheme)


def _advance(state: State, scheme: Scheme) -> tuple[Memory | None, jax.Array]:
    """Return the change of all cells over a step as if there were no absorbers."""
    if scheme.losses is None or state.memory is None:
        force = laplacian(state.pressure, scheme.operator)
        return None, state.change + scheme.step_squared * force
    return lose(
        scheme.losses, state.memory, scheme.operator,
        state.pressure, state.change, scheme.step_squared,
    )  # fmt: skip


def _absorb_at(
    layer: Absorber | None, first: int, pressure: jax.Array, change: jax.Array, scheme: Scheme
) -> tuple[Absorber | None, jax.Array]:
    """Advance an absorber, if there is one, and replace the change of its cells."""
    if layer is None:
        return None, change
    around, local = _window(pressure, scheme.operator, first, layer.transverse.shape[2])
    layer, inside = absorb(layer, around, local, scheme.step_squared)
    return layer, lax.dynamic_update_slice(change, inside, (0, 0, first))


def _window(
    pressure: jax.Array, operator: Operator, first: int, n_layers: int
) -> tuple[jax.Array, Operator]:
    """Return the pressure in and around some cell layers, and their coefficients."""
    cells = slice(first, first + n_layers)
    local = Operator(
        inverse_volume=operator.inverse_volume[:, :, cells],
        area_x=operator.area_x[:, :, cells],
        area_y=operator.area_y[:, :, cells],
        area_z=operator.area_z[:, :, first : first + n_layers + 3],
        beta=operator.beta,
    )
    return pressure[:, :, first : first + n_layers + 4], local


def _drive(pressure: jax.Array, scheme: Scheme, source_layer: int, sample: jax.Array) -> jax.Array:
    """Set the source layer, or add to it."""
    plane = (slice(1, -1), slice(1, -1), source_layer + 2)
    return pressure.at[plane].set(scheme.keep * pressure[plane] + sample * scheme.source)


def _probe(pressure: jax.Array, scheme: Scheme) -> jax.Array:
    """Return the volume-weighted means over the probed layers."""
    planes = jnp.take(pressure[1:-1, 1:-1], scheme.probe_layers + 2, axis=2)
    return jnp.sum(planes * scheme.probe_weights, axis=(0, 1))
