"""Likelihood of a cycle's baseband: its covariance about the model.

The covariance has five parts: the noise; clutter and ring-down, or their error if they are known;
an error of the model in proportion to the echo; an error of the model that is equal at all times;
and an error of the losses in the presses.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cholesky, solve_triangular

from acoustube.base.types import Array
from acoustube.inversion.model import ForwardModel
from acoustube.inversion.parameters import split
from acoustube.inversion.whitening import (
    FullWeights,
    RankOneWeights,
    Weights,
    log_determinant,
)
from acoustube.waves.scattering import Complex

RINGING, RINGING_SHARE = 0.5e-3, 0.05
"""Decay time in s of the power of the model's error after an echo, due to trapped sound, and power
of this tail at its start. Each sample of the echo adds a tail; its power is relative to the
sample's own."""


class Echo(NamedTuple):
    """Echo of presses in the baseband, and the errors that go with it, all (n_time,).

    Attributes
    ----------
    value : ndarray
        In counts.
    power : ndarray
        Variance in counts squared of an error of the model in proportion to the echo, for a
        relative error of 1.
    by_losses : ndarray or None
        Change of the echo due to an error of one standard deviation of the losses in the presses.
        Trapped sound then decays faster or slower, which after some milliseconds exceeds any error
        in proportion to the echo. None if this error is left out.
    """

    value: Complex
    power: Array
    by_losses: Complex | None


def echo_from(model: ForwardModel, value: Complex, by_losses: Complex | None = None) -> Echo:
    """Return the echo whose `value` and `by_losses` are given, both (n_time,) in counts."""
    from scipy.signal import lfilter  # loads 20 MB that acoustube.sensor does not need

    power = np.convolve(np.abs(value) ** 2, [0.25, 0.5, 0.25], "same")
    tail = lfilter([1.0], [1.0, -np.exp(-model.base.interval / RINGING)], power)
    return Echo(value, power + RINGING_SHARE * tail, by_losses)


def echo_of(model: ForwardModel, tools: tuple[int, ...], parameters: Array) -> Echo:
    """Return the echo of presses for parameters (n_parameters,)."""
    places, depths, nuisances = split(parameters[None])
    value = model.baseband(tools, places, depths, nuisances)[0][0]
    echo = value - model.without_presses(nuisances)[0]
    if not tools or model.priors.losses == 0:
        return echo_from(model, echo)
    by_losses = model.priors.losses * model.by_losses(tools, places, depths, nuisances)[0]
    return echo_from(model, echo, by_losses)


def weights(
    model: ForwardModel,
    noise: float,
    error: float,
    echo: Echo | None,
    spread: float = 0.0,
) -> Weights:
    """Return the weights that whiten noise, clutter and errors of the model in a mean of cycles.

    Parameters
    ----------
    model : ForwardModel
    noise : float
        Variance of a sample of the mean of cycles, in counts squared.
    error : float
        Error of the model relative to the echo.
    echo : Echo or None
        Expected echo of the presses; None without presses.
    spread : float
        Error of the model that is equal at all times, relative to the largest magnitude of the
        echo, due to multiple reflections that the model lacks.
    """
    variance, losses = _errors(model, noise, error, echo, spread)
    if model.clutter.shapes is None:
        return RankOneWeights.of(variance, losses, model.base.freedom, spread)
    factor, scale = _factor(model, variance, losses)
    return FullWeights.of(factor, scale, model.base.freedom, spread)


def deviance_of(
    model: ForwardModel,
    noise: float,
    errors: ArrayLike,
    echo: Echo,
    spreads: ArrayLike,
    residual: Complex,
) -> Array:
    """Return minus twice the log likelihoods of a residual for several errors of the model, (n,).

    They omit a constant.

    Parameters
    ----------
    model, noise, echo
        See :func:`weights`.
    errors, spreads : array_like
        Errors relative to the echo, and errors that are equal at all times, (n,) each or one.
    residual : ndarray
        Baseband in counts, (n_time,).
    """
    pairs = np.broadcast_arrays(*np.atleast_1d(errors, spreads))
    if model.clutter.shapes is not None:
        found = [whitened(model, noise, e, echo, s, residual) for e, s in zip(*pairs, strict=True)]
        return np.array([2 * np.sum(np.abs(white) ** 2) + 2 * size for white, size in found])
    # The inverse and the determinant of D + b b^H, with the error b of the losses.
    variance, losses = _errors(model, noise, pairs[0][:, None], echo, pairs[1][:, None])
    energy, logarithm = (np.abs(residual) ** 2 / variance).sum(-1), np.log(variance).sum(-1)
    if losses is not None:
        power = (np.abs(losses) ** 2 / variance).sum(-1)
        along = (losses.conj() * residual / variance).sum(-1)
        energy -= np.abs(along) ** 2 / (1 + power)
        logarithm += np.log1p(power)
    return np.asarray(2 * model.base.freedom * (energy + logarithm))


def whitened(
    model: ForwardModel,
    noise: float,
    error: float,
    echo: Echo,
    spread: float,
    samples: Complex,
) -> tuple[Complex, float]:
    """Return whitened samples (..., n_time), and :attr:`.Weights.log_determinant`.

    It is for weights that are used once: the Cholesky factor of the covariance is not inverted.

    Parameters
    ----------
    model, noise, error, echo, spread
        See :func:`weights`.
    samples : ndarray
        Baseband in counts, (..., n_time).
    """
    if model.clutter.shapes is None:
        whiten = weights(model, noise, error, echo, spread)
        return whiten(samples), whiten.log_determinant
    factor, scale = _factor(model, *_errors(model, noise, error, echo, spread))
    flat = (samples * scale).reshape(-1, len(scale))
    white = solve_triangular(factor, flat.T, lower=True, overwrite_b=True, check_finite=False)
    freedom = model.base.freedom
    found = np.sqrt(freedom) * white.T.reshape(samples.shape)
    return found, freedom * log_determinant(factor, scale)


def _errors(
    model: ForwardModel, noise: float, error: float | Array, echo: Echo | None,
    spread: float | Array,
) -> tuple[Array, Complex | None]:  # fmt: skip
    """Return the variances of the independent errors and the error of the losses.

    The unknown part of the clutter is not included. The variances have the shape (n_time,), or
    (n, n_time) for errors (n, 1). The second result is the change of the echo by one standard
    deviation of the losses, (n_time,), or None.
    """
    variance = np.full(len(model.base.used), noise + model.clutter.variance)
    if echo is None:
        return variance, None
    loudest = np.abs(echo.value).max()
    return variance + ((spread * loudest) ** 2 + error**2 * echo.power), echo.by_losses


def _factor(model: ForwardModel, variance: Array, losses: Complex | None) -> tuple[Complex, Array]:
    """Return the Cholesky factor of the covariance scaled to a unit diagonal, and the scale.

    `variance` and `losses` are those of :func:`_errors`.
    """
    clutter = model.clutter.covariance
    power = 0.0 if losses is None else np.abs(losses) ** 2
    scale = (np.diag(clutter).real + variance + power) ** -0.5
    scaled = clutter * (scale[:, None] * scale)
    scaled[np.diag_indices(len(scale))] += variance * scale**2
    if losses is not None:
        scaled += np.outer(scale * losses, (scale * losses).conj())
    factor = cholesky(scaled, lower=True, overwrite_a=True, check_finite=False)
    return np.asarray(factor), scale
