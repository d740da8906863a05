"""Pages: they show what was computed, and need no network."""

import base64
import json
import re
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import xarray as xr
from matplotlib.image import imread
from rich.console import Console

import acoustube
from acoustube.base.console import ConsoleReporter
from acoustube.base.errors import ConfigError
from acoustube.cli import main
from acoustube.cli.indent import run_press
from acoustube.cli.simulate import run_simulation
from acoustube.indentation import Indenter, MeshSize
from acoustube.indentation.mesh import sweep as swept_tube
from acoustube.lumen.thinning import RINGS, decimate_rings
from acoustube.reports.page import content, read, runs, shapes, write
from acoustube.reports.page.encoded import Arrays
from acoustube.reports.page.solid import Solid
from acoustube.runs.config import Mechanics, load_config
from acoustube.runs.sweep import store
from acoustube.runs.sweep.plan import load_plan
from acoustube.runs.sweep.run import run_sweep
from acoustube.tube import Tube

QUIET = ConsoleReporter(Console(quiet=True))
OVER = {
    "indenter_mm": ["10", "25"],
    "depth_mm": ["0", "0.6", "4"],
    "method": ["spectral"],
    "losses": ["off"],
    "mesh": ["coarse"],
}
TYPES = {"f4": "<f4", "i2": "<i2", "u2": "<u2", "u4": "<u4"}
BORE, WALL = 7.9e-3, 1.6e-3
MOST_BYTES = 15e6

slow = pytest.mark.slow


def page_of(folder, path):
    """Write the page of a run, and return its path."""
    path.write_text(write.assembled(read(folder), write.plotly_js()), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pages") / "study"
    assert run_sweep(load_plan(None, OVER), folder, executor=ThreadPoolExecutor(1))
    return folder


@pytest.fixture(scope="module")
def page(sweep, tmp_path_factory):
    return page_of(sweep, tmp_path_factory.mktemp("pages") / "study.html")


@pytest.fixture(scope="module")
def press(tmp_path_factory):
    config = load_config(kind=Mechanics, indenter_mm=25, depth_mm=1.2, steps=2)
    return run_press(config, tmp_path_factory.mktemp("pages") / "press", QUIET)


@pytest.fixture(scope="module")
def heard(tmp_path_factory):
    config = load_config(indenter_mm=25, depth_mm=1.2, steps=2, resolution=8, frequency_khz=20)
    return run_simulation(config, tmp_path_factory.mktemp("pages") / "heard", QUIET)


def shown(page):
    """Return the content of a page, and its arrays."""
    text = page.read_text(encoding="utf-8")
    found = json.loads(re.search(r'type="application/json">(.*?)</script>', text, re.S)[1])
    arrays = [
        one["scale"] * np.frombuffer(base64.b64decode(one["content"]), TYPES[one["type"]])
        for one in found["arrays"]
    ]
    return found, arrays


def pinched_rings(n_rings=161, n_around=240):
    """Return rings of a tube whose upper half is pressed in by 4 mm along a bell curve."""
    angle = np.linspace(0, 2 * np.pi, n_around, endpoint=False)
    z = 0.06 * np.linspace(-1, 1, n_rings) ** 3
    walls = []
    for radius in (BORE / 2, BORE / 2 + WALL):
        x, y = np.sin(angle), -np.cos(angle)
        drop = 4e-3 * np.exp(-((z / 6e-3) ** 2))[:, None] * (1 + y) / 2
        ring = np.broadcast_to(radius * x, drop.shape), radius * y - drop
        walls.append(np.stack([*ring, np.broadcast_to(z[:, None], drop.shape)], axis=-1))
    return walls


def test_thinned_walls_are_within_20_um_of_all_rings():
    """The bound that the module states; between the kept rings walls are linear."""
    inner, outer = pinched_rings()
    kept, kept_outer = decimate_rings(inner, outer)
    assert kept.shape == kept_outer.shape == (RINGS, 120, 3)
    assert (kept[:, 0, 2] == 0).any()
    z, known = inner[:, 0, 2], kept[:, 0, 2]
    rebuilt = [[np.interp(z, known, kept[:, i, c]) for c in range(3)] for i in range(120)]
    off = np.abs(np.array(rebuilt).transpose(2, 0, 1) - inner[:, ::2])
    assert off.max() < 20e-6


def test_thinning_keeps_what_is_few():
    inner, outer = pinched_rings(9, 90)
    kept, kept_outer = decimate_rings(inner, outer)
    np.testing.assert_array_equal(kept, inner)
    np.testing.assert_array_equal(kept_outer, outer)


def test_cut_tube_of_rings_has_the_areas_of_half_a_cylinder():
    """Half the walls, two strips and two half rings; 120 facets have 1.2e-4 less area."""
    reach = 0.03
    shape = shapes.round_tube(BORE, WALL, reach)
    corners = {name: shape.points[faces] for name, faces in shape.faces.items()}
    areas = {
        name: 0.5 * np.linalg.norm(np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]), axis=1).sum()
        for name, c in corners.items()
    }
    ends = np.pi * ((BORE / 2 + WALL) ** 2 - (BORE / 2) ** 2)
    assert areas["inner"] == pytest.approx(np.pi * BORE / 2 * 2 * reach, rel=3e-4)
    assert areas["outer"] == pytest.approx(np.pi * (BORE / 2 + WALL) * 2 * reach, rel=3e-4)
    assert areas["cut"] == pytest.approx(2 * WALL * 2 * reach + ends, rel=1e-3)
    assert min(c[..., 0].min() for c in corners.values()) > -1e-12


