"""States of a press as smooth functions of depth, interpolated between the rows of an indentation.

The displacements of the rows are interpolated by cubic splines, which have continuous first and
second derivatives [1]_. Cubic Hermite splines could also use the derivative of each state by depth,
which follows from the tangent stiffness. But this derivative holds for one set of contact points
only, and the set changes every few micrometres: with it the error was up to three times as large.

References
----------
.. [1] C. de Boor, "A Practical Guide to Splines", revised ed., Springer (2001), chapter 4.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline, PchipInterpolator

from acoustube.base.errors import ConfigError
from acoustube.base.types import Array
from acoustube.indentation.result import RESULTS, Indentation

FEWEST_ROWS = 5
"""Smallest number of rows: a cubic through all but one estimates the error at that one."""
NEAREST = 0.25
"""Smallest distance of a row from the rows that predict it, relative to the wider of the two
intervals next to that row.

With a constant c, a cubic errs by at most c H^4 / 16 within an interval H, and by c a^2 b^2 at a
row between others at the distances a and b. With a = H / 4 and b = H both are equal."""
_SOLVED = ("depth", "displacement", "press_force", "iterations", "residual")
"""Results that :meth:`DepthPath.at` does not interpolate by monotone cubics (PCHIP)."""


class InterpolationError(NamedTuple):
    """Estimated errors of interpolated states; arrays have the shape of the depths.

    Attributes
    ----------
    displacement : array
        Largest error over the nodes, in m.
    contact_force : array
        Error of the total force, in N.
    """

    displacement: Array
    contact_force: Array


@dataclass(frozen=True, eq=False)
class DepthPath:
    """A press at any depth between first contact and its last row.

    Parameters
    ----------
    indentation : Indentation
        With at least five rows, the first of them at first contact (depth 0).

    Raises
    ------
    ConfigError
        If there are fewer rows, or the first is not at first contact.

    Notes
    -----
    Between the rows a state is not in equilibrium, and its walls are not checked for crossing. The
    rows should be about a sixteenth of the bore apart; see :meth:`error`.
    """

    indentation: Indentation

    def __post_init__(self) -> None:
        """Check the number of rows, and the depth of the first."""
        rows = len(self.indentation.depth)
        if rows < FEWEST_ROWS:
            raise ConfigError(
                f"indentation has {rows} rows, too few to interpolate between; press to at least "
                f"{FEWEST_ROWS - 1} depths"
            )
        first = float(self.indentation.depth[0])
        if first != 0:
            raise ConfigError(
                f"indentation begins at a depth of {first:.6g} m, not at first contact; keep its "
                "row of depth 0"
            )

    def displacement(self, depth: ArrayLike, derivative: int = 0) -> Array:
        """Return the displacements of the nodes, or their derivative by depth.

        Parameters
        ----------
        depth : array_like
            In m, of any shape.
        derivative : int
            Order of the derivative, 0 to 2.

        Returns
        -------
        array of shape (..., n_nodes, 3)
            In m, divided by m once for each order of the derivative.

        Raises
        ------
        ConfigError
            If a depth is negative or beyond the last row.
        """
        return np.asarray(self._displacement(self._checked(depth), derivative))

    def press_force(self, depth: ArrayLike, derivative: int = 0) -> Array:
        """Return the force on each indenter, or its derivative by depth.

        Parameters and errors are those of :meth:`displacement`.

        Returns
        -------
        array of shape (..., n_indenters)
            In N, divided by m once for each order of the derivative.
        """
        return np.asarray(self._press_force(self._checked(depth), derivative))

    def contact_force(self, depth: ArrayLike, derivative: int = 0) -> Array:
        """Return the total force on all indenters; arguments and unit as :meth:`press_force`."""
        return self.press_force(depth, derivative).sum(axis=-1)

    def at(self, depth: ArrayLike) -> Indentation:
        """Return an indentation with rows at given depths.

        Use it with functions that evaluate, draw or export the rows of an indentation.

        Parameters
        ----------
        depth : array_like of shape (n,)
            Rising, in m.

        Returns
        -------
        Indentation
            Its residual is nan and its iterations are zero. Contact area, energy, volume ratio and
            gap are monotone cubics (PCHIP) through those of the rows.

        Raises
        ------
        ConfigError
            If the depths do not rise, or one is negative or beyond the last row.
        """
        depth = np.atleast_1d(self._checked(depth))
        if depth.ndim > 1 or np.any(np.diff(depth) <= 0):
            raise ConfigError("depth must be a 1-D array of increasing numbers")
        given = self.indentation
        others: dict[str, Any] = {
            name: PchipInterpolator(given.depth, getattr(given, name))(depth)
            for name in RESULTS
            if name not in _SOLVED and name != "smallest_gap"
        }
        # The first row's gap is nan if it is from `first_touch`.
        start = int(np.isnan(given.smallest_gap[0]))
        gap = PchipInterpolator(given.depth[start:], given.smallest_gap[start:])
        return dataclasses.replace(
            given,
            depth=depth,
            displacement=self.displacement(depth),
            press_force=self.press_force(depth),
            smallest_gap=gap(np.maximum(depth, given.depth[start])),
            iterations=np.zeros(len(depth), int),
            residual=np.full(len(depth), np.nan),
            **others,
        )

    def error(self, depth: ArrayLike) -> InterpolationError:
        """Return the estimated errors of interpolation at depths.

        Parameters
        ----------
        depth : array_like
            In m, of any shape.

        Raises
        ------
        ConfigError
            If a depth is negative or beyond the last row.

        Notes
        -----
        By cross-validation: each row but the first and the last is predicted from all others,
        except inner rows nearer than a quarter of the wider interval next to it. The estimate
        between two rows is the larger of their two errors; at a row it is zero. Without a row, the
        interval of evenly spaced rows is twice as wide: displacements are about three times as
        accurate as estimated. Forces fluctuate by 0.3 % with the number of contact points, at any
        spacing of the rows; their errors are up to twice the estimate. Between the last row
        with an open lumen and the first with a closed one, the slope of the force changes faster
        than the rows resolve.
        """
        depth = self._checked(depth)
        rows = self.indentation.depth
        after = np.clip(np.searchsorted(rows, depth), 1, len(rows) - 1)
        at_row = np.isin(depth, rows)
        estimates = []
        for of_row in self._left_out:
            padded = np.concatenate([[0.0], of_row, [0.0]])
            estimates.append(np.where(at_row, 0.0, np.maximum(padded[after - 1], padded[after])))
        return InterpolationError(*estimates)

    @cached_property
    def _displacement(self) -> CubicSpline:
        return CubicSpline(self.indentation.depth, self.indentation.displacement)

    @cached_property
    def _press_force(self) -> CubicSpline:
        return CubicSpline(self.indentation.depth, self.indentation.press_force)

    @cached_property
    def _left_out(self) -> tuple[Array, Array]:
        """Errors in m and in N of inner rows that are predicted from others, each (n_rows - 2,)."""
        given, rows = self.indentation, self.indentation.depth
        moved, force = [], []
        for row in range(1, len(rows) - 1):
            # A close neighbour would predict the row, but not the states in the wider interval.
            away = np.abs(rows - rows[row])
            known = away >= NEAREST * max(away[row - 1], away[row + 1])
            known[[0, -1]], known[row] = True, False
            weights = CubicSpline(rows[known], np.eye(known.sum()))(rows[row])
            state = np.tensordot(weights, given.displacement[known], axes=1)
            moved.append(np.abs(state - given.displacement[row]).max())
            force.append(abs(weights @ given.contact_force[known] - given.contact_force[row]))
        return np.array(moved), np.array(force)

    def _checked(self, depth: ArrayLike) -> Array:
        """Return depths as an array, or raise if one is beyond the rows."""
        found, last = np.asarray(depth, float), float(self.indentation.depth[-1])
        outside = found[~((found >= 0) & (found <= last * (1 + 1e-9)))]
        if outside.size:
            raise ConfigError(
                f"is not between 0 and {last:.4g} m, the last depth", setting="depth",
                value=float(outside.flat[0]), unit="m", allowed=(0.0, last),
                advice="use a depth in this range, or press deeper",
            )  # fmt: skip
        return np.minimum(found, last)
