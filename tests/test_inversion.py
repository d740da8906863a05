"""Waveform inversion: its forward model, its Jacobian, and presses found again in recordings."""

import numpy as np
import pytest

from acoustube.air import air_at
from acoustube.inversion import (
    Baseband,
    ForwardModel,
    Inverter,
    Library,
    Tool,
    measured_clutter,
)
from acoustube.inversion.network import Waves, echo
from acoustube.inversion.tables import Matrices, ToolTable
from acoustube.ranging import Rangefinder, record
from acoustube.waves import PlacedScatterer, Scattering, transfer
from acoustube.waves.modes import axial_wavenumber, cut_on_frequency

RADIUS, MODES = 3.95e-3, ("00", "11c", "21c")
FREQUENCY = np.arange(30e3, 54e3, 100.0)
NUMBERS = (0, 0), (1, 1), (2, 1)
CUT_ONS = np.array([cut_on_frequency(*one, RADIUS, air_at(20.0).sound_speed) for one in NUMBERS])


def matrices(depth, frequency):
    """Return scattering like that of a press: an echo that grows and turns with depth, a trapped
    mode whose resonance falls, and coupling to the higher modes; (n, n_f, 2, 3, 2, 3)."""
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


def press(depth, place, frequency=None):
    """Return a press of exactly this scattering, over the band of the recordings."""
    frequency = np.arange(20e3, 70e3, 100.0) if frequency is None else frequency
    s = matrices(depth, frequency)[0]
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
    clutter = measured_clutter(base, base.of_cycles(untouched), len(untouched))
    return ForwardModel(library, base, clutter)


@pytest.fixture(scope="module")
def inverter(model):
    return Inverter(model)


@pytest.mark.parametrize("n", [1, 2, 3])
def test_echo_of_presses_is_that_of_the_network_of_waves(n):
    """The same echo by another code: with all multiple reflections, also at the face."""
    places, depths = np.array([0.41, 0.63, 1.3])[:n], np.array([4.2e-3, 5.1e-3, 6.3e-3])[:n]
    air, frequency = air_at(20.0), np.arange(37e3, 47e3, 100.0)
    k = np.stack([axial_wavenumber(*one, frequency, RADIUS, air) for one in NUMBERS], -1)
    presses = [press(d, z, frequency) for d, z in zip(depths, places, strict=True)]
    given = [Matrices(*(one.scattering.s[None] for _ in range(3))) for one in presses]
    found = echo(given, places[None], Waves(k[None], k[None]), 0.3)
    pressure = transfer(presses, air, frequency, radius=RADIUS, length=2.5, probes=[0.0],
                        source_reflection=0.3, far_reflection=0.0)[0]  # fmt: skip
    # Frequencies are given ones, which its interpolation returns within rounding.
    expected = (pressure - 1) / 1.3
    assert np.abs(found.value[0] - expected).max() < 1e-9 * np.abs(expected).max()


def test_table_interpolates_depth_and_frequency(base):
    depth, stretch = np.array([2.513e-3, 5.377e-3]), np.array([0.0031, -0.0042])
    found = ToolTable(tool(), base.frequency, 3)(depth, stretch).value
    for i in range(2):
        exact = matrices(depth[i], base.frequency * (1 + stretch[i]))[0]
        # Cubic splines over 0.1 mm and 100 Hz, fourth order.
        assert np.abs(found[i] - exact).max() < 2e-5


@pytest.mark.parametrize("places", [[0.52], [0.52, 0.81], [0.47, 0.66, 1.21]])
def test_jacobian_is_that_of_differences(model, places):
    """By fourth-order differences, off the nodes of the clutter's table."""
    m = len(places)
    start = np.concatenate([
        np.ravel(np.column_stack([np.array(places) + 3e-3, [4.31e-3, 5.13e-3, 3.37e-3][:m]])),
        [0.13, 0.02, -0.03, 4e-4, 0.01, 7e-4],
    ])  # fmt: skip

    def value(parameters):
        p = parameters[None]
        return model.baseband((0,) * m, p[:, : 2 * m : 2], p[:, 1 : 2 * m : 2], p[:, 2 * m :])

    jacobian = value(start)[1][0]
    steps = [1e-6, 1e-6] * m + [1e-3, 1e-3, 1e-3, 1e-6, 1e-3, 1e-6]
    for i, step in enumerate(steps):
        e = step * np.eye(len(start))[i]
        far, near = (value(start + s * e)[0][0] - value(start - s * e)[0][0] for s in (2, 1))
        difference = (8 * near - far) / (12 * step)
        assert np.abs(jacobian[i] - difference).max() < 1e-6 * np.abs(difference).max(), i


def test_forward_model_is_the_recording_of_the_rangefinder(library):
    """Without noise, clutter and far end, in the window that the inversion uses."""
    silent = Rangefinder(clutter=0.0, noise=0.0, drift=0.0, quantised=False, far_reflection=0.0)
    own = Baseband(silent, RADIUS, 2.5, 20.0, MODES)
    cycle = record([press(5.03e-3, 0.8)], silent, n_cycles=1)["signal"].values
    given = own.of_cycles(cycle)
    place, depth = np.array([[0.8]]), np.array([[5.03e-3]])
    found, _ = ForwardModel(library, own).baseband((0,), place, depth, np.zeros((1, 6)))
    # The taper's sidelobes, of the pulse's fade and of what is cyclic.
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
