"""Tubes with presses joined from scattering matrices, against closed forms and full simulations."""

from dataclasses import fields, replace

import numpy as np
import pytest
import trimesh
from refusals import refused
from wave_lumens import BORE, pinched_tube

from acoustube.air import Air, air_at
from acoustube.base.errors import ConfigError
from acoustube.waves import (
    PlacedScatterer,
    Pulse,
    SampledPulse,
    Scattering,
    axial_wavenumber,
    cut_cells,
    cut_on_frequency,
    grid_spacing,
    probe_pressure,
    propagate,
    scatter,
    transfer,
)
from acoustube.waves.interpolation import interpolate_scattering
from acoustube.waves.modes.grid_modes import mode_numbers
from acoustube.waves.scattering import ModalScattering
from acoustube.waves.spectral import SpectralScattering

AIR = Air(sound_speed=343.2, density=1.204, viscosity=1.8133e-5, prandtl=0.70520337)
"""Air of the table below."""
PHASE_SPEED = {41e3: 342.5079, 42e3: 342.5162, 43e3: 342.5241}
"""Phase speed in m/s of the plane mode in a bore of 3.95 mm radius, by Zwikker and Kosten."""
PULSE = Pulse(frequency=42e3)


def made(frequency, s, modes=("00",), extent=0.01):
    """Return a press with given coefficients of scattering."""
    n = len(modes)
    cut_ons = np.array([cut_on_frequency(*mode_numbers(m), BORE, 343.2) for m in modes])
    return Scattering(
        frequency=frequency, modes=modes, s=s.reshape(len(frequency), 2, n, 2, n),
        propagates=np.ones((len(frequency), n), bool), cut_ons=cut_ons,
        settled=np.ones((len(frequency), 2, n, 2, n), bool), sound_speed=AIR.sound_speed,
        extent=(-extent, extent), spacing=(1e-4,) * 3, shape=(1, 1, 1), steps=1, time_step=1e-7,
    )  # fmt: skip


def mirror(reflection, frequency):
    """Return a symmetric, lossless press with a real R, for which T = j sqrt(1 - R^2)."""
    through = 1j * np.sqrt(1 - reflection**2)
    matrix = np.array([[reflection, through], [through, reflection]])
    return made(frequency, np.tile(matrix, (len(frequency), 1, 1)).astype(complex))


def tube(**words):
    return {"radius": BORE, "length": 6.0} | words


def test_group_delay_over_five_metres_is_that_of_the_lossy_plane_mode():
    """The slope of the phase from 41 to 43 kHz over 5 m is right within 1 mm, or 2.9 us."""
    frequency = np.array(list(PHASE_SPEED))
    answer = transfer([], AIR, frequency, probes=(0.0, 5.0), **tube())
    wanted = np.array([-2 * np.pi * f * 5 / speed for f, speed in PHASE_SPEED.items()])
    off = np.angle(answer[1] / answer[0] * np.exp(-1j * wanted))
    # The table's seven digits, 1e-4 m/s, are a phase of 1 mrad, or 0.2 mm of group delay.
    assert np.abs(off).max() < 2e-3
    late = -(off[2] - off[0]) / (2 * np.pi * 2e3)
    assert abs(late) * 342 < 1e-3
    exact = -(wanted[2] - wanted[0]) / (2 * np.pi * 2e3)
    time, pressure = probe_pressure([], AIR, PULSE, duration=16e-3, probes=(0.0, 5.0), **tube())
    first, second = (np.abs(np.fft.ifft(2 * np.fft.fft(p) * (np.arange(p.size) < p.size / 2)))
                     for p in pressure)  # fmt: skip
    centres = [np.sum(time * env**4) / np.sum(env**4) for env in (first, second)]
    assert centres[1] - centres[0] == pytest.approx(exact, abs=1e-3 / 342)


@pytest.mark.parametrize("lossy", [False, True])
def test_two_presses_make_a_resonator(lossy):
    """Two partial mirrors in a tube are compared with Airy's sum of all echoes, to rounding."""
    frequency = np.linspace(30e3, 50e3, 401)
    r, gap = 0.6, 0.2
    presses = [PlacedScatterer(mirror(r, frequency), z) for z in (0.5 + gap, 0.5)]
    answer = transfer(
        presses, AIR, frequency, probes=(0.1, 2.0), source_reflection=0.0, lossy=lossy, **tube()
    )
    kz = axial_wavenumber(0, 0, frequency, BORE, AIR, lossy=lossy)
    loop = np.exp(-2j * kz * gap)
    through = -(1 - r**2)
    reflected = r + through * r * loop / (1 - r**2 * loop)
    passed = through / (1 - r**2 * loop) * np.exp(-2j * kz)
    assert answer[0] == pytest.approx(np.exp(-0.1j * kz) + reflected * np.exp(-0.9j * kz), rel=1e-9)
    assert answer[1] == pytest.approx(passed, rel=1e-9)


