"""The fast sensor on an arm: bent modes, presses between bends, against the full chain."""

import dataclasses

import jax
import numpy as np
import pytest
from test_inversion import FREQUENCY, RADIUS, tool
from test_wrapped_inversion import AIR, HELIX, NAMES, WRAP, masked, untouched, wrapped_presses

from acoustube.base.errors import ConfigError
from acoustube.inversion import Library, Wrap
from acoustube.inversion.coupled_network import coupled_echo
from acoustube.inversion.tables import Matrices
from acoustube.ranging import Rangefinder, record
from acoustube.sensor import Contact, TubeSensor
from acoustube.sensor.cycles import OPTIONS, echo_of
from acoustube.sensor.tables import press_tables
from acoustube.sensor.wrapped import wrapped_path
from acoustube.waves import Bent
from acoustube.waves.bent_modes import bent_modes

QUIET = Rangefinder(noise=0.0, drift=0.0, quantised=False)
LENGTH = HELIX.tube_length
COARSE = 5e-3
"""Tolerance of tables between depths; they are exact at the library's depths."""


@pytest.fixture(scope="module")
def library():
    depth = np.arange(1e-3, 7.01e-3, 0.25e-3)
    return Library((tool(0.25e-3, s=masked(depth, FREQUENCY)),))


@pytest.fixture(scope="module")
def sensor(library):
    return TubeSensor(library, QUIET, length=LENGTH, tube_seed=7, wrap=WRAP, tolerance=COARSE)


@pytest.fixture(scope="module")
def silent(library):
    """The sensor without clutter and far end."""
    device = dataclasses.replace(QUIET, far_reflection=0.0, clutter=0.0)
    return TubeSensor(library, device, length=LENGTH, wrap=WRAP, tolerance=COARSE)


@pytest.fixture(scope="module")
def straight(library):
    return TubeSensor(library, QUIET, length=LENGTH, tube_seed=7, tolerance=COARSE)


run = jax.jit(echo_of, static_argnums=0, compiler_options=OPTIONS)


def echo(sensor, place, depth):
    """Return the echo of up to three contacts at the band's frequencies, (n_f,)."""
    given = np.zeros((2, 3), np.float32)
    given[:, 3 - len(place) :] = place, depth
    found = run(sensor._shape, sensor._parts, *given, np.full(3, 25e-3, np.float32))
    return np.asarray(found.re) + 1j * np.asarray(found.im)


@pytest.fixture(scope="module")
def free():
    """Cycle of the untouched tube, by the bends in series."""
    return record(untouched(), QUIET, length=LENGTH, tube_seed=7)["signal"].values[0]


@pytest.mark.parametrize("torsion", [0.0, 3.4])
def test_bent_modes_continue_to_complex_frequencies(torsion):
    """By Taylor's series from real frequencies, to second order; the next term is 1e-6.

    4 kHz below the cut-on of (2,1), next to which the series converges slowly.
    """
    frequency, below = np.arange(35e3, 38e3, 20.0), 57.0
    part = Bent(length=1.0, curvature=20.0, torsion=torsion)
    real, there = (
        bent_modes(AIR, f, part, radius=RADIUS, modes=NAMES, count=3)
        for f in (frequency, frequency - 1j * below)
    )
    for name in ("wavenumber", "returned"):
        value = getattr(real, name)
        slope = np.gradient(value, frequency, axis=0)
        curve = np.gradient(slope, frequency, axis=0)
        series = value - 1j * below * slope - 0.5 * below**2 * curve
        off = np.abs(series - getattr(there, name))[3:-3].max()
        assert off < 1e-5 * np.abs(value).max()
        assert off < 0.05 * np.abs(value - getattr(there, name)).max()


@pytest.mark.parametrize(
    "contacts", [[(0.47, 4e-3)], [(1.3, 6e-3)], [(0.4, 3e-3), (0.9, 4e-3), (1.5, 5e-3)]]
)
def test_echo_is_that_of_the_inversions_network_at_complex_frequencies(library, silent, contacts):
    """In single precision, with matrices interpolated between nine positions along the arm."""
    made = silent
    place, depth = np.array(contacts).T
    found = echo(made, place, depth)
    period, rate = made._shape.period, QUIET.sampling_rate
    n_f = made._parts.scale.re.shape[0]
    real = (made._shape.first_bin + np.arange(n_f)) * rate / period
    damped = real - 0.5j * np.log(300.0) * rate / period / np.pi
    path = wrapped_path(WRAP, AIR, damped, library, 3)
    tables, cold = press_tables(library, damped, 1.0, COARSE), np.zeros(1)
    joined = []
    for z, d in contacts:
        row = np.argmin(np.abs(tables.depths[0] - d))
        different = tables.values[row, 0] + 1j * tables.values[row, 1]
        s = np.moveaxis(different[tables.number], -1, 0)[None].astype(complex)
        joined.append(path.joined(Matrices(s, s, s), np.array([z]), cold))
    exact = coupled_echo(joined, path.sections(place[None], cold), 0.3, path.entry(cold)).value[0]
    weight = np.hypot(made._parts.scale.re, made._parts.scale.im)
    off = (found - exact) * weight
    assert np.linalg.norm(off) < 0.003 * np.linalg.norm(exact * weight)


