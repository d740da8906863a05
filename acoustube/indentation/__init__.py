"""Pressing the tube: Neo-Hookean finite elements against a rigid rod and a rigid floor.

Reading order: ``material`` (the strain energy), ``element`` (its integral over a hexahedron),
``contact`` (the rigid bodies), ``equilibrium`` (assembly and Newton), ``press`` (the increments).
"""

from acoustube.indentation.press import Indentation, Support, indent

__all__ = ["Indentation", "Support", "indent"]
