"""Recordings of a simulated rangefinder: delays, levels and statistics against closed forms."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from refusals import refused
from scipy.optimize import curve_fit
from scipy.signal import hilbert

from acoustube import signals
from acoustube.air import air_at
from acoustube.base.netcdf import write_dataset
from acoustube.ranging import (
    IDEAL,
    Burst,
    Chirp,
    Rangefinder,
    Tones,
    blockage,
    clutter,
    record,
    response,
)
from acoustube.ranging.analogue import oversampling
from acoustube.signals.peaks import _refine
from acoustube.waves import (
    Bent,
    PlacedScatterer,
    Pulse,
    SampledPulse,
    axial_wavenumber,
    joined_bends,
)

BORE = 3.95e-3
BAND = np.array([0.0, 99.99e3])
QUIET = {"noise": 0.0, "clutter": 0.0, "drift": 0.0}
AIR = air_at(20.0)
LINEAR = 0.9 / 2048
"""Volts per count of the default ADC."""


def partial(reflection, position):
    """Return a lossless press with the same reflection at all frequencies."""
    closed = blockage(BAND, position).scattering
    s = np.zeros_like(closed.s)
    s[:, (0, 1), 0, (0, 1), 0] = reflection
    s[:, (0, 1), 0, (1, 0), 0] = 1j * np.sqrt(1 - reflection**2)
    return PlacedScatterer(replace(closed, s=s), position)


def echo(presses, rangefinder, **words):
    """Return the voltage by the echoes of the tube, without the drive itself: (time, voltage)."""
    return response(presses, replace(rangefinder, send=0.0), **words)


def spectrum(time, voltage, frequency):
    """Return the Fourier transform of samples at any frequencies, in V s."""
    return np.exp(-2j * np.pi * np.outer(frequency, time)) @ voltage * (time[1] - time[0])


def height(voltage):
    """Return the envelope, from the analytic signal."""
    return np.abs(hilbert(voltage))


@pytest.mark.parametrize("distance", [0.2, 0.75, 1.234])
@pytest.mark.parametrize("temperature", [5.0, 30.0])
def test_ideal_echo_has_the_delay_and_loss_of_the_lossy_plane_mode(distance, temperature):
    """Over the pulse's band the echo's spectrum is exp(-2j kz l) times that of the pulse.

    The pulse is transformed from samples at 20 MHz. The response is computed at complex
    frequencies, but the air's absorption at their real parts: off by 2 * 230/s / omega = 1.7e-3 of
    0.15 Np/m, over 2.5 m some 5e-4 rad, or 2 ns.
    """
    frequency = np.linspace(38e3, 46e3, 33)
    t, volts = echo([blockage(BAND, distance)], IDEAL, temperature=temperature)
    fine = np.arange(0, 3e-4, 5e-8)
    sent = spectrum(fine, 0.9 * IDEAL.drive(fine), frequency)
    kz = axial_wavenumber(0, 0, frequency, BORE, air_at(temperature))
    found = spectrum(t, volts, frequency) / sent
    assert found == pytest.approx(np.exp(-2j * kz * distance), rel=1e-3)


def test_ideal_echo_peaks_where_a_fine_transform_has_it():
    """The envelope's maximum for 0.7 m is compared with one at 2 MHz and real frequencies.

    A parabola through three samples of 5 us of an envelope with a standard deviation of 44 us has
    an error of 0.1 us, a fiftieth of a sample. The maximum itself comes 0.5 us after the group
    delay at 42 kHz, since the losses tilt the spectrum: a tenth of a sample.
    """
    t, volts = echo([blockage(BAND, 0.7)], IDEAL)
    fine = np.arange(80_000) * 5e-7
    f = np.fft.rfftfreq(fine.size, 5e-7)[1:]
    way = np.exp(-1.4j * axial_wavenumber(0, 0, f, BORE, AIR))
    far = np.fft.irfft(np.append(0, np.fft.rfft(IDEAL.drive(fine))[1:] * way), fine.size)
    found, wanted = (
        _refine(x, height(y), np.array([np.argmax(height(y))]))[0][0]
        for x, y in ((t, volts), (fine, far))
    )
    assert found == pytest.approx(wanted, abs=0.2e-6)
    near = 42e3 + np.array([-100.0, 100.0])
    phase = 1.4 * axial_wavenumber(0, 0, near, BORE, AIR).real
    group = (phase[1] - phase[0]) / (2 * np.pi * 200)
    assert found - IDEAL.drive.duration / 2 == pytest.approx(group, abs=0.7e-6)


def test_face_reflects_the_echo_repeatedly():
    """The sum of repeated echoes is 1 / (1 - r B), with the face's reflection r, to 1e-4.

    The tolerance is the error of the absorption in the test above, over the echoes' path of 0.8 m,
    halved.
    """
    frequency, face = np.linspace(40e3, 44e3, 9), 0.4 - 0.3j
    words = {"presses": [blockage(BAND, 0.4)]}
    t, once = echo(rangefinder=IDEAL, **words)
    _, often = echo(rangefinder=replace(IDEAL, face_reflection=face), **words)
    kz = axial_wavenumber(0, 0, frequency, BORE, AIR)
    # For a real signal the face's reflection is conjugate at negative frequencies, as assumed here.
    wanted = 1 / (1 - face * np.exp(-0.8j * kz))
    assert spectrum(t, often, frequency) / spectrum(t, once, frequency) == pytest.approx(
        wanted, rel=1e-4
    )


def test_far_end_answers_through_the_tube():
    """An end that reflects 0.5 at 1 m gives half of the echo of a closure, to rounding."""
    _, end = echo([], replace(IDEAL, far_reflection=0.5), length=1.0)
    _, closed = echo([blockage(BAND, 1.0)], IDEAL, length=1.1)
    assert end == pytest.approx(0.5 * closed, abs=1e-12)


def test_resonator_passes_a_band_of_f0_over_q_and_rings_with_its_time_constant():
    """Half the power at f0 (sqrt(1 + 1/4Q^2) +- 1/2Q); the record decays as exp(-pi f0 t / Q).

    The closed form is exact. The decay is fitted between 0.5 and 1.2 ms: the ring-down has fallen
    by 57 dB there, and the filter's spread over the record is 60 dB below: 0.1 %.
    """
    r = Rangefinder(quality_factor=14.0, gain=0.0, quantised=False, **QUIET)
    edges = 42e3 * (np.sqrt(1 + 1 / 784) + np.array([-1, 1]) / 28)
    assert np.abs(r.resonator(np.array([42e3 + 0j, *edges]))) ** 2 == pytest.approx([1, 0.5, 0.5])
    t, volts = response([], r)
    part = (t > 0.5e-3) & (t < 1.2e-3)
    slope = np.polyfit(t[part], np.log(height(volts)[part]), 1)[0]
    assert slope == pytest.approx(-np.pi * 42e3 / 14, rel=1e-3)


def test_echo_passes_the_resonator_twice_and_the_own_drive_once():
    """The ratios to a flat sensor are H^2 for the echo and H for the drive.

    To rounding, except for the part of the filter's response before the record's 1 ms of lead:
    3e-6.
    """
    frequency = np.linspace(36e3, 48e3, 25)
    flat, resonant = (replace(IDEAL, quality_factor=q, lead=1e-3) for q in (0.0, 14.0))
    h = resonant.resonator(frequency)
    for send, gain, wanted in ((0.0, 0.9, h**2), (0.9, 0.0, h)):
        (t, a), (_, b) = (
            response([blockage(BAND, 0.3)], replace(r, send=send, gain=gain))
            for r in (flat, resonant)
        )
        assert spectrum(t, b, frequency) / spectrum(t, a, frequency) == pytest.approx(
            wanted, rel=1e-5
        )


def peaks(presses, rangefinder):
    """Return the times of the envelope's peaks, of a prominence of ten times the noise."""
    ds = record(presses, rangefinder)
    envelope = signals.envelope(ds.signal.values[0] - 2048.0, 200e3)
    return signals.find_echoes(ds.time.values, envelope, start=6e-4, prominence=10.0).times


