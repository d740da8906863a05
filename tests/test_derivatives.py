"""Derivatives of force and area by design parameters, against equilibria of changed designs."""

import dataclasses
from functools import cache

import jax
import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from acoustube.base.errors import ConfigError
from acoustube.base.limits import pressed_reach
from acoustube.indentation import Indenter, Layer, MeshSize, indent
from acoustube.indentation.assembly import indenter_force
from acoustube.indentation.derivatives import Design, derivatives
from acoustube.indentation.material import Material, mooney_rivlin
from acoustube.indentation.mesh import sweep
from acoustube.indentation.newton import minimise
from acoustube.indentation.press import first_touch, neo_hookean_wall, press_model
from acoustube.lumen import measure
from acoustube.tube import Tube

pytestmark = pytest.mark.slow

SIZE = MeshSize(through_wall=1, around=8, along=8)
STEP = 1e-5


@cache
def closed(shape, support):
    """Return a press with rows at 4, 7.9 and 8.1 mm; this coarse tube is closed from 7.9 mm."""
    tool = Indenter(shape=shape, diameter=25e-3)
    return indent(Tube(), tool, depth=[4e-3, 7.9e-3, 8.1e-3], support=support, mesh=SIZE)


def settled(indentation, increment, design):
    """Return force and area of a changed design, by Newton's method to round-off."""
    tube = dataclasses.replace(
        indentation.tube,
        shear_modulus=design.shear_modulus,
        wall_thickness=design.wall_thickness,
        inner_diameter=design.inner_diameter,
    )
    tool = dataclasses.replace(indentation.indenters[0], diameter=design.indenter_diameter)
    with jax.enable_x64(True), threadpool_limits(1, user_api="blas"):
        changed = first_touch(
            tube,
            (tool,),
            support=indentation.support,
            layer=None,
            material=neo_hookean_wall(tube),
            mesh=sweep(tube, pressed_reach(tube.outer_diameter, tool.diameter), SIZE),
            barrier_distance=indentation.barrier_distance,
        )
        changed = dataclasses.replace(changed, depth=indentation.depth[[increment]])
        model, bodies = press_model(changed), changed.bodies(0)
        tolerance = 1e-11 * tube.shear_modulus * tube.inner_diameter**2
        found = minimise(model, indentation.displacement[increment], bodies, tolerance)
        assert found.converged, found.reason
        changed = dataclasses.replace(changed, displacement=found.displacement[None])
        force = indenter_force(model, found.displacement, bodies[0])
    return np.array([force, measure(changed, 0, np.zeros(1)).area[0]])


@pytest.mark.parametrize(
    ("shape", "support", "depth_mm"),
    [
        pytest.param("rod", "free", 4.0, marks=pytest.mark.long),
        pytest.param("rod", "free", 7.9, marks=pytest.mark.long),
        pytest.param("rod", "held", 8.1, marks=pytest.mark.long),
        pytest.param("sphere", "held", 4.0, marks=pytest.mark.long),
    ],
)
def test_derivatives_are_those_of_central_differences(shape, support, depth_mm):
    """Compared with differences of the fourth order over steps of 1e-5, within 1e-4.

    Such a step moves a wall by less than the width of a contact's onset; at 7.9 mm the force bends
    by 3e-4 within it. At 7.9 and 8.1 mm the lumen is closed and its walls press on each other. By
    dimensional analysis the area does not depend on the modulus: there 1e-4 of area per modulus is
    allowed.
    """
    indentation = closed(shape, support)
    (increment,) = np.flatnonzero(indentation.depth == 1e-3 * depth_mm)
    assert indentation.closed[increment] == (depth_mm > 7)
    found = derivatives(indentation, increment)
    tube = indentation.tube
    base = Design(tube.shear_modulus, tube.wall_thickness, tube.inner_diameter, 25e-3)
    scale = settled(indentation, increment, base)
    for name, value in base._asdict().items():
        far, near = (
            settled(indentation, increment, base._replace(**{name: value * (1 + s * STEP)}))
            - settled(indentation, increment, base._replace(**{name: value * (1 - s * STEP)}))
            for s in (2, 1)
        )
        expected = (8 * near - far) / (12 * STEP * value)
        force, area = (getattr(result, name) for result in found)
        assert force == pytest.approx(expected[0], rel=1e-4)
        if name == "shear_modulus":
            assert abs(area) < 1e-4 * scale[1] / value
        else:
            assert area == pytest.approx(expected[1], rel=1e-4, abs=1e-6 * scale[1] / value)


