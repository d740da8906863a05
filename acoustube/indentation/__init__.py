"""Indentation of the tube by rigid indenters, up to a closed lumen, by finite elements.

Reading order: `reference_element` (shape functions and quadrature), `mesh` (the swept round tube),
`material` (strain energies), `element` (energy, force and stiffness of an element), `padding`
(of arrays to a few sizes, so that less is compiled), `distances` (to the indenters and
the ground), `contact` (contact laws and energies), `indenters` (rods, punches, spheres and the
ground), `self_contact` (barrier of the inner wall), `wrinkle_penalty` (against wrinkles),
`dissection` (order of elimination), `multifrontal` and `linear_solver` (the sparse matrix and its
factorisation), `assembly` (energy, residual and tangent of the whole tube), `condensed_contact` and
`negative_curvature` (Newton steps), `newton` (equilibrium at one depth), `result` (displacements,
forces and energies over depth), `guide` (the press of a coarse mesh), `load_path` (increments of
depth), `press` (the public function), `depth_path` (interpolation between depths), `derivatives`
(sensitivities), and for imported walls `wall_surface`, `boundary_nodes` and `tetrahedra`.
"""

from acoustube.indentation.depth_path import DepthPath, InterpolationError
from acoustube.indentation.indenters import Indenter, Layer, Press, Support
from acoustube.indentation.mesh import USUAL_MESH, Mesh, MeshSize
from acoustube.indentation.press import indent, restored
from acoustube.indentation.result import Indentation, PressError

__all__ = [
    "USUAL_MESH",
    "DepthPath",
    "Indentation",
    "Indenter",
    "InterpolationError",
    "Layer",
    "Mesh",
    "MeshSize",
    "Press",
    "PressError",
    "Support",
    "indent",
    "restored",
]
