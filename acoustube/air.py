"""Air: sound speed, density, transport properties [2]_ and absorption [1]_.

References
----------
.. [1] ISO 9613-1:1993, Acoustics - Attenuation of sound during propagation outdoors - Part 1:
   Calculation of the absorption of sound by the atmosphere.
.. [2] U.S. Standard Atmosphere, 1976, NOAA-S/T 76-1562, equations 51 and 53.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, pi, sqrt
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from acoustube.base.checks import FREQUENCY, SPEED, TEMPERATURE, check_fields, checked
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

Frequency = TypeVar("Frequency", float, "NDArray[np.float64]")

HEAT_CAPACITY_RATIO = 1.4
SPECIFIC_GAS_CONSTANT = 287.05  # J/(kg K), dry air
STANDARD_PRESSURE = 101_325.0  # Pa
ABSOLUTE_ZERO = -273.15  # degC
REFERENCE_TEMPERATURE = 293.15  # K, of the absorption formulas
TRIPLE_POINT = 273.16  # K
HUMIDITY = 50.0  # per cent, relative
WATER_MASS = 18.0153 / 28.9647
"""Molar mass of water divided by that of dry air."""
WATER_HEAT = 4.04
"""Molar heat capacity of water vapour at constant pressure, divided by the gas constant."""
TEMPERATURES = (-20.0, 60.0)  # degC, range in which the formulas are stated or were checked
NARROW_GAP_LAYERS = 10
"""Opening of a lumen, in viscous boundary layer thicknesses, below which a warning is given."""


@dataclass(frozen=True, kw_only=True)
class Air:
    """Acoustic properties of the gas in the lumen.

    Attributes
    ----------
    sound_speed : float
        Speed of sound in m/s, without losses.
    density : float
        Density at rest in kg/m3.
    viscosity : float
        Dynamic viscosity in Pa s.
    prandtl : float
        Prandtl number, the ratio of viscous to thermal diffusivity.
    heat_capacity_ratio : float
        Ratio of the heat capacities at constant pressure and at constant volume.
    classical_absorption : float
        Attenuation in the bulk by viscosity, heat conduction and rotational relaxation, divided by
        the frequency squared, in Np s2/m.
    relaxations : tuple of Relaxation
        Vibrational relaxations of oxygen and of nitrogen; none by default.

    Raises
    ------
    ConfigError
        If a number is not finite or outside its range, such as a density that is not positive.
    """

    sound_speed: float
    density: float
    viscosity: float = 1.8134e-5
    prandtl: float = 0.7094
    heat_capacity_ratio: float = HEAT_CAPACITY_RATIO
    classical_absorption: float = 0.0
    relaxations: tuple[Relaxation, ...] = ()

    def __post_init__(self) -> None:
        """Validate all numbers."""
        positive = Number(1e-20, 1e12, "(air_at gives ordinary air)")
        check_fields(
            self, sound_speed=SPEED, density=positive, viscosity=positive, prandtl=positive,
            heat_capacity_ratio=Number(1, 100),
            classical_absorption=Number(0, 1e12),
        )  # fmt: skip

    @property
    def viscous_diffusivity(self) -> float:
        """Kinematic viscosity in m2/s."""
        return self.viscosity / self.density

    @property
    def thermal_diffusivity(self) -> float:
        """Thermal diffusivity in m2/s."""
        return self.viscous_diffusivity / self.prandtl

    def absorption(self, frequency: Frequency) -> Frequency:
        """Return the attenuation of a free plane wave in Np/m at frequencies in Hz."""
        if not isinstance(frequency, float):
            import numpy as np  # the command line imports this module before it needs arrays

            frequency = np.asarray(frequency, float)
        relaxing = sum(
            r.strength * frequency**2 / (r.frequency + frequency**2 / r.frequency)
            for r in self.relaxations
        )
        return self.classical_absorption * frequency**2 + relaxing


class Relaxation(NamedTuple):
    """A relaxation with the attenuation ``strength f^2 / (f_r + f^2 / f_r)`` in Np/m at f in Hz.

    Attributes
    ----------
    frequency : float
        Relaxation frequency f_r in Hz.
    strength : float
        Factor of the attenuation, in Np s/m.
    """

    frequency: float
    strength: float


@checked(temperature=TEMPERATURE)
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
        If the temperature is not above absolute zero, or is over 10 000 degC.
    """
    return sqrt(HEAT_CAPACITY_RATIO * SPECIFIC_GAS_CONSTANT * _absolute(temperature))


