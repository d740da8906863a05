"""Small symmetric positive definite systems in JAX, without LAPACK.

The batched LAPACK routines of jaxlib 0.10 wait in XLA's thread pool for tasks of the same pool: two
that run at once on two cores deadlock. For a few unknowns, the factorisation written out element by
element is a small part of the compiled expressions around it.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp


def solve(matrix: jax.Array, right: jax.Array) -> jax.Array:
    """Return the solutions of symmetric positive definite systems, by the Cholesky factorisation.

    Parameters
    ----------
    matrix : ndarray
        (..., n, n) with a small n; the lower triangle is read.
    right : ndarray
        (..., n, m), one right-hand side in each column. Leading axes broadcast with `matrix`.

    Returns
    -------
    ndarray
        (..., n, m); nan or infinite where a matrix is not positive definite.
    """
    n = matrix.shape[-1]
    lower: dict[tuple[int, int], jax.Array] = {}
    for j in range(n):
        for i in range(j, n):
            rest = matrix[..., i, j] - sum(lower[i, k] * lower[j, k] for k in range(j))
            lower[i, j] = jnp.sqrt(rest) if i == j else rest / lower[j, j]
    found: list[jax.Array] = []
    for i in range(n):  # forwards
        rest = right[..., i, :] - sum(lower[i, k][..., None] * found[k] for k in range(i))
        found.append(rest / lower[i, i][..., None])
    for i in reversed(range(n)):  # and backwards
        above = sum(lower[k, i][..., None] * found[k] for k in range(i + 1, n))
        found[i] = (found[i] - above) / lower[i, i][..., None]
    return jnp.stack(found, axis=-2)
