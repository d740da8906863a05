"""Every example runs and draws its figures, and its statements are true."""

import runpy
from math import pi
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
import pyvista

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture
def run_example(tmp_path, monkeypatch):
    """Run an example by its name and check its figures; return its variables."""
    scenes = []
    monkeypatch.setattr(plt, "show", lambda: None)
    monkeypatch.setattr(pyvista.Plotter, "show", lambda plotter: scenes.append(plotter))

    def run(name, in_space=0):
        variables = runpy.run_path(str(EXAMPLES / f"{name}.py"))
        panels = [axes for number in plt.get_fignums() for axes in plt.figure(number).axes]
        plt.close("all")
        assert panels
        assert all(axes.has_data() for axes in panels)
        assert [len(plotter.actors) > 1 for plotter in scenes] == [True] * in_space
        assert not list(tmp_path.iterdir())
        return variables

    return run


@pytest.mark.slow
def test_press_closes_the_lumen_by_its_depth_and_reflects_under_the_rod(run_example):
    """The roof follows the rod to a tenth of a millimetre, and the bed stays.

    The rod's radius is 5 mm: the first reflection comes from under it.
    """
    variables = run_example("chain_how_does_a_press_sound", in_space=1)
    assert float(variables["run"]["lumen_height"][-1]) == pytest.approx(2.9e-3, abs=0.1e-3)
    assert abs(variables["distance"] - variables["truth"]) < 5e-3


@pytest.mark.long
def test_d_bore_holds_what_its_wall_leaves_and_closes_sooner_than_a_round_one(run_example):
    """The bore's area is the outer section less the wall's volume per length, over the STL file.

    The quadratic faces of the tetrahedra follow the file's facets to 0.5 %. The round tube's force
    is compared with that of a mesh with four times the elements, and of CalculiX, within the 3 % of
    a coarse mesh.
    """
    variables = run_example("indentation_how_does_a_d_bore_close", in_space=1)
    wall, areas = variables["surface"], variables["areas"]
    outside = pi / 4 * wall.extents[0] * wall.extents[1]
    assert areas["D-shaped"][0] == pytest.approx(outside - wall.volume / wall.extents[2], rel=5e-3)
    assert areas["round"][0] == pytest.approx(pi / 4 * 7.9e-3**2, rel=1e-3)
    left = {name: area[-1] / area[0] for name, area in areas.items()}
    assert left["D-shaped"] < left["round"] - 0.04
    assert variables["presses"]["round"].contact_force[-1] == pytest.approx(0.977, rel=0.03)


@pytest.mark.long
def test_echo_rises_with_depth_below_the_first_cut_on_and_not_at_the_carrier(run_example):
    """At 10 kHz only the plane wave propagates, and Webster's equation holds within 7 %.

    It assumes a uniform field over the lumen, which is not quite so for an obstacle two bores long
    in a wave of four: measured 4 % more than in three dimensions. Depths 1 mm apart differ by 40 %.
    """
    variables = run_example("waves_why_does_amplitude_mislead")
    steps = {khz: np.diff(height) for khz, height in variables["heights"].items()}
    assert (steps[10] > 0).all()
    assert (steps[20] > 0).all()
    assert not (steps[42] > 0).all()
    matrix, reflected = variables["matrix"], variables["reflected"]
    at_10 = int(np.argmin(np.abs(matrix.frequency - 10e3)))
    found = np.sqrt(reflected[at_10, matrix.modes.index("00")])
    assert found == pytest.approx(abs(webster_reflection(10e3, depth=4e-3)), rel=0.07)


def webster_reflection(frequency, depth):
    """Return the plane wave's reflection at a 10 mm rod, from the lumen's area."""
    import acoustube
    from acoustube.lumen import measure
    from acoustube.runs.presses import pressed

    config = acoustube.load_config(indenter_mm=10, depth_mm=6, mesh="coarse")
    depths = [3e-3, 4e-3, 5e-3, 6e-3]
    press = pressed(config, depths)
    row = press.rows_at(depths)[depths.index(depth)]
    edges = np.linspace(-0.04, 0.04, 801)
    area = measure(press, row, (edges[1:] + edges[:-1]) / 2).area
    wavenumber, whole = 2 * pi * frequency / 343.2, area[0]
    # From a matched end backwards: admittances relative to that of the round bore.
    admittance = 1.0 + 0j
    for step, share in zip(np.diff(edges)[::-1], area[::-1] / whole, strict=True):
        turn = 1j * np.tan(wavenumber * step)
        admittance = share * (admittance + share * turn) / (share + admittance * turn)
    return (1 - admittance) / (1 + admittance)


