"""Modes of a straight duct on the grid: mode shapes, cut-on frequencies and axial phases.

A straight part of the grid repeats one layer of cells, whose axial faces have the open fractions of
its volumes. The modes of the layer then propagate without coupling: the amplitude of each obeys the
scheme of a single line of cells. With Omega = omega dt, theta the phase per layer, nu = c dt / dz,
k^2 the layer's eigenvalue in 1/s2 times dt^2, beta the coefficient of the axial correction of
:mod:`acoustube.waves.scheme.operator`, s = 4 sin^2(Omega/2) and X = 4 sin^2(theta/2),

    s (1 + kappa h) = b (k^2 (1 - d h) + nu^2 X (1 + beta X) (1 - d_z h)).

h is the transfer function from the pressure to its fractional integral of order 1/2; kappa, d and
d_z are coefficients of the losses at the wall, to first order in the boundary layers, and b is the
factor of the air's absorption. Without losses, in a section symmetric about x = 0, this dispersion
relation is exact on the grid: ingoing and outgoing waves can be separated, or moved to another
plane, without an error of discretisation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.linalg import eigh

from acoustube.air import Air
from acoustube.waves.grid.polyhedron import Array
from acoustube.waves.grid.section import section_stiffness
from acoustube.waves.modes.round_duct import Mode, axial_wavenumber, cut_on_frequency, modes_below
from acoustube.waves.scheme.losses import Losses
from acoustube.waves.scheme.operator import Operator
from acoustube.waves.scheme.problem import Scheme

Complex = NDArray[np.complexfloating[Any, Any]]


@dataclass(frozen=True, kw_only=True, eq=False)
class DuctModes:
    """The modes of one layer of a grid.

    Attributes
    ----------
    squares : ndarray
        Eigenvalues in 1/s2, (n_modes,): the squares of the cut-ons' angular frequencies in
        continuous time.
    cut_ons : ndarray
        Cut-on frequencies on the grid, its time steps included, in Hz, (n_modes,).
    shapes : ndarray
        Pressures with a mean square of one over the section, (n_modes, nx, ny). In a round bore
        they have the signs of J_m times cos(m phi), or times sin(m phi) if antisymmetric, with phi
        from -y towards +x, for a half and for a whole tube.
    weights : ndarray
        Projection weights, (n_modes, nx, ny): a modal amplitude is the sum of the products of its
        weights with the pressures of a layer.
    odd : ndarray of bool
        Whether each mode is antisymmetric about x = 0, (n_modes,).
    losses : dict of ndarray
        Loss coefficients of the modes by name, (n_modes,): with the symbols of the module's
        docstring, ``compliance`` is kappa, ``across`` is the product d (k / dt)^2 and ``along`` is
        the product d_z (c / dz)^2. Empty without losses.
    """

    squares: Array
    cut_ons: Array
    shapes: Array
    weights: Array
    odd: NDArray[np.bool_]
    losses: dict[str, Array]


def duct_modes(
    scheme: Scheme, volume: Array, layer: int, highest: float, *, whole: bool, odd: bool = False
) -> DuctModes:
    """Return the modes of one layer of a grid.

    Parameters
    ----------
    scheme : Scheme
        Coefficients of the grid.
    volume : ndarray
        Volume fractions of the grid, (nx, ny, nz).
    layer : int
        Index of a layer in a straight part.
    highest : float
        Largest cut-on in Hz of the modes that are returned.
    whole : bool
        Whether the grid is that of the whole tube, rather than of the half x > 0.
    odd : bool
        Whether the scheme of a half is that of the antisymmetric modes, with zero pressure on
        x = 0; without effect for a whole tube.

    Returns
    -------
    DuctModes
        In the order of their cut-ons.
    """
    filled = volume[:, :, layer]
    operator = scheme.operator
    mass = filled[filled > 0]
    stiffness = _across(operator, layer, filled > 0)
    # Each symmetry alone, which separates degenerate pairs: the slight asymmetry of the triangles
    # of an end would rotate the modes of a pair by any angle.
    sides = (False, True) if whole else (odd,)
    found = [
        _eigenmodes(stiffness, mass, _symmetric(filled, side) if whole else sp.identity(mass.size))
        for side in sides
    ]
    squares, vectors = (np.concatenate(parts) for parts in zip(*found, strict=True))
    odd_ones = np.repeat(sides, [len(part) for part, _ in found])
    order = np.argsort(squares)
    order = order[squares[order] < (2 * np.pi * highest) ** 2]
    squares, odd_ones, vectors = squares[order], odd_ones[order], vectors[order]
    # The plane mode's eigenvalue is zero except for rounding.
    squares = np.where(np.abs(squares) < 1e-6 * (2 * np.pi * highest) ** 2, 0.0, squares)
    shapes = np.zeros((len(vectors), *filled.shape))
    vectors = vectors * _signs(vectors, filled > 0, whole)[:, None]
    shapes[:, filled > 0] = vectors
    losses = scheme.losses
    dt = float(np.sqrt(scheme.step_squared))
    half_turns = np.arcsin(np.sqrt(np.maximum(squares, 0.0)) * dt / 2)
    return DuctModes(
        squares=squares,
        cut_ons=half_turns / (np.pi * dt),
        shapes=shapes,
        weights=shapes * filled / mass.sum(),
        odd=odd_ones,
        losses={} if losses is None else _modal_losses(losses, layer, filled, vectors),
    )


def _symmetric(filled: Array, odd: bool) -> sp.csr_matrix:
    """Return a basis of the pressures of one symmetry about x = 0, (n_cells, n).

    An open cell whose mirror image is closed belongs to the bases of both symmetries.
    """
    inside = filled > 0
    number = np.where(inside, np.cumsum(inside).reshape(inside.shape) - 1, -1)
    here, image = np.arange(inside.sum()), number[::-1][inside]
    first = here[(image < 0) | (here < image)]
    columns, paired = np.arange(len(first)), image[first] >= 0
    entries = np.concatenate([np.ones(len(first)), np.full(paired.sum(), -1.0 if odd else 1.0)])
    rows = np.concatenate([first, image[first][paired]])
    places = rows, np.concatenate([columns, columns[paired]])
    return sp.csr_matrix((entries, places), (len(here), len(first)))


def _eigenmodes(stiffness: sp.csr_matrix, mass: Array, basis: Any) -> tuple[Array, Array]:
    """Return squared angular frequencies, and modes (n, n_cells) with a mean square of one."""
    basis = basis @ sp.diags(1 / np.sqrt(basis.power(2).T @ mass))
    squares, coefficients = eigh((basis.T @ stiffness @ basis).toarray())
    return squares, (basis @ coefficients).T * np.sqrt(mass.sum())


def _signs(vectors: Array, inside: NDArray[np.bool_], whole: bool) -> Array:
    """Return the factors that give modes the signs of those of a round bore.

    Of the cells beside the plane x = 0, at x > 0 and from the axis downwards, the first whose
    pressure is above half of the highest is made positive. It lies in the first lobe of J_m.
    """
    x, y = np.nonzero(inside)
    n_x, n_y = inside.shape
    right = np.flatnonzero(x >= (n_x // 2 if whole else 0))
    side = 2 * y[right] + 1 - n_y
    found = vectors[:, right[np.lexsort((np.abs(side), side > 0, x[right]))]]
    high = np.abs(found) > 0.5 * np.abs(found).max(axis=1, keepdims=True)
    return np.asarray(np.sign(found[np.arange(len(found)), np.argmax(high, axis=1)]))


def _across(operator: Operator, layer: int, inside: NDArray[np.bool_]) -> sp.csr_matrix:
    """Return the stiffness matrix (n, n) of an operator in one layer, of its n open cells."""
    faces = operator.area_x[:, :, layer], operator.area_y[:, :, layer]
    return section_stiffness(*faces, inside)


def _modal_losses(losses: Losses, layer: int, filled: Array, vectors: Array) -> dict[str, Array]:
    """Return the wall's loss coefficients of each mode, by first-order perturbation."""
    inside = filled > 0
    mass = filled[inside]
    across = _across(losses.drag, layer, inside)
    compliance = np.asarray(losses.compliance[:, :, layer], float)[inside]
    # The axial faces of a straight part have the cells' open fractions, times (c / dz)^2.
    along = np.asarray(losses.drag.area_z[:, :, layer + 1], float)[inside]
    return {
        "compliance": vectors**2 @ (mass * compliance) / mass.sum(),
        "across": np.sum(vectors.T * (across @ vectors.T), axis=0) / mass.sum(),
        "along": vectors**2 @ along / mass.sum(),
    }


