"""Processing of recorded cycles: each step, localisation and detection, on known echoes."""

import numpy as np
import pytest
from scipy import signal

from acoustube import signals
from acoustube.signals import Processing, TimeGain, locate

RATE, CARRIER, SPEED = 200e3, 42e3, 343.2
TIME = np.arange(4000) / RATE
PULSE_LENGTH = 11 / CARRIER
OFFSET = 2048.0


def burst(delay):
    """Gaussian pulse as the transducer sends it, `delay` after the send pulse."""
    since = TIME - PULSE_LENGTH / 2 - np.asarray(delay)[..., np.newaxis]
    return np.exp(-0.5 * (since / (PULSE_LENGTH / 6)) ** 2) * np.sin(2 * np.pi * CARRIER * since)


def cycles_at(distance, height=0.3, noise=0.0, seed=0):
    """Cycles in counts of a 12-bit board: offset, send pulse, one echo, white noise."""
    distance = np.atleast_1d(distance)
    clean = burst(np.zeros(1)) + height * burst(2 * distance / SPEED)
    hiss = np.random.default_rng(seed).normal(scale=noise, size=clean.shape)
    return OFFSET + 1500 * (clean + hiss)


def test_offset_and_drift_go_and_echoes_stay():
    """A constant to rounding, a ramp of a cycle's amplitude to 3 %, the echo's height to 1 %."""
    plain = burst(np.array([5e-3]))
    assert np.abs(signals.remove_offset(np.full(4000, 3000.0), RATE)).max() < 1e-9
    left = signals.remove_offset(plain + np.linspace(-1, 1, 4000), RATE)
    assert np.abs((left - plain)[..., 400:-400]).max() < 0.03
    assert np.abs(signals.remove_offset(plain, RATE) - plain).max() < 0.01


def test_offset_is_scipys_two_way_filter():
    rng = np.random.default_rng(3)
    cycles = rng.normal(size=(3, 4000))
    sections = signal.butter(2, 100.0, fs=RATE, output="sos")
    found = signals.remove_offset(cycles, RATE)
    for cycle, mine in zip(cycles, found, strict=True):
        centred = cycle - cycle.mean()
        slow = signal.sosfiltfilt(sections, centred, padtype="even", padlen=3999)
        np.testing.assert_allclose(mine, centred - slow, atol=1e-12)


