"""Signal processing from pressure to distance, shared by simulations and recordings.

The steps are those of "Wearable, Fabric-Embedded Acoustic Waveguides for Meter-Scale Contact
Localization and Force Sensing" (the sleeve paper): :func:`locate` for recordings (section II-B),
:func:`process` for simulated signals (section II-D), which need no matched filter and have no
offset. All functions take arrays of shape (..., time) and treat each cycle on its own.

Reading order: `filters` (from a cycle to its envelope), `compression` (template of a chirp),
`peaks` (send pulse and echoes), `processing` (settings), `time_of_flight` (distances by the speed
of sound), `localise` (distance of the strongest echo), `lead` (start of the send pulse in a
record), `tracker` (streams of cycles); `calibration` (from closures at known distances) and
`calibration_file`.
"""

from acoustube.base.moved import renamed
from acoustube.base.sampling import sampling_rate
from acoustube.signals.calibration import Calibration, calibrate
from acoustube.signals.calibration_file import load, save
from acoustube.signals.compression import chirp_template
from acoustube.signals.filters import (
    FILTER_ORDER,
    TimeGain,
    compensate,
    envelope,
    low_pass,
    matched_filter,
    normalise,
    rectify,
    remove_offset,
    template,
)
from acoustube.signals.lead import find_lead
from acoustube.signals.localise import Ranging, locate, process
from acoustube.signals.peaks import Echoes, find_echoes, send_pulse
from acoustube.signals.processing import Processing, without_aliased_template
from acoustube.signals.time_of_flight import blind_time, distance, speed_of_sound
from acoustube.signals.tracker import Tracker

__all__ = [
    "FILTER_ORDER",
    "Calibration",
    "Echoes",
    "Processing",
    "Ranging",
    "TimeGain",
    "Tracker",
    "blind_time",
    "calibrate",
    "chirp_template",
    "compensate",
    "distance",
    "envelope",
    "find_echoes",
    "find_lead",
    "load",
    "locate",
    "low_pass",
    "matched_filter",
    "normalise",
    "process",
    "rectify",
    "remove_offset",
    "sampling_rate",
    "save",
    "send_pulse",
    "speed_of_sound",
    "template",
    "without_aliased_template",
]

__getattr__ = renamed(__name__, {"suited": "without_aliased_template"})
