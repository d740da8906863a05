"""Modes of the ends of a lumen: of a round bore in closed form, of any other section numerically.

The modes of a section solve its Neumann problem, in the same polynomials as the sound in the
lumen but of a higher degree. Cut-on wavenumbers are multiplied by an effective radius: that of a
round bore, or for any other section that of the circle of equal area. For a round bore the products
are the zeros j' of the derivatives of the Bessel functions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from acoustube.base.errors import ConfigError
from acoustube.waves.spectral.assembly import Boxes, section_matrices
from acoustube.waves.spectral.polynomials import (
    Array,
    Index,
    Polynomials,
    gram,
    moments,
    polynomials,
)
from acoustube.waves.spectral.ports import PortModes, port_functions, port_modes, wall_signs
from acoustube.waves.spectral.walls import Contours, Wall

SECTION_DEGREE = 18
"""Total degree of the polynomials for the modes of a section that is not round."""

MIRROR_PERTURBATION = 1e-6
"""Divided by the squared radius, the factor of the reflection x -> -x that is subtracted from the
stiffness: it separates symmetric from antisymmetric modes of equal cut-on."""
SIGN_POINTS = 24
"""Number of points over half the width, and over half the height, of a section, at which the signs
of its modes are determined."""


@dataclass(frozen=True, eq=False)
class Section:
    """Section of a straight end of a lumen that is not round, with its modes of one symmetry.

    Attributes
    ----------
    contours : Contours
        Contour of the one section.
    boxes : Boxes
        Box of the polynomials: the section's bounding box; for a displaced wall, that of the
        unmoved wall's section.
    extent : Boxes
        Bounding box of the section itself.
    basis : Polynomials
    coefficients : ndarray
        Coefficients of the modes, normalised to a unit integral of the square, (n, n_modes).
    modes : PortModes
        All modes that the basis resolves.
    alike : ndarray
        Overlap, from 0 to 1, of each mode with the unmoved wall's mode of equal index, (n_modes,).
        One for a wall that is not displaced.
    """

    contours: Contours
    boxes: Boxes
    extent: Boxes
    basis: Polynomials
    coefficients: Array
    modes: PortModes
    alike: Array

    def chosen(self, modes: PortModes) -> Array:
        """Return the coefficients of some of the section's modes, (n, n_modes)."""
        return self.coefficients[:, [self.modes.names.index(name) for name in modes.names]]


def end_modes(wall: Wall, highest: float, odd: bool | None, lowest: float = -1.0) -> PortModes:
    """Return the modes of the ends with `lowest` < j' <= `highest`, in the order of their cut-ons.

    Parameters
    ----------
    wall : Wall
    highest, lowest : float
        Bounds of j', the cut-on wavenumber times the wall's `radius`.
    odd : bool or None
        True for the modes antisymmetric about x = 0, False for the symmetric ones; None for both.
    """
    if wall.circular:
        return port_modes(highest, odd, lowest)
    modes = section_of(wall, odd).modes
    kept = (modes.zeros > lowest) & (modes.zeros <= highest)
    return PortModes(
        names=tuple(name for name, there in zip(modes.names, kept, strict=True) if there),
        m=modes.m[kept], zeros=modes.zeros[kept], sine=modes.sine[kept],
    )  # fmt: skip


def end_functions(wall: Wall, modes: PortModes, basis: Polynomials, box: Array) -> Array:
    """Integrate polynomials times the normalised modes over an end, in m, (n, n_modes).

    Parameters
    ----------
    wall : Wall
    modes : PortModes
        Some of the modes of :func:`end_modes`.
    basis : Polynomials
    box : ndarray
        Centre and half width in x, then in y, of the end's box in m: x0, a, y0, b, (4,).
    """
    if wall.circular:
        return port_functions(modes, basis, box, wall.radius)
    section = section_of(wall, basis.odd)
    rich, n = section.basis, section.basis.degree
    contours, boxes = section.contours, section.boxes
    x = (contours.x - box[0]) / box[1]
    y = (contours.y - box[2]) / box[3]
    moment = moments(2 * n, x, y, contours.x_t * contours.weight, boxes.b)
    products = gram(moment, n, rich.i, rich.j)[0]
    place = {pair: row for row, pair in enumerate(zip(rich.i, rich.j, strict=True))}
    rows = [place[pair] for pair in zip(basis.i, basis.j, strict=True)]
    found = basis.mix @ products[rows] @ rich.mix.T @ section.chosen(modes)
    return np.asarray(found)