@pytest.mark.slow
def test_distance_of_a_recording_is_that_of_the_clean_cycle_and_of_a_closure(run_example):
    """Noise shifts the echo by 0.2 mm, and clutter 40 dB below it by a hundredth of its rise.

    A rigid closure at the same position has the same offset: the difference is the distance between
    the direct echo and the press's middle, under 5 mm for a 10 mm rod.
    """
    from acoustube import ranging, signals

    variables = run_example("ranging_what_does_a_sensor_record")
    recording, noisy = variables["recording"], variables["noisy"]
    np.testing.assert_array_equal(recording["signal"], noisy["signal"])
    assert variables["spread"] < 1e-3
    assert abs(variables["difference"]) < 2e-3
    wall = ranging.blockage(variables["matrix"].frequency, variables["TRUE_DISTANCE"])
    closed = ranging.record([wall], variables["clean"], **variables["tube"])
    there = signals.locate(variables["time"], closed["signal"].values[0], variables["how"])
    assert abs(float(variables["simulated"].distance - there.distance)) < 5e-3


@pytest.mark.long
def test_two_presses_are_located_and_the_highest_echo_is_late(run_example):
    """Within three stated deviations, 0.1 to 0.2 mm in position and 0.02 mm in depth."""
    variables = run_example("inversion_where_are_two_presses")
    contacts = variables["found"].contacts
    assert [c.distance.value for c in contacts] == pytest.approx(variables["TRUE_PLACES"], abs=5e-4)
    assert [c.depth.value for c in contacts] == pytest.approx(variables["TRUE_DEPTHS"], abs=6e-5)
    assert np.median(variables["highest"].distance) > variables["TRUE_PLACES"][1] + 0.05


@pytest.mark.slow
def test_echoes_computed_on_a_cluster_fall_as_the_plane_wave_does(run_example):
    """Kirchhoff's attenuation of the plane wave both ways; 3 % for the pulse's bandwidth."""
    from acoustube.air import air_at
    from acoustube.waves import attenuation

    pytest.importorskip("distributed")
    variables = run_example("sweep_how_do_i_use_a_cluster")
    assert variables["complete"]
    assert variables["failed"] == 0
    kinds = sorted(task["key"].split("-")[0] for task in variables["stream"].data)
    assert kinds == ["press", "scattering", "scattering", "simulate_cases", "simulate_cases"]
    cases, loss = variables["cases"], attenuation(0, 0, 20e3, 3.95e-3, air_at(20.0))
    for depth in (2e-3, 4e-3):
        some = np.isclose(cases["depth"], depth)
        slope = np.polyfit(cases["true_distance"][some], variables["level"][some], 1)[0]
        assert slope == pytest.approx(-2 * loss * 20 / np.log(10), rel=0.03)


@pytest.mark.slow
@pytest.mark.long
def test_estimates_of_new_presses_beat_a_constant_and_lie_in_their_intervals(run_example):
    """Median errors are under a third of a constant estimate's.

    The coverage is 90 % of 40 presses, less three deviations of 5 %.
    """
    variables = run_example("estimation_can_echoes_tell_depth")
    learned, asked = (set(variables["press"][variables[side]]) for side in ("learned", "asked"))
    assert len(asked) == 40
    assert not learned & asked
    for name, errors in variables["errors"].items():
        assert errors.median < variables["constant"][name] / 3
        assert errors.covered_wide > 0.75


def test_position_on_a_sleeve_is_that_of_its_helix(run_example):
    """The position is compared with the arc length of a conical helix by quadrature, to 0.1 mm.

    The radius is that of the skin plus half a tube.
    """
    variables = run_example("sleeve_will_it_fit_my_arm")
    z = np.linspace(0, 0.25, 10001)
    radius = np.interp(z, [0, 0.25], [0.17, 0.26]) / (2 * pi) + 5.55e-3
    slope, twist = np.gradient(radius, z), 2 * pi / 0.05
    along = np.sqrt(1 + slope**2 + (radius * twist) ** 2)
    arc = 0.15 + np.concatenate([[0], np.cumsum((along[1:] + along[:-1]) / 2 * np.diff(z))])
    np.testing.assert_allclose(variables["found"].tube_lengths, arc[-1], atol=1e-4)
    height = np.interp(variables["DISTANCE"], arc, z)
    assert variables["z"] == pytest.approx(height, abs=1e-4)
    assert np.hypot(variables["x"], variables["y"]) == pytest.approx(
        np.interp(height, z, radius), abs=1e-4
    )


