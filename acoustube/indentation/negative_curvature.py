"""Newton steps at an indefinite tangent, from its curvatures in a Krylov subspace.

A convex matrix K_c in place of an indefinite tangent K gives a descent step. Near a bifurcation,
however, iterations with such steps converge at a ratio close to one, or to the saddle itself. The
Lanczos method, preconditioned by K_c, finds the subspace in which the two matrices differ most
[1]_. In this subspace the step is Newton's with the absolute values of the curvatures, which moves
away from a saddle as fast as towards a minimum [2]_.

References
----------
.. [1] N. I. M. Gould, S. Lucidi, M. Roma, P. L. Toint, "Solving the trust-region subproblem using
   the Lanczos method", SIAM J. Optim. 9, 504-525 (1999).
.. [2] J. Nocedal, S. J. Wright, "Numerical Optimization", 2nd ed., Springer (2006), section 3.4.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import eigh_tridiagonal

from acoustube.base.types import Array
from acoustube.indentation.linear_solver import Solve

LARGEST_SUBSPACE = 24
"""Largest number of Lanczos vectors."""
ENOUGH = 0.1
"""Largest residual that a step may leave in the linearised equations, relative to the gradient."""
SMALLEST_CURVATURE = 0.02
"""Lower bound of the curvatures' absolute values, relative to those of the convex matrix."""


class CurvedStep(NamedTuple):
    """A step at an indefinite tangent.

    Attributes
    ----------
    step : array of shape (n,)
        In m; the energy falls along it.
    lowest : array of shape (n,)
        Direction v of the least curvature found, in m, scaled to ``v^T K_c v`` = 1 J.
    curvature : float
        Curvature along `lowest`, relative to that of the convex matrix; negative at a saddle.
    """

    step: Array
    lowest: Array
    curvature: float


def curved_step(lower: sparse.csc_array, convex: Solve, gradient: Array) -> CurvedStep:
    """Return the Newton step of a tangent with the absolute values of its curvatures.

    Parameters
    ----------
    lower : sparse array of shape (n, n)
        Lower triangle of the tangent K.
    convex : callable
        Solver of a positive definite matrix K_c near the tangent.
    gradient : array of shape (n,)
        Gradient of the energy, in N, not zero.

    Returns
    -------
    CurvedStep

    Notes
    -----
    With K_c-orthonormal Lanczos vectors Q from ``K_c^-1 g``, ``T = Q^T K Q`` is tridiagonal, and
    the step is ``-Q |T|^-1 Q^T g``. Each vector is orthogonalised against all before it.
    """
    diagonal = lower.diagonal()
    solved = convex(gradient)
    size = float(np.sqrt(gradient @ solved))
    vectors, duals = [solved / size], [gradient / size]
    middle: list[float] = []
    beside: list[float] = []
    while True:
        last = vectors[-1]
        image = lower @ last + lower.T @ last - diagonal * last
        middle.append(float(image @ last))
        for vector, dual in zip(vectors, duals, strict=True):
            image -= (image @ vector) * dual
        solved = convex(image)
        next_size = float(np.sqrt(max(image @ solved, 0.0)))
        values, bases = eigh_tridiagonal(middle, beside)
        share = bases @ (bases[0] / np.maximum(np.abs(values), SMALLEST_CURVATURE))
        left = next_size * abs(share[-1])
        if left <= ENOUGH or len(vectors) == LARGEST_SUBSPACE:
            break
        beside.append(next_size)
        vectors.append(solved / next_size)
        duals.append(image / next_size)
    basis = np.array(vectors)
    return CurvedStep(-size * (share @ basis), bases[:, 0] @ basis, float(values[0]))
