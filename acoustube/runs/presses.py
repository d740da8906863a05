"""Presses of tubes, each computed once and then read from the cache."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acoustube.base import cache
from acoustube.base.ahead import compile_ahead
from acoustube.base.checks import Instance, Reals, checked
from acoustube.base.errors import ConfigError
from acoustube.base.limits import pressed_reach
from acoustube.base.units import MM, MPA
from acoustube.indentation import Indentation, Mesh, MeshSize, indent, restored
from acoustube.indentation.element import compile_contraction
from acoustube.indentation.multifrontal import compile_kernels
from acoustube.indentation.press import deepest_press
from acoustube.indentation.reference_element import TET10
from acoustube.runs.config import Config, Mechanics
from acoustube.runs.config.si import SIPress, press_in_si
from acoustube.tube import Tube

Arrays = Mapping[str, NDArray[Any]]
Progress = Callable[[float], None]
Note = Callable[[str], None]

KERNELS = compile_contraction, compile_kernels
"""Functions that compile the code of a press."""
MESH = ("points", "elements", "inner_faces", "outer_faces")
"""Arrays of the mesh of an imported wall that are cached with its press."""
NOTES = "notes"
"""Name of the cached array of notes on the mesh of an imported wall."""


@checked(config=Instance((Config, Mechanics)), depths=Reals(0, 1, "m", ndim=1))
def pressed(
    config: Config | Mechanics,
    depths: Sequence[float],
    progress: Progress | None = None,
    note: Note | None = None,
) -> Indentation:
    """Press the tube that the settings describe, or read its press from the cache.

    Parameters
    ----------
    config : Config or Mechanics
    depths : sequence of float
        Rising indentation depths in m, each of which is reached exactly.
    progress : callable, optional
        Called with the finished fraction.
    note : callable, optional
        Called with a sentence if a cached press is damaged and has to be computed again, or if the
        mesh of an imported wall deviates from its surface.

    Returns
    -------
    Indentation
        From the cache, if it holds a press of the same tube to the same depths; see
        :mod:`acoustube.base.cache`.

    Raises
    ------
    ConfigError
        If the press is outside the model's range, or an imported wall cannot be read or meshed.
    PressError
        If an increment does not converge; the error holds the increments before.
    """
    return press_to(press_in_si(config), depths, progress, note)


def press_to(
    settings: SIPress,
    depths: Sequence[float],
    progress: Progress | None = None,
    note: Note | None = None,
    *,
    then: Iterable[Callable[[], None]] = (),
) -> Indentation:
    """Press a tube to several depths in m as :func:`pressed`, from settings in SI units.

    The code of the press is compiled in the background, unless the press is cached. Afterwards the
    functions `then` are called, also in the background, to compile code that is needed later.
    """
    name = cache_key(settings, depths)
    known = cache.recall(name)
    if note and known is None and cache.holds(name):
        entry = cache.folder() / f"{name}.npz"
        note(f"The cached press {entry} is damaged and was not used: it was computed again.")
    indenter, support, layer = settings.indenter, settings.support, settings.layer
    compile_ahead([*(KERNELS if known is None else ()), *then])
    said: list[str] = []
    tube, mesh = _tube_and_mesh(settings, known, said)
    if note:
        for words in said:
            note(words)
    if known is not None:
        return restored(tube, indenter, known, support=support, layer=layer, mesh=mesh)
    found = indent(
        tube, indenter, depth=depths, support=support, layer=layer, mesh=mesh, progress=progress
    )
    deepest = dataclasses.replace(settings, depth=max(depths))
    label = f"{wall_in_words(settings)}; {press_in_words(deepest)}"
    cache.store(name, _arrays(found, said), label)
    return found


def cache_key(settings: SIPress, depths: Sequence[float]) -> str:
    """Return the cache key of the press that the settings describe, to depths in m."""
    tube = dataclasses.asdict(settings.tube)
    del tube["length"]  # without effect: the length of the modelled part follows from the press
    return cache.key(
        "press",
        {
            "tube": tube,
            "surface": settings.surface and _content(Path(settings.surface)),
            "press": dataclasses.asdict(settings.indenter),
            "layer": settings.layer and dataclasses.asdict(settings.layer),
            "support": settings.support,
            "mesh": dataclasses.asdict(settings.mesh),
            "depths": [float(depth) for depth in depths],
        },
    )


def wall_in_words(settings: SIPress) -> str:
    """Return the bore and the wall as text, or the name of the surface's file."""
    if settings.surface is not None:
        return Path(settings.surface).name
    tube = settings.tube
    return f"bore {MM * tube.inner_diameter:g} mm, wall {MM * tube.wall_thickness:g} mm"


