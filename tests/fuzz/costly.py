"""Public functions that compute for long, called up to the start of the computation."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from tests.fuzz.corpus import recording
from tests.fuzz.functions import Spec, named_specs, up_to

PRESS = "acoustube.indentation.press"


@cache
def _press() -> tuple[Any, Any]:
    """Return a press of a coarse tube, with two made-up increments, and the size of its mesh.

    It needs no JAX, whose threads would not survive the forks of the cases.
    """
    from acoustube.indentation import Indentation, Indenter, MeshSize
    from acoustube.indentation.mesh import sweep
    from acoustube.indentation.press import neo_hookean_wall
    from acoustube.tube import Tube

    tube, tool = Tube(), Indenter(diameter=25e-3)
    size = MeshSize(around=8, through_wall=1, along=6)
    mesh = sweep(tube, 57e-3, size, halved=(True, True), presses=[0.0])
    one, none = np.ones(2), np.zeros(2)
    press = Indentation(
        tube=tube, indenters=(tool,), support="held", layer=None, mesh=mesh,
        material=neo_hookean_wall(tube), depth=none, displacement=np.zeros((2, *mesh.points.shape)),
        iterations=np.zeros(2, int), residual=none, press_force=np.zeros((2, 1)),
        contact_area=np.zeros((2, 1)), energy=none, smallest_volume_ratio=one, smallest_gap=one,
        touch_heights=(float(mesh.points[:, 1].max()),), barrier_distance=1e-5,
    )  # fmt: skip
    return press, size


def of_presses() -> dict[str, Spec]:
    """Return the functions of presses and of their lumens."""
    from acoustube import indentation as i
    from acoustube import lumen as w

    press, size = _press()
    given = {
        "tube": press.tube, "indenter": press.indenters[0], "support": "held", "layer": None,
        "mesh": size,
    }  # fmt: skip
    one = {"indentation": press, "increment": -1}
    part = w.pressed_part(press)
    return named_specs(
        "press",
        [
            (
                up_to(i.indent, f"{PRESS}:load_path", f"{PRESS}:_guide"),
                {**given, "depth": 2e-3, "whole": False, "barrier_distance": 1e-5},
            ),
            (i.restored, {**given, "results": press.results}, True),
            (w.deformed_wall, {**one, "outer": False}),
            (w.lumen, {**one, "position": 0.2}),
            (w.pressed_part, one),
            (w.whole_tube, {"part": part, "position": 1.0, "length": 2.5}),
            (w.measure, {**one, "z": np.linspace(0, 0.01, 4)}, True),  # nan beyond an end
            (w.inner_wall, {"mesh": press.mesh}),
        ],
    )


def of_fields() -> dict[str, Spec]:
    """Return the functions of sound fields."""
    import trimesh

    from acoustube import ranging as r
    from acoustube import waves as w
    from acoustube.air import air_at
    from acoustube.ranging import rangefinder

    surface = trimesh.creation.cylinder(radius=3.95e-3, height=0.02, sections=16)
    surface.apply_translation((0, 0, 0.01))
    cells, air = w.cut_cells(surface, 1e-3), air_at(20.0)
    field = {"cells": cells, "air": air}
    propagation, scattering = "acoustube.waves.propagation", "acoustube.waves.scattering"
    bore = {"radius": 3.95e-3, "length": 1.0}
    press = [r.blockage(np.array([28e3, 56e3]), 0.5)]
    return named_specs(
        "fields",
        [
            (w.cut_cells, {"surface": surface, "spacing": 1e-3, "half": False}),
            (w.section_cut_ons, {"cells": cells, "layer": 2, "sound_speed": 343.0, "n_modes": 3}),
            (w.stable_step, field),
            (
                w.error_budget,
                {**field, "frequency": 42e3, "highest": 50e3, "radius": 3.95e-3, "lossy": True,
                 "time_step": 1e-6, "pressure": recording()["signal"]},
            ),
            (
                up_to(w.propagate, f"{propagation}:prepare"),
                {**field, "pulse": w.Pulse(frequency=42e3), "duration": 1e-3, "probes": (0.01,),
                 "source_end": "release", "source_mode": "00", "far_end": "absorbing",
                 "absorber_thickness": 0.02, "time_step": 1e-6, "lossy_band": (20e3, 60e3)},
            ),
            (
                up_to(w.scatter, f"{scattering}:straight_ends_cut"),
                {**field, "frequency": np.arange(10e3, 20e3, 1e3), "reference": (0.0, 0.0),
                 "lossy": True, "symmetric": None, "symmetric_only": False, "longest": 5e-3,
                 "absorber_thickness": 0.01},
            ),
            (
                r.digitise,
                {"voltage": np.linspace(-1, 1, 50), "rangefinder": rangefinder.Rangefinder(),
                 "cycles": np.arange(3), "seed": 0, "session_seed": 0},
            ),
            (
                r.clutter,
                {"presses": press, "air": air, "frequency": np.arange(30e3, 55e3, 5e3), **bore,
                 "density": 1e-4, "tube_seed": 0},
            ),
        ],
    )  # fmt: skip


def of_estimators() -> dict[str, Spec]:
    """Return the functions of estimators, and of settings, plans and results."""
    import xarray as xr

    import acoustube as a
    from acoustube import estimation as e
    from acoustube.runs.sweep.cycles import Recipe

    arrays = recording()
    cycles = xr.Dataset(
        {"signal": (("cycle", "time"), arrays["signal"]), "force": ("cycle", arrays["force"])},
        {"time": np.arange(1200) / 200e3},
    ).assign(temperature=("cycle", arrays["temperature"]))
    settings = e.FeatureSettings()
    row = np.linspace(0, 1, 60)
    rows = {"X": np.stack([row, 1 - row], 1), "y": row, "groups": np.arange(60) // 2}
    table = xr.Dataset(
        {"features": (("cycle", "feature"), rows["X"]), "force": ("cycle", row)},
        {"feature": ["amplitude", "distance"]}, {"sampling_rate": 200e3},
    )  # fmt: skip
    network = "acoustube.estimation.network:train"

    def fit(name: str) -> Any:
        make = {"boosting": e.Boosting, "echo": e.EchoEnsemble, "network": e.ForceNetwork}[name]
        places = ["acoustube.estimation.boosting:export_trees"] if name == "boosting" else [network]

        def fitted(X: Any, y: Any, groups: Any, **given: Any) -> Any:
            return make(**given).fit(X, y, groups)

        fitted.__name__ = f"{name}.fit"
        return up_to(fitted, *places)

    common = {**rows, "n_folds": 2, "seed": 0}
    epochs = {"epochs": 1, "batch_size": 32, "learning_rate": 1e-3}
    return named_specs(
        "estimators",
        [
            (e.feature_table, {"cycles": cycles, "settings": settings}, True),
            (
                up_to(e.train, network),
                {"table": table, "name": "network", "feature_settings": settings, "by": "cycle",
                 "seed": 0},
            ),
            (fit("network"), {**common, **epochs}),
            (fit("echo"), {**common, **epochs}),
            (
                fit("boosting"),
                {**common, "max_iter": 1, "learning_rate": 0.1, "max_leaf_nodes": 2},
            ),
            (a.load_config, {"path": None, "depth_mm": 3.0}),
            (a.load_plan, {"path": None, "over": {"depth_mm": ["1:2"]}, "count": 2, "seed": 0}),
            (
                up_to(a.run_sweep, "acoustube.runs.sweep.run:cases_of"),
                {"plan": a.load_plan(over={"depth_mm": ["1"]}), "out": "o", "share": (1, 1),
                 "retry": False},
            ),
            (
                up_to(a.run_dataset, "acoustube.runs.sweep.dataset:_parts"),
                {"sweep": [], "out": "o", "recipe": Recipe()},
            ),
            (up_to(a.pressed, "acoustube.runs.presses:press_to"),
             {"config": a.Mechanics(), "depths": [1e-3]}),
            (up_to(a.simulate, "acoustube.runs.simulate:press_to"), {"config": a.Config()}),
        ],
    )  # fmt: skip
