"""Detection of presses one after the other, in the order of time.

What has been received up to a moment is caused by the presses up to half the distance that sound
has travelled by then. The next press is therefore fitted to the first part of the residual, before
the echoes of presses behind it arrive, jointly with the presses before it. Once a press is known,
an echo that is too faint to have an onset of its own is also sought before the next onset.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from acoustube.base.types import Array
from acoustube.inversion.hypotheses import LOUD, Builder, Hypothesis
from acoustube.inversion.parameters import least_gain
from acoustube.inversion.whitening import mean_square

PARTS = 0.7e-3, 1.2e-3
"""Durations in s of the first part of an echo, tried one after the other."""
EXPLAINED = 1.5
"""Mean square of the whitened residual up to which a hypothesis explains the recording."""
LEADING = 0.1
"""Level at which an echo begins, relative to the highest level within :data:`AHEAD`. Lower levels
before it are the echo's ringing ahead of its onset, due to the edges of the band."""
AHEAD = 0.5e-3
"""Time in s after a sample within which the highest level for `LEADING` is taken."""
EARLIER = 0.3
"""Distance in m by which the search for a press begins before the place that its onset indicates,
in addition to half the length of the drive: the first part of the echo may be too weak to be seen.
"""
AT_ONSET, BEFORE_ONSET = 3, 1
"""Largest numbers of hypotheses that are followed for each number of presses: of those whose last
press is at an onset, and of those in which it comes before that."""
ALIKE = 1e-3
"""Difference in m up to which places of two hypotheses count as the same."""


def peeled(builder: Builder, most: int) -> Iterator[list[Hypothesis]]:
    """Yield hypotheses of one press, two and so on, each fitted to the first part of a recording.

    For each number there are up to :data:`AT_ONSET` hypotheses whose last press is at an onset,
    followed by up to :data:`BEFORE_ONSET` others. Both groups are in the order of rising mean
    square of the samples fitted. The iterator ends early where no further press is found.

    Parameters
    ----------
    builder : Builder
    most : int
        Largest number of presses.
    """
    beam = [builder.silent()]
    for _ in range(most):
        onsets = [(known, onset_behind(builder, known)) for known in beam]
        with_onset = [(known, onset) for known, onset in onsets if onset is not None]
        at = _distinct([more for one in with_onset for more in _at_onset(builder, *one)])
        before = _distinct([more for one in with_onset for more in _before_onset(builder, *one)])
        beam = at[:AT_ONSET]
        beam += [one for one in before if not _known(one, beam)][:BEFORE_ONSET]
        if not beam:
            return
        yield beam
        beam = [builder.searched(known) for known in beam]


def onset_behind(builder: Builder, known: Hypothesis) -> int | None:
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
        more = _with_one_more(builder, known, end, within)
        found += more
        if more and more[0].mean_square < EXPLAINED:
            break
    return found


def _before_onset(builder: Builder, known: Hypothesis, onset: int) -> list[Hypothesis]:
    """Return hypotheses with one more press, whose echo has no onset and arrives before one.

    The correlation adds up the samples of an echo. It detects echoes whose single samples do not
    exceed the level of an onset, as in the decaying sound of a nearer press. Without a known press
    none is sought.
    """
    end = float(builder.model.base.places[max(onset - 1, 0)])
    if not known.tools or end < builder.model.span[0]:
        return []
    return _with_one_more(builder, known, onset, (0.0, end), least_gain(len(known.tools) + 1))


def _with_one_more(
    builder: Builder, known: Hypothesis, end: int, within: tuple[float, float], least: float = 0.0
) -> list[Hypothesis]:
    """Return a list of the best hypothesis with one more press in a range of places in m.

    It is fitted to the samples before number `end`, and its `mean_square` is of these samples.
    The list is empty if the expected gain of no candidate in the range exceeds `least`.
    """
    whiten = known.whiten.until(end)
    found = []
    for tools, fits in builder.with_one_more(known, whiten, within, least)[:1]:
        left = whiten(builder.samples - builder.modelled(tools, fits.parameters[0]))
        square = mean_square(left, builder.model.base.freedom)
        found.append(Hypothesis(tools, fits.first(1), 0.0, whiten, np.inf, square))
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
    """Return the hypotheses that differ in places or tools, by rising mean square."""
    kept: list[Hypothesis] = []
    for one in sorted(found, key=lambda one: one.mean_square):
        if not _known(one, kept):
            kept.append(one)
    return kept


def _known(one: Hypothesis, others: list[Hypothesis]) -> bool:
    """Return whether a hypothesis has the tools of one of several others, at the same places."""
    ends = 2 * len(one.tools)
    return any(
        other.tools == one.tools and np.all(np.abs((other.best - one.best)[:ends:2]) < ALIKE)
        for other in others
    )
