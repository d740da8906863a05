"""A press from first touch to the asked depth, in adaptive increments."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.tree_util import Partial
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from acoustube.errors import ConfigError, SimulationError
from acoustube.indentation import folds, tools
from acoustube.indentation.contact import Body
from acoustube.indentation.equilibrium import (
    Equilibrium,
    Measures,
    Model,
    build_model,
    measures,
    minimise,
)
from acoustube.indentation.material import Material, neo_hookean
from acoustube.indentation.mesh import Mesh, MeshSize, sweep
from acoustube.indentation.self_contact import self_contact, triangulated
from acoustube.indentation.tools import Layer, Press, Support
from acoustube.limits import pressed_reach
from acoustube.tube import Tube

Array = NDArray[np.float64]
Progress = Callable[[float], None]

# All lengths below are in bore diameters, so that a small tube is pressed like a large one.
FIRST_INCREMENT = 2.5e-3
LARGEST_INCREMENT = 1 / 16
SMALLEST_INCREMENT = 1e-5
EASY_ITERATIONS = 8

CLOSING_DISTANCE = 2.5e-3
"""Gap at which the lumen's walls begin to feel each other: 0.02 mm in the paper's tube."""
FORCE_TOLERANCE = 1e-8
"""Out-of-balance force accepted, in shear moduli times squared bore diameters."""

RESULTS = ("depth", "displacement", "iterations", "residual", *Measures._fields)
"""Names of an indentation's arrays with a row per increment."""


@dataclass(frozen=True, eq=False)
class Indentation:
    """A press, increment by increment; the first row is first touch.

    Parameters
    ----------
    tube : Tube
    presses : tuple of Press
    support : {"held", "free"}
    layer : Layer or None
    material : Material
    mesh : Mesh
        The undeformed part that is modelled.
    depth : array of shape (n_increments,)
        How far the presses have come down from first touch, in m (times the share of each).
    displacement : array of shape (n_increments, n_nodes, 3)
        Nodal displacements in m.
    iterations : array of shape (n_increments,)
        Newton iterations that each increment took.
    residual : array of shape (n_increments,)
        Norm of the out-of-balance nodal forces, in N.
    press_force, contact_area : arrays of shape (n_increments, n_presses)
        Of the whole tube: upward force in N on each press, and the deformed area in m2 that it
        touches.
    energy : array of shape (n_increments,)
        Elastic energy of the whole tube in J.
    smallest_volume_ratio : array of shape (n_increments,)
        Smallest J at any quadrature point.
    smallest_gap : array of shape (n_increments,)
        Between the lower and the upper inner wall, in m.
    touch_heights : tuple of float
        Height y in m of the lowest point of each press at first touch.
    closing_distance : float
        Gap in m at which the lumen's walls begin to feel each other.
    """

    tube: Tube
    presses: tuple[Press, ...]
    support: Support
    layer: Layer | None
    material: Material
    mesh: Mesh
    depth: Array
    displacement: Array
    iterations: NDArray[np.int64]
    residual: Array
    press_force: Array
    contact_area: Array
    energy: Array
    smallest_volume_ratio: Array
    smallest_gap: Array
    touch_heights: tuple[float, ...]
    closing_distance: float

    @property
    def contact_force(self) -> Array:
        """Force in N of all presses together, shape (n_increments,)."""
        return self.press_force.sum(axis=1)

    @property
    def closed(self) -> NDArray[np.bool_]:
        """Whether the lumen's walls feel each other, shape (n_increments,)."""
        return self.smallest_gap < self.closing_distance

    @property
    def results(self) -> dict[str, Array]:
        """All arrays with a row per increment, by name."""
        return {name: getattr(self, name) for name in RESULTS}

    def rows_at(self, depths: Sequence[float]) -> list[int]:
        """Return the numbers of those increments that are at one of the given depths, in m."""
        wanted = set(depths)
        return [i for i, depth in enumerate(self.depth) if depth in wanted]

    def position(self, increment: int = -1) -> Array:
        """Return the deformed nodes, shape (n_nodes, 3), in m."""
        return self.mesh.points + self.displacement[increment]

    def bodies(self, increment: int = -1) -> tuple[Body, ...]:
        """Return the presses at an increment, and last the ground."""
        return _bodies(self, self.depth[increment])


class PressError(SimulationError):
    """A press that could not go on.

    Attributes
    ----------
    indentation : Indentation
        Every increment that had converged.
    """

    def __init__(self, message: str, indentation: Indentation) -> None:
        super().__init__(message)
        self.indentation = indentation


