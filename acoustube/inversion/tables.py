"""Scattering of a tool, interpolated over depth and stretch of frequency, with derivatives."""

from __future__ import annotations

from functools import cached_property, lru_cache, partial
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import spline_filter1d

from acoustube.air import air_of_speed
from acoustube.base.types import Array
from acoustube.inversion.tools import Tool
from acoustube.waves.cut_on_steps import (
    Axial,
    fitting,
    lossy,
    onsets,
    restored,
    steps,
    without,
)
from acoustube.waves.modes import cut_on_frequency
from acoustube.waves.modes.grid_modes import change_by_losses, mode_numbers
from acoustube.waves.scattering import Complex

FINER = 2
"""Ratio of the frequency step of a tool's scattering matrices to that of the splines."""
WIDEST_STRETCH = 0.06
"""Largest relative change of frequency (stretch) that the splines cover, if the tool's frequencies
do. Air 25 K from that of the library takes 0.045, and the bore and errors of the solver the rest.
"""
EARLIEST, DECAY, FAINTEST = -0.4e-3, 0.7e-3, 1e-7
"""Start in s of the impulse response of a press, relative to a reflection at its reference plane;
decay time in s of its power; floor of its power, relative to the largest."""
MOST_MODES = 3
"""Largest number of modes that propagate between presses: those of the default bore with cut-ons
below 1.2 times 42 kHz."""
ONWARDS, BACK = 9, 10
"""Indices in :class:`FrontCoefficients` of the plane wave's transmission coefficients: away from
the face, and back towards it."""
ROUNDING = 1e-5
"""Assumed rms error of the given scattering coefficients, relative to their rms."""


class Matrices(NamedTuple):
    """Scattering matrices of presses and their derivatives; each (n, n_f, 2, m, 2, m).

    The axes after frequency are port and mode of the outgoing, then of the incoming wave.

    Attributes
    ----------
    value : ndarray
        Scattering matrices.
    by_depth : ndarray
        Derivatives by depth, per m.
    by_stretch : ndarray
        Derivatives by the stretch, per relative change of frequency.
    """

    value: Complex
    by_depth: Complex
    by_stretch: Complex

    def transmission(self) -> tuple[Complex, Complex, Complex]:
        """Return the plane wave's two-way transmission, and derivatives by depth and stretch.

        Each is (n, n_f).
        """
        return round_trip(
            [one[..., 1, 0, 0, 0] for one in self], [one[..., 0, 0, 1, 0] for one in self]
        )


class FrontCoefficients(NamedTuple):
    """Reflection at the front of presses, and transmission in both directions, with derivatives.

    The echo of a press with no other press behind it depends on these alone. Each attribute is
    (n, n_f, 11): the reflection coefficients between three modes, row by row, then the plane wave's
    transmission coefficients away from the face, and back towards it.

    Attributes
    ----------
    value : ndarray
        Coefficients.
    by_depth : ndarray
        Derivatives by depth, per m.
    by_stretch : ndarray
        Derivatives by the stretch, per relative change of frequency.
    """

    value: Complex
    by_depth: Complex
    by_stretch: Complex

    def transmission(self) -> tuple[Complex, Complex, Complex]:
        """Return the plane wave's two-way transmission, and derivatives by depth and stretch.

        Each is (n, n_f).
        """
        return round_trip([one[..., ONWARDS] for one in self], [one[..., BACK] for one in self])


def round_trip(there: list[Complex], here: list[Complex]) -> tuple[Complex, Complex, Complex]:
    """Return the two-way transmission coefficient and its derivatives by depth and stretch.

    `there` and `here` each hold a one-way coefficient, then its derivatives by depth and stretch.
    """
    by_depth, by_stretch = (there[i] * here[0] + there[0] * here[i] for i in (1, 2))
    return there[0] * here[0], by_depth, by_stretch


