"""Parameter vectors of presses, their bounds, and the prior odds of a press.

A vector has 2 n_presses + 7 components: place and depth in m of each press in turn, then the seven
nuisance parameters of :data:`acoustube.inversion.model.NUISANCES`.
"""

from __future__ import annotations

import numpy as np

from acoustube.base.types import Array
from acoustube.inversion.model import NUISANCES, ForwardModel

LARGEST_STEPS = 1.5e-3, 4e-4
"""Largest changes of place and depth in m in one iteration of a fit."""
CLOSEST = 0.03
"""Smallest distance allowed between two presses in m. The parts of the tube that two presses deform
overlap up to about twice this distance."""
PRESS_COSTS = 2 * np.log([1e4, 1e9, 1e12])
"""Minus twice the logarithms of the prior odds of a first press, a second, and each further one:
1e-4, 1e-9 and 1e-12. The likelihood takes errors of the model as independent between samples. The
data alone therefore give odds of 1e6 to 1e8 to a false detection far behind a press whose trapped
sound differs from the model's, or 1e11 if it is a third press. They gave odds of at least 1e14 to a
real second press, in 20 cycles with two presses."""


def split(parameters: Array) -> tuple[Array, Array, Array]:
    """Return views of parameter vectors: places, depths (n, n_presses) and nuisances (n, 7)."""
    m = (parameters.shape[1] - len(NUISANCES)) // 2
    return parameters[:, : 2 * m : 2], parameters[:, 1 : 2 * m : 2], parameters[:, 2 * m :]


def joined(places: Array, depths: Array, nuisances: Array) -> Array:
    """Return parameter vectors from places, depths (n, n_presses) and nuisances (n, 7)."""
    presses = np.stack([places, depths], axis=-1).reshape(len(places), -1)
    return np.concatenate([presses, nuisances], axis=1)


def bounded(model: ForwardModel, tools: tuple[int, ...], parameters: Array) -> Array:
    """Return a copy of parameter vectors within bounds, (n, 2 n_presses + 7).

    Places and depths are clipped to the ranges of the model, nuisances to six prior standard
    deviations, and the bore also to the range of the tables, but not away from 0. Then places are
    raised until successive presses are :data:`CLOSEST` apart, if necessary beyond the far end of
    their range.
    """
    places, depths, nuisances = split(np.array(parameters))
    for i, tool in enumerate(tools):
        places[:, i] = np.clip(places[:, i], *model.span)
        if i:
            places[:, i] = np.maximum(places[:, i], places[:, i - 1] + CLOSEST)
        depths[:, i] = np.clip(depths[:, i], *model.tables[tool].range)
    limit = 6 * model.priors.deviations
    nuisances = np.clip(nuisances, -limit, limit)
    low, high = (end - nuisances[:, -2] for end in model.stretches)
    nuisances[:, -1] = np.clip(nuisances[:, -1], np.minimum(low, 0.0), np.maximum(high, 0.0))
    return joined(places, depths, nuisances)


def limited(step: Array) -> Array:
    """Return a copy of changes of parameters, places and depths clipped to `LARGEST_STEPS`."""
    found = step.copy()
    m = (step.shape[1] - len(NUISANCES)) // 2
    for i, largest in enumerate(LARGEST_STEPS):
        found[:, i : 2 * m : 2] = np.clip(found[:, i : 2 * m : 2], -largest, largest)
    return found


def cost_of_press(number: int) -> float:
    """Return minus twice the logarithm of the prior odds of press number 1, 2 and so on."""
    return float(PRESS_COSTS[min(number, len(PRESS_COSTS)) - 1])


def least_gain(number: int) -> float:
    """Return the decrease of minus twice the log likelihood that is required of a candidate.

    It compensates the prior odds of the press with that `number`, counted from 1. From the third
    press on, the odds of the second are used: the decrease expected of a candidate does not include
    a refit of the known presses.
    """
    return cost_of_press(min(number, 2))
