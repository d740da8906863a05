"""Derivatives of force and lumen area with respect to the design: direct sensitivity analysis.

An equilibrium u makes the residual forces r(u, p) vanish for the design p. By the implicit function
theorem a change of p at a fixed depth changes u by ``du = -K^-1 r_p dp``, with the tangent
stiffness K of Newton's method, and a result q(u, p) by ``q_u du + q_p dp`` [1]_: one factorisation,
one right-hand side for each parameter, and no further press. JAX computes the partial derivatives,
except those of the self-contact barrier; see
:meth:`acoustube.indentation.self_contact.SelfContact.forces_along`.

References
----------
.. [1] P. Michaleris, D. A. Tortorelli, C. A. Vidal, "Tangent operators and design sensitivity
   formulations for transient non-linear coupled problems with applications to elastoplasticity",
   Int. J. Numer. Methods Eng. 37, 2471-2499 (1994).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from scipy.linalg import LinAlgError
from threadpoolctl import threadpool_limits

from acoustube.base.errors import ConfigError, SimulationError
from acoustube.base.limits import pressed_reach
from acoustube.base.types import Array
from acoustube.base.units import MM
from acoustube.indentation import contact, element, linear_solver
from acoustube.indentation.assembly import Model, stiffness
from acoustube.indentation.contact import Body
from acoustube.indentation.indenters import Indenter, ground_body
from acoustube.indentation.material import Material, neo_hookean
from acoustube.indentation.press import neo_hookean_wall, press_model
from acoustube.indentation.result import Indentation
from acoustube.indentation.self_contact import triangulated

SECTION_PARTS = 8
"""Sides per element edge of the polygon around the lumen's section, whose area is computed."""


class Design(NamedTuple):
    """Design parameters, or the derivatives with respect to each of them.

    Attributes
    ----------
    shear_modulus : float
        In Pa, at constant Poisson's ratio.
    wall_thickness, inner_diameter : float
        Of the tube, in m.
    indenter_diameter : float
        In m; at constant edge radius of a punch if that was given.
    """

    shear_modulus: Any
    wall_thickness: Any
    inner_diameter: Any
    indenter_diameter: Any


class Derivatives(NamedTuple):
    """Derivatives of force and lumen area with respect to the design.

    Attributes
    ----------
    contact_force : Design
        In N per unit of each parameter.
    lumen_area : Design
        Of the cross-section at the indenter, in m2 per unit of each parameter.
    """

    contact_force: Design
    lumen_area: Design


class _Problem(NamedTuple):
    """The discretised press of one design: what nodal forces and results are computed from."""

    points: Any
    material: Material
    rule: element.Quadrature
    outer_area: Any
    bodies: tuple[Body, ...]
    wrinkle_forces: Any


def derivatives(indentation: Indentation, increment: int = -1) -> Derivatives:
    """Differentiate force and lumen area with respect to the design.

    Parameters
    ----------
    indentation : Indentation
        One indenter at z = 0 on a round Neo-Hookean tube, of which the half z >= 0 is modelled.
    increment : int, optional
        Number of the increment, at which the lumen may be closed; the last by default.

    Returns
    -------
    Derivatives
        At constant depth and constant barrier distance.

    Raises
    ------
    ConfigError
        If the tube, its material or the indenter is not as above.
    SimulationError
        If the tangent stiffness is not positive definite (buckling), where no derivative exists.
    """
    _check_differentiable(indentation)
    with jax.enable_x64(True), threadpool_limits(1, user_api="blas"):
        model, displacement = press_model(indentation), indentation.displacement[increment]
        design = _design(indentation)
        problem = _problem(indentation, model, increment)
        try:
            lower = stiffness(model, displacement, indentation.bodies(increment))
            solve = linear_solver.factorise(lower, model.analysis)
        except LinAlgError as error:
            raise SimulationError(
                "the press cannot be differentiated at a depth of "
                f"{MM * indentation.depth[increment]:.3f} mm: the tangent stiffness is not "
                "positive definite (buckling); choose another depth"
            ) from error
        residual_derivative = _residual_derivative(
            indentation, model, problem, displacement, design
        )
        results = [
            _directional(result, displacement, design)
            for result in (_force(indentation, problem), _area(indentation, problem))
        ]
        rows = []
        for direction in np.eye(len(design)):
            along = Design(*direction)
            moved = np.zeros_like(displacement)
            moved[model.free] = -solve(residual_derivative(along)[model.free])
            rows.append([float(result(moved, along)) for result in results])
    force, area = np.transpose(rows)
    return Derivatives(Design(*force), Design(*area))