@lru_cache(maxsize=8)
def table_of(tool: Tool, frequency: bytes, modes: int) -> ToolTable:
    """Return the splines of a tool, cached: they are the same at all temperatures.

    Parameters
    ----------
    tool : Tool
    frequency : bytes
        Frequencies in Hz, as the bytes of an array of doubles.
    modes : int
        Number of modes to keep.
    """
    return ToolTable(tool, np.frombuffer(frequency), modes)


class ToolTable:
    """Splines of a tool's scattering, over depth and frequency.

    Parameters
    ----------
    tool : Tool
    frequency : ndarray
        Frequencies in Hz, (n_f,). The tool's band should exceed them at both ends by
        :data:`WIDEST_STRETCH`.
    modes : int
        Number of modes to keep, at most three, the plane mode first.

    Notes
    -----
    Trapped sound rings for so long that the tool's frequencies are only just dense enough: cubic
    splines between them lose what is radiated later than 2 ms. The coefficients are first
    interpolated to finer frequencies by the conditional mean of a stationary Gaussian process. Its
    covariance is the Fourier transform of the expected power of the impulse response over time.
    Steps at cut-ons are subtracted before and added afterwards
    (:mod:`acoustube.waves.cut_on_steps`). Over these finer frequencies, which are evenly spaced,
    B-splines are used; over the depths, which are not, cubic splines. Derivatives are those of the
    splines themselves.
    """

    def __init__(self, tool: Tool, frequency: Array, modes: int) -> None:
        self.tool, self.frequency, self.modes = tool, frequency, modes
        low, high = frequency[0] * (1 - WIDEST_STRETCH), frequency[-1] * (1 + WIDEST_STRETCH)
        step = float(tool.frequency[1] - tool.frequency[0]) / FINER
        first = max(round((low - tool.frequency[0]) / step) - 3, 0)
        last = min(round((high - tool.frequency[0]) / step) + 4, FINER * (len(tool.frequency) - 1))
        self.start, self.step = float(tool.frequency[0] + first * step), step
        self.count = last - first + 1
        kept = np.ascontiguousarray(tool.s[:, :, :, :modes, :, :modes]).astype(complex)
        flat = kept.reshape(len(tool.depth), len(tool.frequency), -1)
        wanted = self.start + step * np.arange(self.count)
        fine = _refined(tool.frequency, flat, wanted, *cut_on_law(tool, modes, tool.sound_speed))
        filtered = spline_filter1d(fine, axis=1, mode="mirror", output=complex)
        self.value = filtered.astype(np.complex64)
        self.slope = CubicSpline(tool.depth, filtered)(tool.depth, 1).astype(np.complex64)

    @property
    def stretches(self) -> tuple[float, float]:
        """Least and largest relative change of the frequencies that the splines cover."""
        low, high = self.start + self.step, self.start + (self.count - 2) * self.step
        return low / float(self.frequency[0]) - 1, high / float(self.frequency[-1]) - 1

    @property
    def range(self) -> tuple[float, float]:
        """Shallowest and deepest depth in m."""
        return float(self.tool.depth[0]), float(self.tool.depth[-1])

    def __call__(self, depth: Array, stretch: Array) -> Matrices:
        """Return the scattering matrices and their derivatives at depths and frequency stretches.

        Parameters
        ----------
        depth : ndarray
            Depths in m, within :attr:`range`, (n,).
        stretch : ndarray
            Relative changes of frequency, (n,).
        """
        parts = self._sums(self.value, self.slope, depth, stretch)
        return Matrices(*parts.reshape(*parts.shape[:3], 2, self.modes, 2, self.modes))

    def front(self, depth: Array, stretch: Array) -> FrontCoefficients:
        """Return the front coefficients alone, for the arguments of a call of the table."""
        return FrontCoefficients(*self._sums(*self._front, depth, stretch))

    @cached_property
    def _front(self) -> tuple[Complex, Complex]:
        """Spline coefficients of the front coefficients, and their derivatives by depth."""
        return _front_coefficients(self.value, self.modes), _front_coefficients(
            self.slope, self.modes
        )

    def _sums(self, values: Complex, slopes: Complex, depth: Array, stretch: Array) -> Complex:
        """Return coefficients, derivatives by depth and by stretch, (3, n, n_f, n_coefficients)."""
        from acoustube.inversion.spline_sums import sums  # Numba: not needed by acoustube.sensor

        place = (np.outer(1 + np.asarray(stretch, float), self.frequency) - self.start) / self.step
        return np.asarray(sums(
            values.view(np.float32), slopes.view(np.float32), self.tool.depth,
            np.asarray(depth, float), place, self.frequency / self.step,
        ).view(complex))  # fmt: skip


