"""Sweeps of presses for the studies, and their stored scattering matrices."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import xarray as xr

from acoustube.base.errors import SimulationError
from acoustube.base.report import Reporter
from acoustube.reports.studies.report import Level, Scale
from acoustube.runs.opening import files_of, open_dataset
from acoustube.runs.scattering_file import from_dataset
from acoustube.runs.sweep import store
from acoustube.runs.sweep.plan import load_plan
from acoustube.runs.sweep.run import run_sweep
from acoustube.waves.scattering import ModalScattering


def swept(
    folder: Path,
    over: Mapping[str, Sequence[str]],
    level: Level,
    scale: Scale,
    report: Reporter,
) -> xr.Dataset:
    """Run or resume a sweep, and return its cases.

    Parameters
    ----------
    folder : Path
        Folder of the sweep.
    over : mapping of str to sequence of str
        Values of the settings that vary, see :func:`acoustube.runs.sweep.plan.load_plan`.
    level : Level
    scale : Scale
    report : Reporter

    Returns
    -------
    xarray.Dataset
        Cases in the format of :func:`acoustube.open_dataset`, loaded into memory.

    Raises
    ------
    SimulationError
        If a case fails.
    """
    given = {
        "method": ["spectral"], "mesh": [level.mesh],
        # For the time-domain solver, which computes lumens that the spectral one cannot represent.
        "resolution": [str(level.resolution)],
    }  # fmt: skip
    plan = load_plan(None, {**given, **over})
    if not run_sweep(plan, folder, report=report, workers=scale.workers):
        raise SimulationError(
            f"a case of {folder} failed (above); repeat the command to go on with the others"
        )
    return open_dataset(folder).load()


def matrices(folder: Path) -> Iterator[tuple[xr.Dataset, ModalScattering]]:
    """Yield, for each press of a sweep that has a scattering matrix, its cases and this matrix."""
    for path in files_of(folder):
        cases, matrix = store.read(path)
        if matrix is not None:
            yield cases, from_dataset(matrix)
