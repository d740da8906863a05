"""Parameters of a rangefinder from recordings of its tube, untouched and closed at known positions.

Reading order: `recorded` (cycles in the band of the carrier), `model` (echoes of closures, with
derivatives), `fit` (maximum of the posterior), `starts` (the starting values of the search for it),
`posterior` (with unknown scatter of the closures), `estimate` (the fit as a whole), `background`
(ring-down, far end, clutter), `noise`, and `material` (the wall's modulus, from presses).
"""

from acoustube.inversion.twin.background import Background, Measured, fit_background
from acoustube.inversion.twin.estimate import Twin, fit_twin
from acoustube.inversion.twin.material import Material, Press, fit_material
from acoustube.inversion.twin.recorded import Band, Group

__all__ = [
    "Background",
    "Band",
    "Group",
    "Material",
    "Measured",
    "Press",
    "Twin",
    "fit_background",
    "fit_material",
    "fit_twin",
]
