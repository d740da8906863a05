"""Viscothermal losses at the wall and absorption in the air, in the time domain.

A boundary layer that is thin compared with the bore reduces the tangential velocity v by viscous
drag, and makes the compression of the air isothermal [1]_. Let S be the wetted area per volume of
the air near the wall, nu and nu_t the viscous and thermal diffusivities, gamma the ratio of heat
capacities and s = d/dt. To first order in the layer's thickness [2]_,

    s v = -grad p / rho (1 - S sqrt(nu) s^(-1/2)),
    s p (1 + (gamma - 1) S sqrt(nu_t) s^(-1/2)) = -rho c^2 div v.

Without the velocities, and with y = s^(-1/2) p,

    s^2 p + (gamma - 1) S sqrt(nu_t) s^2 y = c^2 div grad p - c^2 div (S sqrt(nu) grad y).

The drag acts along the wall. It is applied to the whole gradient, whose part normal to the wall is
of the order of the distance from it: attenuations of modes near their cut-on become up to 3 % too
large. The diagonal of the projection I - n n^T alone, n the wall's normal, would leave out a part
of the gradient along walls that are inclined to the grid.

`half_integral` approximates s^(-1/2) over a band by first-order relaxations with positive weights,
a passive model of the fractional derivative [3]_. The scheme advances each by the trapezoidal rule.
The dissipation is then positive at every frequency, on any grid: for s = j omega the real part of
s y / p is positive. At zero frequency the scheme is stable as long as S sqrt(nu) times the value of
the sum of relaxations at s = 0 is less than one; without a bound on S the viscous boundary
condition is ill-posed in the time domain [4]_. In a gap of a few boundary layers S is about 2 / h
with the height h of the gap, and S sqrt(nu) may exceed this bound: the static stiffness would be
negative, and pressures of alternating sign would grow. Therefore S sqrt(nu) is limited to
`LARGEST_DRAG` divided by that value. Each face's term, with weights w and rates r,

    1 - S sqrt(nu) sum w / (s + r) = 1 - S sqrt(nu) sum w / r + S sqrt(nu) sum (w / r) s / (s + r),

is then a spring in parallel with a spring and dashpot in series for each relaxation. None of them
is negative, so that the term is passive by construction.

S must not be too concentrated in other places, either. The wetted area of a wall cell, whose volume
may be arbitrarily small, is therefore not assigned to that cell alone but spread over `WALL_SPREAD`
by diffusion, which conserves its total and makes the result independent of the grid. It is spread
farther for bands of low frequencies, whose boundary layers are thicker: S sqrt(nu) at a flat wall
would otherwise exceed the limit.

The absorption of the air adds two terms to the pressure whose Laplacian is taken: one proportional
to the pressure's rate of change (classical absorption), and terms that lag behind the pressure (the
vibrational relaxations of oxygen and nitrogen).

References
----------
.. [1] Kirchhoff, G. (1868). Ueber den Einfluss der Wärmeleitung in einem Gase auf die
   Schallbewegung. Annalen der Physik 210, 177-193. doi:10.1002/andp.18682100602
.. [2] Berggren, M., Bernland, A. and Noreland, D. (2018). Acoustic boundary layers as boundary
   conditions. Journal of Computational Physics 371, 633-650. doi:10.1016/j.jcp.2018.06.005
.. [3] Bilbao, S. and Harrison, R. (2016). Passive time-domain numerical models of viscothermal wave
   propagation in acoustic tubes of variable cross section. Journal of the Acoustical Society of
   America 140, 728-740. doi:10.1121/1.4959025
.. [4] Hägg, L. and Berggren, M. (2022). Investigations of an effective time-domain boundary
   condition for quiescent viscothermal acoustics. arXiv:2207.03152
"""

from __future__ import annotations

from math import pi, sqrt
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike

from acoustube.air import Air
from acoustube.waves.grid.cells import CutCells
from acoustube.waves.grid.polyhedron import Array
from acoustube.waves.scheme.operator import (
    Operator,
    assemble,
    laplacian,
    on_device,
    silent,
    silent_with_halo,
    with_halo,
)
from acoustube.waves.scheme.relaxation_fit import half_integral
from acoustube.waves.scheme.time_step import largest_eigenvalue

