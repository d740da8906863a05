"""Inversion of wrapped tubes: bent modes, forward model, Jacobian, estimated presses, files."""

import dataclasses
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from commands import run_here
from test_inversion import CUT_ONS, MODES, RADIUS, tool
from test_inversion import matrices as scattering

from acoustube.air import air_at
from acoustube.base.errors import ConfigError
from acoustube.inversion import (
    Baseband,
    ContactTracker,
    ForwardModel,
    Inverter,
    Library,
    measured_clutter,
)
from acoustube.inversion.coupled_network import coupled_echo
from acoustube.inversion.tables import Matrices
from acoustube.inversion.wrap import WrappedPath
from acoustube.ranging import Rangefinder, record
from acoustube.recordings import write
from acoustube.runs.inversion import read_sensor
from acoustube.runs.libraries import files
from acoustube.runs.libraries.plan import tool_plans
from acoustube.runs.wrap import wrap_of
from acoustube.sleeve import between_bends, design, windings
from acoustube.waves import Bent, PlacedScatterer, axial_wavenumber, joined_bends
from acoustube.waves.bent_modes import bent_modes
from acoustube.waves.modes.grid_modes import mode_numbers
from acoustube.waves.scattering import ModalScattering
from acoustube.waves.star_product import star_product

AIR = air_at(20.0)
NAMES = (*MODES, "11s", "21s")
HELIX = design(0.26, (0.18, 0.266), loops=9, n_tubes=2)[0]
WRAP = wrap_of(HELIX)


def wavenumbers(names, frequency):
    numbers = [mode_numbers(name) for name in names]
    return np.stack([axial_wavenumber(*one, frequency, RADIUS, AIR) for one in numbers], -1)


@pytest.mark.parametrize("torsion", [0.0, 3.4])
def test_bent_modes_join_to_the_scattering_of_a_bend(torsion):
    """A bend between straight ends, by its modes and two joints, against the multimodal method."""
    frequency, length = np.linspace(36.5e3, 47.5e3, 12), 0.2
    part = Bent(length=length, curvature=25.0, torsion=torsion)
    own = bent_modes(AIR, frequency, part, radius=RADIUS, modes=NAMES, count=3)
    path = np.exp(-1j * own.wavenumber * length)[:, :, None] * np.eye(3)
    into = own.passed.swapaxes(1, 2) * own.signs
    once = path @ own.reflected @ path
    inner = np.linalg.inv(np.eye(3) - own.reflected @ once)
    through = own.passed @ path @ inner.swapaxes(1, 2) @ into
    returned = (
        own.signs[:, None] * own.returned * own.signs + into.swapaxes(1, 2) @ inner @ once @ into
    )
    s = joined_bends(AIR, frequency, [part], radius=RADIUS, modes=NAMES, highest=8.0).s
    # The modes (2,1), near their cut-on at 42.3 kHz, carry a thousandth of the power.
    for out, into_mode in ((0, 0), (1, 0), (1, 1), (3, 0), (3, 1)):
        off = through[:, out, into_mode] - s[:, 1, out, 0, into_mode]
        assert np.abs(off).max() < 5e-3
        off = returned[:, out, into_mode] - s[:, 0, out, 0, into_mode]
        assert np.abs(off).max() < 3e-4
    assert np.abs(s[:, 0, 1, 0, 0]).max() > 3e-3


@pytest.mark.parametrize("frequency", [300.0, 2e3, 8e3])
def test_first_bent_modes_are_the_plane_wave_and_those_that_decay_least(frequency):
    """Torsion gives the wavenumbers of evanescent modes real parts, up to 85 per metre here.

    The bend changes the plane wave's by 1.3 % at most, and the decay of (1,1) by 2 %, measured.
    """
    part = Bent(curvature=25.0, torsion=30.0, length=0.01)
    own = bent_modes(AIR, np.array([frequency]), part, radius=RADIUS, modes=NAMES, count=3)
    plane = axial_wavenumber(0, 0, frequency, RADIUS, AIR)
    np.testing.assert_allclose(own.wavenumber[0, 0], plane, rtol=0.02)
    decay = -axial_wavenumber(1, 1, frequency, RADIUS, AIR).imag
    np.testing.assert_allclose(-own.wavenumber[0, 1:].imag, [decay, decay], rtol=0.03)


