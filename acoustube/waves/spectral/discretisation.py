"""Discretisation of a lumen in a basis and in an enriched one, for the error estimate.

All matrices are those of the enriched basis: polynomials of a total degree higher by
`DEGREE_INCREASE`, and along each element one degree more. The basis itself consists of the first
functions of each.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from acoustube.waves.spectral.assembly import Elements, Layout, assemble
from acoustube.waves.spectral.elimination import factor, solve
from acoustube.waves.spectral.ends import Rim, end_functions, end_modes, rim_of
from acoustube.waves.spectral.polynomials import Array, Index, polynomials
from acoustube.waves.spectral.ports import FARTHEST, MARGIN, PortModes
from acoustube.waves.spectral.walls import Wall

DEGREE_INCREASE = 2
"""Difference of total degree between the richer basis and the basis."""
LAYER_RATIO = 0.476
"""(gamma - 1) / sqrt(Pr): effect of the thermal layer relative to the viscous one."""
LAYER_BLOCKS = 2
"""Number of powers of the layers' operator that extend a Krylov space."""
SPARE_POINTS = 3
"""Number of Gauss points along an element, in excess of its degree."""


@dataclass(frozen=True, eq=False)
class Discretisation:
    """Matrices of a lumen between its ports, for one symmetry about x = 0.

    Attributes
    ----------
    stiffness, mass : ndarray
        Of the elements in the enriched basis, (n_elements, size, size).
    layout : Layout
        Order of their unknowns.
    modes : PortModes
        Of the ports.
    ports : ndarray
        Integrals of the polynomials times the modes, in m, (n_ports, n_all, n_modes).
    heights : tuple of float
        z of the ports in m.
    radius : float
        Of the ports in m.
    rim : Rim
        Products of the modes along the contour of an end.
    halved : bool
        Whether it is the half beyond the plane about which the lumen is symmetric, with one port.
    layers : tuple of ndarray, optional
        Stiffness and mass of the wall, in whose response the Krylov space has one more block.
    """

    stiffness: Array
    mass: Array
    layout: Layout
    modes: PortModes
    ports: Array
    heights: tuple[float, float]
    radius: float
    rim: Rim
    halved: bool
    layers: tuple[Array, Array] | None = None

    @property
    def sides(self) -> tuple[bool, ...]:
        """Parities along z to solve for: True if the pressure is zero in the symmetry plane."""
        return (False, True) if self.halved else (False,)

    @property
    def load(self) -> Array:
        """Load vectors of the modes of all ports, (n_elements, size, n_ports n_modes)."""
        m = len(self.modes)
        load = np.zeros((*self.mass.shape[:2], m * len(self.ports)))
        load[-1, self.layout.end(1), -m:] = self.ports[-1]
        if not self.halved:
            load[0, self.layout.end(0), :m] = self.ports[0]
        return load


class Response(NamedTuple):
    """Solution for one shift and one parity along z (`sides`).

    Attributes
    ----------
    fields : ndarray
        Blocks of a Krylov space in the basis, the response itself among them,
        (n_elements, n_basis, n_columns).
    correction : ndarray
        First-order correction of the response by the other functions of the enriched basis,
        (n_elements, size - n_basis, n_ports n_modes).
    impedance : ndarray
        Z in 1/m, (n_ports n_modes, n_ports n_modes).
    by_degree : ndarray
        Correction of Z by the polynomials of higher degree.
    by_element : ndarray
        Correction of Z by one degree more along each element, (n_elements, ...).
    """

    fields: Array
    correction: Array
    impedance: Array
    by_degree: Array
    by_element: Array


def discretise(
    wall: Wall,
    edges: Array,
    degree: int,
    order: int,
    odd: bool | None,
    wavenumber: float,
    *,
    spare_points: int = SPARE_POINTS,
) -> Discretisation:
    """Assemble a lumen.

    Parameters
    ----------
    wall : Wall
    edges : ndarray
        Boundaries of the elements in m, from the first port, or the plane of symmetry, to the last.
    degree, order : int
        Total degree across the tube, degree along an element.
    odd : bool or None
        Symmetry about x = 0; None for all modes.
    wavenumber : float
        Highest wavenumber of interest in 1/m.
    spare_points : int
        Number of Gauss points along an element, in excess of its degree.
    """
    halved = wall.reversible
    basis = polynomials(degree + DEGREE_INCREASE, odd)
    layout = Layout(basis.count(degree), basis.size, order)
    elements = assemble(wall, edges, basis, layout, order + spare_points)
    reach = MARGIN + wavenumber * wall.radius
    modes = end_modes(wall, reach, odd)
    far = end_modes(wall, reach + FARTHEST, odd, lowest=reach)
    boxes = [elements.last] if halved else [elements.first, elements.last]
    places = ((-1, 1),) if halved else ((0, 0), (-1, 1))
    for (element, end), box in zip(places, boxes, strict=True):
        functions = end_functions(wall, far, basis, box)
        _add_far_modes(
            elements, (element, layout.end(end)), functions, far, wall.radius, wavenumber
        )
    return Discretisation(
        stiffness=elements.stiffness,
        mass=elements.mass,
        layout=layout,
        modes=modes,
        ports=np.stack([end_functions(wall, modes, basis, box) for box in boxes]),
        heights=(2 * wall.middle - edges[-1] if halved else edges[0], edges[-1]),
        radius=wall.radius,
        rim=rim_of(wall, modes, odd),
        halved=halved,
    )  # fmt: skip