def test_ends_reflect_by_their_given_coefficients():
    """A tube with losses between two given reflections, against the sum of its echoes."""
    frequency = np.linspace(30e3, 50e3, 11)
    kz = axial_wavenumber(0, 0, frequency, BORE, AIR)
    rs, rf, length, z = -0.7, 0.9 * np.exp(1e-6j * frequency), 1.5, 0.4
    answer = transfer(
        [], AIR, frequency, radius=BORE, length=length, probes=(z,),
        source_reflection=rs, far_reflection=rf,
    )  # fmt: skip
    back = rf * np.exp(-2j * kz * length)
    wanted = (np.exp(-1j * kz * z) + back * np.exp(1j * kz * z)) / (1 - rs * back)
    assert answer[0] == pytest.approx(wanted, rel=1e-9)


def test_modes_that_meet_again_keep_their_power():
    """Two unitary presses with two modes in a lossless tube conserve power."""
    rng = np.random.default_rng(1)
    frequency = np.linspace(30e3, 50e3, 21)
    modes = ("00", "11c")
    presses = []
    for z in (0.5, 0.8):
        noise = rng.normal(size=(4, 4)) + 1j * rng.normal(size=(4, 4))
        unitary, _ = np.linalg.qr(noise)
        presses.append(PlacedScatterer(made(frequency, np.tile(unitary, (21, 1, 1)), modes), z))
    kept, swapped, none = np.eye(2), np.eye(2)[::-1], np.zeros((2, 2))

    def at_probes(onwards, back):
        """Plane pressure at both probes; near each, a converter of modes by direction of travel."""
        before, behind = (
            PlacedScatterer(
                made(frequency, np.tile(np.block([[none, b], [a, none]]) + 0j, (21, 1, 1)), modes),
                z,
            )
            for a, b, z in ((kept, back, 0.2), (onwards, kept, 1.1))
        )
        return transfer(
            [before, *presses, behind], AIR, frequency, radius=BORE, length=1.5, lossy=False,
            probes=(0.1, 1.3), source_reflection=0.0,
        )  # fmt: skip

    # The converter turns the power of (1,1) into a plane wave.
    launched = np.exp(-1j * axial_wavenumber(0, 0, frequency, BORE, AIR, lossy=False) * 0.1)
    plane, other = at_probes(kept, kept), at_probes(swapped, swapped)
    reflected = np.abs(plane[0] - launched) ** 2 + np.abs(other[0] - launched) ** 2
    passed = np.abs(plane[1]) ** 2 + np.abs(other[1]) ** 2
    assert reflected + passed == pytest.approx(np.ones(21), rel=1e-9)
    assert reflected.max() > 0.5


def test_scattering_between_its_frequencies_is_that_of_its_response():
    """A reflection delayed by 0.3 ms, given every 100 Hz: exact there, 0.2 % in between.

    At a complex frequency it is damped by exp(-eta t).
    """
    frequency = np.arange(30e3, 50e3 + 1, 100.0)
    delay, between = 0.3e-3, np.arange(35e3, 45e3, 33.0)
    s = np.zeros((len(frequency), 2, 2), complex)
    s[:, 0, 0] = np.exp(-2j * np.pi * frequency * delay)
    press = made(frequency, s)
    assert interpolate_scattering(press, frequency)[:, 0, 0, 0, 0] == pytest.approx(
        s[:, 0, 0], rel=1e-9
    )
    for eta in (0.0, 500.0):
        found = interpolate_scattering(press, between - 1j * eta / (2 * np.pi))[:, 0, 0, 0, 0]
        wanted = np.exp((-2j * np.pi * between - eta) * delay)
        # The two ends of the band differ; this is the effect of that step in its middle.
        assert found == pytest.approx(wanted, abs=2e-3)