def _check_differentiable(indentation: Indentation) -> None:
    mesh, indenters = indentation.mesh, indentation.indenters
    if mesh.sweep is None or not mesh.halved[1] or len(indenters) != 1:
        raise ConfigError(
            "only a press of a round tube by one indenter at z = 0 can be differentiated; it must "
            "be symmetric about z = 0"
        )
    material, own = indentation.material, neo_hookean_wall(indentation.tube)
    if material.isochoric.func is not neo_hookean or not (
        material.isochoric.args == own.isochoric.args and material.bulk_modulus == own.bulk_modulus
    ):
        raise ConfigError("only a Neo-Hookean wall with the tube's moduli can be differentiated")


def _design(indentation: Indentation) -> Design:
    tube = indentation.tube
    numbers = tube.shear_modulus, tube.wall_thickness, tube.inner_diameter
    return Design(*map(np.float64, (*numbers, indentation.indenters[0].diameter)))


def _problem(
    indentation: Indentation, model: Model, increment: int
) -> Callable[[Design], _Problem]:
    """Return a function of the design that discretises the press; JAX can differentiate it."""
    tube, mesh, (indenter,) = indentation.tube, indentation.mesh, indentation.indenters
    assert mesh.sweep is not None
    grid, ratio = mesh.sweep, tube.bulk_modulus / tube.shear_modulus
    reach = mesh.points[:, 2].max()
    sampling, _ = triangulated(mesh, mesh.outer_faces)
    (touch,), depth = indentation.touch_heights, indentation.depth[increment]
    first = _first_touched(sampling @ mesh.points, indenter, touch)
    row = sampling[[first]].toarray()[0]
    wrinkles = model.wrinkle_stiffness / (tube.shear_modulus * reach)
    # A mesh whose length is not the default keeps the ratio of its length to the default.
    ratio_of_reach = reach / pressed_reach(tube.outer_diameter, indenter.diameter)

    def problem(design: Design) -> _Problem:
        mu, wall, bore, diameter = design
        length = ratio_of_reach * pressed_reach(bore + 2 * wall, diameter)
        points = jnp.stack(grid.place(bore, wall, length), axis=-1)
        gap = indenter.gap(diameter)
        height = _touch_height(gap, row @ points, touch)
        bodies = (
            Body(gap, height - indenter.depth_fraction * depth, contact.rigid_law(mu, wall)),
            ground_body(mu, wall, -(bore / 2 + wall), indentation.layer),
        )
        corners = points[mesh.outer_faces]
        return _Problem(
            points=points,
            material=Material(Partial(neo_hookean, mu), ratio * mu),
            rule=element.quadrature(points[mesh.elements], mesh.reference),
            outer_area=contact.areas(corners, mesh.face.slopes, mesh.face.weights),
            bodies=bodies,
            wrinkle_forces=lambda displacement: mu * length * _apply(wrinkles, displacement),
        )

    return problem


def _first_touched(points: Array, indenter: Indenter, touch: float) -> int:
    """Return the index of the point at which contact begins, of points (n, 3) on the outer wall."""
    gaps = jax.vmap(indenter.gap())(points - np.array([0.0, touch, 0.0]))
    return int(np.argmin(gaps))


