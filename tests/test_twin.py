"""The twin of a sensor: echoes, derivatives, fit and file, against sensors of known parameters."""

import csv
import re
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from commands import run_here
from test_inversion import CUT_ONS, press, tool

from acoustube.air import air_at
from acoustube.base.errors import ConfigError
from acoustube.base.foreign.documents import read_document
from acoustube.inversion import Library
from acoustube.inversion.twin import Band, Group, Measured, Press, fit_material, fit_twin
from acoustube.inversion.twin.background import _far_end, _scatter, _templates, _variations
from acoustube.inversion.twin.estimate import (
    _first_prior,
    _quantised_levels,
    _rounding,
    _windowed,
)
from acoustube.inversion.twin.fit import Data, Point, Prior, normal_equations, solve
from acoustube.inversion.twin.model import LOCAL, NOMINAL_RADIUS, SHARED, EchoModel
from acoustube.inversion.twin.recorded import mean_of
from acoustube.inversion.twin.starts import _placed
from acoustube.ranging import Burst, Rangefinder, blockage, digitise, response
from acoustube.ranging.analogue import within
from acoustube.recordings import read
from acoustube.runs.inversion import read_sensor
from acoustube.runs.libraries import files
from acoustube.runs.libraries.files import open_library
from acoustube.runs.libraries.plan import tool_plans
from acoustube.runs.recordings import chosen
from acoustube.runs.sensor_file import twin_settings
from acoustube.runs.sweep.cycles import Recipe, _reflectors, in_session
from acoustube.runs.sweep.dataset import rangefinder_in
from acoustube.runs.twin import _check_untouched, _converter, read_recordings
from acoustube.runs.twin_calibration import is_twin, processing_of, thermometer
from acoustube.runs.twin_file import _material_parameters, time_zero_note
from acoustube.runs.twin_pressed import LABELS, _check_starts, _state, presses_of
from acoustube.runs.twin_sessions import recipe_settings
from acoustube.waves.network import at_sound_speed

SIDES = np.array([0.0, 120e3])
RADIUS, AIR, REPORTED, LENGTH = 4.2e-3, 22.5, 20.9, 2.5
SENSOR = Rangefinder(
    drive=Burst(cycles=12), resonance=43.1e3, quality_factor=19.0, gain=0.9, face_reflection=0.35,
    temperature_bias=REPORTED - AIR,
)  # fmt: skip
PLACES = np.linspace(0.35, 1.6, 9)
MISPLACED = 0.6e-3 * np.array([0.3, -1.2, 0.8, 1.1, -0.6, -1.4, 1.5, 0.1, -0.5])
"""Errors in m of stated positions; their standard deviation is 0.6 mm."""
PRESSED, DEPTHS = np.array([0.5, 0.62, 0.71, 0.55]), np.array([3.2e-3, 4.1e-3, 5.3e-3, 4.6e-3])
SOFTER, ZERO, COMPLIANCE = 0.8, 0.1e-3, 3e-5
"""Modulus over the library's, stated depth in m at first contact, and the ground's in m/N."""


def rangefinder_of_file(path):
    return rangefinder_in(read_document(path), path)


def voltage(presses, sensor=SENSOR):
    return response(
        presses, sensor, radius=RADIUS, length=LENGTH, temperature=AIR, tube_seed=5
    )[1]  # fmt: skip


