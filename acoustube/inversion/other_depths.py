"""Other depths of a press at its place whose echo is much the same.

Where the reflection rises and falls again with depth, as that of a lumen near closure does, two
depths that are millimetres apart may sound alike.
"""

from __future__ import annotations

import numpy as np

from acoustube.inversion.fit import Fits, maximise
from acoustube.inversion.likelihood import Weights
from acoustube.inversion.model import ForwardModel
from acoustube.waves.scattering import Complex

STEP = 0.4e-3
"""Distance in m of the depths that are tried."""
FIRST, KEPT, THEN = 2, 3, 6
"""Iterations of all depths, number of those that are followed, and their iterations."""


def other_depths(model: ForwardModel, known: Fits, tools: tuple[int, ...], samples: Complex,
                 whiten: Weights) -> Fits:  # fmt: skip
    """Return the maxima that begin at other depths of each press, all else as at the best one.

    Parameters
    ----------
    model : ForwardModel
    known : Fits
        The best first.
    tools : tuple of int
        Number of the tool of each press.
    samples : ndarray
        Baseband of the cycles, (n_time,).
    whiten : Weights
    """
    starts = []
    for i, tool in enumerate(tools):
        low, high = model.tables[tool].range
        depths = np.linspace(low, high, 2 + int((high - low) / STEP))
        far = np.abs(depths - known.parameters[0, 2 * i + 1]) > STEP
        depths = depths[far] if far.any() else np.array([low, high])
        start = np.repeat(known.parameters[:1], len(depths), axis=0)
        start[:, 2 * i + 1] = depths
        starts.append(start)
    first = maximise(model, tools, np.concatenate(starts), samples, whiten, FIRST)
    best = first.sorted().first(KEPT)
    return maximise(model, tools, best.parameters, samples, whiten, THEN)
