"""Model of a rangefinder at the end of a tube, from the tube's response to ADC counts.

A resonant transducer sends a burst into the tube and receives the echoes through the same
resonance, after its own ring-down. Noise, drift and the ADC follow. Each part can be switched off;
:data:`IDEAL` has none of them.

Reading order: `drives` (bursts, chirps and tones, and their spectra), `rangefinder` (parameters),
`analogue` (voltage before the converter), `digitiser` (noise, drift and counts of many cycles) and
`audibility` (A-weighted level of the sound that is sent).
"""

from acoustube.ranging.analogue import blockage, clutter, response
from acoustube.ranging.audibility import a_weighting, audible_level
from acoustube.ranging.digitiser import digitise, record
from acoustube.ranging.drives import Burst, Chirp, Tones
from acoustube.ranging.rangefinder import IDEAL, LOUDSPEAKER, Drive, Rangefinder

__all__ = [
    "IDEAL",
    "LOUDSPEAKER",
    "Burst",
    "Chirp",
    "Drive",
    "Rangefinder",
    "Tones",
    "a_weighting",
    "audible_level",
    "blockage",
    "clutter",
    "digitise",
    "record",
    "response",
]
