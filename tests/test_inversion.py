"""Waveform inversion: its forward model, its Jacobian, and presses estimated from recordings."""

import csv
import dataclasses
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from commands import run_here
from scipy.special import ndtr
from scipy.stats import norm

from acoustube.air import air_at
from acoustube.base.errors import ConfigError
from acoustube.cli import main
from acoustube.inversion import (
    Baseband,
    Contact,
    ForwardModel,
    Inverter,
    Library,
    Priors,
    Tool,
    Wrap,
    baseband_of,
    measured_clutter,
    model_error,
    peeling,
)
from acoustube.inversion.coupled_network import coupled_echo
from acoustube.inversion.detection import _limit, limits_along
from acoustube.inversion.goodness import MISFIT, RESIDUAL, good_fit, largest_residual
from acoustube.inversion.hypotheses import ERRORS, Builder
from acoustube.inversion.joints import Joined
from acoustube.inversion.likelihood import deviance_of, echo_of, weights
from acoustube.inversion.model_error import discrepancy, restricted_deviance
from acoustube.inversion.network import Waves, echo
from acoustube.inversion.parameters import bounded
from acoustube.inversion.paths import StraightPath
from acoustube.inversion.posterior import mixture
from acoustube.inversion.proposals import PlaneFilter
from acoustube.inversion.quantiser import linearised
from acoustube.inversion.search import Templates
from acoustube.inversion.tables import FrontCoefficients, Matrices, ToolTable
from acoustube.inversion.whitening import RankOneWeights
from acoustube.ranging import Burst, Chirp, Rangefinder, record
from acoustube.recordings import write
from acoustube.reports.figures.posterior import posterior_figure
from acoustube.runs.contact_table import COLUMNS, ContactFit, note_warnings, rows_of
from acoustube.runs.inversion import RecordingInverter, Sensor
from acoustube.runs.libraries import files
from acoustube.runs.libraries.plan import tool_plans
from acoustube.runs.two_ends import EndsContacts
from acoustube.waves import PlacedScatterer, SampledPulse, Scattering, network, transfer
from acoustube.waves.modes import axial_wavenumber, cut_on_frequency

RADIUS, MODES = 3.95e-3, ("00", "11c", "21c")
FREQUENCY = np.arange(30e3, 54e3, 100.0)
NUMBERS = (0, 0), (1, 1), (2, 1)
CUT_ONS = np.array([cut_on_frequency(*one, RADIUS, air_at(20.0).sound_speed) for one in NUMBERS])


def matrices(depth, frequency):
    """Return synthetic scattering like that of a press, (n, n_f, 2, 3, 2, 3).

    The reflection grows and its phase turns with depth; a trapped mode's resonance falls; the
    higher modes are coupled.
    """
    d, f = 1e3 * np.atleast_1d(depth)[:, None], frequency / 42e3
    found = np.zeros((len(d), len(frequency), 2, 3, 2, 3), complex)
    resonance = 1 / (1 + 40j * (f * (1 + 0.01 * d) - 1.03))
    turn = np.exp(-1j * (9 * f - 0.25 * d))
    plane = 4e-4 * d**3 * (turn * np.cos(5 * f + 0.3 * d) + 0.5 * resonance)
    passed = (1 - 8e-4 * d**3) * np.exp(-0.05j * d)
    for port in (0, 1):
        found[:, :, port, 0, port, 0] = plane
        found[:, :, port, 0, 1 - port, 0] = passed
        for mode, size in ((1, 0.3), (2, 0.1)):
            across = size * 2e-3 * d**2 * turn * np.exp(0.2j * mode * d)
            found[:, :, port, mode, port, 0] = found[:, :, port, 0, port, mode] = across
            found[:, :, port, mode, port, mode] = 0.6 - 0.05 * d + 0.1j * d * f
            found[:, :, port, mode, 1 - port, mode] = 0.3 * np.exp(-0.3j * d)
            found[:, :, port, mode, 1 - port, 0] = found[:, :, port, 0, 1 - port, mode] = across / 2
    return found


def tool(step=0.1e-3, **changes):
    depth = np.arange(1e-3, 7.01e-3, step)
    n = len(depth)
    values = {
        "shape": "rod", "diameter": 25e-3, "radius": RADIUS, "depth": depth,
        "force": 2e6 * depth**2.0, "force_error": np.full(n, 0.01), "frequency": FREQUENCY,
        "modes": MODES, "s": matrices(depth, FREQUENCY), "error": np.full(n, 1e-4),
        "interpolation_error": np.full(n - 1, 1e-4), "sound_speed": air_at(20.0).sound_speed,
    }  # fmt: skip
    return Tool(**values | changes)


def press(depth, place, frequency=None, error=0.0, phase=0.0):
    """Return a press of this scattering over the band of the recordings.

    Its reflection has a relative error, in real and imaginary part, that varies over 5 kHz.
    """
    frequency = np.arange(20e3, 70e3, 100.0) if frequency is None else frequency
    s = matrices(depth, frequency)[0]
    s[:, 0, 0, 0, 0] *= 1 + error * np.exp(1j * phase) * np.cos(frequency / 800 + phase)
    n = len(frequency)
    scattering = Scattering(
        frequency=frequency, modes=MODES, s=s, propagates=np.ones((n, 3), bool),
        cut_ons=CUT_ONS, settled=np.ones(s.shape, bool),
        sound_speed=air_at(20.0).sound_speed, extent=(-0.01, 0.01), spacing=(np.nan,) * 3,
        shape=(0, 0, 0), steps=0, time_step=np.nan,
    )  # fmt: skip
    return PlacedScatterer(scattering, place)


@pytest.fixture(scope="module")
def library():
    return Library((tool(),))


@pytest.fixture(scope="module")
def base():
    return Baseband(Rangefinder(), RADIUS, 2.5, 20.0, MODES)


@pytest.fixture(scope="module")
def untouched():
    return record([], n_cycles=200, tube_seed=7, seed=11)["signal"].values


@pytest.fixture(scope="module")
def model(library, base, untouched):
    clutter = measured_clutter(base, untouched)
    return ForwardModel(library, base, clutter)


@pytest.fixture(scope="module")
def inverter(model):
    return Inverter(model)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_echo_of_presses_is_that_of_the_network_of_waves(n, monkeypatch):
    """The echo is that of another code, with all multiple reflections, also at the face.

    These synthetic matrices are not zero below cut-ons, and are taken as they are.
    """
    monkeypatch.setattr(network, "interpolate_scattering", lambda one, *_: one.s)
    places, depths = np.array([0.41, 0.63, 1.3])[:n], np.array([4.2e-3, 5.1e-3, 6.3e-3])[:n]
    air, frequency = air_at(20.0), np.arange(37e3, 47e3, 100.0)
    k = np.stack([axial_wavenumber(*one, frequency, RADIUS, air) for one in NUMBERS], -1)
    presses = [press(d, z, frequency) for d, z in zip(depths, places, strict=True)]
    given = [Matrices(*(one.scattering.s[None] for _ in range(3))) for one in presses]
    front = given[-1].value[:, :, 0, :, 0, :].reshape(1, -1, 9)
    heard = FrontCoefficients(front, front, front)
    # Wavenumbers of 0.9 k, whose change by temperature is k per K, are k where it is 0.1 K warmer.
    warmer = np.array([0.1])
    waves = Waves(0.9 * k, k, np.zeros(3))
    found = echo(given[:-1], heard, places[None], warmer, np.zeros(1), waves, 0.3)
    pressure = transfer(presses, air, frequency, radius=RADIUS, length=2.5, probes=[0.0],
                        source_reflection=0.3, far_reflection=0.0)[0]  # fmt: skip
    expected = (pressure - 1) / 1.3
    assert np.abs(found.value[0] - expected).max() < 1e-9 * np.abs(expected).max()
    # Also by the network of wrapped tubes, with all derivatives, here for a straight tube.
    sections = StraightPath(0.9 * k, k, air.sound_speed).sections(places[None], warmer)
    n_f = len(frequency)
    joints = np.zeros((2, 1, n_f, 27), complex)
    joints[..., [0, 4, 8]] = 1.0  # full transmission, no reflection
    still = {
        "joints": joints, "moved": 0 * joints, "way": np.ones((1, n_f, 3), complex),
        "warm": np.zeros((n_f, 3), complex), "through": np.zeros((1, n_f, 0), complex),
        "through_warm": np.zeros((n_f, 0), complex), "untouched": np.ones((1, n_f), complex),
    }  # fmt: skip
    joined = [Joined(straight=one, **still) for one in given]
    for one, other in zip(coupled_echo(joined, sections, 0.3)[:-1], found[:-1], strict=True):
        assert np.abs(one - other).max() < 1e-9 * np.abs(other).max()