def found_at(distance, rangefinder, reflection=0.2):
    """Return whether a press adds a peak near its time to those of the untouched tube."""
    press = [partial(reflection, distance)]
    time, alone = echo(press, rangefinder)
    due = time[np.argmax(height(alone))]
    without = peaks([], rangefinder)
    new = [t for t in peaks(press, rangefinder) if np.all(np.abs(t - without) > 20e-6)]
    return bool(np.any(np.abs(np.array(new) - due) < 2 * 0.02 / 343))


def test_ring_down_hides_echoes_from_the_first_15_cm():
    """Of a press that reflects a fifth; a prominence of 10 counts is over 10 times the noise."""
    r = Rangefinder()
    assert [found_at(d, r) for d in (0.08, 0.10, 0.12, 0.14, 0.15)] == [False] * 5
    assert [found_at(d, r) for d in (0.2, 0.25, 0.3)] == [True] * 3
    # Without the ring-down they are detected.
    assert all(found_at(d, replace(r, send=0.9)) for d in (0.12, 0.14))


def test_calibration_has_the_published_asymptotes():
    """The reason of the default gain: an arctangent through closures as published.

    Closures from 0.2 to 2 m, envelopes relative to the send pulse. Published, as asymptotes of the
    tanh with the same parameters: 0.635 and 0.104. The fit depends on the clutter by some
    hundredths, and the scatter about it in the paper is 0.025.
    """
    distances = np.arange(0.2, 2.01, 0.05)
    heights = []
    for distance in distances:
        ds = record([blockage(BAND, distance)])
        t, counts = ds.time.values, ds.signal.values[0].astype(float)
        envelope = signals.envelope(counts - np.median(counts), 200e3)
        due = (t > 2 * distance / 343) & (t < 2 * distance / 343 + 8e-4)
        heights.append(envelope[due].max() / envelope[t < 1e-3].max())

    def arctan(x, c1, c2, c3, c4):
        return c1 * np.arctan(c2 * (x - c3)) + c4

    found, _ = curve_fit(arctan, distances, heights, p0=(-0.27, 4, 0.2, 0.37))
    c1, _, _, c4 = found
    assert (c4 - c1, c4 + c1) == pytest.approx((0.635, 0.104), abs=0.03)
    assert np.std(heights - arctan(distances, *found)) < 0.0254


