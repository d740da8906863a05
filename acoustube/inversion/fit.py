"""Likelihood of a cycle's baseband, and its maxima from many starting points at once.

References
----------
* Damped least squares: Marquardt, D. W. (1963). Journal of the Society for Industrial and Applied
  Mathematics 11, 431-441. doi:10.1137/0111030
* Evidence by Laplace's approximation: MacKay, D. J. C. (2003). Information Theory, Inference, and
  Learning Algorithms. Cambridge University Press, chapter 27.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import log, pi
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.linalg.lapack import ztrtri

from acoustube.base.types import Array, Index
from acoustube.inversion.model import NUISANCES, ForwardModel
from acoustube.waves.scattering import Complex

LARGEST_STEPS = 1.5e-3, 4e-4
"""Largest changes of place and depth in an iteration, in m."""
CLOSEST = 0.03
"""Smallest distance of two presses in m; their deformed parts meet earlier."""
RINGING, RINGING_SHARE = 0.5e-3, 0.05
"""Decay in s, and share, of the model's error after an echo: that of trapped sound."""
CONVERGED = 0.02
"""Decrease of the cost in an iteration that ends the iterations."""
DAMPING, RAISED, LOWERED = 1e-2, 6.0, 5.0
AT_ONCE = 4
"""Sets of parameters whose scattering is computed at once: some MB, which a cache holds."""
PATIENCE, FAR_WORSE = 3, 1e3
"""Iterations after which starting points are given up, and the excess of their cost over the least,
halved with each iteration more."""


@dataclass(frozen=True, eq=False)
class Weights:
    """Whitening of the baseband.

    Attributes
    ----------
    matrix : ndarray
        Inverse of the Cholesky factor of the covariance of the first n samples, (n, n): a row
        depends on the samples up to its own time, so that the first rows are the likelihood of the
        first samples.
    log_determinant : float
        Of the covariance.
    spread : float
        Error of the model at all times, relative to the highest echo.
    """

    matrix: Complex
    log_determinant: float
    spread: float = 0.0

    def __call__(self, samples: Complex) -> Complex:
        """Return whitened samples (..., n) of samples (..., n_time)."""
        return samples[..., : len(self.matrix)] @ self.matrix.T

    def roughly(self, samples: Complex) -> Complex:
        """Return the same in single precision, which is enough for derivatives."""
        given = samples[..., : len(self.matrix)].astype(np.complex64)
        return np.asarray(given @ self._rough.T)

    @cached_property
    def _rough(self) -> Complex:
        return self.matrix.astype(np.complex64)

    def weighted(self, samples: Complex) -> Complex:
        """Return samples (n_time,) times the inverse of the covariance, (n,)."""
        return np.asarray(self(samples) @ self.matrix.conj())

    def until(self, n: int) -> Weights:
        """Return the weights of the first n samples alone."""
        return replace(self, matrix=self.matrix[:n, :n])

    @cached_property
    def precision(self) -> Complex:
        """Inverse of the covariance of the first n samples, (n, n)."""
        return np.asarray(self.matrix.conj().T @ self.matrix)


def weights(
    model: ForwardModel,
    noise: float,
    error: float,
    echo: Echo | None,
    spread: float = 0.0,
) -> Weights:
    """Return the weights for the noise of a mean of cycles and a relative error of the model.

    Parameters
    ----------
    model : ForwardModel
    noise : float
        Variance of a sample of the mean of cycles.
    error : float
        Error of the model relative to the echo.
    echo : Echo or None
        Expected echo of the presses.
    spread : float
        Error of the model at all times, relative to the highest echo: multiple reflections that it
        lacks.
    """
    factor = _factor(model, noise, error, echo, spread)
    inverse, _ = ztrtri(factor, lower=1)
    freedom = model.base.freedom
    return Weights(np.sqrt(freedom) * inverse, freedom * _log_determinant(factor), spread)