@pytest.mark.parametrize("halved", [(True, True), (False, True), (True, False), (False, False)])
def test_surfaces_of_a_mesh_are_those_of_the_tube(halved):
    """Half the tube from any modelled part of it; quadratic edges are within 1e-3 of circles.

    The faces are oriented alike: the flux of (x, y, z) through the closed half is three times its
    volume.
    """
    tube = Tube(inner_diameter=BORE, wall_thickness=WALL)
    size, reach = MeshSize(through_wall=1, around=12, along=5), 0.03
    mesh = swept_tube(tube, reach, size, halved=halved)
    solid = Solid(mesh.points, mesh.elements)
    assert solid.halved == halved
    still = np.zeros_like(mesh.points)
    shape = solid.shape(still)
    flux = 0.0
    for faces in shape.faces.values():
        corners = shape.points[faces]
        assert corners[..., 0].min() > -1e-9
        flux += np.linalg.det(corners).sum() / 6
    volume = np.pi * ((BORE / 2 + WALL) ** 2 - (BORE / 2) ** 2) * reach
    assert flux == pytest.approx(volume, rel=3e-3)
    for outline, radius in ((shape.inner, BORE / 2), (shape.outer, BORE / 2 + WALL)):
        np.testing.assert_allclose(np.hypot(*outline.T), radius, rtol=5e-3)
        assert np.ptp(outline, axis=0) == pytest.approx(2 * radius, rel=1e-3)
    z = np.array([-0.02, 0.001, 0.02])
    np.testing.assert_allclose(solid.area(still, z), np.pi * BORE**2 / 4, rtol=1e-3)


def test_tools_touch_a_straight_tube_at_its_top():
    """A rod and a punch touch the top line; a sphere beside it touches as two circles do."""
    radius = BORE / 2 + WALL
    angle, z = np.meshgrid(np.linspace(0, np.pi, 2001), np.linspace(-0.02, 0.02, 41))
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1).reshape(-1, 3)
    for press in (
        Indenter(diameter=25e-3),
        Indenter(diameter=10e-3, yaw=0.3),
        Indenter(shape="punch"),
    ):
        assert shapes.tool_height(press, points) == pytest.approx(radius, rel=1e-6)
    beside = Indenter(shape="sphere", diameter=20e-3, x=3e-3)
    expected = np.sqrt((radius + 10e-3) ** 2 - 3e-3**2) - 10e-3
    assert shapes.tool_height(beside, points) == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("offset", [3.0, -3.0])
def test_sphere_on_either_side_rests_on_the_whole_wall(offset):
    """A straight tube, of which the page shows the half x > 0; the height is that of circles."""
    config = load_config(
        kind=Mechanics, shape="sphere", indenter_mm=20, offset_mm=offset, depth_mm=1.0
    )
    tube = Tube(inner_diameter=BORE, wall_thickness=WALL)
    size = MeshSize(through_wall=1, around=24, along=12)
    mesh = swept_tube(tube, 0.03, size, halved=(False, True))
    numbers = (
        "contact_force", "indentation_depth", "lumen_height", "lumen_width", "lumen_area",
    )  # fmt: skip
    data = xr.Dataset(
        {name: ("depth", [1e-3]) for name in numbers}
        | {
            "lumen_area_profile": (("depth", "z"), np.ones((1, 2))),
            "node_position": (("node", "xyz"), mesh.points),
            "node_displacement": (("depth", "node", "xyz"), np.zeros((1, *mesh.points.shape))),
            "element_node": (("element", "corner"), mesh.elements),
        },
        {"z": [-0.01, 0.01]},
    )
    (state,) = runs._indented(data, config).states
    radius = BORE / 2 + WALL
    expected = np.sqrt((radius + 10e-3) ** 2 - 3e-3**2) - 10e-3
    assert state.tool_height == pytest.approx(expected, abs=2e-5)


