"""Names used from other packages: the air, errors, and the class of scattering matrices."""

from acoustube.air import Air
from acoustube.base.errors import ConfigError
from acoustube.waves.scattering import ModalScattering

__all__ = ["Air", "ConfigError", "ModalScattering"]
