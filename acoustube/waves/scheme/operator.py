"""The spatial operator of the wave equation on cut cells, self-adjoint by construction.

Notes
-----
Mass balance and momentum on a staggered grid [1]_, [2]_ are, per cell of open volume V and face of
open area A and velocity u,

    V dp/dt = -rho c^2 sum(A u),    rho du/dt = -grad p.

Eliminating the face velocities leaves V d2p/dt2 = c^2 sum(A grad p). This has half the memory
traffic of the staggered form and, in leapfrog time stepping, gives the same pressures. Along the
tube the open area is replaced by A + beta D2' N D2, where D2 is the difference between neighbouring
axial faces and N the smaller of their open areas. In a straight duct a plane wave of axial phase
theta = k dz per cell and Omega = omega dt per step then obeys, with nu = c dt / dz,

    sin^2(Omega/2) = nu^2 sin^2(theta/2) (1 + 4 beta sin^2(theta/2)).

Expanded with Omega = nu theta, 1 - nu^2 theta^2/12 = (1 - theta^2/12)(1 + beta theta^2), hence

    beta = (1 - nu^2) / 12

removes the second-order dispersion of space and time together. To that order, this is the symmetric
stencil D' M' A M D, with the differences D between cells and M = 1 - (beta/2) D2^2, but it takes
one pass and is consistent at slanted walls: N vanishes next to a closed face, so that there is no
flow through it. The operator is self-adjoint and negative semidefinite for any areas, so that the
discrete energy is conserved.

References
----------
.. [1] Yee, K. (1966). Numerical solution of initial boundary value problems involving Maxwell's
   equations in isotropic media. IEEE Transactions on Antennas and Propagation 14, 302-307.
   doi:10.1109/TAP.1966.1138693
.. [2] Botteldooren, D. (1995). Finite-difference time-domain simulation of low-frequency room
   acoustic problems. Journal of the Acoustical Society of America 98, 3302-3308.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike, DTypeLike

from acoustube.air import Air
from acoustube.waves.grid.cells import CutCells

HALO = ((1, 1), (1, 1), (2, 2))
"""Number of closed cells around a field on each side; the axial stencil reaches two cells."""
INTERIOR = (slice(1, -1), slice(1, -1), slice(2, -2))
"""Slices that select a field without its halo."""


class Operator(NamedTuple):
    """Coefficients of the discrete c^2 div grad.

    Attributes
    ----------
    inverse_volume : Array
        1 / volume fraction, 0 in the wall, (nx, ny, nz).
    area_x, area_y, area_z : Array
        Open face fractions times (c / h)^2 in 1/s2, with the cell size h along the face's normal.
        Shapes (nx+1, ny, nz), (nx, ny+1, nz) and, with a closed face added at both ends,
        (nx, ny, nz+3).
    beta : Array
        Coefficient of the axial correction, scalar.
    """

    inverse_volume: jax.Array
    area_x: jax.Array
    area_y: jax.Array
    area_z: jax.Array
    beta: jax.Array


def dispersion_coefficient(cells: CutCells, air: Air, time_step: float) -> float:
    """Return the axial correction beta = (1 - nu^2) / 12, with the axial Courant number nu.

    It cancels the plane wave's second-order dispersion. `time_step` is in s.
    """
    return (1.0 - (air.sound_speed * time_step / cells.spacing[2]) ** 2) / 12.0


def assemble(cells: CutCells, air: Air, beta: float, *, dtype: DTypeLike = jnp.float32) -> Operator:
    """Assemble the coefficients of c^2 div grad on a grid.

    Parameters
    ----------
    cells : CutCells
        Fractions, after `share_small_volumes`.
    air : Air
        Gas in the lumen.
    beta : float
        Axial correction; 0 gives the classic second-order stencil.
    dtype : dtype
        Precision of the coefficients.

    Returns
    -------
    Operator
        With closed outermost faces.

    Notes
    -----
    JAX can differentiate the operator, and time stepping with it, with respect to the fractions.
    """
    volume, *faces = (
        on_device(part, dtype)
        for part in (cells.volume_fraction, cells.open_x, cells.open_y, cells.open_z)
    )
    scales = [np.asarray((air.sound_speed / h) ** 2, dtype) for h in cells.spacing]
    inverse, x, y, z = _coefficients(volume, faces, scales)
    return Operator(inverse, x, y, z, on_device(beta, dtype))


@jax.jit
def _coefficients(volume: jax.Array, faces: list[jax.Array], scales: list[ArrayLike]) -> Any:
    """Return the inverse volume fractions, and the open face fractions times (c / h)^2."""
    x, y, z = (
        _closed_outside(face, axis) * scale
        for axis, (face, scale) in enumerate(zip(faces, scales, strict=True))
    )
    # No division by zero in either branch, so that the derivative is also finite.
    inverse = jnp.where(volume > 0.0, 1.0 / jnp.where(volume > 0.0, volume, 1.0), 0.0)
    return inverse, x, y, jnp.pad(z, ((0, 0), (0, 0), (1, 1)))


def _closed_outside(faces: jax.Array, axis: int) -> jax.Array:
    """Return faces with the outermost closed, since the halo is not part of the lumen."""
    inner = np.ones(faces.shape[axis], faces.dtype)
    inner[[0, -1]] = 0.0
    return faces * np.expand_dims(inner, [other for other in range(3) if other != axis])


def on_device(values: ArrayLike, dtype: DTypeLike | None = None) -> jax.Array:
    """Return values as a JAX array; arrays of other kinds are copied, without compilation."""
    if isinstance(values, jax.Array):
        return jnp.asarray(values, dtype)
    # jnp.asarray would compile for each shape; device_put may share the memory of its argument.
    return jax.device_put(np.array(values, dtype))


def with_halo(field: jax.Array) -> jax.Array:
    """Return a field (nx, ny, nz) surrounded by the halo of closed cells."""
    return jnp.pad(field, HALO)


def silent(shape: tuple[int, ...], dtype: DTypeLike) -> jax.Array:
    """Return a field of zeros."""
    return jax.device_put(np.zeros(shape, dtype))


def silent_with_halo(shape: tuple[int, ...], dtype: DTypeLike) -> jax.Array:
    """Return a field of zeros of shape (nx, ny, nz), surrounded by the halo."""
    return silent(tuple(n + sum(pad) for n, pad in zip(shape, HALO, strict=True)), dtype)


def laplacian(pressure: jax.Array, operator: Operator) -> jax.Array:
    """Return the discrete c^2 div grad of a pressure.

    Parameters
    ----------
    pressure : Array
        Pressure with halo, (nx+2, ny+2, nz+4), in Pa.
    operator : Operator
        Coefficients.

    Returns
    -------
    Array
        Second time derivative of the pressure in Pa/s2, (nx, ny, nz).
    """
    gradient = axial_difference(pressure)
    axial = axial_divergence(gradient, operator.area_z, operator.beta)
    across = transverse_divergence(pressure, operator.area_x, operator.area_y)
    return operator.inverse_volume * (across + axial)


def transverse_divergence(pressure: jax.Array, area_x: jax.Array, area_y: jax.Array) -> jax.Array:
    """Return the divergence of area times pressure difference across the tube, (nx, ny, nz)."""
    inner = pressure[:, :, 2:-2]
    flux_x = area_x * (inner[1:, 1:-1] - inner[:-1, 1:-1])
    flux_y = area_y * (inner[1:-1, 1:] - inner[1:-1, :-1])
    return (flux_x[1:] - flux_x[:-1]) + (flux_y[:, 1:] - flux_y[:, :-1])


def axial_difference(pressure: jax.Array) -> jax.Array:
    """Return the pressure differences over the axial faces, (nx, ny, nz+3)."""
    inner = pressure[1:-1, 1:-1]
    return inner[:, :, 1:] - inner[:, :, :-1]


def axial_divergence(velocity: jax.Array, area: jax.Array, beta: jax.Array) -> jax.Array:
    """Return the divergence of (A + beta D2' N D2) u over the axial faces.

    Parameters
    ----------
    velocity : Array
        Axial face quantity u, from one face before the first cell to one behind the last,
        (nx, ny, nz+3).
    area : Array
        Open areas A of these faces. N is the smaller area of two neighbours, D2 the difference.
    beta : Array
        Coefficient of the correction.

    Returns
    -------
    Array
        Divergence per cell, (nx, ny, nz).
    """
    # Face by face rather than by differences of a flux, so that the compiler stores no flux.
    n = velocity.shape[2] - 3
    before, below, above, behind = (velocity[:, :, i : i + n] for i in range(4))
    a, b, c, d = (area[:, :, i : i + n] for i in range(4))
    low = jnp.minimum(a, b) * (below - before)
    here = jnp.minimum(b, c) * (above - below)
    high = jnp.minimum(c, d) * (behind - above)
    return (c * above - b * below) - beta * ((high - here) - (here - low))
