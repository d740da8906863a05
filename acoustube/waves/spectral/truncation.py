"""Truncation error of a basis, relative to the change of S by the next degrees.

The error estimate takes only corrections in the functions of the next degrees.

Across the tube, the field's coefficients fall slowly with the degree beside a narrow gap, so that
higher degrees contribute as much again. If the energies at successive steps of the degree have the
ratio q < 1, the whole truncation error is 1 / (1 - q) times the change by the first step; q is
taken from the highest degrees of the solution itself.

Along the tube this extrapolation fails, because of features of the wall: wrinkles as long as an
element of the press's finite-element mesh, half as long as one of the elements here, add
coefficients of degrees 10 to 13 to a field whose other coefficients have decayed at lower degrees.
The residual is therefore integrated against `MORE_DEGREES` further degrees, point by point, and the
correction is solved for with each element's mean section.
"""

from __future__ import annotations

import numpy as np

from acoustube.waves.spectral.discretisation import DEGREE_INCREASE, Discretisation, Response
from acoustube.waves.spectral.elimination import inner_modes
from acoustube.waves.spectral.polynomials import Array, gauss, lobatto

SLOWEST = 0.9
"""Upper bound of the ratio q of the coefficients' energies at successive steps of the degree across
the tube: a slower decay means that the field is not resolved."""
MORE_DEGREES = 6
"""Number of degrees along an element, beyond its own, in which a correction is solved for."""


def excess_across(system: Discretisation, responses: dict[float, list[Response]]) -> float:
    """Return the truncation error across the tube divided by the change due to the next degrees.

    The change of the responses is taken as a geometric series in the degree, whose ratio is that of
    the energies of the highest and the next lower degrees.

    Parameters
    ----------
    system : Discretisation
    responses : dict
        Responses by squared wavenumber in 1/m2.
    """
    layout, functions = system.layout, system.functions
    degree = functions.degree - DEGREE_INCREASE
    counts = [functions.count(degree - 2 * step) for step in (0, 1, 2)]
    # Energies are of gradients, which grow in proportion to the degree.
    total = (functions.i + functions.j)[: layout.n] ** 2.0
    zeros = np.tile(system.modes.zeros, len(system.ports))
    high, low = 0.0, np.finfo(float).tiny
    for shift, sides in responses.items():
        travels = np.flatnonzero(zeros < np.sqrt(shift) * system.radius)
        for side in sides:
            own = _coefficients(system, side.fields[..., travels])
            by_degree = (own**2).sum(axis=(0, 1, 3)) * total
            high += float(by_degree[counts[1] :].sum())
            low += float(by_degree[counts[2] : counts[1]].sum())
    return 1 / (1 - min(high / low, SLOWEST))


def missing_along(
    system: Discretisation, responses: dict[float, list[Response]]
) -> dict[float, list[Array]]:
    """Return corrections of impedance in m by `MORE_DEGREES` further degrees along each element.

    Parameters
    ----------
    system : Discretisation
    responses : dict
        Responses by squared wavenumber in 1/m2.

    Returns
    -------
    dict
        For each squared wavenumber a list with one array for each parity along z,
        (n_elements, n_ports n_modes, n_ports n_modes).
    """
    rule, first = system.rule, system.layout.order + 1
    value, slope = lobatto(first - 1 + MORE_DEGREES, rule.point)
    new, weight = gauss(first + MORE_DEGREES)
    extra = lobatto(first - 1 + MORE_DEGREES, new)[0][first:]
    product = (extra * weight) @ extra.T
    means = _mean_modes(system)
    found: dict[float, list[Array]] = {}
    for shift, sides in responses.items():
        n = len(sides[0].impedance)
        own = _coefficients(system, np.concatenate([side.fields[..., :n] for side in sides], -1))
        changes = np.empty((len(sides), len(own), n, n))
        for number, (h, square, turn) in enumerate(zip(rule.step / 2, *means, strict=True)):
            here = rule.of(number)
            field, rise = (
                np.tensordot(part[:first, here].T, own[number], 1) for part in (value, slope / h)
            )
            mass, along, across = (part[here] for part in system.sections)
            # Factors of the shape functions' slopes and values in the residual.
            flow = mass @ rise + along @ field
            source = along.swapaxes(1, 2) @ rise + across @ field - shift * (mass @ field)
            residual = np.tensordot(rule.weight[here] * slope[first:, here], flow, 1)
            residual += np.tensordot(h * rule.weight[here] * value[first:, here], source, 1)
            residual = (turn.T @ residual).swapaxes(0, 1)
            matrix = np.eye(MORE_DEGREES) / h + product * ((square - shift) * h)[:, None, None]
            step = np.linalg.solve(matrix, residual)
            for change, a, b in zip(
                changes, *(np.split(part, len(sides), -1) for part in (residual, step)), strict=True
            ):
                change[number] = np.tensordot(a, b, ((0, 1), (0, 1)))
        found[shift] = list(changes)
    return found


def _coefficients(system: Discretisation, fields: Array) -> Array:
    """Return the coefficients of fields along and across, (n_elements, order + 1, n, n_fields)."""
    layout = system.layout
    nothing = np.zeros((len(fields), layout.n_higher, 0))
    own = system.in_polynomials(fields, nothing)[0]
    return own.reshape(len(own), layout.order + 1, layout.n, -1)


def _mean_modes(system: Discretisation) -> tuple[Array, Array]:
    """Return the squared wavenumbers in 1/m2 and the modes of each element's mean section."""
    rule, sections = system.rule, system.sections
    starts = np.searchsorted(rule.element, range(len(rule.step)))
    means = []
    for part in (sections.across, sections.mass):
        weighted = part * (rule.weight / 2)[:, None, None]
        means.append(np.add.reduceat(weighted, starts))
    return inner_modes(*means)
