"""A press from first touch to the asked depth, in adaptive increments."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jax.tree_util import Partial
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from acoustube.base.errors import ConfigError
from acoustube.base.limits import pressed_reach
from acoustube.base.types import Array, Progress
from acoustube.indentation import indenters, wrinkle_penalty
from acoustube.indentation.assembly import Model, build_model
from acoustube.indentation.indenters import Layer, Press, Support
from acoustube.indentation.load_path import load_path
from acoustube.indentation.material import Material, neo_hookean
from acoustube.indentation.mesh import Mesh, MeshSize, sweep
from acoustube.indentation.result import RESULTS, Indentation
from acoustube.indentation.self_contact import self_contact, triangulated
from acoustube.tube import Tube

CLOSING_DISTANCE = 2.5e-3
"""Gap at which the lumen's walls begin to feel each other: 0.02 mm in the paper's tube."""


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
        return load_path(untouched, build(untouched), targets, progress)


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
        touch_heights=tuple(indenters.touch_height(points, p.gap()) for p in presses),
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
        mesh, indentation.material, fixed, lumen, wrinkle_penalty.skin(mesh, tube.shear_modulus)
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
    if support not in indenters.SUPPORTS:
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
