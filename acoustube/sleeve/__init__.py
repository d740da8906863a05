"""The sleeve: from a distance along a wrapped tube to a place on the arm."""

from acoustube.recordings.markers import Markers, read_markers
from acoustube.sleeve.arm_fit import Arm, Line, fit_arm
from acoustube.sleeve.bent_tube import shortened, winding, windings, wrapped
from acoustube.sleeve.echo_association import contacts_of_their_own
from acoustube.sleeve.helix import Frame, Helix, Nearest, nearest
from acoustube.sleeve.layouts import Layout, check_reach, check_room, design, layout, spacing, wound
from acoustube.sleeve.ovalisation import ovality
from acoustube.sleeve.tracking import Contacts, ContactTracker, Following

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
