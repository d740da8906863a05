"""Mesh and results of a press, read back from ``run.nc``."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from acoustube.base.errors import ConfigError
from acoustube.indentation import Indentation, Mesh, restored
from acoustube.indentation.reference_element import HEX20, TET10
from acoustube.indentation.result import RESULTS
from acoustube.runs.config import Mechanics, configured
from acoustube.runs.config.si import press_in_si

NAMES = {
    "depth": "indentation_depth", "displacement": "node_displacement",
    "iterations": "newton_iterations", "residual": "newton_residual",
    "press_force": "contact_force", "energy": "elastic_energy",
}  # fmt: skip
"""Names of a run's variables by attribute of :class:`Indentation`, where the names differ."""
COINCIDENT_DISTANCE = 1e-9
"""Distance in m up to which nodes of two meshes coincide, or a node is in a symmetry plane."""


def settings_of(run: xr.Dataset) -> Mechanics:
    """Return the settings of the tube and the press of a run."""
    return configured(json.loads(run.attrs["configuration"]), Mechanics)


def reached(run: xr.Dataset) -> NDArray[np.int64]:
    """Return the indices of the depths that were reached."""
    if "converged" not in run:
        return np.arange(run.sizes["depth"])
    return np.flatnonzero(run["converged"].values)


def mesh_of(run: xr.Dataset) -> Mesh:
    """Return a run's finite-element mesh, whose optional attribute `sweep` is None.

    Parameters
    ----------
    run : xarray.Dataset
        Run of ``simulate`` or ``indent``.
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
        Run of ``simulate`` or ``indent``.

    Raises
    ------
    ConfigError
        If the mesh differs from that of this version for these settings.
    """
    settings, rows = press_in_si(settings_of(run)), reached(run)
    results = {name: run[NAMES.get(name, name)].values[rows] for name in RESULTS}
    results |= {name: results[name][:, None] for name in ("press_force", "contact_area")}
    found = restored(
        settings.tube, settings.indenter, results, support=settings.support, layer=settings.layer,
        mesh=settings.mesh,
    )  # fmt: skip
    points, stored = found.mesh.points, run["node_position"].values
    if stored.shape != points.shape or np.abs(stored - points).max() > COINCIDENT_DISTANCE:
        raise ConfigError(
            "the run was written by a version of acoustube that made another mesh; repeat the run"
        )
    return found
