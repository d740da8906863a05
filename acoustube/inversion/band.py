"""Frequency band in which the cycles of a rangefinder are inverted."""

from __future__ import annotations

from acoustube.ranging import Rangefinder
from acoustube.ranging.analogue import HALF_WIDTH

CHIRP_BAND = 0.6
"""Half width of the frequency band that is inverted, relative to the bandwidth of the drive. It
applies where this band is wider than that of :data:`acoustube.ranging.analogue.HALF_WIDTH`."""


def is_compressed(rangefinder: Rangefinder) -> bool:
    """Return whether echoes are compressed: bandwidth times duration of the drive exceeds 1."""
    drive = rangefinder.drive
    return getattr(drive, "bandwidth", 0.0) * drive.duration > 1


def half_width(rangefinder: Rangefinder) -> float:
    """Return half the width in Hz of the band in which a rangefinder's cycles are inverted."""
    drive = rangefinder.drive
    carrier = getattr(drive, "frequency", rangefinder.resonance)
    return max(HALF_WIDTH * carrier, CHIRP_BAND * getattr(drive, "bandwidth", 0.0))
