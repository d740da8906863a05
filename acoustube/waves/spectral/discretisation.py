"""Discretisation of a lumen in a basis and in an enriched one, for the error estimate.

The total degree of the enriched basis is higher by `DEGREE_INCREASE`, and its degree along each
element by one. The functions of the basis are the first of those of the enriched basis.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from acoustube.waves.spectral.assembly import Elements, Layout, Sections, assemble
from acoustube.waves.spectral.boundary import TangentialFunctions, WallPoints
from acoustube.waves.spectral.elimination import Chain, factor, inner_modes, solve
from acoustube.waves.spectral.ends import Rim, end_functions, end_modes, rim_of
from acoustube.waves.spectral.polynomials import Array, Index, Polynomials, polynomials
from acoustube.waves.spectral.ports import EVANESCENT_RANGE, MARGIN, PortModes
from acoustube.waves.spectral.quadrature import AxialRule, axial_rule
from acoustube.waves.spectral.walls import Wall

DEGREE_INCREASE = 2
"""Increase of the total polynomial degree across the tube, in the basis enriched for the error
estimate."""
LAYER_RATIO = 0.476
"""(gamma - 1) / sqrt(Pr) of air: effect of the thermal layer relative to the viscous one."""
ACTIVE_MARGIN = 0.6
"""Port modes with j' < k R + this margin have all Krylov blocks, and corrections; modes further
below their cut-on have fewer blocks and no corrections. j' is the cut-on wavenumber times the
radius R."""


class Layers(NamedTuple):
    """Boundary layers of a lumen's wall: quadrature points, and matrices of a uniform layer.

    Attributes
    ----------
    points : WallPoints
    functions : TangentialFunctions
        Functions of the basis across the tube, at `points`.
    stiffness, mass : ndarray
        Matrices of a layer of unit thickness, in the unknowns of :class:`Discretisation`,
        (n_elements, n_basis, n_basis).
    blocks : int
        Number of Krylov blocks for the layer at each shift. The first is the solution for a load of
        the layer's matrix times the response to the ports' loads; in each further one, the block
        before it takes the place of that response.
    """

    points: WallPoints
    functions: TangentialFunctions
    stiffness: Array
    mass: Array
    blocks: int


@dataclass(frozen=True, eq=False)
class Discretisation:
    """Matrices of a lumen between its ports, for one symmetry about x = 0.

    The unknowns inside an element are the coefficients of its modes; see
    :mod:`acoustube.waves.spectral.elimination`.

    Attributes
    ----------
    low, high : Chain
        Matrices of the basis (`low`), and of the functions of higher degree across the tube that
        the basis lacks (`high`).
    cross : tuple of ndarray
        Stiffness and mass between the functions that the basis lacks (those across the tube, then
        those along it) and the basis, (n_elements, size - n_basis, n_basis).
    rest : tuple of ndarray
        Stiffness and mass between the functions that the basis lacks,
        (n_elements, size - n_basis, size - n_basis).
    turns : tuple of ndarray
        Coefficients of the elements' modes in the interior functions, for `low` and for `high`,
        (n_elements, n_inner, n_inner) each.
    layout : Layout
        Order of the unknowns.
    rule : AxialRule
        Quadrature along the elements.
    sections : Sections
        Gram matrices of the basis at the rule's points.
    functions : Polynomials
        Polynomials of the enriched basis.
    modes : PortModes
        Modes of the ports.
    ports : ndarray
        Integrals of the polynomials times the modes, in m, (n_ports, n_all, n_modes).
    heights : tuple of float
        Coordinates z in m of the ports at low and at high z.
    radius : float
        Radius of the ports, or of the circle of equal area, in m.
    rim : Rim
        Products of the modes along the contour of an end.
    halved : bool
        Whether only the half at high z of a symmetric lumen is discretised, which has one port.
    layers : Layers, optional
        Boundary layers of the wall, with which the Krylov space has more blocks; None without
        losses.
    """

    low: Chain
    high: Chain
    cross: tuple[Array, Array]
    rest: tuple[Array, Array]
    turns: tuple[Array, Array]
    layout: Layout
    rule: AxialRule
    sections: Sections
    functions: Polynomials
    modes: PortModes
    ports: Array
    heights: tuple[float, float]
    radius: float
    rim: Rim
    halved: bool
    layers: Layers | None = None

    @property
    def sides(self) -> tuple[bool, ...]:
        """Parities along z to solve for: True if the pressure is zero in the symmetry plane.

        A lumen that is not halved has the one entry False.
        """
        return (False, True) if self.halved else (False,)

    @property
    def load(self) -> Array:
        """Load vectors of the modes of all ports, (n_elements, size, n_ports n_modes)."""
        m = len(self.modes)
        load = np.zeros((len(self.low.mass), self.layout.size, m * len(self.ports)))
        load[-1, self.layout.end(1), -m:] = self.ports[-1]
        if not self.halved:
            load[0, self.layout.end(0), :m] = self.ports[0]
        return load

    def in_polynomials(self, fields: Array, corrections: Array) -> tuple[Array, Array]:
        """Transform fields and corrections from the elements' modes to coefficients of polynomials.

        `fields` are (n_elements, n_basis, ...), `corrections` (n_elements, size - n_basis, ...);
        the results have the same shapes.
        """
        found: list[Array] = []
        for part, turn in zip((fields, corrections), self.turns, strict=True):
            own = part.copy()
            n = turn.shape[1]
            end = (self.layout.n_basis, self.layout.n_higher)[len(found)]
            own[:, end - n : end] = turn @ part[:, end - n : end]
            found.append(own)
        return found[0], found[1]

    def in_modes(self, matrix: Array) -> Array:
        """Transform matrices (n_elements, n_basis, n_basis) from polynomials to elements' modes."""
        turn = self.turns[0]
        n = self.layout.n_basis - turn.shape[1]
        beside = np.concatenate([matrix[:, :, :n], matrix[:, :, n:] @ turn], axis=2)
        return np.concatenate([beside[:, :n], turn.swapaxes(1, 2) @ beside[:, n:]], axis=1)


