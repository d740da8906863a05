"""Rigid indenters and the ground: their settings in SI units, and their contact bodies."""

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

from acoustube.base.checks import LENGTH, PLACE, Optional, check_fields
from acoustube.base.errors import ConfigError
from acoustube.base.limits import PUNCH_EDGE
from acoustube.base.rules import Choice, Number
from acoustube.base.types import Array
from acoustube.indentation import contact, distances
from acoustube.indentation.contact import Body
from acoustube.indentation.padding import padded
from acoustube.tube import Tube

Shape = Literal["rod", "punch", "sphere"]
Support = Literal["held", "free"]

SHAPES = ("rod", "punch", "sphere")
SUPPORTS = ("held", "free")

TOUCH_STEPS = 65
"""Number of heights, from the tube's top to its bottom, at which first contact is searched for."""
LARGEST_YAW = 1.0472
"""Largest yaw of a rod in rad: pi/3, rounded up to the digits that messages show."""


@dataclass(frozen=True, kw_only=True)
class Indenter:
    """A rigid indenter that moves down onto the tube.

    Parameters
    ----------
    shape : {"rod", "punch", "sphere"}
        A cylinder lying across the tube, an upright cylinder with a flat end, or a sphere.
    diameter : float
        In m.
    x, z : float
        Position: offset from the tube's axis, and distance along it from the middle of the modelled
        part, in m.
    yaw : float
        Angle in rad of a rod's axis from the x axis, positive towards +z; -pi/3 to pi/3.
    edge_radius : float, optional
        Radius of a punch's rounded edge in m; a tenth of its radius by default.
    depth_fraction : float
        Indentation depth of this indenter as a fraction of the requested depth, above 0 and at most
        1. Of several indenters, some may have less than 1.

    Raises
    ------
    ConfigError
        If a value is outside its range, or the edge radius is above the radius.
    """

    shape: Shape = "rod"
    diameter: float = 25e-3
    x: float = 0.0
    z: float = 0.0
    yaw: float = 0.0
    edge_radius: float | None = None
    depth_fraction: float = 1.0

    def __post_init__(self) -> None:
        check_fields(
            self, shape=Choice(SHAPES), diameter=LENGTH, x=PLACE, z=PLACE,
            yaw=Number(-LARGEST_YAW, LARGEST_YAW, "rad", "a rod must lie across the tube"),
            edge_radius=Optional(LENGTH), depth_fraction=Number(1e-6, 1),
        )  # fmt: skip
        if self.edge > self.diameter / 2:
            raise ConfigError(
                "is larger than the punch's radius", setting="edge_radius", value=self.edge_radius,
                unit="m", advice=f"use at most {self.diameter / 2:g} m",
            )  # fmt: skip

    @property
    def edge(self) -> float:
        """Radius of a punch's rounded edge in m."""
        return PUNCH_EDGE * self.diameter / 2 if self.edge_radius is None else self.edge_radius

    @property
    def halves(self) -> tuple[bool, bool]:
        """Mirror symmetry of the indenter: about x = 0, and about z = 0."""
        if self.shape == "rod":
            return self.yaw == 0, self.yaw == 0 and self.z == 0
        return self.x == 0, self.z == 0

    def gap(self, diameter: Any = None) -> Partial:
        """Return the signed distance in m to the indenter, as a function of a point (3,) in m.

        Its y is measured from the lowest point of the indenter.

        Parameters
        ----------
        diameter : float, optional
            Another diameter in m; a JAX value where results are differentiated. The default edge
            radius of a punch is proportional to it; a given one stays the same.
        """
        d = np.float64(self.diameter) if diameter is None else diameter
        x, z = np.float64(self.x), np.float64(self.z)
        if self.shape == "rod":
            return Partial(distances.rod_gap, d / 2, x, z, np.float64(self.yaw))
        if self.shape == "sphere":
            return Partial(distances.sphere_gap, d / 2, x, z)
        edge = PUNCH_EDGE * d / 2 if self.edge_radius is None else np.float64(self.edge_radius)
        return Partial(distances.punch_gap, d / 2, edge, x, z)


Press = Indenter
"""Former name of :class:`Indenter`."""


@dataclass(frozen=True, kw_only=True)
class Layer:
    """An elastic layer between the tube and the floor: a model of soft tissue.

    Parameters
    ----------
    thickness : float
        In m.
    modulus : float
        Young's modulus in Pa.

    Raises
    ------
    ConfigError
        If the thickness or the modulus is not positive.

    See Also
    --------
    acoustube.indentation.contact.foundation_energy : Its contact law.
    """

    thickness: float
    modulus: float

    def __post_init__(self) -> None:
        check_fields(self, thickness=LENGTH, modulus=Number(1e-3, 1e15, "Pa"))


def ground_body(shear_modulus: Any, wall_thickness: Any, height: Any, layer: Layer | None) -> Body:
    """Return the ground as a contact body: a rigid floor, or an elastic layer.

    Parameters
    ----------
    shear_modulus, wall_thickness : float
        Of the tube, in Pa and m; they scale the contact law.
    height : float
        Height y of the surface in m.
    layer : Layer or None
        None for the rigid floor.
    """
    gap = Partial(distances.floor_gap)
    if layer is None:
        return Body(gap, height, contact.rigid_law(shear_modulus, wall_thickness))
    constants = np.float64(layer.modulus), np.float64(layer.thickness)
    smoothing = contact.CONTACT_SMOOTHING * wall_thickness
    law = Partial(contact.foundation_energy, *constants, smoothing)
    return Body(gap, height, law, Partial(contact.covered_area))


def indenter_bodies(
    tube: Tube, indenters: Sequence[Indenter], heights: Sequence[float]
) -> tuple[Body, ...]:
    """Return indenters as contact bodies.

    Parameters
    ----------
    tube : Tube
    indenters : sequence of Indenter
    heights : sequence of float
        Height y of each indenter's lowest point, in m.
    """
    law = contact.rigid_law(np.float64(tube.shear_modulus), np.float64(tube.wall_thickness))
    return tuple(
        Body(indenter.gap(), np.float64(height), law)
        for indenter, height in zip(indenters, heights, strict=True)
    )


@jax.jit
def _smallest_gap(points: Array, gap: Partial, height: Any) -> Any:
    """Return the smallest distance in m of points (n, 3) to an indenter at a height."""
    return jnp.min(jax.vmap(gap)(points - height * jnp.array([[0.0, 1.0, 0.0]])))


def touch_height(points: Array, gap: Partial) -> float:
    """Return the height y in m of an indenter at first contact.

    Parameters
    ----------
    points : array of shape (n, 3)
        Points on the outer wall, in m.
    gap : jax.tree_util.Partial
        Signed distance to the indenter, from :meth:`Indenter.gap`.

    Raises
    ------
    ConfigError
        If the indenter misses the tube on its path down.
    """
    repeated = padded(points)

    def nearest(height: Any) -> float:
        return float(_smallest_gap(repeated, gap, height))

    top, bottom = points[:, 1].max(), points[:, 1].min()
    heights = np.linspace(top + 1e-3 * (top - bottom), bottom, TOUCH_STEPS)
    for above, below in itertools.pairwise(heights):
        if nearest(below) < 0:
            return float(brentq(nearest, below, above, xtol=1e-15))
    raise ConfigError(
        "the indenter misses the tube: its offset is too large for its size; reduce the offset or "
        "use a larger indenter"
    )
