"""Clutter and ring-down of a tube: from untouched cycles, or Gaussian with a stated density."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from acoustube.base.checks import Optional, Reals, checked
from acoustube.base.types import Array
from acoustube.inversion.baseband import Baseband
from acoustube.waves.scattering import Complex

SPACING = 1e-3
"""Spacing in m of the reflectors that represent the irregularities of a tube: a quarter wavelength
at 85 kHz."""
CELL = 0.02
"""Spacing in m of the positions for which the clutter beyond them is tabulated."""
WARM, WARM_STEP = 1.5, 0.1
"""Half range and step in K of the temperature deviations for which the clutter is tabulated."""
RING_DEVIATION = 0.3
"""Relative standard deviation of the ring-down's level where it is not measured."""
FAR_DEVIATION = 0.01
"""Standard deviation in m of the position of the far end: its phase is not known."""


@dataclass(frozen=True, eq=False)
class Clutter:
    """Reflections of the untouched tube.

    Attributes
    ----------
    behind : ndarray or None
        Reflection coefficient, referred to the face, of the tube beyond a position, for
        temperatures and positions, (n_t, n_z, n_f); None if only its statistics are known.
    warmer : ndarray or None
        Derivative of `behind` by temperature in 1/K.
    ring : ndarray
        Ring-down in the baseband, (n_time,).
    covariance : ndarray
        Covariance of the unknown part of clutter and ring-down in the baseband, (n_time, n_time).
    """

    behind: Complex | None
    warmer: Complex | None
    ring: Complex
    covariance: Complex

    def beyond(self, place: Array, temperature: Array) -> tuple[Complex, Complex, Complex]:
        """Return the reflection of the tube beyond positions, and its derivatives.

        Parameters
        ----------
        place : ndarray
            Distances from the face in m, (n,).
        temperature : ndarray
            Deviations in K, (n,).

        Returns
        -------
        value, by_place, by_temperature : ndarray
            Reflection coefficient and its derivatives per m and per K, (n, n_f).
        """
        assert self.behind is not None
        from acoustube.inversion.spline_sums import between  # needs Numba: imported when called

        n_t, n_z, _ = self.behind.shape
        columns = np.clip(place / CELL, 0, n_z - 1.000001)
        rows = np.clip((temperature + WARM) / WARM_STEP, 0, n_t - 1.000001)
        value, by_column, by_row = between(self.behind, self.warmer_by_row, rows, columns)
        return value, by_column / CELL, by_row / WARM_STEP

    @cached_property
    def covariance_single(self) -> Complex:
        """The covariance in single precision."""
        return self.covariance.astype(np.complex64)

    @cached_property
    def warmer_by_row(self) -> NDArray[np.complex64]:
        """Derivative of the reflection by temperature, per step `WARM_STEP` of the table."""
        assert self.warmer is not None
        return np.asarray(WARM_STEP * self.warmer, np.complex64)


@checked(base=Baseband)
def unknown_clutter(base: Baseband) -> Clutter:
    """Return clutter of which only the power density is known, as the rangefinder states it."""
    _, shapes = _reflectors(base)
    ring = base.ring_down()
    covariance = shapes @ shapes.conj().T + RING_DEVIATION**2 * np.outer(ring, ring.conj())
    return Clutter(None, None, ring, covariance)


@checked(base=Baseband, counts=Reals(ndim=2), at=Optional(Baseband))
def measured_clutter(
    base: Baseband, counts: NDArray[np.generic], at: Baseband | None = None
) -> Clutter:
    """Return the clutter and ring-down estimated from cycles of the untouched tube.

    Parameters
    ----------
    base : Baseband
        At the temperature of these cycles.
    counts : ndarray
        Counts of the cycles, (n_cycles, n_samples).
    at : Baseband, optional
        At the temperature for which the clutter is returned, that of the cycles by default.

    Returns
    -------
    Clutter

    Notes
    -----
    The level of the ring-down is fitted by weighted least squares. Then reflectors along the tube,
    Gaussian a priori, are estimated by Wiener's filter. Where there is nothing but clutter within
    the resolution of the band, its posterior covariance is that of the noise of the mean.
    """
    return reflectors(base, counts).clutter(at or base)


@dataclass(frozen=True, eq=False)
class Reflectors:
    """Reflectors along a tube that reproduce its untouched cycles.

    Attributes
    ----------
    places : ndarray
        Distances from the face in m, increasing, (n,).
    strength : ndarray
        Reflection coefficients, (n,).
    ring, covariance : ndarray
        See :class:`Clutter`.
    """

    places: Array
    strength: Complex
    ring: Complex
    covariance: Complex

    def clutter(self, at: Baseband) -> Clutter:
        """Return the clutter at the temperature of a baseband.

        The reflection of each reflector is referred to the face. The reflections are then summed
        from the far end to each position.
        """
        first = np.searchsorted(self.places, np.arange(0, at.length + CELL, CELL))
        phase, heated = at.path.plane(self.places)
        field, slope = self.strength * np.exp(-2j * phase), -2j * heated
        field, turn = field * np.exp(-WARM * slope), np.exp(WARM_STEP * slope)
        n_t = round(2 * WARM / WARM_STEP) + 1
        tables = np.zeros((2, n_t, len(first), len(phase)), np.complex64)
        filled = first < len(self.places)
        for i in range(n_t):
            for table, kept in zip(tables, (field, field * slope), strict=True):
                cells = np.add.reduceat(kept, first[filled], axis=1)
                table[i, filled] = np.cumsum(cells[:, ::-1], axis=1)[:, ::-1].T
            field = field * turn
        return Clutter(tables[0], tables[1], self.ring, self.covariance)


def reflectors(base: Baseband, counts: NDArray[np.generic]) -> Reflectors:
    """Return the reflectors that :func:`measured_clutter` estimates."""
    places, shapes = _reflectors(base)
    mean, variance = base.of_cycles(counts)
    noise = variance * np.eye(len(mean))
    prior = shapes @ shapes.conj().T
    inverse = np.linalg.inv(prior + noise)
    shape = base.ring_down()
    weight = (shape.conj() @ inverse @ shape).real
    level = shape.conj() @ inverse @ mean / weight if weight > 0 else 0.0
    strength = shapes.conj().T @ (inverse @ (mean - level * shape))
    scale = np.asarray(strength * base.reflector_scale(places), complex)
    known = shapes @ strength
    return Reflectors(
        places, np.asarray(scale, complex), mean - known, prior - prior @ inverse @ prior
    )


def _reflectors(base: Baseband) -> tuple[Array, Complex]:
    """Return the positions of the reflectors and their echoes of unit variance, (n_time, n)."""
    places = np.arange(0.5 * SPACING, base.length - 2 * FAR_DEVIATION, SPACING)
    end = base.length + FAR_DEVIATION * np.array([-1.5, -0.5, 0.5, 1.5])
    places = np.concatenate([places, end])
    waves = np.exp(-2j * base.path.plane(places)[0])
    return places, base.transformed((base.gain[:, None] * waves * base.reflector_scale(places)).T).T
