"""Presses by force, against the load path of the interpolation and a rigid floor."""

import dataclasses

import numpy as np
import pytest
from refusals import refused

from acoustube.base.errors import ConfigError, SimulationError
from acoustube.indentation import Indenter, Layer, MeshSize, indent
from acoustube.runs.by_force import by_force
from acoustube.tube import Tube

COARSE = MeshSize(through_wall=1, around=12, along=10)
ARM = Layer(thickness=20e-3, modulus=60e3)


def pressed(depth, layer=None):
    return indent(
        Tube(), Indenter(diameter=25e-3), depth=depth, support="free", layer=layer, mesh=COARSE
    )


@pytest.fixture(scope="module")
def on_an_arm():
    return pressed([2e-3, 4e-3, 6e-3], ARM)


@pytest.fixture(scope="module")
def on_a_floor():
    return pressed([1e-3, 2e-3, 3e-3])


def test_forces_of_the_path_give_back_its_depths(on_an_arm):
    """Depths at the path's own forces, the nodes of the interpolant, agree to rounding."""
    found = by_force(on_an_arm, on_an_arm.contact_force)
    assert found.depth == pytest.approx(on_an_arm.depth, abs=1e-12)


def test_press_solved_at_the_depth_that_a_force_gives_bears_it_within_the_stated_error(on_an_arm):
    """A press to the interpolated depth for 1.3 N has this force within the estimate.

    The estimate is at most 3e-3 of the force, by which forces fluctuate with the contact points.
    """
    found = by_force(on_an_arm, 1.3)
    assert float(found.depth) not in on_an_arm.depth
    assert 0 < float(found.force_error) < 3e-3 * 1.3
    force = pressed([float(found.depth)], ARM).contact_force[-1]
    assert abs(force - 1.3) < float(found.force_error)


def test_error_is_zero_at_rows_and_forces_keep_their_order_and_shape(on_an_arm):
    """Forces in any order, some repeated: each result is that of its force alone."""
    force = np.array([[1.3, 0.4, on_an_arm.contact_force[5]], [0.0, 1.3, 0.9]])
    found = by_force(on_an_arm, force)
    for name in ("depth", "closing", "sinking", "lumen_area", "force_error"):
        values = getattr(found, name)
        assert values.shape == force.shape
        assert values[0, 0] == values[1, 1] == float(getattr(by_force(on_an_arm, 1.3), name))
    assert found.force_error[0, 2] == found.force_error[1, 0] == 0
    assert found.depth[1, 0] == found.closing[1, 0] == 0


def test_travel_is_closing_and_sinking_and_a_little_of_the_wall(on_an_arm):
    """Depth less closing and sinking is the wall's compression, at most a fifth of it.

    The wall under the tool and the wall over the ground are each compressed by less than a tenth.
    """
    found = by_force(on_an_arm, [0.5, 1.0, 1.5, 2.0])
    squeezed = found.depth - found.closing - found.sinking
    assert np.all((squeezed > 0) & (squeezed < 0.2 * Tube().wall_thickness))
    assert np.all(found.sinking > 0.15 * found.depth)


@pytest.mark.slow
def test_stiff_layer_is_a_rigid_floor(on_a_floor):
    """A press on a layer of 0.5 GPa is compared with one on a rigid floor.

    The layer yields by a micrometre; 0.3 % is the effect of the contact's smoothing.
    """
    stiff = pressed([1e-3, 2e-3, 3e-3], Layer(thickness=5e-3, modulus=0.5e9))
    forces = [0.3, 0.7, 1.1]
    here, there = by_force(stiff, forces), by_force(on_a_floor, forces)
    for name in ("depth", "closing", "lumen_area"):
        assert getattr(here, name) == pytest.approx(getattr(there, name), rel=3e-3)
    assert np.all(np.abs(here.sinking) < 5e-6)


def test_soft_arm_takes_more_travel_and_less_of_the_lumen(on_an_arm, on_a_floor):
    """At the same force the tool travels farther on a soft ground and closes the lumen less.

    The ground yields, and supports the tube over a greater length.
    """
    soft, hard = by_force(on_an_arm, 1.0), by_force(on_a_floor, 1.0)
    assert soft.depth > 1.5 * hard.depth
    assert 0.6 * hard.closing < soft.closing < hard.closing


def test_forces_beyond_the_path_are_refused(on_a_floor):
    for force in (-0.1, [0.5, 9.0]):
        refused(lambda force=force: by_force(on_a_floor, force), setting="force")


def test_force_that_falls_is_refused(on_a_floor):
    force = on_a_floor.press_force.copy()
    force[-2] *= 0.8
    with pytest.raises(SimulationError, match="depth is not a unique function of force"):
        by_force(dataclasses.replace(on_a_floor, press_force=force), 0.5)


def test_depths_too_far_apart_are_refused(on_a_floor):
    """A press guided by a coarse mesh has rows at the requested depths only, here 3 mm apart."""
    rows = [0, len(on_a_floor.depth) - 1]
    results = {name: values[rows] for name, values in on_a_floor.results.items()}
    with pytest.raises(ConfigError, match=r"depths 3 mm apart.*at most 0\.658 mm apart"):
        by_force(dataclasses.replace(on_a_floor, **results), 0.5)
