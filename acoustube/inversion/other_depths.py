"""Other depths of a press, at the same place, that give nearly the same echo.

Where the reflection rises and falls again with depth, as near closure of the lumen, two depths that
differ by millimetres may have nearly the same echo.
"""

from __future__ import annotations

import numpy as np

from acoustube.inversion.fit import Fits, maximise
from acoustube.inversion.model import ForwardModel
from acoustube.inversion.whitening import Weights
from acoustube.waves.scattering import Complex

STEP = 0.4e-3
"""Step in m between the depths that are tried."""
ITERATIONS = 8
"""Iterations from each of these depths; fewer if :func:`acoustube.inversion.fit.maximise` gives up
this starting point."""


def other_depths(model: ForwardModel, known: Fits, tools: tuple[int, ...], samples: Complex,
                 whiten: Weights) -> Fits:  # fmt: skip
    """Return maxima of the likelihood that are found from other depths of each press.

    The depths tried are more than :data:`STEP` from that of the best fit; if the tool has no such
    depth, they are the ends of its range. All other parameters start at those of the best fit.

    Parameters
    ----------
    model : ForwardModel
    known : Fits
        Fits of the hypothesis, the best one first.
    tools : tuple of int
        Index of the tool of each press in the model's tables.
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
    return maximise(model, tools, np.concatenate(starts), samples, whiten, ITERATIONS, known)
