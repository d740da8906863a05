"""Viscous and thermal losses at the wall, and absorption in the air, in the time domain.

A boundary layer that is thin against the bore drags the tangential velocity v beside it and lets
the air there give way isothermally. To first order in its thickness, with the wetted area per
volume S of the air beside the wall, nu and nu_t the viscous and thermal diffusivities, gamma the
ratio of heat capacities and s = d/dt,

    s v = -grad p / rho (1 - S sqrt(nu) s^(-1/2)),
    s p (1 + (gamma - 1) S sqrt(nu_t) s^(-1/2)) = -rho c^2 div v.

Without the velocities, and with y = s^(-1/2) p,

    s^2 p + (gamma - 1) S sqrt(nu_t) s^2 y = c^2 div grad p - c^2 div (S sqrt(nu) grad_t y).

`half_integral` replaces s^(-1/2) by a sum of first-order relaxations with positive weights over a
band. The scheme steps each by the trapezoidal rule. Its loss is then positive at every frequency,
on any grid: the real part of the response of y to p, times the frequency, has one sign. It is also
stable at rest as long as S sqrt(nu) times the sum's value at s = 0 stays below one, for which S
must not be too concentrated.

So the wetted area of each wall cell is not left in it, where a small volume makes S as large as one
likes, but spread over `BAND` by diffusion, which keeps its total and makes the result independent
of the grid. The tangential share is spread with it: the area times one minus the square of the
normal's component, for each direction of a face.

The air itself adds, to the pressure whose Laplacian is taken, a part that follows its rate (the
classical absorption) and parts that lag behind (the vibrational relaxations of oxygen and
nitrogen).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from math import pi, sqrt
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from scipy.optimize import minimize, nnls

from acoustube.air import Air
from acoustube.base.errors import ConfigError
from acoustube.waves.grid.cells import CutCells
from acoustube.waves.grid.polyhedron import Array
from acoustube.waves.scheme.operator import Operator, assemble, laplacian, with_halo
from acoustube.waves.scheme.time_step import largest_eigenvalue

BAND = 0.2e-3
"""Standard deviation in m of the distance over which the wetted area is spread."""
SPARSE = 0.01
"""Wetted area, as a share of that beside a flat wall, below which air is not beside the wall."""
ACCURACY = 3e-3
"""Largest error of the half-integral over the band, relative."""
MOST_POLES = 10
FIT_POINTS = 200


@dataclass(frozen=True, kw_only=True)
class HalfIntegral:
    """A sum of weight / (s + rate) that stands for s^(-1/2) over a band.

    Attributes
    ----------
    rates, weights : ndarray
        In 1/s, and in s^(-1/2), (n,).
    error : float
        Largest relative error over the band.
    """

    rates: Array
    weights: Array
    error: float


def half_integral(band: tuple[float, float], accuracy: float = ACCURACY) -> HalfIntegral:
    """Fit the half-integral by relaxations.

    Parameters
    ----------
    band : tuple of float
        Lowest and highest frequency in Hz.
    accuracy : float
        Largest relative error over the band.

    Returns
    -------
    HalfIntegral
        With rates in geometric progression, their spacing and middle fitted, and non-negative
        weights; with as few as the accuracy needs.

    Raises
    ------
    ConfigError
        If the band is none.
    """
    if not 0 < band[0] < band[1] < np.inf:
        raise ConfigError(
            f"losses need a band that rises from over 0, not {band[0]:g} to {band[1]:g} Hz"
        )
    for n in range(2, MOST_POLES + 1):
        found = _fitted(band, n)
        if found.error < accuracy:
            break
    return found


def _fitted(band: tuple[float, float], n: int) -> HalfIntegral:
    omega = 2 * pi * np.geomspace(*band, FIT_POINTS)
    middle = sqrt(omega[0] * omega[-1])
    wanted = (1j * omega) ** -0.5

    def weighed(guess: Array) -> tuple[Array, Array, Array]:
        rates = middle * np.exp(np.linspace(-1, 1, n) * np.exp(guess[0]) + guess[1])
        terms = 1 / (1j * omega[:, None] + rates) / wanted[:, None]
        both = np.concatenate([terms.real, terms.imag])
        weights, _ = nnls(both, np.repeat([1.0, 0.0], FIT_POINTS))
        return rates, weights, np.abs(terms @ weights - 1)

    def cost(guess: Array) -> float:
        return float(np.log(np.mean(weighed(guess)[2] ** 2)))

    spread = np.log(band[1] / band[0])
    trials = [
        minimize(cost, [np.log(share * spread), 0.0], method="Nelder-Mead")
        for share in (0.5, 1.0, 2.0)
    ]
    rates, weights, off = weighed(min(trials, key=lambda trial: trial.fun).x)
    used = weights > 0
    return HalfIntegral(rates=rates[used], weights=weights[used], error=float(off.max()))


class Losses(NamedTuple):
    """Coefficients of the losses.

    Attributes
    ----------
    drag : Operator
        The operator whose faces are weighted with S sqrt(nu).
    compliance : Array
        (gamma - 1) S sqrt(nu_t) in s^(-1/2), (nx, ny, nz).
    yielding : Array
        What is left of a change where the air yields to it within the step, (nx, ny, nz).
    decay, gain : tuple of Array
        Of the relaxations per step, n scalars.
    wall, bulk : tuple of Array
        Their shares in y, and in what lags behind the pressure, n scalars.
    response : Array
        What a pressure adds to y within a step, scalar.
    rate : Array
        Share of the pressure's change per step that is added to it, scalar.
    share : Array
        How much the air absorbs in each layer, (1, 1, nz).
    """

    drag: Operator
    compliance: jax.Array
    yielding: jax.Array
    decay: tuple[jax.Array, ...]
    gain: tuple[jax.Array, ...]
    wall: tuple[jax.Array, ...]
    bulk: tuple[jax.Array, ...]
    response: jax.Array
    rate: jax.Array
    share: jax.Array


class Memory(NamedTuple):
    """What the losses remember.

    Attributes
    ----------
    relaxed : tuple of Array
        The relaxations, n of (nx, ny, nz). As one array they took four times as long.
    integral : Array
        The half-integral y of the pressure, with halo.
    increment : Array
        Its change over the last step, (nx, ny, nz).
    """

    relaxed: tuple[jax.Array, ...]
    integral: jax.Array
    increment: jax.Array


def losses(
    cells: CutCells,
    exact: CutCells,
    operator: Operator,
    air: Air,
    time_step: float,
    band: tuple[float, float],
    *,
    share: Array | None = None,
    dtype: DTypeLike = jnp.float32,
) -> tuple[Losses, Memory]:
    """Prepare the losses of a grid.

    Parameters
    ----------
    cells : CutCells
        The grid as it will be marched, its small cells relieved.
    exact : CutCells
        The same before that.
    operator : Operator
        Of the former.
    air : Air
        Gas in the lumen.
    time_step : float
        In s.
    band : tuple of float
        Lowest and highest frequency in Hz at which the wall's losses shall be right.
    share : ndarray, optional
        By how much the losses act in each layer of cells, from 0 to 1, (nz,).
    dtype : dtype
        Precision.

    Returns
    -------
    losses : Losses
    memory : Memory
        Of air at rest.
    """
    wall = half_integral(band)
    bulk = [(2 * pi * r.frequency, r.strength * air.sound_speed / pi) for r in air.relaxations]
    rates = np.concatenate([wall.rates, [rate for rate, _ in bulk]])
    weights = np.concatenate([wall.weights, np.zeros(len(bulk))])
    lags = np.concatenate([np.zeros(len(wall.rates)), [rate * lag for rate, lag in bulk]])
    decay = (1 - rates * time_step / 2) / (1 + rates * time_step / 2)
    gain = time_step / (1 + rates * time_step / 2)
    share = np.ones(cells.shape[2]) if share is None else share
    wetted = wetted_area(cells, exact) * share
    drag = _drag(operator, wetted * sqrt(air.viscous_diffusivity), dtype)
    compliance = (air.heat_capacity_ratio - 1) * sqrt(air.thermal_diffusivity) * wetted.sum(axis=0)
    # The classical absorption A f^2 belongs to the diffusivity A c^3 / (2 pi^2) of the pressure.
    diffusivity = air.classical_absorption * air.sound_speed**3 / (2 * pi**2)
    response = float(gain @ weights)
    found = Losses(
        drag=drag,
        compliance=jnp.asarray(compliance, dtype),
        yielding=jnp.asarray(1 / (1 + 0.5 * response * compliance), dtype),
        decay=_scalars(decay, dtype),
        gain=_scalars(gain, dtype),
        wall=_scalars(weights, dtype),
        bulk=_scalars(lags, dtype),
        response=jnp.asarray(response, dtype),
        rate=jnp.asarray(diffusivity / (air.sound_speed**2 * time_step), dtype),
        share=jnp.asarray(share[None, None], dtype),
    )
    still = jnp.zeros(cells.shape, dtype)
    return found, Memory((still,) * len(rates), with_halo(still), still)


def _scalars(values: Array, dtype: DTypeLike) -> tuple[jax.Array, ...]:
    return tuple(jnp.asarray(value, dtype) for value in values)


def wetted_area(cells: CutCells, exact: CutCells) -> Array:
    """Return the wetted wall area per volume of air, spread over the air beside the wall.

    Parameters
    ----------
    cells, exact : CutCells
        A grid with its small cells relieved, and before that.

    Returns
    -------
    ndarray
        The area's shares by the squares of its normal's components, (3, nx, ny, nz), in 1/m; their
        sum is the wetted area.

    Notes
    -----
    The wall's vector area in a cell closes those of its open faces. A tube that goes on beyond its
    ends has no wall there, and a plane of symmetry is none. What the diffusion takes beyond three
    `BAND`, a few thousandths, is given back to the rest: cells in the core need no memory then.
    """
    dx, dy, dz = exact.spacing
    x, y, z = exact.open_x, exact.open_y, exact.open_z
    vector = np.stack(
        [
            (x[:-1] - x[1:]) * dy * dz,
            (y[:, :-1] - y[:, 1:]) * dx * dz,
            (z[:, :, :-1] - z[:, :, 1:]) * dx * dy,
        ]
    )
    if exact.origin[0] == 0.0:
        vector[0, 0] = 0.0
    area = np.linalg.norm(vector, axis=0)
    volume = cells.volume_fraction * dx * dy * dz
    density = np.divide(1.0, area * volume, out=np.zeros_like(area), where=area * volume > 0)
    operator = assemble(cells, Air(sound_speed=1.0, density=1.0), 0.0)
    n_steps = int(np.ceil(BAND**2 / 2 * largest_eigenvalue(operator)))
    spread = [
        _diffused(jnp.asarray(component, jnp.float32), operator, n_steps)
        for component in vector**2 * density
    ]
    return _near_the_wall(np.asarray(spread, float), cells.volume_fraction)


def _near_the_wall(wetted: Array, volume: Array) -> Array:
    """Return the wetted area without its thin tail, and with the same total."""
    beside_flat_wall = sqrt(2 / pi) / BAND
    near = wetted * (wetted.sum(axis=0) > SPARSE * beside_flat_wall)
    total, kept = (float(np.sum(share * volume)) for share in (wetted, near))
    return near * (total / kept) if kept > 0 else wetted


@partial(jax.jit, static_argnames="n_steps")
def _diffused(density: jax.Array, operator: Operator, n_steps: int) -> jax.Array:
    """Return a density after n steps of explicit diffusion over `BAND`, its total kept."""

    def step(_: int, density: jax.Array) -> jax.Array:
        return density + BAND**2 / (2 * n_steps) * laplacian(with_halo(density), operator)

    return jax.lax.fori_loop(0, n_steps, step, density)


def _drag(operator: Operator, wetted: Array, dtype: DTypeLike) -> Operator:
    """Return an operator whose faces are weighted with what lies along them of an area."""
    x, y, z = wetted.sum(axis=0) - wetted
    x, y = np.pad(x, ((1, 1), (0, 0), (0, 0)), "edge"), np.pad(y, ((0, 0), (1, 1), (0, 0)), "edge")
    z = np.pad(z, ((0, 0), (0, 0), (2, 2)), "edge")
    return operator._replace(
        area_x=operator.area_x * jnp.asarray((x[1:] + x[:-1]) / 2, dtype),
        area_y=operator.area_y * jnp.asarray((y[:, 1:] + y[:, :-1]) / 2, dtype),
        area_z=operator.area_z * jnp.asarray((z[:, :, 1:] + z[:, :, :-1]) / 2, dtype),
    )


def lossy_change(
    losses: Losses,
    memory: Memory,
    operator: Operator,
    around: jax.Array,
    pressure: jax.Array,
    change: jax.Array,
    step_squared: jax.Array,
) -> jax.Array:
    """Return the pressure's change over a step with losses.

    Parameters
    ----------
    losses : Losses
    memory : Memory
        What is remembered at the time of `pressure`, without halo.
    operator : Operator
    around : Array
        The pressure plus `bulk_absorption`, with halo, in Pa.
    pressure : Array
        Without halo, in Pa.
    change : Array
        Over the last step, in Pa.
    step_squared : Array
        In s2.

    Returns
    -------
    Array
        Over this step, in Pa.
    """
    force = laplacian(around, operator) - laplacian(with_halo(memory.integral), losses.drag)
    stiff = losses.compliance * (_expected(losses, memory, pressure) - memory.increment)
    return losses.yielding * (change - stiff + step_squared * force)


def advance_relaxations(
    losses: Losses, memory: Memory, pressure: jax.Array, change: jax.Array
) -> Memory:
    """Advance the relaxations and the half-integral by one step of the trapezoidal rule.

    Parameters
    ----------
    losses : Losses
    memory : Memory
        At the time of `pressure`, without halo.
    pressure, change : Array
        Before the step and over it, in Pa.

    Returns
    -------
    Memory
    """
    increment = _expected(losses, memory, pressure) + 0.5 * losses.response * change
    middle = pressure + 0.5 * change
    relaxed = tuple(
        decay * one + gain * middle
        for decay, gain, one in zip(losses.decay, losses.gain, memory.relaxed, strict=True)
    )
    return Memory(relaxed, memory.integral + increment, increment)


def bulk_absorption(losses: Losses, memory: Memory, change: jax.Array) -> jax.Array:
    """Return the air's absorption as a pressure that adds to the Laplacian's argument, in Pa."""
    lagging = sum(
        (share * one for share, one in zip(losses.bulk, memory.relaxed, strict=True)),
        start=jnp.zeros_like(change),
    )
    return losses.share * (losses.rate * change - lagging)


def _expected(losses: Losses, memory: Memory, pressure: jax.Array) -> jax.Array:
    """Return the half-integral's increment without the response to the step's own change."""
    relaxing = (
        share * (decay - 1) * one
        for share, decay, one in zip(losses.wall, losses.decay, memory.relaxed, strict=True)
    )
    return sum(relaxing, start=losses.response * pressure)