def test_derivatives_along_a_line_through_the_designs_are_those_of_differences():
    """All parameters change at once, for a closed lumen under a rod; within 1e-4 of the sum.

    Each term makes the tube stiffer, so that none cancels another. The tool's diameter matters
    least and has the largest weight: an error of a hundredth in any term is detected, except in the
    area's derivative by the modulus, which is zero.
    """
    weights = Design(0.1, 0.1, -0.1, 1.0)
    indentation = closed("rod", "held")
    increment = len(indentation.depth) - 1
    assert indentation.closed[increment]
    found = derivatives(indentation, increment)
    tube = indentation.tube
    base = Design(tube.shear_modulus, tube.wall_thickness, tube.inner_diameter, 25e-3)

    def along(s):
        moved = (value * (1 + s * STEP * w) for value, w in zip(base, weights, strict=True))
        return settled(indentation, increment, Design(*moved))

    expected = (8 * (along(1) - along(-1)) - (along(2) - along(-2))) / (12 * STEP)
    for result, difference in zip(found, expected, strict=True):
        parts = [slope * value * w for slope, value, w in zip(result, base, weights, strict=True)]
        assert sum(parts) == pytest.approx(difference, rel=1e-4)


@pytest.mark.long
def test_force_is_proportional_to_the_modulus():
    """F = mu f(shape): dF/dmu = F / mu, to Newton's tolerance."""
    indentation = closed("rod", "free")
    found = derivatives(indentation)
    expected = indentation.contact_force[-1] / indentation.tube.shear_modulus
    assert found.contact_force.shear_modulus == pytest.approx(expected, rel=1e-6)


def test_what_cannot_be_differentiated_is_refused():
    press = closed("rod", "held")
    tube = press.tube
    whole = sweep(tube, 30e-3, SIZE, halved=(True, False))
    with pytest.raises(ConfigError, match="must be symmetric about z = 0"):
        derivatives(dataclasses.replace(press, mesh=whole))
    with jax.enable_x64(True):
        half = np.float64(tube.shear_modulus / 4)
        material = Material(jax.tree_util.Partial(mooney_rivlin, half, half), tube.bulk_modulus)
    with pytest.raises(ConfigError, match="Neo-Hookean"):
        derivatives(dataclasses.replace(press, material=material))


@pytest.mark.long
def test_length_of_the_mesh_and_a_layer_are_part_of_the_design():
    """dF/dmu = F / mu on a longer piece; a thicker wall on a layer, by a new equilibrium."""
    tube, tool = Tube(), Indenter(diameter=25e-3)
    longer = sweep(tube, 80e-3, SIZE)
    press = indent(tube, tool, depth=5e-4, support="free", mesh=longer)
    found = derivatives(press).contact_force.shear_modulus
    assert found == pytest.approx(press.contact_force[-1] / tube.shear_modulus, rel=1e-6)

    soft = Layer(thickness=5e-3, modulus=1e5)
    step = 1e-4 * tube.wall_thickness
    forces = []
    for wall in (tube.wall_thickness + step, tube.wall_thickness - step):
        other = dataclasses.replace(tube, wall_thickness=wall)
        pressed = indent(other, tool, depth=5e-4, support="free", layer=soft, mesh=SIZE)
        forces.append(pressed.contact_force[-1])
    press = indent(tube, tool, depth=5e-4, support="free", layer=soft, mesh=SIZE)
    found = derivatives(press).contact_force.wall_thickness
    # Newton's method leaves 1e-5 of each force, and the two differ by 3e-4 of it.
    assert (forces[0] - forces[1]) / (2 * step) == pytest.approx(found, rel=0.05)
