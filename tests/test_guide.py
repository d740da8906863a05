"""The guide of a press: interpolation between meshes, and the states of guided presses."""

import dataclasses

import numpy as np
import pytest

from acoustube.indentation import Indenter, MeshSize, PressError, indent, load_path, press
from acoustube.indentation.guide import coarse_mesh, prolongation
from acoustube.indentation.mesh import sweep
from acoustube.tube import Tube

REACH = 60e-3
FINE = MeshSize(through_wall=2, around=12, along=10)
TOOLS = (Indenter(),)


@pytest.mark.parametrize("halved", [(True, True), (False, True), (True, False), (False, False)])
def test_interpolation_between_meshes_gives_the_place_of_every_node(halved):
    """Nodes are exact along the tube and at coarse nodes; across they are right to 5e-3 radii.

    Measured 4e-3: the widest of twelve quadratic elements per half turn are that far from the
    circle.
    """
    size = MeshSize(through_wall=1, around=12, along=10)
    coarse, fine = (
        sweep(Tube(), REACH, each, halved=halved)
        for each in (size, MeshSize(through_wall=3, around=17, along=13, inner=0.5))
    )
    found = prolongation(coarse, fine) @ coarse.points
    assert found[:, 2] == pytest.approx(fine.points[:, 2], abs=1e-9 * REACH)
    assert np.abs(found - fine.points).max() < 5e-3 * Tube().outer_diameter / 2
    own = prolongation(coarse, coarse)
    assert abs(own @ coarse.points - coarse.points).max() < 1e-9 * REACH


def test_coarse_mesh_is_of_the_same_part_and_only_where_it_saves_time():
    """There is none for a mesh with as few elements, nor for one that was not swept."""
    fine = sweep(Tube(), REACH, FINE, halved=(False, True))
    coarse = coarse_mesh(fine, Tube(), TOOLS)
    assert coarse.halved == fine.halved
    assert coarse.points[:, 2].max() == fine.points[:, 2].max()
    assert len(fine.elements) >= 2 * len(coarse.elements)
    assert coarse_mesh(coarse, Tube(), TOOLS) is None


@pytest.mark.slow
def test_guided_press_ends_in_the_state_of_a_path_on_its_own_mesh(monkeypatch):
    """At 1 and 2 mm, free, to Newton's tolerance; there are no other rows."""
    depths = [1e-3, 2e-3]
    guided = indent(Tube(), TOOLS, depth=depths, support="free", mesh=FINE)
    assert list(guided.depth) == [0.0, *depths]
    monkeypatch.setattr(press, "coarse_mesh", lambda *_: None)
    alone = indent(Tube(), TOOLS, depth=depths, support="free", mesh=FINE)
    assert len(alone.depth) > 6
    rows = alone.rows_at(depths)
    assert guided.contact_force[1:] == pytest.approx(alone.contact_force[rows], rel=2e-5)
    assert np.abs(guided.displacement[1:] - alone.displacement[rows]).max() < 1e-7


@pytest.mark.slow
def test_press_goes_on_alone_where_its_guide_ends(monkeypatch):
    """The guide stops at 0.3 mm; the requested depths are reached without it."""
    limit, solve = 0.3e-3, load_path.minimise
    lowest, sizes = Tube().outer_diameter / 2 - limit, set()

    def blocked(model, start, bodies, tolerance):
        sizes.add(len(model.mesh.elements))
        result = solve(model, start, bodies, tolerance)
        coarse = len(model.mesh.elements) < 200
        if coarse and bodies[0].height < lowest:
            return dataclasses.replace(result, converged=False, reason="buckling")
        return result

    monkeypatch.setattr(load_path, "minimise", blocked)
    found = indent(Tube(), TOOLS, depth=0.6e-3, support="free", mesh=FINE)
    assert sizes == {120, 240}
    assert found.depth[-1] == 0.6e-3
    assert found.depth[1] == pytest.approx(limit, rel=0.01)


def test_press_whose_guide_cannot_start_reports_first_contact(monkeypatch):
    """Without iterations of Newton's method the press ends at first contact, and reports it."""
    monkeypatch.setattr(load_path, "SMALLEST_INCREMENT", load_path.FIRST_INCREMENT)
    monkeypatch.setattr("acoustube.indentation.newton.MAX_ITERATIONS", 0)
    with pytest.raises(PressError, match=r"depth of 0\.00 mm of 1\.00 mm"):
        indent(Tube(), TOOLS, depth=1e-3, mesh=FINE)
