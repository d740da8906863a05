"""Noise of recorded echoes: clutter with the spectrum of the echo, and white noise of the means.

References
----------
* Covariance of estimates whose weights differ from those of the noise: White, H. (1982). Maximum
  likelihood estimation of misspecified models. Econometrica 50, 1-25. doi:10.2307/1912526
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acoustube.base.types import Array
from acoustube.inversion.twin.fit import Data, Normal, Point, Prior, normal_equations
from acoustube.inversion.twin.model import LOCAL, SHARED, EchoModel
from acoustube.waves.scattering import Complex

LEAST_LEFT = 0.1
"""Least fraction of the power of the noise that is assumed to remain in the residuals of a fit."""


class Score(NamedTuple):
    """Covariance of the score: the gradient of half the weighted sum of squares, for each closure.

    Attributes
    ----------
    shared, mixed, local : ndarray
        Blocks of the covariance: of the sensor's parameters, (n, n_shared, n_shared), between these
        and the closure's, (n, n_shared, n_local), and of the closure's, (n, n_local, n_local).
    """

    shared: Array
    mixed: Array
    local: Array


def with_variances(model: EchoModel, data: Data, prior: Prior, point: Point, floors: Array) -> Data:
    """Return data with the variances of their noise, estimated from the residuals of a fit.

    Parameters
    ----------
    model : EchoModel
    data : Data
        Data of n closures, with the variances that were used in the fit.
    prior : Prior
    point : Point
        Maximum of the posterior with these variances.
    floors : ndarray
        Variance of the white noise in counts squared, (n,).

    Notes
    -----
    The power density of the noise is ``a P + b W``: P is that of the echo, W that of white noise in
    the tapered band, of mean one, and b its variance in `floors`. A linear least-squares fit with
    the hat matrix H leaves the residuals ``(I - H) e`` of noise e. Weighted by P, their expected
    power is ``tr[P (I - H) (a P + b W) (I - H)^T]``, which gives a. The noise of other closures and
    of the other segment, which contributes through the parameters, is neglected. The variance is
    the mean density weighted by P, and at least the variance of the residuals.
    """
    echoes = model(*point)
    covariance = _joint_covariance(normal_equations(model, data, point), prior)
    variances, clutter = np.empty_like(data.variances), np.empty_like(data.variances)
    white = np.broadcast_to(_white(model), data.values.shape)
    for k in (0, 1):
        inside = data.segments == k + 1
        count = np.maximum(inside.sum(axis=1), 1)
        slopes = _spectra(np.concatenate([echoes.by_shared, echoes.by_local], axis=1), inside)
        power = np.abs(_spectra(echoes.value[:, None], inside)[:, 0]) ** 2
        left = np.abs(_spectra((data.values - echoes.value)[:, None], inside)[:, 0]) ** 2
        weight = 2 / data.variances[:, k]
        by_power = _gram(slopes, slopes * power[:, None])
        # Autocorrelation of the window of the segment, for the part of the noise inside it.
        lags = np.fft.ifft(np.abs(np.fft.fft(inside)) ** 2) / inside.shape[1]
        remaining = []
        for density in (power, white):
            whole = (power * np.fft.fft(np.fft.ifft(density) * lags).real).sum(axis=1)
            coloured = slopes * density[:, None]
            cut = _spectra(np.fft.ifft(coloured, axis=-1, norm="ortho"), inside)
            taken = weight * _traces(covariance, _gram(slopes, cut * power[:, None]))
            estimates = covariance @ _gram(slopes, coloured)
            again = weight**2 / 2 * _traces(estimates, covariance @ by_power)
            remaining.append(np.maximum(whole - taken + again, LEAST_LEFT * whole))
        a = np.maximum((power * left).sum(axis=1) - floors * remaining[1], 0)
        a /= np.maximum(remaining[0], 1e-300)
        # A single closure's value is uncertain: it is averaged with the median over the closures.
        heard = inside.any(axis=1)
        a = np.where(heard, (a + np.median(a[heard])) / 2, 0.0) if heard.any() else a
        mean, mean_white = _means(power, white)
        plain = left.sum(axis=1) / count
        variances[:, k] = np.maximum(a * mean + floors * mean_white, plain)
        clutter[:, k] = a
    return replace(data, variances=variances, clutter=clutter)


def score_of(model: EchoModel, data: Data, point: Point) -> Score:
    """Return the covariance of the score under the estimated power density of the noise.

    Notes
    -----
    The weights of least squares take the noise as white. Clutter is weak at frequencies where the
    echo is weak: parameters that follow from the flanks of the echo's spectrum are determined
    better than with white noise of the same mean density.
    """
    echoes = model(*point)
    total = np.zeros((len(model.places), len(SHARED) + len(LOCAL), len(SHARED) + len(LOCAL)))
    for k in (0, 1):
        inside = data.segments == k + 1
        power = np.abs(_spectra(echoes.value[:, None], inside)[:, 0]) ** 2
        white = np.broadcast_to(_white(model), power.shape)
        mean, mean_white = _means(power, white)
        variance, a = data.variances[:, k], data.clutter[:, k]
        density = a[:, None] * power + ((variance - a * mean) / mean_white)[:, None] * white
        slopes = _spectra(np.concatenate([echoes.by_shared, echoes.by_local], axis=1), inside)
        total += 2 / variance[:, None, None] ** 2 * _gram(slopes, slopes * density[:, None])
    p = len(SHARED)
    return Score(total[:, :p, :p], total[:, :p, p:], total[:, p:, p:])


def _white(model: EchoModel) -> Array:
    """Return the density of white noise in the tapered band relative to its mean, (n_f,)."""
    power = model.band.taper**2
    return np.asarray(power / power.mean())


def _means(power: Array, white: Array) -> tuple[Array, Array]:
    """Return the means over frequency, weighted by power, of power and white density, (n,) each.

    Both are given as (n, n_t). The second mean is at least one, also where there is no power.
    """
    total = np.maximum(power.sum(axis=1), 1e-300)
    own, other = ((power * one).sum(axis=1) / total for one in (power, white))
    return own, np.maximum(other, 1.0)


def _joint_covariance(normal: Normal, prior: Prior) -> Array:
    """Return the joint covariance of the shared parameters and those of each closure, (n, m, m)."""
    local = normal.local + (prior.local**-2.0)[:, :, None] * np.eye(len(LOCAL))
    inverse = np.linalg.inv(local)
    passed = normal.mixed @ inverse
    schur = normal.shared + np.diag(prior.deviation**-2.0)
    schur = schur - np.einsum("npl,nql->pq", passed, normal.mixed)
    scale = 1 / np.sqrt(np.diag(schur))
    shared = np.linalg.inv(schur * scale[:, None] * scale) * scale[:, None] * scale
    mixed = -shared @ passed
    own = inverse - passed.swapaxes(1, 2) @ mixed
    every = np.broadcast_to(shared, (len(own), *shared.shape))
    return np.block([[every, mixed], [mixed.swapaxes(1, 2), own]])


def _spectra(values: Complex, inside: NDArray[np.bool_]) -> Complex:
    """Return unitary Fourier transforms (n, m, n_t) of the values inside a segment (n, n_t)."""
    return np.asarray(np.fft.fft(np.where(inside[:, None], values, 0), axis=-1, norm="ortho"))


def _gram(first: Complex, second: Complex) -> Array:
    """Return the real parts of the products (n, m, m) of two stacks of spectra (n, m, n_t)."""
    return np.asarray((first @ second.conj().swapaxes(1, 2)).real)


def _traces(first: Array, second: Array) -> Array:
    """Return the traces of the products of two stacks of matrices, (n,)."""
    return np.asarray(np.einsum("npq,nqp->n", first, second))