class Echo(NamedTuple):
    """Echo of presses in the baseband, and its derivative by their losses, both (n_time,).

    Attributes
    ----------
    value : ndarray
    by_losses : ndarray or None
        Its change by an error of the losses in the presses, one standard deviation. Trapped sound
        decays faster or slower by it, which after some milliseconds is more than any error in
        proportion to the echo. None if it is left out.
    """

    value: Complex
    by_losses: Complex | None


def echo_of(model: ForwardModel, tools: tuple[int, ...], parameters: Array) -> Echo:
    """Return the echo of presses with parameters (n_parameters,)."""
    places, depths, nuisances = split(parameters[None])
    value = model.baseband(tools, places, depths, nuisances)[0][0]
    echo = value - model.without_presses(nuisances)[0]
    if not tools or model.priors.losses == 0:
        return Echo(echo, None)
    return Echo(echo, model.priors.losses * model.by_losses(tools, places, depths, nuisances)[0])


def deviance_of(
    model: ForwardModel,
    noise: float,
    error: float,
    echo: Echo,
    spread: float,
    residual: Complex,
) -> float:
    """Return minus twice the log likelihood of a residual, with the arguments of :func:`weights`.

    But for a constant.
    """
    factor = _factor(model, noise, error, echo, spread)
    white = solve_triangular(factor, residual, lower=True, check_finite=False)
    deviance = 2 * float(np.sum(np.abs(white) ** 2)) + 2 * _log_determinant(factor)
    return float(model.base.freedom) * deviance


def _factor(
    model: ForwardModel,
    noise: float,
    error: float,
    echo: Echo | None,
    spread: float,
) -> Complex:
    """Return the Cholesky factor of the covariance."""
    covariance = model.clutter.covariance.copy()
    diagonal = np.full(len(covariance), noise)
    if echo is not None:
        diagonal = diagonal + (spread * np.abs(echo.value).max()) ** 2
    if echo is not None and error > 0:
        from scipy.signal import lfilter  # with the statistics 20 MB, for which a sensor has no use

        power = np.convolve(np.abs(echo.value) ** 2, [0.25, 0.5, 0.25], "same")
        step = model.base.time[1] - model.base.time[0]
        tail = lfilter([1.0], [1.0, -np.exp(-step / RINGING)], power)
        diagonal = diagonal + error**2 * (power + RINGING_SHARE * tail)
    covariance[np.diag_indices(len(diagonal))] += diagonal
    if echo is not None and echo.by_losses is not None:
        covariance += np.outer(echo.by_losses, echo.by_losses.conj())
    return np.asarray(cholesky(covariance, lower=True, overwrite_a=True, check_finite=False))


def _log_determinant(factor: Complex) -> float:
    return 2 * float(np.log(np.diag(factor).real).sum())


@dataclass(frozen=True, eq=False)
class Fits:
    """Local maxima of the likelihood.

    Attributes
    ----------
    parameters : ndarray
        Place and depth of each press in turn in m, and the nuisances, (n, 2 n_presses + 6).
    cost : ndarray
        Minus twice the logarithm of the likelihood and of the nuisances' prior, but for constants,
        (n,).
    information : ndarray
        Half the second derivatives of the cost, (n, n_parameters, n_parameters).
    """

    parameters: Array
    cost: Array
    information: Array

    def sorted(self) -> Fits:
        """Return the fits, the best first."""
        return self.at(np.argsort(self.cost))

    def at(self, order: Index) -> Fits:
        """Return the fits of some indices."""
        return Fits(self.parameters[order], self.cost[order], self.information[order])

    def first(self, n: int) -> Fits:
        """Return the first n of the fits."""
        return Fits(self.parameters[:n], self.cost[:n], self.information[:n])

    def and_those(self, others: Fits) -> Fits:
        """Return the fits followed by others of as many presses."""
        return Fits(
            np.concatenate([self.parameters, others.parameters]),
            np.concatenate([self.cost, others.cost]),
            np.concatenate([self.information, others.information]),
        )