def test_more_bent_modes_than_are_computed_are_refused():
    part = Bent(length=0.1, curvature=20.0)
    with pytest.raises(ConfigError, match="use at most") as refused:
        bent_modes(AIR, np.array([42e3]), part, radius=RADIUS, modes=NAMES, count=50)
    assert "count = 50" in str(refused.value)


def by_network(frequency, places, depths):
    """Return the echo at the face of presses on the wrap, by star products of all modes of bends.

    The bends have 5 cm and constant curvature each; presses transmit antisymmetric modes unchanged.
    """
    propagates = frequency[:, None] > np.append(CUT_ONS, CUT_ONS[1:])
    k, m = wavenumbers(NAMES, frequency), len(NAMES)

    def straight(length):
        turn = np.exp(-1j * k * length)[:, :, None] * np.eye(m)
        return np.block([[0 * turn, turn], [turn, 0 * turn]])

    def bent(start, stop):
        edges = np.linspace(start, stop, 1 + max(1, round((stop - start) / 0.05)))
        parts = []
        for low, high in pairwise(edges):
            curvature, torsion = HELIX.bend(HELIX.height(0.5 * (low + high)))
            parts.append(
                Bent(length=high - low, curvature=float(curvature), torsion=float(torsion))
            )
        found = joined_bends(AIR, frequency, parts, radius=RADIUS, modes=NAMES, highest=4.5)
        return found.s.reshape(len(frequency), 2 * m, 2 * m)

    total, at = straight(HELIX.lead), HELIX.lead
    for place, depth in zip(places, depths, strict=True):
        s = np.zeros((len(frequency), 2, m, 2, m), complex)
        s[:, :, :3, :, :3] = scattering(depth, frequency)[0]
        for i in (3, 4):
            s[:, 0, i, 1, i] = s[:, 1, i, 0, i] = 1.0
        s *= propagates[:, None, :, None, None] * propagates[:, None, None, None, :]
        pressed = s.reshape(len(frequency), 2 * m, 2 * m)
        for one in (bent(at, place - WRAP.reach), straight(WRAP.reach), pressed,
                    straight(WRAP.reach)):  # fmt: skip
            total = star_product(total, one)
        at = place + WRAP.reach
    reflection = total[:, :m, :m]
    inside = np.linalg.inv(np.eye(m) - 0.3 * reflection)
    return (inside @ reflection)[:, 0, 0]


@pytest.mark.parametrize(
    ("places", "tolerance"), [([0.4], 0.012), ([1.3], 0.01), ([0.6, 1.1], 0.006)]
)
def test_echo_of_a_wrapped_tube_is_that_of_its_bends_in_series(places, tolerance):
    """The change of the echo from depths of 2 to 5 mm is compared: the rest is not in the model.

    Without antisymmetric modes between face and wrap the echo of two would be off by 1.4 %.
    """
    frequency = np.linspace(36.5e3, 47.5e3, 12)
    k, cold = wavenumbers(MODES, frequency), np.zeros(1)
    path = WrappedPath(WRAP, AIR, frequency, RADIUS, MODES, k, 0 * k, 1.7e-3)
    found, expected = [], []
    for depth in (2e-3, 5e-3):
        s = masked(depth, frequency)
        joined = [path.joined(Matrices(s, s, s), np.array([z]), cold) for z in places]
        sections = path.sections(np.array([places]), cold)
        found.append(coupled_echo(joined, sections, 0.3, path.entry(cold)).value[0])
        expected.append(by_network(frequency, places, [depth] * len(places)))
    off = (found[1] - found[0]) - (expected[1] - expected[0])
    assert np.linalg.norm(off) < tolerance * np.linalg.norm(expected[1] - expected[0])


@pytest.fixture(scope="module")
def model():
    base = Baseband(Rangefinder(), RADIUS, 2.5, 20.0, MODES, wrap=WRAP)
    return ForwardModel(Library((tool(),)), base)


@pytest.mark.parametrize("places", [[0.52], [0.47, 0.66]])
def test_jacobian_of_a_wrapped_tube_is_that_of_differences(model, places):
    """The reference is fourth-order differences."""
    m = len(places)
    presses = np.column_stack([np.array(places) + 3e-3, [4.31e-3, 5.13e-3][:m]])
    start = np.concatenate([np.ravel(presses), [0.13, 0.02, -0.03, 4e-4, 0.01, 7e-4, 2e-3]])

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


