"""Calibrations from synthetic cycles whose attenuation, distance line and noise are known."""

import numpy as np
import pytest
from test_pipeline import OFFSET, TIME, burst

from acoustube.base.errors import ConfigError
from acoustube.ranging import Rangefinder, blockage, record
from acoustube.signals import Processing, calibrate, load, locate, save, speed_of_sound
from acoustube.signals.calibration import arctan_fall, untouched_deviation

FALL = -0.25, 2.0, 0.9, 0.42
SLOPE, INTERCEPT, NOISE = 0.99, 0.03, 0.002
PLACES = np.repeat(np.arange(0.20, 2.01, 0.05), 3)
SPEED = float(speed_of_sound(20.0))


def blocked(places=PLACES, noise=NOISE, seed=0):
    """Cycles of closures whose echoes are delayed and whose amplitude falls as an arctangent."""
    delay = 2 * (SLOPE * places + INTERCEPT) / SPEED
    clean = burst(np.zeros(1)) + arctan_fall(places, *FALL)[:, None] * burst(delay)
    return OFFSET + 1500 * (clean + np.random.default_rng(seed).normal(0, noise, clean.shape))


def untouched(n=40, noise=NOISE, seed=1):
    clean = np.repeat(burst(np.zeros(1)), n, axis=0)
    return OFFSET + 1500 * (clean + np.random.default_rng(seed).normal(0, noise, clean.shape))


@pytest.fixture(scope="module")
def calibration():
    return calibrate(TIME, blocked(), PLACES, untouched())


def test_all_parameters_are_recovered_within_their_deviations(calibration):
    """Fits of 111 noisy cycles are within four stated deviations and 1 % of the truth.

    The 1 % is the ripple that the overtones of the rectified carrier leave at 200 kHz.
    """
    for name, true in zip(("c1", "c2", "c3", "c4"), FALL, strict=True):
        estimate = getattr(calibration, name)
        assert abs(estimate.value - true) < 4 * estimate.deviation + 0.01 * abs(true), name
        assert estimate.deviation < 0.05 * abs(true), name
    assert abs(calibration.slope.value - SLOPE) < 4 * calibration.slope.deviation + 1e-4
    # The gain rises over the length of an echo, and shifts its maximum by tenths of a millimetre.
    assert abs(calibration.intercept.value - INTERCEPT) < 4 * calibration.intercept.deviation + 5e-4
    assert calibration.distance_rmse < 1e-3
    assert calibration.amplitude_rmse < 5e-3
    assert calibration.fitted_amplitude(1.0) == pytest.approx(arctan_fall(1.0, *FALL), rel=0.01)


def test_shifted_send_time_moves_the_line_through_zero_and_keeps_its_slope(calibration):
    slope, intercept = np.polyfit(calibration.true_distance, calibration.estimated_distance, 1)
    assert slope == pytest.approx(calibration.slope.value, abs=1e-9)
    assert abs(intercept) < 1e-9
    found = locate(TIME, blocked(seed=5), calibration.processing)
    assert found.distance == pytest.approx(SLOPE * PLACES, abs=3e-3)


def test_prominence_is_that_of_untouched_cycles(calibration):
    """The prominence is 2.8 deviations of untouched cycles, on the scale of the envelope.

    It is proportional to the noise. White noise exceeds it in most cycles, and exceeds eight
    deviations in under 5 % of them.
    """
    how = calibration.processing
    sigma = untouched_deviation(TIME, untouched(), how)
    assert how.prominence == pytest.approx(np.pi / 2 * 2.8 * sigma)
    louder = untouched_deviation(TIME, untouched(noise=2 * NOISE), how)
    assert louder == pytest.approx(2 * sigma, rel=0.05)
    assert calibration.false_alarms > 0.5
    strict = calibrate(TIME, blocked(), PLACES, untouched(), sigmas=8.0)
    assert strict.false_alarms == 0.0
    assert np.mean(locate(TIME, untouched(seed=9), strict.processing).detected) < 0.05
    assert locate(TIME, blocked(seed=9), strict.processing).detected.all()


def test_gain_levels_the_echoes(calibration):
    """With the gain curve the amplitudes of closures are equal to about 40 %.

    The tanh has the slope of the arctangent in the middle of the range.
    """
    plain = locate(TIME, blocked(), Processing(template_cycles=None))
    levelled = locate(TIME, blocked(), calibration.processing)
    assert np.ptp(plain.amplitude) / plain.amplitude.mean() > 1.0
    assert np.ptp(levelled.amplitude) / levelled.amplitude.mean() < 0.6


