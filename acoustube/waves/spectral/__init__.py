"""Scattering of a lumen in the frequency domain: polynomials in space, rational in frequency.

Reading order: `polynomials`, `walls`, `lumens` and `sections` (functions, and the walls of lumens),
`quadrature` and `assembly` (stiffness and mass), `ports` and `ends` (modes of the ends),
`elimination` (direct solution along the tube), `discretisation` (a basis and an enriched one),
`reduction` (many frequencies at once), `boundary`, `layers` and `lossy` (losses), `motion`,
`derivatives` and `lossy_derivatives`, and `partition`, `first_basis`, `adaptation`, `truncation`,
`band` and `solver` (choice of the basis, and error estimate of its `result`).
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
