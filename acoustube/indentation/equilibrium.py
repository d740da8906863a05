"""Assembly over the mesh, and Newton's method for the minimum of the energy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded

from acoustube.indentation import contact, element
from acoustube.indentation.contact import Bodies
from acoustube.indentation.element import Material, Quadrature
from acoustube.tube import HexMesh

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MAX_ITERATIONS = 25
MAX_HALVINGS = 8
SUFFICIENT_DECREASE = 1e-4

_energies = jax.jit(element.energies)
_forces = jax.jit(element.forces)
_tangents = jax.jit(element.tangents)
_contact_energies = jax.jit(contact.energies)
_contact_forces = jax.jit(contact.forces)
_contact_tangents = jax.jit(contact.tangents)
_rod_force = jax.jit(contact.rod_force)


class Band(NamedTuple):
    """Where each entry of the element matrices goes in the banded stiffness matrix.

    Attributes
    ----------
    source : array of int
        Positions of the entries of the lower triangle in the concatenated element matrices, those
        that are summed into one place of the band next to each other.
    starts : array of int
        Where in `source` each such group begins.
    target : array of int
        Position of each group's sum in the flat band.
    width, n_free : int
        Number of stored diagonals, and of unknowns.
    """

    source: Index
    starts: Index
    target: Index
    width: int
    n_free: int


@dataclass(frozen=True, eq=False)
class Model:
    """A discretised quarter of a tube: everything that does not change during a press.

    Attributes
    ----------
    mesh : HexMesh
    material : Material
    rule : Quadrature
    outer_area : array of shape (n_faces, n_points)
        Undeformed area in m2 at the points of the outer faces.
    free : array of bool, shape (n_nodes, 3)
        Displacement components that are unknowns; the others are zero.
    band : Band
    """

    mesh: HexMesh
    material: Material
    rule: Quadrature
    outer_area: Array
    free: NDArray[np.bool_]
    band: Band


def build_model(mesh: HexMesh, material: Material, fixed: NDArray[np.bool_]) -> Model:
    """Prepare the assembly on a mesh with the displacement components `fixed` held at zero."""
    free = ~fixed
    return Model(
        mesh=mesh,
        material=material,
        rule=element.quadrature(mesh.points[mesh.elements]),
        outer_area=contact.areas(mesh.points[mesh.outer_faces]),
        free=free,
        band=_band(free, [mesh.elements, mesh.outer_faces]),
    )


def _band(free: NDArray[np.bool_], connectivities: list[Index]) -> Band:
    number = np.where(free, np.cumsum(free).reshape(free.shape) - 1, -1)
    rows, columns = [], []
    for nodes in connectivities:
        unknowns = number[nodes].reshape(len(nodes), -1)
        size = unknowns.shape[1]
        rows.append(np.repeat(unknowns, size, axis=1).ravel())
        columns.append(np.tile(unknowns, size).ravel())
    row, column = np.concatenate(rows), np.concatenate(columns)
    (source,) = np.nonzero((column >= 0) & (row >= column))
    offset = row[source] - column[source]
    width = int(offset.max()) + 1
    place = column[source] * width + offset
    order = np.argsort(place, kind="stable")
    target, starts = np.unique(place[order], return_index=True)
    return Band(source[order], starts, target, width, int(free.sum()))


def potential(model: Model, displacement: Array, bodies: Bodies) -> float:
    """Return the energy in J of the wall and the contacts; NaN where an element is inverted."""
    mesh, position = model.mesh, model.mesh.points + displacement
    wall = _energies(displacement[mesh.elements], model.rule, model.material)
    touch = _contact_energies(position[mesh.outer_faces], model.outer_area, bodies)
    return float(wall.sum() + touch.sum())


def residual(model: Model, displacement: Array, bodies: Bodies) -> Array:
    """Return the gradient of :func:`potential` for the free components, in N."""
    mesh, position = model.mesh, model.mesh.points + displacement
    wall = _forces(displacement[mesh.elements], model.rule, model.material)
    touch = _contact_forces(position[mesh.outer_faces], model.outer_area, bodies)
    nodes = np.concatenate([mesh.elements.ravel(), mesh.outer_faces.ravel()])
    values = np.concatenate([np.reshape(wall, (-1, 3)), np.reshape(touch, (-1, 3))])
    total = np.zeros_like(position)
    np.add.at(total, nodes, values)
    return total[model.free]


def stiffness(model: Model, displacement: Array, bodies: Bodies) -> Array:
    """Return the lower band of the tangent, shape (width, n_free), as SciPy's solvers take it."""
    mesh, position = model.mesh, model.mesh.points + displacement
    wall = _tangents(displacement[mesh.elements], model.rule, model.material)
    touch = _contact_tangents(position[mesh.outer_faces], model.outer_area, bodies)
    entries = np.concatenate([np.ravel(wall), np.ravel(touch)])
    source, starts, target, width, n_free = model.band
    flat = np.zeros(width * n_free)
    flat[target] = np.add.reduceat(entries[source], starts)
    return flat.reshape(n_free, width).T