def test_file_holds_the_calibration(calibration):
    save(calibration, "sensor.toml")
    again = load("sensor.toml")
    assert again.processing == calibration.processing
    assert again.c2 == calibration.c2
    assert again.slope == calibration.slope
    np.testing.assert_array_equal(again.amplitude, calibration.amplitude)
    with pytest.raises(ConfigError, match=r"sensor.toml exists and nothing is overwritten"):
        save(calibration, "sensor.toml")


def test_other_files_are_no_calibration(tmp_path):
    (tmp_path / "other.toml").write_text("[tube]\nlength_cm = 40\n")
    (tmp_path / "broken.toml").write_text("[calibration\n")
    for name in ("other.toml", "broken.toml", "missing.toml"):
        with pytest.raises(ConfigError, match=f"{name} is not a calibration"):
            load(tmp_path / name)


def test_simulated_sensor_is_calibrated_to_millimetres():
    """Closures of a 2.5 m tube with losses give their positions and the published gain.

    37 closures; the asymptotes of the paper are 0.635 and 0.104, and the sensor's gain was chosen
    to match them.
    """
    band, places = np.array([10e3, 90e3]), np.arange(0.20, 2.001, 0.05)
    tube = {"radius": 3.95e-3, "length": 2.5, "temperature": 20.0}
    closed = [
        record([blockage(band, z)], Rangefinder(), n_cycles=2, seed=i, **tube)
        for i, z in enumerate(places)
    ]
    free = record([], Rangefinder(), n_cycles=20, seed=99, **tube)
    found = calibrate(
        free["time"].values,
        np.concatenate([part["signal"].values for part in closed]),
        np.repeat(places, 2),
        free["signal"].values,
        temperature=np.concatenate([part["temperature"].values for part in closed]),
        untouched_temperature=free["temperature"].values,
        sigmas=20.0,
    )
    assert found.true_distance.size == 74
    assert found.slope.value == pytest.approx(1.0, abs=2e-3)
    assert found.distance_rmse < 4e-3
    assert found.amplitude_rmse < 0.0254
    gain = found.processing.gain
    assert (gain.c4 - gain.c1, gain.c4 + gain.c1) == pytest.approx((0.635, 0.104), abs=0.02)
    # A later send pulse, as with another trigger of the board, is corrected for.
    walk = [(z, lead) for z in (0.33, 0.71, 1.13) for lead in (0.0, 25e-6, 100e-6)]
    for z, lead in walk:
        part = record([blockage(band, z)], Rangefinder(lead=lead), seed=500, **tube)
        ranging = locate(
            part["time"].values, part["signal"].values[0], found.processing,
            temperature=part["temperature"].values[0],
        )  # fmt: skip
        assert ranging.distance == pytest.approx(z, abs=5e-3)


@pytest.mark.parametrize(
    ("places", "part"),
    [
        (np.repeat([0.3, 0.6, 0.9], 37), "3 different places are too few"),
        (0.5 + PLACES / 10, "span 0.18 m, too little"),
        (PLACES[:-1], "one distance for each cycle"),
        (-PLACES, "must be positive"),
        (100 * PLACES, "check the unit of the distances"),
        (PLACES[::-1], "check the unit|do not fall"),
    ],
)
def test_places_that_calibrate_nothing_are_refused(places, part):
    with pytest.raises(ValueError, match=part):
        calibrate(TIME, blocked(), places, untouched())


def test_blockages_in_noise_and_silent_cycles_are_refused():
    with pytest.raises(ValueError, match="places show an echo within"):
        calibrate(TIME, untouched(PLACES.size), PLACES, untouched())
    echoes = (0.1 + 0.2 * PLACES)[:, None] * burst(2 * PLACES / SPEED)
    rising = OFFSET + 1500 * (burst(np.zeros(1)) + echoes)
    with pytest.raises(ValueError, match="do not fall with distance"):
        calibrate(TIME, rising, PLACES, untouched())
    with pytest.raises(ValueError, match="holds no send pulse"):
        calibrate(TIME, blocked(), PLACES, np.full((3, 4000), OFFSET))
