"""Scattering of tools (indenters) over depth, the part of the forward model computed beforehand."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from math import nan

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline, PchipInterpolator

from acoustube.base import checks
from acoustube.base.checks import (
    BORE,
    LENGTH,
    SPEED,
    Reals,
    Several,
    check_alike,
    check_fields,
    checked,
)
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Choice, Number
from acoustube.base.types import Array
from acoustube.base.units import MM
from acoustube.waves.scattering import Complex

FEWEST_DEPTHS = 4
"""Least number of depths of a tool between which its scattering can be interpolated."""
FEWEST_FREQUENCIES, UNEVEN = 4, 1e-2
"""Least number of frequencies of a tool, and largest difference of two of their spacings, relative
to the mean spacing."""
POSITIVE = Reals(0, 1e50, ndim=1)
FIELDS = {
    "shape": Choice(("rod", "punch", "sphere")), "diameter": LENGTH, "radius": BORE,
    "depth": Reals(0, 1.0, "m", ndim=1), "force": Reals(-1e50, 1e50, "N", ndim=1),
    "force_error": POSITIVE, "frequency": Reals(0, 1e12, "Hz", ndim=1), "modes": Several(str, 1),
    "s": checks.Complex(0, 1e6), "error": POSITIVE, "interpolation_error": POSITIVE,
    "sound_speed": SPEED, "young_modulus": Reals(1e-3, 1e15, "Pa", ndim=0, missing=True),
    "poisson_ratio": Number(-1, 0.5), "stiffness_error": Number(0, 1e50),
}  # fmt: skip
ARRAYS = "depth", "force", "force_error", "frequency", "error", "interpolation_error"
DEPTHS = Reals(-1.0, 1.0, "m", missing=True, empty=True)
ORDER = Number(0, 3, whole=True)


@dataclass(frozen=True, kw_only=True, eq=False)
class Tool:
    """Scattering and force of one tool (indenter) that presses one tube, over depth.

    Attributes
    ----------
    shape : str
        ``rod``, ``punch`` or ``sphere``.
    diameter : float
        Diameter of the tool in m.
    radius : float
        Radius of the undeformed bore in m.
    depth : ndarray
        Indentation depths from first contact, rising, in m, (n,).
    force : ndarray
        Force of the tool on the tube at each depth in N, (n,).
    force_error : ndarray
        Estimated errors of the forces in N, (n,).
    frequency : ndarray
        Frequencies in Hz, rising and evenly spaced, (n_f,).
    modes : tuple of str
        Names of the modes, as in :class:`acoustube.waves.ModalScattering`.
    s : ndarray
        Scattering matrices, (n, n_f, 2, m, 2, m), as in :class:`acoustube.waves.ModalScattering`.
    error : ndarray
        Estimated errors of the scattering coefficients at each depth, not exceeded at 75 % of the
        frequencies, (n,).
    interpolation_error : ndarray
        Estimated rms errors of interpolated coefficients between each depth and the next, (n - 1,):
        of the reflection of the plane wave relative to its rms, or of the transmission if that
        error is larger.
    sound_speed : float
        Speed of sound in m/s of the air in which the scattering was computed.
    young_modulus : float
        Young's modulus of the wall in Pa, to which the forces are proportional; nan where it is not
        known, or where the forces are not proportional to it because the ground yields.
    poisson_ratio : float
        Poisson's ratio of the wall.
    stiffness_error : float
        Relative standard deviation of Young's modulus; 0 for an exact one.

    Raises
    ------
    ConfigError
        If a value is outside its range, there are fewer than four depths or frequencies, these do
        not rise, the frequencies are not evenly spaced, or arrays do not belong together.
    """

    shape: str
    diameter: float
    radius: float
    depth: Array
    force: Array
    force_error: Array
    frequency: Array
    modes: tuple[str, ...]
    s: Complex
    error: Array
    interpolation_error: Array
    sound_speed: float
    young_modulus: float = nan
    poisson_ratio: float = 0.49
    stiffness_error: float = 0.0

    def __post_init__(self) -> None:
        """Check the values, and that the arrays belong together; lists become arrays."""
        check_fields(self, **FIELDS)
        for name in ARRAYS:
            object.__setattr__(self, name, np.asarray(getattr(self, name), float))
        object.__setattr__(self, "modes", tuple(self.modes))
        n, n_f, m = len(self.depth), len(self.frequency), len(self.modes)
        if n < FEWEST_DEPTHS or np.shape(self.s) != (n, n_f, 2, m, 2, m):
            raise ConfigError(
                f"a tool has {n} values of depth, {n_f} of frequency, {m} modes and s of shape "
                f"{np.shape(self.s)}; give {FEWEST_DEPTHS} or more depths and s of shape "
                f"{(n, n_f, 2, m, 2, m)}"
            )
        check_alike(
            depth=self.depth, force=self.force, force_error=self.force_error, error=self.error
        )
        check_alike(
            interpolation_error=self.interpolation_error, **{"steps of depth": self.depth[1:]}
        )
        if not (np.all(np.diff(self.depth) > 0) and np.all(np.diff(self.frequency) > 0)):
            raise ConfigError("depth and frequency of a tool must increase; sort them")
        step = np.diff(self.frequency)
        if n_f < FEWEST_FREQUENCIES or np.ptp(step) > UNEVEN * step.mean():
            raise ConfigError(
                f"the frequency of a tool has {n_f} values; give {FEWEST_FREQUENCIES} or more, "
                "evenly spaced"
            )

    @property
    def name(self) -> str:
        """Diameter and shape of the tool in words, such as ``25 mm rod``."""
        return f"{MM * self.diameter:g} mm {self.shape}"

    @checked(depth=DEPTHS, derivative=ORDER)
    def matrix(self, depth: ArrayLike, derivative: int = 0) -> Complex:
        """Return scattering matrices at depths between those computed, or derivatives by depth.

        They are interpolated by a cubic spline over depth.

        Parameters
        ----------
        depth : array_like
            Depths in m, of any shape, within the tool's depths.
        derivative : int
            Order of the derivative.

        Returns
        -------
        ndarray
            The shape of `depth`, followed by (n_f, 2, m, 2, m); in 1/m to the power of the order.
        """
        return np.asarray(self._spline(np.asarray(depth, float), derivative))

    @checked(depth=DEPTHS, derivative=ORDER)
    def force_at(self, depth: ArrayLike, derivative: int = 0) -> Array:
        """Return the force in N at depths in m, or a derivative of it by depth.

        `derivative` is the order. The force is interpolated by monotone cubics.
        """
        return np.asarray(self._force(np.asarray(depth, float), derivative))

    @checked(depth=DEPTHS)
    def force_deviation(self, depth: ArrayLike) -> Array:
        """Return the standard deviation in N of the force at depths in m."""
        own = float(self.force_error.max())
        return np.asarray(np.hypot(own, self.stiffness_error * self.force_at(depth)))

    @cached_property
    def _spline(self) -> CubicSpline:
        return CubicSpline(self.depth, self.s.astype(complex))

    @cached_property
    def _force(self) -> PchipInterpolator:
        return PchipInterpolator(self.depth, self.force)


@dataclass(frozen=True, eq=False)
class Library:
    """Tools (indenters) whose scattering was computed in one tube, over one frequency band.

    Parameters
    ----------
    tools : tuple of Tool
        One or more tools, of equal bore, frequencies, modes and air.

    Raises
    ------
    ConfigError
        If there is no tool, or tools differ in bore, frequencies, modes or speed of sound.
    """

    tools: tuple[Tool, ...]

    def __post_init__(self) -> None:
        """Check that the tools go together."""
        check_fields(self, tools=Several(Tool, 1))
        first = self.tools[0]
        for tool in self.tools[1:]:
            if abs(tool.radius - first.radius) > 1e-9:
                raise ConfigError(
                    f"the library holds tubes of {2e3 * first.radius:g} and "
                    f"{2e3 * tool.radius:g} mm bore; use one library for each"
                )
            same = len(tool.frequency) == len(first.frequency) and np.allclose(
                tool.frequency, first.frequency
            )
            if not same or tool.modes != first.modes or tool.sound_speed != first.sound_speed:
                raise ConfigError(
                    "the indenters of the library differ in frequencies, modes or speed of sound; "
                    "compute them with one command"
                )

    @checked(value=Number(1e-3, 1e15, "Pa"), deviation=Number(0, 1e15, "Pa"))
    def with_young_modulus(self, value: float, deviation: float = 0.0) -> Library:
        """Return the library for a wall with another Young's modulus.

        Parameters
        ----------
        value, deviation : float
            Young's modulus and its standard deviation in Pa.

        Raises
        ------
        ConfigError
            If the modulus of a tool's wall is not known, or its ground yields.

        Notes
        -----
        In a Neo-Hookean wall between rigid bodies the shape at a depth does not depend on the
        modulus, and the force is proportional to it.
        """
        tools = []
        for tool in self.tools:
            if not np.isfinite(tool.young_modulus):
                raise ConfigError(
                    f"forces of the {tool.name} of the library are not proportional to a known "
                    "modulus of the wall; make a library on rigid ground with acoustube library"
                )
            factor = value / tool.young_modulus
            tools.append(
                replace(
                    tool, force=factor * tool.force, force_error=factor * tool.force_error,
                    young_modulus=value, stiffness_error=deviation / value,
                )
            )  # fmt: skip
        return Library(tuple(tools))

    @property
    def radius(self) -> float:
        """Radius of the bore in m."""
        return self.tools[0].radius

    @property
    def band(self) -> tuple[float, float]:
        """Lowest and highest frequency in Hz."""
        low, high = self.tools[0].frequency[[0, -1]]
        return float(low), float(high)

    @property
    def modes(self) -> tuple[str, ...]:
        """Names of the modes of the matrices."""
        return self.tools[0].modes

    @property
    def sound_speed(self) -> float:
        """Speed of sound in m/s of the air in which the matrices were computed."""
        return self.tools[0].sound_speed
