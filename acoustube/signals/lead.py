"""Lead of a record: the time from its first sample to the start of the send pulse."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from acoustube.base.sampling import sampling_rate
from acoustube.base.units import MS
from acoustube.signals.compression import chirp_template
from acoustube.signals.filters import envelope, matched_filter, remove_offset
from acoustube.signals.peaks import plateaus, send_pulse
from acoustube.signals.processing import Processing

MOST_CYCLES = 500
"""Largest number of cycles, evenly spread over a record, in which the send pulse is sought."""
COMPRESSED_WIDTH = 4.0
"""Longest time after the rise of a compressed chirp in which its maximum is sought, times its
bandwidth."""
LEAST_AGREEMENT = 0.9
"""Least fraction of cycles in which the send pulse must start at the same time."""


def find_lead(time: ArrayLike, samples: ArrayLike, settings: Processing | None = None) -> float:
    """Return the time at which the send pulse starts in all cycles of a record.

    Parameters
    ----------
    time : array of shape (time,)
        Sampling times in s, from any zero.
    samples : array of shape (cycle, time)
        Cycles in any unit, with their offset, recorded with a constant lead.
    settings : Processing, optional

    Returns
    -------
    float
        In s, on the axis of `time`.

    Raises
    ------
    ValueError
        If the record begins within the pulse, or the cycles agree on no time.

    Notes
    -----
    The envelope of a cycle first reaches half of its maximum in the send pulse, unless an echo is
    more than twice as high. The pulse starts half its duration before its maximum. A clipped pulse
    has no distinct maximum and is taken to start where it rises. The median over the cycles is
    returned. Distances are measured from the maximum in each cycle, and so need no exact lead.

    The envelope of a chirp is that of the compressed pulse, whose maximum is at the chirp's middle.
    """
    settings = settings or Processing()
    time, cycles = np.asarray(time, dtype=float), np.asarray(samples)
    cycles = cycles[:: max(1, -(-len(cycles) // MOST_CYCLES))]
    rate, duration = sampling_rate(time), settings.pulse_cycles / settings.frequency
    if settings.offset_cutoff is not None:
        cycles = remove_offset(cycles, rate, settings.offset_cutoff)
    if settings.bandwidth is None:
        heights, width = envelope(cycles, rate, settings.cutoff), duration + 1 / settings.cutoff
    else:
        chirp = chirp_template(
            rate, settings.frequency, settings.bandwidth, duration, settings.window
        )
        heights = np.abs(matched_filter(cycles, chirp))
        width = min(duration, COMPRESSED_WIDTH / settings.bandwidth)
    half = heights >= heights.max(axis=-1, keepdims=True) / 2
    rise = time[np.argmax(half, axis=-1)]
    agree = np.abs(rise - np.median(rise)) < duration / 2
    if np.mean(agree) < LEAST_AGREEMENT:
        raise ValueError(
            f"the strongest pulse starts at the same time in only {100 * np.mean(agree):.0f} % of "
            "the cycles, so the send pulse cannot be found; state its time by pulse_at (--pulse-at)"
        )
    before = float(np.median(rise)) + width
    peak, height = send_pulse(time, heights[agree], before=before)
    start = peak - duration / 2
    if settings.bandwidth is None:
        clipped, edge = plateaus(time, heights[agree], height, before=before, least=duration / 2)
        start = np.where(clipped, edge, start)
    lead = float(np.median(start))
    if lead < time[0] - duration / 4:
        raise ValueError(
            f"the send pulse starts {MS * (time[0] - lead):.3g} ms before the first sample; "
            "record earlier"
        )
    return lead
