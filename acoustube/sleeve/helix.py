"""A tube wrapped around an arm: from a distance along it to a place on the sleeve, and back.

The arm is a cone about its axis. The tube's centre line on it is the sleeve paper's helix, here
with a phase and a hand, so that several tubes can be wound side by side:

    r(z) = a0 + a1 z,    psi(z) = psi0 + rho z,    h(z) = (r cos psi, r sin psi, z),

with rho = 2 pi n_loops / dz. Distances along the tube count from the sensor; a lead of straight
tube comes before the helix.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import pi
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from acoustube.base.checks import ANGLE, PLACE, Reals, Several, check_fields, checked
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Choice, Number
from acoustube.base.types import Array

TABLE_INTERVALS = 2000
"""Intervals of the arc-length table; on a forearm its error is under 1e-9 of the length."""
QUADRATURE_NODES = 41
"""Nodes of the Gauss-Hermite rule that propagates the distance's uncertainty to the skin."""
REFINEMENTS = 8
"""Newton steps towards the foot of a perpendicular; five reach a micrometre on a forearm."""
HANDS = {"right": 1, "left": -1}
"""Sign of the twist rate of a helix by its hand."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """Coordinate frame of an arm: its axis in the coordinates of the markers.

    Parameters
    ----------
    origin : array of shape (3,)
        Place of z = 0 on the axis, in m.
    rotation : array of shape (3, 3)
        Its columns are the directions of the arm's x, y and z axes.
    """

    origin: Array = field(default_factory=lambda: np.zeros(3))
    rotation: Array = field(default_factory=lambda: np.eye(3))

    def outwards(self, places: ArrayLike) -> Array:
        """Transform points (..., 3) from the coordinates of the arm to those of the markers."""
        return np.asarray(places, float) @ self.rotation.T + self.origin

    def inwards(self, places: ArrayLike) -> Array:
        """Transform points (..., 3) from the coordinates of the markers to those of the arm."""
        return np.asarray((np.asarray(places, float) - self.origin) @ self.rotation)


@dataclass(frozen=True, kw_only=True, eq=False)
class Helix:
    """The centre line of a tube around an arm.

    Parameters
    ----------
    radius : float
        a0, the distance of the centre line from the axis at z = 0, in m.
    taper : float
        a1, the increase of the radius per m along the axis.
    length : float
        dz, the extent of the helix along the axis in m.
    loops : float
        Number of turns over the length.
    phase : float
        psi0 in rad.
    hand : str
        ``right`` or ``left``: on a right-handed helix z increases with psi.
    lead : float
        Length of tube before the helix in m.
    frame : Frame
        Position and orientation of the arm.
    intervals : int
        Number of intervals of the arc-length table.

    Raises
    ------
    ConfigError
        If `length`, `loops` or the radius at either end is not positive, `lead` is negative, `hand`
        is not ``right`` or ``left``, or `intervals` is under 2.
    """

    radius: float
    taper: float = 0.0
    length: float
    loops: float
    phase: float = 0.0
    hand: str = "right"
    lead: float = 0.0
    frame: Frame = field(default_factory=Frame)
    intervals: int = TABLE_INTERVALS

    def __post_init__(self) -> None:
        check_fields(
            self, radius=PLACE, taper=Number(-1e3, 1e3), length=PLACE,
            loops=Number(-1e4, 1e4, "turns"), phase=ANGLE, lead=PLACE, frame=Frame,
            intervals=Number(2, 1e6, whole=True),
        )  # fmt: skip
        _check_positive("loops", self.loops, "a helix needs turns; use 0.25 or more")
        _check_positive("length", self.length, "give the extent along the arm in m")
        for name, z in (("start", 0.0), ("end", self.length)):
            if not 0 < self.radius + self.taper * z < np.inf:
                raise ConfigError(
                    f"the radius of the arm's {name} comes out as "
                    f"{self.radius + self.taper * z:.4g} m and must be positive; check radius and "
                    "taper, or the markers they were fitted to"
                )
        if not 0 <= self.lead < np.inf:
            raise ConfigError(
                "must not be negative", setting="lead", value=self.lead, unit="m",
                advice="use 0 for no lead",
            )  # fmt: skip
        Choice(tuple(HANDS)).check("hand", self.hand)

    @property
    def twist(self) -> float:
        """The twist rate rho in rad/m, negative for a left-handed helix."""
        return HANDS[self.hand] * 2 * pi * self.loops / self.length

    @property
    def pitch(self) -> float:
        """Advance along the axis per loop in m."""
        return self.length / self.loops

    @property
    def tube_length(self) -> float:
        """Total length of lead and helix in m."""
        return float(self.lead + self.table[1, -1])

    @cached_property
    def table(self) -> Array:
        """Heights z and arc lengths from the helix's start in m, (2, intervals + 1).

        Arc lengths are integrals of l'(z) = sqrt(1 + a1^2 + (rho r)^2) by the trapezoidal rule, as
        in the sleeve paper.
        """
        z = np.linspace(0.0, self.length, self.intervals + 1)
        density = self.density(z)
        steps = 0.5 * (density[:-1] + density[1:]) * np.diff(z)
        return np.stack([z, np.concatenate([[0.0], np.cumsum(steps)])])

    def radius_at(self, z: ArrayLike) -> Array:
        """Return the distance r(z) in m of the centre line from the axis, at heights z in m."""
        return self.radius + self.taper * np.asarray(z, float)

    def density(self, z: ArrayLike) -> Array:
        """Return l'(z), the length of tube per m of the axis, at heights z in m."""
        return np.sqrt(1 + self.taper**2 + (self.twist * self.radius_at(z)) ** 2)

    def angle(self, z: ArrayLike) -> Array:
        """Return the angle psi(z) in rad of the centre line about the axis, at heights z in m."""
        return self.phase + self.twist * np.asarray(z, float)

    def point(self, z: ArrayLike) -> Array:
        """Return the points h(z) of the centre line in the arm's coordinates, (..., 3), in m."""
        z, r, psi = np.asarray(z, float), self.radius_at(z), self.angle(z)
        return np.stack([r * np.cos(psi), r * np.sin(psi), z], axis=-1)

    def height(self, distance: ArrayLike) -> Array:
        """Return the heights z of points at distances from the sensor.

        Parameters
        ----------
        distance : array_like
            In m, of any shape.

        Returns
        -------
        ndarray
            In m; nan where the distance lies in the lead or beyond the helix.
        """
        z, arc = self.table
        along = np.asarray(distance, float) - self.lead
        slack = 1e-9 * arc[-1]
        inside = (along >= -slack) & (along <= arc[-1] + slack)
        return np.where(inside, np.interp(along, arc, z), np.nan)

    def place(self, distance: ArrayLike) -> Array:
        """Return the places of points at distances from the sensor, in the markers' coordinates.

        Parameters
        ----------
        distance : array_like
            Distances from the sensor in m, (...).

        Returns
        -------
        ndarray
            (..., 3) in m; nan where the distance lies in the lead or beyond the helix.
        """
        return self.frame.outwards(self.point(self.height(distance)))

    def distance(self, z: ArrayLike) -> Array:
        """Return the distances in m along the tube from the sensor to points at heights z in m.

        Heights beyond an end of the helix give the distance of that end.
        """
        return self.lead + np.interp(np.asarray(z, float), *self.table)

    def bend(self, z: ArrayLike) -> tuple[Array, Array]:
        """Return curvature and torsion of the centre line, both in 1/m.

        Parameters
        ----------
        z : array_like
            Heights in m, (...).

        Returns
        -------
        curvature, torsion : ndarray
            (...) in 1/m; the torsion of a left-handed helix is negative.

        Notes
        -----
        They are those of a helix on a cylinder with the radius at z: the contribution of the taper
        is of second order. With b = 1 / rho, kappa = r / (r^2 + b^2) and tau = b / (r^2 + b^2).
        """
        r, b = self.radius_at(z), 1 / self.twist
        return r / (r**2 + b**2), b / (r**2 + b**2)

    def spread(self, distance: ArrayLike, deviation: ArrayLike) -> tuple[Array, Array]:
        """Propagate the uncertainty of distances to positions on the skin.

        Parameters
        ----------
        distance : array_like
            From the sensor in m, (...).
        deviation : array_like
            Standard deviation of each in m.

        Returns
        -------
        mean : ndarray
            Mean positions, (..., 3) in m, in the coordinates of the markers.
        covariance : ndarray
            Covariance matrices of the positions, (..., 3, 3) in m2. Both are nan where `distance`
            lies in the lead or beyond the helix.

        Notes
        -----
        Gauss-Hermite quadrature along the tube is used, not linearisation, since a standard
        deviation of 5 cm is a fifth of a loop around a forearm. Nodes of the quadrature beyond an
        end of the helix are moved to that end.
        """
        nodes, weights = np.polynomial.hermite_e.hermegauss(QUADRATURE_NODES)
        weights = weights / weights.sum()
        distance, deviation = np.asarray(distance, float), np.asarray(deviation, float)
        ends = self.lead, self.tube_length
        inside = np.isfinite(self.height(distance))[..., None]
        along = distance[..., None] + deviation[..., None] * nodes
        places = self.place(np.clip(along, *ends))
        mean = np.where(inside, weights @ places, np.nan)
        away = places - mean[..., None, :]
        return mean, np.einsum("n,...ni,...nj->...ij", weights, away, away)