def cycles_of(volts, seed, n=6, sensor=SENSOR):
    """Counts of cycles whose trigger has a jitter of 0.4 us and whose gain varies by 1 %."""
    random = np.random.default_rng(seed)
    spectrum = np.fft.rfft(volts, 2 * len(volts))
    omega = 2 * np.pi * np.fft.rfftfreq(2 * len(volts), 1 / sensor.sampling_rate)
    found = []
    for cycle in range(n):
        late = np.exp(-1j * omega * random.normal(0, 0.4e-6))
        one = np.fft.irfft(spectrum * late)[: len(volts)] * (1 + random.normal(0, 0.01))
        found.append(digitise(one, sensor, np.array([cycle]), seed)[0])
    return np.array(found)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Folder with recordings of nine closures, 0.6 mm off their labels, and of no contact."""
    folder = tmp_path_factory.mktemp("recorded")
    closed = [
        cycles_of(voltage([blockage(SIDES, place + error)]), k)
        for k, (place, error) in enumerate(zip(PLACES, MISPLACED, strict=True))
    ]
    known = {"temperature": REPORTED, "sampling_rate_hz": SENSOR.sampling_rate}
    np.savez(
        folder / "closed.npz", signal=np.concatenate(closed), **known,
        true_distance_cm=np.repeat(100 * PLACES, len(closed[0])),
    )  # fmt: skip
    np.savez(folder / "free.npz", signal=cycles_of(voltage([]), 99), **known)
    np.savez(folder / "pressed.npz", **known, **pressed_cycles())
    (plan,) = tool_plans({"depth_mm": ["1:3:0.5"]}, 0.01)
    (folder / "lib").mkdir()
    files.write_tool(folder / "lib" / plan.name, tool(radius=RADIUS), plan)
    return folder


def pressed_cycles():
    """Cycles and labels of three presses with force and depth, and of one with a force only."""
    speed, signal, force = air_at(AIR).sound_speed, [], []
    for k, (place, depth, scatter) in enumerate(
        zip(PRESSED, DEPTHS, (1.01, 0.98, 1.02, 0.99), strict=True)
    ):
        found = press(depth, place)
        cut_ons = CUT_ONS * 3.95e-3 / RADIUS
        scattering = at_sound_speed(replace(found.scattering, cut_ons=cut_ons), speed)
        signal.append(cycles_of(voltage([replace(found, scattering=scattering)]), 70 + k))
        force.append(SOFTER * float(tool().force_at(depth)) * scatter)
    stated = DEPTHS + ZERO + COMPLIANCE * np.array(force)
    stated[3] = np.nan
    labels = {"force_n": force, "depth_mm": 1e3 * stated, "true_distance_cm": 100 * PRESSED,
              "diameter_mm": np.full(4, 25.0)}  # fmt: skip
    return {"signal": np.concatenate(signal)} | {
        name: np.repeat(values, 6) for name, values in labels.items()
    }


@pytest.fixture(scope="module")
def made(recorded):
    """Folder after the command, its output, and the file of the twin."""
    result = run_here(
        "twin", recorded / "closed.npz", recorded / "free.npz", "--out", recorded / "left.toml",
        "--figure", recorded / "twin.png", "--pressed", recorded / "pressed.npz",
        "--library", recorded / "lib",
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    return recorded, result, tomllib.loads((recorded / "left.toml").read_text())


@pytest.fixture(scope="module")
def band():
    return Band(SENSOR.sampling_rate, 0.0, SENSOR.n_samples, SENSOR.resonance, 0.8e-3)


def shared(**values):
    found = np.zeros(len(SHARED))
    for name, value in values.items():
        found[SHARED.index(name)] = value
    return found


def true_parameters():
    counts = 2**SENSOR.bits / SENSOR.full_scale
    return shared(
        log_radius=np.log(RADIUS / NOMINAL_RADIUS), temperature_offset=AIR - REPORTED,
        log_resonance=np.log(SENSOR.resonance / 42e3), log_quality=np.log(19.0),
        drive_cycles=12.0, log_gain=np.log(0.9 * counts), face_real=0.35,
    )  # fmt: skip


def test_echo_of_a_closure_is_that_of_the_rangefinder(band):
    """The reference is :func:`acoustube.waves.transfer`, in the time domain, to 1e-3 of the peak.

    There is no clutter; the error is the difference of the ring-down, and the cyclic time of both.
    """
    quiet = replace(SENSOR, clutter=0.0, send=0.0)
    model = EchoModel(band, np.array([0.7]), np.array([REPORTED]), LENGTH / 2)
    echo = model(true_parameters(), np.zeros((1, len(LOCAL)))).value[0]
    counts = voltage([blockage(SIDES, 0.7)], quiet) * 2**SENSOR.bits / SENSOR.full_scale
    samples = band.baseband(band.spectra(counts))
    late = band.time > 0.7 * 2 / 350
    assert np.abs(echo - samples)[late].max() < 1e-3 * np.abs(samples).max()


@pytest.mark.parametrize("rate", [SENSOR.sampling_rate, 80e3])
def test_derivatives_of_echoes_are_those_of_differences(rate):
    """To 2e-4: the series over the closures' temperatures is finite. 80 kHz folds the carrier."""
    band = Band(rate, 0.0, int(0.02 * rate), SENSOR.resonance, 0.8e-3)
    model = EchoModel(band, PLACES[:3], REPORTED + np.array([0.0, 0.7, -1.2]), 1.2, rate > 1e5)
    point = true_parameters() + shared(
        temperature_gradient=0.4, log_loss=0.02, drive_cycles=0.2, trigger=3e-6, face_imag=0.1,
        level_1=0.02, level_2=-0.01, level_3=0.01, phase_2=0.02, phase_3=-0.03,
    )  # fmt: skip
    local = np.array([[1e-3, 0.02, 0.4], [-2e-3, -0.03, 2.0], [0.0, 0.01, -1.0]])
    echoes = model(point, local)
    for i, name in enumerate(SHARED):
        step = shared(**{name: 1e-5 if name != "trigger" else 1e-10})
        moved = [model(point + sign * step, local).value for sign in (1, -1)]
        slope = (moved[0] - moved[1]) / (2 * step[i])
        wrong = np.abs(slope - echoes.by_shared[:, i]).max()
        assert wrong < 2e-4 * np.abs(slope).max(), name
    for i, name in enumerate(LOCAL):
        step = np.zeros_like(local)
        step[:, i] = 1e-7
        moved = [model(point, local + sign * step).value for sign in (1, -1)]
        slope = (moved[0] - moved[1]) / 2e-7
        assert np.abs(slope - echoes.by_local[:, i]).max() < 1e-5 * np.abs(slope).max(), name


def test_step_is_that_of_the_whole_system(band):
    """The closures' parameters are eliminated; the dense equations have the same solution."""
    model = EchoModel(band, PLACES[:3], np.full(3, REPORTED), 1.2)
    point = Point(true_parameters(), np.zeros((3, len(LOCAL))))
    random = np.random.default_rng(0)
    values = model(*point).value * np.exp(0.1 * random.normal(size=(3, 1)))
    data = Data(values, (np.abs(values) > 1).astype(int), np.ones((3, 2)), np.zeros((3, 2)))
    prior = Prior(np.zeros(len(SHARED)), np.full(len(SHARED), 0.3), np.full((3, 3), 0.2))
    normal = normal_equations(model, data, point)
    step, local = solve(normal, prior, point, 0.0)
    p, n = len(SHARED), len(LOCAL)
    whole = np.zeros((p + 3 * n, p + 3 * n))
    whole[:p, :p] = normal.shared + np.eye(p) / 0.3**2
    right = np.zeros(p + 3 * n)
    right[:p] = normal.right_shared - point.shared / 0.3**2
    for i in range(3):
        own = slice(p + n * i, p + n * (i + 1))
        whole[own, own] = normal.local[i] + np.eye(n) / 0.2**2
        whole[:p, own], whole[own, :p] = normal.mixed[i], normal.mixed[i].T
        right[own] = normal.right_local[i]
    scale = 1 / np.sqrt(np.diag(whole))
    dense = scale * np.linalg.solve(whole * scale[:, None] * scale, scale * right)
    assert step == pytest.approx(dense[:p], rel=1e-5, abs=1e-9)
    assert local.ravel() == pytest.approx(dense[p:], rel=1e-5, abs=1e-9)


def test_hidden_parameters_lie_within_their_deviations(made):
    """Within three standard deviations, each of which is a small part of its prior's."""
    _, _, found = made
    for name, true, sharpest in (
        ("inner_diameter_mm", 2e3 * RADIUS, 0.05), ("resonance_khz", 43.1, 0.01),
        ("quality_factor", 19.0, 0.2), ("temperature_offset_c", AIR - REPORTED, 0.3),
        ("drive_cycles", 12.0, 0.1), ("gain_v", 0.9, 0.02), ("face_reflection_real", 0.35, 0.04),
        ("jitter_us", 0.4, 0.1), ("gain_wander_percent", 1.0, 0.3),
    ):  # fmt: skip
        assert abs(found[name] - true) < 3 * found[f"{name}_sd"], name
        assert found[f"{name}_sd"] < sharpest, name
        assert name in found["determined"], name
    assert "loss_factor" in found["undetermined"]


