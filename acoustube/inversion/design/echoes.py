"""Reflection of the plane mode by presses as a function of depth; the contacts to be estimated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline, PchipInterpolator

from acoustube.base import checks
from acoustube.base.checks import BORE, LENGTH, SPEED, Reals, check_alike, check_fields
from acoustube.base.errors import ConfigError
from acoustube.base.rules import Number
from acoustube.base.types import Array
from acoustube.waves.scattering import Complex

FEWEST = 4
"""Least number of depths between which a reflection is interpolated."""


@dataclass(frozen=True, kw_only=True, eq=False)
class PressedTube:
    """Reflection and force of one tool on one tube, as functions of depth.

    Attributes
    ----------
    radius : float
        Of the undeformed bore in m.
    diameter : float
        Of the tool in m.
    depth : ndarray
        Indentation depths in m, above 0 and increasing, (n,).
    force : ndarray
        In N at the shear modulus with which the presses were computed, (n,).
    frequency : ndarray
        In Hz, evenly spaced, (n_f,).
    reflection : ndarray
        Reflection coefficient of the plane mode, (n, n_f).
    sound_speed : float
        In m/s.
    transmission : ndarray, optional
        Transmission coefficient of the plane mode, (n, n_f), for a press behind this one.

    Raises
    ------
    ConfigError
        If a value is out of range, there are fewer than four depths, depths or forces are not
        positive and increasing, or arrays differ in shape.
    """

    radius: float
    diameter: float
    depth: Array
    force: Array
    frequency: Array
    reflection: Complex
    sound_speed: float
    transmission: Complex | None = None

    def __post_init__(self) -> None:
        """Check that the arrays belong together."""
        check_fields(
            self, radius=BORE, diameter=LENGTH, depth=Reals(0, 1.0, "m", ndim=1),
            force=Reals(0, 1e9, "N", ndim=1), frequency=Reals(0, 1e12, "Hz", ndim=1),
            reflection=checks.Complex(0, 1e6), sound_speed=SPEED,
            transmission=checks.Optional(checks.Complex(0, 1e6)),
        )  # fmt: skip
        for name in ("depth", "force", "frequency"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), float))
        check_alike(depth=self.depth, force=self.force)
        n = len(self.depth)
        if n < FEWEST or self.reflection.shape != (n, len(self.frequency)):
            raise ConfigError(
                f"a tube has {n} depths and reflections of shape {self.reflection.shape}; give "
                f"{FEWEST} or more depths n and reflections (n, {len(self.frequency)})"
            )
        if self.transmission is not None and self.transmission.shape != self.reflection.shape:
            raise ConfigError(
                f"transmission has shape {self.transmission.shape} and reflection "
                f"{self.reflection.shape}; give both at each depth and frequency"
            )
        if not (np.all(np.diff(self.depth) > 0) and np.all(np.diff(self.force) > 0)):
            raise ConfigError("depths and forces of a tube must increase; sort them")
        if not (self.depth[0] > 0 and self.force[0] > 0):
            raise ConfigError(
                f"the first press of a tube has a depth of {self.depth[0]:g} m and a force of "
                f"{self.force[0]:g} N; leave out depth 0, the untouched tube"
            )

    @cached_property
    def _spline(self) -> CubicSpline:
        """Cubic spline of the reflection as a function of depth in m, 0 at depth 0."""
        return self._over_depth(0.0, self.reflection)

    @cached_property
    def _transmission_spline(self) -> CubicSpline:
        """Cubic spline of the transmission as a function of depth in m, 1 at depth 0."""
        assert self.transmission is not None
        return self._over_depth(1.0, self.transmission)

    def _over_depth(self, untouched: float, values: Complex) -> CubicSpline:
        first = np.full((1, len(self.frequency)), untouched, complex)
        return CubicSpline([0.0, *self.depth], np.concatenate([first, values]))

    @cached_property
    def _depth_of(self) -> PchipInterpolator:
        """Monotone cubic interpolant of the depth in m as a function of the force in N."""
        return PchipInterpolator(
            np.concatenate([[0.0], self.force]), np.concatenate([[0.0], self.depth])
        )

    def depth_at(self, force: Array) -> Array:
        """Return the depths in m at forces in N; at forces beyond the last press's, its depth."""
        return np.asarray(self._depth_of(np.clip(force, 0.0, self.force[-1])))

    def compliance_at(self, force: Array) -> Array:
        """Return the derivatives in m/N of depth by force, at forces in N."""
        inside = np.clip(force, 1e-3 * self.force[0], self.force[-1] * (1 - 1e-9))
        return np.asarray(self._depth_of(inside, 1))

    def reflection_at(self, depth: Array, derivative: int = 0) -> Complex:
        """Return reflection coefficients at depths in m, (n, n_f), or their derivatives in 1/m."""
        return np.asarray(self._spline(depth, derivative))

    def transmission_at(self, depth: Array, derivative: int = 0) -> Complex:
        """Return transmission coefficients at depths in m, (n, n_f), or the derivatives in 1/m."""
        return np.asarray(self._transmission_spline(depth, derivative))


@dataclass(frozen=True, kw_only=True, eq=False)
class Contacts:
    """Contacts for which the errors of a sensor are predicted.

    Attributes
    ----------
    place : ndarray
        Distances from the face in m, (n,).
    force : ndarray
        In N, (n,).
    tool : ndarray
        Number of the tool, from 0, (n,).
    lightest, strongest : float
        Range of the forces in N.
    length : float
        Of the tube in m.

    Raises
    ------
    ConfigError
        If a value is out of range, or the arrays differ in length.
    """

    place: Array
    force: Array
    tool: Array
    lightest: float
    strongest: float
    length: float

    def __post_init__(self) -> None:
        """Check the values; lists become arrays."""
        force = Number(1e-9, 1e9, "N")
        check_fields(
            self, place=Reals(0, 1e6, "m", ndim=1), force=Reals(1e-9, 1e9, "N", ndim=1),
            tool=Reals(0, 1e6, ndim=1, kinds="iu"), lightest=force, strongest=force, length=LENGTH,
        )  # fmt: skip
        check_alike(place=self.place, force=self.force, tool=self.tool)

    def at(self, chosen: NDArray[np.bool_]) -> Contacts:
        """Return some of the contacts.

        Parameters
        ----------
        chosen : ndarray of bool
            Whether each contact is returned, (n,).
        """
        return replace(
            self, place=self.place[chosen], force=self.force[chosen], tool=self.tool[chosen]
        )

    @property
    def force_prior(self) -> float:
        """Standard deviation of the logarithm of the force where no echo is received."""
        return float(np.log(self.strongest / self.lightest) / np.sqrt(12))


def check_tools(tubes: Sequence[PressedTube], contacts: Contacts) -> None:
    """Raise :class:`ConfigError` unless there is a pressed tube for the tool of each contact."""
    if (last := int(contacts.tool.max())) >= len(tubes):
        raise ConfigError(
            f"a contact is of tool {last}, and the last tube is that of tool {len(tubes) - 1}; "
            "give a tube for each tool, from 0 on"
        )
