"""Discretisation of a lumen in a basis and in an enriched one, for the error estimate.

All matrices are those of the enriched basis: polynomials of a total degree higher by
`DEGREE_INCREASE`, and along each element one degree more. The basis itself consists of the first
functions of each.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from acoustube.waves.spectral.assembly import Elements, assemble
from acoustube.waves.spectral.elimination import condense, eliminate, solve
from acoustube.waves.spectral.polynomials import Array, polynomials
from acoustube.waves.spectral.ports import FARTHEST, MARGIN, PortModes, port_functions, port_modes
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
        Of the elements in the enriched basis, (n_elements, n_j, n, n_j, n).
    n_functions, order : int
        Number of functions across the tube, and degree along it, of the basis itself.
    modes : PortModes
        Of the ports.
    ports : ndarray
        Integrals of the polynomials times the modes, in m, (n_ports, n, n_modes).
    heights : tuple of float
        z of the ports in m.
    radius : float
        Of the ports in m.
    halved : bool
        Whether it is the half beyond the plane about which the lumen is symmetric, with one port.
    layers : tuple of ndarray, optional
        Stiffness and mass of the wall, in whose response the Krylov space has one more block.
    """

    stiffness: Array
    mass: Array
    n_functions: int
    order: int
    modes: PortModes
    ports: Array
    heights: tuple[float, float]
    radius: float
    halved: bool
    layers: tuple[Array, Array] | None = None

    @property
    def sides(self) -> tuple[bool, ...]:
        """Parities along z to solve for: True if the pressure is zero in the symmetry plane."""
        return (False, True) if self.halved else (False,)

    @property
    def load(self) -> Array:
        """Load vectors of the modes of all ports, (n_elements, n_j, n, n_ports n_modes)."""
        m = len(self.modes)
        load = np.zeros((*self.mass.shape[:3], m * len(self.ports)))
        load[-1, 1, :, -m:] = self.ports[-1]
        if not self.halved:
            load[0, 0, :, :m] = self.ports[0]
        return load


class Response(NamedTuple):
    """Solution for one shift and one parity along z (`sides`).

    Attributes
    ----------
    fields : ndarray
        Blocks of a Krylov space, the response itself among them, (n_elements, n_j, n, n_columns) of
        the richer basis.
    correction : ndarray
        First-order correction of the response in the enriched basis, of that shape.
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
    elements = assemble(wall, edges, basis, order + 1, order + spare_points)
    reach = MARGIN + wavenumber * wall.radius
    modes = port_modes(reach, odd)
    far = port_modes(reach + FARTHEST, odd, lowest=reach)
    boxes = [elements.last] if halved else [elements.first, elements.last]
    places = ((-1, 1),) if halved else ((0, 0), (-1, 1))
    for place, box in zip(places, boxes, strict=True):
        functions = port_functions(far, basis, box, wall.radius)
        _add_far_modes(elements, place, functions, far, wall.radius, wavenumber)
    return Discretisation(
        stiffness=elements.stiffness,
        mass=elements.mass,
        n_functions=basis.count(degree),
        order=order,
        modes=modes,
        ports=np.stack([port_functions(modes, basis, box, wall.radius) for box in boxes]),
        heights=(2 * wall.middle - edges[-1] if halved else edges[0], edges[-1]),
        radius=wall.radius,
        halved=halved,
    )  # fmt: skip


def _add_far_modes(
    elements: Elements,
    place: tuple[int, int],
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
    elements.stiffness[element, end, :, end] += stiff
    elements.mass[element, end, :, end] += (functions / (2 * decay)) @ functions.T


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
    n, n_j = system.n_functions, system.order + 1
    matrix = system.stiffness - shift * system.mass
    condensed = condense(np.ascontiguousarray(matrix[:, :n_j, :n, :n_j, :n]))
    mass = np.ascontiguousarray(system.mass[:, :n_j, :n, :n_j, :n])
    higher = condense(np.ascontiguousarray(matrix[:, :n_j, n:, :n_j, n:]))
    load = system.load
    found = []
    for held in system.sides:
        chain = eliminate(condensed, held=held)
        response = solve(condensed, chain, load[:, :n_j, :n])
        fields = [response]
        if system.layers is not None:
            layer = (system.layers[0] + LAYER_RATIO * shift * system.layers[1])[:, :n_j, :n]
            layer = np.ascontiguousarray(layer[:, :, :, :n_j, :n])
            for _ in range(LAYER_BLOCKS):
                fields.insert(0, solve(condensed, chain, _applied(layer, _normalised(fields[0]))))
            fields.append(fields.pop(LAYER_BLOCKS))
        for _ in range(blocks - 1):
            fields.append(solve(condensed, chain, _applied(mass, _normalised(fields[-1]))))
        ahead = load[:, :n_j, n:] - _applied(matrix[:, :n_j, n:, :n_j, :n], response)
        step = solve(higher, eliminate(higher, held=held), ahead)
        bubble = -_applied(matrix[:, [n_j], :n, :n_j, :n], response)[:, 0]
        bubble_step = np.linalg.solve(matrix[:, n_j, :n, n_j, :n], bubble)
        correction = np.zeros_like(load)
        correction[:, :n_j, n:], correction[:, n_j, :n] = step, bubble_step
        full = np.zeros((*load.shape[:3], sum(field.shape[-1] for field in fields)))
        full[:, :n_j, :n] = np.concatenate(fields, axis=-1)
        found.append(
            Response(
                fields=full,
                correction=correction,
                impedance=_dot(load[:, :n_j, :n], response),
                by_degree=_dot(ahead, step),
                by_element=bubble.swapaxes(1, 2) @ bubble_step,
            )
        )
    return found


def _normalised(block: Array) -> Array:
    """Return an orthonormal basis of a block's columns."""
    return np.asarray(np.linalg.qr(block.reshape(-1, block.shape[-1]))[0].reshape(block.shape))


def _applied(matrix: Array, field: Array) -> Array:
    """Apply the elements' matrices (n_elements, j, i, k, l) to fields (n_elements, k, l, n)."""
    n_elements, j, i, k, m = matrix.shape
    flat = matrix.reshape(n_elements, j * i, k * m) @ field.reshape(n_elements, k * m, -1)
    return flat.reshape(n_elements, j, i, -1)


def _dot(a: Array, b: Array) -> Array:
    return np.tensordot(a, b, ((0, 1, 2), (0, 1, 2)))
