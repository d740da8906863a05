"""One press as a dataset: every stage's arrays with their units, names and origin."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
import xarray as xr

from acoustube import __version__
from acoustube.config import Config
from acoustube.indentation import Indentation
from acoustube.lumen import Lumen, deformed_wall, profile, ring_faces
from acoustube.signals import Ranging
from acoustube.waves import Recording
from acoustube.waves.scheme import SourceEnd

PROFILE_POINTS = 801

Variable = tuple[tuple[str, ...], Any, dict[str, str]]


def variable(dims: str, values: Any, units: str, long_name: str) -> Variable:
    """Return a dataset's variable; `dims` are names separated by spaces."""
    return tuple(dims.split()), np.asarray(values), {"units": units, "long_name": long_name}


def dataset(
    config: Config,
    indentation: Indentation,
    lumen: Lumen,
    recordings: Mapping[SourceEnd, Recording],
    rangings: Mapping[SourceEnd, Ranging],
    *,
    sound_speed: float,
    seconds: Mapping[str, float],
    warnings: Sequence[str],
    device: str,
) -> xr.Dataset:
    """Gather one press.

    Parameters
    ----------
    config : Config
    indentation : Indentation
    lumen : Lumen
    recordings, rangings : mapping of str
        The recorded and the processed signal for each choice of the source end.
    sound_speed : float
        In m/s.
    seconds : mapping of str to float
        How long each stage took.
    warnings : sequence of str
        Where the run leaves the range in which the model holds.
    device : str
        What computed it.

    Returns
    -------
    xarray.Dataset
        In SI units; every variable has ``units`` and ``long_name``.
    """
    variables = (
        _pressed(indentation)
        | _shape(indentation, lumen)
        | _signals(recordings, rangings, config.waves.source_end)
        | {
            "true_distance": variable("", lumen.position, "m", "distance of the press"),
            "sound_speed": variable("", sound_speed, "m/s", "speed of sound"),
            "elapsed_time": variable("stage", list(seconds.values()), "s", "time of each stage"),
        }
    )
    coordinates = {
        "stage": ("stage", list(seconds)),
        "source_end": ("source_end", list(recordings)),
        "xyz": ("xyz", ["x", "y", "z"]),
    }
    origin = _provenance(config, indentation, recordings, warnings, device)
    return xr.Dataset(variables, coordinates, origin)


def _pressed(indentation: Indentation) -> dict[str, Variable]:
    sections = [
        profile(deformed_wall(indentation, i), np.zeros(1)) for i in range(len(indentation.depth))
    ]

    def at_press(quantity: str) -> list[float]:
        return [float(getattr(section, quantity)[0]) for section in sections]

    mesh, nodes = indentation.mesh, (len(indentation.depth), -1, 3)
    return {
        "indentation_depth": variable("depth", indentation.depth, "m", "depth of the rod"),
        "contact_force": variable(
            "depth", indentation.contact_force, "N", "force of the rod on the whole tube"
        ),
        "lumen_height": variable(
            "depth", at_press("height"), "m", "height of the lumen at the press"
        ),
        "lumen_width": variable("depth", at_press("width"), "m", "width of the lumen at the press"),
        "lumen_area": variable(
            "depth", at_press("area"), "m2", "cross-section of the lumen at the press"
        ),
        "newton_iterations": variable("depth", indentation.iterations, "1", "Newton iterations"),
        "newton_residual": variable(
            "depth", indentation.residual, "N", "norm of the out-of-balance nodal forces"
        ),
        "node_position": variable(
            "node xyz", mesh.points, "m", "nodes of the undeformed quarter, the press at z = 0"
        ),
        "node_displacement": variable(
            "depth node xyz", indentation.displacement.reshape(nodes), "m", "displacement"
        ),
        "element_node": variable(
            "element corner", mesh.elements, "1", "node numbers of the 27-node hexahedra"
        ),
    }