class Response(NamedTuple):
    """Solution at one shift, a squared wavenumber, for one parity along z.

    Attributes
    ----------
    fields : ndarray
        All blocks of the Krylov space but the last, side by side, (n_elements, n_basis, n_columns).
        The first block is the response to the ports' loads.
    last : ndarray
        Last block, (n_elements, n_basis, n_last).
    correction : ndarray
        First-order correction of the response by the other functions of the enriched basis,
        (n_elements, size - n_basis, n_active), for the modes up to `ACTIVE_MARGIN`.
    impedance : ndarray
        Z in m, which gives the modal pressures from the modal normal derivatives,
        (n_ports n_modes, n_ports n_modes).
    by_degree : ndarray
        Correction of Z by higher degrees across the tube, of the shape of `impedance`.
    by_element : ndarray
        Correction of Z by one degree more along each element,
        (n_elements, n_ports n_modes, n_ports n_modes).
    """

    fields: Array
    last: Array
    correction: Array
    impedance: Array
    by_degree: Array
    by_element: Array


def discretise(
    wall: Wall, edges: Array, degree: int, order: int, odd: bool | None, wavenumber: float
) -> Discretisation:
    """Assemble the matrices of a lumen in a basis and in the enriched basis.

    Parameters
    ----------
    wall : Wall
    edges : ndarray
        Boundaries of the elements in m, from the first port, or from the plane of symmetry of a
        reversible wall, to the last port.
    degree, order : int
        Total degree of the basis across the tube, and degree of the basis along an element.
    odd : bool or None
        True for the modes antisymmetric about x = 0, False for the symmetric ones; None for all.
    wavenumber : float
        Highest wavenumber of interest in 1/m.
    """
    halved = wall.reversible
    basis = polynomials(degree + DEGREE_INCREASE, odd)
    layout = Layout(basis.count(degree), basis.size, order)
    rule = axial_rule(edges, order + 1, wall.knots)
    elements = assemble(wall, rule, basis, layout)
    reach = MARGIN + wavenumber * wall.radius
    modes, far = end_modes(wall, reach, odd), far_modes(wall, wavenumber, odd)
    boxes = [elements.last] if halved else [elements.first, elements.last]
    places = ((-1, 1),) if halved else ((0, 0), (-1, 1))
    for (element, end), box in zip(places, boxes, strict=True):
        functions = end_functions(wall, far, basis, box)
        _add_far_modes(
            elements, (element, layout.end(end)), functions, far, wall.radius, wavenumber
        )
    low, high, cross, rest, turns = _in_inner_modes(elements, layout)
    return Discretisation(
        low=low,
        high=high,
        cross=cross,
        rest=rest,
        turns=turns,
        layout=layout,
        rule=rule,
        sections=elements.sections,
        functions=basis,
        modes=modes,
        ports=np.stack([end_functions(wall, modes, basis, box) for box in boxes]),
        heights=(2 * wall.middle - edges[-1] if halved else edges[0], edges[-1]),
        radius=wall.radius,
        rim=rim_of(wall, modes, odd),
        halved=halved,
    )  # fmt: skip


