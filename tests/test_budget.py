"""The error budget that is printed with a run, against errors measured in runs."""

import numpy as np
import pytest
from wave_lumens import BORE, straight_tube

from acoustube.air import air_at
from acoustube.runs.config import load_config
from acoustube.waves import (
    ModalProbe,
    Pulse,
    cut_cells,
    error_budget,
    grid_spacing,
    propagate,
    section_cut_ons,
)
from acoustube.waves.budget import LOSSY_REFLECTION, absorber_reflection, delay_bias

AIR = air_at(20.0)
PULSE = Pulse(frequency=42e3)


def measured_bias(resolution):
    """Relative error of the slope of the phase from 41 to 43 kHz over a straight tube."""
    spacing = grid_spacing(2 * BORE, resolution)
    cells = cut_cells(straight_tube(0.24, sections=64), spacing, half=True)
    recording = propagate(
        cells, AIR, PULSE, duration=1e-3, probes=(0.02, 0.22), source_end="absorbing"
    )
    frequency = np.array([41e3, 43e3])
    heard = recording.pressure @ np.exp(-2j * np.pi * np.outer(recording.time, frequency))
    path = recording.probes[1] - recording.probes[0]
    free = np.exp(-2j * np.pi * frequency * path / AIR.sound_speed)
    late = -np.diff(np.angle(heard[1] / heard[0] / free))[0] / (2 * np.pi * 2e3)
    step = recording.time_step
    return late * AIR.sound_speed / path, delay_bias(42e3, spacing[2], step, AIR.sound_speed)


@pytest.mark.parametrize("resolution", [8, 12])
def test_bias_of_the_group_delay_is_the_measured_one(resolution):
    """2e-3 and 3e-4 agree within 5 %; the rest is the pulse's finite band."""
    measured, stated = measured_bias(resolution)
    assert abs(stated) > 1e-4
    assert measured == pytest.approx(stated, rel=0.05)


def test_bias_falls_with_the_fourth_order():
    biases = [
        delay_bias(42e3, BORE / n, 0.5 * BORE / n / AIR.sound_speed, AIR.sound_speed)
        for n in (8, 16, 32)
    ]
    assert np.log2(biases[0] / biases[1]) == pytest.approx(4, abs=0.1)
    assert np.log2(biases[1] / biases[2]) == pytest.approx(4, abs=0.1)


def test_budget_states_the_errors_of_its_grid():
    """The stated errors of area and cut-on are those of a polygon of 64 facets.

    Its area is 0.16 % smaller than the circle's, and its cut-ons are higher by half of that.
    """
    cells = cut_cells(straight_tube(0.01, sections=64), 2 * BORE / 32, half=True)
    pressure = np.ones((1, 1000))
    pressure[:, 900:] = 1e-2
    budget = error_budget(
        cells, AIR, frequency=42e3, highest=48e3, radius=BORE, time_step=None, lossy=False,
        pressure=pressure,
    )  # fmt: skip
    facets = np.sin(2 * np.pi / 64) * 64 / (2 * np.pi) - 1
    assert budget.section_error == pytest.approx(facets, rel=1e-3)
    assert budget.cut_on_error == pytest.approx(-facets / 2, abs=5e-4)
    assert budget.cells_per_wavelength == pytest.approx(343.2 / 48e3 / (2 * BORE / 32), rel=1e-3)
    assert budget.delay_bias == 0.0
    assert budget.ringing == pytest.approx(-40.0)
    assert budget.absorption is None
    assert "absorbing" not in budget.in_words(0.4)
    assert "the bore's section by -0.16 %" in budget.in_words(0.4)


def returned(lossy_band):
    """Reflection in dB of (2,1) by an absorbing end, 1 % above cut-on, 2 cm before the end."""
    cut_on = section_cut_ons(
        cut_cells(straight_tube(0.02, sections=256), 2 * BORE / 12, half=True),
        3,
        AIR.sound_speed,
        3,
    )[2]
    pulse = Pulse(frequency=1.03 * cut_on, cycles=40)
    near, far = (
        propagate(
            cut_cells(straight_tube(length, sections=256), 2 * BORE / 12, half=True), AIR, pulse,
            duration=2.4e-3, probes=(ModalProbe(0.02, "21c"),), source_end="absorbing",
            source_mode="21c", time_step=1e-6, lossy_band=lossy_band,
        ).pressure[0]
        for length in (0.04, 0.16)
    )  # fmt: skip
    n = min(near.size, far.size)
    tone = np.exp(-2j * np.pi * 1.01 * cut_on * 1e-6 * np.arange(n))
    return 20 * np.log10(abs(tone @ (near[:n] - far[:n])) / abs(tone @ far[:n]))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lossy_band", "stated"), [(None, absorber_reflection()), ((20e3, 60e3), LOSSY_REFLECTION)]
)
def test_absorbing_end_returns_no_more_than_is_stated(lossy_band, stated):
    """The reflection of a mode 1 % above its cut-on is at most 3 dB above the stated one.

    The path of 4 cm attenuates it as well, with losses by 10 dB.
    """
    assert returned(lossy_band) < stated + 3.0


def test_absorbing_end_returns_no_more_of_low_plane_waves_than_is_stated():
    """Losses that fade out reflect -56 dB in a bore of 4 mm at 10 kHz, an abrupt end -54 dB."""
    radius, pulse = 2e-3, Pulse(frequency=10e3, cycles=6)
    near, far = (
        propagate(
            cut_cells(straight_tube(length, radius=radius, sections=64), radius / 4, half=True),
            AIR, pulse, duration=0.8e-3, probes=(0.02,), source_end="absorbing", time_step=6e-7,
            lossy_band=(4e3, 20e3),
        ).pressure[0]
        for length in (0.04, 0.16)
    )  # fmt: skip
    returned = 20 * np.log10(np.abs(near - far).max() / np.abs(far).max())
    cells = cut_cells(straight_tube(0.01, radius=radius, sections=64), radius / 4, half=True)
    budget = error_budget(
        cells, AIR, frequency=10e3, highest=12e3, radius=radius, time_step=6e-7, lossy=True,
        pressure=far[None],
    )  # fmt: skip
    assert budget.plane_reflection - 3.0 < returned < budget.plane_reflection
    assert "reflects the plane wave at under -53 dB" in budget.in_words(0.4)


def test_losses_and_method_are_settings():
    config = load_config(losses="on", method="scattering", humidity_percent=20)
    assert config.waves.losses == "on"
    assert config.waves.method == "scattering"
