"""The sleeve: from a distance along a wrapped tube to a place on the arm."""

from acoustube.sleeve.contacts import Contacts, ContactTracker, Following
from acoustube.sleeve.fit import Arm, Line, fit_arm
from acoustube.sleeve.helix import Frame, Helix, Nearest, nearest
from acoustube.sleeve.layouts import (
    Layout,
    check_reach,
    check_room,
    design,
    layout,
    spacing,
    wound,
)
from acoustube.sleeve.markers import Markers, read_markers
from acoustube.sleeve.ovalisation import ovality
from acoustube.sleeve.own_echoes import contacts_of_their_own
from acoustube.sleeve.wrapping import shortened, winding, windings, wrapped

__all__ = [
    "Arm",
    "ContactTracker",
    "Contacts",
    "Following",
    "Frame",
    "Helix",
    "Layout",
    "Line",
    "Markers",
    "Nearest",
    "check_reach",
    "check_room",
    "contacts_of_their_own",
    "design",
    "fit_arm",
    "layout",
    "nearest",
    "ovality",
    "read_markers",
    "shortened",
    "spacing",
    "winding",
    "windings",
    "wound",
    "wrapped",
]
