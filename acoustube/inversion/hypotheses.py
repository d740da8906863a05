"""Hypotheses about a recording: sets of presses, built up one press at a time.

A further press is proposed where the residual correlates with the echo of a press, which may pass
the presses before it, also in higher modes. The candidates are refined jointly with the known
presses, then shifted by half wavelengths and by depths, since the likelihood has maxima there.
Where the known presses explain little, further ones are sought with a smaller error of the model
than the most likely one, which would hide them.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from acoustube.base.types import Array
from acoustube.inversion.fit import UNFINISHED, Fits, distinct, evidence, maximise
from acoustube.inversion.likelihood import deviance_of, echo_of, weights
from acoustube.inversion.model import NUISANCES, ForwardModel
from acoustube.inversion.other_maxima import JOINT, beside, farther, other_depths
from acoustube.inversion.parameters import CLOSEST, joined, least_gain, split
from acoustube.inversion.search import Templates, front_of
from acoustube.inversion.whitening import Weights, mean_square
from acoustube.waves.scattering import Complex

ERRORS = (0.003, 0.01, 0.03, 0.06, 0.1, 0.2, 0.4)
"""Errors of the model, relative to the echo, of which the most likely one is chosen."""
SPREADS = 1e-4, 4e-4, 1.5e-3
"""Errors of the model, equal at all times and relative to the highest echo, tried besides zero."""
BENT_SPREADS = 6e-3, 2.4e-2
"""Errors of the model, equal at all times and relative to the highest echo, also tried on a wrapped
tube, where modes close to their cut-on are slow and reflected where the curvature changes."""
SHIFTS = (
    (-1, 0.0), (1, 0.0), (-2, 0.0), (2, 0.0), (-3, 0.0), (3, 0.0), (0, -0.4e-3), (0, 0.4e-3),
    (0, -0.15e-3), (0, 0.15e-3), (1, 0.15e-3), (-1, -0.15e-3), (1, -0.15e-3), (-1, 0.15e-3),
)  # fmt: skip
"""Shifts of place in half wavelengths and of depth in m by which other maxima are sought."""
POOR = 0.05
"""Relative error of the model above which it is estimated anew after shifts of all presses."""
JUDGED = 4
"""Number of the best maxima, after shifts of all presses, whose model error is estimated anew."""
OUTLIER = 9.0
"""Cap on the squared whitened residual in the robust choice of the initial temperature."""
KEPT = 3
"""Largest number of candidates whose model error is estimated, for each tool of a further press and
each index of this press along the tube."""
SEARCHED = 0.02
"""Largest relative model error that is assumed in the search for presses."""
STARTS = 2, 10
"""Number of iterations for all candidates of one more press, and number of the best candidates that
are then refined further."""
FIRST_STARTS = 16, 5
"""Number of candidates of a first press that are refined, and number of the best that are refined
further after `STARTS[0]` iterations. In twelve recordings of single presses, the candidate that led
to the best maximum was among the first eight of an earlier search with fewer candidates."""
FOLLOWED = 2
"""Number of combinations of tool and order along the tube whose model error is estimated."""
EXACT, NOISE_ALONE = 0.01, 1.5
"""The best of several fits is taken without comparing their evidence if the most likely error of
the model is at most `EXACT`, without one equal at all times, or the mean square of its residual,
whitened without such errors, at most `NOISE_ALONE`: it was up to 1.46 in sixty single cycles."""
LOUD = 5.0
"""Smoothed level of the whitened samples, relative to the noise, at which an echo begins."""
HOPELESS = 10.0
"""Excess of the deviance with one more press over that without it, above which the press is not
followed. The deviance with the press is that before its model error and other maxima are known."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A set of presses, with the maxima of the likelihood that were found for it.

    Attributes
    ----------
    tools : tuple of int
        Number of the tool of each press in the library.
    fits : Fits
        Distinct maxima, the best first.
    error : float
        Most likely relative error of the model.
    whiten : Weights
        Weights with that error.
    deviance : float
        Minus twice the logarithm of the evidence.
    mean_square : float
        Mean square of the whitened residual, 1 if the model is right.
    """

    tools: tuple[int, ...]
    fits: Fits
    error: float
    whiten: Weights
    deviance: float
    mean_square: float

    @property
    def best(self) -> Array:
        """Parameters of the best maximum, (n_parameters,)."""
        return self.fits.parameters[0]


class Builder:
    """Builder of hypotheses about the mean of some cycles.

    Parameters
    ----------
    model : ForwardModel
    templates : list of Templates
        One for each tool.
    samples : ndarray
        Mean of cycles in the baseband in counts, (n_time,).
    noise : float
        Variance of a sample of the mean, in counts squared.

    Attributes
    ----------
    quiet : Weights
        Weights without an error of the model.
    start : ndarray
        Initial nuisance parameters, (7,).
    """

    def __init__(
        self, model: ForwardModel, templates: list[Templates], samples: Complex, noise: float
    ) -> None:
        self.model, self.templates = model, templates
        self.samples, self.noise = samples, noise
        self.quiet = weights(model, noise, 0.0, None)
        self.start = self._robust()

    def untouched(self) -> Hypothesis:
        """Return the hypothesis of no press, with fitted nuisance parameters."""
        fits = maximise(self.model, (), self.start[None], self.samples, self.quiet, 6)
        return self._judged((), fits, 0.0, self.quiet)

    def silent(self) -> Hypothesis:
        """Return the hypothesis of no press at the initial nuisance parameters, without a fit."""
        n = len(self.start)
        fits = Fits(self.start[None], np.zeros(1), np.eye(n)[None])
        return Hypothesis((), fits, 0.0, self.quiet, np.inf, np.inf)

    def _robust(self) -> Array:
        """Return the initial nuisance parameters: zero except for the temperature.

        The temperature is fitted to the clutter, if that is known, with a truncated quadratic cost,
        which limits the effect of presses.
        """
        start = np.zeros(len(NUISANCES))
        if self.model.clutter.behind is None:
            return start
        deviation = self.model.priors.temperature
        span = min(3 * deviation, 1.4)
        tried = np.zeros((2 * int(span / 0.02) + 1, len(NUISANCES)))
        tried[:, 0] = np.linspace(-span, span, len(tried))
        rest = self.quiet(self.samples - self.model.without_presses(tried))
        # Only samples before the first echo that no temperature explains.
        power = np.apply_along_axis(np.convolve, 1, np.abs(rest) ** 2, np.ones(4) / 4, "same")
        loud = np.flatnonzero(power.min(axis=0) > LOUD**2)
        before = rest[:, : max(loud[0] - 2, 0)] if len(loud) else rest
        robust = 2 * np.minimum(np.abs(before) ** 2, OUTLIER).sum(axis=1)
        return np.asarray(tried[np.argmin(robust + (tried[:, 0] / deviation) ** 2)])

    def searched(self, known: Hypothesis) -> Hypothesis:
        """Return a hypothesis with the weights with which further presses are sought.

        They are those for a model error of at most :data:`SEARCHED`.
        """
        if 0 < known.error <= SEARCHED:
            return known
        error = min(known.error, SEARCHED) or SEARCHED
        echo = echo_of(self.model, known.tools, known.best) if known.tools else None
        return replace(known, whiten=weights(self.model, self.noise, error, echo), error=error)

    def extended(self, known: Hypothesis, least: float | None = None) -> list[Hypothesis]:
        """Return hypotheses with one more press, whose expected gain exceeds `least`.

        The gain is the decrease of minus twice the log likelihood. By default `least` is the gain
        that the prior odds of the press require.
        """
        own = self.searched(known) if known.tools else known
        sought = [known] if own is known else [known, own]
        found = []
        if least is None:
            least = least_gain(len(known.tools) + 1)
        for one in sought:
            fits = self.with_one_more(one, one.whiten, least=least)
            if one is known and np.isfinite(known.deviance):
                fits = [fit for fit in fits if self._promising(known, *fit)]
            found += [self._fitted(*fit) for fit in fits[:FOLLOWED]]
        return found

    def with_one_more(
        self,
        known: Hypothesis,
        whiten: Weights,
        within: tuple[float, float] | None = None,
        least: float = 0.0,
    ) -> list[tuple[tuple[int, ...], Fits]]:
        """Return tools and fits with one more press, the best first.

        There is a pair for each tool of the new press and each index of this press along the tube.

        Parameters
        ----------
        known : Hypothesis
        whiten : Weights
            Weights with which candidates are sought and refined.
        within : (float, float), optional
            Range of places in m in which the press is sought.
        least : float
            Expected decrease of the cost that the best candidate of a tool has to exceed.
        """
        if not known.tools:
            parameters = self.start[None]
            known = replace(known, fits=replace(known.fits, parameters=parameters))
        places, depths, nuisances = split(known.fits.parameters[:1])
        fronts = front_of(self.model, known.tools, places[0], depths[0], nuisances[0])
        rest, found = self.residual_of(known), []
        for tool, templates in enumerate(self.templates):
            candidates = templates.search(
                rest, whiten, fronts, within=within, least=least, temperature=nuisances[0, 0]
            )
            if len(candidates.gain):
                found += self._added(known, tool, candidates.place, candidates.depth, whiten)
        return sorted(found, key=lambda one: float(one[1].cost[0]))

    def _promising(self, known: Hypothesis, tools: tuple[int, ...], fits: Fits) -> bool:
        """Return whether fits with one more press may become likelier than `known`."""
        deviance = float(evidence(self.model, tools, fits, known.whiten).min())
        return deviance < self.own_deviance(known) + HOPELESS

    def own_deviance(self, known: Hypothesis) -> float:
        """Return minus twice the logarithm of a hypothesis's evidence with its own weights.

        The attribute `deviance` is larger if :mod:`acoustube.inversion.doubt` has raised it.
        """
        return float(evidence(self.model, known.tools, known.fits.first(1), known.whiten)[0])

    def replaced(self, known: Hypothesis, number: int) -> list[Hypothesis]:
        """Return hypotheses in which the press of index `number` has been sought again."""
        tools, fits = _without(known, number)
        fewer = Hypothesis(tools, fits, known.error, known.whiten, np.inf, np.inf)
        return self.extended(fewer, least=0.0)

    def _added(
        self, known: Hypothesis, tool: int, place: Array, depth: Array, whiten: Weights
    ) -> list[tuple[tuple[int, ...], Fits]]:
        """Return the fits with one more press, for each index of this press along the tube."""
        places, depths, nuisances = split(known.fits.parameters[:1])
        apart = np.abs(place[:, None] - places).min(axis=1, initial=np.inf) > CLOSEST
        rank = np.searchsorted(places[0], place)
        most, followed = (len(place), STARTS[1]) if known.tools else FIRST_STARTS
        found = []
        for i in np.unique(rank[apart]):
            here = np.flatnonzero(apart & (rank == i))[:most]
            n = len(here)
            start = joined(
                np.insert(np.repeat(places, n, 0), i, place[here], axis=1),
                np.insert(np.repeat(depths, n, 0), i, depth[here], axis=1),
                np.repeat(nuisances, n, 0),
            )
            tools = (*known.tools[:i], tool, *known.tools[i:])
            tried = maximise(self.model, tools, start, self.samples, whiten, STARTS[0])
            _, first = np.unique(tried.parameters, axis=0, return_index=True)
            start = tried.at(first).sorted().first(followed).parameters
            fits = maximise(self.model, tools, start, self.samples, whiten, 7)
            found.append((tools, distinct(fits, len(tools)).first(KEPT)))
        return found

    def settled(self, known: Hypothesis) -> Hypothesis:
        """Return a hypothesis refitted to the whole recording, with an estimated model error."""
        return self._fitted(known.tools, known.fits)

    def _fitted(self, tools: tuple[int, ...], fits: Fits) -> Hypothesis:
        """Return the hypothesis of the most likely fit, with an estimated model error.

        Fits after the first are left out if the first has hardly any error of the model.
        """
        first = self._alone(tools, fits.parameters[:1])
        if len(fits.cost) == 1 or self._exact(first):
            return first
        others = [self._alone(tools, at[None]) for at in fits.parameters[1:]]
        return min(first, *others, key=lambda one: one.deviance)

    def _exact(self, known: Hypothesis) -> bool:
        """Return whether the residual of a hypothesis has hardly any error of the model."""
        if known.error <= EXACT and known.whiten.spread == 0:
            return True
        white = self.quiet(self.residual_of(known))
        return mean_square(white, self.model.base.freedom) <= NOISE_ALONE

    def _alone(self, tools: tuple[int, ...], at: Array) -> Hypothesis:
        """Return the hypothesis fitted twice in succession from one point (1, n_parameters).

        Before each fit the error of the model is estimated.
        """
        for spread in (False, True):
            error, own = self._likely_error(tools, at[0], spread=spread)
            fit = maximise(self.model, tools, at, self.samples, own, 8)
            at = fit.parameters
        return self._judged(tools, fit, error, own)

    def shifted(self, known: Hypothesis) -> Hypothesis:
        """Return a hypothesis with further maxima, half wavelengths and steps of depth away."""
        m, half = len(known.tools), self.model.base.half_wavelength
        moves = np.array(SHIFTS) * [half, 1.0]
        start = np.repeat(known.best[None], m * len(moves), axis=0)
        for i in range(m):
            rows = slice(i * len(moves), (i + 1) * len(moves))
            start[rows, 2 * i : 2 * i + 2] += moves
        if m > 1:  # all presses together: the first was placed before the others were known
            joint = np.repeat(known.best[None], len(JOINT), axis=0)
            joint[:, : 2 * m : 2] += half * np.array(JOINT)[:, None]
            afresh = np.concatenate([known.best[None], joint])
            afresh[:, 2 * m :] = self.start
            start = np.concatenate([start, joint, afresh])
        poor = m > 1 and known.error > POOR
        fits = maximise(
            self.model, known.tools, start, self.samples, known.whiten, 8, known.fits,
            unfinished=np.inf if poor else UNFINISHED,
        )  # fmt: skip
        if poor:
            # The model error that is most likely at a wrong place hides the right one.
            n = m * len(moves)
            together = distinct(Fits(fits.parameters[n:], fits.cost[n:], fits.information[n:]), m)
            tried = [self._alone(known.tools, at[None]) for at in together.parameters[:JUDGED]]
            better = min(tried, key=lambda one: one.deviance)
            if better.deviance < known.deviance - 1:
                return self.shifted(better)
        others = other_depths(self.model, known.fits, known.tools, self.samples, known.whiten)
        if others.cost.min() < known.fits.cost[0] - 1:
            better = self._alone(known.tools, others.sorted().parameters[:1])
            if better.deviance < known.deviance - 1:
                return self.shifted(better)
        others = beside(self.model, known.fits, known.tools, others, self.samples, known.whiten)
        merged = distinct(known.fits.and_those(fits).and_those(others), m)
        error, whiten = known.error, known.whiten
        moved = not np.array_equal(merged.parameters[0], known.best)
        if moved:
            error, whiten = self._likely_error(known.tools, merged.parameters[0])
            start = merged.parameters
            merged = distinct(maximise(self.model, known.tools, start, self.samples, whiten, 8), m)
        merged = farther(self.model, merged, known.tools, self.samples, whiten)
        return self._judged(known.tools, merged, error, whiten)

    def pruned(self, known: Hypothesis) -> list[Hypothesis]:
        """Return hypotheses with one press left out, for each press in turn."""
        return [self._fitted(*_without(known, i)) for i in range(len(known.tools))]

    def _likely_error(
        self, tools: tuple[int, ...], parameters: Array, *, spread: bool = True
    ) -> tuple[float, Weights]:
        """Return the most likely error of the model at given parameters, and weights with it.

        With `spread`, the error that is equal at all times is estimated too.
        """
        echo = echo_of(self.model, tools, parameters)
        rest = self.samples - self.modelled(tools, parameters)

        def likeliest(tried: list[tuple[float, float]]) -> tuple[float, float]:
            errors, always = np.array(tried).T
            found = deviance_of(self.model, self.noise, errors, echo, always, rest)
            return tried[int(np.argmin(found))]

        error, wide = likeliest([(error, 0.0) for error in ERRORS])
        if spread:
            # An error equal at all times may account for what seemed one in proportion to the echo.
            errors = sorted({error, *(one for one in ERRORS[:2] if one < error)})
            spreads = SPREADS + BENT_SPREADS if self.model.path.converts else SPREADS
            error, wide = likeliest([(error, 0.0), *itertools.product(errors, spreads)])
        return error, weights(self.model, self.noise, error, echo, wide)

    def modelled(self, tools: tuple[int, ...], parameters: Array) -> Complex:
        """Return the baseband (n_time,) of the model with parameters (n_parameters,)."""
        places, depths, nuisances = split(parameters[None])
        return self.model.baseband(tools, places, depths, nuisances)[0][0]

    def residual_of(self, known: Hypothesis) -> Complex:
        """Return the residual of the samples with a hypothesis, (n_time,)."""
        return self.samples - self.modelled(known.tools, known.best)

    def _judged(
        self, tools: tuple[int, ...], fits: Fits, error: float, whiten: Weights
    ) -> Hypothesis:
        """Return the hypothesis of fits, with its evidence and mean square residual."""
        deviance = float(evidence(self.model, tools, fits, whiten)[0])
        value = self.modelled(tools, fits.parameters[0])
        square = mean_square(whiten(self.samples - value), self.model.base.freedom)
        return Hypothesis(tools, fits, error, whiten, deviance, square)


def _without(known: Hypothesis, number: int) -> tuple[tuple[int, ...], Fits]:
    """Return tools and fits of a hypothesis without the press of index `number`, not refitted."""
    places, depths, nuisances = split(known.fits.parameters[:1])
    kept = [i for i in range(len(known.tools)) if i != number]
    rest = joined(places[:, kept], depths[:, kept], nuisances)
    fits = Fits(rest, np.zeros(1), np.eye(rest.shape[1])[None])
    return tuple(known.tools[i] for i in kept), fits