@pytest.mark.parametrize("damping", [0.0, 300.0])
def test_scattering_above_a_cut_on_is_interpolated_without_its_step(damping):
    """The interpolated matrix of a membrane that couples two modes, against its closed form.

    The membrane has an admittance of 0.3; frequencies are 0.5 kHz and more above the cut-on of the
    higher mode. Were the step at the cut-on interpolated as well, reflection and conversion would
    be off by up to 0.1.
    """
    modes, given = ("00", "11c"), np.arange(23e3, 40e3, 100.0)
    cut_on = cut_on_frequency(1, 1, BORE, 343.2)

    def matrix(f):
        kz = np.sqrt(np.where(f.real > cut_on, 1 - (cut_on / f) ** 2, 0))
        s = np.zeros((len(f), 2, 2, 2, 2), complex)
        s[:, 0, 1, 0, 1] = np.where(f.real > cut_on, (kz - 0.3) / (kz + 0.3), 0)
        s[:, 0, 0, 0, 1] = s[:, 0, 1, 0, 0] = 2 * np.sqrt(0.3 * kz) / (kz + 0.3)
        return s

    wanted = np.arange(cut_on + 500.0, 38e3, 33.0) - 1j * damping / (2 * np.pi)
    found = interpolate_scattering(made(given, matrix(given + 0j), modes), wanted)
    assert np.abs(found - matrix(wanted)).max() < 5e-3


FREQUENCY = np.arange(25e3, 59.1e3, 200.0)


@pytest.mark.parametrize(
    ("positions", "words", "part"),
    [
        (
            [0.3, 0.315],
            {},
            "press at 0.315 m, whose deformed section extends from 0.305 m to 0.325 m",
        ),
        ([0.005], {}, "meets the one before it or the source end"),
        ([5.995], {}, "beyond the tube's end at length = 6 m"),
        ([0.3], {"probes": [0.3]}, "probe = 0.3 m lies outside the tube or within a press"),
        ([0.3], {"probes": [7.0]}, "probe = 7 m lies outside the tube"),
    ],
)
def test_presses_and_probes_that_collide_are_refused(positions, words, part):
    presses = [PlacedScatterer(mirror(0.5, FREQUENCY), z) for z in positions]
    with pytest.raises(ValueError, match=part):
        transfer(presses, AIR, FREQUENCY, **tube(**words))


def test_even_frequencies_by_the_chirp_transform_are_those_one_by_one():
    """The chirp transform equals the evaluation frequency by frequency, to rounding.

    Real frequencies, and complex ones of decaying sound.
    """
    rng = np.random.default_rng(3)
    given = np.arange(30e3, 50e3, 100.0)
    s = rng.normal(size=(2, len(given), 4)) * [[[1]], [[1j]]]
    press = made(given, s.sum(axis=0))
    wanted = np.arange(32e3, 48e3, 37.5) - 40j
    together = interpolate_scattering(press, wanted)
    assert together == pytest.approx(
        np.concatenate(
            [interpolate_scattering(press, wanted[i : i + 1]) for i in range(len(wanted))]
        ),
        abs=1e-9,
    )


def test_frequencies_outside_the_band_of_a_press_are_refused():
    press = PlacedScatterer(mirror(0.5, FREQUENCY), 0.3)
    with pytest.raises(ValueError, match="outside the band of a press, 25000 to 59000 Hz"):
        transfer([press], AIR, np.array([20e3, 30e3]), **tube())
    with pytest.raises(ValueError, match=r"of the energy of the pulse lies outside 25"):
        probe_pressure([press], AIR, Pulse(frequency=25e3), duration=1e-3, **tube())
    with pytest.raises(ValueError, match="no frequency of the pulse lies in the bands of all"):
        apart = [press, PlacedScatterer(mirror(0.5, FREQUENCY + 90e3), 0.5)]
        probe_pressure(apart, AIR, Pulse(frequency=25e3), duration=1e-3, **tube())
    with pytest.raises(ValueError, match=r"pulse lasts 0.2619 ms, longer than the run"):
        probe_pressure([press], AIR, PULSE, duration=0.2e-3, **tube())
    other = PlacedScatterer(
        made(FREQUENCY, np.zeros((len(FREQUENCY), 4, 4), complex), ("00", "11c")), 0.5
    )
    with pytest.raises(ValueError, match="different modes, 00 and 00, 11c"):
        transfer([press, other], AIR, FREQUENCY, **tube())


