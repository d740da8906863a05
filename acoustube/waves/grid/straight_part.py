"""The part of a lumen between its straight ends, and its symmetries."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from acoustube.base.errors import ConfigError
from acoustube.waves.grid.cells import CutCells
from acoustube.waves.grid.polyhedron import Array

STRAIGHT_TOLERANCE = 1e-4
"""Largest difference between the volume fractions of layers that count as straight."""
SYMMETRY_TOLERANCE = 0.02
"""Largest difference between volume fractions of cells that count as equal, or as mirror images.

The diagonals that divide the wall into triangles are not mirrored, which moves the wall by a
hundredth of a cell.
"""
SKEWED_TOLERANCE = 5e-3
"""Tolerance in place of `SYMMETRY_TOLERANCE` for the symmetry along z of a lumen that is not
symmetric about x = 0. It is stricter: a lumen under a slightly turned rod has to count as not
symmetric, and differs from its mirror image by little more than the triangulation does."""


def is_symmetric(cells: CutCells) -> bool:
    """Return True for a whole lumen, not a half, that is mirror symmetric about x = 0."""
    mirrored = np.abs(cells.volume_fraction - cells.volume_fraction[::-1])
    return bool(cells.origin[0] < 0 and mirrored.max() < SYMMETRY_TOLERANCE)


def is_reversible(cells: CutCells, tolerance: float = SYMMETRY_TOLERANCE) -> bool:
    """Return True for a lumen that is mirror symmetric about the middle of its grid along z."""
    mirrored = np.abs(cells.volume_fraction - cells.volume_fraction[..., ::-1])
    return bool(mirrored.max() < tolerance)


def straight_ends_cut(cells: CutCells) -> CutCells:
    """Return the part of a lumen between its straight ends, with one layer of each.

    Parameters
    ----------
    cells : CutCells
        The whole lumen.

    Raises
    ------
    ConfigError
        If an end is not straight over three layers, or the ends differ or are not symmetric about
        x = 0.
    """
    volume = cells.volume_fraction
    last = int(np.floor(cells.length / cells.spacing[2] - 0.5 + 1e-6))
    first, end = (_last_straight_layer(cells, last, inwards) for inwards in (1, -1))
    _check_sections(volume[..., first], volume[..., end])
    layers = slice(first, end + 1)
    dz = cells.spacing[2]
    return replace(
        cells,
        origin=(*cells.origin[:2], cells.origin[2] + first * dz),
        length=(end - first + 0.5) * dz,
        volume_fraction=volume[..., layers],
        open_x=cells.open_x[..., layers],
        open_y=cells.open_y[..., layers],
        open_z=cells.open_z[..., first : end + 2],
    )


def _last_straight_layer(cells: CutCells, last: int, inwards: int) -> int:
    """Return the innermost straight layer of the end at low z (`inwards` = 1) or high z (-1).

    `last` is the index of the last layer that lies wholly in the lumen.
    """
    volume, rim = cells.volume_fraction, 1 if inwards > 0 else last - 1
    off = np.abs(volume - volume[..., [rim]]).max(axis=(0, 1)) > STRAIGHT_TOLERANCE
    inside = np.arange(rim, last if inwards > 0 else 0, inwards)
    changed = inside[off[inside]]
    straight = abs(int(changed[0]) - rim) if len(changed) else len(inside) // 2
    if straight < 3:
        raise ConfigError(
            f"the lumen is not straight at its end of {'low' if inwards > 0 else 'high'} z; let it "
            f"end in at least {3e3 * cells.spacing[2]:.2g} mm of straight tube"
        )
    return rim + inwards * (straight - 1)


def is_mirrored(section: Array) -> bool:
    """Return whether the cells of a whole section, (n_x, n_y), are symmetric about x = 0."""
    return bool(np.abs(section - section[::-1]).max() <= SYMMETRY_TOLERANCE)


def _check_sections(first: Array, second: Array) -> None:
    """Validate that two sections are the same, and symmetric about x = 0."""
    if np.abs(first - second).max() > SYMMETRY_TOLERANCE:
        raise ConfigError(
            "the lumen's two ends differ in section, so that their modes have no common names; "
            "let both ends have the same section"
        )
    if not is_mirrored(first):
        raise ConfigError(
            "the lumen's ends are not symmetric about x = 0, which the names of their modes "
            "require; move or turn it so that they are"
        )
