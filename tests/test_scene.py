"""The drawing of a run: the tool, its position, and the ground."""

import json

import jax
import numpy as np
import pytest
import xarray as xr

from acoustube.indentation import Indenter
from acoustube.reports.scenes import offscreen
from acoustube.reports.scenes import tube as scene
from acoustube.runs.config import Mechanics, load_config

RADIUS, WALL, REACH = 5.55e-3, 1.6e-3, 40e-3


def rings(radius, sink=0.0):
    """Rings of a round tube of 120 points each, from the bottom on, lowered in the middle."""
    angle = np.linspace(0, 2 * np.pi, 120, endpoint=False)
    z = np.linspace(-REACH, REACH, 161)
    shape = (len(z), len(angle))
    y = -radius * np.cos(angle) - sink * np.exp(-((z[:, None] / 8e-3) ** 2))
    return np.stack(
        [np.broadcast_to(radius * np.sin(angle), shape), y, np.broadcast_to(z[:, None], shape)], -1
    )


PRESSES = [
    Indenter(diameter=25e-3),
    Indenter(diameter=25e-3, yaw=0.5),
    Indenter(diameter=25e-3, yaw=-0.5),
    Indenter(shape="sphere", diameter=20e-3),
    Indenter(shape="sphere", diameter=20e-3, x=-3e-3),
    Indenter(shape="punch", diameter=8e-3, x=2e-3),
    Indenter(shape="punch", diameter=8e-3, x=-2e-3),
]


@pytest.mark.parametrize("press", PRESSES, ids=lambda p: f"{p.shape} {p.x:g} {p.yaw:g}")
def test_tool_is_drawn_behind_the_cut_where_it_touches_the_wall(press):
    """The solver's distance to the tool is zero on the drawn tool, and not negative on the wall."""
    outer = rings(RADIUS)
    points, faces = scene.tool_behind(press, outer)
    assert points[:, 0].min() >= -1e-12
    assert faces.max() < len(points)
    distance, up = jax.vmap(press.gap()), np.array([0.0, 1.0, 0.0])
    if press.shape == "punch":
        height = points[:, 1].min()
    else:
        across = points[:, 2] * np.cos(press.yaw) - points[:, 0] * np.sin(press.yaw)
        off = across if press.shape == "rod" else np.hypot(points[:, 0] - press.x, points[:, 2])
        radius = press.diameter / 2
        height = np.median(points[:, 1] - radius + np.sqrt(np.maximum(radius**2 - off**2, 0.0)))
    assert distance(outer.reshape(-1, 3) - height * up).min() == pytest.approx(0, abs=1e-6)
    on_tool = np.asarray(distance(points - height * up))
    assert on_tool.max() < 1e-6  # the cut and the top are within it
    assert np.mean(np.abs(on_tool) < 1e-6) > 0.3


def test_layer_yields_to_the_tube_and_is_flat_beside_it():
    outer = rings(RADIUS, sink=1e-3)
    top, front = scene.layer_sheets(outer, (-4e-3, 15e-3), REACH, -9e-3)
    middle = np.argmin(np.abs(top[:, 0, 2]))
    assert top[middle, :, 1].min() == pytest.approx(-RADIUS - 1e-3, abs=2e-5)
    assert top[:, -1, 1] == pytest.approx(-RADIUS, abs=2e-5)
    assert top[[0, -1], :, 1] == pytest.approx(-RADIUS, abs=2e-5)
    assert front[1, :, 1] == pytest.approx(-9e-3)
    assert front[..., 0] == pytest.approx(-4e-3)  # towards the viewer


@pytest.mark.slow
@pytest.mark.long
def test_drawing_of_a_run_shows_what_its_settings_say():
    """The pictures of a rod, a yawed rod, a sphere, a punch and a layer all differ."""
    along = np.array([0.0, 0.0, REACH])
    wall = rings(RADIUS) + along
    thinner = rings(RADIUS - WALL) + along
    walls = {"outer_wall": wall, "inner_wall": thinner}
    pictures = []
    for settings in (
        {},
        {"yaw_deg": 30},
        {"shape": "sphere"},
        {"shape": "punch", "indenter_mm": 8, "offset_mm": 2},
        {"support": "free", "layer_mm": 5, "layer_mpa": 0.1},
    ):
        config = load_config(None, Mechanics, **settings)
        parts = {name: vars(getattr(config, name)) for name in ("tube", "indentation")}
        data = xr.Dataset(
            {name: (("ring", "around", "xyz"), points) for name, points in walls.items()}
            | {"true_distance": REACH},
            attrs={"configuration": json.dumps(parts)},
        )
        with scene.drawing(data) as drawn:
            images = drawn()
        assert images is not None
        pictures.append(images["close_up"].astype(int))
    for i, one in enumerate(pictures):
        for other in pictures[:i]:
            assert np.mean(np.abs(one - other).max(axis=-1) > 20) > 0.005


def test_distance_grows_to_the_right_in_the_strip():
    """The wall of a tube dented at a quarter of its length has the fewest pixels there."""
    dent = 2e-3 * np.exp(-(((np.linspace(-REACH, REACH, 161) + REACH / 2) / 6e-3) ** 2))
    walls = {}
    for name, radius in (("outer_wall", RADIUS), ("inner_wall", RADIUS - WALL)):
        wall = (rings(radius) + np.array([0.0, 0.0, REACH])) * [1.0, 1.0, 5.0]
        wall[..., 1] -= dent[:, None] * (wall[..., 1] > 0) * 2
        walls[name] = (("ring", "around", "xyz"), wall)
    with offscreen.rendering({"strip": scene.strip(scene.half_walls(xr.Dataset(walls)))}) as drawn:
        images = drawn()
    assert images is not None
    image = images["strip"].astype(int)
    tall = (np.abs(image - image[0, 0]).max(axis=-1) > 20).sum(axis=0)
    assert 0.2 < np.argmin(np.where(tall > 0, tall, 10**6)) / len(tall) < 0.3


def a_view():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    mesh = offscreen.Mesh(points=points, faces=np.array([[0, 1, 2]]), look={})
    return {"triangle": offscreen.View(pixels=(40, 30), meshes=(mesh,))}


def test_pictures_that_cannot_be_drawn_cost_nothing_but_themselves(monkeypatch, tmp_path):
    """A process that fails, and a missing folder for temporary files, raise no error."""
    monkeypatch.setattr(offscreen.sys, "executable", "/bin/false")
    with offscreen.rendering(a_view()) as drawn:
        assert drawn() is None
    monkeypatch.setattr(offscreen.tempfile, "tempdir", str(tmp_path / "none"))
    with offscreen.rendering(a_view()) as drawn:
        assert drawn() is None


def test_drawing_ends_with_its_context(monkeypatch, tmp_path):
    """The process ends also after an exception, such as an interrupt of the computation."""
    started = []
    real = offscreen.subprocess.Popen

    def sleeping(_command, **streams):
        started.append(real(["sleep", "100"], **streams))
        return started[-1]

    monkeypatch.setattr(offscreen.subprocess, "Popen", sleeping)
    monkeypatch.setattr(offscreen.tempfile, "tempdir", str(tmp_path))
    with pytest.raises(KeyboardInterrupt), offscreen.rendering(a_view()):
        assert started[0].poll() is None
        raise KeyboardInterrupt
    assert started[0].poll() is not None
    assert not list(tmp_path.iterdir())
