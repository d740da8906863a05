"""Wide-band and audio-band drives: spectra, pulse compression, audibility, and their inversion."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
import test_inversion
import tomlkit
from commands import run_here
from test_inversion import MODES, RADIUS, matrices, press

from acoustube.base.errors import ConfigError
from acoustube.base.foreign.documents import read_document
from acoustube.inversion import Baseband, ForwardModel, Inverter, Library, measured_clutter
from acoustube.inversion.folded import baseband_of
from acoustube.ranging import (
    IDEAL,
    LOUDSPEAKER,
    Burst,
    Chirp,
    Rangefinder,
    Tones,
    a_weighting,
    audible_level,
    blockage,
    record,
    response,
)
from acoustube.recordings import write
from acoustube.runs.sensor_file import add_rangefinder
from acoustube.runs.sweep.dataset import rangefinder_in
from acoustube.runs.twin_calibration import processing_of
from acoustube.signals import (
    Processing,
    calibrate,
    chirp_template,
    find_lead,
    locate,
    matched_filter,
)

BAND = np.array([10.0, 99.99e3])
ULTRASOUND = Rangefinder(
    drive=Chirp(frequency=40e3, bandwidth=20e3, duration=1e-3), quality_factor=3.0, resonance=40e3
)


def processing(rangefinder, **changes):
    drive = rangefinder.drive
    return Processing(
        frequency=drive.frequency, bandwidth=drive.bandwidth,
        pulse_cycles=drive.duration * drive.frequency, **changes,
    )  # fmt: skip


def sensor_file(path, rangefinder, length=250.0):
    document = tomlkit.document()
    document.add("length_cm", length)
    add_rangefinder(document, rangefinder)
    path.write_text(tomlkit.dumps(document))
    return path


@pytest.mark.parametrize(
    "drive",
    [Chirp(), Chirp(window="hann"), Chirp(frequency=10e3, bandwidth=15e3, window="hamming"),
     Chirp(frequency=9e3, bandwidth=20.0), Tones(),
     Tones(frequencies=(9e3, 13e3), order="together")],
)  # fmt: skip
def test_drives_have_the_spectrum_of_their_samples(drive):
    """Closed-form spectra at complex frequencies, against sums over 40 000 samples.

    The error of the midpoint rule is (2 pi f step)^2 / 24 < 1e-5; where two tones meet, half a
    sample is attributed to the wrong tone.
    """
    n = 40_000
    time = (np.arange(n) + 0.5) * drive.duration / n
    frequency = np.linspace(3e3, 60e3, 40) - 40j
    turned = np.exp(-2j * np.pi * np.outer(frequency, time))
    wanted = turned @ drive(time) * drive.duration / n
    assert drive.spectrum(frequency) == pytest.approx(wanted, abs=2e-4 * np.abs(wanted).max())


@pytest.mark.parametrize(
    ("window", "width", "lobe"),
    [("rectangular", 0.886, -13.26), ("hann", 1.44, -31.47), ("hamming", 1.30, -42.7)],
)
def test_compressed_chirp_has_the_width_and_side_lobes_of_its_window(window, width, lobe):
    """Main lobe and side lobes are those of the window's Fourier transform (Harris).

    They are approached as 1/(B T), with B T = 400 here.
    """
    rate, bandwidth, duration = 500e3, 20e3, 20e-3
    chirp = Chirp(frequency=50e3, bandwidth=bandwidth, duration=duration)
    time = np.arange(int(2.2 * duration * rate)) / rate
    template = chirp_template(rate, 50e3, bandwidth, duration, window)
    level = np.abs(matched_filter(chirp(time - 0.6 * duration), template))
    level /= level.max()
    peak = int(level.argmax())
    assert time[peak] == pytest.approx(1.1 * duration, abs=0.5 / rate)
    inside = np.flatnonzero(level > np.sqrt(0.5))
    first, last = inside[0], inside[-1]
    edges = [
        i + (np.sqrt(0.5) - level[i]) / (level[i + step] - level[i]) * step
        for i, step in ((first, -1), (last, 1))
    ]
    assert (edges[1] - edges[0]) / rate * bandwidth == pytest.approx(width, rel=0.02)
    null = peak + int(np.flatnonzero(np.diff(level[peak:]) > 0)[0])
    assert 20 * np.log10(level[null:].max()) == pytest.approx(lobe, abs=0.8)


@pytest.mark.parametrize(("window", "loss"), [("rectangular", 0.0), ("hann", 1.76)])
def test_compression_gains_bandwidth_times_duration(window, loss):
    """The gain in signal-to-noise ratio in the band is B T; a Hann window loses 1.76 dB.

    The noise's variance is known to 1 % from its 2e4 samples, some 8000 of them independent.
    """
    rate, chirp = 200e3, Chirp(frequency=50e3, bandwidth=20e3, duration=2e-3)
    template = chirp_template(rate, 50e3, 20e3, 2e-3, window)
    noise = matched_filter(np.random.default_rng(1).normal(size=(8, 20_000)), template)
    wave = chirp(np.arange(2000) / rate - 3e-3)
    before = 0.5 / (20e3 / (rate / 2))
    after = np.abs(matched_filter(wave, template)).max() ** 2 / np.mean(np.abs(noise) ** 2)
    assert 10 * np.log10(after / before) == pytest.approx(10 * np.log10(40) - loss, abs=0.15)


def test_two_reflectors_are_resolved_from_a_main_lobe_on():
    """Two equal echoes 1.1 c/B apart have two peaks, and 0.5 c/B apart one peak.

    The main lobe of the Hann window is 2 c/B wide between its zeros. There are no losses and no
    other reflections.
    """
    bandwidth, speed = 20e3, 343.2
    time = np.arange(4000) / 200e3
    chirp = Chirp(frequency=40e3, bandwidth=bandwidth, duration=1e-3)
    sensor = replace(ULTRASOUND, drive=chirp)
    for apart, number in ((1.1, 2), (0.5, 1)):
        delays = 6e-3 + 2 * apart / bandwidth * np.array([0, 1])
        cycle = chirp(time) + 0.3 * sum(chirp(time - delay) for delay in delays)
        found = locate(time, cycle, processing(sensor, prominence=0.05))
        assert np.isfinite(found.echoes.times).sum() == number
        if number == 2:
            places = speed / 2 * (found.echoes.times - found.send_time)
            assert np.diff(places) == pytest.approx(apart * speed / bandwidth, abs=2e-3)


@pytest.mark.parametrize("noise", [0.02, 0.1])
def test_stated_deviation_of_compressed_echoes_is_the_observed_one(noise):
    """The stated deviation is within 20 % of the spread of 200 cycles.

    The spread is known to 5 %; the side lobes add to the stated deviation.
    """
    rate, chirp = 200e3, Chirp(frequency=9e3, bandwidth=12e3, duration=1e-3)
    time = np.arange(4000) / rate
    cycles = chirp(time) + 0.2 * chirp(time - 6e-3)
    cycles = cycles + noise * np.random.default_rng(2).normal(size=(200, len(time)))
    sensor = replace(LOUDSPEAKER, drive=chirp)
    found = locate(time, cycles, processing(sensor, prominence=0.05))
    assert np.median(found.distance_deviation) == pytest.approx(found.distance.std(), rel=0.2)


def test_closures_are_located_by_a_compressed_chirp_in_the_audio_band():
    """Distances are right within 0.4 mm after a bias of 0.15 %.

    The bias is the effect of the wall's boundary layer, which slows sound of 9 kHz in a bore of
    7.9 mm.
    """
    quiet = replace(LOUDSPEAKER, temperature_bias=0.0, temperature_noise=0.0)
    for place in (0.35, 1.0, 2.0):
        cycles = record([blockage(BAND, place)], quiet, n_cycles=2)
        found = locate(cycles["time"].values, cycles["signal"].values, processing(quiet))
        assert found.distance == pytest.approx(1.0015 * place, abs=0.4e-3)
    near = record([blockage(BAND, 0.12)], quiet)
    found = locate(near["time"].values, near["signal"].values, processing(quiet, nearest=0.0))
    # The echo begins while the chirp, 0.17 m long, is sent: at most the second echo is detected.
    assert not found.detected.any() or found.distance[0] > 0.17


@pytest.mark.parametrize("lead", [0.0, 2e-3])
@pytest.mark.parametrize("duration", [1e-3, 4e-3])
def test_lead_of_a_chirp_is_found(duration, lead):
    """It is within 30 us: the loudspeaker's own delay is 18 us."""
    drive = replace(LOUDSPEAKER.drive, duration=duration)
    sensor = replace(LOUDSPEAKER, drive=drive, lead=lead)
    cycles = record([blockage(BAND, 1.5)], sensor, n_cycles=2)
    time, signal = cycles["time"].values, cycles["signal"].values
    assert find_lead(time, signal, processing(sensor)) == pytest.approx(lead, abs=3e-5)


