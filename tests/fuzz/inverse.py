"""Public functions of the inversion of echoes and of twins."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from tests.fuzz.functions import Spec, named_specs, up_to


def made_tool() -> dict[str, Any]:
    """Return the fields of a tool whose reflection grows with depth."""
    depth, frequency = np.linspace(1e-3, 4e-3, 5), np.arange(33.6e3, 50.4e3, 200.0)
    s = np.ones((5, frequency.size, 2, 1, 2, 1), complex) * depth[:, None, None, None, None, None]
    return {
        "shape": "rod", "diameter": 25e-3, "radius": 3.95e-3, "depth": depth,
        "force": 1e3 * depth, "force_error": 0.1 * depth, "frequency": frequency,
        "modes": ("00",), "s": 100 * s, "error": depth, "interpolation_error": depth[1:],
        "sound_speed": 343.0, "young_modulus": 1e6, "poisson_ratio": 0.49, "stiffness_error": 0.1,
    }  # fmt: skip


def of_inversions() -> dict[str, Spec]:
    """Return the functions of the inversion: forward model, posterior, tracking of contacts."""
    from acoustube import inversion as i
    from acoustube.ranging import Rangefinder

    fields = made_tool()
    tool = i.Tool(**fields)
    library, rangefinder = i.Library((tool,)), Rangefinder(n_samples=1600)
    given = {"rangefinder": rangefinder, "radius": 3.95e-3, "length": 0.5, "temperature": 20.0,
             "modes": ("00",), "n_samples": 1600}  # fmt: skip
    base = i.Baseband(**given)
    model = i.ForwardModel(library, base)
    counts = 2048 + 20 * np.sin(np.arange(4800.0).reshape(3, 1600) ** 2)
    at = {"depth": 2e-3}
    follow = up_to(i.ContactTracker(model).update, "acoustube.inversion.tracking:Cycle")
    return named_specs(
        "inversion",
        [
            (i.Tool, fields, True),
            (i.Library, {"tools": (tool,)}),
            (library.with_young_modulus, {"value": 2e6, "deviation": 1e5}),
            (tool.matrix, {**at, "derivative": 1}, True),
            (tool.force_at, {**at, "derivative": 0}, True),
            (tool.force_deviation, at, True),
            (i.Priors, {f.name: f.default for f in dataclasses.fields(i.Priors)}),
            (i.Motion, {f.name: f.default for f in dataclasses.fields(i.Motion)}),
            (i.Wrap, {"place": np.array([0.1, 0.3]), "curvature": np.array([25.0, 24.0]),
                      "torsion": np.array([3.0, 3.0]), "ovality": 0.0, "reach": 0.03}),
            (i.Baseband, given),
            (i.baseband_of, given),
            (i.ForwardModel, {"library": library, "base": base, "clutter": None, "priors": None}),
            (i.unknown_clutter, {"base": base}),
            (i.measured_clutter, {"base": base, "counts": counts, "at": base}),
            (i.Inverter, {"model": model, "most": 1}),
            (base.of_cycles, {"counts": counts}),
            (i.ContactTracker, {"model": model, "most": 1, "motion": None, "cycle_rate": 10.0}),
            (follow, {"counts": counts[0], "elapsed": 0.1}),
        ],
    )  # fmt: skip


def of_twins() -> dict[str, Spec]:
    """Return the functions that fit a twin, up to where their computation begins."""
    from acoustube.inversion import Tool, twin

    cycles = np.arange(400.0).reshape(2, 200)
    group = {"cycles": cycles, "temperature": 20.0, "place": 0.5, "source": "a.npz"}
    one = twin.Group(**group)
    press = twin.Press(Tool(**made_tool()), 2e-3, 1e-4, 2e-3, 4.0)
    return named_specs(
        "twin",
        [
            (twin.Group, group, True),
            (twin.Band, {"rate": 200e3, "start": 0.0, "n_samples": 2000, "carrier": 42e3,
                         "clear": 1e-3}),
            (
                up_to(twin.fit_twin, "acoustube.inversion.twin.estimate:band_of"),
                {"closed": [one], "untouched": one, "rate": 200e3, "start": 0.0, "length": 2.0,
                 "humidity": 50.0},
            ),
            (
                up_to(twin.fit_material, "acoustube.inversion.twin.material:_ground"),
                {"presses": [press]},
            ),
        ],
    )  # fmt: skip
