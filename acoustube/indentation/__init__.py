"""Pressing the tube: finite elements against rigid tools, up to a closed lumen.

Reading order: ``reference`` (shape functions), ``mesh`` (the swept tube), ``material`` (the strain
energy), ``element`` (its integral), ``contact`` and ``tools`` (what presses and what supports),
``self_contact`` (the lumen's walls), ``linear`` (the stiffness matrix), ``folds`` (what keeps
them smooth), ``equilibrium`` (Newton),
``press`` (the increments).
"""

from acoustube.indentation.mesh import Mesh, MeshSize
from acoustube.indentation.press import Indentation, PressError, indent, restored
from acoustube.indentation.tools import Layer, Press, Support

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
