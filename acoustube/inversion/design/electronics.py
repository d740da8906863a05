"""Pulse, transducer and ADC of a sensor, and the energy spectrum of the recorded pulse."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import fresnel

from acoustube.base.errors import ConfigError
from acoustube.base.types import Array
from acoustube.base.units import KHZ
from acoustube.inversion.band import CHIRP_BAND, half_width
from acoustube.inversion.quantiser import common_rounding
from acoustube.ranging import Burst, Chirp, Rangefinder
from acoustube.ranging.analogue import HALF_WIDTH

BAND_EDGE, BAND_ROLL = 0.875, 0.084
"""Sigmoid over frequency in place of the tapers of the inversion's band: distance of its middle
from the carrier, and its width, both relative to half the width of the band."""
TUNED = 1e-3
"""Largest relative difference between the drive's frequency and the transducer's resonance."""


class Electronics(NamedTuple):
    """Pulse, transducer and converter, as scalars or as arrays of one shape.

    Attributes
    ----------
    carrier : float
        Frequency of drive and transducer in Hz.
    cycles : float
        Duration of the drive, a square burst or a chirp, in periods of the carrier.
    quality : float
        Quality factor of the transducer.
    level : float
        Amplitude received from a complete reflection of a steady drive, divided by the standard
        deviation of the noise in a sample of the averaged cycles.
    rate : float
        Samples per second.
    ring : float
        Received amplitude of the rangefinder's own drive divided by half of full scale; if less
        than 1, it is set to 1.
    ends : float
        Number of rangefinders, 1 or 2.
    bandwidth : float
        Bandwidth of a chirp in Hz; 0 for a burst.
    low_corner, high_corner : float
        Corner frequencies in Hz of the high-pass and of the low-pass of loudspeaker and microphone;
        0 for none.
    """

    carrier: float | Array
    cycles: float | Array
    quality: float | Array
    level: float | Array
    rate: float | Array
    ring: float | Array
    ends: float | Array
    bandwidth: float | Array = 0.0
    low_corner: float | Array = 0.0
    high_corner: float | Array = 0.0


def electronics_of(rangefinder: Rangefinder, ends: int = 1, average: int = 1) -> Electronics:
    """Return the electronics of a rangefinder with a square burst or plain chirp at its resonance.

    Parameters
    ----------
    rangefinder : Rangefinder
    ends : int
        Number of rangefinders, of which the second is at the far end.
    average : int
        Number of cycles whose mean is inverted.

    Raises
    ------
    ConfigError
        If the drive is neither of these, or not at the resonance of a resonant transducer.
    """
    r = rangefinder
    drive = _drive(r)
    noise = r.noise * 2**r.bits / r.full_scale
    variance = noise**2 / average
    if r.quantised:
        # Rounding that noise does not dither is an error within the band, the same in all cycles.
        share = min(2 * half_width(r) / (r.sampling_rate / 2), 1.0)
        common = common_rounding(noise)
        variance += (1 / 12 - common) / average + common / share
    level = r.gain * 2**r.bits / r.full_scale / np.sqrt(max(variance, 1e-12))
    return Electronics(
        drive.frequency, drive.duration * drive.frequency, r.quality_factor, level,
        r.sampling_rate, max(2 * r.send / r.full_scale, 1.0), ends, drive.bandwidth,
        r.low_corner, r.high_corner,
    )  # fmt: skip


def _drive(rangefinder: Rangefinder) -> Burst | Chirp:
    """Return the drive of a rangefinder, a square burst or a plain chirp at its resonance."""
    drive, resonance = rangefinder.drive, rangefinder.resonance
    square = isinstance(drive, Burst) and drive.shape == "square"
    plain = isinstance(drive, Chirp) and drive.window == "rectangular"
    if not isinstance(drive, Burst | Chirp) or not (square or plain):
        raise ConfigError(
            f"errors are not predicted for the drive {drive}; use a square Burst, or a Chirp with "
            "a rectangular window"
        )
    if rangefinder.quality_factor > 0 and abs(resonance / drive.frequency - 1) > TUNED:
        raise ConfigError(
            f"the drive has a frequency of {KHZ * drive.frequency:g} kHz and the transducer a "
            f"resonance of {KHZ * resonance:g} kHz; give equal ones, for which errors are predicted"
        )
    return drive


def spectrum(frequency, electronics):  # type: ignore[no-untyped-def]
    """Return the energy spectrum of a drive after both passages of its transducer, in s2, (n_f,).

    That of a square burst equals the squared :meth:`acoustube.ranging.Burst.spectrum` if it lasts a
    whole number of half periods, and is continuous in this number. That of a chirp excludes the
    part at negative frequencies.
    """
    one = Electronics(*electronics)
    carrier, cycles = one.carrier, one.cycles
    u = jnp.pi / 2 * (frequency / carrier - 1)
    near = jnp.abs(jnp.sin(u)) < 1e-7
    safe = jnp.where(near, 1.0, u)
    kernel = jnp.where(near, 2 * cycles, jnp.sin(2 * cycles * safe) / jnp.sin(safe))
    burst = (jnp.cos(u) * kernel / (jnp.pi * frequency)) ** 2
    drive = jnp.where(one.bandwidth > 0, _chirp(frequency - carrier, one), burst)
    off = frequency / carrier - carrier / frequency
    # Squared magnitudes of Butterworth filters of second order.
    high = jnp.where(one.high_corner > 0, one.high_corner, jnp.inf)
    passed = 1 / ((1 + (one.low_corner / frequency) ** 4) * (1 + (frequency / high) ** 4))
    return drive * passed / (1 + (one.quality * off) ** 2) ** 2


def _chirp(off, one):  # type: ignore[no-untyped-def]
    """Return the squared magnitude of a chirp's spectrum in s2, at offsets in Hz from its carrier.

    It is computed by Fresnel integrals, without the part at negative frequencies.
    """
    width = jnp.where(one.bandwidth > 0, one.bandwidth, 1.0)
    lasting = one.cycles / one.carrier
    scale = jnp.sqrt(2 * lasting / width)
    (s0, c0), (s1, c1) = (fresnel(scale * (side * width / 2 - off)) for side in (-1, 1))
    return ((c1 - c0) ** 2 + (s1 - s0) ** 2) * lasting / width / 8


def received(frequency, electronics):  # type: ignore[no-untyped-def]
    """Return :func:`spectrum`, tapered to the band of the inversion, in s2, (n_f,)."""
    one = Electronics(*electronics)
    half = jnp.maximum(HALF_WIDTH * one.carrier, CHIRP_BAND * one.bandwidth)
    sides = (BAND_EDGE - jnp.abs(frequency - one.carrier) / half) / BAND_ROLL
    return spectrum(frequency, electronics) * jax.nn.sigmoid(4 * sides)


def weight_of(frequency: Array, electronics: Electronics) -> Array:
    """Return the weight of each frequency in the Fisher information, (n_f,).

    It is the energy that the echo of a complete reflection has in the interval of each frequency,
    divided by the variance of a sample's noise.

    Parameters
    ----------
    frequency : ndarray
        In Hz, evenly spaced, (n_f,).
    electronics : Electronics
        Scalars.
    """
    step = frequency[1] - frequency[0]
    with jax.enable_x64(True):
        given = [jnp.asarray(float(one)) for one in electronics]
        heard = np.asarray(received(jnp.asarray(frequency), given))
    return np.asarray(2 * electronics.rate * step * electronics.level**2 * heard)