@pytest.mark.parametrize("length", [1.2, 1.21, None])
def test_far_end_is_found_above_the_clutter_whether_or_not_its_place_is_stated(band, length):
    """The clutter is that of the default rangefinder; without the far end, none is found."""
    model = EchoModel(band, np.array([0.4, 0.7]), np.full(2, REPORTED), 0.6)
    twin = SimpleNamespace(
        band=band, model=model, point=Point(true_parameters(), np.zeros((2, len(LOCAL)))),
        untouched=SimpleNamespace(variance=1e-4), deviation=lambda _: 0.1,
    )  # fmt: skip
    places = np.arange(0.01, 3.0, 4e-3)
    clutter = np.sqrt(1.5e-5 * 4e-3) * np.random.default_rng(1).normal(size=len(places))
    noise = clutter @ _templates(twin, places, REPORTED)
    echo = _templates(twin, np.array([1.2]), REPORTED)[0]
    used, reach = (band.time >= band.first) & (band.time <= band.last), 3.0
    far, end = _far_end(twin, noise + 0.5 * echo, used, length, reach, REPORTED)
    assert far.value == pytest.approx(0.5, rel=0.02)
    assert end is not None
    assert end.value == pytest.approx(1.2, abs=2e-3)
    far, end = _far_end(twin, noise, used, length, reach, REPORTED)
    assert end is None
    assert 0 < far.deviation < 0.05


def test_errors_of_the_places_are_found(made):
    """Within three deviations, up to a linear part that the air's temperature may explain."""
    _, _, found = made
    error = np.array([one["placement_error_mm"] for one in found["closures"]])
    deviation = np.array([one["placement_error_mm_sd"] for one in found["closures"]])
    assert np.all(np.abs(error - 1e3 * MISPLACED) < 3 * deviation)
    assert found["placement_mm"] == pytest.approx(0.6, rel=0.6)


def test_file_is_a_sensor_for_other_commands(made):
    folder, _, found = made
    rangefinder = rangefinder_of_file(folder / "left.toml")
    assert rangefinder.resonance == pytest.approx(1e3 * found["resonance_khz"], rel=1e-6)
    assert rangefinder.temperature_bias == pytest.approx(-found["temperature_offset_c"], rel=1e-6)
    assert rangefinder.bits == SENSOR.bits
    sensor = read_sensor(folder / "left.toml")
    assert sensor.rangefinder == rangefinder
    assert sensor.length == pytest.approx(found["length_cm"] / 100)
    assert sensor.priors.quality_factor < 0.01
    (folder / "left.toml").rename(folder / "free.toml")  # beside a recording it is no sidecar
    assert read(folder / "free.npz").sizes["cycle"] == 6
    (folder / "free.toml").rename(folder / "left.toml")


def test_twin_records_as_the_sensor_does(made):
    """The echo of a closure at a new position is right to 2 % of the root of its energy."""
    folder, _, found = made
    twin = rangefinder_of_file(folder / "left.toml")
    closed = [blockage(SIDES, 1.0)]
    temperature = REPORTED + found["temperature_offset_c"]
    _, own = response(
        closed, twin, radius=found["inner_diameter_mm"] / 2e3, length=LENGTH,
        temperature=temperature,
    )  # fmt: skip
    there = slice(int(5.7e-3 * SENSOR.sampling_rate), int(6.8e-3 * SENSOR.sampling_rate))
    true = voltage(closed)[there]
    wave = 2 * np.pi * SENSOR.resonance / 343.0
    spectrum = np.fft.rfft(own[there])
    # Up to the phase of a shift within the air's uncertainty: twice the wavenumber times 2 m.
    shifts = np.linspace(-1, 1, 401) * 2 * wave * 0.3 * 0.00175
    left = min(
        np.linalg.norm(np.fft.irfft(spectrum * np.exp(1j * s), len(true)) - true) for s in shifts
    )
    assert left < 0.02 * np.linalg.norm(true)


def test_presses_determine_the_wall_and_the_ground(made):
    """Three standard deviations: a modulus 20 % under the library's, a compliant ground."""
    folder, result, found = made
    library = open_library(folder / "lib").tools[0]
    for name, true, sharpest in (
        ("young_modulus_mpa", 1e-6 * SOFTER * library.young_modulus, 0.06),
        ("hardness_shore_a", 35 + np.log10(SOFTER) / 0.0235, 1.0),
        ("ground_compliance_mm_per_n", 1e3 * COMPLIANCE, 0.006),
        ("depth_zero_mm", 1e3 * ZERO, 0.3),
    ):
        assert abs(found[name] - true) < 3 * found[f"{name}_sd"], name
        assert found[f"{name}_sd"] < sharpest, name
    assert {"young_modulus_mpa", "ground_compliance_mm_per_n"} <= set(found["determined"])
    depth = np.array([one.get("depth_mm", np.nan) for one in found["presses"]])
    assert np.isfinite(depth).sum() >= 3
    assert np.nanmax(np.abs(depth - 1e3 * DEPTHS)) < 0.1
    assert "the ground yields" in " ".join((result.stdout + result.stderr).split())


def test_inversion_takes_the_modulus_of_the_twin(made):
    """Forces are proportional to the modulus, and their deviation includes that of the modulus."""
    folder, _, found = made
    library, sensor = open_library(folder / "lib"), read_sensor(folder / "left.toml")
    tool, own = library.tools[0], sensor.own(library).tools[0]
    ratio = 1e6 * found["young_modulus_mpa"] / tool.young_modulus
    assert own.force_at(4e-3) == pytest.approx(ratio * tool.force_at(4e-3), rel=1e-6)
    share = found["young_modulus_mpa_sd"] / found["young_modulus_mpa"]
    expected = np.hypot(ratio * tool.force_error.max(), share * own.force_at(4e-3))
    assert own.force_deviation(4e-3) == pytest.approx(expected, rel=1e-6)


def test_depths_alone_do_not_determine_the_modulus():
    """The modulus keeps its prior of 50 %; a force that contradicts the others is named."""
    stiff = tool(young_modulus=1.5e6)
    silent = [Press(stiff, d, 2e-5, d + 1e-4, np.nan) for d in DEPTHS]
    found = fit_material(silent)
    assert found.young_modulus.deviation == pytest.approx(0.5 * 1.5e6, rel=0.01)
    assert not found.yields
    assert set(found.left_out) == {0, 1, 2, 3}
    depths = np.linspace(2e-3, 6e-3, 8)
    forces = 1.2 * stiff.force_at(depths)
    forces[2] *= 1.6
    pressed = [
        Press(stiff, np.nan, np.nan, float(d), float(f))
        for d, f in zip(depths, forces, strict=True)
    ]
    found = fit_material(pressed)
    assert set(found.left_out) == {2}
    assert abs(found.young_modulus.value - 1.8e6) < 3 * found.young_modulus.deviation