def test_noise_has_its_level_and_the_counts_their_steps():
    """Standard deviation and mean of 64 000 samples are right within five standard errors.

    The noise is 5 counts. Rounding adds a variance of 1/12, as its error is uniform and independent
    when the noise is wide against the steps. The offset is 2000.3 counts.
    """
    r = Rangefinder(send=0.0, gain=0.0, drift=0.0, noise=5 * LINEAR, offset=2000.3 * LINEAR)
    counts = record([], r, n_cycles=16).signal.values
    assert counts.dtype == np.uint16
    sigma, n = np.sqrt(25 + 1 / 12), counts.size
    assert counts.std() == pytest.approx(sigma, abs=5 * sigma / np.sqrt(2 * n))
    assert counts.mean() == pytest.approx(2000.3, abs=5 * sigma / np.sqrt(n))
    # White: neighbours, and neighbouring cycles, are uncorrelated.
    white = (counts - counts.mean()) / counts.std()
    for a, b in ((white[:, 1:], white[:, :-1]), (white[1:], white[:-1])):
        assert abs(np.mean(a * b)) < 5 / np.sqrt(a.size)


def test_drift_wanders_slowly_with_its_level():
    """The rms of the slow sines over 15 000 s is the level, to 5 % for 15 periods of the slowest.

    Between neighbouring cycles, 50 ms apart, the drift changes by less than the sum of the sines'
    slopes.
    """
    r = Rangefinder(send=0.0, gain=0.0, noise=0.0, clutter=0.0, quantised=False, n_samples=16)
    slow = record([], replace(r, cycle_rate=0.13, drift=0.01, drive=Burst(frequency=1e6)),
                  n_cycles=2000)  # fmt: skip
    means = slow.signal.values.mean(axis=1) * LINEAR - r.offset
    assert means.std() == pytest.approx(0.01, rel=0.05)
    quick = record([], replace(r, drift=0.01, drive=Burst(frequency=1e6)), n_cycles=100)
    steps = np.diff(quick.signal.values[:, 0]) * LINEAR
    assert 0 < np.abs(steps).max() < 0.01 * np.sqrt(2 / 8) * 2 * np.pi * 0.05 * 0.25


