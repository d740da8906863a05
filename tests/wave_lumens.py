"""Lumens for the tests of the wave stage."""

from dataclasses import replace

import numpy as np
import trimesh

BORE = 3.95e-3  # radius in m


def straight_tube(length, *, radius=BORE, sections=256, shift=(0.0, 0.0)):
    """A circular cylinder from z = 0, with its axis shifted in x and y."""
    # Made at unit size: trimesh drops the facets of a cylinder that is thin in metres.
    tube = trimesh.creation.cylinder(1.0, 1.0, sections=sections)
    tube.apply_translation([0.0, 0.0, 0.5])
    tube.apply_transform(np.diag([radius, radius, length, 1.0]))
    tube.apply_translation([*shift, 0.0])
    return tube


def stepped_tube(length, step, narrow_radius):
    """A bore that narrows abruptly at z = step."""
    profile = [[0, 0], [BORE, 0], [BORE, step], [narrow_radius, step], [narrow_radius, length]]
    return trimesh.creation.revolve([*profile, [0, length]], sections=128)


def pinched_tube(length, depth=0.4, *, centre=None, width=4e-3):
    """A bore whose height shrinks smoothly by a share `depth`, from above only."""
    z = np.linspace(0.0, length, 120)
    profile = [[0, 0], *[[BORE, zi] for zi in z], [0, length]]
    tube = trimesh.creation.revolve(profile, sections=64)
    vertices = tube.vertices.copy()
    press = np.exp(-(((vertices[:, 2] - (centre or length / 2)) / width) ** 2))
    vertices[:, 1] -= depth * press * (vertices[:, 1] + BORE)
    tube.vertices = vertices
    return tube


def staircase(cells):
    """The same lumen made of whole cells: those more than half open, with open faces in between."""
    full = np.where(cells.volume_fraction > 0.5, 1.0, 0.0)
    faces = {name: np.zeros_like(getattr(cells, name)) for name in ("open_x", "open_y", "open_z")}
    faces["open_x"][1:-1] = full[1:] * full[:-1]
    faces["open_y"][:, 1:-1] = full[:, 1:] * full[:, :-1]
    faces["open_z"][..., 1:-1] = full[..., 1:] * full[..., :-1]
    faces["open_z"][..., 0], faces["open_z"][..., -1] = full[..., 0], full[..., -1]
    return replace(cells, volume_fraction=full, **faces)