def test_calibration_compresses_chirps_and_keeps_them_in_its_file(tmp_path):
    from acoustube.signals import load, save

    places = np.repeat(np.linspace(0.35, 2.0, 12), 2)
    smooth = replace(ULTRASOUND, clutter=0.0)
    shut = [record([blockage(BAND, z)], smooth, seed=i) for i, z in enumerate(places)]
    free = record([], smooth, n_cycles=60, seed=90)
    cycles = np.concatenate([one["signal"].values for one in shut])
    how = processing(ULTRASOUND, nearest=0.25)  # behind the ring-down
    found = calibrate(
        free["time"].values, cycles, places, free["signal"].values, how,
        temperature=20.0, untouched_temperature=20.0, sigmas=8.0,
    )  # fmt: skip
    assert found.slope.value == pytest.approx(1, abs=2e-3)
    assert found.distance_rmse < 1e-3
    assert found.false_alarms < 0.1
    save(found, tmp_path / "c.toml")
    assert load(tmp_path / "c.toml").processing == found.processing


def test_loudspeaker_passes_its_band_with_the_slopes_of_second_order():
    for frequency, level in ((1e3, -3.01), (18e3, -3.0), (100.0, -40.0), (180e3, -40.0)):
        passed = 20 * np.log10(np.abs(LOUDSPEAKER.passband(np.array([frequency]))[0]))
        assert passed == pytest.approx(level, abs=0.1)
    # The own drive nearly fills the converter without clipping, as its description states.
    _, volts = response([], LOUDSPEAKER)
    assert 0.85 < np.abs(volts[:200]).max() < 0.9


