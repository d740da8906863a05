"""Range of the model: limits that the settings and the solvers share."""

CLEARANCE = 0.5
"""Smallest distance, in outer diameters, between a press's deformed part and a probe or tube end.

A press moves the ends of the modelled part outwards by up to 0.1 mm, and leaves them oval.
"""
JOINED_CLEARANCE = 1.25
"""As `CLEARANCE`, in outer diameters, for a press whose scattering is computed alone and joined to
straight tube.

The computed part blends into the undeformed tube over one outer diameter, and its straight ends
begin up to a quarter of the bore farther on.
"""

LARGEST_CLOSING = 0.9
"""Reduction of the lumen's height, as a fraction of the bore, above which results of FDTD carry a
warning: the walls meet or nearly, and sound in gaps narrower than a grid cell is approximate."""

SHALLOWEST_MM = 0.05
"""Smallest depth of a press, in mm."""

PUNCH_EDGE = 0.1
"""Default edge radius of a punch, as a fraction of its radius."""


def pressed_reach(outer_diameter: float, indenter_diameter: float) -> float:
    """Return the length of tube that a press deforms on each side of its middle.

    The length extends four outer diameters beyond the indenter's edge. There the default tube, held
    and pressed 4 mm deep by a 25 mm rod, is oval by 0.1 mm, but its area is unchanged to 0.1 %.
    Modelling 1.5 times this length changes the force by 0.2 %.

    Parameters
    ----------
    outer_diameter, indenter_diameter : float
        Diameters of the tube and of the indenter, in one unit.

    Returns
    -------
    float
        Distance from the middle of the press, in the unit of the diameters.
    """
    return 4 * outer_diameter + indenter_diameter / 2