def test_cycles_are_the_same_in_whatever_run():
    """Equal bit by bit; another seed or another cycle gives other noise."""
    r = Rangefinder()
    many = record([partial(0.3, 0.5)], r, n_cycles=300, seed=3)
    few = record([partial(0.3, 0.5)], r, n_cycles=2, first_cycle=270, seed=3)
    assert np.array_equal(few.signal, many.signal[270:272])
    assert np.array_equal(few.temperature, many.temperature[270:272])
    assert list(few.cycle.values) == [270, 271]
    other = record([partial(0.3, 0.5)], r, seed=4)
    assert not np.array_equal(other.signal[0], many.signal[0])
    assert not np.array_equal(many.signal[0], many.signal[1])


def test_clutter_belongs_to_the_tube_and_has_its_level():
    """Mean square over frequencies and tubes: density times integral of exp(-4 alpha z).

    The mean over 20 tubes, each with some 2 * 2.5 m * 40 kHz / 343 m/s = 580 independent values
    less for the loss, about 100 in effect: 2 % of standard error, five of them allowed.
    """
    f = np.linspace(25e3, 65e3, 801)
    words = {"radius": BORE, "length": 2.5, "density": 2e-4}
    tubes = np.array([clutter([], AIR, f, tube_seed=k, **words) for k in range(20)])
    alpha = -axial_wavenumber(0, 0, f, BORE, AIR).imag
    wanted = 2e-4 * (1 - np.exp(-4 * alpha * 2.5)) / (4 * alpha)
    assert np.mean(np.abs(tubes) ** 2 / wanted) == pytest.approx(1, rel=0.1)
    cross = np.mean(tubes[0] * np.conj(tubes[1])) / np.mean(np.abs(tubes) ** 2)
    assert abs(cross) < 0.3  # 3 / sqrt(100)
    assert np.array_equal(tubes[0], clutter([], AIR, f, tube_seed=0, **words))
    a, b = (record([], Rangefinder(noise=0.0), tube_seed=k).signal.values for k in (0, 1))
    assert not np.array_equal(a, b)


def test_clutter_behind_a_bend_that_is_hardly_curved_is_that_of_a_straight_tube():
    """A bend's reference planes are its ends: its phase is that of the tube it replaces."""
    f = np.linspace(30e3, 50e3, 41)
    words = {"radius": BORE, "length": 1.0, "density": 1e-4, "tube_seed": 5}
    part = Bent(length=0.3, curvature=1e-6)
    bend = joined_bends(AIR, np.arange(25e3, 55e3, 100.0), [part], radius=BORE, modes=("00",))
    found = clutter([PlacedScatterer(bend, 0.4)], AIR, f, **words)
    straight = clutter([], AIR, f, **words)
    assert np.abs(found - straight).max() < 2e-3 * np.abs(straight).max()


def test_clutter_in_a_bend_is_the_same_wherever_the_bend_is_divided():
    """The plane wave has the bend's wavenumber throughout, so that divisions have no effect.

    At 33 per metre 1 m of bend has 10 to 40 rad more phase than straight tube, there and back.
    Clutter computed with that of straight tube up to a bend's middle, and a jump there, would
    depend on the division.
    """
    f = np.linspace(30e3, 50e3, 41)
    words = {"radius": BORE, "length": 1.5, "density": 1e-4, "tube_seed": 5}

    band = np.arange(25e3, 55e3, 100.0)

    def bends(*edges):
        parts = [Bent(length=b - a, curvature=33.0) for a, b in pairwise(edges)]
        found = [joined_bends(AIR, band, [one], radius=BORE, modes=("00",)) for one in parts]
        middles = [(a + b) / 2 for a, b in pairwise(edges)]
        return [PlacedScatterer(*one) for one in zip(found, middles, strict=True)]

    whole = clutter(bends(0.2, 1.2), AIR, f, **words)
    divided = clutter(bends(0.2, 0.45, 1.2), AIR, f, **words)
    straight = clutter([], AIR, f, **words)
    assert np.abs(divided - whole).max() < 1e-9 * np.abs(straight).max()
    assert np.abs(straight - whole).max() > 0.5 * np.abs(straight).max()


