"""One press as a dataset: every stage's arrays with their units, names and origin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from acoustube.base.netcdf import Variable, flag, variable
from acoustube.base.units import MM
from acoustube.indentation import Indentation, Mesh
from acoustube.lumen import Lumen, inner_wall, measure, profile, ring_faces
from acoustube.runs.config import Config, Mechanics
from acoustube.runs.config.si import SISettings
from acoustube.runs.provenance import configuration, provenance
from acoustube.waves import Budget, Pulse, Recording, SourceEnd
from acoustube.waves.budget import SpectralBudget

if TYPE_CHECKING:  # these import the solvers of sound, which a press alone does not need
    from acoustube.runs.sound import SpectralCheck
    from acoustube.signals import Ranging

EVEN_POINTS = 401
"""Number of evenly spaced points of a profile along the tube.

The profile of the whole tube has the positions of the lumen's rings in addition.
"""
MEASURED_PART = 0.95
"""Fraction of the modelled length within which the deformed tube is measured.

The end of a tube that tilts off the floor is slanted; where it is within this part, profiles are
nan.
"""
XYZ = variable("xyz", ["x", "y", "z"], "1", "across, up, along the tube")
DEPTH = "indentation depth from first contact"
ECHO = {
    "estimated_distance": ("distance", "m", "distance of the highest echo"),
    "echo_amplitude": ("amplitude", "1", "highest echo, relative to the send pulse"),
    "send_time": ("send_time", "s", "maximum of the send pulse"),
    "return_time": ("return_time", "s", "maximum of the highest echo"),
}
"""Variables of the highest echo: attribute of :class:`Ranging`, unit and long name of each."""
SPECTRAL_ERROR = "estimated error of the scattering coefficients, 95 % quantile over frequency"


def dataset(
    config: Config,
    settings: SISettings,
    indentation: Indentation,
    lumen: Lumen,
    recordings: Mapping[SourceEnd, Recording],
    rangings: Mapping[SourceEnd, Ranging],
    *,
    budget: Budget | SpectralBudget,
    check: SpectralCheck | None,
    seconds: Mapping[str, float],
    warnings: Sequence[str],
    device: str,
) -> xr.Dataset:
    """Return the results of a simulation as a dataset.

    Parameters
    ----------
    config : Config
    settings : SISettings
        The settings `config` in SI units.
    indentation : Indentation
    lumen : Lumen
    recordings, rangings : mapping of str
        The recorded signal and the result of its processing, for each boundary condition at the
        source end.
    budget : Budget or SpectralBudget
        Known errors of the recordings.
    check : SpectralCheck or None
        The echo by the spectral solver; None if it was not computed.
    seconds : mapping of str to float
        Computing time of each stage.
    warnings : sequence of str
        Sentences on limits of the model that the run exceeds.
    device : str
        Name of the computing device.

    Returns
    -------
    xarray.Dataset
        In SI units; every variable has ``units`` and ``long_name``.
    """
    variables = (
        _mechanics(indentation, range(len(indentation.depth)))
        | _mesh(indentation.mesh)
        | _shape(indentation, lumen)
        | _recorded(recordings, settings.pulse)
        | _ranged(rangings, settings.source_end)
        | _error_budget(budget)
        | _spectral_echo(check)
        | {
            "sound_speed": variable("", settings.air.sound_speed, "m/s", "speed of sound"),
            "elapsed_time": variable("stage", list(seconds.values()), "s", "time of each stage"),
        }
    )
    coordinates = {
        "depth": variable("depth", indentation.depth, "m", DEPTH),
        "stage": variable("stage", list(seconds), "1", "stage of the simulation"),
        "source_end": variable(
            "source_end", list(recordings), "1", "boundary condition after the pulse"
        ),
        "xyz": XYZ,
    }
    origin = provenance(config, warnings, device)
    path = 2 * (lumen.position - next(iter(recordings.values())).probes[0])
    origin["accuracy"] = budget.in_words(path)
    return xr.Dataset(variables, coordinates, origin)


def walls(config: Config, lumen: Lumen) -> xr.Dataset:
    """Return the walls of a pressed tube as a dataset.

    Returns
    -------
    xarray.Dataset
        The variables ``inner_wall``, ``outer_wall`` and ``true_distance`` of :func:`dataset`.
    """
    return xr.Dataset(_rings(lumen), attrs={"configuration": configuration(config)})


def press_dataset(
    config: Mechanics,
    indentation: Indentation,
    depths: Sequence[float],
    *,
    seconds: float,
    warnings: Sequence[str],
    device: str,
) -> xr.Dataset:
    """Return the results of a press alone as a dataset, at the requested depths.

    Parameters
    ----------
    indentation : Indentation
        Press, which may end before the last depth. At the depths that it lacks ``converged`` is 0,
        and other values are nan, or zero for integers.
    depths : sequence of float
        Requested depths in m.
    seconds : float
        Computing time in s.
    config, warnings, device
        As of :func:`dataset`.

    Returns
    -------
    xarray.Dataset
        In SI units; forces, areas and energies are those of the whole tube, even if the mesh is a
        part of it. Every variable has ``units`` and ``long_name``.
    """
    reached = indentation.rows_at(depths)
    rows = _mechanics(indentation, reached) | _axial(indentation, reached)
    missing = len(depths) - len(reached)
    found = {name: _lengthened(value, missing) for name, value in rows.items()}
    converged = np.arange(len(depths)) < len(reached)
    found |= _mesh(indentation.mesh) | {
        "indentation_depth": variable("depth", depths, "m", DEPTH),
        "converged": flag("depth", converged, "whether the press converged at this depth"),
        "elapsed_time": variable("", seconds, "s", "time that the press took"),
    }
    coordinates = {
        "depth": variable("depth", depths, "m", DEPTH),
        "z": found.pop("z"),
        "xyz": XYZ,
    }
    origin = provenance(config, warnings, device) | {
        "title": "A press of a soft tube",
        "precision": "float64",
        "closed": (
            "the lumen counts as closed where smallest_gap is under "
            f"{MM * indentation.barrier_distance:.4g} mm, where self-contact sets in"
        ),
    }
    return xr.Dataset(found, coordinates, origin)


def _lengthened(value: Variable, missing: int) -> Variable:
    """Return a variable padded with nan (0 in integers) for depths that were not reached."""
    dims, values, attributes = value
    if dims[0] != "depth" or missing == 0:
        return value
    filler = np.full((missing, *values.shape[1:]), 0 if values.dtype.kind in "iu" else np.nan)
    return dims, np.concatenate([values, filler.astype(values.dtype)]), attributes


def _mechanics(indentation: Indentation, rows: Sequence[int]) -> dict[str, Variable]:
    """Return force, lumen, convergence and displacement of a press at some of its increments."""
    wall = inner_wall(indentation.mesh)
    place = np.array([indentation.indenters[0].z])
    sections = [measure(indentation, i, place, wall) for i in rows]

    def at_press(quantity: str) -> list[float]:
        return [float(getattr(section, quantity)[0]) for section in sections]

    def taken(name: str) -> Any:
        return np.asarray(getattr(indentation, name))[list(rows)]

    scalars = {
        "indentation_depth": (taken("depth"), "m", DEPTH),
        "contact_force": (taken("contact_force"), "N", "force of the indenter on the whole tube"),
        "contact_area": (
            taken("contact_area").sum(axis=1), "m2",
            "area of the outer wall in contact with the indenter",
        ),
        "lumen_height": (at_press("height"), "m", "height of the lumen at the press"),
        "lumen_width": (at_press("width"), "m", "width of the lumen at the press"),
        "lumen_area": (at_press("area"), "m2", "cross-section of the lumen at the press"),
        "elastic_energy": (taken("energy"), "J", "elastic energy of the whole tube"),
        "smallest_gap": (
            taken("smallest_gap"), "m", "smallest gap between top and bottom of the inner wall",
        ),
        "smallest_volume_ratio": (
            taken("smallest_volume_ratio"), "1", "smallest volume ratio J at any quadrature point",
        ),
        "newton_iterations": (taken("iterations"), "1", "Newton iterations"),
        "newton_residual": (taken("residual"), "N", "norm of the out-of-balance nodal forces"),
    }  # fmt: skip
    found = {name: variable("depth", *parts) for name, parts in scalars.items()}
    return found | {
        "closed": flag("depth", taken("closed"), "whether the lumen's walls are in contact"),
        "node_displacement": variable(
            "depth node xyz", taken("displacement"), "m", "displacement of the nodes"
        ),
    }


def _axial(indentation: Indentation, rows: Sequence[int]) -> dict[str, Variable]:
    """Return the profiles of the lumen over z, which is zero at the press, at some increments."""
    reach = MEASURED_PART * indentation.mesh.points[:, 2].max()
    ahead = np.linspace(0, reach, EVEN_POINTS // 2 + 1)
    z = np.concatenate([-ahead[:0:-1], ahead])
    wall = inner_wall(indentation.mesh)
    profiles = [measure(indentation, i, z, wall) for i in rows]
    found = {}
    for name, units, words in (
        ("area", "m2", "cross-section"), ("height", "m", "height"), ("width", "m", "width"),
    ):  # fmt: skip
        values = np.array([getattr(p, name) for p in profiles]).reshape(-1, z.size)
        text = f"{words} of the lumen along the tube"
        found[f"lumen_{name}_profile"] = variable("depth z", values, units, text)
    return found | {"z": variable("z", z, "m", "deformed axial position, zero at the press")}


def _mesh(mesh: Mesh) -> dict[str, Variable]:
    """Return the finite-element mesh."""
    kind = "20-node hexahedra" if mesh.sweep is not None else "10-node tetrahedra"
    planes = [f"{axis} >= 0" for axis, halved in zip("xz", mesh.halved, strict=True) if halved]
    part = " and ".join(planes) or "the whole tube"
    return {
        "node_position": variable(
            "node xyz", mesh.points, "m", f"nodes of the undeformed part that is modelled, {part}"
        ),
        "element_node": variable("element corner", mesh.elements, "1", f"nodes of the {kind}"),
        "inner_face_node": variable(
            "inner_face face_corner", mesh.inner_faces, "1", "nodes of the faces on the inner wall"
        ),
        "outer_face_node": variable(
            "outer_face face_corner", mesh.outer_faces, "1", "nodes of the faces on the outer wall"
        ),
    }


def _shape(indentation: Indentation, lumen: Lumen) -> dict[str, Variable]:
    """Return the walls of the whole tube, and the profile of its lumen."""
    length = indentation.tube.length
    # The rings are dense where the lumen is pressed, and one of them lies under the rod.
    stations = np.clip(lumen.rings[:, 0, 2], 0, length)
    z = np.union1d(np.linspace(0, length, EVEN_POINTS), stations)
    faces = ring_faces(*lumen.rings.shape[:2])
    # A plane through the far cap itself does not cut the surface.
    along = profile(lumen.rings.reshape(-1, 3), faces, np.minimum(z, length * (1 - 1e-12)))
    return _rings(lumen) | {
        "lumen_face": variable(
            "face vertex",
            faces,
            "1",
            "triangles of the closed lumen; vertex number = ring * n_around + around",
        ),
        "z": variable("z", z, "m", "distance from the source end"),
        "area_profile": variable("z", along.area, "m2", "cross-section of the lumen"),
        "height_profile": variable("z", along.height, "m", "height of the lumen"),
        "width_profile": variable("z", along.width, "m", "width of the lumen"),
    }


def _rings(lumen: Lumen) -> dict[str, Variable]:
    """Return the walls of the whole tube, and the position of the press."""
    return {
        "inner_wall": variable(
            "ring around xyz", lumen.rings, "m", "rings of the inner wall, source end at z = 0"
        ),
        "outer_wall": variable(
            "ring around xyz", lumen.outer_rings, "m", "rings of the outer wall"
        ),
        "true_distance": variable("", lumen.position, "m", "distance of the press"),
    }


def _recorded(recordings: Mapping[SourceEnd, Recording], pulse: Pulse) -> dict[str, Variable]:
    """Return the pressure at the probe, and the grid on which it was computed."""
    first = next(iter(recordings.values()))
    return {
        "time": variable(
            "time", first.time, "s", "time since the pulse starts to leave the source end"
        ),
        "pressure": variable(
            "source_end time",
            np.stack([recording.pressure[0] for recording in recordings.values()]),
            "1",
            "mean pressure on the probe plane, relative to the pulse's peak",
        ),
        "probe_position": variable("", first.probes[0], "m", "distance of the probe plane"),
        "pulse_duration": variable("", pulse.duration, "s", "duration of the pulse"),
        "time_step": variable("", first.time_step, "s", "time step"),
        "grid_spacing": variable("xyz", first.spacing, "m", "size of a grid cell"),
        "grid_shape": variable(
            "xyz", first.shape, "1", "grid cells, of the half x > 0 if symmetric"
        ),
    }


def _spectral_echo(check: SpectralCheck | None) -> dict[str, Variable]:
    if check is None:
        return {}
    place = "distance of the highest echo, spectral solver"
    height = "height of the highest echo by the spectral solver, relative to the send pulse"
    return {
        "spectral_distance": variable("source_end", check.distance, "m", place),
        "spectral_amplitude": variable("source_end", check.amplitude, "1", height),
        "spectral_error": variable("", check.error, "1", SPECTRAL_ERROR),
    }


def _error_budget(budget: Budget | SpectralBudget) -> dict[str, Variable]:
    """Return the error budget of the sound as variables."""
    table = {
        "cells_per_wavelength": ("1", "cells per wavelength at the top of the pulse's band"),
        "delay_bias": ("1", "relative error of the plane wave's group delay on the grid"),
        "section_error": ("1", "relative error of the bore's cross-section on the grid"),
        "cut_on_error": ("1", "relative error of the cut-on of mode (1,1) on the grid"),
        "absorption": (
            "dB",
            "reflection of an absorbing end for a mode 1 % above cut-on",
        ),
        "plane_reflection": ("dB", "largest reflection of an absorbing end for the plane wave"),
        "spectral_error": ("1", SPECTRAL_ERROR),
        "ringing": ("dB", "highest pressure at the end of the recording, relative to its maximum"),
    }
    return {
        name: variable("", getattr(budget, name), units, text)
        for name, (units, text) in table.items()
        if getattr(budget, name, None) is not None
    }


def _ranged(rangings: Mapping[SourceEnd, Ranging], source_end: SourceEnd) -> dict[str, Variable]:
    """Return envelope, highest echo and all peaks for each boundary condition at the source end."""
    results = list(rangings.values())
    found = {
        name: variable("source_end", [getattr(one, own) for one in results], units, text)
        for name, (own, units, text) in ECHO.items()
    }
    envelopes = [one.envelope for one in results]
    text = "envelope, relative to the send pulse"
    found["envelope"] = variable("source_end time", envelopes, "1", text)
    for name, units, text in (
        ("distance", "m", "estimated distance"), ("amplitude", "1", "height of the highest echo"),
    ):  # fmt: skip
        attributes = {"units": units, "long_name": text, "source_end": source_end}
        found[name] = ((), getattr(rangings[source_end], name), attributes)
    return found | _peaks(results)


def _peaks(results: Sequence[Ranging]) -> dict[str, Variable]:
    """Return all peaks of each source end, padded with nan."""
    most = max(result.echoes.times.size for result in results)
    dims, rows = "source_end peak", np.full((3, len(results), most), np.nan)
    for i, result in enumerate(results):
        echoes = result.echoes
        for row, values in enumerate((echoes.times, echoes.amplitudes, echoes.prominences)):
            rows[row, i, : values.size] = values
    return {
        "peak_time": variable(dims, rows[0], "s", "times of the envelope's peaks"),
        "peak_amplitude": variable(dims, rows[1], "1", "height of each peak"),
        "peak_prominence": variable(dims, rows[2], "1", "prominence of each peak"),
    }