def _in_inner_modes(
    elements: Elements, layout: Layout
) -> tuple[Chain, Chain, tuple[Array, Array], tuple[Array, Array], tuple[Array, Array]]:
    """Return `low`, `high`, `cross`, `rest`, `turns` of `Discretisation` from element matrices."""
    n, more = layout.n_basis, layout.n_higher
    chains, turns = [], []
    for start, stop, width in ((0, n, layout.n), (n, n + more, layout.n_all - layout.n)):
        ends, inner = slice(start, start + 2 * width), slice(start + 2 * width, stop)
        stiff, heavy = elements.stiffness, elements.mass
        square, modes = inner_modes(stiff[:, inner, inner], heavy[:, inner, inner])
        turn = modes.swapaxes(1, 2)
        pull, drag = (turn @ part[:, inner, ends] for part in (stiff, heavy))
        chains.append(Chain(square, stiff[:, ends, ends], heavy[:, ends, ends], pull, drag))
        turns.append(modes)
    cross, rest = [], []
    (a, b), low = (turn.shape[1] for turn in turns), slice(n)
    for matrix in (elements.stiffness, elements.mass):
        part, own = matrix[:, n:, low].copy(), matrix[:, n:, n:].copy()
        inner, ends = slice(more - b, more), slice(n - a, n)
        part[:, :, ends] = part[:, :, ends] @ turns[0]
        part[:, inner] = turns[1].swapaxes(1, 2) @ part[:, inner]
        own[:, :, inner] = own[:, :, inner] @ turns[1]
        own[:, inner] = turns[1].swapaxes(1, 2) @ own[:, inner]
        cross.append(part)
        rest.append(own)
    return chains[0], chains[1], (cross[0], cross[1]), (rest[0], rest[1]), (turns[0], turns[1])


def _add_far_modes(
    elements: Elements,
    place: tuple[int, Index],
    functions: Array,
    modes: PortModes,
    radius: float,
    wavenumber: float,
) -> None:
    """Add the termination by strongly evanescent modes, linearised in k^2, to a port's element.

    `place` holds the number of the element and the indices of its unknowns at the port.
    """
    element, end = place
    stiffness, mass = far_matrices(functions, modes, radius, wavenumber)
    elements.stiffness[element][np.ix_(end, end)] += stiffness
    elements.mass[element][np.ix_(end, end)] += mass


def far_modes(wall: Wall, wavenumber: float, odd: bool | None) -> PortModes:
    """Return the ends' strongly evanescent modes: with j' in `EVANESCENT_RANGE` above port modes.

    j' is the cut-on wavenumber times the radius.
    """
    reach = MARGIN + wavenumber * wall.radius
    return end_modes(wall, reach + EVANESCENT_RANGE, odd, lowest=reach)


