"""Candidates for one more press: correlation of the residual with a tool's echoes (templates)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acoustube.base.types import Array
from acoustube.inversion.baseband import Baseband
from acoustube.inversion.model import ForwardModel
from acoustube.inversion.parameters import CLOSEST
from acoustube.inversion.paths import Path, stretches
from acoustube.inversion.whitening import Weights
from acoustube.waves.scattering import Complex

COARSE, FINE, AROUND = 3e-3, 0.5e-3, 12e-3
"""Coarse and fine steps of place in m, and half length of the range about a known place, by which
the fine steps may also leave the range of a search: the phase of an echo decides its place."""
DEPTH_STEP = 0.125e-3
"""Step in m between the depths of templates."""
NODES, NODES_BEHIND = 0.05, 0.01
"""Spacing in m of the places at which the energies of templates are computed: where only the plane
mode travels, and where several modes do, which beat over 2 cm, as behind a press."""
APART = 0.03
"""Least distance in m between coarse places that are kept, and usual reach of the fine steps to
both sides of each: what a kept place excludes is thus searched in fine steps."""
DISTINCT = 1.5e-3, 0.5e-3
"""Differences of place and of depth in m: two maxima near a place are separate if one of the two
differences is larger."""
KEPT = 40
"""Number of places whose reflection matrices are cached."""
CHUNK = 6
"""Largest number of places whose templates are computed at once: some MB, which fit a cache."""
BEFORE, LASTING = 1e-3, 5e-3
"""Times in s before the arrival of a template, and after the end of the drive in it, between which
its energy is computed. Within `LASTING`, the power of sound that is trapped under a press decays by
a factor of 1000. Modes near their cut-on arrive later, with up to 6 % of the energy 0.6 m behind
a press. The spectra are computed at so few frequencies (:meth:`.Baseband.every`) that later sound
may be aliased to the start of an echo."""
FAINTEST = 1e-9
"""Floor of the energies of templates at a place, relative to the highest of them, below which they
are rounding errors."""


class Front(NamedTuple):
    """Waves transmitted in both directions by the presses before a place.

    Attributes
    ----------
    place : float
        Distance in m of the last of these presses from the face.
    into, out : ndarray
        Amplitudes of the modes behind that press for a unit plane wave from the face, and of the
        plane wave at the face for unit amplitudes of these modes, both (n_f, m).
    """

    place: float
    into: Complex
    out: Complex


class Candidates(NamedTuple):
    """Candidates for a press, the best first; all (n,).

    Attributes
    ----------
    gain : ndarray
        Expected decrease of the cost, which is minus twice the log likelihood.
    place, depth : ndarray
        Place and depth in m.
    """

    gain: Array
    place: Array
    depth: Array


class Templates:
    """Templates: the echoes of a tool at all depths, with which a residual is correlated.

    Parameters
    ----------
    model : ForwardModel
    tool : int
        Index of the tool in the library.
    step : float
        Step in m between the depths of the templates.
    """

    def __init__(self, model: ForwardModel, tool: int, step: float = DEPTH_STEP) -> None:
        self.model = model
        table = model.tables[tool]
        low, high = table.range
        self.depths = np.linspace(low, high, max(4, round((high - low) / step) + 1))
        stretch = np.full(len(self.depths), model.stretch)
        self.whole = table(self.depths, stretch)
        low, high = model.span
        self.places = np.arange(low, high, COARSE)
        self._reflections: dict[float, Complex] = {}

    def search(
        self,
        residual: Complex,
        whiten: Weights,
        fronts: list[Front],
        *,
        number: int = 6,
        fine: int = 9,
        reach: float = APART,
        within: tuple[float, float] | None = None,
        least: float = 0.0,
        temperature: float = 0.0,
    ) -> Candidates:
        """Return candidates for one more press.

        Parameters
        ----------
        residual : ndarray
            Residual in the baseband, in counts, (n_time,).
        whiten : Weights
        fronts : list of Front
            Transmitted waves behind each press already found, in the order of place.
        number, fine : int
            Largest number of places that are kept, and of candidates at each.
        reach : float
            Reach in m of the fine steps to both sides of a kept place.
        within : (float, float), optional
            Range of places in m to which the coarse search is limited; the fine steps leave it by
            up to :data:`AROUND`.
        least : float
            Candidates are returned only if the best expected decrease of the cost exceeds this.
        temperature : float
            Deviation of the temperature in K.
        """
        base = self.model.base
        field = base.adjoint(whiten.weighted(residual))
        coarse = np.full((len(self.depths), len(self.places)), -np.inf)
        sought = within_range(self.places, within)
        zones, starts = self._zones(fronts, temperature, field)
        owner = np.searchsorted(starts, self.places, side="right") - 1
        for number_of_zone, zone in enumerate(zones):
            here = sought & (owner == number_of_zone)
            if here.any():
                zone.set_energy(base, whiten, self.places[here], reach)
                level = np.abs(zone.correlation(self.places[here]))
                coarse[:, here] = 2 * (2 * level - zone.energy_at(self.places[here]))
        known = [front.place for front in fronts]
        exclude(coarse, self.places, known, sought)
        found: list[tuple[float, float, float]] = []
        if coarse.max() > least:
            for best in apart(coarse.max(axis=0), self.places, number):
                places = self.places[best] + np.arange(-reach, reach + 1e-9, FINE)
                found += self._refined(zones[owner[best]], places, known, within, fine)
        return candidates(found)

    def _refined(
        self,
        zone: _Zone,
        places: Array,
        known: list[float],
        within: tuple[float, float] | None,
        count: int,
    ) -> list[tuple[float, float, float]]:
        """Return gain, place and depth of the highest separate maxima of the gain at places.

        Unlike in the coarse search, the phase of the echo has to agree. `known` are the places of
        presses already found.
        """
        gain = 2 * (2 * zone.correlation(places).real - zone.energy_at(places))
        low, high = within or self.model.span
        exclude(gain, places, known, within_range(places, (low - AROUND, high + AROUND)))
        return separate(gain, places, self.depths, count)

    def _zones(
        self, fronts: list[Front], temperature: float, field: Complex
    ) -> tuple[list[_Zone], Array]:
        """Return templates for each part of the tube: before, between and behind presses.

        The starts of the parts in m are returned too. Where the matrices of presses vary along the
        tube, it is divided into more parts.
        """
        path, gain = self.model.path, self.model.base.gain
        before = [at_face(self.model, temperature), *fronts]
        low, high = self.model.span
        places = stretches(path, min(low, 0.0), high, [front.place for front in fronts])
        found = []
        for (start, number), (stop, _) in zip(places, [*places[1:], (high, 0)], strict=True):
            front, reflection = before[number], self._reflection(0.5 * (start + stop))
            parts: list[tuple[Complex, int, int]] = []
            for a, b in itertools.combinations_with_replacement(range(path.modes), 2):
                both = gain * front.out[:, a] * front.into[:, b]
                other = gain * front.out[:, b] * front.into[:, a]
                if b and not (np.any(both) or np.any(other)):  # at least one part
                    continue
                shape = both.astype(np.complex64) * reflection[a, b]
                if a != b:
                    shape += other.astype(np.complex64) * reflection[b, a]
                parts.append((shape, a, b))
            found.append(_Zone(parts, path, front, temperature, field))
        return found, np.array([start for start, _ in places])

    def _reflection(self, place: float) -> Complex:
        """Return reflection matrices of all depths at a place, (m, m, n_depths, n_f)."""
        path = self.model.path
        place = place if path.converts else 0.0
        if place not in self._reflections:
            if len(self._reflections) >= KEPT:
                self._reflections.clear()
            at = np.full(len(self.depths), place)
            joined = path.joined(self.whole, at, np.zeros(len(at)))
            matrices = joined.value[:, :, 0, :, 0, :].astype(np.complex64)
            self._reflections[place] = np.ascontiguousarray(np.moveaxis(matrices, (2, 3), (0, 1)))
        return self._reflections[place]


class _Zone:
    """Templates for one part of the tube: sums of spectra, each with one mode there and one back.

    Parameters
    ----------
    parts : list of (ndarray, int, int)
        Spectra at the origin for all depths in single precision, (n_depths, n_f), and the indices
        of the modes in which they travel to the press and back.
    path : Path
    front : Front
        Waves at the origin: the last press before this part of the tube, or the face.
    warmer : float
        Deviation of the temperature in K.
    field : ndarray
        Spectrum with which the templates are correlated, (n_f,).
    """

    def __init__(
        self, parts: list[tuple[Complex, int, int]], path: Path, front: Front, warmer: float,
        field: Complex,
    ) -> None:  # fmt: skip
        self.path, self.origin, self.warmer, self.field = path, front.place, warmer, field
        self.shapes = np.stack([shape for shape, _, _ in parts], axis=1)
        self.there, self.back = (np.array([part[i] for part in parts]) for i in (1, 2))
        self.n_modes = 1 + int(self.back.max())
        self.nodes, self.level = np.zeros(0), np.zeros((0, 0))

    def set_energy(self, base: Baseband, whiten: Weights, places: Array, reach: float) -> None:
        """Compute the energies of templates at evenly spaced nodes that cover places.

        Nodes begin at the origin at the nearest.

        Parameters
        ----------
        base : Baseband
        whiten : Weights
        places : ndarray
            Distances from the face in m, rising, (n_places,).
        reach : float
            Distance in m from the places up to which energies are needed.
        """
        from acoustube.inversion.sample_sums import propagated  # imports Numba

        step = NODES_BEHIND if len(self.there) > 1 else NODES
        low, high = places[0] - reach - step, places[-1] + reach + 2 * step
        self.nodes = np.arange(max(low, self.origin), high, step)
        ranges = base.echo_ranges(self.nodes, BEFORE, LASTING, whiten.n_samples)
        every = base.every(BEFORE + base.rangefinder.drive.duration + LASTING)
        modes = np.ascontiguousarray(self._modes(self.nodes)[..., ::every])
        parts = self.shapes.real[..., ::every].copy(), self.shapes.imag[..., ::every].copy()
        energy = np.empty((len(self.nodes), len(self.shapes)), np.float32)
        for some in np.array_split(np.arange(len(self.nodes)), 1 + len(self.nodes) // CHUNK):
            spectra = propagated(*parts, self.there, self.back, modes[some])
            energy[some] = whiten.energies(base.transformed(spectra), ranges[some])
        least = FAINTEST * energy.max(axis=1, keepdims=True)
        self.level = np.log(np.maximum(np.maximum(energy, least), 1e-30).T)

    def energy_at(self, places: Array) -> Array:
        """Return energies (n_depths, n_places) at places; their logarithms are interpolated."""
        share = np.clip((places - self.nodes[0]) / (self.nodes[1] - self.nodes[0]), 0, None)
        i = np.minimum(share.astype(int), len(self.nodes) - 2)
        share = np.clip(share - i, 0, 1)
        return np.asarray(np.exp((1 - share) * self.level[:, i] + share * self.level[:, i + 1]))

    @cached_property
    def _filters(self) -> Complex:
        """Spectra at the origin times the conjugate of the field, (n_depths, n_parts n_f)."""
        products = self.shapes * self.field.conj().astype(np.complex64)
        return np.asarray(products.reshape(len(products), -1))

    def correlation(self, places: Array) -> Complex:
        """Return correlations of the templates with the field, (n_depths, n_places).

        The places in m are evenly spaced, (n_places,).
        """
        modes = self._modes(places)
        factors = modes[:, self.there] * modes[:, self.back]
        return np.asarray((self._filters @ factors.reshape(len(places), -1).T).conj())

    def _modes(self, places: Array) -> Complex:
        """Return the modes' factors from the origin to evenly spaced places.

        Their shape is (n_places, n_modes, n_f).
        """
        return self.path.propagated(self.origin, places, self.warmer, self.n_modes)


def around(place: float) -> tuple[float, float]:
    """Return the range in m, about a place, in which the gain is sought in coarse steps."""
    return place - AROUND, place + AROUND


def within_range(places: Array, limits: tuple[float, float] | None) -> NDArray[np.bool_]:
    """Return the mask of places (n,) within limits, both included; without limits, of all."""
    low, high = limits or (-np.inf, np.inf)
    return np.asarray((places >= low) & (places <= high))


def exclude(gain: Array, places: Array, known: Sequence[float], sought: NDArray[np.bool_]) -> None:
    """Set gains (n_depths, n_places), in place, to -inf near known presses and where not sought."""
    for place in known:
        gain[:, np.abs(places - place) < CLOSEST] = -np.inf
    gain[:, ~sought] = -np.inf


def apart(gain: Array, places: Array, number: int) -> list[int]:
    """Return the indices of the highest positive gains (n,), at least :data:`APART` apart."""
    left, found = gain.copy(), list[int]()
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

    Depths and places are evenly spaced. The array of gains is overwritten.
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
    """Return candidates from tuples of gain, place and depth, the best first, each once."""
    once = {(round(z, 6), depth): (gain, z, depth) for gain, z, depth in sorted(found)}
    table = np.array(sorted(once.values(), key=lambda one: -one[0])).reshape(-1, 3)
    return Candidates(table[:, 0], table[:, 1], table[:, 2])


def at_face(model: ForwardModel, temperature: float) -> Front:
    """Return the front of a tube without a press: the plane wave from the face, in path modes.

    Its `place` is the face or, in a wrapped tube, minus infinity: the modes begin at the wrap.
    """
    entry = model.path.entry(np.array([temperature]))
    if entry is None:
        plane = np.zeros((len(model.base.frequency), model.path.modes), complex)
        plane[:, 0] = 1.0
        return Front(0.0, plane, plane)
    return Front(-np.inf, entry.matrix[0, :, :, 0], entry.matrix[0, :, :, 0])


def front_of(
    model: ForwardModel, tools: tuple[int, ...], places: Array, depths: Array, nuisances: Array
) -> list[Front]:
    """Return the waves behind each of several presses, without multiple reflections.

    Places and depths are in m, (n_presses,), and nuisances (7,).
    """
    path, warm = model.path, nuisances[:1]
    stretch = model.stretches_of(nuisances[None])
    _, into, out = at_face(model, float(warm[0]))
    found = []
    for i, section in enumerate(path.sections(places[None], warm)):
        s = model.tables[tools[i]](depths[i : i + 1], stretch)
        s = path.joined(s, places[i : i + 1], warm).value[0]
        along = section.factor[0]
        into = (s[:, 1, :, 0, :] @ (along * into)[..., None])[..., 0]
        out = ((along * out)[:, None, :] @ s[:, 0, :, 1, :])[:, 0]
        found.append(Front(float(places[i]), into, out))
    return found
