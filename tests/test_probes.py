"""Probes and sources of modes, against their closed form in a straight tube."""

import numpy as np
import pytest
import trimesh
from scipy.special import jv
from wave_lumens import BORE, straight_tube

from acoustube.air import air_at
from acoustube.base.errors import ConfigError
from acoustube.waves import (
    ModalProbe,
    PointProbe,
    Pulse,
    axial_wavenumber,
    cut_cells,
    propagate,
    section_cut_ons,
)
from acoustube.waves.modes import bessel_zero
from acoustube.waves.modes.grid_modes import duct_modes, labels, mode_numbers
from acoustube.waves.scheme.problem import prepare

AIR = air_at(20.0)
CELLS = cut_cells(straight_tube(0.08, sections=256), 2 * BORE / 12, half=True)
PULSE = Pulse(frequency=42e3, cycles=11)


def spectra(recording, frequency):
    return recording.pressure @ np.exp(-2j * np.pi * np.outer(recording.time, frequency))


@pytest.fixture(scope="module")
def launched():
    """(1,1) sent into a straight tube, as recorded by plane, modal and point probes."""
    probes = (
        0.02, ModalProbe(0.0, "11c"), ModalProbe(0.02, "11c"), ModalProbe(0.06, "11c"),
        ModalProbe(0.02, "21c"), PointProbe(0.02, 1e-4, 0.0), PointProbe(0.02, 1e-4, 2.5e-3),
        PointProbe(0.02, 1e-4, -2.5e-3),
    )  # fmt: skip
    return propagate(
        CELLS, AIR, PULSE, duration=0.9e-3, probes=probes, source_end="absorbing",
        source_mode="11c",
    )  # fmt: skip


def test_launched_mode_has_the_amplitude_of_the_pulse(launched):
    """At z = 0, from the signal at 2 cm and the wavenumber, from 38 to 46 kHz.

    The amplitude is right within 1e-3, the phase within the grid's error, whose cut-on is 0.3 %
    off.
    """
    frequency = np.linspace(38e3, 46e3, 9)
    kz = axial_wavenumber(1, 1, frequency, BORE, AIR, lossy=False)
    sent = PULSE(launched.time) @ np.exp(-2j * np.pi * np.outer(launched.time, frequency))
    ratio = spectra(launched, frequency)[2] / sent * np.exp(1j * kz * launched.probes[2])
    assert np.abs(ratio) == pytest.approx(np.ones(9), abs=1e-3)
    assert np.abs(np.angle(ratio)).max() < 0.04


def test_launched_mode_travels_by_its_own_wavenumber(launched):
    """Over 4 cm from 38 to 46 kHz; on 12 cells the cut-on is 0.5 % off, which is 0.03 rad here."""
    frequency = np.linspace(38e3, 46e3, 9)
    heard = spectra(launched, frequency)
    kz = axial_wavenumber(1, 1, frequency, BORE, AIR, lossy=False)
    path = launched.probes[3] - launched.probes[2]
    ratio = heard[3] / heard[2] * np.exp(1j * kz * path)
    assert np.abs(ratio) == pytest.approx(np.ones(9), abs=0.01)
    assert np.abs(np.angle(ratio)).max() < 0.1


def test_probes_of_other_modes_record_nothing(launched):
    """Discrete modes of a layer are orthogonal, to the rounding of float32."""
    loudest = np.abs(launched.pressure[2]).max()
    for i in (0, 4):
        assert np.abs(launched.pressure[i]).max() < 1e-4 * loudest


def test_point_probes_record_the_shape_of_the_mode(launched):
    """J1 along the diameter, odd about the axis; bilinear on 12 cells, within 3 %."""
    zero = bessel_zero(1, 1)
    norm = np.sqrt(0.5 * (1 - 1 / zero**2)) * jv(1, zero)
    expected = jv(1, zero * 2.5e-3 / BORE) / norm
    axis, above, below = launched.pressure[5:8]
    mode = launched.pressure[2]
    assert np.abs(axis).max() < 1e-3 * np.abs(mode).max()
    share = above @ mode / (mode @ mode)
    assert abs(share) == pytest.approx(expected, rel=0.03)
    assert below == pytest.approx(-above, abs=1e-3)


def test_mode_below_its_cut_on_decays_exponentially():
    """(2,1) driven at 25 kHz decays over 1.6 mm."""
    pulse = Pulse(frequency=25e3, cycles=11)
    recording = propagate(
        CELLS, AIR, pulse, duration=0.7e-3, source_end="absorbing", source_mode="21c",
        probes=(ModalProbe(3e-3, "21c"), ModalProbe(6e-3, "21c")),
    )  # fmt: skip
    near, far = np.abs(spectra(recording, np.array([25e3])))[:, 0]
    path = recording.probes[1] - recording.probes[0]
    # The cut-on of the grid, 1 % low on 12 cells; the third of the modes symmetric about x = 0.
    cut_on = section_cut_ons(CELLS, 3, AIR.sound_speed, 3)[2]
    decay = 2 * np.pi * np.sqrt(cut_on**2 - 25e3**2) / AIR.sound_speed
    assert far / near == pytest.approx(np.exp(-decay * path), rel=0.01)


