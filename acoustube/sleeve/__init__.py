"""Wrapped tubes: geometry, layout, bends and contact tracking.

Read :mod:`helix` (distance to position), :mod:`arm_fit` (the arm from markers), :mod:`layouts`
(coverage), then :mod:`bent_tube` and :mod:`ovalisation` (acoustics of the wrapped tube),
:mod:`echo_association` and :mod:`tracking`.
"""

from acoustube.base.moved import renamed
from acoustube.recordings.markers import Markers, read_markers
from acoustube.sleeve.arm_fit import Arm, Line, fit_arm
from acoustube.sleeve.bent_tube import between_bends, winding, windings, with_antisymmetric, wrapped
from acoustube.sleeve.echo_association import remove_ghost_echoes
from acoustube.sleeve.helix import Frame, Helix, Nearest, nearest
from acoustube.sleeve.layouts import Layout, check_reach, check_room, design, layout, spacing, wound
from acoustube.sleeve.ovalisation import ovality
from acoustube.sleeve.tracking import Contacts, ContactTracker, TrackingSettings

__all__ = [
    "Arm",
    "ContactTracker",
    "Contacts",
    "Frame",
    "Helix",
    "Layout",
    "Line",
    "Markers",
    "Nearest",
    "TrackingSettings",
    "between_bends",
    "check_reach",
    "check_room",
    "design",
    "fit_arm",
    "layout",
    "nearest",
    "ovality",
    "read_markers",
    "remove_ghost_echoes",
    "spacing",
    "winding",
    "windings",
    "with_antisymmetric",
    "wound",
    "wrapped",
]

__getattr__ = renamed(
    __name__,
    {
        "contacts_of_their_own": "remove_ghost_echoes",
        "Following": "TrackingSettings",
        "shortened": "between_bends",
    },
)
