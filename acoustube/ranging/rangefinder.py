"""Parameters of a rangefinder, with units and the source of each default.

The sleeve paper: "Wearable, Fabric-Embedded Acoustic Waveguides for Meter-Scale Contact
Localization and Force Sensing".

References
----------
* Data sheet: MaxBotix, LV-MaxSonar-EZ1 (MB1010).
* Reference manual: Texas Instruments, AM335x: the converter of the BeagleBone Black.
* EchoTube: ISS 2019. doi:10.1145/3343055.3359712
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from math import sqrt
from typing import Any

import numpy as np

from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number, Section, setting
from acoustube.ranging.drives import Burst, Chirp, Tones
from acoustube.waves.scattering import Complex
from acoustube.waves.scheme.pulse import Pulse, SampledPulse

Drive = Burst | Chirp | Tones | Pulse | SampledPulse


@dataclass(frozen=True)
class _Kind:
    """Rule of a setting that is not a plain number; see :class:`~acoustube.base.rules.Number`."""

    fits: Callable[[Any], bool]
    allowed: str
    read: Callable[[Any], Any] = lambda value: value

    def check(self, name: str, value: Any) -> Any:
        value = self.read(value)
        if not self.fits(value):
            raise ConfigError(
                "is invalid", setting=name, value=repr(value), advice=f"use {self.allowed}"
            )
        return value


def _complex(value: Any) -> Any:
    """Return [real, imaginary], as in files, as a complex number; any other value unchanged."""
    if isinstance(value, list | tuple) and len(value) == 2:
        parts = [isinstance(part, int | float) and not isinstance(part, bool) for part in value]
        return complex(*value) if all(parts) else value
    return value


DRIVE = _Kind(
    lambda value: isinstance(value, Drive), "a Burst, a Chirp, Tones, a Pulse or a SampledPulse"
)
FLAG = _Kind(lambda value: isinstance(value, bool), "True or False")
FACE = _Kind(
    lambda value: isinstance(value, int | float | complex) and abs(value) <= 1 and value != -1,
    "a number, real or complex as [real, imaginary], of magnitude 0 to 1, but not -1: at such a "
    "face the pressure is zero",
    _complex,
)


@dataclass(frozen=True, kw_only=True)
class Rangefinder(Section):
    """Transducer and electronics at the end of a tube; defaults of the sleeve paper's board.

    Attributes
    ----------
    drive : Burst, Chirp, Tones, Pulse or SampledPulse
        Drive of the transducer, of unit amplitude. Default: 13 cycles of 42 kHz (data sheet).
    resonance : float
        Resonance frequency of the transducer in Hz. Default 42 kHz (data sheet).
    quality_factor : float
        Quality factor: resonance frequency over bandwidth at -3 dB; 0 for a flat response. Default
        14 (3 kHz), chosen: usual for such transducers; the data sheet does not state it.
    low_corner, high_corner : float
        Corner frequencies in Hz of a second-order Butterworth high-pass and low-pass in the path of
        the drive, for a loudspeaker in a closed box and the band of a microphone; 0 for none.
        Default 0.
    send : float
        Voltage in V that the transducer receives from its own steady drive at resonance, far over
        full scale. Default 170, chosen so that a press with a reflection coefficient of 0.2 has a
        separate peak at distances of 16 cm and more, and not nearer: the dead zone of the sleeve
        paper and of EchoTube, 6 inches in the data sheet.
    gain : float
        Voltage in V received from a steady drive that a lossless tube reflects completely. Default
        1.25, chosen so that the echo amplitude as a function of distance, a tanh in the sleeve
        paper's calibration, has nearly the published asymptotes: 0.64 and 0.11 where 0.635 and
        0.104 are published.
    face_reflection : complex
        Pressure reflection coefficient of the transducer's face. Default 0.3, chosen: no second
        echo of a press is reported.
    far_reflection : float
        Pressure reflection coefficient of the tube's far end. Default 0.05 for foam, chosen:
        no echo of it is reported.
    clutter : float
        Power reflected by small irregularities per length of tube in 1/m. Default 1.5e-5 (-48 dB),
        chosen so that up to 0.6 m presses of a 25 mm rod are detected at depths of 2.5 mm and more
        and rarely below; the sleeve paper states 2.5 mm.
    noise : float
        Thermal noise at the ADC in V, rms, white up to half the sampling rate. Default 0.1 mV (0.2
        counts, less than their rounding), chosen so that beyond 1.95 m only a rod that closes the
        lumen is detected: the sleeve paper detects depths over 7 mm there. A closure is then
        detected up to 2.4 m; EchoTube reaches 2.4 to 2.5 m in a bore of 8 mm.
    offset : float
        Mean voltage in V. Default 0.9, chosen: the middle of the ADC's range.
    drift : float
        Slow drift of the offset in V, rms, over 10 s to 1000 s. Default 5 mV, chosen.
    sampling_rate : float
        Samples per second. Default 200 kHz (sleeve paper).
    n_samples : int
        Samples per cycle. Default 4000 (sleeve paper).
    bits : int
        Resolution of the ADC. Default 12 (sleeve paper).
    full_scale : float
        Voltage in V of 2**bits counts. Default 1.8 (reference manual).
    quantised : bool
        True for integer counts clipped at both ends of the scale. Default True.
    cycle_rate : float
        Cycles per second. Default 20 (sleeve paper).
    jitter : float
        Standard deviation of the trigger's delay from cycle to cycle in s. Default 0.
    gain_wander : float
        Relative standard deviation of the gain from cycle to cycle. Default 0.
    lead : float
        Time in s recorded before the drive starts. Default 0, chosen.
    temperature_bias, temperature_noise : float
        Mean and standard deviation of the reported temperature's error in K. Defaults 0.5 and 0.1,
        chosen: those of a simple semiconductor sensor. 0.5 K changes distances by 0.09 %.
    temperature_resolution : float
        Step of the reported temperature in K; 0 for none. Default 0.1, chosen.

    Raises
    ------
    ConfigError
        If a value is outside its range, or `low_corner` is not below `high_corner`.
    """

    drive: Drive = field(default=Burst(), metadata={"rule": DRIVE})
    resonance: float = setting(42e3, Number(1e3, 1e6, "Hz", "resonance of the transducer"))
    quality_factor: float = setting(14.0, Number(0, 1e3, "", "0 for a flat transducer"))
    low_corner: float = setting(0.0, Number(0, 1e6, "Hz", "corner of the high-pass; 0 for none"))
    high_corner: float = setting(0.0, Number(0, 1e6, "Hz", "corner of the low-pass; 0 for none"))
    send: float = setting(170.0, Number(0, 1e6, "V", "received level of the direct drive"))
    gain: float = setting(1.25, Number(0, 1e6, "V", "received level of a complete reflection"))
    face_reflection: complex = field(default=0.3, metadata={"rule": FACE})
    far_reflection: float = setting(0.05, Number(-1, 1, "", "reflection of the far end"))
    clutter: float = setting(1.5e-5, Number(0, 0.1, "1/m", "power reflected per metre"))
    noise: float = setting(0.1e-3, Number(0, 1e3, "V", "rms of the noise"))
    offset: float = setting(0.9, Number(-1e3, 1e3, "V", "mean voltage"))
    drift: float = setting(5e-3, Number(0, 1e3, "V", "rms of the slow drift"))
    sampling_rate: float = setting(200e3, Number(1e3, 1e8, "Hz", "samples per second"))
    n_samples: int = setting(4000, Number(16, 1e6, "", "samples of a cycle", whole=True))
    bits: int = setting(12, Number(1, 16, "", "bits of the ADC", whole=True))
    full_scale: float = setting(1.8, Number(1e-6, 1e6, "V", "voltage of 2**bits counts"))
    quantised: bool = field(default=True, metadata={"rule": FLAG})
    cycle_rate: float = setting(20.0, Number(1e-3, 1e5, "Hz", "cycles per second"))
    jitter: float = setting(0.0, Number(0, 1e-3, "s", "rms of the trigger's delay"))
    gain_wander: float = setting(0.0, Number(0, 1, "", "relative rms of the gain"))
    lead: float = setting(0.0, Number(0, 1, "s", "time before the drive"))
    temperature_bias: float = setting(0.5, Number(-50, 50, "K", "mean error of temperature"))
    temperature_noise: float = setting(0.1, Number(0, 50, "K", "random error of temperature"))
    temperature_resolution: float = setting(0.1, Number(0, 50, "K", "step of the temperature"))

    def __post_init__(self) -> None:
        """Validate the values and the order of the corners."""
        super().__post_init__()
        if 0 < self.high_corner <= self.low_corner:
            raise ConfigError(
                f"is not below high_corner = {self.high_corner:g} Hz", setting="low_corner",
                value=self.low_corner, advice="give a lower frequency, or 0 for none",
            )  # fmt: skip

    def resonator(self, frequency: Complex) -> Complex:
        """Return the transducer's response at frequencies in Hz, real or complex, not zero.

        A second-order band-pass, 1 / (1 + j Q (f/f0 - f0/f)): it rings as exp(-pi f0 t / Q).
        """
        off = frequency / self.resonance - self.resonance / frequency
        return 1 / (1 + 1j * self.quality_factor * off)

    def passband(self, frequency: Complex) -> Complex:
        """Return the response of loudspeaker and microphone together at frequencies in Hz.

        Butterworth filters of second order, 1 / (1 + sqrt(2) s + s^2), with s = j f / f_high of the
        low-pass and s = f_low / (j f) of the high-pass.
        """
        f = np.asarray(frequency)
        found = np.ones(f.shape, complex)
        if self.high_corner > 0:
            s = 1j * f / self.high_corner
            found /= 1 + sqrt(2) * s + s**2
        if self.low_corner > 0:
            s = self.low_corner / (1j * f)
            found /= 1 + sqrt(2) * s + s**2
        return found

    def to_json(self) -> str:
        """Return all parameters as JSON, complex numbers as [real, imaginary]."""

        def plain(value: Any) -> Any:
            return [value.real, value.imag] if isinstance(value, complex) else value.tolist()

        kind = {"kind": type(self.drive).__name__}
        words = dataclasses.asdict(self)
        return json.dumps(words | {"drive": kind | words["drive"]}, default=plain)


IDEAL = Rangefinder(
    drive=Pulse(frequency=42e3), quality_factor=0.0, send=0.9, gain=0.9, face_reflection=0.0,
    far_reflection=0.0, clutter=0.0, noise=0.0, offset=0.0, drift=0.0, quantised=False,
    temperature_bias=0.0, temperature_noise=0.0, temperature_resolution=0.0,
)  # fmt: skip
"""Ideal sensor: unquantised counts, in which a complete reflection has the amplitude of the drive.

Its drive is the band-limited pulse of the sleeve paper's simulations.
"""

LOUDSPEAKER = Rangefinder(
    drive=Chirp(frequency=9e3, bandwidth=12e3, duration=1e-3), quality_factor=0.0, low_corner=1e3,
    high_corner=18e3, send=0.75, gain=0.975, resonance=9e3,
)  # fmt: skip
"""A small loudspeaker with a microphone beside it; all other parameters are the defaults.

The chosen corners are those of a loudspeaker of 15 mm in a closed box and of a MEMS microphone.
The amplifier is set so that the drive, as the microphone receives it, just does not clip (0.88 of
0.9 V). Since the microphone receives launched and returning sound alike, `gain` is `send` times
(1 + the face's reflection coefficient).
"""