def test_modes_between_presses_propagate_as_in_the_wider_bore():
    """Their wavenumbers are those of that bore, also about the cut-on of (2,1) within the band.

    Without losses, which depend on the bore otherwise.
    """
    air, frequency = air_at(20.0), np.arange(37e3, 47e3, 100.0)
    front = np.array([matrices(d, frequency) for d in (4.2e-3, 5.1e-3)])
    given = [Matrices(front[0], front[0], front[0])]
    heard = FrontCoefficients(*[front[1][:, :, 0, :, 0, :].reshape(1, -1, 9)] * 3)
    found = []
    for radius, wider in ((RADIUS / 1.01, 0.01), (RADIUS, 0.0)):
        k = [axial_wavenumber(*one, frequency, radius, air, lossy=False) for one in NUMBERS]
        k = np.stack(k, -1)
        transverse = np.sqrt((k[0, 0] ** 2 - k[0] ** 2).real)
        waves = Waves(k, 0 * k, transverse)
        at = np.array([[0.41, 0.63]]), np.zeros(1), np.array([wider])
        found.append(echo(given, heard, *at, waves, 0.3).value)
    assert np.abs(found[0] - found[1]).max() < 1e-9 * np.abs(found[1]).max()


@pytest.mark.parametrize("length", [1.0, 2.0, 2.5])
def test_clutter_learned_at_another_temperature_has_the_same_times(length):
    """The window ends at the last echo of the coldest air, whatever the temperature."""
    warm, cold = (Baseband(Rangefinder(), RADIUS, length, air, MODES) for air in (34.7, -19.0))
    assert np.array_equal(warm.window, cold.window)
    assert warm.window[-1] > 2 * length / cold.air.sound_speed + 0.9e-3
    free = record([], Rangefinder(), length=length, n_cycles=12, temperature=34.7, seed=1)
    learned = measured_clutter(warm, free["signal"].values, cold)
    model = ForwardModel(Library((tool(),)), cold, learned)
    assert model.without_presses(np.zeros((1, 7))).shape == (1, len(cold.window))


def test_table_interpolates_depth_and_frequency(base):
    depth, stretch = np.array([2.513e-3, 5.377e-3]), np.array([0.0031, -0.0042])
    narrow = tool(radius=0.4 * RADIUS)  # no cut-on in the band, as these matrices have none
    found = ToolTable(narrow, base.frequency, 3)(depth, stretch).value
    for i in range(2):
        exact = matrices(depth[i], base.frequency * (1 + stretch[i]))[0]
        # Cubic splines over 0.1 mm and 100 Hz, fourth order.
        assert np.abs(found[i] - exact).max() < 2e-5


def test_table_interpolates_frequency_above_a_cut_on(base):
    """A membrane's reflection of the third mode, from 0.3 kHz above its cut-on at 42.2 kHz.

    Were the step at the cut-on interpolated too, it would be off by up to 0.1.
    """
    depth, cut_on = np.linspace(1e-3, 2e-3, 5), CUT_ONS[2]

    def reflection(f):
        kz = np.sqrt(np.maximum(1 - (cut_on / f) ** 2, 0))
        return np.where(f > cut_on, (kz - 0.3) / (kz + 0.3), 0)

    s = np.zeros((5, len(FREQUENCY), 2, 3, 2, 3), complex)
    s[:, :, 0, 2, 0, 2] = reflection(FREQUENCY)
    given = tool(depth=depth, force=depth, force_error=depth, error=depth, s=s,
                 interpolation_error=depth[1:])  # fmt: skip
    found = ToolTable(given, base.frequency, 3)(depth[:1], np.zeros(1)).value[0, :, 0, 2, 0, 2]
    above = base.frequency > cut_on + 300
    assert np.abs(found - reflection(base.frequency))[above].max() < 5e-3


def test_table_keeps_sound_that_rings_for_milliseconds():
    """A trapped mode with a decay time of 1.4 ms, to 5 ms, given every 100 Hz."""
    frequency, quality = np.arange(33.6e3, 50.5e3, 100.0), 180.0

    def ring(f):
        return 0.02 * np.exp(-1e-5j * f) / (1 + 2j * quality * (f / 41e3 - 1))

    depth = np.linspace(1e-3, 2e-3, 5)
    s = np.zeros((5, len(frequency), 2, 3, 2, 3), complex)
    s[:, :, 0, 0, 0, 0] = ring(frequency)
    given = tool(depth=depth, force=depth, force_error=depth, error=depth, frequency=frequency, s=s,
                 interpolation_error=depth[1:])  # fmt: skip
    wanted = np.arange(36e3, 48e3, 40.0)
    found = ToolTable(given, wanted, 3).front(depth[:1], np.zeros(1)).value[0, :, 0]
    taper, time = np.hanning(len(wanted)), np.arange(len(wanted)) / (40.0 * len(wanted))
    echo, error = np.abs(np.fft.ifft(taper * [ring(wanted), found - ring(wanted)]))
    # Cubics between 100 Hz are off by 0.1, 2 and 26 %.
    for late in (1e-3, 3e-3, 5e-3):
        part = (time > late - 1e-3) & (time < late)
        assert error[part].max() < 1e-2 * echo[part].max(), late


@pytest.mark.parametrize("places", [[0.52], [0.52, 0.81], [0.47, 0.66, 1.21]])
def test_jacobian_is_that_of_differences(model, places):
    """Derivatives equal fourth-order differences, between the nodes of the clutter's table."""
    m = len(places)
    start = np.concatenate([
        np.ravel(np.column_stack([np.array(places) + 3e-3, [4.31e-3, 5.13e-3, 3.37e-3][:m]])),
        [0.13, 0.02, -0.03, 4e-4, 0.01, 7e-4, 2e-3],
    ])  # fmt: skip

    def value(parameters):
        p = parameters[None]
        return model.baseband((0,) * m, p[:, : 2 * m : 2], p[:, 1 : 2 * m : 2], p[:, 2 * m :])

    jacobian = value(start)[1][0]
    steps = [1e-6, 1e-6] * m + [1e-3, 1e-3, 1e-3, 1e-6, 1e-3, 1e-6, 1e-6]
    for i, step in enumerate(steps):
        e = step * np.eye(len(start))[i]
        far, near = (value(start + s * e)[0][0] - value(start - s * e)[0][0] for s in (2, 1))
        difference = (8 * near - far) / (12 * step)
        assert np.abs(jacobian[i] - difference).max() < 1e-6 * np.abs(difference).max(), i


def test_noise_of_few_untouched_cycles_is_part_of_the_covariance(library, base, untouched):
    """That of 20 untouched cycles is ten times that of 200 others, from which they are subtracted.

    Beyond 1 m it exceeds the clutter. With the clutter's posterior covariance the square is 8.
    """
    model = ForwardModel(library, base, measured_clutter(base, untouched[:20]))
    samples, noise = base.of_cycles(record([], n_cycles=200, tube_seed=7, seed=12)["signal"].values)
    rest = samples - model.without_presses(np.zeros((1, 7)))[0]
    square = np.mean(np.abs(weights(model, noise, 0.0, None)(rest)) ** 2)
    assert square == pytest.approx(1.0, abs=0.3)  # of 390 samples, and the taper takes a part