def indent(
    tube: Tube,
    press: Press | Sequence[Press] | None = None,
    *,
    depth: float | Sequence[float],
    support: Support = "held",
    layer: Layer | None = None,
    material: Material | None = None,
    mesh: Mesh | MeshSize | None = None,
    whole: bool = False,
    closing_distance: float | None = None,
    progress: Progress | None = None,
) -> Indentation:
    """Press one or several rigid tools down on a tube.

    The tube lies on a floor or on an elastic layer; nothing has friction.

    Parameters
    ----------
    tube : Tube
        The tube; its axis is z, its top line at +y.
    press : Press or sequence of Press, optional
        What presses it; a 25 mm rod by default.
    depth : float or sequence of float
        Depth to reach in m, counted from first touch. Of a rising sequence each is met exactly by
        an increment. The lumen closes when the depth is about the bore.
    support : {"held", "free"}
        ``"held"``: the bottom line cannot leave the floor, as in a pocket. ``"free"``: the tube
        rests on the floor and can tilt off it beside the press.
    layer : Layer, optional
        An elastic layer in place of the rigid floor; for a free tube.
    material : Material, optional
        The wall's; Neo-Hookean with the tube's moduli by default.
    mesh : Mesh or MeshSize, optional
        A mesh of the wall, as of an imported surface, or the number of elements of the tube's.
    whole : bool
        Model the whole tube even where it is symmetric, so that it may leave its symmetry.
    closing_distance : float, optional
        Gap in m at which the lumen's walls begin to feel each other; 1/400 of the bore by default.
    progress : callable, optional
        Called after every increment with the fraction of the expected increments that is done.

    Returns
    -------
    Indentation
        Every converged increment, the last at the (largest) `depth`.

    Raises
    ------
    ConfigError
        If the depth or the support is outside what the model holds for, or a press misses the tube.
    PressError
        If no increment, however small, can be converged. It says what depth was reached, and holds
        the increments up to there.

    Notes
    -----
    Each increment starts from the quadratic through the last three states, cut short where the
    lumen's walls would meet on the way. One that does not converge, or meets an indefinite tangent,
    is halved.
    """
    targets = np.atleast_1d(np.asarray(depth, dtype=float))
    presses = _presses(press)
    _check(tube, targets, support, layer)
    # A nearly incompressible wall needs double precision; the rest of acoustube does not, and must
    # not be made to. The banded factorisation works on blocks too small to share: on two busy cores
    # it took 3 to 7 s with two threads and 0.14 s with one.
    with jax.enable_x64(True), threadpool_limits(1, user_api="blas"):
        untouched = first_touch(
            tube,
            presses,
            support=support,
            layer=layer,
            material=material or neo_hookean_wall(tube),
            mesh=_mesh(tube, presses, mesh, whole),
            closing_distance=closing_distance or CLOSING_DISTANCE * tube.inner_diameter,
        )
        _check_room(untouched, targets[-1])
        return _path(untouched, build(untouched), targets, progress)


def restored(
    tube: Tube,
    press: Press | Sequence[Press] | None,
    results: Mapping[str, Array],
    *,
    support: Support = "held",
    layer: Layer | None = None,
    mesh: Mesh | MeshSize | None = None,
) -> Indentation:
    """Return an indentation whose results were computed before; see :func:`indent`.

    Parameters
    ----------
    results : mapping of str to array
        From :attr:`Indentation.results`.
    """
    presses = _presses(press)
    with jax.enable_x64(True):
        untouched = first_touch(
            tube,
            presses,
            support=support,
            layer=layer,
            material=neo_hookean_wall(tube),
            mesh=_mesh(tube, presses, mesh, whole=False),
            closing_distance=CLOSING_DISTANCE * tube.inner_diameter,
        )
    known: dict[str, Any] = {name: results[name] for name in RESULTS}
    return dataclasses.replace(untouched, **known)


def first_touch(
    tube: Tube,
    presses: tuple[Press, ...],
    *,
    support: Support,
    layer: Layer | None,
    material: Material,
    mesh: Mesh,
    closing_distance: float,
) -> Indentation:
    """Return an indentation of no depth; see :func:`indent`."""
    sampling, _ = triangulated(mesh, mesh.outer_faces)
    points = sampling @ mesh.points
    return Indentation(
        tube=tube,
        presses=presses,
        support=support,
        layer=layer,
        material=material,
        mesh=mesh,
        depth=np.zeros(1),
        displacement=np.zeros((1, *mesh.points.shape)),
        iterations=np.zeros(1, int),
        residual=np.zeros(1),
        press_force=np.zeros((1, len(presses))),
        contact_area=np.zeros((1, len(presses))),
        energy=np.zeros(1),
        smallest_volume_ratio=np.ones(1),
        smallest_gap=np.full(1, np.nan),
        touch_heights=tuple(tools.touch_height(points, p.gap()) for p in presses),
        closing_distance=closing_distance,
    )


