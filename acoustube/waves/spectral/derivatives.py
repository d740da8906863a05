"""Derivatives of a scattering matrix by motions of the wall.

For a wall that moves outwards by v_n per unit of the parameter, Hadamard's formula [1]_ gives the
change of the impedance matrix Z from the fields x caused by the loads C of the port modes, without
a new solution, by an integral over the wall:

    dZ = dC^T x + x^T dC - int v_n (grad x . grad x^T - k^2 x x^T) dA.

If the ends move, the loads and the ends' axial wavenumbers k_z change too. The change of the
scattering matrix follows from S = (I + Q)^-1 (Q - I), Q = D Z D, D = sqrt(j k_z).

References
----------
.. [1] Henrot, A., Pierre, M. (2018). Shape Variation and Optimization, chapter 5. European
   Mathematical Society. doi:10.4171/178
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from acoustube.base.errors import ConfigError
from acoustube.waves.spectral.assembly import element_boxes
from acoustube.waves.spectral.boundary import wall_functions, wall_matrices, wall_points
from acoustube.waves.spectral.discretisation import Discretisation, far_matrices, far_modes
from acoustube.waves.spectral.elimination import product
from acoustube.waves.spectral.ends import end_functions, section_of
from acoustube.waves.spectral.motion import Motion
from acoustube.waves.spectral.polynomials import Array
from acoustube.waves.spectral.ports import Complex, PortModes, changed_scattering, port_modes
from acoustube.waves.spectral.reduction import Reduced, projected, ritz
from acoustube.waves.spectral.walls import Wall

LEAST_OVERLAP = 0.9
"""Smallest overlap (integral of the product of normalised modes) of a displaced wall's mode and the
unmoved wall's mode of equal index, from which they count as the same mode."""
NO_MODES = port_modes(-1.0, None)


class Changes(NamedTuple):
    """Derivatives by a parameter of the matrices of a lumen, in polynomials of the enriched basis.

    Attributes
    ----------
    stiffness, mass : ndarray
        Element matrices, (n_elements, size, size).
    load : ndarray
        Loads of the modes of all ports, (n_elements, size, n_ports n_modes).
    """

    stiffness: Array
    mass: Array
    load: Array


def changes_of(system: Discretisation, wall: Wall, motion: Motion, wavenumber: float) -> Changes:
    """Return the derivatives, by a motion, of stiffness, mass and loads without boundary layers.

    Parameters
    ----------
    system : Discretisation
    wall : Wall
    motion : Motion
    wavenumber : float
        Highest wavenumber of interest in 1/m, with which `system` was assembled.
    """
    points = wall_points(wall, system.rule)
    x, y = motion.velocity(points.rule.z[:, None], points.contours.t)
    outwards = x * points.normal[0] + y * points.normal[1]
    functions = wall_functions(points, system.functions)
    stiffness, mass = wall_matrices(points, functions, system.layout, outwards)
    load = np.zeros_like(system.load)
    if motion.ends:
        _add_ends(Changes(stiffness, mass, load), system, wall, motion, wavenumber)
    return Changes(stiffness, mass, load)


def _add_ends(
    changes: Changes, system: Discretisation, wall: Wall, motion: Motion, wavenumber: float
) -> None:
    """Add in place the derivatives, by moving ends, of loads and of the ends' evanescent modes."""
    _, first, last = element_boxes(wall, system.rule)
    far = far_modes(wall, wavenumber, system.functions.odd)
    n, layout = len(system.modes), system.layout
    places = [(-1, 1, last, slice(-n, None))]
    if not system.halved:
        places.append((0, 0, first, slice(None, n)))
    for element, end, box, columns in places:
        found = []
        for moved in (motion.less, motion.more):
            near, beyond = modes_like(moved, system.modes, far, system.functions.odd)
            outer = end_functions(moved, beyond, system.functions, box)
            found.append((
                *far_matrices(outer, beyond, moved.radius, wavenumber),
                end_functions(moved, near, system.functions, box),
            ))  # fmt: skip
        change = [(b - a) / motion.step for a, b in zip(*found, strict=True)]
        at = layout.end(end)
        changes.stiffness[element][np.ix_(at, at)] += change[0]
        changes.mass[element][np.ix_(at, at)] += change[1]
        changes.load[element, at, columns] += change[2]


