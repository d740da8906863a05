"""Maximum of the posterior of a sensor's parameters, by Levenberg and Marquardt's method.

The parameters of each closure affect its own cycles alone. They are eliminated from the normal
equations (Schur complement), so that many closures cost little time.

References
----------
* Damped least squares: Marquardt, D. W. (1963). An algorithm for least-squares estimation of
  nonlinear parameters. Journal of the Society for Industrial and Applied Mathematics 11, 431-441.
  doi:10.1137/0111030
"""

from __future__ import annotations

from dataclasses import dataclass
from math import log
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acoustube.base.types import Array
from acoustube.inversion.twin.model import SHARED, EchoModel
from acoustube.waves.scattering import Complex

SPEED = 343.2
"""Nominal speed of sound in m/s."""
ITERATIONS, CONVERGED = 40, 1e-6
"""Largest number of steps. Decrease of the objective in a step below which the fit ends, to be
multiplied by the larger of 1 and 1e-4 times the objective."""
FIRST_DAMPING, LEAST_DAMPING = 1e-2, 1e-9
"""Initial and least damping of the steps, relative to the diagonal of the matrix to be solved."""


@dataclass(frozen=True, eq=False)
class Data:
    """Recorded closures in the baseband, and the variance of their noise.

    Attributes
    ----------
    values : ndarray
        Baseband in counts, (n, n_t).
    segments : ndarray of int
        Segment of each sample: 1 about the echo, 2 about its repetition, 0 elsewhere; (n, n_t).
    variances : ndarray
        Variances of the noise in segments 1 and 2, in counts squared, (n, 2).
    clutter : ndarray
        Power density of the clutter relative to that of the echo, in segments 1 and 2, (n, 2).
    """

    values: Complex
    segments: NDArray[np.int64]
    variances: Array
    clutter: Array

    @property
    def weights(self) -> Array:
        """Reciprocal variance of a sample's real and imaginary part, 0 if not used, (n, n_t)."""
        inverse = np.concatenate([np.zeros((len(self.variances), 1)), 2 / self.variances], axis=1)
        return np.asarray(np.take_along_axis(inverse, self.segments, axis=1))


@dataclass(frozen=True, eq=False)
class Prior:
    """Independent normal priors of the parameters of a sensor and of its closures.

    Attributes
    ----------
    mean, deviation : ndarray
        Means and standard deviations of the shared parameters, (n_shared,).
    local : ndarray
        Standard deviations of the parameters of each closure, (n, n_local); their means are 0.
    """

    mean: Array
    deviation: Array
    local: Array


class Point(NamedTuple):
    """Parameters of the sensor, (n_shared,), and of each closure, (n, n_local)."""

    shared: Array
    local: Array


class Normal(NamedTuple):
    """Normal equations of weighted least squares, without priors.

    Attributes
    ----------
    shared : ndarray
        Half the Gauss-Newton Hessian of the misfit: block of the sensor, (n_shared, n_shared).
    mixed : ndarray
        Its blocks between the sensor and each closure, (n, n_shared, n_local).
    local : ndarray
        Its block of each closure, (n, n_local, n_local).
    right_shared, right_local : ndarray
        Minus half the gradient of the misfit by the parameters of the sensor, (n_shared,), and of
        each closure, (n, n_local).
    misfit : float
        Weighted sum of the squared residuals.
    """

    shared: Array
    mixed: Array
    local: Array
    right_shared: Array
    right_local: Array
    misfit: float


def normal_equations(model: EchoModel, data: Data, point: Point) -> Normal:
    """Return the normal equations of the data, linearised at given parameters."""
    echoes = model(*point)
    weights = data.weights
    left = data.values - echoes.value
    root = np.sqrt(weights)[:, None]

    def real(values: Complex) -> Array:
        scaled = values * root
        return np.concatenate([scaled.real, scaled.imag], axis=-1)

    js, jl = real(echoes.by_shared), real(echoes.by_local)
    r = real(left[:, None])[:, 0]
    return Normal(
        np.einsum("npt,nqt->pq", js, js, optimize=True),
        js @ jl.swapaxes(1, 2),
        jl @ jl.swapaxes(1, 2),
        np.einsum("npt,nt->p", js, r),
        (jl @ r[:, :, None])[:, :, 0],
        float(np.sum(r**2)),
    )