class Rim(NamedTuple):
    """Products of the modes of an end at points of its contour.

    Attributes
    ----------
    product, slope : ndarray
        Products of two modes in 1/m, and products of their derivatives along the contour in 1/m3.
        Both include the length of contour at each point, (n_points, n, n). A round end has one
        point, with the integrals over the contour.
    section : Section or None
        None if the end is round.
    """

    product: Array
    slope: Array
    section: Section | None


def rim_of(wall: Wall, modes: PortModes, odd: bool | None) -> Rim:
    """Return the products of the modes of one symmetry along the contour of an end."""
    if wall.circular:
        m, zeros = modes.m, modes.zeros
        share = 1 - np.divide(m, zeros, out=np.zeros_like(zeros), where=zeros > 0) ** 2
        edge = np.sqrt(2 / (wall.radius * share)) * wall_signs(modes)
        alike = (m[:, None] == m) & (modes.sine[:, None] == modes.sine)
        product = np.outer(edge, edge) * alike
        slope = product * (m / wall.radius)[:, None] * (m / wall.radius)
        return Rim(product[None], slope[None], None)
    section = section_of(wall, odd)
    contours, boxes, basis = section.contours, section.boxes, section.basis
    x, y = (contours.x[0] - boxes.x0) / boxes.a, (contours.y[0] - boxes.y0) / boxes.b
    chosen = section.chosen(modes)
    value = basis.values(x, y)
    other = polynomials(basis.degree, None if basis.odd is None else not basis.odd)
    p_x, p_y = basis.dx @ other.values(x, y) / boxes.a, basis.dy @ value / boxes.b
    speed = np.hypot(contours.x_t[0], contours.y_t[0])
    along = (p_x * contours.x_t[0] + p_y * contours.y_t[0]) / speed
    length = (speed * contours.weight)[:, None, None]
    parts = ((chosen.T @ part).T for part in (value, along))
    product, slope = (length * part[:, :, None] * part[:, None] for part in parts)
    return Rim(product, slope, section)


@lru_cache(maxsize=8)
def section_of(wall: Wall, odd: bool | None) -> Section:
    """Return the section of a straight end with its modes of one symmetry.

    The modes of a displaced wall's end have the coordinates and signs of the unmoved end's modes,
    so that their difference gives a derivative where `Section.alike` is about one.

    Raises
    ------
    ConfigError
        If the section overlaps itself or is too slender.
    """
    basis = polynomials(SECTION_DEGREE, odd)
    z = np.array([wall.ends[0]])
    unmoved = None if wall.unmoved is None else section_of(wall.unmoved, odd)
    extent = _end_box(wall, z)
    boxes = extent if unmoved is None else unmoved.boxes
    contours = wall.contours(z, SECTION_DEGREE)
    mass, _, stiffness = (part[0] for part in section_matrices(contours, boxes, basis))
    mirror = np.zeros_like(mass)
    if odd is None:
        mirrored = np.where(basis.i % 2 == 0, 1.0, -1.0)
        # Integrals of functions times reflected ones; products odd in x change sign in reflection.
        mirror = mass @ (basis.mix @ (mirrored[:, None] * np.linalg.inv(basis.mix))).T
    # Pairs of equal cut-on mix arbitrarily; a small multiple of the reflection separates them.
    apart = MIRROR_PERTURBATION / wall.radius**2 * (mirror + mirror.T) / 2
    try:
        vectors = eigh(stiffness - apart, mass)[1]
    except np.linalg.LinAlgError as cause:
        raise ConfigError(
            "the end's section overlaps itself or is too slender for the spectral solver; use the "
            "time-domain solver (acoustube.waves.scatter)"
        ) from cause
    square = np.einsum("im,ij,jm->m", vectors, stiffness, vectors)
    zeros = np.sqrt(np.maximum(square, 0.0)) * wall.radius
    if not odd:
        zeros[0] = 0.0
    sine = np.full(len(zeros), bool(odd))
    if odd is None:
        sine = np.einsum("im,ij,jm->m", vectors, mirror, vectors) < 0
    names, m = _names(sine)
    if unmoved is None:
        positive = _in_first_lobes(contours, boxes, basis, vectors)
    else:
        positive = np.einsum("im,ij,jm->m", vectors, mass, unmoved.coefficients)
    vectors = vectors * np.where(positive < 0, -1, 1)
    alike = np.ones(len(zeros)) if unmoved is None else np.abs(positive)
    modes = PortModes(names, m, zeros, sine)
    return Section(contours, boxes, extent, basis, vectors, modes, alike)


