"""A press from first touch to the asked depth, in adaptive increments."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import jax
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from acoustube.errors import ConfigError, SimulationError
from acoustube.indentation.contact import Bodies
from acoustube.indentation.element import Material
from acoustube.indentation.equilibrium import (
    Equilibrium,
    Model,
    build_model,
    minimise,
    rod_force,
)
from acoustube.limits import pressed_reach
from acoustube.tube import HexMesh, MeshSize, Tube, quarter_mesh

Array = NDArray[np.float64]
Support = Literal["held", "free"]

# All lengths below are in bore diameters, so that a small tube is pressed like a large one.
FIRST_INCREMENT = 2.5e-3
LARGEST_INCREMENT = 1 / 16
SMALLEST_INCREMENT = 1e-5
EASY_ITERATIONS = 8

CONTACT_STIFFNESS = 300.0
"""Contact pressure per penetration, in shear moduli per wall thickness.

At the pressures of a 7 mm press (under 0.5 MPa) the wall penetrates the rod by under 6 um.
"""
CONTACT_SMOOTHING = 2.5e-3
"""Half width of the zone in which the contact sets in, in wall thicknesses (4 um)."""
FORCE_TOLERANCE = 1e-8
"""Out-of-balance force accepted, in shear moduli times squared bore diameters."""


@dataclass(frozen=True, eq=False)
class Indentation:
    """A press, increment by increment; the first row is first touch.

    Parameters
    ----------
    tube : Tube
    rod_diameter : float
        In m.
    support : {"held", "free"}
    mesh : HexMesh
        The undeformed quarter x >= 0, z >= 0; the press is at z = 0.
    depth : array of shape (n_increments,)
        How far the rod has come down from first touch, in m.
    contact_force : array of shape (n_increments,)
        Force of the rod on the whole tube, in N.
    displacement : array of shape (n_increments, n_along, n_around, n_through, 3)
        Nodal displacements in m.
    iterations : array of shape (n_increments,)
        Newton iterations that each increment took.
    residual : array of shape (n_increments,)
        Norm of the out-of-balance nodal forces, in N.
    """

    tube: Tube
    rod_diameter: float
    support: Support
    mesh: HexMesh
    depth: Array
    contact_force: Array
    displacement: Array
    iterations: NDArray[np.int64]
    residual: Array


def indent(
    tube: Tube,
    *,
    rod_diameter: float,
    depth: float | Sequence[float],
    support: Support = "held",
    size: MeshSize | None = None,
    progress: Callable[[float], None] | None = None,
) -> Indentation:
    """Press a rigid cylinder, lying across the tube, down to a depth.

    The tube lies on a rigid floor; nothing has friction. The rod, the tube and its supports are
    symmetric about x = 0 and z = 0, so that a quarter is modelled.

    Parameters
    ----------
    tube : Tube
        The tube; its axis is z, its top line at +y.
    rod_diameter : float
        Diameter of the rod in m; it lies along x over z = 0.
    depth : float or sequence of float
        Depth to reach in m, counted from first touch, and under the bore, where the lumen would
        close. Of a rising sequence each is met exactly by an increment.
    support : {"held", "free"}
        ``"held"``: the bottom line cannot leave the floor, as in a pocket. ``"free"``: the tube
        rests on the floor and can tilt off it beside the press.
    size : MeshSize, optional
        Number of elements.
    progress : callable, optional
        Called after every increment with the fraction of the expected increments that is done.

    Returns
    -------
    Indentation
        Every converged increment, the last at the (largest) `depth`.

    Raises
    ------
    ConfigError
        If the rod's diameter or the depth is outside what the model holds for.
    SimulationError
        If no increment, however small, can be converged. Its message says what depth was reached.

    Notes
    -----
    Each increment starts from the quadratic through the last three states. One that does not
    converge, or meets an indefinite tangent, is halved.
    """
    targets = np.atleast_1d(np.asarray(depth, dtype=float))
    _check(tube, rod_diameter, targets, support)
    mesh = quarter_mesh(tube, pressed_reach(tube.outer_diameter, rod_diameter), size)
    # A nearly incompressible wall needs double precision; the rest of acoustube does not, and must
    # not be made to. The banded factorisation works on blocks too small to share: on two busy cores
    # it took 3 to 7 s with two threads and 0.14 s with one.
    with jax.enable_x64(True), threadpool_limits(1, user_api="blas"):
        material = Material(np.float64(tube.shear_modulus), np.float64(tube.bulk_modulus))
        model = build_model(mesh, material, _supports(mesh, support))
        return _path(tube, rod_diameter, targets, support, model, progress)


def _check(tube: Tube, rod_diameter: float, depths: Array, support: str) -> None:
    """Refuse what the model does not hold for."""
    if not (np.isfinite(rod_diameter) and rod_diameter > 0):
        raise ConfigError(f"rod_diameter = {rod_diameter} m is not a size; use a positive number.")
    rising = np.all(np.diff(depths, prepend=0.0) > 0)
    if not (depths.size and rising and depths[-1] < tube.inner_diameter):
        raise ConfigError(
            f"depth = {depths} m must rise within 0 to {tube.inner_diameter} m; "
            "at the upper end the lumen closes, which the model does not hold for."
        )
    if support not in ("held", "free"):
        raise ConfigError(f"support = {support!r} is unknown; use 'held' or 'free'.")


def _supports(mesh: HexMesh, support: Support) -> NDArray[np.bool_]:
    """Return which displacement components are held at zero, shape (n_nodes, 3)."""
    fixed = np.zeros(mesh.nodes.shape, bool)
    fixed[:, [0, -1], :, 0] = True  # the plane x = 0
    fixed[0, :, :, 2] = True  # the plane z = 0
    if support == "held":
        fixed[:, 0, -1, 1] = True  # the bottom line
    return fixed.reshape(-1, 3)


def _bodies(tube: Tube, rod_diameter: float, depth: float) -> Bodies:
    """Return the rod at a depth, and the floor under the tube."""
    top, stiffness = tube.outer_diameter / 2, tube.shear_modulus / tube.wall_thickness
    lengths_and_stiffness = (
        rod_diameter / 2,
        top + rod_diameter / 2 - depth,
        -top,
        CONTACT_STIFFNESS * stiffness,
        CONTACT_SMOOTHING * tube.wall_thickness,
    )
    return Bodies(*[np.float64(value) for value in lengths_and_stiffness])


def _extrapolate(depths: list[float], states: list[Array], depth: float) -> Array:
    """Return the Lagrange polynomial through the states, at a new depth."""
    x = np.array(depths)
    weights = [np.prod((depth - np.delete(x, i)) / (x[i] - np.delete(x, i))) for i in range(len(x))]
    return np.tensordot(weights, np.stack(states), axes=1)


def _next_depth(targets: Array, reached: float, increment: float) -> float:
    """Return where the next increment ends; one that would end just short of a target meets it."""
    target = float(targets[np.searchsorted(targets, reached, side="right")])
    return target if reached + 1.05 * increment >= target else reached + increment


def _share_done(n_done: int, left: float, increment: float, largest: float) -> float:
    """Return the share of the expected increments that is done, with `left` m still to go."""
    expected = np.log2(largest / increment) + left / largest
    return float(n_done / (n_done + expected)) if left > 0 else 1.0


def _path(
    tube: Tube,
    rod_diameter: float,
    targets: Array,
    support: Support,
    model: Model,
    progress: Callable[[float], None] | None,
) -> Indentation:
    """Press from first touch to the last target, and gather every converged increment."""
    bore = tube.inner_diameter
    tolerance = FORCE_TOLERANCE * tube.shear_modulus * bore**2
    start = np.zeros_like(model.mesh.points)
    depths, forces = [0.0], [0.0]
    results = [Equilibrium(start, True, 0, 0.0)]
    increment = FIRST_INCREMENT * bore
    while depths[-1] < targets[-1]:
        depth = _next_depth(targets, depths[-1], increment)
        bodies = _bodies(tube, rod_diameter, depth)
        guess = _extrapolate(depths[-3:], [r.displacement for r in results[-3:]], depth)
        result = minimise(model, guess, bodies, tolerance)
        if not result.converged:
            increment /= 2
            if increment < SMALLEST_INCREMENT * bore:
                raise SimulationError(
                    f"The indentation stopped at a depth of {1e3 * depths[-1]:.2f} mm of "
                    f"{1e3 * targets[-1]:.2f} mm (out-of-balance force {result.residual:.1e} N); "
                    "ask for less depth or a larger indenter."
                )
            continue
        depths.append(depth)
        results.append(result)
        forces.append(4 * rod_force(model, result.displacement, bodies))  # of the four quarters
        if result.iterations <= EASY_ITERATIONS:
            increment = min(2 * increment, LARGEST_INCREMENT * bore)
        if progress:
            left = float(targets[-1]) - depth
            progress(_share_done(len(depths), left, increment, LARGEST_INCREMENT * bore))
    return Indentation(
        tube=tube,
        rod_diameter=rod_diameter,
        support=support,
        mesh=model.mesh,
        depth=np.array(depths),
        contact_force=np.array(forces),
        displacement=np.stack([r.displacement for r in results]).reshape(
            -1, *model.mesh.nodes.shape
        ),
        iterations=np.array([r.iterations for r in results]),
        residual=np.array([r.residual for r in results]),
    )