WALL_SPREAD = 0.2e-3
"""Smallest standard deviation in m of the distance over which the wetted wall area is spread."""
LARGEST_SPREAD = 2e-3
"""Largest standard deviation in m of the distance over which the wetted wall area is spread."""
FLAT_WALL_DRAG = 0.75
"""Largest viscous drag at a flat wall, relative to its limit; where it would be larger, the wetted
wall area is spread farther."""
WALL_THRESHOLD = 0.01
"""Wetted area per volume, relative to that at a flat wall, below which a cell has no losses at the
wall."""
LARGEST_DRAG = 0.99
"""Largest fraction of the air's mobility at zero frequency that the drag removes; rounding of the
relaxations' decay in single precision changes it by 1e-4 at most."""


class Losses(NamedTuple):
    """Coefficients of the viscothermal losses and of the air's absorption.

    Attributes
    ----------
    drag : Operator
        Operator whose faces are weighted with S sqrt(nu), up to its limit: S is the wetted area
        per volume in 1/m, nu the viscous diffusivity.
    compliance : Array
        (gamma - 1) S sqrt(nu_t) in s^(-1/2), with the thermal diffusivity nu_t, (nx, ny, nz).
    implicit_factor : Array
        1 / (1 + response * compliance / 2) of the thermal boundary-layer term, (nx, ny, nz).
    decay, gain : tuple of Array
        Coefficients of the relaxations per step, n scalars.
    wall, bulk : tuple of Array
        Weights of the relaxations in the half-integral y = s^(-1/2) p of the pressure, and in the
        air's bulk absorption, n scalars.
    response : Array
        Response of the half-integral y to the pressure of the same step, scalar.
    rate : Array
        Coefficient of the pressure's change per step in the bulk absorption, scalar.
    weight : Array
        Weight of the air's absorption in each layer, (1, 1, nz).
    """

    drag: Operator
    compliance: jax.Array
    implicit_factor: jax.Array
    decay: tuple[jax.Array, ...]
    gain: tuple[jax.Array, ...]
    wall: tuple[jax.Array, ...]
    bulk: tuple[jax.Array, ...]
    response: jax.Array
    rate: jax.Array
    weight: jax.Array