@pytest.mark.parametrize("drifting", [False, True])
def test_untouched_cycles_of_several_temperatures_are_moved_to_one(library, drifting):
    """In one recording or two: in their mean the clutter at a temperature between is missing."""
    free, known = [], Rangefinder(temperature_bias=0.0)
    for air, n in ((20.0, 50), (21.0, 50), (20.5, 20)):
        recorded = record([], known, n_cycles=n, temperature=air, tube_seed=7, seed=int(10 * air))
        free.append((f"{air}.nc", recorded))
    last = free.pop()
    if drifting:
        parts = [one.drop_vars("cycle", errors="ignore") for _, one in free]
        free = [("both.nc", xr.concat(parts, "cycle", data_vars="minimal"))]
    inverter = RecordingInverter(library, Sensor(length=2.5), free, most=1)
    ((_, found),) = inverter.groups(*last, 20, lambda: None)
    assert not found.contacts
    assert found.best.mean_square == pytest.approx(1.0, abs=0.3)
    assert found.residual < RESIDUAL


def test_without_untouched_cycles_each_recording_has_the_air_of_its_own(library):
    """The same distance after a recording in air 0.2 K colder as without it."""
    known, sensor, places = Rangefinder(temperature_bias=0.0), Sensor(length=2.5), []
    cold, warm = (
        record([press(5e-3, 0.9)], known, n_cycles=20, temperature=air, tube_seed=7, seed=5)
        for air in (20.0, 20.2)
    )
    for recordings in ((cold, warm), (warm,)):
        inverter = RecordingInverter(library, sensor, (), most=1)
        for one in recordings:
            ((_, found),) = inverter.groups("one.nc", one, 20, lambda: None)
        (contact,) = found.contacts
        places.append(contact.distance.value)
    assert places[0] == places[1]


@pytest.mark.parametrize("n_cycles", [5, 20])
def test_rounding_without_dither_is_the_same_in_all_cycles(n_cycles):
    """Its variance in an echo is not divided by the number of cycles, and is at most that stated.

    The whole error of 1/12 count squared is in the band: 1/6 of a complex sample, in which a real
    one of a folded band has 1/12.
    """
    means, echo = [], [press(5e-3, 0.5)]
    for quantised in (True, False):
        silent = Rangefinder(noise=0.0, drift=0.0, quantised=quantised)
        own = Baseband(silent, RADIUS, 2.5, 20.0, MODES)
        counts = record(echo, silent, n_cycles=n_cycles)["signal"].values
        means.append(own.of_cycles(counts))
    (rounded, variance), (exact, _) = means
    highest = np.sort(np.abs(rounded - exact) ** 2)[-len(exact) // 8 :]
    assert variance == pytest.approx(1 / 6, rel=1e-6)
    assert 0.1 * variance < np.mean(highest) < variance
    folded = Rangefinder(noise=0.0, sampling_rate=80e3, n_samples=1600, bits=8)
    one = baseband_of(folded, RADIUS, 2.0, 20.0, MODES)
    assert one.noise(n_cycles) == pytest.approx(1 / 12, rel=1e-6)


@pytest.mark.parametrize("temperature", [-20.0, 60.0])
def test_baseband_is_differentiated_at_the_ends_of_the_range_of_temperatures(temperature):
    """There by a difference to one side, which is 0.2 % off."""
    own = Baseband(Rangefinder(), RADIUS, 2.5, temperature, MODES)
    relative = own.speed_by_temperature / own.speed
    assert relative == pytest.approx(0.5 / (temperature + 273.15), rel=4e-3)
    plane = own.k_by_temperature[:, 0] / own.k[:, 0]
    assert plane.real == pytest.approx(-relative, rel=0.02)


@pytest.mark.parametrize("temperature", [-5.0, 45.0])
def test_bore_varies_in_air_far_from_that_of_the_library(library, temperature):
    """By 1.2 % at least; the tables are not extrapolated, and a known bore stays known."""
    own = Baseband(Rangefinder(), RADIUS, 2.5, temperature, MODES)
    for priors, widest in ((Priors(bore=0.02), 0.012), (Priors(bore=0.0), 0.0)):
        model = ForwardModel(library, own, None, priors)
        for bore in (-0.1, 0.1):
            far = np.array([0.6, 4e-3, *np.zeros(6), bore])[None]
            clipped = bounded(model, (0,), far)[0, -1]
            assert np.sign(bore) * clipped >= widest
            assert widest or abs(clipped) < 1e-8
            low, high = model.stretches
            assert low <= clipped <= high


def test_clutter_is_constant_beyond_the_temperatures_of_its_table(model):
    """Beyond 1.5 K; the derivative by temperature is that of this constant."""
    warm = np.array([-2.0, -1.5, 1.4, 1.5, 2.0])
    value, by_place, by_temperature = model.clutter.beyond(np.full(5, 0.7), warm)
    assert np.allclose(value[[0, 4]], value[[1, 3]], rtol=1e-5)
    assert np.allclose(by_place[[0, 4]], by_place[[1, 3]], rtol=1e-5)
    assert np.all(by_temperature[[0, 4]] == 0)
    assert np.all(np.abs(by_temperature[2]) > 0)


def test_intervals_of_a_mixture_have_their_probabilities():
    """Of maxima half a wavelength apart, one of them faint, and of one that is far away."""
    weight = np.array([0.55, 0.3, 0.1, 0.05])
    mean, deviation = 0.8 + np.array([0.0, 4e-3, -4e-3, 0.2]), np.array([2e-5, 3e-5, 1e-4, 5e-3])
    for level, (low, high) in mixture(weight, mean, deviation).intervals.items():
        for end, below in ((low, (1 - level) / 2), (high, (1 + level) / 2)):
            assert weight @ ndtr((end - mean) / deviation) == pytest.approx(below, abs=1e-9)


def test_density_of_an_estimate_is_that_of_its_mixture_at_values_of_any_shape():
    found = mixture(np.array([0.25, 0.75]), np.array([1.0, 2.0]), np.array([0.5, 0.1]))
    at = np.array([[1.0, 1.5], [2.0, 2.1]])
    expected = 0.25 * norm.pdf(at, 1.0, 0.5) + 0.75 * norm.pdf(at, 2.0, 0.1)
    assert found.density(at) == pytest.approx(expected)
    assert found.density(1.5) == pytest.approx(expected[0, 1])


def test_lists_of_a_tool_or_a_wrap_are_arrays():
    usual = tool()
    lists = {name: getattr(usual, name).tolist() for name in ("depth", "force", "force_error")}
    listed = dataclasses.replace(usual, modes=list(MODES), **lists)
    assert len(Library((usual, listed)).tools) == 2
    assert listed.force_at(4e-3) == usual.force_at(4e-3)
    assert listed.force_deviation(4e-3) == usual.force_deviation(4e-3)
    assert (2 * listed.force).shape == usual.force.shape
    pulse = SampledPulse(pressure=[0.0, 1.0, -1.0, 0.0], rate=1e6)
    assert (2 * pulse.pressure).tolist() == [0.0, 2.0, -2.0, 0.0]
    wrap = Wrap(place=[0.2, 0.6], curvature=[10, 12], torsion=[1, 2]).from_other_end(1.0)
    assert wrap.place.tolist() == [0.4, 0.8]


def test_unsigned_frequencies_in_falling_order_are_refused():
    with pytest.raises(ConfigError, match="frequency of a tool must increase"):
        tool(frequency=FREQUENCY[::-1].astype(np.uint32))


def test_forward_model_is_the_recording_of_the_rangefinder(library):
    """Both without noise, clutter and far end, in the window that the inversion uses."""
    silent = Rangefinder(clutter=0.0, noise=0.0, drift=0.0, quantised=False, far_reflection=0.0)
    own = Baseband(silent, RADIUS, 2.5, 20.0, MODES)
    cycle = record([press(5.03e-3, 0.8)], silent, n_cycles=1)["signal"].values
    given, _ = own.of_cycles(cycle)
    place, depth = np.array([[0.8]]), np.array([[5.03e-3]])
    found, _ = ForwardModel(library, own).baseband((0,), place, depth, np.zeros((1, 7)))
    # Side lobes of the taper, by the fading of the pulse and by cyclic time.
    assert np.abs(found[0] - given).max() < 2e-3 * np.abs(given).max()


@pytest.mark.parametrize(("place", "depth"), [(0.531, 2.83e-3), (1.107, 4.44e-3), (1.62, 6.21e-3)])
def test_press_is_found_at_its_place_and_depth(inverter, place, depth):
    cycles = record([press(depth, place)], n_cycles=20, tube_seed=7, seed=3, temperature=20.2)
    found = inverter(cycles["signal"].values)
    assert len(found.contacts) == 1
    contact = found.contacts[0]
    assert contact.distance.value == pytest.approx(place, abs=3e-4)
    assert contact.depth.value == pytest.approx(depth, abs=5e-5)
    assert contact.force.value == pytest.approx(2e6 * depth**2, rel=0.05)
    assert contact.probability > 0.99
    assert found.fits
    assert found.temperature.value == pytest.approx(0.2, abs=0.05)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"modes": MODES[:2]}, "first modes of the library are 00, 11c, 21c"),
        ({"modes": (MODES[0], MODES[2], MODES[1])}, "those of the baseband 00, 21c, 11c"),
        ({"radius": 3e-3}, "a bore of 7.9 mm and the baseband of 6 mm"),
        ({"rangefinder": Rangefinder(drive=Burst(frequency=50e3))}, "needs 42.4.* to 57.* kHz"),
        ({"rangefinder": Rangefinder(drive=Burst(frequency=34e3))}, "library covers 30 to 53.9"),
    ],
)
def test_library_of_other_modes_bore_or_band_than_the_baseband_is_refused(library, changes, words):
    given = {"rangefinder": Rangefinder(), "radius": RADIUS, "temperature": 20.0, "modes": MODES}
    ForwardModel(library, Baseband(length=1.0, **given))
    with pytest.raises(ConfigError, match=words):
        ForwardModel(library, Baseband(length=1.0, **(given | changes)))


