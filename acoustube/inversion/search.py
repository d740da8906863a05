"""Candidates for one more press: correlation of a residual over place, depth and tool."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acoustube.base.types import Array
from acoustube.inversion.baseband import Baseband
from acoustube.inversion.fit import CLOSEST, Weights
from acoustube.inversion.model import ForwardModel
from acoustube.waves.scattering import Complex

COARSE, FINE, FINE_REACH = 3e-3, 0.5e-3, 12e-3
"""Steps in m over the places, coarse and fine, and the reach of the fine ones to both sides."""
DEPTH_STEP = 0.125e-3
NODES, NODES_BEHIND = 0.05, 0.01
"""Distances in m of the places at which the energy of templates is computed: before the first press
known, and behind, where modes beat over 2 cm."""
APART = 0.03
"""Distance in m of candidates that count as different places."""
DISTINCT = 1.5e-3, 0.5e-3
"""Differences of place and depth in m from which two maxima about a place are separate."""
CHUNK = 40
"""Nodes whose templates are computed at once."""


class Front(NamedTuple):
    """Presses before a place, as they are seen from behind.

    Attributes
    ----------
    place : float
        Of the last of them, in m.
    into, out : ndarray
        Amplitudes of the modes behind it for a plane wave from the face, and of the plane wave at
        the face for the modes, both (n_f, m).
    """

    place: float
    into: Complex
    out: Complex


class Candidates(NamedTuple):
    """Candidates for a press, the best first; all (n,).

    Attributes
    ----------
    gain : ndarray
        Decrease of the cost that is expected of each.
    place, depth : ndarray
        In m.
    """

    gain: Array
    place: Array
    depth: Array


class Templates:
    """Echoes of a tool at all depths, for correlation.

    Parameters
    ----------
    model : ForwardModel
    tool : int
        Number of the tool.
    """

    def __init__(self, model: ForwardModel, tool: int) -> None:
        self.model, base = model, model.base
        table = model.tables[tool]
        low, high = table.range
        self.depths = np.linspace(low, high, max(4, round((high - low) / DEPTH_STEP) + 1))
        stretch = np.full(len(self.depths), model.stretch)
        self.reflection = table(self.depths, stretch).value[:, :, 0, :, 0, :]
        self.places = np.arange(base.nearest, base.length - 0.05, COARSE)

    def search(
        self,
        residual: Complex,
        whiten: Weights,
        fronts: list[Front],
        *,
        number: int = 6,
        fine: int = 6,
        near: float | None = None,
        temperature: float = 0.0,
    ) -> Candidates:
        """Return candidates for one more press.

        Parameters
        ----------
        residual : ndarray
            Baseband that is not explained yet, (n_time,).
        whiten : Weights
        fronts : list of Front
            Of the presses known, by place.
        number, fine : int
            Number of places, and of candidates at each.
        near : float, optional
            Place in m about which alone is searched.
        temperature : float
            Deviation in K.
        """
        base = self.model.base
        waves = base.k[:, : self.model.modes]
        waves = waves + temperature * base.k_by_temperature[:, : self.model.modes]
        field = base.adjoint(whiten(residual) @ whiten.matrix.conj())
        coarse = np.empty((len(self.depths), len(self.places)))
        zones = self._zones(fronts, waves)
        owner = self._owners(fronts, self.places)
        matrix = whiten.matrix.T.astype(np.complex64)
        for number_of_zone, zone in enumerate(zones):
            here = owner == number_of_zone
            if here.any():
                zone.set_energy(base, matrix, self.places[here])
                level = np.abs(zone.correlate(field, self.places[here]))
                coarse[:, here] = 2 * (2 * level - zone.energy_at(self.places[here]))
        exclude(coarse, self.places, [front.place for front in fronts], near, FINE_REACH)
        found: list[tuple[float, float, float]] = []
        for best in apart(coarse.max(axis=0), self.places, number):
            found += self._refined(zones[owner[best]], field, self.places[best], fine)
        return candidates(found)

    def _refined(
        self, zone: _Zone, field: Complex, place: float, count: int
    ) -> list[tuple[float, float, float]]:
        """Return the highest separate maxima of the correlation with its phase, about a place."""
        places = place + np.arange(-FINE_REACH, FINE_REACH + 1e-9, FINE)
        gain = 2 * (2 * zone.correlate(field, places).real - zone.energy_at(places))
        return separate(gain, places, self.depths, count)

    def _zones(self, fronts: list[Front], waves: Complex) -> list[_Zone]:
        base = self.model.base
        found = [_Zone([(base.gain * self.reflection[:, :, 0, 0], 2 * waves[:, 0])], 0.0)]
        for front in fronts:
            parts = []
            m = waves.shape[1]
            for a in range(m):
                for b in range(m):
                    shape = base.gain * front.out[:, a] * front.into[:, b]
                    parts.append((shape * self.reflection[:, :, a, b], waves[:, a] + waves[:, b]))
            found.append(_Zone(parts, front.place))
        return found

    @staticmethod
    def _owners(fronts: list[Front], places: Array) -> NDArray[np.intp]:
        return np.searchsorted(np.array([front.place for front in fronts]), places)


class _Zone:
    """Templates of one stretch of the tube: sums of spectra with wavenumbers, from an origin."""

    def __init__(self, parts: Sequence[tuple[Complex, Complex]], origin: float) -> None:
        self.parts, self.origin = parts, origin
        self.nodes, self.level = np.zeros(0), np.zeros((0, 0))

    def set_energy(self, base: Baseband, whiten: Complex, places: Array) -> None:
        """Compute the energies of templates at nodes about places, whitened by a matrix."""
        step = NODES_BEHIND if len(self.parts) > 1 else NODES
        low, high = places[0] - FINE_REACH - step, places[-1] + FINE_REACH + 2 * step
        self.nodes = np.arange(low, high, step)
        energy = []
        for some in np.array_split(self.nodes, 1 + len(self.nodes) // CHUNK):
            spectra = self.spectra(np.maximum(some, self.origin)).astype(np.complex64)
            samples = base.transformed(spectra).astype(np.complex64) @ whiten
            energy.append(np.sum(samples.real**2 + samples.imag**2, axis=-1))
        self.level = np.log(np.maximum(np.concatenate(energy, axis=1), 1e-30))

    def energy_at(self, places: Array) -> Array:
        """Return energies (n_depths, n_places), interpolated exponentially between nodes."""
        share = np.clip((places - self.nodes[0]) / (self.nodes[1] - self.nodes[0]), 0, None)
        i = np.minimum(share.astype(int), len(self.nodes) - 2)
        share = np.clip(share - i, 0, 1)
        return np.asarray(np.exp((1 - share) * self.level[:, i] + share * self.level[:, i + 1]))

    def correlate(self, field: Complex, places: Array) -> Complex:
        """Return the products with a field, (n_depths, n_places)."""
        total: Complex = np.zeros((len(self.parts[0][0]), len(places)), complex)
        for shape, wave in self.parts:
            turn = np.exp(1j * np.outer(wave.conj(), places - self.origin))
            total += (shape.conj() * field) @ turn
        return total

    def spectra(self, places: Array) -> Complex:
        """Return the spectra at places, (n_depths, n_places, n_f)."""
        first = self.parts[0][0]
        total: Complex = np.zeros((len(first), len(places), first.shape[1]), complex)
        for shape, wave in self.parts:
            turn = np.exp(-1j * np.outer(places - self.origin, wave))
            total += shape[:, None] * turn
        return total


def exclude(
    gain: Array, places: Array, known: Sequence[float], near: float | None, reach: float
) -> None:
    """Set the gain (n_depths, n_places) to minus infinity next to presses and far from a place."""
    for place in known:
        gain[:, np.abs(places - place) < CLOSEST] = -np.inf
    if near is not None:
        gain[:, np.abs(places - near) > reach] = -np.inf


def apart(gain: Array, places: Array, number: int, *first: int) -> list[int]:
    """Return the first of places (n,) and those of the highest positive gains, all apart."""
    left, found = gain.copy(), list(first)
    for i in first:
        left[np.abs(places - places[i]) < APART] = -np.inf
    for _ in range(number):
        best = int(np.argmax(left))
        if not left[best] > 0:
            break
        found.append(best)
        left[np.abs(places - places[best]) < APART] = -np.inf
    return found


def separate(
    gain: Array, places: Array, depths: Array, count: int
) -> list[tuple[float, float, float]]:
    """Return gain, place and depth of the highest separate maxima of a gain (n_depths, n_places).

    The gain is changed.
    """
    rows = round(DISTINCT[1] / (depths[1] - depths[0]))
    columns = round(DISTINCT[0] / (places[1] - places[0]))
    found = []
    for _ in range(count):
        i, j = np.unravel_index(int(np.argmax(gain)), gain.shape)
        if not gain[i, j] > 0:
            break
        found.append((float(gain[i, j]), float(places[j]), float(depths[i])))
        gain[max(i - rows, 0) : i + rows + 1, max(j - columns, 0) : j + columns + 1] = -np.inf
    return found


def candidates(found: list[tuple[float, float, float]]) -> Candidates:
    """Return candidates of gains, places and depths, the best first."""
    table = np.array(sorted(found, key=lambda one: -one[0])).reshape(-1, 3)
    return Candidates(table[:, 0], table[:, 1], table[:, 2])


def front_of(
    model: ForwardModel, tools: tuple[int, ...], places: Array, depths: Array, nuisances: Array
) -> list[Front]:
    """Return what each of several presses leaves behind it, multiple reflections left out."""
    base, n = model.base, len(places)
    waves = base.k[:, : model.modes] + nuisances[0] * base.k_by_temperature[:, : model.modes]
    stretch = model.stretch + model.stretch_by_temperature * nuisances[0] + nuisances[5]
    into = np.zeros((len(waves), model.modes), complex)
    into[:, 0] = 1.0
    out, at, found = into.copy(), 0.0, []
    for i in range(n):
        path = np.exp(-1j * waves * (places[i] - at))
        s = model.tables[tools[i]](depths[i : i + 1], np.array([stretch])).value[0]
        into = (s[:, 1, :, 0, :] @ (path * into)[..., None])[..., 0]
        out = ((path * out)[:, None, :] @ s[:, 0, :, 1, :])[:, 0]
        at = float(places[i])
        found.append(Front(at, into, out))
    return found
