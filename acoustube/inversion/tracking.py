"""Tracking of contacts from cycle to cycle: each cycle of a rangefinder updates their posterior.

One :class:`~acoustube.inversion.tracks.Track` is followed. Where it fits the cycles badly, a second
one starts without contacts, and replaces the first if it fits them better.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import ThreadpoolController

from acoustube.base.checks import Flag, Optional, Reals, checked
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.base.types import Array
from acoustube.inversion.cycle import Cycle
from acoustube.inversion.estimate import Contact
from acoustube.inversion.goodness import MISFIT, unexplained
from acoustube.inversion.hypotheses import Builder
from acoustube.inversion.likelihood import weights
from acoustube.inversion.model import NUISANCES, ForwardModel
from acoustube.inversion.motion import Branches, Motion, Update, at_rest
from acoustube.inversion.parameters import split
from acoustube.inversion.posterior import Estimate, in_own_bore, mixture
from acoustube.inversion.proposals import Proposals
from acoustube.inversion.tracks import FAINT, Track
from acoustube.waves.scattering import Complex

PATIENCE, TRIAL = 3, 8
"""Number of badly fitted cycles in a row above which a second track starts, and number of its
cycles above which it is given up."""
BETTER = 5.0
"""Excess of the second track's log likelihood per cycle, a running mean, above which it may replace
the first."""
SAME = 0.05
"""Distance in m within which contacts of two tracks count as the same."""
TOLD = 0.5
"""Least probability of a contact that is returned; less probable ones are tracked too."""


@dataclass(frozen=True, eq=False)
class Tracked:
    """Contacts that the tracker reports after a cycle.

    Attributes
    ----------
    contacts : list of Contact
        Contacts in the order of distance.
    numbers : list of int
        Numbers of the contacts, from 0 in the order of their appearance.
    misfit : float
        Root of the unexplained fraction of the echo's energy; nan without contacts. Unlike that of
        :class:`acoustube.inversion.Inversion`, it may be below the most likely model error.
    temperature, gain : Estimate
        Difference of the air's temperature from the model's in K, and logarithm of the gain
        relative to the model's.
    place : ndarray
        Distances in m whose echoes arrive at the times of the baseband, (n_time,).
    measured, explained : ndarray
        Baseband of the cycle and of the model of the contacts, both less that of the untouched
        tube, in counts, (n_time,).
    """

    contacts: list[Contact]
    numbers: list[int]
    misfit: float
    temperature: Estimate
    gain: Estimate
    place: Array
    measured: Complex
    explained: Complex

    @property
    def fits(self) -> bool:
        """Goodness of fit: true if the misfit is at most :data:`.goodness.MISFIT`, or nan.

        Unlike :class:`acoustube.inversion.Inversion`, the tracker reports no residual.
        """
        return not self.misfit > MISFIT


class ContactTracker:
    """Tracker of the contacts in the cycles of one sensor, one cycle at a time.

    Parameters
    ----------
    model : ForwardModel
    most : int
        Largest number of contacts.
    motion : Motion, optional
        Model of the motion of contacts; with its default values by default.
    cycle_rate : float, optional
        Cycles per second; that of the rangefinder by default.
    """

    @checked(
        model=ForwardModel, most=Number(1, 8, whole=True), motion=Optional(Motion),
        cycle_rate=Optional(Number(1e-3, 1e6, "Hz")),
    )  # fmt: skip
    def __init__(
        self,
        model: ForwardModel,
        most: int = 3,
        motion: Motion | None = None,
        cycle_rate: float | None = None,
    ) -> None:
        self.model, self.most = model, most
        self.motion = motion or Motion()
        self.step = 1 / (cycle_rate or model.base.rangefinder.cycle_rate)
        noise = model.base.noise(1)
        self.proposals = [Proposals(model, i, noise) for i in range(len(model.tables))]
        self.quiet = weights(model, noise, 0.0, None)
        self.threads = ThreadpoolController()  # once: its search for libraries takes milliseconds
        self.n_searches = 0
        self.track = self._new(at_rest(model.priors))
        self.second: Track | None = None

    def _new(self, branches: Branches) -> Track:
        return Track(self.model, self.proposals, self.motion, self.most, branches, self.quiet)

    @checked(
        counts=Reals(ndim=1), elapsed=Optional(Number(1e-9, 1e6, "s")), search=Flag(),
    )  # fmt: skip
    def update(
        self, counts: ArrayLike, elapsed: float | None = None, *, search: bool = True
    ) -> Tracked:
        """Update the posterior of the contacts with one more cycle, and return the contacts.

        Parameters
        ----------
        counts : ndarray
            Counts of the converter in this cycle, (n_samples,).
        elapsed : float, optional
            Time in s since the previous cycle; by default the inverse of the cycle rate.
        search : bool
            Whether contacts that appear or disappear, and other maxima of the likelihood, are
            sought. Without it known contacts are followed, in a fraction of the time; a cycle that
            they do not explain is not used. They are sought in the first cycle anyway.

        Raises
        ------
        ConfigError
            If the cycle has another length than the model's.
        """
        array, base = np.asarray(counts), self.model.base
        if len(array) != base.n_samples:
            raise ConfigError(
                f"a cycle has {len(array)} samples and the model's {base.n_samples}; give cycles "
                "of the sensor that the model describes"
            )
        with self.threads.limit(limits=1, user_api="blas"):  # one thread: small matrices
            samples, noise = base.of_cycles(array[None])
            if not self.n_searches:
                start = Builder(self.model, [], samples, noise).start
                own = self.track.branches
                self.track.branches = self.track.settled = replace(own, mean=start[None])
                search = True  # at first nothing is known that could be followed
            cycle = Cycle(self.n_searches, samples, noise, search)
            found = self._followed(cycle, self.step if elapsed is None else elapsed)
            self.n_searches += search
            return self._told(found, samples)

    def _followed(self, cycle: Cycle, step: float) -> Update:
        """Update the tracks, and return the distribution of the one that fits the cycles better."""
        found = self.track.update(cycle, step)
        if self.second is None:
            if cycle.search and self.track.n_bad > PATIENCE and cycle.number % TRIAL == 0:
                first = 2 * len(self.track.known)
                own = self.track.branches
                branches = at_rest(self.model.priors)
                mean = own.mean[:1, first : own.parameters].copy()
                self.second = self._new(replace(branches, mean=mean))
            return found
        other = self.second.update(cycle, step)
        better = self.second.score > self.track.score + BETTER
        if better and self.second.residual < self.track.residual and self.second.n_searches > 2:
            self._renumber(self.second)
            self.track, self.second = self.second, None
            return other
        if self.second.n_searches > TRIAL:
            self.second = None
        return found

    def _renumber(self, track: Track) -> None:
        """Give contacts of `track` the numbers of the first track's at the same places.

        Those at other places are given new numbers.
        """
        old = self.track.branches.mean[0, : 2 * len(self.track.known) : 2]
        new = track.branches.mean[0, : 2 * len(track.known) : 2]
        free = {one.number: place for one, place in zip(self.track.known, old, strict=True)}
        track.numbers = self.track.numbers
        for one, place in zip(track.known, new, strict=True):
            near = min(free, key=lambda i: abs(free[i] - place), default=None)
            if near is not None and abs(free[near] - place) < SAME:
                one.number = near
                del free[near]
            else:
                one.number, track.numbers = track.numbers, track.numbers + 1
        track.settled_numbers = track.numbered

    def _told(self, found: Update, samples: Complex) -> Tracked:
        """Return the contacts to report after a cycle with baseband `samples`."""
        model, best = self.model, found.branches
        places = split(best.mean[:1, : best.parameters])[0]
        measured = samples - self.track.untouched
        explained = measured - found.rest[0]
        weight = np.exp(best.level)
        weight /= weight.sum()
        m, p = len(best.tools), best.parameters
        covariance = best.covariance[:, :p, :p] + self._lasting(found)
        variance = np.einsum("nii->ni", covariance).copy()
        variance[:, : 2 * m] += model.priors.offsets(m) ** 2

        def told(parameter: int, error: float = 0.0) -> Estimate:
            deviation = np.sqrt(variance[:, parameter] + error**2)
            return mixture(weight, best.mean[:, parameter], deviation)

        contacts, numbers = [], []
        for i, (tool, one) in enumerate(zip(best.tools, self.track.known, strict=True)):
            known = model.tables[tool].tool
            if one.probability < TOLD or best.mean[0, 2 * i + 1] < known.depth[0] + FAINT:
                continue
            depth = best.mean[:, 2 * i + 1]
            slope = known.force_at(depth, 1) * np.sqrt(variance[:, 2 * i + 1])
            own = model.priors.force_deviation(known, depth)
            force = mixture(weight, known.force_at(depth), np.hypot(slope, own))
            distance = told(2 * i, self.model.scale_error(places[0, i]))
            own_depth = in_own_bore(
                best.mean[:, [2 * i + 1, p - 1]], variance[:, [2 * i + 1, p - 1]],
                covariance[:, 2 * i + 1, p - 1],
            )  # fmt: skip
            told_depth = mixture(weight, *own_depth)
            contacts.append(Contact(one.probability, distance, told_depth, force, tool))
            numbers.append(one.number)
        first = 2 * m
        base, misfit = model.base, np.nan
        if contacts:
            rest = self.quiet(found.rest[0])
            misfit = unexplained(rest, self.quiet(explained), base.freedom)
        return Tracked(
            contacts, numbers, misfit, told(first), told(first + NUISANCES.index("gain")),
            base.places, measured, explained,
        )  # fmt: skip

    def _lasting(self, found: Update) -> Array:
        """Return the parameters' covariance due to errors that are the same in all cycles.

        Shape (n, n_parameters, n_parameters). Noise averages out over cycles. The errors of model
        and clutter, and rounding without dither, which are also part of the weights, do not. With
        the Fisher information I of a cycle, they leave the covariance I^-1 (I - N) I^-1, where N is
        the covariance of the score that is due to noise alone.
        """
        noise = self.model.base.noise(1) - self.model.base.rounding
        p = found.branches.parameters
        prior = np.zeros(p)
        prior[p - len(NUISANCES) :] = 1 / self.model.priors.deviations**2
        whole = np.linalg.inv(found.information + np.diag(prior + 1e-9))
        back = self.track.whiten.adjoint(found.slopes)
        power = (back @ back.conj().swapaxes(1, 2)).real
        own = found.information - 2 / self.model.base.freedom * noise * power
        covariance = np.asarray(whole @ own @ whole)
        diagonal = np.einsum("nii->ni", covariance)
        diagonal[:] = np.maximum(diagonal, 0.0)
        return covariance
