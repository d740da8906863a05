"""Likelihood of a cycle's baseband: its covariance about the model, and whitening.

The covariance has five parts: the noise, the unknown part of clutter and ring-down, an error of the
model in proportion to the echo, one at all times, and one of the losses in the presses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.linalg.lapack import ztrtri

from acoustube.base.types import Array
from acoustube.inversion.model import ForwardModel
from acoustube.inversion.parameters import split
from acoustube.waves.scattering import Complex

INDEPENDENT_SHARE = 1e-3
"""Fraction of each sample's variance that is independent of the other samples, above which single
precision is enough."""
RINGING, RINGING_SHARE = 0.5e-3, 0.05
"""Decay time in s of the power of the model's error after an echo, due to trapped sound, and power
of this tail at its start. Each sample of the echo adds a tail; its power is relative to the
sample's own."""


@dataclass(frozen=True, eq=False)
class Weights:
    """Whitening of the baseband.

    Attributes
    ----------
    matrix : ndarray
        Inverse of the Cholesky factor of the covariance of the first n samples, times the root of
        the baseband's `freedom`, (n, n). A row depends only on the samples up to its own time, so
        that the first rows are the weights of the first samples.
    log_determinant : float
        Logarithm of the determinant of the covariance of all samples, times `freedom`.
    spread : float
        Error of the model at all times, relative to the highest echo.
    """

    matrix: Complex
    log_determinant: float
    spread: float = 0.0

    def __call__(self, samples: Complex) -> Complex:
        """Return whitened samples (..., n) of samples (..., n_time)."""
        return samples[..., : len(self.matrix)] @ self.matrix.T

    def in_single_precision(self, samples: Complex) -> Complex:
        """Return samples whitened in single precision, which is enough for derivatives."""
        given = samples[..., : len(self.matrix)].astype(np.complex64, copy=False)
        return np.asarray(given @ self._single.T)

    @cached_property
    def _single(self) -> Complex:
        return self.matrix.astype(np.complex64)

    def weighted(self, samples: Complex) -> Complex:
        """Return :attr:`precision` times the first n of samples (n_time,): an array (n,)."""
        return np.asarray(self(samples) @ self.matrix.conj())

    def until(self, n: int) -> Weights:
        """Return the weights of the first n samples alone; `log_determinant` is kept."""
        return replace(self, matrix=self.matrix[:n, :n])

    @cached_property
    def precision(self) -> Complex:
        """Inverse of the covariance of the first n samples, times `freedom`, (n, n)."""
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
        Variance of a sample of the mean of cycles, in counts squared.
    error : float
        Error of the model relative to the echo.
    echo : Echo or None
        Expected echo of the presses; None without presses.
    spread : float
        Error of the model at all times, relative to the highest echo, due to multiple reflections
        that the model lacks.
    """
    factor, scale = _factor(model, noise, error, echo, spread)
    inverse, _ = ztrtri(factor, lower=1)
    freedom = model.base.freedom
    logarithm = freedom * _log_determinant(factor, scale)
    return Weights(np.sqrt(freedom) * inverse * scale, logarithm, spread)


class Echo(NamedTuple):
    """Echo of presses in the baseband, and its change with their losses, both (n_time,).

    Attributes
    ----------
    value : ndarray
        In counts.
    by_losses : ndarray or None
        Change of the echo due to an error of one standard deviation of the losses in the presses.
        Trapped sound then decays faster or slower, which after some milliseconds exceeds any error
        in proportion to the echo. None if this error is left out.
    """

    value: Complex
    by_losses: Complex | None


def echo_of(model: ForwardModel, tools: tuple[int, ...], parameters: Array) -> Echo:
    """Return the echo of presses for parameters (n_parameters,)."""
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
    """Return minus twice the log likelihood of a residual (n_time,), up to a constant.

    The other arguments are those of :func:`weights`.
    """
    white, logarithm = whitened(model, noise, error, echo, spread, residual[:, None])
    deviance = 2 * float(np.sum(np.abs(white) ** 2)) + 2 * logarithm
    return float(model.base.freedom) * deviance


def whitened(
    model: ForwardModel,
    noise: float,
    error: float,
    echo: Echo,
    spread: float,
    samples: Complex,
) -> tuple[Complex, float]:
    """Return whitened samples (n_time, n), and the logarithm of the covariance's determinant.

    This is for weights that are used once. Unlike in :class:`Weights`, neither result is scaled by
    the baseband's `freedom`. The Cholesky factor is not inverted, and is in single precision where
    that changes a deviance by less than 0.01. This is so where the independent part of each
    sample's variance is not small (:data:`INDEPENDENT_SHARE`).

    Parameters
    ----------
    model, noise, error, echo, spread
        See :func:`weights`.
    samples : ndarray
        (n_time, n).
    """
    factor, scale = _factor(model, noise, error, echo, spread, single=True)
    given = (samples * scale[:, None]).astype(factor.dtype)
    white = solve_triangular(factor, given, lower=True, overwrite_b=True, check_finite=False)
    return np.asarray(white, complex), _log_determinant(factor, scale)


def _factor(
    model: ForwardModel, noise: float, error: float, echo: Echo | None, spread: float,
    *, single: bool = False,
) -> tuple[Complex, Array]:  # fmt: skip
    """Return the Cholesky factor of the covariance scaled to a unit diagonal, and the scale.

    With `single`, the factor is in single precision where that is enough.
    """
    own, known = _diagonal(model, noise, error, echo, spread), model.clutter.covariance
    losses = None if echo is None else echo.by_losses
    power = 0.0 if losses is None else np.abs(losses) ** 2
    scale = (np.diag(known).real + own + power) ** -0.5
    if single and np.all(own * scale**2 > INDEPENDENT_SHARE):
        known = model.clutter.covariance_single
    scaled = known * (scale[:, None] * scale).astype(known.real.dtype)
    scaled[np.diag_indices(len(scale))] += own * scale**2
    if losses is not None:
        scaled += np.outer(scale * losses, (scale * losses).conj()).astype(known.dtype)
    factor = cholesky(scaled, lower=True, overwrite_a=True, check_finite=False)
    return np.asarray(factor), scale


def _log_determinant(factor: Complex, scale: Array) -> float:
    """Return the log determinant of the covariance, from the Cholesky factor of the scaled one."""
    size = np.log(np.diag(factor).real.astype(float)) - np.log(scale)
    return 2 * float(size.sum())


def _diagonal(
    model: ForwardModel, noise: float, error: float, echo: Echo | None, spread: float
) -> Array:
    """Return the variances of the parts that are independent between samples, (n_time,)."""
    variance = np.full(len(model.base.used), noise)
    if echo is None:
        return variance
    variance += (spread * np.abs(echo.value).max()) ** 2
    if error > 0:
        from scipy.signal import lfilter  # loads statistics too, 20 MB that a sensor does not need

        power = np.convolve(np.abs(echo.value) ** 2, [0.25, 0.5, 0.25], "same")
        step = model.base.interval
        tail = lfilter([1.0], [1.0, -np.exp(-step / RINGING)], power)
        variance += error**2 * (power + RINGING_SHARE * tail)
    return variance
