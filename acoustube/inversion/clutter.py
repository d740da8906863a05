"""Clutter and ring-down of a tube: known from untouched cycles, or Gaussian with known density."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acoustube.base.checks import Optional, Reals, checked
from acoustube.base.types import Array
from acoustube.inversion.baseband import Baseband
from acoustube.waves.scattering import Complex

SPACING = 1e-3
"""Spacing in m of the reflectors that stand for a tube's irregularities: a quarter wavelength at
85 kHz."""
CELL = 0.02
"""Spacing in m of the places up to which clutter is summed in advance."""
WARM, WARM_STEP = 1.5, 0.1
"""Range to both sides, and step, of the temperatures in K at which it is summed in advance."""
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
        Reflection coefficient at the face of all that lies beyond a place, for temperatures and
        places, (n_t, n_z, n_f); None where only its statistics are known.
    warmer : ndarray or None
        Its derivative by temperature.
    ring : ndarray
        Ring-down in the baseband, (n_time,).
    covariance : ndarray
        Of what is not known of clutter and ring-down, in the baseband, (n_time, n_time).
    """

    behind: Complex | None
    warmer: Complex | None
    ring: Complex
    covariance: Complex

    def beyond(self, place: Array, temperature: Array) -> tuple[Complex, Complex, Complex]:
        """Return the reflection of all beyond places, and its derivatives.

        Parameters
        ----------
        place : ndarray
            In m, (n,).
        temperature : ndarray
            Deviations in K, (n,).

        Returns
        -------
        value, by_place, by_temperature : ndarray
            (n, n_f), per m and per K.
        """
        assert self.behind is not None
        assert self.warmer is not None
        n_t, n_z, _ = self.behind.shape
        z = np.clip(place / CELL, 0, n_z - 1.000001)
        t = np.clip((temperature + WARM) / WARM_STEP, 0, n_t - 1.000001)
        j, i = z.astype(int), t.astype(int)
        z, t = (z - j)[:, None], (t - i)[:, None]
        # Linear over the places, Hermite's cubics over the temperatures.
        ends = []
        for table in (self.behind, self.warmer):
            for row in (i, i + 1):
                low, high = table[row, j].astype(complex), table[row, j + 1].astype(complex)
                ends.append((low + z * (high - low), (high - low) / CELL))
        (a, a_z), (b, b_z), (p, p_z), (q, q_z) = ends
        h = (1 + 2 * t) * (1 - t) ** 2, t**2 * (3 - 2 * t), t * (1 - t) ** 2, t**2 * (t - 1)
        g = 6 * t * (t - 1), 6 * t * (1 - t), (1 - t) * (1 - 3 * t), t * (3 * t - 2)
        value = h[0] * a + h[1] * b + WARM_STEP * (h[2] * p + h[3] * q)
        by_place = h[0] * a_z + h[1] * b_z + WARM_STEP * (h[2] * p_z + h[3] * q_z)
        by_heat = (g[0] * a + g[1] * b) / WARM_STEP + g[2] * p + g[3] * q
        return value, by_place, by_heat


@checked(base=Baseband)
def unknown_clutter(base: Baseband) -> Clutter:
    """Return clutter of which only the rangefinder's density of power is known."""
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
    Wiener's estimate of reflectors along the tube, Gaussian a priori, after the level of the
    ring-down is fitted by weighted least squares. Where there is nothing but clutter within the
    resolution of the band, its posterior covariance is that of the noise of the mean.
    """
    places, shapes = _reflectors(base)
    mean, variance = base.of_cycles(counts)
    noise = variance * np.eye(len(mean))
    prior = shapes @ shapes.conj().T
    inverse = np.linalg.inv(prior + noise)
    shape = base.ring_down()
    weight = (shape.conj() @ inverse @ shape).real
    level = shape.conj() @ inverse @ mean / weight if weight > 0 else 0.0
    strength = shapes.conj().T @ (inverse @ (mean - level * shape))
    # Reflector by reflector at the face, then summed from the far end to each place.
    edges = np.arange(0, base.length + CELL, CELL)
    first = np.searchsorted(places, edges)
    there = at or base
    waves, heated = there.k[:, 0], there.k_by_temperature[:, 0]
    scale = strength * base.reflector_scale(places)
    field = scale * np.exp(-2j * np.outer(waves, places))
    slope = -2j * np.outer(heated, places)
    field, turn = field * np.exp(-WARM * slope), np.exp(WARM_STEP * slope)
    behind: list[Complex] = []
    warmer: list[Complex] = []
    for _ in range(round(2 * WARM / WARM_STEP) + 1):
        for kept, table in ((field, behind), (field * slope, warmer)):
            total = np.concatenate([np.zeros((len(waves), 1)), np.cumsum(kept[:, ::-1], 1)], 1)
            table.append(total[:, len(places) - first].T.astype(np.complex64))
        field = field * turn
    known = shapes @ strength
    covariance = prior - prior @ inverse @ prior
    return Clutter(np.array(behind), np.array(warmer), mean - known, covariance)


def _reflectors(base: Baseband) -> tuple[Array, Complex]:
    """Return the places of the reflectors and their echoes of unit variance, (n_time, n)."""
    places = np.arange(0.5 * SPACING, base.length - 2 * FAR_DEVIATION, SPACING)
    end = base.length + FAR_DEVIATION * np.array([-1.5, -0.5, 0.5, 1.5])
    places = np.concatenate([places, end])
    waves = np.exp(-2j * np.outer(base.k[:, 0], places))
    return places, base.transformed((base.gain[:, None] * waves * base.reflector_scale(places)).T).T
