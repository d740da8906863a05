"""Propagation of modes between presses: the interface, and the straight tube.

The wrapped tube is in :mod:`acoustube.inversion.wrap`.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np

from acoustube.base.errors import ConfigError
from acoustube.base.types import Array
from acoustube.inversion.joints import Joined
from acoustube.inversion.tables import Matrices
from acoustube.waves.scattering import Complex

AT_ONCE = 32
"""Number of evenly spaced places whose propagation factors are computed from that of the first."""
BEFORE_END = 0.02
"""Length in m of tube before the far end in which no presses are sought."""


class Section(NamedTuple):
    """Propagation from one press to the next, mode by mode.

    The first section begins at the face or, in a wrapped tube, at the start of the wrap.

    Attributes
    ----------
    factor : ndarray
        Propagation factor exp(-j phase) of the modes' amplitudes, (n, n_f, m).
    at_start, at_end : ndarray
        Wavenumbers in 1/m at the ends of the section, of a shape that broadcasts to (n, n_f, m).
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
        Amplitudes of the bent tube's m modes at that point for unit amplitudes of the straight
        tube's m_s modes at the face, (n, n_f, m, m_s). Its transpose holds for the opposite
        direction.
    by_temperature : ndarray
        Derivatives by temperature of the straight modes' phases from the face to that point, in
        rad/K, (n_f, m_s).
    """

    matrix: Complex
    by_temperature: Complex


class Path(Protocol):
    """Interface of the propagation along a straight or a wrapped tube.

    Temperatures are deviations in K from the nominal one; arrays of them are (n,).

    Attributes
    ----------
    modes : int
        Number m of modes that propagate between presses.
    stretch : float
        Length in m of tube over which a search takes the presses' matrices as constant; infinite
        where they do not vary along the tube.
    converts : bool
        Whether the joints at a press convert modes, so that all coefficients of its matrix are
        needed, also of the last press.
    """

    modes: int
    stretch: float
    converts: bool

    def span(self, nearest: float, length: float) -> tuple[float, float]:
        """Return the range of places in m where presses are sought.

        `nearest` is the nearest place that can be located, `length` the length of the tube, in m.
        """

    def entry(self, temperature: Array) -> Entry | None:
        """Return the propagation from face to bend, for temperatures (n,); None without a bend."""

    def sections(self, places: Array, temperature: Array) -> list[Section]:
        """Return the section of tube before each press, for places (n, n_presses) in m."""

    def joined(self, matrices: Matrices, place: Array, temperature: Array) -> Matrices | Joined:
        """Return a press's scattering between the modes of the sections, at places (n,) in m."""

    def phases(self, places: Array, temperature: float, *, behind: bool = False) -> Complex:
        """Return the modes' one-way phases in rad up to presses at places (n,) in m, (n, n_f, m).

        They begin at the face or, in a wrapped tube, at the start of the wrap. They end at the
        front of each press or, if `behind` is true, at its back.
        """

    def propagated(self, origin: float, places: Array, temperature: float, modes: int) -> Complex:
        """Return the propagation factors of modes from behind a press to the fronts of others.

        Parameters
        ----------
        origin : float
            Place of that press in m, or a place at or before the start of :meth:`phases`.
        places : ndarray
            Places of the other presses in m, evenly spaced, (n,).
        temperature : float
            Deviation of the temperature in K.
        modes : int
            Number of modes, the plane mode first.

        Returns
        -------
        ndarray
            Factors exp(-j phase) in single precision, (n, modes, n_f).
        """

    def plane(self, places: Array) -> tuple[Complex, Complex]:
        """Return the plane wave's one-way phases in rad from the face to places (n,) in m.

        Their derivatives by temperature in rad/K are returned too, both (n_f, n).
        """

    def place_at(self, time: Array) -> Array:
        """Return the distances in m of reflectors from the delays in s of plane-wave echoes."""


