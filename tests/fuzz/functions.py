"""Public functions with valid arguments, of which one or two are made odd."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import inspect
import warnings
from collections.abc import Callable, Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from random import Random
from typing import Any, NamedTuple
from unittest import mock

import numpy as np

from acoustube.base.errors import SimulationError
from tests.fuzz.corpus import TIME, recording
from tests.fuzz.harness import Case
from tests.fuzz.oddities import mutated_array, odd_value

LARGEST_REPLY = 1500
ALSO = {
    "samples": ("record", "pressure"), "pressure": ("record",), "blocked": ("places", "closures"),
    "true_distance": ("places",), "first": ("column", "radius"), "second": ("column", "radius"),
    "time": ("sampling rate", "before"), "time_step": ("band", "longer than the run"),
    "pulse": ("the run",), "line": ("curve",),
    "settings": ("matched filter",), "temperature": ("air", "m/s"), "untouched": ("cycles",),
    "untouched_temperature": ("temperature",),
    "outer_diameter": ("thick", "loops"), "count": ("seed",), "over": ("range",),
    "path": ("cannot be read",), "s": ("matrices", "spaced"), "tools": ("library",),
    "counts": ("cycle",),
}  # fmt: skip
"""Words by which a message may name an argument, where several arguments together are wrong."""


class Spec(NamedTuple):
    """A function, valid arguments, and the names of results that may be nan."""

    function: Callable[..., Any]
    good: Mapping[str, Any]
    gaps: bool = False


def trial(spec: Spec, changed: Mapping[str, Any]) -> str:
    """Call a function with some odd arguments; return what is wrong with its answer, or nothing.

    It may return finite numbers, or raise a ValueError that names one of the odd arguments.
    """
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            answer = spec.function(**(dict(spec.good) | dict(changed)))
    except ValueError as error:
        text = str(error)
        if len(text) > LARGEST_REPLY:
            return f"ValueError of {len(text)} characters: {text[:200]}"
        if not any(_named(name, text) for name in changed):
            return f"names none of {', '.join(changed)}: {text}"
        return ""
    except SimulationError:  # valid arguments that cannot be computed, reported in a sentence
        return ""
    except MemoryError as error:
        return f"MemoryError: {error}"
    except Exception as error:  # all other exceptions are findings
        frame = inspect.trace()[-1]
        where = f"{Path(frame.filename).name}:{frame.lineno}"
        return f"{type(error).__name__}: {str(error)[:200]} ({where})"
    return "" if spec.gaps or _finite(answer) else "the answer is not finite"


def _named(name: str, text: str) -> bool:
    words = {name, name.replace("_", " "), name.rstrip("s"), *ALSO.get(name, ())}
    return any(word in text for word in words)


def _finite(answer: Any) -> bool:
    """Return whether all numbers of an answer are finite."""
    if isinstance(answer, list | tuple):
        return all(_finite(one) for one in answer)
    if dataclasses.is_dataclass(answer) and not isinstance(answer, type):
        return all(_finite(getattr(answer, f.name)) for f in dataclasses.fields(answer))
    if isinstance(answer, float | complex | np.ndarray | np.generic):
        array = np.asarray(answer)
        return array.dtype.kind not in "fc" or bool(np.all(np.isfinite(array)))
    return True


def functions(chance: Random, corpus: Path, folder: Path) -> Case:  # noqa: ARG001
    """Public functions with odd numbers, types and shapes."""
    name = chance.choice(sorted(specs()))
    spec = specs()[name]
    changed = {}
    for argument in chance.sample(sorted(spec.good), min(len(spec.good), chance.choice((1, 1, 2)))):
        good = spec.good[argument]
        if isinstance(good, np.ndarray) and chance.random() < 0.6:
            changed[argument] = mutated_array(chance, good)
        else:
            changed[argument] = chance.choice(
                (odd_value(chance), odd_value(chance), None, 1j, b"x")
            )

    def call() -> str:
        what = trial(spec, changed)
        shown = ", ".join(f"{n} = {str(v)[:80]}" for n, v in changed.items() if not _huge(v))
        return f"{name}({shown}): {what}" if what else ""

    return Case(call=call)


def _huge(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and abs(value) > 10**100


class Reached(Exception):  # noqa: N818
    """All checks have passed, and the computation would begin."""


def up_to(function: Callable[..., Any], *places: str) -> Callable[..., Any]:
    """Return a function that stops where its computation of seconds or minutes would begin.

    Parameters
    ----------
    function : callable
    *places : str
        Function that starts the computation, as ``module:name``.
    """

    @functools.wraps(function)
    def checks(**given: Any) -> float:
        with contextlib.ExitStack() as stack:
            for place in places:
                module, _, name = place.partition(":")
                stack.enter_context(
                    mock.patch.object(import_module(module), name, side_effect=Reached)
                )
            try:
                function(**given)
            except Reached:
                return 0.0
        raise AssertionError(f"{function.__name__} never calls {' or '.join(places)}")

    return checks


@cache
def specs() -> dict[str, Spec]:
    """Return the public functions by name."""
    from tests.fuzz.costly import of_estimators, of_fields, of_presses
    from tests.fuzz.inverse import of_inversions, of_twins

    groups = (
        _of_signals(), _of_sleeve(), _of_waves(), _of_air(), _of_estimation(), _of_walls(),
        of_presses(), of_fields(), of_estimators(), of_inversions(), of_twins(),
    )  # fmt: skip
    return {name: spec for group in groups for name, spec in group.items()}


def named_specs(module: str, rows: list[tuple[Any, ...]]) -> dict[str, Spec]:
    return {f"{module}.{getattr(f, '__name__', f)}": Spec(f, *rest) for f, *rest in rows}


def _of_signals() -> dict[str, Spec]:
    from acoustube import signals as s

    arrays = recording()
    samples, rate = arrays["signal"], {"sampling_rate": 200e3}
    gain = s.TimeGain(-0.25, 2.0, 0.9, 0.42)
    envelope = s.envelope(samples - 2000, 200e3)
    window = {"start": 1e-3, "stop": 5e-3, "prominence": 0.01}
    places = np.linspace(0.3, 0.8, 8)
    since = TIME - 130e-6 - 2 * np.array([[0.0] * 8, places])[..., None] / 343.2
    bursts = np.exp(-((since / 60e-6) ** 2)) * np.sin(2 * np.pi * 42e3 * since)
    closed = bursts[0] + (0.7 - 0.5 * places[:, None]) * bursts[1]
    processing = {
        f.name: f.default for f in dataclasses.fields(s.Processing) if f.name != "gain"
    }  # fmt: skip
    return named_specs(
        "signals",
        [
            (s.sampling_rate, {"time": TIME}),
            (s.rectify, {"pressure": samples}),
            (s.low_pass, {"samples": samples, **rate, "cutoff": 10e3}),
            (s.envelope, {"pressure": samples, **rate, "cutoff": 10e3}),
            (s.remove_offset, {"samples": samples, **rate, "cutoff": 100.0}),
            (s.template, {**rate, "frequency": 42e3, "cycles": 10.0}),
            (s.matched_filter, {"samples": samples, "template": np.ones(31)}),
            (s.compensate, {"samples": samples, "distance": 171 * TIME, "gain": gain}),
            (s.normalise, {"samples": samples, "amplitude": np.ones(3)}, True),
            (s.send_pulse, {"time": TIME, "envelope": envelope, "before": 1e-3}),
            (s.find_echoes, {"time": TIME, "envelope": envelope, **window}, True),
            (s.blind_time, {"pulse_duration": 3e-4, "cutoff": 10e3}),
            (s.distance, {"time_of_flight": 1e-3 * np.ones(3), "temperature": 20.0}, True),
            (s.speed_of_sound, {"temperature": np.full(3, 20.0)}),
            (s.Processing, processing),
            (s.without_aliased_template, {"settings": s.Processing(), **rate}),
            (s.Tracker, {"time": TIME, "settings": s.Processing()}),
            (
                s.locate,
                {"time": TIME, "samples": samples, "settings": s.Processing(),
                 "temperature": 20.0, "temperature_deviation": 0.5},
                True,
            ),
            (
                s.process,
                {"time": TIME, "pressure": samples - 2000, "pulse_duration": 3e-4,
                 "probe_position": 0.02, "temperature": 20.0, "temperature_deviation": 0.5,
                 "offset_cutoff": 100.0, "gain": gain, "template": np.ones(31), "cutoff": 10e3,
                 "prominence": 0.01, "nearest": 0.15, "farthest": 2.0, "send_shift": 0.0},
                True,
            ),
            (
                s.calibrate,
                {"time": TIME, "blocked": 2000 + 1000 * closed, "true_distance": places,
                 "untouched": samples, "settings": s.Processing(), "temperature": 20.0,
                 "untouched_temperature": 20.0, "sigmas": 2.8},
            ),
        ],
    )  # fmt: skip


def _of_sleeve() -> dict[str, Spec]:
    from acoustube import sleeve as s
    from acoustube.tube import Tube

    helix = {"radius": 0.04, "taper": 0.05, "length": 0.25, "loops": 5.0, "phase": 0.0,
             "hand": "right", "lead": 0.15}  # fmt: skip
    tubes = [s.Helix(**helix)]
    z = np.linspace(0, 0.25, 8)
    columns = [np.stack([side * (0.03 + 0.05 * z), 0 * z, z], 1) for side in (1, -1)]
    arm = s.fit_arm(*columns)
    design = {"length": 0.25, "girths": (0.17, 0.26), "loops": 4.0, "n_tubes": 2, "phase": 0.0,
              "hand": "left", "lead": 0.1, "outer_diameter": 0.01, "reach": 2.5}  # fmt: skip
    layout = {"tubes": tubes, "dead_zone": 0.15, "reach": 2.5, "within": 0.01, "deviation": 0.05}
    following = {f.name: f.default for f in dataclasses.fields(s.TrackingSettings)}
    return named_specs(
        "sleeve",
        [
            (s.Helix, helix),
            (s.design, design),
            (s.layout, layout),
            (s.wound, {"arm": arm, "loops": 4.0, "n_tubes": 2, "phase": 0.0, "hand": "right",
                       "lead": 0.1, "length": 0.2}),
            (s.fit_arm, {"first": columns[0], "second": columns[1], "axis": "fitted"}),
            (s.nearest, {"tubes": tubes, "places": np.ones((4, 3))}, True),
            (s.check_reach, {"tubes": tubes, "reach": 2.5}),
            (s.check_room, {"tubes": tubes, "outer_diameter": 0.01}),
            (s.spacing, {"tubes": tubes}),
            (s.ovality, {"tube": Tube(), "curvature": 5.0}),
            (s.remove_ghost_echoes, {"places": np.array([0.3, 0.9]), "heights": np.ones(2)}),
            (s.TrackingSettings, following),
            (s.ContactTracker, {"settings": s.TrackingSettings(), "length": 2.0}),
        ],
    )  # fmt: skip


def _of_waves() -> dict[str, Spec]:
    from acoustube import waves as w
    from acoustube.air import air_at
    from acoustube.ranging import Burst, blockage, record, response
    from acoustube.ranging import rangefinder as r

    air, band = air_at(20.0), np.arange(30e3, 55e3, 500.0)
    mode, bore = {"m": 1, "n": 1}, {"radius": 3.95e-3}
    press = [blockage(np.array([28e3, 56e3]), 0.5)]
    tube = {"presses": press, "radius": 3.95e-3, "length": 1.0}
    ends = {"probes": (0.02,), "source_reflection": -1.0, "far_reflection": 0.0}
    made = {"temperature": 20.0, "tube_seed": 0}
    return named_specs(
        "waves",
        [
            (w.Pulse, {"frequency": 42e3, "cycles": 11.0}),
            (w.SampledPulse, {"pressure": np.hanning(20), "rate": 1e6}),
            (w.cut_on_frequency, {**mode, **bore, "sound_speed": 343.0}),
            (w.modes_below, {"frequency": 50e3, **bore, "sound_speed": 343.0}),
            (w.cut_ons_in_band, {"band": (20e3, 60e3), **bore, "sound_speed": 343.0}),
            (w.axial_wavenumber, {**mode, "frequency": band, **bore, "air": air}),
            (w.attenuation, {**mode, "frequency": 50e3, **bore, "air": air}),
            (w.grid_spacing, {"inner_diameter": 7.9e-3, "resolution": 16, "probe": 0.02}),
            (w.Bent, {"length": 0.1, "curvature": 5.0, "torsion": 0.0, "ovality": 0.0}),
            (w.bend, {"air": air, "frequency": band[:2], **bore, "bend_radius": 0.1, "angle": 0.5,
                      "torsion": 0.0, "highest": 6.0}),
            (w.joined_bends, {"air": air, "frequency": band[:2], **bore, "highest": 6.0,
                              "parts": [w.Bent(length=0.1, curvature=5.0)]}),
            (w.transfer, {"air": air, "frequency": band, **tube, **ends}),
            (w.probe_pressure, {"air": air, "pulse": w.Pulse(frequency=42e3), "duration": 5e-3,
                                "time_step": 2e-6, **tube, **ends}),
            (blockage, {"frequency": band[[0, -1]], "position": 0.5}, True),
            (response, {**tube, **made, "rangefinder": r.IDEAL}),
            (record, {**tube, **made, "rangefinder": r.IDEAL, "n_cycles": 2, "first_cycle": 0,
                      "seed": 0, "session_seed": 0}),
            (Burst, {"frequency": 42e3, "cycles": 13.0, "shape": "square"}),
            (r.Rangefinder, {f.name: f.default for f in dataclasses.fields(r.Rangefinder)}),
        ],
    )  # fmt: skip


def _of_air() -> dict[str, Spec]:
    from acoustube import air as a
    from acoustube.tube import Tube, shear_modulus_from_shore

    tube = {f.name: f.default for f in dataclasses.fields(Tube)}
    return named_specs(
        "air",
        [
            (a.air_at, {"temperature": 20.0, "humidity": 50.0, "pressure": 101325.0}),
            (a.sound_speed, {"temperature": 20.0}),
            (a.Air, {"sound_speed": 343.0, "density": 1.2, "viscosity": 1.8e-5, "prandtl": 0.7,
                     "heat_capacity_ratio": 1.4, "classical_absorption": 0.0}),
            (a.viscous_thickness, {"air": a.air_at(20.0), "frequency": 42e3}),
            (shear_modulus_from_shore, {"shore_a": 35.0}),
            (Tube, tube),
        ],
    )  # fmt: skip


def _of_estimation() -> dict[str, Spec]:
    from acoustube import estimation as e
    from acoustube.recordings.echotube_stream import Decoder
    from acoustube.signals import Processing

    values, groups = np.linspace(0, 1, 20), np.arange(20) // 2
    features = {"kind": "echo", "processing": Processing(), "radius": 3.95e-3}
    return named_specs(
        "estimation",
        [
            (e.errors, {"truth": values, "estimate": values, "half_width": values + 1}, True),
            (e.bins, {"values": values, "width": 0.1}, True),
            (e.folds, {"groups": groups, "count": 3, "seed": 0}),
            (e.split, {"groups": groups, "share": 0.2, "seed": 0}),
            (e.FeatureSettings, features),
            (Decoder, {"frame_bytes": 2000}),
        ],
    )


def _of_walls() -> dict[str, Spec]:
    from acoustube import lumen as w
    from acoustube.indentation import USUAL_MESH, Indenter, Layer, MeshSize
    from acoustube.runs.sweep.cycles import Recipe

    turn = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    z = np.linspace(0, 0.05, 6)
    ring = np.stack([np.cos(turn), np.sin(turn), 0 * turn], -1)
    rings = 4e-3 * ring + z[:, None, None] * [0, 0, 1]
    line = np.stack([0 * z, 0 * z, z], -1)
    return named_specs(
        "walls",
        [
            (w.ring_faces, {"n_rings": 6, "n_around": 12}),
            (w.decimate_rings, {"inner": rings, "outer": 1.4 * rings}),
            (w.straighten, {"points": rings, "line": line}),
            (w.profile, {"vertices": rings.reshape(-1, 3), "triangles": w.ring_faces(6, 12),
                         "z": np.linspace(0.01, 0.04, 3)}),
            (Indenter, {f.name: f.default for f in dataclasses.fields(Indenter)}),
            (Layer, {"thickness": 0.01, "modulus": 1e5}),
            (MeshSize, dataclasses.asdict(USUAL_MESH)),
            (Recipe, {"n_cycles": 50, "n_tubes": 1, "n_sessions": 1, "seed": 0}),
        ],
    )  # fmt: skip
