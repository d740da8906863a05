"""Layout of a sleeve: its tubes, their coverage of the skin, and their resolution.

"The sleeve paper" is Wearable, Fabric-Embedded Acoustic Waveguides for Meter-Scale Contact
Localization and Force Sensing.
"""

from __future__ import annotations

import warnings
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import pi

import numpy as np

from acoustube.base.checks import ANGLE, DISTANCE, LENGTH, PLACE, Reals, Several, checked
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.base.types import Array
from acoustube.base.units import CM, MM
from acoustube.sleeve.arm_fit import Arm
from acoustube.sleeve.helix import Helix, nearest

DEAD_ZONE = 0.15
"""Distance in m within which the send pulse masks every echo, as in the sleeve paper."""
REACH = 2.5
"""Largest distance in m of a detected press, for the sleeve paper's and EchoTube's 8 mm tube."""
LEAD = 0.15
"""Length in m of the lead, the tube before the sleeve; equal to the dead zone, as in the paper."""
OUTER_DIAMETER = 11.1e-3
"""Outer diameter of the sleeve paper's tube in m."""
N_TUBES = 2
COVERED_HALF_WIDTH = 0.01
"""Half width in m of the skin covered by a tube: a contact of 25 mm in diameter, centred at this
distance from the tube, still presses the tube."""
DISTANCE_DEVIATION = 0.05
"""Standard deviation of a distance in m: 5.23 cm is the sleeve paper's median error on the
flat tube."""
SKIN_PLACES = 16_000
"""Number of sampling points of the skin."""
GOLDEN_RATIO = (5**0.5 - 1) / 2


@dataclass(frozen=True, kw_only=True, eq=False)
class Layout:
    """Coverage and resolution of a sleeve.

    Attributes
    ----------
    tube_lengths : ndarray
        Total length of lead and helix of each tube in m.
    detection_range : ndarray
        Range of distances on each tube in which a press is detected, in m, (n_tubes, 2).
    pitch : float
        Advance of a tube along the axis per loop in m.
    spacing : float
        Distance between neighbouring tubes, across them, at the middle of the sleeve, in m.
    skin_area : float
        Area of the skin under the sleeve in m2.
    within : float
        Half width of the skin covered by a tube in m.
    coverage : float
        Fraction of the skin whose nearest point on a tube is at most `within` away, and in the
        detection range of that tube.
    blind : float
        Fraction of the skin whose nearest point on a tube is in the dead zone or beyond the reach.
    deviation : float
        Standard deviation of a distance in m.
    patch_area : float
        Area in m2 that is resolved: two standard deviations along the tube times the spacing.
    patches : float
        Number of resolved areas (`patch_area`) on the part of the skin that is not blind.
    """

    tube_lengths: Array
    detection_range: Array
    pitch: float
    spacing: float
    skin_area: float
    within: float
    coverage: float
    blind: float
    deviation: float
    patch_area: float
    patches: float

    @property
    def heard(self) -> Array:
        """Former name of :attr:`detection_range`."""
        warnings.warn("Layout.heard is detection_range now", DeprecationWarning, stacklevel=2)
        return self.detection_range


@checked(
    arm=Arm,
    loops=Number(-1e6, 1e6),
    n_tubes=Number(1, 100, "tubes", whole=True),
    phase=ANGLE,
    lead=DISTANCE,
    length=LENGTH,
)
def wound(
    arm: Arm,
    loops: float,
    *,
    n_tubes: int = N_TUBES,
    phase: float = 0.0,
    hand: str = "right",
    lead: float = LEAD,
    length: float | None = None,
) -> list[Helix]:
    """Return the helices of tubes wound around an arm that was fitted to markers.

    Parameters
    ----------
    arm : Arm
    loops : float
        Number of turns of each tube over the length.
    n_tubes : int
        Number of tubes. One or two start at the angles of the columns of markers; more are spaced
        evenly, starting at the first column. Each of two tubes has the radius fitted to its own
        column; one tube, or three and more, that of the first column.
    phase : float
        Angle in rad that is added to the angles at which the tubes start.
    hand : str
        ``right`` or ``left``.
    lead : float
        Length of tube before the helix in m.
    length : float, optional
        Extent along the axis in m; that of the markers if not given.

    Returns
    -------
    list of Helix

    Raises
    ------
    ConfigError
        If an argument is out of range; see :class:`~acoustube.sleeve.helix.Helix`.
    """
    starts = [arm.angles[0] + 2 * pi * i / n_tubes for i in range(n_tubes)]
    if n_tubes <= 2:
        starts = list(arm.angles[:n_tubes])
    lines = [arm.lines[i] if n_tubes == 2 else arm.lines[0] for i in range(n_tubes)]
    return [
        Helix(
            radius=line.radius,
            taper=line.taper,
            length=length or arm.length,
            loops=loops,
            phase=start + phase,
            hand=hand,
            lead=lead,
            frame=arm.frame,
        )
        for start, line in zip(starts, lines, strict=True)
    ]