def test_tube_that_the_ring_down_covers_has_no_place_for_a_press():
    long = Rangefinder(drive=Chirp(frequency=42e3, bandwidth=10e3, duration=5e-3))
    with pytest.raises(ConfigError, match=r"length 0\.9 m has no place for a press beyond 1\.0"):
        ForwardModel(Library((tool(),)), Baseband(long, RADIUS, 0.9, 20.0, MODES))


def test_press_is_sought_up_to_the_end_of_the_span(library):
    """That is 2 cm before the end of the tube; places are searched in steps of 3 mm."""
    base, place, depth = Baseband(Rangefinder(), RADIUS, 1.0, 20.0, MODES), 0.975, 5e-3
    free, pressed = (
        record(presses, n_cycles=20, length=1.0, tube_seed=7, seed=seed)["signal"].values
        for seed, presses in enumerate(([], [press(depth, place)]))
    )
    model = ForwardModel(library, base, measured_clutter(base, free))
    assert model.span[1] == pytest.approx(0.98)
    assert PlaneFilter(model, 0, base.noise(1)).places[-1] > model.span[1] - 3.1e-3
    found = Inverter(model, most=1)(pressed)
    assert found.fits
    (contact,) = found.contacts
    assert contact.distance.value == pytest.approx(place, abs=3e-4)
    assert contact.depth.value == pytest.approx(depth, abs=5e-5)


@pytest.mark.slow
def test_intervals_have_their_coverage_and_errors_are_small(inverter):
    """Coverage of 68 and 90 % intervals of 20 quantities, of ten presses up to 1.2 m."""
    rng, inside = np.random.default_rng(5), []
    for i in range(10):
        place, depth = rng.uniform(0.35, 1.2), rng.uniform(2.5e-3, 6.5e-3)
        cycles = record([press(depth, place)], n_cycles=20, tube_seed=7, seed=40 + i)
        contacts = inverter(cycles["signal"].values).contacts
        contact = min(contacts, key=lambda one: abs(one.distance.value - place))
        for one, truth in ((contact.distance, place), (contact.depth, depth)):
            inside.append([low <= truth <= high for low, high in one.intervals.values()])
        assert abs(contact.distance.value - place) < 3e-4
    # Binomial, at the 0.1 % level; positions include the thermometer's error, and more hold.
    assert np.mean(inside, axis=0)[0] > 0.35
    assert np.mean(inside, axis=0)[1] > 0.65


@pytest.mark.slow
def test_restricted_deviance_is_that_of_the_marginal_likelihood():
    """For a linear model, whose parameters add ``J L J^T`` to the covariance of its data.

    Compared are differences between two weights; position and depth have a wide prior.
    """
    rng, n = np.random.default_rng(8), 30
    jacobian = rng.normal(size=(1, 9, n)) + 1j * rng.normal(size=(1, 9, n))
    jacobian[0, :2] *= [[3e3], [3e4]]
    residual = rng.normal(size=(1, n)) + 1j * rng.normal(size=(1, n))
    residual *= 5.0
    at = np.concatenate([[0.6, 4e-3], 1e-3 * rng.normal(size=7)])[None]
    model = SimpleNamespace(priors=Priors())
    prior = np.concatenate([[1.0, 1.0], model.priors.deviations**2])
    # As real data about nuisance parameters of zero, the mean of their prior.
    slopes = np.concatenate([jacobian[0].real, jacobian[0].imag], axis=1).T
    data = np.concatenate([residual[0].real, residual[0].imag])
    data = data + slopes[:, 2:] @ at[0, 2:]
    found, expected = [], []
    for sizes in (np.full(n, 1.0), np.linspace(4.0, 0.5, n)):
        whiten = RankOneWeights.of(sizes**2, None, 1.0, 0.0)
        found.append(
            restricted_deviance(
                model, at, whiten(residual), whiten(jacobian), whiten.log_determinant
            )[0]
        )
        noise = np.tile(sizes**2 / 2, 2)
        covariance = np.diag(noise) + (slopes * prior) @ slopes.T
        value = data @ np.linalg.solve(covariance, data)
        expected.append(value + np.linalg.slogdet(covariance)[1])
    assert found[1] - found[0] == pytest.approx(expected[1] - expected[0], rel=1e-4)


def test_likeliest_maximum_has_the_largest_weight(base, library, untouched, monkeypatch):
    """Of two maxima, the second explains the samples better with every error of the model.

    With the enlarged error of the weights the first one seems the likelier.
    """
    model = ForwardModel(library, base, measured_clutter(base, untouched))
    cycles = record([press(4e-3, 0.6)], n_cycles=20, tube_seed=7, seed=64)["signal"].values
    builder = Builder(model, [Templates(model, 0)], *base.of_cycles(cycles))
    one = builder.extended(builder.untouched())[0]
    fits = dataclasses.replace(
        one.fits, parameters=np.repeat(one.best[None], 2, axis=0), cost=np.zeros(2)
    )
    given = [np.array([60.0, 0.0])] * len(ERRORS) + [np.array([0.0, 8.0])]
    monkeypatch.setattr(model_error, "restricted_deviance", lambda *_: given.pop(0))
    off = discrepancy(model, dataclasses.replace(one, fits=fits), builder.samples, builder.noise)
    assert np.argmin(off.level) == 1
    assert off.level[0] - off.level[1] == pytest.approx(0.0, abs=1e-6)