def test_recorded_echo_is_ranged_to_a_millimetre(run_example):
    # 26 dB of signal to noise; the envelope rises over 10 cm, so 1 mm is a hundredth of it.
    assert abs(run_example("signals_where_did_the_recording_echo")["error"]) < 1e-3


@pytest.mark.slow
def test_held_tube_is_stiffer_by_what_the_reference_says(run_example):
    # The independent solution: 3 to 4 % in force at 2 mm, under 0.1 mm2 in area.
    variables = run_example("indentation_how_much_does_the_support_matter")
    assert 0.03 < variables["stiffening"] < 0.045
    assert abs(variables["area"]["held"] - variables["area"]["free"]) < 0.1e-6


@pytest.mark.slow
def test_release_end_adds_the_negative_of_the_echo(run_example):
    # Exact for the plane wave; the rest is interpolation of the delay and the higher modes,
    # which reach the end off their plane-wave delay.
    variables = run_example("waves_why_does_the_echo_come_twice")
    assert variables["mismatch"] < 0.05


@pytest.mark.slow
def test_second_azimuthal_mode_is_locked_in_beside_a_deep_press(run_example):
    # The round bore's 42.24 kHz to the cut cells' 0.2 % at 32 cells per bore; well below the
    # carrier beside the rod, well above it under the rod.
    variables = run_example("waves_where_is_sound_trapped")
    assert abs(variables["third_khz"][0] / 42.24 - 1) < 2.5e-3
    assert variables["lowest"] < 39
    assert variables["under_the_rod"] > 55


@pytest.mark.slow
def test_wrap_converts_a_fifth_of_the_sound_at_the_carrier_and_gives_it_back(run_example):
    # Coupled-mode theory: the beat of two modes with kz = 769 and 609 1/m is 3.9 cm, and shorter
    # where the coupling adds to their difference.
    variables = run_example("sleeve_how_much_sound_does_a_wrap_convert")
    assert 0.15 < variables["most"][42.0] < 0.2
    assert 0.03 < variables["beat"] < 0.0393
    assert variables["most"][20.0] == 0
    assert max(variables["reflected_db"].values()) < -30


def test_forearm_markers_are_those_beside_the_script(tmp_path):
    script = tmp_path / "forearm_markers.py"
    script.write_text((EXAMPLES / "forearm_markers.py").read_text(encoding="utf-8"))
    runpy.run_path(str(script))
    written = (tmp_path / "forearm_markers.csv").read_text()
    assert written == (EXAMPLES / "forearm_markers.csv").read_text()


@pytest.mark.slow
def test_batches_hold_every_cycle_once_with_its_label(run_example):
    variables = run_example("sweep_how_do_i_feed_a_network")
    # Fifteen cases of 16 cycles, a fifth of them untouched.
    depths, counts = np.unique(np.round(1e3 * variables["labels"]), return_counts=True)
    assert depths.tolist() == [0, 3, 4, 5, 6]
    assert counts.tolist() == [48] * 5
    assert len(variables["means"]) == 8
    # The offset of the ADC is in the middle of its scale.
    assert abs(sum(variables["means"]) / 8 - 0.5) < 0.01


@pytest.mark.long
def test_robots_contact_is_found_in_the_cycles_of_its_sensor(run_example):
    """A moving contact of known force: errors of position and force by the tracker.

    Sensor and tracker share a library, so that errors are by noise, rounding, and motion between
    cycles. Measured 0.03 mm and 0.005 N. Allowed are a quarter of the phase's 4 mm, and a tenth of
    the least force.
    """
    pytest.importorskip("mujoco")
    variables = run_example("sensor_what_does_a_robot_feel")
    assert variables["forces"].max() > 1.0
    assert np.ptp(variables["places"]) > 0.08
    assert variables["found_share"] > 0.9
    assert variables["place_error"] < 1e-3
    assert variables["force_error"] < 0.04
