"""Walls of lumens that are given as stacks of rings."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from acoustube.base.errors import ConfigError
from acoustube.waves.spectral.polynomials import Array
from acoustube.waves.spectral.walls import Wall

CENTRED = 1e-9
"""Largest distance in m of a ring's centre from the axis that counts as rounding."""
ROUND = 1e-3
"""Largest deviation from a circle, relative to its radius, of an end that counts as round."""
NEWTON_STEPS = 30
NOT_STRAIGHT = (
    "the lumen is not straight at its ends, or they differ in section; let both be straight "
    "tube of the same section"
)
"""Message about a lumen whose ends cannot be continued straight."""


class Rings(Protocol):
    """A stack of rings, as :class:`acoustube.lumen.Lumen`.

    Attributes
    ----------
    rings : ndarray
        (n_rings, n_around, 3) in m, in the order of z; points anticlockwise seen from the end of
        high z, with the first point of each ring at the bottom.
    position : float
        Coordinate z in m that becomes the origin.
    symmetric : bool
        True if symmetric about x = 0.
    same : float
        Distance in m up to which rings, or mirror images, count as equal.
    sealing_gap : float
        Height in m of a gap that is half sealed in a computation with losses; 0 to seal none.
    """

    @property
    def rings(self) -> Array: ...  # noqa: D102

    @property
    def position(self) -> float: ...  # noqa: D102

    @property
    def symmetric(self) -> bool: ...  # noqa: D102

    @property
    def same(self) -> float: ...  # noqa: D102

    @property
    def sealing_gap(self) -> float: ...  # noqa: D102


def wall_of(lumen: Rings) -> Wall:
    """Return the wall of a lumen, smooth between its rings.

    Parameters
    ----------
    lumen : Rings
        Its first two and its last two rings must be equal, as those of a tube beyond a press.

    Returns
    -------
    Wall
        With coordinates z relative to the lumen's `position`.

    Raises
    ------
    ConfigError
        If the ends are not straight or differ in section, or the whole lumen is straight.

    Notes
    -----
    Lines through points of equal index are cubic splines over the rings' mean z, from the first to
    the last ring that differs from the ends, and straight from these to the next ring outwards.
    Round ends are moved to x = y = 0.
    """
    rings = lumen.rings - [0.0, 0.0, lumen.position]
    changed = np.abs(rings[..., :2] - rings[:1, :, :2]).max(axis=(1, 2)) > lumen.same
    if not changed.any():
        raise ConfigError(
            "the lumen is straight all along and scatters nothing; press it, or use the modes of a "
            "straight bore"
        )
    first, last = np.flatnonzero(changed)[[0, -1]]
    if first <= 1 or last >= len(rings) - 2:
        raise ConfigError(NOT_STRAIGHT)
    radius, centre = _circle(rings[0])
    if radius is not None:
        rings = rings - [*centre, 0.0]
    part = rings[first - 1 : last + 2]
    mirrored = np.abs(part[::-1] * [1, 1, -1] - part)
    lines = Lines(part)
    heights = rings[..., 2]
    return Wall(
        lines=lines,
        knots=part[..., 2].mean(axis=1),
        ends=(float(heights[first - 1].min()), float(heights[last + 1].max())),
        radius=_effective_radius(rings[0]) if radius is None else radius,
        breaks=(float(heights[first].min()), float(heights[last].max())),
        symmetric=lumen.symmetric,
        reversible=bool(mirrored.max() < lumen.same),
        circular=radius is not None,
        sealing_gap=lumen.sealing_gap,
    )


def _circle(ring: Array) -> tuple[float | None, Array]:
    """Return radius and centre of a ring; the radius is None if the ring is not round."""
    centre = ring[:, :2].mean(axis=0)
    if np.abs(centre).max() < CENTRED:
        centre = np.zeros(2)
    distance = np.hypot(*(ring[:, :2] - centre).T)
    radius = float(distance.mean())
    return (radius if np.abs(distance - radius).max() <= ROUND * radius else None), centre


def _effective_radius(ring: Array) -> float:
    """Return the radius of the circle with the area of a ring."""
    (x, y), (x_next, y_next) = ring[:, :2].T, np.roll(ring[:, :2], -1, axis=0).T
    return float(np.sqrt((x * y_next - x_next * y).sum() / (2 * np.pi)))


class Lines:
    """Longitudinal lines through the ring points of equal index, as functions of z.

    Parameters
    ----------
    rings : ndarray
        (n_rings, n_around, 3) in m; the lumen is straight at the first and at the last ring.
    """

    def __init__(self, rings: Array) -> None:
        inner = rings[1:-1]
        self.knots = inner[..., 2].mean(axis=1)
        pieces = CubicSpline(self.knots, inner).c
        self.coefficients = np.ascontiguousarray(pieces.transpose(3, 0, 1, 2))
        self.rings = rings

    def __call__(self, z: Array) -> tuple[Array, Array, Array, Array]:
        """Return x, y and their z derivatives, (n, n_around), at z (n,) in m."""
        low, high = self.rings[1, :, 2], self.rings[-2, :, 2]
        height = np.broadcast_to(z[:, None], (len(z), len(low)))
        s = np.clip(height, self.knots[0], self.knots[-1])
        for _ in range(NEWTON_STEPS):
            there, along = self._at(s, 2)
            step = (np.clip(height, low, high) - there) / along
            s = np.clip(s + step, self.knots[0], self.knots[-1])
            if np.abs(step).max() < 1e-13:
                break
        (x, x_s), (y, y_s), (_, z_s) = (self._at(s, axis) for axis in range(3))
        place, along = np.stack([x, y], axis=-1), np.stack([x_s / z_s, y_s / z_s], axis=-1)
        for rim, end, beyond in ((1, 0, height < low), (-2, -1, height > high)):
            if beyond.any():
                place, along = self._beyond(height, rim, end, beyond, place, along)
        return place[..., 0], place[..., 1], along[..., 0], along[..., 1]

    def _at(self, s: Array, axis: int) -> tuple[Array, Array]:
        """Return coordinate `axis` of the lines at s, the rings' mean z in m, and its s derivative.

        `s` and both results are (n, n_around).
        """
        piece = np.clip(np.searchsorted(self.knots, s, side="right") - 1, 0, len(self.knots) - 2)
        t = s - self.knots[piece]
        a, b, c, d = self.coefficients[axis][:, piece, np.arange(s.shape[1])]
        return ((a * t + b) * t + c) * t + d, (3 * a * t + 2 * b) * t + c

    def _beyond(
        self,
        height: Array,
        rim: int,
        end: int,
        there: NDArray[np.bool_],
        place: Array,
        along: Array,
    ) -> tuple[Array, Array]:
        """Return `place` and `along` with those of straight lines where the mask `there` is True.

        `place` are x and y in m, `along` their z derivatives, (n, n_around, 2). The straight lines
        lead from ring `rim` to ring `end`; beyond it they are parallel to z.
        """
        start, stop = self.rings[rim], self.rings[end]
        slope = (stop[:, :2] - start[:, :2]) / (stop[:, 2:] - start[:, 2:])
        share = (height - start[:, 2]) / (stop[:, 2] - start[:, 2])
        sloping = (share <= 1.0)[..., None]
        straight = start[:, :2] + np.minimum(share, 1.0)[..., None] * (stop - start)[:, :2]
        here = there[..., None]
        return np.where(here, straight, place), np.where(here, np.where(sloping, slope, 0.0), along)