def test_presses_of_another_tube_or_air_are_refused():
    press = PlacedScatterer(mirror(0.5, FREQUENCY), 0.3)
    for words, part in (
        ({"radius": 0.0}, "radius = 0.0 m must be positive"),
        ({"air": air_at(50.0)}, "computed for sound at 343.20 m/s"),
    ):
        air = words.pop("air", AIR)
        with pytest.raises(ValueError, match=part):
            transfer([press], air, FREQUENCY, **tube(**words))
    s = np.zeros((len(FREQUENCY), 4, 4), complex)
    press = replace(made(FREQUENCY, s, ("00", "11c")), cut_ons=np.array([0.0, 25.4e3]))
    transfer([PlacedScatterer(press, 0.3)], AIR, FREQUENCY, **tube())
    with pytest.raises(ValueError, match=r"radius = 0.008 m is not that of the press at 0.3 m"):
        transfer([PlacedScatterer(press, 0.3)], AIR, FREQUENCY, **tube(radius=8e-3))


def test_frequencies_too_far_apart_or_uneven_are_refused():
    """Steps of 500 Hz are refused only where a mode cuts on among them, here (2,1) at 42.2 kHz."""
    coarse, uneven = np.arange(30e3, 51e3, 500.0), np.geomspace(30e3, 51e3, 300)
    interpolate_scattering(mirror(0.5, coarse), coarse)
    two_modes = made(coarse, np.zeros((len(coarse), 4, 4), complex), ("00", "21c"))
    with pytest.raises(ValueError, match="steps of 500 Hz are too coarse"):
        interpolate_scattering(two_modes, coarse)
    with pytest.raises(ValueError, match="evenly spaced frequencies"):
        interpolate_scattering(mirror(0.5, uneven), uneven)


def test_probe_between_a_press_and_its_position_is_on_the_side_of_the_source():
    """A mirror at 0.33 m, given at its place and by coefficients at planes 3 cm away from it."""
    frequency, far = np.arange(10e3, 25e3, 100.0), 0.03
    there = mirror(0.6, frequency)
    turn = np.exp(-2j * axial_wavenumber(0, 0, frequency, BORE, AIR, lossy=False) * far)
    s = there.s.copy()
    s[:, 0, 0, 0, 0] *= turn
    s[:, 1, 0, 1, 0] /= turn
    beyond = replace(there, s=s, extent=(far - 0.01, far + 0.01))
    before = PlacedScatterer(beyond, 0.3).from_other_end(0.66).scattering
    heard = [
        transfer(
            [PlacedScatterer(press, place)], AIR, frequency, radius=BORE, length=1.0, lossy=False,
            source_reflection=0.0, probes=(0.1, 0.31, 0.35, 0.5),
        )
        for press, place in ((there, 0.33), (beyond, 0.3), (before, 0.36))
    ]  # fmt: skip
    assert heard[1] == pytest.approx(heard[0], abs=1e-9)
    assert heard[2] == pytest.approx(heard[0], abs=1e-9)


def test_mirrored_scatterer_has_all_its_matrices_mirrored():
    rng = np.random.default_rng(5)
    shape = len(FREQUENCY), 2, 1, 2, 1
    press = replace(
        mirror(0.5, FREQUENCY), settled=rng.random(shape) < 0.5, evanescent=rng.random(shape) + 0j
    )
    turned = PlacedScatterer(press, 0.3).from_other_end(1.0).scattering
    assert np.array_equal(turned.evanescent, press.evanescent[:, ::-1, :, ::-1])
    assert np.array_equal(turned.settled, press.settled[:, ::-1, :, ::-1])
    shared = {f.name: getattr(press, f.name) for f in fields(ModalScattering)}
    spectral = SpectralScattering(
        **shared, derivative=rng.random(shape) + 0j, error=np.zeros(len(FREQUENCY)),
        tolerance=1e-3, degree=6, n_elements=4, n_shifts=2, n_fields=9,
    )  # fmt: skip
    turned = PlacedScatterer(spectral, 0.3).from_other_end(1.0).scattering
    assert np.array_equal(turned.derivative, spectral.derivative[:, ::-1, :, ::-1])
    assert PlacedScatterer(replace(spectral, derivative=None), 0.3).from_other_end(1.0)


def test_tubes_that_cannot_be_joined_are_refused_by_what_is_wrong():
    refused(lambda: PlacedScatterer(mirror(0.5, FREQUENCY), np.nan), setting="position")
    one = PlacedScatterer(mirror(0.5, FREQUENCY[:1]), 0.3)
    with pytest.raises(ConfigError, match="a press of one frequency cannot be interpolated"):
        transfer([one], AIR, FREQUENCY[:1], **tube())
    far = np.full(len(FREQUENCY), 0.5)
    words = {"duration": 1e-3, "far_reflection": far, **tube()}
    error = refused(lambda: probe_pressure([], AIR, PULSE, **words), setting="far_reflection")
    assert error.advice == "give one number"
    bump = SampledPulse(pressure=np.hanning(101), rate=1e6)
    press = PlacedScatterer(mirror(0.5, FREQUENCY), 0.3)
    with pytest.raises(ValueError, match="of the energy of the pulse lies outside 25"):
        probe_pressure([press], AIR, bump, duration=2e-3, **tube())


