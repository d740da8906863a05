"""What this package takes from the others: the air, errors, and the form of a scattering matrix."""

from acoustube.air import Air
from acoustube.base.errors import ConfigError
from acoustube.waves.scattering import ModalScattering

__all__ = ["Air", "ConfigError", "ModalScattering"]
