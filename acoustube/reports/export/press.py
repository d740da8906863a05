"""Press read back from ``run.nc``."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from acoustube.base.errors import ConfigError
from acoustube.base.limits import pressed_reach
from acoustube.indentation import Indentation, Mesh
from acoustube.indentation.mesh import sweep
from acoustube.indentation.press import BARRIER_DISTANCE, neo_hookean_wall
from acoustube.indentation.reference_element import HEX20, TET10
from acoustube.runs.config import Mechanics, configured
from acoustube.runs.config.si import press_in_si

COINCIDENT_DISTANCE = 1e-9
"""Largest distance in m between coincident nodes."""


def settings_of(run: xr.Dataset) -> Mechanics:
    """Return the settings of the tube and the press."""
    return configured(json.loads(run.attrs["configuration"]), Mechanics)


def reached(run: xr.Dataset) -> NDArray[np.int64]:
    """Return the indices of the depths that were reached."""
    if "converged" not in run:
        return np.arange(run.sizes["depth"])
    return np.flatnonzero(run["converged"].values)


def mesh_of(run: xr.Dataset) -> Mesh:
    """Return the finite-element mesh, without the data specific to a swept one.

    Parameters
    ----------
    run : xarray.Dataset
        Of ``simulate`` or ``indent``.
    """
    points, none = run["node_position"].values, np.zeros((0, 8), int)
    faces: dict[str, Any] = {
        f"{wall}_faces": run[f"{wall}_face_node"].values if f"{wall}_face_node" in run else none
        for wall in ("inner", "outer")
    }
    low = points.min(axis=0)
    return Mesh(
        points=points,
        elements=run["element_node"].values,
        reference=HEX20 if run.sizes["corner"] == len(HEX20.nodes) else TET10,
        halved=(bool(low[0] > -COINCIDENT_DISTANCE), bool(low[2] > -COINCIDENT_DISTANCE)),
        **faces,
    )


def indentation_of(run: xr.Dataset) -> Indentation:
    """Return the press of a round tube, with a row for each depth that was reached.

    Parameters
    ----------
    run : xarray.Dataset
        Of ``simulate`` or ``indent``.

    Raises
    ------
    ConfigError
        If the mesh differs from that of this version for these settings.
    """
    settings, rows = press_in_si(settings_of(run)), reached(run)
    tube, indenter = settings.tube, settings.indenter
    mesh = sweep(
        tube,
        pressed_reach(tube.outer_diameter, indenter.diameter),
        settings.mesh,
        halved=indenter.halves,
    )
    stored = run["node_position"].values
    if (
        stored.shape != mesh.points.shape
        or np.abs(stored - mesh.points).max() > COINCIDENT_DISTANCE
    ):
        raise ConfigError(
            "the run was written by a version of acoustube that made another mesh; repeat the run"
        )

    def taken(name: str) -> Any:
        return run[name].values[rows]

    return Indentation(
        tube=tube, indenters=(indenter,), support=settings.support,
        layer=settings.layer, material=neo_hookean_wall(tube), mesh=mesh,
        depth=taken("indentation_depth"), displacement=taken("node_displacement"),
        iterations=taken("newton_iterations"), residual=taken("newton_residual"),
        press_force=taken("contact_force")[:, None], contact_area=taken("contact_area")[:, None],
        energy=taken("elastic_energy"),
        smallest_volume_ratio=taken("smallest_volume_ratio"), smallest_gap=taken("smallest_gap"),
        touch_heights=(tube.outer_diameter / 2,),
        barrier_distance=BARRIER_DISTANCE * tube.inner_diameter,
    )  # fmt: skip