def test_weighting_is_that_of_the_standard():
    """A-weighting is that of IEC 61672-1, table of design goals, to its rounding."""
    frequency = np.array([31.5, 100.0, 1000.0, 4000.0, 10e3, 16e3])
    wanted = [-39.4, -19.1, 0.0, 1.0, -2.5, -6.6]
    assert 20 * np.log10(a_weighting(frequency)) == pytest.approx(wanted, abs=0.15)


def test_audible_level_of_a_steady_tone_is_zero_and_of_ultrasound_far_below():
    steady = Rangefinder(
        drive=Burst(frequency=1e3, cycles=50, shape="sine"), quality_factor=0.0, cycle_rate=20.0
    )
    assert audible_level(steady) == pytest.approx(0.0, abs=0.05)
    # Twenty cycles of 1 ms per second: 10 log10(0.02), plus the mean weighting of the band.
    assert audible_level(LOUDSPEAKER) == pytest.approx(-18, abs=2)
    assert audible_level(Rangefinder()) < -70
    assert audible_level(ULTRASOUND) < -50


@pytest.mark.parametrize("duration", [0.1, 0.3, 1.0])
def test_audible_level_of_a_tone_without_pauses_does_not_depend_on_its_duration(duration):
    """It is the weighting at its frequency, which is on no grid of 10 Hz."""
    drive = Tones(frequencies=(2005.0,), duration=duration)
    steady = Rangefinder(drive=drive, resonance=2005.0, quality_factor=0.0, cycle_rate=1 / duration)
    expected = 20 * np.log10(a_weighting(np.array(2005.0)))
    assert audible_level(steady) == pytest.approx(expected, abs=0.01)


def test_audible_level_does_not_depend_on_the_rate_of_the_adc():
    ideal = audible_level(IDEAL)
    for rate in (2e3, 44.1e3, 200001.7):
        slow = replace(IDEAL, sampling_rate=rate)
        assert audible_level(slow) == pytest.approx(ideal, abs=1e-3)


def wide_library():
    frequency = np.arange(1e3, 60e3, 100.0)
    depth = np.arange(1e-3, 7.01e-3, 0.1e-3)
    return Library((test_inversion.tool(frequency=frequency, s=matrices(depth, frequency)),))


@pytest.mark.parametrize("sensor", [ULTRASOUND, LOUDSPEAKER], ids=["ultrasound", "loudspeaker"])
def test_inversion_follows_the_band_of_the_drive(sensor):
    """The forward model is the recording, to 2e-3; a single cycle gives both presses."""
    library, frequency = wide_library(), np.arange(150.0, 99.9e3, 100.0)
    silent = replace(sensor, clutter=0.0, noise=0.0, drift=0.0, quantised=False, far_reflection=0.0)
    base = Baseband(silent, RADIUS, 2.5, 20.0, MODES)
    middle, wide = sensor.drive.frequency, sensor.drive.bandwidth
    assert base.frequency[[0, -1]] == pytest.approx([middle - 0.6 * wide, middle + 0.6 * wide], 60)
    given, _ = base.of_cycles(
        record([press(5.03e-3, 0.8, frequency)], silent, n_cycles=1)["signal"].values
    )
    place, depth = np.array([[0.8]]), np.array([[5.03e-3]])
    found, _ = ForwardModel(library, base).baseband((0,), place, depth, np.zeros((1, 7)))
    assert np.abs(found[0] - given).max() < 2e-3 * np.abs(given).max()
    # Compressed: most of the energy lies within 3 / bandwidth of the middle of the echo.
    energy = np.abs(given) ** 2
    delay = 1.6 / base.speed + sensor.drive.duration / 2
    assert energy[np.abs(base.window - delay) < 3 / wide].sum() > 0.8 * energy.sum()
    own = Baseband(sensor, RADIUS, 2.5, 20.0, MODES)
    untouched = record([], sensor, n_cycles=60, tube_seed=7, seed=11)["signal"].values
    inverter = Inverter(ForwardModel(library, own, measured_clutter(own, untouched)))
    truth = [(0.6, 4e-3), (1.2, 5.1e-3)]
    presses = [press(d, z, frequency) for z, d in truth]
    cycle = record(presses, sensor, n_cycles=1, tube_seed=7, seed=3)["signal"].values
    contacts = inverter(cycle).contacts
    assert len(contacts) == 2
    for contact, (z, d) in zip(contacts, truth, strict=True):
        assert contact.distance.value == pytest.approx(z, abs=1e-3)
        assert contact.depth.value == pytest.approx(d, abs=0.2e-3)