def test_plane_wave_of_a_bend_has_the_phase_that_the_bend_transmits():
    """Averaged over the beats of the bend's modes, which are 0.11 rad at 33 per metre."""
    f = np.arange(30e3, 50e3, 50.0)
    part = Bent(length=0.3, curvature=33.0, torsion=3.0)
    found = joined_bends(AIR, f, [part], radius=BORE, modes=("00",))
    assert found.inside.wavenumber.shape == (1, len(f))
    turn = found.s[:, 1, 0, 0, 0] * np.exp(1j * found.inside.wavenumber[0] * part.length)
    straight = axial_wavenumber(0, 0, f, BORE, AIR) * part.length
    ahead = found.s[:, 1, 0, 0, 0] * np.exp(1j * straight)
    assert abs(np.angle(turn.mean())) < 0.02
    assert np.abs(np.angle(ahead)).max() > 1  # a straight tube's phase is another


def test_clutter_behind_a_press_is_transmitted_through_it():
    """None behind a closure; behind half the power, half the amplitude; before a press, all."""
    f = np.linspace(30e3, 50e3, 41)
    words = {"radius": BORE, "length": 1.0, "density": 1e-4, "tube_seed": 5}
    whole = clutter([], AIR, f, **words)
    before = clutter([blockage(BAND, 0.4)], AIR, f, **words)
    half = clutter([partial(np.sqrt(0.5), 0.4)], AIR, f, **words)
    # T = j sqrt(1/2), so T^2 = -1/2; the band's response continues T to rounding.
    assert half == pytest.approx(before - 0.5 * (whole - before), abs=1e-12)
    assert np.abs(whole - before).max() > 1e-3 * np.abs(whole).max()
    shut = record([blockage(BAND, 0.4)], replace(IDEAL, clutter=1e-4), tube_seed=5)
    t, volts = shut.time.values, shut.signal.values[0]
    # There is no signal between the closure's echo (2.3 ms + 0.26 ms) and the end of the record.
    assert np.abs(volts[t > 3e-3]).max() < 1e-4 * np.abs(volts).max()


def test_adc_clips_at_both_ends():
    """12 bits clip during the send pulse; 8 bits end at 255; unquantised samples do not clip."""
    counts = record([]).signal.values
    assert (counts.min(), counts.max()) == (0, 4095)
    assert (np.sort(counts[0, :60])[[5, -5]] == [0, 4095]).all()
    assert record([], Rangefinder(bits=8)).signal.values.max() == 255
    free = record([], Rangefinder(quantised=False)).signal.values
    assert free.dtype == np.float64
    assert free.max() > 1e5


def test_drive_below_cut_on_has_the_loss_at_its_frequency():
    """At 20 kHz the loss of the plane mode is 66 % of that at 42 kHz.

    The transducer is resonant at 20 kHz. The steady middle of a 60-cycle burst follows exp(-2 alpha
    l) between two closures to 0.2 %, its envelope's ripple from the burst's ends.
    """
    r = replace(IDEAL, drive=Burst(frequency=20e3, cycles=60, shape="sine"), resonance=20e3,
                quality_factor=5.0)  # fmt: skip
    alpha = -axial_wavenumber(0, 0, 20e3, BORE, AIR).imag
    levels = []
    for distance in (0.5, 1.0):
        t, volts = echo([blockage(BAND, distance)], r)
        middle = 2 * distance / 341.5 + 2e-3
        levels.append(np.median(height(volts)[np.abs(t - middle) < 0.3e-3]))
    assert levels[1] / levels[0] == pytest.approx(np.exp(-2 * alpha * 0.5), rel=2e-3)
    assert alpha / -axial_wavenumber(0, 0, 42e3, BORE, AIR).imag == pytest.approx(0.66, abs=0.01)


@pytest.mark.parametrize("shape", ["square", "sine"])
@pytest.mark.parametrize("cycles", [3.0, 2.3])
def test_bursts_have_the_spectrum_of_their_samples(shape, cycles):
    """The closed form is compared with a sum over samples at 100 MHz, midpoint rule.

    A step between samples moves by up to half of one, 5 ns or 1e-3 rad at 42 kHz: 2e-3 of the peak.
    """
    burst = Burst(frequency=42e3, cycles=cycles, shape=shape)
    t = (np.arange(int(burst.duration * 1e8)) + 0.5) * 1e-8
    wave = np.sin(2 * np.pi * 42e3 * t)
    wave = np.sign(wave) if shape == "square" else wave
    f = np.linspace(5e3, 99e3, 95)
    wanted = spectrum(t, wave, f)
    assert burst.spectrum(f) == pytest.approx(wanted, abs=2e-3 * np.abs(wanted).max())


