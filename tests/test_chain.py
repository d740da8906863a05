"""The whole chain by the installed command, run once on a coarse grid, and its files."""

import json

import numpy as np
import pytest
import xarray as xr
from commands import run_process
from scipy.interpolate import CubicSpline

from acoustube import Config, load_config
from acoustube.base.errors import SimulationError
from acoustube.lumen import Lumen
from acoustube.reports.figures import run as run_figure
from acoustube.reports.scenes import tube as tube_scene
from acoustube.runs.config.si import press_in_si, settings_in_si
from acoustube.runs.simulate import simulate, stage, warnings_for
from acoustube.runs.sound import tube_recordings

OPTIONS = {"indenter": 25, "depth": 4, "position": 18, "resolution": 12, "temperature": 25}

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """Run the command; return its result and the folder."""
    folder = tmp_path_factory.mktemp("runs") / "run"
    words = [word for name, value in OPTIONS.items() for word in (f"--{name}", str(value))]
    result = run_process("simulate", *words, "--out", folder)
    assert result.returncode == 0, result.stderr
    return result, folder


@pytest.fixture(scope="module")
def dataset(finished):
    with xr.open_dataset(finished[1] / "run.nc", engine="h5netcdf") as data:
        return data.load()


def test_folder_holds_data_settings_and_figure_and_nothing_else(finished):
    _, folder = finished
    assert {path.name for path in folder.iterdir()} == {"run.nc", "config.toml", "figure.png"}
    assert [path.name for path in folder.parent.iterdir()] == ["run"]


def test_printed_table_states_the_values_of_the_file(finished, dataset):
    printed, last = finished[0].stdout, dataset.isel(depth=-1)
    assert f"{float(last['contact_force']):.3f} N" in printed
    assert f"{1e6 * float(last['lumen_area']):.2f} mm2" in printed
    assert f"{100 * float(dataset['estimated_distance'][1]):.2f} cm" in printed
    assert finished[0].stderr == ""


def test_run_is_checked_against_the_spectral_solver(finished, dataset):
    """At 12 cells across, the echo is within 2 mm and 10 % of that of the spectral solver.

    Measured 0.9 and 1.2 mm, 6 and 4 %, and the same on the fine mesh of the wall: it is the grid's
    error. With 16 cells it is 0.3 mm and 2 %.
    """
    apart = dataset["spectral_distance"] - dataset["estimated_distance"]
    assert np.abs(apart).max() < 2e-3
    np.testing.assert_allclose(dataset["spectral_amplitude"], dataset["echo_amplitude"], rtol=0.1)
    assert float(dataset["spectral_error"]) < 1e-3
    assert f"echo displaced by {1e3 * float(apart[0]):+.3f} mm, height" in finished[0].stdout


def test_every_variable_has_a_unit_and_a_name(dataset):
    bare = [
        name
        for name, variable in dataset.variables.items()
        if not {"units", "long_name"} <= set(variable.attrs)
    ]
    assert bare == []


def test_written_settings_are_those_asked_for_and_load_again(finished, dataset):
    asked = load_config(indenter_mm=25, depth_mm=4, position_cm=18, resolution=12, temperature_c=25)
    assert load_config(finished[1] / "config.toml") == asked
    stored = json.loads(dataset.attrs["configuration"])
    assert stored["indentation"]["position_cm"] == 18
    assert stored["waves"]["temperature_c"] == 25


def test_second_run_into_the_same_folder_is_refused_and_changes_nothing(finished):
    _, folder = finished
    before = {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}
    again = run_process("simulate", "--out", folder)
    assert again.returncode == 2
    assert "not empty" in again.stderr
    assert before == {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}


def test_force_and_section_follow_the_stages(dataset):
    """Force rises with depth, and the least area of the profile is that under the rod.

    The profile is cut from rings of 216 facets, the section at the press from triangles with 288
    points around: two polygons of one curve, whose areas differ by 1e-4.
    """
    assert np.all(np.diff(dataset["contact_force"]) > 0)
    at_press = float(dataset["lumen_area"][-1])
    assert float(dataset["area_profile"].min()) == pytest.approx(at_press, rel=2e-4)
    lowest = float(dataset["z"][np.argmin(dataset["area_profile"].values)])
    assert lowest == pytest.approx(0.18, abs=1e-9)


def test_absorbing_end_places_the_press_within_its_own_length(dataset):
    """The estimated distance is within 3 mm of the rod, which flattens 2.4 cm of the tube.

    On this grid the echo is at 18.31 cm with 0.01359 of the pulse; by scattering matrices, which
    have no delay of the grid, at 18.28 cm with 0.01363. The tolerance of 5 % allows for another
    processor's order of sums and for another mesh.
    """
    case = dataset.sel(source_end="absorbing")
    assert float(case["estimated_distance"]) == pytest.approx(0.1830, abs=1e-3)
    assert float(case["echo_amplitude"]) == pytest.approx(0.0136, rel=0.05)


def test_both_source_ends_give_the_same_pulse_before_any_echo(dataset):
    """Both source ends give the same pressure until the echo has returned to the source end.

    The prescribed pressure and the launched wave differ in their discrete start by 1 %.
    """
    silent = dataset["time"] < 2 * (0.18 - 0.06 - 0.02) / float(dataset["sound_speed"])
    release, absorbing = dataset["pressure"].values[:, silent.values]
    assert np.abs(release - absorbing).max() < 0.02


