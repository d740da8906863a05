"""The tube: a straight silicone cylinder, and its finite-element mesh."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acoustube.errors import ConfigError

Array = NDArray[np.float64]


def shear_modulus_from_shore(shore_a: float) -> float:
    """Return the shear modulus of a silicone from its Shore A hardness.

    Parameters
    ----------
    shore_a : float
        Hardness on the Shore A scale.

    Returns
    -------
    float
        Shear modulus in Pa.

    Notes
    -----
    ``mu = 10**(0.0235 S - 0.64) / 3`` in MPa, the relation that the paper uses for silicone
    rubber. It takes Young's modulus as three times the shear modulus (incompressible).
    """
    return 1e6 * 10 ** (0.0235 * shore_a - 0.64) / 3


@dataclass(frozen=True, kw_only=True)
class Tube:
    """A straight tube of circular cross-section. The defaults are the paper's.

    Parameters
    ----------
    inner_diameter, wall_thickness, length : float
        Sizes in m.
    shear_modulus : float
        Small-strain shear modulus in Pa; see :func:`shear_modulus_from_shore`.
    poisson_ratio : float
        Poisson's ratio, below 0.5.

    Raises
    ------
    ConfigError
        If a size or the modulus is not positive and finite, or the Poisson's ratio is not in
        [0, 0.4999].
    """

    inner_diameter: float = 7.9e-3
    wall_thickness: float = 1.6e-3
    length: float = 0.4
    shear_modulus: float = shear_modulus_from_shore(35.0)
    poisson_ratio: float = 0.49

    def __post_init__(self) -> None:
        for name in ("inner_diameter", "wall_thickness", "length", "shear_modulus"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value > 0):
                raise ConfigError(f"{name} = {value} is not a size; use a positive number (SI).")
        if not 0 <= self.poisson_ratio <= 0.4999:
            raise ConfigError(
                f"poisson_ratio = {self.poisson_ratio} is outside [0, 0.4999]; "
                "0.49 stands for silicone."
            )

    @property
    def outer_diameter(self) -> float:
        """Outer diameter in m."""
        return self.inner_diameter + 2 * self.wall_thickness

    @property
    def bulk_modulus(self) -> float:
        """Bulk modulus in Pa, ``2 mu (1 + nu) / (3 (1 - 2 nu))``."""
        nu = self.poisson_ratio
        return 2 * self.shear_modulus * (1 + nu) / (3 * (1 - 2 * nu))


@dataclass(frozen=True, kw_only=True)
class MeshSize:
    """Number of elements of a quarter of the tube, and how they are graded.

    Parameters
    ----------
    through_wall, around, along : int
        Elements through the wall, around the half circle and along the modelled half length.
    grading : float
        Strength of the refinement towards the press: the first element is
        ``grading / sinh(grading)`` times as long as an even division would make it.
    """

    through_wall: int = 2
    around: int = 12
    along: int = 14
    grading: float = 2.6


@dataclass(frozen=True, eq=False)
class HexMesh:
    """A structured mesh of 27-node hexahedra.

    Nodes are numbered with the axial station slowest, so that the stiffness matrix of a long
    tube is a narrow band.

    Parameters
    ----------
    nodes : array of shape (n_along, n_around, n_through, 3)
        Node coordinates (x, y, z) in m.
    elements : array of shape (n_elements, 27)
        Flat node numbers of each element; local order is that of
        :func:`acoustube.indentation.element.shape_functions`.
    outer_faces : array of shape (n_faces, 9)
        Flat node numbers of the element faces on the outer wall.
    """

    nodes: Array
    elements: NDArray[np.int64]
    outer_faces: NDArray[np.int64]

    @property
    def points(self) -> Array:
        """Node coordinates as a list, shape (n_nodes, 3), in m."""
        return self.nodes.reshape(-1, 3)


def quarter_mesh(tube: Tube, half_length: float, size: MeshSize | None = None) -> HexMesh:
    """Mesh the quarter x >= 0, z >= 0 of a tube pressed at z = 0.

    Parameters
    ----------
    tube : Tube
        The tube; its axis is the z axis.
    half_length : float
        Length of the modelled part beside the press, in m.
    size : MeshSize, optional
        Number of elements.

    Returns
    -------
    HexMesh
        The mesh: through the wall from the bore outwards, around from the bottom line (-y) to
        the top line (+y), along from the press to the far end.
    """
    size = size or MeshSize()
    r = np.linspace(tube.inner_diameter / 2, tube.outer_diameter / 2, 2 * size.through_wall + 1)
    theta = np.linspace(0, np.pi, 2 * size.around + 1)
    edges = np.sinh(size.grading * np.linspace(0, 1, size.along + 1)) / np.sinh(size.grading)
    # A mid-station halfway between its neighbours keeps the axial map of each element affine.
    stations = np.interp(np.arange(2 * size.along + 1) / 2, np.arange(size.along + 1), edges)
    z, t, rr = np.meshgrid(half_length * stations, theta, r, indexing="ij")
    # Exact zeros on the symmetry plane, where sin(pi) is not.
    sine = np.where(np.isclose(np.sin(t), 0, atol=1e-12), 0.0, np.sin(t))
    nodes = np.stack([rr * sine, -rr * np.cos(t), z], axis=-1)
    number = np.arange(z.size).reshape(z.shape)
    elements = _windows(number, (3, 3, 3)).reshape(-1, 27)
    outer = _windows(number[:, :, -1], (3, 3)).reshape(-1, 9)
    return HexMesh(nodes, elements, outer)


def _windows(number: NDArray[np.int64], window: tuple[int, ...]) -> NDArray[np.int64]:
    """Return the node numbers of all elements, which share one plane of nodes with the next."""
    views = np.lib.stride_tricks.sliding_window_view(number, window)
    return views[tuple(slice(None, None, 2) for _ in window)]