@pytest.mark.parametrize("x", [0.0, 2e-3, -2e-3, 7e-3])
@pytest.mark.parametrize(("shape", "diameter"), [("punch", 10e-3), ("sphere", 8e-3)])
def test_round_tools_are_drawn_where_x_is_positive(shape, diameter, x):
    """Outline of the part of the circle at x > 0, and lower side of the tool.

    Facets of 5 degrees are within 1e-3 of a circle.
    """
    tube, radius = BORE + 2 * WALL, diameter / 2
    press = Indenter(shape=shape, diameter=diameter, x=x)
    drawn = shapes.tool(press, tube)
    low, high = drawn.points.min(axis=0), drawn.points.max(axis=0)
    widest = radius if x >= 0 else np.sqrt(radius**2 - x**2)
    expected = 0.95 * tube if shape == "punch" else radius + widest
    assert high[1] == pytest.approx(expected, rel=3e-3)
    assert low[0] == pytest.approx(max(x - radius, 0.0), abs=2e-5)
    assert high[0] == pytest.approx(x + radius, rel=1e-3)
    assert high[2] == pytest.approx(widest, rel=2e-3)
    below = drawn.points[drawn.points[:, 1] < 0.4 * diameter]
    depth = below[:, 1] - shapes.underside(press, below[:, 0], below[:, 2])
    # Caps fill the inside; nothing is drawn below the tool's lower side.
    assert np.nanmin(depth) > -1e-9
    assert np.nanmin(drawn.outline[:, 1]) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("yaw", [0.0, 0.4, -0.9])
@pytest.mark.parametrize("diameter", [5e-3, 35e-3])
def test_rod_is_cut_at_x_0_whatever_its_turn(diameter, yaw):
    drawn = shapes.tool(Indenter(diameter=diameter, yaw=yaw), BORE + 2 * WALL)
    assert drawn.points[:, 0].min() == pytest.approx(0.0, abs=1e-12)
    axis = np.array([-np.sin(yaw), np.cos(yaw)])
    s, y = drawn.points[:, [0, 2]] @ axis, drawn.points[:, 1]
    assert (np.hypot(s, y - diameter / 2) < diameter / 2 + 1e-9).all()
    assert y.max() == pytest.approx(min(diameter, 0.95 * (BORE + 2 * WALL)), rel=1e-3)


def test_drawn_samples_lose_no_extreme():
    """A single extreme among 60 000 samples is drawn, and so are all required samples."""
    values = np.random.default_rng(3).normal(size=60_000)
    values[31_415], values[27_182] = 40.0, -40.0
    which = content.drawn(values, [12_345])
    assert {31_415, 27_182, 12_345, 0, 59_999} <= set(which)
    assert len(which) <= content.SAMPLES + 2
    assert (np.diff(which) > 0).all()
    stretches = np.linspace(0, 60_000, 40).astype(int)
    for a, b in pairwise(stretches):
        some = values[which[(which >= a) & (which < b)]]
        # The intervals of this test cut through drawn intervals at either end.
        assert some.max() >= np.sort(values[a:b])[-20]


def test_few_samples_are_drawn_as_they_are():
    assert len(content.drawn(np.zeros(content.SAMPLES))) == content.SAMPLES


@pytest.mark.parametrize("detected", [False, True])
@pytest.mark.parametrize("late", [0.004, 0.02])
def test_height_of_a_signal_is_that_of_all_after_the_send_pulse(detected, late):
    """The larger of pressure and envelope, detected or not, for a send pulse 5 high."""
    time = np.linspace(0, 2e-3, 9001)
    pressure, envelope = np.zeros((2, time.size))
    pressure[100], envelope[100] = -5.0, 1.0
    pressure[4321], envelope[6543] = -5 * 0.01, late
    peak = np.array([late] if detected else [])
    signal = content.signal_of(
        time, pressure, envelope, peak * 0 + time[6543], peak, place=lambda t: 170 * t,
        faded=3e-4, estimate=0.1, amplitude=late, probe=0.0, source_end="release",
    )  # fmt: skip
    assert signal.height == pytest.approx(max(0.01, late), rel=1e-12)