@dataclass(frozen=True, eq=False)
class Nearest:
    """Tubes nearest to positions on the skin.

    Attributes
    ----------
    tube : ndarray of int
        Index of the nearest tube, (...).
    distance : ndarray
        Distance along that tube from the sensor in m, (...).
    gap : ndarray
        Distance from the position to that tube's centre line in m, (...).
    next_tube, next_distance, next_gap : ndarray
        The same for the second nearest loop, of the same or another tube. A press midway between
        two loops may be detected on either. -1, nan and nan where there is no second loop.
    """

    tube: NDArray[np.int64]
    distance: Array
    gap: Array
    next_tube: NDArray[np.int64]
    next_distance: Array
    next_gap: Array


@checked(tubes=Several(Helix, 1), places=Reals(-1e6, 1e6, "m", last=3, missing=True, empty=True))
def nearest(tubes: Sequence[Helix], places: ArrayLike) -> Nearest:
    """Return the nearest tubes to positions, and the distances along these tubes.

    Parameters
    ----------
    tubes : sequence of Helix
        One or more.
    places : array_like
        Positions in the coordinates of the markers, (..., 3), in m. Where a coordinate is nan,
        distances and gaps are nan.

    Returns
    -------
    Nearest

    Raises
    ------
    ConfigError
        If there is no tube, or the last axis of `places` is not of length 3.

    Notes
    -----
    Each loop passes the angle of the position about the axis once. From there Newton's method
    converges to the foot of the perpendicular onto the loop.
    """
    places = np.asarray(places, float)
    feet = [_feet(tube, tube.frame.inwards(places)) for tube in tubes]
    gap = np.concatenate([gaps for _, gaps in feet], axis=-1)
    along = np.concatenate(
        [tube.distance(z) for tube, (z, _) in zip(tubes, feet, strict=True)], axis=-1
    )
    number = np.repeat(np.arange(len(tubes)), [z.shape[-1] for z, _ in feet])
    best = np.argmin(np.where(np.isnan(gap), np.inf, gap), axis=-1)[..., None]
    first = number[best[..., 0]]
    distance = np.take_along_axis(along, best, -1)
    # Feet of perpendiculars that were clipped to the same end of a tube are not another loop.
    half_a_loop = np.array([0.5 * tube.table[1, -1] / (tube.loops + 1) for tube in tubes])
    same = (number == first[..., None]) & (np.abs(along - distance) < half_a_loop[first][..., None])
    others = np.where(same | np.isnan(gap), np.inf, gap)
    second = np.argmin(others, axis=-1)[..., None]
    next_gap = np.take_along_axis(others, second, -1)[..., 0]
    found = np.isfinite(next_gap)
    return Nearest(
        tube=first,
        distance=distance[..., 0],
        gap=np.take_along_axis(gap, best, -1)[..., 0],
        next_tube=np.where(found, number[second[..., 0]], -1),
        next_distance=np.where(found, np.take_along_axis(along, second, -1)[..., 0], np.nan),
        next_gap=np.where(found, next_gap, np.nan),
    )


