"""The press that the settings describe, computed once and remembered."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acoustube.base import cache
from acoustube.base.errors import ConfigError
from acoustube.base.limits import pressed_reach
from acoustube.base.rules import filled
from acoustube.indentation import Indentation, Layer, Mesh, MeshSize, Press, indent, restored
from acoustube.indentation.press import deepest_press
from acoustube.indentation.reference_element import TET10
from acoustube.runs.config import Config, Mechanics
from acoustube.tube import Tube, shear_modulus_from_shore

Arrays = Mapping[str, NDArray[Any]]

MESH = ("points", "elements", "inner_faces", "outer_faces")
SIZES = {
    "coarse": MeshSize(through_wall=1, around=12, along=10),
    "usual": MeshSize(),
    "fine": MeshSize(through_wall=2, around=24, along=18),
}
"""Meshes of a round tube. The force of a 25 mm rod on each is in the documentation's findings."""


def shear_modulus_from(config: Config | Mechanics) -> float:
    """Return the wall's shear modulus in Pa."""
    settings = config.tube
    if settings.shear_modulus_mpa is not None:
        return 1e6 * settings.shear_modulus_mpa
    return shear_modulus_from_shore(filled(settings.shore_a))


def tube_from(config: Config | Mechanics) -> Tube:
    """Return the round tube that the settings describe, in SI units."""
    settings = config.tube
    return Tube(
        inner_diameter=1e-3 * settings.inner_diameter_mm,
        wall_thickness=1e-3 * settings.wall_mm,
        length=1e-2 * settings.length_cm,
        shear_modulus=shear_modulus_from(config),
        poisson_ratio=settings.poisson_ratio,
    )


def press_from(config: Config | Mechanics) -> Press:
    """Return the press that the settings describe, in SI units."""
    settings = config.indentation
    return Press(
        shape=settings.shape,
        diameter=1e-3 * settings.indenter_mm,
        x=1e-3 * settings.offset_mm,
        yaw=float(np.deg2rad(settings.yaw_deg)),
    )


def layer_from(config: Config | Mechanics) -> Layer | None:
    """Return the elastic layer under the tube, in SI units, if there is one."""
    settings = config.indentation
    if settings.layer_mm is None:
        return None
    return Layer(thickness=1e-3 * settings.layer_mm, modulus=1e6 * filled(settings.layer_mpa))


def pressed(
    config: Config | Mechanics,
    depths: Sequence[float],
    progress: Callable[[float], None] | None = None,
    note: Callable[[str], None] | None = None,
) -> Indentation:
    """Press the tube that the settings describe, or recall that it has been pressed before.

    Parameters
    ----------
    config : Config or Mechanics
    depths : sequence of float
        Rising depths in m, each of which is met exactly.
    progress : callable, optional
        Called with the finished fraction.
    note : callable, optional
        Called with a sentence where a remembered press is damaged and has to be computed again.

    Returns
    -------
    Indentation
        From the cache, if it holds a press of the same tube to the same depths; see
        :mod:`acoustube.base.cache`.

    Raises
    ------
    ConfigError, PressError
        See :func:`acoustube.indentation.indent` and :mod:`acoustube.indentation.tetrahedra`.
    """
    press, layer, support = press_from(config), layer_from(config), config.indentation.support
    surface = config.tube.surface
    name = remembered_as(config, depths)
    known = cache.recall(name)
    if note and known is None and cache.holds(name):
        entry = cache.folder() / f"{name}.npz"
        note(f"The remembered press {entry} is damaged and was not used: it was computed again.")
    size = SIZES[config.indentation.mesh]
    tube, mesh = (tube_from(config), size) if surface is None else _imported(config, press, known)
    if known is not None:
        return restored(tube, press, known, support=support, layer=layer, mesh=mesh)
    found = indent(
        tube, press, depth=depths, support=support, layer=layer, mesh=mesh, progress=progress
    )
    cache.store(name, _arrays(found), f"{wall_in_words(config)}; {press_in_words(config)}")
    return found


