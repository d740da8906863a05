"""Propagation of modes between presses: the interface, and the straight tube.

The wrapped tube is in :mod:`acoustube.inversion.wrap`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np

from acoustube.base.types import Array
from acoustube.inversion.joints import Joined
from acoustube.inversion.tables import Matrices
from acoustube.waves.scattering import Complex


class Section(NamedTuple):
    """Propagation from one press to the next, mode by mode.

    Attributes
    ----------
    factor : ndarray
        Propagation factor of the modes' amplitudes, (n, n_f, m).
    at_start, at_end : ndarray
        Wavenumbers in 1/m at the ends of the section, broadcast to (n, n_f, m).
    by_temperature : ndarray
        Derivative of the phase by temperature, in rad/K, (n, n_f, m).
    """

    factor: Complex
    at_start: Complex
    at_end: Complex
    by_temperature: Complex


class Entry(NamedTuple):
    """Propagation from the face to the point where the bend of a tube begins.

    Attributes
    ----------
    matrix : ndarray
        Amplitudes of the bent tube's modes at that point for unit amplitudes of the straight tube's
        modes at the face, (n, n_f, m, m_s). Its transpose holds for the opposite direction.
    by_temperature : ndarray
        Derivative of the phases of the straight modes up to that point, in rad/K, (n_f, m_s).
    """

    matrix: Complex
    by_temperature: Complex


class Path(Protocol):
    """Propagation along a tube.

    Attributes
    ----------
    modes : int
        Number of modes that propagate between presses.
    stretch : float
        Largest length in m over which the presses' matrices are taken as constant.
    converts : bool
        Whether the joints at a press convert modes, so that all coefficients of its matrix are
        needed, also of the last press.
    """

    modes: int
    stretch: float
    converts: bool

    def span(self, nearest: float, length: float) -> tuple[float, float]:
        """Return the range of places in m where presses are sought."""

    def entry(self, temperature: Array) -> Entry | None:
        """Return the propagation to the bend, if any, at deviations of temperature in K, (n,)."""

    def sections(self, places: Array, temperature: Array) -> list[Section]:
        """Return the propagation before each press, at places (n, n_presses) in m."""

    def joined(self, matrices: Matrices, place: Array, temperature: Array) -> Matrices | Joined:
        """Return presses at places (n,), with matrices between the modes of the sections."""

    def phases(self, places: Array, temperature: float, *, behind: bool = False) -> Complex:
        """Return the modes' phases in rad before or behind presses at places (n,), (n, n_f, m)."""

    def plane(self, places: Array) -> tuple[Complex, Complex]:
        """Return the plane wave's phases in rad at places (n,), and changes per K, (n_f, n)."""

    def place_at(self, time: Array) -> Array:
        """Return the distances in m whose echoes of the plane wave arrive at times in s."""


class StraightPath:
    """Propagation along a straight tube.

    Parameters
    ----------
    k, by_temperature : ndarray
        Axial wavenumbers in 1/m and their derivatives in 1/(m K), the plane wave's first, (n_f, m).
    speed : float
        Of sound, in m/s.
    """

    stretch = np.inf
    converts = False

    def __init__(self, k: Complex, by_temperature: Complex, speed: float) -> None:
        self.k, self.by_temperature, self.speed = k, by_temperature, speed
        self.modes = k.shape[1]

    def span(self, nearest: float, length: float) -> tuple[float, float]:
        """Return the range of places in m where presses are sought."""
        return nearest, length - 0.02

    def entry(self, temperature: Array) -> Entry | None:  # noqa: ARG002
        """Return None: the tube is not bent."""
        return None

    def sections(self, places: Array, temperature: Array) -> list[Section]:
        """Return the propagation before each press, at places (n, n_presses) in m."""
        k = self.k + temperature[:, None, None] * self.by_temperature
        lengths = np.diff(places, axis=1, prepend=0.0)[:, :, None, None]
        return [
            Section(np.exp(-1j * k * one), k, k, self.by_temperature * one)
            for one in lengths.swapaxes(0, 1)
        ]

    def joined(self, matrices: Matrices, place: Array, temperature: Array) -> Matrices:  # noqa: ARG002
        """Return the matrices: the modes of the sections are those of the presses."""
        return matrices

    def phases(self, places: Array, temperature: float, *, behind: bool = False) -> Complex:  # noqa: ARG002
        """Return the modes' phases in rad at places (n,) in m, (n, n_f, m)."""
        return np.asarray(places[:, None, None] * (self.k + temperature * self.by_temperature))

    def plane(self, places: Array) -> tuple[Complex, Complex]:
        """Return the plane wave's phases in rad at places (n,), and changes per K, (n_f, n)."""
        return np.outer(self.k[:, 0], places), np.outer(self.by_temperature[:, 0], places)

    def place_at(self, time: Array) -> Array:
        """Return the distances in m whose echoes of the plane wave arrive at times in s."""
        return np.asarray(time * self.speed / 2)


def stretches(
    path: Path, low: float, high: float, fronts: Sequence[float]
) -> list[tuple[float, int]]:
    """Return places in m from which new templates apply, with the number of presses before each."""
    edges = [low, *fronts, high]
    found = []
    for number, (start, stop) in enumerate(pairwise(edges)):
        parts = 1 if np.isinf(path.stretch) else max(1, round((stop - start) / path.stretch))
        found += [(float(at), number) for at in np.linspace(start, stop, parts + 1)[:-1]]
    return found
