"""Inputs of a track from a cycle, and the state of a contact that it keeps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from acoustube.waves.scattering import Complex


class Cycle(NamedTuple):
    """A cycle.

    Attributes
    ----------
    number : int
        From 0.
    samples : ndarray
        Baseband, (n_time,).
    noise : float
        Variance of its samples.
    """

    number: int
    samples: Complex
    noise: float


@dataclass
class Known:
    """Number, odds and age of a contact, besides its state.

    Attributes
    ----------
    number : int
    odds : float
        Logarithm of the odds that there is the contact.
    age : int
        In cycles.
    faint : int
        Tests since it was deeper than the library's first depth.
    """

    number: int
    odds: float
    age: int = 0
    faint: int = 0

    @property
    def probability(self) -> float:
        """Probability that there is the contact."""
        return float(1 / (1 + np.exp(-self.odds)))
