"""Users' settings are converted to SI units in one place."""

import ast
import dataclasses
import math
from pathlib import Path

import pytest

import acoustube
from acoustube.indentation import Indenter, Layer
from acoustube.runs.config import load_config
from acoustube.runs.config.si import SIPress, press_in_si, settings_in_si
from acoustube.tube import Tube

SUFFIXES = ("_mm", "_cm", "_khz", "_kpa", "_mpa", "_deg")


def test_settings_become_si_in_one_object():
    """Powers of ten by hand; defaults that follow from other settings are filled in."""
    config = load_config(
        inner_diameter_mm=8, wall_mm=1.5, length_cm=60, shear_modulus_mpa=0.4, indenter_mm=20,
        depth_mm=3, steps=3, yaw_deg=30, support="free", layer_mm=5, layer_mpa=0.1,
        frequency_khz=18, pressure_kpa=90, probe_cm=2.5, losses="on",
    )  # fmt: skip
    found = settings_in_si(config)
    tube = Tube(inner_diameter=8e-3, wall_thickness=1.5e-3, length=0.6, shear_modulus=0.4e6)
    assert dataclasses.astuple(found.tube) == pytest.approx(dataclasses.astuple(tube), rel=1e-15)
    assert found.indenter == Indenter(diameter=20e-3, yaw=math.radians(30))
    assert found.layer == Layer(thickness=5e-3, modulus=1e5)
    assert found.depth == 3e-3
    assert found.depths == pytest.approx((1e-3, 2e-3, 3e-3), rel=1e-15)
    assert (found.position, found.probe, found.cutoff) == (0.3, 0.025, 9e3)
    assert (found.pulse.frequency, found.pressure, found.lossy) == (18e3, 90e3, True)
    shared = {field.name: getattr(found, field.name) for field in dataclasses.fields(SIPress)}
    assert press_in_si(config) == SIPress(**shared)


def _scaled_settings(path):
    """Yield the lines of a module in which a setting with a unit in its name is scaled."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult | ast.Div):
            for side in (node.left, node.right):
                if isinstance(side, ast.Attribute) and side.attr.endswith(SUFFIXES):
                    yield f"{path.name}:{node.lineno} {ast.unparse(node)}"


def test_no_other_module_converts_settings():
    root = Path(acoustube.__file__).parent
    modules = [p for p in root.rglob("*.py") if p.parent != root / "runs" / "config"]
    assert len(modules) > 100
    assert not [line for module in modules for line in _scaled_settings(module)]
    assert list(_scaled_settings(root / "runs" / "config" / "si.py"))
