"""Closed surfaces of walls and of lumens, from files."""

from __future__ import annotations

from pathlib import Path

import ipctk
import numpy as np
import trimesh
from numpy.typing import NDArray

from acoustube.base.errors import ConfigError
from acoustube.base.files import check_surface
from acoustube.base.foreign import child
from acoustube.base.foreign.limits import check_file, reading
from acoustube.base.units import MM

FARTHEST = 1e5
"""Largest coordinate of a surface in mm: at 100 m, single precision resolves 0.01 mm."""
SHORTEST = 1.0
"""Length of a surface in mm below which its coordinates are suspected to be in metres."""


def load(path: Path) -> trimesh.Trimesh:
    """Read triangles, in mm, from an STL, PLY, OBJ or VTP file, with coincident corners merged.

    Raises
    ------
    ConfigError
        If the file cannot be read or has no triangles, or they are too far from the origin.
    """
    check_surface(path)
    check_file(path, "surface")
    kind = path.suffix.lower()[1:]
    with reading(path, "cannot be read as a surface", "use STL, PLY, OBJ or VTP"):
        if kind == "vtp":
            found = {label["name"]: value for label, value in child.read("vtp", path, "surface")}
            surface = trimesh.Trimesh(found["points"], found["faces"])
        elif kind not in ("stl", "ply", "obj"):
            raise ValueError("it is of another kind")
        else:
            # Given an open file, the library loads no textures that a surface may name.
            with path.open("rb") as file:
                surface = trimesh.load_mesh(file, file_type=kind, skip_materials=True)
    if not isinstance(surface, trimesh.Trimesh) or not len(surface.faces):
        raise ConfigError(f"{path} holds no triangles; export it as one surface")
    farthest = float(np.abs(surface.vertices).max())
    if not farthest <= FARTHEST:  # so that nan fails too
        raise ConfigError(
            f"{path} reaches {farthest:.3g} mm from the origin, more than the limit of "
            f"{FARTHEST:g} mm; give it in mm, and move it to the origin"
        )
    surface.merge_vertices(merge_tex=True, merge_norm=True)
    return surface


def check_closed(surface: trimesh.Trimesh, path: Path) -> None:
    """Raise ConfigError if a surface is open, not manifold, not oriented, or of several bodies."""
    _, count = np.unique(surface.edges_sorted, axis=0, return_counts=True)
    lone, shared = np.sum(count == 1), np.sum(count > 2)
    if lone:
        raise ConfigError(
            f"{path}: the surface is not closed: {lone} edges belong to one facet only and "
            f"{shared} to more than two; repair it, or export it as a solid"
        )
    if shared:
        raise ConfigError(
            f"{path}: the surface touches itself: {shared} edges belong to more than two facets; "
            "leave a gap there, or export it as a solid"
        )
    if not surface.is_winding_consistent:
        raise ConfigError(f"{path}: some facets are inside out; unify their orientation")
    n = len(np.unique(components(surface)))
    if n != 1:
        raise ConfigError(f"{path} holds {n} separate bodies; export one alone")


def check_millimetres(surface: trimesh.Trimesh, path: Path) -> None:
    """Raise ConfigError if the coordinates of a surface seem to be in metres."""
    longest = float(surface.extents.max())
    if longest < SHORTEST:
        raise ConfigError(
            f"{path} is {longest:.3g} mm long, which would be {MM * longest:.3g} mm if its "
            "numbers were metres; give it in mm"
        )


def check_crossings(surface: trimesh.Trimesh, path: Path) -> None:
    """Raise ConfigError if a surface intersects itself."""
    # Scaled, since ipctk expects lengths of about one.
    vertices = np.asfortranarray(surface.vertices / surface.extents.min())
    faces = surface.faces.astype(np.int32)
    if ipctk.has_intersections(ipctk.CollisionMesh(vertices, ipctk.edges(faces), faces), vertices):
        raise ConfigError(f"{path}: the surface intersects itself; repair it")


def components(surface: trimesh.Trimesh) -> NDArray[np.int64]:
    """Return for each facet the index of the connected part to which it belongs, (facet,)."""
    return trimesh.graph.connected_component_labels(
        surface.face_adjacency, node_count=len(surface.faces)
    )


def read_lumen(path: str | Path) -> tuple[trimesh.Trimesh, float]:
    """Read the closed surface of a lumen.

    Parameters
    ----------
    path : str or Path
        STL, PLY, OBJ or VTP, in mm, along z, closed by flat caps at both ends.

    Returns
    -------
    surface : trimesh.Trimesh
        In m, moved along z to begin at zero.
    start : float
        Coordinate z at which it began, in m.

    Raises
    ------
    ConfigError
        If the surface cannot be read, is open, inside out or self-intersecting, has several bodies
        or a hole through it, is not along z between flat ends, or seems to be in metres.
    """
    path = Path(path)
    surface = load(path)
    check_closed(surface, path)
    extents = surface.extents
    check_millimetres(surface, path)
    if surface.euler_number < 2:
        raise ConfigError(
            f"{path} has a hole through it, as the wall of a tube has; give the surface of the air "
            "inside, or press the wall with acoustube indent --tube"
        )
    if surface.volume < 0:
        raise ConfigError(f"{path} is inside out; turn its facets so that they point outwards")
    low, high = surface.bounds[:, 2]
    z = surface.triangles[..., 2]
    tolerance = 1e-4 * extents.min()
    caps = [np.all(np.abs(z - end) < tolerance, axis=1) for end in (low, high)]
    if extents[2] < extents[:2].max() or not all(cap.any() for cap in caps):
        raise ConfigError(
            f"{path} is {extents[0]:.3g} x {extents[1]:.3g} x {extents[2]:.3g} mm and does not lie "
            "along z between two flat ends; turn it, and cut its ends square"
        )
    check_crossings(surface, path)
    surface.apply_translation([0.0, 0.0, -low])
    # Scaling by 1e-3 in place would make the library merge corners.
    scaled = trimesh.Trimesh(surface.vertices / MM, surface.faces, process=False)
    return scaled, float(low / MM)