def test_equal_arrays_are_stored_once_and_read_back():
    arrays, values = Arrays(), np.linspace(-3.0, 7.0, 1001)
    numbers = [arrays.coarse(values), arrays.real(values), arrays.whole([0, 70_000])]
    assert [arrays.coarse(values.copy()), arrays.real(values)] == numbers[:2]
    assert [one["type"] for one in arrays.kept] == ["i2", "f4", "u4"]
    back = np.frombuffer(base64.b64decode(arrays.kept[0]["content"]), "<i2")
    assert np.abs(arrays.kept[0]["scale"] * back - values).max() <= 0.5 * 7.0 / 32767 * 1.001


@slow
def test_sweep_files_hold_the_walls_of_the_press(sweep):
    """The area of the stored section at the press is within 0.3 % of that of the lumen on the mesh.

    The stored section has 120 facets, the lumen is measured on finer ones.
    """
    pressed = 0
    for path in sorted(sweep.glob("cases-*.nc")):
        (data, _), walls = store.read(path), store.walls(path)
        if float(data["depth"][0]) == 0:
            assert walls is None
            continue
        pressed += 1
        ring = walls["inner_wall"].values[np.abs(walls["inner_wall"].values[:, 0, 2]).argmin()]
        x, y = ring[:, 0].astype(float), ring[:, 1].astype(float)
        area = 0.5 * np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))
        assert area == pytest.approx(float(data["lumen_area"][0]), rel=3e-3)
        along = walls["area_profile"].interp(z=0.0)
        assert float(along) == pytest.approx(float(data["lumen_area"][0]), rel=1e-3)
    assert pressed == 4


@slow
def test_damaged_walls_are_noticed(sweep, tmp_path):
    path = next(p for p in sorted(sweep.glob("cases-*.nc")) if store.walls(p) is not None)
    data, matrix = store.read(path)
    walls = store.walls(path)
    store.write_file(tmp_path / "good.nc", data, matrix, walls)
    assert store.intact(tmp_path / "good.nc") is not None
    bad = walls.assign(outer_wall=1.001 * walls["outer_wall"])
    tree = xr.open_datatree(tmp_path / "good.nc", engine="h5netcdf").load()
    tree["walls"] = xr.DataTree(bad)
    tree.to_netcdf(tmp_path / "bad.nc", engine="h5netcdf")
    assert store.intact(tmp_path / "bad.nc") is None


@slow
def test_page_holds_the_values_of_the_sweep(sweep, page):
    """Numbers have six digits, curves single precision, and shapes 1/32767 of their length."""
    found, arrays = shown(page)
    assert [group["tool"] for group in found["groups"]] == ["rod, 10 mm", "rod, 25 mm"]
    cases, echoes = acoustube.open_dataset(sweep).load(), 0
    for group, diameter in zip(found["groups"], (10e-3, 25e-3), strict=True):
        some = cases.isel(press=np.isclose(cases["diameter"].values, diameter)).sortby("depth")
        assert [state["depth"] for state in group["states"]] == [0.0, 0.6, 4.0]
        for state, i in zip(group["states"], range(3), strict=True):
            case = some.isel(press=i).sel(source_end="release")
            assert state["force"] == pytest.approx(float(case["force"]), rel=1e-5)
            assert state["area"] == pytest.approx(1e6 * float(case["lumen_area"]), rel=1e-5)
            signal, pressure = state["signal"], case["pressure"].values.astype(float)
            pressure = pressure[np.isfinite(pressure)]
            np.testing.assert_allclose(
                arrays[signal["pressure"]], 100 * pressure / np.abs(pressure).max(), atol=1e-5
            )
            told = [signal["estimate"], signal["amplitude"]]
            known = 100 * np.array([case["estimated_distance"], case["echo_amplitude"]])
            assert told == [pytest.approx(v, rel=1e-5) if np.isfinite(v) else None for v in known]
            if signal["estimate"] is not None:
                echoes += 1
                assert np.abs(arrays[signal["peakAt"]] - known[0]).min() < 1e-4
                assert arrays[signal["peak"]].max() == pytest.approx(known[1], rel=1e-5)
    assert echoes >= 2


