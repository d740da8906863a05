"""Whitening of a cycle's baseband: linear maps to independent errors of equal variance."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg.lapack import ztrtri

from acoustube.base.types import Array, Index
from acoustube.waves.scattering import Complex


@dataclass(frozen=True, eq=False, kw_only=True)
class Weights(ABC):
    """Whitening of the baseband by a lower triangular matrix W.

    The precision matrix ``W^H W`` is the inverse of the covariance of the first n samples,
    multiplied by the baseband's `freedom`, the expected squared magnitude of a whitened sample. A
    whitened sample depends only on the samples up to its own time. The first rows of W are
    therefore the weights of the first samples, and an echo does not show in whitened samples before
    it.

    Attributes
    ----------
    log_determinant : float
        Logarithm of the determinant of the covariance of all samples, times `freedom`.
    spread : float
        Standard deviation of the error of the model that is equal at all times, relative to the
        largest magnitude of the echo.
    """

    log_determinant: float
    spread: float = 0.0

    @abstractmethod
    def __call__(self, samples: Complex) -> Complex:
        """Return whitened samples (..., n) of samples (..., n_time)."""

    @abstractmethod
    def of_derivatives(self, samples: Complex) -> Complex:
        """Return whitened derivatives (..., n), in single precision if that is accurate enough."""

    @abstractmethod
    def adjoint(self, white: Complex) -> Complex:
        """Return ``W^H`` times whitened samples (..., n)."""

    @abstractmethod
    def until(self, n: int) -> Weights:
        """Return the weights of the first n samples alone; `log_determinant` is unchanged."""

    @abstractmethod
    def energies(self, samples: Complex, ranges: Index) -> Array:
        """Return the squared norms (n, m) that parts of signals have after whitening.

        Parameters
        ----------
        samples : ndarray
            Signals in single precision, (n, m, n_time).
        ranges : ndarray
            Indices of the first sample that counts and of the one after the last, for each row of
            signals, (n, 2): from 0 to the number of weights. The other samples count as zero.
        """

    @property
    @abstractmethod
    def sample_precision(self) -> Array:
        """Diagonal of the precision matrix, (n,)."""

    @property
    @abstractmethod
    def n_samples(self) -> int:
        """Number n of samples."""

    def weighted(self, samples: Complex) -> Complex:
        """Return the precision matrix times the first n of samples (..., n_time)."""
        return self.adjoint(self(samples))


def mean_square(white: Complex, freedom: float) -> float:
    """Return the mean square of whitened samples relative to its expectation `freedom`."""
    return float(np.mean(np.abs(white) ** 2)) / freedom


@dataclass(frozen=True, eq=False, kw_only=True)
class RankOneWeights(Weights):
    """Whitening of independent errors and an error of known shape.

    The covariance is ``D (I + u u^H) D``, with the standard deviations D of the independent errors.
    With ``s_k = 1 + sum_(i <= k) |u_i|^2`` and samples ``a = D^-1 x``, a whitened sample is

        ``w_k = sqrt(s_(k-1) / s_k) (a_k - u_k / s_(k-1) sum_(i < k) conj(u_i) a_i)``,

    the innovation of a recursive estimate of the error's amplitude.

    Attributes
    ----------
    scale : ndarray
        Root of the baseband's `freedom`, divided by D, (n,).
    shape : ndarray or None
        The vector u, (n,); None for zero.
    """

    scale: Array
    shape: Complex | None

    @staticmethod
    def of(variance: Array, shape: Complex | None, freedom: float, spread: float) -> RankOneWeights:
        """Return the weights for independent errors and one error of known shape.

        Parameters
        ----------
        variance : ndarray
            Variances of the independent errors, (n_time,).
        shape : ndarray or None
            One standard deviation of the error of known shape, (n_time,); None without it.
        freedom, spread : float
            See :class:`Weights`.
        """
        scale = variance**-0.5
        logarithm = float(np.sum(np.log(variance)))
        if shape is not None:
            shape = shape * scale
            logarithm += float(np.log1p(np.vdot(shape, shape).real))
        return RankOneWeights(
            scale=np.sqrt(freedom) * scale, shape=shape, log_determinant=freedom * logarithm,
            spread=spread,
        )  # fmt: skip

    def __call__(self, samples: Complex) -> Complex:
        """Return whitened samples (..., n) of samples (..., n_time)."""
        given = samples[..., : len(self.scale)]
        if self.shape is None:
            return given * self.scale
        from acoustube.inversion.sample_sums import innovations  # imports Numba

        rows = np.ascontiguousarray(given).reshape(math.prod(given.shape[:-1]), len(self.scale))
        found = innovations(rows, self.scale, self.shape, *self._recursion)
        return np.asarray(found.reshape(given.shape))

    def of_derivatives(self, samples: Complex) -> Complex:
        """Return whitened derivatives (..., n), in double precision: products with u may cancel."""
        return self(samples)

    def adjoint(self, white: Complex) -> Complex:
        """Return ``W^H`` times whitened samples (..., n)."""
        if self.shape is None:
            return white * self.scale
        before, gain = self._recursion
        given = white * gain
        along = given * (self.shape.conj() / before)
        later = np.cumsum(along[..., ::-1], axis=-1)[..., ::-1] - along
        return np.asarray((given - self.shape * later) * self.scale)

    def until(self, n: int) -> RankOneWeights:
        """Return the weights of the first n samples alone; `log_determinant` is unchanged."""
        shape = None if self.shape is None else self.shape[:n]
        return replace(self, scale=self.scale[:n], shape=shape)

    def energies(self, samples: Complex, ranges: Index) -> Array:
        """Return the squared norms (n, m) that parts of signals have after whitening."""
        from acoustube.inversion.sample_sums import energies  # imports Numba

        shape = np.zeros(len(self.scale), complex) if self.shape is None else self.shape
        rows, limits = np.ascontiguousarray(samples), np.ascontiguousarray(ranges.T)
        return np.asarray(energies(rows, *limits, self.scale, shape, self._absorbed))

    @property
    def sample_precision(self) -> Array:
        """Diagonal of the precision matrix, (n,)."""
        power = 0.0 if self.shape is None else np.abs(self.shape) ** 2
        return np.asarray(self.scale**2 * (1 - self._absorbed * power))

    @property
    def n_samples(self) -> int:
        """Number n of samples."""
        return len(self.scale)

    @cached_property
    def _absorbed(self) -> float:
        return 1.0 if self.shape is None else 1 / (1 + float(np.vdot(self.shape, self.shape).real))

    @cached_property
    def _recursion(self) -> tuple[Array, Array]:
        """Factors ``s_(k-1)`` and ``sqrt(s_(k-1) / s_k)`` of the class's equation, both (n,)."""
        assert self.shape is not None
        power = np.abs(self.shape) ** 2
        until = 1 + np.cumsum(power)
        before = np.concatenate([[1.0], until[:-1]])
        return before, np.sqrt(before / until)