def test_two_maxima_are_distinguished_less_where_the_model_errs(base, library, untouched):
    """The second set of parameters is half a wavelength off, and not fitted."""
    model = ForwardModel(library, base, measured_clutter(base, untouched))
    cycles = record([press(4e-3, 0.6, error=0.05)], n_cycles=20, tube_seed=7, seed=65)
    builder = Builder(model, [Templates(model, 0)], *base.of_cycles(cycles["signal"].values))
    one = builder.extended(builder.untouched())[0]
    other = one.best.copy()
    other[0] += base.half_wavelength
    at = np.array([other, one.best])
    fits = dataclasses.replace(one.fits, parameters=at, cost=np.zeros(2))
    off = discrepancy(model, dataclasses.replace(one, fits=fits), builder.samples, builder.noise)
    assert np.argmin(off.level) == 1
    echo = echo_of(model, one.tools, one.best)
    costs = [
        deviance_of(model, builder.noise, one.error, echo, 0.0, builder.samples - value)
        for value in model.baseband(one.tools, at[:, :1], at[:, 1:2], at[:, 2:])[0]
    ]
    assert 0 < off.level[0] - off.level[1] < (costs[0] - costs[1]) / 4


def test_error_of_the_model_widens_the_intervals_of_depth(base, library, untouched):
    """Ten presses whose reflection is off by 14 % rms, as by known errors of mesh and solver."""
    exact = Priors(thermometer=0.0, place=0.0, depth=0.0)
    clutter = measured_clutter(base, untouched)
    own = Inverter(ForwardModel(library, base, clutter, exact), most=1)
    rng, inside, wide, narrow = np.random.default_rng(5), [], [], []
    for i in range(10):
        place, depth, phase = rng.uniform([0.35, 2.5e-3, 0], [0.9, 6.5e-3, 2 * np.pi])
        for error, deviations in ((0.2, wide), (0.0, narrow)):
            pressed = [press(depth, place, error=error, phase=phase)]
            cycles = record(pressed, n_cycles=20, tube_seed=7, seed=60 + i)["signal"].values
            found = own(cycles).contacts[0]
            deviations.append(found.depth.deviation)
            if error:
                low, high = found.depth.intervals[0.9]
                inside.append(low <= depth <= high)
    # If each holds with a probability of 0.9, fewer than 5 of 10 hold with one of 0.02 %.
    assert np.mean(inside) > 0.45
    assert np.median(wide) > 4 * np.median(narrow)


def test_tolerance_of_the_modulus_widens_the_force(base, library, untouched):
    """An error of 5 % adds to the other variance in proportion to the force."""
    clutter = measured_clutter(base, untouched)
    cycles = record([press(5e-3, 0.6)], n_cycles=20, tube_seed=7, seed=70)["signal"].values

    def told(**tolerance):
        model = ForwardModel(library, base, clutter, Priors(**tolerance))
        contact = Inverter(model, most=1)(cycles).contacts[0]
        return np.square([contact.depth.deviation, contact.force.deviation]), contact

    known, contact = told()
    added = np.sqrt(told(modulus=0.05)[0] - known)
    assert added == pytest.approx([0.0, 0.05 * contact.force.value], rel=1e-3, abs=1e-9)


@pytest.mark.parametrize("wider", [-0.008, 0.01])
def test_bore_is_estimated_and_scales_the_depth(model, wider):
    """A bore wider in proportion scatters as the library's at a higher frequency and smaller depth.

    Its modes propagate as in that bore between the face and the press.
    """
    depth, place, frequency = 5e-3, 0.42, np.arange(20e3, 70e3, 100.0)
    own = press(depth, place, frequency)
    s = matrices(depth / (1 + wider), frequency * (1 + wider))[0]
    scattering = dataclasses.replace(own.scattering, s=s, cut_ons=CUT_ONS / (1 + wider))
    presses = [dataclasses.replace(own, scattering=scattering)]
    cycles = record(
        presses, n_cycles=20, tube_seed=7, seed=71, radius=RADIUS * (1 + wider)
    )["signal"].values  # fmt: skip
    estimates = []
    for bore in (0.01, 0.0):
        priors = Priors(stretch=1e-4, bore=bore)
        own = ForwardModel(model.tool_library, model.base, model.clutter, priors)
        estimates.append(Inverter(own, most=1)(cycles))
    found, known = estimates
    (contact,) = found.contacts
    assert found.bore.deviation < 1e-3
    for told, true in ((found.bore, wider), (contact.depth, depth), (contact.distance, place)):
        low, high = told.intervals[0.9]
        assert low < true < high
    assert contact.depth.value == pytest.approx(depth, abs=5e-5)
    assert contact.distance.value == pytest.approx(place, abs=1e-4)
    # With a bore stated as known, the depth is several per cent off.
    assert known.bore.value == pytest.approx(0.0, abs=1e-8)
    assert abs(known.contacts[0].depth.value - depth) > 3e-4


def test_two_depths_of_similar_echoes_are_both_in_the_posterior(base, library, untouched):
    """The tool has nearly the same echo at a depth d over 4 mm as at 8 mm - d.

    Both depths have maxima half wavelengths away too, so that both are about equally likely.
    """
    known = library.tools[0]

    def heard(depth):
        return np.minimum(depth, 8e-3 - 0.98 * depth)

    alike = dataclasses.replace(known, s=matrices(heard(known.depth), FREQUENCY))
    clutter = measured_clutter(base, untouched)
    inverter = Inverter(ForwardModel(Library((alike,)), base, clutter), most=1)
    for i, depth in enumerate((2.5e-3, 3e-3, 5e-3, 5.5e-3)):
        cycles = record([press(heard(depth), 0.9)], tube_seed=7, seed=90 + i, n_cycles=1)
        found = inverter(cycles["signal"].values).contacts[0].depth
        for mode in (heard(depth), (8e-3 - heard(depth)) / 0.98):
            near = np.abs(found.means - mode) < 0.3e-3
            assert 0.4 < found.weights[near].sum() < 0.6
        low, high = found.intervals[0.9]
        assert low < depth < high


def test_library_of_a_narrow_range_of_depths_gives_the_depth(base, library, untouched):
    """No other depths are tried: all are closer to the found one than the spacing of the trials."""
    known = library.tools[0]
    near = np.abs(known.depth - 5e-3) < 0.35e-3
    names = ("depth", "force", "force_error", "s", "error")
    short = {name: getattr(known, name)[near] for name in names}
    short["interpolation_error"] = known.interpolation_error[near[:-1]][1:]
    narrow = Library((dataclasses.replace(known, **short),))
    clutter = measured_clutter(base, untouched)
    cycles = record([press(5e-3, 0.9)], tube_seed=7, seed=97, n_cycles=4)
    found = Inverter(ForwardModel(narrow, base, clutter), most=1)(cycles["signal"].values)
    assert abs(found.contacts[0].depth.value - 5e-3) < 0.1e-3


@pytest.mark.slow
@pytest.mark.parametrize(("apart", "depths"), [(0.4, (4e-3, 4.5e-3)), (0.2, (3e-3, 5e-3))])
def test_two_presses_are_resolved(inverter, apart, depths):
    presses = [press(d, z) for d, z in zip(depths, (0.6, 0.6 + apart), strict=True)]
    found = inverter(record(presses, n_cycles=20, tube_seed=7, seed=5)["signal"].values)
    assert [c.distance.value for c in found.contacts] == pytest.approx([0.6, 0.6 + apart], abs=1e-3)
    assert [c.depth.value for c in found.contacts] == pytest.approx(depths, abs=1e-4)
    assert found.fits


