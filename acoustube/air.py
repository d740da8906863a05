"""Air as an ideal gas at one standard atmosphere."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

HEAT_CAPACITY_RATIO = 1.4
SPECIFIC_GAS_CONSTANT = 287.05  # J/(kg K), dry air
STANDARD_PRESSURE = 101_325.0  # Pa
ABSOLUTE_ZERO = -273.15  # degC


@dataclass(frozen=True, kw_only=True)
class Air:
    """Acoustic properties of the gas in the lumen.

    Attributes
    ----------
    sound_speed : float
        Speed of sound in m/s.
    density : float
        Density at rest in kg/m3.
    """

    sound_speed: float
    density: float

    def __post_init__(self) -> None:
        """Refuse values that no gas has."""
        for name in ("sound_speed", "density"):
            if not getattr(self, name) > 0.0:
                raise ValueError(
                    f"{name} = {getattr(self, name)} must be positive; "
                    "take air_at(temperature) for ordinary air"
                )


def sound_speed(temperature: float) -> float:
    """Return the speed of sound in dry air.

    Parameters
    ----------
    temperature : float
        Temperature in degC.

    Returns
    -------
    float
        sqrt(gamma R T) in m/s; 343.2 at 20 degC.

    Raises
    ------
    ValueError
        If the temperature is not above absolute zero.
    """
    return sqrt(HEAT_CAPACITY_RATIO * SPECIFIC_GAS_CONSTANT * _absolute(temperature))


def air_at(temperature: float) -> Air:
    """Return dry air at a temperature and one standard atmosphere.

    Parameters
    ----------
    temperature : float
        Temperature in degC.

    Returns
    -------
    Air
        Speed of sound and density p / (R T); 343.2 m/s and 1.204 kg/m3 at 20 degC.
    """
    density = STANDARD_PRESSURE / (SPECIFIC_GAS_CONSTANT * _absolute(temperature))
    return Air(sound_speed=sound_speed(temperature), density=density)


def _absolute(temperature: float) -> float:
    """Convert degC to kelvin."""
    if not temperature > ABSOLUTE_ZERO:
        raise ValueError(
            f"temperature = {temperature} degC is not above absolute zero "
            f"({ABSOLUTE_ZERO} degC); give degC, not kelvin differences"
        )
    return temperature - ABSOLUTE_ZERO
