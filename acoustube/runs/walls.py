"""Deformed walls of a pressed tube, with fewer points, for files and pictures."""

from __future__ import annotations

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from acoustube.base.netcdf import variable
from acoustube.lumen import Lumen, profile, ring_faces
from acoustube.lumen.thinning import decimate_rings
from acoustube.runs.results import XYZ

MANTISSA = 12
"""Bits kept of a number's mantissa: a relative precision of 1e-4 at half the file size."""


def walls(part: Lumen) -> xr.Dataset:
    """Return the walls of a pressed part, and its lumen's area along the tube, as a dataset.

    Parameters
    ----------
    part : Lumen
        From :func:`acoustube.lumen.pressed_part`.

    Returns
    -------
    xarray.Dataset
        ``inner_wall`` and ``outer_wall`` in m (ring, around, xyz), thinned out by
        :func:`acoustube.lumen.thinning.decimate_rings`, and ``area_profile`` in m2 (z), in single
        precision; the press is at z = 0.
    """
    here = np.array([0.0, 0.0, part.position])
    inner, outer = decimate_rings(part.rings - here, part.outer_rings - here)
    surface = (part.rings - here).reshape(-1, 3), ring_faces(*part.rings.shape[:2])
    z = part.rings[1:-1, 0, 2] - part.position
    along = profile(*surface, z)
    table = {
        "inner_wall": variable("ring around xyz", _rounded(inner), "m", "rings of the inner wall"),
        "outer_wall": variable("ring around xyz", _rounded(outer), "m", "rings of the outer wall"),
        "area_profile": variable("z", _rounded(along.area), "m2", "cross-section of the lumen"),
        "z": variable("z", z, "m", "distance from the press"),
        "xyz": XYZ,
    }
    return xr.Dataset(table, attrs={"title": "Walls of a pressed tube, the press at z = 0"})


def _rounded(values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Round values to `MANTISSA` bits of the mantissa, so that they compress well."""
    last = 23 - MANTISSA
    bits = np.asarray(values, np.float32).view(np.uint32) + np.uint32(1 << (last - 1))
    return (bits & ~np.uint32((1 << last) - 1)).view(np.float32)