def test_wave_at_the_face_is_that_of_all_its_modes(library):
    """From the modes at the joint, against the solution for all modes at the face."""
    device = dataclasses.replace(QUIET, face_reflection=0.95, clutter=0.0, far_reflection=0.5)
    made = TubeSensor(library, device, length=LENGTH, wrap=WRAP, tolerance=COARSE)
    exact = made._parts.untouched
    off = echo(made, np.zeros(1), np.zeros(1)) - (np.asarray(exact.re) + 1j * np.asarray(exact.im))
    assert np.abs(off).max() < 1e-5


@pytest.mark.parametrize("contacts", [[(1.3, 6e-3)], [(0.8, 6e-3), (1.4, 5e-3)]])
def test_cycle_on_an_arm_is_that_of_the_bends_in_series(sensor, free, straight, contacts):
    """Cycles agree with those of bends in short parts of constant curvature, within 2 %.

    They differ by 0.8 to 1.2 %. Echoes in a straight tube differ by far more.
    """
    given = [Contact(place=z, depth=d) for z, d in contacts]
    placed = wrapped_presses(*((d, z) for z, d in contacts))
    exact = record(placed, QUIET, length=LENGTH, tube_seed=7)["signal"].values[0] - free
    found = sensor.read(given) - sensor.read([])
    assert np.linalg.norm(found - exact) < 0.02 * np.linalg.norm(exact)
    off = straight.read(given) - straight.read([]) - exact
    assert np.linalg.norm(off) > 0.3 * np.linalg.norm(exact)


def test_untouched_tube_is_that_of_the_bends_in_series(sensor, free):
    """Clutter and far end; 1.6 % differ."""
    late = slice(round(2 * 0.4 / 343 * QUIET.sampling_rate), None)
    found, exact = (one[late] - np.median(one) for one in (sensor.read([]), free))
    assert np.linalg.norm(found - exact) < 0.03 * np.linalg.norm(exact)
    other = record([], QUIET, length=LENGTH, tube_seed=7)["signal"].values[0][late]
    assert np.linalg.norm(other - np.median(other) - exact) > 0.3 * np.linalg.norm(exact)


def test_shallow_contacts_fade_to_the_untouched_tube(sensor):
    """At any position, although the tube is taken as straight under deeper contacts."""
    quiet = sensor.read([])
    sizes = [
        np.linalg.norm(sensor.read([Contact(place=0.61, depth=d)]) - quiet)
        for d in (0.0, 2e-4, 6e-4, 1e-3)
    ]
    assert sizes[0] < 1e-3 * sizes[1]
    assert sizes[1] < sizes[2] < sizes[3]


def test_batch_is_its_cycles(sensor):
    places, depths = np.array([[0.5, 1.2], [0.9, 0.0]]), np.array([[4e-3, 5e-3], [3e-3, 0.0]])
    many = sensor.read_many(places, depths)
    for row, z, d in zip(many, places, depths, strict=True):
        one = sensor.read([Contact(place=a, depth=b) for a, b in zip(z, d, strict=True)])
        assert np.abs(row - one)[800:].max() < 0.01  # as on a straight tube


@pytest.mark.parametrize(
    ("contacts", "word"), [([(0.1, 2e-3)], "place"), ([(0.5, 2e-3), (0.55, 2e-3)], "6 cm apart")]
)
def test_contact_off_the_wrap_or_too_near_is_one_sentence(sensor, contacts, word):
    with pytest.raises(ConfigError, match=word):
        sensor.read([Contact(place=z, depth=d) for z, d in contacts])


def test_wrap_that_does_not_fit_its_tube_is_one_sentence(library):
    with pytest.raises(ConfigError, match=r"make length 2\.4855 m or more"):
        TubeSensor(library, QUIET, length=1.0, wrap=WRAP)
    short = Wrap(place=np.array([0.2, 0.24]), curvature=np.full(2, 20.0), torsion=np.zeros(2))
    with pytest.raises(ConfigError, match="no place for a press"):
        TubeSensor(library, QUIET, length=1.0, wrap=short)


def test_echo_of_a_tool_is_the_same_in_a_library_of_several(library, sensor):
    """Rows and weights of two tools at two positions correspond."""
    (own,) = library.tools
    half = dataclasses.replace(own, diameter=15e-3, s=own.s * 0.5)
    several = TubeSensor(Library((half, own)), QUIET, length=LENGTH, tube_seed=7, wrap=WRAP,
                         tolerance=COARSE)  # fmt: skip
    for one in ({"place": 0.7, "depth": 4e-3}, {"place": 1.35, "depth": 5.5e-3}):
        alone = sensor.read([Contact(**one)]) - sensor.read([])
        among = several.read([Contact(**one, diameter=25e-3)]) - several.read([])
        # The other tool's tables are refined elsewhere; these rows are the same.
        assert np.abs(among - alone)[800:].max() < 0.02 * np.abs(alone).max()
        other = several.read([Contact(**one, diameter=15e-3)]) - several.read([])
        assert np.linalg.norm(other - alone) > 0.2 * np.linalg.norm(alone)
