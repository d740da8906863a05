"""Detection of presses one after the other, in the order of time.

What has been received up to a moment is caused by the presses up to half the distance that sound
has travelled by then. The next press is therefore fitted to the first part of the residual, before
the echoes of presses behind it arrive, jointly with the presses before it. An echo that is too
faint to have an onset of its own is sought before that of the next one.
"""

from __future__ import annotations

import numpy as np

from acoustube.base.types import Array
from acoustube.inversion.hypotheses import LOUD, Builder, Hypothesis
from acoustube.inversion.parameters import cost_of_press

PARTS = 0.7e-3, 1.2e-3
"""Durations in s of the first part of an echo, tried one after the other."""
EXPLAINED = 1.5
"""Mean square of the whitened residual up to which a hypothesis explains the recording."""
LEADING = 0.1
"""Level at which an echo begins, relative to the highest level within :data:`AHEAD`. Lower levels
before it are the echo's ringing ahead of its onset, due to the edges of the band."""
AHEAD = 0.5e-3
"""Time in s after a sample within which the highest level is taken."""
EARLIER = 0.3
"""Distance in m by which the search for a press begins before its apparent place, in addition to
half the length of the drive: the first part of the echo may be too weak to be seen."""
SEEN, FAINT = 3, 1
"""Numbers of hypotheses that are followed for each number of presses: of those with a press at an
onset, and of those with one before it."""
ALIKE = 1e-3
"""Difference in m up to which places of two hypotheses count as the same."""


def peeled(builder: Builder, most: int) -> list[list[Hypothesis]]:
    """Return hypotheses of one press, two and so on, each fitted to the first part of a recording.

    For each number there are up to :data:`SEEN` and :data:`FAINT`. The list ends early where no
    further press is found.

    Parameters
    ----------
    builder : Builder
    most : int
        Largest number of presses.
    """
    beam = [builder.silent()]
    found: list[list[Hypothesis]] = []
    for _ in range(most):
        onsets = [(known, _onset(builder, known)) for known in beam]
        begun = [(known, onset) for known, onset in onsets if onset is not None]
        seen = [more for one in begun for more in _at_onset(builder, *one)]
        faint = [more for one in begun for more in _before_onset(builder, *one)]
        beam = _distinct([*_distinct(seen)[:SEEN], *_distinct(faint)[:FAINT]])
        if not beam:
            break
        found.append(beam)
        beam = [builder.searched(known) for known in beam]
    return found


def _onset(builder: Builder, known: Hypothesis) -> int | None:
    """Return the index of the sample at which an echo begins in the residual; None if none does."""
    level = np.abs(known.whiten(builder.residual_of(known)))
    return leading_edge(level, builder.model.base.interval)


def _at_onset(builder: Builder, known: Hypothesis, onset: int) -> list[Hypothesis]:
    """Return hypotheses with the press whose echo begins at an onset, fitted to its first part."""
    found = list[Hypothesis]()
    base = builder.model.base
    early = EARLIER + base.rangefinder.drive.duration * base.air.sound_speed / 2
    for part in PARTS:
        end = min(onset + max(int(part / base.interval), 2), len(builder.samples))
        within = float(base.places[onset]) - early, float(base.places[end - 1])
        more = _fitted(builder, known, end, within)
        found += more
        if more and more[0].residual < EXPLAINED:
            break
    return found


def _before_onset(builder: Builder, known: Hypothesis, onset: int) -> list[Hypothesis]:
    """Return hypotheses with a press whose echo arrives before an onset, without one of its own.

    The correlation with the templates detects fainter echoes than the level of single samples does,
    as behind a press whose sound decays slowly.
    """
    if not known.tools or onset < 2:
        return []
    within = 0.0, float(builder.model.base.places[onset - 1])
    return _fitted(builder, known, onset, within, cost_of_press(len(known.tools) + 1))


def _fitted(
    builder: Builder, known: Hypothesis, end: int, within: tuple[float, float], least: float = 0.0
) -> list[Hypothesis]:
    """Return the best hypothesis with one more press, fitted to the samples before an end.

    Its `residual` is that of these samples. The list is empty if there is no candidate within a
    range of places in m whose expected gain exceeds `least`.
    """
    whiten = known.whiten.until(end)
    found = []
    for tools, fits in builder.with_one_more(known, whiten, within, least)[:1]:
        left = whiten(builder.samples - builder.modelled(tools, fits.parameters[0]))
        share = float(np.mean(np.abs(left) ** 2)) / builder.model.base.freedom
        found.append(Hypothesis(tools, fits.first(1), 0.0, whiten, np.inf, share))
    return found


def leading_edge(level: Array, step: float) -> int | None:
    """Return the index of the sample at which an echo begins; None if none does before the last 8.

    Parameters
    ----------
    level : ndarray
        Absolute values of the whitened samples, (n_time,).
    step : float
        Interval between samples in s.
    """
    smooth = np.sqrt(np.convolve(level**2, np.ones(4) / 4, "same"))
    ahead = np.lib.stride_tricks.sliding_window_view(
        np.pad(smooth, (0, max(int(AHEAD / step), 1))), max(int(AHEAD / step), 1) + 1
    )
    loud = np.flatnonzero((smooth > LOUD) & (smooth > LEADING * ahead.max(axis=1)))
    return int(loud[0]) if len(loud) and loud[0] < len(level) - 8 else None


def _distinct(found: list[Hypothesis]) -> list[Hypothesis]:
    """Return the hypotheses that differ in places or tools, in the order of rising residual."""
    kept: list[Hypothesis] = []
    for one in sorted(found, key=lambda one: one.residual):
        ends = 2 * len(one.tools)
        same = any(
            other.tools == one.tools
            and np.all(np.abs((other.best - one.best)[:ends:2]) < ALIKE)
            for other in kept
        )  # fmt: skip
        if not same:
            kept.append(one)
    return kept
