"""Clutter and ring-down of a tube, from untouched cycles or from a stated power density alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from acoustube.base.checks import Optional, Reals, checked
from acoustube.base.types import Array
from acoustube.inversion.baseband import Baseband
from acoustube.inversion.paths import propagation_factor
from acoustube.waves.scattering import Complex

SPACING = 1e-3
"""Spacing in m of the reflectors that represent the irregularities of a tube: a quarter wavelength
at 85 kHz."""
CELL = 0.02
"""Step in m between the positions of the table of the clutter."""
WARM, WARM_STEP = 1.5, 0.1
"""Largest magnitude and step in K of the temperature deviations in the table of the clutter."""
RING_DEVIATION = 0.3
"""Relative standard deviation of the ring-down's amplitude where no ring-down is measured."""
FAR_DEVIATION = 0.01
"""Standard deviation in m of the position of the far end: the phase of its echo is not known."""


@dataclass(frozen=True, eq=False)
class Clutter:
    """Clutter and ring-down of the untouched tube, and the covariance of their unknown part.

    Attributes
    ----------
    behind : ndarray or None
        Reflection coefficient, referred to the face, of the untouched tube beyond a position,
        (n_t, n_z, n_f). The n_t temperature deviations are :data:`WARM_STEP` apart, up to plus and
        minus :data:`WARM`, and the n_z positions are multiples of :data:`CELL`. None if only its
        statistics are known.
    warmer : ndarray or None
        Derivative of `behind` by temperature in 1/K; None if `behind` is.
    ring : ndarray
        Ring-down in the baseband in counts, (n_time,).
    variance : float
        Variance of the independent errors of the known part, in counts squared.
    shapes : ndarray or None
        Baseband of the r independent components of the unknown part, each at one standard
        deviation, in counts, (n_time, r); None if clutter and ring-down are known.
    """

    behind: Complex | None
    warmer: Complex | None
    ring: Complex
    variance: float = 0.0
    shapes: Complex | None = None

    def beyond(self, place: Array, temperature: Array) -> Complex:
        """Return the reflection of the tube beyond positions, and its derivatives.

        `behind` must not be None. Beyond the table, the values at its edge are returned; beyond
        its temperatures, the derivative by temperature is 0.

        Parameters
        ----------
        place : ndarray
            Distances from the face in m, (n,).
        temperature : ndarray
            Deviations from the baseband's temperature in K, (n,).

        Returns
        -------
        ndarray
            Reflection coefficient and its derivatives per m and per K, (3, n, n_f).
        """
        assert self.behind is not None
        from acoustube.inversion.spline_sums import between  # needs Numba: imported when called

        n_t, n_z, _ = self.behind.shape
        columns = np.clip(place / CELL, 0, n_z - 1.000001)
        rows = np.clip((temperature + WARM) / WARM_STEP, 0, n_t - 1.000001)
        slopes = self.warmer_by_row
        found = between(self.behind, slopes, rows, columns, WARM_STEP, CELL)
        found[2, np.abs(temperature) > WARM] = 0.0
        return np.asarray(found)

    @cached_property
    def covariance(self) -> Complex:
        """Covariance of the unknown part in counts squared, (n_time, n_time); needs `shapes`."""
        assert self.shapes is not None
        return np.asarray(self.shapes @ self.shapes.conj().T)

    @cached_property
    def warmer_by_row(self) -> NDArray[np.complex64]:
        """Derivatives `warmer` of the table `behind` per step between its rows.

        Its rows are temperatures :data:`WARM_STEP` apart.
        """
        assert self.warmer is not None
        return np.asarray(WARM_STEP * self.warmer, np.complex64)


@checked(base=Baseband)
def unknown_clutter(base: Baseband) -> Clutter:
    """Return clutter of which only the power density is known, as the rangefinder states it.

    The ring-down is computed from the rangefinder's parameters; the relative standard deviation of
    its amplitude is :data:`RING_DEVIATION`.
    """
    _, shapes = _reflectors(base)
    ring = base.ring_down()
    return Clutter(None, None, ring, shapes=np.column_stack([shapes, RING_DEVIATION * ring]))


