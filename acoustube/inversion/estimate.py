"""Presses in a recording: number, places, depths, tools and forces, with their uncertainty."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import islice

import numpy as np
from numpy.typing import ArrayLike
from threadpoolctl import ThreadpoolController, threadpool_limits

from acoustube.base.checks import Reals, checked
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.base.types import Array
from acoustube.inversion.detection import detection_limit
from acoustube.inversion.doubt import doubted
from acoustube.inversion.goodness import EXCESS, good_fit, largest_residual, unexplained
from acoustube.inversion.hypotheses import HOPELESS, Builder, Hypothesis
from acoustube.inversion.model import NUISANCES, ForwardModel
from acoustube.inversion.model_error import Discrepancy, discrepancy
from acoustube.inversion.parameters import cost_of_press, split
from acoustube.inversion.peeling import EXPLAINED, onset_behind, peeled
from acoustube.inversion.posterior import Estimate, Posterior
from acoustube.inversion.search import Templates
from acoustube.waves.scattering import Complex

BEAM = 2
"""Number of hypotheses of each number of presses whose other maxima are sought, and to which one
more press is added."""
SAME_PLACE = 0.03
"""Distance in m below which presses of two hypotheses count as the same press."""
GOOD = 0.05
"""Relative error of the model up to which a hypothesis is good, so that no other of equally many
presses is followed."""
NEGLIGIBLE = 300.0
"""Excess of the cost (minus twice the log likelihood) of a maximum over the least, above which the
maximum is left out of the posterior. The posterior allows for ten times the power of the model's
error. With the most likely error, the weight of such a maximum would be exp(-15)."""


@dataclass(frozen=True)
class Contact:
    """A press detected in a recording.

    Attributes
    ----------
    probability : float
        Probability that there is a press at this distance.
    distance, depth : Estimate
        Distance from the face and depth, in m.
    force : Estimate
        Force in N.
    tool : int
        Number of the tool in the library, from 0.
    """

    probability: float
    distance: Estimate
    depth: Estimate
    force: Estimate
    tool: int


@dataclass(frozen=True, eq=False)
class Inversion:
    """Posterior of the presses in a recording: contacts, their number, and the goodness of fit.

    Attributes
    ----------
    contacts : list of Contact
        In the order of distance.
    misfit : float
        Relative error of the forward model, nan without contacts. It is the larger of two: the
        error with the highest evidence (:attr:`.Hypothesis.error`), and the unexplained fraction of
        the echo. The latter is the root of the energy of the residual beyond that of the noise and
        two of its standard deviations, relative to the energy of the echo.
    residual : float
        Largest mean square of the whitened residual in any part of the echo that lasts for
        :data:`.goodness.WINDOW`, or twice that where samples are real. Whitening divides the
        difference of recorded and modelled echo by the standard deviation that noise, clutter and
        errors of the model would give it. If the contacts explain the echo, the value is mostly
        between 1 and 2.
    residual_span : (float, float)
        First and last distance in m whose echoes arrive in that part.
    temperature, gain : Estimate
        Difference of the air's temperature from the model's in K, and logarithm of the gain
        relative to the model's.
    resonance, quality_factor, stretch, bore : Estimate
        Relative differences from the model: of the transducer's resonance and quality factor, of
        the frequency at which the presses' scattering is taken, and of the bore's diameter.
    number : dict of float
        Probability of each number of presses that was tried.
    hypotheses : list of Hypothesis
        Most likely hypothesis of each number of presses, in the order of that number.
    place : ndarray
        Distances in m whose echoes arrive at the times of the baseband, (n_time,).
    measured, explained : ndarray
        Baseband of the cycles and of the detected contacts, both less that of the untouched tube,
        in counts, (n_time,).
    noise : float
        Variance of a sample of the mean of cycles in the baseband, in counts squared.
    model : ForwardModel
        Model of the sensor that recorded the cycles.
    most : int
        Largest number of presses that was tried.
    """

    contacts: list[Contact]
    misfit: float
    residual: float
    residual_span: tuple[float, float]
    temperature: Estimate
    gain: Estimate
    resonance: Estimate
    quality_factor: Estimate
    stretch: Estimate
    bore: Estimate
    number: dict[int, float]
    hypotheses: list[Hypothesis]
    place: Array
    measured: Complex
    explained: Complex
    noise: float
    model: ForwardModel
    most: int

    @property
    def fits(self) -> bool:
        """Goodness of fit: whether the contacts explain the echo (:func:`.good_fit`)."""
        return good_fit(self.misfit, self.residual)

    @property
    def best(self) -> Hypothesis:
        """The most likely hypothesis."""
        return self.hypotheses[max(self.number, key=lambda n: self.number[n])]

    @checked(places=Reals(ndim=1), tool=Number(0, 1000, whole=True))
    def detection_limit(self, places: ArrayLike, tool: int = 0) -> Array:
        """Return the limits of detection: the least depths at which a further press is detected.

        Parameters
        ----------
        places : ndarray
            Distances from the face in m, (n,).
        tool : int, optional
            Number in the library of the tool of the further press, from 0.

        Returns
        -------
        ndarray
            Depths in m, (n,): inf where the deepest press of the library would not be detected, and
            everywhere if :attr:`most` contacts were detected, so that no further one is sought; nan
            closer to a contact than presses can be, and outside the span of the model. See
            :func:`acoustube.inversion.detection.detection_limit`. The limits are valid only if
            :attr:`fits` is true.

        Raises
        ------
        ConfigError
            If the library has no such tool.
        """
        last = len(self.model.tables) - 1
        if tool > last:
            allowed = f"0 to {last}" if last else "0"
            raise ConfigError(f"tool = {tool} is out of range; use {allowed}")
        at = np.asarray(places, float)
        with threadpool_limits(1, user_api="blas"):  # one thread, as the matrices are small
            found = detection_limit(self.model, self.best, self.noise, tool, at)
        full = len(self.best.tools) >= self.most
        return np.where(np.isnan(found) | (not full), found, np.inf)


class Inverter:
    """Inversion of recordings of one tube.

    Parameters
    ----------
    model : ForwardModel
    most : int
        Largest number of presses that is tried, 1 to 8.
    """

    @checked(model=ForwardModel, most=Number(1, 8, whole=True))
    def __init__(self, model: ForwardModel, most: int = 3) -> None:
        self.model, self.most = model, most
        self._threads = ThreadpoolController()  # once: its search for libraries takes milliseconds
        self.templates = [Templates(model, i) for i in range(len(model.tables))]

    @checked(counts=Reals(ndim=2))
    def __call__(self, counts: ArrayLike) -> Inversion:
        """Return the presses estimated from cycles of one state of the tube.

        Parameters
        ----------
        counts : ndarray
            Counts of the converter, (n_cycles, n_samples).

        Raises
        ------
        ConfigError
            If there is no cycle, or cycles have another length than the model's.
        """
        array = np.asarray(counts)
        if array.shape[1] != self.model.base.n_samples:
            raise ConfigError(
                f"cycles have {array.shape[1]} samples and the model's "
                f"{self.model.base.n_samples}; give cycles of the sensor that the model describes"
            )
        samples, noise = self.model.base.of_cycles(array)
        builder = Builder(self.model, self.templates, samples, noise)
        with self._threads.limit(limits=1, user_api="blas"):  # one thread: small matrices
            return self._posterior(self._chain(builder), builder)

    def _chain(self, builder: Builder) -> list[Hypothesis]:
        """Return the best hypothesis of each number of presses, up to the first unlikely number.

        The list goes on beyond an unlikely number if more presses were found one after another in
        time (:mod:`acoustube.inversion.peeling`), unless fewer presses explain the echo well. A
        second one is not sought in time if the residual of the first has no onset of an echo.
        """
        chain = [builder.untouched()]
        beam, levels = chain, peeled(builder, self.most)
        in_time = list(islice(levels, 1))
        for number in range(1, self.most + 1):
            found = [
                builder.settled(one) for level in in_time[number - 1 : number] for one in level
            ]
            if number == 1 and found:
                found = _shifted(builder, found)
                if found[0].error > GOOD:  # sought in the first part of its echo so far
                    found[0] = _sought_again(builder, found[0])
                if onset_behind(builder, builder.searched(found[0])) is not None:
                    in_time += levels
            poor = all(one.error > GOOD for one in found)
            sought = poor and (number > 1 or len(in_time) < 2)
            if sought:
                found += [more for known in beam for more in builder.extended(known)]
            if not found:
                break
            least = min(one.deviance for one in found)
            enough = builder.own_deviance(chain[-1]) + HOPELESS
            if chain[-1].error <= GOOD and least > enough:
                break
            if number > 1 or sought:
                found = _shifted(builder, found)
            best = found[0]
            cost = cost_of_press(number)
            likelier = best.deviance + cost < chain[-1].deviance
            if number > 1 and best.error > GOOD and (likelier or chain[-1].mean_square > EXPLAINED):
                best = _sought_again(builder, best)
            if number > 1:
                best = doubted(builder, chain[-1], best)
                likelier = best.deviance + cost < chain[-1].deviance
            chain.append(best)
            if not likelier and number >= len(in_time):  # two alone of three may be unlikely
                break
            beam = [best, *_others(best, found)] if best.error > GOOD else [best]
        return _pruned(builder, chain)

    def _posterior(self, chain: list[Hypothesis], builder: Builder) -> Inversion:
        """Return the posterior of the presses, from the best hypothesis of each number of them."""
        costs = np.cumsum([0.0, *map(cost_of_press, range(1, len(chain)))])
        deviance = np.array([one.deviance + o for one, o in zip(chain, costs, strict=True)])
        inflation = max(1.0, min(one.mean_square for one in chain))
        probability = np.exp(-0.5 * (deviance - deviance.min()) / inflation)
        probability /= probability.sum()
        number = int(np.argmax(probability))
        near = chain[number].fits.likely(NEGLIGIBLE * max(1.0, chain[number].mean_square))
        best = replace(chain[number], fits=near)
        off = discrepancy(self.model, best, builder.samples, builder.noise)
        order = np.argsort(off.level)
        best = replace(best, fits=best.fits.at(order))
        chain = [*chain[:number], best, *chain[number + 1 :]]
        posterior = Posterior(best, Discrepancy(off.level[order], off.deviation[order]))
        contacts = []
        for i, tool in enumerate(best.tools):
            place = best.best[2 * i]
            seen = [
                weight for one, weight in zip(chain, probability, strict=True)
                if np.any(np.abs(one.best[: 2 * len(one.tools) : 2] - place) < SAME_PLACE)
            ]  # fmt: skip
            known = self.model.tables[tool].tool
            contacts.append(
                Contact(
                    probability=float(sum(seen)),
                    distance=posterior.estimate(2 * i, self.model.scale_error(place)),
                    depth=posterior.depth(2 * i + 1),
                    force=posterior.mapped(
                        2 * i + 1, known.force_at, partial(self.model.priors.force_deviation, known)
                    ),
                    tool=tool,
                )
            )
        nuisance = {
            name: posterior.estimate(2 * len(best.tools) + NUISANCES.index(name))
            for name in NUISANCES
            if name != "phase"
        }
        measured, explained = self._echoes(best, builder)
        base, misfit = self.model.base, float("nan")
        if contacts:
            rest, echo = builder.quiet(np.stack([measured - explained, explained]))
            misfit = max(unexplained(rest, echo, base.freedom, EXCESS), best.error)
        residual, span = largest_residual(best.whiten(measured - explained), base)
        return Inversion(
            contacts=contacts, misfit=misfit,
            residual=residual, residual_span=span, hypotheses=chain,
            number={i: float(p) for i, p in enumerate(probability)},
            place=base.places, measured=measured, explained=explained, noise=builder.noise,
            model=self.model, most=self.most,
            **nuisance,
        )  # fmt: skip

    def _echoes(self, best: Hypothesis, builder: Builder) -> tuple[Complex, Complex]:
        """Return mean cycle and hypothesis in the baseband, each less the untouched tube's echo."""
        places, depths, nuisances = split(best.fits.parameters[:1])
        untouched = self.model.without_presses(nuisances)[0]
        value = self.model.baseband(best.tools, places, depths, nuisances)[0][0]
        return builder.samples - untouched, value - untouched