@pytest.mark.parametrize("through", [0, 251, 1001])
def test_a_pulse_with_a_mean_travels_unchanged_at_the_speed_of_sound(through):
    """The part at frequency zero travels too, also through a press known from zero."""
    frequency = np.linspace(0.0, 50e3, max(through, 2))
    one = made(frequency, np.tile(np.eye(2)[::-1], (len(frequency), 1, 1)).astype(complex))
    presses = [PlacedScatterer(one, 0.1)] if through else []
    bump = SampledPulse(pressure=np.exp(-((np.arange(401) - 200) ** 2) / 50**2), rate=1e6)
    time, pressure = probe_pressure(
        presses, AIR, bump, duration=5e-3, probes=(0.4,), lossy=False, source_reflection=0.0,
        **tube(),
    )  # fmt: skip
    # The bump is truncated at exp(-16), 1e-7 of its peak; above 50 kHz it has nothing.
    assert pressure[0] == pytest.approx(bump(time - 0.4 / 343.2), abs=2e-7)


def test_lists_of_frequencies_and_reflections_are_taken_as_arrays():
    f, far = [41e3, 42e3], [0.1, 0.2 + 0.1j]
    found = transfer([], AIR, f, far_reflection=far, **tube())
    wanted = transfer([], AIR, np.array(f), far_reflection=np.array(far), **tube())
    assert np.array_equal(found, wanted)
    with pytest.raises(ValueError, match=r"far_reflection has shape \(3,\)"):
        transfer([], AIR, f, **tube(far_reflection=np.zeros(3)))
    refused(lambda: transfer([], AIR, ["x"], **tube()), setting="frequency")
    refused(lambda: transfer([], AIR, [[1.0], [1.0, 2.0]], **tube()), setting="frequency")


def twice_pinched(length, pinches):
    z = np.linspace(0.0, length, 400)
    profile = [[0, 0], *[[BORE, zi] for zi in z], [0, length]]
    lumen = trimesh.creation.revolve(profile, sections=64)
    vertices = lumen.vertices.copy()
    for centre, depth in pinches:
        press = np.exp(-(((vertices[:, 2] - centre) / 4e-3) ** 2))
        vertices[:, 1] -= depth * press * (vertices[:, 1] + BORE)
    lumen.vertices = vertices
    return lumen


@pytest.mark.slow
def test_two_presses_echo_as_in_a_run_of_the_whole_tube():
    """Cascade and march of the whole tube agree within 2 % of the pulse, 5 % of the echoes.

    At 22 kHz, with 12 cells per bore and losses. Below the cut-on of (1,1) both compute the plane
    mode; above it the grid of the full run slows the other modes between the presses.
    """
    pulse = Pulse(frequency=20e3, cycles=8)
    air, length, pinches = air_at(20.0), 0.26, [(0.10, 0.5), (0.18, 0.6)]
    spacing = grid_spacing(2 * BORE, 12)
    band = 8e3, 32e3
    run = propagate(
        cut_cells(twice_pinched(length, pinches), spacing, half=True), air, pulse,
        duration=1.6e-3, source_end="absorbing", lossy_band=band,
    )  # fmt: skip
    frequency = np.arange(*band, 100.0)
    presses = []
    for centre, depth in pinches:
        part = cut_cells(pinched_tube(0.05, depth=depth), spacing)
        s = scatter(part, air, frequency, reference=(0.025, 0.025), symmetric_only=True)
        presses.append(PlacedScatterer(s, centre))
    _, pressure = probe_pressure(
        presses, air, pulse, radius=BORE, length=length, duration=run.time[-1],
        time_step=run.time_step, probes=run.probes, source_reflection=0.0,
    )  # fmt: skip
    n = min(pressure.shape[1], run.pressure.shape[1])
    difference, full = (pressure[0] - run.pressure[0])[:n], run.pressure[0, :n]
    assert np.linalg.norm(difference) < 0.02 * np.linalg.norm(full)
    echoes = run.time[:n] > 0.5e-3
    assert np.linalg.norm(difference[echoes]) < 0.05 * np.linalg.norm(full[echoes])
