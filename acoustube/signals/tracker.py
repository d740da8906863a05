"""Processing of a stream of cycles, one after another."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from acoustube.base.checks import TIMES, Instance, Optional, check_argument
from acoustube.signals.localise import Ranging, locate
from acoustube.signals.processing import Processing


class Tracker:
    """Process a stream of cycles, each on its own.

    Parameters
    ----------
    time : array of shape (time,)
        Sampling times of every cycle in s; the pulse starts to leave the source end at 0.
    settings : Processing, optional
        As in :func:`locate`.

    Attributes
    ----------
    n_cycles, n_detections : int
        Number of cycles so far, and number of cycles with an echo.

    Raises
    ------
    ValueError
        As :func:`locate`; raised at construction, where a silent cycle is processed.

    Notes
    -----
    No state is kept between cycles: the results equal those of :func:`locate` on all cycles
    together, but for rounding.
    """

    def __init__(self, time: ArrayLike, settings: Processing | None = None):
        check_argument("time", time, TIMES)
        check_argument("settings", settings, Optional(Instance((Processing,))))
        self.time = np.asarray(time, dtype=float)
        self.settings = settings or Processing()
        self.n_cycles = self.n_detections = 0
        locate(self.time, np.zeros(self.time.shape), self.settings)

    def update(self, cycle: ArrayLike, temperature: float = 20.0) -> Ranging:
        """Return the distance of a press in the next cycle.

        Parameters
        ----------
        cycle : array of shape (time,)
            In any unit, integer or not, with its offset.
        temperature : float
            Of the air in degC.

        Returns
        -------
        Ranging
            Its arrays have no axis of cycles.

        Raises
        ------
        ValueError
            If the cycle does not have the shape of the time, or holds values that are not finite.
        """
        cycle = np.asarray(cycle)
        if cycle.shape != self.time.shape:
            raise ValueError(
                f"cycle has shape {cycle.shape} and time {self.time.shape}; give one cycle at a "
                "time, with the samples of the time axis"
            )
        ranging = locate(self.time, cycle, self.settings, temperature=temperature)
        self.n_cycles += 1
        self.n_detections += int(ranging.detected)
        return ranging