def phases(modes: DuctModes, scheme: Scheme, spacing: float, frequency: Array, c: float) -> Phases:
    """Return the axial phases of the modes along a straight part.

    Parameters
    ----------
    modes : DuctModes
    scheme : Scheme
    spacing : float
        Axial cell size in m.
    frequency : ndarray
        In Hz, (n,).
    c : float
        Sound speed in m/s.
    """
    dt2 = float(scheme.step_squared)
    beta = float(scheme.operator.beta)
    turn = np.exp(2j * np.pi * np.asarray(frequency) * np.sqrt(dt2))[:, None]
    nu2 = dt2 * (c / spacing) ** 2
    # A real quantity, so that rounding does not make a propagating mode grow or decay.
    inertia = 4 * np.sin(np.pi * np.asarray(frequency) * np.sqrt(dt2))[:, None] ** 2
    lossless = (inertia - dt2 * modes.squares) / nu2
    stiffness, axial, added = dt2 * modes.squares, np.ones(1), np.ones(1)
    if scheme.losses is not None:
        lost = scheme.losses
        decay, gain, wall, bulk = (
            np.array([float(value) for value in values])
            for values in (lost.decay, lost.gain, lost.wall, lost.bulk)
        )
        response = gain * (1 + 1 / turn) / 2 / (1 - decay / turn)
        h = response @ wall[:, None]
        air = 1 + float(lost.rate) * (1 - 1 / turn) - response @ bulk[:, None]
        added = 1 + modes.losses["compliance"] * h
        stiffness = air * dt2 * (modes.squares - h * modes.losses["across"])
        axial = air * (1 - h * modes.losses["along"] * (spacing / c) ** 2)
    square = (inertia * added - stiffness) / (nu2 * axial)
    return Phases(
        theta=_phase(square, beta),
        slope=nu2 * axial * _slope(square, beta),
        power=_slope(lossless, beta),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Phases:
    """Axial phases of modes, and their derivatives, each (n_frequencies, n_modes).

    Attributes
    ----------
    theta : ndarray
        Complex phase per layer: a wave over m layers is exp(-j theta m), for time dependence
        exp(+j omega t).
    slope : ndarray
        Derivative of the axial term of the module's dispersion relation, b nu^2 X (1 + beta X)
        (1 - d_z h), with respect to theta: the impedance of a source in one layer.
    power : ndarray
        Derivative of X (1 + beta X) without losses, to which the transmitted power is proportional;
        real where the mode propagates, imaginary where it is evanescent.
    """

    theta: Complex
    slope: Complex
    power: Complex


def _second_difference(square: Complex, beta: float) -> Complex:
    """Return X = 4 sin^2(theta / 2); -X is the symbol of the second difference along z.

    X is the root of X (1 + beta X) = `square` that tends to `square` as beta tends to 0; see the
    dispersion relation in the module's text.
    """
    return np.asarray(2 * square / (1 + np.sqrt(1 + 4 * beta * square + 0j)))


def _phase(square: Complex, beta: float) -> Complex:
    """Return the axial phase theta per cell of the wave that decays or propagates towards +z."""
    theta = 2 * np.arcsin(np.sqrt(_second_difference(square, beta) + 0j) / 2)
    theta = np.where(theta.imag > 0, -theta, theta)
    return np.asarray(np.where((theta.imag == 0) & (theta.real < 0), -theta, theta))


def _slope(square: Complex, beta: float) -> Complex:
    """Return the derivative of X (1 + beta X) with respect to theta."""
    theta = _phase(square, beta)
    return np.asarray(2 * np.sin(theta) * (1 + 2 * beta * _second_difference(square, beta)))


def labels(modes: DuctModes, radius: float, c: float) -> tuple[str, ...]:
    """Return the names of modes: those of the round bore's modes of equal symmetry and order.

    Parameters
    ----------
    modes : DuctModes
        In the order of their cut-ons.
    radius : float
        Radius of the round bore in m.
    c : float
        Sound speed in m/s.

    Returns
    -------
    tuple of str
        As ``00``, ``11c``, ``21s``: nodal diameters, nodal circles, and the symmetry of modes with
        nodal diameters.
    """
    highest, names = cut_on_frequency(1, 1, radius, c), {False: list[str](), True: list[str]()}
    while any(len(names[odd]) < np.sum(modes.odd == odd) for odd in names):
        highest *= 1.5
        known = modes_below(highest, radius, c)
        names = {
            odd: [_label(mode, odd) for mode in known if mode.m > 0 or not odd] for odd in names
        }
    found = {odd: iter(names[odd]) for odd in names}
    return tuple(next(found[bool(odd)]) for odd in modes.odd)


def _label(mode: Mode, odd: bool) -> str:
    """Return the name of a mode, as ``11c``."""
    symmetry = "" if mode.m == 0 else "s" if odd else "c"
    return f"{mode.m}{mode.n}{symmetry}"


def mode_numbers(label: str) -> tuple[int, int]:
    """Return the numbers of nodal diameters and circles from a mode's name."""
    digits = label.rstrip("cs")
    return int(digits[:-1]), int(digits[-1])


def wavenumbers(
    labels: Sequence[str], frequency: NDArray[Any], radius: float, air: Air, *, lossy: bool
) -> Complex:
    """Return the axial wavenumbers of named modes of a round bore, (n_frequencies, n_modes)."""
    found = (
        axial_wavenumber(*mode_numbers(name), frequency, radius, air, lossy=lossy)
        for name in labels
    )
    return np.stack(list(found), axis=-1)


def change_by_losses(radius: float, air: Air, label: str, frequency: NDArray[Any]) -> Complex:
    """Return the change of a named mode's squared axial wavenumber by losses in 1/m2, (n,)."""
    with_losses, without = (
        axial_wavenumber(*mode_numbers(label), frequency, radius, air, lossy=lossy)
        for lossy in (True, False)
    )
    return np.asarray(with_losses**2 - without**2)