def test_press_without_an_echo_is_of_no_tool_where_two_have_its_diameter():
    """A 25 mm sphere is not taken for the 25 mm rod, whose force is another."""
    rod, sphere = (replace(tool(), shape=shape) for shape in ("rod", "sphere"))
    label = {"true_distance": 0.5, "diameter": 25e-3, "depth": 3e-3, "force": 0.9}
    silent = SimpleNamespace(contacts=[], misfit=0.0)
    both = _state(Path("p"), label, silent, Library((rod, sphere)))
    assert np.isnan([both.press.stated_depth, both.press.force]).all()
    alone = _state(Path("p"), label, silent, Library((rod,)))
    assert (alone.press.stated_depth, alone.press.force) == (3e-3, 0.9)


def test_bits_are_those_of_counts_of_any_type():
    counts = xr.Dataset({"signal": (("cycle", "time"), np.array([[500.0, 3000.0]]))})
    assert _converter([(Path("p"), counts)], 12)[:2] == (12, True)
    assert _converter([(Path("p"), counts)], None)[1] is False  # volts, as far as is known
    with pytest.raises(ConfigError, match="bits needs counts"):
        _converter([(Path("p"), counts / 7)], 12)


def test_presses_of_stated_depth_determine_the_ground_by_the_librarys_force():
    """On ground of 0.3 mm/N, with presses without a force: the origin stays at zero.

    The relative error of the compliance is that of the modulus, whose prior deviation is 50 %.
    """
    known = tool(young_modulus=1.5e6)
    depths = np.linspace(2e-3, 6e-3, 5)
    presses = [
        Press(known, float(d), 1e-5, float(d + 3e-4 * known.force_at(d)), np.nan) for d in depths
    ]
    found = fit_material(presses)
    assert found.yields
    assert found.compliance.value == pytest.approx(3e-4, rel=0.01)
    assert found.compliance.deviation == pytest.approx(1.5e-4, rel=0.05)
    assert abs(found.zero.value) < 2 * found.zero.deviation


@pytest.mark.parametrize("modulus", [0.35, 2.5])
def test_ground_is_determined_by_presses_of_stated_depth_and_others_of_stated_force(modulus):
    """The others give the modulus, a multiple of the library's, and so the forces of the first."""
    known = tool(young_modulus=1.5e6)
    presses = []
    for i, d in enumerate(np.linspace(2e-3, 6e-3, 8)):
        force = modulus * float(known.force_at(d))
        stated = (np.nan, force) if i % 2 else (float(d + 3e-5 * force), np.nan)
        presses.append(Press(known, float(d), 1e-5, *stated))
    found = fit_material(presses)
    assert found.young_modulus.value == pytest.approx(modulus * 1.5e6, rel=0.01)
    assert found.compliance.value == pytest.approx(3e-5, rel=0.03)
    assert found.compliance.deviation < 0.2 * found.compliance.value


@pytest.mark.parametrize("wrong", [10.0, 0.1, -1.0])
def test_press_whose_force_is_left_out_does_not_change_the_ground(wrong):
    """One of seven labels of force is wrong; its depth still counts."""
    known, random, presses = tool(young_modulus=1.5e6), np.random.default_rng(0), []
    for i, d in enumerate(np.linspace(2e-3, 6e-3, 7)):
        force = float(known.force_at(d))
        stated = float(ZERO + d + COMPLIANCE * force + 1e-5 * random.normal())
        force *= wrong if i == 2 else float(np.exp(0.01 * random.normal()))
        presses.append(Press(known, float(d), 1e-5, stated, force))
    found = fit_material(presses)
    assert list(found.left_out) == [2]
    assert found.yields
    assert found.compliance.value == pytest.approx(COMPLIANCE, rel=0.05)
    assert found.zero.value == pytest.approx(ZERO, abs=5e-5)


def test_modulus_and_hardness_are_determined_together():
    """For a wall a third as stiff as the library's."""
    known = tool(young_modulus=1.5e6)
    presses = [
        Press(known, float(d), 5e-4, np.nan, float(0.35 * known.force_at(d))) for d in DEPTHS
    ]
    soft = fit_material(presses)
    assert soft.young_modulus.value < 0.5 * 1.5e6
    assert soft.young_modulus.deviation / soft.young_modulus.value < 0.3
    rows = {one.name: one for one in _material_parameters(SimpleNamespace(material=soft))}
    shares = [
        rows[name].deviation / rows[name].prior
        for name in ("young_modulus_mpa", "hardness_shore_a")
    ]
    assert shares[0] == pytest.approx(shares[1], rel=1e-6)


