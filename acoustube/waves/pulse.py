"""The excitation: a sine of a few cycles under a Gaussian envelope."""

from __future__ import annotations

from dataclasses import dataclass
from math import log, pi, sqrt

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True, kw_only=True)
class Pulse:
    """A Gaussian-modulated sine of unit amplitude; call it with times in s.

    Attributes
    ----------
    frequency : float
        Carrier frequency f in Hz.
    cycles : float
        Length of the window in carrier cycles.

    Notes
    -----
    s(t) = exp(-(t - T/2)^2 / (2 sigma^2)) sin(2 pi f (t - T/2)) for 0 <= t <= T = cycles / f, else
    0, with sigma = T/6: the window holds +-3 sigma and cuts the envelope at 1.1 %. With a whole
    number of cycles the carrier vanishes there, so the signal is continuous.
    """

    frequency: float
    cycles: float = 11.0

    def __post_init__(self) -> None:
        """Refuse pulses that do not exist."""
        for name in ("frequency", "cycles"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} = {getattr(self, name)} must be positive")

    @property
    def duration(self) -> float:
        """Length of the window in s."""
        return self.cycles / self.frequency

    @property
    def sigma(self) -> float:
        """Standard deviation of the Gaussian envelope in s, a sixth of the duration."""
        return self.duration / 6.0

    def __call__(self, time: ArrayLike) -> NDArray[np.float64]:
        """Return the pulse at times in s, with unit peak envelope."""
        since_centre = np.asarray(time, dtype=float) - 0.5 * self.duration
        envelope = np.exp(-0.5 * (since_centre / self.sigma) ** 2)
        carrier = np.sin(2.0 * pi * self.frequency * since_centre)
        return np.where(np.abs(since_centre) <= 0.5 * self.duration, envelope * carrier, 0.0)

    def band(self, level: float = -20.0) -> tuple[float, float]:
        """Return where the spectrum falls to a level.

        Parameters
        ----------
        level : float
            In dB below the spectrum's peak, negative.

        Returns
        -------
        lowest, highest : float
            Frequencies in Hz. The spectrum is exp(-(2 pi sigma (f - f0))^2 / 2), the cut of the
            envelope neglected.
        """
        if not level < 0.0:
            raise ValueError(f"level = {level} dB must be negative")
        nepers = -level * log(10.0) / 20.0
        half_width = sqrt(2.0 * nepers) / (2.0 * pi * self.sigma)
        return max(self.frequency - half_width, 0.0), self.frequency + half_width