class StraightPath:
    """Propagation along a straight tube.

    Parameters
    ----------
    k, by_temperature : ndarray
        Axial wavenumbers in 1/m and their derivatives in 1/(m K), the plane wave's first, (n_f, m).
    speed : float
        Speed of sound in m/s.
    """

    stretch = np.inf
    converts = False

    def __init__(self, k: Complex, by_temperature: Complex, speed: float) -> None:
        self.k, self.by_temperature, self.speed = k, by_temperature, speed
        self.modes = k.shape[1]

    def span(self, nearest: float, length: float) -> tuple[float, float]:
        """Return the range of places in m where presses are sought: to 2 cm before the far end.

        The parameters are those of :meth:`Path.span`.

        Raises
        ------
        ConfigError
            If there is no place for a press beyond the nearest.
        """
        if not length - BEFORE_END > nearest:
            raise ConfigError(
                f"a tube of length {length:.4g} m has no place for a press beyond {nearest:.3g} m, "
                "the nearest distance that can be located; use a longer tube or a shorter drive"
            )
        return nearest, length - BEFORE_END

    def entry(self, temperature: Array) -> Entry | None:  # noqa: ARG002
        """Return None: the tube is not bent."""
        return None

    def sections(self, places: Array, temperature: Array) -> list[Section]:
        """Return the section of tube before each press, for places (n, n_presses) in m."""
        k = self.k + temperature[:, None, None] * self.by_temperature
        lengths = np.diff(places, axis=1, prepend=0.0)[:, :, None, None]
        return [
            Section(np.exp(-1j * k * one), k, k, self.by_temperature * one)
            for one in lengths.swapaxes(0, 1)
        ]

    def joined(self, matrices: Matrices, place: Array, temperature: Array) -> Matrices:  # noqa: ARG002
        """Return the matrices unchanged: the modes of the sections are those of the presses."""
        return matrices

    def phases(self, places: Array, temperature: float, *, behind: bool = False) -> Complex:  # noqa: ARG002
        """Return the modes' phases in rad from the face to places (n,) in m, (n, n_f, m)."""
        return np.asarray(places[:, None, None] * (self.k + temperature * self.by_temperature))

    def propagated(self, origin: float, places: Array, temperature: float, modes: int) -> Complex:
        """Return factors from `origin` to evenly spaced places (n,) of some modes, (n, modes, n_f).

        They are products of factors to one in :data:`AT_ONCE` places and of factors over fewer
        steps, since exponentials take several times as long as products.
        """
        k: Complex = (self.k + temperature * self.by_temperature).T[:modes]
        step = float(places[1] - places[0]) if len(places) > 1 else 0.0
        near = step * np.arange(min(len(places), AT_ONCE))[:, None, None]
        far = (places[::AT_ONCE] - max(origin, 0.0))[:, None, None]
        there, onwards = (propagation_factor(np.asarray(length * k)) for length in (far, near))
        found = np.asarray(there[:, None] * onwards)
        return found.reshape(-1, *k.shape)[: len(places)]

    def plane(self, places: Array) -> tuple[Complex, Complex]:
        """Return the plane wave's phases from the face in rad, and changes in rad/K, (n_f, n)."""
        return np.outer(self.k[:, 0], places), np.outer(self.by_temperature[:, 0], places)

    def place_at(self, time: Array) -> Array:
        """Return the distances in m of reflectors from the delays in s of plane-wave echoes."""
        return np.asarray(time * self.speed / 2)


def stretches(
    path: Path, low: float, high: float, fronts: Sequence[float]
) -> list[tuple[float, int]]:
    """Return the starts in m of stretches of tube, each with the number of presses before it.

    The tube is divided at the presses and, where their matrices vary along it, into stretches of
    about ``path.stretch``.

    Parameters
    ----------
    path : Path
    low, high : float
        Ends of the part of the tube that is divided, in m.
    fronts : sequence of float
        Places of the presses in m, rising.
    """
    edges = [low, *fronts, high]
    found = []
    for number, (start, stop) in enumerate(pairwise(edges)):
        parts = 1 if np.isinf(path.stretch) else max(1, round((stop - start) / path.stretch))
        found += [(float(at), number) for at in np.linspace(start, stop, parts + 1)[:-1]]
    return found


def propagation_factor(phases: Complex) -> Complex:
    """Return exp(-j phases) of complex phases in rad, in single precision for speed."""
    turn = phases.real / (2 * np.pi)
    angle = (-2 * np.pi * (turn - np.rint(turn))).astype(np.float32)
    size = np.exp(phases.imag.astype(np.float32))
    found = np.empty(phases.shape, np.complex64)
    found.real, found.imag = size * np.cos(angle), size * np.sin(angle)
    return found