@slow
def test_page_holds_reflection_and_walls_of_each_press(sweep, page):
    found, arrays = shown(page)
    paths = {str(store.read(p)[0]["press"].values[0]): p for p in sweep.glob("cases-*.nc")}
    cases = acoustube.open_dataset(sweep).load()
    for i in range(cases.sizes["press"]):
        case = cases.isel(press=i)
        tool = f"rod, {1e3 * float(case['diameter']):g} mm"
        group = next(group for group in found["groups"] if group["tool"] == tool)
        depth = round(1e3 * float(case["depth"]), 6)
        state = next(state for state in group["states"] if state["depth"] == depth)
        _, matrix = store.read(paths[str(case["press"].values)])
        walls = store.walls(paths[str(case["press"].values)])
        if depth == 0:
            assert state["spectrum"] is None
            continue
        s = matrix.sel(port_out=1, mode_out="00", port_in=1, mode_in="00")
        reflection = np.hypot(s["s_real"].values, s["s_imag"].values)
        np.testing.assert_allclose(arrays[state["spectrum"]["reflection"]], reflection, atol=1e-6)
        # Scattering is computed at 20 degrees, as these cases are.
        np.testing.assert_allclose(
            arrays[state["spectrum"]["frequency"]], 1e-3 * matrix["frequency"].values, rtol=1e-6
        )
        cut_ons = dict(state["spectrum"]["cutOns"])
        assert cut_ons["11c"] == pytest.approx(1e-3 * float(matrix["cut_on"][1]), rel=1e-5)
        np.testing.assert_allclose(
            arrays[state["along"]["area"]], 1e6 * walls["area_profile"].values, rtol=1e-6
        )
        outer = walls["outer_wall"].values
        half = outer[:, : outer.shape[1] // 2 + 1].reshape(-1, 3)
        points = arrays[state["shape"]["points"]].reshape(2, -1, 3)[1]
        assert np.abs(points - 1e3 * half).max() < 0.51 * 1e3 * np.abs(half).max() / 32767


@slow
def test_page_of_a_press_holds_all_its_depths(press):
    group = read(press).groups[0]
    with xr.open_dataset(press / "run.nc", engine="h5netcdf") as data:
        np.testing.assert_array_equal([s.force for s in group.states], data["contact_force"])
        for state, row in zip(group.states, range(2), strict=True):
            profile = data["lumen_area_profile"].values[row]
            np.testing.assert_array_equal(state.along.area, profile)
            # The tool's lowest point is at the given depth; the contact yields by 6 um.
            assert BORE / 2 + WALL - state.tool_height == pytest.approx(state.depth, abs=2e-5)
    assert all(state.signal is None and state.spectrum is None for state in group.states)
    assert "no sound" in read(press).missing["signal"]


def test_page_with_one_depth_names_no_slider(press):
    content, group = read(press), read(press).groups[0]
    one = replace(content, groups=[replace(group, states=group.states[-1:])])
    told = ["Move the slider" in write.assembled(each, "") for each in (content, one)]
    assert told == [True, False]


@slow
def test_page_of_a_run_holds_the_signal_of_its_last_depth(heard):
    shown = read(heard)
    last = shown.groups[0].states[-1]
    with xr.open_dataset(heard / "run.nc", engine="h5netcdf") as data:
        case = data.sel(source_end="release").load()
    assert last.signal.estimate == float(case["estimated_distance"])
    np.testing.assert_array_equal(last.signal.envelope, case["envelope"].values)
    np.testing.assert_array_equal(last.along.area, case["area_profile"].values)
    assert all(state.signal is None for state in shown.groups[0].states[:-1])
    # The last depth has rings, those before have elements: their depths are in one sequence.
    depths = [state.depth for state in shown.groups[0].states]
    heights = [state.tool_height for state in shown.groups[0].states]
    np.testing.assert_allclose(BORE / 2 + WALL - np.array(heights), depths, atol=2e-5)
    assert [note for note in shown.notes if "losses are off" in note]


@slow
def test_page_is_one_file_without_network_requests(page):
    """The page holds no address outside its library, and its policy forbids all requests."""
    text = page.read_text(encoding="utf-8")
    own = text.replace(write.plotly_js().replace("</script", "<\\/script"), "")
    assert len(text) - len(own) > 1e6
    assert not re.search(r"https?:|//[a-z]+\.|@import|url\(|<link|<img|src=", own)
    assert "default-src 'none'" in own
    assert page.stat().st_size < MOST_BYTES
    # Besides the library each of these presses takes 0.1 MB: 48 would take under 6 MB.
    assert len(own) / 6 * 48 < MOST_BYTES - (len(text) - len(own))


@slow
def test_page_of_earlier_files_states_what_is_missing(sweep, tmp_path):
    old = tmp_path / "old"
    old.mkdir()
    for path in sorted(sweep.glob("cases-*.nc")):
        store.write(old, *store.read(path))
    found = read(old)
    pressed = [state for group in found.groups for state in group.states if state.depth > 0]
    assert pressed
    assert all(state.shape is None and state.signal is not None for state in pressed)
    assert "before files held the deformed walls" in found.missing["shape"]


@slow
def test_many_places_are_thinned_out_evenly(sweep, monkeypatch):
    from acoustube.reports.page import cases

    monkeypatch.setattr(cases, "MOST_CASES", 30)
    groups = {(str(tool), 10.0 * place, ""): [None] * 3 for tool in range(2) for place in range(20)}
    kept, notes = cases.limited(groups)
    assert sorted({place for _, place, _ in kept}) == [0.0, 50.0, 100.0, 140.0, 190.0]
    assert "30 of the sweep's 120 cases: 5 of 20 places" in notes[0]
    monkeypatch.setattr(cases, "MOST_CASES", 5)
    with pytest.raises(ConfigError, match="has 6 cases, 6 of them at one place"):
        read(sweep)


def test_places_that_hold_most_cases_do_not_refuse_a_page():
    """390, 10 and 50 cases: the outer places have too many, the first one alone does not."""
    from acoustube.reports.page import cases

    sizes = {10.0: 390, 20.0: 10, 30.0: 50}
    kept, notes = cases.limited({("rod", place, ""): [None] * n for place, n in sizes.items()})
    assert [place for _, place, _ in kept] == [10.0]
    assert "390 of the sweep's 450 cases: 1 of 3 places" in notes[0]


def test_what_cannot_be_shown_is_refused(tmp_path, capsys):
    (tmp_path / "begun").mkdir()
    (tmp_path / "begun" / "sweep.toml").write_text("")
    (tmp_path / "empty").mkdir()
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "run.nc").write_bytes(b"nothing")
    (tmp_path / "taken.html").write_text("mine")
    refused = [
        (["nowhere", "--html", "a.html"], "nowhere does not exist"),
        (["begun", "--html", "a.html"], "a sweep without a finished case"),
        (["empty", "--html", "a.html"], "holds no run"),
        (["broken", "--html", "a.html"], "damaged or no run"),
        (["begun", "--html", "taken.html"], "exists and nothing is overwritten"),
        (["begun", "--html", "no/a.html"], "in a folder that does not exist"),
        (["begun", "--html", "a.png"], "must end in .html"),
        (["begun"], "nothing to write"),
    ]
    for words, message in refused:
        assert main(["show", *words]) == 2, words
        assert message in " ".join(capsys.readouterr().err.split()), words
    assert (tmp_path / "taken.html").read_text() == "mine"
    assert not (tmp_path / "a.html").exists()


