"""Candidates for a new contact in one cycle.

First a matched filter for the plane wave alone is applied, in some milliseconds. It is that of
:mod:`acoustube.inversion.search`, but the quantities that do not depend on the cycle are computed
beforehand: the phase factors of the places, and the energies of the echoes whitened with the noise
of an untouched tube. If this filter detects an echo, the search with all modes follows: behind a
contact, and in bends, sound arrives by several modes, whose apparent places are centimetres apart.
"""

from __future__ import annotations

import numpy as np

from acoustube.base.types import Array
from acoustube.inversion.likelihood import weights
from acoustube.inversion.model import ForwardModel
from acoustube.inversion.paths import stretches
from acoustube.inversion.search import (
    AROUND,
    Candidates,
    Front,
    Templates,
    at_face,
    candidates,
    exclude,
    within_range,
)
from acoustube.inversion.tables import Matrices
from acoustube.inversion.whitening import Weights
from acoustube.waves.scattering import Complex

PLACE_STEP, DEPTH_STEP = 3e-3, 0.25e-3
"""Steps of place and depth in m in the search with the plane wave. The step of depth is also that
of the search with all modes."""
NODES = 0.15
"""Spacing in m of the places at which the energies of echoes are computed."""
WORTH, MORE_PLACES = 40.0, 2
"""Least expected decrease of the cost, with the plane wave alone, at which all modes are tried; and
number of places that the search with all modes keeps beyond the number requested."""
SMOOTHED = 0.4e-3
"""Time in s over which the samples' inverse variance is averaged: the length of an echo."""


class PlaneFilter:
    """Matched filter for the plane-wave echoes of a tool.

    Parameters
    ----------
    model : ForwardModel
    tool : int
        Index of the tool in the library.
    noise : float
        Typical variance of a baseband sample of a cycle, in counts squared.
    """

    def __init__(self, model: ForwardModel, tool: int, noise: float) -> None:
        self.model, base = model, model.base
        table = model.tables[tool]
        low, high = table.range
        depths = np.linspace(low, high, max(4, round((high - low) / DEPTH_STEP) + 1))
        matrices = table(depths, np.full(len(depths), model.stretch))
        low, high = model.span
        self.places = np.arange(low, high, PLACE_STEP)
        starts = np.array([start for start, _ in stretches(model.path, low, high, [])])
        face = at_face(model, 0.0)
        self.entered = face.out[:, 0] * face.into[:, 0]
        shapes = [
            base.gain * self.entered * _reflection(model, matrices, place)
            for place in np.append((starts[1:] + starts[:-1]) / 2, (starts[-1] + high) / 2)
        ]
        self.zone = np.searchsorted(starts, self.places, side="right") - 1
        self.shapes = np.conj(shapes).astype(np.complex64)
        self.turns = np.exp(2j * self._phases(self.places).conj().T).astype(np.complex64)
        quiet = weights(model, noise, 0.0, None)
        self.quiet = quiet.sample_precision
        nodes = np.arange(low, high + NODES, NODES)
        zones = np.searchsorted(starts, nodes, side="right") - 1
        turned = np.exp(-2j * self._phases(nodes))
        spectra = np.stack([shapes[zone] * one for zone, one in zip(zones, turned, strict=True)], 1)
        # Mean over two phases of the echo: the energy depends on the phase in folded basebands.
        power = [np.abs(quiet(base.transformed(turn * spectra))) ** 2 for turn in (1, 1j)]
        level = np.log(np.maximum(np.sum(power, axis=(0, -1)) / 2, 1e-300))
        share = np.interp(self.places, nodes, np.arange(len(nodes)))
        i = np.minimum(share.astype(int), len(nodes) - 2)
        share = share - i
        self.energy = np.exp((1 - share) * level[:, i] + share * level[:, i + 1])
        self.delay = base.rangefinder.lead + base.rangefinder.drive.duration / 2

    def highest(
        self,
        rest: Complex,
        whiten: Weights,
        fronts: list[Front],
        within: tuple[float, float] | None = None,
    ) -> float:
        """Return the largest expected decrease of the cost by one more contact.

        The cost is minus twice the log likelihood. The result is minus infinity if no place remains
        to be searched.

        Parameters
        ----------
        rest : ndarray
            Residual in the baseband, in counts, (n_time,).
        whiten : Weights
        fronts : list of Front
            Waves transmitted by the known contacts, in the order of place.
        within : (float, float), optional
            Range of places in m to which the search is limited.
        """
        base = self.model.base
        field = base.adjoint(whiten.weighted(rest))
        energy = self.energy * self._dimmed(whiten)
        gain = np.empty(energy.shape)
        fields, ends, scales = [field], [0.0], [1.0]
        for front in fronts:
            # Two-way transmission through the contacts, without the phase of the path up to there,
            # which is part of `turns`, and without the entry, which is part of `shapes`.
            passed = front.out[:, 0] * front.into[:, 0] / self.entered
            passed = passed * np.exp(2j * self._phases(np.array([front.place]), behind=True)[0])
            fields.append(passed.conj() * field)
            scales.append(float(np.median(np.abs(passed)) ** 2))
            ends.append(front.place)
        owner = np.searchsorted(ends[1:], self.places)
        searched = within_range(self.places, within)
        for i, j in np.unique(np.stack([owner, self.zone])[:, searched], axis=1).T:
            here = searched & (owner == i) & (self.zone == j)
            filters = (self.shapes[j] * fields[i]).astype(np.complex64)
            level = np.abs(filters @ self.turns[:, here])
            energy[:, here] *= scales[i]
            gain[:, here] = 2 * (2 * level - energy[:, here])
        exclude(gain, self.places, ends[1:], searched)
        return float(gain.max())

    def _phases(self, places: Array, *, behind: bool = False) -> Complex:
        """Return the plane wave's one-way phases in rad, complex with losses, (n, n_f).

        They end at the front of presses at places (n,) in m or, if `behind` is true, at their back.
        """
        return self.model.path.phases(places, 0.0, behind=behind)[..., 0]

    def _dimmed(self, whiten: Weights) -> Array:
        """Return the inverse variance of samples in the echo of each place, (n_places,).

        It is divided by the inverse variance without contacts, and averaged over :data:`SMOOTHED`.
        """
        base = self.model.base
        ratio = whiten.sample_precision / self.quiet
        width = max(1, round(SMOOTHED / base.interval))
        smooth = np.convolve(ratio, np.ones(width) / width, "same")
        return np.interp(2 * self.places / base.speed + self.delay, base.window, smooth)


