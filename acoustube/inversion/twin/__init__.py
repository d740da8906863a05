"""Parameters of a rangefinder from recordings of its tube, untouched and closed at known positions.

Reading order: `recorded` (cycles in the band of the carrier), `model` (echoes of closures, with
derivatives), `fit` (maximum of the posterior), `starts` (starting values of that fit), `noise`
(variances of the data), `posterior` (averaged over the unknown scatter of the closures), `estimate`
(all steps of the fit), `background` (ring-down, far end, clutter), and `material` (the wall's
modulus, from presses).
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