def test_cycles_of_one_press_are_one(made, tmp_path):
    """120 cycles with one label give as much information on its force as 6."""
    folder, _, _ = made
    few = dict(np.load(folder / "pressed.npz"))
    first = few["depth_mm"] == few["depth_mm"][0]
    many = {
        name: np.concatenate([value[first]] * (120 // first.sum())) if value.ndim else value
        for name, value in few.items()
    }
    np.savez(tmp_path / "many.npz", **many)
    for path, n, cycles in (
        (folder / "pressed.npz", len(DEPTHS), 6),
        (tmp_path / "many.npz", 1, 50),
    ):
        ((_, data),) = read_recordings([path], {}, None)
        found = list(presses_of(data, [name for name in LABELS if name in data]))
        assert len(found) == n
        assert {part.sizes["cycle"] for part, _, _ in found} == {cycles}
        assert found[0][1]["depth"] == pytest.approx(1e-3 * few["depth_mm"][0])
        assert found[-1][2] == pytest.approx(1)


def test_presses_without_a_library_are_refused(recorded, tmp_path):
    result = run_here("twin", recorded / "closed.npz", recorded / "free.npz", "--pressed",
                      recorded / "pressed.npz", "--out", tmp_path / "left.toml")  # fmt: skip
    assert result.returncode == 2
    assert "--pressed and --library go together" in " ".join(result.stderr.split())


def test_process_with_the_twin_locates_closures_within_5_mm(made):
    """Within 5 mm: 0.6 mm of the positions, the resonance's delay, and 0.2 K over 1.6 m.

    Without the twin they are 4 cm off: by the maximum of the send pulse, and 1.6 K of the
    thermometer.
    """
    folder, _, _ = made

    def errors(*words):
        done = run_here("process", folder / "closed.npz", *words)
        assert done.returncode == 0, done.stderr
        rows = [row for row in csv.DictReader(done.stdout.splitlines()) if row["distance_cm"]]
        assert len(rows) > (50 if words else 30)
        told, true = (
            np.array([float(row[name]) for row in rows])
            for name in ("distance_cm", "true_distance_cm")
        )
        return np.abs(told - true)

    known, unknown = errors("--sensor", folder / "left.toml"), errors()
    assert known.max() < 0.5
    assert np.median(unknown) > 2.0


def test_twin_is_a_calibration(made):
    """As one from recorded closures: its gain falls, and false detections are few.

    A file that is not of a twin is no calibration; the file of a sensor gives the thermometer's
    error only.
    """
    folder, _, found = made
    known, settings = chosen(str(folder / "left.toml"), None)
    assert known.slope.value == pytest.approx(1.0, abs=0.005)
    assert known.distance_rmse < 3e-3
    assert known.false_alarms <= 0.01
    assert settings.gain is not None
    bias = thermometer(folder / "left.toml")
    assert bias == pytest.approx(-found["temperature_offset_c"], rel=1e-6)
    (folder / "plain.toml").write_text("temperature_bias = 0.7\nlength_cm = 200\n")
    assert thermometer(folder / "plain.toml") == 0.7
    (folder / "silent.toml").write_text("length_cm = 200\n")
    assert thermometer(folder / "silent.toml") == 0.0
    assert not is_twin(folder / "plain.toml")


@pytest.mark.slow
def test_calibration_of_a_twin_is_for_its_carrier(made, tmp_path):
    """Of 60 kHz: with a template of 42 kHz distances are 100 mm off."""
    text = (made[0] / "left.toml").read_text()
    high = {"resonance": 60e3, "frequency": 60e3, "cycles": 13.0}
    (tmp_path / "high.toml").write_text(with_values(text, high))
    known, settings = chosen(str(tmp_path / "high.toml"), None)
    assert settings.frequency == 60e3
    assert processing_of(tmp_path / "high.toml").frequency == 60e3
    assert known.distance_rmse < 3e-3
    assert known.slope.value == pytest.approx(1.0, abs=0.005)


SESSIONS = 5


@pytest.fixture(scope="module")
def sessions(made, tmp_path_factory):
    """Files of a twin in sessions of other temperatures, gains and clutter."""
    folder, _, found = made
    text, random = (folder / "left.toml").read_text(), np.random.default_rng(3)
    where, paths = tmp_path_factory.mktemp("sessions"), []
    clutter = np.array(found["clutter"]["reflection"])
    for k in range(SESSIONS):
        offset, gain = (
            found["temperature_offset_c"] + 1.0 * (k - 2),
            found["gain_v"] + 0.05 * (k - 2),
        )
        own = clutter + random.normal(0, 1e-4, len(clutter))
        new = {
            "temperature_offset_c": offset, "gain_v": gain, "gain": gain,
            "inner_diameter_mm": found["inner_diameter_mm"] + 0.01 * random.normal(),
            "temperature_bias": -offset, "reflection": own.tolist(),
        }  # fmt: skip
        paths.append(where / f"{k}.toml")
        paths[-1].write_text(with_values(text, new))
    return paths


def with_values(text, new):
    """The text of a TOML file with new values in the first lines of given names."""
    for name, value in new.items():
        text, count = re.subn(
            rf"(?ms)^{name} = (\[.*?\]|[^\n]*)", f"{name} = {value}", text, count=1
        )
        assert count == 1, name
    return text


def test_sessions_determine_constant_and_variable_parameters(sessions, made):
    """The spread of the offsets is 1.58 K less that of the fits; the bore is constant."""
    _, _, found = made
    settings, table = recipe_settings(sessions)
    rows = {one.name: one for one in table}
    assert rows["temperature_offset_c"].wanders
    assert rows["gain_v"].wanders
    assert not rows["inner_diameter_mm"].wanders
    assert not rows["resonance_khz"].wanders
    variance = 2.5 - found["temperature_offset_c_sd"] ** 2
    assert rows["temperature_offset_c"].spread == pytest.approx(variance**0.5, rel=1e-3)
    spread = dict(settings["spread"])
    assert set(spread) == {"gain"}
    assert spread["gain"] == pytest.approx(np.std(np.log(found["gain_v"] + 0.05 * np.arange(-2, 3)),
                                                  ddof=1), rel=0.02)  # fmt: skip
    assert settings["offset_deviation"] > 1.5
    assert settings["rangefinder"].gain == pytest.approx(rows["gain_v"].mean)
    # Reflectors 1 mm apart that change by 1e-4.
    assert settings["clutter_spread"] == pytest.approx(1e-8 / 1e-3, rel=0.1)
    assert settings["young_modulus"] == pytest.approx(1e6 * found["young_modulus_mpa"], rel=1e-6)


def test_constant_parameters_are_drawn_without_a_spread(sessions, made, tmp_path):
    """The gains differ by a little more than their deviations, which is compatible with chance."""
    _, _, found = made
    gains = found["gain_v"] * (1 + found["gain_v_sd"] / found["gain_v"] * np.array([0, 1.4, -1, 2]))
    paths = [tmp_path / f"{k}.toml" for k in range(4)]
    for path, gain in zip(paths, gains, strict=True):
        new = {"gain_v": gain, "gain": gain}
        path.write_text(with_values(sessions[2].read_text(), new))
    settings, table = recipe_settings(paths)
    (gain,) = (one for one in table if one.name == "gain_v")
    assert not gain.wanders
    assert gain.spread > 0
    assert "gain" not in dict(settings["spread"])


def test_variable_parameters_are_drawn_for_each_session(sessions):
    """Gains of many sessions have mean and deviation of the twins; other parameters are fixed."""
    settings, _ = recipe_settings(sessions)
    recipe = Recipe(**settings)
    drawn = [in_session(recipe.rangefinder, seed, recipe) for seed in range(300)]
    gains = np.log([one.gain for one in drawn])
    # Standard errors of mean and deviation of 300: 6 and 4 %.
    width = dict(recipe.spread)["gain"]
    assert gains.mean() == pytest.approx(np.log(recipe.rangefinder.gain), abs=0.2 * width)
    assert gains.std() == pytest.approx(width, rel=0.15)
    assert {one.resonance for one in drawn} == {recipe.rangefinder.resonance}
    biases = np.array([one.temperature_bias for one in drawn])
    assert biases.std() == pytest.approx(recipe.offset_deviation, rel=0.15)
    clutter = np.array([_reflectors(recipe, seed, LENGTH) for seed in range(40)])
    assert clutter.std(axis=0).mean() == pytest.approx(1e-4, rel=0.1)
    assert recipe.name != Recipe(**(settings | {"spread": ()})).name


def test_sessions_of_other_sensors_are_refused(sessions, tmp_path):
    (tmp_path / "other.toml").write_text(with_values(sessions[0].read_text(), {"bits": 8}))
    with pytest.raises(ConfigError, match="sessions are of one sensor"):
        recipe_settings([sessions[1], tmp_path / "other.toml"])
    (tmp_path / "plain.toml").write_text("gain = 1.0\n")
    with pytest.raises(ConfigError, match="not the file of a twin"):
        recipe_settings([sessions[1], tmp_path / "plain.toml"])


def test_figure_and_table_are_made(made):
    folder, result, _ = made
    assert (folder / "twin.png").read_bytes().startswith(b"\x89PNG")
    told = " ".join(result.stdout.split())
    assert "9 of 9 closures are fitted" in told
    assert "temperature_offset_c" in told


def groups(recorded):
    ((_, shut),) = read_recordings([recorded / "closed.npz"], {}, None)
    ((_, free),) = read_recordings([recorded / "free.npz"], {}, None)
    signal, places = shut["signal"].values, shut["true_distance"].values
    closed = [
        Group(signal[places == place], REPORTED, float(place), "closed.npz")
        for place in np.unique(places)
    ]
    return closed, Group(free["signal"].values, REPORTED, source="free.npz")


@pytest.mark.slow
def test_wrong_label_and_clipped_echo_are_left_out(recorded):
    """A label 4 cm off, and an echo at full scale; the other closures determine the sensor."""
    closed, free = groups(recorded)
    closed[3] = replace(closed[3], place=closed[3].place + 0.04)
    loud = np.array(closed[1].cycles)
    loud[:, 600:700] = 4095
    closed[1] = replace(closed[1], cycles=loud)
    found = fit_twin(closed, free, SENSOR.sampling_rate)
    assert set(found.left_out) == {1, 3}
    assert "clipped" in found.left_out[1]
    assert "label" in found.left_out[3]
    assert abs(found.value("temperature_offset") - (AIR - REPORTED)) < 3 * found.deviation(
        "temperature_offset"
    )


@pytest.mark.parametrize(
    ("change", "part"),
    [
        (lambda shut, _: shut.pop("true_distance_cm"), "no label true_distance"),
        (lambda shut, _: shut.update(true_distance_cm=50.0), "1 of 1 closures can be used"),
        (lambda shut, _: shut.update(true_distance_cm=5.0), "within the ring-down"),
        (lambda shut, _: shut.update(true_distance_cm=900.0), "after the end of the cycle"),
        (lambda shut, _: shut.update(sampling_rate_hz=1e5), "free.npz has cycles of 4000 samples"),
        (lambda _, free: free.update(signal=free["signal"][:, :3000]), "cycles of 3000 samples"),
        (lambda shut, _: shut.update(signal=np.full((54, 4000), 7)), "closed.npz is silent"),
        (lambda shut, _: shut.update(temperature=300.0), "temperature = 300 degC"),
    ],
)
def test_bad_recordings_are_named_with_what_is_wrong(recorded, tmp_path, change, part):
    shut, free = (dict(np.load(recorded / name)) for name in ("closed.npz", "free.npz"))
    change(shut, free)
    np.savez(tmp_path / "closed.npz", **shut)
    np.savez(tmp_path / "free.npz", **free)
    out = tmp_path / "left.toml"
    result = run_here("twin", tmp_path / "closed.npz", tmp_path / "free.npz", "--out", out)
    told = " ".join(result.stderr.split())
    assert result.returncode == 2, told
    assert part in told
    assert str(tmp_path) in told
    assert not Path(out).exists()


def test_untouched_tube_with_presses_is_refused():
    """Its estimated clutter is that of presses, 20 dB above the strongest clutter of tubes."""
    rest = SimpleNamespace(clutter=Measured(value=0.01, deviation=1e-3))
    with pytest.raises(ConfigError, match=r"free\.npz hold echoes along the whole tube"):
        _check_untouched(None, rest, Group(np.zeros((1, 9)), 20.0, source="free.npz"))


def test_slow_sampling_is_refused():
    group = Group(np.random.default_rng(0).integers(0, 256, (3, 400)), 20.0, 0.5)
    with pytest.raises(ConfigError, match=r"too low for a carrier|hold no sound"):
        fit_twin([group], group, 15e3)
    for rate in (48e3, 1.2 * 42e3):
        with pytest.raises(ConfigError, match="too low for a carrier of 42 kHz; record at 105000"):
            Band(rate, 0.0, 960, 42e3, 1e-3)
    assert Band(55e3, 0.0, 960, 42e3, 1e-3).frequency[0] > 0


@pytest.mark.parametrize(
    ("shape", "words"),
    [((0, 400), "0 cycles of 400 samples"), ((3, 380), "3 cycles of 380 samples")],
)
def test_group_without_cycles_or_of_another_length_is_refused(shape, words):
    random = np.random.default_rng(0)
    usual = Group(random.integers(0, 256, (3, 400)), 20.0, 0.5)
    other = Group(np.zeros(shape), 20.0, 0.7, "odd.npz")
    with pytest.raises(ConfigError, match=f"odd.npz has {words}"):
        fit_twin([usual, other], usual, 80e3)
    with pytest.raises(ConfigError, match="give each group one or more cycles of one length"):
        fit_twin([usual, usual], other, 80e3)


def test_cycles_in_lists_are_those_of_an_array():
    assert Group([[1, 2], [3, 4]], 20.0).cycles.dtype.kind == "i"


@pytest.mark.parametrize(("noise", "distorted"), [(0.1, True), (1.0, False)])
def test_level_of_an_echo_is_uncertain_by_rounding_without_dither(band, noise, distorted):
    """As the variance of its samples is; noise of a count makes rounding linear on average."""
    random = np.random.default_rng(0)
    cycles = np.rint(2048 + 10 * random.normal(size=400) + random.normal(0, noise, (8, 400)))
    groups = [Group(cycles.astype(int), 20.0, 0.5), Group(cycles, 20.0, 0.5)]
    values, inside = np.full((2, 9), 4.0 + 0j), np.ones((2, 9), int)
    data = Data(values, inside, np.ones((2, 2)), np.zeros((2, 2)))
    levels = _quantised_levels(groups, data, np.arange(2))
    assert list(levels > 0) == list(_rounding(groups, band) > 0) == [distorted, False]


@pytest.mark.slow
def test_moist_air_gives_a_lower_temperature(made):
    """The difference is that at which dry air has the same speed of sound, 1.2 K at 50 %.

    To 0.06 K, a quarter of its standard deviation, as the variances of the residuals are fitted
    too.
    """
    folder, _, dry = made
    words = ["twin", folder / "closed.npz", folder / "free.npz", "--humidity", 50, "--quiet"]
    assert run_here(*words, "--out", folder / "moist.toml").returncode == 0
    moist = tomllib.loads((folder / "moist.toml").read_text())
    fall = dry["temperature_offset_c"] - moist["temperature_offset_c"]
    colder = REPORTED + moist["temperature_offset_c"]
    ratio = air_at(colder, humidity=50, moist=True).sound_speed / air_at(colder).sound_speed
    assert fall == pytest.approx((ratio**2 - 1) * (273.15 + colder), abs=0.06)
    rangefinder = rangefinder_of_file(folder / "moist.toml")
    assert rangefinder.temperature_bias == pytest.approx(-dry["temperature_offset_c"], abs=0.06)


def test_dataset_records_with_the_measured_clutter(made):
    """The echoes of its untouched tube are the recorded ones where these exceed the noise."""
    folder, _, _ = made
    settings = twin_settings(folder / "left.toml")
    assert settings["offset_deviation"] < 0.5
    recipe = Recipe(rangefinder=rangefinder_of_file(folder / "left.toml"), **settings)
    assert recipe.name != Recipe(rangefinder=recipe.rangefinder).name
    _, own = response(
        [], recipe.rangefinder, radius=RADIUS, length=LENGTH, temperature=AIR,
        reflectors=within(recipe.reflectors, LENGTH),
    )  # fmt: skip
    true = voltage([])
    near = slice(int(2.2e-3 * SENSOR.sampling_rate), int(3.5e-3 * SENSOR.sampling_rate))
    left = np.linalg.norm(own[near] - true[near]) / np.linalg.norm(true[near])
    other = voltage([], replace(SENSOR, clutter=0.0))[near]
    assert np.linalg.norm(other - true[near]) > 0.7 * np.linalg.norm(true[near])
    assert left < 0.3
    damaged = (folder / "left.toml").read_text().replace("reflection = [", 'reflection = ["a", ')
    (folder / "damaged.toml").write_text(damaged)
    with pytest.raises(ConfigError, match="damaged"):
        twin_settings(folder / "damaged.toml")


@pytest.mark.parametrize(
    ("new", "part"),
    [
        ({"length_cm": 30.0}, "too short"),
        ({"trigger_us": '"late"'}, "damaged"),
        ({"inner_diameter_mm": -1.0}, "gives no calibration"),
    ],
)
def test_twin_that_gives_no_calibration_is_refused(made, tmp_path, new, part):
    folder, _, _ = made
    (tmp_path / "wrong.toml").write_text(with_values((folder / "left.toml").read_text(), new))
    with pytest.raises(ConfigError, match=part):
        chosen(str(tmp_path / "wrong.toml"), None)


def test_closure_beyond_the_end_of_the_tube_is_refused(recorded, tmp_path):
    """The excess is more than the thickness of a plug, 2 cm; the farthest closure is at 1.6 m."""
    files, out = [recorded / name for name in ("closed.npz", "free.npz")], tmp_path / "left.toml"
    result = run_here("twin", *files, "--length", 150, "--out", out)
    assert result.returncode == 2
    assert "closed.npz: the closure at 160 cm lies beyond the end of the tube" in result.stderr
    assert not out.exists()
    silent = Group(np.zeros((2, 4000)), 20.0)
    closed = [replace(silent, place=place, source="shut.npz") for place in (0.5, 1.6)]
    with pytest.raises(ConfigError, match="beyond the end"):
        fit_twin(closed, silent, 200e3, length=1.57)
    for length in (None, 1.59):
        with pytest.raises(ConfigError, match="ring-down of the untouched cycles"):
            fit_twin(closed, silent, 200e3, length=length)


@pytest.mark.parametrize("late", [-0.28e-3, 0.0, 0.2e-3])
def test_common_delay_of_the_echoes_is_that_of_the_trigger(band, late):
    """At the starting point. The temperature takes what is proportional to the distance.

    A wrong label, by 30 mm, changes neither. To 8 us, two steps of the delays that are tried.
    """
    model = EchoModel(band, PLACES, np.full(len(PLACES), REPORTED), LENGTH / 2)
    moved = np.zeros((len(PLACES), len(LOCAL)))
    moved[3, 0] = 30e-3
    values = model.value(true_parameters() + shared(trigger=late), moved)
    first = _first_prior(band, len(PLACES))
    data = _windowed(model, values, np.ones(len(PLACES)))
    known = true_parameters() + shared(temperature_offset=REPORTED - AIR)
    start = _placed(model, data, first, known)
    assert abs(start.shared[SHARED.index("trigger")] - late) < 8e-6
    assert start.shared[SHARED.index("temperature_offset")] == pytest.approx(AIR - REPORTED, abs=1)
    assert np.abs(start.local[:, 0] - moved[:, 0]).max() < 3e-3


@pytest.mark.slow
def test_drive_before_the_first_sample_changes_neither_temperature_nor_face():
    """By 0.2 ms: as if each position were stated 34 mm too large. Three deviations."""
    closed = [
        Group(cycles_of(voltage([blockage(SIDES, p + e)]), k)[:, 40:], REPORTED, float(p), f"{k}")
        for k, (p, e) in enumerate(zip(PLACES, MISPLACED, strict=True))
    ]
    free = Group(cycles_of(voltage([]), 99)[:, 40:], REPORTED, source="free")
    found = fit_twin(closed, free, SENSOR.sampling_rate)
    assert found.value("trigger") == pytest.approx(-40 / SENSOR.sampling_rate, abs=2e-6)
    for name, true in (("temperature_offset", AIR - REPORTED), ("face_real", 0.35)):
        assert abs(found.value(name) - true) < 3 * found.deviation(name), name
        assert found.deviation(name) < 0.3, name


@pytest.mark.parametrize(
    ("start", "trigger", "words"),
    [(0.0, -2e-4, "0.200 ms before the first sample.*3.4 cm too large"),
     (2e-4, 0.0, "0.200 ms before the first sample"), (0.0, 3e-4, "0.300 ms after time zero"),
     (-1e-3, 0.0, None), (0.0, 2e-5, None)],
)  # fmt: skip
def test_drive_before_the_first_sample_is_noted(start, trigger, words):
    """Other commands take the first sample for the drive's start, since `lead` is not negative."""
    twin = SimpleNamespace(band=SimpleNamespace(start=start), value={"trigger": trigger}.get)
    note = time_zero_note(SimpleNamespace(twin=twin))
    assert re.search(words, note) if words else note == ""


@pytest.mark.parametrize("true", [0.0, 0.3, 1.0, 3.0])
def test_deviation_of_a_scatter_contains_that_of_the_noise(true):
    """Of ten groups of 20 cycles with noise of 1: the rms error is half to 1.15 of the stated."""
    random, found = np.random.default_rng(0), []
    means = [SimpleNamespace(wobble=1.0)] * 10
    for _ in range(300):
        values = [random.normal(0, np.hypot(true, 1.0), 20) for _ in means]
        found.append(_scatter(values, means, 1.0))
    error = np.sqrt(np.mean([(one.value - true) ** 2 for one in found]))
    assert 0.5 < error / np.mean([one.deviation for one in found]) < 1.15


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.15, 0.23, 0.3, 0.6])
def test_deviation_of_a_noise_contains_what_rounding_hides(noise):
    """Of 40 offsets between two counts: the rms error is at most 1.3 of the stated deviation."""
    random, found = np.random.default_rng(0), []
    none = SimpleNamespace(delays=np.zeros(0), gains=np.zeros(0), wobble=0.0)
    for offset in np.linspace(0, 1, 40):
        each = [
            Group(np.rint(offset + random.normal(0, noise, (10, 500))).astype(int), REPORTED)
            for offset in random.normal(2048 + offset, 0.3, 5)
        ]
        found.append(_variations(each[0], each[1:], [none], 42e3)["noise"])
    error = np.sqrt(np.mean([(one.value - noise) ** 2 for one in found]))
    assert error < 1.3 * np.mean([one.deviation for one in found])


