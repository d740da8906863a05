"""What a rangefinder at the end of a tube records: from the tube's response to an ADC's counts.

A resonant transducer sends a burst into the tube and hears, through its own resonance again, what
comes back; it also hears its own ring-down. An amplifier, an ADC and slow disturbances make a
record of that. Each part can be switched off; :data:`IDEAL` has none of them.
"""

from acoustube.ranging.analogue import blockage, clutter, response
from acoustube.ranging.digitiser import digitise, record
from acoustube.ranging.rangefinder import IDEAL, Burst, Drive, Rangefinder

__all__ = [
    "IDEAL",
    "Burst",
    "Drive",
    "Rangefinder",
    "blockage",
    "clutter",
    "digitise",
    "record",
    "response",
]