class Proposals:
    """Search for contacts of a tool, with all modes where the plane wave alone detects an echo.

    Parameters
    ----------
    model, tool, noise
        See :class:`PlaneFilter`.
    """

    def __init__(self, model: ForwardModel, tool: int, noise: float) -> None:
        self.model = model
        self.plane = PlaneFilter(model, tool, noise)
        self.modal = Templates(model, tool, DEPTH_STEP)

    def search(
        self,
        rest: Complex,
        whiten: Weights,
        fronts: list[Front],
        *,
        number: int = 2,
        fine: int = 3,
        within: tuple[float, float] | None = None,
        temperature: float = 0.0,
    ) -> Candidates:
        """Return candidates for one more contact; none if the plane wave gains less than `WORTH`.

        Parameters
        ----------
        rest, whiten, fronts, within
            See :meth:`PlaneFilter.highest`.
        number, fine : int
            Largest number of places, to which :data:`MORE_PLACES` is added, and of candidates at
            each place.
        temperature : float
            Deviation of the temperature in K.
        """
        if self.plane.highest(rest, whiten, fronts, within) < WORTH:
            return candidates([])
        # Few candidates are kept in a cycle: only those next to the best places are sought.
        return self.modal.search(
            rest, whiten, fronts, number=number + MORE_PLACES, fine=fine, reach=AROUND,
            within=within, temperature=temperature,
        )  # fmt: skip


def _reflection(model: ForwardModel, matrices: Matrices, place: float) -> Complex:
    """Return the plane wave's reflection by presses of all depths at a place, (n_depths, n_f)."""
    at = np.full(len(matrices.value), place)
    return model.path.joined(matrices, at, np.zeros(len(at))).value[:, :, 0, 0, 0, 0]