@pytest.mark.slow
def test_three_presses_are_found_where_two_alone_are_misplaced(inverter):
    """A model of two presses explains little; with the third all are at their positions.

    The echoes have an error of 1 %. Two presses alone are discounted by a large estimated error of
    the model.
    """
    places, depths = [0.506, 0.889, 1.223], [2e-3, 5e-3, 6e-3]
    presses = [press(d, z, error=0.01, phase=1.0) for d, z in zip(depths, places, strict=True)]
    found = inverter(record(presses, n_cycles=20, tube_seed=7, seed=1)["signal"].values)
    assert [one.distance.value for one in found.contacts] == pytest.approx(places, abs=1e-3)
    assert [one.depth.value for one in found.contacts] == pytest.approx(depths, abs=0.1e-3)
    assert found.fits


def test_faint_press_before_a_strong_one_is_found_in_time(inverter, monkeypatch):
    """Its echo has no onset of its own: single samples of it are hardly above the noise."""
    places, depths = [0.5, 0.95, 1.15], [3e-3, 2.3e-3, 6e-3]
    presses = [press(d, z) for d, z in zip(depths, places, strict=True)]
    cycles = record(presses, n_cycles=4, tube_seed=7, seed=6)["signal"].values
    samples = inverter.model.base.of_cycles(cycles)
    builder = Builder(inverter.model, inverter.templates, *samples)

    def found():
        last = list(peeling.peeled(builder, 3))[-1]
        return [np.split(known.best, [2 * len(known.tools)])[0].reshape(-1, 2) for known in last]

    expected = np.column_stack([places, depths])
    assert any(
        len(one) == 3 and np.all(np.abs(one - expected) < [1e-3, 0.15e-3]) for one in found()
    )
    monkeypatch.setattr(peeling, "_before_onset", lambda *_: [])
    assert all(one[:, 0] == pytest.approx([places[0], places[2]], abs=1e-3) for one in found())


@pytest.mark.slow
def test_error_of_the_model_gives_no_false_detection(inverter):
    """The trapped mode of the press is narrower and higher than the library's.

    Two further presses of the library would reduce the residual more than independent errors of the
    samples.
    """
    depth, frequency = 6.5e-3, np.arange(20e3, 70e3, 100.0)
    pressed = press(depth, 0.5)
    d, f = 1e3 * depth, frequency / 42e3
    known, own = (
        1 / (1 + q * 1j * (f * (1 + 0.01 * d) - at)) for q, at in ((40, 1.03), (100, 1.05))
    )
    for port in (0, 1):
        change = 2e-4 * d**3 * np.exp(-1j * (9 * f - 0.25 * d)) * (own - known)
        pressed.scattering.s[:, port, 0, port, 0] += change
    found = inverter(record([pressed], n_cycles=20, tube_seed=7, seed=3)["signal"].values)
    assert [c.distance.value for c in found.contacts] == pytest.approx([0.5], abs=1e-3)
    assert found.number[1] > 0.5


@pytest.mark.slow
@pytest.mark.parametrize(
    ("before", "place"), [([], 1.7), ([(6e-3, 0.6)], 0.9), ([(6e-3, 0.6)], 1.7)]
)
def test_press_is_found_beyond_the_limit_of_detection(inverter, before, place):
    """All of three presses 0.3 mm deeper than the limit are found, and none 0.4 mm shallower.

    Measured, of six each: all at the limit, and 0 or 1 of those 0.3 mm shallower.
    """

    def found(*presses, seed):
        cycles = record([press(*one) for one in presses], n_cycles=20, tube_seed=7, seed=seed)
        return inverter(cycles["signal"].values)

    (limit,) = found(*before, seed=5).detection_limit([place])
    for off, told in ((0.3e-3, True), (-0.4e-3, False)):
        for seed in (30, 31, 32):
            contacts = found(*before, (limit + off, place), seed=seed).contacts
            assert any(abs(one.distance.value - place) < 0.02 for one in contacts) == told


def test_picture_ends_with_the_tube_and_hatches_where_no_contact_is_sought(inverter, library):
    """Within 3 cm of the contact, before the nearest position and at the end."""
    cycles = record([press(5e-3, 0.6)], n_cycles=20, tube_seed=7, seed=5)["signal"].values
    echo, limit, *_ = posterior_figure(EndsContacts.of_one_end(inverter(cycles)), library).axes
    assert echo.get_xlim() == limit.get_xlim() == (0.0, 250.0)
    (hatched,) = [one for one in limit.collections if one.get_hatch()]
    edges = [path.vertices[:, 0] for path in hatched.get_paths()]
    spans = np.array([(x.min(), x.max()) for x in edges])
    assert len(spans) == 3
    assert spans[0, 0] == 0.0
    assert spans[1] == pytest.approx([57, 63], abs=1.4)
    assert spans[2, 1] == pytest.approx(250)


@pytest.mark.parametrize(
    ("surplus", "limit"),
    [([1, 1, 1], 1.0), ([-1, 1, 1], 1.5), ([1, -1, 3], 2.25), ([-1, 1, 0], np.inf),
     ([-1, 1, np.nan], np.inf)],
)  # fmt: skip
def test_limit_is_the_depth_beyond_which_all_are_found(surplus, limit):
    depths = np.array([1.0, 2.0, 3.0])
    assert _limit(depths, np.array(surplus, float)) == limit


def test_limits_along_the_tube_are_the_worst_of_neighbours():
    """The limit is nan where the position itself has none."""
    limit = {0.039: np.nan, 0.052: 2.0, 0.065: 1.0, 0.078: 3.0, 0.091: np.inf}
    places, depths = limits_along(
        lambda at: np.array([limit[round(z, 3)] for z in at]), (0.03, 0.1)
    )
    assert places == pytest.approx(list(limit))
    assert np.array_equal(depths, [np.nan, 2.0, 3.0, np.inf, np.inf], equal_nan=True)


@pytest.mark.parametrize("beat", [0.02, 0.04])
def test_limits_along_the_tube_hold_where_modes_beat(beat):
    """One of three positions is within 63 degrees of the maximum: 1 is stated as 0.45."""
    turns = np.linspace(0, 2 * np.pi, 9)

    def limit(places, phase):
        return np.cos(2 * np.pi * places / beat + phase)

    for phase in turns:
        _, depths = limits_along(partial(limit, phase=phase), (0.3, 0.6))
        assert depths[1:-1].min() > 0.45


def test_limit_of_a_tool_without_an_echo_is_infinite(base, untouched):
    """No press of this library reflects or converts sound."""
    still = tool(s=matrices(np.full(61, 1e-6), FREQUENCY))
    model = ForwardModel(Library((still,)), base, measured_clutter(base, untouched))
    cycles = record([], n_cycles=20, tube_seed=7, seed=21)["signal"].values
    assert np.all(Inverter(model)(cycles).detection_limit([0.5, 1.0, 2.0]) == np.inf)


def test_no_further_contact_is_found_where_none_is_sought(model):
    cycles = record([press(6e-3, 0.6)], n_cycles=20, tube_seed=7, seed=5)["signal"].values
    found = Inverter(model, most=1)(cycles)
    assert list(found.detection_limit([0.4, 1.2])) == [np.inf, np.inf]
    assert np.isnan(found.detection_limit([0.6])[0])


def test_limit_of_detection_rises_with_distance_and_ends(inverter):
    """In one cycle no press is detectable near the end; at a contact there is no limit."""
    cycles = record([press(6e-3, 0.6)], n_cycles=1, tube_seed=7, seed=5)["signal"].values
    found = inverter(cycles)
    limit = found.detection_limit([0.3, 0.5, 2.3, 0.61, 0.01, 2.6])
    assert limit[0] < limit[1] < 3e-3
    assert limit[2] == np.inf
    assert np.all(np.isnan(limit[3:]))
    with pytest.raises(ValueError, match="tool = 1 is out of range; use 0"):
        found.detection_limit([0.3], tool=1)


