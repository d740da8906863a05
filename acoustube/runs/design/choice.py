"""Recommended sensors of a design, their errors along the tube and by cause, and robustness."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from acoustube.air import air_at
from acoustube.base.types import Array
from acoustube.base.units import PERCENT
from acoustube.inversion.design import Contacts, Pairs, PressedTube
from acoustube.ranging import Burst, Rangefinder
from acoustube.runs.config.goal import DesignGoal
from acoustube.runs.design.candidates import Candidate, Choice, rangefinder_of
from acoustube.runs.design.search import (
    CONTACTS,
    contacts_of,
    evaluated,
    known_of,
    modulus_of,
)
from acoustube.runs.design.tubes import REFERENCE_SHORE_A, Compute, TubeSpec
from acoustube.waves.scattering import Complex

PAPER = TubeSpec(7.9, 1.6, 35.0)
"""Tube of the sleeve paper."""
WORSE = 1.25
"""Largest rms error of force of a recommended sensor, relative to the least of all candidates."""
MAP_PLACES, MAP_FORCES = 16, 12
"""Numbers of positions and of forces of a map of errors."""
CHANGES = {"bore": 0.05, "hardness": 5.0, "temperature": 10.0}
"""Changes, up and down, for the robustness: bore (relative), Shore A hardness, temperature in K."""


class Map(NamedTuple):
    """Expected errors of a sensor by position and force, for the goal's first indenter.

    Attributes
    ----------
    place : ndarray
        Distances in m, (n_z,).
    force : ndarray
        Forces in N, (n_f,).
    depth : ndarray
        Depths in m at these forces, (n_f,); the last computed depth for forces beyond it.
    force_error : ndarray
        Relative standard deviations of force, (n_f, n_z).
    place_error : ndarray
        Standard deviations of position in m, (n_f, n_z).
    """

    place: Array
    force: Array
    depth: Array
    force_error: Array
    place_error: Array


class Recommended(NamedTuple):
    """A recommended sensor, and the results that are reported for it.

    Attributes
    ----------
    name : str
        Name of its files.
    words : str
        Reason for the recommendation.
    candidate : Candidate
    map : Map
    limits : dict of str to float
        Fractions of the mean square error of force by cause; see :func:`limits_of`.
    robustness : dict of str to ndarray
        Objectives, (4,), after a change of bore, hardness or temperature, by the change in words;
        see :func:`robustness_of`. Empty if not computed.
    ranges : dict of str to (float, float)
        Tolerated range of each property of the parts; see
        :func:`acoustube.runs.design.parts.ranges_of`.
    pairs : Pairs or None
        Errors for two presses at once; see :func:`acoustube.runs.design.parts.pairs_of`.
    """

    name: str
    words: str
    candidate: Candidate
    map: Map
    limits: dict[str, float]
    robustness: dict[str, Array]
    ranges: dict[str, tuple[float, float]]
    pairs: Pairs | None


def recommended(design: DesignGoal, front: Sequence[Candidate]) -> list[tuple[str, str, Candidate]]:
    """Return the best sensors of a Pareto front in force, reach and resolution.

    Each is a tuple of name, reason and sensor. It is the best of the candidates that meet the
    goal's other requirements and whose error of force is at most :data:`WORSE` times the least.
    Without such candidates it is the best of those that come closest to these limits. No sensor is
    recommended twice, so that a short front gives fewer than three.
    """
    goal, least = design.goal, min(one.objectives[1] for one in front)

    def lack(one: Candidate, skip: int) -> float:
        reach, force, resolution, place = one.objectives
        asked = (
            goal.reach_m / reach, force / (WORSE * least), resolution / goal.separation,
            place / goal.place_deviation, float(one.found.nearest) / goal.nearest_m,
        )  # fmt: skip
        return sum(max(np.log(max(x, 1e-9)), 0) for i, x in enumerate(asked) if i != skip)

    found: list[tuple[str, str, Candidate]] = []
    for name, words, column, sign in (
        ("force", "least error of force", 1, 1), ("reach", "longest reach", 0, -1),
        ("resolution", "finest resolution", 2, 1),
    ):  # fmt: skip
        left = [one for one in front if all(one is not other for *_, other in found)]
        if not left:
            break
        # Rounded, so that differences of less than a per cent are ignored.
        best = min(
            left,
            key=lambda one: (round(lack(one, column), 2), sign * one.objectives[column], one.score),
        )
        found.append((name, words, best))
    return found


def paper_sensor(design: DesignGoal, tubes: Sequence[PressedTube]) -> Candidate:
    """Return the sleeve paper's sensor with its predicted errors for a goal.

    `tubes` are the presses of the tube :data:`PAPER` by each indenter of the goal.
    """
    usual = Rangefinder()
    assert isinstance(usual.drive, Burst)
    own = Choice("resonant", usual.quality_factor, 0.0, usual.sampling_rate, usual.bits, 1)
    made = rangefinder_of(design, usual.resonance, usual.drive.cycles, own)
    start = Candidate(tube=PAPER, rangefinder=made, ends=1, found=None, score=0.0)  # type: ignore[arg-type]
    return evaluated(design, known_of(design, tubes, PAPER.shore), start)


def error_map(design: DesignGoal, tubes: Sequence[PressedTube], candidate: Candidate) -> Map:
    """Return a sensor's expected errors by position and force, for the goal's first indenter."""
    goal = design.goal
    place = np.linspace(goal.nearest_m, goal.reach_m, MAP_PLACES)
    force = np.geomspace(*goal.forces_n, MAP_FORCES)
    rows, columns = (part.ravel() for part in np.meshgrid(force, place, indexing="ij"))
    found = []
    # In blocks of the size for which the prediction is compiled.
    for i in range(0, len(rows), CONTACTS):
        here = slice(i, i + CONTACTS)
        contacts = Contacts(
            place=columns[here], force=rows[here], tool=np.zeros(len(rows[here]), int),
            lightest=goal.forces_n[0], strongest=goal.forces_n[1], length=goal.reach_m,
        )  # fmt: skip
        known = known_of(design, tubes, candidate.tube.shore, contacts)
        one = evaluated(design, known, candidate).found
        found.append((one.force, one.place))
    errors = np.concatenate(found, axis=1).reshape(2, MAP_FORCES, MAP_PLACES)
    depth = tubes[0].depth_at(force / modulus_of(design, candidate.tube.shore))
    return Map(place, force, depth, errors[0], errors[1])


def limits_of(design: DesignGoal, candidate: Candidate) -> dict[str, float]:
    """Return the contributions to the mean square error of force, as fractions by cause.

    Causes are the wall's hardness, the forward model, noise with unknown temperature, gain and
    phase, positions wrong by whole half wavelengths, and presses that are missed, lie in the
    ring-down, or have a force beyond that of a closed lumen.
    """
    found, hardness = candidate.found, design.goal.hardness
    square = found.force**2
    prior = contacts_of(design).force_prior ** 2
    lost = np.where(square >= prior * (1 - 1e-6), square, (1 - found.found) * prior)
    rest = square - lost
    parts = {"missed, in the ring-down, or beyond a closed lumen": lost}
    for name, own in (
        ("hardness of the wall", np.full_like(square, hardness**2)),
        ("errors of the forward model", found.model**2),
        ("noise, temperature, gain and phase", found.noise**2),
    ):
        parts[name] = np.minimum(own, np.maximum(rest, 0))
        rest = rest - parts[name]
    parts["errors of half wavelengths"] = np.maximum(rest, 0)
    total = float(square.sum())
    return {name: float(np.sum(part)) / total for name, part in parts.items()}


def robustness_of(
    design: DesignGoal, candidate: Candidate, tubes: Sequence[PressedTube], compute: Compute
) -> dict[str, Array]:
    """Return a sensor's objectives, recalibrated after a change of bore, hardness or temperature.

    The result has :attr:`acoustube.runs.design.candidates.Candidate.objectives` by the change in
    words. A change to a tube that cannot be computed is left out.

    Parameters
    ----------
    design : DesignGoal
    candidate : Candidate
    tubes : sequence of PressedTube
        Presses of the candidate's tube by each indenter of the goal.
    compute : callable
        Computes tubes of another bore and, on a soft layer, of another hardness.
    """
    spec, found = candidate.tube, {}
    table = design.goal.support == "table"
    for sign in (-1, 1):
        shore = float(np.clip(spec.shore + sign * CHANGES["hardness"], 10, 90))
        bore = round(spec.bore * (1 + sign * CHANGES["bore"]), 4)
        pressed = REFERENCE_SHORE_A if table else spec.shore
        other = TubeSpec(bore, spec.wall, pressed)
        stiff = TubeSpec(spec.bore, spec.wall, REFERENCE_SHORE_A if table else shore)
        wanted = [other] if table else [other, stiff]
        made = compute(wanted)
        cases: list[tuple[str, Sequence[PressedTube] | str, float]] = []
        cases.append((f"bore {sign * PERCENT * CHANGES['bore']:+g} %", made[other], spec.shore))
        if shore != spec.shore:
            cases.append(
                (f"{shore - spec.shore:+g} Shore A", tubes if table else made[stiff], shore)
            )
        for name, parts, hardness in cases:
            if not isinstance(parts, str):
                known = known_of(design, parts, hardness)
                found[name] = evaluated(design, known, candidate).objectives
        warm = dataclasses.replace(
            design, goal=dataclasses.replace(
                design.goal, temperature_c=float(
                    np.clip(design.goal.temperature_c + sign * CHANGES["temperature"], -20, 60)
                ),
            ),
        )  # fmt: skip
        heated = [warmed(tube, warm.goal.temperature_c) for tube in tubes]
        known = known_of(warm, heated, spec.shore)
        change = warm.goal.temperature_c - design.goal.temperature_c
        if change:
            found[f"{change:+g} K"] = evaluated(warm, known, candidate).objectives
    return found


def warmed(tube: PressedTube, temperature: float) -> PressedTube:
    """Return a tube in air of a temperature in degC: frequencies scale with the sound speed."""
    speed = air_at(temperature).sound_speed
    at = tube.frequency * tube.sound_speed / speed

    def moved(part: Complex) -> Complex:
        return np.array([np.interp(at, tube.frequency, row) for row in part])

    through = None if tube.transmission is None else moved(tube.transmission)
    return dataclasses.replace(
        tube, reflection=moved(tube.reflection), transmission=through, sound_speed=speed
    )