def cut_on_law(tool: Tool, modes: int, speed: float) -> tuple[Array, Axial]:
    """Return the cut-ons in Hz of a tool's first modes, and their wavenumbers next to these.

    Parameters
    ----------
    tool : Tool
    modes : int
        Number m of modes.
    speed : float
        Speed of sound in m/s in the tube.

    Returns
    -------
    cut_ons : ndarray
        (m,).
    axial : callable
        Relative axial wavenumbers with losses, see :data:`acoustube.waves.cut_on_steps.Axial`.
    """
    names = tool.modes[:modes]
    cut_ons = np.array(
        [cut_on_frequency(*mode_numbers(name), tool.radius, speed) for name in names]
    )
    losses = partial(change_by_losses, tool.radius, air_of_speed(speed))
    return cut_ons, lossy(names, cut_ons, speed, losses)


def _front_coefficients(part: Complex, modes: int) -> Complex:
    """Return front coefficients (n_depths, n_f, 11) taken from flattened scattering matrices."""
    s = part.reshape(*part.shape[:2], 2, modes, 2, modes)
    found = np.zeros((*part.shape[:2], BACK + 1), part.dtype)
    between = found[..., :ONWARDS].reshape(*part.shape[:2], MOST_MODES, MOST_MODES)
    between[..., :modes, :modes] = s[:, :, 0, :, 0, :]
    found[..., ONWARDS], found[..., BACK] = s[:, :, 1, 0, 0, 0], s[:, :, 0, 0, 1, 0]
    return found


def _refined(given: Array, flat: Complex, wanted: Array, cut_ons: Array, axial: Axial) -> Complex:
    """Return scattering (n_depths, n_given, n) at other frequencies, (n_depths, n_wanted, n)."""
    found, matrix = steps(given, wanted, onsets(cut_ons), axial), _refinement(given, wanted)

    def refined(one: Complex) -> Complex:
        own = fitting(found, one)
        return restored(own, matrix @ without(own, one), one)

    return np.stack([refined(one) for one in flat])


def _refinement(given: Array, wanted: Array) -> Complex:
    """Return the matrix (n_wanted, n_given) that interpolates scattering over frequency.

    The result is the conditional mean of a Gaussian process whose impulse response has independent
    values. Their power is constant from :data:`EARLIEST` to 0 and then decays exponentially, with
    the time constant :data:`DECAY`, to the floor :data:`FAINTEST`. The response ends where the
    given frequencies no longer distinguish later from earlier times.
    """
    period = 1 / (given[1] - given[0])
    time = np.linspace(EARLIEST, EARLIEST + 0.98 * period, 4 * len(given))
    power = np.exp(-np.maximum(time, 0.0) / DECAY) + FAINTEST

    def covariance(a: Array, b: Array) -> Complex:
        # A function of a - b, from the outer products of the phases of a and of b.
        left, right = (np.exp(-2j * np.pi * np.outer(f - given[0], time)) for f in (a, b))
        return np.asarray((left * power) @ right.conj().T)

    known = covariance(given, given)
    known[np.diag_indices(len(given))] += ROUNDING**2 * power.sum()
    return np.asarray(np.linalg.solve(known.T, covariance(wanted, given).T).T)


def padded(part: Complex, modes: int) -> Complex:
    """Return matrices (n, n_f, 2, m, 2, m) padded with zeros to a larger number of modes."""
    m = part.shape[-1]
    if m == modes:
        return np.ascontiguousarray(part)
    found = np.zeros((*part.shape[:2], 2, modes, 2, modes), complex)
    found[..., :m, :, :m] = part
    return found
