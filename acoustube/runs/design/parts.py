"""Tolerances of a recommended sensor's parameters, and its errors for two presses at once."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from acoustube.base.types import Array
from acoustube.base.units import KHZ
from acoustube.inversion.design import Electronics, Pairs, PressedTube, predict, predict_pairs
from acoustube.inversion.design.electronics import electronics_of
from acoustube.inversion.design.prediction import on_device, score
from acoustube.runs.config.goal import LONGEST_PULSE, DesignGoal
from acoustube.runs.design.candidates import Candidate, choice_of, suits
from acoustube.runs.design.search import contacts_of, known_of, modulus_of

WORSE = 1.1
"""Largest factor by which the rms error of force may grow within a parameter's range, penalties for
missed goals included."""
FACTORS = np.geomspace(0.5, 2.0, 141)
"""Factors by which each parameter is multiplied, one parameter at a time."""
HARDNESSES = np.arange(-15.0, 15.1, 1.0)
"""Changes of the wall's hardness in Shore A that are tried."""


def ranges_of(
    design: DesignGoal, tubes: Sequence[PressedTube], candidate: Candidate
) -> dict[str, tuple[float, float]]:
    """Return the tolerated range of each parameter of a sensor, varied alone.

    Within this range, the exponential of :func:`acoustube.inversion.design.prediction.score`, the
    rms error of force with penalties for missed goals, grows by the factor :data:`WORSE` at most.

    Parameters
    ----------
    design : DesignGoal
    tubes : sequence of PressedTube
        Presses of the candidate's tube by each tool.
    candidate : Candidate

    Returns
    -------
    dict of str to (float, float)
        Lowest and highest value by the name of the parameter with its unit. The carrier is varied
        for drive and transducer alike. A range ends where the drive does not suit the sampling
        rate, or a chirp is too short for its bandwidth
        (:func:`acoustube.runs.design.candidates.suits`). The noise is relative to that of the
        sensor. The hardness is varied on a table only, where it needs no further press. Each varied
        sensor has its own calibration and library.
    """
    shore, average = candidate.tube.shore, design.goal.average
    known = on_device(known_of(design, tubes, shore))
    usual = electronics_of(candidate.rangefinder, candidate.ends, average)
    choice = choice_of(candidate)
    start = float(score(predict(known, usual), design.goal.asked))

    def within(values: Array, scores: Array, own: float) -> tuple[float, float]:
        good = scores <= start + np.log(WORSE) + 1e-9
        middle = int(np.argmin(np.abs(values - own)))
        low = high = middle
        while low > 0 and good[low - 1]:
            low -= 1
        while high < len(values) - 1 and good[high + 1]:
            high += 1
        return float(values[low]), float(values[high])

    longest = max(LONGEST_PULSE, usual.cycles / usual.carrier) * (1 + 1e-9)
    found = {}
    for name, part, scale in (
        ("carrier (kHz)", "carrier", KHZ), ("cycles", "cycles", 1.0),
        ("bandwidth (kHz)", "bandwidth", KHZ), ("quality factor", "quality", 1.0),
        ("noise (relative)", "level", 1.0),
    ):  # fmt: skip
        own = float(getattr(usual, part))
        if own == 0:
            continue
        many = Electronics(*(np.full(len(FACTORS), one) for one in usual))
        factors = 1 / FACTORS if part == "level" else FACTORS
        many = many._replace(**{part: own * factors})
        values = FACTORS if part == "level" else own * FACTORS * scale
        scores = score(predict(known, many), design.goal.asked)
        drives = zip(*map(np.asarray, (many.carrier, many.cycles, many.bandwidth)), strict=True)
        fits = [
            n / f <= longest and suits(f, n, choice._replace(bandwidth=width))
            for f, n, width in drives
        ]
        scores = np.where(fits, scores, np.inf)
        found[name] = within(values, scores, 1.0 if part == "level" else own * scale)
    if design.goal.support == "table":
        shores = np.clip(shore + HARDNESSES, 10, 90)
        scores = np.array([
            score(predict(known_of(design, tubes, float(one)), usual), design.goal.asked)
            for one in shores
        ])  # fmt: skip
        found["hardness (Shore A)"] = within(shores, scores, shore)
    return found


def pairs_of(
    design: DesignGoal, tubes: Sequence[PressedTube], candidate: Candidate
) -> Pairs | None:
    """Return the expected errors of two simultaneous presses at the goal's separation.

    The first presses are the goal's contacts that lie beyond the ring-down, do not close the lumen
    and leave room on the tube for the second press. One rangefinder records. None is returned if
    there are fewer than two such contacts, or the transmission of a tube is not known.
    """
    goal = design.goal
    contacts = contacts_of(design)
    single = electronics_of(candidate.rangefinder, 1, goal.average)
    known = known_of(design, tubes, candidate.tube.shore)
    here = contacts.place >= float(predict(known, single).nearest)
    here &= contacts.place + goal.separation <= goal.reach_m
    modulus = modulus_of(design, candidate.tube.shore)
    strongest = np.array([tube.force[-1] for tube in tubes])
    here &= contacts.force / modulus <= strongest[contacts.tool]
    if here.sum() < 2 or any(tube.transmission is None for tube in tubes):
        return None
    return predict_pairs(
        tubes, contacts.at(here), single, goal.separation, modulus=modulus,
        temperature=goal.temperature_c, hardness=goal.hardness, model=goal.model,
    )  # fmt: skip