def air_of_speed(speed: float) -> Air:
    """Return ordinary air of the temperature at which dry air has a speed of sound in m/s.

    The temperature is limited to the range of :func:`air_at`. The result gives the losses of sound;
    where the temperature was limited, its own speed is another.
    """
    absolute = speed**2 / (HEAT_CAPACITY_RATIO * SPECIFIC_GAS_CONSTANT)
    low, high = TEMPERATURES
    return air_at(min(max(absolute + ABSOLUTE_ZERO, low), high))


def neighbouring_air(temperature: float) -> tuple[Air, Air, float]:
    """Return the air 0.5 K below and 0.5 K above a temperature in degC, and their difference in K.

    Both temperatures stay in the range of :func:`air_at`: the difference is 1 K, but down to 0.5 K
    near the ends of this range.
    """
    low, high = max(temperature - 0.5, TEMPERATURES[0]), min(temperature + 0.5, TEMPERATURES[1])
    return air_at(low), air_at(high), high - low


@checked(
    temperature=TEMPERATURE,
    humidity=Number(-1e6, 1e9, "%"),
    pressure=Number(-1e12, 1e12, "Pa"),
)
def air_at(
    temperature: float,
    *,
    humidity: float = HUMIDITY,
    pressure: float = STANDARD_PRESSURE,
    moist: bool = False,
) -> Air:
    """Return the acoustic properties of air at a temperature.

    Parameters
    ----------
    temperature : float
        Temperature in degC.
    humidity : float, optional
        Relative humidity in per cent; it affects the absorption, and with `moist` the speed.
    pressure : float, optional
        Atmospheric pressure in Pa.
    moist : bool, optional
        True for the speed of sound, density and ratio of heat capacities of moist air; by default
        they are those of dry air.

    Returns
    -------
    Air
        Speed of sound and density p / (R T) of dry air (343.2 m/s and 1.204 kg/m3 at 20 degC) or,
        with `moist`, of moist air; viscosity and Prandtl number of dry air; absorption of moist
        air.

    Raises
    ------
    ConfigError
        If the temperature is outside -20 to 60 degC, the humidity outside 0 to 100 %, the pressure
        outside 10 to 200 kPa, or the partial pressure of the water vapour not below the pressure.

    Notes
    -----
    At 20 degC the speed of sound is 0.36 % higher in saturated air than in dry air, at 50 %
    humidity 0.18 %. With `moist` it is that of a mixture of ideal gases. Its rise from dry to moist
    air agrees with Cramer's formula [1]_ at 0 to 30 degC to 0.01 % of the speed.

    References
    ----------
    .. [1] Cramer, O. (1993). The variation of the specific heat ratio and the speed of sound in air
       with temperature, pressure, humidity, and CO2 concentration. Journal of the Acoustical
       Society of America 93, 2510-2516. doi:10.1121/1.405827
    """
    low, high = TEMPERATURES
    if not low <= temperature <= high:
        raise ConfigError(
            f"is outside {low:g} to {high:g} degC, where the properties of air are known",
            setting="temperature", value=temperature, unit="degC", allowed=(low, high),
            advice=f"use {low:g} to {high:g}",
        )  # fmt: skip
    if not 0.0 <= humidity <= 100.0:
        raise ConfigError(
            "is outside 0 to 100 %", setting="humidity", value=humidity, unit="%",
            allowed=(0, 100), advice="give per cent",
        )  # fmt: skip
    if not 1e4 <= pressure <= 2e5:
        raise ConfigError(
            "is outside 10 to 200 kPa", setting="pressure", value=pressure, unit="Pa",
            allowed=(10e3, 200e3), advice="give Pa",
        )  # fmt: skip
    kelvin = _absolute(temperature)
    density = pressure / (SPECIFIC_GAS_CONSTANT * kelvin)
    viscosity = 1.458e-6 * kelvin**1.5 / (kelvin + 110.4)
    conductivity = 2.64638e-3 * kelvin**1.5 / (kelvin + 245.4 * 10 ** (-12 / kelvin))
    dry = HEAT_CAPACITY_RATIO
    heat_capacity = dry / (dry - 1) * SPECIFIC_GAS_CONSTANT
    if _water_fraction(kelvin, humidity, pressure) >= 1:
        raise ConfigError(
            f"at {temperature:g} degC gives a vapour pressure not below the air pressure, "
            f"{pressure:g} Pa",
            setting="humidity", value=humidity, unit="%", advice="use less, or a higher pressure",
        )  # fmt: skip
    water = _water_fraction(kelvin, humidity, pressure) if moist else 0.0
    mass = 1 - water * (1 - WATER_MASS)
    heat = (1 - water) * dry / (dry - 1) + water * WATER_HEAT
    ratio = heat / (heat - 1) if moist else dry
    # The first term of equation 5 of ISO 9613-1, over f^2.
    classical = 1.84e-11 * STANDARD_PRESSURE / pressure * sqrt(kelvin / REFERENCE_TEMPERATURE)
    return Air(
        sound_speed=sound_speed(temperature) * sqrt(ratio / dry / mass),
        density=density * mass,
        viscosity=viscosity,
        prandtl=viscosity * heat_capacity / conductivity,
        heat_capacity_ratio=ratio,
        classical_absorption=classical,
        relaxations=_relaxations(kelvin, humidity, pressure),
    )