@pytest.mark.parametrize(
    ("words", "part"),
    [
        ({"source_mode": "11c", "source_end": "release"}, 'needs source_end = "absorbing"'),
        ({"source_mode": "11s", "source_end": "absorbing"}, 'mode = "11s" is not one of 00, 11c'),
        ({"source_end": "rigid"}, "source_end = rigid has no source"),
        ({"probes": (ModalProbe(0.02, "99"),)}, 'mode = "99" is not one of'),
        ({"probes": (PointProbe(0.02, 0.0, 5e-3),)}, "not in the air"),
    ],
)
def test_modes_and_points_that_are_not_there_are_refused(words, part):
    with pytest.raises(ValueError, match=part):
        propagate(CELLS, AIR, PULSE, duration=1e-3, **words)


def test_mode_of_a_section_without_symmetry_is_refused():
    """Its modes are neither symmetric nor antisymmetric about x = 0; the plane mode is exact."""
    oblique = straight_tube(0.03, sections=3)
    oblique.apply_transform(trimesh.transformations.rotation_matrix(0.3, [0, 0, 1]))
    words = {"duration": 0.3e-3, "source_end": "absorbing"}
    cells = cut_cells(oblique, BORE / 8)
    propagate(cells, AIR, PULSE, probes=(ModalProbe(0.02, "00"),), **words)
    with pytest.raises(ValueError, match='mode = "11c" is not defined, because the section'):
        propagate(cells, AIR, PULSE, probes=(ModalProbe(0.02, "11c"),), **words)


def test_probe_in_a_closed_layer_is_refused():
    """Between two lumens 10 mm apart."""
    parts = [straight_tube(0.03, sections=24) for _ in range(2)]
    parts[1].apply_translation([0.0, 0.0, 0.04])
    cells = cut_cells(trimesh.util.concatenate(parts), BORE / 4)
    with pytest.raises(ConfigError, match=r"lumen is closed at probe = 0.035 m; move the probe"):
        propagate(cells, AIR, PULSE, duration=1e-3, probes=(0.02, 0.035))


@pytest.mark.parametrize("half", [True, False])
def test_modes_of_half_and_whole_tubes_have_the_signs_of_bessel_functions(half):
    """J_m cos(m phi) and J_m sin(m phi), phi from -y towards +x, up to (2,2), as those of bends."""
    cells = cut_cells(straight_tube(0.004), 2 * BORE / 24, half=half)
    setup = prepare(cells, AIR, probes=(), far_end="rigid", time_step=1e-7)
    highest = 6.9 * AIR.sound_speed / (2 * np.pi * BORE)
    modes = duct_modes(setup.scheme, cells.volume_fraction, 4, highest, whole=not half)
    names = labels(modes, BORE, AIR.sound_speed)
    assert {"01", "12c", "22c", "41c"} < set(names)
    x, y = (cells.centres(axis) for axis in (0, 1))
    r, phi = np.hypot(*np.meshgrid(x, y, indexing="ij")), np.arctan2(x[:, None], -y)
    for name, weights in zip(names, modes.weights, strict=True):
        m = mode_numbers(name)[0]
        around = np.sin(m * phi) if name.endswith("s") else np.cos(m * phi)
        exact = jv(m, bessel_zero(*mode_numbers(name)) * r / BORE) * around
        size = np.sqrt(np.mean(exact[cells.volume_fraction[:, :, 4] > 0] ** 2))
        assert np.sum(weights * exact) / size > 0.9


def test_pairs_of_modes_are_separated_where_triangles_are_not_mirrored():
    """(1,1) of a whole tube points to -y and to +x, also if its 64 facets are turned."""
    tube = straight_tube(0.004, sections=64)
    tube.apply_transform(trimesh.transformations.rotation_matrix(0.4, [0, 0, 1]))
    cells = cut_cells(tube, 2 * BORE / 16)
    setup = prepare(cells, AIR, probes=(), far_end="rigid", time_step=1e-7)
    modes = duct_modes(setup.scheme, cells.volume_fraction, 4, 30e3, whole=True)
    pair = dict(zip(labels(modes, BORE, AIR.sound_speed), modes.weights, strict=True))
    x, y = cells.centres(0)[:, None], cells.centres(1)
    for name, direction in (("11c", (0.0, -1.0)), ("11s", (1.0, 0.0))):
        found = np.array([np.sum(pair[name] * axis) for axis in (x, y)])
        assert found / np.hypot(*found) == pytest.approx(direction, abs=1e-4)