def press_in_words(settings: SIPress) -> str:
    """Return the indenter, depth and support of the press as text."""
    indenter, layer = settings.indenter, settings.layer
    words = [f"{MM * indenter.diameter:g} mm {indenter.shape}", f"{MM * settings.depth:g} mm deep"]
    words += [f"{MM * indenter.x:g} mm beside the axis"] * (indenter.x != 0)
    words += [f"turned by {np.degrees(indenter.yaw):g} deg"] * (indenter.yaw != 0)
    if layer is not None:
        words.append(f"on a {MM * layer.thickness:g} mm layer of {MPA * layer.modulus:g} MPa")
    return ", ".join([*words, f"support {settings.support}"])


def _content(path: Path) -> str:
    """Return the hash of a file's content; an unreadable file is reported by its reader later."""
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError:
        return "unreadable"


def _tube_and_mesh(
    settings: SIPress, known: Arrays | None, said: list[str]
) -> tuple[Tube, Mesh | MeshSize]:
    """Return the tube, with the mesh of an imported wall or the mesh size of a round tube.

    The mesh of an imported wall, and the notes on it, which are appended to `said`, are taken from
    the arrays `known` of a cached press, if given.
    """
    if settings.surface is None:
        return settings.tube, settings.mesh
    from acoustube.indentation import tetrahedra, wall_surface
    from acoustube.runs import imported_wall

    surface = imported_wall.read_surface(settings.surface)
    tube = wall_surface.tube_of(
        surface,
        shear_modulus=settings.tube.shear_modulus,
        poisson_ratio=settings.tube.poisson_ratio,
    )
    _check_depth(tube, settings)
    if known is not None:
        said += [str(words) for words in known[NOTES]]
        halved = bool(known["halved"][0]), bool(known["halved"][1])
        parts: dict[str, Any] = {name: known[name] for name in MESH}
        return tube, Mesh(**parts, reference=TET10, halved=halved)
    reach = pressed_reach(tube.outer_diameter, settings.indenter.diameter)
    halves = settings.indenter.halves
    return tube, tetrahedra.tetrahedral_mesh(surface, reach=reach, halved=halves, note=said.append)


def _check_depth(tube: Tube, settings: SIPress) -> None:
    """Raise if the depth exceeds the limit of an imported tube, before it is meshed."""
    deepest = deepest_press(tube, settings.layer)
    if settings.depth > deepest * (1 + 1e-9):
        raise ConfigError(
            f"depth_mm = {MM * settings.depth:g} is beyond a closed lumen by more than half a wall "
            f"(bore {MM * tube.inner_diameter:.3g} mm high, wall {MM * tube.wall_thickness:.3g} "
            f"mm); use at most {MM * deepest:.3g}"
        )


def _arrays(indentation: Indentation, said: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Return the arrays of a press to be cached: its results.

    For an imported wall these include its mesh, and the notes `said` on the mesh.
    """
    mesh = indentation.mesh
    found = dict(indentation.results)
    if mesh.sweep is None:
        found |= {name: getattr(mesh, name) for name in MESH}
        found |= {"halved": np.array(mesh.halved), NOTES: np.array(said, str)}
    return found