def _in_first_lobes(contours: Contours, boxes: Boxes, basis: Polynomials, vectors: Array) -> Array:
    """Return the value of each mode at a point of its first lobe, which determines its sign, (n,).

    The point is the first of a grid in x > 0 at which the magnitude exceeds half of the largest.
    The grid has columns of rising x, each taken from the middle down, then from the middle up.
    """
    side = (np.arange(SIGN_POINTS) + 0.5) / SIGN_POINTS
    across, up = np.meshgrid(side, np.concatenate([-side, side]), indexing="ij")
    x, y = across.ravel(), up.ravel()
    # Inside the contour a half line upwards crosses it an odd number of times. The contour of half
    # a section is closed along x = 0.
    rim = [(contours.x[0] - boxes.x0) / boxes.a, (contours.y[0] - boxes.y0) / boxes.b]
    (here_x, here_y), (next_x, next_y) = rim, (np.roll(part, -1) for part in rim)
    passes = (here_x <= x[:, None]) != (next_x <= x[:, None])
    share = np.divide(x[:, None] - here_x, next_x - here_x, out=0.0 * passes, where=passes)
    above = passes & (here_y + share * (next_y - here_y) > y[:, None])
    inside = above.sum(axis=1) % 2 == 1
    found = basis.values(x[inside], y[inside]).T @ vectors
    high = np.abs(found) > 0.5 * np.abs(found).max(axis=0)
    return np.asarray(np.take_along_axis(found, high.argmax(axis=0)[None], 0)[0])


def _end_box(wall: Wall, z: Array) -> Boxes:
    """Return the bounding box of a straight end at a coordinate z in m, (1,)."""
    x, y, *_ = wall.lines(z)
    low, high = np.array([x.min(), y.min()]), np.array([x.max(), y.max()])
    (x0, y0), (a, b) = (low + high) / 2, (high - low) / 2
    still = np.zeros(1)
    x0 = 0.0 if wall.symmetric else x0
    return Boxes(still + x0, still + a, still + y0, still + b, still, still, still, still)


def _names(sine: NDArray[np.bool_]) -> tuple[tuple[str, ...], Index]:
    """Return the modes' names and nodal diameters, those of the round bore's modes of equal rank.

    The rank is counted among the modes of equal symmetry, in the order of the cut-ons. `sine` is
    True for modes antisymmetric about x = 0.
    """
    highest = 4.0
    while True:
        known = {side: port_modes(highest, side) for side in (False, True)}
        if all(len(known[side]) >= np.sum(sine == side) for side in known):
            break
        highest *= 1.5
    count = np.where(sine, np.cumsum(sine), np.cumsum(~sine)) - 1
    found = [(known[bool(s)], i) for s, i in zip(sine, count, strict=True)]
    return tuple(modes.names[i] for modes, i in found), np.array([modes.m[i] for modes, i in found])