def test_pressed_cycles_that_begin_at_another_time_are_refused():
    found = SimpleNamespace(twin=SimpleNamespace(band=SimpleNamespace(start=-1e-3, rate=200e3)))
    recordings = [
        (Path(f"{start}.nc"), xr.Dataset(coords={"time": start + np.arange(9) / 200e3}))
        for start in (-1e-3, 0.0)
    ]
    _check_starts(found, recordings[:1])
    with pytest.raises(ConfigError, match=r"0.0.nc begins at 0 ms .* closed cycles at -1 ms"):
        _check_starts(found, recordings)


def test_session_whose_noise_rounding_hides_is_left_out_for_it(sessions, tmp_path):
    """A noise of 0 has no logarithm."""
    hidden = tmp_path / "hidden.toml"
    hidden.write_text(with_values(sessions[0].read_text(), {"noise_v": 0.0}))
    assert "noise_v" not in [one.name for one in recipe_settings([hidden, sessions[1]])[1]]
    assert "noise_v" in [one.name for one in recipe_settings([hidden, *sessions[1:3]])[1]]


def test_scatter_of_gains_by_noise_alone_is_the_stated_one():
    """Of cycles of 7.5 ms, which the band pads by 28 %; the draws determine it to 6 %."""
    n, random = 1500, np.random.default_rng(0)
    band = Band(200e3, 0.0, n, 42e3, 0.8e-3)
    time = np.arange(n) / band.rate
    echo = 300 * np.exp(-(((time - 3e-3) / 3e-4) ** 2)) * np.sin(2 * np.pi * 42e3 * time)
    means = [mean_of(band, echo + random.normal(0, 3, (30, n))) for _ in range(20)]
    phases = [2 * np.pi * band.carrier * one.delays for one in means]
    scatter = [np.var([*one.gains, *(1 + own)], ddof=2)
               for one, own in zip(means, phases, strict=True)]  # fmt: skip
    assert np.mean(scatter) == pytest.approx(np.mean([one.wobble for one in means]), rel=0.15)