def test_settings_out_of_range_are_one_sentence_each():
    cases = [
        (lambda: Chirp(frequency=9e3, bandwidth=18e3), "bandwidth"),
        (lambda: Chirp(duration=-1.0), "duration"),
        (lambda: Chirp(window="triangle"), "window"),
        (lambda: Tones(frequencies=()), "frequencies"),
        (lambda: Tones(frequencies=(20e3, "loud")), "frequencies"),
        (lambda: Tones(order="backwards"), "order"),
        (lambda: Rangefinder(low_corner=2e3, high_corner=1e3), "low_corner"),
        (lambda: chirp_template(100e3, 45e3, 20e3, 1e-3), "frequency"),
        (lambda: chirp_template(1e6, 45e3, 20e3, 10.0), "duration"),
        (lambda: Processing(window="triangle"), "window"),
        (lambda: Processing(bandwidth=-1.0), "bandwidth"),
        (lambda: Processing(template_cycles=0.3), "template_cycles"),
        (lambda: Processing(nearest=2.0, farthest=1.0), "nearest"),
    ]
    for call, name in cases:
        with pytest.raises(ConfigError) as caught:
            call()
        assert caught.value.setting == name
    wide = replace(LOUDSPEAKER, drive=Chirp(frequency=9e3, bandwidth=17e3))
    with pytest.raises(ConfigError, match="too wide to invert"):
        baseband_of(wide, RADIUS, 2.5, 20.0, MODES)
    with pytest.raises(ConfigError, match="record at"):
        baseband_of(replace(ULTRASOUND, sampling_rate=90e3), RADIUS, 2.5, 20.0, MODES)


@pytest.mark.parametrize(
    "drive", [Chirp(window="hann"), Tones(frequencies=(9e3, 11e3)), Burst(cycles=4.0)]
)
def test_drives_pass_through_the_sensors_file(tmp_path, drive):
    sensor = replace(LOUDSPEAKER, drive=drive)
    path = tmp_path / "own.toml"
    document = tomlkit.document()
    add_rangefinder(document, sensor)
    path.write_text(tomlkit.dumps(document))
    assert rangefinder_in(read_document(path), path) == sensor
    assert json.loads(sensor.to_json())["drive"]["kind"] == type(drive).__name__


def test_process_compresses_what_the_sensors_file_states(tmp_path):
    sensor = sensor_file(tmp_path / "s.toml", LOUDSPEAKER)
    cycles = record([blockage(BAND, 0.9)], LOUDSPEAKER, n_cycles=3)
    write(cycles, tmp_path / "cycles.nc")
    done = run_here(
        "process", tmp_path / "cycles.nc", "--sensor", sensor, "--out", tmp_path / "d.csv"
    )
    assert done.returncode == 0, done.stderr
    with (tmp_path / "d.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["distance_cm"]) for row in rows] == pytest.approx([90.13] * 3, abs=0.1)
    assert processing_of(sensor).bandwidth == LOUDSPEAKER.drive.bandwidth
    # A long burst too is blind while it lasts.
    (tmp_path / "burst.toml").write_text("length_cm = 200\n[drive]\nkind = 'Burst'\ncycles = 40\n")
    assert processing_of(tmp_path / "burst.toml").pulse_cycles == pytest.approx(40)
    tones = sensor_file(tmp_path / "t.toml", replace(LOUDSPEAKER, drive=Tones()))
    done = run_here("process", tmp_path / "cycles.nc", "--sensor", tones)
    assert done.returncode == 2
    assert "Tones" in done.stderr
    assert "Traceback" not in done.stderr
