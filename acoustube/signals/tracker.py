"""The processing of one cycle after another, as a board sends them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from acoustube.signals.localise import Ranging, locate
from acoustube.signals.processing import Processing


class Tracker:
    """Process a stream of cycles, each on its own.

    Parameters
    ----------
    time : array of shape (time,)
        Sampling times of every cycle in s; the pulse starts to leave the source end at 0.
    how : Processing, optional
        As :func:`locate`.

    Attributes
    ----------
    n_cycles, n_detections : int
        Cycles so far, and how many of them held an echo.

    Raises
    ------
    ValueError
        As :func:`locate`, at once and not with the first cycle: a silent one is tried.

    Notes
    -----
    Nothing is remembered of a cycle, so that the results are those of :func:`locate` on all cycles
    together, to rounding.
    """

    def __init__(self, time: ArrayLike, how: Processing | None = None):
        self.time = np.asarray(time, dtype=float)
        self.how = how or Processing()
        self.n_cycles = self.n_detections = 0
        locate(self.time, np.zeros(self.time.shape), self.how)

    def update(self, cycle: ArrayLike, temperature: float = 20.0) -> Ranging:
        """Find the distance of a press in the next cycle.

        Parameters
        ----------
        cycle : array of shape (time,)
            In any unit, whole numbers or not, offset and all.
        temperature : float
            Of the air in degC.

        Returns
        -------
        Ranging
            Its arrays without the axis of cycles.

        Raises
        ------
        ValueError
            If it is not one cycle of the tracker's time, or holds values that are not finite.
        """
        cycle = np.asarray(cycle)
        if cycle.shape != self.time.shape:
            raise ValueError(
                f"cycle has shape {cycle.shape} and time {self.time.shape}; give one cycle at a "
                "time, of as many samples as the time has"
            )
        ranging = locate(self.time, cycle, self.how, temperature=temperature)
        self.n_cycles += 1
        self.n_detections += int(ranging.detected)
        return ranging