def _shifted(builder: Builder, found: list[Hypothesis]) -> list[Hypothesis]:
    """Return hypotheses by rising deviance, the best :data:`BEAM` of them with further maxima.

    The further maxima are sought with presses half wavelengths and steps of depth away.
    """
    found = sorted(found, key=lambda one: one.deviance)
    best = [found[0], *_others(found[0], found)]
    rest = [one for one in found if one not in best]
    return sorted([*map(builder.shifted, best), *rest], key=lambda one: one.deviance)


def _sought_again(builder: Builder, known: Hypothesis) -> Hypothesis:
    """Return a hypothesis whose presses were sought again one by one, with the others known."""
    for i in range(len(known.tools)):
        found = [one for one in builder.replaced(known, i) if len(one.tools) == len(known.tools)]
        best = min(found, key=lambda one: one.deviance, default=known)
        if best.deviance < known.deviance:
            known = builder.shifted(best)
    return known


def _pruned(builder: Builder, chain: list[Hypothesis]) -> list[Hypothesis]:
    """Return a chain in which no hypothesis is worse than the next one with a press left out.

    An additional press may fit an error of the others, and the joint fit may then correct the
    others. Without that press they may be better than the hypothesis found before, and replace it.
    Hypotheses of more presses are then judged again by what they explain beyond the better one. The
    chain is changed in place.
    """
    given = list(chain)
    for number in range(len(chain) - 1, 1, -1):
        if chain[number].deviance + cost_of_press(number) < chain[number - 1].deviance:
            fewer = min(builder.pruned(chain[number]), key=lambda one: one.deviance)
            if fewer.deviance < chain[number - 1].deviance:
                chain[number - 1] = builder.shifted(fewer)
    for number in range(2, len(chain)):
        if chain[number - 1] is not given[number - 1]:  # replaced, or itself judged again
            chain[number] = doubted(builder, chain[number - 1], chain[number])
    return chain


def _others(best: Hypothesis, found: list[Hypothesis]) -> list[Hypothesis]:
    """Return further hypotheses to extend, with other places or depths than `best`.

    They also differ from each other in places or depths.
    """
    kept = [best]
    for one in found:
        same = any(
            len(one.best) == len(other.best)
            and np.allclose(one.best[: 2 * len(one.tools)], other.best[: 2 * len(other.tools)],
                            atol=1e-3)
            for other in kept
        )  # fmt: skip
        if not same and len(kept) < BEAM:
            kept.append(one)
    return kept[1:]
