"""What presses the tube, and what it rests on: settings in SI units, and the bodies they make."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial
from scipy.optimize import brentq

from acoustube.base.errors import ConfigError
from acoustube.base.types import Array
from acoustube.indentation import contact
from acoustube.indentation.contact import Body
from acoustube.tube import Tube

Shape = Literal["rod", "punch", "sphere"]
Support = Literal["held", "free"]

SHAPES = ("rod", "punch", "sphere")
SUPPORTS = ("held", "free")

CONTACT_STIFFNESS = 300.0
"""Contact pressure per penetration, in shear moduli per wall thickness.

At the pressures of a 7 mm press (under 0.5 MPa) the wall penetrates the rod by under 6 um.
"""
CONTACT_SMOOTHING = 3e-4
"""Half width of the zone in which the contact sets in, in wall thicknesses (0.5 um).

The tube is 0.47 N/mm stiff at first: 4 um more on either side are 3 % of the force at 0.25 mm."""
TOUCH_STEPS = 65
"""Heights between top and bottom of the tube at which a tool is tried for its first touch."""
PUNCH_EDGE = 0.1
"""Radius of a punch's edge, as a share of its own, where none is given."""


@dataclass(frozen=True, kw_only=True)
class Press:
    """A rigid tool that comes down on the tube.

    Parameters
    ----------
    shape : {"rod", "punch", "sphere"}
        A cylinder lying across the tube, an upright one with a flat end, or a sphere.
    diameter : float
        In m.
    x, z : float
        Where it comes down, beside the tube's axis and along it from the middle of the modelled
        part, in m.
    yaw : float
        Angle in rad by which a rod is turned from across the tube (towards +z).
    edge_radius : float, optional
        Of a punch, in m; a tenth of its radius if not given.
    share : float
        How deep it goes, as a share of the depth that is asked for; for one of several presses.

    Raises
    ------
    ConfigError
        If a value is outside what it may be.
    """

    shape: Shape = "rod"
    diameter: float = 25e-3
    x: float = 0.0
    z: float = 0.0
    yaw: float = 0.0
    edge_radius: float | None = None
    share: float = 1.0

    def __post_init__(self) -> None:
        if self.shape not in SHAPES:
            raise ConfigError(f"shape = {self.shape!r} is unknown; use 'rod', 'punch' or 'sphere'.")
        if not (np.isfinite(self.diameter) and self.diameter > 0):
            raise ConfigError(f"diameter = {self.diameter} m is not a size; use a positive number.")
        for name in ("x", "z"):
            if not np.isfinite(getattr(self, name)):
                raise ConfigError(f"{name} = {getattr(self, name)} m is no place; use a number.")
        if not abs(self.yaw) <= np.pi / 3:
            raise ConfigError(
                f"yaw = {self.yaw} rad is outside -1.047 to 1.047; a rod must lie across the tube."
            )
        if not 0 < self.share <= 1:
            raise ConfigError(f"share = {self.share} of the depth must be above 0 and at most 1.")
        if not 0 < self.edge <= self.diameter / 2:
            raise ConfigError(
                f"edge_radius = {self.edge_radius} m must be positive and at most the punch's "
                f"radius, {self.diameter / 2} m."
            )

    @property
    def edge(self) -> float:
        """Radius of a punch's edge in m."""
        return PUNCH_EDGE * self.diameter / 2 if self.edge_radius is None else self.edge_radius

    @property
    def halves(self) -> tuple[bool, bool]:
        """Whether the press is symmetric about x = 0, and about z = 0."""
        if self.shape == "rod":
            return self.yaw == 0, self.yaw == 0 and self.z == 0
        return self.x == 0, self.z == 0

    def gap(self, diameter: Any = None) -> Partial:
        """Return its signed distance; see :class:`acoustube.indentation.contact.Body`.

        Parameters
        ----------
        diameter : float, optional
            In place of its own, in m; a JAX value where results are differentiated.
        """
        d = np.float64(self.diameter) if diameter is None else diameter
        x, z = np.float64(self.x), np.float64(self.z)
        if self.shape == "rod":
            return Partial(contact.rod_gap, d / 2, x, z, np.float64(self.yaw))
        if self.shape == "sphere":
            return Partial(contact.sphere_gap, d / 2, x, z)
        return Partial(contact.punch_gap, d / 2, d * (self.edge / self.diameter), x, z)


@dataclass(frozen=True, kw_only=True)
class Layer:
    """An elastic layer between the tube and the floor, standing for a soft arm.

    Parameters
    ----------
    thickness : float
        In m.
    modulus : float
        Young's modulus in Pa.

    Raises
    ------
    ConfigError
        If one of them is not positive.
    """

    thickness: float
    modulus: float

    def __post_init__(self) -> None:
        for name, unit in (("thickness", "m"), ("modulus", "Pa")):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ConfigError(f"{name} = {value} {unit} is not positive; use a larger number.")


def rigid_law(shear_modulus: Any, wall_thickness: Any) -> Partial:
    """Return the law of contact with a rigid body."""
    return Partial(
        contact.rigid,
        CONTACT_STIFFNESS * shear_modulus / wall_thickness,
        CONTACT_SMOOTHING * wall_thickness,
    )


def ground(shear_modulus: Any, wall_thickness: Any, height: Any, layer: Layer | None) -> Body:
    """Return what a tube of such a wall rests on, with its surface at a height y in m."""
    law = rigid_law(shear_modulus, wall_thickness)
    if layer is not None:
        numbers = np.float64(layer.modulus), np.float64(layer.thickness)
        law = Partial(contact.layer, *numbers, CONTACT_SMOOTHING * wall_thickness)
    return Body(Partial(contact.floor_gap), height, law)


def tools(tube: Tube, presses: Sequence[Press], heights: Sequence[float]) -> tuple[Body, ...]:
    """Return the presses as bodies, with their lowest points at heights y in m."""
    law = rigid_law(np.float64(tube.shear_modulus), np.float64(tube.wall_thickness))
    return tuple(
        Body(press.gap(), np.float64(height), law)
        for press, height in zip(presses, heights, strict=True)
    )


def touch_height(points: Array, gap: Partial) -> float:
    """Return the height y in m at which a tool on its way down first touches any of the points."""

    @jax.jit
    def nearest(height: Any) -> Any:
        return jnp.min(jax.vmap(gap)(points - height * jnp.array([[0.0, 1.0, 0.0]])))

    top, bottom = points[:, 1].max(), points[:, 1].min()
    ladder = np.linspace(top + 1e-3 * (top - bottom), bottom, TOUCH_STEPS)
    for above, below in itertools.pairwise(ladder):
        if float(nearest(below)) < 0:
            return float(brentq(lambda height: float(nearest(height)), below, above, xtol=1e-15))
    raise ConfigError(
        "The press misses the tube: its offset is too large for its size; move it nearer to the "
        "axis or use a larger one."
    )