def _touch_height(gap: Partial, point: Any, touch: float) -> Any:
    """Return the height in m of first contact by a Newton step, which JAX can differentiate."""
    up = jnp.array([0.0, 1.0, 0.0])

    def clearance(height: Any, point: Any) -> Any:
        return gap(point - height * up)

    rate = jax.lax.stop_gradient(jax.grad(clearance)(touch, point))
    return touch - clearance(touch, point) / rate


def _apply(matrix: Any, values: Any) -> Any:
    """Return the product of a constant sparse matrix with an array that JAX traces."""
    entries = matrix.tocoo()
    flat = jnp.ravel(values)
    product = entries.data * flat[entries.col]
    return jnp.zeros_like(flat).at[entries.row].add(product).reshape(values.shape)


def _residual_derivative(
    indentation: Indentation,
    model: Model,
    problem: Callable[[Design], _Problem],
    displacement: Array,
    design: Design,
) -> Callable[[Design], Array]:
    """Return a function of a change of the design: the derivative of the nodal forces along it.

    The derivative is (n_nodes, 3), in N per unit of the change, at constant displacements.
    """
    mesh = indentation.mesh
    position = mesh.points + displacement
    _, barrier = model.lumen.energy_and_forces(position)

    def forces(design: Design, displacement: Any) -> tuple[Any, Any]:
        case = problem(design)
        _, wall = element.energies_and_forces(displacement[mesh.elements], case.rule, case.material)
        faces = (case.points + displacement)[mesh.outer_faces]
        _, touch = contact.energies_and_forces(faces, case.outer_area, mesh.face, case.bodies)
        total = case.wrinkle_forces(displacement).at[mesh.elements].add(wall)
        return total.at[mesh.outer_faces].add(touch), case.points

    # Everything that varies is an argument: XLA evaluates products of constants while compiling.
    @jax.jit
    def tangent(design: Design, along: Design, displacement: Any) -> Any:
        return jax.jvp(lambda design: forces(design, displacement), (design,), (along,))[1]

    def derivative(along: Design) -> Array:
        change, moved = tangent(design, along, displacement)
        stiffening = along.shear_modulus / design.shear_modulus
        of_barrier = model.lumen.forces_along(position, np.asarray(moved)) + stiffening * barrier
        return np.asarray(change) + of_barrier

    return derivative


def _force(indentation: Indentation, problem: Callable[[Design], _Problem]) -> Any:
    """Return the whole tube's force on the indenter as a function of displacement and design."""
    mesh = indentation.mesh

    def force(displacement: Any, design: Design) -> Any:
        case = problem(design)
        position = (case.points + displacement)[mesh.outer_faces]
        part = contact.force(position, case.outer_area, mesh.face, case.bodies[0])
        return mesh.copies * part

    return force


def _area(indentation: Indentation, problem: Callable[[Design], _Problem]) -> Any:
    """Return the lumen's area in the section z = 0 as a function of displacement and design."""
    mesh = indentation.mesh
    sampling, _ = triangulated(mesh, parts=SECTION_PARTS)
    rest = sampling @ mesh.points
    (ring,) = np.nonzero(rest[:, 2] == 0)
    order = np.argsort(np.arctan2(rest[ring, 0], -rest[ring, 1]) % (2 * np.pi))
    rows = sampling[ring[order]].toarray()
    symmetric = mesh.halved[0]

    def area(displacement: Any, design: Design) -> Any:
        x, y, _ = (rows @ (problem(design).points + displacement)).T
        # The shoelace formula; the closing line x = 0 of a half section adds nothing.
        cross = x * jnp.roll(y, -1) - y * jnp.roll(x, -1)
        return (1 if symmetric else 0.5) * jnp.abs(jnp.sum(cross))

    return area


def _directional(result: Any, displacement: Array, design: Design) -> Any:
    """Return the directional derivative of a result with respect to displacement and design."""

    @jax.jit
    def directional(displacement: Any, design: Design, moved: Any, along: Design) -> Any:
        return jax.jvp(result, (displacement, design), (moved, along))[1]

    return partial(directional, displacement, design)