def test_matched_filter_is_a_correlation_without_delay():
    wave = signals.template(RATE, CARRIER)
    assert wave.size == 2 * int(10 / CARRIER * RATE / 2) + 1
    assert np.linalg.norm(wave) == pytest.approx(1.0)
    rng = np.random.default_rng(4)
    cycles = rng.normal(size=(2, 3, 500))
    found = signals.matched_filter(cycles, wave)
    for index in np.ndindex(2, 3):
        plain = np.correlate(cycles[index], wave, mode="same")
        np.testing.assert_allclose(found[index], plain, atol=1e-12)
    lone = np.zeros(501)
    lone[250 - wave.size // 2 : 250 + wave.size // 2 + 1] = wave
    assert np.argmax(signals.matched_filter(lone, wave)) == 250


def test_gain_of_the_matched_filter_is_that_of_theory():
    """The peak-to-noise ratio is the root of energy over noise density, within 0.5 dB.

    From 4000 noise samples the level is known to 1.1 %, 0.1 dB.
    """
    wave = signals.template(RATE, CARRIER)
    lone = np.zeros(4000)
    lone[2000 - wave.size // 2 : 2000 + wave.size // 2 + 1] = wave / wave.max()
    hiss = np.random.default_rng(5).normal(size=(8, 4000))
    before = lone.max()
    after = signals.matched_filter(lone, wave).max() / signals.matched_filter(hiss, wave).std()
    theory = np.linalg.norm(wave / wave.max())
    assert 20 * np.log10(after / before) == pytest.approx(20 * np.log10(theory), abs=0.5)
    assert theory > 3


def test_gain_undoes_the_fall_that_it_describes():
    gain = TimeGain(c1=-0.2655, c2=1.5, c3=0.9, c4=0.3695)
    distance = np.linspace(0, 3, 50)
    assert gain.level(-100.0) == pytest.approx(0.635)
    assert gain.level(100.0) == pytest.approx(0.104)
    assert signals.compensate(gain.level(distance), distance, gain) == pytest.approx(np.ones(50))
    with pytest.raises(ValueError, match="must stay positive"):
        signals.compensate(np.ones(50), distance, TimeGain(-0.5, 1.5, 0.9, 0.2))


def test_steps_in_their_order_are_the_processing():
    """Offset, gain, matched filter, rectify, normalise, low-pass: step by step and together."""
    gain = TimeGain(-0.2, 1.5, 0.9, 0.4)
    how = Processing(gain=gain, prominence=0.005)
    cycles = cycles_at([0.5, 1.2], noise=0.002)
    found = locate(TIME, cycles, how)
    steps = signals.remove_offset(cycles, RATE)
    distance = SPEED * np.maximum(TIME - PULSE_LENGTH / 2, 0) / 2
    steps = signals.compensate(steps, distance, gain)
    steps = signals.matched_filter(steps, signals.template(RATE, CARRIER))
    steps = np.pi / 2 * signals.low_pass(signals.rectify(steps), RATE)
    steps = signals.normalise(steps, found.send_amplitude)
    # The speed of sound at 20 degC is 343.24 m/s.
    np.testing.assert_allclose(found.envelope, steps, rtol=1e-3, atol=1e-4)


OFFSETS = np.linspace(0, 1, 21)


@pytest.mark.parametrize("template_cycles", [None, 10.0])
def test_distance_is_right_at_all_places_and_offsets_between_samples(template_cycles):
    """The bias is under 0.5 mm, the spread under 1 mm, from 0.15 to 2.15 m at 40 dB echo-to-noise.

    21 positions, with 21 offsets within a sample of 0.86 mm each.
    """
    places = np.linspace(0.18, 2.13, 21)
    distance = (places[:, None] + OFFSETS * SPEED / RATE / 2).ravel()
    cycles = cycles_at(distance, height=0.3, noise=0.003)
    how = Processing(template_cycles=template_cycles, prominence=0.05)
    found = locate(TIME, cycles, how, temperature=19.93)  # 343.2 m/s
    assert found.detected.all()
    error = 1e3 * (found.distance - distance)
    assert abs(error.mean()) < 0.5
    assert error.std() < 1.0
    by_place = error.reshape(21, -1)
    assert np.abs(by_place.mean(axis=1)).max() < 0.5


@pytest.mark.parametrize("noise", [0.01, 0.02, 0.04])
@pytest.mark.parametrize("template_cycles", [None, 10])
def test_stated_deviation_is_the_observed_one(template_cycles, noise):
    """The ratio of observed to stated deviation is within 20 %, for 400 cycles at 17 to 30 dB.

    The observed deviation is known to 4 %; the law of the floor by sampling is approximate.
    """
    how = Processing(prominence=0.1, template_cycles=template_cycles)
    places = 1.0 + 1e-3 * np.random.default_rng(0).uniform(-1, 1, 400)
    cycles = cycles_at(places, height=0.3, noise=noise)
    found = locate(TIME, cycles, how)
    assert found.detected.all()
    ratio = np.std(found.distance - places) / np.median(found.distance_deviation)
    assert 1 / 1.2 < ratio < 1.2


def test_error_of_the_temperature_is_in_the_deviation():
    cycles = cycles_at(np.full(1, 1.0), height=0.3, noise=0.015)
    warm = locate(TIME, cycles, Processing(prominence=0.1), temperature_deviation=2.0)
    assert warm.distance_deviation[0] == pytest.approx(1.0 * 2.0 / (2 * 293.15), rel=0.1)


def test_each_cycle_has_the_speed_of_its_own_temperature():
    cycles = np.repeat(cycles_at(1.0), 3, axis=0)
    temperature = np.array([0.0, 20.0, 40.0])
    together = locate(TIME, cycles, temperature=temperature)
    for i, warmth in enumerate(temperature):
        alone = locate(TIME, cycles[i], temperature=warmth)
        assert together.distance[i] == pytest.approx(float(alone.distance), rel=1e-12)
    assert np.all(np.diff(together.distance) > 0.03)
    with pytest.raises(ValueError, match="absolute zero"):
        locate(TIME, cycles, temperature=np.array([20.0, -300.0, 20.0]))


@pytest.mark.parametrize("dtype", [np.uint16, np.int16, np.int32, np.float32])
def test_type_of_the_samples_does_not_matter(dtype):
    """Integers round by 0.3 counts of 1500, single precision by 1e-4."""
    cycles = cycles_at([0.4, 0.9], noise=0.003)
    exact, found = (locate(TIME, samples) for samples in (cycles, cycles.astype(dtype)))
    assert found.distance == pytest.approx(exact.distance, abs=2e-5)
    assert found.amplitude == pytest.approx(exact.amplitude, rel=2e-3)


def test_batch_and_single_cycles_are_equal():
    cycles = cycles_at(np.linspace(0.3, 1.9, 12), noise=0.003).reshape(3, 4, -1)
    how = Processing(gain=TimeGain(-0.2, 1.5, 0.9, 0.4))
    batch = locate(TIME, cycles, how)
    for index in np.ndindex(3, 4):
        alone = locate(TIME, cycles[index], how)
        for name in ("distance", "amplitude", "prominence", "distance_deviation", "detected"):
            assert getattr(batch, name)[index] == pytest.approx(getattr(alone, name), rel=1e-9), (
                name
            )


def test_false_detections_are_rare_and_echoes_at_20_db_are_detected():
    """With a prominence of 2.8 deviations of the rectified noise all echoes at 20 dB are detected.

    In noise alone under 5 % of cycles have a detection.
    """
    hiss = cycles_at(np.full(200, 1.0), height=0.0, noise=0.01)
    heard = cycles_at(np.full(200, 1.0), height=0.1, noise=0.01, seed=2)
    found = locate(TIME, heard, Processing(prominence=0.04))
    assert np.mean(np.abs(found.distance - 1.0) < 0.01) == 1.0
    assert np.mean(locate(TIME, hiss, Processing(prominence=0.04)).detected) < 0.05


def test_carrier_beyond_the_rate_and_short_records_are_refused():
    with pytest.raises(ValueError, match="frequency = 120000 Hz must lie between 0 and half"):
        signals.template(RATE, 120e3)
    with pytest.raises(ValueError, match="shorter than the matched filter's template"):
        signals.matched_filter(np.zeros(20), signals.template(RATE, CARRIER))


def test_templates_of_zeros_and_those_without_a_middle_are_refused():
    for cycles, carrier in ((0.3, CARRIER), (0.5, 50e3)):
        with pytest.raises(ValueError, match=r"is zero at all its samples, [13] at .*more cycles"):
            signals.template(RATE, carrier, cycles)
    with pytest.raises(ValueError, match=r"template has 4 samples .* give an odd number"):
        signals.matched_filter(np.zeros(20), np.ones(4))


@pytest.mark.parametrize(
    "how", [Processing(), Processing(template_cycles=None), Processing(bandwidth=10e3)]
)
@pytest.mark.parametrize("temperature", [20.0, np.empty(0)])
def test_no_cycles_have_no_distances(how, temperature):
    found = locate(TIME, np.empty((0, 4000)), how, temperature=temperature)
    assert found.envelope.shape == (0, 4000)
    assert found.distance.shape == found.distance_deviation.shape == found.detected.shape == (0,)
    with pytest.raises(ValueError, match="give one for all or one for each"):
        locate(TIME, np.zeros((2, 4000)), how, temperature=np.empty(0))


def test_gain_at_a_probe_within_the_tube_is_that_of_the_echos_place():
    """Send pulse and echo are divided by the levels at the probe and at the reflector, to 0.5 %."""
    probe, place, gain = 0.5, 1.5, TimeGain(-0.4, 2.0, 1.0, 0.5)
    heard = burst(probe / SPEED) + float(gain.level(place)) * burst((2 * place - probe) / SPEED)
    how = {"pulse_duration": PULSE_LENGTH, "probe_position": probe, "temperature": 19.93}
    found = signals.process(TIME, heard, gain=gain, nearest=1.0, **how)
    assert found.distance == pytest.approx(place, abs=1e-3)
    assert found.amplitude == pytest.approx(float(gain.level(probe)), rel=5e-3)
