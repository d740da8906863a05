"""Every example runs, and what it says is true."""

import runpy
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture
def run_example(tmp_path, monkeypatch):
    """Run an example by its name where it may leave its picture, and return its variables."""
    monkeypatch.chdir(tmp_path)

    def run(name):
        variables = runpy.run_path(str(EXAMPLES / f"{name}.py"))
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000
        return variables

    return run


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
    # Exact for the plane wave; what is left is the delay's interpolation and the higher modes,
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
def test_batches_hold_every_cycle_once_with_its_label(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = EXAMPLES / "sweep_how_do_i_feed_a_network.py"
    variables = runpy.run_path(str(path), run_name="__main__")
    # Nine cases of 16 cycles, a third of them untouched.
    labels = variables["labels"]
    assert [int((labels == depth).sum()) for depth in (0.0, 1e-3, 2e-3)] == [48, 48, 48]
    assert len(variables["means"]) == 5
    # The offset of the ADC is in the middle of its scale.
    assert abs(sum(variables["means"]) / 5 - 0.5) < 0.01
    assert (tmp_path / f"{path.stem}.png").stat().st_size > 10_000