def masked(depth, frequency):
    """Return the scattering with zeros for modes below their cut-ons, (n, n_f, 2, 3, 2, 3)."""
    above = frequency[:, None] > CUT_ONS
    return scattering(depth, frequency) * (
        above[:, None, :, None, None] * above[:, None, None, None, :]
    )


FREQUENCY = np.arange(20e3, 62e3, 100.0)


@cache
def bends_between(*places):
    """Bends of the arm before, between and behind presses at given positions."""
    return windings(HELIX, AIR, FREQUENCY, places, reach=WRAP.reach, radius=RADIUS, modes=MODES)


def wrapped_presses(*contacts):
    """Presses of given depths at positions on the arm, between bends."""
    placed = [
        PlacedScatterer(
            ModalScattering(
                frequency=FREQUENCY, modes=MODES, s=masked(depth, FREQUENCY)[0], cut_ons=CUT_ONS,
                propagates=FREQUENCY[:, None] > CUT_ONS, sound_speed=AIR.sound_speed,
                extent=(-WRAP.reach, WRAP.reach),
            ),
            place,
        )
        for depth, place in contacts
    ]  # fmt: skip
    found = bends_between(*(place for _, place in contacts))
    return found + [between_bends(press, WRAP.reach) for press in placed]


def untouched():
    """Bends of the arm without a press."""
    return list(bends_between())


def wrapped_cycles(depth, place, seed, n_cycles=20):
    """Cycles of a press on the arm."""
    presses = wrapped_presses((depth, place))
    return record(presses, radius=RADIUS, n_cycles=n_cycles, seed=seed, temperature=20.0)


def test_modelled_far_end_behind_a_press_on_an_arm_is_the_recorded_one():
    """The press attenuates and delays the echo of the far end, in cycles with little noise."""
    rangefinder = Rangefinder(clutter=1e-12, noise=1e-6, bits=16, gain=50.0, far_reflection=0.3)
    tube = {"radius": RADIUS, "length": 2.5, "temperature": 20.0, "n_cycles": 1, "seed": 1}
    bends = untouched()
    base = Baseband(rangefinder, RADIUS, 2.5, 20.0, MODES, wrap=WRAP)
    alone, pressed = (
        base.of_cycles(record(presses, rangefinder, **tube)["signal"].values)[0]
        for presses in (bends, wrapped_presses((5e-3, 0.9)))
    )
    free = record(bends, rangefinder, **tube)["signal"].values
    model = ForwardModel(Library((tool(),)), base, measured_clutter(base, free))
    place, depth = np.array([[0.9]]), np.array([[5e-3]])
    modelled = model.baseband((0,), place, depth, np.zeros((1, 7)))[0][0]
    late = base.path.place_at(base.window) > 2.4
    assert np.linalg.norm((pressed - alone)[late]) > 0.3 * np.linalg.norm(alone[late])
    off = np.linalg.norm((pressed - modelled)[late])
    assert off < 0.1 * np.linalg.norm(alone[late])


@pytest.mark.slow
def test_press_on_an_arm_is_found_at_its_place_and_depth(model):
    cycles = wrapped_cycles(4.3e-3, 0.52, seed=3)["signal"].values
    found = Inverter(model, most=1)(cycles)
    assert len(found.contacts) == 1
    contact = found.contacts[0]
    assert contact.distance.value == pytest.approx(0.52, abs=0.5e-3)
    assert contact.depth.value == pytest.approx(4.3e-3, abs=0.15e-3)
    # The plane wave returns later than along a straight tube of this length.
    assert np.interp(0.52, found.place, model.base.window) > 1.02 * 2 * 0.52 / AIR.sound_speed


@pytest.mark.slow
def test_press_on_an_arm_is_found_beyond_the_limit_of_detection(model):
    """Behind a deep press; measured, presses are found from 0.6 mm below the limit on.

    The limit allows for model errors of 6 %. There is no limit in the lead, where no press is
    sought.
    """

    def found(*contacts):
        presses = wrapped_presses(*contacts)
        cycles = record(presses, radius=RADIUS, n_cycles=20, seed=4, temperature=20.0)
        return Inverter(model, most=2)(cycles["signal"].values)

    first = 6.5e-3, 0.45
    lead, limit = found(first).detection_limit([0.1, 1.9])
    assert np.isnan(lead)
    for off, number in ((0.2e-3, 2), (-1.2e-3, 1)):
        assert len(found(first, (limit + off, 1.9)).contacts) == number