@slow
def test_command_writes_the_page(sweep, capsys):
    assert main(["show", str(sweep), "--html", "study.html", "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    assert main(["show", str(sweep), "--html", "study.html"]) == 2


def test_show_draws_a_run_again(press, heard, tmp_path, capsys):
    for run, named, picture in (
        (press, press, "press.png"), (heard, heard, "heard.png"),
        (press, press / "run.nc", "file.png"),
    ):  # fmt: skip
        assert main(["show", str(named), "--out", picture]) == 0
        assert f"Run drawn in {picture}." in capsys.readouterr().out
        drawn, first = imread(tmp_path / picture), imread(run / "figure.png")
        np.testing.assert_array_equal(drawn, first)
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "run.nc").write_bytes(b"nothing")
    assert main(["show", "broken", "--out", "broken.png"]) == 2
    assert "damaged or no run" in " ".join(capsys.readouterr().err.split())


DESKTOP = {"width": 1440, "height": 900}
CHROMIUM = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
DRAWN = "() => document.body.dataset.drawn === '%d %d'"
FITTED = """() => [...document.querySelectorAll('.js-plotly-plot')].every(
  one => Math.abs(one._fullLayout.width - one.clientWidth) < 2)"""


@pytest.fixture(scope="module")
def browser():
    """Start Chromium, which draws 3-D on the processor."""
    path = next((found for name in CHROMIUM if (found := shutil.which(name))), None)
    if path is None:
        pytest.skip(f"no browser: none of {', '.join(CHROMIUM)} is installed")
    playwright = pytest.importorskip("playwright.sync_api")
    switches = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with playwright.sync_playwright() as driver:
        yield driver.chromium.launch(executable_path=path, args=switches)


@pytest.fixture(scope="module")
def shared_tab(browser, page):
    """Open the page once; return the tab, its requests, and its errors."""
    asked, wrong = [], []

    def route(route):
        asked.append(route.request.url)
        route.abort()

    tab = browser.new_page(viewport=DESKTOP)
    tab.set_default_timeout(120_000)
    tab.route(lambda url: not url.startswith(("file:", "data:", "blob:")), route)
    tab.on("pageerror", lambda error: wrong.append(str(error)))
    tab.on("console", lambda said: wrong.append(said.text) if said.type == "error" else None)
    tab.goto(page.as_uri())
    tab.wait_for_function("() => document.body.dataset.drawn")
    yield tab, asked, wrong
    tab.close()
    assert not asked
    assert not wrong


@pytest.fixture
def opened(shared_tab):
    """The open page at its first tool and second depth.

    After the test there must be no requests and no errors.
    """
    tab, asked, wrong = shared_tab
    if tab.viewport_size != DESKTOP:
        tab.set_viewport_size(DESKTOP)
        tab.wait_for_function(FITTED)
    tab.locator("#same").uncheck()
    tab.locator("#tool").select_option(index=0)
    tab.locator("#depth").fill("1")
    tab.wait_for_function(DRAWN % (0, 1))
    yield tab
    found = [*asked], [*wrong]
    asked.clear()
    wrong.clear()
    assert found == ([], [])


def curves(tab):
    """Return the curve of each chart as plotly.js draws it now."""
    return tab.evaluate(
        "() => Object.fromEntries(Object.entries({tube: [0, 'z'], section: [1, 'y'], "
        "area: [1, 'y'], spectrum: [1, 'y'], signal: [0, 'y']}).map(([name, [trace, axis]]) => "
        "[name, Array.from(document.getElementById(name).data[trace][axis])]))"
    )


@slow
def test_slider_moves_every_picture(opened, page):
    """The slider is moved by keys; then each curve is the array of that depth."""
    found, arrays = shown(page)
    opened.locator("#depth").focus()
    opened.keyboard.press("Home")
    opened.keyboard.press("ArrowRight")
    opened.wait_for_function(DRAWN % (0, 1))
    before = curves(opened)
    opened.keyboard.press("ArrowRight")
    opened.wait_for_function(DRAWN % (0, 2))
    after = curves(opened)
    assert opened.locator("#shown").inner_text() == "4 mm"
    assert opened.locator("#depth").get_attribute("aria-valuetext") == "4 mm deep"
    for name in before:
        assert before[name] != after[name], name
    state = found["groups"][0]["states"][2]
    np.testing.assert_allclose(after["area"], arrays[state["along"]["area"]], rtol=1e-6)
    np.testing.assert_allclose(after["spectrum"], arrays[state["spectrum"]["reflection"]])
    np.testing.assert_allclose(after["signal"], arrays[state["signal"]["pressure"]])
    assert f"{state['force']:.2f} N" in opened.locator("#numbers").inner_text()


@slow
def test_arrow_keys_move_the_depth_from_anywhere_but_a_list(opened):
    opened.locator("h1").click()
    opened.keyboard.press("ArrowLeft")
    opened.wait_for_function(DRAWN % (0, 0))
    opened.keyboard.press("ArrowLeft")
    opened.keyboard.press("ArrowRight")
    opened.wait_for_function(DRAWN % (0, 1))
    opened.locator("#same").check()
    opened.keyboard.press("ArrowRight")
    opened.wait_for_function(DRAWN % (0, 2))
    # Where the list has the focus, the key chooses in it.
    opened.locator("#tool").focus()
    opened.keyboard.press("ArrowLeft")
    opened.wait_for_timeout(300)
    assert opened.locator("#depth").input_value() == "2"


@slow
def test_no_button_of_a_chart_leaves_the_page(opened):
    titles = opened.evaluate(
        "() => [...document.querySelectorAll('.modebar-btn')].map("
        "one => one.dataset.title.toLowerCase())"
    )
    for kept in ("zoom", "pan", "reset axes", "download plot as a png"):
        assert titles.count(kept) >= 3, kept
    assert not [one for one in titles if re.search("share|upload|edit|link|cloud", one)]


@slow
def test_signal_is_not_clipped_after_the_send_pulse(opened, page):
    """At all depths; the send pulse has passed the probe within 5 cm of it."""
    found, arrays = shown(page)
    opened.locator("#depth").focus()
    opened.keyboard.press("Home")
    for number, state in enumerate(found["groups"][0]["states"]):
        opened.wait_for_function(DRAWN % (0, number))
        limit = opened.evaluate("document.getElementById('signal').layout.yaxis.range[1]")
        signal = state["signal"]
        for at, values in (("distance", "pressure"), ("smooth", "envelope")):
            later = arrays[signal[at]] > signal["probe"] + 5
            assert np.abs(arrays[signal[values]][later]).max() < limit
        opened.keyboard.press("ArrowRight")


@slow
def test_untouched_tube_has_no_reflection_to_draw(opened):
    opened.locator("#depth").focus()
    opened.keyboard.press("Home")
    opened.wait_for_function(DRAWN % (0, 0))
    assert not opened.locator("#spectrum").is_visible()
    assert "reflects nothing" in opened.locator("#spectrum-figure").inner_text()
    assert opened.locator("#tube canvas").count() > 0


@slow
def test_indenter_is_chosen_and_the_depth_stays(opened):
    opened.locator("#depth").focus()
    opened.keyboard.press("End")
    opened.wait_for_function(DRAWN % (0, 2))
    before = curves(opened)
    opened.locator("#tool").select_option("rod, 25 mm")
    opened.wait_for_function(DRAWN % (1, 2))
    after = curves(opened)
    assert all(before[name] != after[name] for name in before)
    assert "Rod, 25 mm" in opened.locator("#tube-caption").inner_text()
    # There is one place and nothing else to choose.
    assert not opened.locator("#place").is_visible()
    assert not opened.locator("#other").is_visible()


@slow
def test_controls_are_reached_by_tab_and_show_the_focus(opened):
    opened.reload()  # else the keys continue from the last focus
    opened.wait_for_function("() => document.body.dataset.drawn")
    reached = []
    for _ in range(4):
        opened.keyboard.press("Tab")
        focus = "document.activeElement"
        reached.append(opened.evaluate(f"{focus}.id"))
        width = opened.evaluate(f"parseFloat(getComputedStyle({focus}).outlineWidth)")
        assert width >= 2, reached
    assert reached[:3] == ["tool", "play", "depth"]
    named = (
        "() => [...document.querySelectorAll('select, input, button, [role=img]')].filter(one => "
        "one.offsetParent && !one.closest('.modebar') && !one.labels?.length "
        "&& !one.getAttribute('aria-label') && !one.getAttribute('aria-labelledby') "
        "&& !one.textContent.trim()).map(one => one.outerHTML)"
    )
    assert opened.evaluate(named) == []


@slow
@pytest.mark.parametrize("size", [(390, 844), (820, 1180), (1440, 900)])
def test_page_fits_phone_tablet_and_desktop(opened, size):
    opened.set_viewport_size({"width": size[0], "height": size[1]})
    # The plots follow the window's width in their own time.
    opened.wait_for_function(FITTED, timeout=20_000)
    opened.wait_for_timeout(200)
    assert opened.evaluate("document.documentElement.scrollWidth") <= size[0]
    for name in ("tube", "section", "area", "spectrum", "signal"):
        box = opened.locator(f"#{name}").bounding_box()
        assert box["width"] > 250
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= size[0]


def test_chart_fills_its_figure_where_a_run_has_no_reflection(browser, press, tmp_path):
    """The figure of the area then takes the whole row, before the chart is drawn in it."""
    page = page_of(press, tmp_path / "press.html")
    tab = browser.new_page(viewport=DESKTOP)
    tab.goto(page.as_uri())
    tab.wait_for_function("() => document.body.dataset.drawn")
    wide, figure = (
        tab.evaluate(f"document.querySelector('{name}').getBoundingClientRect().width")
        for name in ("#area .main-svg", "#area-figure")
    )
    tab.close()
    assert figure > 1000
    assert wide > 0.9 * figure
