"""Gauss rules along a lumen whose wall is smooth only between knots."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from acoustube.waves.spectral.polynomials import Array, Index, gauss

LEAST_POINTS = 3
"""Least number of Gauss points between two knots, enough for a cubic spline and its slope."""
SPARE_POINTS = 3
"""Number of Gauss points between two knots in addition to those for the polynomials."""
MOST_PIECES = 24
"""Approximate largest number of pieces of an element between knots; surplus knots are skipped."""


class AxialRule(NamedTuple):
    """Quadrature along the elements of a lumen.

    Attributes
    ----------
    z : ndarray
        Coordinates z in m, rising, (n_points,).
    point, weight : ndarray
        Local coordinate from -1 to 1 in the element, and quadrature weight over that coordinate,
        (n_points,).
    element : ndarray of int
        Number of the element, (n_points,).
    edges : ndarray
        Boundaries of the elements in m, (n_elements + 1,).
    """

    z: Array
    point: Array
    weight: Array
    element: Index
    edges: Array

    def of(self, number: int) -> slice:
        """Return the slice of an element's points."""
        low, high = np.searchsorted(self.element, [number, number + 1])
        return slice(int(low), int(high))

    def only(self, elements: Index) -> AxialRule:
        """Return the rule of some elements, given in rising order, as if they were adjacent.

        The elements are renumbered from 0, and `edges` starts at 0 m; `z` remains.
        """
        here = np.isin(self.element, elements)
        edges = np.concatenate([[0.0], np.cumsum(self.step[elements])])
        number = np.searchsorted(elements, self.element[here])
        return AxialRule(self.z[here], self.point[here], self.weight[here], number, edges)

    @property
    def step(self) -> Array:
        """Lengths of the elements in m, (n_elements,)."""
        return np.diff(self.edges)


def axial_rule(edges: Array, degree: int, knots: NDArray[np.float64]) -> AxialRule:
    """Return the Gauss rule for products of two polynomials along a piecewise smooth wall.

    Parameters
    ----------
    edges : ndarray
        Boundaries of the elements in m, rising, (n_elements + 1,).
    degree : int
        Degree of a polynomial along an element.
    knots : ndarray
        Coordinates z in m between which the wall is smooth, in any order.
    """
    found = []
    for number, (low, high) in enumerate(pairwise(edges)):
        close = 1e-3 * (high - low)
        inner = np.unique(knots[(knots > low + close) & (knots < high - close)])
        inner = inner[:: 1 + len(inner) // MOST_PIECES]
        borders = (np.concatenate([[low], inner, [high]]) - low) * 2 / (high - low) - 1
        for start, stop in pairwise(borders):
            n = SPARE_POINTS + int(np.ceil((degree + 1) * (stop - start) / 2 - 1e-9))
            point, weight = gauss(max(n, LEAST_POINTS), float(start), float(stop))
            found.append((low + (high - low) * (point + 1) / 2, point, weight, 0 * point + number))
    z, point, weight, element = (np.concatenate(part) for part in zip(*found, strict=True))
    return AxialRule(z, point, weight, element.astype(int), edges)