@pytest.mark.slow
def test_cycles_of_8_bits_at_80_khz_determine_the_sensor():
    """EchoTube's: every third sample at 240 kHz. Three deviations; the far closure is left out."""
    fine = replace(SENSOR, sampling_rate=240e3, n_samples=4800, gain=3.0)
    board = replace(fine, sampling_rate=80e3, n_samples=1600, bits=8, noise=1e-3)

    def cycles(volts, seed):
        random = np.random.default_rng(seed)
        each = [volts[::3] * (1 + random.normal(0, 0.01)) for _ in range(6)]
        return np.concatenate([digitise(v, board, np.array([k]), seed) for k, v in enumerate(each)])

    places = np.array([0.35, 0.5, 0.65, 0.8, 0.95, 1.1, 2.4])
    closed = [
        Group(cycles(voltage([blockage(SIDES, p + e)], fine), k), REPORTED, float(p), f"{k}")
        for k, (p, e) in enumerate(zip(places, MISPLACED, strict=False))
    ]
    free = Group(cycles(voltage([], fine), 99), REPORTED, source="free")
    found = fit_twin(closed, free, 80e3, length=LENGTH)
    assert "raise the gain" in found.left_out[6]
    for name, true, sharpest in (
        ("log_radius", np.log(RADIUS / NOMINAL_RADIUS), 0.05),
        ("log_resonance", np.log(43.1 / 42), 2e-3), ("log_quality", np.log(19.0), 0.05),
        ("temperature_offset", AIR - REPORTED, 2.0),
    ):  # fmt: skip
        assert abs(found.value(name) - true) < 3 * found.deviation(name), name
        assert found.deviation(name) < sharpest, name
