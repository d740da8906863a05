"""The lumen, the air space of a deformed tube: surface, cross-sections, straightened form.

Reading order: ``straightening`` (coordinates along a bent tube), ``surface`` (the lumen of the
pressed part and of the whole tube), ``profiles`` (height, width and area along the tube),
``thinning`` (fewer rings for files and pictures).
"""

from acoustube.lumen.profiles import TRIANGLES_PER_EDGE, Profile, inner_wall, measure, profile
from acoustube.lumen.straightening import straighten
from acoustube.lumen.surface import (
    Lumen,
    deformed_wall,
    lumen,
    pressed_part,
    ring_faces,
    whole_tube,
)
from acoustube.lumen.thinning import decimate_rings

__all__ = [
    "TRIANGLES_PER_EDGE",
    "Lumen",
    "Profile",
    "decimate_rings",
    "deformed_wall",
    "inner_wall",
    "lumen",
    "measure",
    "pressed_part",
    "profile",
    "ring_faces",
    "straighten",
    "whole_tube",
]