def neo_hookean_wall(tube: Tube) -> Material:
    """Return the Neo-Hookean material with a tube's moduli."""
    return Material(
        Partial(neo_hookean, np.float64(tube.shear_modulus)), np.float64(tube.bulk_modulus)
    )


def build(indentation: Indentation) -> Model:
    """Return the discretised tube of an indentation."""
    mesh, tube = indentation.mesh, indentation.tube
    fixed = _fixed(mesh, indentation.support)
    lumen = self_contact(mesh, tube.shear_modulus, indentation.closing_distance)
    return build_model(
        mesh, indentation.material, fixed, lumen, folds.skin(mesh, tube.shear_modulus)
    )


def _presses(press: Press | Sequence[Press] | None) -> tuple[Press, ...]:
    if press is None:
        return (Press(),)
    presses = (press,) if isinstance(press, Press) else tuple(press)
    if not presses:
        raise ConfigError("press = () presses nothing; give at least one Press.")
    return presses


def deepest_press(tube: Tube, layer: Layer | None = None) -> float:
    """Return the largest depth in m that is followed: the bore and half a wall thickness.

    A layer under the tube gives way besides, by less than its own thickness.
    """
    return tube.inner_diameter + tube.wall_thickness / 2 + (layer.thickness if layer else 0.0)


def _check(tube: Tube, depths: Array, support: str, layer: Layer | None) -> None:
    """Refuse what the model does not hold for."""
    deepest = deepest_press(tube, layer)
    if not (depths.size and np.all(np.diff(depths, prepend=0.0) > 0)):
        shown = ", ".join(f"{depth:.6g}" for depth in depths[:5]) + ", ..." * (len(depths) > 5)
        raise ConfigError(f"depth = {shown} m must be one or more depths over 0 that rise.")
    if not depths[-1] <= deepest * (1 + 1e-9):
        raise ConfigError(
            f"depth = {depths[-1]:.6g} m is beyond half a wall thickness after the bore has "
            f"closed{' and the layer is flat' * (layer is not None)}; use at most {deepest:.6g}."
        )
    if support not in tools.SUPPORTS:
        raise ConfigError(f"support = {support!r} is unknown; use 'held' or 'free'.")
    if layer is not None and support == "held":
        raise ConfigError("support = 'held' needs a rigid floor; use 'free' on an elastic layer.")


def _check_room(untouched: Indentation, depth: float) -> None:
    """Refuse to push a tool beside the tube into the floor."""
    floor = untouched.mesh.points[:, 1].min()
    floor -= untouched.layer.thickness if untouched.layer else 0.0
    for touch, press in zip(untouched.touch_heights, untouched.presses, strict=True):
        room = (touch - floor) / press.share
        if depth >= room:
            raise ConfigError(
                f"depth = {depth:.6g} m pushes the {press.shape} at x = {press.x:.6g} m into the "
                f"floor, which is {room:.6g} m below first touch; use less, or less offset."
            )


def _mesh(tube: Tube, presses: Sequence[Press], mesh: Mesh | MeshSize | None, whole: bool) -> Mesh:
    """Return the mesh that was given, or that of the smallest part that symmetry leaves."""
    if isinstance(mesh, Mesh):
        return mesh
    reach = max(pressed_reach(tube.outer_diameter, p.diameter) + abs(p.z) for p in presses)
    x, z = (all(p.halves[i] for p in presses) and not whole for i in (0, 1))
    return sweep(tube, reach, mesh, halved=(x, z), presses=[p.z for p in presses])


def _fixed(mesh: Mesh, support: Support) -> NDArray[np.bool_]:
    """Return which displacement components are held at zero, shape (n_nodes, 3).

    Beside the planes of symmetry and the support, what a rigid motion needs: a tube that is whole
    across lies in a groove that guides its bottom line, and one that is whole along cannot slide.
    """
    x, _, z = mesh.points.T
    fixed = np.zeros(mesh.points.shape, bool)
    fixed[:, 0] = (x == 0) & mesh.halved[0]
    fixed[:, 2] = (z == 0) & mesh.halved[1]
    bottom = mesh.bottom
    fixed[bottom, 1] = support == "held"
    if not mesh.halved[0]:
        fixed[bottom, 0] = True
    if not mesh.halved[1]:
        fixed[bottom[np.argmin(np.abs(z[bottom]))], 2] = True
    return fixed


