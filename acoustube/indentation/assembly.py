"""Potential energy of the pressed tube, its gradient and tangent stiffness, and derived results."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
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
from acoustube.indentation.multifrontal import Analysis
from acoustube.indentation.padding import counts_of_blocks, in_blocks
from acoustube.indentation.self_contact import SelfContact

_quadrature = jax.jit(element.quadrature, static_argnames="reference")
_wall = jax.jit(element.energies_and_forces)
_touch = jax.jit(contact.energies_and_forces, static_argnames="face")
_touch_tangents = jax.jit(contact.tangents, static_argnames="face")
_force = jax.jit(contact.force, static_argnames="face")
_contact_area = jax.jit(contact.contact_area)
_areas = jax.jit(contact.areas)
_volume_ratios = jax.jit(element.volume_ratios)


@dataclass(frozen=True, eq=False)
class Model:
    """The discretised tube: everything that is constant during a press.

    JAX compiles a function anew for each shape of its arguments. Elements and outer faces are
    therefore evaluated in blocks of one size, so that all meshes share compiled code; see
    :func:`acoustube.indentation.padding.in_blocks`.

    Attributes
    ----------
    mesh : Mesh
    material : Material
    elements : array of int, shape (n_blocks, n_block, n_local)
        Nodes of the wall's elements; the last element is repeated to fill the last block.
    rules : tuple of Quadrature
        Quadrature of the blocks of elements; the weights of repeated elements are zero.
    outer_faces : array of int, shape (n_blocks, n_block, n_face_nodes)
        Nodes of the outer faces; the last face is repeated to fill the last block.
    outer_areas : array of shape (n_blocks, n_block, n_points)
        Undeformed area in m2 of the outer faces' quadrature points, zero for repeated faces.
    pattern : Pattern
        Sparsity of the stiffness matrix.
    lumen : SelfContact
        Contact of the inner wall with itself.
    wrinkle_stiffness : sparse array of shape (3 n_nodes, 3 n_nodes)
        Of :func:`acoustube.indentation.wrinkle_penalty.stiffness`, in N/m.
    """

    mesh: Mesh
    material: Material
    elements: NDArray[np.int_]
    rules: tuple[Quadrature, ...]
    outer_faces: NDArray[np.int_]
    outer_areas: Array
    pattern: Pattern
    lumen: SelfContact
    wrinkle_stiffness: sparse.csr_array

    @cached_property
    def wrinkle_tangent(self) -> sparse.csc_array:
        """Lower triangle of `wrinkle_stiffness` for the unknowns only, in N/m, (n_free, n_free)."""
        return self.pattern.restrict(self.wrinkle_stiffness)

    @cached_property
    def analysis(self) -> Analysis:
        """Order in which a factorisation of the stiffness matrix eliminates the unknowns."""
        return Analysis(self.mesh.points[np.nonzero(self.free)[0]])

    @property
    def free(self) -> NDArray[np.bool_]:
        """Mask of the unknown displacement components, shape (n_nodes, 3)."""
        return self.pattern.free


def _weights_of_mesh(blocks: list[Array], n_rows: int) -> Array:
    """Stack the quadrature weights of blocks, (n_blocks, n_block, ...), zero in repeated rows."""
    weights = np.stack([np.asarray(block) for block in blocks])
    for block, count in zip(weights, counts_of_blocks(n_rows), strict=True):
        block[count:] = 0.0
    return weights


def _joined(blocks: list[Any], n_rows: int) -> Array:
    """Concatenate the rows of all blocks, and drop the repeated rows at the end."""
    return np.concatenate([np.asarray(block) for block in blocks])[:n_rows]


def build_model(
    mesh: Mesh,
    material: Material,
    fixed: NDArray[np.bool_],
    lumen: SelfContact,
    wrinkle_stiffness: sparse.csr_array | None = None,
) -> Model:
    """Return the finite-element model of a tube.

    Parameters
    ----------
    mesh : Mesh
    material : Material
    fixed : array of bool, shape (n_nodes, 3)
        Displacement components held at zero.
    lumen : SelfContact
        Contact of the inner wall with itself.
    wrinkle_stiffness : sparse array of shape (3 n_nodes, 3 n_nodes), optional
        Stiffness matrix of the wrinkle penalty, in N/m; zero by default.
    """
    face, n_components = mesh.face, mesh.points.size
    if wrinkle_stiffness is None:
        wrinkle_stiffness = sparse.csr_array((n_components, n_components))
    elements, outer_faces = in_blocks(mesh.elements), in_blocks(mesh.outer_faces)
    rules = [_quadrature(mesh.points[block], mesh.reference) for block in elements]
    weights = _weights_of_mesh([rule.weights for rule in rules], len(mesh.elements))
    areas = [_areas(mesh.points[block], face.slopes, face.weights) for block in outer_faces]
    return Model(
        mesh=mesh,
        material=material,
        elements=elements,
        rules=tuple(
            rule._replace(weights=jnp.asarray(kept))
            for rule, kept in zip(rules, weights, strict=True)
        ),
        outer_faces=outer_faces,
        outer_areas=_weights_of_mesh(areas, len(mesh.outer_faces)),
        pattern=linear_solver.pattern(~fixed, [mesh.elements, mesh.outer_faces]),
        lumen=lumen,
        wrinkle_stiffness=wrinkle_stiffness,
    )


class State(NamedTuple):
    """Potential energy and its gradient at given displacements.

    Attributes
    ----------
    displacement : array of shape (n_nodes, 3)
        In m.
    energy : float
        Potential energy of the modelled part, in J: strain energy of the wall, contact energy,
        self-contact barrier and wrinkle penalty.
    gradient : array of shape (n_free,)
        Residual (out-of-balance) forces on the unknowns, in N.
    norm : float
        Euclidean norm of the gradient, in N.
    """

    displacement: Array
    energy: float
    gradient: Array
    norm: float


def evaluate(model: Model, displacement: Array, bodies: tuple[Body, ...]) -> State:
    """Evaluate the potential energy and the residual forces.

    Parameters
    ----------
    model : Model
    displacement : array of shape (n_nodes, 3)
        In m.
    bodies : tuple of Body
        Indenters and ground at their heights.

    Returns
    -------
    State
        Its energy and its norm are not finite if an element is inverted (J <= 0).
    """
    mesh, position = model.mesh, model.mesh.points + displacement
    energies, inner = _wall_of(model, displacement)
    touches = [_touch(faces, areas, mesh.face, bodies) for faces, areas in _faces(model, position)]
    touch, outer = (
        _joined(list(part), len(mesh.outer_faces)) for part in zip(*touches, strict=True)
    )
    barrier, total = model.lumen.energy_and_forces(position)
    np.add.at(total, mesh.elements, inner)
    np.add.at(total, mesh.outer_faces, outer)
    smoothing = (model.wrinkle_stiffness @ displacement.ravel()).reshape(displacement.shape)
    gradient = (total + smoothing)[model.free]
    smooth = 0.5 * np.sum(smoothing * displacement)
    energy = float(energies.sum() + touch.sum() + smooth) + barrier
    return State(displacement, energy, gradient, float(np.linalg.norm(gradient)))


def _wall_of(model: Model, displacement: Array) -> tuple[Array, Array]:
    """Return the elements' strain energies (n,) in J and nodal forces (n, n_local, 3) in N."""
    found = [
        _wall(displacement[block], rule, model.material)
        for block, rule in zip(model.elements, model.rules, strict=True)
    ]
    n_elements = len(model.mesh.elements)
    energies, forces = (_joined(list(part), n_elements) for part in zip(*found, strict=True))
    return energies, forces