class RelaxationState(NamedTuple):
    """Memory variables of the viscothermal losses.

    Attributes
    ----------
    relaxed : tuple of Array
        n relaxations, each (nx, ny, nz). A single array took four times as long.
    integral : Array
        Half-integral y = s^(-1/2) p of the pressure, with halo, (nx+2, ny+2, nz+4).
    increment : Array
        Change of the half-integral over the last step, (nx, ny, nz).
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
    weight: Array | None = None,
    dtype: DTypeLike = jnp.float32,
) -> tuple[Losses, RelaxationState]:
    """Return the coefficients of the losses of a grid, and their state at rest.

    Parameters
    ----------
    cells : CutCells
        The grid of the scheme, after `share_small_volumes`.
    exact : CutCells
        The grid before `share_small_volumes`.
    operator : Operator
        Operator of `cells`.
    air : Air
        Gas in the lumen.
    time_step : float
        In s.
    band : tuple of float
        Lowest and highest frequency in Hz over which the wall's losses are fitted.
    weight : ndarray, optional
        Weight of the losses in each layer of cells, from 0 to 1, (nz,); 1 by default.
    dtype : dtype
        Precision.

    Returns
    -------
    losses : Losses
    memory : RelaxationState
        State of air at rest.
    """
    wall = half_integral(band)
    bulk = [(2 * pi * r.frequency, r.strength * air.sound_speed / pi) for r in air.relaxations]
    rates = np.concatenate([wall.rates, [rate for rate, _ in bulk]])
    weights = np.concatenate([wall.weights, np.zeros(len(bulk))])
    lags = np.concatenate([np.zeros(len(wall.rates)), [rate * lag for rate, lag in bulk]])
    decay = (1 - rates * time_step / 2) / (1 + rates * time_step / 2)
    gain = time_step / (1 + rates * time_step / 2)
    weight = np.ones(cells.shape[2]) if weight is None else weight
    most = LARGEST_DRAG / float(np.sum(wall.weights / wall.rates))
    wetted = wetted_area(cells, exact, _spread(most, air)) * weight
    drag = _drag(operator, wetted * sqrt(air.viscous_diffusivity), most, dtype)
    compliance = (air.heat_capacity_ratio - 1) * sqrt(air.thermal_diffusivity) * wetted
    # The classical absorption A f^2 corresponds to a diffusivity of the pressure A c^3 / (2 pi^2).
    diffusivity = air.classical_absorption * air.sound_speed**3 / (2 * pi**2)
    response = float(gain @ weights)
    found = Losses(
        drag=drag,
        compliance=on_device(compliance, dtype),
        implicit_factor=on_device(1 / (1 + 0.5 * response * compliance), dtype),
        decay=_scalars(decay, dtype),
        gain=_scalars(gain, dtype),
        wall=_scalars(weights, dtype),
        bulk=_scalars(lags, dtype),
        response=on_device(response, dtype),
        rate=on_device(diffusivity / (air.sound_speed**2 * time_step), dtype),
        weight=on_device(weight[None, None], dtype),
    )
    still, around = silent(cells.shape, dtype), silent_with_halo(cells.shape, dtype)
    return found, RelaxationState((still,) * len(rates), around, still)


def _scalars(values: Array, dtype: DTypeLike) -> tuple[jax.Array, ...]:
    """Return each value as a scalar array."""
    return tuple(on_device(value, dtype) for value in values)


def _spread(most: float, air: Air) -> float:
    """Return the standard deviation in m of the wetted area's spread, for a limit of S sqrt(nu)."""
    needed = sqrt(2 / pi * air.viscous_diffusivity) / (FLAT_WALL_DRAG * most)
    return min(max(WALL_SPREAD, needed), LARGEST_SPREAD)