def split(parameters: Array) -> tuple[Array, Array, Array]:
    """Return places, depths (n, n_presses) and nuisances (n, 6) of parameters."""
    m = (parameters.shape[1] - len(NUISANCES)) // 2
    return parameters[:, : 2 * m : 2], parameters[:, 1 : 2 * m : 2], parameters[:, 2 * m :]


def joined(places: Array, depths: Array, nuisances: Array) -> Array:
    """Return parameters of places and depths (n, n_presses) and nuisances (n, 6)."""
    presses = np.stack([places, depths], axis=-1).reshape(len(places), -1)
    return np.concatenate([presses, nuisances], axis=1)


def maximise(
    model: ForwardModel,
    tools: tuple[int, ...],
    start: Array,
    samples: Complex,
    whiten: Weights,
    iterations: int = 12,
) -> Fits:
    """Return the maxima of the likelihood next to starting points, by Levenberg and Marquardt.

    Starting points that stay far worse than the best one are given up and left where they are.

    Parameters
    ----------
    model : ForwardModel
    tools : tuple of int
        Number of the tool of each press.
    start : ndarray
        Parameters, (n, 2 n_presses + 6).
    samples : ndarray
        Baseband of the cycles, (n_time,).
    whiten : Weights
    iterations : int
    """
    at = bounded(model, tools, start)
    cost, gradient, information = _quadratic(model, tools, at, samples, whiten)
    damping, active = np.full(len(at), DAMPING), np.ones(len(at), bool)
    for number in range(iterations):
        if number >= PATIENCE:
            active &= cost < cost.min() + FAR_WORSE / 2 ** (number - PATIENCE)
        i = np.flatnonzero(active)
        if not len(i):
            break
        diagonal = np.einsum("nii->ni", information[i])
        damped = information[i] + damping[i, None, None] * (
            diagonal[:, :, None] * np.eye(at.shape[1])
        )
        step = -np.linalg.solve(damped, gradient[i][..., None])[..., 0]
        tried = bounded(model, tools, at[i] + _limited(step))
        new = _quadratic(model, tools, tried, samples, whiten)
        better = new[0] < cost[i]
        gain = np.where(better, cost[i] - new[0], np.inf)
        damping[i] = np.where(better, np.maximum(damping[i] / LOWERED, 1e-7), damping[i] * RAISED)
        j = i[better]
        at[j], cost[j] = tried[better], new[0][better]
        gradient[j], information[j] = new[1][better], new[2][better]
        active[i] = (gain > CONVERGED) & (damping[i] < 1e5)
    return Fits(at, cost, information)


def bounded(model: ForwardModel, tools: tuple[int, ...], parameters: Array) -> Array:
    """Return parameters within the ranges of places and depths, with rising places."""
    places, depths, nuisances = split(np.array(parameters))
    for i, tool in enumerate(tools):
        places[:, i] = np.clip(places[:, i], *model.span)
        if i:
            places[:, i] = np.maximum(places[:, i], places[:, i - 1] + CLOSEST)
        depths[:, i] = np.clip(depths[:, i], *model.tables[tool].range)
    limit = 6 * model.priors.deviations
    return joined(places, depths, np.clip(nuisances, -limit, limit))


def _quadratic(
    model: ForwardModel,
    tools: tuple[int, ...],
    parameters: Array,
    samples: Complex,
    whiten: Weights,
) -> tuple[Array, Array, Array]:
    """Return cost (n,), half its gradient (n, p) and half its Gauss-Newton Hessian (n, p, p)."""
    parts = [
        _few_quadratic(model, tools, parameters[i : i + AT_ONCE], samples, whiten)
        for i in range(0, len(parameters), AT_ONCE)
    ]
    cost, gradient, information = (np.concatenate(part) for part in zip(*parts, strict=True))
    return cost, gradient, information


