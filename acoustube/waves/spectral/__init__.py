"""Scattering of a lumen in the frequency domain, by spectral elements and a rational Krylov space.

Reading order: `polynomials` (basis across the tube), `walls`, `lumens` and `sections` (walls from
formulas, rings and surfaces), `quadrature` and `assembly` (stiffness and mass), `ports` and `ends`
(modes of the ends), `elimination` (direct solution along the tube), `discretisation` (matrices in a
basis and in an enriched one), `reduction` (Galerkin projection, for many frequencies), `boundary`,
`layers`, `end_layers` and `lossy` (losses), `motion`, `derivatives` and `lossy_derivatives`
(derivatives by motions of the wall), `partition`, `first_basis`, `adaptation`, `truncation` and
`band` (choice of the basis, and its error), `solver` and `result` (scattering matrix with its error
estimate).
"""

from acoustube.waves.spectral.lumens import wall_of
from acoustube.waves.spectral.motion import wall_motion
from acoustube.waves.spectral.result import SpectralScattering
from acoustube.waves.spectral.sections import SurfaceRings, rings_of_surface
from acoustube.waves.spectral.solver import scatter_spectral
from acoustube.waves.spectral.walls import Wall, analytic_wall

__all__ = [
    "SpectralScattering", "SurfaceRings", "Wall", "analytic_wall", "rings_of_surface",
    "scatter_spectral", "wall_motion", "wall_of",
]  # fmt: skip
