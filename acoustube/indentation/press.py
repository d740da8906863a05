"""Press of a tube by rigid indenters: the model at first contact, and its load path to a depth."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jax.tree_util import Partial
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from acoustube.base.checks import FLAG, Either, Instance, Optional, Reals, Several, checked
from acoustube.base.errors import ConfigError
from acoustube.base.limits import pressed_reach
from acoustube.base.report import part_of
from acoustube.base.rules import Choice, Number
from acoustube.base.types import Array, Progress
from acoustube.indentation import wrinkle_penalty
from acoustube.indentation.assembly import Model, build_model
from acoustube.indentation.guide import Guide, coarse_mesh, guide
from acoustube.indentation.indenters import SUPPORTS, Indenter, Layer, Support, touch_height
from acoustube.indentation.load_path import SPACING, load_path, spread
from acoustube.indentation.material import Material, neo_hookean
from acoustube.indentation.mesh import Mesh, MeshSize, sweep
from acoustube.indentation.result import RESULTS, Indentation, PressError
from acoustube.indentation.self_contact import (
    BARRIER_DISTANCE,
    SUBDIVISIONS,
    self_contact,
    triangulated,
)
from acoustube.tube import Tube

# The guide is the load path on a coarse mesh. It is followed before that on the requested mesh.
GUIDE_INCREMENT = 1 / 8
"""Largest increment of depth on the coarse mesh, in bore diameters."""
GUIDE_TOLERANCE = 1e-3
"""Largest norm of the residual forces at convergence on the coarse mesh, in shear moduli times
squared bore diameters."""
GUIDE_SUBDIVISIONS = 2
"""Number of triangle edges of the inner wall along the edge of a face of the coarse mesh."""

DEPTHS = Reals(0, 1, "m")
INDENTERS = Optional(Either((Indenter,), Several(Indenter, 1)))
SUPPORT = Choice(SUPPORTS, "of the tube")
GUIDE_SHARE = 0.25
"""Expected share of the coarse mesh in the computing time, for the reported progress."""


@checked(
    tube=Tube,
    indenter=INDENTERS,
    depth=DEPTHS,
    support=SUPPORT,
    layer=Optional(Layer),
    mesh=Optional(Instance((Mesh, MeshSize))),
    whole=FLAG,
    barrier_distance=Optional(Number(1e-9, 1e-2, "m")),
)
def indent(
    tube: Tube,
    indenter: Indenter | Sequence[Indenter] | None = None,
    *,
    depth: float | Sequence[float],
    support: Support = "held",
    layer: Layer | None = None,
    material: Material | None = None,
    mesh: Mesh | MeshSize | None = None,
    whole: bool = False,
    barrier_distance: float | None = None,
    progress: Progress | None = None,
) -> Indentation:
    """Press a tube with one or several rigid indenters.

    The tube lies on a rigid floor or on an elastic layer; contact is frictionless.

    Parameters
    ----------
    tube : Tube
        The tube; its axis is z, its top line at +y.
    indenter : Indenter or sequence of Indenter, optional
        The indenters; a 25 mm rod by default.
    depth : float or sequence of float
        Indentation depth in m, measured from first contact. Each depth of a rising sequence is met
        exactly by an increment. The lumen closes when the depth is about the bore.
    support : {"held", "free"}
        ``"held"``: the bottom line cannot leave the floor, as in a pocket. ``"free"``: the tube
        rests on the floor and can lift off it away from the indenter.
    layer : Layer, optional
        An elastic layer in place of the rigid floor; requires a free tube.
    material : Material, optional
        Material of the wall; Neo-Hookean with the tube's moduli by default.
    mesh : Mesh or MeshSize, optional
        A mesh of the wall, for instance of an imported surface, or the numbers of elements;
        ``USUAL_MESH`` by default.
    whole : bool
        Model the whole tube even where it is symmetric, so that symmetry can break.
    barrier_distance : float, optional
        Activation distance of the self-contact barrier in m; 1/400 of the bore by default.
    progress : callable, optional
        Called after every increment with the fraction of the expected increments that is done.

    Returns
    -------
    Indentation
        Every converged increment, the last at the (largest) `depth`.

    Raises
    ------
    ConfigError
        If the depth, the support or the layer is outside the model's range, an indenter misses the
        tube, or a given mesh is a half where the whole tube must be modelled.
    PressError
        If an increment does not converge however small it is. It states the depth reached, and
        holds the increments up to there.

    Notes
    -----
    The increments are adaptive; see :mod:`acoustube.indentation.load_path`. At each depth Newton's
    method finds the equilibrium; see :mod:`acoustube.indentation.newton`.
    """
    targets = np.atleast_1d(np.asarray(depth, dtype=float))
    indenters = _indenters(indenter)
    _check_range(tube, targets, support, layer)
    # A nearly incompressible wall needs double precision; the rest of acoustube does not, and must
    # not be switched to it. The factorisation's blocks are too small for several threads: on two
    # idle cores it takes 0.05 s with one thread and with two, at twice the processor time.
    with jax.enable_x64(True), threadpool_limits(1, user_api="blas"):
        untouched = first_touch(
            tube,
            indenters,
            support=support,
            layer=layer,
            material=material or neo_hookean_wall(tube),
            mesh=_mesh(tube, indenters, mesh, whole),
            barrier_distance=barrier_distance or BARRIER_DISTANCE * tube.inner_diameter,
        )
        _check_clearance(untouched, targets[-1])
        model, first = press_model(untouched), part_of(progress, 0.0, GUIDE_SHARE)
        coarse = _guide(untouched, targets, first)
        if coarse is not None:
            progress = part_of(progress, GUIDE_SHARE, 1.0)
        return load_path(untouched, model, targets, progress, guide=coarse)


def _guide(untouched: Indentation, targets: Array, progress: Progress | None) -> Guide | None:
    """Return the load path on a coarse mesh; None if there is no such mesh or its press fails."""
    mesh = coarse_mesh(untouched.mesh, untouched.tube, untouched.indenters)
    if mesh is None:
        return None
    coarse = dataclasses.replace(
        untouched, mesh=mesh, displacement=np.zeros((1, *mesh.points.shape))
    )
    model = press_model(coarse, GUIDE_SUBDIVISIONS)
    targets = spread(targets, SPACING * untouched.tube.inner_diameter)
    try:
        coarse = load_path(
            coarse, model, targets, progress, tolerance=GUIDE_TOLERANCE, largest=GUIDE_INCREMENT
        )
    except PressError as error:
        coarse = error.indentation
    return guide(coarse, untouched.mesh) if len(coarse.depth) > 1 else None


@checked(
    tube=Tube,
    indenter=INDENTERS,
    results=Mapping,
    support=SUPPORT,
    layer=Optional(Layer),
    mesh=Optional(Instance((Mesh, MeshSize))),
)
def restored(
    tube: Tube,
    indenter: Indenter | Sequence[Indenter] | None,
    results: Mapping[str, Array],
    *,
    support: Support = "held",
    layer: Layer | None = None,
    mesh: Mesh | MeshSize | None = None,
) -> Indentation:
    """Return an indentation from results computed before.

    Its material is Neo-Hookean with the tube's moduli, and its barrier distance is the default.

    Parameters
    ----------
    tube, indenter, support, layer, mesh
        As for :func:`indent`; a mesh of the whole tube must be given as a Mesh.
    results : mapping of str to array
        From :attr:`Indentation.results`.

    Returns
    -------
    Indentation

    Raises
    ------
    ConfigError
        If a result is missing, or an argument is outside its range.
    """
    if missing := set(RESULTS) - set(results):
        raise ConfigError(f"results have no {min(missing)}; give those of an Indentation")
    indenters = _indenters(indenter)
    with jax.enable_x64(True):
        untouched = first_touch(
            tube,
            indenters,
            support=support,
            layer=layer,
            material=neo_hookean_wall(tube),
            mesh=_mesh(tube, indenters, mesh, whole=False),
            barrier_distance=BARRIER_DISTANCE * tube.inner_diameter,
        )
    known: dict[str, Any] = {name: results[name] for name in RESULTS}
    return dataclasses.replace(untouched, **known)


def first_touch(
    tube: Tube,
    indenters: tuple[Indenter, ...],
    *,
    support: Support,
    layer: Layer | None,
    material: Material,
    mesh: Mesh,
    barrier_distance: float,
) -> Indentation:
    """Return the indentation at first contact: one increment, of depth 0 and smallest gap nan.

    Parameters
    ----------
    tube, support, layer, material, mesh, barrier_distance
        As for :func:`indent`.
    indenters : tuple of Indenter

    Raises
    ------
    ConfigError
        If an indenter misses the tube.
    """
    sampling, _ = triangulated(mesh, mesh.outer_faces)
    points = sampling @ mesh.points
    return Indentation(
        tube=tube,
        indenters=indenters,
        support=support,
        layer=layer,
        material=material,
        mesh=mesh,
        depth=np.zeros(1),
        displacement=np.zeros((1, *mesh.points.shape)),
        iterations=np.zeros(1, int),
        residual=np.zeros(1),
        press_force=np.zeros((1, len(indenters))),
        contact_area=np.zeros((1, len(indenters))),
        energy=np.zeros(1),
        smallest_volume_ratio=np.ones(1),
        smallest_gap=np.full(1, np.nan),
        touch_heights=tuple(touch_height(points, tool.gap()) for tool in indenters),
        barrier_distance=barrier_distance,
    )


def neo_hookean_wall(tube: Tube) -> Material:
    """Return the Neo-Hookean material with the moduli of a tube.

    Parameters
    ----------
    tube : Tube
    """
    return Material(
        Partial(neo_hookean, np.float64(tube.shear_modulus)), np.float64(tube.bulk_modulus)
    )


def press_model(indentation: Indentation, subdivisions: int = SUBDIVISIONS) -> Model:
    """Return the discretised tube of an indentation, the same at all increments.

    Parameters
    ----------
    indentation : Indentation
    subdivisions : int
        Number of triangle edges of the inner wall along the edge of an element's face.
    """
    mesh, tube = indentation.mesh, indentation.tube
    fixed = _fixed(mesh, indentation.support)
    lumen = self_contact(mesh, tube.shear_modulus, indentation.barrier_distance, subdivisions)
    smooth_folds = wrinkle_penalty.stiffness(mesh, tube.shear_modulus)
    return build_model(mesh, indentation.material, fixed, lumen, smooth_folds)


def _indenters(indenter: Indenter | Sequence[Indenter] | None) -> tuple[Indenter, ...]:
    if indenter is None:
        return (Indenter(),)
    return (indenter,) if isinstance(indenter, Indenter) else tuple(indenter)


def deepest_press(tube: Tube, layer: Layer | None = None) -> float:
    """Return the largest supported depth in m: the bore plus half a wall thickness.

    Parameters
    ----------
    tube : Tube
    layer : Layer, optional
        Layer under the tube; its thickness is added, because it is compressed as well.
    """
    return tube.inner_diameter + tube.wall_thickness / 2 + (layer.thickness if layer else 0.0)


def _check_range(tube: Tube, depths: Array, support: str, layer: Layer | None) -> None:
    """Raise if the depths, the support or the layer are outside the model's range."""
    if depths.ndim > 1:
        raise ConfigError(
            f"depth has shape {depths.shape}; give a number, or a 1-D array of increasing numbers"
        )
    deepest = deepest_press(tube, layer)
    deepest = max(deepest, float(f"{deepest:.6g}"))  # as the message states it
    if not (depths.size and np.all(np.diff(depths, prepend=0.0) > 0)):
        shown = ", ".join(f"{depth:.6g}" for depth in depths[:5]) + ", ..." * (len(depths) > 5)
        raise ConfigError(f"depth = {shown} m must be one or more positive, increasing depths")
    if not depths[-1] <= deepest * (1 + 1e-9):
        raise ConfigError(
            f"depth = {depths[-1]:.6g} m is beyond a closed lumen by more than half a wall"
            f"{' and the layer' * (layer is not None)}; use at most {deepest:.6g} m"
        )
    if layer is not None and support == "held":
        raise ConfigError("support = 'held' needs a rigid floor; use 'free' on an elastic layer")


