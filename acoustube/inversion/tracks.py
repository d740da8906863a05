"""One hypothesis about the cycles so far, updated by each cycle: contacts appear and disappear.

The distribution is a mixture of normal distributions, the branches, over one set of contacts
(:mod:`acoustube.inversion.motion`). A contact is added where the matched filter detects one in the
residual of a cycle, or in the mean residual of several, and the evidence rises. It is removed where
the cycles are as likely without it.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace

import numpy as np

from acoustube.inversion.births import (
    NEW_CONTACT,
    candidates,
    fronts_of,
    in_place_of,
    new_deviations,
    rank_of,
    uniform,
    with_shifts,
)
from acoustube.inversion.cycle import Cycle, Known
from acoustube.inversion.fewer import UNUSUAL, log_ratio, one_for_two, refitted, restarted
from acoustube.inversion.goodness import MISFIT, unexplained
from acoustube.inversion.likelihood import Echo, echo_from, weights
from acoustube.inversion.model import ForwardModel
from acoustube.inversion.motion import LOST, Branches, Motion, Update, likely, predicted, updated
from acoustube.inversion.parameters import bounded, split
from acoustube.inversion.proposals import Proposals
from acoustube.inversion.search import around
from acoustube.inversion.whitening import Weights, mean_square
from acoustube.waves.scattering import Complex

BRANCHES, YOUNG_BRANCHES = 2, 5
"""Largest number of branches, usually and while a contact is young."""
UNLIKELY = -12.0
"""Logarithm of the odds, relative to the best branch, below which a branch is dropped."""
FORGET = 0.95
"""Factor per cycle of the logarithms of the branches' odds, since errors of the model persist."""
MEAN = 8
"""Number of cycles in whose mean residual weak contacts are sought."""
NEAR, NEAR_CONTACTS = 3, 2
"""Number of candidates in the search for a contact near its place, and number of contacts that are
sought again in a cycle."""
SURE, GONE = 12.0, -2.0
"""Upper limit of a contact's log odds, and value at or below which the contact is removed."""
FAINT, FAINT_TESTS = 0.1e-3, 3
"""Depth in m above the library's least depth up to which a contact is not detectable, and number of
tests in a row after which such a contact is removed."""
NEW = 2, 4, 7
"""Ages in cycles of a contact at which contacts are sought again near their places."""
YOUNG, OFTEN, SELDOM, RARELY = 15, 2, 6, 12
"""Age in cycles below which a contact is young. Numbers of cycles between searches: `OFTEN` for
other maxima while a contact is young or the fit is bad, `RARELY` for other maxima at other times,
and `SELDOM` for weak contacts."""
TESTED = 4
"""Number of a contact's turns in the tests of its odds of which one is used, if it is sure and not
faint, no contact is young, and the fit is good."""
MERGED = 3
"""Cycles between tests of whether a recently found contact and its neighbour are one contact."""
LOUD = 3.0
"""Smoothed level of the whitened residual above which a new contact is sought at once."""
SETTLED, UNSETTLED = 1.0, 1.0
"""Mean square of the whitened residual below which contacts are settled (0.75 in the median where
fits of a simulated stream are right), and time in s after which this state is no longer used."""
BAD = 3.0
"""Mean square of the whitened residual above which a fit is bad. A fit is also bad if its misfit
exceeds `MISFIT`."""
ADAPTED, RISE = 0.2, 1.5
"""Weight of a cycle's squared misfit in the running mean square of the model's error, and cap on
this misfit relative to that error, so that an undetected contact's echo hardly raises the mean."""
ERROR, ERRORS = 0.03, (0.003, 0.4)
"""Initial relative error of the model, and its range."""
SPREAD, BENT_SPREAD = 5e-4, 6e-3
"""Error of the model, equal at all times, relative to the highest echo: straight, wrapped tube."""
SHIFTS = ((-1, 0.0), (0, -0.3e-3), (1, 0.0), (0, 0.3e-3))
"""Shifts of place in half wavelengths and of depth in m by which other maxima are sought: in turn
the two of place and the two of depth. Shifts of place are also applied to all contacts together."""
RESTARTED = -3.0
"""Logarithm of the prior odds that a contact has left its predicted place or depth in a jump."""