def far_matrices(
    functions: Array, modes: PortModes, radius: float, wavenumber: float
) -> tuple[Array, Array]:
    """Return stiffness in m and mass in m3, (n, n), of an end's strongly evanescent modes.

    A mode of cut-on wavenumber kt has dp/dn = -sqrt(kt^2 - k^2) p there, linearised in k^2 about
    half the square of the highest `wavenumber`, in 1/m. `functions` are the integrals of
    polynomials times modes in m, (n, n_modes).
    """
    middle = wavenumber**2 / 2
    decay = np.sqrt((modes.zeros / radius) ** 2 - middle)
    stiffness = (functions * (decay + middle / (2 * decay))) @ functions.T
    return stiffness, (functions / (2 * decay)) @ functions.T


def respond(system: Discretisation, shift: float, blocks: int) -> list[Response]:
    """Solve for the ports' loads at one squared wavenumber, with Krylov blocks and corrections.

    Parameters
    ----------
    system : Discretisation
    shift : float
        k^2 in 1/m2.
    blocks : int
        Number of blocks of the Krylov space of (K - k^2 M)^-1 M; the first is the response.

    Returns
    -------
    list of Response
        One per parity along z; for a lumen that is not symmetric along z, one.
    """
    n, more = system.layout.n_basis, system.layout.n_higher
    factors = factor(system.low, shift)
    sides = system.sides
    load = np.concatenate([system.load] * len(sides), axis=-1)
    held = np.repeat(sides, system.load.shape[-1])
    response = solve(factors, load[:, :n], held)
    # The response of modes far below their cut-on is almost the same at all shifts.
    reach = np.sqrt(max(shift, 0.0)) * system.radius + ACTIVE_MARGIN
    active = np.tile(
        system.modes.zeros < max(reach, 1.01 * system.modes.zeros[0]),
        len(load[0, 0]) // len(system.modes),
    )
    driven, kept = response[..., active], held[active]
    fields = [response]
    if system.layers is not None:
        layer = system.layers.stiffness + LAYER_RATIO * shift * system.layers.mass
        ahead = solve(factors, layer @ _normalised(response, len(sides)), held)
        fields.append(ahead)
        ahead = ahead[..., active]
        for _ in range(system.layers.blocks - 1):
            ahead = solve(factors, layer @ _normalised(ahead, len(sides)), kept)
            fields.append(ahead)
    for _ in range(blocks - 1):
        driven = solve(factors, system.low.times_mass(_normalised(driven, len(sides))), kept)
        fields.append(driven)
    missing = (system.cross[0] - shift * system.cross[1]) @ response
    ahead = load[:, n : n + more] - missing[:, :more]
    step = solve(factor(system.high, shift), ahead, held)
    bubble = -missing[:, more:]
    own = [part[:, more:, more:] for part in system.rest]
    bubble_step = np.linalg.solve(own[0] - shift * own[1], bubble)
    parts = (np.split(part, len(sides), axis=-1) for part in (
        load[:, :n], response, ahead, step, bubble, bubble_step
    ))  # fmt: skip
    which = active[: len(active) // len(sides)]
    split = [np.split(field, len(sides), axis=-1) for field in fields]
    return [
        Response(
            fields=np.concatenate([side_fields[0], *side_fields[1:-1]], axis=-1),
            last=side_fields[-1],
            correction=np.concatenate([higher_step, inner_step], axis=1)[..., which],
            impedance=_dot(side_load, own),
            by_degree=_dot(higher_load, higher_step),
            by_element=inner_load.swapaxes(1, 2) @ inner_step,
        )
        for side_fields, side_load, own, higher_load, higher_step, inner_load, inner_step in zip(
            zip(*split, strict=True), *parts, strict=True
        )
    ]


def _normalised(block: Array, n_sides: int) -> Array:
    """Return a block of fields, its even and its odd columns along z each orthonormalised."""
    flat = block.reshape(-1, block.shape[-1])
    bases = [np.linalg.qr(part)[0] for part in np.split(flat, n_sides, axis=1)]
    return np.concatenate(bases, axis=1).reshape(block.shape)


def _dot(a: Array, b: Array) -> Array:
    return np.tensordot(a, b, ((0, 1), (0, 1)))
