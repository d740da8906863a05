"""A-weighted level of the sound that a rangefinder sends, relative to a steady tone of 1 kHz.

References
----------
* A-weighting: IEC 61672-1:2013, Electroacoustics: sound level meters, annex E.
"""

from __future__ import annotations

from math import ceil, log10

import numpy as np

from acoustube.base.checks import FREQUENCIES, checked
from acoustube.base.types import Array
from acoustube.ranging.analogue import sent_spectrum
from acoustube.ranging.drives import Burst, Chirp, Tones
from acoustube.ranging.rangefinder import Rangefinder

POLES = 20.598997, 107.65265, 737.86223, 12194.217
"""Frequencies in Hz of the weighting's poles."""
HEARD = 20e3
"""Highest audible frequency in Hz; sound above it is not counted."""
STEP = 10.0
"""Largest frequency step in Hz of the integral over the drive's spectrum."""
STEPS_PER_LINE = 4
"""Least number of frequency steps in the width of a spectral line, 1 / duration of the sound."""
BLOCK = 2000
"""Number of frequencies that are computed together."""


@checked(frequency=FREQUENCIES)
def a_weighting(frequency: Array) -> Array:
    """Return the factor of the A-weighting for sound pressures at frequencies in Hz, 1 at 1 kHz."""

    def factor(f: Array) -> Array:
        f = np.asarray(f, float) ** 2
        low, second, third, high = (pole**2 for pole in POLES)
        return np.asarray(
            high * f**2 / ((f + low) * np.sqrt((f + second) * (f + third)) * (f + high))
        )

    return np.asarray(factor(frequency) / factor(np.array(1e3)))


@checked(rangefinder=Rangefinder)
def audible_level(rangefinder: Rangefinder) -> float:
    """Return the equivalent continuous A-weighted level of the sent cycles in dB.

    Parameters
    ----------
    rangefinder : Rangefinder

    Returns
    -------
    float
        Relative to a steady tone of 1 kHz with the sound pressure of a steady drive of unit
        amplitude at the transducer's resonance. Sound above 20 kHz is inaudible and not counted.

    Notes
    -----
    The weighted spectrum of the sound is ``A E H``: A-weighting, spectrum of the drive after
    loudspeaker and microphone, and response of the resonator. By Parseval's theorem the mean square
    of the sound, one such pulse per cycle, is 2 ``cycle_rate`` times the integral of ``|A E H|^2``
    over frequencies above 0; the mean square of the tone is 1/2. A sum over frequency steps equals
    the integral if the steps are less than half the reciprocal of the sound's duration, which
    includes Q / f0 for the ringing of the resonance.
    """
    r = rangefinder
    # Sampling rate in Hz of a drive without a closed-form spectrum: enough for its carrier.
    rate = max(r.sampling_rate, 10 * HEARD, getattr(r.drive, "frequency", 0.0))
    lasting = r.drive.duration + r.quality_factor / r.resonance
    n = ceil(rate / min(STEP, 1 / (STEPS_PER_LINE * lasting)))
    step = rate / n
    f = np.arange(1, int(HEARD / step) + 1) * step
    in_blocks = isinstance(r.drive, Burst | Chirp | Tones)  # with a spectrum in closed form
    heard = 0.0
    for part in np.array_split(f, len(f) // BLOCK + 1) if in_blocks else [f]:
        sent = sent_spectrum(r, part.astype(complex), rate, n, 0.0)
        sent = sent * r.resonator(part.astype(complex))
        heard += float(np.sum((np.abs(sent) * a_weighting(part)) ** 2)) * step
    return 10 * log10(max(4 * r.cycle_rate * heard, 1e-30))