class Track:
    """Hypothesis about the contacts in the cycles so far.

    Parameters
    ----------
    model : ForwardModel
    proposals : list of Proposals
        One for each tool.
    motion : Motion
    most : int
        Largest number of contacts.
    branches : Branches
        Distribution before the first cycle, without contacts.
    quiet : Weights
        Weights of a cycle without contacts.
    """

    def __init__(
        self,
        model: ForwardModel,
        proposals: list[Proposals],
        motion: Motion,
        most: int,
        branches: Branches,
        quiet: Weights,
    ) -> None:
        self.model, self.proposals, self.motion, self.most = model, proposals, motion, most
        self.branches, self.settled, self.quiet = branches, branches, quiet
        self.known: list[Known] = []
        self.settled_numbers, self.unsettled = list[int](), 0.0
        self.echo: Echo | None = None
        self.error, self.residual, self.score = ERROR, 1.0, 0.0
        self.n_searches, self.n_bad, self.n_shifts, self.numbers = 0, 0, 0, 0
        self.rests: deque[Complex] = deque(maxlen=MEAN)
        self.whiten, self.untouched = quiet, np.zeros(0, complex)
        self.spread = BENT_SPREAD if model.path.converts else SPREAD

    def update(self, cycle: Cycle, step: float) -> Update:
        """Update the distribution with a cycle, `step` seconds after the previous; return it."""
        error = self.error if self.known else 0.0
        self.whiten = weights(self.model, cycle.noise, error, self.echo, self.spread)
        prior = predicted(self.branches, self.motion, self.model.priors, step)
        self.unsettled += step
        if self.settled is self.branches or self.unsettled >= UNSETTLED:
            self.settled = prior
        else:
            self.settled = predicted(self.settled, self.motion, self.model.priors, step)
        found = self._pruned(self._updated(prior, cycle.samples, forget=FORGET))
        if cycle.search:
            found = self._searched(prior, found, cycle)
        elif self._bad(found) and self.n_bad < YOUNG:  # otherwise the model itself fits badly
            return self._unused(prior, cycle)
        else:
            self.rests.append(found.rest[0])
        self.branches = found.branches
        fits = self._mean_square(found) < SETTLED and self.misfit(found) <= MISFIT
        if fits or self.numbered != self.settled_numbers:
            self.settled, self.settled_numbers, self.unsettled = found.branches, self.numbered, 0.0
        self._keep_echo(found, cycle)
        return found

    def _unused(self, prior: Branches, cycle: Cycle) -> Update:
        """Return the best branch as predicted: an echo of an unknown contact would mislead it."""
        mean, p = prior.mean.copy(), prior.parameters
        mean[:, :p] = bounded(self.model, prior.tools, mean[:, :p])
        self.branches = replace(prior, mean=mean)
        best = self.branches.take(np.zeros(1, int))
        return replace(self._updated(best, cycle.samples, iterations=0), branches=best)

    @property
    def numbered(self) -> list[int]:
        """Numbers of the known contacts, in their order along the tube."""
        return [one.number for one in self.known]

    def _searched(self, prior: Branches, found: Update, cycle: Cycle) -> Update:
        """Return the branches after the tests and searches that are due in a cycle."""
        new = any(one.age in NEW for one in self.known) or (self._young() and self._loud(found))
        if self.known and (new or self._bad(found)):
            found = self._sought_near(prior, found, cycle)
        if cycle.number % MERGED == 0:
            found = self._merged(found, cycle)
        self._judge(found)
        found = self._without_gone(found, cycle)
        self.rests.append(found.rest[0])
        found = self._explored(prior, found, cycle)
        self.n_searches += 1
        for one in self.known:
            one.age += 1
        return found

    def _updated(
        self,
        prior: Branches,
        samples: Complex,
        iterations: int = 3,
        forget: float = 1.0,
        whiten: Weights | None = None,
    ) -> Update:
        whiten = whiten or self.whiten
        return updated(self.model, prior, samples, whiten, iterations=iterations, forget=forget)

    def _young(self) -> bool:
        return any(one.age < YOUNG for one in self.known)

    def _judge(self, found: Update) -> None:
        """Adapt the error of the model to the residual, and count badly fitted cycles in a row."""
        self.n_bad = self.n_bad + 1 if self._bad(found) else 0
        misfit = self.misfit(found)
        if self.known:
            squared = (1 - ADAPTED) * self.error**2 + ADAPTED * min(misfit, RISE * self.error) ** 2
            self.error = float(np.clip(np.sqrt(squared), *ERRORS))
        self.residual = self._mean_square(found)
        likelihood = float(found.evidence[0]) - self.whiten.log_determinant
        self.score = likelihood if not self.n_searches else 0.7 * self.score + 0.3 * likelihood

    def _mean_square(self, found: Update) -> float:
        return mean_square(self.whiten(found.rest[0]), self.model.base.freedom)

    def _bad(self, found: Update) -> bool:
        return self._mean_square(found) > BAD or self.misfit(found) > MISFIT

    def misfit(self, found: Update) -> float:
        """Return the root of the residual's energy beyond that of noise and clutter.

        It is relative to the root of the energy of the contacts' echo in the previous cycle, and 0
        without an echo.
        """
        if self.echo is None:
            return 0.0
        rest, echo = self.quiet(np.stack([found.rest[0], self.echo.value]))
        return unexplained(rest, echo, self.model.base.freedom)

    def _keep_echo(self, found: Update, cycle: Cycle) -> None:
        """Store the echo of the contacts for the weights of the next cycle."""
        own = self.branches.mean[:1, 2 * len(self.known) : self.branches.parameters]
        self.untouched = self.model.without_presses(own)[0]
        explained = cycle.samples - found.rest[0]
        self.echo = echo_from(self.model, explained - self.untouched) if self.known else None

    def _explored(self, prior: Branches, found: Update, cycle: Cycle) -> Update:
        """Return the branches after a search for new contacts or other maxima, if one is due."""
        turn, room = cycle.number, len(self.known) < self.most
        if room and self._loud(found) and (not self.known or self.n_bad or turn % 2 == 0):
            return self._born(found, cycle)
        if room and turn % SELDOM == 3:
            return self._born(found, cycle, weak=True)
        same = found.branches.tools == prior.tools
        often = OFTEN if self._young() or self.n_bad else RARELY
        if self.known and same and turn % often == 1:
            return self._shifted(prior, found, cycle)
        return found

    def _loud(self, found: Update) -> bool:
        power = np.abs(self.whiten(found.rest[0])) ** 2
        return bool(np.sqrt(np.convolve(power, np.ones(4) / 4, "same").max()) > LOUD)

    def _born(self, found: Update, cycle: Cycle, *, weak: bool = False) -> Update:
        """Return the branches with one more contact, if the evidence for it suffices.

        A contact in front of others changes their echoes, and they have been fitted to some cycles
        without it. It is therefore also sought with the others as predicted from the last cycle in
        which they were settled. A weak contact is sought in the mean residual of the last cycles.
        """
        branches, whiten = found.branches.take(np.arange(1)), self.whiten
        rest, samples, known = found.rest[0], cycle.samples, [branches]
        if weak:
            error = self.error if self.known else 0.0
            rest = np.mean(self.rests, axis=0)
            whiten = weights(
                self.model, cycle.noise / len(self.rests), error, self.echo, self.spread
            )
            samples = cycle.samples - found.rest[0] + rest
        elif self.settled_numbers == self.numbered:
            known.append(self.settled.take(np.arange(1)))
        plain = float(np.sum(np.abs(whiten(rest)) ** 2))
        tried = []
        for fewer in known:
            if fewer is not branches:
                parts = split(fewer.mean[:, : fewer.parameters])
                rest = samples - self.model.baseband(fewer.tools, *parts)[0][0]
            starts = candidates(self.proposals, self.motion, fewer, rest, whiten)
            tried += [(self._updated(one, samples, 5, whiten=whiten), fewer) for one in starts]
        if not tried:
            return found
        best, fewer = max(tried, key=lambda one: float(one[0].evidence[0]))
        rank = rank_of(fewer, best.branches)
        best = with_shifts(self.model, self.motion, fewer, best, rank, samples, whiten)
        log_odds = float(best.evidence[0]) + plain - NEW_CONTACT
        log_odds -= uniform(self.model, best.branches.tools[rank])
        if log_odds < 0:
            return found
        young = [i for i, one in enumerate(self.known) if i >= rank and one.age < YOUNG]
        best, gone = in_place_of(self.model, self.motion, fewer, young, best, rank, samples, whiten)
        if gone is not None:
            del self.known[gone]
        for one in self.known:  # the new contact changes their echoes
            one.age = min(one.age, NEW[-1] + 1)
        self.known.insert(rank, Known(self.numbers, min(log_odds, SURE)))
        self.numbers += 1
        self.rests.clear()
        self.error = ERROR
        best = self._pruned(best)
        return replace(best, rest=best.rest + (cycle.samples - samples))

    def _sought_near(self, prior: Branches, found: Update, cycle: Cycle) -> Update:
        """Search for contacts again near their places, at all depths, and return all branches."""
        # The youngest first; contacts of equal age take turns.
        order = sorted(
            range(len(prior.tools)),
            key=lambda i: (min(self.known[i].age, YOUNG), (i + cycle.number) % len(prior.tools)),
        )
        for i in order[:NEAR_CONTACTS]:
            tool = prior.tools[i]
            best = found.branches.take(np.arange(1))
            fewer = best.without(i)
            places, depths, own = split(fewer.mean[:, : fewer.parameters])
            value, _ = self.model.baseband(fewer.tools, places, depths, own)
            fronts, _, warm = fronts_of(self.model, fewer)
            given = self.proposals[tool].search(
                cycle.samples - value[0], self.whiten, fronts, number=1, fine=NEAR,
                within=around(best.mean[0, 2 * i]), temperature=warm,
            )  # fmt: skip
            n = len(given.gain)
            if n:
                start = (
                    prior.take(np.zeros(1, int))
                    .without(i)
                    .added(i, tool, given.place, given.depth, new_deviations(self.motion))
                )
                found = self._with_others(found, start, cycle, RESTARTED)
        return found

    def _shifted(self, prior: Branches, found: Update, cycle: Cycle) -> Update:
        """Return the branches and those started from shifts of the best by :data:`SHIFTS`."""
        turn, best = self.n_shifts, found.branches
        self.n_shifts += 1
        among = [i for i, one in enumerate(self.known) if one.age < YOUNG]
        young, among = bool(among), among or list(range(len(self.known)))
        i = among[turn % len(among)]
        moves = np.array(SHIFTS[turn // len(among) % 2 :: 2])
        n = len(moves)
        mean = np.repeat(best.mean[:1], n, axis=0)
        mean[:, 2 * i : 2 * i + 2] += moves * [self.model.base.half_wavelength, 1.0]
        if len(self.known) > 1 and moves[0, 0]:  # all at once: the first was placed alone
            joint = np.repeat(best.mean[:1], n, axis=0)
            joint[:, : 2 * len(self.known) : 2] += moves[:, :1] * self.model.base.half_wavelength
            mean = np.concatenate([mean, joint])
        start = restarted(prior, mean, self.model.priors)
        return self._with_others(found, start, cycle, UNUSUAL if young else UNLIKELY)

    def _with_others(
        self, found: Update, start: Branches, cycle: Cycle, prior_odds: float
    ) -> Update:
        """Return the branches, and those fitted from `start`, whose log prior odds are given."""
        plain = 2 * float(np.sum(np.abs(self.whiten(found.rest[0])) ** 2))
        tried = updated(
            self.model, start, cycle.samples, self.whiten, iterations=4, limit=plain + LOST
        )
        level = tried.evidence - found.evidence[0] + prior_odds
        others = replace(tried, branches=replace(tried.branches, level=level))
        return self._pruned(found.joined(others))

    def _pruned(self, found: Update) -> Update:
        return likely(found, UNLIKELY, YOUNG_BRANCHES if self._young() else BRANCHES)

    def _without_gone(self, found: Update, cycle: Cycle) -> Update:
        """Test one contact, and return the branches without it if it is too improbable or faint.

        For the test, the other contacts are fitted again without it.
        """
        if not self.known:
            return found
        i = cycle.number % len(self.known)
        one = self.known[i]
        least = self.model.tables[found.branches.tools[i]].range[0]
        faint = found.branches.mean[0, 2 * i + 1] < least + FAINT
        sure = one.log_odds >= SURE and not (faint or self.n_bad or self._young())
        if sure and cycle.number // len(self.known) % TESTED:
            return found
        fewer = found.branches.take(np.arange(1)).without(i)
        refit = refitted(self.model, fewer, cycle.samples, self.whiten)
        gained = log_ratio(found, refit, self.whiten)
        there = self.motion.survival * one.probability
        log_odds = np.log(there / (1 - there)) + gained - 1.0
        one.log_odds = float(min(log_odds, SURE))
        one.faint = one.faint + 1 if faint else 0
        if one.log_odds > GONE and one.faint < FAINT_TESTS:
            return found
        del self.known[i]
        self.rests.clear()
        return self._pruned(refit)

    def _merged(self, found: Update, cycle: Cycle) -> Update:
        """Return fits with one contact in place of two neighbours, if the cycle is as likely."""
        ages = [one.age for one in self.known]
        pairs = [i for i in range(len(ages) - 1) if min(ages[i : i + 2]) < YOUNG]
        if not pairs:
            return found
        i = pairs[cycle.number // MERGED % len(pairs)]
        best = found.branches.take(np.arange(1))
        alone = one_for_two(self.proposals, self.motion, best, i, cycle.samples, self.whiten)
        if alone is None or log_ratio(found, alone, self.whiten) > NEW_CONTACT:
            return found
        kept = max(self.known[i : i + 2], key=lambda one: one.age)
        kept.age = min(kept.age, NEW[-1] + 1)
        self.known[i : i + 2] = [kept]
        self.rests.clear()
        return self._pruned(alone)
