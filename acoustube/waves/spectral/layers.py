"""Boundary layers at a wall: viscous losses of tangential motion, thermal losses of compression.

To first order in D_v = sqrt(nu / (j omega)) and D_t = D_v / sqrt(Pr), for the kinematic viscosity
nu, the air within D_v of a wall does not move along it, and isothermal compression within D_t acts
like (gamma - 1) D_t more air. With stiffness K, mass M and wavenumber k the system matrix is

    A = K - k^2 M - D_v K_wall - (gamma - 1) D_t k^2 M_wall,

where K_wall and M_wall are the integrals over the wall of grad p . grad q, with gradients along the
wall, and of p q. If the air is only a few layers wide, this subtracts more than the air
contributes. There a slit of height h loses D tanh(h / 2D) at each wall instead of D, and a round
tube of diameter h loses D I1(h / 2D) / I0(h / 2D), with D either thickness. The wall's curvature
kappa determines the mixture of the two, and D is replaced by

    f D,    f = (1 - b) tanh(h / 2D) + b I1(h / 2D) / I0(h / 2D),    b = kappa h / 2 from 0 to 1,

where h is the diameter of the greatest circle in the section that touches the wall there. The
matrix then remains that of passive air as h vanishes, both limits are exact, and so is the first
correction by curvature, D - kappa D^2 / 2. Over a band, a singular value decomposition gives f as a
sum of few products of a function of position and a function of frequency. Where the walls are
pressed together, the mean velocity in the gap is that of a slit `LEAK` times as high, with f =
tanh(LEAK h / 2D) / LEAK for D_v only: touching walls seal, although the mechanics leaves a gap.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.special import ive

from acoustube.air import Air
from acoustube.waves.spectral.assembly import Boxes
from acoustube.waves.spectral.boundary import WallPoints
from acoustube.waves.spectral.polynomials import Array
from acoustube.waves.spectral.ports import Complex
from acoustube.waves.spectral.walls import Contours

NARROW_SECTION = 60.0
"""Height or width of a section, relative to the thickness ``|D_v|`` of the viscous boundary layer,
below which the gap between walls is measured at each point of the contour."""
NARROW_GAP = 12.0
"""Gap between walls, relative to the viscous layer's thickness ``|D_v|``, below which gaps are
measured in dented sections wider than `NARROW_SECTION`. In wider gaps the factor f of the layers is
that of a wide section within 1e-3."""
FEW_POINTS = 60
"""Approximate number of points round a contour from which gaps below `NARROW_GAP` are found."""
WIDE_GAP = 30.0
"""Smallest gap in an element that counts as wide, relative to the viscous layer's thickness
``|D_v|`` at the lowest frequency."""
MANY_LAYERS = 15.0
"""Real part of h / 2D, gap divided by twice the complex layer thickness, from which the factor f of
the layers is computed by its asymptotic series."""
TANGENTIAL = 1e-3
"""Sine of the angle between a wall and the line to another point, below which that point counts as
a neighbour on the same wall."""
LEAK = 0.7
"""Height of the slit whose mean velocity a sealed gap has, relative to the gap: air that could not
move at all would have mass without stiffness, which no polynomials resolve. At a depth of 8 mm
under a 25 mm rod the estimated error of the span of lossless fields is 2e-2 at 0.3, 1e-3 at 0.7."""
SEALING_WIDTH = 0.2
"""Range of gaps, relative to the sealing gap, over which walls pass from sealed to open. Gaps
vary little over a contact: if it were sealed at one height exactly, it would open at once over its
whole width, and no quadrature along the tube would converge."""
SAMPLES = 10
"""Number of frequencies from which the functions of position of the layers are derived."""
LEAST_PART = 1e-4
"""Smallest singular value of a function of position that is included in the sum for the layers'
factor f, relative to the norm of all values of f."""


class LayerSeries(NamedTuple):
    """Corrected thicknesses of boundary layers, as functions of frequency and position.

    These are f D_v and (gamma - 1) f D_t, with the complex viscous and thermal thicknesses D_v and
    D_t in m, and their factor f in narrow gaps. Each is a sum of n_parts products of a function of
    position and a function of frequency.

    Attributes
    ----------
    weights : ndarray
        Functions of position, for both sums, (n_parts, n_sections, n_points).
    viscous, thermal : ndarray
        Functions of frequency for f D_v and for (gamma - 1) f D_t, in m, (n_frequencies, n_parts).
    """

    weights: Array
    viscous: Complex
    thermal: Complex


def layer_thickness(frequency: Array, air: Air) -> tuple[Complex, Complex]:
    """Return the complex layer thicknesses D_v and D_t in m at frequencies in Hz, (n,) each."""
    viscous = np.sqrt(air.viscous_diffusivity / (2j * np.pi * frequency))
    return viscous, viscous / np.sqrt(air.prandtl)


def filling(width: Array, roundness: Array, thickness: Complex) -> Complex:
    """Return the factor f of the layer thickness D in a gap h (see the module's docstring).

    `width` is h in m, `roundness` the weight b of the term for a round tube, and `thickness` D in
    m; they are broadcast.
    """
    argument, b = np.broadcast_arrays(width / (2 * thickness), roundness)
    # The series has a relative error of 1e-7 where the air is many layers wide, mostly the case.
    inverse = 1 / argument
    series = 0.5 + inverse * (0.125 + inverse * (0.125 + 0.195 * inverse))
    found: Complex = np.array(1 - b * inverse * series)
    few = argument.real < MANY_LAYERS
    narrow, b = argument[few], b[few]
    found[few] = (1 - b) * np.tanh(narrow) + b * ive(1, narrow) / ive(0, narrow)
    return found


class Gaps(NamedTuple):
    """Gaps at points of a wall, from the largest inscribed circle that touches the wall there.

    Attributes
    ----------
    width, roundness : ndarray
        Diameter h of the circle in m, and weight b of the term for a round tube in the layers'
        factor f, (n_sections, n_points).
    measured : ndarray of bool
        Whether the widths of a section are measured at each point, (n_sections,).
    sealed : ndarray
        Weight from 0 (open) to 1 (pressed together), (n_sections, n_points).
    """

    width: Array
    roundness: Array
    measured: NDArray[np.bool_]
    sealed: Array


def gaps_of(points: WallPoints, thickness: float, like: Gaps | None = None) -> Gaps:
    """Return the gaps at points of a wall.

    Parameters
    ----------
    points : WallPoints
    thickness : float
        Thickness of the thickest viscous layer in m.
    like : Gaps, optional
        Gaps of nearly the same wall, whose `measured` is used.
    """
    contours, boxes = points.contours, points.boxes
    measured = (
        narrow_sections(contours, boxes, points.halved, thickness)
        if like is None
        else like.measured
    )
    width = gap_widths(contours, boxes, points.halved, measured)
    roundness = np.clip(curvature(contours) * width / 2, 0.0, 1.0)
    return Gaps(width, roundness, measured, sealing_weight(width, points.sealing_gap))


def sealing_weight(width: Array, sealing_gap: float) -> Array:
    """Return the weight of sealing of gaps, from 0 (open) to 1 (pressed together).

    It is a smooth step over `SEALING_WIDTH` about the sealing gap, of the shape of `width`.

    Parameters
    ----------
    width : ndarray
        Heights of gaps in m, of any shape.
    sealing_gap : float
        Height in m of a gap that is half sealed.
    """
    if not sealing_gap:
        return np.zeros_like(width)
    share = np.clip((1 - width / sealing_gap) / SEALING_WIDTH + 0.5, 0.0, 1.0)
    return np.asarray(share**2 * (3 - 2 * share))


def narrow_sections(
    contours: Contours, boxes: Boxes, halved: bool, thickness: float
) -> NDArray[np.bool_]:
    """Return a mask of the sections so narrow that their gaps are measured point by point.

    They are low or slender, or dented until opposite walls almost meet, as under a small indenter.
    """
    narrow = 2 * np.minimum(boxes.a, boxes.b) < NARROW_SECTION * thickness
    dented = np.any(curvature(contours) < 0, axis=1) & ~narrow
    few = slice(None, None, max(contours.x.shape[1] * (1 + halved) // FEW_POINTS, 1))
    contours = contours._replace(
        t=contours.t[few], weight=contours.weight[few],
        **{name: getattr(contours, name)[:, few] for name in ("x", "y", "x_t", "y_t")},
    )  # fmt: skip
    width = gap_widths(contours, boxes, halved, dented).min(axis=1)
    return narrow | (dented & (width < NARROW_GAP * thickness))


def layer_series(points: WallPoints, frequency: Array, air: Air) -> LayerSeries:
    """Return the corrected thicknesses of the layers at points of a wall, as sums of products.

    Parameters
    ----------
    points : WallPoints
    frequency : ndarray
        In Hz, (n,), rising.
    air : Air
    """
    sampled = _sampled(frequency)
    gaps = gaps_of(points, _thickest(sampled, air))
    return _series(points, gaps, _fillings(gaps, sampled, air), sampled, frequency, air)


def changed_series(
    points: WallPoints, shifted: tuple[WallPoints, WallPoints], step: float, frequency: Array,
    air: Air,
) -> LayerSeries:  # fmt: skip
    """Return derivatives of the corrected thicknesses by a parameter, at points moving with a wall.

    Parameters
    ----------
    points : WallPoints
    shifted : tuple of WallPoints
        The same points of the wall before and after a small step.
    step : float
        Difference of the parameter between the elements of `shifted`.
    frequency : ndarray
        In Hz, (n,), rising.
    air : Air
    """
    sampled = _sampled(frequency)
    thickest = _thickest(sampled, air)
    gaps = gaps_of(points, thickest)
    less, more = (_fillings(gaps_of(part, thickest, gaps), sampled, air) for part in shifted)
    return _series(points, gaps, (more - less) / step, sampled, frequency, air)


def _sampled(frequency: Array) -> Array:
    """Return the frequencies in Hz from which the functions of position are derived."""
    if len(frequency) == 1:
        return frequency
    return np.geomspace(frequency[0], frequency[-1], SAMPLES)


def _thickest(sampled: Array, air: Air) -> float:
    return float(np.abs(layer_thickness(sampled[:1], air)[0][0]))


def _fillings(gaps: Gaps, sampled: Array, air: Air) -> Complex:
    """Return factors f of viscous, then thermal layers, (2 n_sampled, n_sections n_points)."""
    width, roundness, share = gaps.width.ravel(), gaps.roundness.ravel(), gaps.sealed.ravel()
    layers = layer_thickness(sampled, air)
    both = np.stack([filling(width, roundness, d) for layer in layers for d in layer[:, None]])
    # A sealed gap has the mean velocity of a lower slit.
    closed, viscous = share > 0, both[: len(sampled)]
    leak = np.tanh(LEAK * width[closed] / (2 * layers[0][:, None])) / LEAK
    viscous[:, closed] += share[closed] * (leak - viscous[:, closed])
    return both


def _series(
    points: WallPoints, gaps: Gaps, values: Complex, sampled: Array, frequency: Array, air: Air
) -> LayerSeries:
    """Return corrected thicknesses f D from values of f, or their derivatives from those of f."""
    rows = np.concatenate([values.real, values.imag])
    number = points.rule.element
    of_element = np.repeat(number, gaps.width.shape[1])
    narrowest = np.full(number[-1] + 1, np.inf)
    np.minimum.at(narrowest, number, gaps.width.min(axis=1))
    wide = (narrowest > WIDE_GAP * _thickest(sampled, air))[of_element]
    functions, weights = _parts(rows, wide)
    halves = np.split(functions, 2)
    parts = (halves[0] + 1j * halves[1]).reshape(2, len(sampled), -1)
    scaled = [
        _between(sampled, part, frequency) * d[:, None]
        for part, d in zip(parts, layer_thickness(frequency, air), strict=True)
    ]
    return LayerSeries(
        weights.reshape(-1, *gaps.width.shape), scaled[0], (air.heat_capacity_ratio - 1) * scaled[1]
    )


def _parts(rows: Array, wide: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return values (n, n_points) as functions (n, n_parts) times weights (n_parts, n_points).

    The functions of the wide points (in elements without narrow gaps) come first. The weights of
    the other functions are zero at wide points, so that their integrals extend over few elements.
    """
    left, functions, weights = rows, [], []
    least = (LEAST_PART * np.linalg.norm(rows)) ** 2
    for where in (wide, ~wide):
        # Singular vectors from the smaller product matrix, because the points are many.
        square, turned = np.linalg.eigh(left[:, where] @ left[:, where].T)
        functions.append(turned[:, square > least])
        weights.append(functions[-1].T @ left)
        left = left - functions[-1] @ weights[-1]
        left[:, wide] = 0.0
    return np.concatenate(functions, axis=1), np.concatenate(weights)


def _between(sampled: Array, values: Complex, frequency: Array) -> Complex:
    if len(sampled) == 1:
        return values
    return np.asarray(CubicSpline(np.log(sampled), values)(np.log(frequency)))


def curvature(contours: Contours) -> Array:
    """Return the curvature of the sections' contours in 1/m, positive where they are convex."""
    angle = np.unwrap(np.arctan2(contours.y_t, contours.x_t), axis=1)
    return np.asarray(np.gradient(angle, contours.t, axis=1) / np.hypot(contours.x_t, contours.y_t))


def gap_widths(
    contours: Contours, boxes: Boxes, halved: bool, measured: NDArray[np.bool_]
) -> Array:
    """Return the diameter in m of the largest inscribed circle tangent to the wall at each point.

    For sections that are not `measured`, (n_sections,), it is the smaller of height and width.
    """
    width = np.tile(2 * np.minimum(boxes.a, boxes.b)[:, None], (1, contours.x.shape[1]))
    for section in np.flatnonzero(measured):
        here = np.stack([contours.x[section], contours.y[section]])
        inwards = np.stack([-contours.y_t[section], contours.x_t[section]])
        inwards /= np.hypot(*inwards)
        there, facing = here, inwards
        if halved:
            mirror = np.array([[-1.0], [1.0]])
            there, facing = (
                np.concatenate([part, (part * mirror)[:, ::-1]], axis=1) for part in (here, inwards)
            )
        touching = _touching(here, inwards, there, facing)
        width[section] = np.minimum(touching, width[section])
    return width


def _touching(here: Array, inwards: Array, there: Array, facing: Array) -> Array:
    """Return diameters of the largest circles inside a contour that touch it at given points.

    Each is the smallest circle that touches the contour there and passes through another point.

    Parameters
    ----------
    here, inwards : ndarray
        Given points in m and their inward normals of unit length, (2, n).
    there, facing : ndarray
        Points and inward normals of the whole contour, in its order, (2, n_all).

    Returns
    -------
    ndarray
        Diameters in m, (n,).

    Notes
    -----
    The circle that touches the wall with normal n and passes through a point at the vector a has
    the diameter a^2 / (a . n). Opposite walls may be much closer than the points of a contour:
    where the wall faces a point, the least value on the chord between two neighbours is taken.
    """
    away = there[:, None] - here[:, :, None]
    chord = np.roll(there, -1, axis=1) - there
    ahead, rise = np.einsum("pij,pi->ij", away, inwards), inwards.T @ chord
    square, length = (away**2).sum(axis=0), (chord**2).sum(axis=0)
    least = np.where(
        ahead > TANGENTIAL * np.sqrt(square), square / np.where(ahead > 0, ahead, 1.0), np.inf
    )
    slope = np.einsum("pij,pj->ij", away, chord)
    # Minimum of (square + 2 slope s + length s^2) / (ahead + rise s) over 0 < s < 1.
    turn = rise * square - 2 * slope * ahead
    down = length * ahead
    down = down + np.sqrt(np.maximum(down**2 + length * rise * turn, 0.0))
    s = np.clip(np.divide(turn, down, out=np.zeros_like(down), where=down > 0), 0.0, 1.0)
    opposite = (inwards.T @ facing < 0) & (inwards.T @ np.roll(facing, -1, axis=1) < 0)
    opposite &= (ahead > 0) & (ahead + rise > 0)
    reached = np.where(opposite, ahead + rise * s, 1.0)
    between = np.where(opposite, (square + s * (2 * slope + length * s)) / reached, np.inf)
    return np.asarray(np.minimum(least, between).min(axis=1))
