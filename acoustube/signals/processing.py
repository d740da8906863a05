"""Settings of the processing from pressure to distance."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from acoustube.signals.filters import (
    OFFSET_CUTOFF,
    TEMPLATE_CYCLES,
    TimeGain,
    template,
)


@dataclass(frozen=True, kw_only=True)
class Processing:
    """How recorded cycles become distances: the paper's steps with their numbers (section II-B).

    Attributes
    ----------
    frequency : float
        Carrier in Hz.
    pulse_cycles : float
        Carrier cycles that the transducer sends.
    offset_cutoff : float or None
        Frequency in Hz below which all is taken for the offset; None leaves it.
    gain : TimeGain or None
        From a calibration.
    template_cycles : float or None
        Length of the matched filter in carrier cycles; None goes without.
    cutoff : float
        Of the envelope's low-pass in Hz.
    prominence : float
        Least prominence of an echo, as a share of the send pulse.
    nearest, farthest : float
        Of the search, in m.
    send_shift : float
        What a calibration adds to the time of the send pulse, in s.
    """

    frequency: float = 42e3
    pulse_cycles: float = 11.0
    offset_cutoff: float | None = OFFSET_CUTOFF
    gain: TimeGain | None = None
    template_cycles: float | None = TEMPLATE_CYCLES
    cutoff: float = 10e3
    prominence: float = 0.01
    nearest: float = 0.15
    farthest: float = 2.15
    send_shift: float = 0.0

    def __post_init__(self) -> None:
        """Refuse numbers that process nothing."""
        positive = ("frequency", "pulse_cycles", "cutoff", "prominence", "farthest")
        for name in (*positive, "offset_cutoff", "template_cycles", "nearest", "send_shift"):
            value = getattr(self, name)
            if value is None and name in ("offset_cutoff", "template_cycles"):
                continue
            if isinstance(value, str) or not np.isfinite(value):
                raise ValueError(f"{name} = {value!r} must be a finite number")
            if not value > 0 and name not in ("nearest", "send_shift"):
                raise ValueError(f"{name} = {value} must be positive")


def without_aliased_template(how: Processing, sampling_rate: float) -> Processing:
    """Return a processing that cycles of a sampling rate allow: undersampled ones unmatched.

    Parameters
    ----------
    how : Processing
    sampling_rate : float
        Of the cycles, in Hz.

    Returns
    -------
    Processing
        `how` where the carrier lies below half the sampling rate, else `how` without the matched
        filter.

    Notes
    -----
    EchoTube's board takes 80 000 samples a second of a 42 kHz carrier, which then appears at
    80 - 42 = 38 kHz, so close to half the rate that the samples are a beat of 2 kHz with
    alternating signs. Its phase is the carrier's, and changes once along every 4 mm of the tube.
    A template at 38 kHz is such a beat too, of a phase of its own: it moves the peak by the
    difference (on echoes of 11 cycles in 1750 mm of tube a deviation of 7 mm, at most 13 mm off).
    Rectification and low-pass need no phase and stay. They do not come away unharmed: the rectified
    carrier's overtone at 84 kHz appears at 4 kHz, below the usual cut-off, and what falls between
    the samples is lost. Measured on those echoes: distances 0.3 mm too long, deviation 4 mm, at
    most 9 mm off; amplitudes with a deviation of 31 %, where 200 kHz gives 0.2 mm and 2 %.
    """
    if how.frequency < sampling_rate / 2:
        return how
    return replace(how, template_cycles=None)


def process_arguments(how: Processing, rate: float) -> dict[str, Any]:
    """Return what :func:`process` takes for a processing at a sampling rate in Hz."""
    cycles = how.template_cycles
    return {
        "pulse_duration": how.pulse_cycles / how.frequency,
        "offset_cutoff": how.offset_cutoff,
        "gain": how.gain,
        "template": None if cycles is None else template(rate, how.frequency, cycles),
        "cutoff": how.cutoff,
        "prominence": how.prominence,
        "nearest": how.nearest,
        "farthest": how.farthest,
        "send_shift": how.send_shift,
    }
