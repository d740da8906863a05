"""Indentation of the tube: finite elements pressed by rigid indenters until the lumen is closed.

Reading order: `reference_element` (shape functions and quadrature), `mesh` (the swept round tube),
`material` (strain energies), `element` (energy, force and stiffness of an element), `padding`
(blocks of elements, so that few sizes of arrays are compiled), `distances` (to the indenters and
the ground), `contact` (contact laws and energies), `indenters` (rods, punches, spheres and the
ground), `self_contact` (the lumen's barrier), `wrinkle_penalty` (penalty on sharp folds),
`dissection` (order of elimination), `multifrontal` and `linear_solver` (the sparse matrix and its
factorisation), `assembly` (energy, residual and tangent of the whole tube), `condensed_contact` and
`negative_curvature` (Newton steps), `newton` (equilibrium at one depth), `result` (displacements,
forces and energies over depth), `guide` (a path on a coarse mesh), `load_path` (increments of
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