def remembered_as(config: Config | Mechanics, depths: Sequence[float]) -> str:
    """Return the name in the cache of the press that the settings describe, to depths in m."""
    layer, surface = layer_from(config), config.tube.surface
    tube = dataclasses.asdict(tube_from(config))
    del tube["length"]  # beyond the modelled part, whose length follows from the press
    return cache.key(
        "press",
        {
            "tube": tube,
            "surface": surface and _content(Path(surface)),
            "press": dataclasses.asdict(press_from(config)),
            "layer": layer and dataclasses.asdict(layer),
            "support": config.indentation.support,
            "mesh": dataclasses.asdict(SIZES[config.indentation.mesh]),
            "depths": list(depths),
        },
    )


def wall_in_words(config: Config | Mechanics) -> str:
    """Return in words what is pressed."""
    tube = config.tube
    if tube.surface is not None:
        return Path(tube.surface).name
    return f"bore {tube.inner_diameter_mm:g} mm, wall {tube.wall_mm:g} mm"


def press_in_words(config: Config | Mechanics) -> str:
    """Return in words how it is pressed."""
    press = config.indentation
    words = [f"{press.indenter_mm:g} mm {press.shape}", f"{press.depth_mm:g} mm deep"]
    words += [f"{press.offset_mm:g} mm beside the axis"] * (press.offset_mm != 0)
    words += [f"turned by {press.yaw_deg:g} deg"] * (press.yaw_deg != 0)
    if press.layer_mm is not None:
        words.append(f"on {press.layer_mm:g} mm of {filled(press.layer_mpa):g} MPa")
    return ", ".join([*words, f"support {press.support}"])


def _content(path: Path) -> str:
    """Return the hash of a file's content; one that cannot be read is refused when it is read."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return "unreadable"


def _imported(
    config: Config | Mechanics, press: Press, known: Arrays | None
) -> tuple[Tube, Mesh | MeshSize]:
    """Return an imported tube with its mesh, which is not made again where it is remembered."""
    from acoustube.indentation import tetrahedra, wall_surface
    from acoustube.runs import imported_wall

    surface = imported_wall.read_surface(str(config.tube.surface))
    tube = wall_surface.tube_of(
        surface,
        shear_modulus=shear_modulus_from(config),
        poisson_ratio=config.tube.poisson_ratio,
    )
    _check_depth(tube, config)
    if known is not None:
        halved = bool(known["halved"][0]), bool(known["halved"][1])
        parts: dict[str, Any] = {name: known[name] for name in MESH}
        return tube, Mesh(**parts, reference=TET10, halved=halved)
    reach = pressed_reach(tube.outer_diameter, press.diameter)
    return tube, tetrahedra.tetrahedral_mesh(surface, reach=reach, halved=press.halves)


def _check_depth(tube: Tube, config: Config | Mechanics) -> None:
    """Refuse a depth beyond what an imported tube allows, before it is meshed."""
    depth_mm = config.indentation.depth_mm
    deepest = deepest_press(tube, layer_from(config))
    if 1e-3 * depth_mm > deepest * (1 + 1e-9):
        raise ConfigError(
            f"depth_mm = {depth_mm:g} is beyond a closed lumen by more than half a wall (bore "
            f"{1e3 * tube.inner_diameter:.3g} mm high, wall {1e3 * tube.wall_thickness:.3g} mm); "
            f"use at most {1e3 * deepest:.3g}"
        )


def _arrays(indentation: Indentation) -> dict[str, NDArray[Any]]:
    """Return what is remembered of a press: its results, and a mesh that was imported."""
    mesh = indentation.mesh
    found = dict(indentation.results)
    if mesh.sweep is None:
        found |= {name: getattr(mesh, name) for name in MESH} | {"halved": np.array(mesh.halved)}
    return found