def wetted_area(cells: CutCells, exact: CutCells, spread: float = WALL_SPREAD) -> Array:
    """Return the wetted wall area per volume of air, spread over the air near the wall.

    Parameters
    ----------
    cells, exact : CutCells
        A grid after and before `share_small_volumes`.
    spread : float
        Standard deviation of the distance over which it is spread, in m.

    Returns
    -------
    ndarray
        Wetted area per volume in 1/m, (nx, ny, nz).

    Notes
    -----
    The wall's vector area in a cell is minus the sum of those of its open faces. A tube that
    continues beyond its ends has no wall there, and a plane of symmetry is not a wall. The tail of
    the diffusion beyond three times `spread`, a few thousandths of the total, is redistributed to
    the rest, so that cells in the core need no memory variables.
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
    density = np.divide(area, volume, out=np.zeros_like(area), where=volume > 0)
    operator = assemble(cells, Air(sound_speed=1.0, density=1.0), 0.0)
    n_steps = int(np.ceil(spread**2 / 2 * largest_eigenvalue(operator)))
    rate = on_device(spread**2 / (2 * n_steps), np.float32)
    diffused = _diffused(on_device(density, np.float32), operator, rate, n_steps)
    return _near_the_wall(np.asarray(diffused, float), cells.volume_fraction, spread)


def _near_the_wall(wetted: Array, volume: Array, spread: float) -> Array:
    """Return the wetted area truncated below `WALL_THRESHOLD`, rescaled to the same total."""
    at_flat_wall = sqrt(2 / pi) / spread
    near = wetted * (wetted > WALL_THRESHOLD * at_flat_wall)
    total, kept = (float(np.sum(area * volume)) for area in (wetted, near))
    return near * (total / kept) if kept > 0 else wetted


@jax.jit
def _diffused(density: jax.Array, operator: Operator, rate: jax.Array, n_steps: int) -> jax.Array:
    """Return a density after n steps of explicit diffusion at a rate in m2 per step."""

    def step(_: int, density: jax.Array) -> jax.Array:
        return density + rate * laplacian(with_halo(density), operator)

    return jax.lax.fori_loop(0, n_steps, step, density)


def _drag(operator: Operator, drag: Array, most: float, dtype: DTypeLike) -> Operator:
    """Return an operator whose faces are weighted with `drag`, up to the limit `most`.

    `drag` is S sqrt(nu), (nx, ny, nz), with the wetted area per volume S and the diffusivity nu.
    The weight of a face is the mean of those of two cells, and is therefore within the limit. So is
    the axial correction, whose areas are the smaller of two weighted ones. The drag is therefore
    passive (see the module's docstring).
    """
    limited = np.minimum(drag, most)

    def weighted(area: jax.Array, axis: int, padding: int) -> jax.Array:
        widths = [(padding, padding) if i == axis else (0, 0) for i in range(3)]
        cells = np.moveaxis(np.pad(limited, widths, "edge"), axis, 0)
        at_faces = np.moveaxis((cells[1:] + cells[:-1]) / 2, 0, axis)
        return on_device(np.asarray(area) * at_faces.astype(dtype), dtype)

    return operator._replace(
        area_x=weighted(operator.area_x, 0, 1),
        area_y=weighted(operator.area_y, 1, 1),
        area_z=weighted(operator.area_z, 2, 2),
    )


def lossy_change(
    losses: Losses,
    memory: RelaxationState,
    operator: Operator,
    around: jax.Array,
    pressure: jax.Array,
    change: jax.Array,
    step_squared: jax.Array,
) -> jax.Array:
    """Return the pressure's change over a leapfrog step with viscothermal losses.

    Parameters
    ----------
    losses : Losses
    memory : RelaxationState
        At the time of `pressure`, without halo.
    operator : Operator
    around : Array
        The pressure plus `bulk_absorption`, with halo, in Pa.
    pressure : Array
        Pressure without halo, in Pa.
    change : Array
        Pressure change over the last step, in Pa.
    step_squared : Array
        Time step squared in s2.

    Returns
    -------
    Array
        Pressure change over this step, in Pa.
    """
    force = laplacian(around, operator) - laplacian(with_halo(memory.integral), losses.drag)
    stiff = losses.compliance * (_expected(losses, memory, pressure) - memory.increment)
    return losses.implicit_factor * (change - stiff + step_squared * force)


def advance_relaxations(
    losses: Losses, memory: RelaxationState, pressure: jax.Array, change: jax.Array
) -> RelaxationState:
    """Advance the relaxations and the half-integral by one step of the trapezoidal rule.

    Parameters
    ----------
    losses : Losses
    memory : RelaxationState
        At the time of `pressure`, without halo.
    pressure, change : Array
        Pressure before the step, and its change over the step, in Pa.
    """
    increment = _expected(losses, memory, pressure) + 0.5 * losses.response * change
    middle = pressure + 0.5 * change
    relaxed = tuple(
        decay * one + gain * middle
        for decay, gain, one in zip(losses.decay, losses.gain, memory.relaxed, strict=True)
    )
    return RelaxationState(relaxed, memory.integral + increment, increment)


def bulk_absorption(losses: Losses, memory: RelaxationState, change: jax.Array) -> jax.Array:
    """Return the term in Pa that bulk absorption adds to the argument of the Laplacian.

    `change` is that of the pressure in the last step, in Pa.
    """
    lagging = sum(
        (weight * one for weight, one in zip(losses.bulk, memory.relaxed, strict=True)),
        start=jnp.zeros_like(change),
    )
    return losses.weight * (losses.rate * change - lagging)


def _expected(losses: Losses, memory: RelaxationState, pressure: jax.Array) -> jax.Array:
    """Return the half-integral's increment in a step if the pressure did not change in it."""
    relaxing = (
        weight * (decay - 1) * one
        for weight, decay, one in zip(losses.wall, losses.decay, memory.relaxed, strict=True)
    )
    return sum(relaxing, start=losses.response * pressure)