def test_untouched_tube_has_no_contact(inverter):
    for seed in (21, 22):
        cycles = record([], n_cycles=20, tube_seed=7, seed=seed, temperature=19.9)
        assert not inverter(cycles["signal"].values).contacts


def test_single_cycle_gives_a_larger_uncertainty(inverter):
    cycles = record([press(5e-3, 0.7)], n_cycles=20, tube_seed=7, seed=9)["signal"].values
    one, many = inverter(cycles[:1]), inverter(cycles)
    assert one.contacts[0].distance.value == pytest.approx(0.7, abs=1e-3)
    assert one.contacts[0].depth.deviation > many.contacts[0].depth.deviation


def test_press_of_another_tool_is_a_misfit(base, untouched):
    """The scattering is that of no depth in the library, whose frequency axis is reversed."""
    other = tool(s=matrices(np.arange(1e-3, 7.01e-3, 0.1e-3), FREQUENCY[::-1]))
    model = ForwardModel(Library((other,)), base, measured_clutter(base, untouched))
    cycles = record([press(5e-3, 0.7)], n_cycles=20, tube_seed=7, seed=9)["signal"].values
    assert Inverter(model, most=1)(cycles).misfit > MISFIT


def test_echo_with_another_late_part_is_a_misfit(inverter):
    """Late trapped sound that the library lacks, which could hide a press, is reported.

    It is a hundredth of the echo's energy (0.098 squared), which is less than the threshold of the
    misfit.
    """
    pressed = press(6e-3, 0.5)
    matrix, f = pressed.scattering.s.copy(), pressed.scattering.frequency
    for port in (0, 1):
        matrix[:, port, 0, port, 0] += 0.3 * 4e-4 * 6.0**3 / (1 + 200j * (f / 42e3 - 1.01))
    other = dataclasses.replace(pressed.scattering, s=matrix)
    found = [
        inverter(record([one], n_cycles=20, tube_seed=7, seed=3)["signal"].values)
        for one in (pressed, dataclasses.replace(pressed, scattering=other))
    ]
    assert [one.fits for one in found] == [True, False]
    assert [one.misfit > MISFIT for one in found] == [False, True]
    assert found[1].contacts[0].distance.value == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize(("depth", "place"), [(3e-3, 1.2), (2e-3, 0.9)])
def test_echo_of_an_undetected_press_is_in_the_residual(inverter, depth, place):
    """It is a hundredth of the whole echo, which the misfit hardly shows.

    The first press is not sought. The second is too faint to be credited beyond the model's error.
    """
    presses = [press(5e-3, 0.5), press(depth, place)]
    cycles = record(presses, n_cycles=20, tube_seed=7, seed=5)["signal"].values
    alone = Inverter(inverter.model, most=1)(cycles)
    assert alone.misfit < 0.02
    assert not alone.fits
    first, last = alone.residual_span
    assert place < last
    assert first < place + 0.1
    assert last - first == pytest.approx(2e-3 * air_at(20.0).sound_speed / 2, abs=0.02)
    both = Inverter(inverter.model, most=2)(cycles)
    for found in (alone, both):
        figure = posterior_figure(EndsContacts.of_one_end(found), inverter.model.tool_library)
        shaded = [one for one in figure.axes[0].patches if "not explained" in one.get_label()]
        assert len(shaded) == (not found.fits)
        for one in shaded:
            ends = one.get_x(), one.get_x() + one.get_width()
            assert ends == pytest.approx(100 * np.array(found.residual_span))
    assert both.fits is (len(both.contacts) == 2) is (depth == 3e-3)


@pytest.mark.parametrize(("freedom", "length"), [(1.0, 24), (0.5, 48)])
def test_residual_is_that_of_a_part_of_2_or_4_ms(freedom, length):
    """4 ms where whitened samples are real, as in a folded band, for as many degrees of freedom."""
    rest = np.sqrt(freedom) * np.ones(180)
    rest[70 : 70 + length] *= 2
    base = SimpleNamespace(freedom=freedom, interval=1 / 12e3, places=np.arange(180.0))
    value, span = largest_residual(rest, base)
    assert value == pytest.approx(4.0)
    assert span == (70.0, 69.0 + length)


@pytest.mark.parametrize(
    ("misfit", "residual", "good"),
    [(np.nan, 2.4, True), (np.nan, 2.6, False), (0.14, 2.4, True), (0.16, 1.0, False)],
)
def test_fit_is_good_up_to_both_thresholds(misfit, residual, good):
    assert good_fit(misfit, residual) is good


def test_tools_are_identified(base, untouched):
    other = tool(diameter=10e-3, s=matrices(np.arange(1e-3, 7.01e-3, 0.1e-3), FREQUENCY[::-1]))
    model = ForwardModel(Library((other, tool())), base, measured_clutter(base, untouched))
    cycles = record([press(4e-3, 0.7)], n_cycles=20, tube_seed=7, seed=9)["signal"].values
    found = Inverter(model, most=1)(cycles)
    assert model.tool_library.tools[found.contacts[0].tool].diameter == 25e-3


def test_mean_of_rounded_cycles_is_the_voltage():
    """An echo of a third of a count, with noise that hardly dithers it, at any offset."""
    rng, t = np.random.default_rng(2), np.arange(4000)
    echo = 0.3 * np.sin(0.9 * t) * (t < 2000)
    for offset in (100.0, 100.25, 100.5):
        noisy = np.rint(echo + offset + 0.227 * rng.standard_normal((400, 4000)))
        found = linearised(noisy, 0.227, 1200)
        gain, plain = (np.vdot(echo, x) / np.vdot(echo, echo) for x in (found.mean, noisy.mean(0)))
        # The noise of a mean of 400 leaves 1 %.
        assert gain == pytest.approx(1.0, abs=0.04)
        assert abs(plain - 1) > 0.2 or offset == 100.25
        error = np.std(found.mean - echo)
        assert error == pytest.approx(np.std(found.deviations) / 20, rel=0.1)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A library of one tool, recordings of two presses, and the untouched tube."""
    where = tmp_path_factory.mktemp("inversion")
    (plan,) = tool_plans({"depth_mm": ["1:3:0.5"]}, 0.01)
    (where / "lib").mkdir()
    files.write_tool(where / "lib" / plan.name, tool(), plan)
    write(record([], n_cycles=100, tube_seed=7, seed=11), where / "free.nc")
    for i, (place, depth) in enumerate([(0.53, 3e-3), (0.91, 5e-3)]):
        write(record([press(depth, place)], n_cycles=20, tube_seed=7, seed=i), where / f"p{i}.nc")
    return where


def inverted(folder, tmp_path, *names, group):
    """Run the command with all its outputs; return the rows of its table of limits of detection."""
    done = run_here(
        "invert", *(folder / name for name in names), "--library", folder / "lib", "--untouched",
        folder / "free.nc", "--group", group, "--out", tmp_path / "c.csv", "--figure",
        tmp_path / "c.png", "--detection-limits", tmp_path / "l.csv",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "c.png").read_bytes()[1:4] == b"PNG"
    with (tmp_path / "l.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_command_writes_a_row_a_contact(folder, tmp_path):
    limits = inverted(folder, tmp_path, "p0.nc", "p1.nc", group=10)
    assert {(row["recording"][-5:], row["group"]) for row in limits} == {
        (name, group) for name in ("p0.nc", "p1.nc") for group in "01"
    }
    first = {float(row["distance_cm"]): row for row in limits if row["recording"].endswith("p0.nc")}
    assert not [z for z in first if abs(z - 53) < 3 or z < 10 or z > 250]  # none at the contact
    near, far = first[29.9], first[149.5]
    assert 1 <= float(near["depth_mm"]) < float(far["depth_mm"]) <= 7
    assert float(far["misfit"]) < 0.15
    assert float(far["force_n"]) == pytest.approx(2 * float(far["depth_mm"]) ** 2, rel=1e-2)
    assert (far["shape"], far["indenter_mm"]) == ("rod", "25")
    with (tmp_path / "c.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == [
        "recording", "group", "contact", "probability", "distance_cm", "distance_sd_cm", "depth_mm",
        "depth_sd_mm", "force_n", "force_sd_n", "indenter_mm", "misfit", "shape", "residual",
    ]  # fmt: skip
    assert [(row["group"], row["contact"]) for row in rows] == [("0", "0"), ("1", "0")] * 2
    for row, (place, depth) in zip(rows, [(53, 3)] * 2 + [(91, 5)] * 2, strict=True):
        assert float(row["distance_cm"]) == pytest.approx(place, abs=0.05)
        assert float(row["depth_mm"]) == pytest.approx(depth, abs=0.05)
        assert float(row["force_n"]) == pytest.approx(2 * depth**2, rel=0.05)
        assert (row["indenter_mm"], row["shape"]) == ("25", "rod")


def test_contacts_of_tools_of_one_diameter_differ_in_the_table():
    """In columns that are the same otherwise, down to the misfit."""
    tools = Library((tool(), tool(shape="sphere")))
    one = SimpleNamespace(value=1.0, deviation=0.1)
    contacts = [ContactFit(Contact(1.0, one, one, one, tool=i), 0.05, 1.2) for i in (0, 1)]
    first, second = (
        dict(zip(COLUMNS, row, strict=True)) for row in rows_of("p", 0, contacts, tools)
    )
    assert (first["indenter_mm"], first["shape"]) == ("25", "rod")
    assert second == first | {"contact": 1, "shape": "sphere"}


def test_command_writes_and_draws_the_limit_of_an_untouched_tube(folder, tmp_path):
    limits = inverted(folder, tmp_path, "free.nc", group=100)
    assert {row["misfit"] for row in limits} == {"nan"}
    assert float(limits[-1]["depth_mm"]) > float(limits[0]["depth_mm"])


def test_length_that_a_recording_states_counts_more_than_that_of_the_sensor_s_file():
    """Else contacts beyond the length in the sensor's file would be lost."""
    library, stated = Library((tool(),)), (("cycle",), [2.5, 2.5])
    for length in (None, 1.0):
        inverter = RecordingInverter(library, Sensor(length=length))
        assert inverter.length(xr.Dataset()) == length
        assert inverter.length(xr.Dataset(attrs={"tube_length": 2.5})) == 2.5
        assert inverter.length(xr.Dataset({"tube_length": stated})) == 2.5