@dataclass(frozen=True, eq=False, kw_only=True)
class FullWeights(Weights):
    """Whitening of correlated errors.

    Attributes
    ----------
    matrix : ndarray
        Inverse of the Cholesky factor of the covariance of the first n samples, times the root of
        the baseband's `freedom`, (n, n).
    """

    matrix: Complex

    @staticmethod
    def of(factor: Complex, scale: Array, freedom: float, spread: float) -> FullWeights:
        """Return the weights that whiten errors, from a Cholesky factor of their covariance.

        Parameters
        ----------
        factor : ndarray
            Lower Cholesky factor of ``S C S``, with the covariance C of the samples and the
            diagonal matrix S of `scale`, (n, n).
        scale : ndarray
            Factor of each sample, (n,).
        freedom, spread : float
            See :class:`Weights`.
        """
        inverse, _ = ztrtri(factor, lower=1)
        return FullWeights(
            matrix=np.sqrt(freedom) * inverse * scale, spread=spread,
            log_determinant=freedom * log_determinant(factor, scale),
        )  # fmt: skip

    def __call__(self, samples: Complex) -> Complex:
        """Return whitened samples (..., n) of samples (..., n_time)."""
        return samples[..., : len(self.matrix)] @ self.matrix.T

    def of_derivatives(self, samples: Complex) -> Complex:
        """Return whitened derivatives (..., n), in single precision."""
        given = samples[..., : len(self.matrix)].astype(np.complex64, copy=False)
        return np.asarray(given @ self._single.T)

    def adjoint(self, white: Complex) -> Complex:
        """Return ``W^H`` times whitened samples (..., n)."""
        return np.asarray(white @ self.matrix.conj())

    def until(self, n: int) -> FullWeights:
        """Return the weights of the first n samples alone; `log_determinant` is unchanged."""
        return replace(self, matrix=self.matrix[:n, :n])

    def energies(self, samples: Complex, ranges: Index) -> Array:
        """Return the squared norms (n, m) that parts of signals have after whitening."""
        found = np.empty(samples.shape[:2], np.float32)
        for i, (start, stop) in enumerate(ranges):
            part = samples[i, :, start:stop]
            weighted = part @ self._precision[start:stop, start:stop].T
            found[i] = (part.real * weighted.real + part.imag * weighted.imag).sum(-1)
        return np.asarray(found)

    @property
    def sample_precision(self) -> Array:
        """Diagonal of the precision matrix, (n,)."""
        return np.asarray(np.sum(np.abs(self.matrix) ** 2, axis=0))

    @property
    def n_samples(self) -> int:
        """Number n of samples."""
        return len(self.matrix)

    @cached_property
    def _single(self) -> Complex:
        return self.matrix.astype(np.complex64)

    @cached_property
    def _precision(self) -> Complex:
        """Precision matrix in single precision, (n, n)."""
        return (self.matrix.conj().T @ self.matrix).astype(np.complex64)


def log_determinant(factor: Complex, scale: Array) -> float:
    """Return the log determinant of a covariance, from the Cholesky factor of the scaled one.

    The arguments are those of :meth:`FullWeights.of`.
    """
    size = np.log(np.diag(factor).real.astype(float)) - np.log(scale)
    return 2 * float(size.sum())