def test_sampled_drive_is_the_pulse_that_it_samples():
    """At 2 MHz the spline of a 42 kHz pulse is right to (2 pi 42/2000)^4 / 100: 3e-6.

    The pulse ends between two samples, with a slope of 1 % of 2 pi 42 kHz: 1e-3 at most is lost for
    at most 0.5 us, a tenth of a sample of the record: 1e-4.
    """
    pulse = Pulse(frequency=42e3)
    t = np.arange(0, pulse.duration, 5e-7)
    drive = SampledPulse(pressure=pulse(t), rate=2e6)
    volts = [response([], replace(IDEAL, drive=d))[1] for d in (pulse, drive)]
    assert volts[1] == pytest.approx(volts[0], abs=1e-4)
    assert json.loads(replace(IDEAL, drive=drive).to_json())["drive"]["rate"] == 2e6


def test_nothing_is_aliased():
    """A square's third overtone, 126 kHz, would appear at 74 kHz, 10 dB below the carrier.

    The side lobes of the Hann window are 1e-8 there: its width is 1600 samples, and they decrease
    with the cube of the distance.
    """
    flat = replace(IDEAL, drive=Burst(frequency=42e3, cycles=400))
    t, volts = response([], flat)
    steady = (t > 1e-3) & (t < 9e-3)
    window = np.hanning(steady.sum())
    level = np.abs(spectrum(t[steady], volts[steady] * window, np.array([42e3, 74e3])))
    assert level[1] < 1e-6 * level[0]


@pytest.mark.parametrize(("presses", "least"), [([], 1e-6), ([blockage(BAND, 1.0)], 1e-4)])
def test_no_voltage_is_left_behind_a_drive_with_a_mean(presses, least):
    """A flat transducer and a chirp, whose mean is not zero: 10 % of it were left at the end.

    The losses leave a tail of 5e-5 behind the echo.
    """
    r = replace(IDEAL, drive=Chirp(frequency=9e3, bandwidth=12e3))
    t, volts = response(presses, r, length=3.6)
    silent = (t > 1.5e-3) & (t < 5.5e-3) if presses else t > 1.5e-3
    assert np.abs(volts[silent]).max() < least
    assert np.abs(volts[-1]) < least


@pytest.mark.parametrize(
    ("lead", "carrier", "every"), [(0.0, 42e3, 3), (1e-3, 42e3, 3), (0.0, 38e3, 2)]
)
def test_band_above_half_the_sampling_rate_is_undersampled(lead, carrier, every):
    """As on EchoTube's board: every third sample at 240 kHz, say, not filtered at 40 kHz."""
    fine = Rangefinder(
        sampling_rate=every * 80e3, n_samples=every * 1200, lead=lead,
        drive=Burst(frequency=carrier), resonance=carrier,
    )  # fmt: skip
    board = replace(fine, sampling_rate=80e3, n_samples=1200)
    closed = [blockage(np.array([0.0, every * 39.9e3]), 0.8)]
    (t, volts), (_, exact) = (response(closed, one) for one in (board, fine))
    assert t == pytest.approx(np.arange(1200) / 80e3)
    assert volts == pytest.approx(exact[::every], abs=1e-6)


@pytest.mark.parametrize(
    ("rate", "drive", "every"),
    [
        (96e3, Burst(), 1), (95e3, Burst(), 2), (66e3, Tones(), 1), (66e3, Burst(), 3),
        (80e3, SampledPulse(pressure=np.hanning(20), rate=1e6), 3),
    ],
)  # fmt: skip
def test_bands_are_aliased_above_half_the_sampling_rate(rate, drive, every):
    """A burst's by a seventh of the carrier to either side; tones' if their middle is above."""
    assert oversampling(Rangefinder(sampling_rate=rate, drive=drive)) == every


def test_lead_delays_the_record():
    """The delay is a whole number of samples, to rounding."""
    early, late = (response([], replace(IDEAL, lead=lead))[1] for lead in (0.0, 1e-3))
    assert late[200:] == pytest.approx(early[:-200], abs=1e-9)


