"""Data of one cycle for the tracking of contacts, and the record of each tracked contact."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from acoustube.waves.scattering import Complex


class Cycle(NamedTuple):
    """Baseband of one cycle, and its noise.

    Attributes
    ----------
    number : int
        Number of earlier cycles with a search.
    samples : ndarray
        Baseband in counts, (n_time,).
    noise : float
        Variance of the noise of a sample, in counts squared.
    search : bool
        Whether contacts that appear or disappear, and other maxima of the likelihood, are sought.
    """

    number: int
    samples: Complex
    noise: float
    search: bool = True


@dataclass
class Known:
    """Number, odds and age of a tracked contact, apart from its position, depth and velocities.

    Attributes
    ----------
    number : int
        Number of the contact, from 0 in the order of appearance.
    log_odds : float
        Logarithm of the odds that the contact is real.
    age : int
        Age in cycles with a search.
    faint : int
        Number of tests in a row in which the depth exceeded the library's least depth by less than
        `FAINT` of :mod:`acoustube.inversion.tracks`.
    """

    number: int
    log_odds: float
    age: int = 0
    faint: int = 0

    @property
    def probability(self) -> float:
        """Probability that the contact is real."""
        return float(1 / (1 + np.exp(-self.log_odds)))
