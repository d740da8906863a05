"""How far the error of a basis exceeds what the next degrees change.

The estimate solves for the residual in the functions of the next degrees alone. Where the field's
coefficients fall slowly with the degree, as they do beside a narrow gap or over a wall from
finite elements, degrees beyond those change as much again. With energies that fall by a factor q
from one step of the degree to the next, all that is missing is 1 / (1 - q) times what the first
step changes; q is taken from the highest degrees of the solution itself.
"""

from __future__ import annotations

import numpy as np

from acoustube.waves.spectral.discretisation import DEGREE_INCREASE, Discretisation, Response
from acoustube.waves.spectral.polynomials import Array

SLOWEST = 0.9
"""Largest factor q that is believed: slower decay is that of a field which is not resolved."""


def excesses(system: Discretisation, responses: dict[float, list[Response]]) -> tuple[float, Array]:
    """Return the ratios of the whole error to the change by the next degrees.

    Parameters
    ----------
    system : Discretisation
    responses : dict
        From squared wavenumbers in 1/m2 to responses.

    Returns
    -------
    across : float
        For the degree across the tube.
    along : ndarray
        For that along each element, (n_elements,).
    """
    layout, functions = system.layout, system.functions
    degree = functions.degree - DEGREE_INCREASE
    counts = [functions.count(degree - 2 * step) for step in (0, 1, 2)]
    total = (functions.i + functions.j)[: layout.n] ** 2.0
    zeros = np.tile(system.modes.zeros, len(system.ports))
    high, low = np.zeros((2, 2, len(system.low.mass)))
    for shift, sides in responses.items():
        travels = np.flatnonzero(zeros < np.sqrt(shift) * system.radius)
        for side in sides:
            fields = side.fields[..., travels]
            nothing = np.zeros((len(fields), layout.n_higher, 0))
            own = system.in_polynomials(fields, nothing)[0]
            square = (own.reshape(len(own), layout.order + 1, layout.n, -1) ** 2).sum(axis=-1)
            # Of gradients: those across grow as the degree, slopes along are normalised.
            by_degree, by_order = (square * total).sum(axis=1), square.sum(axis=2)
            high += by_degree[:, counts[1] :].sum(axis=1), by_order[:, -2:].sum(axis=1)
            low += (
                by_degree[:, counts[2] : counts[1]].sum(axis=1), by_order[:, -4:-2].sum(axis=1)
            )  # fmt: skip
    across = min(high[0].sum() / max(low[0].sum(), np.finfo(float).tiny), SLOWEST)
    # Two degrees in the energies compared, but one in the estimate.
    along = np.sqrt(high[1] / np.maximum(low[1], np.finfo(float).tiny))
    return 1 / (1 - across), 1 / (1 - np.minimum(along, SLOWEST))
