"""From pressure to distance, on synthetic echoes whose delay and height are known exactly."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from acoustube import signals

CARRIER = 42e3
DURATION = 11 / CARRIER
SPEED = 343.2
SENT, RETURNED = 0.2e-3, 1.3e-3


def clock(rate=2e6, duration=3e-3):
    """Return sampling times in s."""
    return np.arange(round(duration * rate)) / rate


def pulse(time, centre, duration=DURATION):
    """Return an 11-cycle sine under a Gaussian that has decayed to 1 % where it is cut."""
    envelope = np.exp(-0.5 * ((time - centre) / (duration / 6)) ** 2)
    inside = np.abs(time - centre) < duration / 2
    return np.where(inside, envelope, 0.0) * np.sin(2 * np.pi * CARRIER * (time - centre))


def sent_and_returned(time, height=0.1, returned=RETURNED):
    """Return a send pulse of amplitude 1 and one echo."""
    return pulse(time, SENT) + height * pulse(time, returned)


@pytest.mark.parametrize(("rate", "bias"), [(200e3, 0.3), (2e6, 0.1), (4e6, 0.03)])
def test_delay_is_exact_at_every_sub_sample_offset(rate, bias):
    # The error is aliasing of the overtones of the rectified carrier, see signals.process.
    time = clock(rate)
    offsets = np.linspace(0, 1, 41) / rate
    cycles = np.stack([sent_and_returned(time, returned=RETURNED + o) for o in offsets])
    ranging = signals.process(time, cycles, pulse_duration=DURATION)
    error = (ranging.return_time - (RETURNED + offsets)) * rate
    assert np.all(np.abs(error) < bias)
    assert abs(error.mean()) < 0.02


def test_parabola_alone_finds_the_top_of_a_gaussian_within_a_thousandth_of_a_sample():
    rate = 200e3
    time = clock(rate)
    offsets = np.linspace(0, 1, 41) / rate
    tops = np.exp(-0.5 * ((time - RETURNED - offsets[:, np.newaxis]) / 50e-6) ** 2)
    echoes = signals.find_echoes(time, tops)
    np.testing.assert_allclose(echoes.times[:, 0] - RETURNED, offsets, atol=1e-3 / rate)
    np.testing.assert_allclose(echoes.amplitudes[:, 0], 1, rtol=1e-4)


@pytest.mark.parametrize("height", [1.0, 0.5, 0.1, 0.02])
def test_amplitude_is_the_echos_share_of_the_send_pulse(height):
    time = clock()
    ranging = signals.process(time, sent_and_returned(time, height), pulse_duration=DURATION)
    assert ranging.amplitude == pytest.approx(height, rel=1e-4)
    assert ranging.echoes.prominences[0] == pytest.approx(height, rel=0.05)


def test_distance_is_counted_from_the_source_end():
    time = clock()
    ranging = signals.process(
        time, sent_and_returned(time), pulse_duration=DURATION, probe_position=0.02
    )
    assert ranging.detected
    assert ranging.distance == pytest.approx(0.02 + SPEED * (RETURNED - SENT) / 2, abs=1e-4)


def test_one_metre_is_twice_the_way_at_the_speed_of_the_air():
    assert signals.distance(2 / SPEED, 20) == pytest.approx(1, rel=1e-4)
    # An ideal gas: the speed grows with the root of the absolute temperature.
    ratio = signals.distance(1.0, 40) / signals.distance(1.0, 0)
    assert ratio == pytest.approx(np.sqrt(313.15 / 273.15), rel=1e-6)


@given(scale=st.floats(1e-6, 1e6))
@settings(deadline=None, max_examples=20)
def test_unit_of_the_pressure_does_not_matter(scale):
    time = clock(400e3)
    plain = signals.process(time, sent_and_returned(time), pulse_duration=DURATION)
    scaled = signals.process(time, scale * sent_and_returned(time), pulse_duration=DURATION)
    assert scaled.distance == pytest.approx(plain.distance, rel=1e-9)
    assert scaled.amplitude == pytest.approx(plain.amplitude, rel=1e-9)
    assert scaled.send_amplitude == pytest.approx(scale * plain.send_amplitude, rel=1e-9)


def test_batch_equals_single_cycles():
    time = clock(400e3)
    two_echoes = sent_and_returned(time) + 0.2 * pulse(time, 2e-3)
    batch = np.stack([sent_and_returned(time), two_echoes, pulse(time, SENT), 0 * time])
    together = signals.process(time, batch.reshape(2, 2, -1), pulse_duration=DURATION)
    for index, cycle in zip(np.ndindex(2, 2), batch, strict=True):
        alone = signals.process(time, cycle, pulse_duration=DURATION)
        for name in ("envelope", "send_time", "return_time", "amplitude", "distance", "detected"):
            np.testing.assert_array_equal(
                getattr(together, name)[index], getattr(alone, name), err_msg=name
            )
        count = alone.echoes.times.size
        np.testing.assert_array_equal(together.echoes.times[index][:count], alone.echoes.times)
        assert np.isnan(together.echoes.times[index][count:]).all()
    np.testing.assert_array_equal(together.detected, [[True, True], [False, False]])


def test_highest_echo_counts_not_the_first():
    time = clock()
    pressure = sent_and_returned(time, 0.1) + 0.2 * pulse(time, 2e-3)
    ranging = signals.process(time, pressure, pulse_duration=DURATION)
    np.testing.assert_allclose(ranging.echoes.times, [RETURNED, 2e-3], atol=1e-7)
    assert ranging.return_time == pytest.approx(2e-3, abs=1e-7)


@pytest.mark.parametrize(
    ("window", "expected"),
    [({}, 2e-3), ({"farthest": 0.25}, RETURNED), ({"nearest": 0.25}, 2e-3)],
)
def test_search_window_is_in_distance(window, expected):
    # The echoes lie at 18.9 and 30.9 cm.
    time = clock()
    pressure = sent_and_returned(time, 0.1) + 0.2 * pulse(time, 2e-3)
    ranging = signals.process(time, pressure, pulse_duration=DURATION, **window)
    assert ranging.return_time == pytest.approx(expected, abs=1e-7)


@pytest.mark.parametrize("cutoff", [5e3, 10e3, 20e3])
@pytest.mark.parametrize("cycles", [3, 11, 30])
def test_send_pulse_alone_is_no_echo(cycles, cutoff):
    duration = cycles / CARRIER
    time = clock()
    ranging = signals.process(
        time, pulse(time, duration / 2, duration), pulse_duration=duration, cutoff=cutoff
    )
    assert not ranging.detected
    assert np.isnan(ranging.distance)
    assert np.isnan(ranging.amplitude)
    assert ranging.echoes.times.size == 0


@pytest.mark.parametrize(("later", "believed"), [(0.20e-3, False), (0.30e-3, True)])
def test_ringing_before_the_send_pulse_has_faded_is_no_echo(later, believed):
    # An eleven-cycle pulse and the filter take 0.131 + 0.1 ms to fade; these are three cycles long.
    time = clock()
    short = 3 / CARRIER
    pressure = pulse(time, SENT, short) + 0.3 * pulse(time, SENT + later, short)
    assert signals.process(time, pressure, pulse_duration=DURATION).detected == believed


@pytest.mark.parametrize("level", [0.0, 1.0, -3.0])
def test_constant_signal_is_no_echo(level):
    time = clock()
    ranging = signals.process(time, np.full_like(time, level), pulse_duration=DURATION)
    assert not ranging.detected
    assert np.isnan(ranging.distance)


def test_echo_below_the_prominence_is_no_echo():
    time = clock()
    pressure = sent_and_returned(time, 0.02)
    assert signals.process(time, pressure, pulse_duration=DURATION, prominence=0.015).detected
    assert not signals.process(time, pressure, pulse_duration=DURATION, prominence=0.025).detected


def test_echo_cut_by_the_end_of_the_record_is_no_echo():
    time = clock(duration=RETURNED - 20e-6)
    ranging = signals.process(time, sent_and_returned(time), pulse_duration=DURATION)
    assert not ranging.detected


@pytest.mark.parametrize(("rate", "ripple"), [(200e3, 0.01), (2e6, 0.003)])
def test_envelope_of_a_steady_sine_is_its_amplitude(rate, ripple):
    time = clock(rate)
    found = signals.envelope(3 * np.sin(2 * np.pi * CARRIER * time + 0.3), rate)
    margin = round(3e-4 * rate)
    np.testing.assert_allclose(found[margin:-margin], 3, rtol=ripple)
    np.testing.assert_allclose(found, 3, rtol=0.05)


def test_low_pass_has_no_delay_and_the_stated_gain():
    rate = 1e6
    time = clock(rate, 20e-3)
    for frequency in (1e3, 5e3, 10e3, 20e3, 40e3):
        tone = np.sin(2 * np.pi * frequency * time)
        middle = slice(8000, 12000)  # whole periods of every tone
        found = signals.low_pass(tone, rate, 10e3)[middle]
        gain = 2 * np.mean(found * tone[middle])
        assert gain == pytest.approx(1 / (1 + (frequency / 10e3) ** 4), abs=0.003)
        quadrature = 2 * np.mean(found * np.cos(2 * np.pi * frequency * time[middle]))
        assert quadrature == pytest.approx(0, abs=1e-4)


def test_each_step_is_scipys_on_every_cycle():
    rng = np.random.default_rng(1)
    rate, cycles = 200e3, rng.standard_normal((3, 400))
    sections = signal.butter(2, 10e3, fs=rate, output="sos")
    plain = np.stack(
        [signal.sosfiltfilt(sections, np.abs(c), padtype="even", padlen=60) for c in cycles]
    )
    np.testing.assert_array_equal(signals.rectify(cycles), np.abs(cycles))
    np.testing.assert_allclose(signals.low_pass(np.abs(cycles), rate), plain, rtol=1e-12)
    time = np.arange(400) / rate
    echoes = signals.find_echoes(time, plain, start=time[50], stop=time[350], prominence=0.2)
    for row, cycle in enumerate(plain):
        index, found = signal.find_peaks(cycle[50:351], prominence=0.2)
        count = len(index)
        assert count > 0
        np.testing.assert_allclose(echoes.times[row, :count], time[index + 50], atol=0.5 / rate)
        np.testing.assert_allclose(echoes.prominences[row, :count], found["prominences"])
        assert np.isnan(echoes.prominences[row, count:]).all()


def test_normalising_before_or_after_the_low_pass_is_the_same():
    time = clock(400e3)
    pressure = sent_and_returned(time)
    after = signals.normalise(signals.envelope(pressure, 400e3), 2.0)
    before = np.pi / 2 * signals.low_pass(signals.normalise(signals.rectify(pressure), 2.0), 400e3)
    np.testing.assert_allclose(after, before, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("name", ["start", "stop"])
def test_windows_of_another_number_are_refused(name):
    time = np.arange(100) * 1e-5
    with pytest.raises(ValueError, match=rf"{name} has shape \(5,\)"):
        signals.find_echoes(time, np.ones((3, 100)), **{name: np.linspace(0, 1e-3, 5)})


def test_wrong_signals_are_refused_with_the_reason():
    time = clock()
    good = sent_and_returned(time)
    bad = good.copy()
    bad[17] = np.nan
    for wrong_time, pressure, reason in (
        (time, bad, r"1 values that are not finite, the first at index \(17,\)"),
        (time, np.where(good > 0.5, np.inf, good), "not finite"),
        (time[:-1], good, "last axis"),
        (time[:100], good[:100], "too short"),
        (time[::-1], good, "not evenly spaced"),
        (time**2, good, "not evenly spaced"),
        (1e10 * time, good, "time has steps of"),
        (np.where(time > 1e-3, np.nan, time), good, "not finite"),
        (time[:1], good[:1], "at least two samples"),
        (time + 1, good, "leaves fewer than 3 samples"),
    ):
        with pytest.raises(ValueError, match=reason):
            signals.process(wrong_time, pressure, pulse_duration=DURATION)
    with pytest.raises(ValueError, match="half the sampling rate"):
        signals.low_pass(good, 15e3, 10e3)
    for filtered in (signals.low_pass, signals.remove_offset):  # SciPy's sections would be singular
        with pytest.raises(ValueError, match=r"rate of 1e\+12 Hz"):
            filtered(good, 1e12, 100.0)


def test_single_precision_times_are_accepted():
    time = clock(4e6)
    ranging = signals.process(
        time.astype(np.float32),
        sent_and_returned(time).astype(np.float32),
        pulse_duration=DURATION,
    )
    assert ranging.return_time == pytest.approx(RETURNED, abs=1e-7)
