"""Search for sensors: pattern search over tubes, and grid and gradients over their electronics."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import minimize
from scipy.stats import qmc

from acoustube.base.types import Array
from acoustube.inversion.design import (
    Contacts,
    Electronics,
    Information,
    Prediction,
    PressedTube,
    gradient,
    information,
    predict,
)
from acoustube.inversion.design.electronics import electronics_of
from acoustube.inversion.design.prediction import on_device, score
from acoustube.ranging import Burst, Chirp
from acoustube.runs.config.goal import LEAST_RATE, DesignGoal
from acoustube.runs.design.candidates import (
    Candidate,
    choice_of,
    choices_of,
    rangefinder_of,
    suits,
)
from acoustube.runs.design.tubes import REFERENCE_SHORE_A, Compute, TubeSpec
from acoustube.tube import shear_modulus_from_shore

CONTACTS = 32
"""Number of contacts that are drawn from a goal, always the same ones."""
STEPS = {"bore": 0.5, "wall": 0.25, "shore": 5.0}
"""Steps of the lattice of tubes, in mm and Shore A: tubes are not manufactured in smaller steps."""
WIDEST = 4
"""First step of the pattern search, in steps of the lattice; later steps are halved down to 1."""
CARRIERS, PULSES, HARDNESSES = 14, 5, 5
"""Numbers of values of carrier, cycles and (on a table) hardness that are tried for each tube."""


def contacts_of(design: DesignGoal, n: int = CONTACTS) -> Contacts:
    """Return n contacts of a goal, spread evenly over position, tool and logarithm of force."""
    goal = design.goal
    draws = qmc.Sobol(3, seed=1).random(n)
    low, high = goal.forces_n
    return Contacts(
        place=goal.nearest_m + (goal.reach_m - goal.nearest_m) * draws[:, 0],
        force=low * (high / low) ** draws[:, 1],
        tool=np.minimum((draws[:, 2] * len(goal.tools_mm)).astype(int), len(goal.tools_mm) - 1),
        lightest=low, strongest=high, length=goal.reach_m,
    )  # fmt: skip


def modulus_of(design: DesignGoal, shore: float) -> float:
    """Return the ratio of the modulus at a Shore A hardness to that of the computed presses.

    It is 1 on an arm, where each tube is pressed at its own hardness.
    """
    if design.goal.support != "table":
        return 1.0
    return float(shear_modulus_from_shore(shore) / shear_modulus_from_shore(REFERENCE_SHORE_A))


def known_of(
    design: DesignGoal, tubes: Sequence[PressedTube], shore: float, contacts: Contacts | None = None
) -> Information:
    """Return the Fisher information on a goal's contacts, for a tube of a given hardness.

    Parameters
    ----------
    design : DesignGoal
    tubes : sequence of PressedTube
        Presses of one tube by each tool, computed on a table at
        :data:`acoustube.runs.design.tubes.REFERENCE_SHORE_A`, else at `shore`.
    shore : float
        Shore A hardness.
    contacts : Contacts, optional
        Contacts to predict errors for; by default those of :func:`contacts_of`.
    """
    goal = design.goal
    return information(
        tubes, contacts or contacts_of(design), modulus=modulus_of(design, shore),
        temperature=goal.temperature_c, hardness=goal.hardness, model=goal.model,
    )  # fmt: skip


@dataclass
class Search:
    """Pattern search for the candidates of a goal; tubes are computed on demand.

    Attributes
    ----------
    design : DesignGoal
    compute : callable
        See :data:`acoustube.runs.design.tubes.Compute`.
    seed : int
        Random seed of the first tubes.
    most : int
        Largest number of tubes.
    best : dict of TubeSpec to Candidate
        Best candidate of each tube.
    kept : list of Candidate
        Pareto front in reach, resolution, and the errors of force and position.
    failed : dict of TubeSpec to str
        Tubes that cannot be computed or that no drive suits, and why.
    tubes : dict of TubeSpec to list of PressedTube
        Tubes that were computed, with their presses by each tool.
    """

    design: DesignGoal
    compute: Compute
    seed: int = 0
    most: int = 40
    best: dict[TubeSpec, Candidate] = field(default_factory=dict)
    kept: list[Candidate] = field(default_factory=list)
    failed: dict[TubeSpec, str] = field(default_factory=dict)
    tubes: dict[TubeSpec, list[PressedTube]] = field(default_factory=dict)

    def run(self) -> Candidate | None:
        """Search until no neighbouring tube is better, or `most` tubes have been tried.

        Returns
        -------
        Candidate or None
            Candidate with the lowest score; None if no tube has a candidate.
        """
        self._try(self._first())
        step = WIDEST
        while step >= 1 and self.best and self._room() > 0:
            centre = min(self.best, key=lambda spec: self.best[spec].score)
            new = [spec for spec in self._around(centre, step) if not self._known(spec)]
            if not new:
                step //= 2
                continue
            self._try(new[: self._room()])
        return min(self.best.values(), key=lambda one: one.score) if self.best else None

    def _room(self) -> int:
        return self.most - len(self.best) - len(self.failed)

    def _known(self, spec: TubeSpec) -> bool:
        return spec in self.best or spec in self.failed

    def axes(self) -> dict[str, Array]:
        """Return the lattice of tubes: values of bore and wall in mm and of Shore A hardness."""
        free = self.design.variables
        ranges = {"bore": free.bore_mm, "wall": free.wall_mm, "shore": free.hardness_shore_a}
        found = {}
        for name, (low, high) in ranges.items():
            n = round((high - low) / STEPS[name])
            found[name] = np.round(np.linspace(low, high, n + 1), 4)
        if self.design.goal.support == "table":
            found["shore"] = np.array([REFERENCE_SHORE_A])
        return found

    def _fits(self, spec: TubeSpec) -> bool:
        room = spec.bore + 2 * spec.wall <= self.design.variables.outer_mm + 1e-9
        return room and self.design.bends(spec.bore, spec.wall)

    def _first(self) -> list[TubeSpec]:
        """Return the first tubes: up to a third of the allowed number, spread evenly."""
        values = list(self.axes().values())
        draws = qmc.Sobol(3, seed=self.seed).random_base2(max(8 * self.most - 1, 63).bit_length())
        places = [
            TubeSpec(*(float(v[min(int(u * len(v)), len(v) - 1)])
                       for u, v in zip(row, values, strict=True)))
            for row in draws
        ]  # fmt: skip
        fitting = dict.fromkeys(spec for spec in places if self._fits(spec))
        if not fitting:  # narrow ranges, in which no drawn tube fits
            lattice = [TubeSpec(*map(float, row)) for row in itertools.product(*values)]
            fitting = dict.fromkeys([next(filter(self._fits, lattice), lattice[0])])
        return list(fitting)[: max(self.most // 3, 1)]

    def _around(self, centre: TubeSpec, step: int) -> Iterator[TubeSpec]:
        """Yield the tubes that differ from `centre` by `step` on one axis of the lattice.

        Tubes that are too thick, or would kink at the goal's radius of bending, are left out.
        """
        for name, values in self.axes().items():
            here = int(np.argmin(np.abs(values - getattr(centre, name))))
            for there in (here - step, here + step):
                if 0 <= there < len(values):
                    spec = centre._replace(**{name: float(values[there])})
                    if self._fits(spec):
                        yield spec

    def _try(self, specs: Sequence[TubeSpec]) -> None:
        for spec, tubes in self.compute(specs).items():
            if isinstance(tubes, str):
                self.failed[spec] = tubes
                continue
            self.tubes[spec] = tubes
            found = candidates_of(self.design, spec, tubes)
            if not found:
                self.failed[spec] = (
                    "each chirp reaches over half of the sampling rate, or is too short for its "
                    "bandwidth (rate_khz, cycles, bandwidth_khz)"
                )
                continue
            self.best[spec] = min(found, key=lambda one: one.score)
            self.kept = front_of([*self.kept, *found])


def candidates_of(
    design: DesignGoal, spec: TubeSpec, tubes: Sequence[PressedTube]
) -> list[Candidate]:
    """Return the Pareto front of the candidates with one tube, the best of them refined.

    Electronics and, on a table, hardness are tried on a grid; carrier and cycles of the candidate
    with the best score are then improved by a quasi-Newton method. The front is empty if no drive
    suits a sampling rate, or each chirp is too short for its bandwidth.
    """
    shores = [spec.shore]
    if design.goal.support == "table":
        shores = list(np.unique(np.linspace(*design.variables.hardness_shore_a, HARDNESSES)))
    found = []
    known: dict[float, Information] = {}
    for shore in shores:
        known[shore] = on_device(known_of(design, tubes, shore))
        found += _grid(design, spec._replace(shore=float(shore)), known[shore])
    if not found:
        return []
    best = min(found, key=lambda one: one.score)
    return front_of([*found, refined(design, known[best.tube.shore], best)])


def _grid(design: DesignGoal, spec: TubeSpec, known: Information) -> list[Candidate]:
    """Return the candidates with one tube, and with electronics on a grid."""
    free, choices = design.variables, []
    cycles = np.geomspace(*free.cycles, PULSES if np.ptp(free.cycles) else 1)
    cycles = np.unique(np.round(2 * cycles) / 2)  # rounded to half periods
    for choice in choices_of(design):
        ends = free.chirp_carrier(choice.bandwidth)
        carriers = np.geomspace(*ends, CARRIERS if np.ptp(ends) else 1)
        choices += [
            (rangefinder_of(design, carrier, lasting, choice), choice.ends)
            for carrier, lasting in itertools.product(carriers, cycles)
            if suits(carrier, lasting, choice)
        ]
    if not choices:
        return []
    each = Electronics(
        *np.array([electronics_of(r, ends, design.goal.average) for r, ends in choices]).T
    )
    found = predict(known, each)
    scores = score(found, design.goal.asked)
    return [
        Candidate(
            tube=spec, rangefinder=r, ends=ends, score=float(scores[i]),
            found=Prediction(*(part[i] for part in found)),
        )
        for i, (r, ends) in enumerate(choices)
    ]  # fmt: skip


def refined(design: DesignGoal, known: Information, best: Candidate) -> Candidate:
    """Return a candidate with carrier and cycles improved by L-BFGS-B.

    The number of cycles is rounded to half cycles. `best` itself is returned if the result does not
    suit the sampling rate or has no better score.
    """
    free, goal, r = design.variables, design.goal, best.rangefinder
    assert isinstance(r.drive, Burst | Chirp)
    choice = choice_of(best)
    start = electronics_of(r, best.ends, goal.average)

    def objective(logs: Array) -> tuple[float, Array]:
        carrier, cycles = np.exp(logs)
        return gradient(known, start._replace(carrier=carrier, cycles=cycles), goal.asked)

    low, high = free.chirp_carrier(choice.bandwidth)
    bounds = [np.log([low, min(high, r.sampling_rate / LEAST_RATE)]), np.log(free.cycles)]
    first = np.log([r.drive.frequency, r.drive.duration * r.drive.frequency])
    end = minimize(objective, first, jac=True, method="L-BFGS-B", bounds=bounds,
                   options={"maxiter": 12})  # fmt: skip
    carrier, cycles = np.exp(end.x)
    carrier, cycles = round(float(carrier), 1), max(round(2 * float(cycles)) / 2, 0.5)
    if not suits(carrier, cycles, choice):
        return best
    moved = rangefinder_of(design, carrier, cycles, choice)
    candidate = evaluated(design, known, replace(best, rangefinder=moved))
    return candidate if candidate.score < best.score else best


def evaluated(design: DesignGoal, known: Information, candidate: Candidate) -> Candidate:
    """Return a candidate with its errors and score as predicted from the information `known`."""
    goal = design.goal
    found = predict(known, electronics_of(candidate.rangefinder, candidate.ends, goal.average))
    value = score(found, goal.asked)
    return replace(candidate, found=found, score=float(value))


def front_of(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Return the Pareto front in reach, resolution, and the errors of force and position.

    The candidate with the longest reach comes first.
    """
    values = np.round(np.array([one.objectives for one in candidates]) * (-1, 1, 1, 1), 5)
    kept: list[int] = []
    # Sorted by the first objective: only earlier candidates can dominate a later one.
    for i in np.lexsort(values.T[::-1]):
        if not np.any(np.all(values[kept] <= values[i], axis=1)):
            kept.append(int(i))
    return [candidates[i] for i in kept]
