"""The air space inside a deformed tube: its surface, its sections, and its straightened form.

Read `surface`, then `profiles`, `straightening` and `thinning`.
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