def _bodies(indentation: Indentation, depth: float) -> tuple[Body, ...]:
    tube, presses = indentation.tube, indentation.presses
    heights = [
        touch - press.share * depth
        for touch, press in zip(indentation.touch_heights, presses, strict=True)
    ]
    bottom = np.float64(indentation.mesh.points[:, 1].min())
    wall = np.float64(tube.shear_modulus), np.float64(tube.wall_thickness)
    return *tools.tools(tube, presses, heights), tools.ground(*wall, bottom, indentation.layer)


class _Done(NamedTuple):
    """A converged increment."""

    depth: float
    result: Equilibrium
    measures: Measures


def _path(
    untouched: Indentation, model: Model, targets: Array, progress: Progress | None
) -> Indentation:
    """Press from first touch to the last target, and gather every converged increment."""
    tube, bore = untouched.tube, untouched.tube.inner_diameter
    tolerance = FORCE_TOLERANCE * tube.shear_modulus * bore**2
    start = Equilibrium(untouched.displacement[0], True, 0, 0.0)
    done = [_Done(0.0, start, _at_first_touch(model, untouched))]
    increment = FIRST_INCREMENT * bore
    while done[-1].depth < targets[-1]:
        depth = _next_depth(targets, done[-1].depth, increment)
        bodies = _bodies(untouched, depth)
        result = minimise(model, _guess(model, done[-3:], depth), bodies, tolerance)
        if not result.converged:
            increment = (depth - done[-1].depth) / 2
            if increment < SMALLEST_INCREMENT * bore:
                raise _stopped(untouched, done, targets[-1], result)
            continue
        done.append(_Done(depth, result, measures(model, result.displacement, bodies)))
        if result.iterations <= EASY_ITERATIONS:
            increment = min(2 * increment, LARGEST_INCREMENT * bore)
        if progress:
            left = float(targets[-1]) - depth
            progress(_share_done(len(done), left, increment, LARGEST_INCREMENT * bore))
    return _gathered(untouched, done)


def _at_first_touch(model: Model, untouched: Indentation) -> Measures:
    """Return the measures of the undeformed tube; the contact only begins to be felt there."""
    none = np.zeros(len(untouched.presses))
    return Measures(none, none, 0.0, 1.0, model.lumen.smallest_gap(model.mesh.points))


def _next_depth(targets: Array, reached: float, increment: float) -> float:
    """Return where the next increment ends; one that would end just short of a target meets it."""
    target = float(targets[np.searchsorted(targets, reached, side="right")])
    return target if reached + 1.05 * increment >= target else reached + increment


def _guess(model: Model, last: Sequence[_Done], depth: float) -> Array:
    """Return the polynomial through the last states at a new depth, short of any collision."""
    x = np.array([done.depth for done in last])
    weights = [np.prod((depth - np.delete(x, i)) / (x[i] - np.delete(x, i))) for i in range(len(x))]
    states = np.stack([done.result.displacement for done in last])
    here, ahead = states[-1], np.tensordot(weights, states, axes=1)
    share = model.lumen.free_share(model.mesh.points + here, model.mesh.points + ahead)
    return here + share * (ahead - here)


def _share_done(n_done: int, left: float, increment: float, largest: float) -> float:
    """Return the share of the expected increments that is done, with `left` m still to go."""
    expected = np.log2(largest / increment) + left / largest
    return float(n_done / (n_done + expected)) if left > 0 else 1.0


def _stopped(
    untouched: Indentation, done: Sequence[_Done], asked: float, failed: Equilibrium
) -> PressError:
    return PressError(
        f"The indentation stopped at a depth of {1e3 * done[-1].depth:.2f} mm of "
        f"{1e3 * asked:.2f} mm: {failed.reason} (out-of-balance force {failed.residual:.1e} N). "
        "Ask for less depth or a larger indenter; from Python, for a finer mesh.",
        _gathered(untouched, done),
    )


def _gathered(untouched: Indentation, done: Sequence[_Done]) -> Indentation:
    results = [increment.result for increment in done]
    measured: dict[str, Any] = {
        name: np.array([getattr(increment.measures, name) for increment in done])
        for name in Measures._fields
    }
    return dataclasses.replace(
        untouched,
        depth=np.array([increment.depth for increment in done]),
        displacement=np.stack([result.displacement for result in results]),
        iterations=np.array([result.iterations for result in results]),
        residual=np.array([result.residual for result in results]),
        **measured,
    )