@checked(
    length=LENGTH,
    girths=Reals(1e-3, 1e3, "m", ndim=1, last=2),
    loops=Number(-1e6, 1e6),
    pitch=PLACE,
    n_tubes=Number(1, 100, "tubes", whole=True),
    phase=ANGLE,
    lead=DISTANCE,
    outer_diameter=LENGTH,
    reach=LENGTH,
)
def design(
    length: float,
    girths: tuple[float, float],
    *,
    loops: float | None = None,
    pitch: float | None = None,
    n_tubes: int = N_TUBES,
    phase: float = 0.0,
    hand: str = "right",
    lead: float = LEAD,
    outer_diameter: float = OUTER_DIAMETER,
    reach: float = REACH,
) -> list[Helix]:
    """Return the helices of tubes wound around a forearm of given length and circumferences.

    Parameters
    ----------
    length : float
        Length of the sleeve along the arm in m.
    girths : tuple of float
        Circumference of the arm in m at the end near the sensors, and at the far end.
    loops, pitch : float
        Number of turns over the length, or advance per turn in m. Exactly one must be given.
    n_tubes : int
        Number of tubes, wound side by side at even angles.
    phase : float
        Angle at which the first tube starts, in rad.
    hand : str
        ``right`` or ``left``.
    lead : float
        Length of tube before the helix in m.
    outer_diameter : float
        Outer diameter of the tube in m; the centre line is half a diameter above the skin.
    reach : float
        Largest distance at which a press is detected, in m.

    Returns
    -------
    list of Helix

    Raises
    ------
    ConfigError
        If not exactly one of `loops` and `pitch` is given, an argument is out of range, a tube with
        its lead is longer than the reach, or the tubes do not fit side by side.
    """
    if (loops is None) == (pitch is None):
        raise ConfigError("a layout needs loops or a pitch; give one of them, such as loops = 9")
    if pitch is not None:
        if not 0 < pitch <= 4 * length:
            raise ConfigError(
                f"pitch = {CM * pitch:g} cm must be positive and at most {400 * length:g} cm, "
                "four lengths of the sleeve"
            )
        loops = length / pitch
    first, last = (girth / (2 * pi) + outer_diameter / 2 for girth in girths)
    tubes = [
        Helix(
            radius=first,
            taper=(last - first) / length,
            length=length,
            loops=loops or 0.0,
            phase=phase + 2 * pi * i / n_tubes,
            hand=hand,
            lead=lead,
        )
        for i in range(n_tubes)
    ]
    check_reach(tubes, reach)
    check_room(tubes, outer_diameter)
    return tubes


@checked(tubes=Several(Helix, 1), reach=LENGTH)
def check_reach(tubes: Sequence[Helix], reach: float) -> None:
    """Raise ConfigError if a tube with its lead is longer than the sensor's reach in m."""
    longest = max(tubes, key=lambda tube: tube.tube_length)
    if longest.tube_length > reach:
        fitting = _most_loops(longest, reach)
        advice = f"use {fitting:g} loops or fewer" if fitting > 0.1 else "shorten the lead"
        raise ConfigError(
            f"loops = {longest.loops:.4g} over a length of {CM * longest.length:.4g} cm and a lead "
            f"of {CM * longest.lead:.4g} cm needs a tube of {CM * longest.tube_length:.0f} cm, and "
            f"presses are detected up to {CM * reach:.0f} cm; {advice}, use more tubes, or raise "
            "the reach"
        )