def test_reported_temperature_has_the_stated_bias_and_noise():
    """Bias and noise are right within five standard errors of 400 cycles, in whole steps."""
    r = Rangefinder(temperature_bias=0.5, temperature_noise=0.2, temperature_resolution=0.0625)
    found = record([], r, temperature=21.0, n_cycles=400).temperature.values
    sigma = np.hypot(0.2, 0.0625 / np.sqrt(12))
    assert found.mean() == pytest.approx(21.5, abs=5 * sigma / 20)
    assert found.std() == pytest.approx(sigma, abs=5 * sigma / np.sqrt(800))
    assert found / 0.0625 == pytest.approx(np.round(found / 0.0625), abs=1e-9)


def test_dataset_says_what_it_is(tmp_path):
    ds = record([blockage(BAND, 0.5)], n_cycles=2, seed=7)
    assert ds.signal.dims == ("cycle", "time")
    assert ds.signal.shape == (2, 4000)
    assert np.allclose(ds.time, np.arange(4000) / 200e3)
    for name in (*ds.data_vars, *ds.coords):
        assert {"units", "long_name"} <= set(ds[name].attrs)
    assert ds.attrs["source"] == "simulation"
    assert json.loads(ds.attrs["rangefinder"])["noise"] == Rangefinder().noise
    complex_face = Rangefinder(face_reflection=0.3 + 0.1j).to_json()
    assert json.loads(complex_face)["face_reflection"] == [0.3, 0.1]
    write_dataset(ds, tmp_path / "record.nc")
    write_dataset(record([]), tmp_path / "untouched.nc")


@pytest.mark.parametrize(
    "words",
    [
        {"noise": -1.0},
        {"bits": 17},
        {"n_samples": 4000.5},
        {"quality_factor": np.nan},
        {"face_reflection": -1.0},
        {"face_reflection": 0.8 + 0.8j},
        {"drive": "loud"},
        {"quantised": 2},
    ],
)
def test_impossible_parameters_are_refused(words):
    refused(lambda: Rangefinder(**words), setting=next(iter(words)))


def test_impossible_records_are_refused():
    refused(lambda: record([], n_cycles=0), setting="n_cycles", value=0)
    refused(lambda: Burst(frequency=0.0), setting="frequency", value=0.0)
    with pytest.raises(ValueError, match="the pulse lasts"):
        record([], Rangefinder(drive=Burst(cycles=1000)))
    narrow = blockage(np.array([41e3, 43e3]), 0.5)
    with pytest.raises(ValueError, match="outside"):
        record([narrow])


def test_cycles_jitter_and_wander_by_what_is_stated():
    """The spread of delays and levels of an echo in 400 cycles, to 10 %, three of its deviations.

    The delay is the phase of the cycle's product with the mean, over the carrier frequency.
    """
    sensor = replace(IDEAL, jitter=0.5e-6, gain_wander=0.03, drive=Burst(), quality_factor=14.0)
    data = record([blockage(BAND, 0.7)], sensor, n_cycles=400, seed=3)
    part = hilbert(data["signal"].values[:, 700:1200])
    product = part @ part.mean(axis=0).conj()
    delay = np.angle(product) / (2 * np.pi * 42e3)
    assert np.std(delay) == pytest.approx(0.5e-6, rel=0.1)
    assert np.std(np.abs(product)) / np.mean(np.abs(product)) == pytest.approx(0.03, rel=0.1)
    assert abs(np.corrcoef(delay, np.abs(product))[0, 1]) < 0.15


def test_given_reflectors_echo_where_they_are():
    """One of -40 dB at 0.5005 m, against a press of that reflection at that position."""
    reflectors = np.zeros(1000)
    reflectors[500] = 0.01
    sensor = replace(Rangefinder(), **QUIET, face_reflection=0.0, far_reflection=0.0)
    _, found = echo([], sensor, reflectors=reflectors)
    _, expected = echo([partial(0.01, 0.5005)], sensor)
    assert np.abs(found - expected).max() < 1e-3 * np.abs(expected).max()
    response([], sensor, length=0.9995, reflectors=reflectors)
    with pytest.raises(ValueError, match=r"1000 values, .* beyond length = 0.999 m; .* most 999"):
        response([], sensor, length=0.999, reflectors=reflectors)