def _add_far_modes(
    elements: Elements,
    place: tuple[int, Index],
    functions: Array,
    modes: PortModes,
    radius: float,
    wavenumber: float,
) -> None:
    """Add the impedance of strongly evanescent modes to a port, linearised in k^2."""
    element, end = place
    middle = wavenumber**2 / 2
    decay = np.sqrt((modes.zeros / radius) ** 2 - middle)
    stiff = (functions * (decay + middle / (2 * decay))) @ functions.T
    elements.stiffness[element][np.ix_(end, end)] += stiff
    elements.mass[element][np.ix_(end, end)] += (functions / (2 * decay)) @ functions.T


def respond(system: Discretisation, shift: float, blocks: int) -> list[Response]:
    """Solve for the ports' loads at one squared wavenumber, with Krylov vectors and corrections.

    Parameters
    ----------
    system : Discretisation
    shift : float
        k^2 in 1/m2.
    blocks : int
        Number of blocks of the Krylov space of (K - k^2 M)^-1 M; the response is the first.

    Returns
    -------
    list of Response
        One per parity along z; for a lumen that is not symmetric along z, one.
    """
    layout, n = system.layout, system.layout.n_basis
    low, high = slice(n), slice(n, n + layout.n_higher)
    last = slice(n + layout.n_higher, None)

    def matrix(a: slice, b: slice) -> Array:
        return np.asarray(system.stiffness[:, a, b] - shift * system.mass[:, a, b])

    factors = factor(matrix(low, low), layout.n)
    sides = system.sides
    load = np.concatenate([system.load] * len(sides), axis=-1)
    held = np.repeat(sides, system.load.shape[-1])
    response = solve(factors, load[:, low], held)
    fields = [response]
    if system.layers is not None:
        stiff, heavy = (part[:, low, low] for part in system.layers)
        layer = stiff + LAYER_RATIO * shift * heavy
        for _ in range(LAYER_BLOCKS):
            fields.insert(0, solve(factors, layer @ _normalised(fields[0], len(sides)), held))
        fields.append(fields.pop(LAYER_BLOCKS))
    for _ in range(blocks - 1):
        ahead = system.mass[:, low, low] @ _normalised(fields[-1], len(sides))
        fields.append(solve(factors, ahead, held))
    ahead = load[:, high] - matrix(high, low) @ response
    step = solve(factor(matrix(high, high), layout.n_all - layout.n), ahead, held)
    bubble = -matrix(last, low) @ response
    bubble_step = np.linalg.solve(matrix(last, last), bubble)
    parts = (np.split(part, len(sides), axis=-1) for part in (
        load[:, low], response, ahead, step, bubble, bubble_step
    ))  # fmt: skip
    split = [np.split(field, len(sides), axis=-1) for field in fields]
    return [
        Response(
            fields=np.concatenate(blocks_of_side, axis=-1),
            correction=np.concatenate([higher_step, inner_step], axis=1),
            impedance=_dot(side_load, own),
            by_degree=_dot(higher_load, higher_step),
            by_element=inner_load.swapaxes(1, 2) @ inner_step,
        )
        for blocks_of_side, side_load, own, higher_load, higher_step, inner_load, inner_step in zip(
            zip(*split, strict=True), *parts, strict=True
        )
    ]


def _normalised(block: Array, n_sides: int) -> Array:
    """Return a block with orthonormal columns for each side."""
    flat = block.reshape(-1, block.shape[-1])
    bases = [np.linalg.qr(part)[0] for part in np.split(flat, n_sides, axis=1)]
    return np.concatenate(bases, axis=1).reshape(block.shape)


def _dot(a: Array, b: Array) -> Array:
    return np.tensordot(a, b, ((0, 1), (0, 1)))