def _water_fraction(kelvin: float, humidity: float, pressure: float) -> float:
    """Return the molar fraction of water vapour, from annex B of ISO 9613-1."""
    saturation = 10 ** (-6.8346 * (TRIPLE_POINT / kelvin) ** 1.261 + 4.6151)
    return humidity / 100 * saturation * STANDARD_PRESSURE / pressure


def _relaxations(kelvin: float, humidity: float, pressure: float) -> tuple[Relaxation, Relaxation]:
    """Return the relaxations of oxygen and nitrogen, equations 3 to 5 of ISO 9613-1."""
    p_ratio, t_ratio = pressure / STANDARD_PRESSURE, kelvin / REFERENCE_TEMPERATURE
    molar = 100 * _water_fraction(kelvin, humidity, pressure)
    oxygen = p_ratio * (24 + 4.04e4 * molar * (0.02 + molar) / (0.391 + molar))
    slowing = exp(-4.170 * (t_ratio ** (-1 / 3) - 1))
    nitrogen = p_ratio / sqrt(t_ratio) * (9 + 280 * molar * slowing)
    return (
        Relaxation(oxygen, t_ratio**-2.5 * 0.01275 * exp(-2239.1 / kelvin)),
        Relaxation(nitrogen, t_ratio**-2.5 * 0.1068 * exp(-3352.0 / kelvin)),
    )


@checked(air=Air, frequency=FREQUENCY)
def viscous_thickness(air: Air, frequency: float) -> float:
    """Return the viscous boundary layer's thickness sqrt(2 nu / omega) in m; frequency in Hz."""
    return sqrt(air.viscous_diffusivity / (pi * frequency))


def _absolute(temperature: float) -> float:
    """Convert degC to kelvin."""
    if not temperature > ABSOLUTE_ZERO:
        raise ValueError(
            f"temperature = {temperature} degC is not above absolute zero "
            f"({ABSOLUTE_ZERO} degC); give a temperature in degC"
        )
    return temperature - ABSOLUTE_ZERO
