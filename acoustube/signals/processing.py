"""Settings of the processing from pressure to distance.

The sleeve paper: "Wearable, Fabric-Embedded Acoustic Waveguides for Meter-Scale Contact
Localization and Force Sensing".
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from acoustube.base.checks import (
    CYCLES,
    FREQUENCY,
    LENGTH,
    RATE,
    Instance,
    Optional,
    check_fields,
    checked,
)
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.signals.compression import WINDOW, chirp_template
from acoustube.signals.filters import (
    OFFSET_CUTOFF,
    TEMPLATE_CYCLES,
    TimeGain,
    template,
)

TEMPLATE = Number(1, CYCLES.high, "cycles")
"""Rule for the length of the matched filter: a shorter one may have no sample but zeros."""


@dataclass(frozen=True, kw_only=True)
class Processing:
    """Settings of the processing of recorded cycles to distances.

    The defaults are those of the sleeve paper (section II-B).

    Attributes
    ----------
    frequency : float
        Carrier frequency in Hz.
    pulse_cycles : float
        Duration of the send pulse in carrier cycles.
    offset_cutoff : float or None
        Cut-off frequency in Hz of the high-pass that removes the offset; None for no removal.
    gain : TimeGain or None
        Attenuation model of the time gain, from a calibration; None for no time gain.
    template_cycles : float or None
        Length of the matched filter in carrier cycles; None for no matched filter.
    bandwidth : float or None
        Bandwidth in Hz of a linear chirp about `frequency` that lasts `pulse_cycles` periods of it.
        The chirp is compressed: its complex matched filter replaces the template, the rectifier and
        the low-pass. None for a burst.
    window : str
        Weighting of the chirp's template: ``rectangular``, ``hann`` or ``hamming``.
    cutoff : float
        Cut-off frequency in Hz of the envelope's low-pass.
    prominence : float
        Least prominence of an echo, relative to the send pulse.
    nearest, farthest : float
        Limits of the search window in m from the source end.
    send_shift : float
        Time in s that a calibration adds to the time of the send pulse.

    Raises
    ------
    ConfigError
        If a value is outside its range, or `nearest` is not below `farthest`.
    """

    frequency: float = 42e3
    pulse_cycles: float = 11.0
    offset_cutoff: float | None = OFFSET_CUTOFF
    gain: TimeGain | None = None
    template_cycles: float | None = TEMPLATE_CYCLES
    bandwidth: float | None = None
    window: str = "hann"
    cutoff: float = 10e3
    prominence: float = 0.01
    nearest: float = 0.15
    farthest: float = 2.15
    send_shift: float = 0.0

    def __post_init__(self) -> None:
        """Raise if a value is out of range, or the search window is empty."""
        check_fields(
            self, frequency=FREQUENCY, pulse_cycles=CYCLES, cutoff=FREQUENCY,
            prominence=Number(1e-12, 1e6), nearest=Number(-1e3, 1e6, "m"),
            farthest=LENGTH, send_shift=Number(-1, 1, "s"), offset_cutoff=Optional(FREQUENCY),
            template_cycles=Optional(TEMPLATE), gain=Optional(Instance((TimeGain,))),
            bandwidth=Optional(FREQUENCY), window=WINDOW,
        )  # fmt: skip
        if self.nearest >= self.farthest:
            raise ConfigError(
                f"is not below farthest = {self.farthest:g} m", setting="nearest",
                value=self.nearest, unit="m", advice="give a search window that is not empty",
            )  # fmt: skip


@checked(settings=Processing, sampling_rate=RATE)
def without_aliased_template(settings: Processing, sampling_rate: float) -> Processing:
    """Return settings without matched filter if the carrier is aliased at a sampling rate.

    Parameters
    ----------
    settings : Processing
    sampling_rate : float
        Of the cycles, in Hz.

    Returns
    -------
    Processing
        `settings` without the matched filter if the carrier is at the Nyquist frequency or above,
        else `settings`. Those of a chirp are returned unchanged:
        :func:`acoustube.signals.chirp_template` refuses a band that reaches the Nyquist frequency.

    Notes
    -----
    EchoTube's board samples a 42 kHz carrier at 80 kHz, which aliases it to 80 - 42 = 38 kHz. This
    is so close to the Nyquist frequency that the samples are a beat of 2 kHz with alternating
    signs. The beat has the phase of the carrier, which changes by 2 pi with every 4 mm of distance.
    A template at 38 kHz is such a beat too, with a phase of its own: it shifts the peak by the
    difference of both (on echoes of 11 cycles in 1750 mm of tube, a standard deviation of 7 mm, at
    most 13 mm).

    Rectification and low-pass do not depend on the phase and remain. They lose accuracy: the
    rectified carrier's overtone at 84 kHz is aliased to 4 kHz, below the usual cut-off. Measured on
    those echoes: distances 0.3 mm too long, standard deviation 4 mm, at most 9 mm; amplitudes with
    a standard deviation of 31 %, compared with 0.2 mm and 2 % at 200 kHz.
    """
    if settings.frequency < sampling_rate / 2 or settings.bandwidth is not None:
        return settings
    return replace(settings, template_cycles=None)


def process_arguments(settings: Processing, rate: float) -> dict[str, Any]:
    """Return the keyword arguments of :func:`acoustube.signals.process` for settings.

    Parameters
    ----------
    settings : Processing
    rate : float
        Sampling rate in Hz.

    Returns
    -------
    dict
    """
    return {
        "pulse_duration": settings.pulse_cycles / settings.frequency,
        "offset_cutoff": settings.offset_cutoff,
        "gain": settings.gain,
        "template": _template_of(settings, rate),
        "cutoff": settings.cutoff,
        "prominence": settings.prominence,
        "nearest": settings.nearest,
        "farthest": settings.farthest,
        "send_shift": settings.send_shift,
    }


def _template_of(settings: Processing, rate: float) -> Any:
    """Return the matched filter's template at a sampling rate in Hz; None without the filter."""
    if settings.bandwidth is not None:
        duration = settings.pulse_cycles / settings.frequency
        return chirp_template(
            rate, settings.frequency, settings.bandwidth, duration, settings.window
        )
    cycles = settings.template_cycles
    return None if cycles is None else template(rate, settings.frequency, cycles)