@checked(base=Baseband, counts=Reals(ndim=2), at=Optional(Baseband))
def measured_clutter(
    base: Baseband, counts: NDArray[np.generic], at: Baseband | None = None
) -> Clutter:
    """Return the clutter and ring-down estimated from cycles of the untouched tube.

    Parameters
    ----------
    base : Baseband
        Baseband at the temperature of these cycles.
    counts : ndarray
        Counts of the cycles, (n_cycles, n_samples).
    at : Baseband, optional
        Baseband at the temperature for which the clutter is returned; `base` by default.

    Returns
    -------
    Clutter

    Raises
    ------
    ConfigError
        If there is no cycle, or cycles have another length than the baseband's.

    Notes
    -----
    The computed ring-down's complex amplitude is fitted by weighted least squares. Then reflectors
    along the tube, Gaussian a priori, are estimated by Wiener's filter. What these do not explain
    counts as ring-down. Ring-down and clutter together are the mean of the cycles, and the variance
    of their errors is that of the noise of this mean.
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
    ring, variance
        See :class:`Clutter`.
    """

    places: Array
    strength: Complex
    ring: Complex
    variance: float

    def clutter(self, at: Baseband) -> Clutter:
        """Return the clutter at the temperature of a baseband.

        The reflection coefficient of each reflector is multiplied by the plane wave's propagation
        factor from the face and back. The products are summed in each cell of the table, and from
        the far end to each position. Within a cell the change of the phase with temperature differs
        by at most 0.08 rad at the largest deviation, so that three terms of its Taylor series
        suffice.
        """
        edges = np.arange(0, at.length + CELL, CELL)
        first = np.searchsorted(self.places, edges)
        filled = first < len(self.places)
        first, middle = first[filled], edges[filled] + CELL / 2
        phase, heated = at.path.plane(self.places)
        slope = -2j * at.path.plane(middle)[1]
        cell = np.repeat(np.arange(len(first)), np.diff(first, append=len(self.places)))
        off = (-2j * heated - slope[:, cell]).astype(np.complex64)  # small within a cell
        term = np.asarray(self.strength * propagation_factor(2 * phase), np.complex64)
        terms = []
        for power in (1, 2, 3):
            terms.append(np.add.reduceat(term, first, axis=1))
            term = term * off / np.float32(power)
        turn, factor, slope = (
            value.astype(np.complex64)
            for value in (np.exp(WARM_STEP * slope), np.exp(-WARM * slope), slope)
        )
        deviations = np.linspace(-WARM, WARM, round(2 * WARM / WARM_STEP) + 1)
        tables = np.zeros((2, len(deviations), len(edges), len(phase)), np.complex64)
        for i, t in enumerate(deviations.astype(np.float32)):
            cells = factor * (terms[0] + t * (terms[1] + t * terms[2]))
            by_warmer = slope * cells + factor * (terms[1] + 2 * t * terms[2])
            for table, kept in zip(tables, (cells, by_warmer), strict=True):
                table[i, filled] = np.cumsum(kept[:, ::-1], axis=1)[:, ::-1].T
            factor = factor * turn
        return Clutter(tables[0], tables[1], self.ring, self.variance)


def mean_reflectors(parts: Sequence[Reflectors], weights: Sequence[float]) -> Reflectors:
    """Return the weighted mean of independent estimates of one tube's reflectors."""
    share = np.asarray(weights, float) / np.sum(weights)
    strength = share @ np.stack([one.strength for one in parts])
    ring = share @ np.stack([one.ring for one in parts])
    variance = float(share**2 @ [one.variance for one in parts])
    return Reflectors(parts[0].places, strength, ring, variance)


def reflectors(base: Baseband, counts: NDArray[np.generic]) -> Reflectors:
    """Return the reflectors that :func:`measured_clutter` estimates, for its arguments."""
    places, shapes = _reflectors(base)
    mean, variance = base.of_cycles(counts)
    prior = shapes @ shapes.conj().T
    inverse = np.linalg.inv(prior + variance * np.eye(len(mean)))
    shape = base.ring_down()
    weight = (shape.conj() @ inverse @ shape).real
    level = shape.conj() @ inverse @ mean / weight if weight > 0 else 0.0
    strength = shapes.conj().T @ (inverse @ (mean - level * shape))
    coefficients = np.asarray(strength * _scale(base, places), complex)
    return Reflectors(places, coefficients, mean - shapes @ strength, variance)


def _scale(base: Baseband, places: Array) -> Array:
    """Return the prior standard deviations of reflection coefficients at places in m, (n,).

    Reflectors near the tube's end represent the far end, all others the clutter.
    """
    clutter = max(base.rangefinder.clutter, 1e-12)  # reflected power per m
    deviation = np.full(len(places), np.sqrt(clutter * SPACING))
    deviation[places > base.length - 2 * FAR_DEVIATION] = abs(base.rangefinder.far_reflection) / 2
    return deviation


def _reflectors(base: Baseband) -> tuple[Array, Complex]:
    """Return reflectors' positions in m, and their echoes in counts in the baseband, (n_time, n).

    The strength of each is one prior standard deviation.
    """
    places = np.arange(0.5 * SPACING, base.length - 2 * FAR_DEVIATION, SPACING)
    end = base.length + FAR_DEVIATION * np.array([-1.5, -0.5, 0.5, 1.5])
    places = np.concatenate([places, end])
    waves = np.exp(-2j * base.path.plane(places)[0])
    return places, base.transformed((base.gain[:, None] * waves * _scale(base, places)).T).T
