"""Pressing the tube: finite elements against rigid tools, up to a closed lumen.

Reading order: ``reference`` (shape functions), ``mesh`` (the swept tube), ``material`` (the strain
energy), ``element`` (its integral), ``contact`` and ``tools`` (what presses and what supports),
``self_contact`` (the lumen's walls), ``folds`` (what keeps its folds smooth), ``linear`` (the
stiffness matrix), ``equilibrium`` (Newton's method), ``press`` (the increments), ``derivatives``
(by the design), ``tetrahedra`` (walls of any shape).
"""

from acoustube.indentation.indenters import Layer, Press, Support
from acoustube.indentation.mesh import Mesh, MeshSize
from acoustube.indentation.press import indent, restored
from acoustube.indentation.result import Indentation, PressError

__all__ = [
    "Indentation",
    "Layer",
    "Mesh",
    "MeshSize",
    "Press",
    "PressError",
    "Support",
    "indent",
    "restored",
]
