"""Tracking of a press that moves along a tube (swipe), and of two presses at once."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from acoustube import signals, sleeve
from acoustube.base.types import Array
from acoustube.base.units import CM, MS
from acoustube.ranging import Rangefinder, record
from acoustube.reports.figures.run import PRESS
from acoustube.reports.studies.arm import TUBE_SEEDS, processing_of
from acoustube.reports.studies.calibration import LENGTH, RADIUS, TEMPERATURE
from acoustube.reports.studies.report import Row
from acoustube.sleeve import ContactTracker, TrackingSettings
from acoustube.waves.scattering import ModalScattering, PlacedScatterer

RATE = Rangefinder().cycle_rate
SPEED = 0.05
"""Speed of a swipe in m/s."""
START, SWIPE_DURATION = 0.40, 8.0
"""Distance in m at which a swipe starts, and its duration in s."""
PAIR, PAIR_DURATION = (0.60, 0.80), 2.0
"""Distances of two simultaneous presses in m, and their duration in s."""
FORCES = (4.3, 7.0)
"""Forces in N of the nearer press, and of the farther one or the swipe."""
NEARER_FORCES, FARTHER_FORCES, GAPS = (4.3, 5.0, 5.7), (6.3, 7.0, 7.7), (0.2, 0.25, 0.3, 0.4)
"""Forces in N of nearer and of farther presses, and distances between them in m."""
PAIR_TOLERANCE, PAIR_CYCLES = 0.10, 6
"""Largest distance error in m with which a press of a pair counts as located (half of the smallest
of `GAPS`), and number of cycles for which a pair is tracked."""
CANDIDATE_RATIO = 0.06
"""Least amplitude of an echo that is tracked, as a fraction of the highest: with 0.12 a press
behind another is missed, with 0.03 a hard press has twice as many false echoes."""
TRACKING = TrackingSettings(deviation=0.015)
"""Settings of the tracker; the standard deviation includes delays of echoes by trapped sound."""


class Track(NamedTuple):
    """Contacts tracked over time.

    Attributes
    ----------
    times : array of shape (cycle,)
        Times of the cycles in s.
    true : array of shape (cycle, contact)
        True distances in m.
    candidates : list of array
        Distances in m of the echoes of each cycle whose amplitude is at least
        :data:`CANDIDATE_RATIO` times the highest.
    contacts : list
        Confirmed contacts of each cycle; see :class:`acoustube.sleeve.ContactTracker`.
    seconds : array of shape (cycle,)
        Processor time of processing and tracking each cycle, in s.
    """

    times: Array
    true: Array
    candidates: list[Array]
    contacts: list[sleeve.tracking.Contacts]
    seconds: Array


def swiped(
    presses: Mapping[float, tuple[Any, ModalScattering]], *, quick: bool
) -> tuple[Track, Track]:
    """Record and track a swipe, and two simultaneous presses.

    Parameters
    ----------
    presses : mapping
        See :func:`acoustube.reports.studies.arm.by_depth`.
    quick : bool
        Whether to record only the first quarter of each.

    Returns
    -------
    swipe, pair : Track

    Notes
    -----
    The tube is straight: on a wrapped tube each position would need other bends around the press.
    """
    light, hard = (_of_force(presses, force) for force in FORCES)
    share = 0.25 if quick else 1.0
    times = np.arange(int(share * SWIPE_DURATION * RATE)) / RATE
    swipe = _followed([hard], (START + SPEED * times)[:, None], times)
    times = np.arange(int(share * PAIR_DURATION * RATE)) / RATE
    pair = _followed([light, hard], np.tile(PAIR, (len(times), 1)), times)
    return swipe, pair


def resolved_pairs(
    presses: Mapping[float, tuple[Any, ModalScattering]], *, quick: bool
) -> NDArray[np.bool_]:
    """Return the mask of the pairs that are resolved as two presses, each near its true position.

    Returns
    -------
    ndarray of bool
        (gap, light, hard), in the order of :data:`GAPS`, :data:`NEARER_FORCES` and
        :data:`FARTHER_FORCES`; in a quick study only the first of each.
    """
    gaps, lights, hards = (
        every[: 1 if quick else None] for every in (GAPS, NEARER_FORCES, FARTHER_FORCES)
    )
    times = np.arange(PAIR_CYCLES) / RATE
    resolved = np.zeros((len(gaps), len(lights), len(hards)), bool)
    for at in np.ndindex(resolved.shape):
        places = PAIR[0] + np.array([0.0, gaps[at[0]]])
        pair = [_of_force(presses, lights[at[1]]), _of_force(presses, hards[at[2]])]
        found = _followed(pair, np.tile(places, (PAIR_CYCLES, 1)), times).contacts[-1].place
        resolved[at] = len(found) == 2 and bool(
            np.all(np.abs(np.sort(found) - places) < PAIR_TOLERANCE)
        )
    return resolved


def _of_force(
    presses: Mapping[float, tuple[Any, ModalScattering]], force: float
) -> ModalScattering:
    """Return the scattering matrix of the press whose force is nearest to `force` in N."""
    return min(presses.values(), key=lambda press: abs(float(press[0]["force"]) - force))[1]


def _followed(matrices: Sequence[ModalScattering], true: Array, times: Array) -> Track:
    """Record presses, detect their echoes and track the contacts.

    `true` are the distances of the presses in m, (cycle, contact), and `times` are in s.
    """
    candidates, contacts, seconds = [], [], []
    tracker = ContactTracker(TRACKING)
    known: signals.Tracker | None = None
    for i, (at, places) in enumerate(zip(times, true, strict=True)):
        presses = [PlacedScatterer(m, float(z)) for m, z in zip(matrices, places, strict=True)]
        cycle = record(
            presses, Rangefinder(), radius=RADIUS, length=LENGTH, temperature=TEMPERATURE,
            first_cycle=i, seed=7, tube_seed=TUBE_SEEDS[0],
        )  # fmt: skip
        known = known or signals.Tracker(cycle["time"].values, processing_of(0))
        temperature = float(cycle["temperature"].values[0])
        begun = time.thread_time()
        ranging = known.update(cycle["signal"].values[0], temperature)
        loud = ranging.echoes.amplitudes >= CANDIDATE_RATIO * ranging.amplitude
        found = signals.distance(ranging.echoes.times[loud] - ranging.send_time, temperature)
        presses_found = sleeve.remove_ghost_echoes(found, ranging.echoes.amplitudes[loud])
        contacts.append(tracker.update(float(at), presses_found))
        seconds.append(time.thread_time() - begun)
        candidates.append(found[np.isfinite(found)])
    return Track(times, true, candidates, contacts, np.array(seconds))


def errors_of(track: Track) -> Array:
    """Return the distance in m from each true contact to the nearest tracked one, (cycle, contact).

    The distance is not negative. It is nan in cycles without a confirmed contact.
    """
    return np.array(
        [
            [np.min(np.abs(now.place - z)) if len(now.place) else np.nan for z in places]
            for now, places in zip(track.contacts, track.true, strict=True)
        ]
    )


def swipe_rows(tracks: tuple[Track, Track], resolved: NDArray[np.bool_]) -> list[Row]:
    """Return rows of tracking errors, numbers of resolved pairs of presses, and computing time."""
    swipe, pair = tracks
    off, both = errors_of(swipe), errors_of(pair)
    speeds = [now.speed[np.argmin(np.abs(now.place - z))] for now, (z,) in zip(
        swipe.contacts, swipe.true, strict=True) if len(now.place)]  # fmt: skip
    taken = np.concatenate([swipe.seconds, pair.seconds])
    why = "Simulated with the whole sensor, on a straight tube; the sleeve paper gives no numbers."
    of_two = (
        "Behind a hard press, the echo of a second one is as weak as the sound trapped by the "
        "first. Where these two overlap, one contact is found instead of two, or the farther one "
        "is placed too far away."
    )
    return [
        Row(quantity="swipe of 5 cm/s: RMSE of the place", unit="cm",
            ours=CM * float(np.sqrt(np.nanmean(off**2))), why=why),
        Row(quantity="swipe of 5 cm/s: median estimated speed", unit="cm/s",
            ours=CM * float(np.median(speeds)) if speeds else float("nan"), why=why),
        Row(quantity="swipe of 5 cm/s: cycles with a contact", unit="%",
            ours=100 * float(np.mean(np.isfinite(off))),
            why="Contacts are confirmed after a few cycles."),
        Row(quantity="swipe of 5 cm/s: confirmed contacts at its end", unit="1",
            ours=float(len(swipe.contacts[-1].number)), why="One is there."),
        Row(quantity="two presses 20 cm apart: confirmed contacts", unit="1",
            ours=float(len(pair.contacts[-1].number)), why="Two are there."),
        *(
            Row(quantity=f"two presses 20 cm apart: RMSE of the {which}", unit="cm",
                ours=CM * float(np.sqrt(np.nanmean(part**2))), why=why)
            for which, part in zip(("nearer", "farther"), both.T, strict=True)
        ),
        *(
            Row(quantity=f"pairs {CM * gap:g} cm apart located as two, of {pairs.size}",
                unit="1", ours=float(pairs.sum()), why=of_two)
            for gap, pairs in zip(GAPS, resolved, strict=False)
        ),
        Row(quantity="processing and tracking of a cycle: processor time", unit="ms",
            ours=MS * float(np.median(taken)),
            why=f"The rangefinder sends one every {1e3 / RATE:g} ms."),
    ]  # fmt: skip


def swipe_figure(tracks: tuple[Track, Track]) -> Figure:
    """Draw distances of echoes and of tracked contacts over time."""
    sheet = Figure(figsize=(12, 4.5), layout="constrained")
    for axes, track in zip(sheet.subplots(1, 2, sharey=True), tracks, strict=True):
        at = np.repeat(track.times, [len(found) for found in track.candidates])
        axes.plot(at, CM * np.concatenate(track.candidates), ".", ms=3, color="0.7", label="echoes")
        axes.plot(track.times, CM * track.true, "--", lw=1, color=PRESS)
        for number in sorted({int(n) for now in track.contacts for n in now.number}):
            path = np.array([
                [t, now.place[now.number == number][0]]
                for t, now in zip(track.times, track.contacts, strict=True) if number in now.number
            ])  # fmt: skip
            axes.plot(path[:, 0], CM * path[:, 1], color=f"C{number}", label=f"contact {number}")
        axes.set(xlabel="time (s)", ylabel="distance (cm)")
        axes.legend(fontsize="small")
    return sheet
