"""Candidates of a design: sensors with their predicted errors, and the choices of electronics."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from acoustube.base.types import Array
from acoustube.base.units import CM, KHZ, MM, PERCENT
from acoustube.inversion.band import CHIRP_BAND
from acoustube.inversion.design import Prediction
from acoustube.ranging import LOUDSPEAKER, Burst, Chirp, Rangefinder, audible_level
from acoustube.runs.config.goal import LEAST_RATE, DesignGoal
from acoustube.runs.design.tubes import TubeSpec

LEAST_PRODUCT = 3.0
"""Least product of duration and bandwidth of a chirp; with a smaller one it is almost a burst."""


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A sensor and its predicted errors.

    Attributes
    ----------
    tube : TubeSpec
    rangefinder : Rangefinder
    ends : int
        Number of ends of the tube with a rangefinder.
    found : Prediction
        Predicted errors.
    score : float
        Logarithm of the relative rms error of force, with penalties for missed requirements of the
        goal; lower is better.
    """

    tube: TubeSpec
    rangefinder: Rangefinder
    ends: int
    found: Prediction
    score: float

    @property
    def objectives(self) -> Array:
        """Reach, relative rms error of force, resolution, median error of position; in SI, (4,).

        The resolution is the least distance of two presses at which their echoes are separate.
        """
        return np.append(self.found.objectives, np.median(self.found.place))

    def shortfalls(self, design: DesignGoal) -> list[str]:
        """Return in words the requirements that are missed, with actual and required value."""
        goal, (reach, _, resolution, place) = design.goal, self.objectives
        found, nearest = [], float(self.found.nearest)
        for name, short, scale, unit, value, asked in (
            ("reach", reach < goal.reach_m, 1.0, "m", reach, goal.reach_m),
            ("resolution", resolution > goal.separation, CM, "cm", resolution, goal.separation),
            ("place", place > goal.place_deviation, MM, "mm", place, goal.place_deviation),
            ("nearest press", nearest > goal.nearest_m, CM, "cm", nearest, goal.nearest_m),
        ):
            if short:
                found.append(f"{name} {scale * value:.4g} {unit} (goal {scale * asked:.4g})")
        return found

    @property
    def transducer(self) -> str:
        """Kind of transducer, from :data:`acoustube.runs.config.goal.TRANSDUCERS`."""
        return "loudspeaker" if self.rangefinder.high_corner > 0 else "resonant"

    @property
    def row(self) -> dict[str, Any]:
        """Row of front.csv: the sensor and its objectives, in the units that the names state."""
        r, (reach, force, resolution, place) = self.rangefinder, self.objectives
        assert isinstance(r.drive, Burst | Chirp)
        return {
            "bore_mm": self.tube.bore, "wall_mm": self.tube.wall,
            "hardness_shore_a": round(self.tube.shore, 1),
            "carrier_khz": round(KHZ * r.resonance, 3), "cycles": round(
                r.drive.duration * r.drive.frequency, 2),
            "bandwidth_khz": round(KHZ * r.drive.bandwidth, 3), "transducer": self.transducer,
            "quality_factor": r.quality_factor, "rate_khz": KHZ * r.sampling_rate,
            "bits": r.bits, "ends": self.ends, "reach_m": round(float(reach), 3),
            "force_percent": round(PERCENT * float(force), 3),
            "force_median_percent": round(PERCENT * float(np.median(self.found.force)), 3),
            "resolution_cm": round(CM * float(resolution), 2),
            "place_mm": round(MM * float(place), 3),
            "nearest_cm": round(CM * float(self.found.nearest), 1),
            "audible_db": round(audible_level(r), 1),
            "wrong_half_wave_percent": round(PERCENT * float(
                np.average(self.found.wrong, weights=self.found.found + 1e-9)), 2),
            "detected_percent": round(PERCENT * float(np.mean(self.found.found)), 2),
        }  # fmt: skip


class Choice(NamedTuple):
    """Electronics of a sensor, except carrier and cycles.

    Attributes
    ----------
    transducer : str
        Kind of transducer, from :data:`acoustube.runs.config.goal.TRANSDUCERS`.
    quality : float
        Quality factor; 0 for a loudspeaker.
    bandwidth : float
        Bandwidth of a chirp in Hz; 0 for a burst.
    rate : float
        Sampling rate in Hz.
    bits : int
        Resolution of the converter.
    ends : int
        Number of ends of the tube with a rangefinder.
    """

    transducer: str
    quality: float
    bandwidth: float
    rate: float
    bits: int
    ends: int


def choices_of(design: DesignGoal) -> list[Choice]:
    """Return all combinations of electronics in a goal; a loudspeaker has no quality factor."""
    free = design.variables
    made = itertools.product(
        free.transducer, free.quality_factor, free.bandwidths, free.rates, free.bits, free.ends
    )
    found = (Choice(*one) for one in made)
    return list(dict.fromkeys(
        one._replace(quality=0.0) if one.transducer == "loudspeaker" else one for one in found
    ))  # fmt: skip


def choice_of(candidate: Candidate) -> Choice:
    """Return the electronics of a candidate, except carrier and cycles."""
    r = candidate.rangefinder
    assert isinstance(r.drive, Burst | Chirp)
    return Choice(
        candidate.transducer, r.quality_factor, r.drive.bandwidth, r.sampling_rate, r.bits,
        candidate.ends,
    )  # fmt: skip


def rangefinder_of(
    design: DesignGoal, carrier: float, cycles: float, choice: Choice
) -> Rangefinder:
    """Return a rangefinder with a carrier in Hz, a number of cycles, and chosen electronics.

    Other parameters are those of the default rangefinder or of
    :data:`acoustube.ranging.rangefinder.LOUDSPEAKER`.
    """
    duration = float(cycles) / float(carrier)
    samples = design.goal.samples_at(choice.rate, duration)
    usual = LOUDSPEAKER if choice.transducer == "loudspeaker" else Rangefinder()
    drive: Burst | Chirp = Burst(frequency=float(carrier), cycles=float(cycles))
    if choice.bandwidth > 0:
        drive = Chirp(
            frequency=float(carrier), bandwidth=float(choice.bandwidth), duration=duration
        )
    return replace(
        usual, drive=drive, resonance=float(carrier), quality_factor=float(choice.quality),
        sampling_rate=float(choice.rate), bits=int(choice.bits), n_samples=max(samples, 512),
    )  # fmt: skip


def suits(carrier: float, cycles: float, choice: Choice) -> bool:
    """Return whether electronics suit a carrier in Hz and a number of cycles.

    The band must lie below half the sampling rate, and a chirp's product of duration and bandwidth
    be at least :data:`LEAST_PRODUCT`.
    """
    highest = max(LEAST_RATE / 2 * carrier, carrier + CHIRP_BAND * choice.bandwidth)
    chirped = choice.bandwidth * cycles / carrier
    return highest <= choice.rate / 2 * (1 + 1e-9) and (not chirped or chirped >= LEAST_PRODUCT)