@pytest.mark.parametrize(
    ("name", "sensor", "reason"),
    [
        ("slow.npz", "", "sampling rate of 60000 Hz aliases the band"),
        ("volts.npz", "", "not counts of a converter of 12 bits"),
        ("p0.nc", "sampling_rate = 100e3", "has 200000 samples per second and the sensor 100000"),
        ("p0.nc", "resonant = 4", "resonant is not a parameter"),
        ("p0.nc", "[priors]\nheat = 1", "heat is not known"),
        ("p0.nc", "length_cm = -3", "length_cm"),
        (
            "p0.nc",
            "resonance = 60e3\n[drive]\nfrequency = 60e3",
            "the library covers 30 to 53.9 kHz",
        ),
    ],
)
def test_foreign_recording_or_sensor_is_one_sentence(folder, tmp_path, name, sensor, reason):
    rng = np.random.default_rng(0)
    np.savez(tmp_path / "slow.npz", signal=rng.integers(0, 4000, (2, 1600)), sampling_rate=60e3,
             temperature=20.0)  # fmt: skip
    np.savez(tmp_path / "volts.npz", signal=rng.normal(size=(2, 4000)), sampling_rate=200e3,
             temperature=20.0)  # fmt: skip
    path = (tmp_path if name.endswith("npz") else folder) / name
    words = ["--library", folder / "lib"]
    if sensor:
        (tmp_path / "s.toml").write_text(sensor)
        words += ["--sensor", tmp_path / "s.toml"]
    done = run_here("invert", path, *words, "--out", tmp_path / "c.csv")
    assert done.returncode == 2
    assert reason in done.stderr
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "c.csv").exists()


def test_library_of_tubes_of_two_bores_is_refused():
    with pytest.raises(ValueError, match="one library for each"):
        Library((tool(), dataclasses.replace(tool(), radius=5e-3)))


@pytest.mark.parametrize(
    ("poor", "told"),
    [
        ([(1, 0.2, 1.2), (3, np.nan, 123)], ["2 of 5 groups", "group 1,", "0.2, ", "123, "]),
        ([(4, np.nan, 2.7), (5, 0.1, 2.6)], ["2 of 5 groups", "group 4,", "(residual up to 2.7, "]),
    ],
)
def test_groups_whose_echo_is_not_explained_are_counted(poor, told):
    """A group without contacts has no misfit."""
    notes = []
    note_warnings("p.nc", poor, 5, 2.5, SimpleNamespace(note=notes.append))
    assert [words for words in told if words not in notes[0]] == []


def test_assumed_length_of_the_tube_is_reported(folder, tmp_path, capsys):
    silent = record([press(3e-3, 0.53)], n_cycles=2, tube_seed=7, seed=0)
    del silent.attrs["tube_length"]
    write(silent, tmp_path / "silent.nc")
    (tmp_path / "s.toml").write_text("length_cm = 250\n")
    words = ["invert", str(tmp_path / "silent.nc"), "--library", str(folder / "lib"), "--out"]
    assert main([*words, str(tmp_path / "a.csv")]) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "nothing states the length of the tube, and 250 cm is assumed" in told
    assert main([*words, str(tmp_path / "b.csv"), "--sensor", str(tmp_path / "s.toml")]) == 0
    assert "nothing states" not in capsys.readouterr().out
    assert (tmp_path / "a.csv").read_text() == (tmp_path / "b.csv").read_text()


@pytest.mark.parametrize(
    "rangefinder", [Rangefinder(), Rangefinder(sampling_rate=80e3, n_samples=1600, lead=0.0)],
    ids=["complex", "folded"],
)  # fmt: skip
def test_error_of_the_losses_is_an_imaginary_part_of_frequency_in_the_presses(rangefinder):
    """By differences of basebands with presses at complex frequencies."""
    base = baseband_of(rangefinder, RADIUS, 2.5, 20.0, MODES)
    step, depth = 1e-5, tool().depth
    given = (0,), np.array([[0.7]]), np.array([[5.03e-3]]), np.zeros((1, 7))
    more, less = (
        ForwardModel(Library((tool(s=matrices(depth, FREQUENCY * (1 + 1j * sign * step))),)), base)
        for sign in (1, -1)
    )
    difference = (more.baseband(*given)[0][0] - less.baseband(*given)[0][0]) / (2 * step)
    derivative = (more.by_losses(*given)[0] + less.by_losses(*given)[0]) / 2
    # The table's spline over frequency, every 100 Hz.
    assert np.abs(derivative - difference).max() < 3e-3 * np.abs(difference).max()


def test_error_of_the_losses_adds_its_own_deviance_only(model):
    """A baseband off by one deviation of the losses has 2 more deviance than an exact one."""
    parameters = np.array([0.7, 5.03e-3, *np.zeros(7)])
    echo = echo_of(model, (0,), parameters)
    size = float(np.abs(echo.by_losses).max())
    assert size > 0.003 * np.abs(echo.value).max()
    noise = (0.02 * size) ** 2
    off = [
        deviance_of(model, noise, 0.0, one, 0.0, echo.by_losses)
        - deviance_of(model, noise, 0.0, one, 0.0, 0 * echo.value)
        for one in (echo, echo._replace(by_losses=None))
    ]
    assert off[0] == pytest.approx(2.0, rel=0.02)  # one standard deviation, of a circular error
    assert off[1] > 100 * off[0]