def _check_clearance(untouched: Indentation, depth: float) -> None:
    """Raise if an indenter with an offset would reach the floor next to the tube."""
    floor = untouched.mesh.points[:, 1].min()
    floor -= untouched.layer.thickness if untouched.layer else 0.0
    for touch, indenter in zip(untouched.touch_heights, untouched.indenters, strict=True):
        clearance = (touch - floor) / indenter.depth_fraction
        if depth >= clearance:
            raise ConfigError(
                f"depth = {depth:.6g} m pushes the {indenter.shape} at x = {indenter.x:.6g} m into "
                f"the floor, which it reaches at a depth of {clearance:.6g} m; reduce the depth or "
                "the offset"
            )


def _mesh(
    tube: Tube, indenters: Sequence[Indenter], mesh: Mesh | MeshSize | None, whole: bool
) -> Mesh:
    """Return the given mesh, or mesh the smallest part of the tube that symmetry allows."""
    x, z = (all(tool.halves[i] for tool in indenters) and not whole for i in (0, 1))
    if isinstance(mesh, Mesh):
        for axis, half, allowed in zip("xz", mesh.halved, (x, z), strict=True):
            if half and not allowed:
                reason = "whole = True" if whole else f"an indenter not symmetric about {axis} = 0"
                raise ConfigError(
                    f"mesh has the half {axis} >= 0 of the tube only, which does not fit {reason}; "
                    "give a mesh of both halves"
                )
        return mesh
    reach = max(
        pressed_reach(tube.outer_diameter, tool.diameter) + abs(tool.z) for tool in indenters
    )
    return sweep(tube, reach, mesh, halved=(x, z), presses=[tool.z for tool in indenters])


def _fixed(mesh: Mesh, support: Support) -> NDArray[np.bool_]:
    """Return the mask of displacement components held at zero, shape (n_nodes, 3).

    They are those of symmetry planes, of the support, and against rigid-body motion. A tube not
    halved at x = 0 is guided sideways along its bottom line and, if free, at the top of its ends,
    so that it does not roll. One not halved at z = 0 is held along z at one node.
    """
    x, _, z = mesh.points.T
    fixed = np.zeros(mesh.points.shape, bool)
    fixed[:, 0] = (x == 0) & mesh.halved[0]
    fixed[:, 2] = (z == 0) & mesh.halved[1]
    bottom = mesh.bottom
    fixed[bottom, 1] = support == "held"
    if not mesh.halved[0]:
        fixed[bottom, 0] = True
        fixed[mesh.end_tops, 0] |= support == "free"
    if not mesh.halved[1]:
        fixed[bottom[np.argmin(np.abs(z[bottom]))], 2] = True
    return fixed
