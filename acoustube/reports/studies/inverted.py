"""Waveform inversion of a study's recordings, to compare with the sleeve paper's processing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from acoustube.base.errors import SimulationError
from acoustube.base.interrupts import watched_interrupts
from acoustube.base.report import Reporter
from acoustube.base.types import Array
from acoustube.base.units import CM, PERCENT
from acoustube.inversion import Library, Priors, Wrap
from acoustube.ranging import Rangefinder, record
from acoustube.reports.figures.run import RETURN, SEND
from acoustube.reports.studies.calibration import LENGTH, RADIUS, TEMPERATURE
from acoustube.reports.studies.ranged import found_distance
from acoustube.reports.studies.report import Level, Scale
from acoustube.runs.inversion import RecordingInverter, Sensor
from acoustube.runs.inverted_cycles import inverted
from acoustube.runs.libraries.build import build_library
from acoustube.runs.libraries.files import open_library
from acoustube.runs.libraries.plan import tool_plans
from acoustube.waves import PlacedScatterer

GROUP = 5
"""Number of cycles of a press that are inverted together."""
UNTOUCHED = 200
"""Number of cycles without contact, from which the clutter of the tube is estimated."""
SEED = 11
"""Random seed of the cycles without contact."""
TOLERANCE = 0.005
"""Largest relative error of the interpolated scattering: the default of ``acoustube library``."""
DEPTHS = "0.25:8:0.31"
"""Depths in mm in the libraries; the recorded presses have other depths, except the last."""
PLACE_AXIS, FORCE_AXIS = (1e-3, 100.0), (1e-2, 1000.0)
"""Ranges of the figure's axes: errors of distance in cm, and errors of force in per cent."""


def library_of(
    folder: Path, over: Mapping[str, Sequence[str]], level: Level, scale: Scale, report: Reporter
) -> Library:
    """Compute or resume a library of presses on the level's mesh, and return the library.

    Parameters
    ----------
    folder : Path
        Folder of the library.
    over : mapping of str to sequence of str
        Settings of the indenter; depths are :data:`DEPTHS` if not given.
    level : Level
    scale : Scale
    report : Reporter

    Raises
    ------
    SimulationError
        If a press fails.
    """
    plans = tool_plans({"depth_mm": [DEPTHS], "mesh": [level.mesh], **over}, TOLERANCE)
    if not build_library(plans, folder, report=report, workers=scale.workers):
        raise SimulationError(
            f"a press of {folder} failed (above); repeat the command to go on with the others"
        )
    return open_library(folder)


def inverter_of(
    library: Library,
    untouched: Sequence[PlacedScatterer],
    *,
    session_seed: int,
    tube_seed: int,
    rangefinder: Rangefinder | None = None,
    wrap: Wrap | None = None,
) -> RecordingInverter:
    """Return the inversion of the recordings of one tube, with known parameters of the rangefinder.

    Parameters
    ----------
    library : Library
    untouched : sequence of PlacedScatterer
        Scatterers of the tube without presses: its bends.
    session_seed, tube_seed : int
        See :func:`acoustube.ranging.record`.
    rangefinder : Rangefinder, optional
        Rangefinder of the recordings, the default one if not given. The inversion also knows the
        mean error of its thermometer, as from a calibration with closures.
    wrap : Wrap, optional
        Curvature of a wrapped tube.
    """
    known = rangefinder or Rangefinder()
    free = record(
        untouched, known, radius=RADIUS, length=LENGTH, temperature=TEMPERATURE,
        n_cycles=UNTOUCHED, seed=SEED, session_seed=session_seed, tube_seed=tube_seed,
    )  # fmt: skip
    sensor = Sensor(rangefinder=known, priors=Priors(thermometer=0.0), wrap=wrap, length=LENGTH)
    return RecordingInverter(library, sensor, [(Path("untouched"), free)])