def solve(normal: Normal, prior: Prior, point: Point, damping: float) -> tuple[Array, Array]:
    """Return damped Gauss-Newton steps of sensor, (n_shared,), and closures, (n, n_local)."""
    precision, local_precision = prior.deviation**-2.0, prior.local**-2.0
    a = normal.shared + np.diag(precision)
    c = normal.local + local_precision[:, :, None] * np.eye(normal.local.shape[1])
    b_s = normal.right_shared - precision * (point.shared - prior.mean)
    b_l = normal.right_local - local_precision * point.local
    a = a + damping * np.diag(np.diag(a))
    c = c + damping * c * np.eye(c.shape[1])
    inverse = np.linalg.inv(c)
    passed = normal.mixed @ inverse
    schur = a - np.einsum("npl,nql->pq", passed, normal.mixed, optimize=True)
    right = b_s - np.einsum("npl,nl->p", passed, b_l)
    scale = 1 / np.sqrt(np.diag(schur))
    step = scale * np.linalg.solve(schur * scale[:, None] * scale, scale * right)
    local = b_l - np.einsum("npl,p->nl", normal.mixed, step)
    return step, (inverse @ local[:, :, None])[:, :, 0]


def objective(misfit: float, prior: Prior, point: Point) -> float:
    """Return minus twice the logarithm of the posterior density, up to a constant."""
    shared = ((point.shared - prior.mean) / prior.deviation) ** 2
    return float(misfit + shared.sum() + ((point.local / prior.local) ** 2).sum())


def maximise(
    model: EchoModel, data: Data, prior: Prior, point: Point, iterations: int = ITERATIONS
) -> tuple[Point, Normal, float]:
    """Return the maximum of the posterior, and the normal equations and the objective there."""
    normal = normal_equations(model, data, point)
    value, damping = objective(normal.misfit, prior, point), FIRST_DAMPING
    for _ in range(iterations):
        step, local = solve(normal, prior, point, damping)
        trial = Point(*_bounded(point.shared + step, point.local + local))
        left = data.values - model.value(*trial)
        found = objective(float(np.sum(data.weights * np.abs(left) ** 2)), prior, trial)
        if not found < value:
            damping *= 8
            if damping > 1e8:
                break
            continue
        gained, point, value = value - found, trial, found
        normal = normal_equations(model, data, point)
        damping = max(damping / 6, LEAST_DAMPING)
        if gained < CONVERGED * max(1.0, 1e-4 * value):
            break
    return point, normal, value


def _bounded(shared: Array, local: Array) -> tuple[Array, Array]:
    """Clip parameters to the range in which the model is defined, in place; return them."""
    limits = {
        "log_radius": (log(0.3), log(4.0)), "temperature_offset": (-30.0, 30.0),
        "log_quality": (log(0.5), log(300.0)), "drive_cycles": (0.6, 100.0),
        "log_resonance": (log(0.2), log(5.0)), "log_drive_frequency": (log(0.2), log(5.0)),
        "face_real": (-0.9, 0.9), "face_imag": (-0.9, 0.9), "log_gain": (-30.0, 30.0),
        "trigger": (-2e-3, 2e-3), **{name: (-1.0, 1.0) for name in SHARED if name[-1] in "123"},
    }  # fmt: skip
    for name, (low, high) in limits.items():
        i = SHARED.index(name)
        shared[i] = min(max(shared[i], low), high)
    local[:, 0] = np.clip(local[:, 0], -0.2, 0.2)
    local[:, 1] = np.clip(local[:, 1], -4.0, 4.0)
    return shared, local