def test_figure_shares_the_distance_and_marks_both_pulses(dataset):
    with tube_scene.drawing(dataset) as drawn:
        images = drawn()
    assert images is not None
    strip = images["strip"]
    assert strip.shape == (tube_scene.STRIP_PIXELS[1], tube_scene.STRIP_PIXELS[0], 3)
    # The wall reaches both edges, and the lumen in the picture is lowest at the press.
    middle = strip[strip.shape[0] // 2].astype(int)
    assert np.all(np.ptp(middle[[0, -1]], axis=1) > 10)
    sheet = run_figure.figure(dataset, images)
    shared = sheet.axes[1:]
    assert {axes.get_xlim() for axes in shared} == {(0.0, 40.0)}
    texts = " ".join(text.get_text() for text in sheet.axes[-1].texts)
    assert "send pulse" in texts
    assert "return pulse" in texts


def test_figure_without_pictures_says_why(dataset):
    sheet = run_figure.figure(dataset, None)
    assert "VTK cannot draw" in sheet.axes[0].texts[0].get_text()


def round_rings(length):
    """Return the two rings of a straight bore."""
    angle = 2 * np.pi * np.arange(64) / 64
    circle = 3.95e-3 * np.stack([np.sin(angle), -np.cos(angle), 0 * angle], axis=-1)
    rings = np.stack([circle, circle])
    rings[1, :, 2] = length
    return rings


def test_both_source_ends_share_one_time_axis_whatever_the_length():
    """Here the steps of the two ends alone would give different numbers of samples."""
    config = load_config(indenter_mm=10, resolution=9, length_cm=40.72)
    rings = round_rings(0.4072)
    recordings, _ = tube_recordings(
        settings_in_si(config), Lumen(rings=rings, outer_rings=rings, position=0.2)
    )
    release, absorbing = recordings.values()
    assert np.array_equal(release.time, absorbing.time)


def test_refusal_inside_a_stage_becomes_a_failure_of_that_stage():
    config = load_config(resolution=8)
    inside_out = round_rings(0.4)[:, ::-1]
    with pytest.raises(SimulationError, match=r"^waves: surface"), stage("waves", {}, print):
        tube_recordings(
            settings_in_si(config), Lumen(rings=inside_out, outer_rings=inside_out, position=0.2)
        )


def test_press_within_the_blind_time_is_warned_of():
    near = load_config(position_cm=10, lowpass_khz=2)
    assert any("not searched" in line for line in warnings_for(settings_in_si(near)))
    assert not any("not searched" in line for line in warnings_for(settings_in_si(load_config())))


def test_settings_become_si():
    tube = press_in_si(load_config(shear_modulus_mpa=0.4)).tube
    assert tube.shear_modulus == pytest.approx(0.4e6)
    assert press_in_si(Config()).tube.shear_modulus == pytest.approx(0.5074e6, rel=1e-4)
    assert tube.outer_diameter == pytest.approx(11.1e-3)


def test_cut_on_inside_the_band_is_warned_of():
    assert any("(2,1)" in line for line in warnings_for(settings_in_si(load_config())))
    assert not any(
        "cuts on" in line for line in warnings_for(settings_in_si(load_config(frequency_khz=20.5)))
    )


def test_loss_that_the_model_leaves_out_is_stated():
    """13.35 dB/m by the wall (Zwikker and Kosten), 1.39 by the air: 5.3 dB over 36 cm."""
    assert any("by 5.3 dB" in line for line in warnings_for(settings_in_si(load_config())))


def test_scattering_and_straight_tube_give_the_recording_of_the_whole_tube(dataset):
    """Scattering and whole tube agree within 2.5 % of the pulse, at 12 cells per bore.

    The release end launches 1.3 % less than prescribed. On the default grid the difference is half
    a per cent; see benchmarks/whole_tube_or_scattering.py.
    """
    words = {f"{name}_mm": OPTIONS[name] for name in ("indenter", "depth")}
    found = simulate(
        load_config(**words, position_cm=18, resolution=12, temperature_c=25, method="scattering")
    )
    time = dataset["time"].values
    for end in ("release", "absorbing"):
        full = dataset["pressure"].sel(source_end=end).values
        parts = CubicSpline(found["time"], found["pressure"].sel(source_end=end))(time)
        assert np.linalg.norm(parts - full) < 0.025 * np.linalg.norm(full)
        case, whole = found.sel(source_end=end), dataset.sel(source_end=end)
        # Measured 0.5 and 0.3 %, and 0.48 and 0.31 mm.
        assert float(case["echo_amplitude"]) == pytest.approx(
            float(whole["echo_amplitude"]), rel=0.015
        )
        assert float(case["estimated_distance"]) == pytest.approx(
            float(whole["estimated_distance"]), abs=1e-3
        )
    assert float(found["delay_bias"]) == 0.0 < abs(float(dataset["delay_bias"]))
    assert "the grid moves the echo" in dataset.attrs["accuracy"]


@pytest.mark.parametrize("losses", ["off", "on"])
def test_default_prominence_finds_the_press_with_and_without_losses(losses, dataset):
    """Losses reduce the echo, 1.4 % of the pulse, to below 1 %; both runs locate the press."""
    found = simulate(
        load_config(
            losses=losses,
            indenter_mm=25,
            depth_mm=4,
            position_cm=18,
            resolution=12,
            temperature_c=25,
        )
    )
    assert abs(float(found["distance"]) - 0.18) < 0.012
    if losses == "off":
        assert float(found["distance"]) == float(dataset["distance"])
    else:
        assert float(found["amplitude"]) < 0.7 * float(dataset["amplitude"])
