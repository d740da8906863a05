"""Energy of the pressed tube, and Newton's method for its minimum."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import jax
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from acoustube.base.types import Array
from acoustube.indentation import contact, element, linear_solver
from acoustube.indentation.contact import Body
from acoustube.indentation.element import Quadrature
from acoustube.indentation.linear_solver import Pattern
from acoustube.indentation.material import Material
from acoustube.indentation.mesh import Mesh
from acoustube.indentation.self_contact import SelfContact

_wall = jax.jit(element.energies_and_forces)
_wall_tangents = jax.jit(element.tangents)
_touch = jax.jit(contact.energies_and_forces)
_touch_tangents = jax.jit(contact.tangents)
_force = jax.jit(contact.force)
_touched = jax.jit(contact.touched_area)
_areas = jax.jit(contact.areas)
_volume_ratios = jax.jit(element.volume_ratios)


@dataclass(frozen=True, eq=False)
class Model:
    """A discretised tube: everything that does not change during a press.

    Attributes
    ----------
    mesh : Mesh
    material : Material
    rule : Quadrature
    outer_area : array of shape (n_faces, n_points)
        Undeformed area in m2 at the points of the outer faces.
    pattern : Pattern
    lumen : SelfContact
        Contact of the inner wall with itself.
    skin : sparse array of shape (3 n_nodes, 3 n_nodes)
        Stiffness in N/m that keeps the inner wall smooth; see
        :mod:`acoustube.indentation.wrinkle_penalty`.
    """

    mesh: Mesh
    material: Material
    rule: Quadrature
    outer_area: Array
    pattern: Pattern
    lumen: SelfContact
    skin: sparse.csr_array

    @cached_property
    def skin_tangent(self) -> sparse.csc_array:
        """The lower triangle of `skin` for the unknowns."""
        return self.pattern.restrict(self.skin)

    @property
    def free(self) -> NDArray[np.bool_]:
        """Displacement components that are unknowns, shape (n_nodes, 3)."""
        return self.pattern.free


def build_model(
    mesh: Mesh,
    material: Material,
    fixed: NDArray[np.bool_],
    lumen: SelfContact,
    skin: sparse.csr_array | None = None,
) -> Model:
    """Prepare the assembly on a mesh with the displacement components `fixed` held at zero.

    Without a `skin` nothing keeps the inner wall from wrinkling.
    """
    face, n_components = mesh.face, mesh.points.size
    outer_area = _areas(mesh.points[mesh.outer_faces], face.slopes, face.weights)
    return Model(
        mesh=mesh,
        material=material,
        rule=element.quadrature(mesh.points[mesh.elements], mesh.reference),
        outer_area=np.asarray(outer_area),
        pattern=linear_solver.pattern(~fixed, [mesh.elements, mesh.outer_faces]),
        lumen=lumen,
        skin=sparse.csr_array((n_components, n_components)) if skin is None else skin,
    )


class State(NamedTuple):
    """Displacements (n_nodes, 3) with their energy, gradient (n_free,) and its norm."""

    displacement: Array
    energy: float
    gradient: Array
    norm: float


def evaluate(model: Model, displacement: Array, bodies: tuple[Body, ...]) -> State:
    """Return energy and out-of-balance forces; NaN where an element is inverted."""
    mesh, position = model.mesh, model.mesh.points + displacement
    wall, inner = _wall(displacement[mesh.elements], model.rule, model.material)
    touch, outer = _touch(position[mesh.outer_faces], model.outer_area, mesh.face.shapes, bodies)
    closing, total = model.lumen.energy_and_forces(position)
    np.add.at(total, mesh.elements, inner)
    np.add.at(total, mesh.outer_faces, outer)
    smoothing = (model.skin @ displacement.ravel()).reshape(displacement.shape)
    gradient = (total + smoothing)[model.free]
    energy = float(np.sum(wall) + np.sum(touch) + 0.5 * np.sum(smoothing * displacement)) + closing
    return State(displacement, energy, gradient, float(np.linalg.norm(gradient)))


def stiffness(model: Model, displacement: Array, bodies: tuple[Body, ...]) -> sparse.csc_array:
    """Return the lower triangle of the tangent for the unknowns, in N/m."""
    mesh, position = model.mesh, model.mesh.points + displacement
    matrices = [
        _wall_tangents(displacement[mesh.elements], model.rule, model.material),
        _touch_tangents(position[mesh.outer_faces], model.outer_area, mesh.face.shapes, bodies),
    ]
    lower = model.pattern.assemble(matrices) + model.skin_tangent
    closing = model.lumen.tangent(position)
    return lower if closing is None else lower + model.pattern.restrict(closing)


class Measures(NamedTuple):
    """What is told of a converged state, for the whole tube.

    Attributes
    ----------
    press_force : array of shape (n_presses,)
        Force on each press, upwards, in N.
    contact_area : array of shape (n_presses,)
        Deformed outer wall that touches each press, in m2.
    energy : float
        Elastic energy of the wall in J.
    smallest_volume_ratio : float
        Smallest J at any quadrature point.
    smallest_gap : float
        Between the lower and the upper inner wall, in m.
    """

    press_force: Array
    contact_area: Array
    energy: float
    smallest_volume_ratio: float
    smallest_gap: float


def measures(model: Model, displacement: Array, bodies: tuple[Body, ...]) -> Measures:
    """Return force, contact area and soundness of a state; the last of the bodies is the ground."""
    mesh, position = model.mesh, model.mesh.points + displacement
    local = displacement[mesh.elements]
    wall, _ = _wall(local, model.rule, model.material)
    faces = position[mesh.outer_faces]
    deformed = _areas(faces, mesh.face.slopes, mesh.face.weights)
    touched = [_touched(faces, deformed, mesh.face.shapes, body) for body in bodies[:-1]]
    return Measures(
        press_force=np.array([tool_force(model, displacement, body) for body in bodies[:-1]]),
        contact_area=mesh.copies * np.array(touched),
        energy=mesh.copies * float(np.sum(wall)),
        smallest_volume_ratio=float(np.min(_volume_ratios(local, model.rule))),
        smallest_gap=model.lumen.smallest_gap(position),
    )


def tool_force(model: Model, displacement: Array, body: Body) -> float:
    """Return the force in N on a body from the whole tube, upwards."""
    position = (model.mesh.points + displacement)[model.mesh.outer_faces]
    part = _force(position, model.outer_area, model.mesh.face.shapes, body)
    return model.mesh.copies * float(part)