WRAPPED = "[wrap]\nforearm_cm = [26, 18, 26.6]\nloops = 9\n"


def test_file_of_a_sensor_states_its_wrap(tmp_path):
    path = tmp_path / "s.toml"
    path.write_text(f"length_cm = 250\n{WRAPPED}")
    found = read_sensor(path).wrap
    assert found.start == pytest.approx(0.15)
    assert found.stop == pytest.approx(HELIX.tube_length, rel=1e-9)
    assert found.curvature == pytest.approx(WRAP.curvature, rel=1e-9)
    assert found.torsion == pytest.approx(WRAP.torsion, rel=1e-9)


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("wrap = 3", "wrap = 3 must be a section"),
        ("[wrap]\nloops = 9", "needs forearm_cm = [26, 18, 26.6], say"),
        ("[wrap]\nforearm_cm = [26, 18]\nloops = 9", "needs forearm_cm"),
        ("[wrap]\nforearm_cm = [26, 18, 26.6]", "a layout needs loops or a pitch"),
        (f"{WRAPPED}lead = 3", "lead is not known; did you mean lead_cm"),
        (f"{WRAPPED}lead_cm = -3", "lead_cm = -3"),
        (f'{WRAPPED}hand = "both"', "hand"),
    ],
)
def test_wrap_that_cannot_be_is_one_sentence(tmp_path, words, reason):
    path = tmp_path / "s.toml"
    path.write_text(words)
    with pytest.raises(ConfigError) as found:
        read_sensor(path)
    assert reason in str(found.value)
    assert str(path) in str(found.value)
    assert "\n" not in str(found.value)


def test_wrap_beyond_the_tube_has_no_place_for_a_press():
    late = dataclasses.replace(WRAP, place=WRAP.place + 3.0)
    base = Baseband(Rangefinder(), RADIUS, 2.5, 20.0, MODES, wrap=late)
    with pytest.raises(ConfigError, match="has no place for a press"):
        ForwardModel(Library((tool(),)), base)


@pytest.mark.slow
def test_contact_on_an_arm_is_followed(model):
    """In a tube with known clutter the contact moves by 0.5 mm and gets deeper."""
    free = record(untouched(), radius=RADIUS, n_cycles=30, seed=2, temperature=20.0)
    clutter = measured_clutter(model.base, free["signal"].values)
    tracker = ContactTracker(ForwardModel(model.tool_library, model.base, clutter))
    assert all(not tracker.update(one).contacts for one in free["signal"].values[:3])
    for place, depth, seed in ((0.52, 4.3e-3, 3), (0.5205, 4.5e-3, 4)):
        cycles = wrapped_cycles(depth, place, seed, n_cycles=6)["signal"].values
        found = [tracker.update(one).contacts for one in cycles][-1]
        assert len(found) == 1
        assert found[0].distance.value == pytest.approx(place, abs=0.5e-3)
        assert found[0].depth.value == pytest.approx(depth, abs=0.15e-3)


@pytest.mark.slow
def test_command_inverts_recordings_of_a_sleeve(tmp_path):
    (plan,) = tool_plans({"depth_mm": ["1:3:0.5"]}, 0.01)
    (tmp_path / "lib").mkdir()
    files.write_tool(tmp_path / "lib" / plan.name, tool(), plan)
    write(wrapped_cycles(5.1e-3, 0.45, seed=4), tmp_path / "p.nc")
    (tmp_path / "s.toml").write_text(WRAPPED)
    done = run_here(
        "invert", tmp_path / "p.nc", "--library", tmp_path / "lib", "--sensor",
        tmp_path / "s.toml", "--group", 20, "--most", 1, "--out", tmp_path / "c.csv",
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    head, *rows = (tmp_path / "c.csv").read_text().splitlines()
    assert len(rows) == 1
    row = dict(zip(head.split(","), rows[0].split(","), strict=True))
    assert float(row["distance_cm"]) == pytest.approx(45, abs=0.05)
    assert float(row["depth_mm"]) == pytest.approx(5.1, abs=0.25)