def _feet(tube: Helix, places: Array) -> tuple[Array, Array]:
    """Return the heights of the feet of perpendiculars onto each loop, and the gaps, (..., loop).

    Places are in the coordinates of the arm, (..., 3); all lengths are in m.
    """
    x, y, height = (places[..., i, None] for i in range(3))
    angle = np.arctan2(y, x) - tube.phase
    # Candidate loops at this angle, with one more at each end.
    turns = np.arange(-1, int(np.ceil(tube.loops)) + 2) * 2 * pi * HANDS[tube.hand]
    first = np.mod(HANDS[tube.hand] * angle, 2 * pi) * HANDS[tube.hand]
    z = np.clip((first + turns) / tube.twist, 0.0, tube.length)
    for _ in range(REFINEMENTS):
        z = np.clip(z - _newton_step(tube, x, y, height, z), 0.0, tube.length)
    gap = np.linalg.norm(tube.point(z) - places[..., None, :], axis=-1)
    return z, gap


def _newton_step(tube: Helix, x: Array, y: Array, height: Array, z: Array) -> Any:
    """Return the step of Newton's method on half the squared gap, at most a sixth of a loop."""
    r, psi, rho, a1 = tube.radius_at(z), tube.angle(z), tube.twist, tube.taper
    c, s = np.cos(psi), np.sin(psi)
    outwards, around = x * c + y * s, y * c - x * s
    slope = (r - outwards) * a1 - r * rho * around + z - height
    bend = a1**2 - 2 * rho * a1 * around + r * rho**2 * outwards + 1
    # Far from the helix the second derivative is negative: use the squared arc-length density.
    bend = np.where(bend > 0.1 * tube.density(z) ** 2, bend, tube.density(z) ** 2)
    return np.clip(slope / bend, -tube.pitch / 6, tube.pitch / 6)


def _check_positive(name: str, value: float, advice: str) -> None:
    if not 0 < value < np.inf:
        raise ConfigError("must be positive", setting=name, value=value, advice=advice)