def _most_loops(tube: Helix, longest: float) -> float:
    """Return the largest multiple of 0.1 loops that needs a tube of at most `longest` m."""
    tenths = range(1, int(10 * tube.loops) + 1)
    return bisect_right(tenths, longest, key=lambda n: replace(tube, loops=n / 10).tube_length) / 10


@checked(tubes=Several(Helix, 1), outer_diameter=LENGTH)
def check_room(tubes: Sequence[Helix], outer_diameter: float) -> None:
    """Raise ConfigError if the least spacing of tubes is under their outer diameter in m.

    All are taken to have the shape of the first; they may start at uneven angles.
    """
    starts = np.sort([tube.phase / (2 * pi) % 1 for tube in tubes])
    narrowest = float(np.diff(starts, append=starts[0] + 1).min())
    room = spacing(tubes) * len(tubes) * narrowest
    if room < outer_diameter:
        raise ConfigError(
            f"n_tubes = {len(tubes)} over a length of {CM * tubes[0].length:.4g} cm would be "
            f"{MM * room:.1f} mm apart, less than their {MM * outer_diameter:g} mm outer diameter; "
            "use fewer loops, a larger pitch or fewer tubes, or start them at even angles"
        )


@checked(tubes=Several(Helix, 1))
def spacing(tubes: Sequence[Helix]) -> float:
    """Return the distance in m between neighbouring tubes, across them, at the sleeve's middle.

    All tubes are taken to have the shape of the first, and to be spaced evenly.
    """
    tube = tubes[0]
    along = float(np.hypot(1, tube.taper) / tube.density(tube.length / 2))
    around = float(abs(tube.twist) * tube.radius_at(tube.length / 2)) * along
    return tube.pitch / len(tubes) * around


@checked(tubes=Several(Helix, 1), dead_zone=DISTANCE, reach=LENGTH, within=LENGTH, deviation=LENGTH)
def layout(
    tubes: Sequence[Helix],
    *,
    dead_zone: float = DEAD_ZONE,
    reach: float = REACH,
    within: float = COVERED_HALF_WIDTH,
    deviation: float = DISTANCE_DEVIATION,
) -> Layout:
    """Return coverage and resolution of a sleeve.

    Parameters
    ----------
    tubes : sequence of Helix
        Tubes around the same arm. Spacing and skin are computed from the shape of the first.
    dead_zone, reach : float
        Start and end of the detection range along a tube, in m.
    within : float
        Half width of the skin covered by a tube in m.
    deviation : float
        Standard deviation of a distance in m.

    Returns
    -------
    Layout

    Notes
    -----
    The skin is the cone on which the centre line of the first tube lies, between the ends of the
    sleeve; distances to a tube are straight ones. Areas are sums over evenly spread points.
    """
    tube = tubes[0]
    places, weights = _skin(tube)
    found = nearest(tubes, tube.frame.outwards(places))
    lengths = np.array([each.tube_length for each in tubes])
    detection_range = np.array(
        [
            [min(max(t.lead, dead_zone), n), min(n, reach)]
            for t, n in zip(tubes, lengths, strict=True)
        ]
    )
    low, high = detection_range[found.tube].T
    detected = (found.distance >= low) & (found.distance <= high)
    area = float(weights.sum())
    patch = 2 * deviation * spacing(tubes)
    return Layout(
        tube_lengths=lengths,
        detection_range=detection_range,
        pitch=tube.pitch,
        spacing=spacing(tubes),
        skin_area=area,
        within=within,
        coverage=float(weights[detected & (found.gap <= within)].sum() / area),
        blind=float(weights[~detected].sum() / area),
        deviation=deviation,
        patch_area=patch,
        patches=float(weights[detected].sum() / patch),
    )


def _skin(tube: Helix) -> tuple[Array, Array]:
    """Return points on the skin in the arm's coordinates in m, (n, 3), and their areas in m2."""
    n = SKIN_PLACES
    z = (np.arange(n) + 0.5) * tube.length / n
    # Golden angle, so that no row of points follows a loop, as it might on a grid.
    psi = 2 * pi * GOLDEN_RATIO * np.arange(n)
    r = tube.radius_at(z)
    weights = 2 * pi * r * np.hypot(1, tube.taper) * tube.length / n
    return np.stack([r * np.cos(psi), r * np.sin(psi), z], axis=-1), weights