def rod_force(model: Model, displacement: Array, bodies: Bodies) -> float:
    """Return the force in N with which the rod presses on the modelled quarter."""
    position = (model.mesh.points + displacement)[model.mesh.outer_faces]
    return float(_rod_force(position, model.outer_area, bodies))


class Equilibrium(NamedTuple):
    """What Newton's method came to.

    Attributes
    ----------
    displacement : array of shape (n_nodes, 3)
        In m.
    converged : bool
    iterations : int
    residual : float
        Norm of the out-of-balance nodal forces, in N.
    """

    displacement: Array
    converged: bool
    iterations: int
    residual: float


def minimise(model: Model, start: Array, bodies: Bodies, tolerance: float) -> Equilibrium:
    """Find the displacements at which the energy is least, from a given start.

    Newton's method with a line search on the energy. A tangent that is not positive definite ends
    the search: the start lies across a buckling, and the caller does better to come closer in a
    shorter increment than to follow it into a crumpled state.

    Parameters
    ----------
    model : Model
    start : array of shape (n_nodes, 3)
        First guess of the displacements, in m.
    bodies : Bodies
    tolerance : float
        Largest accepted norm of the out-of-balance nodal forces, in N.

    Returns
    -------
    Equilibrium
        With ``converged`` false if the iterations ran out, no step went downhill or the tangent
        was indefinite.
    """
    state = _evaluate(model, start, bodies)
    for iteration in range(MAX_ITERATIONS):
        if not state.norm > tolerance:  # also true where the start inverts an element (NaN)
            return Equilibrium(state.displacement, state.norm <= tolerance, iteration, state.norm)
        try:
            factor = cholesky_banded(
                stiffness(model, state.displacement, bodies),
                overwrite_ab=True,
                lower=True,
                check_finite=False,
            )
        except LinAlgError:
            return Equilibrium(state.displacement, False, iteration, state.norm)
        step = np.zeros_like(start)
        step[model.free] = -cho_solve_banded((factor, True), state.force, check_finite=False)
        lower = _search_line(model, state, step, bodies)
        if lower is None:
            return Equilibrium(state.displacement, False, iteration, state.norm)
        state = lower
    return Equilibrium(state.displacement, state.norm <= tolerance, MAX_ITERATIONS, state.norm)


class _State(NamedTuple):
    """Displacements with their energy, free nodal forces and the norm of these."""

    displacement: Array
    energy: float
    force: Array
    norm: float


def _evaluate(model: Model, displacement: Array, bodies: Bodies) -> _State:
    force = residual(model, displacement, bodies)
    energy = potential(model, displacement, bodies)
    return _State(displacement, energy, force, float(np.linalg.norm(force)))


def _search_line(model: Model, state: _State, step: Array, bodies: Bodies) -> _State | None:
    """Return the first of the halved steps that lowers the energy enough, if any does."""
    slope = float(state.force @ step[model.free])
    for length in 0.5 ** np.arange(MAX_HALVINGS):
        trial = _evaluate(model, state.displacement + length * step, bodies)
        enough = state.energy + SUFFICIENT_DECREASE * length * slope
        # Close to the solution the energy's decrease drowns in round-off, the residual's does not.
        if trial.energy <= enough or trial.norm < 0.5 * state.norm:
            return trial
    return None