def modes_like(
    wall: Wall, near: PortModes, far: PortModes, odd: bool | None
) -> tuple[PortModes, PortModes]:
    """Return the modes of a displaced wall's ends that correspond to modes of the unmoved wall.

    `near` are the port modes of the unmoved wall, `far` the evanescent modes that follow in cut-on.

    Raises
    ------
    ConfigError
        If no such modes exist: two modes of equal cut-on may be combined differently.
    """
    if wall.circular:
        return near, far
    section = section_of(wall, odd)
    if np.any(section.alike[: len(near) + len(far)] < LEAST_OVERLAP):
        raise ConfigError(
            "two modes of the wall's ends cut on at the same frequency, so that S has no "
            "derivative by a motion of the ends; give a motion that is zero there"
        )
    modes = section.modes
    return modes.part(slice(len(near))), modes.part(slice(len(near), len(near) + len(far)))


def changed_wavenumbers(system: Discretisation, motion: Motion, kz: Complex) -> Complex:
    """Return the derivatives of the lossless axial wavenumbers `kz`, (n, n_modes), by a motion.

    They are in 1/m per unit of the parameter, and zero where kz is zero.
    """
    transverse = [
        modes_like(wall, system.modes, NO_MODES, system.functions.odd)[0].zeros / wall.radius
        for wall in (motion.less, motion.more)
    ]
    change = (transverse[1] ** 2 - transverse[0] ** 2) / (2 * motion.step)
    return -np.divide(change, kz, out=np.zeros_like(kz), where=np.abs(kz) > 0)


def moved_scattering(
    system: Discretisation,
    spaces: list[Reduced],
    changes: Changes,
    k: Array,
    kz: Complex,
    drift: Complex,
) -> list[Complex]:
    """Return the derivative of S without losses for each side (parity along z).

    Parameters
    ----------
    system : Discretisation
    spaces : list of Reduced
        Reduced space of each side.
    changes : Changes
    k : ndarray
        Wavenumbers in 1/m, (n,).
    kz, drift : ndarray
        Axial wavenumbers of the modes of all ports in 1/m, and their derivatives,
        (n, n_ports n_modes).

    Returns
    -------
    list of ndarray
        At the ports, (n, n_ports n_modes, n_ports n_modes), per unit of the parameter.
    """
    found = []
    for space in spaces:
        response, change = _changed_impedance(system, space, changes, k)
        found.append(changed_scattering(response, change, kz, drift))
    return found


def reduced_changes(
    system: Discretisation, space: Reduced, changes: Changes
) -> tuple[Array, Array, Array]:
    """Return the derivatives of the projected `stiffness`, `mass`, `ports` of :class:`Reduced`."""
    stiffness, mass = (projected(system, part, space) for part in (changes.stiffness, changes.mass))
    n = system.layout.n_basis
    ports = np.concatenate([
        product(space.fields, changes.load[:, :n]), product(space.corrections, changes.load[:, n:]),
    ])  # fmt: skip
    return stiffness, mass, ports


def _changed_impedance(
    system: Discretisation, space: Reduced, changes: Changes, k: Array
) -> tuple[Array, Array]:
    """Return the impedance matrix Z in m, without losses, and its derivative by the parameter.

    Z gives the modal pressures from the modal normal derivatives of the pressure. Its derivative is
    per unit of the parameter of `changes`. Both are (n, n_ports n_modes, n_ports n_modes), at
    wavenumbers `k` in 1/m, (n,).
    """
    square, vector = ritz(space.stiffness, space.mass)
    ports = vector.T @ space.ports
    fields = ports / (square - k[:, None] ** 2)[:, :, None]
    stiffness, mass, loads = reduced_changes(system, space, changes)
    stiffness, mass = (vector.T @ part @ vector for part in (stiffness, mass))
    pushed = stiffness @ fields - k[:, None, None] ** 2 * (mass @ fields)
    loaded = np.matmul((vector.T @ loads).T, fields)
    change = loaded + loaded.swapaxes(1, 2) - np.matmul(fields.swapaxes(1, 2), pushed)
    return np.matmul(ports.T, fields), change
