"""The axis of an arm, and its radius as a linear function along it, from two columns of markers.

A column is a row of markers along the arm. Outliers are detected first, column by column, by the
line in space with the least median of squared distances (up to almost half of the markers may be
wrong). The inliers are then fitted by ordinary least squares, whose confidence intervals are exact
for normal errors.

References
----------
Rousseeuw, P. J. (1984). Least median of squares regression. Journal of the American Statistical
Association 79, 871-880. doi:10.1080/01621459.1984.10477105
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from math import log
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares
from scipy.stats import t as student

from acoustube.base.checks import Reals, checked
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Choice, Number
from acoustube.base.types import Array
from acoustube.base.units import CM, MM
from acoustube.sleeve.helix import Frame

Kept = NDArray[np.bool_]

MOST_PAIRS = 3000
"""Largest number of marker pairs tried as lines; of more pairs, evenly spaced ones are tried."""
OUTLIER_DEVIATIONS = 4.5
"""Least deviation of outliers from the line, in standard deviations: 1 normal error in 25 000."""
SMALLEST_DEVIATION = 0.2e-3
"""Lower bound of the estimated standard deviation of a marker from its column's line, in m."""
RADIUS_RANGE = 0.01, 0.3
"""Plausible range of an arm's radius in m."""
LENGTH_RANGE = 0.03, 1.5
"""Plausible range of the length of an arm in m. Columns with outliers may be twice as long."""
MIN_MARKERS = 3
"""Least number of markers per column: a line goes through any two."""
THIRD_DISTANCE = 0.01
"""Distance in m from the line up to which each marker of a column of only three is an inlier."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Line:
    """Fitted line r(z) = a0 + a1 z of an arm's radius along its axis.

    Attributes
    ----------
    radius, taper : float
        a0 in m, and a1 in m of radius per m along the axis.
    covariance : ndarray
        Covariance matrix of a0 and a1, (2, 2).
    freedom : int
        Degrees of freedom of the fit.
    deviation : float
        Standard deviation in m of markers from the line.
    """

    radius: float
    taper: float
    covariance: Array
    freedom: int
    deviation: float

    @checked(confidence=Number(0, 1))
    def interval(self, confidence: float = 0.95) -> Array:
        """Return lower and upper limits (columns) of a0 and a1 (rows) at a confidence of 0 to 1."""
        half = student.ppf(0.5 + confidence / 2, self.freedom) * np.sqrt(np.diag(self.covariance))
        return np.array([self.radius, self.taper])[:, None] + half[:, None] * [-1.0, 1.0]


@dataclass(frozen=True, kw_only=True, eq=False)
class Arm:
    """Cone fitted to two columns of markers on an arm.

    Attributes
    ----------
    frame : Frame
        If the axis was fitted, z increases from the first marker of the first column to its last;
        otherwise along the z axis of the coordinates. z is 0 at the lowest marker that was used.
    lines : tuple of Line
        Fitted radius at each column; the same line twice where the axis was fitted too.
    angles : tuple of float
        Angle psi of each column about the axis in rad.
    length : float
        Extent of the markers along the axis in m, from z = 0.
    kept : tuple of ndarray of bool
        Mask of the markers of each column that were used (inliers), (n,) as the column.
    """

    frame: Frame
    lines: tuple[Line, Line]
    angles: tuple[float, float]
    length: float
    kept: tuple[Kept, Kept]


@checked(
    axis=Choice(("fitted", "z")),
    first=Reals(-1e6, 1e6, "m", missing=True, empty=True),
    second=Reals(-1e6, 1e6, "m", missing=True, empty=True),
)
def fit_arm(first: ArrayLike, second: ArrayLike, *, axis: str = "fitted") -> Arm:
    """Fit an arm to two columns of markers.

    Parameters
    ----------
    first, second : array_like
        Coordinates in m, (n, 3) each, in order along the arm; gaps are nan.
    axis : str
        ``fitted``: the columns lie on opposite sides of the arm, and the axis is midway between
        them; one line of the radius is fitted to both. ``z``: the axis is the z axis of the
        coordinates, as in the sleeve paper, and a line of the radius is fitted to each column.

    Returns
    -------
    Arm

    Raises
    ------
    ConfigError
        If a column has fewer than three markers, does not run along the arm, or is too short or too
        long for an arm; if markers are assigned to the wrong column, or both columns are on one
        line; or if the fitted radius is not that of an arm.

    Notes
    -----
    Two straight lines on a cone do not determine its axis if the angle between them is unknown;
    hence the two choices of `axis`. If the axis is fitted, seven numbers are fitted to two
    deviations per marker, those across the axis.
    """
    columns = [_column(points, name) for points, name in ((first, "first"), (second, "second"))]
    _check_units(columns)
    lines = [_robust_line(points) for points in columns]
    _check_mixed(columns, lines)
    for (_, _, _, kept), name in zip(lines, ("first", "second"), strict=True):
        if kept.sum() < MIN_MARKERS:
            raise ConfigError(
                f"only {kept.sum()} markers of the {name} column lie on a line; check the column"
            )
    used = [points[line[3]] for points, line in zip(columns, lines, strict=True)]
    if axis == "z":
        frame = Frame()
        found = tuple(_radius_line(points) for points in used)
    else:
        frame, line = _fit_axis(used, _common_direction(lines))
        found = (line, line)
    return _arm(first, second, used, frame, found)


def _arm(first: Any, second: Any, used: list[Array], frame: Frame, lines: Any) -> Arm:
    """Return the arm, with z = 0 moved to the lowest of the markers used."""
    own = [frame.inwards(points) for points in used]
    heights = np.concatenate([points[:, 2] for points in own])
    start, end = float(heights.min()), float(heights.max())
    _check_length(end - start)
    _check_along(own, end - start)
    shift = np.array([[1.0, start], [0.0, 1.0]])
    moved = tuple(
        replace(
            line,
            radius=line.radius + line.taper * start,
            covariance=shift @ line.covariance @ shift.T,
        )
        for line in lines
    )
    _check_radii(moved, end - start)
    angles = [float(np.arctan2(*points[:, 1::-1].mean(axis=0))) for points in own]
    kept = [_flags(points, part) for points, part in zip((first, second), used, strict=True)]
    return Arm(
        frame=Frame(origin=frame.outwards([0.0, 0.0, start]), rotation=frame.rotation),
        lines=(moved[0], moved[1]),
        angles=(angles[0], angles[1]),
        length=end - start,
        kept=(kept[0], kept[1]),
    )


def _flags(points: Any, used: Array) -> Kept:
    """Return the mask of the markers of a column (n, 3) that are among those used."""
    points = np.asarray(points, float)
    return np.array([bool(np.any(np.all(used == point, axis=1))) for point in points])


def _column(points: ArrayLike, name: str) -> Array:
    """Return a column without its missing markers."""
    points = np.asarray(points, float)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ConfigError(f"the {name} column has shape {points.shape} and must have (n, 3)")
    seen = points[np.all(np.isfinite(points), axis=1)]
    if len(seen) < MIN_MARKERS:
        gaps = f", and {len(points) - len(seen)} gaps" if len(seen) < len(points) else ""
        raise ConfigError(
            f"the {name} column has {len(seen)} marker{'s' * (len(seen) != 1)}{gaps}; a line needs "
            f"{MIN_MARKERS} or more of them"
        )
    return seen


def _robust_line(points: Array) -> tuple[Array, Array, float, Kept]:
    """Return a robust line fit: centroid, direction, standard deviation, and mask of inliers."""
    pairs = np.array(list(combinations(range(len(points)), 2)))
    if len(pairs) > MOST_PAIRS:
        pairs = pairs[np.linspace(0, len(pairs) - 1, MOST_PAIRS).astype(int)]
    start, step = points[pairs[:, 0]], points[pairs[:, 1]] - points[pairs[:, 0]]
    size = np.linalg.norm(step, axis=1)
    if not size.max() > 0:
        raise ConfigError("the markers of a column all lie at one place; check the column")
    # Close pairs give poor lines: errors of the markers tilt them.
    far = size > 0.3 * size.max()
    start, step = start[far], step[far] / size[far, None]
    away = points[:, None, :] - start
    squares = np.sum(away**2, axis=-1) - np.einsum("npi,pi->np", away, step) ** 2
    best = int(np.argmin(np.median(squares, axis=0)))
    middle, direction = start[best], step[best]
    kept = np.ones(len(points), bool)
    for _ in range(3):
        away = points - middle
        across = np.linalg.norm(away - np.outer(away @ direction, direction), axis=1)
        # Two squared normal errors have a sum of median 2 log 2; small samples lie below it.
        spread = np.sqrt(np.median(across**2) / (2 * log(2))) * (1 + 5 / max(len(points) - 2, 1))
        deviation = max(float(spread), SMALLEST_DEVIATION)
        least = THIRD_DISTANCE if len(points) == MIN_MARKERS else 0.0
        kept = across <= max(OUTLIER_DEVIATIONS * deviation, least)
        middle = points[kept].mean(axis=0)
        direction = np.linalg.svd(points[kept] - middle)[2][0]
    along = (points[kept] - middle) @ direction
    return middle, direction * (1 if along[-1] >= along[0] else -1), deviation, kept


def _common_direction(lines: list[tuple[Array, Array, float, Kept]]) -> Array:
    """Return the mean direction of two columns, oriented as the first."""
    (_, u, _, _), (_, v, _, _) = lines
    if abs(u @ v) < 0.7:
        between = np.degrees(np.arccos(float(abs(u @ v))))
        raise ConfigError(
            f"the columns lie at {between:.0f} degrees to each other and must both run along the "
            "arm; check which marker belongs to which column"
        )
    sum_ = u + v * np.sign(u @ v)
    return np.asarray(sum_ / np.linalg.norm(sum_))


def _radius_line(points: Array) -> Line:
    """Return the line r = a0 + a1 z fitted to the distances of markers (n, 3) from the z axis."""
    z, r = points[:, 2], np.hypot(points[:, 0], points[:, 1])
    design = np.stack([np.ones_like(z), z], axis=1)
    if np.ptp(z) < LENGTH_RANGE[0]:
        raise ConfigError(
            f"a column extends {CM * np.ptp(z):.2g} cm along z; the arm must lie along z, or else "
            'use axis = "fitted"'
        )
    values = np.asarray(np.linalg.lstsq(design, r, rcond=None)[0], float)
    return _line(values, design, r - design @ values)


def _line(values: Array, jacobian: Array, residuals: Array) -> Line:
    """Return the radius line of a least-squares fit: its last two parameters are a0 and a1.

    Residuals are in m, (n,). Their Jacobian is (n, n_parameters); its sign has no effect.
    """
    freedom = len(residuals) - len(values)
    variance = float(residuals @ residuals) / freedom
    covariance = np.asarray(variance * np.linalg.inv(jacobian.T @ jacobian), float)
    return Line(
        radius=float(values[-2]),
        taper=float(values[-1]),
        covariance=covariance[-2:, -2:],
        freedom=freedom,
        deviation=variance**0.5,
    )


def _fit_axis(columns: list[Array], direction: Array) -> tuple[Frame, Line]:
    """Fit axis and radius together; the frame's x points to the first column."""
    first, second = columns
    middles = [points.mean(axis=0) for points in columns]
    # Without the part along the axis, since the columns need not begin side by side.
    across = middles[0] - middles[1]
    across = across - (across @ direction) * direction
    size = float(np.linalg.norm(across))
    if size < 2 * RADIUS_RANGE[0]:
        raise ConfigError(
            f"the two columns are {MM * size:.2g} mm apart and must lie on opposite sides of the "
            'arm; if they do not, put the arm along z and use axis = "z"'
        )
    x = across / size
    start = np.stack([x, np.cross(direction, x), direction], axis=1)
    # Heights along the axis count from the point midway between the columns' middles.
    origin = 0.5 * (middles[0] + middles[1])
    scale = np.concatenate([np.full(2, size), np.ones(3), [size, 1.0]])
    sides = np.concatenate([np.ones(len(first)), -np.ones(len(second))])
    points = np.concatenate(columns)

    def frame_of(values: Array) -> Frame:
        shift_x, shift_y, tilt_x, tilt_y, turn = (scale * values)[:5]
        axis = direction + tilt_x * start[:, 0] + tilt_y * start[:, 1]
        axis = axis / np.linalg.norm(axis)
        out = np.cos(turn) * start[:, 0] + np.sin(turn) * start[:, 1]
        out = out - (out @ axis) * axis
        out = out / np.linalg.norm(out)
        rotation = np.stack([out, np.cross(axis, out), axis], axis=1)
        return Frame(origin=origin + start[:, :2] @ [shift_x, shift_y], rotation=rotation)

    def deviations(values: Array) -> Array:
        own = frame_of(values).inwards(points)
        radius = (scale * values)[5] + (scale * values)[6] * own[:, 2]
        return np.concatenate([sides * own[:, 0] - radius, own[:, 1]])

    guess = np.array([0, 0, 0, 0, 0, 0.5, 0.0])
    found = least_squares(deviations, guess, jac="3-point", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    line = _line(scale * found.x, found.jac / scale, found.fun)
    return frame_of(found.x), line


def _check_units(columns: list[Array]) -> None:
    """Raise if the columns do not have the size of an arm, as with a wrong unit."""
    for points in columns:
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        if steps.max() > max(300 * np.median(steps), 2 * LENGTH_RANGE[1]):
            raise ConfigError(
                "some markers of a column are a thousand times farther out than others: m and mm "
                "are mixed; use one unit"
            )
    sizes = [float(np.linalg.norm(np.ptp(points, axis=0))) for points in columns]
    low, high = sorted(sizes)
    if high > 100 * low:
        raise ConfigError(
            f"the columns are {sizes[0]:.3g} m and {sizes[1]:.3g} m long: one is in m and the "
            "other in mm, or they are of different things; use one unit"
        )
    for size in sizes:
        if not LENGTH_RANGE[0] <= size <= 2 * LENGTH_RANGE[1]:
            factor = "mm read as m" if size > 2 * LENGTH_RANGE[1] else "m read as mm"
            raise ConfigError(
                f"a column of markers is {size:.3g} m long, and {LENGTH_RANGE[0]:g} to "
                f"{LENGTH_RANGE[1]:g} m fit an arm: is it {factor}? give unit (--unit) m, cm or mm"
            )


def _check_mixed(columns: list[Array], lines: list[tuple[Array, Array, float, Kept]]) -> None:
    """Raise if both columns lie on one line, or markers of one lie on the line of the other."""
    (p, u, _, _), (q, v, _, _) = lines
    between = np.linalg.norm((p - q) - ((p - q) @ u) * u)
    if between < 2 * RADIUS_RANGE[0] and abs(u @ v) > 0.95:
        raise ConfigError(
            f"the two columns lie on one line ({MM * between:.2g} mm apart), which determines no "
            "radius; give columns on opposite sides of the arm"
        )
    for i, (points, (_, _, _, kept)) in enumerate(zip(columns, lines, strict=True)):
        middle, direction, deviation, _ = lines[1 - i]
        away = points - middle
        across = np.linalg.norm(away - np.outer(away @ direction, direction), axis=1)
        strangers = np.flatnonzero(~kept & (across < OUTLIER_DEVIATIONS * deviation))
        if len(strangers):
            numbers = ", ".join(str(k + 1) for k in strangers)
            raise ConfigError(
                f"of the {('first', 'second')[i]} column, marker {numbers} lies on the line of the "
                "other: columns are swapped there; check which marker belongs to which column"
            )


def _check_length(length: float) -> None:
    """Raise if the markers without outliers do not extend over the length of an arm in m."""
    if not LENGTH_RANGE[0] <= length <= LENGTH_RANGE[1]:
        raise ConfigError(
            f"the markers extend {length:.3g} m along the axis, and {LENGTH_RANGE[0]:g} to "
            f"{LENGTH_RANGE[1]:g} m fit an arm; check their unit, and use those of the arm alone"
        )


def _check_along(own: list[Array], length: float) -> None:
    """Raise if columns are not along the axis, or along different parts of it."""
    for points, name in zip(own, ("first", "second"), strict=True):
        if np.ptp(points[:, 2]) < 0.5 * length:
            raise ConfigError(
                f"the {name} column extends {CM * np.ptp(points[:, 2]):.3g} cm along the axis and "
                f"both together {CM * length:.3g} cm; both must run along the sleeve: are x, y "
                "and z in this order?"
            )


def _check_radii(lines: tuple[Line, ...], length: float) -> None:
    """Raise if the radius is not that of an arm."""
    ends = [line.radius + line.taper * z for line in lines for z in (0.0, length)]
    if not (RADIUS_RANGE[0] <= min(ends) and max(ends) <= RADIUS_RANGE[1]):
        raise ConfigError(
            f"the radius comes out as {CM * min(ends):.3g} to {CM * max(ends):.3g} cm, and "
            f"{CM * RADIUS_RANGE[0]:g} to {CM * RADIUS_RANGE[1]:g} cm fit an arm; check the "
            "unit, the order of x, y and z, and whether the columns lie on opposite sides"
        )
