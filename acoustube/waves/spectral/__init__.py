"""Scattering of a lumen in the frequency domain: polynomials in space, rational in frequency.

Reading order: `polynomials` (basis functions), `walls` and `lumens` (domain of integration),
`assembly` (stiffness and mass), `ports` (modes of the ends), `elimination` (direct solution along
the tube), `discretisation` (a basis and an enriched one), `reduction` (reduced-order model),
`partition` (elements) and `solver` (adaptivity and error estimate).
"""

from acoustube.waves.spectral.lumens import wall_of
from acoustube.waves.spectral.result import SpectralScattering
from acoustube.waves.spectral.solver import scatter_spectral
from acoustube.waves.spectral.walls import Wall, analytic_wall

__all__ = ["SpectralScattering", "Wall", "analytic_wall", "scatter_spectral", "wall_of"]