def _faces(model: Model, position: Array) -> Iterator[tuple[Array, Array]]:
    """Iterate over blocks of outer faces: nodes in m, undeformed areas of their points in m2."""
    return zip((position[block] for block in model.outer_faces), model.outer_areas, strict=True)


def stiffness(
    model: Model, displacement: Array, bodies: tuple[Body, ...], *, convex: bool = False
) -> sparse.csc_array:
    """Assemble the tangent stiffness.

    Parameters
    ----------
    model, displacement, bodies
        As for :func:`evaluate`.
    convex : bool
        Leave out the terms that are the first to make the tangent indefinite: the geometric
        stiffness of the pressure in the wall, and the negative eigenvalues of the stiffness of
        the self-contact barrier.

    Returns
    -------
    sparse array of shape (n_free, n_free)
        Lower triangle of the tangent stiffness, in N/m.
    """
    mesh, position = model.mesh, model.mesh.points + displacement
    share = 0.0 if convex else 1.0
    inner = [
        element.tangents(displacement[block], rule, model.material, share, count=count)
        for block, rule, count in zip(
            model.elements, model.rules, counts_of_blocks(len(mesh.elements)), strict=True
        )
    ]
    outer = [
        _touch_tangents(faces, areas, mesh.face, bodies) for faces, areas in _faces(model, position)
    ]
    matrices = [np.concatenate(inner), _joined(outer, len(mesh.outer_faces))]
    lower = model.pattern.assemble(matrices) + model.wrinkle_tangent
    barrier = model.lumen.tangent(position, convex=convex)
    return lower if barrier is None else lower + model.pattern.restrict(barrier)


