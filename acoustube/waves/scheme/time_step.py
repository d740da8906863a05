"""Largest stable time step of the leapfrog scheme, from the operator's largest eigenvalue."""

from __future__ import annotations

from math import sqrt

import jax
import jax.numpy as jnp
import numpy as np
from scipy.linalg import eigh_tridiagonal

from acoustube.air import Air
from acoustube.base.checks import checked
from acoustube.waves.grid.cells import CutCells
from acoustube.waves.grid.polyhedron import Array
from acoustube.waves.grid.repeated_layers import without_repeated_layers
from acoustube.waves.grid.small_cells import share_small_volumes
from acoustube.waves.scheme.operator import (
    Operator,
    assemble,
    dispersion_coefficient,
    laplacian,
    on_device,
    with_halo,
)

SAFETY = 0.98
"""Ratio of the time step to its stability limit; it covers the error of the Lanczos value."""
ITERATIONS = 40
"""Largest number of Lanczos steps."""
LANCZOS_LAYERS = 32
"""Number of layers kept at each end of a straight part for the computation of the eigenvalue."""


@checked(cells=CutCells, air=Air)
def stable_step(cells: CutCells, air: Air) -> float:
    """Return the default time step of `propagate` in s, just below the limit of stability.

    Parameters
    ----------
    cells : CutCells
        The lumen, exact fractions.
    air : Air
        Gas in the lumen.

    Returns
    -------
    float
        0.98 of the stability limit in s. The step that `propagate` takes by default may differ from
        this value by 0.1 %, because the absorbers lengthen the grid.

    Raises
    ------
    ValueError
        If the grid has no open cell.
    """
    return marching_step(share_small_volumes(cells), air)


def marching_step(cells: CutCells, air: Air) -> float:
    """Return the time step, 0.98 of the leapfrog scheme's limit 2 / sqrt(largest eigenvalue).

    Parameters
    ----------
    cells : CutCells
        The grid of the scheme, after `share_small_volumes`.
    air : Air
        Gas in the lumen.

    Returns
    -------
    float
        Time step in s.

    Notes
    -----
    The operator's axial correction beta = (1 - nu^2)/12, with the axial Courant number nu, depends
    on the step, and the largest eigenvalue grows with beta. The step for the bound beta = 1/12 is
    therefore stable. So is the longer step for the beta of that step, because its own beta is
    smaller still.
    """
    step = 0.0
    # Shortening a straight part to this length reduces the axial term by a relative 6e-4.
    cells, _ = without_repeated_layers(cells, LANCZOS_LAYERS)
    for _ in range(2):
        operator = assemble(cells, air, dispersion_coefficient(cells, air, step))
        step = SAFETY * 2.0 / sqrt(largest_eigenvalue(operator))
    return step


def largest_eigenvalue(operator: Operator) -> float:
    """Return the largest eigenvalue of the negative operator in 1/s2.

    Parameters
    ----------
    operator : Operator
        Coefficients.

    Returns
    -------
    float
        The Lanczos value [1]_, or Gershgorin's bound if it is smaller.

    Raises
    ------
    ValueError
        If the grid has no open cell.

    Notes
    -----
    The inner product is weighted with the volumes, so that the operator is self-adjoint. The start
    is a checkerboard, the highest mode of an uncut grid, with noise that excites modes localised in
    single wall cells. ``scipy.sparse.linalg.eigsh`` converges to a value higher by 3e-5 to 1e-4 and
    takes three to ten times as long, since each of its products leaves JAX.

    References
    ----------
    .. [1] Lanczos, C. (1950). An iteration method for the solution of the eigenvalue problem of
       linear differential and integral operators. Journal of Research of the National Bureau of
       Standards 45, 255-282. doi:10.6028/jres.045.026
    """
    inverse = np.asarray(operator.inverse_volume)
    volume = np.divide(1.0, inverse, out=np.zeros_like(inverse), where=inverse > 0.0)
    start = _checkerboard(volume.shape).astype(volume.dtype) * (volume > 0.0)
    norm = np.sqrt(np.sum(volume * start**2))
    if not norm > 0.0:
        raise ValueError("the grid has no open cell; check the lumen and the spacing")
    volume, current, previous, coupling = (
        on_device(part, volume.dtype)
        for part in (volume, start / norm, np.zeros_like(volume), np.zeros_like(norm))
    )
    diagonal, off_diagonal = [], []
    for _ in range(ITERATIONS):
        previous, current, level, coupling = _lanczos(previous, current, coupling, volume, operator)
        diagonal.append(float(level))
        off_diagonal.append(float(coupling))
        if off_diagonal[-1] <= 1e-6 * abs(diagonal[0]):  # an invariant subspace: exact
            break
    ritz = eigh_tridiagonal(np.array(diagonal), np.array(off_diagonal[:-1]), eigvals_only=True)
    return min(float(ritz[-1]), _gershgorin(operator))


@jax.jit
def _lanczos(
    previous: jax.Array,
    current: jax.Array,
    coupling: jax.Array,
    volume: jax.Array,
    operator: Operator,
) -> tuple[jax.Array, jax.Array, jax.Array, jax.Array]:
    """Return the current and next Lanczos vector, and the tridiagonal matrix's two new entries."""
    image = -laplacian(with_halo(current), operator) - coupling * previous
    level = jnp.sum(volume * image * current)
    image = image - level * current
    following = jnp.sqrt(jnp.sum(volume * image**2))
    return current, image / jnp.maximum(following, 1e-30), level, following


def _gershgorin(operator: Operator) -> float:
    """Return Gershgorin's bound of the eigenvalues.

    It is the largest value in any cell of twice the sum of its open faces, divided by its volume.
    The axial correction beta D2' N D2 (see `operator`) is at most 4 beta A, because N never exceeds
    A.
    """
    inverse, x, y, z, beta = map(np.asarray, operator)  # JAX would compile for each shape
    z = z[:, :, 1:-1]
    axial = (1.0 + 4.0 * beta) * (z[:, :, 1:] + z[:, :, :-1])
    faces = x[1:] + x[:-1] + y[:, 1:] + y[:, :-1] + axial
    return float(2.0 * np.max(inverse * faces))


def _checkerboard(shape: tuple[int, ...]) -> Array:
    """Return a field of alternating sign with random magnitudes from 0.5 to 1.5."""
    parity = np.indices(shape).sum(axis=0) % 2
    noise = np.random.default_rng(0).uniform(0.5, 1.5, shape)
    return (1.0 - 2.0 * parity) * noise