def inverted_table(
    recordings: Sequence[xr.Dataset], inverter: RecordingInverter, report: Reporter
) -> xr.Dataset:
    """Invert recordings, each of one press.

    Parameters
    ----------
    recordings : sequence of xarray.Dataset
        In the format of :func:`acoustube.ranging.record`, with labels.
    inverter : RecordingInverter
    report : Reporter

    Returns
    -------
    xarray.Dataset
        A row for each recording along ``cycle``: the labels; ``features`` in the format of
        :func:`acoustube.estimation.feature_table`, but only ``distance``; and ``estimated_force``
        in N. Distance and force are those of the most probable contact, nan where none is detected.
    """
    total = len(recordings)
    with watched_interrupts() as check, report.progress(check) as show:
        done = iter(range(1, total + 1))
        labels, found = inverted(
            ((Path(f"recording {i}"), one) for i, one in enumerate(recordings)), inverter, GROUP,
            lambda _stage, _share: show("inversion", next(done) / total),
        )  # fmt: skip
    return labels.assign(
        features=(("cycle", "feature"), found["distance"].values[:, None]),
        estimated_force=found["force"],
    ).assign_coords(feature=["distance"])


def compared_figures(
    table: xr.Dataset,
    inversion: xr.Dataset | None,
    forces: tuple[ArrayLike, ArrayLike] | None = None,
    pressed: xr.Dataset | None = None,
) -> dict[str, Figure]:
    """Return a figure that compares errors of inversion and of the highest peak, by its caption.

    Parameters
    ----------
    table : xarray.Dataset
        Cycles, with distances estimated from the highest peak.
    inversion : xarray.Dataset or None
        From :func:`inverted_table`; if None, the result is empty.
    forces : (array_like, array_like), optional
        True forces in N, and the force network's estimates in N.
    pressed : xarray.Dataset, optional
        Result of an inversion whose forces are drawn in place of those of `inversion`.
    """
    if inversion is None:
        return {}
    places = {
        "highest peak": (table["true_distance"], found_distance(table)),
        "waveform inversion": (inversion["true_distance"], found_distance(inversion)),
    }
    other = inversion if pressed is None else pressed
    by_inversion: dict[str, tuple[ArrayLike, ArrayLike]] = {
        "waveform inversion": (other["force"], other["estimated_force"])
    }
    words = "of the force by inversion (right)."
    if forces is not None:
        by_inversion = {"force network": forces, **by_inversion}
        words = "of the force by the network and by inversion (right)."
    caption = (
        "Share of recordings whose error is at most the value on the axis; those without an "
        "estimate never count. Single cycles by the sleeve paper's processing, means of a few by "
        "inversion. Errors of the distance by the highest peak and by waveform inversion (left), "
        f"{words}"
    )
    return {caption: errors_figure(places, by_inversion)}


def errors_figure(
    places: Mapping[str, tuple[ArrayLike, ArrayLike]],
    forces: Mapping[str, tuple[ArrayLike, ArrayLike]],
) -> Figure:
    """Draw the cumulative distributions of the errors of place and of force.

    Parameters
    ----------
    places, forces : mapping of str to (array_like, array_like)
        True values and estimates by the name of the estimator: distances in m, and forces in N. An
        estimate of nan, where no contact is detected, counts as an error beyond the axis. If
        `forces` is empty, its panel is omitted.
    """
    given: list[tuple[str, tuple[float, float], Mapping[str, Array]]] = [
        ("absolute error of the distance (cm)", PLACE_AXIS,
         {name: CM * np.abs(np.subtract(b, a)) for name, (a, b) in places.items()}),
        ("relative error of the force (%)", FORCE_AXIS,
         {name: PERCENT * np.abs(np.divide(b, a) - 1) for name, (a, b) in forces.items()}),
    ]  # fmt: skip
    drawn = [part for part in given if part[2]]
    sheet = Figure(figsize=(5.5 * len(drawn), 4.2), layout="constrained")
    for axes, (words, bounds, errors) in zip(
        sheet.subplots(1, len(drawn), sharey=True, squeeze=False)[0], drawn, strict=True
    ):
        for name, values in errors.items():
            colour = RETURN if "inversion" in name else SEND
            known = np.sort(values[np.isfinite(values)])
            share = PERCENT * np.arange(1, len(known) + 1) / max(len(values), 1)
            axes.step(np.maximum(known, bounds[0]), share, where="post", color=colour, label=name)
        axes.set(xscale="log", xlim=bounds, ylim=(0, 100), xlabel=words)
        axes.legend(loc="upper left")
    sheet.axes[0].set_ylabel("recordings with a smaller error (%)")
    return sheet