def _few_quadratic(
    model: ForwardModel,
    tools: tuple[int, ...],
    parameters: Array,
    samples: Complex,
    whiten: Weights,
) -> tuple[Array, Array, Array]:
    """Return the same of a few sets of parameters, whose matrices stay in the cache."""
    places, depths, nuisances = split(parameters)
    value, jacobian = model.baseband(tools, places, depths, nuisances)
    residual = whiten(samples - value)
    slopes = whiten.roughly(jacobian)
    p = parameters.shape[1]
    prior = np.zeros((p, p))
    own = np.arange(p - len(NUISANCES), p)
    precision = 1 / model.priors.deviations**2
    prior[own, own] = precision
    cost = 2 * np.sum(np.abs(residual) ** 2, axis=1) + nuisances**2 @ precision
    conjugate = slopes.conj()
    gradient = np.asarray(-2 * (conjugate @ residual[:, :, None])[:, :, 0].real, float)
    gradient[:, own] += nuisances * precision
    information = 2 * (conjugate @ slopes.swapaxes(1, 2)).real.astype(float) + prior
    return cost, gradient, information


def _limited(step: Array) -> Array:
    """Return steps whose changes of places and depths are not too large."""
    found = step.copy()
    m = (step.shape[1] - len(NUISANCES)) // 2
    for i, largest in enumerate(LARGEST_STEPS):
        found[:, i : 2 * m : 2] = np.clip(found[:, i : 2 * m : 2], -largest, largest)
    return found


def restricted_deviance(
    model: ForwardModel, parameters: Array, residual: Complex, jacobian: Complex, whiten: Weights
) -> Array:
    """Return minus twice the log likelihood of weights, parameters marginalised, (n,).

    By a linear model about each of some sets of parameters, within the largest steps of an
    iteration, and but for a constant.

    Parameters
    ----------
    model : ForwardModel
    parameters : ndarray
        (n, n_parameters).
    residual : ndarray
        Samples less the model's, (n, n_time).
    jacobian : ndarray
        Derivatives of the model, (n, n_parameters, n_time).
    whiten : Weights
    """
    precision = np.zeros(parameters.shape[1])
    precision[-len(NUISANCES) :] = 1 / model.priors.deviations**2
    rest, slopes = whiten(residual), whiten(jacobian)
    information = 2 * (slopes.conj() @ slopes.swapaxes(1, 2)).real + np.diag(precision)
    gradient = precision * parameters - 2 * (slopes.conj() @ rest[..., None])[..., 0].real
    step = np.asarray(np.linalg.solve(information, gradient[..., None])[..., 0], float)
    # As far towards the minimum as the linear model holds: it may lie beyond a bound.
    part = np.min(
        _limited(step) / np.where(step == 0, 1.0, step), axis=1, initial=1.0, where=step != 0
    )
    least = 2 * np.sum(np.abs(rest) ** 2, axis=1) + parameters**2 @ precision
    least -= part * (2 - part) * np.sum(gradient * step, axis=1)
    curvature = np.linalg.slogdet(information)[1]
    return np.asarray(least + 2 * whiten.log_determinant + curvature)


def evidence(model: ForwardModel, tools: tuple[int, ...], fits: Fits, whiten: Weights) -> Array:
    """Return minus twice the logarithm of the evidence of each fit, but for a constant, (n,).

    Places and depths are uniform a priori.
    """
    length = model.span[1] - model.span[0]
    volume = sum(2 * log(length * float(np.diff(model.tables[tool].range)[0])) for tool in tools)
    volume += float(np.log(2 * pi * model.priors.deviations**2).sum())
    p = fits.parameters.shape[1]
    curvature = np.linalg.slogdet(fits.information)[1] - p * log(2 * pi)
    return np.asarray(fits.cost + 2 * whiten.log_determinant + curvature + volume)