def _shape(indentation: Indentation, lumen: Lumen) -> dict[str, Variable]:
    along = profile(lumen.rings, np.linspace(0, indentation.tube.length, PROFILE_POINTS))
    return {
        "inner_wall": variable(
            "ring around xyz", lumen.rings, "m", "rings of the inner wall, source end at z = 0"
        ),
        "outer_wall": variable(
            "ring around xyz", lumen.outer_rings, "m", "rings of the outer wall"
        ),
        "lumen_face": variable(
            "face vertex",
            ring_faces(*lumen.rings.shape[:2]),
            "1",
            "triangles of the closed lumen; vertex number = ring * n_around + around",
        ),
        "z": variable("z", along.z, "m", "distance from the source end"),
        "area_profile": variable("z", along.area, "m2", "cross-section of the lumen"),
        "height_profile": variable("z", along.height, "m", "height of the lumen"),
        "width_profile": variable("z", along.width, "m", "width of the lumen"),
    }


def _signals(
    recordings: Mapping[SourceEnd, Recording],
    rangings: Mapping[SourceEnd, Ranging],
    source_end: SourceEnd,
) -> dict[str, Variable]:
    first = next(iter(recordings.values()))
    results = list(rangings.values())
    chosen = rangings[source_end]
    most = max(result.echoes.times.size for result in results)

    def stacked(quantity: str) -> Any:
        return np.stack([np.asarray(getattr(result, quantity)) for result in results])

    def echoes(quantity: str) -> Any:
        rows = np.full((len(results), most), np.nan)
        for row, result in zip(rows, results, strict=True):
            values = getattr(result.echoes, quantity)
            row[: values.size] = values
        return rows

    return {
        "time": variable("time", first.time, "s", "time since the pulse starts to leave"),
        "pressure": variable(
            "source_end time",
            np.stack([recording.pressure[0] for recording in recordings.values()]),
            "1",
            "mean pressure on the probe plane, as a share of the pulse's peak",
        ),
        "envelope": variable(
            "source_end time", stacked("envelope"), "1", "envelope, as a share of the send pulse"
        ),
        "send_time": variable("source_end", stacked("send_time"), "s", "maximum of the send pulse"),
        "return_time": variable("source_end", stacked("return_time"), "s", "highest echo"),
        "echo_amplitude": variable(
            "source_end", stacked("amplitude"), "1", "highest echo, as a share of the send pulse"
        ),
        "estimated_distance": variable(
            "source_end", stacked("distance"), "m", "distance that the highest echo tells"
        ),
        "peak_time": variable("source_end peak", echoes("times"), "s", "peaks of the envelope"),
        "peak_amplitude": variable(
            "source_end peak", echoes("amplitudes"), "1", "height of each peak"
        ),
        "peak_prominence": variable(
            "source_end peak", echoes("prominences"), "1", "prominence of each peak"
        ),
        "distance": (
            (),
            chosen.distance,
            {"units": "m", "long_name": "estimated distance", "source_end": source_end},
        ),
        "amplitude": (
            (),
            chosen.amplitude,
            {"units": "1", "long_name": "amplitude of its echo", "source_end": source_end},
        ),
    }


def _provenance(
    config: Config,
    indentation: Indentation,
    recordings: Mapping[SourceEnd, Recording],
    warnings: Sequence[str],
    device: str,
) -> dict[str, Any]:
    first = next(iter(recordings.values()))
    settings = json.dumps(dataclasses.asdict(config), sort_keys=True)
    return {
        "title": "One press of a soft acoustic waveguide",
        "source": "simulation",
        "acoustube_version": __version__,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "configuration": settings,
        "configuration_hash": hashlib.sha256(settings.encode()).hexdigest()[:16],
        "device": device,
        "precision": "float64 in the wall, float32 in the air",
        "time_step": first.time_step,
        "grid_spacing": list(first.spacing),
        "grid_shape": list(first.shape),
        "probe": first.probes[0],
        "pulse_duration": config.waves.cycles / (1e3 * config.waves.frequency_khz),
        "newton_residual": float(indentation.residual.max()),
        "warnings": "\n".join(warnings),
    }