class EquilibriumResults(NamedTuple):
    """Post-processed quantities of a converged equilibrium, for the whole tube.

    Attributes
    ----------
    press_force : array of shape (n_indenters,)
        Upward force on each indenter, in N.
    contact_area : array of shape (n_indenters,)
        Deformed area of the outer wall in contact with each indenter, in m2.
    energy : float
        Elastic energy of the wall in J.
    smallest_volume_ratio : float
        Smallest volume ratio J at the quadrature points.
    smallest_gap : float
        Smallest distance across the lumen in m, between the lower and the upper part of the inner
        wall; see :meth:`acoustube.indentation.self_contact.SelfContact.smallest_gap`.
    """

    press_force: Array
    contact_area: Array
    energy: float
    smallest_volume_ratio: float
    smallest_gap: float


def equilibrium_results(
    model: Model, displacement: Array, bodies: tuple[Body, ...]
) -> EquilibriumResults:
    """Compute forces, contact areas and energy of an equilibrium.

    Arguments as for :func:`evaluate`; the last body is the ground.
    """
    mesh, position = model.mesh, model.mesh.points + displacement
    energies, _ = _wall_of(model, displacement)
    faces = [faces for faces, _ in _faces(model, position)]
    areas = [_areas(block, mesh.face.slopes, mesh.face.weights) for block in faces]
    deformed = _weights_of_mesh(areas, len(mesh.outer_faces))
    touched = [
        sum(
            float(_contact_area(block, area, mesh.face.shapes, body))
            for block, area in zip(faces, deformed, strict=True)
        )
        for body in bodies[:-1]
    ]
    ratios = [
        np.asarray(_volume_ratios(displacement[block], rule)).min()
        for block, rule in zip(model.elements, model.rules, strict=True)
    ]
    return EquilibriumResults(
        press_force=np.array([indenter_force(model, displacement, body) for body in bodies[:-1]]),
        contact_area=mesh.copies * np.array(touched),
        energy=mesh.copies * float(energies.sum()),
        smallest_volume_ratio=float(min(ratios)),
        smallest_gap=model.lumen.smallest_gap(position),
    )


def indenter_force(model: Model, displacement: Array, body: Body) -> float:
    """Return the upward force in N of the whole tube on a body.

    Parameters
    ----------
    model : Model
    displacement : array of shape (n_nodes, 3)
        In m.
    body : Body
    """
    parts = [
        float(_force(faces, areas, model.mesh.face, body))
        for faces, areas in _faces(model, model.mesh.points + displacement)
    ]
    return model.mesh.copies * sum(parts)
